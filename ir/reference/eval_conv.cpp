// ir/reference/eval_conv.cpp -- convolutions and matmul: of integers as exact dot products of 16-bit
// factors, of floats as sums in a fixed order.
//
// All four convolutions run one loop: for each output position the window is gathered into a patch
// of (input - zero point), 0 outside the input, and every output channel is a dot product with its
// row of (weight - zero point). They differ in which input element a tap reads, and in how many
// channels a group has: one group of all channels, or for depthwise a group a channel.
#include <algorithm>
#include <numeric>

#include "ir/reference/real.h"

namespace shale {
namespace {

/// Products that an int32 sum holds for sure, for factors up to these magnitudes.
int64_t exact_block(int64_t max_a, int64_t max_b) {
  return dtype_range(DType::kInt32).max / (max_a * max_b);
}

/// Largest magnitude of (element - zero point).
int64_t max_difference(DType dtype) { return dtype == DType::kInt16 ? 32768 : 255; }

/// Exact sum of a[i] * b[i]; every run of `block` products must fit int32.
int64_t dot(const int16_t* a, const int16_t* b, int64_t count, int64_t block) {
  int64_t total = 0;
  for (int64_t begin = 0; begin < count; begin += block) {
    const int64_t end = std::min(begin + block, count);
    int32_t sum = 0;
    for (int64_t i = begin; i < end; ++i) sum += a[i] * b[i];
    total += sum;
  }
  return total;
}

/// Element minus zero point: int8 lies in -255..255, int16 has zero point 0.
void subtract(const Tensor& tensor, int64_t begin, int64_t count, int16_t zero_point,
              int64_t out_step, int16_t* out) {
  const auto run = [&](const auto* in) {
    for (int64_t i = 0; i < count; ++i)
      out[i * out_step] = static_cast<int16_t>(in[begin + i] - zero_point);
  };
  if (tensor.host_bytes() == 1)
    run(tensor.data<int8_t>());
  else
    run(tensor.data<int16_t>());
}

/// One spatial axis: output o and kernel tap k meet at input o * stride - pad + k * dilation, or at
/// the i with o = i * stride + pad + k in a transposed convolution.
struct ConvAxis {
  int64_t in = 1, out = 1, kernel = 1, stride = 1, pad = 0, dilation = 1;
  bool transposed = false;

  /// Input coordinate, or nothing where the tap contributes 0.
  std::optional<int64_t> input(int64_t o, int64_t k) const {
    int64_t i = 0;
    if (transposed) {
      const int64_t distance = o - pad - k;
      if (distance < 0 || distance % stride != 0) return std::nullopt;
      i = distance / stride;
    } else {
      i = o * stride - pad + k * dilation;
    }
    return in_range(i, {0, in - 1}) ? std::optional(i) : std::nullopt;
  }
};

struct Conv {
  std::array<ConvAxis, 3> axes;  ///< depth, height, width; in 2D the depth is 1
  int64_t in_channels = 0;
  int64_t out_channels = 0;
  int64_t groups = 1;

