// conv2d_s8_coopmat for matrices of every shape that GPUs report: its modules are read word by word,
// and all of its code but the matrix instructions runs on whatever device is there, those replaced
// by loops of the same meaning (SHALE_PLAIN_MATRICES), bit for bit against the interpreter. Where
// the device has cooperative matrices, the kernel runs as it is.
#include <gtest/gtest.h>

#include <map>
#include <set>

#include "compiler/driver/compile.h"
#include "compiler/frontend/frontend.h"
#include "compiler/spirv/check.h"
#include "compiler/spirv/cooperative_matrix.h"
#include "compiler/spirv/glsl.h"
#include "ir/base/file.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"
#include "tests/support/source_folder.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

constexpr const char* kKernel = "conv2d_s8_coopmat";

/// Matrix products that a device has, and its subgroups.
struct Matrices {
  std::vector<MatrixProduct> products;
  uint32_t subgroup = 32;
};

/// A GPU with those.
DeviceProfile profile_with(const Matrices& matrices) {
  DeviceProfile profile = *find_profile("coopmat-gpu");
  profile.caps.matrix_products = matrices.products;
  profile.caps.subgroup_size = matrices.subgroup;
  return profile;
}

Compiled compiled_for_matrices(const Graph& graph, std::vector<std::string> kernels,
                               const Matrices& matrices = {{{16, 16, 32}}}) {
  CompileOptions options;
  options.targets = {"coopmat-gpu"};
  options.profiles.emplace("coopmat-gpu", profile_with(matrices));
  options.kernels = std::move(kernels);
  options.optimize_spirv = false;
  return must(compile_graph(graph, 0, options));
}

/// The package with plain loops in place of matrix instructions; the number of modules replaced.
size_t replace_matrices(Compiled& compiled, const Matrices& matrices = {{{16, 16, 32}}}) {
  Variant& variant = compiled.package.variants[0];
  size_t replaced = 0, next = 0;
  for (Group& group : collect_groups(compiled.graph)) {
    const Dispatch& dispatch = variant.segments[0].dispatches[next++];
    if (dispatch.kernel != kKernel) continue;
    GroupProblem problem{
        .graph = &compiled.graph, .group = std::move(group), .proof = {}, .cost = {}};
    const auto sources = must(conv2d_coopmat_emit(problem, profile_with(matrices)));
    EXPECT_EQ(sources.size(), 1u);
    variant.modules[dispatch.module] =
        must(compile_glsl(sources[0].glsl, {{"SHALE_PLAIN_MATRICES", "1"}}, dispatch.name));
    EXPECT_EQ(must(validate_spirv(variant.modules[dispatch.module], dispatch.name)),
              Validity::kValid);
    ++replaced;
  }
  variant.requirements.features.bits &= ~(1u << static_cast<uint32_t>(Feature::kCooperativeMatrix));
  variant.requirements.matrix_products.clear();
  variant.requirements.subgroup_size = 0;
  return replaced;
}

/// Shapes and subgroups that drivers report or might: NVIDIA's, AMD's (subgroups of 64), Intel's of
/// two generations, lavapipe's, and others for the rule's sake.
const Matrices kShapes[] = {
    {{{16, 16, 32}}, 32}, {{{16, 8, 32}}, 32}, {{{16, 16, 16}}, 64}, {{{8, 8, 32}}, 8},
    {{{8, 16, 32}}, 16},  {{{8, 8, 8}}, 8},    {{{4, 4, 4}}, 16},    {{{64, 64, 32}}, 64},
    {{{32, 8, 16}}, 32},  {{{6, 12, 20}}, 8},  {{{16, 32, 64}}, 32},
};

class Coopmat : public testing::TestWithParam<std::tuple<size_t, ConvCase>> {
 protected:
  static void SetUpTestSuite() {
    Result<ToolDevice> device = ToolDevice::open({.name = {}, .cache = {}, .validation = true});
    if (!device) device = ToolDevice::open({});
    if (device) device_ = std::make_unique<ToolDevice>(*std::move(device));
  }
  static void TearDownTestSuite() { device_.reset(); }

  void TearDown() override {
    if (!device_) return;
    for (const std::string& message : device_->take_validation_messages()) ADD_FAILURE() << message;
  }

