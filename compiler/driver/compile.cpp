#include "compiler/driver/compile.h"

#include <algorithm>
#include <cctype>
#include <chrono>
#include <map>
#include <numeric>
#include <set>

#include "compiler/cost/cost.h"
#include "compiler/frontend/frontend.h"
#include "compiler/memory/planner.h"
#include "compiler/spirv/check.h"
#include "compiler/spirv/forward.h"
#include "compiler/spirv/glsl.h"
#include "ir/base/hash.h"
#include "ir/base/parallel.h"
#include "ir/verify/verify.h"

namespace shale {
namespace {

constexpr const char* kCompilerVersion = "shale 0.1.0";

/// A graph output must be the result of a node of its own: constants, inputs and repeated outputs
/// are copied.
void give_outputs_nodes(Graph& graph) {
  std::set<ValueId> seen(graph.inputs.begin(), graph.inputs.end());
  for (ValueId& output : graph.outputs) {
    if (!seen.contains(output) && !graph.value(output).is_constant()) {
      seen.insert(output);
      continue;
    }
    const Value value = graph.value(output);
    output = graph.add_node(Op::kIdentity, {}, {output}, value.name, value.type);
    seen.insert(output);
  }
}

/// Weight blob under construction; equal tensors lie there once.
class WeightBlob {
 public:
  uint64_t add(const std::vector<uint8_t>& bytes) {
    const uint64_t hash = stable_hash(bytes);
    const auto [first, last] = offsets_.equal_range(hash);
    for (auto entry = first; entry != last; ++entry) {
      const auto [offset, size] = entry->second;
      if (size == bytes.size() && std::equal(bytes.begin(), bytes.end(),
                                             blob.begin() + static_cast<std::ptrdiff_t>(offset)))
        return offset;
    }
    blob.resize((blob.size() + kBufferAlignment - 1) / kBufferAlignment * kBufferAlignment);
    const uint64_t offset = blob.size();
    blob.insert(blob.end(), bytes.begin(), bytes.end());
    offsets_.emplace(hash, std::pair{offset, bytes.size()});
    return offset;
  }

  std::vector<uint8_t> blob;

 private:
  std::multimap<uint64_t, std::pair<uint64_t, size_t>> offsets_;
};

/// Builds one variant of the package for one device profile.
class VariantBuilder {
 public:
  VariantBuilder(const Graph& graph, const std::vector<GroupProblem>& problems,
                 const DeviceProfile& profile, const CompileOptions& options, WeightBlob& blob,
                 std::vector<std::string>& warnings)
      : graph_(graph),
        problems_(problems),
        profile_(profile),
        options_(options),
        blob_(blob),
        warnings_(warnings) {
    variant_.target = profile.name;
    variant_.device_class = profile.device_class;
  }

  Result<Variant> build() {
    for (const ValueId id : graph_.inputs) add_tensor(id, Category::kInput);
    for (const ValueId id : graph_.outputs) add_tensor(id, Category::kOutput);
    if (options_.frame) {
      SHALE_TRY_VOID(add_frame_images());
      variant_.params = options_.frame->params;
    }
    if (options_.frame) {
      for (const FramePass& pass : options_.frame->passes) {
        if (pass.is_graph)
          SHALE_TRY_VOID(add_graph());
        else
          SHALE_TRY_VOID(add_pass(pass));
      }
    } else {
      SHALE_TRY_VOID(add_graph());
    }
    SHALE_TRY_VOID(build_modules());
    place_intermediates();
    add_requirements();
    if (options_.frame) SHALE_TRY_VOID(add_views());
    return std::move(variant_);
  }

  uint64_t arena_lower_bound_bytes() const { return lower_bound_; }
  std::vector<WorkTable> take_work() { return std::move(work_); }

 private:
  uint32_t add_tensor(ValueId id, Category category) {
    const auto found = resource_of_.find(id);
    if (found != resource_of_.end()) return found->second;
    const Value& value = graph_.value(id);
    Resource resource;
    resource.name = value.name;
    resource.category = category;
    resource.dtype = value.type.dtype;
    resource.shape = value.type.shape;
    resource.size_bytes = static_cast<uint64_t>(element_count(value.type.shape).value_or(0)) *
                          dtype_info(value.type.dtype).host_bytes;
    if (category == Category::kWeights) resource.offset_bytes = blob_.add(value.constant->bytes);
    if (options_.frame)
      for (const FrameTensor& tensor : options_.frame->tensors)
        if (tensor.name == value.name) resource.quantization = tensor.quantization;
    variant_.resources.push_back(std::move(resource));
    const uint32_t index = static_cast<uint32_t>(variant_.resources.size() - 1);
    resource_of_.emplace(id, index);
    return index;
  }

