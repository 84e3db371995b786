// compiler/frontend/vgf/convert.h -- graphs out of VGF files; graphs and packages into them.
#pragma once

#include "compiler/frontend/frontend.h"
#include "compiler/frontend/vgf/vgf.h"
#include "ir/package/package.h"

namespace shale {

/// The graph of one GRAPH segment: the only one, or the one whose name (or else whose module's
/// entry point) is `options.entry_point`. Types of the interface come from the resource table, where
/// a negative dimension is open, and names from the model's interface. A graph constant is the
/// constant with that number, if the segment lists it; else the one at that position of its list.
/// Errors: those of read_vgf and read_spirv_graph; kBadInput without such a segment, for a module
/// that is no SPIR-V, and for a sparsity mark that does not hold.
Result<Graph> import_vgf(std::span<const uint8_t> bytes, const ImportOptions& options);

/// One graph segment with one SPIR-V module. Inputs, then outputs, then constants are the resources;
/// binding i of set 0 is resource i; graph constant i is constant i.
/// Errors: those of write_spirv_graph.
Result<Vgf> graph_to_vgf(const Graph& graph);

struct PackageToVgfOptions {
  uint32_t variant = 0;
  /// Constants have no place in the descriptor sets of a VGF file. With this, weights are inputs of
  /// the model that the application fills from the file's constants, which lie in the order of those
  /// inputs.
  bool weights_as_inputs = false;
};

/// A compute segment for each dispatch of a variant, under its name. Intermediate tensors are
/// resources of their own, since the format knows no offsets; a tensor that is bound as buffer and
/// as texel buffer, or an image that is sampled and stored, is two resources of one alias group. What
/// has a size that is no multiple of 4 becomes a list of elements up to the next (bound_bytes).
/// Passes get their block of push constants as a range; the values are the application's.
/// `package` must pass check_package.
/// Errors: kBadInput for a variant that does not exist; kUnsupported for weights (without the
/// option), for images of earlier frames and for parameters that follow them.
Result<Vgf> package_to_vgf(const Package& package, const PackageToVgfOptions& options);

}  // namespace shale
