// compiler/frontend/spirv_graph/module.h -- a SPIR-V graph module taken apart and checked: types,
// constants, variables, graphs and entry points.
#pragma once

#include <unordered_map>
#include <unordered_set>

#include "compiler/frontend/spirv_graph/grammar.h"
#include "compiler/frontend/spirv_graph/spirv_graph.h"

namespace shale::spirv_graph {

/// Largest sum of host bytes of the inline constants that one graph uses. A few words can ask for
/// any size (null, replicated and shared constituents); real modules stay far below.
inline constexpr int64_t kMaxInlineBytes = int64_t{1} << 26;

/// Largest size, roughly, of the interfaces of all entry points with their names, and of the lists
/// of their constants: entry points may share variables and graphs, so the file's size is no bound.
inline constexpr size_t kMaxListingBytes = size_t{1} << 26;

/// Most tensors of one array of an interface: a few words can ask for any number.
inline constexpr int64_t kMaxArrayTensors = 1024;

/// External constants by GraphConstantID.
using ExternalData = std::map<uint32_t, const ExternalConstant*>;

struct Type {
  enum class Kind : uint8_t { kScalar, kTensor, kArray, kStruct, kPointer, kGraph, kOther };
  Kind kind = Kind::kOther;
  DType dtype = DType::kUnknown;  ///< scalar, tensor
  bool ranked = false;            ///< tensor
  bool shaped = false;            ///< tensor
  Shape shape;                    ///< tensor: as long as the rank, kDynamic unless shaped
  uint32_t element = 0;           ///< array, pointer: type id
  int64_t length = 0;             ///< array
  uint32_t storage_class = 0;     ///< pointer
  uint32_t input_count = 0;       ///< graph: entries that are inputs
  std::vector<uint32_t> entries;  ///< graph: type ids, inputs first; struct: of its members
  /// Graph: number of the first tensor of each entry, and of all; an array has one for each element.
  std::vector<uint32_t> first_tensor;
  uint32_t input_tensors() const { return first_tensor[input_count]; }
};

struct Constant {
  enum class Kind : uint8_t { kScalar, kComposite, kReplicate, kNull, kExternal, kOther };
  Kind kind = Kind::kOther;
  uint32_t type = 0;
  int64_t value = 0;         ///< scalar: sign-extended bits
  size_t first_part = 0;     ///< composite, replicate: word of the first constituent's id
  size_t part_count = 0;     ///< composite
  uint32_t external_id = 0;  ///< external: GraphConstantID
};

struct Variable {
  uint32_t type = 0;  ///< pointer
  uint32_t storage_class = 0;
};

/// `tensor` counts the inputs or outputs of the graph, elements of arrays each.
struct GraphInput {
  uint32_t id, tensor;
};
struct GraphOutput {
  uint32_t value, tensor;
};
struct GraphDefinition {
  uint32_t type = 0;
  size_t at = 0;  ///< word of OpGraphARM
  std::vector<GraphInput> inputs;
  std::vector<size_t> body;          ///< words of OpExtInst and OpCompositeExtract
  std::vector<GraphOutput> outputs;  ///< every output, in order
};

struct EntryPoint {
  size_t at = 0;
  uint32_t graph = 0;  ///< id
  std::string name;
  std::vector<uint32_t> interface;  ///< variable ids
};

class Module {
 public:
  /// Reads and checks everything but the operators.
  static Result<Module> parse(std::span<const uint8_t> bytes);

  std::vector<uint32_t> words;
  std::vector<EntryPoint> entry_points;
  std::unordered_map<uint32_t, std::string> names;
  std::unordered_map<uint32_t, uint32_t> sets, bindings;

  /// What an id is, or null.
  const Type* type(uint32_t id) const { return find(Kind::kType, id, types_); }
  const Constant* constant(uint32_t id) const { return find(Kind::kConstant, id, constants_); }
  const Variable* variable(uint32_t id) const { return find(Kind::kVariable, id, variables_); }
  const GraphDefinition* graph(uint32_t id) const { return find(Kind::kGraph, id, graphs_); }
  const std::string* import(uint32_t id) const { return find(Kind::kImport, id, imports_); }

