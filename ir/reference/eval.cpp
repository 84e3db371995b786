#include "ir/reference/eval.h"

#include <algorithm>
#include <thread>

namespace shale {

std::string coordinates_text(const Shape& shape, int64_t element) {
  Shape coordinates(shape.size());
  for (size_t axis = shape.size(); axis-- > 0;) {
    coordinates[axis] = element % shape[axis];
    element /= shape[axis];
  }
  return shape_text(coordinates);
}

Shape row_major_strides(const Shape& shape) {
  Shape strides(shape.size());
  int64_t step = 1;
  for (size_t axis = shape.size(); axis-- > 0;) {
    strides[axis] = step;
    step *= shape[axis];
  }
  return strides;
}

Shape broadcast_strides(const Shape& shape) {
  Shape strides = row_major_strides(shape);
  for (size_t axis = 0; axis < shape.size(); ++axis)
    if (shape[axis] == 1) strides[axis] = 0;
  return strides;
}

AxisView::AxisView(const Shape& shape, size_t axis) : dim(shape[axis]) {
  for (size_t i = 0; i < axis; ++i) outer *= shape[i];
  for (size_t i = axis + 1; i < shape.size(); ++i) inner *= shape[i];
}

Result<void> parallel_for(int64_t count, int64_t item_cost, const RangeBody& body) {
  constexpr int64_t kThreadCost = 1 << 18;  // operations that make the start of a thread cheap
  const int64_t processors = std::max<int64_t>(std::thread::hardware_concurrency(), 1);
  const int64_t workers =
      std::clamp<int64_t>(count * item_cost / kThreadCost, 1, std::min(processors, count));
  std::vector<Result<void>> outcomes(static_cast<size_t>(workers));
  const auto work = [&](int64_t worker) {
    outcomes[static_cast<size_t>(worker)] =
        body(count * worker / workers, count * (worker + 1) / workers);
  };
  std::vector<std::thread> threads;
  for (int64_t worker = 1; worker < workers; ++worker) threads.emplace_back(work, worker);
  work(0);
  for (std::thread& thread : threads) thread.join();
  for (Result<void>& outcome : outcomes)
    if (!outcome) return std::move(outcome.error());
  return {};
}

}  // namespace shale
