// ir/binary/tosa.h -- TOSA 1.0 FlatBuffers model files to and from Graph.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

/// True if the bytes carry the file identifier "TOSA".
bool is_tosa(std::span<const uint8_t> bytes);

/// Reads an untrusted file: versions 1.0 and 1.1, one region with one block, the operators
/// of ops.def. Constants are decoded, unused tensors dropped. The result is well formed (ids
/// in range, names unique, producers first) but not checked by the operators' rules: that is
/// verify's part.
/// Errors: kBadInput for a broken file, kUnsupported for what TOSA has and Shale has
/// not; `where` is the operator's or tensor's position and name.
/// Source: TOSA 1.0, serialization
/// schema.
Result<Graph> read_tosa(std::span<const uint8_t> bytes);

/// Version 1.0.0, constants first, each at its exact size. read_tosa(write_tosa(g)) == g but for
/// groups, which the format does not have.
std::vector<uint8_t> write_tosa(const Graph& graph);

}  // namespace shale
