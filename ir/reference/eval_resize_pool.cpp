// ir/reference/eval_resize_pool.cpp -- pools and resize.
#include <algorithm>

#include "ir/reference/eval.h"

namespace shale {
namespace {

/// Stores body(element, [n, y, x, c]) for every element of an NHWC result, or returns its error.
/// `element_cost` is roughly the operations of the body.
template <typename Body>
Result<Tensor> fill_image(const Eval& node, int64_t element_cost, const Body& body) {
  Tensor result = Tensor::zeros(node.result_type());
  const Shape& shape = result.type.shape;
  const int64_t height = shape[1], width = shape[2], channels = shape[3];
  const auto compute = [&](int64_t begin, int64_t end) -> Result<void> {
    for (int64_t line = begin, element = begin * width * channels; line < end; ++line)
      for (int64_t x = 0; x < width; ++x)
        for (int64_t c = 0; c < channels; ++c, ++element) {
          SHALE_TRY(const int64_t value,
                    body(element, std::array{line / height, line % height, x, c}));
          result.set(element, value);
        }
    return {};
  };
  SHALE_TRY_VOID(parallel_for(shape[0] * height, width * channels * element_cost, compute));
  return result;
}

/// An element of operand 0.
int64_t pixel(const Eval& node, int64_t n, int64_t y, int64_t x, int64_t c) {
  const Shape& shape = node.shape(0);
  return node.in(0).get(((n * shape[1] + y) * shape[2] + x) * shape[3] + c);
}

struct Span {
  int64_t begin;
  int64_t end;
};

/// The part of a pool's window that lies inside the input.
Span window(const Eval& node, size_t axis, int64_t out) {
  const int64_t begin =
      out * node.attrs().list(Attr::kStride)[axis] - node.attrs().list(Attr::kPad)[2 * axis];
  return {std::max<int64_t>(begin, 0),
          std::min(begin + node.attrs().list(Attr::kKernel)[axis], node.shape(0)[axis + 1])};
}

/// Source rows or columns of one output coordinate, and how far it lies towards the second.
struct ResizeTap {
  int64_t first;
  int64_t second;
  int64_t distance;  ///< 0 to scale - 1
  int64_t scale;
};

ResizeTap resize_tap(const Eval& node, size_t axis, int64_t out) {
  const int64_t i = static_cast<int64_t>(axis);
  const int64_t scale = node.in(1).get(2 * i), step = node.in(1).get(2 * i + 1);
  const int64_t position = out * step + node.in(2).get(i);
  // position >= -scale, so one scale more makes the division a floor.
  const int64_t at = (position + scale) / scale - 1;
  const int64_t last = node.shape(0)[axis + 1] - 1;
  return {std::max<int64_t>(at, 0), std::min(at + 1, last), position - at * scale, scale};
}

/// function(node, axis, out) for every output coordinate along height (0) or width (1).
template <typename T>
std::vector<T> along_axis(const Eval& node, size_t axis,
                          T (*function)(const Eval&, size_t, int64_t)) {
  std::vector<T> results;
  for (int64_t out = 0; out < node.result_type().shape[axis + 1]; ++out)
    results.push_back(function(node, axis, out));
  return results;
}

}  // namespace

Result<Tensor> eval_pool(const Eval& node) {
  const bool average = node.op() == Op::kAvgPool2d;
  const int64_t input_zp = average ? node.scalar(1) : 0, output_zp = average ? node.scalar(2) : 0;
  const IntRange range = dtype_range(node.result_type().dtype);
  const auto all_rows = along_axis(node, 0, window), all_columns = along_axis(node, 1, window);
  const int64_t window_size =
      node.attrs().list(Attr::kKernel)[0] * node.attrs().list(Attr::kKernel)[1];
  const auto pool = [&](int64_t element, const std::array<int64_t, 4>& at) -> Result<int64_t> {
    const Span rows = all_rows[static_cast<size_t>(at[1])];
    const Span columns = all_columns[static_cast<size_t>(at[2])];
    int64_t sum = 0, largest = range.min;
    for (int64_t y = rows.begin; y < rows.end; ++y)
      for (int64_t x = columns.begin; x < columns.end; ++x) {
        const int64_t value = pixel(node, at[0], y, x, at[3]);
        largest = std::max(largest, value);
        sum += value - input_zp;
      }
    if (!average) return largest;
    const Scale scale = reciprocal_scale((rows.end - rows.begin) * (columns.end - columns.begin));
    const auto mean = apply_scale_32(sum, scale.multiplier, scale.shift, false);
    if (!mean) return node.unpredictable(element, "the sum {} is outside INT32", sum);
    return std::clamp(*mean + output_zp, range.min, range.max);
  };
  return fill_image(node, 8 * window_size, pool);
}

Result<Tensor> eval_resize(const Eval& node) {
  const bool nearest = node.attrs().get(Attr::kMode) == kNearest;
  const auto rows = along_axis(node, 0, resize_tap), columns = along_axis(node, 1, resize_tap);
  return fill_image(node, 32, [&](int64_t, const std::array<int64_t, 4>& at) -> Result<int64_t> {
    const ResizeTap& y = rows[static_cast<size_t>(at[1])];
    const ResizeTap& x = columns[static_cast<size_t>(at[2])];
    const auto in = [&](int64_t row, int64_t column) {
      return pixel(node, at[0], row, column, at[3]);
    };
    if (nearest)
      return in(2 * y.distance >= y.scale ? y.second : y.first,
                2 * x.distance >= x.scale ? x.second : x.first);
    const int64_t y1 = y.distance, y0 = y.scale - y1;
    const int64_t x1 = x.distance, x0 = x.scale - x1;
    return in(y.first, x.first) * y0 * x0 + in(y.first, x.second) * y0 * x1 +
           in(y.second, x.first) * y1 * x0 + in(y.second, x.second) * y1 * x1;
  });
}

}  // namespace shale
