// Vgf as text: every field, in the order of the file.
#include <fmt/ranges.h>

#include <iterator>

#include "compiler/frontend/vgf/vgf.h"
#include "ir/base/hash.h"
#include "ir/graph/tensor.h"

namespace shale {
namespace {

template <typename... Args>
void line(std::string& text, fmt::format_string<Args...> format, Args&&... args) {
  fmt::format_to(std::back_inserter(text), format, std::forward<Args>(args)...);
  text += '\n';
}

/// In quotes; control characters, which a terminal may obey, as \x1b.
std::string quoted(const std::string& name) {
  std::string text = "\"";
  for (const char c : name) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 0x20 || byte == 0x7f)
      text += fmt::format("\\x{:02x}", byte);
    else
      text += c;
  }
  return text + "\"";
}

void dump_layout(std::string& text, const VgfLayout& layout) {
  const auto section = [&](const char* name, const VgfLayout::Section& s) {
    line(text, "  {:20} {} bytes at {}", name, s.size, s.offset);
  };
  line(text, "sections, magic {}:", layout.old_magic ? "C3D2E1F0" : "VGF1");
  section("module table", layout.modules);
  section("model sequence", layout.sequence);
  section("model resource table", layout.resources);
  section(layout.legacy_constants ? "constants (legacy)" : "constants", layout.constants);
}

void dump_module(std::string& text, size_t index, const VgfModule& module) {
  const std::string head =
      fmt::format("  {:3} {} {}, entry point {}, {}", index, vgf_name(module.type),
                  quoted(module.name), quoted(module.entry_point), vgf_name(module.code));
  if (!module.source.empty()) {
    line(text, "{}, {} characters:", head, module.source.size());
    for (size_t at = 0; at < module.source.size();) {
      const size_t end = std::min(module.source.find('\n', at), module.source.size());
      line(text, "        {}", quoted(module.source.substr(at, end - at)));
      at = end + 1;
    }
    return;
  }
  if (module.words.empty()) return line(text, "{}, a placeholder", head);
  const auto* bytes = reinterpret_cast<const uint8_t*>(module.words.data());
  line(text, "{}, {} words, version {:#010x}, bound {}, hash {:016x}", head, module.words.size(),
       module.words[1], module.words[3], stable_hash({bytes, 4 * module.words.size()}));
}

void dump_resource(std::string& text, size_t index, const VgfResource& resource) {
  const std::string strides = resource.strides.empty()
                                  ? ""
                                  : fmt::format(" strides [{}]", fmt::join(resource.strides, ","));
  const std::string alias =
      resource.alias_group == kVgfNone ? "" : fmt::format(" alias group {}", resource.alias_group);
  line(text, "  {:3} {:12} {}{} descriptor {}{}{}", index, vgf_name(resource.category),
       vk_format_name(resource.format), shape_text(resource.shape),
       vk_descriptor_name(resource.descriptor_type), strides, alias);
  if (const std::optional<VgfSampler>& s = resource.sampler)
    line(text,
         "        sampler: min filter {}, mag filter {}, address mode u {}, address mode v {}, "
         "border color {}",
         s->min_filter, s->mag_filter, s->address_mode_u, s->address_mode_v, s->border_color);
}

void dump_constant(std::string& text, const Vgf& vgf, const VgfLayout* layout, size_t index) {
  const VgfConstant& constant = vgf.constants[index];
  std::string sparsity = "dense";
  if (constant.sparsity_dimension >= 0) {
    const Result<void> check = check_sparsity(vgf, index);
    sparsity = fmt::format("2:4 sparse along dimension {}{}", constant.sparsity_dimension,
                           check ? "" : " (it is not: " + check.error().message + ")");
  }
  const std::string place = layout && index < layout->payload_offsets.size()
                                ? fmt::format(" at {}", layout->payload_offsets[index])
                                : "";
  const size_t shown = std::min<size_t>(constant.bytes.size(), 16);
  line(
      text, "  {:3} resource {}, {} bytes{}, {}, begins {:02x}, hash {:016x}", index,
      constant.resource, constant.bytes.size(), place, sparsity,
      fmt::join(constant.bytes.begin(), constant.bytes.begin() + static_cast<ptrdiff_t>(shown), ""),
      stable_hash(constant.bytes));
}

void dump_slots(std::string& text, const std::string& head, const std::vector<VgfSlot>& slots,
                const std::vector<std::string>& names = {}) {
  std::string list;
  for (size_t i = 0; i < slots.size(); ++i)
    list += fmt::format("{} {}: resource {}{}", i ? "," : "", slots[i].binding, slots[i].resource,
                        names.empty() ? "" : " " + quoted(names[i]));
  line(text, "{}{}", head, slots.empty() ? " none" : list);
}

void dump_segment(std::string& text, size_t index, const VgfSegment& segment) {
  line(text, "  {:3} {} {}, module {}, dispatch {}", index, vgf_name(segment.type),
       quoted(segment.name), segment.module, fmt::join(segment.dispatch, "x"));
  for (size_t i = 0; i < segment.sets.size(); ++i)
    dump_slots(text,
               fmt::format("      set {}{}", segment.set_number(i),
                           segment.sets[i].set_index == kVgfNone ? " (by position)" : ""),
               segment.sets[i].bindings);
  dump_slots(text, "      inputs ", segment.inputs);
  dump_slots(text, "      outputs", segment.outputs);
  if (!segment.constants.empty())
    line(text, "      constants {}", fmt::join(segment.constants, ", "));
  for (const VgfPushConstants& range : segment.push_constants)
    line(text, "      push constants: {} bytes at {}, stages {:#x}", range.size, range.offset,
         range.stage_flags);
}

}  // namespace

std::string dump_vgf(const Vgf& vgf, const VgfLayout* layout) {
  std::string text;
  line(text, "VGF {}, Vulkan header {}", fmt::join(vgf.version, "."), vgf.vk_header_version);
  if (layout) dump_layout(text, *layout);
  line(text, "modules: {}", vgf.modules.size());
  for (size_t i = 0; i < vgf.modules.size(); ++i) dump_module(text, i, vgf.modules[i]);
  line(text, "resources: {}", vgf.resources.size());
  for (size_t i = 0; i < vgf.resources.size(); ++i) dump_resource(text, i, vgf.resources[i]);
  line(text, "constants: {}", vgf.constants.size());
  for (size_t i = 0; i < vgf.constants.size(); ++i) dump_constant(text, vgf, layout, i);
  line(text, "segments: {}", vgf.segments.size());
  for (size_t i = 0; i < vgf.segments.size(); ++i) dump_segment(text, i, vgf.segments[i]);
  dump_slots(text, "model inputs ", vgf.inputs, vgf.input_names);
  dump_slots(text, "model outputs", vgf.outputs, vgf.output_names);
  return text;
}

}  // namespace shale
