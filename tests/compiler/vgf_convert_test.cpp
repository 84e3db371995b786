// Graphs out of VGF files and into them; packages as VGF.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <set>

#include "compiler/frontend/vgf/convert.h"
#include "ir/base/hash.h"
#include "ir/binary/tosa.h"
#include "tests/compiler/graph_support.h"
#include "tests/compiler/spirv_text.h"
#include "tests/ir/golden_files.h"

namespace shale {
namespace {

constexpr const char* kConvolution = R"(graph net {
  input %x : i8[1,4,4,4]
  const %w : i8[4,1,1,4] = [1,0,0,2,0,3,0,-4,5,6,0,0,0,0,7,8]
  const %b : i32[4] = [10,-20,30,-40]
  const %zp : i8[1] = [0]
  %y = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], local_bound=false, acc_type=i32} : i32[1,4,4,4]
  return %y
}
)";

Vgf convolution() { return must(graph_to_vgf(graph_of(kConvolution))); }

Result<Graph> import(const Vgf& vgf, const ImportOptions& options = {}) {
  return import_model(must(write_vgf(vgf)), options);
}

std::string outcome(const Vgf& vgf, const ImportOptions& options = {}) {
  const Result<Graph> graph = import(vgf, options);
  return graph ? print_text(*graph) : graph.error().text();
}

TEST(VgfConvert, GraphsOfTheReferenceEncoderGiveTheirResults) {
  const std::string folder = SHALE_SHARED_DIR "/golden/vgf/";
  if (!read_file(folder + "pool_clamp_graph.vgf")) GTEST_SKIP() << "no golden files";
  const std::pair<std::string, std::pair<int, int>> cases[] = {
      {"conv2d_rescale_constants", {91, 200}}, {"pool_clamp_graph", {73, 19}}};
  for (const auto& [name, rule] : cases) {
    const auto json = nlohmann::json::parse(must(read_text(folder + name + ".json")));
    const Graph graph = must(import_model(must(read_file(folder + name + ".vgf"))));
    ASSERT_TRUE(verify(graph)) << name;
    Tensor input = Tensor::zeros(graph.value(graph.inputs[0]).type);
    for (size_t i = 0; i < input.bytes.size(); ++i)
      input.bytes[i] = static_cast<uint8_t>(static_cast<size_t>(rule.first) * i +
                                            static_cast<size_t>(rule.second));
    const auto& expected = json["io_example"]["outputs"][0];
    EXPECT_EQ(graph.value(graph.inputs[0]).name, json["io_example"]["inputs"][0]["name"]);
    EXPECT_EQ(graph.value(graph.outputs[0]).name, expected["name"]);
    const std::vector<Tensor> outputs = must(interpret(graph, std::vector{input}));
    ASSERT_EQ(outputs.size(), 1u);
    EXPECT_EQ(outputs[0].type.shape, expected["shape"].get<Shape>());
    const std::vector<int64_t> values = outputs[0].ints();
    const auto first = expected["first_values"].get<std::vector<int64_t>>();
    EXPECT_TRUE(std::equal(first.begin(), first.end(), values.begin())) << name;
    EXPECT_EQ(std::set<int64_t>(values.begin(), values.end()).size(), expected["distinct_values"]);
  }
  // The graph among compute segments is one too.
  const Graph pool =
      must(import_model(must(read_file(folder + "compute_graph_compute_sequence.vgf"))));
  EXPECT_EQ(pool.nodes.size(), 1u);
}

TEST(VgfConvert, EveryGoldenGraphGivesTheSameThroughAFile) {
  size_t count = 0;
  for (const GoldenFile& file : golden_files()) {
    const Result<Graph> graph = read_tosa(file.bytes);
    if (!graph || !verify(*graph)) continue;
    SCOPED_TRACE(file.name);
    const Result<Vgf> vgf = graph_to_vgf(*graph);
    ASSERT_TRUE(vgf) << vgf.error().text();
    const Result<Graph> again = import(*vgf);
    ASSERT_TRUE(again) << again.error().text();
    ASSERT_TRUE(verify(*again));
    ASSERT_EQ(again->inputs.size(), graph->inputs.size());
    for (size_t i = 0; i < graph->inputs.size(); ++i)
      EXPECT_EQ(again->value(again->inputs[i]).name, graph->value(graph->inputs[i]).name);
    ++count;
    if (*again == *graph) continue;
    std::vector<Tensor> inputs = random_inputs(*graph, 1);
    const auto expected = interpret(*graph, inputs);
    for (size_t i = 0; i < inputs.size(); ++i) inputs[i].type = again->value(again->inputs[i]).type;
    const auto found = interpret(*again, inputs);
    ASSERT_EQ(found.has_value(), expected.has_value()) << error_text(found);
    if (!expected) continue;
    ASSERT_EQ(found->size(), expected->size());
    for (size_t i = 0; i < found->size(); ++i) EXPECT_EQ((*found)[i].bytes, (*expected)[i].bytes);
  }
  if (count == 0) GTEST_SKIP() << "no golden cases";
  EXPECT_GE(count, 700u);
}

