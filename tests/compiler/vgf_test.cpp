// VGF containers: files of another encoder, fields, layout, refusals.
#include "compiler/frontend/vgf/vgf.h"

#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>

#include "ir/base/file.h"
#include "ir/schema/vgf_generated.h"

namespace shale {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using Bytes = std::vector<uint8_t>;

struct Golden {
  std::string name;
  Bytes bytes;
  json described;
};

std::vector<Golden> golden_containers() {
  std::vector<Golden> files;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(SHALE_SOURCE_DIR "/tests/golden/vgf", error)) {
    if (entry.path().extension() != ".vgf") continue;
    fs::path description = entry.path();
    description.replace_extension(".json");
    files.push_back({entry.path().filename().string(), *read_file(entry.path().string()),
                     json::parse(*read_text(description.string()))});
  }
  return files;
}

template <typename T>
T load(const Bytes& bytes, size_t offset) {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

template <typename T>
void store(Bytes& bytes, size_t offset, T value) {
  std::memcpy(bytes.data() + offset, &value, sizeof value);
}

json slots_json(const std::vector<VgfSlot>& slots) {
  json list = json::array();
  for (const VgfSlot& slot : slots)
    list.push_back({{"binding", slot.binding}, {"mrt_index", slot.resource}});
  return list;
}

json number_or_null(uint32_t number) { return number == kVgfNone ? json() : json(number); }

/// What uses every field of the format; its constants are as large as their shapes say.
Vgf everything() {
  Vgf vgf;
  vgf.vk_header_version = 359;
  vgf.modules = {
      {VgfModuleType::kGraph, "g", "main", VgfCode::kSpirv, {0x07230203, 0x10600, 0, 8, 0}, ""},
      {VgfModuleType::kCompute, "text", "main", VgfCode::kGlsl, {}, "void main() {}\n"},
      {VgfModuleType::kCompute, "more", "run", VgfCode::kHlsl, {}, "[numthreads(1,1,1)]"},
      {VgfModuleType::kCompute, "later", "main", VgfCode::kSpirv, {}, ""}};
  const auto resource = [](uint32_t descriptor, uint32_t format, VgfCategory category,
                           std::vector<int64_t> shape) {
    VgfResource made;
    made.descriptor_type = descriptor;
    made.format = format;
    made.category = category;
    made.shape = std::move(shape);
    return made;
  };
  vgf.resources = {resource(1000460000, 14, VgfCategory::kInput, {1, -1, 4, 2}),
                   resource(1000460000, 14, VgfCategory::kIntermediate, {1, 4, 4, 2}),
                   resource(7, 98, VgfCategory::kIntermediate, {8}),
                   resource(7, 98, VgfCategory::kOutput, {8}),
                   resource(kVgfNone, 14, VgfCategory::kConstant, {3, 8}),
                   resource(kVgfNone, 99, VgfCategory::kConstant, {3}),
                   resource(1, 37, VgfCategory::kInput, {1, 4, 4, 4})};
  vgf.resources[1].alias_group = vgf.resources[2].alias_group = 5;
  vgf.resources[1].strides = {32, 8, 2, 1};
  vgf.resources[6].sampler = {1, 0, 2, 3, 4};
  vgf.constants = {{4, 1, Bytes(24)}, {5, -1, Bytes(12, 7)}};
  vgf.constants[0].bytes[0] = vgf.constants[0].bytes[3] = vgf.constants[0].bytes[22] = 9;
  VgfSegment graph;
  graph.type = VgfModuleType::kGraph;
  graph.name = "network";
  graph.sets = {{{{0, 0}, {1, 1}}, kVgfNone}};
  graph.inputs = {{0, 0}};
  graph.outputs = {{1, 1}};
  graph.constants = {0, 1};
  VgfSegment pass;
  pass.name = "pass";
  pass.module = 1;
  pass.sets = {{{{0, 2}, {7, 3}}, 2}, {{{0, 6}}, 4}};
  pass.inputs = {{0, 2}, {0, 6}};
  pass.outputs = {{7, 3}};
  pass.dispatch = {4, 2, 1};
  pass.push_constants = {{0x20, 0, 8}, {0x20, 8, 4}};
  vgf.segments = {graph, pass};
  vgf.inputs = {{0, 0}, {1, 6}};
  vgf.outputs = {{7, 3}};
  vgf.input_names = {"x", "lut"};
  vgf.output_names = {"y"};
  return vgf;
}

Bytes must_write(const Vgf& vgf) {
  const Result<Bytes> bytes = write_vgf(vgf);
  EXPECT_TRUE(bytes) << bytes.error().text();
  return *bytes;
}

/// Header and sections as they come, each at a multiple of `alignment`.
Bytes assemble(const std::array<Bytes, 4>& sections, size_t alignment = 8) {
  Bytes bytes(128);
  std::copy_n("VGF1", 4, bytes.begin());
  bytes[9] = 4;
  for (size_t i = 0; i < 4; ++i) {
    bytes.resize((bytes.size() + alignment - 1) / alignment * alignment);
    store<uint64_t>(bytes, 16 + 16 * i, bytes.size());
    store<uint64_t>(bytes, 24 + 16 * i, sections[i].size());
    bytes.insert(bytes.end(), sections[i].begin(), sections[i].end());
  }
  return bytes;
}

Bytes section(const Bytes& file, size_t index) {
  const auto begin = file.begin() + static_cast<ptrdiff_t>(load<uint64_t>(file, 16 + 16 * index));
  return {begin, begin + static_cast<ptrdiff_t>(load<uint64_t>(file, 24 + 16 * index))};
}

std::array<Bytes, 4> sections(const Bytes& file) {
  return {section(file, 0), section(file, 1), section(file, 2), section(file, 3)};
}

Bytes finished(flatbuffers::FlatBufferBuilder& builder) {
  return {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()};
}

std::string error_of(const Bytes& bytes) {
  const Result<Vgf> vgf = read_vgf(bytes);
  return vgf ? "read" : vgf.error().text();
}

TEST(Vgf, FilesOfTheReferenceEncoderAgreeWithTheirDescriptions) {
  const std::vector<Golden> files = golden_containers();
  if (files.empty()) GTEST_SKIP() << "no golden files";
  for (const Golden& file : files) {
    SCOPED_TRACE(file.name);
    const json& want = file.described;
    VgfLayout layout;
    const Result<Vgf> read = read_vgf(file.bytes, &layout);
    ASSERT_TRUE(read) << read.error().text();
    const Vgf& vgf = *read;
    EXPECT_FALSE(layout.old_magic);
    EXPECT_EQ(vgf.vk_header_version, want["header"]["vk_header_version"]);
    EXPECT_EQ(json(vgf.version), want["header"]["version"]);
    EXPECT_EQ(layout.legacy_constants, want["constants_tag"] != "CONST00");
    const std::pair<const char*, VgfLayout::Section> parts[] = {
        {"module_table", layout.modules},
        {"model_sequence", layout.sequence},
        {"model_resource_table", layout.resources},
        {"constants", layout.constants}};
    for (const auto& [name, part] : parts) {
      EXPECT_EQ(part.offset, want["sections"][name]["offset"]) << name;
      EXPECT_EQ(part.size, want["sections"][name]["size"]) << name;
    }
    ASSERT_EQ(vgf.modules.size(), want["modules"].size());
    for (size_t i = 0; i < vgf.modules.size(); ++i) {
      const json& module = want["modules"][i];
      EXPECT_EQ(vgf_name(vgf.modules[i].type), module["type"]);
      EXPECT_EQ(vgf.modules[i].name, module["name"]);
      EXPECT_EQ(vgf.modules[i].entry_point, module["entry_point"]);
      EXPECT_EQ(vgf_name(vgf.modules[i].code), module["code"]);
      EXPECT_EQ(vgf.modules[i].words.size(), module.value("words", 0u));
      EXPECT_EQ(vgf.modules[i].source.size(), module.value("chars", 0u));
      EXPECT_EQ(vgf.modules[i].source, module.value("source_text", ""));
      if (module.contains("spirv_header")) {
        EXPECT_EQ(vgf.modules[i].words[3], module["spirv_header"]["bound"]);
      }
    }
    ASSERT_EQ(vgf.resources.size(), want["resources"].size());
    for (size_t i = 0; i < vgf.resources.size(); ++i) {
      const VgfResource& resource = vgf.resources[i];
      const json& entry = want["resources"][i];
      EXPECT_EQ(number_or_null(resource.descriptor_type), entry["vk_descriptor_type"]);
      EXPECT_EQ(resource.format, entry["vk_format"]);
      EXPECT_EQ(vgf_name(resource.category), entry["category"]);
      EXPECT_EQ(json(resource.shape), entry["shape"]);
      EXPECT_EQ(json(resource.strides), entry["strides"]);
      EXPECT_EQ(number_or_null(resource.alias_group), entry["alias_group_id"]);
      ASSERT_EQ(resource.sampler.has_value(), entry.contains("sampler_config"));
      if (!resource.sampler) continue;
      const json& sampler = entry["sampler_config"];
      EXPECT_EQ(resource.sampler->min_filter, sampler["min_filter"]);
      EXPECT_EQ(resource.sampler->mag_filter, sampler["mag_filter"]);
      EXPECT_EQ(resource.sampler->address_mode_u, sampler["address_mode_u"]);
      EXPECT_EQ(resource.sampler->address_mode_v, sampler["address_mode_v"]);
      EXPECT_EQ(resource.sampler->border_color, sampler["border_color"]);
    }
    ASSERT_EQ(vgf.constants.size(), want["constants"].size());
    for (size_t i = 0; i < vgf.constants.size(); ++i) {
      const VgfConstant& constant = vgf.constants[i];
      const json& entry = want["constants"][i];
      EXPECT_EQ(constant.resource, entry["mrt_index"]);
      EXPECT_EQ(constant.sparsity_dimension, entry["sparsity_dimension"]);
      EXPECT_EQ(constant.bytes.size(), entry["size"]);
      EXPECT_EQ(layout.payload_offsets[i], entry["payload_offset"]);
      std::string hex;
      for (size_t b = 0; b < std::min<size_t>(constant.bytes.size(), 16); ++b)
        hex += fmt::format("{:02x}", constant.bytes[b]);
      EXPECT_EQ(hex, entry["first_bytes_hex"]);
    }
    ASSERT_EQ(vgf.segments.size(), want["segments"].size());
    for (size_t i = 0; i < vgf.segments.size(); ++i) {
      const VgfSegment& segment = vgf.segments[i];
      const json& entry = want["segments"][i];
      EXPECT_EQ(vgf_name(segment.type), entry["type"]);
      EXPECT_EQ(segment.name, entry["name"]);
      EXPECT_EQ(segment.module, entry["module_index"]);
      EXPECT_EQ(slots_json(segment.inputs), entry["inputs"]);
      EXPECT_EQ(slots_json(segment.outputs), entry["outputs"]);
      EXPECT_EQ(json(segment.constants), entry["constants"]);
      EXPECT_EQ(json(segment.dispatch), entry["dispatch_shape"]);
      ASSERT_EQ(segment.sets.size(), entry["set_infos"].size());
      for (size_t s = 0; s < segment.sets.size(); ++s) {
        const json& set = entry["set_infos"][s];
        EXPECT_EQ(number_or_null(segment.sets[s].set_index), set["set_index_field"]);
        EXPECT_EQ(segment.set_number(s), set["set_index_effective"]);
        EXPECT_EQ(slots_json(segment.sets[s].bindings), set["bindings"]);
      }
      json ranges = json::array();
      for (const VgfPushConstants& range : segment.push_constants)
        ranges.push_back(
            {{"stage_flags", range.stage_flags}, {"offset", range.offset}, {"size", range.size}});
      EXPECT_EQ(ranges, entry["push_constant_ranges"]);
    }
    EXPECT_EQ(slots_json(vgf.inputs), want["model"]["inputs"]);
    EXPECT_EQ(slots_json(vgf.outputs), want["model"]["outputs"]);
    EXPECT_EQ(json(vgf.input_names), want["model"]["input_names"]);
    EXPECT_EQ(json(vgf.output_names), want["model"]["output_names"]);

    const Result<Vgf> again = read_vgf(must_write(vgf));
    ASSERT_TRUE(again) << again.error().text();
    EXPECT_EQ(*again, vgf);
  }
}

TEST(Vgf, EveryFieldSurvivesWriteAndRead) {
  const Vgf vgf = everything();
  const Bytes bytes = must_write(vgf);
  const Result<Vgf> again = read_vgf(bytes);
  ASSERT_TRUE(again) << again.error().text();
  EXPECT_EQ(*again, vgf);
  EXPECT_EQ(must_write(*again), bytes);
  const Vgf empty;
  EXPECT_EQ(*read_vgf(must_write(empty)), empty);
}

TEST(Vgf, AWrittenFileHasTheLayoutOfVersion043) {
  const Bytes bytes = must_write(everything());
  EXPECT_EQ(std::string(bytes.begin(), bytes.begin() + 4), "VGF1");
  EXPECT_EQ(load<uint16_t>(bytes, 4), 359);
  EXPECT_EQ(load<uint16_t>(bytes, 6), 0);
  EXPECT_EQ((std::array{bytes[8], bytes[9], bytes[10], bytes[11]}),
            (std::array<uint8_t, 4>{0, 4, 3, 0}));
  EXPECT_EQ(load<uint32_t>(bytes, 12), 0u);
  for (size_t i = 80; i < 128; ++i) EXPECT_EQ(bytes[i], 0) << i;
  uint64_t end = 128;
  for (size_t i = 0; i < 4; ++i) {
    const uint64_t offset = load<uint64_t>(bytes, 16 + 16 * i);
    EXPECT_EQ(offset, (end + 7) / 8 * 8) << i;
    for (uint64_t gap = end; gap < offset; ++gap) EXPECT_EQ(bytes[gap], 0) << gap;
    end = offset + load<uint64_t>(bytes, 24 + 16 * i);
  }
  EXPECT_EQ(end, bytes.size());
  const Bytes constants = section(bytes, 3);
  EXPECT_EQ(std::string(constants.begin(), constants.begin() + 8), std::string("CONST00\0", 8));
  EXPECT_EQ(load<uint64_t>(constants, 8), 2u);
  EXPECT_EQ(load<uint32_t>(constants, 16), 4u);
  EXPECT_EQ(load<int32_t>(constants, 20), 1);
  EXPECT_EQ(load<uint64_t>(constants, 24), 24u);
  EXPECT_EQ(load<uint64_t>(constants, 32), 0u);
  EXPECT_EQ(load<uint32_t>(constants, 40), 5u);
  EXPECT_EQ(load<int32_t>(constants, 44), -1);
  EXPECT_EQ(load<uint64_t>(constants, 48), 12u);
  EXPECT_EQ(load<uint64_t>(constants, 56), 24u);
  EXPECT_EQ(constants.size(), 64u + 24 + 16) << "the last entry is padded to 8 too";
  EXPECT_EQ(section(must_write(Vgf()), 3).size(), 16u);
}

TEST(Vgf, OldFilesAreRead) {
  Vgf vgf = everything();
  std::array<Bytes, 4> parts = sections(must_write(vgf));
  // Before 0.4.0 the constants were FlatBuffers; an absent dimension means 0.
  flatbuffers::FlatBufferBuilder builder;
  std::vector<flatbuffers::Offset<vgf::ConstantData>> data;
  for (const VgfConstant& constant : vgf.constants)
    data.push_back(vgf::CreateConstantData(builder, constant.resource, constant.sparsity_dimension,
                                           builder.CreateVector(constant.bytes)));
  data.push_back(vgf::CreateConstantData(builder, 4, 0, builder.CreateVector(Bytes(24))));
  builder.Finish(vgf::CreateConstantSection(builder, builder.CreateVector(data)));
  parts[3] = finished(builder);
  Bytes bytes = assemble(parts, 4);
  bytes[9] = 3;
  store<uint32_t>(bytes, 0, 0xF0E1D2C3);
  vgf.version = {0, 3, 0};
  vgf.vk_header_version = 0;
  vgf.constants.push_back({4, 0, Bytes(24)});
  VgfLayout layout;
  const Result<Vgf> read = read_vgf(bytes, &layout);
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(*read, vgf);
  EXPECT_TRUE(layout.old_magic);
  EXPECT_TRUE(layout.legacy_constants);
}

TEST(Vgf, SectionsMayBeginAtOddMultiplesOfFour) {
  const Vgf vgf = everything();
  std::array<Bytes, 4> parts = sections(must_write(vgf));
  parts[0].resize(parts[0].size() / 8 * 8 + 4);  // what follows is shifted by four
  const Bytes bytes = assemble(parts, 4);
  ASSERT_EQ(load<uint64_t>(bytes, 32) % 8, 4u);
  Result<Vgf> read = read_vgf(bytes);
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(read->segments, vgf.segments);
  EXPECT_EQ(read->resources, vgf.resources);
}

TEST(Vgf, VectorsOfEightByteNumbersMayLieAtOddMultiplesOfFour) {
  // A resource table with one entry of shape [5, 6], whose elements begin at byte 68.
  const std::vector<uint32_t> words{
      12,         0x00080006, 4,            // vtable: a field at 4
      8,          4,          1,       16,  // root, vector of one entry
      0x0008000C, 0,          4 << 16,      // vtable: field 3 at 4
      12,         12,                       // the entry
      0x00080006, 4,                        // vtable: a field at 4
      8,          4,                        // its description
      2,          5,          0,       6,  0};
  std::array<Bytes, 4> parts = sections(must_write(Vgf()));
  parts[2].resize(4 * words.size());
  std::memcpy(parts[2].data(), words.data(), parts[2].size());
  const Result<Vgf> read = read_vgf(assemble(parts));
  ASSERT_TRUE(read) << read.error().text();
  ASSERT_EQ(read->resources.size(), 1u);
  EXPECT_EQ(read->resources[0].shape, (std::vector<int64_t>{5, 6}));
}

/// Sections of a file whose sequence is one root table with the fields that `fill` adds.
std::array<Bytes, 4> with_sequence(
    const std::function<void(flatbuffers::FlatBufferBuilder&)>& fill) {
  std::array<Bytes, 4> parts = sections(must_write(everything()));
  flatbuffers::FlatBufferBuilder builder;
  fill(builder);
  parts[1] = finished(builder);
  return parts;
}

TEST(Vgf, UnknownFieldsAreIgnoredAndAbsentOnesAreEmpty) {
  const Bytes bytes = assemble(with_sequence([](flatbuffers::FlatBufferBuilder& builder) {
    const auto numbers = builder.CreateVector(std::vector<uint32_t>{1, 2});
    const auto segment = [&] {
      const auto start = builder.StartTable();
      builder.AddElement<uint8_t>(4, 1, 0);   // type GRAPH
      builder.AddOffset(4 + 2 * 9, numbers);  // a field of later versions
      return flatbuffers::Offset<vgf::SegmentInfo>(builder.EndTable(start));
    }();
    builder.Finish(vgf::CreateModelSequenceTable(builder, builder.CreateVector(&segment, 1)));
  }));
  const Result<Vgf> read = read_vgf(bytes);
  ASSERT_TRUE(read) << read.error().text();
  VgfSegment graph;
  graph.type = VgfModuleType::kGraph;
  EXPECT_EQ(read->segments, std::vector{graph});
  EXPECT_TRUE(read->inputs.empty());
}

TEST(Vgf, TruncationAtEveryByteIsRefused) {
  std::vector<Bytes> files{must_write(everything())};
  for (Golden& file : golden_containers()) files.push_back(std::move(file.bytes));
  for (const Bytes& file : files)
    for (size_t size = 0; size < file.size(); ++size)
      ASSERT_FALSE(read_vgf(std::span(file).first(size))) << size << " of " << file.size();
}

TEST(Vgf, BrokenStructureIsRefusedByPlace) {
  const Bytes good = must_write(everything());
  const uint64_t size = good.size();
  const uint64_t constants = load<uint64_t>(good, 64);
  const auto changed = [&](auto change) {
    Bytes bytes = good;
    change(bytes);
    return error_of(bytes);
  };
  EXPECT_EQ(error_of({}), "found 0 bytes, a VGF file has at least 128");
  EXPECT_EQ(changed([](Bytes& b) { b[3] = '2'; }),
            "offset 0: found the magic 56 47 46 32, expected VGF1");
  EXPECT_EQ(changed([](Bytes& b) { b[8] = 1; }),
            "offset 8: found VGF 1.4.3, versions up to 0.4 are read");
  EXPECT_EQ(changed([](Bytes& b) { b[9] = 5; }),
            "offset 8: found VGF 0.5.3, versions up to 0.4 are read");
  EXPECT_EQ(changed([](Bytes& b) { b[10] = 99; }), "read") << "the patch does not matter";
  EXPECT_EQ(changed([](Bytes& b) { store<uint64_t>(b, 40, UINT64_MAX); }),
            fmt::format("offset 32: the model sequence of {} bytes at {} leaves the file of {} "
                        "bytes",
                        UINT64_MAX, load<uint64_t>(good, 32), size));
  EXPECT_EQ(changed([&](Bytes& b) { store<uint64_t>(b, 48, size + 1); }),
            fmt::format("offset 48: the model resource table of {} bytes at {} leaves the file of "
                        "{} bytes",
                        load<uint64_t>(good, 56), size + 1, size));
  EXPECT_EQ(changed([](Bytes& b) { store<uint64_t>(b, 16, 130); }),
            "offset 130: the module table does not begin at a multiple of 4");
  EXPECT_EQ(changed([](Bytes& b) { store<uint64_t>(b, 24, 3); }),
            "offset 128: the module table has 3 bytes, expected at least 4");
  EXPECT_EQ(changed([](Bytes& b) { store<uint32_t>(b, 128, 0x7fffffff); }),
            fmt::format("offset 128: the FlatBuffers structure of the module table is broken or "
                        "cut off ({} bytes)",
                        load<uint64_t>(good, 24)));
  EXPECT_EQ(changed([](Bytes& b) { store<uint64_t>(b, 72, 7); }),
            fmt::format("offset {}: the constants have 7 bytes, expected at least 8", constants));
  EXPECT_EQ(changed([](Bytes& b) { store<uint64_t>(b, 72, 8); }),
            fmt::format("offset {}: the constants have 8 bytes, expected at least 16", constants));
  EXPECT_EQ(changed([&](Bytes& b) { store<uint64_t>(b, constants + 8, UINT64_MAX / 24 + 2); }),
            fmt::format("offset {}: {} constants do not fit into the section of 104 bytes",
                        constants, UINT64_MAX / 24 + 2));
  EXPECT_EQ(changed([&](Bytes& b) { store<uint64_t>(b, constants + 24, UINT64_MAX); }),
            fmt::format("constant 0: {} bytes at 0 leave the payload of 40 bytes", UINT64_MAX));
  EXPECT_EQ(changed([&](Bytes& b) { store<uint64_t>(b, constants + 56, 41); }),
            "constant 1: 12 bytes at 41 leave the payload of 40 bytes");
  EXPECT_EQ(changed([&](Bytes& b) { b[constants + 6] = 'X'; }),
            fmt::format("offset {}: the FlatBuffers structure of the constants (without the tag "
                        "CONST00) is broken or cut off (104 bytes)",
                        constants));
}

TEST(Vgf, TablesThatLieAreRefused) {
  EXPECT_EQ(
      error_of(assemble(with_sequence([](flatbuffers::FlatBufferBuilder& builder) {
        const auto shape = builder.CreateVector(std::vector<uint32_t>{1, 2});
        const auto segment = vgf::CreateSegmentInfo(
            builder, vgf::ModuleType::GRAPH, builder.CreateString("s"), 0, 0, 0, 0, 0, shape);
        builder.Finish(vgf::CreateModelSequenceTable(builder, builder.CreateVector(&segment, 1)));
      }))),
      "segment 0 \"s\": the dispatch shape has 2 numbers, expected 3");
  std::array<Bytes, 4> parts = sections(must_write(everything()));
  {
    flatbuffers::FlatBufferBuilder builder;
    const auto entry =
        vgf::CreateModelResourceTableEntry(builder, 0, 0, vgf::ResourceCategory::INPUT, 0,
                                           vgf::ExtraConfig(2), builder.CreateString("?").Union());
    builder.Finish(vgf::CreateModelResourceTable(builder, builder.CreateVector(&entry, 1)));
    std::array<Bytes, 4> changed = parts;
    changed[2] = finished(builder);
    EXPECT_EQ(error_of(assemble(changed)),
              "resource 0: the extra configuration of type 2 is no sampler");
  }
  {
    flatbuffers::FlatBufferBuilder builder;
    const auto data = vgf::CreateConstantData(builder, 4, int64_t{1} << 32);
    builder.Finish(vgf::CreateConstantSection(builder, builder.CreateVector(&data, 1)));
    std::array<Bytes, 4> changed = parts;
    changed[3] = finished(builder);
    EXPECT_EQ(error_of(assemble(changed)),
              "constant 0: the sparsity dimension 4294967296 is no dimension");
  }
  {
    // One large module, a thousand times.
    flatbuffers::FlatBufferBuilder builder;
    const auto words = builder.CreateVector(std::vector<uint32_t>(100000, 0x07230203));
    const auto module =
        vgf::CreateModule(builder, vgf::ModuleType::GRAPH, 0, 0, vgf::ModuleCode::SPIRV,
                          vgf::CreateSPIRV(builder, words).Union());
    builder.Finish(vgf::CreateModuleTable(
        builder,
        builder.CreateVector(std::vector<flatbuffers::Offset<vgf::Module>>(1000, module))));
    std::array<Bytes, 4> changed = parts;
    changed[0] = finished(builder);
    const Bytes bytes = assemble(changed);
    EXPECT_EQ(error_of(bytes), fmt::format("the file refers to its parts so often that they grow "
                                           "to over 16 times its {} bytes",
                                           bytes.size()));
  }
}

TEST(Vgf, ContradictionsAreRefusedByName) {
  const std::pair<std::function<void(Vgf&)>, const char*> cases[] = {
      {[](Vgf& v) { v.modules[0].type = VgfModuleType(2); },
       "module 0 \"g\": module type 2 does not exist"},
      {[](Vgf& v) { v.modules[1].code = VgfCode(4); },
       "module 1 \"text\": code type 4 does not exist"},
      {[](Vgf& v) { v.modules[1].code = VgfCode::kSpirv; },
       "module 1 \"text\": holds code of another kind than SPIRV"},
      {[](Vgf& v) { v.modules[0].code = VgfCode::kNone; },
       "module 0 \"g\": holds code of another kind than NONE"},
      {[](Vgf& v) { v.modules[0].words[0] = 0x03022307; },
       "module 0 \"g\": holds no SPIR-V: found 5 words, the first 0x03022307"},
      {[](Vgf& v) { v.modules[0].words.resize(4); },
       "module 0 \"g\": holds no SPIR-V: found 4 words, the first 0x07230203"},
      {[](Vgf& v) { v.resources[0].category = VgfCategory(4); },
       "resource 0: category 4 does not exist"},
      {[](Vgf& v) { v.resources[1].strides.pop_back(); },
       "resource 1: has 3 strides, expected none or 4"},
      {[](Vgf& v) { v.resources[4].alias_group = 1; },
       "resource 4: is a constant in alias group 1, constants share no storage"},
      {[](Vgf& v) { v.resources[2].shape = {7}; },
       "resource 2: has 28 bytes, resource 1 of the same alias group 5 has 32"},
      {[](Vgf& v) { v.resources[1].strides[1] = 9; },
       "resource 2: has 32 bytes, resource 1 of the same alias group 5 has 35"},
      {[](Vgf& v) { v.constants[0].resource = 9; },
       "constant 0: resource 9 does not exist, there are 7"},
      {[](Vgf& v) { v.constants[0].resource = 3; },
       "constant 0: resource 3 is OUTPUT, expected CONSTANT"},
      {[](Vgf& v) { v.constants[0].sparsity_dimension = 2; },
       "constant 0: the sparsity dimension 2 is no dimension of rank 2"},
      {[](Vgf& v) { v.constants[1].sparsity_dimension = -2; },
       "constant 1: the sparsity dimension -2 is no dimension of rank 1"},
      {[](Vgf& v) { v.constants[1].bytes.pop_back(); },
       "constant 1: holds 11 bytes, R32_SINT[3] of resource 5 makes 12"},
      {[](Vgf& v) { v.resources[4].shape[0] = -1; },
       "constant 0: the shape [?,8] of resource 4 has no size"},
      {[](Vgf& v) {
         v.resources[4].shape = {INT64_MAX, INT64_MAX};
       },
       "constant 0: the shape [9223372036854775807,9223372036854775807] of resource 4 has no size"},
      {[](Vgf& v) { v.segments[0].module = 4; },
       "segment 0 \"network\": module 4 does not exist, there are 4"},
      {[](Vgf& v) { v.segments[0].type = VgfModuleType(7); },
       "segment 0 \"network\": segment type 7 does not exist"},
      {[](Vgf& v) { v.segments[1].type = VgfModuleType::kGraph; },
       "segment 1 \"pass\": has the type GRAPH, its module 1 is COMPUTE"},
      {[](Vgf& v) { v.segments[0].constants[1] = 2; },
       "segment 0 \"network\": constant 2 does not exist, there are 2"},
      {[](Vgf& v) { v.segments[1].push_constants[0].offset = 2; },
       "segment 1 \"pass\": the push constants, 8 bytes at 2, are no range of 32-bit words"},
      {[](Vgf& v) {
         v.segments[1].push_constants[0].size = 0xFFFFFFFC;
         v.segments[1].push_constants[0].offset = 8;
       },
       "segment 1 \"pass\": the push constants, 4294967292 bytes at 8, are no range of 32-bit "
       "words"},
      {[](Vgf& v) { v.segments[1].sets[1].set_index = 2; },
       "segment 1 \"pass\", set 1: the set number 2 is taken already"},
      {[](Vgf& v) { v.segments[1].sets[0].bindings[1].binding = 0; },
       "segment 1 \"pass\", set 0: the binding number 0 is taken already"},
      {[](Vgf& v) { v.segments[1].sets[0].bindings[1].resource = 7; },
       "segment 1 \"pass\", set 0, slot 1: resource 7 does not exist, there are 7"},
      {[](Vgf& v) { v.segments[1].sets[0].bindings[1].resource = 4; },
       "segment 1 \"pass\", set 0, slot 1: binds resource 4, a constant"},
      {[](Vgf& v) { v.segments[0].inputs[0].binding = 5; },
       "segment 0 \"network\", input 0: binding 5 of resource 0 is in no set of the segment"},
      {[](Vgf& v) {
         v.segments[0].outputs[0] = {0, 0};
       },
       "segment 0 \"network\", output 0: writes resource 0, an input of the model"},
      {[](Vgf& v) { v.inputs[0].resource = 3; },
       "model input 0: resource 3 is OUTPUT, expected INPUT"},
      {[](Vgf& v) { v.outputs[0].resource = 8; },
       "model output 0: resource 8 does not exist, there are 7"},
      {[](Vgf& v) { v.input_names.pop_back(); }, "model input: has 1 names for 2 slots"},
      {[](Vgf& v) { v.output_names.push_back("z"); }, "model output: has 2 names for 1 slots"},
  };
  for (const auto& [change, expected] : cases) {
    Vgf vgf = everything();
    change(vgf);
    const Result<void> checked = check_vgf(vgf);
    EXPECT_EQ(checked ? "accepted" : checked.error().text(), expected);
    EXPECT_FALSE(write_vgf(vgf)) << expected;
  }
}

TEST(Vgf, SparsityIsCheckedAlongItsDimension) {
  Vgf vgf = everything();
  EXPECT_TRUE(check_sparsity(vgf, 0));
  EXPECT_TRUE(check_sparsity(vgf, 1)) << "a dense constant claims nothing";
  vgf.constants[0].bytes[20] = vgf.constants[0].bytes[21] = 1;
  EXPECT_EQ(check_sparsity(vgf, 0).error().text(),
            "constant 0: is marked 2:4 sparse along dimension 1, but 3 of the four elements from "
            "[2,4] on are not zero");
  vgf.constants[0].sparsity_dimension = 0;
  EXPECT_EQ(check_sparsity(vgf, 0).error().text(),
            "constant 0: is marked 2:4 sparse along dimension 0, whose 3 elements are no multiple "
            "of 4");
  // Along the outer dimension the four lie apart.
  vgf.resources[4].shape = {4, 6};
  vgf.constants[0].bytes.assign(24, 0);
  for (const size_t i : {1u, 7u, 2u, 20u, 3u, 15u}) vgf.constants[0].bytes[i] = 1;
  EXPECT_TRUE(check_sparsity(vgf, 0));
  vgf.constants[0].bytes[19] = 1;
  EXPECT_EQ(check_sparsity(vgf, 0).error().text(),
            "constant 0: is marked 2:4 sparse along dimension 0, but 3 of the four elements from "
            "[0,1] on are not zero");
}

TEST(Vgf, TheListingShowsEveryPart) {
  VgfLayout layout;
  const Vgf vgf = *read_vgf(must_write(everything()), &layout);
  const std::string text = dump_vgf(vgf, &layout);
  for (const char* part :
       {"VGF 0.4.3, Vulkan header 359", "sections, magic VGF1:", "bytes at 128",
        "0 GRAPH \"g\", entry point \"main\", SPIRV, 5 words, version 0x00010600, bound 8",
        "1 COMPUTE \"text\", entry point \"main\", GLSL, 15 characters:", "\"void main() {}\"",
        "3 COMPUTE \"later\", entry point \"main\", SPIRV, a placeholder",
        "0 INPUT        R8_SINT[1,?,4,2] descriptor TENSOR_ARM\n",
        "R8_SINT[1,4,4,2] descriptor TENSOR_ARM strides [32,8,2,1] alias group 5",
        "sampler: min filter 1, mag filter 0, address mode u 2, address mode v 3, border color 4",
        "0 resource 4, 24 bytes at 0, 2:4 sparse along dimension 1, begins 09000009",
        "1 resource 5, 12 bytes at 24, dense", "1 COMPUTE \"pass\", module 1, dispatch 4x2x1",
        "set 0 (by position) 0: resource 0, 1: resource 1", "set 4 0: resource 6", "constants 0, 1",
        "push constants: 4 bytes at 8, stages 0x20",
        "model inputs  0: resource 0 \"x\", 1: resource 6 \"lut\"",
        "model outputs 7: resource 3 \"y\""})
    EXPECT_NE(text.find(part), std::string::npos) << part << "\nis not in\n" << text;
  Vgf evil = everything();
  evil.modules[0].name = "\x1b[2J";
  EXPECT_EQ(dump_vgf(evil, nullptr).find('\x1b'), std::string::npos);
}

}  // namespace
}  // namespace shale
