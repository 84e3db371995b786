// compiler/cost/layers.h -- published networks as lists of layers, to check the cost model against
// their papers.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

enum class LayerKind : uint8_t {
  kConv,
  kTransposeConv,
  kActivation,
  kBatchNorm,
  kMaxPool,
  kAvgPool,
  kUpsample,
  kDepthToSpace,
  kSplit,
  kSoftmax,
  kWeightedSum,
  kReduceMax,
  kReduceSum,
  kElementwise,
};

enum class Activation : uint8_t {
  kNone,
  kRelu,
  kRelu6,
  kLeakyRelu,
  kElu,
  kPrelu,
  kTanh,
  kSigmoid,
};

inline constexpr int64_t kMaxLayerSide = 16384;  ///< pixels of the low-resolution picture, a side

/// Side of a grid of positions in units of the low-resolution (LR) side, reduced.
struct Ratio {
  int64_t num = 1, den = 1;
  bool operator==(const Ratio&) const = default;
  double value() const { return static_cast<double>(num) / static_cast<double>(den); }
};

struct Grid {
  Ratio h, w;
  bool operator==(const Grid&) const = default;
  double area() const { return h.value() * w.value(); }  ///< positions per LR pixel
};

/// One entry of a "layers" list, with the grid and the channels that follow from the entries before
/// it.
struct Layer {
  std::string op;  ///< as the file writes it
  LayerKind kind = LayerKind::kElementwise;
  Activation activation = Activation::kNone;
  int64_t kernel[2] = {1, 1}, stride[2] = {1, 1};  ///< h, w
  int64_t groups = 1;
  int64_t factor = 1;  ///< of upsample and depth_to_space
  bool bias = false;
  bool affine = true;              ///< of a batch norm
  bool nearest = true;             ///< of upsample
  std::vector<std::string> parts;  ///< of split: names of equal shares of the channels
  std::vector<std::string> of;     ///< of softmax_of: names of the parts that are multiplied
  int64_t in_channels = 0, out_channels = 0;
  Grid in, out;
};

/// Reads a "layers" list of cost_tables.json, which nobody vouches for. Names of operators and
/// activations are taken in the usual spellings ("transpose_conv2d", "conv_transpose2d", "deconv";
/// "pixel_shuffle"). Sizes are a number or [h,w]. "cin" absent: the channels of the layer before;
/// "bias" absent: true, as PyTorch has it; "at" ("lr" or "hr") names the grid of a layer's input or
/// output, absent: it follows from the factors and strides before. `scale` is that of "hr", 0 if
/// unknown; `input_channels` 0 if unknown.
/// Errors: kBadInput, kUnsupported for an unknown operator,
/// with the layer in `where`.
Result<std::vector<Layer>> parse_layers(std::string_view json, int64_t scale,
                                        int64_t input_channels);

/// Counts of a network; all but the parameters are per LR pixel.
struct LayerCounts {
  uint64_t parameters = 0;  ///< weights, biases, slopes of PReLU, affine batch norms
  double macs_lr = 0;       ///< multiply-accumulates of layers on the LR grid or a smaller one
  double macs_hr = 0;       ///< of layers on larger grids
  double counter_macs = 0, counter_bias = 0, counter_activation = 0, counter_upsample = 0;
  double counter_other = 0;  ///< pooling and batch norm

  double macs() const { return macs_lr + macs_hr; }
  double counter_operations() const {
    return counter_macs + counter_bias + counter_activation + counter_upsample + counter_other;
  }
};

/// Source: tests/golden/cost_tables.json, conventions "mac" and "counter_A".
LayerCounts count_layers(std::span<const Layer> layers);

/// The same network as an INT8 TOSA graph with made-up weights, whose cost alone has a meaning: i8
/// NHWC [1,lr_h,lr_w,c] in, i8 out. Skip connections, which a list of layers does not tell, enter
/// as further inputs: where a layer takes more channels than its predecessor gives, or another
/// grid.
/// Errors: kUnsupported for layers without an INT8 form here (PReLU, batch norm, bilinear
/// upsampling, groups other than 1 and one an input channel); kBadInput if the sizes do not come
/// out whole.
Result<Graph> graph_of_layers(const std::string& name, std::span<const Layer> layers, int64_t lr_h,
                              int64_t lr_w);

/// A published figure with the precision it was printed in.
struct Stated {
  std::string text;
  double value = 0;
  double half_unit = 0;  ///< half of the last printed digit; 0: exact
};

enum class Convention : uint8_t { kMac, kCounterA };

enum class Agreement : uint8_t {
  kNotStated,
  kReproduced,
  kDiffers,
  kNoResolution,  ///< a total is stated, but not for which size
};
std::string_view agreement_text(Agreement agreement);

/// A row of cost_tables.json.
struct CostRow {
  std::string id, kind, paper, network;
  int64_t scale = 0, input_channels = 0;  ///< 0: not given
  std::vector<Layer> layers;              ///< empty: nothing to count
  Convention convention = Convention::kMac;
  std::optional<Stated> parameters_stated;
  std::optional<double> giga_stated;  ///< 1e9 operations of `convention`
  double tolerance_giga = 0.005;
  int64_t lr_h = 0, lr_w = 0;  ///< size that the figures were counted for; 0: not given

  /// Timings of devices are no counts.
  bool is_timing() const { return kind == "time"; }
};

struct RowCheck {
  LayerCounts counts;
  double giga = 0;  ///< at the row's size, in its convention; 0 without a size
  Agreement parameters = Agreement::kNotStated;
  Agreement giga_agreement = Agreement::kNotStated;

  bool differs() const {
    return parameters == Agreement::kDiffers || giga_agreement == Agreement::kDiffers;
  }
};

/// Parameters agree to the last printed digit, operations within the row's tolerance.
RowCheck check_row(const CostRow& row);

/// Reads a file of schema "cost-tables/1", which nobody vouches for.
/// Errors: kBadInput, kUnsupported as parse_layers, with the row in `where`.
Result<std::vector<CostRow>> parse_cost_table(std::string_view json);

}  // namespace shale
