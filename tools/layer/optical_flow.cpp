#include "tools/layer/optical_flow.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "compiler/spirv/glsl.h"
#include "runtime/datagraph/late_pipelines.h"
#include "runtime/vk/commands.h"
#include "tools/layer/chain.h"
#include "tools/layer/flow_embedded.h"

namespace shale::layer {
namespace {

constexpr uint32_t kGroup = 8;           // invocations of a workgroup each way
constexpr uint32_t kCoarsest = 5;        // level of the pyramids where the search begins
constexpr uint32_t kLongestSide = 4096;  // what is reported, where the device has buffers for it

/// What lies in a session's memory: a binding each.
enum Store : uint32_t { kInput, kReference, kFound, kCleaned, kEven, kOdd, kStores };

/// The brightness of a picture in 8-bit steps, as luma.comp has it of what it tone maps.
constexpr const char* kLuma = R"(
#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= LUMA_WIDTH || at.y >= LUMA_HEIGHT) return;
#if GRAY
  const float luma = fetch_picture(at).r;
#else
  const float luma = dot(fetch_picture(at).rgb, vec3(0.25, 0.5, 0.25));
#endif
  store_luma(at, floor(luma * 255.0 + 0.5));
}
)";

/// A hint that fits better is taken, as hint.comp does it; vectors are in pixels of the pictures. The cost is the
/// sum of absolute differences over 5x5 pixels of the last level.
constexpr const char* kFinish = R"(
#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
const ivec2 kSize = ivec2(SMOOTH_WIDTH, SMOOTH_HEIGHT);
float difference(ivec2 at, vec2 flow) {
  const ivec2 way = ivec2(floor(clamp(flow, vec2(-16384.0), vec2(16384.0)) + 0.5));
  float sum = 0.0;
  for (int i = 0; i < 25; ++i) {
    const ivec2 p = at + ivec2(i % 5, i / 5) - 2;
    sum += abs(fetch_before(inside(p, kSize)) - fetch_after(inside(p + way, kSize)));
  }
  return sum;
}
void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kSize.x || at.y >= kSize.y) return;
  vec2 best = fetch_smooth(at);
#if HINT
  vec2 hint = fetch_hint(at).xy / float(GRID);
  if (any(isnan(hint)) || any(isinf(hint))) hint = vec2(0.0);
  if (difference(at, hint) < difference(at, best)) best = hint;
#endif
  store_result(at, best * float(GRID));
#if COST
  store_cost(at, uint(floor(difference(at, best) + 0.5)));
#endif
}
)";

struct Size {
  uint32_t width, height;
  uint64_t texels() const { return uint64_t{width} * height; }
};
Size level_size(const FlowSource& source, uint32_t level) {
  const auto part = [&](uint32_t whole) { return (whole + (1u << level) - 1) >> level; };
  return {part(source.width), part(source.height)};
}

/// The accessors of a pass, and the sizes that it asks for by name.
class PassText {
 public:
  PassText(const FlowSource& source, uint32_t own_set) : source_(source), own_set_(own_set) {
    defines_ = {{"LOCAL_X", std::to_string(kGroup)},
                {"LOCAL_Y", std::to_string(kGroup)},
                {"SHALE_LINEAR", "0"},
                {"GRAY", source.gray ? "1" : "0"},
                {"GRID", std::to_string(source.grid)},
                {"HINT", source.hint ? "1" : "0"},
                {"COST", source.cost ? "1" : "0"}};
  }
  PassText& define(const char* name, int value) {
    defines_.emplace_back(name, std::to_string(value));
    return *this;
  }
  /// A level of a pyramid of floats.
  PassText& brightness(const std::string& name, Store store, uint32_t level) {
    uint64_t first = 0;
    for (uint32_t i = 0; i < level; ++i) first += level_size(source_, i).texels();
    declare(store, "float");
    accessors(name, store, "float", level, first, "{}", "value");
    return *this;
  }
  /// Vectors of a level, two halves in a word.
  PassText& vectors(const std::string& name, Store store, uint32_t level) {
    declare(store, "uint");
    accessors(name, store, "vec2", level, 0, "unpackHalf2x16({})", "packHalf2x16(value)");
    return *this;
  }
  /// The application's image, to be read.
  PassText& picture(const std::string& name, const FlowImage& image, const char* format) {
    const std::string where = fmt::format("set = {}, binding = {}", image.set, image.binding);
    const bool is_storage = image.type == VK_DESCRIPTOR_TYPE_STORAGE_IMAGE;
    if (is_storage)
      text_ +=
          fmt::format("layout({}, {}) readonly uniform image2D {}_image;\n", where, format, name);
    else
      text_ += fmt::format(
          "layout({}) uniform {} {}_image;\n", where,
          image.type == VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE ? "texture2D" : "sampler2D", name);
    text_ += fmt::format("vec4 fetch_{0}(ivec2 at) {{ return {1}({0}_image, at{2}); }}\n", name,
                         is_storage ? "imageLoad" : "texelFetch", is_storage ? "" : ", 0");
    return *this;
  }
  /// The application's image, to be written.
  PassText& result(const std::string& name, const FlowImage& image, const char* format,
                   const char* image_type, const char* type, const char* texel) {
    text_ += fmt::format(
        "layout(set = {}, binding = {}, {}) writeonly uniform {} {}_image;\n"
        "void store_{}(ivec2 at, {} value) {{ imageStore({}_image, at, {}); }}\n",
        image.set, image.binding, format, image_type, name, name, type, name, texel);
    return *this;
  }
  Result<Spirv> compile(std::string_view source, const char* name) const {
    return compile_glsl(source, defines_, name,
                        [&](const std::string& file) -> Result<std::string> {
                          if (file != "generated_accessors.glsl")
                            return bad_input(file, "is no file of optical flow");
                          return text_;
                        });
  }

