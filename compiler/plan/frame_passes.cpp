// The passes, promises and bounds of frame.json.
#include <algorithm>

#include "compiler/plan/frame_json.h"

namespace shale::frame_json {

bool is_identifier(const std::string& name) {
  const auto fits = [](unsigned char c) { return std::isalnum(c) != 0 || c == '_'; };
  return !name.empty() && std::all_of(name.begin(), name.end(), fits) &&
         std::isdigit(static_cast<unsigned char>(name[0])) == 0;
}

Result<std::string> identifier(const Fields& fields) {
  SHALE_TRY(const std::string name, fields.text("name"));
  if (!is_identifier(name))
    return bad_input(fields.where(), "the name \"{}\" is no identifier", name);
  return name;
}

static Result<std::array<uint32_t, 2>> parse_divide(const Fields& fields) {
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

Result<FrameSize> parse_size(const Fields& fields, const char* key) {
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

Result<void> refuse_old_fields(const Fields& fields) {
  for (const char* old : {"bindings", "copy", "clear", "linear", "texels"})
    if (fields.has(old))
      return bad_input(fields.where(),
                       "\"{}\" is of schema shale-frame/1: see compiler/driver/README.md", old);
  return {};
}

namespace {

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

}  // namespace

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

Result<FrameProgram> parse_program(const Fields& fields, std::string name, SetIndex set) {
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

}  // namespace shale::frame_json
