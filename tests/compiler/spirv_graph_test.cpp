#include "compiler/frontend/spirv_graph/spirv_graph.h"

#include <gtest/gtest.h>

#include <random>

#include "ir/binary/tosa.h"
#include "ir/reference/interpreter.h"
#include "tests/compiler/graph_support.h"
#include "tests/compiler/spirv_text.h"
#include "tests/ir/golden_files.h"
#include "tests/support/float_cases.h"

namespace shale {
namespace {

std::span<const uint8_t> bytes_of(const std::vector<uint32_t>& words) {
  return {reinterpret_cast<const uint8_t*>(words.data()), words.size() * 4};
}

/// The graph's text form, or the error.
std::string outcome(const std::vector<uint32_t>& words, const SpirvGraphOptions& options = {}) {
  const Result<Graph> graph = read_spirv_graph(bytes_of(words), options);
  return graph ? print_text(*graph) : graph.error().text();
}
std::string outcome(const std::string& module, const SpirvGraphOptions& options = {}) {
  return outcome(assemble_spirv(module), options);
}

/// The constants of a written module, as its reader wants them.
SpirvGraphOptions with_constants(const SpirvGraphModule& module) {
  SpirvGraphOptions options;
  for (uint32_t i = 0; i < module.constants.size(); ++i)
    options.constants.push_back({i, module.constants[i].bytes});
  return options;
}

Result<Graph> reread(const SpirvGraphModule& module) {
  return read_spirv_graph(bytes_of(module.words), with_constants(module));
}

/// The format has what the graph has, so that it comes back as it was.
bool is_exact(const Graph& graph) {
  for (const Node& node : graph.nodes)
    if (node.op == Op::kIdentity ||
        (node.attrs.has(Attr::kNanMode) && node.attrs.get(Attr::kNanMode) == 0))
      return false;
  return std::ranges::none_of(graph.values, [](const Value& value) {
    return value.type.shape.empty() || value.type.dtype == DType::kInt4;
  });
}

/// Equal bytes from equal bytes: element types and shapes may differ as the writer documents.
void expect_equal_bytes(const Graph& before, const Graph& after, const std::string& name) {
  ASSERT_EQ(before.inputs.size(), after.inputs.size()) << name;
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    const std::vector<Tensor> inputs = random_inputs(before, seed);
    std::vector<Tensor> same = inputs;
    for (size_t i = 0; i < same.size(); ++i) same[i].type = after.value(after.inputs[i]).type;
    const auto expected = interpret(before, inputs);
    const auto found = interpret(after, same);
    ASSERT_EQ(expected.has_value(), found.has_value()) << name << ": " << error_text(found);
    if (!expected) continue;
    ASSERT_EQ(expected->size(), found->size()) << name;
    for (size_t i = 0; i < found->size(); ++i)
      EXPECT_TRUE((*expected)[i].bytes == (*found)[i].bytes) << name << ", output " << i;
  }
}

TEST(SpirvGraph, RoundTripsAllGoldenGraphs) {
  size_t exact = 0, rewritten = 0;
  for (const GoldenFile& file : golden_files()) {
    const Result<Graph> graph = read_tosa(file.bytes);
    if (!graph || !verify(*graph)) continue;
    for (const bool external : {false, true}) {
      const auto module = write_spirv_graph(*graph, {.external_constants = external});
      ASSERT_TRUE(module) << file.name << ": " << error_text(module);
      EXPECT_TRUE(external || module->constants.empty()) << file.name;
      const Result<Graph> again = reread(*module);
      ASSERT_TRUE(again) << file.name << ": " << error_text(again);
      const auto verified = verify(*again);
      ASSERT_TRUE(verified) << file.name << ": " << error_text(verified);
      if (is_exact(*graph)) {
        EXPECT_TRUE(*again == *graph) << file.name << "\n" << print_text(*again);
        ++exact;
      } else {
        expect_equal_bytes(*graph, *again, file.name);
        ++rewritten;
      }
    }
  }
  EXPECT_GT(exact, 0u);
  EXPECT_GE(exact, 1000u);
  EXPECT_GE(rewritten, 40u);
}

TEST(SpirvGraph, RoundTripsTheModels) {
  for (const char* model :
       {"nss_v1_high", "nss_v1_low", "nss_v0_1", "mnss_x2", "qrisp_s_x2", "srpo_x2", "srpo_x3"}) {
    const std::string path = fmt::format("{}/models/{}/model.tosa", SHALE_SOURCE_DIR, model);
    const Graph graph = must(read_tosa(must(read_file(path))), path);
    for (const bool external : {false, true}) {
      const auto module = must(write_spirv_graph(graph, {.external_constants = external}), path);
      EXPECT_TRUE(must(reread(module), path) == graph) << path;
    }
  }
}

/// CONV2D and RESCALE with per-channel multipliers; weights and biases are graph constants.
const std::string kConvolution = R"(
OpCapability GraphARM
OpCapability TensorsARM
OpCapability Int8
OpCapability Shader
OpCapability VulkanMemoryModel
OpExtension "SPV_ARM_graph"
OpExtension "SPV_ARM_tensors"
%tosa = OpExtInstImport "TOSA.001000.1"
OpMemoryModel Logical Vulkan
OpName %x "x"
OpName %y "y"
OpDecorate %x DescriptorSet 0
OpDecorate %x Binding 0
OpDecorate %y DescriptorSet 0
OpDecorate %y Binding 1
%bool = OpTypeBool
%i8 = OpTypeInt 8 0
%i32 = OpTypeInt 32 0
%true = OpConstantTrue %bool
%false = OpConstantFalse %bool
%c0 = OpConstant %i32 0
%c1 = OpConstant %i32 1
%c2 = OpConstant %i32 2
%c3 = OpConstant %i32 3
%c4 = OpConstant %i32 4
%a1 = OpTypeArray %i32 %c1
%a4 = OpTypeArray %i32 %c4
%sh_x = OpConstantComposite %a4 %c1 %c4 %c4 %c2
%sh_y = OpConstantComposite %a4 %c1 %c4 %c4 %c3
%sh_w = OpConstantComposite %a4 %c3 %c1 %c1 %c2
%sh1 = OpConstantComposite %a1 %c1
%sh2 = OpConstantComposite %a1 %c2
%sh3 = OpConstantComposite %a1 %c3
%sh4 = OpConstantComposite %a1 %c4
%t_x = OpTypeTensorARM %i8 %c4 %sh_x
%t_y = OpTypeTensorARM %i8 %c4 %sh_y
%t_acc = OpTypeTensorARM %i32 %c4 %sh_y
%t_w = OpTypeTensorARM %i8 %c4 %sh_w
%t_i8_1 = OpTypeTensorARM %i8 %c1 %sh1
%t_i8_3 = OpTypeTensorARM %i8 %c1 %sh3
%t_i32_1 = OpTypeTensorARM %i32 %c1 %sh1
%t_i32_2 = OpTypeTensorARM %i32 %c1 %sh2
%t_i32_3 = OpTypeTensorARM %i32 %c1 %sh3
%t_i32_4 = OpTypeTensorARM %i32 %c1 %sh4
%p_x = OpTypePointer UniformConstant %t_x
%p_y = OpTypePointer UniformConstant %t_y
%x = OpVariable %p_x UniformConstant
%y = OpVariable %p_y UniformConstant
%pad = OpConstantComposite %t_i32_4 %c0 %c0 %c0 %c0
%ones = OpConstantComposite %t_i32_2 %c1 %c1
%w = OpGraphConstantARM %t_w 0
%bias = OpGraphConstantARM %t_i32_3 1
%zpx_v = OpConstant %i8 253
%zpx = OpConstantComposite %t_i8_1 %zpx_v
%zp0 = OpConstantNull %t_i8_1
%zp0_32 = OpConstantNull %t_i32_1
%m0 = OpConstant %i32 1073741824
%m1 = OpConstant %i32 1518500250
%m2 = OpConstant %i32 2021161081
%mult = OpConstantComposite %t_i32_3 %m0 %m1 %m2
%s37 = OpConstant %i8 37
%s38 = OpConstant %i8 38
%s39 = OpConstant %i8 39
%shift = OpConstantComposite %t_i8_3 %s37 %s38 %s39
%zpy_v = OpConstant %i8 4
%zpy = OpConstantComposite %t_i8_1 %zpy_v
%gt = OpTypeGraphARM 1 %t_x %t_y
OpGraphEntryPointARM %g "main_graph" %x %y
%g = OpGraphARM %gt
%in = OpGraphInputARM %t_x %c0
%acc = OpExtInst %t_acc %tosa CONV2D %pad %ones %ones %c1 %false %in %w %bias %zpx %zp0
%out = OpExtInst %t_y %tosa RESCALE %true %c1 %true %false %false %acc %mult %shift %zp0_32 %zpy
OpGraphSetOutputARM %out %c0
OpGraphEndARM
)";

const std::vector<uint8_t> kWeights{1, 2, 3, 4, 5, 250};
const std::vector<uint8_t> kBias{1, 0, 0, 0, 2, 0, 0, 0, 0xff, 0xff, 0xff, 0xff};

SpirvGraphOptions convolution_constants() {
  SpirvGraphOptions options;
  options.constants = {{1, kBias}, {5, kWeights}, {0, kWeights}};
  return options;
}

TEST(SpirvGraph, ReadsAConvolution) {
  EXPECT_EQ(outcome(kConvolution, convolution_constants()), R"(graph main_graph {
  input %x : i8[1,4,4,2]
  const %graph_constant_0 : i8[3,1,1,2] = [1,2,3,4,5,-6]
  const %graph_constant_1 : i32[3] = [1,2,-1]
  const %constant_2 : i8[1] = [-3]
  const %constant_3 : i8[1] = [0]
  const %constant_4 : i32[3] = [1073741824,1518500250,2021161081]
  const %constant_5 : i8[3] = [37,38,39]
  const %constant_6 : i32[1] = [0]
  const %constant_7 : i8[1] = [4]
  %conv2d_0 = conv2d %x, %graph_constant_0, %graph_constant_1, %constant_2, %constant_3 {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], local_bound=false, acc_type=i32} : i32[1,4,4,3]
  %y = rescale %conv2d_0, %constant_4, %constant_5, %constant_6, %constant_7 {scale32=true, rounding_mode=single, per_channel=true, input_unsigned=false, output_unsigned=false} : i8[1,4,4,3]
  return %y
}
)");
}

TEST(SpirvGraph, ListsWhatAModuleNeeds) {
  const auto listed = must(list_spirv_entry_points(bytes_of(assemble_spirv(kConvolution))));
  ASSERT_EQ(listed.size(), 1u);
  EXPECT_EQ(listed[0].name, "main_graph");
  ASSERT_EQ(listed[0].inputs.size(), 1u);
  EXPECT_EQ(listed[0].inputs[0].name, "x");
  EXPECT_EQ(listed[0].inputs[0].set, 0u);
  EXPECT_EQ(listed[0].inputs[0].binding, 0u);
  EXPECT_EQ(type_text(listed[0].inputs[0].type), "i8[1,4,4,2]");
  EXPECT_TRUE(listed[0].inputs[0].ranked);
  ASSERT_EQ(listed[0].outputs.size(), 1u);
  EXPECT_EQ(listed[0].outputs[0].name, "y");
  EXPECT_EQ(listed[0].outputs[0].binding, 1u);
  EXPECT_EQ(listed[0].constant_ids, (std::vector<uint32_t>{0, 1}));
  ASSERT_EQ(listed[0].constant_types.size(), 2u);
  EXPECT_EQ(type_text(listed[0].constant_types[0]), "i8[3,1,1,2]");
  EXPECT_EQ(type_text(listed[0].constant_types[1]), "i32[3]");
}

