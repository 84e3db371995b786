// Graph modules and pipelines: creation, properties, destruction.
#include <algorithm>
#include <chrono>
#include <cstring>
#include <thread>

#include "tools/layer/build_graph.h"
#include "tools/layer/chain.h"
#include "tools/layer/disk_cache.h"
#include "tools/layer/tensor_shader.h"

namespace shale::layer {
namespace {

/// Bits of VkPipelineCreateFlags2 that a graph may have; their values are those of the older type.
constexpr VkPipelineCreateFlags2 kFailOnCompileRequired =
    VK_PIPELINE_CREATE_FAIL_ON_PIPELINE_COMPILE_REQUIRED_BIT;
constexpr VkPipelineCreateFlags2 kEarlyReturn = VK_PIPELINE_CREATE_EARLY_RETURN_ON_FAILURE_BIT;
constexpr VkPipelineCreateFlags2 kNoProtectedAccess = VkPipelineCreateFlags2{1} << 27;
constexpr VkPipelineCreateFlags2 kInBuffers = VK_PIPELINE_CREATE_DESCRIPTOR_BUFFER_BIT_EXT;
constexpr VkPipelineCreateFlags2 kKnownFlags = kFailOnCompileRequired | kEarlyReturn | kInBuffers |
                                               kNoProtectedAccess |
                                               VK_PIPELINE_CREATE_DISABLE_OPTIMIZATION_BIT;

/// One create info of a call.
class Creation {
 public:
  Creation(Device& device, VkPipelineCache cache, const VkDataGraphPipelineCreateInfoARM& info)
      : device_(device), cache_handle_(cache), info_(info) {
    if (cache) cache_ = device.caches.find(cache);
  }

  /// Null, without an error, where the pipeline would have to be compiled and may not.
  Result<std::unique_ptr<GraphPipeline>> run() {
    const auto start = std::chrono::steady_clock::now();
    Result<std::unique_ptr<GraphPipeline>> pipeline = make();
    const std::chrono::duration<double, std::nano> took = std::chrono::steady_clock::now() - start;
    if (const auto* feedback = find_in_chain<VkPipelineCreationFeedbackCreateInfo>(
            info_.pNext, VK_STRUCTURE_TYPE_PIPELINE_CREATION_FEEDBACK_CREATE_INFO);
        feedback && feedback->pPipelineCreationFeedback) {
      VkPipelineCreationFeedbackFlags flags = VK_PIPELINE_CREATION_FEEDBACK_VALID_BIT;
      if (hit_) flags |= VK_PIPELINE_CREATION_FEEDBACK_APPLICATION_PIPELINE_CACHE_HIT_BIT;
      *feedback->pPipelineCreationFeedback = {flags, static_cast<uint64_t>(took.count())};
    }
    return pipeline;
  }

 private:
  Result<std::unique_ptr<GraphPipeline>> make() {
    if (info_.flags & ~kKnownFlags)
      return unsupported("VkDataGraphPipelineCreateInfoARM::flags", "{:#x} has unsupported bits",
                         info_.flags);
    SHALE_TRY_VOID(check_engines());
    SHALE_TRY_VOID(check_layout());
    const auto* module = find_in_chain<VkDataGraphPipelineShaderModuleCreateInfoARM>(
        info_.pNext, VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SHADER_MODULE_CREATE_INFO_ARM);
    const auto* named = find_in_chain<VkDataGraphPipelineIdentifierCreateInfoARM>(
        info_.pNext, VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_IDENTIFIER_CREATE_INFO_ARM);
    const auto* node = find_in_chain<VkDataGraphPipelineSingleNodeCreateInfoARM>(
        info_.pNext, VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SINGLE_NODE_CREATE_INFO_ARM);
    if ((module ? 1 : 0) + (named ? 1 : 0) + (node ? 1 : 0) != 1)
      return bad_input("VkDataGraphPipelineCreateInfoARM",
                       "expected either a shader module, an identifier or a node in its chain");
    if (node) return from_node(*node);
    if (named) return from_identifier(*named);
    SHALE_TRY(const GraphSource source, read_source(device_, info_, *module));
    const Identifier identifier = identify(device_, source);
    if (const auto bytes = find(identifier)) {
      hit_ = true;
      if (auto pipeline = from_bytes(*bytes, identifier)) return pipeline;
      hit_ = false;  // of another make; compile it again
    }
    if (info_.flags & kFailOnCompileRequired) return std::unique_ptr<GraphPipeline>();
    if (device_.disk_cache)
      if (const auto bytes = device_.disk_cache->find(identifier))
        if (auto pipeline = from_bytes(*bytes, identifier)) {
          keep(identifier, bytes);
          return pipeline;
        }
    std::string log;
    SHALE_TRY(const Package package, compile_source(device_, source, log));
    const auto bytes = std::make_shared<const std::vector<uint8_t>>(write_package(package));
    SHALE_TRY(auto pipeline, from_package(package, identifier));
    pipeline->log = std::move(log);
    keep(identifier, bytes);
    if (device_.disk_cache) device_.disk_cache->store(identifier, *bytes);
    return pipeline;
  }

