// products: conv2d, conv3d and matmul on CPU drivers whose factors are both read from memory: FP32, FP16, and INT8 with
// weights that are not constant.
//
// Meaning of a workgroup: 8 invocations of a row; one makes `rows_` rows (output channels, or rows of the first matrix) of
// `columns_` columns (pixels next to each other, or columns of the second matrix). A fetch is some 60 instructions of the driver's,
// for 16 bytes a lane, so tiles are large: 16 rows of 16 columns fetch 32 times for 1024 products of FP32. Their sums are more than
// there are registers, so that a turn of the loop takes each once: products of a sum stand together, and rows are outside of columns, so that
// what a row brings stays in registers.
//
// The order of a sum is the interpreter's, kernel planes, rows, columns, then channels, each operation rounded alone: on a
// driver that keeps subnormal numbers floats have the interpreter's bits. INT8 is summed in float32 while no sum can leave
// 2^24, in runs of that length.
//
// Tried, not kept: weights as literals, which serve int8 (they hardly repeat, so that LLVM keeps each as 32 bytes on the stack, and
// the driver compiles for half a minute); a fetch of 8 rows by 8 lanes and subgroupBroadcast (Mesa 22.3 looks for the lane in a loop
// over all of them, 70 instructions for each number). Source: ours.
#include <algorithm>
#include <cmath>
#include <functional>

#include "compiler/kernels/codegen.h"
#include "compiler/kernels/literal_conv.h"

namespace shale {
namespace {

constexpr int64_t kLocal = 8;        ///< invocations of a workgroup, along the columns
constexpr int64_t kProducts = 1024;  ///< most products of a turn: what the processor keeps decoded

class ProductsEmitter {
 public:
  ProductsEmitter(const GroupProblem& problem, const DeviceProfile& profile)
      : problem_(problem),
        graph_(*problem.graph),
        node_(graph_.node(*problem.group.head)),
        codegen_(problem),
        out_(shape(node_.output)),
        is_real_(is_float(graph_.value(node_.output).type.dtype)),
        is_matmul_(node_.op == Op::kMatmul) {
    codegen_.read_as_texels(profile.caps.max_texel_elements);
    const Shape& weight = shape(node_.inputs[1]);
    if (is_matmul_)
      sizes_ = {1, shape(node_.inputs[0])[2]};
    else
      sizes_.assign(weight.begin() + 1, weight.end());
    step_ = 16 / dtype_info(graph_.value(node_.inputs[0]).type.dtype).host_bytes;
    if (is_matmul_) step_ = std::min<int64_t>(step_, 4);
    while (sizes_.back() % step_ != 0) step_ /= 2;
    choose_tile();
    parts_ = {node_.inputs[is_matmul_ ? 1 : 0]};
    const std::optional<NodeId> producer = graph_.producers()[parts_[0].index];
    if (is_matmul_ || !producer || !problem.group.contains(*producer)) return;
    const Node& view = graph_.node(*producer);
    if (view.op == Op::kConcat &&
        view.attrs.get(Attr::kAxis) == static_cast<int64_t>(out_.size()) - 1)
      parts_ = view.inputs;
  }

  bool fits() const {
    return grid_x() <= kMaxWorkgroups && grid_y() <= kMaxWorkgroups && grid_z() <= kMaxWorkgroups &&
           (is_real_ || largest_product() * 4 < kFloatExact);
  }

  /// Products, with those that fill tiles and blocks.
  double macs() const {
    double all = static_cast<double>(grid_x() * kLocal * columns_) * static_cast<double>(grid_y()) *
                 static_cast<double>(grid_z() * (is_matmul_ ? 1 : rows_));
    if (is_matmul_) all *= static_cast<double>(rows_);
    for (const int64_t size : sizes_) all *= static_cast<double>(size);
    return all;
  }