TEST(VgfConvert, AGraphBecomesOneSegmentWithItsConstantsOutside) {
  const Vgf vgf = convolution();
  EXPECT_TRUE(check_vgf(vgf));
  ASSERT_EQ(vgf.segments.size(), 1u);
  EXPECT_EQ(vgf.segments[0].type, VgfModuleType::kGraph);
  EXPECT_EQ(vgf.segments[0].dispatch, (std::array<uint32_t, 3>{}));
  EXPECT_EQ(vgf.segments[0].constants, (std::vector<uint32_t>{0, 1}));
  EXPECT_EQ(vgf.segments[0].sets, (std::vector<VgfDescriptorSet>{{{{0, 0}, {1, 1}}, kVgfNone}}));
  EXPECT_EQ(vgf.inputs, (std::vector<VgfSlot>{{0, 0}}));
  EXPECT_EQ(vgf.outputs, (std::vector<VgfSlot>{{1, 1}}));
  EXPECT_EQ(vgf.input_names, (std::vector<std::string>{"x"}));
  EXPECT_EQ(vgf.output_names, (std::vector<std::string>{"y"}));
  const auto resource = [](uint32_t descriptor, uint32_t format, VgfCategory category,
                           std::vector<int64_t> shape) {
    VgfResource made;
    made.descriptor_type = descriptor;
    made.format = format;
    made.category = category;
    made.shape = std::move(shape);
    return made;
  };
  EXPECT_EQ(vgf.resources,
            (std::vector{resource(1000460000, 14, VgfCategory::kInput, {1, 4, 4, 4}),
                         resource(1000460000, 99, VgfCategory::kOutput, {1, 4, 4, 4}),
                         resource(kVgfNone, 14, VgfCategory::kConstant, {4, 1, 1, 4}),
                         resource(kVgfNone, 99, VgfCategory::kConstant, {4})}));
  EXPECT_EQ(outcome(vgf), normal_text(kConvolution));
}

TEST(VgfConvert, ConstantsAreFoundByNumberOrByPosition) {
  Vgf vgf = convolution();
  // A constant that nobody uses comes first: the graph's 0 and 1 are the file's 1 and 2.
  vgf.resources.push_back(vgf.resources[3]);
  vgf.constants.insert(vgf.constants.begin(), {4, -1, std::vector<uint8_t>(16)});
  vgf.segments[0].constants = {1, 2};
  EXPECT_EQ(outcome(vgf), normal_text(kConvolution)) << "by position";
  std::swap(vgf.constants[0], vgf.constants[2]);  // weights 1, bias 0
  std::swap(vgf.constants[0], vgf.constants[1]);  // weights 0, bias 1
  vgf.segments[0].constants = {2, 1, 0};
  EXPECT_EQ(outcome(vgf), normal_text(kConvolution)) << "by number, in any order";
  vgf.segments[0].constants = {};
  EXPECT_NE(outcome(vgf).find("module 0 \"net\""), std::string::npos) << outcome(vgf);
}

TEST(VgfConvert, ASparsityMarkMustHold) {
  Vgf vgf = convolution();
  vgf.constants[0].sparsity_dimension = 3;
  EXPECT_EQ(outcome(vgf), normal_text(kConvolution));
  vgf.constants[0].bytes[1] = 9;
  EXPECT_EQ(outcome(vgf),
            "constant 0: is marked 2:4 sparse along dimension 3, but 3 of the four elements from "
            "[0,0,0,0] on are not zero");
}

