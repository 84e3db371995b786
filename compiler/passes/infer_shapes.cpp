// Gives graph inputs their final shapes and recomputes the result type of every node.
#include <algorithm>

#include "compiler/passes/pass.h"
#include "ir/verify/verify.h"

namespace shale {

Result<Change> infer_shapes(Graph& graph, const PassContext& context) {
  Change change = Change::kNone;
  for (const auto& [name, shape] : context.input_shapes) {
    const std::optional<ValueId> id = graph.find_value(name);
    const bool is_input =
        id && std::find(graph.inputs.begin(), graph.inputs.end(), *id) != graph.inputs.end();
    if (!is_input) return bad_input("--input-shape", "the graph has no input \"{}\"", name);
    Value& input = graph.value(*id);
    if (!element_count(shape))
      return bad_input("--input-shape", "{} is no shape for input \"{}\"", shape_text(shape), name);
    if (input.type.shape.size() != shape.size())
      return bad_input("--input-shape", "input \"{}\" has rank {}, found {}", name,
                       input.type.shape.size(), shape_text(shape));
    if (input.type.shape != shape) change = Change::kChanged;
    input.type.shape = shape;
  }
  for (const ValueId id : graph.inputs) {
    const Value& input = graph.value(id);
    if (std::find(input.type.shape.begin(), input.type.shape.end(), kDynamic) !=
        input.type.shape.end())
      return bad_input("input \"" + input.name + "\"",
                       "its shape {} is open; give it with --input-shape {}=N,H,W,C",
                       shape_text(input.type.shape), input.name);
  }
  const bool reshaped = change == Change::kChanged;
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    SHALE_TRY(const TensorType type, infer_result(graph, {i}));
    Value& result = graph.value(graph.nodes[i].output);
    if (result.type == type) continue;
    // A declared shape is a claim to check, unless the claim was about other input sizes.
    const bool open = std::find(result.type.shape.begin(), result.type.shape.end(), kDynamic) !=
                      result.type.shape.end();
    if (!reshaped && !open)
      return bad_input(node_label(graph, {i}), "declares its result as {}, its operands give {}",
                       type_text(result.type), type_text(type));
    if (result.type.dtype != type.dtype)
      return bad_input(node_label(graph, {i}), "declares its result as {}, its operands give {}",
                       dtype_info(result.type.dtype).name, dtype_info(type.dtype).name);
    result.type = type;
    change = Change::kChanged;
  }
  return change;
}

}  // namespace shale
