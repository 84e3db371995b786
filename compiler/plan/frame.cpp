#include "compiler/plan/frame.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

namespace shale {
namespace {

using Json = nlohmann::json;

constexpr uint32_t kMaxEntries = 64;
constexpr double kMaxRatio = 16;
constexpr uint32_t kMaxDivide = 64;
constexpr uint32_t kMaxMultiple = 256;
constexpr uint32_t kMaxHistory = 8;
constexpr uint32_t kMaxLocalSize = 32;
constexpr size_t kMaxBoundChannels = 1024;

/// A JSON object with the path that messages name it by.
class Fields {
 public:
  Fields(const Json& json, std::string where) : json_(json), where_(std::move(where)) {}

  const std::string& where() const { return where_; }
  bool has(const char* key) const { return json_.is_object() && json_.contains(key); }

  Result<std::string> text(const char* key) const {
    if (!has(key) || !json_[key].is_string() || json_[key].get_ref<const std::string&>().empty())
      return bad_input(where_, "\"{}\" must be a text", key);
    return json_[key].get<std::string>();
  }

  Result<double> number(const char* key, double low, double high,
                        std::optional<double> absent = {}) const {
    if (!has(key) && absent) return *absent;
    if (!has(key) || !json_[key].is_number())
      return bad_input(where_, "\"{}\" must be a number", key);
    const double value = json_[key].get<double>();
    if (!(value >= low && value <= high))
      return bad_input(where_, "\"{}\" is {}, expected {} to {}", key, value, low, high);
    return value;
  }

  Result<int64_t> integer(const char* key, int64_t low, int64_t high,
                          std::optional<int64_t> absent = {}) const {
    if (!has(key) && absent) return *absent;
    SHALE_TRY(const double value, number(key, static_cast<double>(low), static_cast<double>(high)));
    if (value != std::floor(value))
      return bad_input(where_, "\"{}\" is {}, expected an integer", key, value);
    return static_cast<int64_t>(value);
  }

  Result<std::vector<Fields>> list(const char* key) const {
    std::vector<Fields> items;
    if (!has(key)) return items;
    if (!json_[key].is_array() || json_[key].size() > kMaxEntries)
      return bad_input(where_, "\"{}\" must be a list of at most {} entries", key, kMaxEntries);
    for (size_t i = 0; i < json_[key].size(); ++i)
      items.emplace_back(json_[key][i], fmt::format("{}.{}[{}]", where_, key, i));
    return items;
  }

  const Json& json() const { return json_; }

