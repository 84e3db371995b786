// compiler/kernels/codegen.h -- GLSL for the nodes of a group, shared by all kernel families.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "compiler/kernels/kernel.h"

namespace shale {

/// Where an element is: one GLSL expression per dimension, and the row-major index if somebody has
/// it.
struct Position {
  std::vector<std::string> coords;
  std::string linear = {};  ///< empty if it has to be computed
  /// Of an element of a run along the last dimension: its first coordinate, a multiple of `run`, and how far
  /// from there this element is. What lies in one texel is then fetched once.
  std::string base = {};
  int64_t lane = 0, run = 1;

  bool in_run() const { return run > 1; }
  /// The elements of the run that starts at `first` (a multiple of `length`) along the last dimension.
  static std::vector<Position> run_at(std::vector<std::string> coords, const std::string& first,
                                      int64_t length);
};

/// Turns nodes into GLSL expressions. Registers hold BOOL, INT4, INT8, INT16 and INT32 as `int`,
/// INT48 as `int64_t`, floating-point types as `float`; what computes a value rounds it to its type. Values of the group that are computed already are found in `locals`.
class Codegen {
 public:
  explicit Codegen(const GroupProblem& problem);

  const Graph& graph() const { return graph_; }
  const Value& value(ValueId id) const { return graph_.value(id); }

  /// The binding number of a buffer value; declares it on first use.
  size_t bind(ValueId id, BindingType type, ImageFormat format, bool writes);

  /// The binding number of a buffer (storage or texels) of uvec4 that holds the kernel's own
  /// constants.
  size_t bind_constant(std::vector<uint8_t> bytes, BindingType type = BindingType::kStorageBuffer);

  /// Takes all values that are as large as the group's result as rows of one dimension, where nothing in the group asks
  /// where an element is: runs then go on past the end of the last dimension.
  void flatten_if_elementwise();
  /// Of a value, or of what it was flattened to.
  const Shape& shape_of(ValueId id) const;

  /// Expression for one element of a value: a local, a literal, a call into a folded view, or a
  /// load. `at` is a position in the value's own shape.
  std::string load(ValueId id, const Position& at);
  /// The same of a constant or a value in memory that is seen in another shape of as many elements.
  std::string load_as(ValueId id, const Shape& shape, const Position& at);

  /// The operand of an elementwise node at a position of the node's result, broadcast applied.
  std::string operand(const Node& node, size_t index, const Position& at);

  /// Expression of an elementwise node; its in-group operands must be in locals().
  std::string elementwise(const Node& node, const Position& at);

  /// Appends the elementwise nodes after the head to `body`, in order; `at` is a position of the
  /// group's result. `suffix` keeps locals of unrolled copies apart; `known` is in locals() already.
  void epilogue(std::string& body, const Position& at, const std::string& suffix,
                std::optional<ValueId> known = std::nullopt);

  /// Stores `expression` as an element of the group's result.
  std::string store(ValueId id, const Position& at, const std::string& expression);
  /// The longest runs of the group's result that are within the last dimension, start at a multiple of their length and
  /// fill whole words: `most` elements, a half of it and so on; 1 where none is.
  int64_t run_length(int64_t most) const;
  /// Stores a run of such a length at the position of its first element.
  std::string store_run(const Position& first, const std::vector<std::string>& expressions);

  /// Expression of one element of a view node's result (coordinates in `at`), before folding.
  std::string view(const Node& node, const Position& at);

  /// The same of a CONCAT whose operands fill `extent` along its axis.
  std::string concat(const Node& node, const Position& at, int64_t extent);

  std::map<ValueId, std::string>& locals() { return locals_; }

  /// `#version`, extensions, includes, buffers, functions, then main with `body`.
  std::string finish(const std::string& local_size, const std::string& body) const;

  std::vector<KernelBinding> bindings() const { return bindings_; }