TEST(SpirvGraph, WritesTheWordsOfTheFormat) {
  const Graph graph = graph_of(R"(graph net {
  input %x : i8[1,2]
  const %t : i32[1,2] = [7,0]
  const %zp : i8[1] = [-3]
  const %p : shape[4] = [0,0,1,0]
  %a = pad %x, %p, %zp : i8[1,3]
  %b = clamp %a {min_val=-4, max_val=5, nan_mode=propagate} : i8[1,3]
  %c = cast %x : i32[1,2]
  %d = add %c, %t : i32[1,2]
  return %b, %d
})");
  const SpirvGraphModule module = must(write_spirv_graph(graph, {.external_constants = true}));
  EXPECT_EQ(module.entry_point, "net");
  ASSERT_EQ(module.constants.size(), 1u);
  EXPECT_TRUE(module.constants[0] == *graph.value(*graph.find_value("t")).constant);
  const std::vector<uint32_t>& words = module.words;
  EXPECT_EQ(std::vector<uint32_t>(words.begin(), words.begin() + 5),
            (std::vector<uint32_t>{0x07230203, 0x00010500, 0, 39, 0}));
  EXPECT_EQ(words.back(), 0x0001105Au);
  EXPECT_EQ(spirv_text(words), R"(OpCapability 1
OpCapability 39
OpCapability 4174
OpCapability 4191
OpCapability 5345
OpExtension "SPV_ARM_tensors"
OpExtension "SPV_ARM_graph"
%1 = OpExtInstImport "TOSA.001000.1"
OpMemoryModel 0 3
OpName %10 "x"
OpName %15 "b"
OpName %18 "d"
OpName %21 "x"
OpName %27 "p"
OpName %31 "zp"
OpName %32 "a"
OpName %35 "b"
OpName %36 "c"
OpName %37 "t"
OpName %38 "d"
OpDecorate %10 34 0
OpDecorate %10 33 0
OpDecorate %15 34 0
OpDecorate %15 33 1
OpDecorate %18 34 0
OpDecorate %18 33 2
%2 = OpTypeInt 8 0
%3 = OpTypeInt 32 0
%4 = OpConstant %3 2
%5 = OpTypeArray %3 %4
%6 = OpConstant %3 1
%7 = OpConstantComposite %5 %6 %4
%8 = OpTypeTensorARM %2 %4 %7
%9 = OpTypePointer 0 %8
%10 = OpVariable %9 0
%11 = OpConstant %3 3
%12 = OpConstantComposite %5 %6 %11
%13 = OpTypeTensorARM %2 %4 %12
%14 = OpTypePointer 0 %13
%15 = OpVariable %14 0
%16 = OpTypeTensorARM %3 %4 %7
%17 = OpTypePointer 0 %16
%18 = OpVariable %17 0
%19 = OpTypeGraphARM 1 %8 %13 %16
%22 = OpConstant %3 0
%23 = OpTypeArray %3 %6
%24 = OpConstant %3 4
%25 = OpConstantComposite %23 %24
%26 = OpTypeTensorARM %3 %6 %25
%27 = OpConstantComposite %26 %22 %22 %6 %22
%28 = OpConstantComposite %23 %6
%29 = OpTypeTensorARM %2 %6 %28
%30 = OpConstant %2 253
%31 = OpConstantComposite %29 %30
%33 = OpConstant %2 252
%34 = OpConstant %2 5
%37 = OpGraphConstantARM %16 0
OpGraphEntryPointARM %20 "net" %10 %15 %18
%20 = OpGraphARM %19
%21 = OpGraphInputARM %8 %22
%32 = OpExtInst %13 %1 55 %21 %27 %31
%35 = OpExtInst %13 %1 10 %33 %34 %6 %32
%36 = OpExtInst %16 %1 64 %21
%38 = OpExtInst %16 %1 14 %36 %37
OpGraphSetOutputARM %35 %22
OpGraphSetOutputARM %38 %6
OpGraphEndARM
)");
  const auto listed = must(list_spirv_entry_points(bytes_of(words)));
  ASSERT_EQ(listed.size(), 1u);
  EXPECT_EQ(listed[0].inputs.size(), 1u);
  ASSERT_EQ(listed[0].outputs.size(), 2u);
  EXPECT_EQ(listed[0].outputs[1].binding, 2u);
  EXPECT_EQ(listed[0].constant_ids, (std::vector<uint32_t>{0}));
}

struct Slot {
  std::string name;  ///< empty: no OpName
  std::string type;
};

/// A module with one graph "net" and many types at hand; binding i is slot i, inputs first. The
/// body finds the inputs as %in0, %in1, ... and sets the outputs.
std::string module_of(const std::vector<Slot>& inputs, const std::vector<Slot>& outputs,
                      const std::string& declarations, const std::string& body) {
  std::string names, variables, interface, types, reads;
  for (size_t i = 0; i < inputs.size() + outputs.size(); ++i) {
    const Slot& slot = i < inputs.size() ? inputs[i] : outputs[i - inputs.size()];
    if (!slot.name.empty()) names += fmt::format("OpName %v{} \"{}\"\n", i, slot.name);
    names += fmt::format("OpDecorate %v{0} DescriptorSet 0\nOpDecorate %v{0} Binding {0}\n", i);
    variables += fmt::format(
        "%p{0} = OpTypePointer UniformConstant {1}\n%v{0} = OpVariable %p{0} UniformConstant\n", i,
        slot.type);
    interface += fmt::format(" %v{}", i);
    types += " " + slot.type;
    if (i < inputs.size())
      reads += fmt::format("%in{0} = OpGraphInputARM {1} %c{0}\n", i, slot.type);
  }
  return "%tosa = OpExtInstImport \"TOSA.001000.1\"\n" + names + R"(
%bool = OpTypeBool
%i8 = OpTypeInt 8 0
%i16 = OpTypeInt 16 1
%i32 = OpTypeInt 32 0
%i64 = OpTypeInt 64 0
%f32 = OpTypeFloat 32
%true = OpConstantTrue %bool
%false = OpConstantFalse %bool
%c0 = OpConstant %i32 0
%c1 = OpConstant %i32 1
%c2 = OpConstant %i32 2
%c3 = OpConstant %i32 3
%c4 = OpConstant %i32 4
%c5 = OpConstant %i32 5
%c6 = OpConstant %i32 6
%c7 = OpConstant %i32 7
%c8 = OpConstant %i32 8
%c9 = OpConstant %i32 9
%a1 = OpTypeArray %i32 %c1
%a2 = OpTypeArray %i32 %c2
%a3 = OpTypeArray %i32 %c3
%a4 = OpTypeArray %i32 %c4
%s1 = OpConstantComposite %a1 %c1
%s2 = OpConstantComposite %a1 %c2
%s3 = OpConstantComposite %a1 %c3
%s4 = OpConstantComposite %a1 %c4
%s6 = OpConstantComposite %a1 %c6
%s23 = OpConstantComposite %a2 %c2 %c3
%s32 = OpConstantComposite %a2 %c3 %c2
%s223 = OpConstantComposite %a3 %c2 %c2 %c3
%s1444 = OpConstantComposite %a4 %c1 %c4 %c4 %c4
%b1 = OpTypeTensorARM %i8 %c1 %s1
%b2 = OpTypeTensorARM %i8 %c1 %s2
%b3 = OpTypeTensorARM %i8 %c1 %s3
%b4 = OpTypeTensorARM %i8 %c1 %s4
%b6 = OpTypeTensorARM %i8 %c1 %s6
%b23 = OpTypeTensorARM %i8 %c2 %s23
%b32 = OpTypeTensorARM %i8 %c2 %s32
%b223 = OpTypeTensorARM %i8 %c3 %s223
%b1444 = OpTypeTensorARM %i8 %c4 %s1444
%flag2 = OpTypeTensorARM %bool %c1 %s2
%h1 = OpTypeTensorARM %i16 %c1 %s1
%h2 = OpTypeTensorARM %i16 %c1 %s2
%d1 = OpTypeTensorARM %i32 %c1 %s1
%d2 = OpTypeTensorARM %i32 %c1 %s2
%d4 = OpTypeTensorARM %i32 %c1 %s4
%d23 = OpTypeTensorARM %i32 %c2 %s23
%l2 = OpTypeTensorARM %i64 %c1 %s2
%f2 = OpTypeTensorARM %f32 %c1 %s2
%b_any = OpTypeTensorARM %i8
%b_4d = OpTypeTensorARM %i8 %c4
%b_2d = OpTypeTensorARM %i8 %c2
%d_any = OpTypeTensorARM %i32
%d_4d = OpTypeTensorARM %i32 %c4
%zero8 = OpConstantNull %b1
%zero32 = OpConstantNull %d1
)" + declarations +
         variables +
         fmt::format(
             "%gt = OpTypeGraphARM {}{}\nOpGraphEntryPointARM %g \"net\"{}\n"
             "%g = OpGraphARM %gt\n{}{}OpGraphEndARM\n",
             inputs.size(), types, interface, reads, body);
}

TEST(SpirvGraph, ReadsEveryKindOfConstant) {
  const std::vector<std::string> types{"%flag2", "%flag2", "%b23", "%b223", "%h2",
                                       "%l2",    "%b223",  "%b23", "%d2"};
  std::vector<Slot> outputs;
  std::string names, sets;
  for (size_t i = 0; i < types.size(); ++i) {
    outputs.push_back({"", types[i]});
    names += fmt::format("OpName %k{0} \"k{0}\"\n", i);
    sets += fmt::format("OpGraphSetOutputARM %k{0} %c{0}\n", i);
  }
  const std::string module = module_of({}, outputs, names + R"(
%spec_false = OpSpecConstantFalse %bool
%spec_true = OpSpecConstantTrue %bool
%m1 = OpConstant %i8 255
%e7 = OpSpecConstant %i8 7
%e0 = OpConstantNull %i8
%row = OpConstantComposite %b3 %m1 %e7 %e0
%zero_row = OpConstantNull %b3
%nine = OpConstant %i8 9
%nine_row = OpConstantCompositeReplicateEXT %b3 %nine
%h = OpConstant %i16 65236
%hs = OpConstant %i16 -301
%l = OpConstant %i64 0 -32768
%lm = OpConstant %i64 -1 32767
%k0 = OpConstantComposite %flag2 %true %spec_false
%k1 = OpSpecConstantComposite %flag2 %spec_true %true
%k2 = OpConstantComposite %b23 %row %zero_row
%plane = OpConstantComposite %b23 %nine_row %row
%k3 = OpSpecConstantCompositeReplicateEXT %b223 %plane
%k4 = OpConstantComposite %h2 %h %hs
%k5 = OpConstantComposite %l2 %l %lm
%k6 = OpConstantNull %b223
%external_row = OpGraphConstantARM %b3 4000000000
%k7 = OpConstantComposite %b23 %row %external_row
%k8 = OpGraphConstantARM %d2 8
)",
                                       sets);
  const std::vector<uint8_t> row{1, 2, 128}, pair{1, 0, 0, 0, 254, 255, 255, 255};
  SpirvGraphOptions options;
  options.constants = {{4000000000, row}, {8, pair}};
  EXPECT_EQ(outcome(module, options), R"(graph net {
  const %k0 : bool[2] = [1,0]
  const %k1 : bool[2] = [1,1]
  const %k2 : i8[2,3] = [-1,7,0,0,0,0]
  const %k3 : i8[2,2,3] = [9,9,9,-1,7,0,9,9,9,-1,7,0]
  const %k4 : i16[2] = [-300,-301]
  const %k5 : i48[2] = [-140737488355328,140737488355327]
  const %k6 : i8[2,2,3] = [0,0,0,0,0,0,0,0,0,0,0,0]
  const %k7 : i8[2,3] = [-1,7,0,1,2,-128]
  const %k8 : i32[2] = [1,-2]
  return %k0, %k1, %k2, %k3, %k4, %k5, %k6, %k7, %k8
}
)");
  const auto listed = must(list_spirv_entry_points(bytes_of(assemble_spirv(module))));
  EXPECT_EQ(listed[0].constant_ids, (std::vector<uint32_t>{8, 4000000000}));
}

