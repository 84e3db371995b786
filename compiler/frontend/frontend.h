// compiler/frontend/frontend.h -- model files of every kind to Graph, told apart by their content.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

/// What some formats leave to the user.
struct ImportOptions {
  /// Graph entry point of a SPIR-V module, or graph segment of a VGF file; empty: the only one.
  std::string entry_point;
  /// By input name, for inputs of SPIR-V whose rank is open. Sizes that a shape leaves open are the
  /// infer-shapes pass's part, in every format.
  std::map<std::string, Shape> input_shapes;
  /// Bytes of the external graph constants of a SPIR-V module, by GraphConstantID.
  std::map<uint32_t, std::vector<uint8_t>> constants;
};

/// Name of the format ("tosa", "tir", "vgf", "spirv"), or empty if no frontend recognizes the bytes.
std::string_view model_format(std::span<const uint8_t> bytes);

/// Errors: kBadInput if nobody recognizes the bytes or the format has no place for an option, else
/// the frontend's own.
Result<Graph> import_model(std::span<const uint8_t> bytes, const ImportOptions& options = {});

}  // namespace shale
