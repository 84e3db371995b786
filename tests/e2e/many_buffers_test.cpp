// Groups with more tensors than a dispatch may bind, cut by the limits of the target and run on the
// device that is there, bit for bit against the interpreter.
#include <gtest/gtest.h>

#include <set>

#include "compiler/cost/cost.h"
#include "compiler/driver/compile.h"
#include "tests/compiler/graph_support.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

struct Case {
  std::string name, text;
};

void PrintTo(const Case& row, std::ostream* out) { *out << row.name; }

/// "%x1, %x2, ...", `count` of `distinct` names.
std::string names(int64_t count, int64_t distinct) {
  std::string text;
  for (int64_t i = 0; i < count; ++i)
    text += fmt::format("{}%x{}", i > 0 ? ", " : "", i % distinct + 1);
  return text;
}

/// Inputs %x1 to %x<count>, the one at `axis` with extents that go from 1 to 3 and round again.
std::string inputs(int64_t count, const std::string& type, const Shape& shape, size_t axis) {
  std::string text;
  for (int64_t i = 0; i < count; ++i) {
    Shape own = shape;
    own[axis] = i % 3 + 1;
    text += fmt::format("  input %x{} : {}{}\n", i + 1, type, shape_text(own));
  }
  return text;
}

Case concat(int64_t count, size_t axis, const std::string& type = "i8", int64_t distinct = 64) {
  distinct = std::min(distinct, count);
  Shape shape{2, 3, 2, 3};
  Shape result = shape;
  result[axis] = 0;
  for (int64_t i = 0; i < count; ++i) result[axis] += i % distinct % 3 + 1;
  return {fmt::format("concat_{}_of_{}_axis_{}_{}", count, distinct, axis, type),
          fmt::format("graph main {{\n{}  %y = concat {} {{axis={}}} : {}{}\n  return %y\n}}\n",
                      inputs(distinct, type, shape, axis), names(count, distinct), axis, type,
                      shape_text(result))};
}

/// A convolution over a concat of so many tensors, each of which is also added behind it.
Case convolution(int64_t count, bool adds) {
  std::string text = "graph main {\n", weights, last = "%q";
  for (int64_t i = 1; i <= count; ++i) text += fmt::format("  input %x{} : i8[1,5,6,4]\n", i);
  for (int64_t i = 0; i < 4 * 4 * count; ++i)
    weights += fmt::format("{}{}", i > 0 ? "," : "", i % 19 - 9);
  text += fmt::format(
      "  const %w : i8[4,1,1,{0}] = [{1}]\n  const %b : i32[4] = [7,-8,9,10]\n"
      "  const %zp : i8[1] = [0]\n  const %m : i32[4] = "
      "[1073741824,1173741824,1273741824,1373741824]\n"
      "  const %s : i8[4] = [34,35,36,34]\n  const %oz : i32[1] = [0]\n"
      "  %v = concat {2} {{axis=3}} : i8[1,5,6,{0}]\n"
      "  %h = conv2d %v, %w, %b, %zp, %zp {{pad=[0,0,0,0], stride=[1,1], dilation=[1,1], "
      "acc_type=i32}} : i32[1,5,6,4]\n"
      "  %q = rescale %h, %m, %s, %oz, %zp {{scale32=true, rounding_mode=single, "
      "per_channel=true}} : i8[1,5,6,4]\n",
      4 * count, weights, names(count, count));
  // As residual networks add: in int32.
  if (adds) {
    text +=
        "  const %one : i32[1] = [1073741824]\n  const %t : i8[1] = [30]\n"
        "  %r = rescale %q, %one, %t, %zp, %oz {scale32=true, rounding_mode=single, "
        "per_channel=false} : i32[1,5,6,4]\n";
    last = "%r";
  }
  for (int64_t i = 1; adds && i <= count; ++i) {
    text += fmt::format(
        "  %r{0} = rescale %x{0}, %one, %t, %zp, %oz {{scale32=true, rounding_mode=single, "
        "per_channel=false}} : i32[1,5,6,4]\n  %a{0} = add {1}, %r{0} : i32[1,5,6,4]\n",
        i, last);
    last = fmt::format("%a{}", i);
  }
  return {fmt::format("conv2d_over_{}{}", count, adds ? "_and_again" : ""),
          text + fmt::format("  return {}\n}}\n", last)};
}

/// x1 + x2 + ...: one chain of elementwise nodes.
Case chain(int64_t count) {
  std::string text = "graph main {\n", last = "%x1";
  for (int64_t i = 1; i <= count; ++i) text += fmt::format("  input %x{} : i32[2,3,5]\n", i);
  for (int64_t i = 2; i <= count; ++i) {
    text += fmt::format("  %a{0} = add {1}, %x{0} : i32[2,3,5]\n", i, last);
    last = fmt::format("%a{}", i);
  }
  return {fmt::format("chain_of_{}", count), text + fmt::format("  return {}\n}}\n", last)};
}

/// Many results of one tensor.
Case outputs(int64_t count) {
  std::string text = "graph main {\n  input %x1 : i32[3,7]\n  input %x2 : i32[3,7]\n", list;
  for (int64_t i = 0; i < count; ++i) {
    text += fmt::format("  %y{} = {} %x1, %x2 : i32[3,7]\n", i, i % 2 == 0 ? "maximum" : "minimum");
    list += fmt::format("{}%y{}", i > 0 ? ", " : "", i);
  }
  return {fmt::format("outputs_{}", count), text + "  return " + list + "\n}\n"};
}

