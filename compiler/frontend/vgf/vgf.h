// compiler/frontend/vgf/vgf.h -- VGF container files, versions 0.3 to 0.4.3, as plain data.
//
// A VGF file holds SPIR-V modules (or shader text), a sequence of segments that run them one after
// the other, a table of the resources that they bind, and constant data. Numbers of Vulkan
// (descriptor types, formats, filters, stages) are kept as they are. Segments, slots and constants
// name resources by their position in the resource table.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "ir/base/result.h"

namespace shale {

/// "None" of descriptor types, alias groups and set indexes.
inline constexpr uint32_t kVgfNone = 0xFFFFFFFF;

/// VkDescriptorType of tensors.
inline constexpr uint32_t kVkDescriptorTensor = 1000460000;

enum class VgfModuleType : uint8_t { kCompute = 0, kGraph = 1 };
enum class VgfCode : uint8_t { kNone = 0, kSpirv = 1, kGlsl = 2, kHlsl = 3 };
enum class VgfCategory : uint8_t { kInput = 0, kOutput = 1, kIntermediate = 2, kConstant = 3 };

struct VgfModule {
  VgfModuleType type = VgfModuleType::kCompute;
  std::string name;
  std::string entry_point;
  VgfCode code = VgfCode::kSpirv;
  std::vector<uint32_t> words;  ///< kSpirv; empty is a placeholder that the application fills
  std::string source;           ///< kGlsl, kHlsl
  bool operator==(const VgfModule&) const = default;
};

/// A resource at a binding number.
struct VgfSlot {
  uint32_t binding = 0;
  uint32_t resource = 0;
  bool operator==(const VgfSlot&) const = default;
};

struct VgfDescriptorSet {
  std::vector<VgfSlot> bindings;
  uint32_t set_index = kVgfNone;  ///< kVgfNone: the position in the list
  bool operator==(const VgfDescriptorSet&) const = default;
};

struct VgfPushConstants {
  uint32_t stage_flags = 0;
  uint32_t offset = 0, size = 0;  ///< bytes, multiples of 4
  bool operator==(const VgfPushConstants&) const = default;
};

/// One run of a pipeline.
struct VgfSegment {
  VgfModuleType type = VgfModuleType::kCompute;  ///< that of the module
  std::string name;
  uint32_t module = 0;
  std::vector<VgfDescriptorSet> sets;
  std::vector<VgfSlot> inputs, outputs;  ///< slots of the sets
  std::vector<uint32_t> constants;       ///< positions in Vgf::constants
  std::array<uint32_t, 3> dispatch{};    ///< workgroups; zeros for graphs
  std::vector<VgfPushConstants> push_constants;
  bool operator==(const VgfSegment&) const = default;

  /// Number of the set at this position of the list.
  uint32_t set_number(size_t position) const {
    return sets[position].set_index == kVgfNone ? static_cast<uint32_t>(position)
                                                : sets[position].set_index;
  }
};

struct VgfSampler {
  uint32_t min_filter = 0, mag_filter = 0, address_mode_u = 0, address_mode_v = 0;
  uint32_t border_color = 0;
  bool operator==(const VgfSampler&) const = default;
};

struct VgfResource {
  uint32_t descriptor_type = kVgfNone;  ///< VkDescriptorType; kVgfNone for constants
  uint32_t format = 0;                  ///< VkFormat
  VgfCategory category = VgfCategory::kInput;
  std::vector<int64_t> shape;    ///< outermost first; kDynamic where a dimension is open
  std::vector<int64_t> strides;  ///< bytes; empty is packed
  std::optional<VgfSampler> sampler;
  uint32_t alias_group = kVgfNone;  ///< resources of one group share their storage
  bool operator==(const VgfResource&) const = default;
};

struct VgfConstant {
  uint32_t resource = 0;
  /// Of this dimension at most two of every four consecutive elements are not zero, as a hint; the
  /// bytes are dense all the same. -1: no such claim.
  int32_t sparsity_dimension = -1;
  std::vector<uint8_t> bytes;  ///< the packed tensor in the resource's format
  bool operator==(const VgfConstant&) const = default;
};

struct Vgf {
  std::array<uint8_t, 3> version{0, 4, 3};  ///< of the file that was read
  uint16_t vk_header_version = 0;           ///< of the writer's Vulkan headers; 0 is unknown
  std::vector<VgfModule> modules;
  std::vector<VgfSegment> segments;
  std::vector<VgfSlot> inputs, outputs;                ///< of the whole model
  std::vector<std::string> input_names, output_names;  ///< empty, or a name for each slot
  std::vector<VgfResource> resources;
  std::vector<VgfConstant> constants;
  bool operator==(const Vgf&) const = default;
};

/// Where a file has its parts; for listings.
struct VgfLayout {
  struct Section {
    uint64_t offset = 0, size = 0;  ///< bytes
  };
  bool old_magic = false;         ///< C3 D2 E1 F0 instead of VGF1
  bool legacy_constants = false;  ///< FlatBuffers, as before 0.4.0
  Section modules, sequence, resources, constants;
  std::vector<uint64_t> payload_offsets;  ///< of each constant, if they are not legacy
};

/// True if the bytes begin with either magic.
bool is_vgf(std::span<const uint8_t> bytes);

/// Reads an untrusted file of any version up to 0.4.x. The result passes check_vgf. Unknown fields
/// of the tables are ignored. Memory is bounded by a multiple of the file's size.
/// `layout`, if not null, receives where the parts lie.
/// Errors: kBadInput for a broken file, kUnsupported for a version above 0.4; `where` is a byte
/// offset or names the entry.
Result<Vgf> read_vgf(std::span<const uint8_t> bytes, VgfLayout* layout = nullptr);

/// What holds beyond the file's structure: numbers of enums, indexes, categories that fit their
/// use, as many names as slots, slots of segments that lie in their sets, unique set and binding
/// numbers, constants as large as their shape and format say, the magic of SPIR-V, alias groups
/// without constants whose buffers and tensors have one size.
/// Errors: kBadInput, naming the entry.
Result<void> check_vgf(const Vgf& vgf);

/// The file in the layout of version 0.4.3, whatever `vgf.version` says. Same data, same bytes.
/// read_vgf of it equals `vgf` but for the version.
/// Errors: those of check_vgf; kUnsupported if a section would be above 2 GiB.
Result<std::vector<uint8_t>> write_vgf(const Vgf& vgf);

/// Everything in the file, for people. `layout` may be null.
std::string dump_vgf(const Vgf& vgf, const VgfLayout* layout);

/// Does the data of a constant keep what its sparsity mark claims? A constant without a mark does,
/// and one whose format has no known size.
/// Errors: kBadInput with the position of the first four elements that break the claim, or if the
/// dimension is no multiple of four.
Result<void> check_sparsity(const Vgf& vgf, size_t constant);

/// Bytes of a texel of an uncompressed VkFormat; 0 if unknown here.
uint32_t vk_format_bytes(uint32_t format);
/// "R8_SINT", "STORAGE_BUFFER": for people; the number where the name is unknown.
std::string vk_format_name(uint32_t format);
std::string vk_descriptor_name(uint32_t descriptor_type);

/// "COMPUTE", "SPIRV", "INPUT": names of the enums, as the format's documentation has them.
const char* vgf_name(VgfModuleType type);
const char* vgf_name(VgfCode code);
const char* vgf_name(VgfCategory category);

}  // namespace shale
