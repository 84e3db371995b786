#include "ir/package/package.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <random>

#include "ir/base/file.h"
#include "ir/package/pack.h"
#include "ir/schema/package_generated.h"

namespace shale {
namespace {

constexpr uint64_t kSeed = 7;

Resource tensor(std::string name, Category category, DType dtype, std::vector<int64_t> shape,
                uint64_t offset) {
  Resource r;
  r.name = std::move(name);
  r.category = category;
  r.dtype = dtype;
  r.shape = std::move(shape);
  r.offset_bytes = offset;
  r.size_bytes = dtype_info(dtype).host_bytes;
  for (const int64_t extent : r.shape) r.size_bytes *= static_cast<uint64_t>(extent);
  return r;
}

Resource image(std::string name, Category category, ImageFormat format, uint32_t depth) {
  Resource r;
  r.name = std::move(name);
  r.category = category;
  r.format = format;
  r.width = 16;
  r.height = 8;
  r.history_depth = depth;
  return r;
}

/// A pass that feeds a graph of two dispatches, and a program that shows what they left; every kind
/// of resource and of binding to shaders occurs.
Package sample_package() {
  enum : uint32_t { kX, kMid, kWeight, kY, kColor, kHistory, kShown, kScratch, kPast };
  Variant v;
  v.target = "any";
  v.arena_bytes = 1024;
  v.resources = {tensor("x", Category::kInput, DType::kInt8, {1, 8, 16, 4}, 0),
                 tensor("mid", Category::kIntermediate, DType::kInt8, {1, 8, 16, 4}, 512),
                 tensor("w", Category::kWeights, DType::kInt32, {16}, 256),
                 tensor("y", Category::kOutput, DType::kInt8, {1, 8, 16, 4}, 0),
                 image("color", Category::kImageInput, ImageFormat::kRgba16Float, 0),
                 image("history", Category::kImageHistory, ImageFormat::kRgba8Unorm, 3),
                 image("shown", Category::kImageOutput, ImageFormat::kRgba8Unorm, 0),
                 image("scratch", Category::kImageInternal, ImageFormat::kR32Uint, 0),
                 tensor("past", Category::kOutput, DType::kInt8, {2, 3}, 0)};
  v.resources[kPast].history_depth = 2;
  v.resources[kX].quantization = Quantization{0.5f, -3};
  const auto storage = BindingType::kStorageBuffer;
  const auto texel = BindingType::kUniformTexelBuffer;
  const auto sampled = BindingType::kSampledImage;
  const auto stored = BindingType::kStorageImage;
  const auto none = ImageFormat::kNone;
  const Dispatch pack{"pack",
                      "pre",
                      0,
                      {1, 2, 3},
                      {{0, sampled, kColor, none, true, false, 0},
                       {1, sampled, kHistory, none, true, false, 2},
                       {2, stored, kScratch, none, false, true, 0},
                       {4, BindingType::kSampler, kColor, none, true, false, 0},
                       {9, storage, kX, none, false, true, 0}},
                      {}};
  const Dispatch conv1{"conv1",
                       "conv2d_s8_f32exact",
                       1,
                       {4, 1, 1},
                       {{0, texel, kX, ImageFormat::kRgba8Sint, true, false, 0},
                        {1, storage, kWeight, none, true, false, 0},
                        {2, storage, kMid, none, false, true, 0}},
                       {1000, 20, 300, 40, 5.5}};
  const Dispatch conv2{"conv2",
                       "conv2d_s8_f32exact",
                       1,
                       {4, 1, 1},
                       {{0, texel, kMid, ImageFormat::kR8Sint, true, false, 0},
                        {5, storage, kPast, none, false, true, 0},
                        {63, storage, kY, none, true, true, 0}},
                       {}};
  const Dispatch show{"show",
                      "post",
                      0,
                      {1, 1, 1},
                      {{0, storage, kY, none, true, false, 0},
                       {1, stored, kHistory, none, false, true, 0},
                       {2, stored, kShown, none, false, true, 0}},
                      {}};
  const Dispatch conv3{
      "conv3",
      "conv2d_s8_f32exact",
      1,
      {4, 1, 1},
      {{0, storage, kPast, none, true, false, 1}, {1, storage, kY, none, false, true, 0}},
      {}};
  v.segments = {{"pre", SegmentKind::kCompute, {pack}},
                {"network", SegmentKind::kGraph, {conv1, conv2}},
                {"post", SegmentKind::kCompute, {show}},
                {"network_again", SegmentKind::kGraph, {conv3}, 1}};
  v.programs = {"frame", "again"};
  v.chosen_by = "jitter";
  v.choices = {0.25f, -0.5f, 0, 0.5f};
  v.device_class = DeviceClass::kDot8Gpu;
  v.modules = {{0x07230203, 0x10000, 0, 9, 0}, {0x07230203, 0x10000, 0, 9, 0, 7}};
  v.proofs = {{"conv1", {-5, -6}, {5, 6}, {10, 12}}};
  v.params = {{"jitter", false, 2, 8, ParamSource::kHost, {0.25f, -0.5f}},
              {"reset", true, 1, 16, ParamSource::kReset, {0}}};
  v.views = {{"colour", kX, 1, 3, 0, 1}, {"past", kHistory, 3, 1, 1, -1}};
  v.requirements = binding_requirements(v);
  v.requirements.features.add(Feature::kInt8);
  Package p;
  p.provenance = {0x1234567890abcdef, "sample", "shale 0.1.0", "target=any"};
  p.variants = {v};
  p.weights.resize(321);
  for (size_t i = 0; i < p.weights.size(); ++i) p.weights[i] = static_cast<uint8_t>(i * 7);
  return p;
}

/// sample_package behind a copy of its input image into a linear one, and with another that is
/// cleared and read.
Package linear_package() {
  Package p = sample_package();
  Variant& v = p.variants[0];
  Resource raw = image("raw", Category::kImageInternal, ImageFormat::kRgba16Float, 0);
  raw.size_bytes = 8 * 128;  // 8 rows of 16 texels of 8 bytes
  Resource kept = image("kept", Category::kImageHistory, ImageFormat::kR32Uint, 2);
  kept.size_bytes = 8 * 64;
  v.resources.push_back(raw);
  v.resources.push_back(kept);
  const auto none = ImageFormat::kNone;
  const auto transfer = BindingType::kTransfer;
  const Dispatch take{
      "take",
      "copy",
      0,
      {1, 1, 1},
      {{0, transfer, 4, none, true, false, 0}, {1, transfer, 9, none, false, true, 0}},
      {}};
  const Dispatch empty{"empty", "clear", 0, {1, 1, 1}, {{0, transfer, 10, none, false, true, 0}},
                       {}};
  v.segments.insert(v.segments.begin(), {"transfers", SegmentKind::kTransfer, {take, empty}});
  v.segments[1].dispatches[0].bindings.push_back(
      {3, BindingType::kUniformTexelBuffer, 9, ImageFormat::kRgba32Uint, true, false, 0});
  v.segments[1].dispatches[0].bindings.push_back(
      {5, BindingType::kStorageBuffer, 10, none, false, true, 0});
  v.requirements = binding_requirements(v);
  return p;
}

/// sample_package whose first network works by tiles: resources 9 and 10 are its changes and its work.
Package tiles_package() {
  Package p = sample_package();
  Variant& v = p.variants[0];
  v.resources.push_back(tensor("changes", Category::kIntermediate, DType::kInt32, {3}, 0));
  v.resources.push_back(tensor("work", Category::kIntermediate, DType::kInt32, {16}, 256));
  v.segments[1].tiles = Tiles{9, 10, 2};
  v.segments[1].dispatches[0].indirect = IndirectGrid{10, 4};
  v.segments[1].dispatches[0].bindings.push_back(
      {7, BindingType::kStorageBuffer, 10, ImageFormat::kNone, true, false, 0});
  v.requirements = binding_requirements(v);
  v.requirements.features.add(Feature::kInt8);
  return p;
}

std::string refusal(std::span<const uint8_t> bytes) {
  const Result<Package> result = read_package(bytes);
  return result ? "accepted" : result.error().text();
}

TEST(Package, ComesBackAsItWasWritten) {
  const Package package = sample_package();
  const std::vector<uint8_t> bytes = write_package(package);
  EXPECT_TRUE(is_package(bytes));
  const Result<Package> read = read_package(bytes);
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(*read, package);
}

TEST(Package, HasTheSameBytesEveryTime) {
  EXPECT_EQ(write_package(sample_package()), write_package(sample_package()));
  const std::vector<uint8_t> bytes = write_package(sample_package());
  EXPECT_EQ(write_package(read_package(bytes).value()), bytes);
}

TEST(Package, IsReadFromAnyAddress) {
  const std::vector<uint8_t> bytes = write_package(sample_package());
  std::vector<uint8_t> shifted(bytes.size() + 1);
  std::copy(bytes.begin(), bytes.end(), shifted.begin() + 1);
  EXPECT_EQ(refusal(std::span(shifted).subspan(1)), "accepted");
}

TEST(Package, IsRefusedWhenCutAnywhere) {
  const std::vector<uint8_t> bytes = write_package(sample_package());
  for (size_t size = 0; size < bytes.size(); ++size) {
    const std::vector<uint8_t> cut(bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(size));
    ASSERT_FALSE(read_package(cut)) << "cut to " << size << " bytes";
  }
  Package empty_weights = sample_package();
  empty_weights.weights.clear();
  empty_weights.variants[0].resources[2] =
      tensor("w", Category::kIntermediate, DType::kInt8, {1}, 0);
  const std::vector<uint8_t> small = write_package(empty_weights);
  ASSERT_TRUE(read_package(small));
  for (size_t size = 0; size < small.size(); ++size)
    ASSERT_FALSE(read_package(std::span(small).first(size))) << "cut to " << size << " bytes";
}

TEST(Package, StaysConsistentUnderFlippedBytes) {
  const std::vector<uint8_t> bytes = write_package(sample_package());
  for (size_t i = 0; i < bytes.size(); ++i) {
    for (const int flip : {0x01, 0x80, 0xff}) {
      std::vector<uint8_t> damaged = bytes;
      damaged[i] = static_cast<uint8_t>(damaged[i] ^ flip);
      const Result<Package> read = read_package(damaged);
      if (read) {
        EXPECT_TRUE(check_package(*read));
        EXPECT_FALSE(dump_package(*read).empty());
      } else {
        EXPECT_FALSE(read.error().message.empty());
      }
    }
  }
}

TEST(Package, StaysConsistentUnderManyFlippedBytes) {
  const std::vector<uint8_t> bytes = write_package(sample_package());
  std::mt19937_64 random(kSeed);
  for (int round = 0; round < 5000; ++round) {
    std::vector<uint8_t> damaged = bytes;
    for (int k = 0; k < 6; ++k) damaged[random() % damaged.size()] = static_cast<uint8_t>(random());
    const Result<Package> read = read_package(damaged);
    ASSERT_TRUE(!read || check_package(*read)) << "seed " << kSeed << " round " << round;
  }
}

TEST(Package, RefusesForeignFiles) {
  EXPECT_FALSE(is_package({}));
  const std::vector<uint8_t> text(100, 'a');
  EXPECT_FALSE(is_package(text));
  EXPECT_EQ(refusal(text), "is no .shale package: the identifier is missing");
}

TEST(Package, RefusesOtherMajorVersions) {
  std::vector<uint8_t> bytes = write_package(sample_package());
  auto* root = flatbuffers::GetMutableRoot<flatbuffers::Table>(bytes.data());
  ASSERT_TRUE(root->SetField<uint32_t>(fbs::Version::VT_MAJOR_VERSION, kPackageMajor + 1, 0));
  const Result<Package> newer = read_package(bytes);
  ASSERT_FALSE(newer);
  EXPECT_EQ(newer.error().code, ErrorCode::kUnsupported);
  EXPECT_EQ(newer.error().message, "package version 2.9 is newer than 1.9, which this build reads");
  ASSERT_TRUE(root->SetField<uint32_t>(fbs::Version::VT_MAJOR_VERSION, 0, 1));
  EXPECT_EQ(refusal(bytes), "package version 0.9 does not exist");
}

TEST(Package, AcceptsNewerMinorVersions) {
  // The version is accepted: what is missed is the content.
  flatbuffers::FlatBufferBuilder builder;
  builder.Align(8);
  const auto empty = builder.CreateString("");
  const auto provenance = fbs::CreateProvenance(builder, 0, empty, empty, empty);
  const auto variants = builder.CreateVector(std::vector<flatbuffers::Offset<fbs::Variant>>());
  const auto weights = builder.CreateVector(std::vector<uint8_t>());
  fbs::FinishPackageBuffer(builder,
                           fbs::CreatePackage(builder, 1, 77, provenance, variants, weights));
  EXPECT_EQ(refusal({builder.GetBufferPointer(), builder.GetSize()}), "the package has no variant");
}

/// What the reader says of a package that nobody wrote: a variant of these modules, `count` times the same one.
std::string refusal_of(flatbuffers::FlatBufferBuilder& builder,
                       const std::vector<flatbuffers::Offset<fbs::Module>>& modules, size_t count) {
  const auto text = builder.CreateString("x");
  const auto all = builder.CreateVector(modules);
  const auto resources = builder.CreateVector(std::vector<flatbuffers::Offset<fbs::Resource>>());
  const auto segments = builder.CreateVector(std::vector<flatbuffers::Offset<fbs::Segment>>());
  const auto proofs = builder.CreateVector(std::vector<flatbuffers::Offset<fbs::RangeProof>>());
  const auto variant = fbs::CreateVariant(builder, text, fbs::CreateRequirements(builder), 0,
                                          resources, segments, all, proofs);
  const auto variants =
      builder.CreateVector(std::vector<flatbuffers::Offset<fbs::Variant>>(count, variant));
  const auto weights = builder.CreateVector(std::vector<uint8_t>());
  fbs::FinishPackageBuffer(
      builder,
      fbs::CreatePackage(builder, kPackageMajor, kPackageMinor,
                         fbs::CreateProvenance(builder, 0, text, text, text), variants, weights));
  return refusal({builder.GetBufferPointer(), builder.GetSize()});
}

TEST(Package, RefusesPartsThatOverlap) {
  // Every module leads to the same words: verified, but copying would multiply the file.
  flatbuffers::FlatBufferBuilder builder;
  builder.Align(8);
  Spirv words(1000, 0);
  words[0] = 0x07230203;
  const auto module = fbs::CreateModule(builder, builder.CreateVector(words));
  EXPECT_EQ(refusal_of(builder, std::vector(1000, module), 100),
            "the package is damaged: parts of it overlap");
}

TEST(Package, PacksModules) {
  Package package = sample_package();
  Spirv& words = package.variants[0].modules[1];
  words.resize(5);
  std::mt19937_64 random(kSeed);
  for (uint32_t i = 0; i < 2000; ++i)
    words.insert(words.end(),
                 {5u << 16 | 133, 6, 1000 + i, 900, static_cast<uint32_t>(random() % 250)});
  std::vector<uint8_t> bytes = write_package(package);
  EXPECT_LT(bytes.size(), words.size() * sizeof(uint32_t) / 4);
  const Result<Package> read = read_package(bytes);
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(*read, package);

  const auto* module = fbs::GetPackage(bytes.data())->variants()->Get(0)->modules()->Get(1);
  auto* table = reinterpret_cast<flatbuffers::Table*>(const_cast<fbs::Module*>(module));
  const auto count = static_cast<uint32_t>(words.size());
  ASSERT_TRUE(table->SetField<uint32_t>(fbs::Module::VT_WORD_COUNT, count + 1, 0));
  EXPECT_EQ(refusal(bytes), fmt::format("variant 0, module 1: the packed module is damaged: its "
                                        "columns do not make {} words",
                                        count + 1));
  const auto most = static_cast<uint32_t>(module->packed()->size() * kMaxPacking / 4);
  ASSERT_TRUE(table->SetField<uint32_t>(fbs::Module::VT_WORD_COUNT, most + 1, 0));
  EXPECT_EQ(refusal(bytes), fmt::format("variant 0, module 1: {} packed bytes cannot hold {} "
                                        "words: 5 to {} are expected",
                                        module->packed()->size(), most + 1, most));
  ASSERT_TRUE(table->SetField<uint32_t>(fbs::Module::VT_WORD_COUNT, UINT32_MAX, 0));
  EXPECT_EQ(refusal(bytes),
            "variant 0, module 1: the package's modules have 17179869180 bytes, at most "
            "2147483640 are expected");
  ASSERT_TRUE(table->SetField<uint32_t>(fbs::Module::VT_WORD_COUNT, count, 0));
  auto* packed = const_cast<uint8_t*>(module->packed()->data());
  packed[module->packed()->size() / 2] ^= 0xff;
  EXPECT_TRUE(refusal(bytes).starts_with("variant 0, module 1: the packed module is damaged: "));
}

TEST(Package, RefusesWordsBesidePackedOnes) {
  flatbuffers::FlatBufferBuilder builder;
  builder.Align(8);
  const auto words = builder.CreateVector(Spirv{0x07230203, 0, 0, 0, 0});
  const auto packed = builder.CreateVector(std::vector<uint8_t>(8, 1));
  EXPECT_EQ(refusal_of(builder, {fbs::CreateModule(builder, words, packed, 5)}, 1),
            "variant 0, module 0: has 5 words beside packed ones, 0 are expected");
}

/// Sets the minor version of a written package.
void set_minor(std::vector<uint8_t>& bytes, uint32_t minor) {
  auto* root = flatbuffers::GetMutableRoot<flatbuffers::Table>(bytes.data());
  ASSERT_TRUE(root->SetField<uint32_t>(fbs::Version::VT_MINOR_VERSION, minor, 0));
}

struct OldFile {
  const char* version;
  const char* target;
  DeviceClass device_class;
};

/// Small frames as the writers of those versions wrote them; frame_loop_test runs them.
TEST(OldPackages, AreReadAndCompleted) {
  for (const OldFile& file : {OldFile{"1.0", "lavapipe", DeviceClass::kCpu},
                              OldFile{"1.1", "dot8-gpu", DeviceClass::kDot8Gpu},
                              OldFile{"1.2", "coopmat-gpu", DeviceClass::kMatrixGpu},
                              OldFile{"1.3", "any", DeviceClass::kAny}}) {
    const auto bytes =
        read_file(fmt::format("{}/tests/ir/packages/{}.shale", SHALE_SOURCE_DIR, file.version));
    ASSERT_TRUE(bytes) << bytes.error().text();
    const auto version = flatbuffers::GetRoot<fbs::Version>(bytes->data());
    EXPECT_EQ(fmt::format("{}.{}", version->major_version(), version->minor_version()),
              file.version);
    const Result<Package> package = read_package(*bytes);
    ASSERT_TRUE(package) << file.version << ": " << package.error().text();
    const Variant& v = package->variants.at(0);
    EXPECT_EQ(v.target, file.target);
    EXPECT_EQ(v.device_class, file.device_class);
    EXPECT_EQ(v.programs, std::vector<std::string>{"frame"});
    EXPECT_EQ(program_segments(v, 0).size(), 3u);
    EXPECT_EQ(v.resources.at(5).name, "history");
    const Result<Package> again = read_package(write_package(*package));
    ASSERT_TRUE(again);
    EXPECT_EQ(*again, *package);
  }
}

TEST(OldPackages, NeedTheFormatsThatTheyStore) {
  Package package = sample_package();
  Variant& v = package.variants[0];
  v.resources[6].format = ImageFormat::kR8Unorm;  // "shown"
  std::vector<uint8_t> bytes = write_package(package);
  EXPECT_EQ(
      refusal(bytes),
      "variant 0: the requirements lack shaderStorageImageExtendedFormats, which the bindings "
      "need");
  set_minor(bytes, 3);
  const Result<Package> old = read_package(bytes);
  ASSERT_TRUE(old) << old.error().text();
  v.requirements.features.add(Feature::kStorageImageExtended);
  EXPECT_EQ(old->variants[0].requirements, v.requirements);
}

TEST(OldPackages, HadMatricesOfOneShape) {
  Package package = sample_package();
  Requirements& needs = package.variants[0].requirements;
  needs.features.add(Feature::kCooperativeMatrix);
  needs.subgroup_size = 64;
  needs.matrix_products = {{8, 8, 32}, {16, 16, 16}};
  std::vector<uint8_t> bytes = write_package(package);
  const Result<Package> same = read_package(bytes);
  ASSERT_TRUE(same) << same.error().text();
  EXPECT_EQ(same->variants[0].requirements, needs);
  EXPECT_NE(dump_package(*same).find("matrices of 16x16x16 int8 in subgroups of 64"),
            std::string::npos);
  set_minor(bytes, 3);
  const Result<Package> old = read_package(bytes);
  ASSERT_TRUE(old) << old.error().text();
  needs.subgroup_size = 32;
  needs.matrix_products = {{16, 16, 32}};
  EXPECT_EQ(old->variants[0].requirements, needs);
}

TEST(Package, HasNetworksThatWorkByTiles) {
  const Package package = tiles_package();
  const Result<Package> read = read_package(write_package(package));
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(*read, package);
  const std::string dump = dump_package(*read);
  EXPECT_NE(dump.find("works by tiles: changes in \"changes\", work in \"work\", tolerance 2"),
            std::string::npos);
  EXPECT_NE(dump.find("as many as words 4..6 of \"work\" say"), std::string::npos);
}

/// sample_package with a start form of the first network's first dispatch.
Package start_package() {
  Package p = sample_package();
  Segment& segment = p.variants[0].segments[1];
  StartForm start{0, segment.dispatches[0]};
  start.form.kernel = "conv2d_s8_loop";
  start.form.workgroups = {7, 1, 1};
  segment.start_forms.push_back(start);
  return p;
}

TEST(Package, KeepsStartForms) {
  const Package package = start_package();
  const Result<Package> read = read_package(write_package(package));
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(*read, package);
  EXPECT_NE(dump_package(package).find("start of \"conv1\": conv2d_s8_loop"), std::string::npos);
}

TEST(Package, RefusesStartFormsThatDoSomethingElse) {
  const auto refused = [](const std::function<void(Segment&, Variant&)>& damage) {
    Package package = start_package();
    damage(package.variants[0].segments[1], package.variants[0]);
    return refusal(write_package(package));
  };
  EXPECT_EQ(refused([](Segment&, Variant&) {}), "accepted");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.start_forms[0].dispatch = 2; }),
            "variant 0, segment 1: start form 0: dispatch 2 does not exist, or is out of order");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.start_forms.push_back(s.start_forms[0]); }),
            "variant 0, segment 1: start form 1: dispatch 0 does not exist, or is out of order");
  EXPECT_EQ(
      refused([](Segment& s, Variant&) { s.start_forms[0].form.name = "other"; }),
      "variant 0, segment 1, start form of \"conv1\": has another name, or a grid of the device");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.start_forms[0].form.module = 99; }),
            "variant 0, segment 1, start form of \"conv1\": module 99 does not exist, there are 2");
  EXPECT_EQ(refused([](Segment& s, Variant&) {
              std::erase_if(s.start_forms[0].form.bindings,
                            [](const Binding& binding) { return binding.writes; });
            }),
            "variant 0, segment 1, start form of \"conv1\": reads or writes other tensors than the "
            "dispatch");
  EXPECT_EQ(refused([](Segment& s, Variant& v) { v.segments[0].start_forms = s.start_forms; }),
            "variant 0, segment 0: has start forms, which only graph segments without tiles can");
}