  uint32_t tensor_of(ValueId id) {
    return add_tensor(
        id, graph_.value(id).is_constant() ? Category::kWeights : Category::kIntermediate);
  }

  /// Constants as one kernel wants them: a tensor of bytes of its own, in the weight blob.
  uint32_t add_packed(const std::vector<uint8_t>& bytes, const std::string& dispatch) {
    Resource resource;
    resource.name = dispatch + "#packed";
    const auto taken = [&] {
      return graph_.find_value(resource.name) ||
             std::any_of(variant_.resources.begin(), variant_.resources.end(),
                         [&](const Resource& other) { return other.name == resource.name; });
    };
    while (taken()) resource.name += '#';
    resource.category = Category::kWeights;
    resource.dtype = DType::kInt8;
    resource.shape = {static_cast<int64_t>(bytes.size())};
    resource.size_bytes = bytes.size();
    resource.offset_bytes = blob_.add(bytes);
    variant_.resources.push_back(std::move(resource));
    return static_cast<uint32_t>(variant_.resources.size() - 1);
  }

  /// A shader to be compiled.
  struct Source {
    std::string glsl;
    OptimizeBy optimize = OptimizeBy::kSpirvOpt;
    Defines defines;
    std::string where;
    IncludeLoader load;
  };
  /// Its place among the sources, which stands for the module until build_modules.
  uint32_t add_source(Source source) {
    sources_.push_back(std::move(source));
    return static_cast<uint32_t>(sources_.size() - 1);
  }

  /// A source as SPIR-V, and what it asks of the device. May run on any thread.
  struct Module {
    Spirv words;
    SpirvNeeds needs;
  };
  Result<Module> build_module(const Source& source) const {
    Module module;
    SHALE_TRY(module.words, compile_glsl(source.glsl, source.defines, source.where, source.load));
    if (source.optimize == OptimizeBy::kForwarding) {
      module.words = forward_locals(module.words);
    } else if (source.optimize == OptimizeBy::kSpirvOpt && options_.optimize_spirv) {
      SHALE_TRY(module.words, optimize_spirv(module.words, source.where));
    }
    // A third of the time where thousands of products stand in the code.
    if (source.optimize != OptimizeBy::kForwarding || options_.pass_options.verify_each)
      SHALE_TRY_VOID(validate_spirv(module.words, source.where));
    SHALE_TRY(module.needs, spirv_needs(module.words, source.where));
    return module;
  }

  /// Compiles all sources on all cores, the long ones first. Modules lie in the order of the sources, so
  /// that the same model gives the same bytes.
  Result<void> build_modules() {
    std::vector<size_t> order(sources_.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
      return sources_[a].glsl.size() > sources_[b].glsl.size();
    });
    std::vector<Result<Module>> modules(sources_.size(), Module{});
    const auto proceed = [&](size_t done) {
      return !options_.progress || options_.progress(done, sources_.size());
    };
    if (!parallel_for(
            order.size(), [&](size_t i) { modules[order[i]] = build_module(sources_[order[i]]); },
            proceed))
      return bad_input("", "interrupted");
    std::vector<uint32_t> indices;
    for (Result<Module>& module : modules) {
      if (!module) return module.error();
      indices.push_back(add_module(*std::move(module)));
    }
    for (Segment& segment : variant_.segments)
      for (Dispatch& dispatch : segment.dispatches) dispatch.module = indices[dispatch.module];
    return {};
  }

  /// Equal modules lie in the package once.
  uint32_t add_module(Module module) {
    Requirements& all = variant_.requirements;
    all.features.bits |= module.needs.features.bits;
    all.workgroup_invocations =
        std::max(all.workgroup_invocations, module.needs.workgroup_invocations);
    all.shared_bytes = std::max(all.shared_bytes, module.needs.shared_bytes);
    all.matrix_products.insert(all.matrix_products.end(), module.needs.matrix_products.begin(),
                               module.needs.matrix_products.end());
    const auto same = std::find(variant_.modules.begin(), variant_.modules.end(), module.words);
    const uint32_t index = static_cast<uint32_t>(same - variant_.modules.begin());
    if (same == variant_.modules.end()) variant_.modules.push_back(std::move(module.words));
    return index;
  }

