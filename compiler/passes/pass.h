// compiler/passes/pass.h -- what a pass is: one free function over a Graph, a row in passes.def.
#pragma once

#include <functional>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

enum class Change { kNone, kChanged };

struct PassContext {
  /// Shapes that replace those of graph inputs, by name (--input-shape).
  std::map<std::string, Shape> input_shapes;
};

using PassFunction = Result<Change> (*)(Graph& graph, const PassContext& context);

struct PassInfo {
  std::string_view name;  ///< also the name on the command line
  PassFunction run;
  std::string_view help;
};

#define SHALE_PASS(name, function, help) Result<Change> function(Graph&, const PassContext&);
#include "compiler/passes/passes.def"

/// All passes, in the order of passes.def.
std::span<const PassInfo> all_passes();
const PassInfo* find_pass(std::string_view name);

struct PassTiming {
  std::string_view pass;
  double time_us = 0;
  Change change = Change::kNone;
};

struct PassOptions {
  bool optimize = true;      ///< false: only what is needed to compile at all
  bool verify_each = false;  ///< verify after every pass; a failure is our bug and names the pass
  /// Called after each pass with its name; for --dump-after.
  std::function<void(std::string_view pass, const Graph&)> after;
};

/// Runs the pipeline of pipeline.cpp.
/// Errors: those of the passes and of the verifier.
Result<std::vector<PassTiming>> run_pipeline(Graph& graph, const PassContext& context,
                                             const PassOptions& options);

/// Runs these passes in order, with the options' checks and callbacks.
Result<std::vector<PassTiming>> run_passes(Graph& graph, const PassContext& context,
                                           const PassOptions& options,
                                           std::span<const std::string_view> names);

/// Runs one pass and, if it reports a change, drops unused values.
Result<Change> run_pass(const PassInfo& pass, Graph& graph, const PassContext& context);

}  // namespace shale