TEST(Package, TellsHowMuchOfANetworkRan) {
  Package package = tiles_package();
  Segment& segment = package.variants[0].segments[1];
  segment.dispatches[0].cost.time_us = 6;
  segment.dispatches[1].cost.time_us = 2;  // without a command
  EXPECT_EQ(indirect_grids({&segment, 1}), (std::vector<IndirectGrid>{{10, 4}}));
  const auto share = [&](uint32_t cells) {
    return share_run({&segment, 1}, std::array<uint32_t, 3>{cells, 1, 1});
  };
  EXPECT_DOUBLE_EQ(share(0), 0.25);
  EXPECT_DOUBLE_EQ(share(2), 0.625);
  EXPECT_DOUBLE_EQ(share(4), 1);
}

TEST(Package, RefusesTilesThatLeadNowhere) {
  const auto refused = [](const std::function<void(Segment&, Variant&)>& damage) {
    Package package = tiles_package();
    damage(package.variants[0].segments[1], package.variants[0]);
    return refusal(write_package(package));
  };
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.tiles->changes = 11; }),
            "variant 0, segment 1: resource 11 of its tiles does not exist, there are 11");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.tiles->work = 0; }),
            "variant 0, segment 1: \"x\" of its tiles is no intermediate tensor of INT32");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.tiles->changes = 1; }),
            "variant 0, segment 1: \"mid\" of its tiles is no intermediate tensor of INT32");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.tiles->tolerance = 256; }),
            "variant 0, segment 1: a tolerance of 256 codes is above 255");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.tiles.reset(); }),
            "variant 0, dispatch \"conv1\": grid: \"work\" is not the work of its segment's tiles");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.dispatches[0].indirect->first = 14; }),
            "variant 0, dispatch \"conv1\": grid: words 14 to 16 leave the 16 of \"work\"");
  EXPECT_EQ(refused([](Segment& s, Variant&) { s.dispatches[0].indirect->first = UINT32_MAX; }),
            "variant 0, dispatch \"conv1\": grid: words 4294967295 to 4294967297 leave the 16 of "
            "\"work\"");
  EXPECT_EQ(refused([](Segment&, Variant& v) {
              v.segments[0].tiles = Tiles{9, 10, 0};
            }),
            "variant 0, segment 0: works by tiles, which only graph segments can");
}