  static void expect_exact(Compiled& compiled, const Graph& graph, uint64_t seed) {
    if (!device_) GTEST_SKIP() << "no Vulkan device";
    for (const std::string& line :
         missing(device_->context().caps, compiled.package.variants[0].requirements))
      GTEST_SKIP() << line;
    const std::vector<Tensor> inputs = random_inputs(graph, seed);
    const std::vector<Tensor> expected = must(interpret(graph, inputs));
    const std::vector<Tensor> found = must(run_network(*device_, compiled.package, inputs));
    for (size_t i = 0; i < expected.size(); ++i)
      if (const auto difference = first_difference(found[i], expected[i]))
        ADD_FAILURE() << "inputs " << seed << ", output " << i << ": " << *difference;
  }

  inline static std::unique_ptr<ToolDevice> device_;
};

TEST_P(Coopmat, MatchesTheInterpreterButForTheMatrixInstructions) {
  const auto& [shape, row] = GetParam();
  const Graph graph = row.graph();
  Compiled compiled = compiled_for_matrices(graph, {kKernel}, kShapes[shape]);
  EXPECT_EQ(compiled.warnings, std::vector<std::string>());
  const Requirements& needs = compiled.package.variants[0].requirements;
  EXPECT_EQ(needs.matrix_products, kShapes[shape].products);
  EXPECT_EQ(needs.subgroup_size, kShapes[shape].subgroup);
  ASSERT_EQ(replace_matrices(compiled, kShapes[shape]), 1u);
  // LLVM takes a minute for each stand-in of the smallest ones: their modules are valid, and that is all that is said of them.
  if (kShapes[shape].products[0].k <= 8) return;
  for (const uint64_t seed : {1u, 2u}) expect_exact(compiled, graph, seed);
}

class OwnMatrices : public Coopmat {};

TEST_P(OwnMatrices, MatchTheInterpreter) {
  if (!device_) GTEST_SKIP() << "no Vulkan device";
  const DeviceCaps& caps = device_->context().caps;
  if (caps.matrix_products.empty()) GTEST_SKIP() << caps.name << " has no cooperative matrices";
  const Graph graph = std::get<1>(GetParam()).graph();
  for (const MatrixProduct& product : caps.matrix_products) {
    Compiled compiled = compiled_for_matrices(graph, {kKernel}, {{product}, caps.subgroup_size});
    ASSERT_EQ(compiled.package.variants[0].segments[0].dispatches[0].kernel, kKernel);
    for (const uint64_t seed : {1u, 2u}) expect_exact(compiled, graph, seed);
  }
}

TEST_F(Coopmat, ChoosesTheShapeThatIsFilledBest) {
  const auto chosen = [](const ConvCase& row, const Matrices& matrices) {
    const Compiled compiled = compiled_for_matrices(row.graph(), {kKernel}, matrices);
    const std::vector<MatrixProduct>& products =
        compiled.package.variants[0].requirements.matrix_products;
    return products.size() == 1 ? matrix_product_text(products[0]) : "not one";
  };
  const Matrices nvidia{{{16, 8, 32}, {16, 16, 32}}, 32};
  // As well filled: the larger one. 24 channels are three blocks of 8, or two of 16.
  EXPECT_EQ(chosen({.name = "", .w = 32, .ic = 32, .oc = 32}, nvidia), "16x16x32");
  EXPECT_EQ(chosen({.name = "", .w = 32, .ic = 32, .oc = 24}, nvidia), "16x8x32");
  // What no word of four channels fits, or no shared memory, is left.
  EXPECT_EQ(chosen({.name = "", .ic = 32, .oc = 16}, {{{4, 6, 8}, {8, 8, 9}, {16, 16, 16}}, 32}),
            "16x16x16");
  EXPECT_EQ(chosen({.name = "", .ic = 32, .oc = 16}, {{{16, 16, 16}, {128, 128, 128}}, 32}),
            "16x16x16");
  const Compiled none = compiled_for_matrices(ConvCase{.name = "", .oc = 16}.graph(), {kKernel},
                                              {{{0, 16, 16}, {16, 16, 2048}, {8, 8, 2}}, 32});
  EXPECT_EQ(none.package.variants[0].segments[0].dispatches[0].kernel, "generic");
}