  /// A group's dispatches before they are put into the package.
  struct Emitted {
    const KernelFamily* family = nullptr;
    WorkTable work{};
    std::vector<KernelSource> sources;
    std::vector<std::string> names;
  };

  Result<Emitted> emit_group(const GroupProblem& problem) const {
    Emitted emitted;
    const std::string& name = graph_.value(problem.group.result).name;
    if (const auto choice = options_.choices.find(name); choice != options_.choices.end()) {
      emitted.family = find_kernel(choice->second);
      if (!emitted.family || !emitted.family->supports(problem, profile_))
        return bad_input("--choices", "\"{}\" cannot make \"{}\" for {}", choice->second, name,
                         profile_.name);
    } else {
      emitted.family = options_.prefer.empty() ? nullptr : find_kernel(options_.prefer);
      if (!emitted.family || !emitted.family->supports(problem, profile_))
        emitted.family = &select_kernel(problem, profile_, options_.kernels);
    }
    SHALE_TRY(emitted.sources, emitted.family->emit(problem, profile_));
    emitted.work = emitted.family->work(problem, profile_);
    for (size_t part = 0; part < emitted.sources.size(); ++part) {
      std::string& own =
          emitted.names.emplace_back(part == 0 ? name : fmt::format("{}#{}", name, part));
      while (part > 0 && graph_.find_value(own)) own += '#';  // a value may be called so
    }
    return emitted;
  }

  Result<void> add_graph() {
    Segment segment;
    segment.name = "graph";
    segment.kind = SegmentKind::kGraph;
    std::vector<Result<Emitted>> groups(problems_.size(), Emitted{});
    parallel_for(groups.size(), [&](size_t i) { groups[i] = emit_group(problems_[i]); });
    std::map<std::string, uint32_t> compiled;  // equal sources are compiled once
    for (size_t i = 0; i < groups.size(); ++i) {
      if (!groups[i]) return groups[i].error();
      const GroupProblem& problem = problems_[i];
      Emitted& group = *groups[i];
      for (size_t part = 0; part < group.sources.size(); ++part) {
        KernelSource& source = group.sources[part];
        Dispatch dispatch;
        dispatch.name = group.names[part];
        dispatch.kernel = group.family->name;
        dispatch.workgroups = source.workgroups;
        WorkTable& work = work_.emplace_back(group.work);
        for (double& amount : work) amount /= static_cast<double>(group.sources.size());
        dispatch.cost = share(problem.cost, work_time_us(work, profile_.ns), group.sources.size());
        const auto [known, is_new] = compiled.try_emplace(source.glsl, 0);
        if (is_new)
          known->second = add_source({.glsl = std::move(source.glsl),
                                      .optimize = source.optimize,
                                      .defines = {},
                                      .where = dispatch.name,
                                      .load = {}});
        dispatch.module = known->second;
        for (uint32_t binding = 0; binding < source.bindings.size(); ++binding) {
          const KernelBinding& from = source.bindings[binding];
          const bool is_texels = from.type == BindingType::kUniformTexelBuffer;
          dispatch.bindings.push_back(
              {.binding = binding,
               .type = from.type,
               .resource = from.constant.empty() ? tensor_of(from.value)
                                                 : add_packed(from.constant, dispatch.name),
               .view_format = is_texels ? from.view_format : ImageFormat::kNone,
               .reads = !from.writes,
               .writes = from.writes,
               .frames_back = 0});
          if (from.constant.empty()) touch(from.value, static_cast<uint32_t>(dispatch_count_));
        }
        ++dispatch_count_;
        segment.dispatches.push_back(std::move(dispatch));
      }
      if (problem.proof) variant_.proofs.push_back(*problem.proof);
    }
    variant_.segments.push_back(std::move(segment));
    return {};
  }

  static Cost share(Cost cost, double time_us, size_t parts) {
    cost.macs /= parts;
    cost.ops /= parts;
    cost.bytes_written /= parts;
    cost.time_us = time_us;
    return cost;
  }

  void touch(ValueId id, uint32_t dispatch) {
    const auto [entry, is_new] = live_.try_emplace(id, LiveInterval{dispatch, dispatch, 0});
    entry->second.last = dispatch;
  }

