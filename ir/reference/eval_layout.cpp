// ir/reference/eval_layout.cpp -- reductions, data layout, gather and scatter.
#include <algorithm>

#include "ir/reference/eval.h"

namespace shale {
namespace {

/// A tensor walked in any order: the offset of its first element and the step along each axis.
struct View {
  Shape strides;
  int64_t offset = 0;
};

/// Copies `shape` elements from one view to the other; both tensors have the same element type.
void copy_view(const Shape& shape, const Tensor& from, const View& source, Tensor& to,
               const View& target) {
  const auto run = [&]<typename T>(T) {
    const T* in = from.data<T>();
    T* out = to.data<T>();
    for_each_index<2>(shape, {source.strides, target.strides}, {source.offset, target.offset},
                      [&](int64_t, const std::array<int64_t, 2>& at) {
                        out[at[1]] = in[at[0]];
                        return true;
                      });
  };
  switch (from.host_bytes()) {
    case 1: return run(int8_t{});
    case 2: return run(int16_t{});
    case 4: return run(int32_t{});
    default: return run(int64_t{});
  }
}

/// The result is the input read through a view of the result's shape.
Tensor read_view(const Eval& node, const View& source) {
  Tensor result = Tensor::zeros(node.result_type());
  const Shape& shape = result.type.shape;
  copy_view(shape, node.in(0), source, result, {row_major_strides(shape), 0});
  return result;
}

/// A box of `to` that begins at `start`.
View box(const Shape& shape, std::span<const int64_t> start) {
  View view{row_major_strides(shape), 0};
  for (size_t axis = 0; axis < shape.size(); ++axis)
    view.offset += view.strides[axis] * start[axis];
  return view;
}

struct ReduceRow {
  Op op;
  int64_t first;  ///< result of no element
  int64_t (*combine)(int64_t a, int64_t b);
};
constexpr ReduceRow kReduce[] = {
    {Op::kReduceAll, 1, [](int64_t a, int64_t b) { return a & b; }},
    {Op::kReduceAny, 0, [](int64_t a, int64_t b) { return a | b; }},
    {Op::kReduceMax, INT64_MIN, [](int64_t a, int64_t b) { return std::max(a, b); }},
    {Op::kReduceMin, INT64_MAX, [](int64_t a, int64_t b) { return std::min(a, b); }},
    {Op::kReduceSum, 0, [](int64_t a, int64_t b) { return a + b; }},
};

AxisView axis_view(const Eval& node) {
  return {node.shape(0), static_cast<size_t>(node.attrs().get(Attr::kAxis))};
}

}  // namespace

Result<Tensor> eval_argmax(const Eval& node) {
  const AxisView view = axis_view(node);
  Tensor result = Tensor::zeros(node.result_type());
  for (int64_t i = 0; i < result.count(); ++i) {
    const int64_t first = i / view.inner * view.dim * view.inner + i % view.inner;
    const auto value = [&](int64_t k) { return node.in(0).get(first + k * view.inner); };
    int64_t best = 0;
    for (int64_t k = 1; k < view.dim; ++k)
      if (value(k) > value(best)) best = k;
    result.set(i, best);
  }
  return result;
}

Result<Tensor> eval_reduce(const Eval& node) {
  const AxisView view = axis_view(node);
  const auto row = std::ranges::find(kReduce, node.op(), &ReduceRow::op);
  SHALE_CHECK(row != std::end(kReduce));
  Tensor result = Tensor::zeros(node.result_type());
  for (int64_t i = 0; i < result.count(); ++i) {
    const int64_t first = i / view.inner * view.dim * view.inner + i % view.inner;
    int64_t value = row->first;
    for (int64_t k = 0; k < view.dim; ++k)
      value = row->combine(value, node.in(0).get(first + k * view.inner));
    if (!in_range(value, dtype_range(result.type.dtype))) return node.out_of_range(i, value);
    result.set(i, value);
  }
  return result;
}

Result<Tensor> eval_concat(const Eval& node) {
  Tensor result = Tensor::zeros(node.result_type());
  const size_t axis = static_cast<size_t>(node.attrs().get(Attr::kAxis));
  Shape start(result.type.shape.size(), 0);
  for (size_t i = 0; i < node.operand_count(); ++i) {
    copy_view(node.shape(i), node.in(i), {row_major_strides(node.shape(i)), 0}, result,
              box(result.type.shape, start));
    start[axis] += node.shape(i)[axis];
  }
  return result;
}

Result<Tensor> eval_pad(const Eval& node) {
  Tensor result = Tensor::zeros(node.result_type());
  for (int64_t i = 0; i < result.count(); ++i) result.set(i, node.scalar(2));
  Shape before;
  for (size_t axis = 0; axis < node.shape(0).size(); ++axis)
    before.push_back(node.in(1).get(static_cast<int64_t>(2 * axis)));
  copy_view(node.shape(0), node.in(0), {row_major_strides(node.shape(0)), 0}, result,
            box(result.type.shape, before));
  return result;
}

Result<Tensor> eval_reshape(const Eval& node) {
  return Tensor{node.result_type(), node.in(0).bytes};
}

Result<Tensor> eval_reverse(const Eval& node) {
  const size_t axis = static_cast<size_t>(node.attrs().get(Attr::kAxis));
  View view{row_major_strides(node.shape(0)), 0};
  view.offset = (node.shape(0)[axis] - 1) * view.strides[axis];
  view.strides[axis] = -view.strides[axis];
  return read_view(node, view);
}

Result<Tensor> eval_slice(const Eval& node) {
  return read_view(node, box(node.shape(0), node.in(1).ints()));
}

Result<Tensor> eval_tile(const Eval& node) {
  // Every axis becomes two, [multiple, dim], and the input stands still along the first.
  const Shape& input = node.shape(0);
  const Shape strides = row_major_strides(input);
  Shape shape;
  View view;
  for (size_t axis = 0; axis < input.size(); ++axis) {
    shape.insert(shape.end(), {node.in(1).get(static_cast<int64_t>(axis)), input[axis]});
    view.strides.insert(view.strides.end(), {0, strides[axis]});
  }
  Tensor result = Tensor::zeros(node.result_type());
  copy_view(shape, node.in(0), view, result, {row_major_strides(shape), 0});
  return result;
}

Result<Tensor> eval_transpose(const Eval& node) {
  const Shape strides = row_major_strides(node.shape(0));
  View view;
  for (const int64_t axis : node.attrs().list(Attr::kPerms))
    view.strides.push_back(strides[static_cast<size_t>(axis)]);
  return read_view(node, view);
}

namespace {

/// Every element of indices [n,w] is a row of values [n,k,c].
Result<void> check_indices(const Eval& node) {
  const Tensor& indices = node.in(1);
  const int64_t rows = node.shape(0)[1];
  for (int64_t i = 0; i < indices.count(); ++i)
    if (const int64_t index = indices.get(i); !in_range(index, {0, rows - 1}))
      return node.error("the indices have {} at {}, expected 0 to {}", index,
                        coordinates_text(indices.type.shape, i), rows - 1);
  return {};
}

}  // namespace

Result<Tensor> eval_gather(const Eval& node) {
  SHALE_TRY_VOID(check_indices(node));
  const int64_t rows = node.shape(0)[1], width = node.shape(1)[1];
  const int64_t row_bytes = node.shape(0)[2] * node.in(0).host_bytes();
  Tensor result = Tensor::zeros(node.result_type());
  for (int64_t i = 0; i < node.in(1).count(); ++i) {
    const int64_t row = i / width * rows + node.in(1).get(i);
    std::copy_n(node.in(0).bytes.begin() + row * row_bytes, row_bytes,
                result.bytes.begin() + i * row_bytes);
  }
  return result;
}

Result<Tensor> eval_scatter(const Eval& node) {
  SHALE_TRY_VOID(check_indices(node));
  const int64_t rows = node.shape(0)[1], width = node.shape(1)[1], channels = node.shape(0)[2];
  const int64_t row_bytes = channels * node.in(0).host_bytes();
  Tensor result = node.in(0);
  std::vector<bool> written(static_cast<size_t>(node.shape(0)[0] * rows));
  for (int64_t i = 0; i < node.in(1).count(); ++i) {
    const int64_t row = i / width * rows + node.in(1).get(i);
    if (written[static_cast<size_t>(row)])
      return node.unpredictable(row * channels, "written by more than one index");
    written[static_cast<size_t>(row)] = true;
    std::copy_n(node.in(2).bytes.begin() + i * row_bytes, row_bytes,
                result.bytes.begin() + row * row_bytes);
  }
  return result;
}

}  // namespace shale
