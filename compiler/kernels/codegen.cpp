#include "compiler/kernels/codegen.h"

#include <algorithm>
#include <charconv>
#include <cmath>

namespace shale {
namespace {

std::optional<int64_t> as_number(const std::string& text) {
  int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

const char* memory_type(DType dtype) {
  switch (dtype) {
    case DType::kInt16: return "int16_t";
    case DType::kInt32: return "int";
    case DType::kInt48: return "int64_t";
    case DType::kFp16:
    case DType::kBf16: return "uint16_t";
    case DType::kFp32: return "float";
    default: return "int8_t";
  }
}

/// The position with the same run, whose coordinates may be changed: nobody has its index then.
Position moved(Position at) {
  at.linear.clear();
  return at;
}

std::string clamped(const std::string& coord, int64_t last) {
  return fmt::format("clamp({}, 0, {})", coord, last);
}

/// One of two values. In a run both are made, at places that exist, since a CPU driver runs both sides of a branch
/// anyway, and cannot find equal fetches across it.
std::string either(const Position& at, const std::string& condition, const std::string& yes,
                   const std::string& no) {
  return at.in_run() ? fmt::format("mix({}, {}, {})", no, yes, condition)
                     : fmt::format("(({}) ? {} : {})", condition, yes, no);
}

Position with_coords(Position at, std::vector<std::string> coords) {
  at.coords = std::move(coords);
  at.linear.clear();
  return at;
}

/// The function of functions.glsl for an operator of floats, or null.
const char* function_name(Op op) {
  switch (op) {
    case Op::kCos: return "real_cos";
    case Op::kErf: return "real_erf";
    case Op::kExp: return "real_exp";
    case Op::kLog: return "real_log";
    case Op::kPow: return "real_pow";
    case Op::kReciprocal: return "real_reciprocal";
    case Op::kRsqrt: return "real_rsqrt";
    case Op::kSigmoid: return "real_sigmoid";
    case Op::kSin: return "real_sin";
    case Op::kTanh: return "real_tanh";
    default: return nullptr;
  }
}

/// Keeps the low `bits` of an int, sign extended.
std::string narrow(const std::string& expression, DType dtype) {
  const uint32_t bits = dtype_info(dtype).bits;
  return bits >= 32 ? expression : fmt::format("bitfieldExtract({}, 0, {})", expression, bits);
}

}  // namespace

Codegen::Codegen(const GroupProblem& problem)
    : problem_(problem), graph_(*problem.graph), producers_(graph_.producers()) {
  // INT48 and floats may live in registers and literals alone, so bindings do not tell.
  const auto look_at = [&](ValueId id) {
    int64_ = int64_ || value(id).type.dtype == DType::kInt48;
    real_ = real_ || is_float(value(id).type.dtype);
  };
  for (const NodeId id : problem.group.nodes) {
    const Node& node = graph_.node(id);
    look_at(node.output);
    functions_of_reals_ = functions_of_reals_ || function_name(node.op);
    for (const ValueId input : node.inputs) look_at(input);
  }
}

std::string Codegen::literal(int64_t value, DType dtype) {
  if (is_float(dtype)) return real_literal(bits_real(dtype, value));
  if (dtype == DType::kInt48) return fmt::format("int64_t({}l)", value);
  if (value == INT32_MIN) return "int(0x80000000u)";
  return value < 0 ? fmt::format("({})", value) : std::to_string(value);
}

std::string Codegen::real_literal(float value) {
  // 17 digits name the float as a double, so that reading it rounds nothing.
  if (std::isnormal(value) || (value == 0 && !std::signbit(value))) {
    std::string text = fmt::format("{:.17g}", static_cast<double>(value));
    if (text.find_first_of(".e") == std::string::npos) text += ".0";
    return value < 0 ? "(" + text + ")" : text;
  }
  return fmt::format("uintBitsToFloat(0x{:08x}u)", std::bit_cast<uint32_t>(value));
}

std::string Codegen::narrow_call(const char* prefix, DType dtype, const std::string& x) {
  switch (dtype) {
    case DType::kFp16: return fmt::format("{}half({})", prefix, x);
    case DType::kBf16: return fmt::format("{}bf16({})", prefix, x);
    case DType::kFp8E4M3: return fmt::format("{}e4m3({})", prefix, x);
    case DType::kFp8E5M2: return fmt::format("{}e5m2({})", prefix, x);
    default: return x;
  }
}

std::string Codegen::scaled(const std::string& value, IntRange range, int64_t multiplier,
                            int64_t shift) {
  // With multiplier = high * 2^16 + low and a half that is a multiple of 2^16, what low times value has below 2^16 is cut off
  // in any case.
  constexpr int64_t kSmall = 1 << 15;
  if (range.min >= -kSmall && range.max <= kSmall && shift >= 17 && shift <= 46 && multiplier >= 0)
    return fmt::format("scale_small({}, {}, {}, {})", value, multiplier >> 16, multiplier & 0xffff,
                       shift - 16);
  if (shift > 32) return fmt::format("scale_high({}, {}, {})", value, multiplier, shift - 32);
  return fmt::format("scale_round({}, {}, {}, false)", value, multiplier, shift);
}

std::string Codegen::extremum(const Node& node, const char* which, const std::string& a,
                              const std::string& b) {
  const bool ignore = node.attrs.get(Attr::kNanMode) == kIgnoreNan;
  return fmt::format("{}_{}({}, {})", which, ignore ? "ignore" : "propagate", a, b);
}

std::string Codegen::linear(const Position& at, const Shape& shape) {
  if (!at.linear.empty()) return at.linear;
  std::string text;
  for (size_t i = 0; i < shape.size(); ++i) {
    if (shape[i] == 1) continue;
    text =
        text.empty() ? at.coords[i] : fmt::format("({} * {} + {})", text, shape[i], at.coords[i]);
  }
  return text.empty() ? "0" : text;
}

Position Codegen::split(const std::string& index, const Shape& shape) {
  Position at{std::vector<std::string>(shape.size(), "0"), index};
  int64_t stride = 1;
  for (size_t i = shape.size(); i-- > 0;) {
    if (shape[i] == 1) continue;
    const std::string quotient = stride == 1 ? index : fmt::format("({} / {})", index, stride);
    const bool outermost =
        std::all_of(shape.begin(), shape.begin() + static_cast<std::ptrdiff_t>(i),
                    [](int64_t d) { return d == 1; });
    at.coords[i] = outermost ? quotient : fmt::format("({} % {})", quotient, shape[i]);
    stride *= shape[i];
  }
  return at;
}

size_t Codegen::bind(ValueId id, BindingType type, ImageFormat format, bool writes) {
  const auto [entry, is_new] = binding_of_.try_emplace({id, type, format}, bindings_.size());
  if (is_new) bindings_.push_back({id, type, format, writes});
  return entry->second;
}

size_t Codegen::bind_constant(std::vector<uint8_t> bytes, BindingType type) {
  SHALE_CHECK(!bytes.empty() && bytes.size() % 16 == 0);
  bindings_.push_back({.value = {},
                       .type = type,
                       .view_format = ImageFormat::kRgba32Uint,
                       .constant = std::move(bytes)});
  return bindings_.size() - 1;
}

std::string Codegen::load(ValueId id, const Position& at) { return load_as(id, shape_of(id), at); }

std::string Codegen::load_as(ValueId id, const Shape& shape, const Position& at) {
  if (const auto local = locals_.find(id); local != locals_.end()) return local->second;
  const Value& source = value(id);
  if (source.is_constant()) {
    // A constant at a position that is known now is a literal.
    if (source.constant->count() == 1) return literal(source.constant->get(0), source.type.dtype);
    int64_t index = 0;
    bool known = at.coords.size() == shape.size();
    for (size_t i = 0; known && i < at.coords.size(); ++i) {
      const std::optional<int64_t> coord = as_number(at.coords[i]);
      known = coord.has_value();
      index = index * shape[i] + coord.value_or(0);
    }
    if (known) return literal(source.constant->get(index), source.type.dtype);
  }
  const std::optional<NodeId> producer = producers_[id.index];
  if (producer && problem_.group.contains(*producer) &&
      op_kind(graph_.node(*producer)) == OpKind::kView) {
    // A function would forget the run.
    if (at.in_run()) return view(graph_.node(*producer), at);
    auto function = view_functions_.find(id);
    if (function == view_functions_.end()) {
      const std::string name = fmt::format("view{}", id.index);
      function = view_functions_.emplace(id, name).first;
      Position formal;
      std::string parameters;
      for (size_t i = 0; i < source.type.shape.size(); ++i) {
        formal.coords.push_back(fmt::format("i{}", i));
        parameters += fmt::format("{}int i{}", i > 0 ? ", " : "", i);
      }
      const std::string body = view(graph_.node(*producer), formal);
      functions_ += fmt::format("{} {}({}) {{ return {}; }}\n\n", register_type(source.type.dtype),
                                name, parameters, body);
    }
    const Position& full =
        at.coords.size() == source.type.shape.size() ? at : split(at.linear, source.type.shape);
    return fmt::format("{}({})", function->second, fmt::join(full.coords, ", "));
  }
  if (source.type.dtype != DType::kInt48 &&
      static_cast<uint64_t>(element_count(shape).value_or(0)) < most_texels_)
    return fetch(id, shape, at);
  const size_t binding = bind(id, BindingType::kStorageBuffer, ImageFormat::kNone, false);
  if (is_float(source.type.dtype) && source.type.dtype != DType::kFp32)
    return narrow_call("from_", source.type.dtype,
                       fmt::format("uint(b{}.d[{}])", binding, linear(at, shape)));
  return fmt::format("{}(b{}.d[{}])", register_type(source.type.dtype), binding, linear(at, shape));
}

std::string Codegen::operand(const Node& node, size_t index, const Position& at) {
  const ValueId id = node.inputs[index];
  const Shape& from = value(id).type.shape;
  const Shape& to = value(node.output).type.shape;
  if (from == to || !flat_.empty()) return load(id, at);  // what is not as large has one element
  Position own = moved(at);
  for (size_t i = 0; i < from.size(); ++i)
    if (from[i] == 1) own.coords[i] = "0";
  if (!from.empty() && from.back() == 1) own = {.coords = own.coords};
  return load(id, own);
}

std::string Codegen::store(ValueId id, const Position& at, const std::string& expression) {
  const size_t binding = bind(id, BindingType::kStorageBuffer, ImageFormat::kNone, true);
  const TensorType& type = value(id).type;
  return fmt::format("  b{}.d[{}] = {}({});\n", binding, linear(at, shape_of(id)),
                     memory_type(type.dtype), narrow_call("to_", type.dtype, expression));
}

std::string Codegen::elementwise(const Node& node, const Position& at) {
  const DType out = value(node.output).type.dtype;
  if (node.op != Op::kSelect && (is_float(out) || is_float(value(node.inputs[0]).type.dtype)))
    return real_elementwise(node, at);
  const std::string a = operand(node, 0, at);
  const auto b = [&] { return operand(node, 1, at); };
  const auto binary = [&](const char* symbol) { return fmt::format("({} {} {})", a, symbol, b()); };
  const auto compare = [&](const char* symbol) {
    return fmt::format("int({} {} {})", a, symbol, b());
  };
  const auto constant = [&](size_t index) { return value(node.inputs[index]).constant->get(0); };
  switch (node.op) {
    case Op::kAdd: return binary("+");
    case Op::kSub: return binary("-");
    case Op::kBitwiseAnd:
    case Op::kLogicalAnd: return binary("&");
    case Op::kBitwiseOr:
    case Op::kLogicalOr: return binary("|");
    case Op::kBitwiseXor:
    case Op::kLogicalXor: return binary("^");
    case Op::kBitwiseNot: return fmt::format("(~{})", a);
    case Op::kLogicalNot: return fmt::format("({} ^ 1)", a);
    case Op::kMaximum: return fmt::format("max({}, {})", a, b());
    case Op::kMinimum: return fmt::format("min({}, {})", a, b());
    case Op::kEqual: return compare("==");
    case Op::kGreater: return compare(">");
    case Op::kGreaterEqual: return compare(">=");
    case Op::kAbs: return fmt::format("abs({})", a);
    case Op::kClz: return fmt::format("(31 - findMSB(uint({})))", a);
    case Op::kIntDiv: return fmt::format("divide({}, {})", a, b());
    case Op::kSelect: return fmt::format("({} != 0 ? {} : {})", a, b(), operand(node, 2, at));
    case Op::kLogicalLeftShift: return narrow(binary("<<"), out);
    case Op::kLogicalRightShift: {
      const uint32_t bits = dtype_info(out).bits;
      const std::string pattern = bits == 32 ? fmt::format("uint({})", a)
                                             : fmt::format("(uint({}) & {}u)", a, (1u << bits) - 1);
      return narrow(fmt::format("int({} >> {})", pattern, b()), out);
    }
    case Op::kArithmeticRightShift:
      return node.attrs.flag(Attr::kRound) ? fmt::format("shift_round({}, {})", a, b())
                                           : binary(">>");
    case Op::kMul: {
      const int64_t shift = constant(2);
      if (shift == 0) return binary("*");
      return fmt::format("multiply_round({}, {}, {})", a, b(), shift);
    }
    case Op::kCast:
      if (out == DType::kBool) return fmt::format("int({} != 0)", a);
      return narrow(a, out);
    case Op::kClamp:
      return fmt::format("clamp({}, {}, {})", a, literal(node.attrs.get(Attr::kMinVal)),
                         literal(node.attrs.get(Attr::kMaxVal)));
    case Op::kNegate: {
      const std::string negated =
          fmt::format("({} - ({} - {}))", literal(constant(2)), a, literal(constant(1)));
      if (out == DType::kInt32) return negated;
      const IntRange range = dtype_range(out);
      return fmt::format("clamp({}, {}, {})", negated, range.min, range.max);
    }
    case Op::kTable: {
      const auto entry = [&](const std::string& index) {
        return load(node.inputs[1], {{index}, {}});
      };
      if (value(node.inputs[0]).type.dtype == DType::kInt8) {
        if (texel_tables_ && value(node.inputs[1]).is_constant())
          return fmt::format(
              "texelFetch(t{}, {} + 128).x",
              bind(node.inputs[1], BindingType::kUniformTexelBuffer, ImageFormat::kR8Sint, false),
              a);
        return entry(fmt::format("{} + 128", a));
      }
      const std::string low = entry(fmt::format("({} >> 7) + 256", a));
      const std::string high = entry(fmt::format("({} >> 7) + 257", a));
      return fmt::format("({0} * 128 + ({1} - {0}) * ({2} & 127))", low, high, a);
    }
    case Op::kRescale: {
      const Tensor& multiplier = *value(node.inputs[1]).constant;
      Position channel{.coords = {"0"}};
      if (multiplier.count() > 1) channel = with_coords(at, {at.coords.back()});
      const std::string m = load(node.inputs[1], channel);
      const std::string s = load(node.inputs[2], channel);
      const auto unsigned_value = [](int64_t v, DType dtype) {
        return v & ((int64_t{1} << dtype_info(dtype).bits) - 1);
      };
      const DType in = value(node.inputs[0]).type.dtype;
      const bool in_unsigned = node.attrs.flag(Attr::kInputUnsigned);
      const bool out_unsigned = node.attrs.flag(Attr::kOutputUnsigned);
      const int64_t in_zp = in_unsigned ? unsigned_value(constant(3), in) : constant(3);
      const int64_t out_zp = out_unsigned ? unsigned_value(constant(4), out) : constant(4);
      std::string v = in_unsigned ? fmt::format("({} & {})", a, (1 << dtype_info(in).bits) - 1) : a;
      if (in_zp != 0) v = fmt::format("({} - {})", v, literal(in_zp));
      IntRange centred = in_unsigned ? IntRange{0, (1 << dtype_info(in).bits) - 1}
                                     : value_range(graph_, node.inputs[0]);
      centred = {centred.min - in_zp, centred.max - in_zp};
      const bool double_round = node.attrs.get(Attr::kRoundingMode) == kDoubleRound;
      const std::optional<int64_t> shift = as_number(s);
      std::string r;
      if (in == DType::kInt48)
        r = fmt::format("apply_scale_48({}, {}, {})", v, m, s);
      else if (const std::optional<int64_t> factor = as_number(m); factor && shift && !double_round)
        r = scaled(v, centred, *factor, *shift);
      else if (shift && *shift > 32 && !double_round)
        r = fmt::format("scale_high({}, {}, {})", v, m, *shift - 32);
      else
        r = fmt::format("scale_round({}, {}, {}, {})", v, m, s, double_round);
      if (out_zp != 0) r = fmt::format("({} + {})", r, literal(out_zp));
      if (out == DType::kInt32) return r;
      const IntRange range = dtype_range(out);
      if (!out_unsigned) return fmt::format("clamp({}, {}, {})", r, range.min, range.max);
      return narrow(fmt::format("clamp({}, 0, {})", r, range.max - range.min), out);
    }
    default: break;
  }
  SHALE_CHECK(false && "no elementwise operator");
}

std::string Codegen::real_elementwise(const Node& node, const Position& at) {
  const DType in = value(node.inputs[0]).type.dtype, out = value(node.output).type.dtype;
  const std::string a = operand(node, 0, at);
  const auto b = [&] { return operand(node, 1, at); };
  const auto binary = [&](const char* symbol) {
    return rounded(fmt::format("({} {} {})", a, symbol, b()), out);
  };
  const auto compare = [&](const char* symbol) {
    return fmt::format("int({} {} {})", a, symbol, b());
  };
  switch (node.op) {
    case Op::kAdd: return binary("+");
    case Op::kSub: return binary("-");
    case Op::kMul: return binary("*");
    case Op::kMaximum: return extremum(node, "max", a, b());
    case Op::kMinimum: return extremum(node, "min", a, b());
    case Op::kEqual: return compare("==");
    case Op::kGreater: return compare(">");
    case Op::kGreaterEqual: return compare(">=");
    case Op::kAbs: return fmt::format("abs({})", a);
    case Op::kNegate: return fmt::format("(-{})", a);
    case Op::kCeil: return fmt::format("ceil({})", a);
    case Op::kFloor: return fmt::format("floor({})", a);
    case Op::kClamp:
      return extremum(node, "min",
                      extremum(node, "max", a, literal(node.attrs.get(Attr::kMinVal), in)),
                      literal(node.attrs.get(Attr::kMaxVal), in));
    case Op::kCast: {
      if (is_float(out)) return rounded(is_float(in) ? a : fmt::format("float({})", a), out);
      const IntRange range = dtype_range(out);
      return fmt::format("to_int({}, {}, {})", a, literal(range.min), literal(range.max));
    }
    default: break;
  }
  const char* const function = function_name(node.op);
  SHALE_CHECK(function);
  return rounded(node.op == Op::kPow ? fmt::format("{}({}, {})", function, a, b())
                                     : fmt::format("{}({})", function, a),
                 out);
}

std::string Codegen::view(const Node& node, const Position& at) {
  const ValueId source = node.inputs[0];
  const Shape& from = value(source).type.shape;
  const Shape& to = value(node.output).type.shape;
  const auto ints = [&](size_t index) { return value(node.inputs[index]).constant->ints(); };
  // Keeps the run while it is along the last dimension still.
  Position mapped = moved(at);
  const auto move_last = [&](int64_t by) {
    if (mapped.in_run() && by % mapped.run == 0)
      mapped.base = fmt::format("({} + {})", mapped.base, literal(by));
    else
      mapped = {.coords = mapped.coords};
  };
  switch (node.op) {
    case Op::kIdentity: return load(source, at);
    case Op::kReshape: {
      if (!at.in_run() || from.empty() || from.back() != to.back()) {
        const std::string index = linear(at, to);
        return load(source, split("(" + index + ")", from));
      }
      Position first{.coords = at.coords};
      first.coords.back() = at.base;
      mapped = with_coords(at, split("(" + linear(first, to) + ")", from).coords);
      mapped.coords.back() = at.coords.back();
      return load(source, mapped);
    }
    case Op::kTranspose: {
      const std::span<const int64_t> perms = node.attrs.list(Attr::kPerms);
      for (size_t i = 0; i < perms.size(); ++i)
        mapped.coords[static_cast<size_t>(perms[i])] = at.coords[i];
      if (static_cast<size_t>(perms.back()) + 1 != from.size()) mapped = {.coords = mapped.coords};
      return load(source, mapped);
    }
    case Op::kReverse: {
      const size_t axis = static_cast<size_t>(node.attrs.get(Attr::kAxis));
      mapped.coords[axis] = fmt::format("({} - {})", from[axis] - 1, at.coords[axis]);
      if (axis + 1 == from.size()) mapped = {.coords = mapped.coords};
      return load(source, mapped);
    }
    case Op::kSlice: {
      const std::vector<int64_t> start = ints(1);
      for (size_t i = 0; i < from.size(); ++i)
        if (start[i] != 0) mapped.coords[i] = fmt::format("({} + {})", at.coords[i], start[i]);
      if (!start.empty() && start.back() != 0) move_last(start.back());
      return load(source, mapped);
    }
    case Op::kTile:
      for (size_t i = 0; i < from.size(); ++i)
        if (from[i] != to[i]) mapped.coords[i] = fmt::format("({} % {})", at.coords[i], from[i]);
      if (!from.empty() && from.back() != to.back()) mapped = {.coords = mapped.coords};
      return load(source, mapped);
    case Op::kPad: {
      const std::vector<int64_t> padding = ints(1);
      std::string inside;
      for (size_t i = 0; i < from.size(); ++i) {
        if (padding[2 * i] == 0 && padding[2 * i + 1] == 0) continue;
        const std::string own = fmt::format("({} - {})", at.coords[i], padding[2 * i]);
        inside += fmt::format("{}uint({}) < {}u", inside.empty() ? "" : " && ", own, from[i]);
        if (i + 1 == from.size()) mapped = {.coords = mapped.coords};
        mapped.coords[i] = at.in_run() ? clamped(own, from[i] - 1) : own;
      }
      const std::string element = load(source, mapped);
      if (inside.empty()) return element;
      return either(at, inside, element, load(node.inputs[2], {{"0"}, "0"}));
    }
    case Op::kConcat: return concat(node, at, to[static_cast<size_t>(node.attrs.get(Attr::kAxis))]);
    case Op::kResize: {
      const std::vector<int64_t> scale = ints(1), offset = ints(2);
      for (size_t axis = 0; axis < 2; ++axis)
        mapped.coords[axis + 1] =
            fmt::format("nearest({}, {}, {}, {}, {})", at.coords[axis + 1], scale[2 * axis],
                        scale[2 * axis + 1], literal(offset[axis]), from[axis + 1]);
      return load(source, mapped);
    }
    default: break;
  }
  SHALE_CHECK(false && "no view operator");
}

std::string Codegen::concat(const Node& node, const Position& at, int64_t extent) {
  const size_t axis = static_cast<size_t>(node.attrs.get(Attr::kAxis));
  std::string text;
  for (size_t i = node.inputs.size(); i-- > 0;) {
    const int64_t begin = extent - value(node.inputs[i]).type.shape[axis];
    const int64_t size = extent - begin;
    Position mapped = moved(at);
    const auto own = [&](const std::string& coord) {
      return begin == 0 ? coord : fmt::format("({} - {})", coord, begin);
    };
    if (at.in_run() && axis + 1 == at.coords.size() && begin % at.run == 0 && size % at.run == 0) {
      mapped.base = clamped(own(at.base), size - at.run);
      mapped.coords[axis] = fmt::format("({} + {})", mapped.base, at.lane);
    } else {
      if (axis + 1 == at.coords.size()) mapped = {.coords = mapped.coords};
      mapped.coords[axis] =
          at.in_run() ? clamped(own(at.coords[axis]), size - 1) : own(at.coords[axis]);
    }
    const std::string part = load(node.inputs[i], mapped);
    text = text.empty() ? part
                        : either(at, fmt::format("{} < {}", at.coords[axis], extent), part, text);
    extent = begin;
  }
  return text;
}

void Codegen::epilogue(std::string& body, const Position& at, const std::string& suffix,
                       std::optional<ValueId> known) {
  for (const NodeId id : problem_.group.nodes) {
    const Node& node = graph_.node(id);
    if (op_kind(node) != OpKind::kElementwise || node.output == known) continue;
    const std::string local = fmt::format("e{}{}", node.output.index, suffix);
    body += fmt::format("  {} = {};\n", declare(value(node.output).type.dtype, local),
                        elementwise(node, at));
    locals_[node.output] = local;
  }
}

void Codegen::take_cells(KernelSource& source, const std::function<Stretch(int64_t)>& column,
                         int64_t row_height) {
  const Shape& shape = value(problem_.group.result).type.shape;
  if (problem_.cell_rows == 0 || shape.size() != 4) return;
  const int64_t columns = source.workgroups[0], rows = source.workgroups[1],
                images = source.workgroups[2];
  const auto cells_high = [&](int64_t each) { return (rows + each - 1) / each; };
  int64_t each = std::max<int64_t>(problem_.cell_rows / row_height, 1);
  while (columns * cells_high(each) > kMaxWorkgroups && each < rows) ++each;
  if (columns * cells_high(each) > kMaxWorkgroups || each * images > kMaxWorkgroups) return;
  Cells cells;
  for (int64_t i = 0; i < columns; ++i) cells.columns.push_back(column(i));
  for (int64_t i = 0; i < cells_high(each); ++i)
    cells.rows.push_back({i * each * row_height, std::min((i + 1) * each * row_height, shape[1])});
  source.workgroups = {static_cast<uint32_t>(columns * cells_high(each)),
                       static_cast<uint32_t>(each * images), 1};
  source.cells = std::move(cells);
  cell_columns_ = columns;
  cell_rows_ = each;
  KernelBinding work;
  work.is_work = true;
  bindings_.push_back(std::move(work));
}

std::string Codegen::finish(const std::string& local_size, const std::string& body) const {
  std::string text = "#version 450\n#include \"int8.glsl\"\n#include \"requantize.glsl\"\n";
  text += "#include \"integer.glsl\"\n";
  if (int64_) text += "#include \"int64.glsl\"\n";
  if (real_) text += "#include \"real.glsl\"\n";
  if (functions_of_reals_) text += "#include \"functions.glsl\"\n";
  text += fmt::format("\nlayout({}) in;\n\n", local_size);
  for (size_t i = 0; i < bindings_.size(); ++i) {
    const KernelBinding& binding = bindings_[i];
    const bool words = binding.view_format == ImageFormat::kR32Uint,
               quads = binding.view_format == ImageFormat::kRgba32Uint;
    if (binding.is_work)
      text += fmt::format(
          "layout(set = 0, binding = {}, std430) readonly buffer Work {{ uint d[]; }} work;\n", i);
    else if (binding.type == BindingType::kUniformTexelBuffer)
      text +=
          fmt::format("layout(set = 0, binding = {0}) uniform {1}samplerBuffer t{0};\n", i,
                      words || quads || binding.view_format == ImageFormat::kR16Uint ? 'u' : 'i');
    else
      text += fmt::format(
          "layout(set = 0, binding = {0}, std430) {1} buffer B{0} {{ {2} d[]; }} b{0};\n", i,
          binding.writes ? "writeonly" : "readonly",
          !binding.constant.empty() || quads ? "uvec4"
          : words                            ? "uint"
                                             : memory_type(value(binding.value).type.dtype));
  }
  text += "\n" + functions_ + "void main() {\n";
  if (has_cells())
    text += fmt::format(
        "  uint cell = work.d[SHALE_LIST + gl_WorkGroupID.x];\n"
        "  uvec3 group = uvec3(cell % {0}u, cell / {0}u * {1}u + gl_WorkGroupID.y % {1}u,\n"
        "                      gl_WorkGroupID.y / {1}u);\n"
        "  uvec3 place = group * gl_WorkGroupSize + gl_LocalInvocationID;\n",
        cell_columns_, cell_rows_);
  return text + body + "}\n";
}

}  // namespace shale