TEST(SpirvGraph, ReadsFloatsThoughTheProfileHasNone) {
  const std::string module = module_of(
      {}, {{"", "%f2"}}, "%f = OpConstant %f32 1065353216\n%k = OpConstantComposite %f2 %f %f\n",
      "OpGraphSetOutputARM %k %c0\n");
  const Graph graph = must(read_spirv_graph(bytes_of(assemble_spirv(module)), {}));
  EXPECT_EQ(graph.values[0].type, (TensorType{DType::kFp32, {2}}));
  EXPECT_EQ(graph.values[0].constant->bytes, (std::vector<uint8_t>{0, 0, 128, 63, 0, 0, 128, 63}));
}

TEST(SpirvGraph, TakesOperandsAsProducersGiveThem) {
  // A plain array as a shape, as it stands in the type too.
  EXPECT_EQ(outcome(module_of({{"x", "%b23"}}, {{"y", "%b6"}}, "",
                              "%r = OpExtInst %b6 %tosa RESHAPE %in0 %s6\n"
                              "OpGraphSetOutputARM %r %c0\n")),
            R"(graph net {
  input %x : i8[2,3]
  const %constant_0 : shape[1] = [6]
  %y = reshape %x, %constant_0 : i8[6]
  return %y
}
)");
  // One constant as a shape and as a tensor; 16-bit integers where the set says 32.
  EXPECT_EQ(outcome(module_of({{"x", "%b23"}}, {{"y", "%b23"}, {"z", "%d4"}},
                              "OpName %k \"k\"\n%k = OpConstantNull %d4\n"
                              "%h0 = OpConstant %i16 0\n%h1c = OpConstant %i16 1\n"
                              "%perms = OpConstantComposite %h2 %h1c %h0\n",
                              "%r = OpExtInst %b23 %tosa PAD %in0 %k %zero8\n"
                              "%s = OpExtInst %b32 %tosa TRANSPOSE %perms %r\n"
                              "%t = OpExtInst %d4 %tosa ABS %k\n"
                              "OpGraphSetOutputARM %r %c0\nOpGraphSetOutputARM %t %c1\n")),
            R"(graph net {
  input %x : i8[2,3]
  const %k : shape[4] = [0,0,0,0]
  const %constant_1 : i8[1] = [0]
  const %k.1 : i32[4] = [0,0,0,0]
  %y = pad %x, %k, %constant_1 : i8[2,3]
  %transpose_1 = transpose %y {perms=[1,0]} : i8[3,2]
  %z = abs %k.1 : i32[4]
  return %y, %z
}
)");
  // Limits as unsigned bytes, a flag as a specialization constant, int32 multipliers of 16 bits.
  EXPECT_EQ(outcome(module_of({{"x", "%b2"}}, {{"y", "%b2"}},
                              "%low = OpConstant %i8 253\n%high = OpConstant %i8 3\n"
                              "%yes = OpSpecConstantTrue %bool\n%shifts = OpConstantNull %b2\n"
                              "%m = OpConstant %i32 32767\n%ms = OpConstantComposite %d1 %m\n"
                              "%e15 = OpConstant %i8 15\n%es = OpConstantComposite %b1 %e15\n",
                              "%r = OpExtInst %b2 %tosa CLAMP %low %high %c1 %in0\n"
                              "%s = OpExtInst %b2 %tosa ARITHMETIC_RIGHT_SHIFT %yes %r %shifts\n"
                              "%t = OpExtInst %b2 %tosa RESCALE %false %c1 %false %false %false %s "
                              "%ms %es %zero8 %zero8\n"
                              "OpGraphSetOutputARM %t %c0\n")),
            R"(graph net {
  input %x : i8[2]
  const %constant_0 : i8[2] = [0,0]
  const %constant_1 : i16[1] = [32767]
  const %constant_2 : i8[1] = [15]
  const %constant_3 : i8[1] = [0]
  %clamp_0 = clamp %x {min_val=-3, max_val=3, nan_mode=propagate} : i8[2]
  %arithmetic_right_shift_1 = arithmetic_right_shift %clamp_0, %constant_0 {round=true} : i8[2]
  %y = rescale %arithmetic_right_shift_1, %constant_1, %constant_2, %constant_3, %constant_3 {scale32=false, rounding_mode=single, per_channel=false, input_unsigned=false, output_unsigned=false} : i8[2]
  return %y
}
)");
}

TEST(SpirvGraph, SkipsWhatCarriesNothing) {
  const std::string plain =
      module_of({{"x", "%b2"}}, {{"y", "%b2"}}, "",
                "%r = OpExtInst %b2 %tosa BITWISE_NOT %in0\nOpGraphSetOutputARM %r %c0\n");
  std::string decorated = module_of({{"x", "%b2"}}, {{"y", "%b2"}},
                                    "%void = OpTypeVoid\n%pair = OpTypeStruct %i8 %i8\n"
                                    "%both = OpConstantNull %pair\n"
                                    "%note = OpExtInst %void %debug 1 %file\n",
                                    "OpLine %file 3 4\n%n = OpExtInst %void %debug 2 %in0\n"
                                    "%r = OpExtInst %b2 %tosa BITWISE_NOT %in0\n"
                                    "OpGraphSetOutputARM %r %c0\n");
  decorated =
      "OpCapability Shader\n%debug = OpExtInstImport \"NonSemantic.Graph.DebugInfo.1\"\n"
      "OpSource 0 1\n%file = OpString \"a b.py\"\nOpDecorate %v0 24\n" +
      decorated;
  EXPECT_EQ(outcome(decorated), outcome(plain));
  EXPECT_TRUE(outcome(plain).starts_with("graph net {")) << outcome(plain);
}

/// BITWISE_NOT of %x to %y, both of one type.
std::string not_module(const std::string& type) {
  return module_of(
      {{"x", type}}, {{"y", type}}, "",
      "%r = OpExtInst " + type + " %tosa BITWISE_NOT %in0\nOpGraphSetOutputARM %r %c0\n");
}

TEST(SpirvGraph, LeavesOpenWhatNobodyKnows) {
  const std::string module = not_module("%b_4d");
  EXPECT_EQ(outcome(module), R"(graph net {
  input %x : i8[?,?,?,?]
  %y = bitwise_not %x : i8[?,?,?,?]
  return %y
}
)");
  const auto listed = must(list_spirv_entry_points(bytes_of(assemble_spirv(module))));
  EXPECT_EQ(type_text(listed[0].inputs[0].type), "i8[?,?,?,?]");
  EXPECT_TRUE(listed[0].inputs[0].ranked);
  // Shapes of the outside that leave sizes open do so here too.
  SpirvGraphOptions options;
  options.interface = {{0, 0, {DType::kInt8, {1, kDynamic, kDynamic, 12}}, "colors"},
                       {0, 1, {DType::kUnknown, {1, kDynamic, kDynamic, 12}}, "result"}};
  EXPECT_EQ(outcome(module, options), R"(graph net {
  input %colors : i8[1,?,?,12]
  %result = bitwise_not %colors : i8[1,?,?,12]
  return %result
}
)");
  // Known inputs settle the results.
  options.interface = {{0, 0, {DType::kInt8, {1, 2, 3, 12}}, ""}};
  EXPECT_EQ(outcome(module, options), R"(graph net {
  input %x : i8[1,2,3,12]
  %y = bitwise_not %x : i8[1,2,3,12]
  return %y
}
)");
  options.interface.push_back({0, 1, {DType::kInt8, {1, kDynamic, 4, 12}}, ""});
  EXPECT_EQ(outcome(module, options),
            "node %0 \"y\" (bitwise_not): declares its result as i8[1,?,4,12], its operands give "
            "i8[1,2,3,12]");
}

TEST(SpirvGraph, TakesRanksFromOutside) {
  const std::string module =
      module_of({{"x", "%b_any"}}, {{"y", "%b_any"}}, "",
                "%r = OpExtInst %b_any %tosa BITWISE_NOT %in0\n%s = OpExtInst %b_any %tosa "
                "BITWISE_NOT %r\nOpGraphSetOutputARM %s %c0\n");
  const auto listed = must(list_spirv_entry_points(bytes_of(assemble_spirv(module))));
  EXPECT_FALSE(listed[0].inputs[0].ranked);
  EXPECT_EQ(outcome(module),
            "input 0 \"x\": its rank is open; give it with --input-shape x=N,H,W,C");
  SpirvGraphOptions options;
  options.input_shapes = {{"x", {2, 5}}};
  const std::string closed = R"(graph net {
  input %x : i8[2,5]
  %bitwise_not_0 = bitwise_not %x : i8[2,5]
  %y = bitwise_not %bitwise_not_0 : i8[2,5]
  return %y
}
)";
  EXPECT_EQ(outcome(module, options), closed);
  options.input_shapes = {{"x", {2, 0}}};
  EXPECT_EQ(outcome(module, options), "input 0 \"x\": [2,0] is no shape");
  options = {};
  options.interface = {{0, 0, {DType::kInt8, {2, 5}}, ""}};
  EXPECT_EQ(outcome(module, options), closed);
  // With open sizes the rank of what follows stays open.
  options.interface = {{0, 0, {DType::kInt8, {2, kDynamic}}, ""}};
  EXPECT_EQ(outcome(module, options), R"(graph net {
  input %x : i8[2,?]
  %bitwise_not_0 = bitwise_not %x : i8[?]
  %y = bitwise_not %bitwise_not_0 : i8[?]
  return %y
}
)");
}