/// Every edge of the other kernels with enough channels, and the edges of this one.
std::vector<ConvCase> cases() {
  std::vector<ConvCase> rows;
  for (ConvCase row : edge_conv_cases()) {
    if (row.weight_zp != 0) continue;
    if (row.oc < 16) row.oc = row.oc % 4 == 0 ? 20 : 19;
    rows.push_back(row);
  }
  // Lanes fetch four words where all tensors have sixteens of channels, else one by one.
  rows.push_back({.name = "ic16_oc16", .ic = 16, .oc = 16});
  rows.push_back({.name = "ic32_w16", .w = 16, .ic = 32, .oc = 16});
  rows.push_back({.name = "ic48_w17", .w = 17, .ic = 48, .oc = 32});
  rows.push_back({.name = "ic32_concat", .ic = 32, .oc = 16, .source = Source::kConcat});
  rows.push_back({.name = "ic48_concat_of_24", .ic = 48, .oc = 16, .source = Source::kConcat});
  rows.push_back({.name = "ic12_stride2",
                  .h = 8,
                  .w = 36,
                  .ic = 12,
                  .oc = 32,
                  .stride_y = 2,
                  .stride_x = 2,
                  .pad = {1, 0, 1, 0},
                  .input_zp = -128});
  // Four blocks of channels are a workgroup's.
  rows.push_back({.name = "oc64", .h = 3, .oc = 64});
  rows.push_back({.name = "oc65", .h = 3, .oc = 65, .epilogue = Epilogue::kTable});
  rows.push_back({.name = "oc144_batch2", .n = 2, .h = 2, .oc = 144});
  rows.push_back(
      {.name = "one_chunk_of_one_byte", .ic = 1, .oc = 16, .kh = 1, .kw = 1, .pad = {0, 0, 0, 0}});
  rows.push_back({.name = "small_weight_zp",
                  .ic = 5,
                  .oc = 16,
                  .input_zp = 3,
                  .weight_zp = 7,
                  .weight_min = -121});
  return rows;
}

std::string case_name(const testing::TestParamInfo<std::tuple<size_t, ConvCase>>& test) {
  const Matrices& matrices = kShapes[std::get<0>(test.param)];
  return matrix_product_text(matrices.products[0]) + "_" + std::to_string(matrices.subgroup) + "_" +
         replaced(std::get<1>(test.param).name, "-", "minus");
}

/// Those on which every shape is tried: drivers compile the stand-ins of small matrices for minutes elsewhere.
std::vector<ConvCase> cases_of_shapes() {
  std::vector<ConvCase> rows;
  for (const ConvCase& row : cases())
    for (const char* name : {"ic16_oc16", "stride2", "pad_folded", "table_oc17", "one_pixel"})
      if (row.name == name) rows.push_back(row);
  return rows;
}

INSTANTIATE_TEST_SUITE_P(Edges, Coopmat,
                         testing::Combine(testing::Values(size_t{0}), testing::ValuesIn(cases())),
                         case_name);
INSTANTIATE_TEST_SUITE_P(Shapes, Coopmat,
                         testing::Combine(testing::Range(size_t{1}, std::size(kShapes)),
                                          testing::ValuesIn(cases_of_shapes())),
                         case_name);
INSTANTIATE_TEST_SUITE_P(Edges, OwnMatrices,
                         testing::Combine(testing::Values(size_t{0}), testing::ValuesIn(cases())),
                         [](const testing::TestParamInfo<OwnMatrices::ParamType>& test) {
                           return replaced(std::get<1>(test.param).name, "-", "minus");
                         });

TEST_F(Coopmat, NssTakesFourteenDispatchesThirteenOfMatrices) {
  const std::vector<uint8_t> bytes =
      must(read_file(source_folder() + "/models/nss_v1_high/model.tosa"));
  CompileOptions options;
  options.targets = {"coopmat-gpu"};
  options.passes.input_shapes["input"] = {1, 16, 128, 12};  // 16 pixels at the narrowest level
  Compiled compiled = must(compile(bytes, options));
  const std::vector<Dispatch>& dispatches = compiled.package.variants[0].segments[0].dispatches;
  ASSERT_EQ(dispatches.size(), 14u);
  EXPECT_EQ(dispatches.back().kernel, "conv2d_s8_dot8");
  EXPECT_EQ(replace_matrices(compiled), 13u);
  expect_exact(compiled, compiled.graph, 1);
}