  /// "word 57 (OpExtInst)".
  std::string where(size_t at) const;
  /// OpName, or empty.
  std::string name(uint32_t id) const;
  /// The tensors of an interface, inputs first.
  std::vector<SpirvEntryPoint::Slot> slots(const EntryPoint& entry) const;
  /// External constants that a graph uses, by GraphConstantID, with their types; sizes that the
  /// module leaves open are kDynamic, [?] where it does not know the rank either.
  std::map<uint32_t, TensorType> external_constants(const GraphDefinition& graph) const;

  /// Element type and shape of a shaped tensor or of an array of scalars.
  std::optional<TensorType> data_type(const Type& type) const;
  /// All elements of a constant with a data_type, or of an external one with the type that its data
  /// give it; `budget` is what inline constants may still take.
  Result<Tensor> tensor(uint32_t constant_id, const ExternalData& external, int64_t& budget) const;

 private:
  enum class Kind : uint8_t { kType, kConstant, kVariable, kGraph, kImport, kValue, kOther };
  struct Definition {
    Kind kind;
    size_t index;
  };
  /// A result of the body or an input, with the graph that it belongs to.
  struct GraphValue {
    uint32_t type;
    size_t graph;
  };
  struct Instruction {
    size_t at;
    const OpcodeInfo* info;
    std::span<const uint32_t> words;

    Opcode opcode() const { return info->opcode; }
    uint32_t operator[](size_t i) const { return words[i]; }
    size_t size() const { return words.size(); }
  };

  template <typename T>
  const T* find(Kind kind, uint32_t id, const std::vector<T>& list) const {
    const auto found = definitions_.find(id);
    return found == definitions_.end() || found->second.kind != kind ? nullptr
                                                                     : &list[found->second.index];
  }
  template <typename... Args>
  Error bad(const Instruction& instruction, fmt::format_string<Args...> format,
            Args&&... args) const {
    return bad_input(where(instruction.at), format, std::forward<Args>(args)...);
  }

  Result<Instruction> instruction_at(size_t at) const;
  Result<void> read(const Instruction& instruction);
  Result<void> read_in_graph(const Instruction& instruction);
  Result<void> read_type(const Instruction& instruction);
  Result<void> read_tensor_type(const Instruction& instruction, Type& type);
  Result<void> read_graph_type(const Instruction& instruction, Type& type);
  Result<void> read_constant(const Instruction& instruction);
  Result<void> check_parts(const Instruction& instruction, const TensorType& data,
                           int64_t expected) const;
  /// The tensor of a graph's type that an index and, for an array, an element index say.
  struct GraphTensor {
    uint32_t number = 0;  ///< among inputs and outputs
    uint32_t type = 0;
  };
  Result<GraphTensor> graph_tensor(const Instruction& instruction, bool is_input,
                                   size_t first_operand) const;
  Result<void> read_graph_input(const Instruction& instruction);
  Result<void> read_graph_output(const Instruction& instruction);
  Result<void> read_extract(const Instruction& instruction);
  Result<void> end_graph(const Instruction& instruction);
  Result<void> check_entry_point(const EntryPoint& entry) const;
  Result<Shape> shape_value(const Instruction& instruction, uint32_t id, size_t rank) const;
  Result<int64_t> integer(const Instruction& instruction, std::string_view what, uint32_t id) const;
  Result<std::string> string(const Instruction& instruction, size_t first, size_t* end) const;
  Result<void> define(const Instruction& instruction, uint32_t id, Kind kind, size_t index);
  Result<Tensor> external_tensor(uint32_t constant_id, const ExternalData& external) const;
  Result<void> expand(uint32_t constant_id, const ExternalData& external, int64_t first,
                      Tensor& tensor) const;

  uint32_t bound_ = 0;
  std::unordered_map<uint32_t, Definition> definitions_;
  std::vector<Type> types_;
  std::vector<Constant> constants_;
  std::vector<Variable> variables_;
  std::vector<GraphDefinition> graphs_;
  std::vector<std::string> imports_;
  std::vector<GraphValue> values_;
  std::unordered_map<uint32_t, size_t> external_ids_;  ///< GraphConstantID -> word
  std::unordered_set<uint32_t> seen_tensors_;          ///< of the graph being read
  bool in_graph_section_ = false, in_graph_ = false;
};

}  // namespace shale::spirv_graph
