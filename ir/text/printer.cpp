#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>

#include "ir/text/text.h"

namespace shale {
namespace {

bool is_plain(const std::string& name) {
  return !name.empty() && std::all_of(name.begin(), name.end(), [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '_' || c == '.' || c == '$' || c == '/' || c == '-';
  });
}

std::string quoted(const std::string& name) {
  std::string text = "\"";
  for (const char c : name) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '"' || c == '\\')
      text += {'\\', c};
    else if (byte < 32 || byte == 127)
      text += fmt::format("\\x{:02x}", byte);
    else
      text += c;
  }
  return text + "\"";
}

std::string reference(const Graph& graph, ValueId id) {
  const std::string& name = graph.value(id).name;
  return "%" + (is_plain(name) ? name : quoted(name));
}

std::string references(const Graph& graph, const std::vector<ValueId>& ids) {
  std::string text;
  for (const ValueId id : ids) text += (text.empty() ? "" : ", ") + reference(graph, id);
  return text;
}

/// The shortest decimal that reads back as the same float; a NaN as its bits.
std::string element(DType dtype, int64_t value) {
  if (!is_float(dtype)) return std::to_string(value);
  const float real = bits_real(dtype, value);
  if (std::isnan(real))
    return fmt::format("0x{:0{}x}",
                       static_cast<uint64_t>(value) & ((uint64_t{1} << dtype_info(dtype).bits) - 1),
                       2 * dtype_info(dtype).host_bytes);
  char text[32];
  return {text, std::to_chars(text, text + sizeof(text), real).ptr};
}

/// `operand` is the element type of the node's first operand.
std::string attribute(const AttrInfo& info, std::span<const int64_t> values, DType operand) {
  const std::span<const std::string_view> names = attr_value_names(info.kind);
  const int64_t value = values.empty() ? 0 : values[0];
  const bool in_range = value >= 0 && static_cast<size_t>(value) < names.size();
  std::string text = std::string(info.name) + "=";
  if (info.kind == AttrKind::kIntList) return text + fmt::format("[{}]", fmt::join(values, ","));
  if (info.kind == AttrKind::kBool) return text + (value != 0 ? "true" : "false");
  if (info.kind == AttrKind::kDType && value >= 0 && is_dtype(static_cast<uint32_t>(value)))
    return text + std::string(dtype_info(static_cast<DType>(value)).name);
  if (info.kind == AttrKind::kElement) return text + element(operand, value);
  if (in_range) return text + std::string(names[static_cast<size_t>(value)]);
  return text + std::to_string(value);
}

std::string constant(const Tensor& tensor) {
  if (tensor.count() <= kMaxListedElements) {
    std::vector<std::string> elements;
    for (const int64_t value : tensor.ints()) elements.push_back(element(tensor.type.dtype, value));
    return fmt::format("[{}]", fmt::join(elements, ","));
  }
  std::string text = "hex \"";
  text.reserve(tensor.bytes.size() * 2 + 8);
  for (const uint8_t byte : tensor.bytes) {
    text += "0123456789abcdef"[byte >> 4];
    text += "0123456789abcdef"[byte & 15];
  }
  return text + "\"";
}

}  // namespace

std::string print_text(const Graph& graph) {
  std::string text =
      fmt::format("graph {} {{\n", is_plain(graph.name) ? graph.name : quoted(graph.name));
  for (const ValueId id : graph.inputs)
    text += fmt::format("  input {} : {}\n", reference(graph, id), type_text(graph.value(id).type));
  for (uint32_t i = 0; i < graph.values.size(); ++i) {
    const Value& value = graph.values[i];
    if (value.is_constant())
      text += fmt::format("  const {} : {} = {}\n", reference(graph, {i}), type_text(value.type),
                          constant(*value.constant));
  }
  for (const Node& node : graph.nodes) {
    const OpInfo& info = op_info(node.op);
    text += fmt::format("  {} = {} {}", reference(graph, node.output), info.name,
                        references(graph, node.inputs));
    std::string attributes;
    for (const Attr attr : info.attrs)
      if (node.attrs.has(attr))
        attributes +=
            (attributes.empty() ? "" : ", ") + attribute(attr_info(attr), node.attrs.list(attr),
                                                         graph.value(node.inputs[0]).type.dtype);
    if (!attributes.empty()) text += " {" + attributes + "}";
    text += " : " + type_text(graph.value(node.output).type);
    if (node.group != 0) text += fmt::format(" @{}", node.group);
    text += '\n';
  }
  return text + fmt::format("  return {}\n}}\n", references(graph, graph.outputs));
}

}  // namespace shale