struct BadPackage {
  const char* name;
  std::function<void(Package&)> damage;
  const char* message;
};

void PrintTo(const BadPackage& c, std::ostream* out) { *out << c.name; }

class EveryBadPackage : public testing::TestWithParam<BadPackage> {};

TEST_P(EveryBadPackage, IsRefusedWithTheReason) {
  Package package = sample_package();
  GetParam().damage(package);
  EXPECT_EQ(refusal(write_package(package)), GetParam().message);
}

Variant& variant(Package& p) { return p.variants[0]; }
Resource& resource(Package& p, size_t i) { return p.variants[0].resources[i]; }
Dispatch& dispatch(Package& p, size_t segment, size_t i) {
  return p.variants[0].segments[segment].dispatches[i];
}
/// The second program, which writes what the first one reads.
void make_generator(Variant& v) {
  v.chosen_by.clear();
  v.choices.clear();
  v.generator = Generator{1, 0, 1};
}
template <typename T>
T number(uint32_t n) {
  return static_cast<T>(n);
}

const BadPackage kBadPackages[] = {
    {"NoVariant", [](Package& p) { p.variants.clear(); }, "the package has no variant"},
    {"ControlCharacterInProvenance", [](Package& p) { p.provenance.options = "a\x1b[0m"; },
     "provenance: has control characters"},
    {"EmptyTarget", [](Package& p) { variant(p).target.clear(); },
     "variant 0: the target name is empty"},
    {"HugeArena", [](Package& p) { variant(p).arena_bytes = uint64_t{1} << 40; },
     "variant 0: an arena of 1099511627776 bytes is not below 1099511627776"},
    {"SecondVariantIsChecked",
     [](Package& p) {
       p.variants.push_back(p.variants[0]);
       p.variants[1].modules[0][0] = 1;
     },
     "variant 1, module 0: holds no SPIR-V"},
    {"EmptyResourceName", [](Package& p) { resource(p, 1).name.clear(); },
     "variant 0, resource 1: the resource name is empty"},
    {"NulInResourceName", [](Package& p) { resource(p, 1).name = std::string("a\0b", 3); },
     "variant 0, resource 1: the resource name has control characters"},
    {"ResourceNameIsNoUtf8", [](Package& p) { resource(p, 1).name = "a\xff"; },
     "variant 0, resource 1: the resource name has bytes that are no UTF-8"},
    {"ResourceNameTwice", [](Package& p) { resource(p, 1).name = "x"; },
     "variant 0, resource 1: the resource name \"x\" is taken already"},
    {"Category", [](Package& p) { resource(p, 1).category = number<Category>(8); },
     "variant 0, resource \"mid\": category 8 does not exist"},
    {"ElementType", [](Package& p) { resource(p, 1).dtype = number<DType>(13); },
     "variant 0, resource \"mid\": element type 13 does not exist"},
    {"TensorWithoutType", [](Package& p) { resource(p, 1).dtype = DType::kUnknown; },
     "variant 0, resource \"mid\": a tensor cannot have the element type UNKNOWN"},
    {"ShapeTensor", [](Package& p) { resource(p, 1).dtype = DType::kShape; },
     "variant 0, resource \"mid\": a tensor cannot have the element type SHAPE"},
    {"Rank", [](Package& p) { resource(p, 1).shape = {1, 1, 1, 1, 1, 1, 512}; },
     "variant 0, resource \"mid\": rank 7 is above 6"},
    {"ZeroExtent", [](Package& p) { resource(p, 1).shape[2] = 0; },
     "variant 0, resource \"mid\": extent 0 is below 1"},
    {"NegativeExtent",
     [](Package& p) {
       resource(p, 1).shape = {-8, -64};
     },
     "variant 0, resource \"mid\": extent -8 is below 1"},
    {"OverflowingShape",
     [](Package& p) {
       resource(p, 1).shape = {int64_t{1} << 32, int64_t{1} << 32};
       resource(p, 1).size_bytes = 0;
     },
     "variant 0, resource \"mid\": the tensor is larger than 1099511627776 bytes"},
    {"SizeAgainstShape", [](Package& p) { resource(p, 1).size_bytes = 511; },
     "variant 0, resource \"mid\": size is 511 bytes, the shape makes 512"},
    {"ZeroScale", [](Package& p) { resource(p, 0).quantization->scale = 0; },
     "variant 0, resource \"x\": scale 0 is not a positive number"},
    {"ScaleNoNumber", [](Package& p) { resource(p, 0).quantization->scale = NAN; },
     "variant 0, resource \"x\": scale nan is not a positive number"},
    {"TensorWithExtent", [](Package& p) { resource(p, 0).width = 1; },
     "variant 0, resource \"x\": a tensor has image fields"},
    {"IntermediateHistory", [](Package& p) { resource(p, 1).history_depth = 2; },
     "variant 0, resource \"mid\": only inputs and outputs can be histories"},
    {"TensorHistoryOfOne", [](Package& p) { resource(p, 8).history_depth = 1; },
     "variant 0, resource \"past\": history depth 1 is outside 2..16"},
    {"ArenaOffsetUnaligned", [](Package& p) { resource(p, 1).offset_bytes = 128; },
     "variant 0, resource \"mid\": offset 128 is no multiple of 256"},
    {"ArenaRange", [](Package& p) { resource(p, 1).offset_bytes = 768; },
     "variant 0, resource \"mid\": bytes 768 to 768 + 512 leave the arena of 1024 bytes"},
    {"ArenaRangeWrapsAround", [](Package& p) { resource(p, 1).offset_bytes = ~uint64_t{255}; },
     "variant 0, resource \"mid\": bytes 18446744073709551360 to 18446744073709551360 + 512 leave "
     "the arena of 1024 bytes"},
    {"WeightRange", [](Package& p) { p.weights.resize(300); },
     "variant 0, resource \"w\": bytes 256 to 256 + 64 leave the weights of 300 bytes"},
    {"InputOffset", [](Package& p) { resource(p, 0).offset_bytes = 256; },
     "variant 0, resource \"x\": a tensor bound by the caller has offset 256"},
    {"ImageFormatNumber", [](Package& p) { resource(p, 4).format = number<ImageFormat>(16); },
     "variant 0, resource \"color\": image format 16 does not exist"},
    {"ImageFormatOfTexels", [](Package& p) { resource(p, 4).format = ImageFormat::kR8Sint; },
     "variant 0, resource \"color\": an image cannot have the format r8_sint"},
    {"ImageWithoutExtent", [](Package& p) { resource(p, 4).height = 0; },
     "variant 0, resource \"color\": extent 16x0 is outside 1..16384"},
    {"ImageTooWide", [](Package& p) { resource(p, 4).width = 16385; },
     "variant 0, resource \"color\": extent 16385x8 is outside 1..16384"},
    {"ImageWithShape", [](Package& p) { resource(p, 4).shape = {1}; },
     "variant 0, resource \"color\": an image has tensor fields"},
    {"HistoryOfNone", [](Package& p) { resource(p, 5).history_depth = 0; },
     "variant 0, resource \"history\": history depth 0 is outside 1..16"},
    {"EndlessHistory", [](Package& p) { resource(p, 5).history_depth = 17; },
     "variant 0, resource \"history\": history depth 17 is outside 1..16"},
    {"HistoryDepthElsewhere", [](Package& p) { resource(p, 4).history_depth = 2; },
     "variant 0, resource \"color\": history depth 2 of an image that is no history"},
    {"ShortModule", [](Package& p) { variant(p).modules[1].resize(4); },
     "variant 0, module 1: holds no SPIR-V"},
    {"SegmentNameTwice", [](Package& p) { variant(p).segments[2].name = "pre"; },
     "variant 0, segment 2: the segment name \"pre\" is taken already"},
    {"SegmentKindNumber", [](Package& p) { variant(p).segments[2].kind = number<SegmentKind>(3); },
     "variant 0, segment 2: segment kind 3 does not exist"},
    {"ParamNameTwice", [](Package& p) { variant(p).params[1].name = "jitter"; },
     "variant 0, parameter \"jitter\": the parameter name \"jitter\" is taken already"},
    {"ParamComponents", [](Package& p) { variant(p).params[0].components = 5; },
     "variant 0, parameter \"jitter\": 5 components are outside 1..4"},
    {"ParamSourceNumber", [](Package& p) { variant(p).params[0].source = number<ParamSource>(4); },
     "variant 0, parameter \"jitter\": source 4 does not exist"},
    {"ParamOfReset", [](Package& p) { variant(p).params[1].is_integer = false; },
     "variant 0, parameter \"reset\": the reset flag must be one integer"},
    {"ParamAlignment", [](Package& p) { variant(p).params[0].offset_bytes = 4; },
     "variant 0, parameter \"jitter\": offset 4 is no multiple of 8, or leaves the 128 bytes"},
    {"ParamBeyond", [](Package& p) { variant(p).params[0].offset_bytes = 128; },
     "variant 0, parameter \"jitter\": offset 128 is no multiple of 8, or leaves the 128 bytes"},
    {"ParamOverlap", [](Package& p) { variant(p).params[1].offset_bytes = 12; },
     "variant 0, parameter \"reset\": shares byte 12 with another"},
    {"ParamDefaults", [](Package& p) { variant(p).params[0].default_values.pop_back(); },
     "variant 0, parameter \"jitter\": 1 default values, expected 2"},
    {"ParamDefaultKind", [](Package& p) { variant(p).params[1].default_values = {0.5f}; },
     "variant 0, parameter \"reset\": the default value 0.5 is no exact integer"},
    {"ViewResource", [](Package& p) { variant(p).views[0].resource = 99; },
     "variant 0, view 0: resource 99 does not exist, there are 9"},
    {"ViewOfWeights", [](Package& p) { variant(p).views[0].resource = 2; },
     "variant 0, view 0: \"w\" cannot be viewed"},
    {"ViewChannels", [](Package& p) { variant(p).views[0].first_channel = 2; },
     "variant 0, view 0: 3 channels from 2 on are not in the 4 of \"x\""},
    {"ViewRange", [](Package& p) { variant(p).views[1].high = 1; },
     "variant 0, view 1: 1..1 is no range"},
    {"NoSegment", [](Package& p) { variant(p).segments.clear(); },
     "variant 0: program \"frame\" has no segment"},
    {"DeviceClassNumber", [](Package& p) { variant(p).device_class = number<DeviceClass>(7); },
     "variant 0: device class 7 does not exist"},
    {"NoProgram", [](Package& p) { variant(p).programs.clear(); }, "variant 0: has no program"},
    {"ProgramNameTwice", [](Package& p) { variant(p).programs[1] = "frame"; },
     "variant 0, program 1: the program name \"frame\" is taken already"},
    {"ProgramNoIdentifier", [](Package& p) { variant(p).programs[1] = "2nd"; },
     "variant 0, program 1: \"2nd\" is no identifier"},
    {"ProgramIndex", [](Package& p) { variant(p).segments[3].program = 2; },
     "variant 0, segment 3: program 2 does not exist, there are 2"},
    {"ProgramsMixed", [](Package& p) { variant(p).segments[1].program = 1; },
     "variant 0, segment 2: program 0 does not follow program 1"},
    {"ProgramSkipped",
     [](Package& p) {
       variant(p).programs.push_back("third");
       variant(p).segments[3].program = 2;
     },
     "variant 0, segment 3: program 2 does not follow program 0"},
    {"FirstProgramWithoutSegment",
     [](Package& p) {
       for (Segment& segment : variant(p).segments) segment.program = 1;
     },
     "variant 0, segment 0: program 1 does not follow program 0"},
    {"LastProgramWithoutSegment", [](Package& p) { variant(p).programs.push_back("third"); },
     "variant 0: program \"third\" has no segment"},
    {"ChosenByNothing", [](Package& p) { variant(p).chosen_by.clear(); },
     "variant 0: has 4 values that choose programs, and no parameter"},
    {"ChosenByNoParameter", [](Package& p) { variant(p).chosen_by = "index"; },
     "variant 0: programs are chosen by \"index\", which is no parameter of the host"},
    {"ChosenByTheLoopsParameter", [](Package& p) { variant(p).chosen_by = "reset"; },
     "variant 0: programs are chosen by \"reset\", which is no parameter of the host"},
    {"TooFewChoices", [](Package& p) { variant(p).choices.pop_back(); },
     "variant 0: 3 values choose programs, expected 2 for each of 2"},
    {"ChoiceNotFinite",
     [](Package& p) { variant(p).choices[2] = std::numeric_limits<float>::infinity(); },
     "variant 0: inf chooses no program"},
    {"TimeWithoutGenerator",
     [](Package& p) {
       variant(p).params.push_back({"t", false, 1, 20, ParamSource::kTime, {0}});
     },
     "variant 0: parameter \"t\" is for a program that generates, and none does"},
    {"TimeIsAnInteger",
     [](Package& p) {
       variant(p).params.push_back({"t", true, 1, 20, ParamSource::kTime, {0}});
     },
     "variant 0, parameter \"t\": the time must be one float"},
    {"FramesAreAFloat",
     [](Package& p) {
       variant(p).params.push_back({"n", false, 1, 20, ParamSource::kFrames, {0}});
     },
     "variant 0, parameter \"n\": the number of frames must be one integer"},
    {"GeneratorAmongChoices",
     [](Package& p) {
       variant(p).generator = Generator{1, 0, 1};
     },
     "variant 0: a program that generates needs one other beside it, there are 1, chosen by a "
     "parameter"},
    {"GeneratorIsNoProgram",
     [](Package& p) {
       make_generator(variant(p));
       variant(p).generator->program = 2;
     },
     "variant 0: program 2 generates, there are 2"},
    {"GeneratesAtNoTime",
     [](Package& p) {
       make_generator(variant(p));
       variant(p).generator->after = 1;
     },
     "variant 0: generates at times above 1 up to 1, expected a range in 0 to 2"},
    {"GeneratesTooFarAhead",
     [](Package& p) {
       make_generator(variant(p));
       variant(p).generator->until = 2.5f;
     },
     "variant 0: generates at times above 0 up to 2.5, expected a range in 0 to 2"},
    {"GeneratorWritesWhatFramesFind", [](Package& p) { make_generator(variant(p)); },
     "variant 0, dispatch \"conv3\": generates pictures, and writes \"y\", which the next rendered "
     "frame would find"},
    {"DispatchNameTwice", [](Package& p) { dispatch(p, 1, 1).name = "conv1"; },
     "variant 0, segment 1, dispatch 1: the dispatch name \"conv1\" is taken already"},
    {"NoKernelName", [](Package& p) { dispatch(p, 1, 1).kernel.clear(); },
     "variant 0, dispatch \"conv2\": the kernel name is empty"},
    {"ModuleIndex", [](Package& p) { dispatch(p, 1, 1).module = 2; },
     "variant 0, dispatch \"conv2\": module 2 does not exist, there are 2"},
    {"EmptyGrid", [](Package& p) { dispatch(p, 1, 1).workgroups[2] = 0; },
     "variant 0, dispatch \"conv2\": a grid of 0 workgroups is outside 1..65535"},
    {"HugeGrid", [](Package& p) { dispatch(p, 1, 1).workgroups[0] = 65536; },
     "variant 0, dispatch \"conv2\": a grid of 65536 workgroups is outside 1..65535"},
    {"PredictedTime", [](Package& p) { dispatch(p, 1, 1).cost.time_us = -1; },
     "variant 0, dispatch \"conv2\": predicted time -1 is not a duration"},
    {"BindingNumber", [](Package& p) { dispatch(p, 1, 0).bindings[0].binding = 64; },
     "variant 0, dispatch \"conv1\", binding 64: the binding number is not below 64"},
    {"BindingTwice", [](Package& p) { dispatch(p, 1, 0).bindings[1].binding = 0; },
     "variant 0, dispatch \"conv1\", binding 0: the binding number is taken already"},
    {"BindingTypeNumber",
     [](Package& p) { dispatch(p, 1, 0).bindings[1].type = number<BindingType>(6); },
     "variant 0, dispatch \"conv1\", binding 1: binding type 6 does not exist"},
    {"ViewFormatNumber",
     [](Package& p) { dispatch(p, 1, 0).bindings[0].view_format = number<ImageFormat>(99); },
     "variant 0, dispatch \"conv1\", binding 0: view format 99 does not exist"},
    {"ResourceIndex", [](Package& p) { dispatch(p, 1, 0).bindings[1].resource = 9; },
     "variant 0, dispatch \"conv1\", binding 1: resource 9 does not exist, there are 9"},
    {"UnusedBinding", [](Package& p) { dispatch(p, 1, 0).bindings[1].reads = false; },
     "variant 0, dispatch \"conv1\", binding 1: neither reads nor writes"},
    {"ImageDescriptorOfTensor",
     [](Package& p) { dispatch(p, 1, 0).bindings[1].type = BindingType::kStorageImage; },
     "variant 0, dispatch \"conv1\", binding 1: an image descriptor leads to the tensor \"w\""},
    {"WrittenWeights", [](Package& p) { dispatch(p, 1, 0).bindings[1].writes = true; },
     "variant 0, dispatch \"conv1\", binding 1: weights \"w\" are written"},
    {"WrittenInput", [](Package& p) { dispatch(p, 1, 0).bindings[2].resource = 0; },
     "variant 0, dispatch \"conv1\", binding 2: the graph segment writes its input \"x\""},
    {"TensorOfThePast", [](Package& p) { dispatch(p, 1, 0).bindings[1].frames_back = 1; },
     "variant 0, dispatch \"conv1\", binding 1: frames_back is 1, \"w\" holds 1 frame(s)"},
    {"TensorTooFarBack", [](Package& p) { dispatch(p, 3, 0).bindings[0].frames_back = 2; },
     "variant 0, dispatch \"conv3\", binding 0: frames_back is 2, \"past\" holds 2 frame(s)"},
    {"RewrittenPastTensor", [](Package& p) { dispatch(p, 3, 0).bindings[0].writes = true; },
     "variant 0, dispatch \"conv3\", binding 0: an earlier frame's \"past\" is written"},
    {"SamplerOfTensor",
     [](Package& p) { dispatch(p, 1, 0).bindings[1].type = BindingType::kSampler; },
     "variant 0, dispatch \"conv1\", binding 1: an image descriptor leads to the tensor \"w\""},
    {"WrittenSampler", [](Package& p) { dispatch(p, 0, 0).bindings[3].writes = true; },
     "variant 0, dispatch \"pack\", binding 4: a sampled image is written"},
    {"SamplerOfUnfilteredFormat",
     [](Package& p) { resource(p, 4).format = ImageFormat::kRgba32Float; },
     "variant 0, dispatch \"pack\", binding 4: not every device filters the format rgba32_float of "
     "\"color\""},
    {"TooManySamplers",
     [](Package& p) {
       for (uint32_t i = 20; i < 36; ++i)
         dispatch(p, 0, 0).bindings.push_back(
             {i, BindingType::kSampler, 4, ImageFormat::kNone, true, false, 0});
     },
     "variant 0, dispatch \"pack\": has 17 samplers, more than 16"},
    {"StorageBufferWithFormat",
     [](Package& p) { dispatch(p, 1, 0).bindings[1].view_format = ImageFormat::kR8Sint; },
     "variant 0, dispatch \"conv1\", binding 1: a storage buffer has a view format"},
    {"WrittenTexelBuffer", [](Package& p) { dispatch(p, 1, 1).bindings[0].writes = true; },
     "variant 0, dispatch \"conv2\", binding 0: a uniform texel buffer is written"},
    {"TexelBufferFormat",
     [](Package& p) { dispatch(p, 1, 0).bindings[0].view_format = ImageFormat::kRgba8Unorm; },
     "variant 0, dispatch \"conv1\", binding 0: a texel buffer cannot have the view format "
     "rgba8_unorm"},
    {"TexelBufferOfInt32", [](Package& p) { dispatch(p, 1, 0).bindings[0].resource = 2; },
     "variant 0, dispatch \"conv1\", binding 0: a texel buffer of rgba8_sint views a tensor of "
     "type "
     "INT32"},
    {"BrokenTexels",
     [](Package& p) {
       resource(p, 0).shape = {511};
       resource(p, 0).size_bytes = 511;
     },
     "variant 0, dispatch \"conv1\", binding 0: 511 bytes of \"x\" are no whole number of 4 byte "
     "texels"},
    {"BufferDescriptorOfImage",
     [](Package& p) { dispatch(p, 0, 0).bindings[0].type = BindingType::kStorageBuffer; },
     "variant 0, dispatch \"pack\", binding 0: a buffer descriptor leads to the image \"color\""},
    {"ImageInGraph",
     [](Package& p) { dispatch(p, 1, 0).bindings[1] = dispatch(p, 0, 0).bindings[1]; },
     "variant 0, dispatch \"conv1\", binding 1: the graph segment uses the image \"history\""},
    {"ImageWithViewFormat",
     [](Package& p) { dispatch(p, 0, 0).bindings[0].view_format = ImageFormat::kR8Unorm; },
     "variant 0, dispatch \"pack\", binding 0: an image descriptor has a view format"},
    {"WrittenSampledImage", [](Package& p) { dispatch(p, 0, 0).bindings[1].writes = true; },
     "variant 0, dispatch \"pack\", binding 1: a sampled image is written"},
    {"WrittenInputImage", [](Package& p) { dispatch(p, 0, 0).bindings[2].resource = 4; },
     "variant 0, dispatch \"pack\", binding 2: the input image \"color\" is written"},
    {"TooFarBack", [](Package& p) { dispatch(p, 0, 0).bindings[1].frames_back = 3; },
     "variant 0, dispatch \"pack\", binding 1: frames_back is 3, \"history\" holds 3 frame(s)"},
    {"BackWithoutHistory", [](Package& p) { dispatch(p, 0, 0).bindings[0].frames_back = 1; },
     "variant 0, dispatch \"pack\", binding 0: frames_back is 1, \"color\" holds 1 frame(s)"},
    {"RewrittenPast", [](Package& p) { dispatch(p, 2, 0).bindings[1].frames_back = 1; },
     "variant 0, dispatch \"show\", binding 1: an earlier frame's \"history\" is written"},
    {"ProofLengths", [](Package& p) { variant(p).proofs[0].max.pop_back(); },
     "variant 0, proof 0: 2 minima, 1 maxima and 2 magnitudes, expected as many of each"},
    {"ProofOrder", [](Package& p) { variant(p).proofs[0].max[1] = -7; },
     "variant 0, proof 0: channel 1 has the range -6..-7 and the magnitude 12"},
    {"UnknownFeature", [](Package& p) { variant(p).requirements.features.bits |= 0xc00; },
     "variant 0: feature bits 0xc00 do not exist"},
    {"UnderstatedRange", [](Package& p) { variant(p).requirements.storage_range_bytes = 100; },
     "variant 0: storage_range_bytes is 100, the bindings need 512"},
    {"UnderstatedTexels", [](Package& p) { variant(p).requirements.texel_elements = 511; },
     "variant 0: texel_elements is 511, the bindings need 512"},
    {"UnderstatedImages", [](Package& p) { variant(p).requirements.storage_images = 1; },
     "variant 0: storage_images is 1, the bindings need 2"},
    {"MatricesWithoutFeature",
     [](Package& p) {
       variant(p).requirements.matrix_products = {{16, 16, 32}};
     },
     "variant 0: requirements name 1 products of matrices, and do not need cooperativeMatrix"},
    {"FeatureWithoutMatrices",
     [](Package& p) { variant(p).requirements.features.add(Feature::kCooperativeMatrix); },
     "variant 0: requirements name 0 products of matrices, and need cooperativeMatrix"},
    {"MatricesOutOfOrder",
     [](Package& p) {
       variant(p).requirements.features.add(Feature::kCooperativeMatrix);
       variant(p).requirements.matrix_products = {{16, 16, 32}, {16, 16, 32}};
     },
     "variant 0: requirements name products of matrices out of order"},
};