 private:
  void declare(Store store, const char* type) {
    if (declared_[store]) return;
    declared_[store] = true;
    text_ += fmt::format(
        "layout(std430, set = {0}, binding = {1}) buffer Store{1} {{ {2} store_{1}[]; }};\n",
        own_set_, static_cast<uint32_t>(store), type);
  }
  void accessors(const std::string& name, Store store, const char* type, uint32_t level,
                 uint64_t first, const std::string& read, const char* written) {
    const Size size = level_size(source_, level);
    const std::string word = fmt::format("store_{}[{} + at.y * {} + at.x]",
                                         static_cast<uint32_t>(store), first, size.width);
    text_ += fmt::format(
        "{0} fetch_{1}(ivec2 at) {{ return {2}; }}\n"
        "void store_{1}(ivec2 at, {0} value) {{ {3} = {4}; }}\n",
        type, name, fmt::format(fmt::runtime(read), word), word, written);
    std::string upper = name;
    for (char& c : upper) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    defines_.emplace_back(upper + "_WIDTH", std::to_string(size.width));
    defines_.emplace_back(upper + "_HEIGHT", std::to_string(size.height));
  }

  const FlowSource& source_;
  uint32_t own_set_;
  Defines defines_;
  std::string text_;
  std::array<bool, kStores> declared_{};
};

std::string_view shader_text(std::string_view name) {
  for (const auto& file : embedded_flow::kEmbeddedFiles)
    if (file.name == name) return file.text;
  SHALE_CHECK(false);
  return {};
}

}  // namespace

uint32_t max_flow_side(const Physical& physical) {
  // A pyramid of floats takes the most: 16 / 3 bytes a pixel of the picture.
  const double fits =
      std::sqrt(static_cast<double>(physical.limits.maxStorageBufferRange) * 3 / 16) - 64;
  return std::min({kLongestSide, physical.limits.maxImageDimension2D, static_cast<uint32_t>(fits)});
}

std::span<const VkFormat> flow_formats(VkDataGraphOpticalFlowImageUsageFlagsARM usage) {
  static constexpr VkFormat kPictures[] = {VK_FORMAT_R8_UNORM, VK_FORMAT_R8G8B8A8_UNORM};
  static constexpr VkFormat kVectors[] = {VK_FORMAT_R16G16_SFLOAT};
  static constexpr VkFormat kCosts[] = {VK_FORMAT_R16_UINT};
  constexpr auto kVectorUsage = VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_OUTPUT_BIT_ARM |
                                VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_HINT_BIT_ARM;
  if (usage == VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_INPUT_BIT_ARM) return kPictures;
  if (usage == VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_COST_BIT_ARM) return kCosts;
  if (usage != 0 && (usage & ~VkFlags{kVectorUsage}) == 0) return kVectors;
  return {};
}