TEST(VgfConvert, OpenDimensionsComeFromTheResourceTable) {
  Vgf vgf = convolution();
  vgf.modules[0].words = assemble_spirv(R"(
OpCapability GraphARM
OpCapability TensorsARM
OpCapability Int8
OpCapability Shader
OpCapability VulkanMemoryModel
OpExtension "SPV_ARM_graph"
OpExtension "SPV_ARM_tensors"
%tosa = OpExtInstImport "TOSA.001000.1"
OpMemoryModel Logical Vulkan
OpDecorate %x DescriptorSet 2
OpDecorate %x Binding 5
OpDecorate %y DescriptorSet 2
OpDecorate %y Binding 6
%i8 = OpTypeInt 8 0
%i32 = OpTypeInt 32 0
%c0 = OpConstant %i32 0
%c4 = OpConstant %i32 4
%t = OpTypeTensorARM %i8 %c4
%p = OpTypePointer UniformConstant %t
%x = OpVariable %p UniformConstant
%y = OpVariable %p UniformConstant
%gt = OpTypeGraphARM 1 %t %t
OpGraphEntryPointARM %g "net" %x %y
%g = OpGraphARM %gt
%in = OpGraphInputARM %t %c0
%r = OpExtInst %t %tosa BITWISE_NOT %in
OpGraphSetOutputARM %r %c0
OpGraphEndARM
)");
  vgf.segments[0].constants = {};
  vgf.segments[0].sets = {{{{5, 0}, {6, 1}}, 2}};
  vgf.segments[0].inputs = vgf.inputs = {{5, 0}};
  vgf.segments[0].outputs = vgf.outputs = {{6, 1}};
  vgf.resources[1].format = 13;
  vgf.resources[0].shape = {1, INT64_MIN, -1, 3};
  EXPECT_EQ(outcome(vgf),
            "graph net {\n  input %x : i8[1,?,?,3]\n  %y = bitwise_not %x : i8[1,4,4,4]\n"
            "  return %y\n}\n");
  vgf.resources[0].shape = {1, 4, 4, 4};
  const std::string closed =
      "graph net {\n  input %x : i8[1,4,4,4]\n  %y = bitwise_not %x : "
      "i8[1,4,4,4]\n  return %y\n}\n";
  EXPECT_EQ(outcome(vgf), closed);
  vgf.resources[0].shape = {};
  vgf.resources[1].shape = {};
  EXPECT_EQ(outcome(vgf, {.entry_point = "", .input_shapes = {}, .constants = {}}),
            "graph net {\n  input %x : i8[?,?,?,?]\n  %y = bitwise_not %x : i8[?,?,?,?]\n  return "
            "%y\n}\n");
}

TEST(VgfConvert, SegmentsAreChosenByName) {
  Vgf vgf = convolution();
  const auto with = [&](const std::string& name) {
    return outcome(vgf, {.entry_point = name, .input_shapes = {}, .constants = {}});
  };
  EXPECT_EQ(with("net"), normal_text(kConvolution));
  EXPECT_EQ(with("other"),
            "--entry-point: found \"other\", which is the name of 0 graph segments of: \"net\"");
  vgf.segments.push_back(vgf.segments[0]);
  vgf.segments[1].name = "again";
  EXPECT_EQ(outcome(vgf), "has 2 graph segments, name one with --entry-point: \"net\", \"again\"");
  EXPECT_EQ(with("again"), normal_text(kConvolution));
  vgf.segments[0].name = "first";
  EXPECT_EQ(with("net"),
            "--entry-point: found \"net\", which is the name of 2 graph segments of: "
            "\"first\", \"again\"")
      << "both have the entry point net";
  vgf.segments.pop_back();
  EXPECT_EQ(with("net"), normal_text(kConvolution)) << "the entry point of the module";
  EXPECT_EQ(outcome(vgf, {.entry_point = "", .input_shapes = {}, .constants = {{0, {}}}}),
            "--constant: the format holds its constants itself");
}

TEST(VgfConvert, FilesWithoutAReadableGraphAreRefused) {
  Vgf vgf = convolution();
  vgf.modules[0].words.clear();
  EXPECT_EQ(outcome(vgf), "module 0 \"net\": is a placeholder, expected SPIR-V with a graph");
  vgf.modules[0].code = VgfCode::kGlsl;
  EXPECT_EQ(outcome(vgf), "module 0 \"net\": is GLSL, expected SPIR-V with a graph");
  vgf = convolution();
  vgf.modules[0].entry_point = "absent";
  EXPECT_EQ(outcome(vgf),
            "module 0 \"net\": the module has no entry point \"absent\", it has \"net\"");
  vgf.modules[0].words.resize(6);
  EXPECT_TRUE(outcome(vgf).starts_with("module 0 \"net\", word 5")) << outcome(vgf);
  vgf.modules[0].type = vgf.segments[0].type = VgfModuleType::kCompute;
  EXPECT_EQ(outcome(vgf), "has no graph segment, found 1 of the type COMPUTE");
  vgf = convolution();
  vgf.resources[0].shape[3] = 5;
  EXPECT_EQ(outcome(vgf),
            "module 0 \"net\", input 0 \"x\": is [1,4,4,5] outside, the module has [1,4,4,4]");
}

