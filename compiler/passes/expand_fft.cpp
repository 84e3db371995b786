// Writes FFT2D and RFFT2D as matrix products with constant cosines and sines, over the rows and then over the columns, so
// that they need no kernels of their own: products of a complex number by the parts next to each other,
//
//   [re | im] * [ C -S ]  =  [re C + im S | im C - re S],   C, S = cos, sin of 2 pi j k / n
//               [ S  C ]
#include <map>

#include "compiler/passes/pass.h"
#include "ir/reference/real.h"

namespace shale {
namespace {

/// Sizes above have tables that no package should hold: 16 MB for 1024.
constexpr int64_t kMaxExtent = 1024;

/// [1, parts * n, kept] for one part of the result, or [1, parts * n, 2 * kept] for both, of the operands' parts.
Tensor table(int64_t n, int64_t parts, int64_t kept, std::vector<int64_t> wanted, bool inverse) {
  const int64_t columns = kept * static_cast<int64_t>(wanted.size());
  Tensor result = Tensor::zeros({DType::kFp32, {1, parts * n, columns}});
  for (int64_t part = 0; part < parts; ++part)
    for (int64_t j = 0; j < n; ++j)
      for (size_t w = 0; w < wanted.size(); ++w)
        for (int64_t k = 0; k < kept; ++k) {
          const std::complex<double> root = root_of_unity(inverse ? j * k : -(j * k), n);
          const double value = part == wanted[w] ? root.real()
                               : part == 0       ? root.imag()
                                                 : -root.imag();
          result.set_real((part * n + j) * columns + static_cast<int64_t>(w) * kept + k, value);
        }
  return result;
}

class Expansion {
 public:
  explicit Expansion(Graph& graph) : graph_(graph) {}

  Result<Change> run() {
    Change change = Change::kNone;
    const std::vector<Node> nodes = graph_.nodes;
    for (uint32_t i = 0; i < nodes.size(); ++i) {
      if (nodes[i].op == Op::kFft2d || nodes[i].op == Op::kRfft2d) {
        SHALE_TRY_VOID(expand(nodes[i], node_label(graph_, {i})));
        change = Change::kChanged;
      } else {
        result_.push_back(nodes[i]);
      }
    }
    graph_.nodes = std::move(result_);
    return change;
  }

 private:
  ValueId add(Op op, Attrs attrs, std::vector<ValueId> operands, const Shape& shape) {
    return add_to(graph_.add_value(name_, {DType::kFp32, shape}), op, std::move(attrs),
                  std::move(operands));
  }
  ValueId add_to(ValueId to, Op op, Attrs attrs, std::vector<ValueId> operands) {
    result_.push_back({op, std::move(attrs), std::move(operands), to, 0});
    return to;
  }
  ValueId reshaped(ValueId x, const Shape& shape) {
    return add(Op::kReshape, {}, {x, graph_.add_shape(name_, shape)}, shape);
  }
  ValueId transposed(ValueId x, std::vector<int64_t> perms, const Shape& shape) {
    return add(Op::kTranspose, Attrs().set(Attr::kPerms, std::move(perms)), {x}, shape);
  }
  ValueId product(ValueId x, Tensor matrix) {
    const Shape shape{1, graph_.value(x).type.shape[1], matrix.type.shape[2]};
    const ValueId zero = graph_.add_constant(name_, Tensor::zeros({DType::kFp32, {1}}));
    return add(Op::kMatmul, {}, {x, graph_.add_constant(name_, std::move(matrix)), zero, zero},
               shape);
  }

  /// The transformed rows, both parts: [1, N * W', 2 * H].
  ValueId rows(const Node& node, const Shape& in, int64_t kept) {
    const int64_t parts = static_cast<int64_t>(node.inputs.size());
    ValueId x = node.inputs[0];
    if (parts == 2)
      x = add(Op::kConcat, Attrs().set(Attr::kAxis, 2), node.inputs, {in[0], in[1], 2 * in[2]});
    x = product(reshaped(x, {1, in[0] * in[1], parts * in[2]}),
                table(in[2], parts, kept, {0, 1}, node.attrs.flag(Attr::kInverse)));
    x = transposed(reshaped(x, {in[0], in[1], 2, kept}), {0, 3, 2, 1}, {in[0], kept, 2, in[1]});
    return reshaped(x, {1, in[0] * kept, 2 * in[1]});
  }

  Result<void> expand(const Node& node, const std::string& label) {
    const Shape in = graph_.value(node.inputs[0]).type.shape;
    const int64_t kept = graph_.value(node.output).type.shape[2];
    for (const int64_t extent : {in[1], in[2]})
      if (extent > kMaxExtent)
        return unsupported(label, "transforms {} elements on an axis, the limit is {}", extent,
                           kMaxExtent);
    name_ = graph_.value(node.output).name + ".fft";
    Attrs shared = node.attrs;
    shared.set(Attr::kPart, 0);
    const auto key = std::pair{node.inputs, shared};
    auto found = rows_.find(key);
    if (found == rows_.end()) found = rows_.emplace(key, rows(node, in, kept)).first;
    ValueId x = product(found->second, table(in[1], 2, in[1], {node.attrs.get(Attr::kPart)},
                                             node.attrs.flag(Attr::kInverse)));
    x = reshaped(x, {in[0], kept, in[1]});
    add_to(node.output, Op::kTranspose, Attrs().set(Attr::kPerms, std::vector<int64_t>{0, 2, 1}),
           {x});
    return {};
  }

  Graph& graph_;
  std::vector<Node> result_;
  std::string name_;  ///< of new values
  std::map<std::pair<std::vector<ValueId>, Attrs>, ValueId> rows_;
};

}  // namespace

Result<Change> expand_fft(Graph& graph, const PassContext&) { return Expansion(graph).run(); }

}  // namespace shale