Result<FlowSource> read_flow(const Device& device, const VkDataGraphPipelineCreateInfoARM& info,
                             const VkDataGraphPipelineSingleNodeCreateInfoARM& node) {
  const char* where = "VkDataGraphPipelineOpticalFlowCreateInfoARM";
  const auto* flow = find_in_chain<VkDataGraphPipelineOpticalFlowCreateInfoARM>(
      info.pNext, VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_OPTICAL_FLOW_CREATE_INFO_ARM);
  if (!device.optical_flow) return unsupported(where, "dataGraphOpticalFlow is not enabled");
  if (node.nodeType != VK_DATA_GRAPH_PIPELINE_NODE_TYPE_OPTICAL_FLOW_ARM)
    return unsupported(where, "node type {} is unknown", static_cast<int>(node.nodeType));
  if (!flow) return bad_input(where, "is missing in the chain of the node");
  const uint32_t longest = max_flow_side(*device.physical);
  if (flow->width == 0 || flow->height == 0 || flow->width > longest || flow->height > longest)
    return unsupported(where, "pictures have {}x{} pixels, expected 1 to {} each way", flow->width,
                       flow->height, longest);
  const auto takes = [](VkFormat format, VkDataGraphOpticalFlowImageUsageFlagsARM usage) {
    const auto formats = flow_formats(usage);
    return std::find(formats.begin(), formats.end(), format) != formats.end();
  };
  constexpr VkFlags kKnownFlags = VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_ENABLE_HINT_BIT_ARM |
                                  VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_ENABLE_COST_BIT_ARM;
  const bool hints = flow->flags & VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_ENABLE_HINT_BIT_ARM;
  const bool costs = flow->flags & VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_ENABLE_COST_BIT_ARM;
  if (flow->flags & ~kKnownFlags) return unsupported(where, "flags {:#x}", flow->flags);
  if (!takes(flow->imageFormat, VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_INPUT_BIT_ARM) ||
      !takes(flow->flowVectorFormat, VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_OUTPUT_BIT_ARM) ||
      (costs && !takes(flow->costFormat, VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_COST_BIT_ARM)))
    return unsupported(
        where, "format {}, {} or {} is not reported", static_cast<int>(flow->imageFormat),
        static_cast<int>(flow->flowVectorFormat), static_cast<int>(flow->costFormat));
  const uint32_t grid = flow->outputGridSize;
  if (grid != 1 && grid != 2 && grid != 4 && grid != 8)
    return bad_input(where, "output grid size {:#x} is not one of 1x1 to 8x8", grid);
  if (flow->hintGridSize != 0 && flow->hintGridSize != grid)
    return bad_input(where, "the hint's grid size {:#x} is not the output's", flow->hintGridSize);

  const auto layout = device.layouts.find(info.layout);
  if (!layout || !layout->with_flow)
    return unsupported("VkDataGraphPipelineCreateInfoARM::layout",
                       "has pushed or dynamic descriptors, lies in buffers, or has too many sets");
  FlowSource source;
  source.width = flow->width;
  source.height = flow->height;
  source.grid = grid;  // the flags' values are the sides
  source.gray = flow->imageFormat == VK_FORMAT_R8_UNORM;
  const auto find = [&](VkDataGraphPipelineNodeConnectionTypeARM wanted, bool is_written,
                        FlowImage& image) -> Result<bool> {
    const std::span<const VkDataGraphPipelineSingleNodeConnectionARM> all(node.pConnections,
                                                                          node.connectionCount);
    const auto is_it = [&](const auto& each) { return each.connection == wanted; };
    const auto found = std::find_if(all.begin(), all.end(), is_it);
    if (found == all.end()) return false;
    const std::string place = fmt::format("connection {} (set {}, binding {})",
                                          static_cast<int>(wanted), found->set, found->binding);
    if (std::count_if(all.begin(), all.end(), is_it) > 1) return bad_input(place, "is there twice");
    const SetLayout* set =
        found->set < layout->sets.size() ? layout->sets[found->set].get() : nullptr;
    const auto binding = set ? set->bindings.find(found->binding) : decltype(set->bindings.end()){};
    if (!set || binding == set->bindings.end() || binding->second.count != 1 ||
        binding->second.varies || !(binding->second.stages & VK_SHADER_STAGE_COMPUTE_BIT))
      return bad_input(place, "the layout has no single image for all stages there");
    image = {found->set, found->binding, binding->second.type};
    const bool fits = image.type == VK_DESCRIPTOR_TYPE_STORAGE_IMAGE ||
                      (!is_written && (image.type == VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE ||
                                       image.type == VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER));
    if (!fits)
      return unsupported(place, "descriptor type {} is no image to be {}",
                         static_cast<int>(image.type), is_written ? "written" : "read");
    return true;
  };
  const auto need = [&](VkDataGraphPipelineNodeConnectionTypeARM wanted, bool is_written,
                        FlowImage& image) -> Result<void> {
    SHALE_TRY(const bool found, find(wanted, is_written, image));
    if (!found) return bad_input(where, "connection {} is missing", static_cast<int>(wanted));
    return {};
  };
  SHALE_TRY_VOID(need(VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_INPUT_ARM, false,
                      source.input));
  SHALE_TRY_VOID(need(VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_REFERENCE_ARM, false,
                      source.reference));
  SHALE_TRY_VOID(need(VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_FLOW_VECTOR_ARM,
                      true, source.flow));
  if (hints)
    SHALE_TRY_VOID(need(VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_HINT_ARM, false,
                        source.hint.emplace()));
  if (costs)
    SHALE_TRY_VOID(need(VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_COST_ARM, true,
                        source.cost.emplace()));
  return source;
}