TEST(SpirvGraph, RefusesAnInterfaceThatContradictsTheModule) {
  const std::string ranked = not_module("%b_4d");
  const std::string shaped = not_module("%b1444");
  const auto with = [](const std::string& module, TensorType type) {
    SpirvGraphOptions options;
    options.interface = {{0, 0, std::move(type), ""}};
    return outcome(module, options);
  };
  EXPECT_EQ(with(ranked, {DType::kInt16, {}}), "input 0 \"x\": is i16 outside, the module has i8");
  EXPECT_EQ(with(ranked, {DType::kInt8, {2, 2}}),
            "input 0 \"x\": is [2,2] outside, the module has [?,?,?,?]");
  EXPECT_EQ(with(ranked, {DType::kInt8, {1, 0, 1, 1}}),
            "input 0 \"x\": has a size of 0 outside, expected at least 1");
  EXPECT_EQ(with(ranked, {DType::kInt8, {1, 1 << 30, 2, 1}}),
            "input 0 \"x\": has shape [1,1073741824,2,1], level 8K ends at 2147483647 elements");
  EXPECT_EQ(with(shaped, {DType::kInt8, {1, 4, 4, 5}}),
            "input 0 \"x\": is [1,4,4,5] outside, the module has [1,4,4,4]");
  EXPECT_EQ(with(not_module("%b_any"), {DType::kInt8, Shape(7, 1)}),
            "input 0 \"x\": has rank 7, level 8K ends at rank 6");
  EXPECT_TRUE(with(shaped, {DType::kInt8, {1, kDynamic, 4, 4}}).starts_with("graph net"));
}

TEST(SpirvGraph, SettlesAnyChainOnceInputsAreKnown) {
  // As a network with open height and width: convolutions, resizes, concatenations, all rank-only.
  const std::string module = module_of({{"x", "%b_4d"}}, {{"y", "%b_4d"}}, R"(
%w_shape = OpConstantComposite %a4 %c4 %c3 %c3 %c4
%wt = OpTypeTensorARM %i8 %c4 %w_shape
%w = OpConstantNull %wt
%pad = OpConstantComposite %d4 %c1 %c0 %c1 %c0
%twos = OpConstantComposite %d2 %c2 %c2
%ones = OpConstantComposite %d2 %c1 %c1
%m = OpConstant %i32 1073741824
%multiplier = OpConstantComposite %d1 %m
%e38 = OpConstant %i8 38
%shift = OpConstantComposite %b1 %e38
%scale = OpConstantComposite %d4 %c4 %c2 %c4 %c2
%minus = OpConstant %i32 -1
%offset = OpConstantComposite %d2 %minus %minus
)",
                                       R"(
%conv = OpExtInst %d_4d %tosa CONV2D %pad %twos %ones %c1 %false %in0 %w %zero32 %zero8 %zero8
%q = OpExtInst %b_4d %tosa RESCALE %true %c1 %false %false %false %conv %multiplier %shift %zero32 %zero8
%up = OpExtInst %b_4d %tosa RESIZE %c1 %q %scale %offset %ones
%up2 = OpExtInst %b_4d %tosa RESIZE %c1 %q %scale %offset %ones
%cat = OpExtInst %b_4d %tosa CONCAT %c3 %up %in0 %up2
OpGraphSetOutputARM %cat %c0
)");
  EXPECT_EQ(outcome(module).substr(0, 41), "graph net {\n  input %x : i8[?,?,?,?]\n  co");
  SpirvGraphOptions options;
  options.interface = {{0, 0, {DType::kInt8, {1, 8, 6, 4}}, ""}};
  const Graph graph = must(read_spirv_graph(bytes_of(assemble_spirv(module)), options));
  EXPECT_TRUE(verify(graph)) << error_text(verify(graph));
  EXPECT_EQ(type_text(graph.value(graph.outputs[0]).type), "i8[1,8,6,12]");
  const auto module_again = must(write_spirv_graph(graph, {}));
  EXPECT_TRUE(must(reread(module_again)) == graph);
}

TEST(SpirvGraph, CarriesEveryFloatingPointOperator) {
  // bfloat16 and float8 have encodings, transforms are split out of a struct.
  for (const FloatCase& each : float_cases()) {
    const Graph again = must(reread(must(write_spirv_graph(each.graph, {}))), each.name);
    const auto verified = verify(again);
    ASSERT_TRUE(verified) << each.name << ": " << error_text(verified);
    EXPECT_EQ(must(interpret(again, each.inputs)), must(interpret(each.graph, each.inputs)))
        << each.name;
  }
}

TEST(SpirvGraph, ReadsOnlyTheChosenEntryPoint) {
  std::string module = module_of({{"x", "%b2"}}, {{"y", "%b2"}}, "%w = OpGraphConstantARM %b2 3\n",
                                 "%r = OpExtInst %b2 %tosa 66 %w\nOpGraphSetOutputARM %r %c0\n");
  module += R"(OpGraphEntryPointARM %g2 "other" %v1 %v0
%g2 = OpGraphARM %gt
%in_other = OpGraphInputARM %b2 %c0
%r2 = OpExtInst %b2 %tosa BITWISE_NOT %in_other
OpGraphSetOutputARM %r2 %c0
OpGraphEndARM
)";
  EXPECT_EQ(outcome(module), "the module has 2 entry points, choose one: \"net\", \"other\"");
  SpirvGraphOptions options;
  options.entry_point = "third";
  EXPECT_EQ(outcome(module, options),
            "the module has no entry point \"third\", it has \"net\", \"other\"");
  options.entry_point = "other";
  EXPECT_EQ(outcome(module, options), R"(graph other {
  input %y : i8[2]
  %x = bitwise_not %y : i8[2]
  return %x
}
)");
  options.entry_point = "net";
  EXPECT_EQ(outcome(module, options),
            "word 310 (OpExtInst): operator number 66 is not in TOSA.001000.1");
  const auto listed = must(list_spirv_entry_points(bytes_of(assemble_spirv(module))));
  ASSERT_EQ(listed.size(), 2u);
  EXPECT_EQ(listed[0].constant_ids, (std::vector<uint32_t>{3}));
  EXPECT_EQ(listed[1].constant_ids, (std::vector<uint32_t>{}));
}

TEST(SpirvGraph, GivesEveryOutputItsName) {
  const std::string body = R"(
%r = OpExtInst %b2 %tosa BITWISE_NOT %in0
OpGraphSetOutputARM %r %c3
OpGraphSetOutputARM %r %c0
OpGraphSetOutputARM %in0 %c1
OpGraphSetOutputARM %k %c2
OpGraphSetOutputARM %in0 %c4
OpGraphSetOutputARM %r %c5
)";
  EXPECT_EQ(outcome(module_of(
                {{"x", "%b2"}},
                {{"a", "%b2"}, {"b", "%b2"}, {"c", "%b2"}, {"d", "%b2"}, {"x", "%b2"}, {"", "%b2"}},
                "OpName %r \"inner\"\nOpName %k \"a\"\n%k = OpConstantNull %b2\n", body)),
            R"(graph net {
  input %x : i8[2]
  const %a.1 : i8[2] = [0,0]
  %a = bitwise_not %x : i8[2]
  %b = identity %x : i8[2]
  %c = identity %a.1 : i8[2]
  %d = identity %a : i8[2]
  return %a, %b, %c, %d, %x, %a
}
)");
  // Without names, and with doubles.
  EXPECT_EQ(outcome(module_of({{"", "%b2"}, {"same", "%b2"}, {"same", "%b2"}}, {{"", "%b2"}},
                              "OpName %in0 \"same\"\n",
                              "%r = OpExtInst %b2 %tosa BITWISE_NOT %in1\n"
                              "%s = OpExtInst %b2 %tosa BITWISE_NOT %r\n"
                              "OpGraphSetOutputARM %s %c0\n")),
            R"(graph net {
  input %same : i8[2]
  input %same.1 : i8[2]
  input %same.2 : i8[2]
  %bitwise_not_0 = bitwise_not %same.1 : i8[2]
  %output_0 = bitwise_not %bitwise_not_0 : i8[2]
  return %output_0
}
)");
}

/// Two arrays of two tensors: element e of output i is the other element of input i, turned round.
const std::string kArrays =
    module_of({{"x", "%pair"}, {"", "%pair"}}, {{"y", "%pair"}, {"z", "%b3"}},
              "%pair = OpTypeArray %b2 %c2\n", R"(
%x1 = OpGraphInputARM %b2 %c0 %c1
%x0 = OpGraphInputARM %b2 %c0 %c0
%b1_in = OpGraphInputARM %b2 %c1 %c1
%r = OpExtInst %b2 %tosa BITWISE_XOR %x0 %b1_in
%q = OpExtInst %b2 %tosa BITWISE_NOT %x1
OpGraphSetOutputARM %q %c0 %c1
OpGraphSetOutputARM %r %c0 %c0
OpGraphSetOutputARM %k %c1
)");

TEST(SpirvGraph, TakesArraysOfTensorsElementByElement) {
  // The helper reads whole inputs, which arrays have not.
  std::string module = kArrays;
  for (const char* line :
       {"%in0 = OpGraphInputARM %pair %c0\n", "%in1 = OpGraphInputARM %pair %c1\n"}) {
    const size_t at = module.find(line);
    ASSERT_NE(at, std::string::npos);
    module.erase(at, std::string(line).size());
  }
  module.insert(module.find("%pair = "), "%k = OpConstantNull %b3\n");
  EXPECT_EQ(outcome(module), R"(graph net {
  input %x.0 : i8[2]
  input %x.1 : i8[2]
  input %input_2 : i8[2]
  input %input_3 : i8[2]
  const %constant_0 : i8[3] = [0,0,0]
  %y.0 = bitwise_xor %x.0, %input_3 : i8[2]
  %y.1 = bitwise_not %x.1 : i8[2]
  %z = identity %constant_0 : i8[3]
  return %y.0, %y.1, %z
}
)");
  const auto listed = must(list_spirv_entry_points(bytes_of(assemble_spirv(module))));
  ASSERT_EQ(listed[0].inputs.size(), 4u);
  EXPECT_EQ(listed[0].inputs[1].name, "x.1");
  EXPECT_EQ(listed[0].inputs[3].binding, 1u);
  EXPECT_EQ(listed[0].inputs[3].element, 1u);
  EXPECT_EQ(listed[0].outputs[2].element, std::nullopt);
  SpirvGraphOptions options;
  options.interface = {{0, 0, {DType::kUnknown, {}}, "given"}};
  EXPECT_NE(outcome(module, options).find("input %given.1 : i8[2]"), std::string::npos);
  const auto refused = [&](const std::string& from, const std::string& to) {
    std::string changed = module;
    changed.replace(changed.find(from), from.size(), to);
    const std::string text = outcome(changed);
    return text.substr(std::min(text.find("): "), text.size()));
  };
  EXPECT_EQ(refused("%b2 %c0 %c1", "%b2 %c0 %c2"),
            "): the element index is 2, input 0 has 2 tensors");
  EXPECT_EQ(refused("%b2 %c0 %c1", "%b2 %c0 %c0"), "): input 0 is read a second time");
  EXPECT_EQ(refused("%q %c0 %c1", "%q %c0 %c0"), "): output 0 is set a second time");
  EXPECT_EQ(refused("OpGraphSetOutputARM %q %c0 %c1\n", ""),
            "): the graph sets 2 of its 3 outputs");
  EXPECT_EQ(refused("%q %c0 %c1", "%q %c0"),
            "): output 0 is an array of 2 tensors, which is taken element by element: its element "
            "index is missing");
}

