// tools/layer/disk_cache.h -- compiled graphs that survive the process, in the user's cache folder.
#pragma once

#include "runtime/vk/pipeline_cache.h"
#include "tools/layer/graph.h"

namespace shale::layer {

/// Differs between builds of the layer, so that none takes what another has compiled.
const std::string& layer_identity();

/// Files of packages, and the device's own pipeline cache. Shared between processes: files are written
/// beside their name and moved there, so a reader sees a whole one or none, and one that is damaged is
/// none. Nothing here fails; what cannot be read or written is only not cached.
class DiskCache {
 public:
  /// In the folder that SHALE_LAYER_CACHE names, or else below XDG_CACHE_HOME or HOME; null if that is
  /// "off" or nowhere.
  static std::unique_ptr<DiskCache> open(const Device& device);
  /// Saves the device's pipelines.
  ~DiskCache();

  VkPipelineCache pipelines() const { return pipelines_ ? pipelines_->get() : VK_NULL_HANDLE; }
  /// The package's bytes, or null.
  std::shared_ptr<const std::vector<uint8_t>> find(const Identifier& identifier) const;
  void store(const Identifier& identifier, std::span<const uint8_t> package) const;

 private:
  explicit DiskCache(std::string folder) : folder_(std::move(folder)) {}
  std::string file_of(const Identifier& identifier) const;

  std::string folder_;
  std::optional<vk::PipelineCache> pipelines_;
};

}  // namespace shale::layer
