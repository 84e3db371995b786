// One frame for a CPU driver and for GPUs: what becomes of its images, and what does not fit together.
#include "compiler/plan/frame_lowering.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/compiler/frame_support.h"

namespace shale {
namespace {

const Resource& resource_of(const Variant& variant, const std::string& name) {
  for (const Resource& resource : variant.resources)
    if (resource.name == name) return resource;
  ADD_FAILURE() << "no resource " << name;
  return variant.resources.front();
}

/// "segment kernel" of every dispatch.
std::vector<std::string> dispatches_of(const Variant& variant) {
  std::vector<std::string> names;
  for (const Segment& segment : variant.segments)
    for (const Dispatch& dispatch : segment.dispatches)
      names.push_back(dispatch.name + " " + dispatch.kernel);
  return names;
}

const Dispatch& dispatch_of(const Variant& variant, const std::string& name) {
  for (const Segment& segment : variant.segments)
    for (const Dispatch& dispatch : segment.dispatches)
      if (dispatch.name == name) return dispatch;
  ADD_FAILURE() << "no dispatch " << name;
  return variant.segments.front().dispatches.front();
}

std::string error_of(const std::string& from, const std::string& to) {
  const std::string text = replaced(kFrame, from, to);
  EXPECT_NE(text, kFrame) << from;
  return error_text(compile_frame(frame_options(text)));
}

TEST(FrameLowering, KeepsTexelsInBuffersOnACpu) {
  const Compiled compiled = must(compile_frame(frame_options(kFrame)));
  const Variant& variant = compiled.package.variants[0];
  EXPECT_EQ(dispatches_of(variant),
            (std::vector<std::string>{"take_color copy", "clear_marks clear", "pre pass", "y runs",
                                      "post pass", "show_shown copy"}));
  EXPECT_TRUE(is_linear(resource_of(variant, "kept")));
  EXPECT_TRUE(is_linear(resource_of(variant, "marks")));
  EXPECT_TRUE(is_linear(resource_of(variant, "color.linear")));
  EXPECT_FALSE(is_linear(resource_of(variant, "color")));
  EXPECT_EQ(resource_of(variant, "kept").size_bytes,
            24u * 8 * 12);  // rows of 20 texels, padded to 64 bytes
  for (const Binding& binding : dispatch_of(variant, "pre").bindings)
    EXPECT_TRUE(binding.type == BindingType::kUniformTexelBuffer ||
                binding.type == BindingType::kStorageBuffer);
  EXPECT_TRUE(must(read_package(write_package(compiled.package))) == compiled.package);
}

TEST(FrameLowering, TakesTheHostsImagesAsTheyAreOnAGpu) {
  for (const char* target : {"generic-gpu", "dot8-gpu", "coopmat-gpu"}) {
    CompileOptions options = frame_options(kFrame);
    options.targets = {target};
    const Compiled compiled = must(compile_frame(options));
    EXPECT_EQ(compiled.warnings, std::vector<std::string>{}) << target;
    const Variant& variant = compiled.package.variants[0];
    EXPECT_EQ(dispatches_of(variant), (std::vector<std::string>{"clear_marks clear", "pre pass",
                                                                "y generic", "post pass"}));
    for (const Resource& resource : variant.resources) EXPECT_FALSE(is_linear(resource));
    // The sampler is the device's; the output gets what the history gets.
    const std::vector<Binding>& pre = dispatch_of(variant, "pre").bindings;
    EXPECT_TRUE(std::any_of(pre.begin(), pre.end(), [](const Binding& binding) {
      return binding.type == BindingType::kSampler && binding.frames_back == 2;
    }));
    size_t stored = 0;
    for (const Binding& binding : dispatch_of(variant, "post").bindings)
      if (binding.type == BindingType::kStorageImage) ++stored;
    EXPECT_EQ(stored, 2u);
    EXPECT_EQ(variant.requirements.texel_elements, 0u);
  }
}

TEST(FrameLowering, FallsBackToImagesWhereNoBufferIsLargeEnough) {
  CompileOptions options = frame_options(replaced(kFrame, "[1.5, 3]", "[1, 3]"));
  options.sizes.render = FrameExtent{8000, 8000};
  options.sizes.output = FrameExtent{8000, 8000};
  options.frame->images[2].format = options.frame->images[1].format = ImageFormat::kRgba16Float;
  const Compiled compiled = must(compile_frame(
      options,
      "graph main {\n input %x : i8[1,?,?,4]\n %y = bitwise_not %x : i8[1,?,?,4]\n return %y\n}"));
  for (const Resource& resource : compiled.package.variants[0].resources)
    EXPECT_FALSE(is_linear(resource)) << resource.name;
}

TEST(FrameLowering, PutsPassesOverTheirGrids) {
  const Compiled compiled = must(compile_frame(frame_options(kFrame)));
  const Variant& variant = compiled.package.variants[0];
  EXPECT_EQ(dispatch_of(variant, "pre").workgroups,
            (std::array<uint32_t, 3>{2, 2, 1}));  // 10x6 by 8x4
  EXPECT_EQ(dispatch_of(variant, "post").workgroups,
            (std::array<uint32_t, 3>{3, 2, 1}));  // 20x12 by 8x8
  EXPECT_EQ(variant.params.size(), 3u);
  EXPECT_EQ(variant.views.size(), 1u);
}

TEST(FrameLowering, NamesWhatDoesNotFitTogether) {
  EXPECT_EQ(error_of("\"over\": \"color\"", "\"over\": \"colour\""),
            "pass \"pre\": there is no image, graph input or output \"colour\" to go over");
  EXPECT_EQ(error_of("\"reads\": [\"y\", \"marks\"]", "\"reads\": [\"y\", \"marks\", \"z\"]"),
            "pass \"post\": reads \"z\", for which post.comp has no accessor");
  EXPECT_EQ(
      error_of("\"reads\": [\"y\", \"marks\"]", "\"reads\": [\"y\"]"),
      "pass \"post\": post.comp has fetch_marks, but \"marks\" is not among what the pass reads");
  EXPECT_EQ(
      error_of("\"writes\": [\"kept\"]", "\"writes\": []"),
      "pass \"post\": post.comp has store_kept, but \"kept\" is not among what the pass writes");
  EXPECT_EQ(
      error_of("\"updates\": [\"marks\"]", "\"updates\": []"),
      "pass \"pre\": pre.comp has max_marks, but \"marks\" is not among what the pass updates");
  EXPECT_EQ(error_of("\"frames_back\": 2", "\"frames_back\": 3"),
            "pass \"pre\": reads \"kept\" 3 frames back, its history is 3 deep");
  EXPECT_EQ(error_of("\"name\": \"shown\"", "\"name\": \"color\""),
            "frame.images: the name \"color\" is used twice");
  EXPECT_EQ(error_of("\"shows\": \"kept\"", "\"shows\": \"marks\""),
            "image \"shown\": shows \"marks\", which is no internal or history image of its format "
            "and size");
  EXPECT_EQ(error_of("\"clears\": [\"marks\"]", "\"clears\": [\"kept\"]"),
            "pass \"pre\": clears \"kept\", which is no internal image");
  EXPECT_EQ(error_of("pre.comp", "missing.comp"), "missing.comp: cannot be read");
  EXPECT_EQ(
      error_text(compile_frame(frame_options(kFrame),
                               "graph main {\n input %x : i32[2,3]\n %y = abs %x : i32[2,3]\n "
                               "return %y\n}")),
      "frame.tensors: the network has no NHWC input \"x\"");
  EXPECT_EQ(
      error_text(compile_frame(frame_options(kFrame),
                               "graph main {\n input %z : i8[1,6,10,4]\n %y = bitwise_not %z : "
                               "i8[1,6,10,4]\n return %y\n}")),
      "frame.tensors: the network has no NHWC input \"x\"");
}

TEST(FrameLowering, RefusesAccessorsThatAResourceDoesNotHave) {
  auto shaders = frame_shaders();
  shaders["post.comp"] = replaced(shaders["post.comp"], "codes_y(0)", "fetch_y(0)");
  EXPECT_EQ(error_text(compile_frame(frame_options(kFrame, shaders))),
            "pass \"post\": fetch_y: tensor \"y\" has no such accessor");
  shaders = frame_shaders();
  shaders["pre.comp"] =
      replaced(shaders["pre.comp"], "max_marks(ivec2(0), uint(at.x))", "store_marks(ivec2(0), 1u)");
  EXPECT_EQ(
      error_text(compile_frame(frame_options(kFrame, shaders))),
      "pass \"pre\": pre.comp has store_marks, but \"marks\" is not among what the pass writes");
}

TEST(FrameLowering, ComparesInterfacesWithThePlan) {
  // Declarations of a shader's own meet the plan's bindings, and are told apart by kind, format and numbers.
  struct Row {
    const char *declaration, *use, *message;
  };
  const Row rows[] = {
      {"layout(set = 0, binding = 9) uniform utextureBuffer own;", "texelFetch(own, 0).x",
       "pass \"post\", binding 9: the shader declares a texel buffer, and nothing is bound there"},
      {"layout(set = 0, binding = 0) uniform utextureBuffer own;", "texelFetch(own, 0).x",
       "pass \"post\", binding 0: the shader reads uints, but \"y\" has ints (rgba8_sint)"},
      {"layout(set = 0, binding = 0, rgba8) uniform readonly image2D own;",
       "uint(imageLoad(own, ivec2(0)).x)",
       "pass \"post\", binding 0: the shader declares a storage image, but \"y\" is bound as a "
       "texel buffer"},
      {"layout(set = 1, binding = 0, std430) readonly buffer Own { uint data[]; } own;",
       "own.data[0]", "pass \"post\", binding 0: the shader declares it in set 1, expected set 0"},
      {"layout(set = 0, binding = 0) uniform Own { uint data; } own;", "own.data",
       "post.comp, binding 0: the shader declares a descriptor that is no image and no storage "
       "buffer"},
      {"layout(push_constant) uniform Own { vec4 data[3]; } own;", "uint(own.data[2].x)",
       "pass \"post\": the shader declares 48 bytes of push constants, the parameters have 20"},
  };
  for (const Row& row : rows) {
    auto shaders = frame_shaders();
    shaders["post.comp"] = replaced(replaced(shaders["post.comp"], "void main() {",
                                             std::string(row.declaration) + "\nvoid main() {"),
                                    "float(fetch_marks(ivec2(0)))",
                                    std::string("float(fetch_marks(ivec2(0)) + ") + row.use + ")");
    EXPECT_EQ(error_text(compile_frame(frame_options(kFrame, shaders))), row.message);
  }
}

TEST(FrameLowering, TakesTheSizesThatAreAskedFor) {
  CompileOptions sized = frame_options(kFrame);
  sized.sizes.render = FrameExtent{12, 8};
  const auto size = [](const Compiled& compiled, const char* name) {
    const Resource& resource = resource_of(compiled.package.variants[0], name);
    return FrameExtent{resource.width, resource.height};
  };
  Compiled compiled = must(compile_frame(sized));
  EXPECT_EQ(compiled.package.variants[0].resources[0].shape, (Shape{1, 8, 12, 4}));
  EXPECT_EQ(size(compiled, "shown"), (FrameExtent{24, 16}));
  sized.sizes.output = FrameExtent{36, 13};
  compiled = must(compile_frame(sized));
  EXPECT_EQ(size(compiled, "shown"), (FrameExtent{36, 13}));
  sized.sizes.output = FrameExtent{12, 8};
  EXPECT_NE(error_text(compile_frame(sized)).find("12x8 to 12x8 is a ratio outside 1.5 to 3"),
            std::string::npos);
  sized.sizes.output.reset();
  sized.passes.input_shapes = {{"x", {1, 6, 8, 4}}};
  EXPECT_NE(error_text(compile_frame(sized)).find("use --render and --output-size"),
            std::string::npos);
}

TEST(FrameLowering, MayHaveNoNetwork) {
  const std::string json =
      R"({"schema": "shale-frame/2", "render": [4, 4], "output": [8, 8], "ratio": [2, 2],
    "images": [{"name": "color", "role": "input", "format": "rgba8_unorm", "size": "render"},
               {"name": "shown", "role": "output", "format": "rgba8_unorm", "size": "output"}],
    "passes": [{"name": "grow", "shader": "grow.comp", "over": "shown", "reads": ["color"], "writes": ["shown"]}]})";
  const CompileOptions alone = frame_options(
      json,
      {{"half.glsl", "ivec2 half_of(ivec2 at) { return at / 2; }\n"}, {"grow.comp", R"(#version 450
#include "access.glsl"
#include "half.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
void main() { const ivec2 at = ivec2(gl_GlobalInvocationID.xy); store_shown(at, fetch_color(half_of(at))); })"}});
  const Compiled compiled = must(compile({}, alone));
  EXPECT_EQ(dispatches_of(compiled.package.variants[0]),
            (std::vector<std::string>{"take_color copy", "grow pass"}));
  EXPECT_TRUE(must(read_package(write_package(compiled.package))) == compiled.package);
}

TEST(FrameLowering, KeepsNamesOfPassesAndValuesApart) {
  const Compiled compiled =
      must(compile_frame(frame_options(replaced(kFrame, "\"name\": \"pre\"", "\"name\": \"y\""))));
  EXPECT_EQ(dispatches_of(compiled.package.variants[0])[2], "y pass");
  EXPECT_EQ(dispatches_of(compiled.package.variants[0])[3], "y# runs");
}

TEST(FrameLowering, ShadersAndFrameAreInTheProvenance) {
  const auto options_of = [](const CompileOptions& options) {
    return must(compile_frame(options)).package.provenance.options;
  };
  const std::string plain = options_of(frame_options(kFrame));
  auto shaders = frame_shaders();
  shaders["post.comp"] = replaced(shaders["post.comp"], "codes_y(0)", "codes_y(1)");
  EXPECT_NE(options_of(frame_options(kFrame, shaders)), plain);
  EXPECT_NE(options_of(frame_options(replaced(kFrame, "\"LEAST\": 0.25", "\"LEAST\": 0.5"))),
            plain);
  EXPECT_NE(options_of(frame_options(replaced(kFrame, "\"depth\": 3", "\"depth\": 4"))), plain);
  EXPECT_NE(
      options_of(frame_options(replaced(kFrame, "\"default\": [0.5]", "\"default\": [0.25]"))),
      plain);
  EXPECT_NE(
      options_of(frame_options(replaced(kFrame, "\"title\": \"input\"", "\"title\": \"in\""))),
      plain);
  EXPECT_EQ(options_of(frame_options(kFrame)), plain);
}

TEST(FrameLowering, ProgramsShareImagesAndGraphs) {
  std::string json = kFrame;
  json = replaced(json, "\"passes\": [", "\"programs\": [{\"name\": \"upscale\", \"passes\": [");
  json.erase(json.rfind(']'));
  json +=
      R"(]}, {"name": "again", "passes": [{"name": "show_again", "shader": "again.comp", "over": "marks",
    "reads": [{"of": "kept", "frames_back": 0}], "writes": ["marks"]}, {"graph": "main"},
    {"name": "other", "graph": "second.tosa", "tensors": {"x": "z", "y": "w"}}]}]})";
  auto shaders = frame_shaders();
  shaders["again.comp"] = R"(#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