  /// The layout's sets lie in descriptor buffers, or none does, as the flags say.
  Result<void> check_layout() const {
    const auto layout = device_.layouts.find(info_.layout);
    for (size_t i = 0; layout && i < layout->sets.size(); ++i)
      if (const auto& set = layout->sets[i];
          set && set->has_tensors && set->in_descriptor_buffer != bool(info_.flags & kInBuffers))
        return bad_input("VkDataGraphPipelineCreateInfoARM::flags",
                         "set {} {} in a descriptor buffer, the pipeline's {}", i,
                         set->in_descriptor_buffer ? "lies" : "does not lie",
                         set->in_descriptor_buffer ? "do not" : "do");
    if (info_.flags & kInBuffers && !(layout && layout->own))
      return bad_input("VkDataGraphPipelineCreateInfoARM::flags",
                       "the layout has no tensors in descriptor buffers");
    return {};
  }

  Result<void> check_engines() const {
    const auto* engines = find_in_chain<VkDataGraphProcessingEngineCreateInfoARM>(
        info_.pNext, VK_STRUCTURE_TYPE_DATA_GRAPH_PROCESSING_ENGINE_CREATE_INFO_ARM);
    if (!engines) return {};
    for (uint32_t i = 0; i < engines->processingEngineCount; ++i) {
      const VkPhysicalDeviceDataGraphProcessingEngineARM& engine = engines->pProcessingEngines[i];
      if (i > 0 || engine.isForeign ||
          engine.type != VK_PHYSICAL_DEVICE_DATA_GRAPH_PROCESSING_ENGINE_TYPE_DEFAULT_ARM)
        return unsupported("VkDataGraphProcessingEngineCreateInfoARM",
                           "engine {} is not the default one", i);
    }
    return {};
  }

  Result<std::unique_ptr<GraphPipeline>> from_identifier(
      const VkDataGraphPipelineIdentifierCreateInfoARM& named) {
    if (!(info_.flags & kFailOnCompileRequired) || info_.resourceInfoCount != 0)
      return bad_input(
          "VkDataGraphPipelineIdentifierCreateInfoARM",
          "expected no resource infos, and the flag to fail where a compiler is needed");
    Identifier identifier;
    if (named.identifierSize != identifier.size()) return std::unique_ptr<GraphPipeline>();
    std::memcpy(identifier.data(), named.pIdentifier, identifier.size());
    const auto bytes = find(identifier);
    if (!bytes) return std::unique_ptr<GraphPipeline>();
    hit_ = true;
    return from_bytes(*bytes, identifier);
  }

  Result<std::unique_ptr<GraphPipeline>> from_node(
      const VkDataGraphPipelineSingleNodeCreateInfoARM& node) {
    SHALE_TRY(const FlowSource source, read_flow(device_, info_, node));
    if (info_.flags & kFailOnCompileRequired) return std::unique_ptr<GraphPipeline>();
    VkPipelineCache cache = cache_handle_;
    if (!cache && device_.disk_cache) cache = device_.disk_cache->pipelines();
    auto pipeline = std::make_unique<GraphPipeline>();
    SHALE_TRY(pipeline->flow,
              OpticalFlow::create(device_, source, device_.layouts.find(info_.layout), cache));
    pipeline->log = "optical flow\n";
    return pipeline;
  }

  std::shared_ptr<const std::vector<uint8_t>> find(const Identifier& identifier) const {
    if (!cache_) return nullptr;
    const std::lock_guard lock(cache_->mutex);
    const auto found = cache_->packages.find(identifier);
    return found == cache_->packages.end() ? nullptr : found->second;
  }
  void keep(const Identifier& identifier, std::shared_ptr<const std::vector<uint8_t>> bytes) const {
    if (!cache_) return;
    const std::lock_guard lock(cache_->mutex);
    cache_->packages.emplace(identifier, std::move(bytes));
  }