  KernelSource emit() {
    std::string text =
        fmt::format("  int x = int(gl_GlobalInvocationID.x) * {};\n  if (x >= {}) return;\n",
                    columns_, extent_columns());
    if (is_matmul_) {
      text += fmt::format("  int n = int(gl_WorkGroupID.z), row = int(gl_WorkGroupID.y) * {};\n",
                          rows_);
    } else {
      text += fmt::format(
          "  int n = int(gl_WorkGroupID.z) / {0}, row = int(gl_WorkGroupID.z) % {0} * {1};\n",
          blocks(), rows_);
      text += out_.size() == 5 ? fmt::format(
                                     "  int z = int(gl_WorkGroupID.y) / {0}, y = "
                                     "int(gl_WorkGroupID.y) % {0};\n",
                                     out_[2])
                               : "  int y = int(gl_WorkGroupID.y);\n";
    }
    text += fmt::format("  uint none = uint(x >= {});\n", INT32_MAX);
    // Rows past the end are made of the last one, and not stored.
    for (int64_t i = 0; i < rows_; ++i)
      text += extent_rows() % rows_ == 0
                  ? fmt::format("  int row{0} = row + {0};\n", i)
                  : fmt::format("  int row{0} = min(row + {0}, {1});\n", i, extent_rows() - 1);
    for_sums([&](const std::string& at) {
      text += fmt::format("  precise float a{0} = 0.0;\n{1}", at,
                          is_whole() ? "" : fmt::format("  int i{} = 0;\n", at));
    });
    text += is_matmul_ ? along_matrices() : taps();
    for (int64_t i = 0; i < (is_matmul_ ? rows_ : columns_); ++i)
      text += is_matmul_ ? results_of_row(i) : results_of_pixel(i);
    KernelSource source;
    source.glsl = codegen_.finish(fmt::format("local_size_x = {}", kLocal), text);
    source.workgroups = {static_cast<uint32_t>(grid_x()), static_cast<uint32_t>(grid_y()),
                         static_cast<uint32_t>(grid_z())};
    source.bindings = codegen_.bindings();
    return source;
  }

 private:
  const Shape& shape(ValueId id) const { return graph_.value(id).type.shape; }
  /// The tile of the least work, idle lanes and what is past the end counted: a fetch for each row and column of it serves
  /// its products.
  void choose_tile() {
    double least = 0;
    for (int64_t rows = 4; rows <= 16; rows += 4)
      for (int64_t columns = 1; columns <= 16; ++columns) {
        if (rows * columns * step_ > kProducts || columns > extent_columns()) continue;
        if (is_matmul_ && (extent_columns() % columns != 0 || (columns & (columns - 1)) != 0))
          continue;
        const double area =
            static_cast<double>(ceil_div(extent_rows(), rows) * rows) *
            static_cast<double>(ceil_div(ceil_div(extent_columns(), columns), kLocal) * kLocal *
                                columns);
        const double fetches = 60.0 / static_cast<double>(step_) *
                               static_cast<double>(rows + columns) /
                               static_cast<double>(rows * columns);
        const double work = area * (fetches + 2.75);
        if (rows_ != 0 && work >= least) continue;
        least = work, rows_ = rows, columns_ = columns;
      }
  }
  int64_t extent_rows() const { return is_matmul_ ? out_[1] : out_.back(); }
  int64_t extent_columns() const { return out_[out_.size() - (is_matmul_ ? 1 : 2)]; }
  int64_t blocks() const { return ceil_div(extent_rows(), rows_); }
  int64_t grid_x() const { return ceil_div(ceil_div(extent_columns(), columns_), kLocal); }
  int64_t grid_y() const {
    return is_matmul_ ? blocks() : out_.size() == 5 ? out_[1] * out_[2] : out_[1];
  }
  int64_t grid_z() const { return is_matmul_ ? out_[0] : out_[0] * blocks(); }

  /// Zero points of what the columns and the rows bring.
  int64_t zero_point(bool of_rows) const {
    if (is_real_) return 0;
    const size_t operand = is_matmul_ ? (of_rows ? 2 : 3) : (of_rows ? 4 : 3);
    return graph_.value(node_.inputs[operand]).constant->get(0);
  }
  int64_t largest(ValueId id, int64_t zero_point) const {
    const IntRange range = value_range(graph_, id);
    return std::max(
        {std::abs(range.min - zero_point), std::abs(range.max - zero_point), int64_t{1}});
  }
  int64_t largest_product() const {
    return largest(node_.inputs[is_matmul_ ? 1 : 0], zero_point(false)) *
           largest(node_.inputs[is_matmul_ ? 0 : 1], zero_point(true));
  }
  /// The products that one float may sum.
  int64_t longest_sum() const {
    return is_real_ ? INT64_MAX : (kFloatExact - 1) / largest_product();
  }
  int64_t summed() const {
    int64_t all = 1;
    for (const int64_t size : sizes_) all *= size;
    return all;
  }
  bool is_whole() const { return summed() <= longest_sum(); }