Result<vk::SetLayoutHandle> create_flow_set_layout(const Device& device) {
  std::array<VkDescriptorSetLayoutBinding, kStores> bindings;
  for (uint32_t i = 0; i < kStores; ++i)
    bindings[i] = {i, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr};
  auto info = vk::init<VkDescriptorSetLayoutCreateInfo>(
      VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
  info.bindingCount = kStores;
  info.pBindings = bindings.data();
  return vk::make(device.context->vk.CreateDescriptorSetLayout,
                  device.context->vk.DestroyDescriptorSetLayout, "vkCreateDescriptorSetLayout",
                  device.handle, info);
}

Result<std::unique_ptr<OpticalFlow>> OpticalFlow::create(
    const Device& device, const FlowSource& source, std::shared_ptr<const PipelineLayout> layout,
    VkPipelineCache cache) {
  auto flow = std::make_unique<OpticalFlow>();
  flow->layout_ = std::move(layout);
  const auto own_set = static_cast<uint32_t>(flow->layout_->sets.size());
  for (const FlowImage* image : {&source.input, &source.reference, &source.flow})
    flow->sets_.insert(image->set);
  if (source.hint) flow->sets_.insert(source.hint->set);
  if (source.cost) flow->sets_.insert(source.cost->set);

  const auto finest = static_cast<uint32_t>(std::countr_zero(source.grid));
  uint64_t pyramid = 0;
  for (uint32_t level = 0; level <= kCoarsest; ++level)
    pyramid += level_size(source, level).texels();
  const uint64_t vectors = level_size(source, finest).texels();
  for (uint32_t store = 0; store < kStores; ++store) {
    const uint64_t bytes = sizeof(uint32_t) * (store <= kReference ? pyramid : vectors);
    flow->parts_.push_back({flow->memory_bytes_, bytes});
    constexpr uint64_t kAlignment = 256;  // the largest that Vulkan allows
    flow->memory_bytes_ += (bytes + kAlignment - 1) / kAlignment * kAlignment;
  }

  const auto add = [&](const char* name, std::string_view text, const PassText& pass,
                       uint32_t level, bool waits) -> Result<void> {
    SHALE_TRY(const Spirv words, pass.compile(text, name));
    SHALE_TRY(vk::PipelineHandle pipeline,
              create_pipeline(*device.context, words, flow->layout_->with_flow.get(), cache));
    const Size size = level_size(source, level);
    flow->passes_.push_back({std::move(pipeline), size.width, size.height, waits});
    return {};
  };
  const auto pass = [&] { return PassText(source, own_set); };
  const char* format = source.gray ? "r8" : "rgba8";
  SHALE_TRY_VOID(add("luma", kLuma,
                     pass().picture("picture", source.input, format).brightness("luma", kInput, 0),
                     0, false));
  SHALE_TRY_VOID(
      add("luma", kLuma,
          pass().picture("picture", source.reference, format).brightness("luma", kReference, 0), 0,
          false));
  for (uint32_t level = 1; level <= kCoarsest; ++level)
    for (const Store store : {kInput, kReference})
      SHALE_TRY_VOID(add("halve", shader_text("halve.comp"),
                         pass()
                             .define("BLUR", level > 1)
                             .brightness("fine", store, level - 1)
                             .brightness("coarse", store, level),
                         level, store == kInput));
  const auto smooth = [](uint32_t level) { return level % 2 == 0 ? kEven : kOdd; };
  for (uint32_t level = kCoarsest + 1; level-- > finest;) {
    PassText match = pass();
    match.define("COARSEST", level == kCoarsest)
        .brightness("before", kInput, level)
        .brightness("after", kReference, level)
        .vectors("found", kFound, level);
    if (level < kCoarsest) match.vectors("above", smooth(level + 1), level + 1);
    SHALE_TRY_VOID(add("match", shader_text("match.comp"), match, level, true));
    SHALE_TRY_VOID(add("median", shader_text("median.comp"),
                       pass().vectors("found", kFound, level).vectors("cleaned", kCleaned, level),
                       level, true));
    SHALE_TRY_VOID(add("bilateral", shader_text("bilateral.comp"),
                       pass()
                           .brightness("before", kInput, level)
                           .vectors("cleaned", kCleaned, level)
                           .vectors("flow", smooth(level), level),
                       level, true));
  }
  PassText finish = pass();
  finish.brightness("before", kInput, finest)
      .brightness("after", kReference, finest)
      .vectors("smooth", smooth(finest), finest)
      .result("result", source.flow, "rg16f", "image2D", "vec2", "vec4(value, 0.0, 0.0)");
  if (source.hint) finish.picture("hint", *source.hint, "rg16f");
  if (source.cost)
    finish.result("cost", *source.cost, "r16ui", "uimage2D", "uint", "uvec4(value, 0u, 0u, 0u)");
  SHALE_TRY_VOID(add("finish", kFinish, finish, finest, true));
  return flow;
}

Result<OpticalFlow::Bound> OpticalFlow::Bound::create(const Device& device, const OpticalFlow& flow,
                                                      VkBuffer memory) {
  const vk::Context& context = *device.context;
  Bound bound;
  const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, kStores};
  auto pool_info =
      vk::init<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
  pool_info.maxSets = 1;
  pool_info.poolSizeCount = 1;
  pool_info.pPoolSizes = &size;
  SHALE_TRY(bound.pool_, vk::make(context.vk.CreateDescriptorPool, context.vk.DestroyDescriptorPool,
                                  "vkCreateDescriptorPool", context.device, pool_info));
  const VkDescriptorSetLayout set_layout = device.flow_set_layout.get();
  auto allocate =
      vk::init<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
  allocate.descriptorPool = bound.pool_.get();
  allocate.descriptorSetCount = 1;
  allocate.pSetLayouts = &set_layout;
  SHALE_TRY_VOID(
      vk::check(context.vk.AllocateDescriptorSets(context.device, &allocate, &bound.set_),
                "vkAllocateDescriptorSets"));
  std::array<VkDescriptorBufferInfo, kStores> buffers;
  for (size_t i = 0; i < kStores; ++i)
    buffers[i] = {memory, flow.parts_[i].offset, flow.parts_[i].bytes};
  auto write = vk::init<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
  write.dstSet = bound.set_;
  write.descriptorCount = kStores;  // over all bindings
  write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  write.pBufferInfo = buffers.data();
  context.vk.UpdateDescriptorSets(context.device, 1, &write, 0, nullptr);
  return bound;
}

void OpticalFlow::record(const Device& device, VkCommandBuffer commands, const Bound& bound,
                         const std::map<uint32_t, VkDescriptorSet>& sets) const {
  const vk::Context& context = *device.context;
  const auto bind = [&](uint32_t number, VkDescriptorSet set) {
    context.vk.CmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE,
                                     layout_->with_flow.get(), number, 1, &set, 0, nullptr);
  };
  for (const uint32_t number : sets_) bind(number, sets.at(number));
  bind(static_cast<uint32_t>(layout_->sets.size()), bound.set());
  for (const Pass& pass : passes_) {
    if (pass.waits)
      vk::memory_barrier(context, commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                         VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                         VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT);
    context.vk.CmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pass.pipeline.get());
    context.vk.CmdDispatch(commands, (pass.width + kGroup - 1) / kGroup,
                           (pass.height + kGroup - 1) / kGroup, 1);
  }
}

}  // namespace shale::layer
