// Runs of elements: fetched as texels, stored as words.
#include "compiler/kernels/codegen.h"

namespace shale {

std::vector<Position> Position::run_at(std::vector<std::string> coords, const std::string& first,
                                       int64_t length) {
  std::vector<Position> elements;
  for (int64_t lane = 0; lane < length; ++lane) {
    coords.back() = lane == 0 ? first : fmt::format("({} + {})", first, lane);
    elements.push_back(
        {.coords = coords, .base = length > 1 ? first : "", .lane = lane, .run = length});
  }
  return elements;
}

void Codegen::flatten_if_elementwise() {
  const Shape& result = value(problem_.group.result).type.shape;
  for (const NodeId id : problem_.group.nodes) {
    const Node& node = graph_.node(id);
    if (op_kind(node) != OpKind::kElementwise) return;
    for (const ValueId input : node.inputs) {
      const Value& v = value(input);
      const bool is_table = node.op == Op::kTable && input == node.inputs[1];
      if (v.type.shape != result && !is_table && !(v.is_constant() && v.constant->count() == 1))
        return;
    }
  }
  flat_ = {element_count(result).value_or(0)};
}

const Shape& Codegen::shape_of(ValueId id) const {
  const Shape& own = value(id).type.shape;
  return !flat_.empty() && own == value(problem_.group.result).type.shape ? flat_ : own;
}

std::string Codegen::fetch(ValueId id, const Shape& shape, const Position& at) {
  const DType dtype = value(id).type.dtype;
  const int64_t bytes = dtype_info(dtype).host_bytes;
  int64_t lanes = 1;  // of a texel
  if (at.in_run())
    for (const int64_t width : {16 / bytes, 4 / bytes})
      if (lanes == 1 && at.run % width == 0 && shape.back() % width == 0) lanes = width;
  const int64_t texel_bytes = lanes * bytes;
  const ImageFormat format = texel_bytes == 16  ? ImageFormat::kRgba32Uint
                             : texel_bytes == 4 ? ImageFormat::kR32Uint
                             : texel_bytes == 2 ? ImageFormat::kR16Uint
                                                : ImageFormat::kR8Sint;
  std::string index;
  if (lanes > 1) {
    Shape texels = shape;
    texels.back() /= lanes;
    Position texel{.coords = at.coords};
    texel.coords.back() = fmt::format("(({} + {}) / {})", at.base, at.lane / lanes * lanes, lanes);
    index = linear(texel, texels);
  } else {
    index = linear(at, shape);
  }
  const int64_t byte = at.lane % lanes * bytes;  // from the start of the texel
  const std::string word = fmt::format("texelFetch(t{}, {}).{}",
                                       bind(id, BindingType::kUniformTexelBuffer, format, false),
                                       index, "xyzw"[static_cast<size_t>(byte / 4)]);
  switch (dtype) {
    case DType::kFp32: return fmt::format("uintBitsToFloat({})", word);
    case DType::kFp16:
      // Exact on CPU drivers, which alone take this way; they convert all lanes in one instruction.
      return fmt::format("unpackHalf2x16({}).{}", word, byte % 4 == 0 ? 'x' : 'y');
    case DType::kBf16:
      return fmt::format("uintBitsToFloat({} {})", word, byte % 4 == 0 ? "<< 16" : "& 0xffff0000u");
    case DType::kFp8E4M3:
    case DType::kFp8E5M2:
      return narrow_call("from_", dtype,
                         lanes == 1 ? fmt::format("uint({})", word)
                                    : fmt::format("({} >> {})", word, byte % 4 * 8));
    case DType::kInt32: return fmt::format("int({})", word);
    case DType::kInt16: return fmt::format("bitfieldExtract(int({}), {}, 16)", word, byte % 4 * 8);
    default:
      return lanes == 1 ? word : fmt::format("bitfieldExtract(int({}), {}, 8)", word, byte % 4 * 8);
  }
}

int64_t Codegen::run_length(int64_t most) const {
  const Shape& shape = shape_of(problem_.group.result);
  const int64_t bytes = dtype_info(value(problem_.group.result).type.dtype).host_bytes;
  for (int64_t length = most; length > 1 && bytes <= 4 && !shape.empty(); length /= 2)
    if (shape.back() % length == 0 && length * bytes % 4 == 0) return length;
  return 1;
}

std::string Codegen::store_run(const Position& first, const std::vector<std::string>& expressions) {
  const ValueId id = problem_.group.result;
  const DType dtype = value(id).type.dtype;
  if (expressions.size() == 1) return store(id, first, expressions[0]);
  const size_t in_word = 4 / dtype_info(dtype).host_bytes;
  const bool wide = expressions.size() % (4 * in_word) == 0;
  const size_t together = wide ? 4 * in_word : in_word;
  const size_t binding = bind(id, BindingType::kStorageBuffer,
                              wide ? ImageFormat::kRgba32Uint : ImageFormat::kR32Uint, true);
  Shape texels = shape_of(id);
  texels.back() /= static_cast<int64_t>(together);
  std::string text;
  for (size_t at = 0; at < expressions.size(); at += together) {
    std::vector<std::string> words;
    for (size_t i = at; i < at + together; i += in_word)
      words.push_back(packed_word(dtype, {expressions.data() + i, in_word}));
    Position texel{.coords = first.coords};
    texel.coords.back() = fmt::format("(({} + {}) / {})", first.base, at, together);
    text += fmt::format("  b{}.d[{}] = {}({});\n", binding, linear(texel, texels),
                        wide ? "uvec4" : "uint", fmt::join(words, ", "));
  }
  return text;
}

std::string Codegen::packed_word(DType dtype, std::span<const std::string> v) {
  const auto packed = [](const std::string& word) { return fmt::format("max({}, none)", word); };
  switch (dtype) {
    case DType::kFp32: return fmt::format("floatBitsToUint({})", v[0]);
    case DType::kInt32: return packed(fmt::format("uint({})", v[0]));
    case DType::kFp16:
    case DType::kBf16:
      return packed(fmt::format("{} | ({} << 16)", narrow_call("to_", dtype, v[0]),
                                narrow_call("to_", dtype, v[1])));
    case DType::kFp8E4M3:
    case DType::kFp8E5M2:
      return packed(fmt::format("{} | ({} << 8) | ({} << 16) | ({} << 24)",
                                narrow_call("to_", dtype, v[0]), narrow_call("to_", dtype, v[1]),
                                narrow_call("to_", dtype, v[2]), narrow_call("to_", dtype, v[3])));
    case DType::kInt16: return packed(fmt::format("uint(({} & 65535) | ({} << 16))", v[0], v[1]));
    default:
      return packed(
          fmt::format("uint(({} & 255) | (({} & 255) << 8) | (({} & 255) << 16) | ({} << 24))",
                      v[0], v[1], v[2], v[3]));
  }
}

}  // namespace shale
