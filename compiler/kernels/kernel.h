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
  /// How a texel buffer is viewed; for a storage buffer of int8 the width of an element: kR32Uint
  /// (uint) or kRgba32Uint (uvec4) instead of single bytes.
  ImageFormat view_format = ImageFormat::kNone;
  bool writes = false;
  /// Data of the kernel's own instead of a value: a storage buffer of uvec4, whole ones.
  std::vector<uint8_t> constant = {};
  bool is_work = false;  ///< Tiles::work instead of a value
};

/// Positions [begin, end) along an axis of a picture.
struct Stretch {
  int64_t begin = 0, end = 0;
  bool operator==(const Stretch&) const = default;
};

/// What the workgroups of a kernel make that finds the cell to make in a list, number column + row * columns: the
/// grid is {number of cells, workgroups of a cell, 1}.
struct Cells {
  std::vector<Stretch> columns, rows;  ///< of the result that a column or row of cells may write
};

/// What is done to a kernel's SPIR-V.
enum class OptimizeBy {
  kSpirvOpt,    ///< for GPUs; forward_locals for CPUs, whose drivers optimize for themselves
  kForwarding,  ///< forward_locals alone: spirv-opt would take long over thousands of products
  kNothing,     ///< instructions that spirv-opt does not know
};

/// One dispatch as a family emits it; binding i is descriptor i of set 0.
struct KernelSource {
  std::string glsl;
  std::array<uint32_t, 3> workgroups{1, 1, 1};
  std::vector<KernelBinding> bindings;
  OptimizeBy optimize = OptimizeBy::kSpirvOpt;
  /// Nothing: every run makes the whole result. Else the code takes the macro SHALE_LIST, words from the
  /// start of Tiles::work to its list.
  std::optional<Cells> cells = std::nullopt;
};

/// A group to be compiled, with what selection needs to know about it.
struct GroupProblem {
  const Graph* graph = nullptr;
  Group group;
  std::optional<RangeProof> proof;  ///< for convolutions with constant weights and bias
  Cost cost;                        ///< without time
  /// If not 0, families may make the cells of a list, of about as many rows of the result.
  int64_t cell_rows = 0;
};

struct KernelFamily {
  std::string_view name;
  bool (*supports)(const GroupProblem& problem, const DeviceProfile& profile);
  /// What the kernel does, dispatches included; its time follows by work_time_us.
  WorkTable (*work)(const GroupProblem& problem, const DeviceProfile& profile);
  /// Products whose weights stand in the code, which the driver has to compile; null if none do.
  int64_t (*literals)(const GroupProblem& problem, const DeviceProfile& profile);
  /// Errors: kUnsupported where the group is outside the family after all.
  Result<std::vector<KernelSource>> (*emit)(const GroupProblem& problem,
                                            const DeviceProfile& profile);
};

inline constexpr int64_t (*no_literals)(const GroupProblem&, const DeviceProfile&) = nullptr;

#define SHALE_KERNEL(prefix, name, literals)                          \
  bool prefix##_supports(const GroupProblem&, const DeviceProfile&);  \
  WorkTable prefix##_work(const GroupProblem&, const DeviceProfile&); \
  Result<std::vector<KernelSource>> prefix##_emit(const GroupProblem&, const DeviceProfile&);
#include "compiler/kernels/kernels.def"
int64_t conv2d_direct_literals(const GroupProblem& problem, const DeviceProfile& profile);
int64_t conv2d_phase_literals(const GroupProblem& problem, const DeviceProfile& profile);
int64_t conv2d_winograd_literals(const GroupProblem& problem, const DeviceProfile& profile);
int64_t conv2d_winograd32_literals(const GroupProblem& problem, const DeviceProfile& profile);

std::span<const KernelFamily> all_kernels();
/// Null if there is no family of that name.
const KernelFamily* find_kernel(std::string_view name);

/// Static bounds of the group's convolution head (conv2d, depthwise_conv2d, transpose_conv2d with
/// constant weights and bias), or nothing.
/// Source: ours, shown in tests/compiler/range_proof_test.
std::optional<RangeProof> prove_ranges(const Graph& graph, const Group& group);

/// Smallest and largest value that `id` can hold, from its type and from CLAMP, TABLE, RESCALE
/// limits and constants before it.
IntRange value_range(const Graph& graph, ValueId id);

}  // namespace shale