  template <typename Function>
  void for_sums(Function function) const {
    for (int64_t c = 0; c < columns_; ++c)
      for (int64_t r = 0; r < rows_; ++r) function(fmt::format("{}_{}", c, r));
  }

  /// A loop that is left at its end: after a condition at its start CPU drivers run the body once more, for no lane.
  static std::string loop(const std::string& name, const std::string& from, const std::string& end,
                          const std::string& body, int64_t step = 1) {
    return fmt::format(
        "  {{\n  int {0} = {1};\n  for (;;) {{\n{2}  {0} += {3};\n  if ({0} >= {4}) break;\n  }}\n "
        " "
        "}}\n",
        name, from, body, step, end);
  }
  static std::string loop(const std::string& name, int64_t end, const std::string& body,
                          int64_t step = 1) {
    if (end <= step) return fmt::format("  {{\n  const int {} = 0;\n{}  }}\n", name, body);
    return loop(name, "0", std::to_string(end), body, step);
  }

  std::string take_sums() const {
    std::string text;
    for_sums([&](const std::string& at) {
      text += fmt::format("  i{0} += int(a{0}); a{0} = 0.0;\n", at);
    });
    return text;
  }

  /// A loop over `count` channels, `step` a turn; where the sums are not whole, taken after as many as they may hold.
  std::string along(int64_t count, int64_t step, const std::string& turn) const {
    if (is_whole()) return loop("c", count, turn, step);
    const int64_t run = longest_sum() / step * step;
    if (run >= count) return loop("c", count, turn, step) + take_sums();
    return loop(
        "from", count,
        loop("c", "from", fmt::format("min(from + {}, {})", run, count), turn, step) + take_sums(),
        run);
  }

  /// `(x - zero point)` as a float.
  std::string as_float(const std::string& x, bool of_rows) const {
    if (is_real_) return x;
    const int64_t zp = zero_point(of_rows);
    return zp == 0 ? fmt::format("float({})", x)
                   : fmt::format("float({} - {})", x, Codegen::literal(zp));
  }

  /// Registers w<row>_<channel>: what the rows bring in `step` channels from `first` on.
  std::string fetch_rows(ValueId id, const std::vector<std::string>& tap, const std::string& first,
                         int64_t step) {
    std::string text;
    for (int64_t r = 0; r < rows_; ++r) {
      std::vector<std::string> coords = tap;
      coords.insert(coords.begin() + (is_matmul_ ? 1 : 0), fmt::format("row{}", r));
      coords.emplace_back();
      for (const Position& c : Position::run_at(coords, first, step))
        text +=
            fmt::format("  float w{}_{} = {};\n", r, c.lane, as_float(codegen_.load(id, c), true));
    }
    return text;
  }
  /// Adds the products of `step` channels, of the registers v<column>_<channel> and w<row>_<channel>.
  std::string add_products(int64_t step) const {
    std::string text;
    for (int64_t r = 0; r < rows_; ++r)
      for (int64_t c = 0; c < columns_; ++c)
        for (int64_t k = 0; k < step; ++k)
          text += fmt::format("  a{0}_{1} += v{0}_{2} * w{1}_{2};\n", c, r, k);
    return text;
  }

  std::string along_matrices() {
    std::string turn = fetch_rows(node_.inputs[0], {"n"}, "c", step_);
    for (int64_t k = 0; k < step_; ++k)
      for (const Position& at :
           Position::run_at({"n", fmt::format("(c + {})", k), ""}, "x", columns_))
        turn += fmt::format("  float v{}_{} = {};\n", at.lane, k,
                            as_float(codegen_.load(node_.inputs[1], at), false));
    return along(sizes_[1], step_, turn + add_products(step_));
  }

  bool has_outside(size_t axis) const {
    const std::span<const int64_t> pad = node_.attrs.list(Attr::kPad);
    return pad[2 * axis] != 0 || pad[2 * axis + 1] != 0;
  }