TEST(SpirvGraph, AGraphConstantMayHaveItsShapeFromOutside) {
  const std::string module =
      module_of({{"x", "%b2"}}, {{"y", "%b2"}, {"table", "%open"}},
                "%open = OpTypeTensorARM %i8 %c2\n%k = OpGraphConstantARM %open 4\n",
                "%r = OpExtInst %b2 %tosa BITWISE_NOT %in0\n"
                "OpGraphSetOutputARM %r %c0\nOpGraphSetOutputARM %k %c1\n");
  const std::vector<uint8_t> bytes{1, 2, 3, 4, 5, 6};
  SpirvGraphOptions options;
  options.constants = {{4, bytes, {2, 3}}};
  EXPECT_NE(outcome(module, options).find("const %graph_constant_4 : i8[2,3] = [1,2,3,4,5,6]"),
            std::string::npos)
      << outcome(module, options);
  options.constants[0].shape = {};
  EXPECT_EQ(
      outcome(module, options),
      "output 1, operand: graph constant 4: is i8[?,?] in the module and nothing else outside, "
      "so its shape is not known");
  options.constants[0].shape = {2, 2};
  EXPECT_EQ(outcome(module, options),
            "output 1, operand: graph constant 4: has 6 bytes of data, i8[2,2] needs 4");
  options.constants[0].shape = {-1, 3};
  EXPECT_EQ(
      outcome(module, options),
      "output 1, operand: graph constant 4: is [?,3] outside, which is no shape of a constant");
  EXPECT_EQ(must(list_spirv_entry_points(bytes_of(assemble_spirv(module))))[0].constant_types[0],
            (TensorType{DType::kInt8, {kDynamic, kDynamic}}));
}

TEST(SpirvGraph, WritesOpenSizes) {
  const Graph graph = must(parse_text(R"(graph main {
  input %x : i8[1,?,?,4]
  input %k : i8[1,1,1,4]
  input %list : i8[?]
  %y = bitwise_xor %x, %k : i8[1,?,?,4]
  %z = bitwise_not %k : i8[1,1,1,4]
  %r = bitwise_not %list : i8[?]
  return %y, %z, %r
})"));
  EXPECT_FALSE(verify(graph));
  EXPECT_EQ(print_text(must(reread(must(write_spirv_graph(graph, {}))))), R"(graph main {
  input %x : i8[?,?,?,?]
  input %k : i8[1,1,1,4]
  input %list : i8[?]
  %y = bitwise_xor %x, %k : i8[?,?,?,?]
  %z = bitwise_not %k : i8[1,1,1,4]
  %r = bitwise_not %list : i8[?]
  return %y, %z, %r
}
)");
}

TEST(SpirvGraph, KeepsAliasesThroughWriteAndRead) {
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[2]
  const %c : i8[2] = [1,2]
  %y = bitwise_not %x : i8[2]
  %a = identity %x : i8[2]
  %b = identity %c : i8[2]
  %d = identity %y : i8[2]
  return %y, %x, %a, %c, %b, %y, %d
})");
  for (const bool external : {false, true}) {
    const auto module = must(write_spirv_graph(graph, {.external_constants = external}));
    EXPECT_EQ(module.constants.size(), external ? 1u : 0u);
    const Graph again = must(reread(module));
    EXPECT_TRUE(again == graph) << print_text(again);
  }
}

TEST(SpirvGraph, RewritesWhatTheFormatHasNot) {
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[1,1,1,2]
  input %s : i32[]
  input %v : i8[3]
  const %w : i4[1,1,1,2] = [-7,3]
  const %b : i32[1] = [5]
  const %zp : i8[1] = [0]
  const %wzp : i4[1] = [0]
  const %one : i32[] = [1]
  const %p : shape[0] = []
  const %e : i4[3] = [1,2,3]
  %m = identity %x : i8[1,1,1,2]
  %y = conv2d %m, %w, %b, %zp, %wzp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,1,1,1]
  %t = add %s, %one : i32[]
  %i = argmax %v {axis=0} : i32[]
  %r = reshape %y, %p : i32[]
  return %y, %t, %i, %r, %e
})");
  const auto module = must(write_spirv_graph(graph, {}));
  const Graph again = must(reread(module));
  EXPECT_TRUE(verify(again)) << error_text(verify(again));
  EXPECT_EQ(print_text(again), R"(graph main {
  input %x : i8[1,1,1,2]
  input %s : i32[1]
  input %v : i8[3]
  const %w : i8[1,1,1,2] = [-7,3]
  const %b : i32[1] = [5]
  const %zp : i8[1] = [0]
  const %wzp : i8[1] = [0]
  const %one : i32[1] = [1]
  const %column_shape : shape[2] = [3,1]
  const %scalar_shape : shape[1] = [1]
  const %e : i8[3] = [1,2,3]
  %y = conv2d %x, %w, %b, %zp, %wzp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], local_bound=false, acc_type=i32} : i32[1,1,1,1]
  %t = add %s, %one : i32[1]
  %column = reshape %v, %column_shape : i8[3,1]
  %i = argmax %column {axis=0, nan_mode=propagate} : i32[1]
  %r = reshape %y, %scalar_shape : i32[1]
  return %y, %t, %i, %r, %e
}
)");
  expect_equal_bytes(graph, again, "rewritten");
}

TEST(SpirvGraph, WritesOperandsOutsideByTheirRole) {
  Graph graph = graph_of(R"(graph main {
  input %x : i8[1,1,1,2]
  const %w : i8[1,1,1,2] = [-7,3]
  const %b : i32[1] = [5]
  const %zp : i8[1] = [0]
  const %m : i32[1] = [1073741824]
  const %shift : i8[1] = [30]
  const %zp32 : i32[1] = [0]
  const %both : i8[1] = [9]
  const %p : shape[1] = [1]
  const %mask : i8[1] = [15]
  %y = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,1,1,1]
  %z = rescale %y, %m, %shift, %zp32, %both {scale32=true, rounding_mode=single} : i8[1,1,1,1]
  %f = reshape %z, %p : i8[1]
  %g = bitwise_and %f, %both : i8[1]
  %h = bitwise_or %g, %mask : i8[1]
  return %h, %zp
})");
  const auto module = must(write_spirv_graph(graph, {.external_constants = true}));
  std::vector<std::string> types;
  for (const Tensor& constant : module.constants)
    types.push_back(type_text(constant.type) + fmt::format(" {}", constant.ints()[0]));
  EXPECT_EQ(fmt::format("{}", fmt::join(types, ", ")), "i8[1,1,1,2] -7, i32[1] 5, i8[1] 15");
  EXPECT_TRUE(must(reread(module)) == graph);
}

/// One operator between an input and an output, and a graph constant that nothing uses.
const std::string kSmall = R"(
%tosa = OpExtInstImport "TOSA.001000.1"
OpName %x "x"
OpDecorate %x DescriptorSet 0
OpDecorate %x Binding 0
OpDecorate %y DescriptorSet 0
OpDecorate %y Binding 1
%i8 = OpTypeInt 8 0
%i32 = OpTypeInt 32 0
%bool = OpTypeBool
%f64 = OpTypeFloat 64
%c0 = OpConstant %i32 0
%c1 = OpConstant %i32 1
%c2 = OpConstant %i32 2
%c7 = OpConstant %i32 7
%e3 = OpConstant %i8 3
%max = OpConstant %i32 2147483647
%a1 = OpTypeArray %i32 %c1
%a2 = OpTypeArray %i32 %c2
%sh = OpConstantComposite %a1 %c2
%sh0 = OpConstantComposite %a1 %c0
%huge = OpConstantComposite %a2 %max %c2
%t = OpTypeTensorARM %i8 %c1 %sh
%t2 = OpTypeTensorARM %i32 %c1 %sh
%tr = OpTypeTensorARM %i8 %c1
%ta = OpTypeArray %t %c2
%k = OpConstantComposite %t %e3 %e3
%c13 = OpConstant %i32 13
%a13 = OpTypeArray %i32 %c13
%long = OpConstantNull %a13
%p = OpTypePointer UniformConstant %t
%x = OpVariable %p UniformConstant
%y = OpVariable %p UniformConstant
%w = OpGraphConstantARM %t 7
%gt = OpTypeGraphARM 1 %t %t
OpGraphEntryPointARM %g "main" %x %y
%g = OpGraphARM %gt
%in = OpGraphInputARM %t %c0
%sum = OpExtInst %t %tosa CLAMP %e3 %e3 %c1 %in
OpGraphSetOutputARM %sum %c0
OpGraphEndARM
)";