/// Instructions of a module, each with its words.
std::vector<std::vector<uint32_t>> instructions_of(const Spirv& words) {
  std::vector<std::vector<uint32_t>> result;
  for (size_t at = 5; at < words.size(); at += words[at] >> 16) {
    if (words[at] >> 16 == 0 || (words[at] >> 16) > words.size() - at) {
      ADD_FAILURE() << "word " << at;
      return result;
    }
    result.emplace_back(words.begin() + static_cast<std::ptrdiff_t>(at),
                        words.begin() + static_cast<std::ptrdiff_t>(at + (words[at] >> 16)));
  }
  return result;
}

Spirv some_module() {
  const ConvCase row{.name = "", .h = 8, .w = 40, .ic = 32, .oc = 40};
  const Compiled compiled = compiled_for_matrices(row.graph(), {kKernel});
  const Variant& variant = compiled.package.variants[0];
  EXPECT_TRUE(variant.requirements.features.has(Feature::kCooperativeMatrix));
  EXPECT_EQ(variant.requirements.shared_bytes, 1024u);
  EXPECT_EQ(variant.requirements.workgroup_invocations, 32u);
  EXPECT_EQ(variant.segments[0].dispatches[0].workgroups, (std::array<uint32_t, 3>{3, 8, 1}));
  EXPECT_EQ(variant.modules.size(), 1u);
  return variant.modules[0];
}

TEST(CoopmatModule, HasTheInstructionsOfTheExtension) {
  const Spirv words = some_module();
  std::map<uint32_t, uint32_t> constants, types_of;
  std::map<uint32_t, std::vector<uint32_t>> integers, matrices, pointers;
  std::set<uint32_t> capabilities;
  std::map<uint32_t, size_t> counts;
  const std::vector<std::vector<uint32_t>> all = instructions_of(words);
  for (const std::vector<uint32_t>& i : all) {
    const uint32_t op = i[0] & 0xffff;
    ++counts[op];
    if (op == 17) capabilities.insert(i[1]);
    if (op == 21) integers[i[1]] = {i[2], i[3]};
    if (op == 43) constants[i[2]] = i[3];
    if (op == 32) pointers[i[1]] = {i[2], i[3]};
    if (op == 61 || op == 65 || op == 80 || op == 4457 || op == 4459) types_of[i[2]] = i[1];
    if (op != 4456) continue;
    ASSERT_EQ(i.size(), 7u);
    ASSERT_TRUE(integers.contains(i[2])) << "the element type must come first";
    matrices[i[1]] = {integers[i[2]][0], integers[i[2]][1], constants[i[3]],
                      constants[i[4]],   constants[i[5]],   constants[i[6]]};
  }
  EXPECT_TRUE(capabilities.contains(6022));  // CooperativeMatrixKHR
  EXPECT_TRUE(capabilities.contains(39));    // Int8
  EXPECT_TRUE(capabilities.contains(5345));  // VulkanMemoryModel
  std::set<std::vector<uint32_t>> kinds;
  for (const auto& [id, kind] : matrices) kinds.insert(kind);
  EXPECT_EQ(must(spirv_needs(words, "m")).matrix_products,
            (std::vector<MatrixProduct>{{16, 16, 32}}));
  // Bits, signed, scope subgroup, rows, columns, use.
  const std::vector<uint32_t> a{8, 1, 3, 16, 32, 0}, b{8, 1, 3, 32, 16, 1}, c{32, 1, 3, 16, 16, 2};
  EXPECT_EQ(kinds, (std::set<std::vector<uint32_t>>{a, b, c}));
  EXPECT_EQ(matrices.size(), 3u);
  // 40 channels are three blocks: an A and three Bs a chunk.
  EXPECT_EQ(counts[4457], 4u);
  EXPECT_EQ(counts[4458], 3u);
  EXPECT_EQ(counts[4459], 3u);
  for (const std::vector<uint32_t>& i : all) {
    switch (i[0] & 0xffff) {
      case 4457: {
        ASSERT_EQ(i.size(), matrices[i[1]] == a ? 8u : 6u);
        const std::vector<uint32_t> pointer = pointers[types_of[i[3]]];
        ASSERT_EQ(pointer.size(), 2u);
        EXPECT_EQ(constants[i[4]], 0u);                         // row major
        EXPECT_EQ(pointer[0], matrices[i[1]] == a ? 4u : 12u);  // Workgroup, StorageBuffer
        EXPECT_EQ(constants[i[5]], matrices[i[1]] == a ? 8u : 1u);
        if (i.size() == 6) break;
        EXPECT_EQ(i[6], 0x30u);  // NonPrivatePointer, MakePointerVisible
        EXPECT_EQ(constants[i[7]], 2u);
        break;
      }
      case 4458:
        ASSERT_EQ(i.size(), 7u);
        EXPECT_EQ(pointers[types_of[i[1]]][0], 4u);
        EXPECT_EQ(matrices[types_of[i[2]]], c);
        EXPECT_EQ(constants[i[3]], 0u);
        EXPECT_EQ(constants[i[4]], 16u);
        EXPECT_EQ(i[5], 0x28u);  // NonPrivatePointer, MakePointerAvailable
        EXPECT_EQ(constants[i[6]], 2u);
        break;
      case 4459:
        ASSERT_EQ(i.size(), 7u);
        EXPECT_EQ(matrices[i[1]], c);
        EXPECT_EQ(matrices[types_of[i[3]]], a);
        EXPECT_EQ(matrices[types_of[i[4]]], b);
        EXPECT_EQ(matrices[types_of[i[5]]], c);
        EXPECT_EQ(i[6], 15u);  // all signed
        break;
      default: break;
    }
  }
}

