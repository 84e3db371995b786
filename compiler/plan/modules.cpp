#include "compiler/plan/modules.h"

#include <algorithm>
#include <numeric>

#include "compiler/spirv/check.h"
#include "compiler/spirv/forward.h"
#include "compiler/spirv/reflection.h"
#include "ir/base/parallel.h"

namespace shale {
namespace {

struct Module {
  Spirv words;
  SpirvNeeds needs;
  Interface interface;
};

/// A source as SPIR-V, what it asks of the device and what it declares. May run on any thread.
Result<Module> build_module(const ModuleSource& source, const ModuleOptions& options) {
  Module module;
  SHALE_TRY(module.words, compile_glsl(source.glsl, source.defines, source.where, source.load));
  const bool optimize = source.optimize == OptimizeBy::kSpirvOpt && options.optimize;
  if (source.optimize == OptimizeBy::kForwarding || (optimize && options.forward)) {
    module.words = forward_locals(module.words);
  } else if (optimize) {
    SHALE_TRY(module.words, optimize_spirv(module.words, source.where));
  }
  // A third of the time where thousands of products stand in the code.
  if (source.optimize != OptimizeBy::kForwarding || options.validate_always)
    SHALE_TRY_VOID(validate_spirv(module.words, source.where));
  SHALE_TRY(module.needs, spirv_needs(module.words, source.where));
  SHALE_TRY(module.interface, reflect(module.words, source.where));
  return module;
}

/// Joins what a module asks for.
void add_needs(Requirements& all, const SpirvNeeds& needs) {
  all.features.bits |= needs.features.bits;
  all.workgroup_invocations = std::max(all.workgroup_invocations, needs.workgroup_invocations);
  all.shared_bytes = std::max(all.shared_bytes, needs.shared_bytes);
  all.matrix_products.insert(all.matrix_products.end(), needs.matrix_products.begin(),
                             needs.matrix_products.end());
}

}  // namespace

Result<void> build_modules(Plan& plan, const ModuleOptions& options) {
  const std::vector<ModuleSource>& sources = plan.sources;
  std::vector<size_t> order(sources.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return sources[a].glsl.size() > sources[b].glsl.size();
  });
  std::vector<Result<Module>> modules(sources.size(), Module{});
  const auto proceed = [&](size_t done) {
    return !options.progress || options.progress(done, sources.size());
  };
  if (!parallel_for(
          order.size(),
          [&](size_t i) { modules[order[i]] = build_module(sources[order[i]], options); }, proceed))
    return bad_input("", "interrupted");

  Variant& variant = plan.variant;
  std::vector<uint32_t> indices;
  Requirements from_modules;
  for (const Result<Module>& module : modules) {
    if (!module) return module.error();
    add_needs(from_modules, module->needs);
    const auto same = std::find(variant.modules.begin(), variant.modules.end(), module->words);
    indices.push_back(static_cast<uint32_t>(same - variant.modules.begin()));
    if (same == variant.modules.end()) variant.modules.push_back(module->words);
  }
  for (Segment& segment : variant.segments) {
    if (segment.kind == SegmentKind::kTransfer) continue;
    const auto finish = [&](Dispatch& dispatch) -> Result<void> {
      SHALE_TRY_VOID(
          check_interface(modules[dispatch.module]->interface, dispatch, variant,
                          segment.kind == SegmentKind::kCompute ? param_bytes(variant) : 0));
      dispatch.module = indices[dispatch.module];
      return {};
    };
    for (Dispatch& dispatch : segment.dispatches) SHALE_TRY_VOID(finish(dispatch));
    for (StartForm& start : segment.start_forms) SHALE_TRY_VOID(finish(start.form));
  }
  variant.requirements = binding_requirements(variant);
  variant.requirements.features.bits |= from_modules.features.bits;
  variant.requirements.workgroup_invocations = from_modules.workgroup_invocations;
  variant.requirements.shared_bytes = from_modules.shared_bytes;
  std::vector<MatrixProduct>& products = variant.requirements.matrix_products;
  products = std::move(from_modules.matrix_products);
  std::sort(products.begin(), products.end());
  products.erase(std::unique(products.begin(), products.end()), products.end());
  if (!products.empty()) variant.requirements.subgroup_size = options.subgroup_size;
  return {};
}

}  // namespace shale