TEST(VgfConvert, OptionsThatAFormatHasNoPlaceForAreRefused) {
  const std::string text = kConvolution;
  const std::vector<uint8_t> tir(text.begin(), text.end());
  for (const std::vector<uint8_t>& bytes : {tir, write_tosa(graph_of(kConvolution))}) {
    EXPECT_EQ(error_text(
                  import_model(bytes, {.entry_point = "net", .input_shapes = {}, .constants = {}})),
              "--entry-point: found \"net\", the format has one unnamed entry point");
    EXPECT_EQ(error_text(import_model(
                  bytes, {.entry_point = "", .input_shapes = {}, .constants = {{3, {}}}})),
              "--constant: the format holds its constants itself");
  }
}

/// A pass fills "x"; the network makes "y" from it over "t"; a pass shows it in an image.
Package small_package() {
  Package package;
  package.weights.resize(260, 7);
  Variant variant;
  variant.target = "lavapipe";
  variant.arena_bytes = 256;
  const auto tensor = [](const char* name, Category category, std::vector<int64_t> shape,
                         uint64_t offset) {
    Resource resource;
    resource.name = name;
    resource.category = category;
    resource.dtype = DType::kInt8;
    resource.size_bytes = static_cast<uint64_t>(*element_count(shape));
    resource.shape = std::move(shape);
    resource.offset_bytes = offset;
    return resource;
  };
  const auto image = [](const char* name, Category category) {
    Resource resource;
    resource.name = name;
    resource.category = category;
    resource.format = ImageFormat::kRgba8Unorm;
    resource.width = 5;
    resource.height = 3;
    return resource;
  };
  variant.resources = {tensor("x", Category::kInput, {1, 2, 2, 4}, 0),
                       tensor("y", Category::kOutput, {1, 3, 3, 3}, 0),
                       tensor("w", Category::kWeights, {3}, 256),
                       tensor("t", Category::kIntermediate, {1, 3, 3, 3}, 0),
                       image("color", Category::kImageInput),
                       image("shown", Category::kImageOutput),
                       image("blend", Category::kImageInternal)};
  variant.modules = {{0x07230203, 0x00010600, 0, 8, 0}, {0x07230203, 0x00010600, 0, 9, 0}};
  const auto dispatch = [](const char* name, uint32_t module, std::vector<Binding> bindings) {
    Dispatch made;
    made.name = name;
    made.kernel = "generic";
    made.module = module;
    made.workgroups = {3, 2, 1};
    made.bindings = std::move(bindings);
    return made;
  };
  const auto buffer = [](uint32_t number, uint32_t resource, bool writes) {
    return Binding{
        number, BindingType::kStorageBuffer, resource, ImageFormat::kNone, !writes, writes, 0};
  };
  const auto picture = [](uint32_t number, BindingType type, uint32_t resource, bool writes) {
    return Binding{number, type, resource, ImageFormat::kNone, !writes, writes, 0};
  };
  const Binding texels{1, BindingType::kUniformTexelBuffer, 0, ImageFormat::kRgba8Sint, true, false,
                       0};
  variant.segments = {
      {"pre",
       SegmentKind::kCompute,
       {dispatch("fill", 0,
                 {picture(0, BindingType::kSampledImage, 4, false), buffer(1, 0, true)})}},
      {"graph",
       SegmentKind::kGraph,
       {dispatch("first", 1, {buffer(0, 2, false), texels, buffer(2, 3, true)}),
        dispatch("second", 1, {buffer(0, 3, false), buffer(1, 1, true)})}},
      {"post",
       SegmentKind::kCompute,
       {dispatch("mix", 0, {buffer(0, 1, false), picture(3, BindingType::kStorageImage, 6, true)}),
        dispatch("show", 0,
                 {picture(0, BindingType::kSampledImage, 6, false),
                  picture(1, BindingType::kStorageImage, 5, true)})}}};
  variant.params = {{"sharpness", false, 2, 8, ParamSource::kHost, {1, 2}}};
  variant.requirements = binding_requirements(variant);
  package.variants = {variant};
  return package;
}

