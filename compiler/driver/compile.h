// compiler/driver/compile.h -- the library's one front door: a model file to a package.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "compiler/frontend/frontend.h"
#include "compiler/kernels/select.h"
#include "compiler/passes/pass.h"
#include "compiler/plan/frame.h"
#include "ir/package/package.h"

namespace shale {

struct CompileOptions {
  std::vector<std::string> targets{"lavapipe"};  ///< a variant each
  /// Profiles of targets that are no known_profiles(), such as what profile_from_caps made.
  std::map<std::string, DeviceProfile> profiles;
  ImportOptions import;  ///< input_shapes are those of `passes`
  PassContext passes;
  PassOptions pass_options;
  std::vector<std::string>
      kernels;  ///< families to choose from; empty is all. "generic" always may serve
  /// Family by the name of a group's result: what was measured to be fastest. Others are selected.
  std::map<std::string, std::string> choices;
  /// Constants of the cost model by target, in place of the profile's own: those of the device at
  /// hand, from `shale fit`.
  std::map<std::string, MeasuredConstants> constants;
  std::string
      prefer;  ///< family of every group that it supports and `choices` leaves; empty is none
  /// Runs over which the driver's compile time is spread; nothing is kRunsOfFrame with a frame, else
  /// kRunsOfNetwork.
  std::optional<double> expected_runs;
  /// SelectOptions::start_us; infinity leaves start forms out.
  double start_us = kStartUs;
  /// Networks work by tiles (Tiles in package.h), with this tolerance in codes, up to kMaxTileTolerance; above 0 the tiles
  /// of a frame that has `settles` stay as they are where nothing happens (compiler/plan/settled.h), and what its networks
  /// then see they see exactly. Nothing is the whole picture in every run.
  std::optional<uint32_t> tiles;
  bool require_proof = false;  ///< an unproven accumulator is an error, not a warning
  bool optimize_spirv = true;  ///< false: what asks for kSpirvOpt stays as glslang made it
  std::optional<Frame> frame;  ///< with it the package holds pre and post passes too
  ShaderLoader load_shader;    ///< needed with `frame`
  /// Bytes of a model file by its path in frame.json; needed for every graph but the first.
  std::function<Result<std::vector<uint8_t>>(const std::string& path)> load_model;
  FrameSizes sizes;  ///< for `frame`
  /// What the scenes need that the package is for: passes have the forms of the promises that these keep.
  std::optional<SceneNeeds> needs;
  std::string model_name = "model";
  /// Called with work done and work in all; returns false to stop (kBadInput "interrupted").
  std::function<bool(size_t done, size_t total)> progress;
};

struct Compiled {
  Package package;
  Graph graph;  ///< of the first network, after the passes, groups set; empty without one
  std::vector<Graph> further_graphs;
  std::vector<std::string> warnings;
  std::vector<PassTiming> timings;
  uint64_t arena_lower_bound_bytes = 0;
  /// By variant: what each dispatch of the network does.
  std::vector<std::vector<WorkTable>> work;
  std::vector<Selection>
      selections;         ///< by variant: the kernels, and what they are expected to take
  double kernels_ms = 0;  ///< time in code generation and SPIR-V
};

/// The model with the input shapes that the options and the frame give it, verified; before the
/// passes.
/// Errors: those of the frontend, of shapes that stay open, of the verifier.
Result<Graph> shaped_graph(std::span<const uint8_t> model, const CompileOptions& options);

/// A shaped graph as compile() cuts it into dispatches: after the passes, groups set. No code is made.
Result<Graph> fused_graph(Graph graph, const CompileOptions& options);

/// The same input and options give the same bytes. `model` is the first graph of a frame; with a frame
/// that has none it may be empty and is not looked at.
/// Errors: those of every step.
Result<Compiled> compile(std::span<const uint8_t> model, const CompileOptions& options);

/// As above, from a graph; `model_hash` goes into the provenance.
Result<Compiled> compile_graph(Graph graph, uint64_t model_hash, const CompileOptions& options);

/// What compile() would put into the package, as text, a plan for each target; no code is made.
/// Errors: as compile(), but for those of kernels' code.
Result<std::vector<std::string>> plan_texts(std::span<const uint8_t> model,
                                            const CompileOptions& options);

}  // namespace shale