  Result<std::unique_ptr<GraphPipeline>> from_bytes(const std::vector<uint8_t>& bytes,
                                                    const Identifier& identifier) {
    SHALE_TRY(const Package package, read_package(bytes));
    SHALE_TRY(auto pipeline, from_package(package, identifier));
    pipeline->log = "taken from a cache\n";
    return pipeline;
  }

  Result<std::unique_ptr<GraphPipeline>> from_package(const Package& package,
                                                      const Identifier& identifier) {
    const Compile compile = compile_when(info_);
    // The application may destroy its cache, or use it, while pipelines are made in the background.
    const bool is_late = compile != Compile::kAtOnce &&
                         !package.variants.front().segments.front().start_forms.empty();
    VkPipelineCache cache = is_late ? VK_NULL_HANDLE : cache_handle_;
    if (!cache && device_.disk_cache) cache = device_.disk_cache->pipelines();
    const auto layout = device_.layouts.find(info_.layout);
    const bool late_sets =
        layout && std::any_of(layout->sets.begin(), layout->sets.end(),
                              [](const auto& set) { return set && set->update_after_bind; });
    SHALE_TRY(DataGraphPipeline pipeline,
              DataGraphPipeline::create(*device_.context, package,
                                        {.cache = cache,
                                         .graph = {},
                                         .compile = compile,
                                         .threads = std::thread::hardware_concurrency(),
                                         .update_after_bind = late_sets}));
    SHALE_TRY(std::vector<GraphTensor> tensors, graph_tensors(pipeline.variant()));
    std::vector<std::optional<StridedCopy>> copies(tensors.size());
    for (size_t i = 0; late_sets && i < tensors.size(); ++i)
      if (const GraphTensor& each = tensors[i]; !each.layout.packed) {
        SHALE_TRY(copies[i],
                  StridedCopy::create(*device_.context, each.layout, !each.is_input, cache));
      }
    return std::unique_ptr<GraphPipeline>(
        new GraphPipeline{std::move(pipeline),
                          std::move(tensors),
                          identifier,
                          {},
                          std::move(copies),
                          info_.flags & kInBuffers ? layout : nullptr,
                          nullptr});
  }

  Device& device_;
  VkPipelineCache cache_handle_;
  std::shared_ptr<GraphCache> cache_;
  const VkDataGraphPipelineCreateInfoARM& info_;
  bool hit_ = false;  ///< in the application's cache
};

/// Writes as much of `from` as fits; false if that is not all.
bool write_property(VkDataGraphPipelinePropertyQueryResultARM& result,
                    std::span<const uint8_t> from) {
  if (!result.pData) {
    result.dataSize = from.size();
    return true;
  }
  const size_t written = std::min(result.dataSize, from.size());
  std::memcpy(result.pData, from.data(), written);
  if (result.isText && written > 0) static_cast<char*>(result.pData)[written - 1] = '\0';
  result.dataSize = written;
  return written == from.size();
}

}  // namespace

VkResult VKAPI_CALL CreateShaderModule(VkDevice handle, const VkShaderModuleCreateInfo* info,
                                       const VkAllocationCallbacks* allocator,
                                       VkShaderModule* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    const std::span<const uint32_t> words(info->pCode, info->codeSize / sizeof(uint32_t));
    if (device.tensor_buffers && has_tensors(words)) {
      const Result<std::vector<uint32_t>> lowered = lower_tensors(words);
      if (!lowered) return device.fail(VK_OBJECT_TYPE_DEVICE, number_of(handle), lowered.error());
      VkShaderModuleCreateInfo below = *info;
      below.codeSize = sizeof(uint32_t) * lowered->size();
      below.pCode = lowered->data();
      return device.CreateShaderModule(handle, &below, allocator, result);
    }
    if (!device.graphs || !has_graphs(words))
      return device.CreateShaderModule(handle, info, allocator, result);
    auto module = std::make_shared<GraphModule>();
    module->words.assign(words.begin(), words.end());
    *result = reinterpret_cast<VkShaderModule>(module.get());
    device.modules.put(*result, std::move(module));
    return VK_SUCCESS;
  });
}

void VKAPI_CALL DestroyShaderModule(VkDevice handle, VkShaderModule module,
                                    const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    if (!device.modules.take(module)) device.DestroyShaderModule(handle, module, allocator);
  });
}

