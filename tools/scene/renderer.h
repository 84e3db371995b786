// tools/scene/renderer.h -- renders frames of a scene on a device.
#pragma once

#include <functional>

#include "ir/base/result.h"
#include "runtime/vk/device.h"
#include "tools/scene/tables.h"

namespace shale {

/// A regular grid of pixels over a window, and where in each of them samples are taken.
struct SampleGrid {
  Extent extent;                        ///< pixels in the window
  uint32_t origin_x = 0, origin_y = 0;  ///< first pixel of the window in the whole picture's grid
  double scale_x = 1, scale_y = 1;      ///< output pixels per pixel
  std::array<float, 2> jitter{};        ///< in pixels of this grid
  uint32_t samples = 1;                 ///< along each side of a pixel
};

struct RenderedImages {
  FloatImage color, depth, motion;  ///< 3, 1 and 2 channels
};

/// The pipelines for one scene, and the buffers of its frames.
class SceneRenderer {
 public:
  /// Keeps a copy of what it needs of the scene. `cache` may be VK_NULL_HANDLE.
  /// Errors: kDevice.
  static Result<std::unique_ptr<SceneRenderer>> create(const vk::Context& context,
                                                       const Scene& scene,
                                                       VkPipelineCache cache = VK_NULL_HANDLE);
  ~SceneRenderer();

  /// Makes the tables of a frame the ones that `render` reads.
  /// Errors: kDevice.
  Result<void> set_frame(const FrameTables& tables);

  /// In bands of rows, one submission each. Between them asks `keep_going`, which may be empty.
  /// Errors: kDevice; kBadInput "interrupted" when told to stop.
  Result<RenderedImages> render(const SampleGrid& grid, const std::function<bool()>& keep_going);

  /// Largest number of texels in a list or table.
  uint32_t max_texels() const;

 private:
  class Impl;
  explicit SceneRenderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace shale
