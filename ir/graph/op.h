// ir/graph/op.h -- operators and attributes as tables, so that reader, writer, printer and parser
// loop.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

namespace shale {

enum class Op : uint8_t {
#define SHALE_OP(enumerator, name, wire, min_operands, max_operands, attrs) enumerator,
#include "ir/graph/ops.def"
};

enum class Attr : uint8_t {
  kAxis,
  kNanMode,
  kKernel,
  kStride,
  kPad,
  kDilation,
  kLocalBound,
  kAccType,
  kOutPad,
  kMinVal,
  kMaxVal,
  kRound,
  kPerms,
  kMode,
  kScale32,
  kRoundingMode,
  kPerChannel,
  kInputUnsigned,
  kOutputUnsigned,
  kInverse,
  kPart,
};

/// How an attribute is stored on the wire and printed.
enum class AttrKind : uint8_t {
  kInt,           ///< int32
  kBool,          ///< ubyte, 0 or 1
  kIntList,       ///< [int32]
  kElement,       ///< [ubyte]: one element of the operand's type; the bits of a float
  kDType,         ///< uint32, a DType
  kResizeMode,    ///< uint32: 1 nearest, 2 bilinear
  kNanMode,       ///< uint32: 1 propagate, 2 ignore
  kRoundingMode,  ///< uint32: 1 single, 2 inexact, 3 double
  kPart,          ///< in no file: which result of an operator of two, 0 real, 1 imaginary
};

struct AttrInfo {
  Attr attr;
  std::string_view name;
  AttrKind kind;
};

struct OpInfo {
  Op op;
  std::string_view name;
  uint32_t wire;  ///< number in TosaOperator.op and in the Attribute union
  uint32_t min_operands;
  uint32_t max_operands;
  std::vector<Attr> attrs;  ///< in wire order: position is the field id of the attribute table
};

/// Results of the operator in a file, a node each here.
size_t result_count(Op op);
const OpInfo& op_info(Op op);
const AttrInfo& attr_info(Attr attr);
std::span<const OpInfo> all_ops();
std::span<const AttrInfo> all_attrs();
std::optional<Op> op_from_name(std::string_view name);
std::optional<Op> op_from_wire(uint32_t number);
std::optional<Attr> attr_from_name(std::string_view name);

/// Names of an enumerated attribute kind, by wire value; empty for the other kinds.
std::span<const std::string_view> attr_value_names(AttrKind kind);

inline constexpr int64_t kNearest = 1, kBilinear = 2;
inline constexpr int64_t kPropagateNan = 1, kIgnoreNan = 2;
inline constexpr int64_t kSingleRound = 1, kInexactRound = 2, kDoubleRound = 3;

/// Attribute values of a node. A scalar is a list of one; an absent attribute reads as 0 or empty.
class Attrs {
 public:
  int64_t get(Attr attr) const {
    const auto found = values_.find(attr);
    return found == values_.end() || found->second.empty() ? 0 : found->second[0];
  }
  bool flag(Attr attr) const { return get(attr) != 0; }
  std::span<const int64_t> list(Attr attr) const {
    const auto found = values_.find(attr);
    return found == values_.end() ? std::span<const int64_t>{} : found->second;
  }
  bool has(Attr attr) const { return values_.contains(attr); }
  Attrs& set(Attr attr, int64_t value) { return set(attr, std::vector<int64_t>{value}); }
  Attrs& set(Attr attr, std::vector<int64_t> values) {
    values_[attr] = std::move(values);
    return *this;
  }
  bool operator==(const Attrs&) const = default;
  bool operator<(const Attrs& other) const { return values_ < other.values_; }

 private:
  std::map<Attr, std::vector<int64_t>> values_;
};

}  // namespace shale
