#include "compiler/plan/frame_lowering.h"

#include <algorithm>
#include <cctype>
#include <set>

#include "compiler/plan/accessors.h"
#include "compiler/plan/frame_bounds.h"
#include "compiler/plan/frame_segments.h"
#include "compiler/plan/run_pass.h"
#include "compiler/plan/settled.h"

namespace shale {
namespace {

constexpr const char* kAccessorFile = "generated_accessors.glsl";

// --- what there is

Result<void> add_images(Plan& plan, const LoweringOptions& options) {
  std::set<std::string> names;
  for (const Resource& resource : plan.variant.resources) names.insert(resource.name);
  for (const FrameImage& image : options.frame.images) {
    if (!names.insert(image.name).second)
      return bad_input("frame.images", "the name \"{}\" is used twice", image.name);
    Resource resource;
    resource.name = image.name;
    resource.category = image.category;
    resource.format = image.format;
    const FrameExtent extent = image.size(options.render, options.output);
    resource.height = extent.height;
    resource.width = extent.width;
    resource.history_depth = image.history_depth;
    if (resource.height > kMaxImageExtent || resource.width > kMaxImageExtent)
      return bad_input("frame.images",
                       "image \"{}\" would have {}x{} pixels, expected at most {} a side",
                       image.name, resource.width, resource.height, kMaxImageExtent);
    plan.variant.resources.push_back(std::move(resource));
  }
  return {};
}

void describe_tensors(Plan& plan, const Frame& frame) {
  for (Resource& resource : plan.variant.resources)
    for (const FrameTensor& tensor : frame.tensors)
      if (tensor.name == resource.name) {
        resource.quantization = tensor.quantization;
        resource.history_depth = tensor.history_depth;
      }
}

Result<void> add_views(Plan& plan, const Frame& frame) {
  for (const FrameView& from : frame.views) {
    View view = from.view;
    SHALE_TRY(view.resource,
              find_resource(plan.variant, from.name, "view \"" + from.view.title + "\""));
    plan.variant.views.push_back(std::move(view));
  }
  return {};
}

// --- what passes use

/// Sizes and quantization of every image, input and output, under their upper-case names; the declaration of the
/// parameters; the pass's own.
Defines pass_defines(const Variant& variant, const FramePass& pass) {
  Defines defines;
  std::string members;
  for (const Param& param : variant.params) {
    const std::string type =
        param.components == 1
            ? (param.is_integer ? "int" : "float")
            : fmt::format("{}vec{}", param.is_integer ? "i" : "", param.components);
    members += fmt::format(" layout(offset = {}) {} {};", param.offset_bytes, type, param.name);
  }
  if (!members.empty())
    defines.emplace_back(
        "SHALE_PARAMS",
        fmt::format("layout(push_constant, std430) uniform Params {{{} }} params", members));
  const auto upper_case = [](const std::string& from) {
    std::string name;
    for (const char c : from)
      name += std::isalnum(static_cast<unsigned char>(c)) != 0
                  ? static_cast<char>(std::toupper(static_cast<unsigned char>(c)))
                  : '_';
    return name;
  };
  for (const Resource& resource : variant.resources) {
    if (resource.category == Category::kWeights || resource.category == Category::kIntermediate)
      continue;
    const std::string name = upper_case(resource.name);
    for (const FrameBinding& binding : pass.bindings) {
      // Images that the shader knows by another name; one of a resource's own means that.
      if (binding.name != resource.name || !is_image(resource.category) ||
          std::any_of(variant.resources.begin(), variant.resources.end(),
                      [&](const Resource& other) { return other.name == binding.handle; }))
        continue;
      const std::string handle = upper_case(binding.handle);
      defines.emplace_back(handle + "_WIDTH", std::to_string(resource.width));
      defines.emplace_back(handle + "_HEIGHT", std::to_string(resource.height));
    }
    if (is_image(resource.category)) {
      defines.emplace_back(name + "_WIDTH", std::to_string(resource.width));
      defines.emplace_back(name + "_HEIGHT", std::to_string(resource.height));
      continue;
    }
    if (resource.shape.size() != 4) continue;
    defines.emplace_back(name + "_HEIGHT", std::to_string(resource.shape[1]));
    defines.emplace_back(name + "_WIDTH", std::to_string(resource.shape[2]));
    defines.emplace_back(name + "_CHANNELS", std::to_string(resource.shape[3]));
    if (!resource.quantization) continue;
    defines.emplace_back(name + "_SCALE", fmt::format("{:.9e}", resource.quantization->scale));
    defines.emplace_back(name + "_ZERO_POINT",
                         fmt::format("({})", resource.quantization->zero_point));
  }
  defines.emplace_back("LOCAL_X", std::to_string(pass.workgroup[0]));
  defines.emplace_back("LOCAL_Y", std::to_string(pass.workgroup[1]));
  defines.insert(defines.end(), pass.defines.begin(), pass.defines.end());
  return defines;
}

/// A pass as its shader uses what it binds.
struct UsedPass {
  const FramePass* pass = nullptr;
  std::vector<std::vector<Verb>> verbs;  ///< of each binding
  ModuleSource source;
};

/// Files beside the shader; the accessors where they are asked for.
IncludeLoader includes_of(const FramePass& pass, const ShaderLoader& load, std::string accessors) {
  return [load, accessors = std::move(accessors),
          folder = pass.shader.substr(0, pass.shader.rfind('/') + 1)](const std::string& name) {
    return name == kAccessorFile ? Result<std::string>(accessors) : load(folder + name);
  };
}

Result<UsedPass> used_pass(const Variant& variant, const RunPass& run,
                           const LoweringOptions& options, bool is_linear) {
  const FramePass& pass = run.pass;
  UsedPass used;
  used.pass = &pass;
  ModuleSource& source = used.source;
  source.glsl = run.glsl;
  source.where = pass.shader.empty() ? pass.name : pass.shader;
  source.defines = pass_defines(variant, pass);
  source.defines.emplace_back("SHALE_LINEAR", is_linear ? "1" : "0");
  source.load = includes_of(pass, options.load_shader, "");
  SHALE_TRY(const std::string text,
            preprocess_glsl(source.glsl, source.defines, source.where, source.load));
  // Names of everything in the frame: what a shader uses and the pass does not bind is found, too.
  std::vector<std::string> handles;
  for (const FrameBinding& binding : pass.bindings) handles.push_back(binding.handle);
  for (const Resource& resource : variant.resources)
    if (std::find(handles.begin(), handles.end(), resource.name) == handles.end())
      handles.push_back(resource.name);
  used.verbs.resize(pass.bindings.size());
  for (const Use& use : uses_in(text, handles)) {
    const bool updates = use.verb == Verb::kMax;
    const auto binding =
        std::find_if(pass.bindings.begin(), pass.bindings.end(), [&](const FrameBinding& each) {
          return each.handle == use.handle && each.writes == verb_info(use.verb).writes &&
                 (each.reads && each.writes) == updates;
        });
    if (binding == pass.bindings.end())
      return bad_input(pass_label(pass), "{} has {}_{}, but \"{}\" is not among what the pass {}",
                       pass.shader, verb_info(use.verb).name, use.handle, use.handle,
                       updates ? "updates" : (verb_info(use.verb).writes ? "writes" : "reads"));
    used.verbs[static_cast<size_t>(binding - pass.bindings.begin())].push_back(use.verb);
  }
  for (size_t i = 0; i < pass.bindings.size(); ++i)
    if (used.verbs[i].empty())
      return bad_input(pass_label(pass), "{} \"{}\", for which {} has no accessor",
                       pass.bindings[i].writes ? "writes" : "reads", pass.bindings[i].handle,
                       pass.shader);
  return used;
}

/// A binding against what it names.
Result<void> check_binding(const FramePass& pass, const FrameBinding& from,
                           const Resource& resource) {
  const std::string where = pass_label(pass);
  if (from.writes &&
      (resource.category == Category::kImageInput || resource.category == Category::kOutput))
    return bad_input(where, "writes \"{}\", which is an input of the pass", from.name);
  if (from.reads && resource.category == Category::kImageOutput)
    return bad_input(where, "reads \"{}\", which is an output of the frame", from.name);
  if (from.frames_back >= std::max(resource.history_depth, 1u))
    return bad_input(where, "reads \"{}\" {} frames back, its history is {} deep", from.name,
                     from.frames_back, resource.history_depth);
  return {};
}

// --- where texels lie

/// Of each image the places where passes reach it: its own resource, or a linear copy of a host's image.
struct Places {
  bool is_linear = false;                             ///< SHALE_LINEAR: buffers are preferred
  std::vector<uint32_t> accessed;                     ///< resource by resource
  std::vector<AccessForm> forms;                      ///< resource by resource
  std::vector<std::pair<uint32_t, uint32_t>> copies;  ///< from a host's image to its linear copy
};

bool fits_buffer(const Resource& image, const DeviceProfile& profile) {
  const uint64_t bytes = uint64_t{linear_pitch(image.format, image.width)} * image.height *
                         image_format_info(image.format).texel_bytes;
  return bytes <= profile.caps.max_storage_range_bytes &&
         bytes / 4 <= profile.caps.max_texel_elements;
}

/// Texels lie in buffers where kernels run on a CPU and the largest image fits one.
bool prefers_buffers(const Variant& variant, const DeviceProfile& profile) {
  return profile.literal_weights &&
         std::all_of(variant.resources.begin(), variant.resources.end(),
                     [&](const Resource& resource) {
                       // Colours of 32 bits have no form in buffers, and share a type with others.
                       return !is_image(resource.category) ||
                              (fits_buffer(resource, profile) &&
                               resource.format != ImageFormat::kRgba32Float);
                     });
}

Places choose_places(Plan& plan, const std::vector<UsedPass>& passes, bool is_linear) {
  Variant& variant = plan.variant;
  const size_t count = variant.resources.size();
  // A buffer serves an image if every use of it has a form for buffers, and some pass reads it.
  std::vector<bool> in_buffer(count, is_linear), is_read(count, false);
  for (const UsedPass& used : passes)
    for (size_t b = 0; b < used.pass->bindings.size(); ++b)
      for (size_t i = 0; i < count; ++i) {
        if (variant.resources[i].name != used.pass->bindings[b].name) continue;
        is_read[i] = is_read[i] || used.pass->bindings[b].reads;
        for (const Verb verb : used.verbs[b])
          if (is_image(variant.resources[i].category) &&
              !has_buffer_form(variant.resources[i].format, verb))
            in_buffer[i] = false;
      }
  Places places;
  places.is_linear = is_linear;
  for (uint32_t i = 0; i < count; ++i) {
    places.accessed.push_back(i);
    const Resource& image = variant.resources[i];
    const bool linear =
        shale::is_linear(image) ||  // that of grids, on every target
        (in_buffer[i] &&
         (!is_image(image.category) || (is_read[i] && image.category != Category::kImageOutput)));
    places.forms.push_back(linear ? AccessForm::kBuffer : AccessForm::kImage);
    if (!linear || !is_image(image.category)) continue;
    const uint64_t bytes = uint64_t{linear_pitch(image.format, image.width)} * image.height *
                           image_format_info(image.format).texel_bytes;
    if (image.category != Category::kImageInput) {
      variant.resources[i].size_bytes = bytes;
      continue;
    }
    Resource copy = image;
    copy.name += ".linear";
    copy.category = Category::kImageInternal;
    copy.size_bytes = bytes;
    places.accessed[i] = static_cast<uint32_t>(variant.resources.size());
    places.copies.emplace_back(i, places.accessed[i]);
    variant.resources.push_back(std::move(copy));
  }
  return places;
}

// --- dispatches

Result<void> add_clears(Plan& plan, uint32_t program, const FramePass& pass,
                        const DeviceProfile& profile) {
  for (const std::string& name : pass.clears) {
    SHALE_TRY(const uint32_t index, find_resource(plan.variant, name, pass_label(pass)));
    if (plan.variant.resources[index].category != Category::kImageInternal)
      return bad_input(pass_label(pass), "clears \"{}\", which is no internal image", name);
    Dispatch clear;
    clear.kernel = kClearKernel;
    clear.bindings = {transfer_end(0, index, true)};
    add_segment(plan, SegmentKind::kTransfer, program, "clear_" + name, std::move(clear), profile);
  }
  return {};
}

/// The output that shows an image, if one does.
std::optional<uint32_t> shown_as(const Variant& variant, const Frame& frame,
                                 const std::string& image) {
  for (const FrameImage& each : frame.images)
    if (each.shows == image)
      for (uint32_t i = 0; i < variant.resources.size(); ++i)
        if (variant.resources[i].name == each.name) return i;
  return std::nullopt;
}

/// The images of promises, where some pass of the programs has a form for one.
void add_promise(Plan& plan, std::span<const std::vector<RunPass>> programs,
                 const LoweringOptions& options) {
  std::ptrdiff_t most = 0;
  for (const std::vector<RunPass>& passes : programs)
    most = std::max(most, std::count_if(passes.begin(), passes.end(), [](const RunPass& each) {
                      return each.runs != Runs::kInAllFrames;
                    }));
  if (most == 0) return;
  Resource broken;
  broken.name = kBrokenImage;
  broken.category = Category::kImageInternal;
  broken.format = ImageFormat::kR32Uint;
  broken.width = broken.height = 1;
  Resource grids = broken;
  grids.name = kGridsImage;
  grids.width = 3 * static_cast<uint32_t>(most);
  grids.size_bytes = uint64_t{linear_pitch(grids.format, grids.width)} * 4;
  std::string text;
  for (const FramePromise* promise : options.kept)
    text +=
        fmt::format("{}{} ({})", text.empty() ? "" : ", ", promise->name, promise_text(*promise));
  plan.variant.promise = Promise{text, static_cast<uint32_t>(plan.variant.resources.size())};
  plan.variant.resources.push_back(std::move(broken));
  plan.variant.resources.push_back(std::move(grids));
}

/// What a pass has beside its accessors: buffers by their numbers alone, and which invocation it is.
std::string own_accessors(const RunPass& runs, std::vector<Binding>& bindings) {
  std::string text =
      fmt::format("#define FREE_BINDING {}\n", static_cast<uint32_t>(bindings.size()));
  const auto bind = [&](Binding binding) {
    binding.binding = static_cast<uint32_t>(bindings.size());
    bindings.push_back(binding);
    return binding.binding;
  };
  for (const Binding& each : runs.buffers) bind(each);
  if (!runs.list) return text + "uvec2 invocation() { return gl_GlobalInvocationID.xy; }\n";
  const uint32_t number = bind({.binding = 0,
                                .type = BindingType::kStorageBuffer,
                                .resource = runs.list->resource,
                                .view_format = ImageFormat::kNone,
                                .reads = true,
                                .writes = false,
                                .frames_back = 0});
  return text +
         fmt::format(
             "layout(set = 0, binding = {}, std430) readonly buffer Running {{ uint d[]; }} "
             "running;\nuvec2 invocation() {{ const uint own = running.d[{} + "
             "gl_WorkGroupID.x]; return uvec2(own % {}u, own / {}u) * uvec2(LOCAL_X, LOCAL_Y) + "
             "gl_LocalInvocationID.xy; }}\n",
             number, runs.list->first, runs.list->columns, runs.list->columns);
}

Result<void> add_pass(Plan& plan, uint32_t program, UsedPass used, const RunPass& runs,
                      uint32_t first_word, const Places& places, const LoweringOptions& options) {
  const FramePass& pass = *used.pass;
  Dispatch dispatch;
  dispatch.kernel = "pass";
  if (runs.runs != Runs::kInAllFrames) {
    SHALE_TRY(const uint32_t grids, find_resource(plan.variant, kGridsImage, pass_label(pass)));
    dispatch.indirect = IndirectGrid{grids, first_word};
  }
  if (runs.grid) dispatch.indirect = runs.grid;
  if (!pass.shader.empty()) {
    SHALE_TRY(dispatch.workgroups, workgroups_of(plan.variant, pass, options));
  } else if (runs.workgroups) {
    dispatch.workgroups = *runs.workgroups;
  }
  if (runs.list) dispatch.workgroups = {dispatch.workgroups[0] * dispatch.workgroups[1], 1, 1};
  std::string accessors;
  std::vector<std::pair<uint32_t, uint32_t>> shows;
  for (size_t b = 0; b < pass.bindings.size(); ++b) {
    const FrameBinding& from = pass.bindings[b];
    SHALE_TRY(const uint32_t index, find_resource(plan.variant, from.name, pass_label(pass)));
    SHALE_TRY_VOID(check_binding(pass, from, plan.variant.resources[index]));
    AccessedResource accessed;
    accessed.handle = from.handle;
    accessed.index = places.accessed[index];
    accessed.resource = &plan.variant.resources[accessed.index];
    accessed.verbs = used.verbs[b];
    accessed.frames_back = from.frames_back;
    accessed.form = places.forms[index];
    accessed.is_linear = places.is_linear;
    // On a CPU driver a storage image is read at half the cost; the host's come for sampling.
    accessed.loads =
        options.profile.literal_weights && accessed.resource->category != Category::kImageInput;
    const std::optional<uint32_t> shown = shown_as(plan.variant, options.frame, from.name);
    if (from.writes && shown) {
      if (accessed.form == AccessForm::kImage)
        accessed.mirror = shown;
      else
        shows.emplace_back(accessed.index, *shown);
    }
    SHALE_TRY(const std::string text, accessor_text(accessed, dispatch.bindings, pass_label(pass)));
    accessors += text;
  }
  accessors += own_accessors(runs, dispatch.bindings);
  if (std::any_of(dispatch.bindings.begin(), dispatch.bindings.end(),
                  [](const Binding& binding) { return binding.binding >= kMaxBindings; }))
    return bad_input(pass_label(pass), "needs {} bindings, expected at most {}",
                     dispatch.bindings.size(), kMaxBindings);
  if (std::any_of(used.verbs.begin(), used.verbs.end(), [](const std::vector<Verb>& verbs) {
        return std::find(verbs.begin(), verbs.end(), Verb::kStoreElement) != verbs.end();
      }))
    used.source.defines.emplace_back("SHALE_STORES_ELEMENTS", "1");
  used.source.load = includes_of(pass, options.load_shader, accessors);
  used.source.accessors = std::move(accessors);
  // A pass that several programs have is compiled once.
  const auto same =
      std::find_if(plan.sources.begin(), plan.sources.end(), [&](const ModuleSource& known) {
        return known.where == used.source.where && known.defines == used.source.defines &&
               known.accessors == used.source.accessors && known.glsl == used.source.glsl;
      });
  dispatch.module = static_cast<uint32_t>(same - plan.sources.begin());
  if (same == plan.sources.end()) plan.sources.push_back(std::move(used.source));
  add_segment(plan, SegmentKind::kCompute, program, pass.name, std::move(dispatch),
              options.profile);
  // What is expected to run is what is paid for.
  if (runs.runs == Runs::kBroken || runs.is_rare)
    plan.variant.segments.back().dispatches.back().cost = {};
  if (!runs.is_last_form) return {};
  for (const auto& [from, to] : shows) add_copy(plan, program, from, to, options.profile);
  return {};
}

/// Outputs that show an image have its format and size, and no pass writes them but those that generate.
Result<void> check_shown(const Variant& variant, const Frame& frame) {
  for (const FrameImage& image : frame.images) {
    if (image.shows.empty()) continue;
    const std::string where = "image \"" + image.name + "\"";
    SHALE_TRY(const uint32_t from, find_resource(variant, image.shows, where));
    SHALE_TRY(const uint32_t to, find_resource(variant, image.name, where));
    const Resource &source = variant.resources[from], &shown = variant.resources[to];
    if (!is_image(source.category) || source.category == Category::kImageInput ||
        source.category == Category::kImageOutput || source.format != shown.format ||
        source.width != shown.width || source.height != shown.height)
      return bad_input(where,
                       "shows \"{}\", which is no internal or history image of its format and size",
                       image.shows);
    for (const FrameImage& other : frame.images)
      if (&other != &image && other.shows == image.shows)
        return bad_input(where, "shows \"{}\", as \"{}\" does", image.shows, other.name);
    for (const FrameProgram& program : frame.programs)
      for (const FramePass& pass : program.passes)
        for (const FrameBinding& binding : pass.bindings)
          if (binding.name == image.name && !program.generates)
            return bad_input(pass_label(pass), "writes \"{}\", which shows \"{}\"", image.name,
                             image.shows);
  }
  return {};
}

}  // namespace

Result<void> lower_frame(Plan& plan, std::span<const PlannedGraph> graphs,
                         const LoweringOptions& options, WeightBlob& weights) {
  Variant& variant = plan.variant;
  const Frame& frame = options.frame;
  for (const PlannedGraph& graph : graphs) SHALE_TRY_VOID(plan_interface(plan, graph));
  describe_tensors(plan, frame);
  SHALE_TRY_VOID(add_images(plan, options));
  variant.params = frame.params;
  variant.programs.clear();
  variant.chosen_by = frame.chosen_by;
  SHALE_TRY_VOID(check_shown(variant, frame));

  std::vector<std::vector<RunPass>> runs;  // by program
  for (const FrameProgram& program : frame.programs)
    runs.push_back(run_passes(program, options.kept));
  add_promise(plan, runs, options);
  for (std::vector<RunPass>& program : runs)
    for (RunPass& each : program) {
      if (!each.pass.graph.empty()) continue;
      SHALE_TRY(each.glsl, each.pass.shader.empty() ? choice_shader(variant, program, options)
                                                    : options.load_shader(each.pass.shader));
    }
  const bool is_linear = prefers_buffers(variant, options.profile);
  if (frame.settles && options.tiles.value_or(0) > 0)
    SHALE_TRY_VOID(settle(plan, runs, options, is_linear, weights));
  std::vector<UsedPass> passes;
  for (const std::vector<RunPass>& program : runs)
    for (const RunPass& each : program) {
      if (!each.pass.graph.empty()) continue;
      SHALE_TRY(passes.emplace_back(), used_pass(variant, each, options, is_linear));
    }
  const Places places = choose_places(plan, passes, is_linear);

  const std::vector<std::string> files = graph_files(frame);
  auto used = passes.begin();
  for (const FrameProgram& program : frame.programs) {
    const uint32_t index = static_cast<uint32_t>(variant.programs.size());
    variant.programs.push_back(program.name);
    if (program.generates) {
      if (variant.generator)
        return bad_input("frame.programs", "\"{}\" and \"{}\" generate, one can",
                         variant.programs[variant.generator->program], program.name);
      variant.generator = {index, (*program.generates)[0], (*program.generates)[1]};
    }
    variant.choices.insert(variant.choices.end(), program.at.begin(), program.at.end());
    for (const auto& [from, to] : places.copies) {
      const std::string& name = variant.resources[from].name;
      if (std::any_of(runs[index].begin(), runs[index].end(), [&](const RunPass& each) {
            return std::any_of(each.pass.bindings.begin(), each.pass.bindings.end(),
                               [&](const FrameBinding& binding) { return binding.name == name; });
          }))
        add_copy(plan, index, from, to, options.profile);
    }
    uint32_t first_word = 0;
    for (const RunPass& each : runs[index]) {
      const FramePass& pass = each.pass;
      if (!pass.graph.empty()) {
        const size_t which =
            static_cast<size_t>(std::find(files.begin(), files.end(), pass.graph) - files.begin());
        SHALE_TRY_VOID(plan_graph(plan, graphs[which], index, options.profile, weights));
        continue;
      }
      SHALE_TRY_VOID(add_clears(plan, index, pass, options.profile));
      SHALE_TRY_VOID(add_pass(plan, index, std::move(*used++), each, first_word, places, options));
      if (each.runs != Runs::kInAllFrames) first_word += 3;
    }
  }
  SHALE_TRY(variant.bounds, frame_bounds(variant, frame, graphs));
  return add_views(plan, frame);
}

}  // namespace shale