VkResult VKAPI_CALL CreateDataGraphPipelinesARM(VkDevice handle, VkDeferredOperationKHR deferred,
                                                VkPipelineCache cache, uint32_t count,
                                                const VkDataGraphPipelineCreateInfoARM* infos,
                                                const VkAllocationCallbacks* allocator,
                                                VkPipeline* results) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    std::fill_n(results, count, VkPipeline{VK_NULL_HANDLE});
    if (deferred)
      return device.fail(VK_OBJECT_TYPE_DEVICE, number_of(handle),
                         unsupported("vkCreateDataGraphPipelinesARM", "the operation is deferred"));
    VkResult worst = VK_SUCCESS;
    for (uint32_t i = 0; i < count; ++i) {
      const VkResult made = guarded([&]() -> VkResult {
        Result<std::unique_ptr<GraphPipeline>> pipeline = Creation(device, cache, infos[i]).run();
        if (!pipeline)
          return device.fail(VK_OBJECT_TYPE_DEVICE, number_of(handle), pipeline.error());
        if (!*pipeline) return VK_PIPELINE_COMPILE_REQUIRED;
        // What is behind the handle is shared with sessions, which may outlive it.
        std::shared_ptr<GraphPipeline> shared = *std::move(pipeline);
        results[i] = reinterpret_cast<VkPipeline>(
            make_object<std::shared_ptr<GraphPipeline>>(allocator, shared));
        device.pipelines.put(results[i], std::move(shared));
        return VK_SUCCESS;
      });
      // An error counts for more than what has still to be compiled.
      if (made != VK_SUCCESS && (worst == VK_SUCCESS || made < 0)) worst = made;
      if (made != VK_SUCCESS && infos[i].flags & kEarlyReturn) break;
    }
    return worst;
  });
}

void VKAPI_CALL DestroyPipeline(VkDevice handle, VkPipeline pipeline,
                                const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    if (device.pipelines.take(pipeline))
      destroy_object(reinterpret_cast<std::shared_ptr<GraphPipeline>*>(pipeline), allocator);
    else
      device.DestroyPipeline(handle, pipeline, allocator);
  });
}

VkResult VKAPI_CALL GetDataGraphPipelineAvailablePropertiesARM(
    VkDevice, const VkDataGraphPipelineInfoARM*, uint32_t* count,
    VkDataGraphPipelinePropertyARM* results) {
  constexpr VkDataGraphPipelinePropertyARM kAll[] = {
      VK_DATA_GRAPH_PIPELINE_PROPERTY_CREATION_LOG_ARM,
      VK_DATA_GRAPH_PIPELINE_PROPERTY_IDENTIFIER_ARM};
  constexpr auto kCount = static_cast<uint32_t>(std::size(kAll));
  if (!results) {
    *count = kCount;
    return VK_SUCCESS;
  }
  *count = std::min(*count, kCount);
  std::copy_n(kAll, *count, results);
  return *count < kCount ? VK_INCOMPLETE : VK_SUCCESS;
}

VkResult VKAPI_CALL GetDataGraphPipelinePropertiesARM(
    VkDevice handle, const VkDataGraphPipelineInfoARM* info, uint32_t count,
    VkDataGraphPipelinePropertyQueryResultARM* results) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    const auto pipeline = device.pipelines.find(info->dataGraphPipeline);
    if (!pipeline)
      return device.fail(VK_OBJECT_TYPE_PIPELINE, number_of(info->dataGraphPipeline),
                         bad_input("vkGetDataGraphPipelinePropertiesARM", "is no data graph"));
    bool complete = true;
    for (uint32_t i = 0; i < count; ++i) {
      std::span<const uint8_t> data = pipeline->identifier;
      switch (results[i].property) {
        case VK_DATA_GRAPH_PIPELINE_PROPERTY_CREATION_LOG_ARM:
          results[i].isText = VK_TRUE;
          data = {reinterpret_cast<const uint8_t*>(pipeline->log.c_str()),
                  pipeline->log.size() + 1};
          break;
        case VK_DATA_GRAPH_PIPELINE_PROPERTY_IDENTIFIER_ARM: results[i].isText = VK_FALSE; break;
        default:
          return device.fail(VK_OBJECT_TYPE_PIPELINE, number_of(info->dataGraphPipeline),
                             unsupported("vkGetDataGraphPipelinePropertiesARM",
                                         "property {} is none of the pipeline's",
                                         static_cast<int>(results[i].property)));
      }
      complete = write_property(results[i], data) && complete;
    }
    return complete ? VK_SUCCESS : VK_INCOMPLETE;
  });
}

}  // namespace shale::layer