  void place_intermediates() {
    std::vector<LiveInterval> intervals;
    std::vector<uint32_t> resources;
    for (const auto& [id, interval] : live_) {
      const uint32_t resource = resource_of_.at(id);
      if (variant_.resources[resource].category != Category::kIntermediate) continue;
      intervals.push_back({interval.first, interval.last, variant_.resources[resource].size_bytes});
      resources.push_back(resource);
    }
    const MemoryPlan plan = plan_memory(intervals, kBufferAlignment);
    for (size_t i = 0; i < resources.size(); ++i)
      variant_.resources[resources[i]].offset_bytes = plan.offsets[i];
    variant_.arena_bytes = plan.arena_bytes;
    lower_bound_ = plan.lower_bound_bytes;
  }

  Result<void> add_frame_images() {
    SHALE_TRY(const auto sizes, frame_sizes(*options_.frame, options_.sizes));
    std::set<std::string> names;
    for (const Resource& resource : variant_.resources) names.insert(resource.name);
    for (const FrameImage& image : options_.frame->images) {
      if (!names.insert(image.name).second)
        return bad_input("frame.images", "the name \"{}\" is used twice", image.name);
      Resource resource;
      resource.name = image.name;
      resource.category = image.category;
      resource.format = image.format;
      const FrameExtent extent = image.size(sizes.first, sizes.second);
      resource.height = extent.height;
      resource.width = extent.width;
      resource.history_depth = image.history_depth;
      if (image.is_linear)
        resource.size_bytes = uint64_t{linear_pitch(image.format, extent.width)} *
                              image_format_info(image.format).texel_bytes * extent.height;
      if (resource.height > kMaxImageExtent || resource.width > kMaxImageExtent)
        return bad_input("frame.images",
                         "image \"{}\" would have {}x{} pixels, expected at most {} a side",
                         image.name, resource.width, resource.height, kMaxImageExtent);
      variant_.resources.push_back(std::move(resource));
    }
    return {};
  }

  Result<void> add_views() {
    for (const FrameView& from : options_.frame->views) {
      const std::string where = "view \"" + from.view.title + "\"";
      const auto named = std::find_if(variant_.resources.begin(), variant_.resources.end(),
                                      [&](const Resource& r) { return r.name == from.name; });
      if (named == variant_.resources.end())
        return bad_input(where, "there is no image, graph input or output \"{}\"", from.name);
      View view = from.view;
      view.resource = static_cast<uint32_t>(named - variant_.resources.begin());
      variant_.views.push_back(std::move(view));
    }
    return {};
  }