  std::string taps() {
    const auto ints = [&](Attr attr) { return node_.attrs.list(attr); };
    const auto pad = ints(Attr::kPad), stride = ints(Attr::kStride),
               dilation = ints(Attr::kDilation);
    const size_t axes = out_.size() - 2;  // the last one is along the columns
    const char* const names = axes == 3 ? "zyx" : "yx";
    const Shape& in = shape(node_.inputs[0]);
    // A place outside reads another and counts as 0, without a branch, both sides of which run anyway.
    std::string text, inside;
    for (size_t axis = 0; axis < axes; ++axis) {
      const char name = names[axis];
      text += fmt::format("  int i{0} = {0} * {1} - {2} + k{0} * {3};\n", name, stride[axis],
                          pad[2 * axis], dilation[axis]);
      if (axis + 1 == axes || !has_outside(axis)) continue;
      text += fmt::format("  bool in_{0} = uint(i{0}) < {1}u;\n  i{0} = in_{0} ? i{0} : 0;\n", name,
                          in[axis + 1]);
      inside += fmt::format("in_{} && ", name);
    }
    for (int64_t p = 0; p < columns_; ++p)
      text += fmt::format(
          "  int x{0} = ix + {1};\n  bool in{0} = {3}uint(x{0}) < {2}u;\n"
          "  x{0} = in{0} ? x{0} : 0;\n",
          p, p * stride[axes - 1], in[axes], inside);
    int64_t first = 0;
    for (const ValueId part : parts_) {
      text += products(part, first);
      first += shape(part).back();
    }
    for (size_t axis = axes; axis-- > 0;)
      text = loop(fmt::format("k{}", names[axis]), sizes_[axis], text);
    return text;
  }

  /// What one of the tensors adds that are read as one, from channel `first` on.
  std::string products(ValueId part, int64_t first) {
    const TensorType& type = graph_.value(part).type;
    const int64_t count = type.shape.back();
    int64_t step = step_;
    while (count % step != 0 || first % step != 0) step /= 2;
    const bool is_3d = out_.size() == 5;
    const std::span<const int64_t> pad = node_.attrs.list(Attr::kPad);
    const bool padded = std::any_of(pad.begin(), pad.end(), [](int64_t p) { return p != 0; });
    std::string turn;
    for (int64_t p = 0; p < columns_; ++p) {
      std::vector<std::string> coords{"n"};
      if (is_3d) coords.push_back("iz");
      coords.insert(coords.end(), {"iy", fmt::format("x{}", p), ""});
      for (const Position& c : Position::run_at(coords, "c", step))
        turn += fmt::format(
            "  float v{0}_{1} = {2};\n{3}", p, c.lane, as_float(codegen_.load(part, c), false),
            padded ? fmt::format("  v{0}_{1} = in{0} ? v{0}_{1} : 0.0;\n", p, c.lane) : "");
    }
    std::vector<std::string> tap{"ky", "kx"};
    if (is_3d) tap.insert(tap.begin(), "kz");
    turn +=
        fetch_rows(node_.inputs[1], tap, first == 0 ? "c" : fmt::format("(c + {})", first), step);
    return along(count, step, turn + add_products(step));
  }

  /// The head's result, for column `column` and row `row`; `bias` is empty for a matrix product.
  std::string head(int64_t column, int64_t row, const std::string& bias) const {
    const std::string at = fmt::format("{}_{}", column, row);
    std::string sum = is_real_ ? "a" + at : is_whole() ? fmt::format("int(a{})", at) : "i" + at;
    if (!bias.empty()) sum = fmt::format("({} + {})", sum, bias);
    return Codegen::rounded(sum, graph_.value(node_.output).type.dtype);
  }

  /// Bias, the nodes behind and the stores of elements next to each other.
  std::string results(const std::vector<Position>& run, bool whole, int64_t end,
                      const std::function<std::string(size_t element)>& head) {
    const DType dtype = graph_.value(node_.output).type.dtype;
    const int64_t length = whole ? codegen_.run_length(static_cast<int64_t>(run.size())) : 1;
    std::string text;
    std::vector<std::string> values;
    Position run_start;
    for (size_t i = 0; i < run.size(); ++i) {
      const Position at = whole ? run[i] : Position{.coords = run[i].coords};
      const std::string own = fmt::format("{}_{}", runs_, i);
      if (!whole) text += fmt::format("  if ({} < {}) {{\n", at.coords.back(), end);
      text += fmt::format("  {} = {};\n", Codegen::declare(dtype, "h" + own), head(i));
      codegen_.locals()[node_.output] = "h" + own;
      codegen_.epilogue(text, at, own);
      const std::string value = codegen_.load(problem_.group.result, at);
      if (length == 1) {
        text += codegen_.store(problem_.group.result, {.coords = at.coords}, value);
        if (!whole) text += "  }\n";
        continue;
      }
      if (values.empty()) run_start = at;
      values.push_back(value);
      if (static_cast<int64_t>(values.size()) < length) continue;
      // A run shorter than the block begins where its own first element is.
      run_start.base = run_start.coords.back();
      text += codegen_.store_run(run_start, values);
      values.clear();
    }
    ++runs_;
    return text;
  }