  int64_t taps() const { return axes[0].kernel * axes[1].kernel * axes[2].kernel; }
  /// Length of a group's patch and of an output channel's row of weights.
  int64_t row() const { return taps() * in_channels / groups; }
};

Conv describe(const Eval& node) {
  const bool depthwise = node.op() == Op::kDepthwiseConv2d;
  const bool transposed = node.op() == Op::kTransposeConv2d;
  const Shape& input = node.shape(0);
  const Shape& weight = node.shape(1);
  const auto pad = node.attrs().list(transposed ? Attr::kOutPad : Attr::kPad);
  const auto stride = node.attrs().list(Attr::kStride);
  const auto dilation = node.attrs().list(Attr::kDilation);

  Conv conv;
  const size_t spatial = input.size() - 2;
  for (size_t i = 0; i < spatial; ++i) {
    ConvAxis& axis = conv.axes[3 - spatial + i];
    axis.in = input[i + 1];
    axis.out = node.result_type().shape[i + 1];
    axis.kernel = weight[depthwise ? i : i + 1];
    axis.stride = stride[i];
    axis.pad = pad[2 * i];
    axis.dilation = transposed ? 1 : dilation[i];
    axis.transposed = transposed;
  }
  conv.in_channels = input.back();
  conv.out_channels = node.result_type().shape.back();
  conv.groups = depthwise ? conv.in_channels : 1;
  return conv;
}

/// Weights as [oc][row], zero point subtracted. Depthwise weights are stored [tap][oc].
std::vector<int16_t> weight_rows(const Eval& node, const Conv& conv) {
  const Tensor& weight = node.in(1);
  const int16_t zero_point = static_cast<int16_t>(node.scalar(4));
  std::vector<int16_t> rows(static_cast<size_t>(weight.count()));
  if (node.op() != Op::kDepthwiseConv2d) {
    subtract(weight, 0, weight.count(), zero_point, 1, rows.data());
    return rows;
  }
  for (int64_t tap = 0; tap < conv.taps(); ++tap)
    subtract(weight, tap * conv.out_channels, conv.out_channels, zero_point, conv.taps(),
             rows.data() + tap);
  return rows;
}

/// Zero point taken off the channels of a pixel.
auto centred_pixel(const Eval& node) {
  return [&node, zero_point = static_cast<int16_t>(node.scalar(3))](int64_t begin, int64_t count,
                                                                    int64_t step, int16_t* out) {
    subtract(node.in(0), begin, count, zero_point, step, out);
  };
}

/// The window of one output position, as [group][tap][channel of the group]; 0 outside the input.
/// copy(first element, channels, step, out) gives the channels of a pixel.
template <typename T, typename Copy>
void gather_patch(const Conv& conv, int64_t batch, const std::array<int64_t, 3>& position,
                  const Copy& copy, std::vector<T>& patch) {
  const auto& [depth, height, width] = conv.axes;
  const bool grouped = conv.groups > 1;
  const int64_t channel_step = grouped ? conv.taps() : 1;
  const int64_t tap_step = grouped ? 1 : conv.in_channels;
  std::ranges::fill(patch, T{0});
  T* tap = patch.data();
  for (int64_t kz = 0; kz < depth.kernel; ++kz) {
    const auto z = depth.input(position[0], kz);
    for (int64_t ky = 0; ky < height.kernel; ++ky) {
      const auto y = height.input(position[1], ky);
      for (int64_t kx = 0; kx < width.kernel; ++kx, tap += tap_step) {
        const auto x = width.input(position[2], kx);
        if (!z || !y || !x) continue;
        const int64_t pixel = ((batch * depth.in + *z) * height.in + *y) * width.in + *x;
        copy(pixel * conv.in_channels, conv.in_channels, channel_step, tap);
      }
    }
  }
}

/// Where the position'th pixel of the result lies: [depth, height, width]; its batch.
std::array<int64_t, 3> position_of(const Conv& conv, int64_t position, int64_t& batch) {
  const auto& [depth, height, width] = conv.axes;
  batch = position / (width.out * height.out * depth.out);
  return {position / (width.out * height.out) % depth.out, position / width.out % height.out,
          position % width.out};
}

template <typename T>
std::vector<T> conv_sums(const Eval& node, const std::vector<T>& input,
                         const std::vector<T>& weight, const std::vector<T>& bias) {
  const Conv conv = describe(node);
  const int64_t channels = conv.out_channels, row = conv.row();
  // [row][oc], as depthwise weights are already: neighbouring sums then take neighbouring weights.
  std::vector<T> by_row = weight;
  if (node.op() != Op::kDepthwiseConv2d)
    for (int64_t oc = 0; oc < channels; ++oc)
      for (int64_t k = 0; k < row; ++k)
        by_row[static_cast<size_t>(k * channels + oc)] = weight[static_cast<size_t>(oc * row + k)];
  const int64_t outputs_a_group = channels / conv.groups;
  const int64_t positions = *element_count(node.result_type().shape) / channels;
  std::vector<T> sums(static_cast<size_t>(positions * channels));
  // A tap outside the input adds nothing, not even where its weight is no number.
  const auto compute = [&](int64_t begin, int64_t end) -> Result<void> {
    std::vector<T> patch(static_cast<size_t>(row * conv.groups));
    std::vector<uint8_t> inside(patch.size());
    for (int64_t position = begin; position < end; ++position) {
      int64_t batch = 0;
      const std::array<int64_t, 3> at = position_of(conv, position, batch);
      gather_patch(
          conv, batch, at,
          [&](int64_t first, int64_t count, int64_t step, T* out) {
            for (int64_t i = 0; i < count; ++i)
              out[i * step] = input[static_cast<size_t>(first + i)];
          },
          patch);
      gather_patch(
          conv, batch, at,
          [&](int64_t, int64_t count, int64_t step, uint8_t* out) {
            for (int64_t i = 0; i < count; ++i) out[i * step] = 1;
          },
          inside);
      T* const sum = sums.data() + position * channels;
      for (int64_t k = 0; k < row; ++k) {
        const T* const weights = by_row.data() + k * channels;
        if (conv.groups > 1) {
          for (int64_t oc = 0; oc < channels; ++oc) {
            const size_t tap = static_cast<size_t>(oc / outputs_a_group * row + k);
            if (inside[tap] != 0) sum[oc] += patch[tap] * weights[oc];
          }
        } else if (inside[static_cast<size_t>(k)] != 0) {
          const T x = patch[static_cast<size_t>(k)];
          for (int64_t oc = 0; oc < channels; ++oc) sum[oc] += x * weights[oc];
        }
      }
      for (int64_t oc = 0; oc < channels; ++oc)
        sum[oc] += bias[bias.size() == 1 ? 0 : static_cast<size_t>(oc)];
    }
    return {};
  };
  // The body has no error.
  static_cast<void>(parallel_for(positions, channels * row, compute));
  return sums;
}

template <typename T>
std::vector<T> matmul_sums(const Eval& node, const std::vector<T>& a, const std::vector<T>& b) {
  const int64_t depth = node.shape(0)[2], rows = node.shape(0)[1], columns = node.shape(1)[2];
  std::vector<T> sums(static_cast<size_t>(node.shape(0)[0] * rows * columns));
  const auto compute = [&](int64_t begin, int64_t end) -> Result<void> {
    for (int64_t row = begin; row < end; ++row)
      for (int64_t k = 0; k < depth; ++k) {
        const T factor = a[static_cast<size_t>(row * depth + k)];
        const T* const other = b.data() + (row / rows * depth + k) * columns;
        for (int64_t column = 0; column < columns; ++column)
          sums[static_cast<size_t>(row * columns + column)] += factor * other[column];
      }
    return {};
  };
  static_cast<void>(parallel_for(node.shape(0)[0] * rows, columns * depth, compute));
  return sums;
}

}  // namespace

template <typename T>
std::vector<T> real_sums(const Eval& node, const std::vector<T>& a, const std::vector<T>& b,
                         const std::vector<T>& bias) {
  return node.op() == Op::kMatmul ? matmul_sums(node, a, b) : conv_sums(node, a, b, bias);
}
template std::vector<float> real_sums(const Eval&, const std::vector<float>&,
                                      const std::vector<float>&, const std::vector<float>&);
template std::vector<double> real_sums(const Eval&, const std::vector<double>&,
                                       const std::vector<double>&, const std::vector<double>&);

Result<Tensor> eval_real_sums(const Eval& node) {
  const std::vector<float> bias =
      node.op() == Op::kMatmul ? std::vector<float>{} : node.in(2).reals();
  return Tensor::from_reals(node.result_type(),
                            real_sums(node, node.in(0).reals(), node.in(1).reals(), bias));
}

Result<Tensor> eval_conv(const Eval& node) {
  const Conv conv = describe(node);
  const std::vector<int16_t> weights = weight_rows(node, conv);
  const std::vector<int64_t> bias = node.in(2).ints();
  const int64_t block = exact_block(max_difference(node.in(0).type.dtype), 255);
  const int64_t outputs_a_group = conv.out_channels / conv.groups;
  Tensor result = Tensor::zeros(node.result_type());
  const IntRange range = dtype_range(result.type.dtype);

  const auto compute = [&](int64_t begin, int64_t end) -> Result<void> {
    std::vector<int16_t> patch(static_cast<size_t>(conv.row() * conv.groups));
    for (int64_t position = begin; position < end; ++position) {
      int64_t batch = 0;
      const std::array<int64_t, 3> at = position_of(conv, position, batch);
      gather_patch(conv, batch, at, centred_pixel(node), patch);
      for (int64_t oc = 0; oc < conv.out_channels; ++oc) {
        const int64_t sum = bias[bias.size() == 1 ? 0 : static_cast<size_t>(oc)] +
                            dot(patch.data() + oc / outputs_a_group * conv.row(),
                                weights.data() + oc * conv.row(), conv.row(), block);
        const int64_t element = position * conv.out_channels + oc;
        if (!in_range(sum, range)) return node.out_of_range(element, sum);
        result.set(element, sum);
      }
    }
    return {};
  };
  SHALE_TRY_VOID(
      parallel_for(result.count() / conv.out_channels, conv.out_channels * conv.row(), compute));
  return result;
}

Result<Tensor> eval_matmul(const Eval& node) {
  const Tensor& a = node.in(0);
  const Tensor& b = node.in(1);
  const int64_t depth = node.shape(0)[2], rows = node.shape(0)[1], columns = node.shape(1)[2];
  const int64_t max = max_difference(a.type.dtype);
  const int64_t block = exact_block(max, max);
  const int16_t a_zp = static_cast<int16_t>(node.scalar(2));
  const int16_t b_zp = static_cast<int16_t>(node.scalar(3));
  // b as [n][column][depth], so that both factors of a dot product are contiguous.
  std::vector<int16_t> transposed(static_cast<size_t>(b.count()));
  for (int64_t n = 0; n < node.shape(0)[0]; ++n)
    for (int64_t k = 0; k < depth; ++k)
      subtract(b, (n * depth + k) * columns, columns, b_zp, depth,
               transposed.data() + n * depth * columns + k);

  Tensor result = Tensor::zeros(node.result_type());
  const IntRange range = dtype_range(result.type.dtype);
  const auto compute = [&](int64_t begin, int64_t end) -> Result<void> {
    std::vector<int16_t> factors(static_cast<size_t>(depth));
    for (int64_t row = begin; row < end; ++row) {
      subtract(a, row * depth, depth, a_zp, 1, factors.data());
      const int16_t* matrix = transposed.data() + row / rows * depth * columns;
      for (int64_t column = 0; column < columns; ++column) {
        const int64_t sum = dot(factors.data(), matrix + column * depth, depth, block);
        const int64_t element = row * columns + column;
        if (!in_range(sum, range)) return node.out_of_range(element, sum);
        result.set(element, sum);
      }
    }
    return {};
  };
  SHALE_TRY_VOID(parallel_for(node.shape(0)[0] * rows, columns * depth, compute));
  return result;
}

}  // namespace shale