  /// Sizes and quantization of every image, input and output, under their upper-case names; the
  /// declaration of the parameters.
  Defines frame_defines() const {
    Defines defines;
    std::string members;
    for (const Param& param : variant_.params) {
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
    for (const Resource& resource : variant_.resources) {
      if (resource.category == Category::kWeights || resource.category == Category::kIntermediate)
        continue;
      std::string name;
      for (const char c : resource.name)
        name += std::isalnum(static_cast<unsigned char>(c)) != 0
                    ? static_cast<char>(std::toupper(static_cast<unsigned char>(c)))
                    : '_';
      if (is_image(resource.category)) {
        defines.emplace_back(name + "_WIDTH", std::to_string(resource.width));
        defines.emplace_back(name + "_HEIGHT", std::to_string(resource.height));
        if (is_linear(resource))
          defines.emplace_back(name + "_PITCH",
                               std::to_string(linear_pitch(resource.format, resource.width)));
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
    return defines;
  }

  Result<uint32_t> find_resource(const std::string& name, bool wants_image,
                                 const std::string& where) const {
    for (uint32_t i = 0; i < variant_.resources.size(); ++i) {
      const Resource& resource = variant_.resources[i];
      if (resource.name == name && is_image(resource.category) == wants_image) return i;
    }
    return bad_input(where, "there is no {} \"{}\"",
                     wants_image ? "image" : "graph input or output", name);
  }

  /// Pixels of what the pass goes over.
  Result<FrameExtent> grid_of(const FramePass& pass, const std::string& where) const {
    if (pass.over_size) {
      SHALE_TRY(const auto sizes, frame_sizes(*options_.frame, options_.sizes));
      return (*pass.over_size)(sizes.first, sizes.second);
    }
    for (const Resource& resource : variant_.resources) {
      if (resource.name != pass.over) continue;
      if (is_image(resource.category)) return FrameExtent{resource.width, resource.height};
      if (resource.shape.size() == 4 && resource.shape[1] <= kMaxImageExtent &&
          resource.shape[2] <= kMaxImageExtent)
        return FrameExtent{static_cast<uint32_t>(resource.shape[2]),
                           static_cast<uint32_t>(resource.shape[1])};
    }
    return bad_input(where, "there is no image, graph input or output \"{}\" to go over",
                     pass.over);
  }

  /// check_package has the rules of transfers; the bindings of shaders are judged here.
  Result<BindingType> binding_type(const FrameBinding& from, const Resource& resource,
                                   bool is_transfer, const std::string& where) const {
    if (is_transfer) return BindingType::kTransfer;
    if (from.texels != ImageFormat::kNone) {
      if (from.is_image && !is_linear(resource))
        return bad_input(where, "reads texels of \"{}\", which is not linear", from.name);
      return BindingType::kUniformTexelBuffer;
    }
    if (from.loads && is_linear(resource))
      return bad_input(where, "loads \"{}\", which is linear: read its texels", from.name);
    if (!from.is_image || is_linear(resource)) return BindingType::kStorageBuffer;
    return from.writes || from.loads ? BindingType::kStorageImage : BindingType::kSampledImage;
  }

  Result<void> add_pass(const FramePass& pass) {
    const std::string where = "pass \"" + pass.name + "\"";
    const bool is_transfer = !pass.transfer.empty();
    Dispatch dispatch;
    dispatch.name = pass.name;
    dispatch.kernel = is_transfer ? pass.transfer : "pass";
    if (!is_transfer) {
      SHALE_TRY(const FrameExtent grid, grid_of(pass, where));
      dispatch.workgroups = {(grid.width + pass.workgroup[0] - 1) / pass.workgroup[0],
                             (grid.height + pass.workgroup[1] - 1) / pass.workgroup[1], 1};
    }
    for (const FrameBinding& from : pass.bindings) {
      SHALE_TRY(const uint32_t index, find_resource(from.name, from.is_image, where));
      const Resource& resource = variant_.resources[index];
      if (from.writes &&
          (resource.category == Category::kImageInput || resource.category == Category::kOutput))
        return bad_input(where, "writes \"{}\", which is an input of the pass", from.name);
      // The host's images come with the usage of sampled images.
      if (from.loads && resource.category == Category::kImageInput)
        return bad_input(where, "loads \"{}\", which is an input: it can only be read", from.name);
      if (from.frames_back >= std::max(resource.history_depth, 1u))
        return bad_input(where, "reads \"{}\" {} frames back, its history is {} deep", from.name,
                         from.frames_back, resource.history_depth);
      SHALE_TRY(const BindingType type, binding_type(from, resource, is_transfer, where));
      dispatch.bindings.push_back(
          {from.binding, type, index, from.texels, from.reads, from.writes, from.frames_back});
      const uint64_t bytes = is_image(resource.category)
                                 ? uint64_t{resource.width} * resource.height *
                                       image_format_info(resource.format).texel_bytes
                                 : resource.size_bytes;
      if (from.reads) dispatch.cost.bytes_read += bytes;
      if (from.writes) dispatch.cost.bytes_written += bytes;
    }
    dispatch.cost.time_us =
        1e-3 * (static_cast<double>(dispatch.cost.bytes_read + dispatch.cost.bytes_written) *
                    profile_.ns[Work::kByte] +
                profile_.ns[Work::kDispatch]);
    if (!is_transfer) {
      SHALE_TRY(dispatch.module, add_pass_source(pass));
    }
    Segment segment;
    segment.name = pass.name;
    segment.kind = is_transfer ? SegmentKind::kTransfer : SegmentKind::kCompute;
    segment.dispatches.push_back(std::move(dispatch));
    variant_.segments.push_back(std::move(segment));
    return {};
  }

  Result<uint32_t> add_pass_source(const FramePass& pass) {
    Source source;
    SHALE_TRY(source.glsl, options_.load_shader(pass.shader));
    source.where = pass.shader;
    source.defines = frame_defines();
    // Where one invocation is a lane of a processor, 64 bits are stored as one number.
    source.defines.emplace_back("SHALE_ON_CPU", profile_.literal_weights ? "1" : "0");
    source.defines.emplace_back("LOCAL_X", std::to_string(pass.workgroup[0]));
    source.defines.emplace_back("LOCAL_Y", std::to_string(pass.workgroup[1]));
    source.defines.insert(source.defines.end(), pass.defines.begin(), pass.defines.end());
    // Includes lie beside the shader.
    source.load = [this, folder = pass.shader.substr(0, pass.shader.rfind('/') + 1)](
                      const std::string& name) { return options_.load_shader(folder + name); };
    return add_source(std::move(source));
  }

  /// What the bindings ask for joins what the modules ask for.
  void add_requirements() {
    const Requirements from_modules = variant_.requirements;
    variant_.requirements = binding_requirements(variant_);
    variant_.requirements.features = from_modules.features;
    variant_.requirements.workgroup_invocations = from_modules.workgroup_invocations;
    variant_.requirements.shared_bytes = from_modules.shared_bytes;
    std::vector<MatrixProduct>& products = variant_.requirements.matrix_products;
    products = from_modules.matrix_products;
    std::sort(products.begin(), products.end());
    products.erase(std::unique(products.begin(), products.end()), products.end());
    // Kernels with matrices have one subgroup to a workgroup.
    if (!products.empty()) variant_.requirements.subgroup_size = profile_.caps.subgroup_size;
    for (const std::string& line : missing(profile_.caps, variant_.requirements))
      warnings_.push_back(fmt::format("target {}: {}", profile_.name, line));
  }

  const Graph& graph_;
  const std::vector<GroupProblem>& problems_;
  const DeviceProfile& profile_;
  const CompileOptions& options_;
  WeightBlob& blob_;
  std::vector<std::string>& warnings_;
  Variant variant_;
  std::map<ValueId, uint32_t> resource_of_;
  std::map<ValueId, LiveInterval> live_;
  std::vector<WorkTable> work_;
  std::vector<Source> sources_;
  size_t dispatch_count_ = 0;
  uint64_t lower_bound_ = 0;
};

/// Names the first channels whose accumulator may leave int32; nothing if all are proven.
std::optional<std::string> unproven(const Graph& graph, const GroupProblem& problem) {
  if (!problem.group.head) return std::nullopt;
  const Node& node = graph.node(*problem.group.head);
  if (graph.value(node.output).type.dtype != DType::kInt32) return std::nullopt;
  if (node.op != Op::kConv2d && node.op != Op::kConv3d && node.op != Op::kDepthwiseConv2d &&
      node.op != Op::kTransposeConv2d)
    return std::nullopt;
  const std::string label = node_label(graph, *problem.group.head);
  if (!problem.proof)
    return label + ": weights or bias are no constants, so its accumulators cannot be bounded";
  const IntRange range = dtype_range(DType::kInt32);
  for (size_t c = 0; c < problem.proof->min.size(); ++c)
    if (problem.proof->min[c] < range.min || problem.proof->max[c] > range.max)
      return fmt::format(
          "{}: channel {} may leave int32: its accumulator is only known to lie in {}..{}", label,
          c, problem.proof->min[c], problem.proof->max[c]);
  return std::nullopt;
}

std::string options_text(const CompileOptions& options) {
  std::string text =
      fmt::format("optimize={} kernels=[{}] spirv_opt={}", options.pass_options.optimize,
                  fmt::join(options.kernels, ","), options.optimize_spirv);
  for (const auto& [name, kernel] : options.choices) text += fmt::format(" {}:{}", name, kernel);
  for (const auto& [name, shape] : options.passes.input_shapes)
    text += fmt::format(" {}={}", name, shape_text(shape));
  return text;
}

/// Gives the graph inputs whose sizes follow from the frame their shapes.
/// Errors: kBadInput if there is no such input, or its shape was asked for otherwise too.
Result<void> size_inputs(const Graph& graph, CompileOptions& options) {
  SHALE_TRY(const auto sizes, frame_sizes(*options.frame, options.sizes));
  for (const FrameTensor& tensor : options.frame->tensors) {
    if (!tensor.size) continue;
    const auto input = std::find_if(graph.inputs.begin(), graph.inputs.end(), [&](ValueId id) {
      return graph.value(id).name == tensor.name;
    });
    if (input == graph.inputs.end() || graph.value(*input).type.shape.size() != 4)
      return bad_input("frame.tensors", "the network has no NHWC input \"{}\"", tensor.name);
    if (options.passes.input_shapes.contains(tensor.name))
      return bad_input("--input-shape",
                       "the size of \"{}\" follows from the frame: use --render and --output-size",
                       tensor.name);
    const FrameExtent extent = (*tensor.size)(sizes.first, sizes.second);
    Shape shape = graph.value(*input).type.shape;
    shape[1] = extent.height;
    shape[2] = extent.width;
    options.passes.input_shapes[tensor.name] = std::move(shape);
  }
  return {};
}

Result<Graph> imported(std::span<const uint8_t> model, const CompileOptions& options) {
  ImportOptions import = options.import;
  import.input_shapes = options.passes.input_shapes;
  return import_model(model, import);
}

bool has_graph(const Frame& frame) {
  return std::any_of(frame.passes.begin(), frame.passes.end(),
                     [](const FramePass& pass) { return pass.is_graph; });
}

}  // namespace

Result<Graph> shaped_graph(std::span<const uint8_t> model, const CompileOptions& given) {
  CompileOptions options = given;
  SHALE_TRY(Graph graph, imported(model, options));
  if (options.frame) SHALE_TRY_VOID(size_inputs(graph, options));
  const Result<Change> shapes = run_pass(*find_pass("infer-shapes"), graph, options.passes);
  if (!shapes) return shapes.error();
  SHALE_TRY_VOID(verify(graph));
  return graph;
}

Result<Graph> fused_graph(Graph graph, const CompileOptions& options) {
  const auto timings = run_pipeline(graph, {}, options.pass_options);
  if (!timings) return timings.error();
  give_outputs_nodes(graph);
  return graph;
}

Result<Compiled> compile(std::span<const uint8_t> model, const CompileOptions& options) {
  Graph graph;
  if (!options.frame || has_graph(*options.frame)) {
    SHALE_TRY(graph, imported(model, options));
  }
  return compile_graph(std::move(graph), stable_hash(model), options);
}

Result<Compiled> compile_graph(Graph graph, uint64_t model_hash, const CompileOptions& given) {
  CompileOptions options = given;
  if (options.frame) SHALE_TRY_VOID(size_inputs(graph, options));
  for (const std::string& kernel : options.kernels)
    if (!find_kernel(kernel)) return bad_input("--kernels", "\"{}\" is no kernel family", kernel);
  Compiled compiled;
  SHALE_TRY(compiled.timings, run_pipeline(graph, options.passes, options.pass_options));
  give_outputs_nodes(graph);

  std::vector<GroupProblem> problems;
  for (Group& group : collect_groups(graph)) {
    GroupProblem problem{.graph = &graph, .group = std::move(group), .proof = {}, .cost = {}};
    problem.proof = prove_ranges(graph, problem.group);
    problem.cost = group_cost(graph, problem.group);
    if (const std::optional<std::string> message = unproven(graph, problem)) {
      if (options.require_proof) return bad_input("--require-proof", "{}", *message);
      compiled.warnings.push_back(*message);
    }
    problems.push_back(std::move(problem));
  }

  const auto start = std::chrono::steady_clock::now();
  WeightBlob blob;
  for (const std::string& target : options.targets) {
    const auto own_profile = options.profiles.find(target);
    const DeviceProfile* profile =
        own_profile != options.profiles.end() ? &own_profile->second : find_profile(target);
    if (!profile) {
      std::string known;
      for (const DeviceProfile& each : known_profiles())
        known += (known.empty() ? "" : ", ") + std::string(each.name);
      return bad_input("--target", "\"{}\" is unknown, expected one of: {}", target, known);
    }
    DeviceProfile own = *profile;
    if (const auto measured = options.constants.find(std::string(own.name));
        measured != options.constants.end())
      own.ns = measured->second.ns, own.roof_gops = measured->second.roof_gops;
    VariantBuilder builder(graph, problems, own, options, blob, compiled.warnings);
    SHALE_TRY(Variant variant, builder.build());
    compiled.arena_lower_bound_bytes =
        std::max(compiled.arena_lower_bound_bytes, builder.arena_lower_bound_bytes());
    compiled.work.push_back(builder.take_work());
    compiled.package.variants.push_back(std::move(variant));
  }
  const std::chrono::duration<double, std::milli> elapsed =
      std::chrono::steady_clock::now() - start;
  compiled.kernels_ms = elapsed.count();
  compiled.package.provenance = {model_hash, options.model_name, kCompilerVersion,
                                 options_text(options)};
  compiled.package.weights = std::move(blob.blob);
  SHALE_TRY_VOID(
      check_package(compiled.package));  // names, for one, come from the model as they are
  compiled.graph = std::move(graph);
  return compiled;
}

}  // namespace shale