TEST(VgfConvert, APackageBecomesComputeSegments) {
  const Package package = small_package();
  ASSERT_TRUE(check_package(package)) << check_package(package).error().text();
  EXPECT_EQ(error_text(package_to_vgf(package, {.variant = 1})),
            "--variant: found 1, the package has 1");
  EXPECT_EQ(error_text(package_to_vgf(package, {})),
            "resource \"w\": is a constant, which VGF binds to no compute segment; "
            "--weights-as-inputs makes it an input of the model");
  const Vgf vgf = must(package_to_vgf(package, {.weights_as_inputs = true}));
  EXPECT_EQ(must(read_vgf(must(write_vgf(vgf)))), vgf);
  const auto hash_of = [&](size_t module) {
    const Spirv& words = package.variants[0].modules[module];
    return fmt::format("{:016x}",
                       stable_hash({reinterpret_cast<const uint8_t*>(words.data()), 20}));
  };
  EXPECT_EQ(dump_vgf(vgf, nullptr),
            R"(VGF 0.4.3, Vulkan header 0
modules: 2
    0 COMPUTE "module_0", entry point "main", SPIRV, 5 words, version 0x00010600, bound 8, hash )" +
                hash_of(0) +
                R"(
    1 COMPUTE "module_1", entry point "main", SPIRV, 5 words, version 0x00010600, bound 9, hash )" +
                hash_of(1) +
                R"(
resources: 10
    0 INTERMEDIATE R8_SINT[1,2,2,4] descriptor STORAGE_BUFFER alias group 0
    1 INTERMEDIATE R8G8B8A8_SINT[4] descriptor UNIFORM_TEXEL_BUFFER alias group 0
    2 INTERMEDIATE R8_SINT[28] descriptor STORAGE_BUFFER
    3 INPUT        R8_SINT[4] descriptor STORAGE_BUFFER
    4 INTERMEDIATE R8_SINT[28] descriptor STORAGE_BUFFER
    5 INPUT        R8G8B8A8_UNORM[1,3,5,4] descriptor SAMPLED_IMAGE
    6 OUTPUT       R8G8B8A8_UNORM[1,3,5,4] descriptor STORAGE_IMAGE
    7 INTERMEDIATE R8G8B8A8_UNORM[1,3,5,4] descriptor STORAGE_IMAGE alias group 1
    8 INTERMEDIATE R8G8B8A8_UNORM[1,3,5,4] descriptor SAMPLED_IMAGE alias group 1
    9 CONSTANT     R8_SINT[3] descriptor none
constants: 1
    0 resource 9, 3 bytes, dense, begins 070707, hash )" +
                fmt::format("{:016x}", stable_hash(std::vector<uint8_t>(3, 7))) +
                R"(
segments: 5
    0 COMPUTE "fill", module 0, dispatch 3x2x1
      set 0 0: resource 5, 1: resource 0
      inputs  0: resource 5
      outputs 1: resource 0
      push constants: 16 bytes at 0, stages 0x20
    1 COMPUTE "first", module 1, dispatch 3x2x1
      set 0 0: resource 3, 1: resource 1, 2: resource 4
      inputs  0: resource 3, 1: resource 1
      outputs 2: resource 4
    2 COMPUTE "second", module 1, dispatch 3x2x1
      set 0 0: resource 4, 1: resource 2
      inputs  0: resource 4
      outputs 1: resource 2
    3 COMPUTE "mix", module 0, dispatch 3x2x1
      set 0 0: resource 2, 3: resource 7
      inputs  0: resource 2
      outputs 3: resource 7
      push constants: 16 bytes at 0, stages 0x20
    4 COMPUTE "show", module 0, dispatch 3x2x1
      set 0 0: resource 8, 1: resource 6
      inputs  0: resource 8
      outputs 1: resource 6
      push constants: 16 bytes at 0, stages 0x20
model inputs  0: resource 3 "w", 1: resource 5 "color"
model outputs 2: resource 6 "shown"
)");
}

TEST(VgfConvert, WhatVgfCannotSayOfAPackageIsRefused) {
  Package package = small_package();
  package.variants[0].resources[6].category = Category::kImageHistory;
  package.variants[0].resources[6].history_depth = 2;
  ASSERT_TRUE(check_package(package)) << check_package(package).error().text();
  EXPECT_EQ(error_text(package_to_vgf(package, {.weights_as_inputs = true})),
            "resource \"blend\": is a history of earlier frames, VGF has one frame only");
  package = small_package();
  package.variants[0].params = {{"reset", true, 1, 0, ParamSource::kReset, {0}}};
  ASSERT_TRUE(check_package(package));
  EXPECT_EQ(error_text(package_to_vgf(package, {.weights_as_inputs = true})),
            "parameter \"reset\": follows the history of frames, which VGF does not have");
}

}  // namespace
}  // namespace shale
