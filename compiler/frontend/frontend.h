// compiler/frontend/frontend.h -- model files of every kind to Graph, told apart by their content.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

#include "ir/graph/graph.h"

namespace shale {

/// Name of the format ("tosa", "tir"), or empty if no frontend recognizes the bytes.
std::string_view model_format(std::span<const uint8_t> bytes);

/// Errors: kBadInput if nobody recognizes the bytes, else the frontend's own.
Result<Graph> import_model(std::span<const uint8_t> bytes);

}  // namespace shale
