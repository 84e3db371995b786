// compiler/frontend/spirv_graph/spirv_graph.h -- SPIR-V graph modules (SPV_ARM_tensors,
// SPV_ARM_graph, TOSA.001000.1) to and from Graph.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

/// What the outside knows of one interface variable, as a VGF resource table does.
struct ExternalTensor {
  uint32_t set = 0;
  uint32_t binding = 0;
  TensorType type;   ///< kUnknown: the module's element type; an empty shape says nothing, kDynamic
                     ///< leaves one size open
  std::string name;  ///< empty: the module's
};

/// Bytes of an external graph constant: row-major, little-endian, BOOL 1 byte, INT48 8 bytes.
struct ExternalConstant {
  uint32_t id = 0;  ///< GraphConstantID
  std::span<const uint8_t> bytes;
  Shape shape = {};  ///< for a constant whose shape the module leaves open; empty: not known
};

struct SpirvGraphOptions {
  std::string entry_point;                  ///< empty: the only one
  std::vector<ExternalTensor> interface;    ///< types and names of variables, by set and binding
  std::vector<ExternalConstant> constants;  ///< by GraphConstantID; more than are used may be given
  std::map<std::string, Shape> input_shapes;  ///< by input name, for inputs whose rank nobody knows
};

/// True if the bytes begin with the magic number of SPIR-V, in either byte order.
bool is_spirv(std::span<const uint8_t> bytes);

/// One graph entry point of a module.
struct SpirvEntryPoint {
  /// One tensor; a variable that is an array has several, of one set and binding.
  struct Slot {
    std::string
        name;  ///< OpName of the variable, ".2" for element 2 of an array behind it; or empty
    uint32_t set = 0;
    uint32_t binding = 0;
    TensorType type;                       ///< sizes that the module leaves open are kDynamic
    bool ranked = false;                   ///< false: the shape is empty and says nothing
    std::optional<uint32_t> element = {};  ///< of an array
  };
  std::string name;
  std::vector<Slot> inputs;
  std::vector<Slot> outputs;
  std::vector<uint32_t> constant_ids;      ///< GraphConstantIDs that the graph uses, ascending
  std::vector<TensorType> constant_types;  ///< type of each of them
};

/// Reads the module's structure by all rules that read_spirv_graph applies to it, but no operator.
/// Errors: as read_spirv_graph.
Result<std::vector<SpirvEntryPoint>> list_spirv_entry_points(std::span<const uint8_t> bytes);

/// Reads one graph of an untrusted module. Constant operands that TOSA has as shapes become shape
/// values; a 64-bit integer is INT48. Only the constants that the graph uses are decoded. Names are
/// those of the interface (outside, then OpName of the variable), then OpName, then made up;
/// doubles get a suffix. An output that repeats an input, a constant or an earlier output under
/// another name becomes an IDENTITY. Sizes that neither module nor options know stay kDynamic; a
/// result of unknown rank is [?] until its operands are known. Results whose operands are known get
/// their type by the operator's rule. The graph is well formed, but verify has still to check it.
/// Errors: kBadInput for a broken module, kUnsupported for what SPIR-V has and Shale has not;
/// `where` is the word offset with the instruction's name, or the input, output or graph constant.
/// Source: SPV_ARM_tensors revision 2, SPV_ARM_graph revision 3, TOSA.001000.1 revision 2.
Result<Graph> read_spirv_graph(std::span<const uint8_t> bytes, const SpirvGraphOptions& options);

struct SpirvGraphModule {
  std::vector<uint32_t> words;
  std::vector<Tensor> constants;  ///< GraphConstantID i takes constants[i]; empty if all are inline
  std::string entry_point;        ///< the graph's name
};

struct SpirvWriteOptions {
  /// Weights, biases, tables and other tensor operands become graph constants. Attributes, shapes,
  /// zero points, multipliers and shifts stay inline.
  bool external_constants = false;
  /// False writes what breaks TOSA's rules too, as far as it has a form: to try readers with.
  bool verified = true;
};

/// Writes SPIR-V 1.5 with one graph. Binding i of set 0 is input i; outputs follow the inputs.
/// read_spirv_graph gives the same graph again but for what the format has not: IDENTITY becomes an
/// alias, INT4 becomes INT8, rank 0 becomes [1] (all three in the interface too: ask
/// list_spirv_entry_points for its types), an unknown NaN mode becomes PROPAGATE. Results are
/// equal. A type with an open size has its rank alone; a result that is [?] has not even that.
/// Errors: those of verify; kUnsupported, naming the value, for what does not fit an instruction's
/// 16-bit length: an inline constant with more than 65,532 elements on an axis, a name of more than
/// 260,000 bytes, an interface of more tensors than its instruction holds.
Result<SpirvGraphModule> write_spirv_graph(const Graph& graph, const SpirvWriteOptions& options);

}  // namespace shale