INSTANTIATE_TEST_SUITE_P(Package, EveryBadPackage, testing::ValuesIn(kBadPackages),
                         [](const auto& tested) { return std::string(tested.param.name); });

TEST(Package, RequirementsFollowFromBindings) {
  const Requirements needs = binding_requirements(sample_package().variants[0]);
  EXPECT_EQ(needs, (Requirements{.features = {},
                                 .storage_range_bytes = 512,
                                 .texel_elements = 512,
                                 .storage_buffers = 2,
                                 .texel_buffers = 3,
                                 .storage_images = 2}));
}

TEST(Package, BuffersAreBoundInWholeWords) {
  EXPECT_EQ(bound_bytes(tensor("a", Category::kInput, DType::kInt8, {1}, 0)), 4u);
  EXPECT_EQ(bound_bytes(tensor("a", Category::kInput, DType::kInt8, {8}, 0)), 8u);
}

TEST(Package, DumpShowsEveryPart) {
  const std::string text = dump_package(sample_package());
  for (const char* part : {
           "shale package 1.9\nmodel \"sample\", hash 1234567890abcdef\n",
           "made by shale 0.1.0 with \"target=any\"\nweights: 321 bytes, hash ",
           "variant 0: target \"any\" (class dot8-gpu), arena 1024 bytes\n  needs: shaderInt8\n",
           "      0 input          i8[1,8,16,4] 512 bytes scale 0.5 zero point -3 \"x\"\n",
           "      1 intermediate   i8[1,8,16,4] 512 bytes at 512 \"mid\"\n",
           "      5 image history  rgba8_unorm 16x8 depth 3 \"history\"\n",
           "      8 output         i8[2,3] 6 bytes depth 2 \"past\"\n",
           "  program \"frame\" where \"jitter\" is nearest 0.25,-0.5\n  segment \"pre\" "
           "(compute): 1 dispatches\n",
           "  program \"again\" where \"jitter\" is nearest 0,0.5\n  segment \"network_again\" "
           "(graph): 1 dispatches\n",
           "       4 sampler reads \"color\"\n",
           "  segment \"network\" (graph): 2 dispatches\n",
           "    \"conv1\": conv2d_s8_f32exact module 1 grid 4x1x1\n",
           "      predicted 5.5 us: 1000 macs, 20 other ops, 300 bytes read, 40 written\n",
           "       0 texel buffer rgba8_sint reads \"x\"\n",
           "       1 sampled image reads \"history\" 2 frame(s) back\n",
           "      63 storage buffer reads and writes \"y\"\n",
           "      1 6 words in 24 bytes, hash ",
           "        1 -6..6, any partial sum within 12\n",
       })
    EXPECT_NE(text.find(part), std::string::npos) << part << "\nis not in\n" << text;
}

