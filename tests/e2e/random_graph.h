// tests/e2e/random_graph.h -- seeded random graphs over the whole integer profile, or over what floats
// can do, at the extremes of shapes and attributes.
#pragma once

#include <cstdint>
#include <map>
#include <random>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

/// Draws from a fixed seed; the same numbers with every standard library.
class Random {
 public:
  explicit Random(uint64_t seed) : engine_(seed) {}

  /// Uniform in min..max, both included.
  int64_t between(int64_t min, int64_t max);
  bool chance(int percent) { return between(1, 100) <= percent; }
  template <typename T>
  const T& pick(const std::vector<T>& from) {
    return from[static_cast<size_t>(between(0, static_cast<int64_t>(from.size()) - 1))];
  }

 private:
  std::mt19937_64 engine_;
};

/// Data over the whole type, near zero, or at the limits; which of them is drawn too. Floats are mostly
/// of moderate size; else of any exponent, or infinite, NaN, subnormal and the largest there is.
Tensor random_tensor(Random& random, const TensorType& type);

struct RandomGraph {
  Graph graph;                 ///< legal, 1 to 8 nodes
  std::vector<Tensor> inputs;  ///< for which the interpreter gives a result
};

/// What became of the nodes that were drawn.
struct RandomGraphCounts {
  uint64_t kept = 0;
  uint64_t illegal = 0;        ///< the verifier refused the node
  uint64_t unpredictable = 0;  ///< TOSA gives no result for its operands
  std::map<Op, uint64_t> ops;  ///< kept nodes
};

/// Nodes are drawn one by one and evaluated at once; one that is illegal or without a result is
/// drawn again, so every graph is predictable for its inputs. Adds to `counts`. With `real`, values are
/// FP32 and FP16, beside what comparisons and casts give.
RandomGraph random_graph(uint64_t seed, RandomGraphCounts& counts, bool real = false);

/// The operators that such graphs are drawn from.
std::vector<Op> random_graph_ops(bool real);

}  // namespace shale