TEST(SpirvGraph, RefusesWhatBreaksARule) {
  EXPECT_TRUE(outcome(kSmall).starts_with("graph main {")) << outcome(kSmall);
  struct Row {
    const char *from, *to, *error;
  };
  const Row rows[] = {
      // Graph type.
      {"OpTypeGraphARM 1 %t %t", "OpTypeGraphARM 1 %t",
       "word 138 (OpTypeGraphARM): has 1 types for 1 inputs, expected at least one output"},
      {"OpTypeGraphARM 1 %t %t", "OpTypeGraphARM 1 %t %i8",
       "word 138 (OpTypeGraphARM): the type %4 is no tensor and no array of tensors of fixed "
       "length"},
      {"OpTypeGraphARM 1 %t %t", "OpTypeGraphARM 1 %ta %t",
       "word 152 (OpGraphInputARM): input 0 is an array of 2 tensors, which is taken element by "
       "element: its element index is missing"},
      // Entry point.
      {"OpGraphEntryPointARM %g \"main\" %x %y\n", "",
       "the SPIR-V module has no graph entry point"},
      {"OpGraphEntryPointARM %g", "OpGraphEntryPointARM %t",
       "word 143 (OpGraphEntryPointARM): %19 is no OpGraphARM"},
      {"\"main\" %x %y", "\"main\" %x",
       "word 143 (OpGraphEntryPointARM): has 1 interface variables, the graph has 1 inputs and 1 "
       "outputs"},
      {"\"main\" %x %y", "\"main\" %x %c1",
       "word 143 (OpGraphEntryPointARM): the interface id %9 is no variable"},
      {"\"main\" %x %y", "\"main\" %x %y\nOpGraphEntryPointARM %g \"main\" %x %y",
       "word 149 (OpGraphEntryPointARM): another entry point is named \"main\" too"},
      {"%y = OpVariable %p UniformConstant", "%y = OpVariable %p StorageBuffer",
       "word 143 (OpGraphEntryPointARM): the variable %3 has storage class 12, expected "
       "UniformConstant"},
      {"OpTypePointer UniformConstant %t", "OpTypePointer StorageBuffer %t",
       "word 143 (OpGraphEntryPointARM): the variable %2 has storage class 12, expected "
       "UniformConstant"},
      {"%y = OpVariable %p", "%p2 = OpTypePointer UniformConstant %t2\n%y = OpVariable %p2",
       "word 147 (OpGraphEntryPointARM): the variable %3 points to type %20, entry 1 of the "
       "graph's type is %19"},
      {"%y = OpVariable %p", "%y = OpVariable %t",
       "word 130 (OpVariable): its type %19 is no pointer"},
      {"OpDecorate %y Binding 1\n", "",
       "word 139 (OpGraphEntryPointARM): the variable %3 has no Binding decoration"},
      {"OpDecorate %y DescriptorSet 0\n", "",
       "word 139 (OpGraphEntryPointARM): the variable %3 has no DescriptorSet decoration"},
      {"OpDecorate %y Binding 1", "OpDecorate %y Binding 1 1",
       "word 26 (OpDecorate): has 5 words, this decoration has 4"},
      // Inputs.
      {"%in = OpGraphInputARM %t %c0", "%in = OpGraphInputARM %t %c1",
       "word 152 (OpGraphInputARM): the input index is 1, the graph has 1 inputs"},
      {"%in = OpGraphInputARM %t %c0", "%in = OpGraphInputARM %t %x",
       "word 152 (OpGraphInputARM): the input index %2 is no integer constant"},
      {"%in = OpGraphInputARM %t %c0", "%in = OpGraphInputARM %t2 %c0",
       "word 152 (OpGraphInputARM): its type is %20, input 0 of the graph's type is %19"},
      {"%in = OpGraphInputARM %t %c0", "%in = OpGraphInputARM %t %c0 %c0",
       "word 152 (OpGraphInputARM): has an element index, but input 0 is no array"},
      {"%in = OpGraphInputARM %t %c0",
       "%in = OpGraphInputARM %t %c0\n%in2 = OpGraphInputARM %t %c0",
       "word 156 (OpGraphInputARM): input 0 is read a second time"},
      {"OpGraphSetOutputARM", "%in2 = OpGraphInputARM %t %c1\nOpGraphSetOutputARM",
       "word 165 (OpGraphInputARM): inputs come straight after OpGraphARM"},
      // Outputs.
      {"OpGraphSetOutputARM %sum %c0", "OpGraphSetOutputARM %sum %c1",
       "word 165 (OpGraphSetOutputARM): the output index is 1, the graph has 1 outputs"},
      {"OpGraphSetOutputARM %sum %c0", "OpGraphSetOutputARM %sum %k",
       "word 165 (OpGraphSetOutputARM): the output index %23 is no integer constant"},
      {"OpGraphSetOutputARM %sum %c0", "OpGraphSetOutputARM %tosa %c0",
       "word 165 (OpGraphSetOutputARM): %1 is no value of this graph and no constant"},
      {"OpGraphSetOutputARM %sum %c0", "OpGraphSetOutputARM %c2 %c0",
       "word 165 (OpGraphSetOutputARM): the type of %10 is %5, output 0 of the graph's type is "
       "%19"},
      {"OpGraphSetOutputARM %sum %c0", "OpGraphSetOutputARM %sum %c0 %c0",
       "word 165 (OpGraphSetOutputARM): has an element index, but output 0 is no array"},
      {"OpGraphSetOutputARM %sum %c0", "OpGraphSetOutputARM %sum %c0\nOpGraphSetOutputARM %in %c0",
       "word 168 (OpGraphSetOutputARM): output 0 is set a second time"},
      {"OpGraphSetOutputARM %sum %c0",
       "OpGraphSetOutputARM %sum %c0\n%z = OpExtInst %t %tosa BITWISE_NOT %in",
       "word 168 (OpExtInst): stands behind an OpGraphSetOutputARM, outputs come last"},
      {"OpGraphSetOutputARM %sum %c0\n", "",
       "word 165 (OpGraphEndARM): the graph sets 0 of its 1 outputs"},
      // Graphs.
      {"OpGraphEndARM\n", "",
       "word 149 (OpGraphARM): the module ends before this graph's OpGraphEndARM"},
      {"OpGraphEndARM", "OpGraphEndARM\nOpGraphEndARM",
       "word 169 (OpGraphEndARM): stands outside a graph"},
      {"OpGraphEndARM", "OpGraphEndARM\n%i16 = OpTypeInt 16 0",
       "word 169 (OpTypeInt): types, constants and variables come before the first graph"},
      {"%in = Op", "%i16 = OpTypeInt 16 0\n%in = Op",
       "word 152 (OpTypeInt): stands inside a graph"},
      {"%g = OpGraphARM %gt", "%g = OpGraphARM %t",
       "word 149 (OpGraphARM): its type %19 is no OpTypeGraphARM"},
      {"OpGraphEntryPointARM", "%z = OpExtInst %t %tosa BITWISE_NOT %k\nOpGraphEntryPointARM",
       "word 143 (OpExtInst): stands outside a graph"},
      {"OpGraphSetOutputARM", "%z = OpCompositeExtract %t %sum 0\nOpGraphSetOutputARM",
       "word 165 (OpCompositeExtract): %32 is no struct of this graph"},
      {"OpGraphEndARM",
       "OpGraphEndARM\n%g2 = OpGraphARM %gt\nOpGraphSetOutputARM %in %c0\nOpGraphEndARM",
       "word 172 (OpGraphSetOutputARM): %31 is no value of this graph and no constant"},
      // Graph constants.
      {"OpGraphConstantARM %t 7", "OpGraphConstantARM %i8 7",
       "word 134 (OpGraphConstantARM): its type %4 is no tensor type"},
      {"OpGraphConstantARM %t 7", "OpGraphConstantARM %t 7\n%w2 = OpGraphConstantARM %t 7",
       "word 138 (OpGraphConstantARM): the GraphConstantID 7 is taken by word 134"},
      // Types.
      {"%t = OpTypeTensorARM %i8", "%t = OpTypeTensorARM %c1",
       "word 88 (OpTypeTensorARM): the element type %9 is no bool, int8, int16, int32, int64, "
       "float32, float16, bfloat16 or float8"},
      {"%t = OpTypeTensorARM %i8", "%t = OpTypeTensorARM %f64",
       "word 88 (OpTypeTensorARM): the element type %7 is no bool, int8, int16, int32, int64, "
       "float32, float16, bfloat16 or float8"},
      {"%t = OpTypeTensorARM %i8 %c1 %sh", "%t = OpTypeTensorARM %i8 %i8",
       "word 88 (OpTypeTensorARM): the rank %4 is no integer constant"},
      {"%t = OpTypeTensorARM %i8 %c1 %sh", "%t = OpTypeTensorARM %i8 %c0",
       "word 88 (OpTypeTensorARM): has rank 0, expected at least 1"},
      {"%t = OpTypeTensorARM %i8 %c1 %sh", "%t = OpTypeTensorARM %i8 %c7",
       "word 88 (OpTypeTensorARM): has rank 7, level 8K ends at rank 6"},
      {"%t = OpTypeTensorARM %i8 %c1 %sh", "%t = OpTypeTensorARM %i8 %c2 %sh",
       "word 88 (OpTypeTensorARM): the shape %16 has 1 sizes, the rank is 2"},
      {"%t = OpTypeTensorARM %i8 %c1 %sh", "%t = OpTypeTensorARM %i8 %c1 %c2",
       "word 88 (OpTypeTensorARM): the shape %10 is no constant array of integers"},
      {"%t = OpTypeTensorARM %i8 %c1 %sh", "%t = OpTypeTensorARM %i8 %c1 %sh0",
       "word 88 (OpTypeTensorARM): has a size of 0, expected at least 1"},
      {"%t = OpTypeTensorARM %i8 %c1 %sh", "%t = OpTypeTensorARM %i8 %c2 %huge",
       "word 88 (OpTypeTensorARM): has shape [2147483647,2], level 8K ends at 2147483647 elements"},
      {"%t = OpTypeTensorARM %i8 %c1 %sh", "%t = OpTypeTensorARM %i8 %c1 %sh %sh",
       "word 88 (OpTypeTensorARM): has 6 words, expected 3 to 5"},
      {"OpTypeArray %i32 %c1", "OpTypeArray %i32 %c0",
       "word 67 (OpTypeArray): has length 0, expected 1 to 2147483647"},
      {"OpTypeArray %i32 %c1", "OpTypeArray %c0 %c1",
       "word 67 (OpTypeArray): the element type %8 is no type"},
      {"OpTypePointer UniformConstant %t", "OpTypePointer UniformConstant %c0",
       "word 122 (OpTypePointer): the pointed type %8 is no type"},
      // Constants.
      {"%k = OpConstantComposite %t %e3 %e3", "%k = OpConstantComposite %t %e3",
       "word 106 (OpConstantComposite): has 1 constituents, i8[2] needs 2"},
      {"%k = OpConstantComposite %t %e3 %e3", "%k = OpConstantComposite %t %e3 %c1",
       "word 106 (OpConstantComposite): the constituent %9 is not i8, as i8[2] needs"},
      {"%k = OpConstantComposite %t %e3 %e3", "%k = OpConstantComposite %t %e3 %i8",
       "word 106 (OpConstantComposite): the constituent %4 is no constant"},
      {"%k = OpConstantComposite %t %e3 %e3", "%k = OpConstantComposite %tr %e3 %e3",
       "word 106 (OpConstantComposite): its type is i8[?], only tensors with a shape can be "
       "constants"},
      {"%k = OpConstantComposite %t %e3 %e3", "%k = OpConstantNull %c0",
       "word 106 (OpConstantNull): its type %8 is no type"},
      {"%k = OpConstantComposite %t %e3 %e3", "%k = OpConstantTrue %i8",
       "word 106 (OpConstantTrue): its type %4 is not bool"},
      {"%k = OpConstantComposite %t %e3 %e3", "%k = OpConstant %i8 3 0",
       "word 106 (OpConstant): has 5 words, a value of 8 bits makes it 4"},
      {"%k = OpConstantComposite %t %e3 %e3", "%k = OpConstant %bool 1",
       "word 106 (OpConstant): its type %6 is no number"},
      {"%k = OpConstantComposite %t %e3 %e3", "%e3 = OpConstantNull %t",
       "word 106 (OpConstantNull): the id %12 is defined a second time"},
      // Operators.
      {"TOSA.001000.1", "TOSA.001001.0",
       "word 5 (OpExtInstImport): found the instruction set \"TOSA.001001.0\", expected "
       "\"TOSA.001000.1\""},
      {"TOSA.001000.1", "Arm.MotionEngine.100",
       "word 158 (OpExtInst): instruction 10 of the set \"Arm.MotionEngine.100\", expected "
       "\"TOSA.001000.1\""},
      {"%tosa CLAMP", "%c0 CLAMP", "word 156 (OpExtInst): %8 is no imported instruction set"},
      {"CLAMP %e3 %e3 %c1 %in", "66 %in",
       "word 156 (OpExtInst): operator number 66 is not in TOSA.001000.1"},
      {"CLAMP %e3 %e3 %c1 %in", "67 %in",
       "word 156 (OpExtInst): operator number 67 is not in TOSA.001000.1"},
      {"CLAMP %e3 %e3 %c1 %in", "CLAMP %e3 %e3 %c1",
       "word 156 (OpExtInst), clamp: has 3 operands, expected 4"},
      {"CLAMP %e3 %e3 %c1 %in", "CONCAT %c0",
       "word 156 (OpExtInst), concat: has 1 operands, expected 2 to 65"},
      {"CLAMP %e3 %e3 %c1 %in", "CLAMP %e3 %in %c1 %in",
       "word 156 (OpExtInst), clamp: max_val is %31, which is no constant"},
      {"CLAMP %e3 %e3 %c1 %in", "CLAMP %e3 %k %c1 %in",
       "word 156 (OpExtInst), clamp: max_val is %23, which is no number constant"},
      {"CLAMP %e3 %e3 %c1 %in", "CLAMP %e3 %e3 %c0 %in",
       "word 156 (OpExtInst), clamp: nan_mode is 0, expected 1 to 2"},
      {"CLAMP %e3 %e3 %c1 %in", "CLAMP %e3 %e3 %c1 %sum",
       "word 156 (OpExtInst), clamp: operand 0 is %32, which is no constant and no earlier value "
       "of this graph"},
      {"CLAMP %e3 %e3 %c1 %in", "CLAMP %e3 %e3 %c1 %e3",
       "word 156 (OpExtInst), clamp, operand: constant %12: is neither a shaped tensor nor an "
       "array of scalars"},
      {"CLAMP %e3 %e3 %c1 %in", "ARITHMETIC_RIGHT_SHIFT %c1 %in %in",
       "word 156 (OpExtInst), arithmetic_right_shift: round is %9, which is no bool constant"},
      {"CLAMP %e3 %e3 %c1 %in", "TRANSPOSE %c0 %in",
       "word 156 (OpExtInst), transpose, perms: constant %8: is neither a shaped tensor nor an "
       "array of scalars"},
      {"CLAMP %e3 %e3 %c1 %in", "AVG_POOL2D %sh %sh %sh %c7 %in %k %k",
       "word 156 (OpExtInst), avg_pool2d: acc_type is 7, expected 1 to 4"},
      {"CLAMP %e3 %e3 %c1 %in", "TRANSPOSE %long %in",
       "word 156 (OpExtInst), transpose: the perms %26 is i32[13], expected a list of at most 12 "
       "integers"},
      {"CLAMP %e3 %e3 %c1 %in", "RESHAPE %in %long",
       "word 156 (OpExtInst), reshape: the shape %26 is i32[13], expected a list of at most 12 "
       "integers"},
      {"CLAMP %e3 %e3 %c1 %in", "RESHAPE %in %in",
       "word 156 (OpExtInst), reshape: operand 1 is %31, a shape must be constant"},
      {"CLAMP %e3 %e3 %c1 %in", "BITWISE_NOT %w",
       "word 156 (OpExtInst), bitwise_not, operand: graph constant 7: is i8[2] from outside the "
       "module, and no data was given for it (of a .spv file, with --constant 7=FILE)"},
      {"OpExtInst %t %tosa", "OpExtInst %i8 %tosa",
       "word 165 (OpGraphSetOutputARM): the type of %32 is %4, output 0 of the graph's type is "
       "%19"},
      {"OpExtInst %t %tosa", "OpExtInst %c0 %tosa", "word 156 (OpExtInst): its type %8 is no type"},
      {"OpGraphSetOutputARM", "%z = OpExtInst %i8 %tosa BITWISE_NOT %in\nOpGraphSetOutputARM",
       "word 165 (OpExtInst), bitwise_not: its type %4 is no tensor type"},
      // Others.
      {"%bool = OpTypeBool", "%bool = OpTypeBool\n%u = OpUndef %bool",
       "word 40 (OpUndef): the instruction has no place in a graph module"},
      {"%bool = OpTypeBool", "%bool = OpTypeBool\nOpEntryPoint 5 %g \"main\"",
       "word 40 (OpEntryPoint): the instruction has no place in a graph module"},
      {"%i32 = OpTypeInt 32 0", "%i32 = OpTypeInt 32 0 0",
       "word 34 (OpTypeInt): has 5 words, expected 4"},
  };
  for (const Row& row : rows) {
    const std::string broken = replaced(kSmall, row.from, row.to);
    ASSERT_NE(broken, kSmall) << row.from;
    EXPECT_EQ(outcome(broken), row.error) << row.from << " -> " << row.to;
  }
}