  /// Where the problem asks for cells and there are not too many, makes `source`, whose grid is set, one that
  /// makes the cells of a list: a column of the grid, which writes the positions that `column` tells, by
  /// several of its rows of `row_height` positions. Before finish() and bindings(). The code then may see rows past the grid's
  /// last one, and asks group() and invocation() where it is.
  void take_cells(KernelSource& source, const std::function<Stretch(int64_t)>& column,
                  int64_t row_height);
  /// gl_WorkGroupID and gl_GlobalInvocationID of a grid without cells.
  bool has_cells() const { return cell_columns_ != 0; }
  const char* group() const { return has_cells() ? "group" : "gl_WorkGroupID"; }
  const char* invocation() const { return has_cells() ? "place" : "gl_GlobalInvocationID"; }
  void use_int64() { int64_ = true; }
  /// Reads constant int8 tables through texel buffers, which CPU drivers do for all lanes at once.
  void read_tables_as_texels() { texel_tables_ = true; }
  /// Reads all values of at most so many elements like that.
  void read_as_texels(uint64_t most_elements) {
    texel_tables_ = true;
    most_texels_ = most_elements;
  }
  bool reads_texels() const { return most_texels_ > 0; }
  /// A declaration to appear before main.
  void add_function(std::string text) { functions_ += std::move(text); }

  /// Row-major index expression of a position in `shape`.
  static std::string linear(const Position& at, const Shape& shape);
  /// Position from a row-major index expression.
  static Position split(const std::string& index, const Shape& shape);
  /// GLSL type of a register.
  static const char* register_type(DType dtype) {
    return is_float(dtype) ? "float" : dtype == DType::kInt48 ? "int64_t" : "int";
  }
  /// Declares a register: floats keep the operations and the order that the code gives them.
  static std::string declare(DType dtype, const std::string& name) {
    return fmt::format("{}{} {}", is_float(dtype) ? "precise " : "", register_type(dtype), name);
  }
  /// A decimal literal that GLSL accepts, the most negative int included. A float is given by its bits.
  static std::string literal(int64_t value, DType dtype = DType::kInt32);
  static std::string real_literal(float value);
  /// (value * multiplier + 2^(shift - 1)) >> shift (TOSA apply_scale_32, single rounding) of a value in `range`: in two
  /// products of 32 bits where it is small, else by pairs of words. 1 <= shift <= 62, 0 <= multiplier < 2^31.
  static std::string scaled(const std::string& value, IntRange range, int64_t multiplier,
                            int64_t shift);
  /// `expression` (float) rounded to what `dtype`, a floating-point type, holds.
  static std::string rounded(const std::string& expression, DType dtype) {
    return narrow_call("round_", dtype, expression);
  }
  /// A call of to_..., from_... or round_... of real.glsl for a type of 16 or 8 bits; `x` alone for others.
  static std::string narrow_call(const char* prefix, DType dtype, const std::string& x);
  /// The word of elements that lie together, given as expressions of registers. A maximum with a 0 that the driver
  /// cannot know, `none`, keeps LLVM from packing, or computing an int32, lane by lane in the loop in which Mesa stores: 9 to
  /// 15 % of a layer, 60 % of a RESIZE of int8.
  static std::string packed_word(DType dtype, std::span<const std::string> elements);
  /// A call of max_... or min_... of real.glsl by the node's NaN mode.
  static std::string extremum(const Node& node, const char* which, const std::string& a,
                              const std::string& b);

 private:
  std::string real_elementwise(const Node& node, const Position& at);
  /// Expression of an element of a value in memory, through a texel buffer.
  std::string fetch(ValueId id, const Shape& shape, const Position& at);

  const GroupProblem& problem_;
  const Graph& graph_;
  std::vector<std::optional<NodeId>> producers_;
  std::map<ValueId, std::string> locals_;
  std::vector<KernelBinding> bindings_;
  std::map<std::tuple<ValueId, BindingType, ImageFormat>, size_t> binding_of_;
  std::map<ValueId, std::string> view_functions_;
  std::string functions_;
  bool int64_ = false;
  bool real_ = false;
  bool functions_of_reals_ = false;
  bool texel_tables_ = false;
  uint64_t most_texels_ = 0;
  Shape flat_;                                ///< empty: values have their own shapes
  int64_t cell_columns_ = 0, cell_rows_ = 1;  ///< 0 columns: no cells; rows of the grid in a cell
};

}  // namespace shale
