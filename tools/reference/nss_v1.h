// tools/reference/nss_v1.h -- the passes of NSS v1 in double precision, a function a pass: what the shaders of shaders/frame/nss
// mean, said as plainly as it can be. Their conventions stand in tools/train/nss_passes.py and shaders/frame/README.md.
//
// Source: ours, from nss.md sections 1.1, 2 and 3 as the shaders' heads settle it; shown to agree in
// tests/e2e/nss_reference_test.cpp.
#pragma once

#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "compiler/plan/frame.h"
#include "ir/graph/tensor.h"
#include "ir/package/package.h"
#include "tools/scene/frame_source.h"

namespace shale::nss_v1 {

/// Where shaders store halves, codes of 8 bits and depths of 31, the model rounds as they do, or not at all. The network's
/// inputs are codes either way.
enum class Rounding { kAsStored, kNone };

/// Values of a picture, [height][width][channels] in row order from the top.
struct Grid {
  int width = 0, height = 0, channels = 0;
  std::vector<double> values;

  static Grid zeros(int width, int height, int channels);
  bool empty() const { return values.empty(); }
  double* at(int x, int y);
  const double* at(int x, int y) const;  ///< of the nearest texel, if outside
};

/// What frame.json, sizes and quantization make of the passes: their `defines`, in the shaders' words.
struct Form {
  Extent render, output;
  Extent network, padded;  ///< of the network's picture, without and with its padding
  int side = 1;            ///< render texels a network texel, per axis
  int block = 2, kernel = 6, taps = 9, kpn_shift = 2;
  double weight_floor = 0;
  bool catmull_rom = true;
  Quantization input, temporal, weights;
};

/// The form of a compiled sandwich whose passes are those of NSS v1, told by the names of their shaders.
/// Errors: kUnsupported, saying why there is no model of them.
Result<Form> form_of(const Frame& frame, const Variant& variant);

/// What a frame leaves to the next one. Empty: nothing, the frame is a reset.
struct Past {
  Grid history;     ///< the output: linear, exposure removed, 3 channels
  Grid state;       ///< of the instability, 4 channels in [-1, 1], padded
  Tensor temporal;  ///< of the network, codes [1, h, w, 4], padded
};

/// Pass b: by block of render texels, the depth that what is seen had a frame ago; the farthest where nothing came.
Grid scatter(const Form& form, const SourceFrame& frame, Rounding rounding);

/// Pass c, with side 2: disocclusion in 0..1 by block of 4x4 render texels.
Grid disocclusion(const Form& form, const SourceFrame& frame, const Grid& scattered,
                  Rounding rounding);

/// Pass d.
struct Pre {
  Tensor input;  ///< codes [1, h, w, 12], padded
  Grid state;    ///< as Past has it
  Grid
      dilated;  ///< motion where the closest depth is, as the host gave it; render size, 2 channels
};
/// scattered: with side 1; disoccluded: with side 2.
Pre pre(const Form& form, const SourceFrame& frame, const Grid& scattered, const Grid& disoccluded,
        const Past& past, Rounding rounding);

/// The post pass: the new history. temporal, kernel: of the network.
Grid post(const Form& form, const SourceFrame& frame, const Grid& dilated, const Past& past,
          const Tensor& temporal, const Tensor& kernel, Rounding rounding);

/// "temporal" and "kernel" from "input".
using Network = std::function<Result<std::pair<Tensor, Tensor>>(const Tensor& input)>;

/// Whole frames, one after the other.
class Model {
 public:
  Model(Form form, Rounding rounding) : form_(form), rounding_(rounding) {}

  /// The next frame starts without a past. Frames with a cut do so themselves.
  void reset() { past_ = {}; }
  /// The shown picture, linear, as the player of the sandwich gives it.
  /// Errors: those of the network.
  Result<FloatImage> play(const SourceFrame& frame, const Network& network);

 private:
  Form form_;
  Rounding rounding_;
  Past past_;
};

/// As the models take pictures and give them.
Grid grid_of(const FloatImage& image, int channels);
FloatImage picture_of(const Grid& grid);

}  // namespace shale::nss_v1
