// Bytes of a VGF file to Vgf. What FlatBuffers' verifier or the header bounds is read here; what
// the numbers mean to each other is check.cpp's part.
#include <algorithm>
#include <cstring>

#include "compiler/frontend/vgf/layout.h"
#include "ir/graph/tensor.h"
#include "ir/schema/vgf_generated.h"

namespace shale {
namespace {

using flatbuffers::Offset;
using flatbuffers::String;
using flatbuffers::Vector;

/// A file may refer to one table many times, so what is made of it is counted: at most this many
/// bytes for each of the file.
constexpr uint64_t kMaxGrowth = 16;
constexpr uint64_t kGrowthSlack = 65536;

template <typename T>
T load(std::span<const uint8_t> bytes, uint64_t offset) {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

class Reader {
 public:
  explicit Reader(std::span<const uint8_t> bytes)
      : bytes_(bytes), budget_(kMaxGrowth * bytes.size() + kGrowthSlack) {}

  Result<Vgf> read(VgfLayout& layout) {
    SHALE_TRY_VOID(read_header(layout));
    SHALE_TRY_VOID(read_section<vgf::ModuleTable>("module table", layout.modules,
                                                  [&](const auto& t) { return modules(t); }));
    SHALE_TRY_VOID(read_section<vgf::ModelSequenceTable>(
        "model sequence", layout.sequence, [&](const auto& t) { return sequence(t); }));
    SHALE_TRY_VOID(read_section<vgf::ModelResourceTable>(
        "model resource table", layout.resources, [&](const auto& t) { return resources(t); }));
    SHALE_TRY_VOID(constants(layout));
    SHALE_TRY_VOID(check_vgf(vgf_));
    return std::move(vgf_);
  }

 private:
  Result<void> read_header(VgfLayout& layout) {
    if (bytes_.size() < vgf_layout::kHeaderBytes)
      return bad_input("", "found {} bytes, a VGF file has at least {}", bytes_.size(),
                       vgf_layout::kHeaderBytes);
    if (!is_vgf(bytes_))
      return bad_input("offset 0", "found the magic {:02X} {:02X} {:02X} {:02X}, expected VGF1",
                       bytes_[0], bytes_[1], bytes_[2], bytes_[3]);
    layout.old_magic = bytes_[0] != 'V';
    vgf_.vk_header_version = load<uint16_t>(bytes_, vgf_layout::kVkHeaderVersion);
    std::copy_n(bytes_.begin() + vgf_layout::kVersion, 3, vgf_.version.begin());
    if (vgf_.version[0] != 0 || vgf_.version[1] > 4)
      return unsupported("offset 8", "found VGF {}.{}.{}, versions up to 0.4 are read",
                         vgf_.version[0], vgf_.version[1], vgf_.version[2]);
    SHALE_TRY(layout.modules, section("module table", 0));
    SHALE_TRY(layout.sequence, section("model sequence", 1));
    SHALE_TRY(layout.resources, section("model resource table", 2));
    SHALE_TRY(layout.constants, section("constants", 3));
    return {};
  }

  Result<VgfLayout::Section> section(const char* name, size_t index) {
    const size_t at = vgf_layout::kSections + 16 * index;
    const VgfLayout::Section result{load<uint64_t>(bytes_, at), load<uint64_t>(bytes_, at + 8)};
    if (result.offset > bytes_.size() || result.size > bytes_.size() - result.offset)
      return bad_input(fmt::format("offset {}", at),
                       "the {} of {} bytes at {} leaves the file of {} bytes", name, result.size,
                       result.offset, bytes_.size());
    return result;
  }

  /// Runs `use` on the verified root table of a section.
  template <typename Table, typename Use>
  Result<void> read_section(const char* name, const VgfLayout::Section& section, const Use& use) {
    const std::string where = fmt::format("offset {}", section.offset);
    if (section.offset % 4 != 0)
      return bad_input(where, "the {} does not begin at a multiple of 4", name);
    if (section.size < 4)
      return bad_input(where, "the {} has {} bytes, expected at least 4", name, section.size);
    // Alignment counts from the section's start, which old files put at odd multiples of 4.
    std::vector<uint64_t> aligned((section.size + 7) / 8);
    std::memcpy(aligned.data(), bytes_.data() + section.offset, section.size);
    const auto* data = reinterpret_cast<const uint8_t*>(aligned.data());
    flatbuffers::Verifier verifier(data, section.size);
    if (!verifier.VerifyBuffer<Table>(nullptr))
      return bad_input(where, "the FlatBuffers structure of the {} is broken or cut off ({} bytes)",
                       name, section.size);
    return use(*flatbuffers::GetRoot<Table>(data));
  }

  /// Takes bytes that are about to be copied from the budget.
  Result<void> take(uint64_t bytes) {
    if (bytes > budget_)
      return bad_input("",
                       "the file refers to its parts so often that they grow to over {} times "
                       "its {} bytes",
                       kMaxGrowth, bytes_.size());
    budget_ -= bytes;
    return {};
  }

  template <typename T>
  Result<void> copy(const Vector<T>* source, std::vector<T>& target) {
    if (!source) return {};
    SHALE_TRY_VOID(take(source->size() * sizeof(T)));
    // The verifier lets vectors of 8-byte elements begin at odd multiples of 4.
    target.resize(source->size());
    if (!target.empty()) std::memcpy(target.data(), source->Data(), target.size() * sizeof(T));
    return {};
  }

  Result<void> copy(const String* source, std::string& target) {
    if (!source) return {};
    SHALE_TRY_VOID(take(source->size()));
    target = source->str();
    return {};
  }

  /// Appends one element of `target` for each of `source`; `fill` gives it its content.
  template <typename Table, typename T, typename Fill>
  Result<void> copy_tables(const Vector<Offset<Table>>* source, std::vector<T>& target,
                           const Fill& fill) {
    if (!source) return {};
    SHALE_TRY_VOID(take(source->size() * sizeof(T)));
    target.reserve(source->size());
    for (const Table* table : *source) SHALE_TRY_VOID(fill(*table, target.emplace_back()));
    return {};
  }

  Result<void> slots(const Vector<Offset<vgf::BindingSlot>>* source, std::vector<VgfSlot>& target) {
    return copy_tables(source, target, [](const vgf::BindingSlot& from, VgfSlot& to) {
      to = {from.binding(), from.mrt_index()};
      return Result<void>();
    });
  }

  Result<void> names(const Vector<Offset<String>>* source, std::vector<std::string>& target) {
    return copy_tables(source, target,
                       [&](const String& from, std::string& to) { return copy(&from, to); });
  }

  Result<void> modules(const vgf::ModuleTable& table) {
    return copy_tables(table.modules(), vgf_.modules,
                       [&](const vgf::Module& from, VgfModule& to) -> Result<void> {
                         to.type = static_cast<VgfModuleType>(from.type());
                         to.code = static_cast<VgfCode>(from.code_type());
                         SHALE_TRY_VOID(copy(from.name(), to.name));
                         SHALE_TRY_VOID(copy(from.entry_point(), to.entry_point));
                         // A code type without a value is a placeholder.
                         if (const vgf::SPIRV* spirv = from.code_as_SPIRV())
                           return copy(spirv->words(), to.words);
                         if (const vgf::GLSL* glsl = from.code_as_GLSL())
                           return copy(glsl->code(), to.source);
                         if (const vgf::HLSL* hlsl = from.code_as_HLSL())
                           return copy(hlsl->code(), to.source);
                         return {};
                       });
  }

  Result<void> sequence(const vgf::ModelSequenceTable& table) {
    SHALE_TRY_VOID(copy_tables(
        table.segments(), vgf_.segments,
        [&](const vgf::SegmentInfo& from, VgfSegment& to) { return segment(from, to); }));
    SHALE_TRY_VOID(slots(table.inputs(), vgf_.inputs));
    SHALE_TRY_VOID(slots(table.outputs(), vgf_.outputs));
    SHALE_TRY_VOID(names(table.input_names(), vgf_.input_names));
    return names(table.output_names(), vgf_.output_names);
  }

  Result<void> segment(const vgf::SegmentInfo& from, VgfSegment& to) {
    to.type = static_cast<VgfModuleType>(from.type());
    to.module = from.module_index();
    SHALE_TRY_VOID(copy(from.name(), to.name));
    SHALE_TRY_VOID(copy_tables(from.set_infos(), to.sets,
                               [&](const vgf::DescriptorSetInfo& set, VgfDescriptorSet& copied) {
                                 copied.set_index = set.set_index();
                                 return slots(set.bindings(), copied.bindings);
                               }));
    SHALE_TRY_VOID(slots(from.inputs(), to.inputs));
    SHALE_TRY_VOID(slots(from.outputs(), to.outputs));
    SHALE_TRY_VOID(copy(from.constants(), to.constants));
    if (const Vector<uint32_t>* shape = from.dispatch_shape()) {
      if (shape->size() != 3)
        return bad_input(vgf_layout::label("segment", vgf_.segments.size() - 1, to.name),
                         "the dispatch shape has {} numbers, expected 3", shape->size());
      std::copy(shape->begin(), shape->end(), to.dispatch.begin());
    }
    return copy_tables(from.push_constant_ranges(), to.push_constants,
                       [](const vgf::PushConstantRange& range, VgfPushConstants& copied) {
                         copied = {range.stage_flags(), range.offset(), range.size()};
                         return Result<void>();
                       });
  }

  Result<void> resources(const vgf::ModelResourceTable& table) {
    return copy_tables(
        table.mrt_entry(), vgf_.resources,
        [&](const vgf::ModelResourceTableEntry& from, VgfResource& to) -> Result<void> {
          to.descriptor_type = from.vk_descriptor_type();
          to.format = from.vk_format();
          to.category = static_cast<VgfCategory>(from.category());
          to.alias_group = from.alias_group_id();
          if (const vgf::Description* description = from.description()) {
            SHALE_TRY_VOID(copy(description->shape(), to.shape));
            // Writers differ in the negative number of an open size.
            for (int64_t& size : to.shape) size = std::max(size, kDynamic);
            SHALE_TRY_VOID(copy(description->strides(), to.strides));
          }
          if (from.extra_config_type() == vgf::ExtraConfig::NONE) return {};
          const vgf::SamplerConfig* sampler = from.extra_config_as_SamplerConfig();
          if (!sampler)
            return bad_input(fmt::format("resource {}", vgf_.resources.size() - 1),
                             "the extra configuration of type {} is no sampler",
                             static_cast<uint32_t>(from.extra_config_type()));
          to.sampler = {sampler->min_filter(), sampler->mag_filter(), sampler->address_mode_u(),
                        sampler->address_mode_v(), sampler->border_color()};
          return {};
        });
  }

  Result<void> constants(VgfLayout& layout) {
    const VgfLayout::Section& section = layout.constants;
    const std::span<const uint8_t> bytes = bytes_.subspan(section.offset, section.size);
    const std::string where = fmt::format("offset {}", section.offset);
    if (bytes.size() < vgf_layout::kConstantsTag.size())
      return bad_input(where, "the constants have {} bytes, expected at least {}", bytes.size(),
                       vgf_layout::kConstantsTag.size());
    if (std::equal(vgf_layout::kConstantsTag.begin(), vgf_layout::kConstantsTag.end(),
                   bytes.begin()))
      return raw_constants(where, bytes, layout);
    layout.legacy_constants = true;
    return read_section<vgf::ConstantSection>("constants (without the tag CONST00)", section,
                                              [&](const auto& table) { return legacy(table); });
  }

  Result<void> raw_constants(const std::string& where, std::span<const uint8_t> bytes,
                             VgfLayout& layout) {
    using vgf_layout::kRecordBytes;
    using vgf_layout::kRecords;
    if (bytes.size() < kRecords)
      return bad_input(where, "the constants have {} bytes, expected at least {}", bytes.size(),
                       kRecords);
    const uint64_t count = load<uint64_t>(bytes, 8);
    if (count > (bytes.size() - kRecords) / kRecordBytes)
      return bad_input(where, "{} constants do not fit into the section of {} bytes", count,
                       bytes.size());
    const std::span<const uint8_t> payload = bytes.subspan(kRecords + count * kRecordBytes);
    for (uint64_t i = 0; i < count; ++i) {
      const uint64_t record = kRecords + i * kRecordBytes;
      VgfConstant& constant = vgf_.constants.emplace_back();
      constant.resource = load<uint32_t>(bytes, record);
      constant.sparsity_dimension = load<int32_t>(bytes, record + 4);
      const uint64_t size = load<uint64_t>(bytes, record + 8);
      const uint64_t offset = load<uint64_t>(bytes, record + 16);
      if (offset > payload.size() || size > payload.size() - offset)
        return bad_input(fmt::format("constant {}", i),
                         "{} bytes at {} leave the payload of {} bytes", size, offset,
                         payload.size());
      SHALE_TRY_VOID(take(size));
      constant.bytes.assign(payload.begin() + static_cast<ptrdiff_t>(offset),
                            payload.begin() + static_cast<ptrdiff_t>(offset + size));
      layout.payload_offsets.push_back(offset);
    }
    return {};
  }

  Result<void> legacy(const vgf::ConstantSection& table) {
    return copy_tables(table.data(), vgf_.constants,
                       [&](const vgf::ConstantData& from, VgfConstant& to) -> Result<void> {
                         const int64_t dimension = from.sparsity_dimension();
                         to.resource = from.mrt_index();
                         to.sparsity_dimension = static_cast<int32_t>(dimension);
                         if (to.sparsity_dimension != dimension)
                           return bad_input(fmt::format("constant {}", vgf_.constants.size() - 1),
                                            "the sparsity dimension {} is no dimension", dimension);
                         return copy(from.raw(), to.bytes);
                       });
  }

  std::span<const uint8_t> bytes_;
  uint64_t budget_;
  Vgf vgf_;
};

}  // namespace

bool is_vgf(std::span<const uint8_t> bytes) {
  return bytes.size() >= 4 &&
         (std::equal(vgf_layout::kMagic.begin(), vgf_layout::kMagic.end(), bytes.begin()) ||
          std::equal(vgf_layout::kOldMagic.begin(), vgf_layout::kOldMagic.end(), bytes.begin()));
}

Result<Vgf> read_vgf(std::span<const uint8_t> bytes, VgfLayout* layout) {
  VgfLayout found;
  Result<Vgf> vgf = Reader(bytes).read(found);
  if (vgf && layout) *layout = std::move(found);
  return vgf;
}

}  // namespace shale
