#include "ir/graph/op.h"

#include <array>

#include "ir/base/result.h"

namespace shale {
namespace {

const std::vector<OpInfo>& op_table() {
  static const std::vector<OpInfo> table{
#define SHALE_OP(enumerator, name, wire, min_operands, max_operands, attrs) \
  {Op::enumerator, name, wire, min_operands, max_operands, std::vector<Attr> attrs},
#include "ir/graph/ops.def"
  };
  return table;
}

constexpr std::array<AttrInfo, 21> kAttrs{{
    {Attr::kAxis, "axis", AttrKind::kInt},
    {Attr::kNanMode, "nan_mode", AttrKind::kNanMode},
    {Attr::kKernel, "kernel", AttrKind::kIntList},
    {Attr::kStride, "stride", AttrKind::kIntList},
    {Attr::kPad, "pad", AttrKind::kIntList},
    {Attr::kDilation, "dilation", AttrKind::kIntList},
    {Attr::kLocalBound, "local_bound", AttrKind::kBool},
    {Attr::kAccType, "acc_type", AttrKind::kDType},
    {Attr::kOutPad, "out_pad", AttrKind::kIntList},
    {Attr::kMinVal, "min_val", AttrKind::kElement},
    {Attr::kMaxVal, "max_val", AttrKind::kElement},
    {Attr::kRound, "round", AttrKind::kBool},
    {Attr::kPerms, "perms", AttrKind::kIntList},
    {Attr::kMode, "mode", AttrKind::kResizeMode},
    {Attr::kScale32, "scale32", AttrKind::kBool},
    {Attr::kRoundingMode, "rounding_mode", AttrKind::kRoundingMode},
    {Attr::kPerChannel, "per_channel", AttrKind::kBool},
    {Attr::kInputUnsigned, "input_unsigned", AttrKind::kBool},
    {Attr::kOutputUnsigned, "output_unsigned", AttrKind::kBool},
    {Attr::kInverse, "inverse", AttrKind::kBool},
    {Attr::kPart, "part", AttrKind::kPart},
}};

constexpr std::array<std::string_view, 3> kResizeModes{"unknown", "nearest", "bilinear"};
constexpr std::array<std::string_view, 3> kNanModes{"unknown", "propagate", "ignore"};
constexpr std::array<std::string_view, 2> kParts{"real", "imag"};
constexpr std::array<std::string_view, 4> kRoundingModes{"unknown", "single", "inexact", "double"};

}  // namespace

size_t result_count(Op op) {
  const std::vector<Attr>& attrs = op_info(op).attrs;
  return !attrs.empty() && attrs.back() == Attr::kPart ? kParts.size() : 1;
}

const OpInfo& op_info(Op op) { return op_table()[static_cast<size_t>(op)]; }
const AttrInfo& attr_info(Attr attr) { return kAttrs[static_cast<size_t>(attr)]; }
std::span<const OpInfo> all_ops() { return op_table(); }
std::span<const AttrInfo> all_attrs() { return kAttrs; }

std::optional<Op> op_from_name(std::string_view name) {
  for (const OpInfo& info : op_table())
    if (info.name == name) return info.op;
  return std::nullopt;
}

std::optional<Op> op_from_wire(uint32_t number) {
  for (const OpInfo& info : op_table())
    if (info.wire == number) return info.op;
  return std::nullopt;
}

std::optional<Attr> attr_from_name(std::string_view name) {
  for (const AttrInfo& info : kAttrs)
    if (info.name == name) return info.attr;
  return std::nullopt;
}

std::span<const std::string_view> attr_value_names(AttrKind kind) {
  switch (kind) {
    case AttrKind::kResizeMode: return kResizeModes;
    case AttrKind::kNanMode: return kNanModes;
    case AttrKind::kRoundingMode: return kRoundingModes;
    case AttrKind::kPart: return kParts;
    default: return {};
  }
}

}  // namespace shale
