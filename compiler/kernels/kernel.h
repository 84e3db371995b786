// compiler/kernels/kernel.h -- what a kernel family is: a row in kernels.def that can take a group.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/passes/op_kind.h"
#include "compiler/target/profile.h"
#include "ir/package/package.h"

namespace shale {

/// Where a binding's data comes from.
struct KernelBinding {
  ValueId value;
  BindingType type = BindingType::kStorageBuffer;
  ImageFormat view_format = ImageFormat::kNone;  ///< for texel buffers
  bool writes = false;
  /// Data of the kernel's own instead of a value: a storage buffer of uvec4, whole ones.
  std::vector<uint8_t> constant = {};
};

/// One dispatch as a family emits it; binding i is descriptor i of set 0.
struct KernelSource {
  std::string glsl;
  std::array<uint32_t, 3> workgroups{1, 1, 1};
  std::vector<KernelBinding> bindings;
  bool optimize =
      true;  ///< false where spirv-opt costs much and gains nothing: literal-heavy modules
};

/// A group to be compiled, with what selection needs to know about it.
struct GroupProblem {
  const Graph* graph = nullptr;
  Group group;
  std::optional<RangeProof> proof;  ///< for convolutions with constant weights and bias
  Cost cost;                        ///< without time
};

struct KernelFamily {
  std::string_view name;
  bool (*supports)(const GroupProblem& problem, const DeviceProfile& profile);
  /// Estimated time in microseconds on the profile.
  double (*time_us)(const GroupProblem& problem, const DeviceProfile& profile);
  /// Errors: kUnsupported where the group is outside the family after all.
  Result<std::vector<KernelSource>> (*emit)(const GroupProblem& problem,
                                            const DeviceProfile& profile);
};

#define SHALE_KERNEL(name, supports, time_us, emit)          \
  bool supports(const GroupProblem&, const DeviceProfile&);  \
  double time_us(const GroupProblem&, const DeviceProfile&); \
  Result<std::vector<KernelSource>> emit(const GroupProblem&, const DeviceProfile&);
#include "compiler/kernels/kernels.def"

std::span<const KernelFamily> all_kernels();

/// The family of least estimated time among those that support the group; table order breaks ties.
/// `allowed` (names; empty is all) restricts the choice; the generic kernel always takes part.
const KernelFamily& select_kernel(const GroupProblem& problem, const DeviceProfile& profile,
                                  std::span<const std::string> allowed = {});

/// Static bounds of the group's convolution head (conv2d, depthwise_conv2d, transpose_conv2d with
/// constant weights and bias), or nothing.
/// Source: ours, shown in tests/compiler/range_proof_test.
std::optional<RangeProof> prove_ranges(const Graph& graph, const Group& group);

/// Smallest and largest value that `id` can hold, from its type and from CLAMP, TABLE, RESCALE
/// limits and constants before it.
IntRange value_range(const Graph& graph, ValueId id);

}  // namespace shale
