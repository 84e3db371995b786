// compiler/plan/modules.h -- the sources of a plan as SPIR-V modules of its variant.
#pragma once

#include <functional>

#include "compiler/plan/plan.h"

namespace shale {

struct ModuleOptions {
  bool optimize = true;          ///< by spirv-opt, where a source asks for it
  bool forward = false;          ///< by forward_locals in place of spirv-opt
  bool validate_always = false;  ///< modules with thousands of products, too
  uint32_t subgroup_size =
      0;  ///< of the target: kernels with matrices have one subgroup to a workgroup
  /// Called with work done and work in all; returns false to stop (kBadInput "interrupted").
  std::function<bool(size_t done, size_t total)> progress;
};

/// Compiles all sources on all cores, the long ones first; equal modules lie in the variant once, in the order of the
/// sources, so that the same plan gives the same bytes. What each declares is checked against what the dispatches bind.
/// Fills modules, module indices and the requirements that follow from words and bindings.
/// Errors: those of the shaders; kBadInput naming pass and binding where a shader's interface is not the plan's.
Result<void> build_modules(Plan& plan, const ModuleOptions& options);

}  // namespace shale
