#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iterator>

#include "ir/base/hash.h"
#include "ir/package/pack.h"
#include "ir/package/package.h"

namespace shale {
namespace {

constexpr std::array<const char*, kCategoryCount> kCategoryNames{
    "input",       "output",       "intermediate",   "weights",
    "image input", "image output", "image internal", "image history"};
constexpr std::array<const char*, kBindingTypeCount> kBindingTypeNames{
    "storage buffer", "texel buffer", "sampled image", "storage image", "transfer", "sampler"};
constexpr std::array<const char*, 3> kSegmentNames{"compute", "graph", "transfer"};

template <typename... Args>
void line(std::string& text, fmt::format_string<Args...> format, Args&&... args) {
  fmt::format_to(std::back_inserter(text), format, std::forward<Args>(args)...);
  text += '\n';
}

void dump_requirements(std::string& text, const Requirements& r) {
  std::string features;
  for (uint32_t i = 0; i < kFeatureCount; ++i)
    if (r.features.has(static_cast<Feature>(i)))
      features += fmt::format(" {}", feature_name(static_cast<Feature>(i)));
  line(text, "  needs:{}", features.empty() ? " no optional feature" : features);
  line(text, "    workgroups of {} invocations, {} shared bytes", r.workgroup_invocations,
       r.shared_bytes);
  line(text, "    buffer ranges of {} bytes, texel buffers of {} elements", r.storage_range_bytes,
       r.texel_elements);
  line(text,
       "    in one dispatch {} storage buffers, {} texel buffers and sampled images, "
       "{} storage images",
       r.storage_buffers, r.texel_buffers, r.storage_images);
  for (const MatrixProduct& product : r.matrix_products)
    line(text, "    cooperative matrices of {} int8 in subgroups of {}",
         matrix_product_text(product), r.subgroup_size);
}

void dump_resource(std::string& text, size_t index, const Resource& r) {
  const char* category = kCategoryNames[static_cast<uint32_t>(r.category)];
  if (is_image(r.category)) {
    line(text, "    {:3} {:14} {} {}x{}{}{} \"{}\"", index, category,
         image_format_info(r.format).name, r.width, r.height,
         r.history_depth ? fmt::format(" depth {}", r.history_depth) : "",
         is_linear(r) ? fmt::format(" linear, {} bytes", r.size_bytes) : "", r.name);
    return;
  }
  const bool placed = r.category == Category::kIntermediate || r.category == Category::kWeights;
  line(text, "    {:3} {:14} {}[{}] {} bytes{}{}{} \"{}\"", index, category,
       dtype_info(r.dtype).name, fmt::join(r.shape, ","), r.size_bytes,
       placed ? fmt::format(" at {}", r.offset_bytes) : "",
       r.history_depth ? fmt::format(" depth {}", r.history_depth) : "",
       r.quantization ? fmt::format(" scale {} zero point {}", r.quantization->scale,
                                    r.quantization->zero_point)
                      : "",
       r.name);
}

void dump_binding(std::string& text, const Binding& b, const Variant& variant) {
  const char* access = !b.writes ? "reads" : b.reads ? "reads and writes" : "writes";
  line(text, "      {:2} {}{} {} \"{}\"{}", b.binding,
       kBindingTypeNames[static_cast<uint32_t>(b.type)],
       b.view_format == ImageFormat::kNone
           ? ""
           : fmt::format(" {}", image_format_info(b.view_format).name),
       access, variant.resources[b.resource].name,
       b.frames_back ? fmt::format(" {} frame(s) back", b.frames_back) : "");
}

void dump_segment(std::string& text, const Segment& segment, const Variant& variant) {
  line(text, "  segment \"{}\" ({}): {} dispatches", segment.name,
       kSegmentNames[static_cast<uint32_t>(segment.kind)], segment.dispatches.size());
  if (segment.tiles)
    line(text, "    works by tiles: changes in \"{}\", work in \"{}\", tolerance {}",
         variant.resources[segment.tiles->changes].name,
         variant.resources[segment.tiles->work].name, segment.tiles->tolerance);
  for (const Dispatch& d : segment.dispatches) {
    line(text, "    \"{}\": {} module {} grid {}x{}x{}", d.name, d.kernel, d.module,
         d.workgroups[0], d.workgroups[1], d.workgroups[2]);
    if (d.indirect)
      line(text, "      as many as words {}..{} of \"{}\" say", d.indirect->first,
           d.indirect->first + 2, variant.resources[d.indirect->resource].name);
    line(text, "      predicted {:.1f} us: {} macs, {} other ops, {} bytes read, {} written",
         d.cost.time_us, d.cost.macs, d.cost.ops, d.cost.bytes_read, d.cost.bytes_written);
    for (const Binding& binding : d.bindings) dump_binding(text, binding, variant);
  }
  for (const auto& [index, d] : segment.start_forms) {
    line(text, "    start of \"{}\": {} module {} grid {}x{}x{}, predicted {:.1f} us", d.name,
         d.kernel, d.module, d.workgroups[0], d.workgroups[1], d.workgroups[2], d.cost.time_us);
    for (const Binding& binding : d.bindings) dump_binding(text, binding, variant);
  }
}

void dump_variant(std::string& text, size_t index, const Variant& variant) {
  line(text, "variant {}: target \"{}\" (class {}), arena {} bytes", index, variant.target,
       device_class_name(variant.device_class), variant.arena_bytes);
  dump_requirements(text, variant.requirements);
  if (variant.promise)
    line(text, "  promised: {}; \"{}\" is not 0 in a frame that breaks it", variant.promise->text,
         variant.resources[variant.promise->broken].name);
  line(text, "  resources: {}", variant.resources.size());
  for (size_t i = 0; i < variant.resources.size(); ++i)
    dump_resource(text, i, variant.resources[i]);
  for (uint32_t i = 0; i < variant.programs.size(); ++i) {
    const size_t values = variant.choices.size() / variant.programs.size();
    line(text, "  program \"{}\"{}", variant.programs[i],
         values == 0
             ? ""
             : fmt::format(" where \"{}\" is nearest {}", variant.chosen_by,
                           fmt::join(std::span(variant.choices).subspan(i * values, values), ",")));
    if (variant.generator && variant.generator->program == i)
      line(text, "    generates pictures at times above {} up to {}", variant.generator->after,
           variant.generator->until);
    for (const Segment& segment : program_segments(variant, i))
      dump_segment(text, segment, variant);
  }
  line(text, "  modules: {}", variant.modules.size());
  for (size_t i = 0; i < variant.modules.size(); ++i) {
    const Spirv& words = variant.modules[i];
    const auto* bytes = reinterpret_cast<const uint8_t*>(words.data());
    const std::optional<std::vector<uint8_t>> packed = pack_module(words);
    line(text, "    {:3} {} words in {} bytes, hash {:016x}", i, words.size(),
         packed ? packed->size() : words.size() * sizeof(uint32_t),
         stable_hash({bytes, words.size() * sizeof(uint32_t)}));
  }
  constexpr const char* kSources[kParamSourceCount] = {"", " (reset)", " (time)", " (frames)"};
  if (!variant.params.empty()) line(text, "  parameters: {}", variant.params.size());
  for (const Param& p : variant.params)
    line(text, "    {:3} {}{} \"{}\" = {}{}", p.offset_bytes, p.is_integer ? "i32" : "f32",
         p.components > 1 ? fmt::format("[{}]", p.components) : "", p.name,
         fmt::join(p.default_values, ","), kSources[static_cast<size_t>(p.source)]);
  if (!variant.views.empty()) line(text, "  views: {}", variant.views.size());
  for (const View& v : variant.views)
    line(text, "    \"{}\": channels {}..{} of \"{}\", {} to {}", v.title, v.first_channel,
         v.first_channel + v.channels - 1, variant.resources[v.resource].name, v.low, v.high);
  if (!variant.bounds.empty()) line(text, "  bounds, for every input: {}", variant.bounds.size());
  for (const ValueBounds& bounds : variant.bounds) {
    std::string ranges;
    for (size_t c = 0; c < bounds.low.size(); ++c)
      ranges += fmt::format(" {:g}..{:g}", bounds.low[c], bounds.high[c]);
    line(text, "    \"{}\":{}", variant.resources[bounds.resource].name, ranges);
  }
  line(text, "  proofs: {}", variant.proofs.size());
  for (const RangeProof& proof : variant.proofs) {
    line(text, "    \"{}\": {} channels", proof.name, proof.min.size());
    for (size_t c = 0; c < proof.min.size(); ++c)
      line(text, "      {:3} {}..{}, any partial sum within {}", c, proof.min[c], proof.max[c],
           proof.magnitude[c]);
  }
}

}  // namespace

std::string dump_package(const Package& package) {
  std::string text;
  line(text, "shale package {}.{}", kPackageMajor, kPackageMinor);
  line(text, "model \"{}\", hash {:016x}", package.provenance.model_name,
       package.provenance.model_hash);
  line(text, "made by {} with \"{}\"", package.provenance.compiler, package.provenance.options);
  line(text, "weights: {} bytes, hash {:016x}", package.weights.size(),
       stable_hash(package.weights));
  for (size_t i = 0; i < package.variants.size(); ++i) dump_variant(text, i, package.variants[i]);
  return text;
}

}  // namespace shale
