// tools/shale/random_inputs.h -- random values for the inputs of a graph that the graph is defined for.
#pragma once

#include <map>
#include <random>
#include <string>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

/// NAME -> LOW, HIGH, as --range gives them; whole numbers for integers.
using GivenRanges = std::map<std::string, std::pair<double, double>>;

/// What random values of one input are drawn from.
struct RandomRange {
  double low = 0, high = 0;  ///< both included
  int64_t distinct = 0;      ///< so many after each other have no value twice: indices of SCATTER
};

/// By graph input: all of the type, or less where TOSA leaves some of it unpredictable (an index of
/// GATHER outside its values, a shift of 32, a sum outside its type). Found by intervals, so a graph may
/// stand more; floats are in -4..4. `given` is taken as it is.
/// Errors: kBadInput for a name that is no input, or a range that is empty or outside the type.
Result<std::vector<RandomRange>> legal_ranges(const Graph& graph, const GivenRanges& given);

/// Of a type alone, where there is no graph to ask.
RandomRange type_range(DType dtype);

/// The same on every machine for a seed.
Tensor random_tensor(const TensorType& type, const RandomRange& range, std::mt19937_64& generator);

}  // namespace shale