TEST(SpirvGraph, LeavesTheOperatorsRulesToVerify) {
  const auto verdict = [](const std::string& body) {
    const std::string module = module_of({{"x", "%b1"}}, {{"y", "%b1"}}, "", body);
    return error_text(verify(must(read_spirv_graph(bytes_of(assemble_spirv(module)), {}))));
  };
  EXPECT_EQ(verdict("%r = OpExtInst %b1 %tosa 40 %in0 %in0 %zero8\nOpGraphSetOutputARM %r %c0\n"),
            "node %0 \"y\" (negate): input_zp \"x\" i8[1] is not constant, which needs the "
            "extension EXT-DYNAMIC");
  EXPECT_EQ(verdict("%r = OpExtInst %b1 %tosa RESIZE %c1 %in0 %s4 %s2 %s2\n"
                    "OpGraphSetOutputARM %r %c0\n"),
            "node %0 \"y\" (resize): input \"x\" i8[1] has rank 1, expected 4");
}

TEST(SpirvGraph, RefusesBrokenWords) {
  const std::vector<uint32_t> words = assemble_spirv(kSmall);
  const auto with = [&](size_t at, uint32_t word) {
    std::vector<uint32_t> changed = words;
    changed[at] = word;
    return outcome(changed);
  };
  EXPECT_TRUE(is_spirv(bytes_of(words)));
  EXPECT_FALSE(is_spirv(bytes_of(words).first(3)));
  EXPECT_FALSE(is_spirv(bytes_of(words).subspan(4)));
  EXPECT_EQ(error_text(read_spirv_graph(bytes_of(words).first(words.size() * 4 - 1), {})),
            "found 675 bytes, SPIR-V has 4 a word");
  EXPECT_EQ(error_text(read_spirv_graph(bytes_of(words).first(16), {})),
            "found 4 words, a SPIR-V header has 5");
  EXPECT_EQ(with(0, 0x07230204), "word 0: found the magic number 0x07230204, expected 0x07230203");
  EXPECT_EQ(with(0, 0x03022307), "word 0: the module is big-endian, expected little-endian");
  EXPECT_EQ(with(1, 0x00020000), "word 1: found the version word 0x00020000, expected SPIR-V 1");
  EXPECT_EQ(with(3, 10),
            "word 51 (OpConstant): the result id %10 is outside 1 to 9, the module's bound");
  EXPECT_EQ(with(3, 0),
            "word 5 (OpExtInstImport): the result id %1 is outside 1 to 0, the module's bound");
  EXPECT_EQ(with(5, 11), "word 5 (OpExtInstImport): has 0 words, 164 are left in the module");
  EXPECT_EQ(with(5, words[5] + 0x7f000000),
            "word 5 (OpExtInstImport): has 32518 words, 164 are left in the module");
  EXPECT_EQ(with(5, words[5] - 11 + 9999),
            "word 5 (opcode 9999): the instruction has no place in a graph module");
  EXPECT_EQ(with(5, words[5] - 11 + 54),
            "word 5 (OpFunction): the instruction has no place in a graph module");
  EXPECT_EQ(with(10, words[10] | 0x01010101),
            "word 5 (OpExtInstImport): the string does not end within the instruction");
  EXPECT_EQ(with(words.size() - 1, 0x0003105A),
            "word 168 (OpGraphEndARM): has 3 words, 1 are left in the module");
}

TEST(SpirvGraph, WantsAllExternalConstants) {
  EXPECT_EQ(outcome(kConvolution),
            "word 300 (OpExtInst), conv2d, operand: graph constant 0: is i8[3,1,1,2] from outside "
            "the module, and no data was given for it (of a .spv file, with --constant 0=FILE)");
  SpirvGraphOptions options = convolution_constants();
  options.constants.pop_back();
  options.constants.push_back({0, std::span(kWeights).first(5)});
  EXPECT_EQ(outcome(kConvolution, options),
            "word 300 (OpExtInst), conv2d, operand: graph constant 0: has 5 bytes of data, "
            "i8[3,1,1,2] needs 6");
  const std::vector<uint8_t> flags{1, 2};
  options.constants = {{7, flags}};
  EXPECT_EQ(outcome(module_of({}, {{"", "%flag2"}}, "%k = OpGraphConstantARM %flag2 7\n",
                              "OpGraphSetOutputARM %k %c0\n"),
                    options),
            "output 0: the operand %59 has 2, BOOL is 0 to 1");
}

TEST(SpirvGraph, BoundsInlineConstants) {
  const std::string declarations = R"(
%million = OpConstant %i32 1048576
%n64 = OpConstant %i32 64
%sl = OpConstantComposite %a2 %n64 %million
%sm = OpConstantComposite %a1 %million
%tm = OpTypeTensorARM %i8 %c1 %sm
%tl = OpTypeTensorARM %i8 %c2 %sl
%e5 = OpConstant %i8 5
%row = OpConstantCompositeReplicateEXT %tm %e5
%k = OpConstantCompositeReplicateEXT %tl %row
%k2 = OpConstantNull %tm
)";
  const Graph graph =
      must(read_spirv_graph(bytes_of(assemble_spirv(module_of({}, {{"", "%tl"}}, declarations,
                                                              "OpGraphSetOutputARM %k %c0\n"))),
                            {}));
  EXPECT_TRUE(graph.values[0].constant->bytes == std::vector<uint8_t>(size_t{1} << 26, 5));
  EXPECT_EQ(outcome(module_of({}, {{"", "%tl"}, {"", "%tm"}}, declarations,
                              "OpGraphSetOutputARM %k %c0\nOpGraphSetOutputARM %k2 %c1\n")),
            "output 1, operand: constant %69: is i8[1048576]: inline constants of a graph may take "
            "67108864 bytes together");
  // The writer has no replicated constants, and its instructions end at 65,535 words.
  EXPECT_EQ(error_text(write_spirv_graph(graph, {})),
            "constant \"constant_0\": is i8[64,1048576]: an inline constant has at most 65532 "
            "elements on an axis; write it as an external constant");
  const SpirvGraphModule module = must(write_spirv_graph(graph, {.external_constants = true}));
  EXPECT_TRUE(must(reread(module)) == graph);
}

