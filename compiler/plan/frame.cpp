#include "compiler/plan/frame.h"

#include <algorithm>
#include <cmath>

#include "compiler/plan/frame_json.h"

namespace shale {
namespace {

using namespace frame_json;

Result<FrameExtent> parse_extent(const Fields& fields, const char* key) {
  const Json& size = fields.has(key) ? fields.json()[key] : Json();
  if (!size.is_array() || size.size() != 2 || !size[0].is_number_unsigned() ||
      !size[1].is_number_unsigned())
    return bad_input(fields.where(), "\"{}\" must be a width and a height", key);
  for (size_t i = 0; i < 2; ++i)
    if (size[i].get<uint64_t>() < 1 || size[i].get<uint64_t>() > kMaxImageExtent)
      return bad_input(fields.where(), "\"{}\" has the side {}, expected 1 to {}", key,
                       size[i].get<uint64_t>(), kMaxImageExtent);
  return FrameExtent{size[0].get<uint32_t>(), size[1].get<uint32_t>()};
}

/// A name, or a list of [x, y].
Result<SamplingPattern> parse_frame_pattern(const Fields& root) {
  if (!root.has("pattern")) return SamplingPattern{};
  const Json& json = root.json()["pattern"];
  std::vector<std::array<float, 2>> offsets;
  for (const Json& pair : json.is_array() ? json : Json::array()) {
    if (!pair.is_array() || pair.size() != 2 || !pair[0].is_number() || !pair[1].is_number())
      return bad_input(root.where() + ".pattern", "entry {} must be [x, y]", offsets.size());
    offsets.push_back({pair[0].get<float>(), pair[1].get<float>()});
  }
  if (!json.is_string() && !json.is_array())
    return bad_input(root.where(), "\"pattern\" must be halton, mnss, or a list of [x, y]");
  Result<SamplingPattern> pattern =
      json.is_string() ? parse_pattern(json.get<std::string>()) : pattern_of(std::move(offsets));
  if (!pattern) return bad_input(root.where() + ".pattern", "{}", pattern.error().message);
  return pattern;
}

/// A number for both axes, or a list of two; 1 if absent.
/// Offsets are given later.
Result<Param> parse_param(const Fields& fields) {
  static const std::vector<std::pair<std::string, uint32_t>> kTypes{
      {"float", 1}, {"vec2", 2},  {"vec3", 3},  {"vec4", 4},
      {"int", 1},   {"ivec2", 2}, {"ivec3", 3}, {"ivec4", 4}};
  Param param;
  SHALE_TRY(param.name, identifier(fields));
  SHALE_TRY(const std::string type, fields.text("type"));
  const auto known = std::find_if(kTypes.begin(), kTypes.end(),
                                  [&](const auto& each) { return each.first == type; });
  if (known == kTypes.end())
    return bad_input(fields.where(), "type \"{}\" is none of float, vec2..4, int, ivec2..4", type);
  param.components = known->second;
  param.is_integer = type[0] == 'i';
  param.default_values.assign(param.components, 0.0f);
  constexpr std::pair<const char*, ParamSource> kSources[] = {{"reset", ParamSource::kReset},
                                                              {"time", ParamSource::kTime},
                                                              {"frames", ParamSource::kFrames}};
  for (const auto& [key, source] : kSources) {
    if (!fields.has(key)) continue;
    if (!fields.json()[key].is_boolean())
      return bad_input(fields.where(), "\"{}\" must be true or false", key);
    if (fields.json()[key].get<bool>()) param.source = source;
  }
  if (!fields.has("default")) return param;
  const Json& values = fields.json()["default"];
  if (!values.is_array() || values.size() != param.components)
    return bad_input(fields.where(), "\"default\" must be a list of {}", param.components);
  for (uint32_t i = 0; i < param.components; ++i) {
    if (!values[i].is_number())
      return bad_input(fields.where(), "\"default\" must be a list of numbers");
    param.default_values[i] = values[i].get<float>();
  }
  return param;
}

/// Places the parameters one behind the other, aligned as in std430. check_package judges the end.
void place_params(std::vector<Param>& params) {
  uint32_t offset = 0;
  for (Param& param : params) {
    const uint32_t alignment = param.components == 1 ? 4 : param.components == 2 ? 8 : 16;
    param.offset_bytes = (offset + alignment - 1) / alignment * alignment;
    offset = param.offset_bytes + 4 * param.components;
  }
}

Result<FrameView> parse_view(const Fields& fields) {
  FrameView view;
  SHALE_TRY(view.view.title, fields.text("title"));
  SHALE_TRY(view.name, fields.text("of"));
  SHALE_TRY(const int64_t first, fields.integer("first", 0, 1023, 0));
  SHALE_TRY(const int64_t channels, fields.integer("channels", 1, 3, 1));
  SHALE_TRY(const double low, fields.number("low", -1e6, 1e6, 0.0));
  SHALE_TRY(const double high, fields.number("high", -1e6, 1e6, 1.0));
  view.view.first_channel = static_cast<uint32_t>(first);
  view.view.channels = static_cast<uint32_t>(channels);
  view.view.low = static_cast<float>(low);
  view.view.high = static_cast<float>(high);
  return view;
}

Result<FrameImage> parse_image(const Fields& fields) {
  FrameImage image;
  SHALE_TRY_VOID(refuse_old_fields(fields));
  SHALE_TRY(image.name, identifier(fields));
  SHALE_TRY(const std::string role, fields.text("role"));
  if (role == "input")
    image.category = Category::kImageInput;
  else if (role == "output")
    image.category = Category::kImageOutput;
  else if (role == "internal")
    image.category = Category::kImageInternal;
  else if (role == "history")
    image.category = Category::kImageHistory;
  else
    return bad_input(fields.where(), "role \"{}\" is none of input, output, internal, history",
                     role);
  SHALE_TRY(const std::string format, fields.text("format"));
  const std::optional<ImageFormat> known = image_format_from_name(format);
  if (!known || *known == ImageFormat::kRgba8Sint || *known == ImageFormat::kR8Sint ||
      *known == ImageFormat::kR16Uint)
    return bad_input(fields.where(), "format \"{}\" is no image format", format);
  image.format = *known;
  SHALE_TRY(image.size, parse_size(fields));
  if (fields.has("shows")) {
    SHALE_TRY(image.shows, fields.text("shows"));
    if (image.category != Category::kImageOutput)
      return bad_input(fields.where(), "\"shows\" is for outputs");
  }
  if (image.category == Category::kImageHistory) {
    SHALE_TRY(const int64_t depth, fields.integer("depth", 2, kMaxHistory, 2));
    image.history_depth = static_cast<uint32_t>(depth);
  }
  return image;
}

Result<FrameTensor> parse_tensor(const Fields& fields) {
  FrameTensor tensor;
  SHALE_TRY(tensor.name, identifier(fields));
  SHALE_TRY(const double scale, fields.number("scale", 1e-12, 1e12));
  SHALE_TRY(const int64_t zero_point, fields.integer("zero_point", -32768, 65535, 0));
  tensor.quantization = {static_cast<float>(scale), static_cast<int32_t>(zero_point)};
  if (fields.has("size")) {
    SHALE_TRY(tensor.size, parse_size(fields));
  }
  if (fields.has("depth")) {
    SHALE_TRY(const int64_t depth, fields.integer("depth", 2, kMaxHistory));
    tensor.history_depth = static_cast<uint32_t>(depth);
  }
  return tensor;
}

/// Times above the first, up to the second; check_package judges them.
Result<std::optional<std::array<float, 2>>> parse_generates(const Fields& fields) {
  if (!fields.has("generates")) return std::optional<std::array<float, 2>>();
  const Json& times = fields.json()["generates"];
  if (!times.is_array() || times.size() != 2 || !times[0].is_number() || !times[1].is_number())
    return bad_input(fields.where(), "\"generates\" must be two times, as [0, 1]");
  return std::optional(std::array{times[0].get<float>(), times[1].get<float>()});
}

/// "settles": the history whose tiles come to rest, and what exposes it.
Result<FrameSettles> parse_settles(const Fields& fields, const Frame& frame) {
  FrameSettles settles;
  SHALE_TRY(settles.image, fields.text("image"));
  if (std::none_of(frame.images.begin(), frame.images.end(), [&](const FrameImage& image) {
        return image.name == settles.image && image.category == Category::kImageHistory &&
               image.format == ImageFormat::kRgba16Float;
      }))
    return bad_input(fields.where(), "\"image\" is \"{}\", which is no history of rgba16_float",
                     settles.image);
  if (!fields.has("exposure")) return settles;
  SHALE_TRY(settles.exposure, fields.text("exposure"));
  if (std::none_of(frame.params.begin(), frame.params.end(), [&](const Param& param) {
        return param.name == settles.exposure && param.source == ParamSource::kHost &&
               !param.is_integer && param.components == 1;
      }))
    return bad_input(fields.where(), "\"exposure\" is \"{}\", which is no float of the host",
                     settles.exposure);
  return settles;
}

/// "sets": the passes once for each set of weights, and the values of a parameter that choose it.
Result<void> parse_sets(const Fields& root, Frame& frame) {
  const Fields sets(root.json()["sets"], root.where() + ".sets");
  SHALE_TRY(frame.chosen_by, sets.text("chosen_by"));
  const auto param = std::find_if(frame.params.begin(), frame.params.end(), [&](const Param& each) {
    return each.name == frame.chosen_by && each.source == ParamSource::kHost;
  });
  if (param == frame.params.end())
    return bad_input(sets.where(), "\"chosen_by\" is \"{}\", which is no parameter of the host",
                     frame.chosen_by);
  SHALE_TRY(const std::vector<Fields> entries, sets.list("at"));
  if (entries.empty()) return bad_input(sets.where(), "\"at\" holds no set");
  for (size_t i = 0; i < entries.size(); ++i) {
    SHALE_TRY(FrameProgram program,
              parse_program(root, fmt::format("set_{}", i), {i, entries.size()}));
    const Json& values = entries[i].json();
    if (!values.is_array() || values.size() != param->components)
      return bad_input(entries[i].where(), "must be a list of {}, as \"{}\" has values",
                       param->components, param->name);
    for (const Json& value : values) {
      if (!value.is_number() || !std::isfinite(value.get<float>()))
        return bad_input(entries[i].where(), "must be a list of numbers");
      program.at.push_back(value.get<float>());
    }
    frame.programs.push_back(std::move(program));
  }
  return {};
}

}  // namespace

FrameExtent FrameSize::operator()(FrameExtent render, FrameExtent output) const {
  const auto side = [&](uint32_t of, uint32_t by) {
    return ((of + by - 1) / by + multiple - 1) / multiple * multiple;
  };
  const FrameExtent of = of_output ? output : render;
  return {side(of.width, divide[0]), side(of.height, divide[1])};
}

Result<std::pair<FrameExtent, FrameExtent>> frame_sizes(const Frame& frame,
                                                        const FrameSizes& wanted) {
  const FrameExtent render = wanted.render.value_or(frame.render);
  const auto scaled = [](uint32_t side, uint32_t to, uint32_t from) {
    return static_cast<uint32_t>((uint64_t{side} * to + from / 2) / from);
  };
  const FrameExtent output = wanted.output.value_or(
      FrameExtent{scaled(render.width, frame.output.width, frame.render.width),
                  scaled(render.height, frame.output.height, frame.render.height)});
  for (const uint32_t side : {render.width, render.height, output.width, output.height})
    if (side < 1 || side > kMaxImageExtent)
      return bad_input("frame", "{}x{} to {}x{}: a side is outside 1..{}", render.width,
                       render.height, output.width, output.height, kMaxImageExtent);
  // Sides are whole pixels, so a ratio is met within the rounding of one.
  const auto offered = [&](uint32_t to, uint32_t from) {
    return to + 0.5 >= frame.min_ratio * from && to - 0.5 <= frame.max_ratio * from && to >= from;
  };
  if (!offered(output.width, render.width) || !offered(output.height, render.height))
    return bad_input("frame", "{}x{} to {}x{} is a ratio outside {} to {}", render.width,
                     render.height, output.width, output.height, frame.min_ratio, frame.max_ratio);
  return std::pair{render, output};
}

Result<Frame> parse_frame(const std::string& text) {
  SHALE_TRY(const Json json, parse_json(text));
  if (!json.is_object()) return bad_input("", "is no JSON object");
  const Fields root(json, "frame");
  SHALE_TRY(const std::string schema, root.text("schema"));
  if (schema == "shale-frame/1")
    return bad_input(
        "frame",
        "schema \"shale-frame/1\" is no longer read: \"bindings\", copies and "
        "linear images became \"reads\" and \"writes\", see compiler/driver/README.md");
  if (schema != "shale-frame/2")
    return bad_input("frame", "schema \"{}\" is unknown, expected \"shale-frame/2\"", schema);
  Frame frame;
  SHALE_TRY(frame.render, parse_extent(root, "render"));
  SHALE_TRY(frame.output, parse_extent(root, "output"));
  if (root.has("ratio")) {
    const Json& ratio = json["ratio"];
    if (!ratio.is_array() || ratio.size() != 2 || !ratio[0].is_number() || !ratio[1].is_number())
      return bad_input("frame", "\"ratio\" must be the least and the largest ratio");
    frame.min_ratio = ratio[0].get<double>();
    frame.max_ratio = ratio[1].get<double>();
  }
  if (!(frame.min_ratio >= 1 && frame.min_ratio <= frame.max_ratio && frame.max_ratio <= kMaxRatio))
    return bad_input("frame", "\"ratio\" is {} to {}, expected a range within 1 to {}",
                     frame.min_ratio, frame.max_ratio, kMaxRatio);
  SHALE_TRY_VOID(frame_sizes(frame, {}));
  SHALE_TRY(frame.pattern, parse_frame_pattern(root));
  SHALE_TRY(const std::vector<Fields> params, root.list("params"));
  for (const Fields& fields : params) {
    SHALE_TRY(Param param, parse_param(fields));
    frame.params.push_back(std::move(param));
  }
  place_params(frame.params);
  SHALE_TRY(const std::vector<Fields> views, root.list("views"));
  for (const Fields& fields : views) {
    SHALE_TRY(FrameView view, parse_view(fields));
    frame.views.push_back(std::move(view));
  }
  SHALE_TRY(const std::vector<Fields> images, root.list("images"));
  for (const Fields& fields : images) {
    SHALE_TRY(FrameImage image, parse_image(fields));
    frame.images.push_back(std::move(image));
  }
  SHALE_TRY(const std::vector<Fields> tensors, root.list("tensors"));
  for (const Fields& fields : tensors) {
    SHALE_TRY(FrameTensor tensor, parse_tensor(fields));
    frame.tensors.push_back(std::move(tensor));
  }
  SHALE_TRY(const std::vector<Fields> promises, root.list("promises"));
  for (const Fields& fields : promises) {
    SHALE_TRY(FramePromise promise, parse_promise(fields));
    for (const FramePromise& other : frame.promises)
      if (other.name == promise.name)
        return bad_input(fields.where(), "the name \"{}\" is used twice", promise.name);
    frame.promises.push_back(std::move(promise));
  }
  if (root.has("settles")) {
    SHALE_TRY(frame.settles, parse_settles(Fields(json["settles"], "frame.settles"), frame));
  }
  if (root.has("passes") == root.has("programs"))
    return bad_input("frame", "either \"passes\" or \"programs\" must be there");
  if (root.has("sets")) {
    if (root.has("programs")) return bad_input("frame", "\"sets\" are of \"passes\"");
    SHALE_TRY_VOID(parse_sets(root, frame));
  } else if (root.has("passes")) {
    SHALE_TRY(FrameProgram program, parse_program(root, "frame"));
    frame.programs.push_back(std::move(program));
  }
  SHALE_TRY(const std::vector<Fields> programs, root.list("programs"));
  for (const Fields& fields : programs) {
    SHALE_TRY(std::string name, identifier(fields));
    for (const FrameProgram& other : frame.programs)
      if (other.name == name)
        return bad_input(fields.where(), "the name \"{}\" is used twice", name);
    SHALE_TRY(FrameProgram program, parse_program(fields, std::move(name)));
    SHALE_TRY(program.generates, parse_generates(fields));
    frame.programs.push_back(std::move(program));
  }
  if (frame.programs.empty()) return bad_input("frame.programs", "there is no program");
  SHALE_TRY_VOID(check_forms(frame));
  return frame;
}

std::vector<const FramePromise*> kept_promises(const Frame& frame, const SceneNeeds& needs,
                                               FrameExtent render) {
  // What moves so far in one size moves as many times as far in a larger one.
  std::optional<double> motion = needs.motion_pixels;
  if (motion && needs.render)
    *motion *= std::max(render.width / (*needs.render)[0], render.height / (*needs.render)[1]);
  std::vector<const FramePromise*> kept;
  for (const FramePromise& promise : frame.promises)
    if ((!promise.motion_pixels || (motion && *motion <= *promise.motion_pixels)) &&
        (!promise.finite || needs.finite == true))
      kept.push_back(&promise);
  return kept;
}

std::string promise_text(const FramePromise& promise) {
  std::string text;
  if (promise.motion_pixels) text = fmt::format("motion_pixels at most {}", *promise.motion_pixels);
  if (promise.finite) text += fmt::format("{}finite", text.empty() ? "" : ", ");
  return text;
}

std::vector<std::string> graph_files(const Frame& frame) {
  std::vector<std::string> files;
  for (const FrameProgram& program : frame.programs)
    for (const FramePass& pass : program.passes)
      if (!pass.graph.empty() && std::find(files.begin(), files.end(), pass.graph) == files.end())
        files.push_back(pass.graph);
  return files;
}

}  // namespace shale