TEST(Package, NearestChoiceIsTheProgram) {
  Variant variant = sample_package().variants[0];
  EXPECT_EQ(chosen_program(variant, std::array{0.2f, -0.1f}), 0u);
  EXPECT_EQ(chosen_program(variant, std::array{0.1f, 0.4f}), 1u);
  variant.choices = {0, 0, 0, 1};
  EXPECT_EQ(chosen_program(variant, std::array{3.0f, 0.5f}), 0u);  // the first of equal ones
  variant.choices.clear();
  EXPECT_EQ(chosen_program(variant, std::array{1.0f, 1.0f}), 0u);
}

TEST(ImageFormats, NamesLeadBack) {
  for (uint32_t i = 1; i < kImageFormatCount; ++i) {
    const ImageFormatInfo& info = image_format_info(static_cast<ImageFormat>(i));
    EXPECT_EQ(static_cast<uint32_t>(info.format), i);
    EXPECT_EQ(image_format_from_name(info.name), info.format);
    EXPECT_GT(info.texel_bytes, 0u);
  }
  EXPECT_EQ(image_format_from_name("none"), std::nullopt);
  EXPECT_EQ(image_format_from_name("bgra8"), std::nullopt);
}

TEST(Caps, MissingNamesEachShortfall) {
  DeviceCaps caps;
  caps.features.add(Feature::kInt8);
  caps.max_workgroup_invocations = 128;
  Requirements needs;
  needs.workgroup_invocations = 128;
  needs.features.add(Feature::kInt8);
  EXPECT_TRUE(meets(caps, needs));
  needs.features.add(Feature::kDotProduct8);
  needs.workgroup_invocations = 256;
  needs.storage_images = 1;
  EXPECT_EQ(missing(caps, needs),
            (std::vector<std::string>{"shaderIntegerDotProduct is not supported",
                                      "maxComputeWorkGroupInvocations is 128, needs 256",
                                      "maxPerStageDescriptorStorageImages is 0, needs 1"}));
}