void main() { store_marks(ivec2(0), uint(rgb_of(fetch_kept(ivec2(0))).r)); })";
  CompileOptions options = frame_options(json, shaders);
  options.load_model = [](const std::string& path) -> Result<std::vector<uint8_t>> {
    EXPECT_EQ(path, "second.tosa");
    const std::string text =
        "graph main {\n input %x : i8[3]\n %y = bitwise_not %x : i8[3]\n return %y\n}";
    return std::vector<uint8_t>(text.begin(), text.end());
  };
  const Compiled compiled = must(compile_frame(options));
  const Variant& variant = compiled.package.variants[0];
  EXPECT_EQ(variant.programs, (std::vector<std::string>{"upscale", "again"}));
  EXPECT_EQ(compiled.further_graphs.size(), 1u);
  EXPECT_EQ(resource_of(variant, "z").category, Category::kInput);
  EXPECT_EQ(resource_of(variant, "w").category, Category::kOutput);
  EXPECT_EQ(program_segments(variant, 1).size(), 3u);
  EXPECT_TRUE(must(read_package(write_package(compiled.package))) == compiled.package);
  options.load_model = {};
  EXPECT_EQ(error_text(compile_frame(options)), "second.tosa: cannot be read: no loader is given");
}

}  // namespace
}  // namespace shale
