// Vgf to the bytes of a file of version 0.4.3.
#include <algorithm>
#include <cstring>

#include "compiler/frontend/vgf/layout.h"
#include "ir/schema/vgf_generated.h"

namespace shale {
namespace {

using flatbuffers::FlatBufferBuilder;
using flatbuffers::Offset;
using flatbuffers::Vector;

/// Vectors are written even when empty, as the format's own encoder does.
auto slots(FlatBufferBuilder& builder, const std::vector<VgfSlot>& slots) {
  std::vector<Offset<vgf::BindingSlot>> tables;
  for (const VgfSlot& slot : slots)
    tables.push_back(vgf::CreateBindingSlot(builder, slot.binding, slot.resource));
  return builder.CreateVector(tables);
}

Offset<vgf::Module> module_table(FlatBufferBuilder& builder, const VgfModule& module) {
  const auto name = builder.CreateString(module.name);
  const auto entry_point = builder.CreateString(module.entry_point);
  Offset<void> code;
  if (module.code == VgfCode::kSpirv && !module.words.empty())
    code = vgf::CreateSPIRV(builder, builder.CreateVector(module.words)).Union();
  if (module.code == VgfCode::kGlsl)
    code = vgf::CreateGLSL(builder, builder.CreateString(module.source)).Union();
  if (module.code == VgfCode::kHlsl)
    code = vgf::CreateHLSL(builder, builder.CreateString(module.source)).Union();
  return vgf::CreateModule(builder, static_cast<vgf::ModuleType>(module.type), name, entry_point,
                           static_cast<vgf::ModuleCode>(module.code), code);
}

Offset<vgf::SegmentInfo> segment_table(FlatBufferBuilder& builder, const VgfSegment& segment) {
  std::vector<Offset<vgf::DescriptorSetInfo>> sets;
  for (const VgfDescriptorSet& set : segment.sets)
    sets.push_back(
        vgf::CreateDescriptorSetInfo(builder, slots(builder, set.bindings), set.set_index));
  std::vector<Offset<vgf::PushConstantRange>> ranges;
  for (const VgfPushConstants& range : segment.push_constants)
    ranges.push_back(
        vgf::CreatePushConstantRange(builder, range.stage_flags, range.offset, range.size));
  const auto name = builder.CreateString(segment.name);
  const auto set_infos = builder.CreateVector(sets);
  const auto inputs = slots(builder, segment.inputs);
  const auto outputs = slots(builder, segment.outputs);
  const auto constants = builder.CreateVector(segment.constants);
  const auto dispatch = builder.CreateVector(segment.dispatch.data(), segment.dispatch.size());
  const auto push_constants = builder.CreateVector(ranges);
  return vgf::CreateSegmentInfo(builder, static_cast<vgf::ModuleType>(segment.type), name,
                                segment.module, set_infos, inputs, outputs, constants, dispatch,
                                push_constants);
}

Offset<vgf::ModelResourceTableEntry> resource_table(FlatBufferBuilder& builder,
                                                    const VgfResource& resource) {
  const auto shape = builder.CreateVector(resource.shape);
  const auto strides = builder.CreateVector(resource.strides);
  const auto description = vgf::CreateDescription(builder, shape, strides);
  Offset<void> sampler;
  if (const std::optional<VgfSampler>& s = resource.sampler)
    sampler = vgf::CreateSamplerConfig(builder, s->min_filter, s->mag_filter, s->address_mode_u,
                                       s->address_mode_v, s->border_color)
                  .Union();
  return vgf::CreateModelResourceTableEntry(
      builder, resource.descriptor_type, resource.format,
      static_cast<vgf::ResourceCategory>(resource.category), description,
      resource.sampler ? vgf::ExtraConfig::SamplerConfig : vgf::ExtraConfig::NONE, sampler,
      resource.alias_group);
}

void modules_section(FlatBufferBuilder& builder, const Vgf& file) {
  std::vector<Offset<vgf::Module>> tables;
  for (const VgfModule& module : file.modules) tables.push_back(module_table(builder, module));
  builder.Finish(vgf::CreateModuleTable(builder, builder.CreateVector(tables)));
}

void sequence_section(FlatBufferBuilder& builder, const Vgf& file) {
  std::vector<Offset<vgf::SegmentInfo>> tables;
  for (const VgfSegment& segment : file.segments) tables.push_back(segment_table(builder, segment));
  const auto segments = builder.CreateVector(tables);
  const auto inputs = slots(builder, file.inputs);
  const auto outputs = slots(builder, file.outputs);
  const auto input_names = builder.CreateVectorOfStrings(file.input_names);
  const auto output_names = builder.CreateVectorOfStrings(file.output_names);
  builder.Finish(
      vgf::CreateModelSequenceTable(builder, segments, inputs, outputs, input_names, output_names));
}

void resources_section(FlatBufferBuilder& builder, const Vgf& file) {
  std::vector<Offset<vgf::ModelResourceTableEntry>> tables;
  for (const VgfResource& resource : file.resources)
    tables.push_back(resource_table(builder, resource));
  builder.Finish(vgf::CreateModelResourceTable(builder, builder.CreateVector(tables)));
}

template <typename T>
void store(std::vector<uint8_t>& bytes, size_t offset, T value) {
  std::memcpy(bytes.data() + offset, &value, sizeof value);
}

std::vector<uint8_t> constants_section(const std::vector<VgfConstant>& constants) {
  using vgf_layout::kRecordBytes;
  using vgf_layout::kRecords;
  const size_t payload = kRecords + constants.size() * kRecordBytes;
  std::vector<uint8_t> bytes(payload);
  std::copy(vgf_layout::kConstantsTag.begin(), vgf_layout::kConstantsTag.end(), bytes.begin());
  store<uint64_t>(bytes, 8, constants.size());
  for (size_t i = 0; i < constants.size(); ++i) {
    const VgfConstant& constant = constants[i];
    const size_t record = kRecords + i * kRecordBytes;
    store<uint32_t>(bytes, record, constant.resource);
    store<int32_t>(bytes, record + 4, constant.sparsity_dimension);
    store<uint64_t>(bytes, record + 8, constant.bytes.size());
    store<uint64_t>(bytes, record + 16, bytes.size() - payload);
    bytes.insert(bytes.end(), constant.bytes.begin(), constant.bytes.end());
    bytes.resize(vgf_layout::aligned(bytes.size()));
  }
  return bytes;
}

/// FlatBuffers ends at 2 GiB and aborts beyond, so what a section will need is bounded before.
/// Every entry takes at most 128 bytes beside its strings and vectors.
uint64_t flat_bytes(const Vgf& file) {
  constexpr uint64_t kEntry = 128;
  uint64_t total = 0;
  const auto add = [&](uint64_t bytes) { total += kEntry + bytes; };
  for (const VgfModule& module : file.modules)
    add(module.name.size() + module.entry_point.size() + 4 * module.words.size() +
        module.source.size());
  for (const VgfSegment& segment : file.segments) {
    add(segment.name.size() + 4 * segment.constants.size() +
        kEntry * (segment.inputs.size() + segment.outputs.size() + segment.push_constants.size()));
    for (const VgfDescriptorSet& set : segment.sets) add(kEntry * set.bindings.size());
  }
  for (const auto* names : {&file.input_names, &file.output_names})
    for (const std::string& name : *names) add(name.size());
  for (const VgfResource& resource : file.resources)
    add(8 * (resource.shape.size() + resource.strides.size()));
  return total + kEntry * (file.inputs.size() + file.outputs.size());
}

}  // namespace

Result<std::vector<uint8_t>> write_vgf(const Vgf& file) {
  SHALE_TRY_VOID(check_vgf(file));
  constexpr uint64_t kMaxFlatBytes = (uint64_t{1} << 31) - 65536;
  if (const uint64_t bytes = flat_bytes(file); bytes > kMaxFlatBytes)
    return unsupported("",
                       "modules, segments and resources need {} bytes, at most {} can be written",
                       bytes, kMaxFlatBytes);
  std::vector<uint8_t> bytes(vgf_layout::kHeaderBytes);
  std::copy(vgf_layout::kMagic.begin(), vgf_layout::kMagic.end(), bytes.begin());
  store<uint16_t>(bytes, vgf_layout::kVkHeaderVersion, file.vk_header_version);
  bytes[vgf_layout::kVersion + 1] = 4;
  bytes[vgf_layout::kVersion + 2] = 3;
  const auto add = [&](size_t index, std::span<const uint8_t> section) {
    bytes.resize(vgf_layout::aligned(bytes.size()));
    store<uint64_t>(bytes, vgf_layout::kSections + 16 * index, bytes.size());
    store<uint64_t>(bytes, vgf_layout::kSections + 16 * index + 8, section.size());
    bytes.insert(bytes.end(), section.begin(), section.end());
  };
  constexpr void (*kSections[])(FlatBufferBuilder&, const Vgf&) = {
      modules_section, sequence_section, resources_section};
  for (size_t i = 0; i < std::size(kSections); ++i) {
    FlatBufferBuilder builder;
    kSections[i](builder, file);
    add(i, {builder.GetBufferPointer(), builder.GetSize()});
  }
  add(3, constants_section(file.constants));
  return bytes;
}

}  // namespace shale
