#include "tests/support/small_packages.h"

#include <array>

#include "generated/add.h"
#include "generated/filter.h"
#include "generated/pair.h"
#include "generated/post.h"
#include "generated/pre.h"
#include "generated/scale.h"

namespace shale {
namespace {

constexpr std::array<int8_t, 4> kWeights{1, -1, 2, 0};

Resource tensor(std::string name, Category category, uint64_t offset = 0) {
  Resource r;
  r.name = std::move(name);
  r.category = category;
  r.dtype = DType::kInt8;
  r.shape = {1, kSmallHeight, kSmallWidth, 4};
  r.offset_bytes = offset;
  r.size_bytes = kSmallBytes;
  return r;
}

/// The weights, behind 256 bytes that nobody uses.
Resource weights() {
  Resource r = tensor("weights", Category::kWeights, 256);
  r.shape = {kWeights.size()};
  r.size_bytes = kWeights.size();
  return r;
}

Resource image(std::string name, Category category, ImageFormat format, uint32_t depth = 0) {
  Resource r;
  r.name = std::move(name);
  r.category = category;
  r.format = format;
  r.width = kSmallWidth;
  r.height = kSmallHeight;
  r.history_depth = depth;
  return r;
}

Binding reads(uint32_t number, uint32_t resource, uint32_t frames_back = 0) {
  return {.binding = number, .resource = resource, .reads = true, .frames_back = frames_back};
}

Binding writes(uint32_t number, uint32_t resource) {
  return {.binding = number, .resource = resource, .writes = true};
}

Binding texels(uint32_t number, uint32_t resource) {
  return {.binding = number,
          .type = BindingType::kUniformTexelBuffer,
          .resource = resource,
          .view_format = ImageFormat::kRgba8Sint,
          .reads = true};
}

Binding sampled(uint32_t number, uint32_t resource, uint32_t frames_back = 0) {
  return {.binding = number,
          .type = BindingType::kSampledImage,
          .resource = resource,
          .reads = true,
          .frames_back = frames_back};
}

Binding stored(uint32_t number, uint32_t resource, bool written) {
  return {.binding = number,
          .type = BindingType::kStorageImage,
          .resource = resource,
          .reads = !written,
          .writes = written};
}

template <size_t N>
Spirv words(const uint32_t (&code)[N]) {
  return Spirv(code, code + N);
}

Package package_of(Variant variant) {
  variant.target = "any";
  variant.requirements = binding_requirements(variant);
  variant.requirements.workgroup_invocations = 64;
  variant.requirements.features.add(Feature::kStorageBuffer8);
  variant.requirements.features.add(Feature::kInt8);
  Package package;
  package.provenance = {0, "small", "by hand", ""};
  package.variants = {std::move(variant)};
  package.weights.resize(256);
  for (const int8_t w : kWeights) package.weights.push_back(static_cast<uint8_t>(w));
  return package;
}

}  // namespace

Package small_graph() {
  enum : uint32_t { kX, kW, kA, kB, kC, kY };
  enum : uint32_t { kScale, kPair, kAdd };
  Variant v;
  v.arena_bytes = 2 * kSmallBytes;
  v.resources = {
      tensor("x", Category::kInput),           weights(),
      tensor("a", Category::kIntermediate, 0), tensor("b", Category::kIntermediate, kSmallBytes),
      tensor("c", Category::kIntermediate, 0), tensor("y", Category::kOutput),
  };
  v.modules = {words(kScaleWords), words(kPairWords), words(kAddWords)};
  const std::array<uint32_t, 3> per_element{kSmallBytes / 64, 1, 1};
  const std::array<uint32_t, 3> per_texel{kSmallBytes / 256, 1, 1};
  v.segments = {
      {"network",
       SegmentKind::kGraph,
       {{"scale", "scale", kScale, per_element, {reads(0, kX), reads(1, kW), writes(2, kA)}, {}},
        {"pair", "pair", kPair, per_texel, {texels(0, kA), writes(5, kB)}, {}},
        {"double", "add", kAdd, per_element, {reads(0, kB), reads(1, kB), writes(2, kC)}, {}},
        {"sum", "add", kAdd, per_element, {reads(0, kC), reads(1, kX), writes(2, kY)}, {}}}}};
  return package_of(std::move(v));
}

std::vector<int8_t> small_graph_result(const std::vector<int8_t>& x) {
  std::vector<int8_t> y(kSmallBytes);
  for (size_t i = 0; i < kSmallBytes; ++i) {
    const size_t next = (i + 4) % kSmallBytes;
    const auto a = static_cast<int8_t>(x[i] * kWeights[i % 4]);
    const auto a_next = static_cast<int8_t>(x[next] * kWeights[i % 4]);
    const auto b = static_cast<int8_t>(a + a_next);
    y[i] = static_cast<int8_t>(b + b + x[i]);
  }
  return y;
}

Package small_frame() {
  enum : uint32_t { kX, kW, kY, kColor, kBlend, kHistory, kShown };
  enum : uint32_t { kPre, kScale, kPost };
  Variant v;
  v.resources = {tensor("x", Category::kInput),
                 weights(),
                 tensor("y", Category::kOutput),
                 image("color", Category::kImageInput, ImageFormat::kRgba8Unorm),
                 image("blend", Category::kImageInternal, ImageFormat::kR32Uint),
                 image("history", Category::kImageHistory, ImageFormat::kR32Uint, 3),
                 image("shown", Category::kImageOutput, ImageFormat::kRgba8Unorm)};
  v.modules = {words(kPreWords), words(kScaleWords), words(kPostWords)};
  const std::array<uint32_t, 3> per_pixel{kSmallWidth / 8, kSmallHeight / 8, 1};
  v.segments = {{"pre",
                 SegmentKind::kCompute,
                 {{"pre",
                   "pre",
                   kPre,
                   per_pixel,
                   {sampled(0, kColor), sampled(1, kHistory, 1), sampled(2, kHistory, 2),
                    stored(3, kBlend, true), writes(4, kX)},
                   {}}}},
                {"network",
                 SegmentKind::kGraph,
                 {{"scale",
                   "scale",
                   kScale,
                   {kSmallBytes / 64, 1, 1},
                   {reads(0, kX), reads(1, kW), writes(2, kY)},
                   {}}}},
                {"post",
                 SegmentKind::kCompute,
                 {{"post",
                   "post",
                   kPost,
                   per_pixel,
                   {reads(0, kY), stored(1, kBlend, false), stored(2, kHistory, true),
                    stored(3, kShown, true)},
                   {}}}}};
  return package_of(std::move(v));
}

Package small_frame_again() {
  Package package = small_frame();
  Variant& v = package.variants[0];
  Segment again = v.segments[0];
  again.name = "again";
  again.program = 1;
  again.dispatches[0].name = "pre_again";
  for (Binding& binding : again.dispatches[0].bindings)
    if (binding.frames_back > 0) --binding.frames_back;
  v.segments.push_back(std::move(again));
  v.programs = {"frame", "again"};
  return package;
}

Package small_programs() {
  enum : uint32_t { kX, kW, kY, kS, kZ };
  enum : uint32_t { kScale, kAdd };
  Variant v;
  v.resources = {tensor("x", Category::kInput), weights(), tensor("y", Category::kOutput),
                 tensor("s", Category::kOutput), tensor("z", Category::kOutput)};
  v.resources[kY].history_depth = 3;
  v.modules = {words(kScaleWords), words(kAddWords)};
  const std::array<uint32_t, 3> grid{kSmallBytes / 64, 1, 1};
  v.programs = {"frame", "between"};
  v.segments = {{"network",
                 SegmentKind::kGraph,
                 {{"scale", "scale", kScale, grid, {reads(0, kX), reads(1, kW), writes(2, kY)}, {}},
                  {"sum", "add", kAdd, grid, {reads(0, kY), reads(1, kY, 2), writes(2, kS)}, {}}}},
                {"middle",
                 SegmentKind::kGraph,
                 {{"mix", "add", kAdd, grid, {reads(0, kY), reads(1, kY, 1), writes(2, kZ)}, {}}},
                 1}};
  return package_of(std::move(v));
}

Package small_filter() {
  enum : uint32_t { kColor, kShown };
  Variant v;
  v.resources = {image("color", Category::kImageInput, ImageFormat::kRgba8Unorm),
                 image("shown", Category::kImageOutput, ImageFormat::kRgba8Unorm)};
  v.modules = {words(kFilterWords)};
  Binding filtered = sampled(0, kColor);
  filtered.type = BindingType::kSampler;
  v.segments = {{"filter",
                 SegmentKind::kCompute,
                 {{"filter",
                   "filter",
                   0,
                   {kSmallWidth / 8, kSmallHeight / 8, 1},
                   {filtered, stored(1, kShown, true)},
                   {}}}}};
  return package_of(std::move(v));
}

std::vector<uint32_t> SmallFrameModel::blend() const {
  std::vector<uint32_t> blend(kPixels);
  for (size_t p = 0; p < kPixels; ++p) blend[p] = last_[p] + 2 * before_[p];
  return blend;
}

std::vector<uint8_t> SmallFrameModel::next(const std::vector<uint8_t>& color) {
  std::vector<uint32_t> history = blend();
  std::vector<uint8_t> shown(kSmallBytes);
  for (size_t p = 0; p < kPixels; ++p) {
    int sum = 100;
    for (size_t k = 0; k < 4; ++k) sum += static_cast<int8_t>(color[4 * p + k] / 4 * kWeights[k]);
    history[p] += static_cast<uint32_t>(sum);
    for (size_t k = 0; k < 4; ++k) shown[4 * p + k] = static_cast<uint8_t>(history[p] >> (8 * k));
  }
  before_ = std::move(last_);
  last_ = std::move(history);
  return shown;
}

void SmallFrameModel::reset_history() { *this = {}; }

}  // namespace shale