TEST(LinearImages, ComeBackAsTheyWere) {
  const Package package = linear_package();
  ASSERT_TRUE(check_package(package));
  const Result<Package> again = read_package(write_package(package));
  ASSERT_TRUE(again);
  EXPECT_EQ(*again, package);
  const std::string dump = dump_package(package);
  EXPECT_NE(dump.find("rgba16_float 16x8 linear, 1024 bytes \"raw\""), std::string::npos) << dump;
  EXPECT_NE(dump.find("segment \"transfers\" (transfer): 2 dispatches"), std::string::npos) << dump;
  EXPECT_EQ(linear_pitch(ImageFormat::kRgba16Float, 17), 24u);
  EXPECT_EQ(linear_pitch(ImageFormat::kR8Unorm, 1), 64u);
}

TEST(LinearImages, AndTransfersFollowRules) {
  struct Row {
    void (*change)(Variant&);
    const char* message;
  };
  const Row rows[] = {
      {[](Variant& v) { v.resources[9].size_bytes = 1023; },
       "resource \"raw\": size is 1023 bytes, the extent makes 1024"},
      {[](Variant& v) { v.resources[4].size_bytes = 1024; },
       "resource \"color\": an image of the host has a size of 1024 bytes"},
      {[](Variant& v) { v.resources[9].size_bytes = 0; },
       "dispatch \"take\": copies \"color\" to \"raw\", of which one must be linear"},
      {[](Variant& v) { v.segments[0].dispatches[0].kernel = "move"; },
       "dispatch \"take\": \"move\" is no transfer"},
      {[](Variant& v) { v.segments[0].dispatches[0].module = 1; },
       "dispatch \"take\": a transfer has a module or a grid"},
      {[](Variant& v) { v.segments[0].dispatches[0].workgroups[0] = 2; },
       "dispatch \"take\": a transfer has a module or a grid"},
      {[](Variant& v) { v.segments[0].dispatches[0].bindings.pop_back(); },
       "dispatch \"take\": has 1 ends, expected 2"},
      {[](Variant& v) { v.segments[0].dispatches[0].bindings[0].binding = 2; },
       "dispatch \"take\": the ends of a transfer are out of order"},
      {[](Variant& v) { v.segments[0].dispatches[0].bindings[1].reads = true; },
       "dispatch \"take\": the ends of a transfer are out of order"},
      {[](Variant& v) { v.segments[0].dispatches[0].bindings[1].resource = 10; },
       "dispatch \"take\": copies \"color\" to \"kept\", which has another format or extent"},
      {[](Variant& v) { v.segments[0].dispatches[0].bindings[1].resource = 0; },
       "dispatch \"take\", binding 1: an image descriptor leads to the tensor \"x\""},
      {[](Variant& v) {
         v.segments[0].dispatches[1].bindings[0].type = BindingType::kStorageBuffer;
       },
       "dispatch \"empty\", binding 0: transfer segments have transfer bindings, and no others do"},
      {[](Variant& v) { v.segments[1].dispatches[0].bindings[0].type = BindingType::kTransfer; },
       "dispatch \"pack\", binding 0: transfer segments have transfer bindings, and no others do"},
      {[](Variant& v) {
         v.segments[1].dispatches[0].bindings[5].type = BindingType::kStorageImage;
       },
       "dispatch \"pack\", binding 3: an image descriptor leads to the linear image \"raw\""},
      {[](Variant& v) {
         v.segments[1].dispatches[0].bindings[5].view_format = ImageFormat::kR32Float;
       },
       "dispatch \"pack\", binding 3: a texel buffer cannot have the view format r32_float"},
      {[](Variant& v) { v.segments[1].dispatches[0].bindings[5].writes = true; },
       "dispatch \"pack\", binding 3: a uniform texel buffer is written"},
      {[](Variant& v) { v.segments[1].dispatches[0].bindings[6].frames_back = 1; },
       "dispatch \"pack\", binding 5: an earlier frame's \"kept\" is written"},
  };
  for (const Row& row : rows) {
    Package package = linear_package();
    row.change(package.variants[0]);
    const Result<void> checked = check_package(package);
    ASSERT_FALSE(checked) << row.message;
    EXPECT_EQ(checked.error().text(), std::string("variant 0, ") + row.message);
  }
}

}  // namespace
}  // namespace shale
