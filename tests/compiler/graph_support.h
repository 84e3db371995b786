// tests/compiler/graph_support.h -- graphs from text, random data for them, and what they compute.
#pragma once

#include <gtest/gtest.h>

#include <random>
#include <string>
#include <vector>

#include "ir/reference/interpreter.h"
#include "ir/text/text.h"
#include "ir/verify/verify.h"

namespace shale {

/// The value, or a failed test and the end of the program: what follows would make no sense.
template <typename T>
T must(Result<T> result, const std::string& context = {}) {
  if (!result) {
    ADD_FAILURE() << result.error().text() << "\n" << context;
    std::abort();
  }
  return *std::move(result);
}

/// The error's text, or "no error".
template <typename T>
std::string error_text(const Result<T>& result) {
  return result ? "no error" : result.error().text();
}

/// A legal graph from its text form.
inline Graph graph_of(const std::string& text) {
  Graph graph = must(parse_text(text), text);
  const auto verified = verify(graph);
  EXPECT_TRUE(verified) << error_text(verified) << "\n" << text;
  return graph;
}

/// The text as the printer has it.
inline std::string normal_text(const std::string& text) {
  return print_text(must(parse_text(text), text));
}

/// A tensor for each graph input over the whole range of its type, INT32 over 20 bits; from a fixed
/// seed.
inline std::vector<Tensor> random_inputs(const Graph& graph, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<Tensor> inputs;
  for (const ValueId id : graph.inputs) {
    const TensorType& type = graph.value(id).type;
    const IntRange range =
        type.dtype == DType::kInt32 ? IntRange{-524288, 524287} : dtype_range(type.dtype);
    Tensor tensor = Tensor::zeros(type);
    for (int64_t i = 0; i < tensor.count(); ++i)
      tensor.set(i, range.min + static_cast<int64_t>(
                                    random() % static_cast<uint64_t>(range.max - range.min + 1)));
    inputs.push_back(std::move(tensor));
  }
  return inputs;
}

/// Both graphs compute the same from three random inputs.
inline void expect_same_results(const Graph& a, const Graph& b) {
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    const std::vector<Tensor> inputs = random_inputs(a, seed);
    const auto expected = interpret(a, inputs);
    const auto found = interpret(b, inputs);
    ASSERT_TRUE(expected) << error_text(expected);
    ASSERT_TRUE(found) << error_text(found);
    EXPECT_TRUE(*found == *expected) << "seed " << seed << "\n"
                                     << print_text(a) << "became\n"
                                     << print_text(b);
  }
}

/// The text with every `from` replaced.
inline std::string replaced(std::string text, const std::string& from, const std::string& to) {
  for (size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size()))
    text.replace(at, from.size(), to);
  return text;
}

}  // namespace shale