TEST(SpirvGraph, BoundsWhatEntryPointsShare) {
  // A long name on the variable that all inputs are, and many entry points of one graph.
  const auto inputs = [](size_t count) {
    std::string list, types;
    for (size_t i = 0; i < count; ++i) list += " %x", types += " %t";
    std::string module =
        replaced(kSmall, "OpName %x \"x\"", "OpName %x \"" + std::string(200000, 'n') + "\"");
    module =
        replaced(module, "OpTypeGraphARM 1 %t", fmt::format("OpTypeGraphARM {}{}", count, types));
    return replaced(module, "\"main\" %x", "\"main\"" + list);
  };
  const Graph graph = must(read_spirv_graph(bytes_of(assemble_spirv(inputs(300))), {}));
  EXPECT_EQ(graph.value(graph.inputs[0]).name.size(), 200000u);
  EXPECT_EQ(graph.value(graph.inputs[299]).name, std::string(256, 'n') + ".299");
  EXPECT_EQ(outcome(inputs(400)),
            "word 50542 (OpGraphEntryPointARM): the interfaces take over 67108864 bytes with their "
            "names");
  std::string entries, constants, operands;
  for (int i = 0; i < 1100; ++i) {
    entries += fmt::format("OpGraphEntryPointARM %g \"{}\" %x %y\n", i);
    constants += fmt::format("%w{0} = OpGraphConstantARM %t {1}\n", i, i + 100);
    operands += fmt::format(" %w{}", i);
  }
  std::string module = replaced(kSmall, "%gt = ", constants + "%gt = ");
  module = replaced(module, "CLAMP %e3 %e3 %c1 %in", "CONCAT %c0" + operands);
  EXPECT_EQ(must(list_spirv_entry_points(bytes_of(assemble_spirv(module))))[0].constant_ids.size(),
            1100u);
  module = replaced(module, "%g = OpGraphARM", entries + "%g = OpGraphARM");
  EXPECT_EQ(error_text(list_spirv_entry_points(bytes_of(assemble_spirv(module)))),
            "word 9309 (OpGraphEntryPointARM): the constants of all entry points take over "
            "67108864 bytes");
}

TEST(SpirvGraph, WritesRowsUpToTheInstructionLimit) {
  Graph graph;
  Tensor list = Tensor::zeros({DType::kInt32, {65532}});
  for (int64_t i = 0; i < list.count(); ++i) list.set(i, i);
  const ValueId k = graph.add_constant("k", list);
  const ValueId x = graph.add_input("x", list.type);
  graph.outputs = {graph.add_node(Op::kAdd, {}, {x, k}, "y", list.type)};
  EXPECT_TRUE(must(reread(must(write_spirv_graph(graph, {})))) == graph);
}

TEST(SpirvGraph, RefusesToWriteWhatSpirvCannotHold) {
  Graph graph =
      graph_of("graph g {\n  input %x : i8[2]\n  %y = bitwise_not %x : i8[2]\n  return %y\n}");
  graph.values[1].name = std::string("a\0b", 3);
  EXPECT_EQ(error_text(write_spirv_graph(graph, {})),
            "value %1 \"" + graph.values[1].name + "\": has a name with control characters");
  graph.values[1].name = std::string(260000, 'n');
  EXPECT_TRUE(must(reread(must(write_spirv_graph(graph, {})))) == graph);
  graph.values[1].name += 'n';
  EXPECT_EQ(error_text(write_spirv_graph(graph, {})),
            "value %1: its name has 260001 bytes, the writer's limit is 260000");
  graph.values[1].name = "d\xc3\xbcne \"";
  graph.name = std::string(260000, 'g');
  graph.outputs.assign(531, graph.outputs[0]);
  EXPECT_TRUE(must(reread(must(write_spirv_graph(graph, {})))) == graph);
  graph.outputs.push_back(graph.outputs[0]);
  EXPECT_EQ(error_text(write_spirv_graph(graph, {})),
            "graph: has 1 inputs and 532 outputs, the writer's limit is 532 together");
  graph.outputs.resize(1);
  graph.nodes[0].attrs = Attrs().set(Attr::kAxis, 1);
  EXPECT_EQ(error_text(write_spirv_graph(graph, {})),
            R"(node %0 "düne "" (bitwise_not): has no use for the attribute axis)");
}

/// Modules all of whose prefixes are broken.
std::vector<std::vector<uint32_t>> whole_modules() {
  std::vector<std::vector<uint32_t>> modules{assemble_spirv(kSmall), assemble_spirv(kConvolution)};
  modules.push_back(
      assemble_spirv(replaced(kSmall, "\"main\" %x %y",
                              "\"main\" %x %y\nOpGraphEntryPointARM %g2 \"other\" %y %x") +
                     "%g2 = OpGraphARM %gt\n%in2 = OpGraphInputARM %t %c0\n"
                     "OpGraphSetOutputARM %in2 %c0\nOpGraphEndARM\n"));
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[1,4,4,2]
  const %w : i8[2,1,1,2] = [1,-2,3,4]
  const %b : i32[2] = [5,-6]
  const %big : i48[1] = [-140737488355328]
  const %flag : bool[2] = [1,0]
  const %zp : i8[1] = [0]
  const %p : shape[8] = [0,0,1,1,1,1,0,0]
  %y = pad %x, %p, %zp : i8[1,6,6,2]
  %c = conv2d %y, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,6,6,2]
  %d = clamp %y {min_val=-100, max_val=100, nan_mode=propagate} : i8[1,6,6,2]
  return %c, %d, %big, %flag
})");
  modules.push_back(must(write_spirv_graph(graph, {})).words);
  return modules;
}

TEST(SpirvGraph, RefusesEveryCut) {
  for (const std::vector<uint32_t>& words : whole_modules()) {
    SpirvGraphOptions options = convolution_constants();
    options.entry_point = must(list_spirv_entry_points(bytes_of(words))).front().name;
    ASSERT_TRUE(read_spirv_graph(bytes_of(words), options));
    for (size_t count = 0; count < words.size(); ++count) {
      // A copy of its own, so that reading behind the end is seen by the tools that look for it.
      const std::vector<uint32_t> cut(words.begin(),
                                      words.begin() + static_cast<std::ptrdiff_t>(count));
      const Result<Graph> graph = read_spirv_graph(bytes_of(cut), options);
      ASSERT_FALSE(graph) << "cut to " << count << " of " << words.size() << " words";
      EXPECT_EQ(graph.error().code, ErrorCode::kBadInput) << count;
    }
  }
}

/// Reads damaged words: an error, or a graph that comes back from being written.
bool survives(const std::vector<uint32_t>& words, SpirvGraphOptions options) {
  const auto listed = list_spirv_entry_points(bytes_of(words));
  if (!listed) return !listed.error().text().empty();
  options.entry_point = listed->front().name;
  const Result<Graph> graph = read_spirv_graph(bytes_of(words), options);
  if (!graph) return !graph.error().text().empty();
  if (!verify(*graph)) return true;
  for (const bool external : {false, true}) {
    const auto module = write_spirv_graph(*graph, {.external_constants = external});
    if (!module) return module.error().code == ErrorCode::kUnsupported;
    const Result<Graph> again = reread(*module);
    if (!again || !(*again == *graph)) return false;
  }
  return true;
}

TEST(SpirvGraph, SurvivesDamageOfEveryWord) {
  for (const std::vector<uint32_t>& words : whole_modules())
    for (size_t at = 0; at < words.size(); ++at)
      for (const uint32_t change :
           {0x1u, 0x2u, 0x4u, 0x8u, 0x10u, 0x20u, 0x40u, 0x80u, 0x10000u, 0x20000u, 0xffffffffu}) {
        std::vector<uint32_t> damaged = words;
        damaged[at] ^= change;
        ASSERT_TRUE(survives(damaged, convolution_constants()))
            << "word " << at << " xor " << change;
      }
}

/// The SPIR-V modules of a VGF file: a vector of words begins with its length.
std::vector<std::vector<uint32_t>> modules_in(const std::vector<uint8_t>& file) {
  std::vector<std::vector<uint32_t>> modules;
  std::vector<uint32_t> words(file.size() / 4);
  std::memcpy(words.data(), file.data(), words.size() * 4);
  for (size_t i = 1; i < words.size(); ++i)
    if (words[i] == 0x07230203 && words[i - 1] <= words.size() - i)
      modules.emplace_back(words.begin() + static_cast<std::ptrdiff_t>(i),
                           words.begin() + static_cast<std::ptrdiff_t>(i + words[i - 1]));
  return modules;
}

TEST(SpirvGraph, ReadsModulesOfOtherProducers) {
  const auto file = read_file(SHALE_SOURCE_DIR "/tests/golden/vgf/conv2d_rescale_constants.vgf");
  ASSERT_TRUE(file);
  const auto modules = modules_in(*file);
  ASSERT_EQ(modules.size(), 1u);
  const auto listed = must(list_spirv_entry_points(bytes_of(modules[0])));
  EXPECT_EQ(listed[0].constant_ids, (std::vector<uint32_t>{0, 1, 2}));
  std::vector<std::vector<uint8_t>> data;
  SpirvGraphOptions options;
  for (uint32_t i = 0; i < listed[0].constant_types.size(); ++i)
    data.push_back(Tensor::zeros(listed[0].constant_types[i]).bytes);
  for (uint32_t i = 0; i < data.size(); ++i) options.constants.push_back({i, data[i]});
  EXPECT_EQ(outcome(modules[0], options), R"(graph conv_rescale {
  input %image : i8[1,6,6,3]
  const %graph_constant_0 : i8[5,3,3,3] = hex "000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
  const %graph_constant_1 : i32[5] = [0,0,0,0,0]
  const %constant_2 : i8[1] = [-3]
  const %constant_3 : i8[1] = [0]
  const %graph_constant_2 : i32[5] = [0,0,0,0,0]
  const %constant_5 : i8[5] = [40,40,41,39,40]
  const %constant_6 : i32[1] = [0]
  const %constant_7 : i8[1] = [7]
  %conv2d_0 = conv2d %image, %graph_constant_0, %graph_constant_1, %constant_2, %constant_3 {pad=[1,1,1,1], stride=[1,1], dilation=[1,1], local_bound=false, acc_type=i32} : i32[1,6,6,5]
  %features = rescale %conv2d_0, %graph_constant_2, %constant_5, %constant_6, %constant_7 {scale32=true, rounding_mode=single, per_channel=true, input_unsigned=false, output_unsigned=false} : i8[1,6,6,5]
  return %features
}
)");
  const auto pool =
      modules_in(must(read_file(SHALE_SOURCE_DIR "/tests/golden/vgf/pool_clamp_graph.vgf")));
  ASSERT_EQ(pool.size(), 1u);
  EXPECT_EQ(outcome(pool[0]), R"(graph pool_clamp {
  input %in0 : i8[1,8,8,4]
  %max_pool2d_0 = max_pool2d %in0 {kernel=[2,2], stride=[2,2], pad=[0,0,0,0], nan_mode=propagate} : i8[1,4,4,4]
  %out0 = clamp %max_pool2d_0 {min_val=-100, max_val=100, nan_mode=propagate} : i8[1,4,4,4]
  return %out0
}
)");
  const auto mixed = modules_in(
      must(read_file(SHALE_SOURCE_DIR "/tests/golden/vgf/compute_graph_compute_sequence.vgf")));
  ASSERT_EQ(mixed.size(), 2u);
  EXPECT_EQ(outcome(mixed[0]), R"(graph main {
  input %a : i8[1,4,4,8]
  const %constant_0 : i8[1] = [0]
  %b = avg_pool2d %a, %constant_0, %constant_0 {kernel=[2,2], stride=[2,2], pad=[0,0,0,0], acc_type=i32} : i8[1,2,2,8]
  return %b
}
)");
  EXPECT_EQ(outcome(mixed[1]),
            "word 10 (OpEntryPoint): the instruction has no place in a graph module");
}

}  // namespace
}  // namespace shale