/// Concats of concats, and pads of them.
Case nested() {
  std::string text = "graph main {\n" + inputs(24, "i8", {1, 2, 2, 1}, 3);
  std::string parts;
  for (int64_t i = 0; i < 6; ++i) {
    text +=
        fmt::format("  %p{} = concat %x{}, %x{}, %x{}, %x{} {{axis=3}} : i8[1,2,2,{}]\n", i,
                    4 * i + 1, 4 * i + 2, 4 * i + 3, 4 * i + 4,
                    (4 * i % 3) + ((4 * i + 1) % 3) + ((4 * i + 2) % 3) + ((4 * i + 3) % 3) + 4);
    parts += fmt::format("{}%p{}", i > 0 ? ", " : "", i);
  }
  return {
      "nested",
      text + fmt::format("  %y = concat {} {{axis=3}} : i8[1,2,2,48]\n  return %y\n}}\n", parts)};
}

std::vector<Case> cases() {
  std::vector<Case> list;
  for (const int64_t count : {15, 16, 31, 32, 48, 63, 64}) list.push_back(concat(count, 3));
  for (const size_t axis : {0u, 1u, 2u}) list.push_back(concat(40, axis));
  for (const char* type : {"bool", "i16", "i32", "f16", "f32"}) list.push_back(concat(40, 1, type));
  list.push_back(concat(64, 2, "i8", 1));
  list.push_back(concat(64, 2, "i8", 20));
  for (const int64_t count : {8, 10, 12, 40}) {
    list.push_back(convolution(count, false));
    list.push_back(convolution(count, true));
  }
  list.push_back(chain(13));
  list.push_back(chain(64));
  list.push_back(outputs(64));
  list.push_back(nested());
  return list;
}

std::vector<Tensor> values_for(const Graph& graph) {
  std::mt19937_64 random(1);
  std::vector<Tensor> tensors;
  for (const ValueId id : graph.inputs) {
    Tensor tensor = Tensor::zeros(graph.value(id).type);
    const DType dtype = tensor.type.dtype;
    for (int64_t i = 0; i < tensor.count(); ++i) {
      if (is_float(dtype)) {
        tensor.set_real(i, static_cast<float>(random() % 2001) / 8.0f - 125.0f);
        continue;
      }
      // Sums of 64 of them stay in int32.
      const IntRange range =
          dtype == DType::kInt32 ? IntRange{-9999999, 9999999} : dtype_range(dtype);
      tensor.set(i, range.min + static_cast<int64_t>(
                                    random() % static_cast<uint64_t>(range.max - range.min + 1)));
    }
    tensors.push_back(std::move(tensor));
  }
  return tensors;
}

class ManyBuffers : public testing::TestWithParam<Case> {};

TEST_P(ManyBuffers, GiveTheInterpretersResultsOnEveryTarget) {
  const Graph graph = graph_of(GetParam().text);
  Result<ToolDevice> device = ToolDevice::open({.name = {}, .cache = {}, .validation = true});
  if (!device) device = ToolDevice::open({});
  if (!device) GTEST_SKIP() << error_text(device);
  const std::vector<Tensor> inputs = values_for(graph);
  const std::vector<Tensor> expected = must(interpret(graph, inputs));
  for (const DeviceProfile& profile : known_profiles())
    for (const bool optimize : {true, false}) {
      SCOPED_TRACE(fmt::format("{}{}", profile.name, optimize ? "" : ", without passes"));
      CompileOptions options;
      options.targets = {std::string(profile.name)};
      options.pass_options.optimize = optimize;
      options.optimize_spirv = false;
      const Compiled compiled = must(compile_graph(graph, 0, options));
      const Variant& variant = compiled.package.variants[0];
      for (const Dispatch& dispatch : variant.segments[0].dispatches)
        EXPECT_LE(dispatch.bindings.size(), profile.caps.max_storage_buffers) << dispatch.name;
      if (!missing(device->context().caps, variant.requirements).empty()) continue;
      const std::vector<Tensor> found = must(run_network(*device, compiled.package, inputs));
      ASSERT_EQ(found.size(), expected.size());
      for (size_t i = 0; i < expected.size(); ++i)
        if (const auto difference = first_difference(found[i], expected[i]))
          ADD_FAILURE() << "output " << i << ": " << *difference;
    }
  for (const std::string& message : device->take_validation_messages()) ADD_FAILURE() << message;
}

/// The least that Vulkan 1.3 lets a device bind.
TEST_P(ManyBuffers, FitTheSmallestDevice) {
  Graph graph = graph_of(GetParam().text);
  must(run_pipeline(graph, {}, {}));
  for (const DeviceProfile& known : known_profiles()) {
    DeviceProfile profile = known;
    profile.caps.max_storage_buffers = 4;
    std::set<ValueId> made;
    for (const Group& group : collect_groups(graph, profile.caps.max_storage_buffers)) {
      GroupProblem problem{.graph = &graph, .group = group, .proof = {}, .cost = {}};
      problem.proof = prove_ranges(graph, problem.group);
      problem.cost = group_cost(graph, problem.group);
      made.insert(group.result);
      for (const KernelFamily& family : all_kernels()) {
        if (!family.supports(problem, profile)) continue;
        for (const KernelSource& source : must(family.emit(problem, profile))) {
          size_t buffers = 0;
          for (const KernelBinding& binding : source.bindings)
            buffers += binding.type == BindingType::kStorageBuffer;
          EXPECT_LE(buffers, 4u) << family.name;
        }
      }
    }
    for (const ValueId id : graph.outputs) EXPECT_TRUE(made.contains(id));
  }
}

INSTANTIATE_TEST_SUITE_P(Graphs, ManyBuffers, testing::ValuesIn(cases()),
                         [](const testing::TestParamInfo<Case>& test) { return test.param.name; });

}  // namespace
}  // namespace shale