  std::string results_of_pixel(int64_t pixel) {
    const ValueId bias = node_.inputs[2];
    const bool is_one = shape(bias)[0] == 1;
    const bool whole = out_.back() % rows_ == 0;
    std::vector<std::string> coords{"n", "y", fmt::format("(x + {})", pixel), ""};
    if (out_.size() == 5) coords.insert(coords.begin() + 1, "z");
    const std::vector<Position> run = Position::run_at(coords, "row", rows_);
    const auto element = [&](size_t i) {
      Position channel = whole ? run[i] : Position{};
      channel.coords = {is_one ? "0" : run[i].coords.back()};
      if (is_one) channel = {.coords = channel.coords};
      return head(pixel, static_cast<int64_t>(i), codegen_.load(bias, channel));
    };
    return fmt::format("  if (x + {} < {}) {{\n", pixel, extent_columns()) +
           results(run, whole, out_.back(), element) + "  }\n";
  }

  std::string results_of_row(int64_t row) {
    const std::vector<Position> run =
        Position::run_at({"n", fmt::format("(row + {})", row), ""}, "x", columns_);
    return fmt::format("  if (row + {} < {}) {{\n", row, out_[1]) +
           results(run, true, out_[2],
                   [&](size_t i) { return head(static_cast<int64_t>(i), row, ""); }) +
           "  }\n";
  }

  const GroupProblem& problem_;
  const Graph& graph_;
  const Node& node_;
  Codegen codegen_;
  const Shape& out_;
  bool is_real_, is_matmul_;
  int64_t rows_ = 0, columns_ = 0;  ///< of a tile
  int64_t step_ = 0;                ///< channels of a turn: those of a fetch
  Shape sizes_;                     ///< of a sum: taps and channels
  std::vector<ValueId> parts_;  ///< what the columns bring, one after the other along the channels
  int runs_ = 0;
};

/// What is multiplied with the zeros around a picture has to be finite.
bool is_finite(const Value& weight) {
  if (!weight.is_constant()) return false;
  for (int64_t i = 0; i < weight.constant->count(); ++i)
    if (!std::isfinite(bits_real(weight.type.dtype, weight.constant->get(i)))) return false;
  return true;
}

}  // namespace

bool products_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!profile.literal_weights || !problem.group.head) return false;
  const Graph& graph = *problem.graph;
  const Node& node = graph.node(*problem.group.head);
  if ((node.op != Op::kConv2d && node.op != Op::kConv3d && node.op != Op::kMatmul) ||
      op_kind(graph.node(problem.group.nodes.back())) == OpKind::kView)
    return false;
  const DType dtype = graph.value(node.inputs[0]).type.dtype,
              weight = graph.value(node.inputs[1]).type.dtype;
  if (dtype != weight ||
      (dtype != DType::kFp32 && dtype != DType::kFp16 && dtype != DType::kInt8) ||
      (dtype == DType::kInt8 && graph.value(node.output).type.dtype != DType::kInt32))
    return false;
  // Where INT8 weights are constant, other families know them.
  if (node.op == Op::kConv2d && dtype == DType::kInt8 && graph.value(node.inputs[1]).is_constant())
    return false;
  if (node.op != Op::kMatmul && dtype != DType::kInt8) {
    const std::span<const int64_t> pad = node.attrs.list(Attr::kPad);
    const bool is_padded = std::any_of(pad.begin(), pad.end(), [](int64_t p) { return p != 0; });
    if (is_padded && !is_finite(graph.value(node.inputs[1]))) return false;
  }
  return buffer_count(graph, problem.group.nodes) <=
             std::min<uint64_t>({profile.caps.max_storage_buffers, profile.caps.max_texel_buffers,
                                 kMaxBindings}) &&
         ProductsEmitter(problem, profile).fits();
}

WorkTable products_work(const GroupProblem& problem, const DeviceProfile& profile) {
  WorkTable work{};
  work[Work::kDispatch] = 1;
  work[Work::kRealMac] = ProductsEmitter(problem, profile).macs();
  work[Work::kRunResult] = static_cast<double>(
      element_count(problem.graph->value(problem.group.result).type.shape).value_or(0));
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

Result<std::vector<KernelSource>> products_emit(const GroupProblem& problem,
                                                const DeviceProfile& profile) {
  return std::vector<KernelSource>{ProductsEmitter(problem, profile).emit()};
}

}  // namespace shale