 private:
  const Json& json_;
  std::string where_;
};

bool is_identifier(const std::string& name) {
  const auto fits = [](unsigned char c) { return std::isalnum(c) != 0 || c == '_'; };
  return !name.empty() && std::all_of(name.begin(), name.end(), fits) &&
         std::isdigit(static_cast<unsigned char>(name[0])) == 0;
}

/// Names become preprocessor definitions, so they are identifiers.
Result<std::string> identifier(const Fields& fields) {
  SHALE_TRY(const std::string name, fields.text("name"));
  if (!is_identifier(name))
    return bad_input(fields.where(), "the name \"{}\" is no identifier", name);
  return name;
}

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
Result<std::array<uint32_t, 2>> parse_divide(const Fields& fields) {
  if (!fields.has("divide") || !fields.json()["divide"].is_array()) {
    SHALE_TRY(const int64_t divide, fields.integer("divide", 1, kMaxDivide, 1));
    return std::array{static_cast<uint32_t>(divide), static_cast<uint32_t>(divide)};
  }
  const Json& list = fields.json()["divide"];
  std::array<uint32_t, 2> divide{};
  for (size_t i = 0; i < 2; ++i) {
    if (list.size() != 2 || !list[i].is_number_unsigned() || list[i].get<uint64_t>() < 1 ||
        list[i].get<uint64_t>() > kMaxDivide)
      return bad_input(fields.where(), "\"divide\" must be one or two whole numbers from 1 to {}",
                       kMaxDivide);
    divide[i] = list[i].get<uint32_t>();
  }
  return divide;
}

/// "render", "output", or {"of": one of them, "divide": N or [N, N], "multiple": N}.
Result<FrameSize> parse_size(const Fields& fields, const char* key = "size") {
  const Json& json = fields.has(key) ? fields.json()[key] : Json();
  FrameSize size;
  std::string of;
  if (json.is_string()) {
    of = json.get<std::string>();
  } else if (json.is_object()) {
    const Fields parts(json, fields.where() + "." + key);
    SHALE_TRY(of, parts.text("of"));
    SHALE_TRY(size.divide, parse_divide(parts));
    SHALE_TRY(const int64_t multiple, parts.integer("multiple", 1, kMaxMultiple, 1));
    size.multiple = static_cast<uint32_t>(multiple);
  }
  if (of != "render" && of != "output")
    return bad_input(fields.where(), "\"{}\" must be \"render\", \"output\" or {{\"of\": ...}}",
                     key);
  size.of_output = of == "output";
  return size;
}

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

/// What files of schema "shale-frame/1" had and nobody has to say any more.
Result<void> refuse_old_fields(const Fields& fields) {
  for (const char* old : {"bindings", "copy", "clear", "linear", "texels"})
    if (fields.has(old))
      return bad_input(fields.where(),
                       "\"{}\" is of schema shale-frame/1: see compiler/driver/README.md", old);
  return {};
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

/// A name, or for what is read {"of": name, "frames_back": N, "as": its name in the shader}.
Result<FrameBinding> parse_binding(const Fields& fields) {
  FrameBinding binding;
  const Json& json = fields.json();
  if (json.is_string()) {
    binding.name = binding.handle = json.get<std::string>();
  } else {
    SHALE_TRY(binding.name, fields.text("of"));
    SHALE_TRY(const int64_t back, fields.integer("frames_back", 0, kMaxHistory - 1, 0));
    binding.frames_back = static_cast<uint32_t>(back);
    binding.handle = binding.name;
    if (fields.has("as")) {
      SHALE_TRY(binding.handle, fields.text("as"));
    }
  }
  if (!is_identifier(binding.handle))
    return bad_input(fields.where(), "the name \"{}\" is no identifier", binding.handle);
  return binding;
}

/// The bindings of a pass; no two of one kind of access under one name.
Result<void> parse_bindings(const Fields& fields, FramePass& pass) {
  const auto add = [&](const char* key, bool reads, bool writes) -> Result<void> {
    SHALE_TRY(const std::vector<Fields> entries, fields.list(key));
    for (const Fields& entry : entries) {
      SHALE_TRY(FrameBinding binding, parse_binding(entry));
      binding.reads = reads;
      binding.writes = writes;
      if (writes && binding.frames_back != 0)
        return bad_input(entry.where(), "\"frames_back\" is {}: only this frame's can be written",
                         binding.frames_back);
      for (const FrameBinding& other : pass.bindings)
        if (other.handle == binding.handle && other.writes == writes)
          return bad_input(entry.where(), "the name \"{}\" is used twice", binding.handle);
      pass.bindings.push_back(std::move(binding));
    }
    return {};
  };
  SHALE_TRY_VOID(add("reads", true, false));
  SHALE_TRY_VOID(add("writes", false, true));
  return add("updates", true, true);
}

/// "defines": names with numbers.
Result<std::vector<std::pair<std::string, std::string>>> parse_defines(const Fields& fields) {
  std::vector<std::pair<std::string, std::string>> result;
  if (!fields.has("defines")) return result;
  const Json& defines = fields.json()["defines"];
  if (!defines.is_object() || defines.size() > kMaxEntries)
    return bad_input(fields.where(), "\"defines\" must be at most {} names with numbers",
                     kMaxEntries);
  for (const auto& [name, value] : defines.items()) {
    if (!is_identifier(name) || !value.is_number())
      return bad_input(fields.where(), "the definition \"{}\" is no name with a number", name);
    result.emplace_back(name, value.is_number_integer()
                                  ? std::to_string(value.get<int64_t>())
                                  : fmt::format("{:.9e}", value.get<double>()));
  }
  return result;
}

/// A range [low, high], or what is read: "name" or "name.channel".
Result<BoundPart> parse_bound_part(const Json& json, const std::string& where) {
  BoundPart part;
  if (json.is_array() && json.size() == 2 && json[0].is_number() && json[1].is_number()) {
    part.low = json[0].get<double>();
    part.high = json[1].get<double>();
    if (!(part.low <= part.high))
      return bad_input(where, "{} to {} is no range", part.low, part.high);
    return part;
  }
  if (!json.is_string()) return bad_input(where, "must hold ranges [low, high] and names");
  part.of = json.get<std::string>();
  const size_t dot = part.of.find('.');
  if (dot == std::string::npos) return part;
  const std::string channel = part.of.substr(dot + 1);
  if (channel.empty() || channel.size() > 3 ||
      !std::all_of(channel.begin(), channel.end(), [](char c) { return c >= '0' && c <= '9'; }))
    return bad_input(where, "\"{}\" has no channel behind its point", part.of);
  part.channel = static_cast<uint32_t>(std::stoul(channel));
  part.of.resize(dot);
  return part;
}

/// "bounds": of what is written, a range, a list of parts with a name among them, or a list of either by channel.
Result<void> parse_bounds(const Fields& fields, FramePass& pass) {
  if (!fields.has("bounds")) return {};
  const Json& all = fields.json()["bounds"];
  if (!all.is_object() || all.size() > kMaxEntries)
    return bad_input(fields.where(), "\"bounds\" must be at most {} names with ranges",
                     kMaxEntries);
  for (const auto& [key, json] : all.items()) {
    const std::string& name = key;  // clang 14 captures no structured bindings
    const std::string where = fmt::format("{}.bounds.{}", fields.where(), name);
    if (std::none_of(pass.bindings.begin(), pass.bindings.end(), [&](const FrameBinding& binding) {
          return binding.writes && binding.name == name;
        }))
      return bad_input(where, "the pass writes nothing of that name");
    BoundContract contract{name, {}};
    const auto add = [&](const Json& of) -> Result<void> {
      const bool is_list = of.is_array() && !of.empty() && !of[0].is_number();
      std::vector<BoundPart>& parts = contract.channels.emplace_back();
      for (const Json& part : is_list ? of : Json::array({of})) {
        SHALE_TRY(parts.emplace_back(), parse_bound_part(part, where));
      }
      return {};
    };
    const bool is_one =
        !json.is_array() || json.empty() || json[0].is_number() ||
        std::any_of(json.begin(), json.end(), [](const Json& part) { return part.is_string(); });
    if (is_one) {
      SHALE_TRY_VOID(add(json));
    } else {
      for (const Json& channel : json) SHALE_TRY_VOID(add(channel));
    }
    if (contract.channels.size() > kMaxBoundChannels)
      return bad_input(where, "has {} channels, expected at most {}", contract.channels.size(),
                       kMaxBoundChannels);
    pass.bounds.push_back(std::move(contract));
  }
  return {};
}

/// "when": of each promise, what is otherwise where it is kept; false leaves the pass out.
Result<void> parse_forms(const Fields& fields, FramePass& pass) {
  if (!fields.has("when")) return {};
  const Json& forms = fields.json()["when"];
  if (!forms.is_object() || forms.size() > kMaxEntries)
    return bad_input(fields.where(), "\"when\" must be at most {} forms by their promises",
                     kMaxEntries);
  for (const auto& [promise, json] : forms.items()) {
    const Fields form(json, fmt::format("{}.when.{}", fields.where(), promise));
    PassForm parsed{promise, json == Json(false), {}, pass.bindings};
    if (!parsed.is_left_out && !json.is_object())
      return bad_input(form.where(), "must be an object, or false");
    for (const auto& [key, value] : json.items())
      if (json.is_object() && key != "defines" && key != "reads" && key != "writes")
        return bad_input(form.where(), "\"{}\" is none of defines, reads, writes", key);
    SHALE_TRY(parsed.defines, parse_defines(form));
    FramePass own;
    SHALE_TRY_VOID(parse_bindings(form, own));
    std::erase_if(parsed.bindings, [&](const FrameBinding& binding) {
      return (form.has("reads") && !binding.writes) || (form.has("writes") && !binding.reads);
    });
    parsed.bindings.insert(parsed.bindings.begin(), own.bindings.begin(), own.bindings.end());
    pass.forms.push_back(std::move(parsed));
  }
  return {};
}

Result<std::vector<std::string>> parse_names(const Fields& fields, const char* key) {
  std::vector<std::string> names;
  SHALE_TRY(const std::vector<Fields> entries, fields.list(key));
  for (const Fields& entry : entries) {
    if (!entry.json().is_string()) return bad_input(entry.where(), "must be a name");
    names.push_back(entry.json().get<std::string>());
  }
  return names;
}

/// Which of the sets of weights is read, of how many; one is what frames without sets have.
struct SetIndex {
  size_t index = 0, count = 1;
};

Result<FramePass> parse_graph_pass(const Fields& fields, SetIndex set) {
  FramePass pass;
  pass.name = "graph";
  if (fields.has("name")) {
    SHALE_TRY(pass.name, identifier(fields));
  }
  if (fields.json()["graph"].is_array()) {
    const Json& files = fields.json()["graph"];
    if (files.size() != set.count || !files[set.index].is_string())
      return bad_input(fields.where(), "\"graph\" must be a file, or one for each of {} sets",
                       set.count);
    pass.graph = files[set.index].get<std::string>();
  } else {
    SHALE_TRY(pass.graph, fields.text("graph"));
  }
  if (!fields.has("tensors")) return pass;
  const Json& names = fields.json()["tensors"];
  if (!names.is_object() || names.size() > kMaxEntries)
    return bad_input(fields.where(), "\"tensors\" must be at most {} names by the graph's names",
                     kMaxEntries);
  for (const auto& [from, to] : names.items()) {
    if (!to.is_string() || !is_identifier(to.get<std::string>()))
      return bad_input(fields.where(), "the name of \"{}\" is no identifier", from);
    pass.tensors[from] = to.get<std::string>();
  }
  return pass;
}

Result<FramePass> parse_pass(const Fields& fields, SetIndex set) {
  if (fields.has("graph")) return parse_graph_pass(fields, set);
  FramePass pass;
  SHALE_TRY_VOID(refuse_old_fields(fields));
  SHALE_TRY(pass.name, identifier(fields));
  SHALE_TRY(pass.shader, fields.text("shader"));
  if (fields.has("over") && !fields.json()["over"].is_string()) {
    SHALE_TRY(pass.over_size, parse_size(fields, "over"));
  } else {
    SHALE_TRY(pass.over, fields.text("over"));
  }
  if (fields.has("workgroup")) {
    const Json& size = fields.json()["workgroup"];
    if (!size.is_array() || size.size() != 2 || !size[0].is_number_unsigned() ||
        !size[1].is_number_unsigned())
      return bad_input(fields.where(), "\"workgroup\" must be two whole numbers");
    for (size_t i = 0; i < 2; ++i) {
      const uint64_t value = size[i].get<uint64_t>();
      if (value < 1 || value > kMaxLocalSize)
        return bad_input(fields.where(), "workgroup size {} is outside 1..{}", value,
                         kMaxLocalSize);
      pass.workgroup[i] = static_cast<uint32_t>(value);
    }
  }
  SHALE_TRY(pass.defines, parse_defines(fields));
  SHALE_TRY(pass.clears, parse_names(fields, "clears"));
  SHALE_TRY_VOID(parse_bindings(fields, pass));
  SHALE_TRY_VOID(parse_forms(fields, pass));
  SHALE_TRY_VOID(parse_bounds(fields, pass));
  return pass;
}

/// The check is a pass that raises kBrokenImage, and knows the promise's conditions as definitions.
Result<FramePromise> parse_promise(const Fields& fields) {
  FramePromise promise;
  SHALE_TRY(promise.name, identifier(fields));
  if (!fields.has("needs") || !fields.json()["needs"].is_object())
    return bad_input(fields.where(), "\"needs\" must be an object");
  const Fields needs(fields.json()["needs"], fields.where() + ".needs");
  for (const auto& [key, value] : needs.json().items())
    if (key != "motion_pixels" && key != "finite")
      return bad_input(needs.where(), "\"{}\" is none of motion_pixels, finite", key);
  if (needs.has("motion_pixels")) {
    SHALE_TRY(promise.motion_pixels, needs.number("motion_pixels", 0, kMaxImageExtent));
  }
  if (needs.has("finite")) {
    if (needs.json()["finite"] != Json(true))
      return bad_input(needs.where(), "\"finite\" must be true");
    promise.finite = true;
  }
  if (!promise.motion_pixels && !promise.finite)
    return bad_input(needs.where(), "there is no condition");
  if (!fields.has("check") || !fields.json()["check"].is_object())
    return bad_input(fields.where(), "\"check\" must be a pass");
  SHALE_TRY(promise.check,
            parse_pass(Fields(fields.json()["check"], fields.where() + ".check"), {}));
  if (!promise.check.graph.empty() || !promise.check.forms.empty())
    return bad_input(fields.where() + ".check", "must be a pass of shaders without other forms");
  promise.check.bindings.push_back({kBrokenImage, kBrokenImage, true, true, 0});
  if (promise.motion_pixels)
    promise.check.defines.emplace_back("MOTION_PIXELS",
                                       fmt::format("{:.9e}", *promise.motion_pixels));
  return promise;
}

/// Forms are of promises that there are.
Result<void> check_forms(const Frame& frame) {
  for (const FrameProgram& program : frame.programs)
    for (const FramePass& pass : program.passes)
      for (const PassForm& form : pass.forms)
        if (std::none_of(frame.promises.begin(), frame.promises.end(),
                         [&](const FramePromise& each) { return each.name == form.promise; }))
          return bad_input("pass \"" + pass.name + "\"",
                           "\"when\" names \"{}\", which is no promise", form.promise);
  if (!frame.promises.empty())
    for (const FrameImage& image : frame.images)
      if (image.name == kBrokenImage || image.name == kGridsImage)
        return bad_input("frame.images", "the name \"{}\" is taken by what checks promises",
                         image.name);
  return {};
}

Result<FrameProgram> parse_program(const Fields& fields, std::string name, SetIndex set = {}) {
  FrameProgram program{std::move(name), {}, {}, {}};
  SHALE_TRY(const std::vector<Fields> passes, fields.list("passes"));
  for (const Fields& entry : passes) {
    SHALE_TRY(FramePass pass, parse_pass(entry, set));
    if (set.index > 0) pass.name += fmt::format("_{}", set.index);
    program.passes.push_back(std::move(pass));
  }
  if (program.passes.empty()) return bad_input(fields.where() + ".passes", "there is no pass");
  return program;
}

/// Times above the first, up to the second; check_package judges them.
Result<std::optional<std::array<float, 2>>> parse_generates(const Fields& fields) {
  if (!fields.has("generates")) return std::optional<std::array<float, 2>>();
  const Json& times = fields.json()["generates"];
  if (!times.is_array() || times.size() != 2 || !times[0].is_number() || !times[1].is_number())
    return bad_input(fields.where(), "\"generates\" must be two times, as [0, 1]");
  return std::optional(std::array{times[0].get<float>(), times[1].get<float>()});
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
  const Json json = Json::parse(text, nullptr, false, true);
  if (json.is_discarded() || !json.is_object()) return bad_input("", "is not valid JSON");
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

std::vector<const FramePass*> shader_passes(const Frame& frame) {
  std::vector<const FramePass*> passes;
  for (const FrameProgram& program : frame.programs)
    for (const FramePass& pass : program.passes)
      if (pass.graph.empty()) passes.push_back(&pass);
  return passes;
}

}  // namespace shale