TEST(CoopmatModule, IsNewerThanTheValidatorAndValidInItsOlderForm) {
  const Spirv words = some_module();
  EXPECT_EQ(must(validate_spirv(words, "m")), Validity::kNewerThanValidator);
  const std::string text = must(disassemble_spirv(words));
  EXPECT_NE(text.find("OpCooperativeMatrixMulAddNV"), std::string::npos);
  EXPECT_EQ(text.find("OpName"), std::string::npos);
}

TEST(CoopmatModule, IsRefusedWhereSomethingIsWrong) {
  const Spirv words = some_module();
  const auto error_with = [&](uint32_t op, size_t operand, uint32_t value) {
    Spirv changed = words;
    for (size_t at = 5; at < changed.size(); at += changed[at] >> 16) {
      if ((changed[at] & 0xffff) != op) continue;
      changed[at + operand] = value;
      break;
    }
    return error_text(validate_spirv(changed, "m"));
  };
  const uint32_t bound = words[3];
  EXPECT_EQ(error_with(4459, 6, 7), "m: a product has the operands 7, expected all to be signed");
  EXPECT_EQ(error_with(4459, 3, bound - 1),
            "m: a product's operands are no matrices A, B and accumulator");
  EXPECT_EQ(error_with(4457, 4, bound + 5), "m: the layout of a matrix is no constant 0 or 1");
  // What the older form has too, the validator finds.
  EXPECT_NE(error_with(4457, 3, 1).find("m: the module is not valid"), std::string::npos);
  EXPECT_NE(error_with(4458, 2, 1).find("m: the module is not valid"), std::string::npos);
  // Broken words.
  Spirv cut = words;
  cut.pop_back();
  EXPECT_NE(error_text(validate_spirv(cut, "m")), "no error");
  Spirv short_type = words;
  for (size_t at = 5; at < short_type.size(); at += short_type[at] >> 16)
    if ((short_type[at] & 0xffff) == 4459) {
      short_type[at] -= 1u << 16;
      break;
    }
  EXPECT_NE(error_text(validate_spirv(short_type, "m")), "no error");
}

TEST(CoopmatModule, LeavesOtherModulesAlone) {
  Spirv words = must(compile_glsl("#version 450\nvoid main() {}\n", {}, "m"));
  const Spirv before = words;
  EXPECT_TRUE(complete_cooperative_matrices(words, "m"));
  EXPECT_EQ(words, before);
  EXPECT_EQ(must(validate_spirv(words, "m")), Validity::kValid);
}

}  // namespace
}  // namespace shale
