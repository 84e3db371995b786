// What a list of layers counts, and how published figures compare with it.
#include <cmath>

#include "compiler/cost/layers.h"

namespace shale {

LayerCounts count_layers(std::span<const Layer> layers) {
  LayerCounts counts;
  for (const Layer& layer : layers) {
    const double in = layer.in.area(), out = layer.out.area();
    const double elements = out * static_cast<double>(layer.out_channels);
    switch (layer.kind) {
      case LayerKind::kConv:
      case LayerKind::kTransposeConv: {
        const int64_t weights = layer.kernel[0] * layer.kernel[1] * layer.in_channels /
                                layer.groups * layer.out_channels;
        counts.parameters += static_cast<uint64_t>(weights + (layer.bias ? layer.out_channels : 0));
        // The work of a transposed convolution is at its input positions; the counter charges its
        // output.
        const double positions = layer.kind == LayerKind::kTransposeConv ? in : out;
        (positions > 1 ? counts.macs_hr : counts.macs_lr) +=
            positions * static_cast<double>(weights);
        counts.counter_macs += out * static_cast<double>(weights);
        if (layer.bias) counts.counter_bias += elements;
        break;
      }
      case LayerKind::kBatchNorm:
        if (layer.affine) counts.parameters += 2 * static_cast<uint64_t>(layer.out_channels);
        counts.counter_other += (layer.affine ? 2 : 1) * elements;
        break;
      case LayerKind::kMaxPool:
      case LayerKind::kAvgPool:
        counts.counter_other += in * static_cast<double>(layer.in_channels);
        break;
      case LayerKind::kUpsample: counts.counter_upsample += elements; break;
      default: break;  // free
    }
    switch (layer.activation) {
      case Activation::kPrelu:
        counts.parameters += static_cast<uint64_t>(layer.out_channels);
        [[fallthrough]];
      case Activation::kRelu:
      case Activation::kRelu6:
      case Activation::kLeakyRelu:
      case Activation::kElu: counts.counter_activation += elements; break;
      case Activation::kNone:
      case Activation::kTanh:
      case Activation::kSigmoid: break;
    }
  }
  return counts;
}

std::string_view agreement_text(Agreement agreement) {
  switch (agreement) {
    case Agreement::kNotStated: return "not stated";
    case Agreement::kReproduced: return "reproduced";
    case Agreement::kDiffers: return "differs";
    case Agreement::kNoResolution: return "no resolution";
  }
  return "";
}

RowCheck check_row(const CostRow& row) {
  RowCheck check;
  if (row.layers.empty()) return check;
  check.counts = count_layers(row.layers);
  const double per_pixel =
      row.convention == Convention::kMac ? check.counts.macs() : check.counts.counter_operations();
  check.giga = 1e-9 * per_pixel * static_cast<double>(row.lr_h) * static_cast<double>(row.lr_w);
  // Decimal figures are not exact in binary; the slack is far below their last digit.
  const auto judge = [](double computed, double stated, double tolerance) {
    return std::abs(computed - stated) <= tolerance + 1e-9 * stated ? Agreement::kReproduced
                                                                    : Agreement::kDiffers;
  };
  if (row.parameters_stated)
    check.parameters = judge(static_cast<double>(check.counts.parameters),
                             row.parameters_stated->value, row.parameters_stated->half_unit);
  if (row.giga_stated)
    check.giga_agreement = row.lr_h == 0 ? Agreement::kNoResolution
                                         : judge(check.giga, *row.giga_stated, row.tolerance_giga);
  return check;
}

}  // namespace shale
