#include "ir/binary/tosa.h"

#include <algorithm>
#include <string>
#include <unordered_map>

#include "ir/schema/tosa_generated.h"

namespace shale {
namespace {

using flatbuffers::Offset;
using flatbuffers::Vector;

/// Slot of a field in a vtable. Every attribute table is flat, so the rows of ops.def address its
/// fields by position; the generated verifier has checked them by type before.
constexpr flatbuffers::voffset_t slot(size_t field) {
  return static_cast<flatbuffers::voffset_t>(4 + 2 * field);
}

std::string text(const flatbuffers::String* string) {
  return string ? string->str() : std::string();
}

std::span<const uint8_t> bytes_of(const Vector<uint8_t>* vector) {
  if (!vector) return {};
  return {vector->data(), vector->size()};
}

class Reader {
 public:
  Result<Graph> read(const tosa::TosaGraph& file) {
    SHALE_TRY_VOID(check_version(*file.version()));
    if (!file.regions() || file.regions()->size() != 1)
      return unsupported("regions", "found {}, Shale reads files with one region",
                         file.regions() ? file.regions()->size() : 0);
    const tosa::TosaRegion* region = file.regions()->Get(0);
    if (!region->blocks() || region->blocks()->size() != 1)
      return unsupported("region \"" + text(region->name()) + "\"",
                         "found {} blocks, Shale reads regions with one block",
                         region->blocks() ? region->blocks()->size() : 0);
    const tosa::TosaBasicBlock* block = region->blocks()->Get(0);
    graph_.name = text(block->name());
    SHALE_TRY_VOID(index_names(*block));
    SHALE_TRY_VOID(read_inputs(*block));
    if (block->operators()) {
      for (uint32_t i = 0; i < block->operators()->size(); ++i)
        SHALE_TRY_VOID(read_operator(i, *block->operators()->Get(i)));
    }
    if (!block->outputs() || block->outputs()->size() == 0)
      return bad_input("block \"" + graph_.name + "\"", "has no output");
    for (const flatbuffers::String* name : *block->outputs()) {
      SHALE_TRY(const ValueId id, operand(text(name), "block output"));
      graph_.outputs.push_back(id);
    }
    return std::move(graph_);
  }

 private:
  /// A name stands for a tensor or for a shape; the other pointer is null.
  struct Declaration {
    const tosa::TosaTensor* tensor;
    const tosa::TosaShape* shape;
  };

  static Result<void> check_version(const tosa::Version& version) {
    if (version._major() == 1 && (version._minor() == 0 || version._minor() == 1)) return {};
    return unsupported("version", "found TOSA {}.{}.{}{}, expected 1.0 or 1.1", version._major(),
                       version._minor(), version._patch(), version._draft() ? " (draft)" : "");
  }

  /// Where a name is declared; a name may be declared once, as a tensor or as a shape.
  Result<void> index_names(const tosa::TosaBasicBlock& block) {
    const auto add = [this](const std::string& name,
                            const Declaration& declaration) -> Result<void> {
      const std::string where =
          fmt::format("{} \"{}\"", declaration.tensor ? "tensor" : "shape", name);
      if (name.empty()) return bad_input(where, "has no name");
      if (!declared_.emplace(name, declaration).second)
        return bad_input(where, "the name is declared twice");
      return {};
    };
    if (block.tensors())
      for (const tosa::TosaTensor* tensor : *block.tensors())
        SHALE_TRY_VOID(add(text(tensor->name()), {tensor, nullptr}));
    if (block.shapes())
      for (const tosa::TosaShape* shape : *block.shapes())
        SHALE_TRY_VOID(add(text(shape->name()), {nullptr, shape}));
    return {};
  }

  Result<void> read_inputs(const tosa::TosaBasicBlock& block) {
    if (!block.inputs()) return {};
    for (const flatbuffers::String* string : *block.inputs()) {
      const std::string name = text(string);
      SHALE_TRY(const ValueId id, define(name, "block input"));
      if (graph_.value(id).type.dtype == DType::kShape)
        return bad_input("block input \"" + name + "\"", "is a shape, expected a tensor");
      graph_.inputs.push_back(id);
    }
    return {};
  }

  /// Makes the value of a declared name; the second definition of a name is an error.
  Result<ValueId> define(const std::string& name, const std::string& by) {
    const std::string where = fmt::format("{} \"{}\"", by, name);
    const auto found = declared_.find(name);
    if (found == declared_.end()) return bad_input(where, "is not declared in the block");
    if (defined_.contains(name)) return bad_input(where, "has a producer already");
    SHALE_TRY(TensorType type, declared_type(name, found->second));
    const ValueId id{static_cast<uint32_t>(graph_.values.size())};
    graph_.values.push_back({name, std::move(type), std::nullopt});
    defined_.emplace(name, id);
    return id;
  }

  Result<TensorType> declared_type(const std::string& name, const Declaration& declaration) {
    if (declaration.shape)
      return TensorType{DType::kShape, {static_cast<int64_t>(declaration.shape->rank())}};
    const tosa::TosaTensor& tensor = *declaration.tensor;
    const std::string where = "tensor \"" + name + "\"";
    const uint32_t number = static_cast<uint32_t>(tensor.type());
    if (!is_dtype(number) || number == 0 || number == static_cast<uint32_t>(DType::kShape))
      return bad_input(where, "type {} is no tensor type", number);
    if (tensor.variable()) return unsupported(where, "is a variable (EXT-VARIABLE)");
    if (tensor.is_unranked()) return unsupported(where, "has no rank");
    TensorType type{static_cast<DType>(number), {}};
    if (tensor.shape()) {
      if (tensor.shape()->size() > kMaxRank)
        return bad_input(where, "rank {} is above the level's {}", tensor.shape()->size(),
                         kMaxRank);
      for (const int32_t dim : *tensor.shape()) {
        if (dim < 1 && dim != kDynamic) return bad_input(where, "dimension {} is below 1", dim);
        type.shape.push_back(dim);
      }
    }
    return type;
  }

  Result<ValueId> operand(const std::string& name, const std::string& user) {
    if (const auto found = defined_.find(name); found != defined_.end()) return found->second;
    if (declared_.contains(name))
      return bad_input(user, "\"{}\" is used before any operator produces it", name);
    return bad_input(user, "\"{}\" is not declared in the block", name);
  }

  Result<void> read_operator(uint32_t index, const tosa::TosaOperator& source) {
    const uint32_t number = static_cast<uint32_t>(source.op());
    const std::string result =
        source.outputs() && source.outputs()->size() > 0 ? text(source.outputs()->Get(0)) : "";
    const char* wire_name = tosa::EnumNameOp(source.op());
    const std::string where = fmt::format("operator {} \"{}\" ({})", index, result,
                                          *wire_name ? wire_name : std::to_string(number));
    if (number == 0 || number > static_cast<uint32_t>(tosa::Op::MAX))
      return bad_input(where, "operator number {} is not in TOSA 1.0", number);
    if (static_cast<uint32_t>(source.attribute_type()) != number)
      return bad_input(where, "carries the attribute table {}, expected {}",
                       static_cast<uint32_t>(source.attribute_type()), number);
    if (!source.attribute()) return bad_input(where, "has no attribute table");
    const std::optional<Op> op = op_from_wire(number);
    const size_t results = source.outputs() ? source.outputs()->size() : 0;
    if (const size_t expected = op ? result_count(*op) : 1; results != expected)
      return bad_input(where, "has {} results, expected {}", results, expected);
    const uint32_t operand_count = source.inputs() ? source.inputs()->size() : 0;
    if (source.op() == tosa::Op::CONST || source.op() == tosa::Op::CONST_SHAPE) {
      if (operand_count != 0) return bad_input(where, "a constant has no operand");
      return read_constant(where, result, source.op() == tosa::Op::CONST);
    }
    if (!op) return unsupported(where, "the operator is not supported");
    const OpInfo& info = op_info(*op);
    if (operand_count < info.min_operands || operand_count > info.max_operands)
      return bad_input(where, "has {} operands, expected {} to {}", operand_count,
                       info.min_operands, info.max_operands);
    Node node{.op = *op, .attrs = {}, .inputs = {}, .output = {}, .group = 0};
    for (uint32_t i = 0; i < operand_count; ++i) {
      SHALE_TRY(const ValueId id, operand(text(source.inputs()->Get(i)), where));
      node.inputs.push_back(id);
    }
    const auto* table = static_cast<const flatbuffers::Table*>(source.attribute());
    for (size_t field = 0; field < info.attrs.size(); ++field)
      SHALE_TRY_VOID(read_attribute(where, *table, field, node));
    for (size_t i = 0; i < results; ++i) {
      SHALE_TRY(node.output, define(text(source.outputs()->Get(static_cast<uint32_t>(i))), where));
      if (results > 1) node.attrs.set(Attr::kPart, static_cast<int64_t>(i));
      graph_.nodes.push_back(node);
    }
    return {};
  }

  Result<void> read_attribute(const std::string& where, const flatbuffers::Table& table,
                              size_t field, Node& node) {
    const AttrInfo& info = attr_info(op_info(node.op).attrs[field]);
    switch (info.kind) {
      case AttrKind::kInt:
        node.attrs.set(info.attr, table.GetField<int32_t>(slot(field), 0));
        return {};
      case AttrKind::kBool:
        node.attrs.set(info.attr, table.GetField<uint8_t>(slot(field), 0) != 0 ? 1 : 0);
        return {};
      case AttrKind::kDType:
      case AttrKind::kResizeMode:
      case AttrKind::kNanMode:
      case AttrKind::kRoundingMode:
        node.attrs.set(info.attr, table.GetField<uint32_t>(slot(field), 0));
        return {};
      case AttrKind::kIntList: {
        const auto* list = table.GetPointer<const Vector<int32_t>*>(slot(field));
        std::vector<int64_t> values;
        if (list) values.assign(list->begin(), list->end());
        node.attrs.set(info.attr, std::move(values));
        return {};
      }
      case AttrKind::kElement: {
        const auto* list = table.GetPointer<const Vector<uint8_t>*>(slot(field));
        const DType dtype = graph_.value(node.inputs[0]).type.dtype;
        const Result<Tensor> element = decode_constant({dtype, {}}, bytes_of(list));
        if (!element) return bad_input(where, "{}: {}", info.name, element.error().message);
        if (element->bytes.empty())
          return bad_input(where, "{}: operand has no element type", info.name);
        node.attrs.set(info.attr, element->get(0));
        return {};
      }
      case AttrKind::kPart: return {};
    }
    return {};
  }

  Result<void> read_constant(const std::string& where, const std::string& name, bool is_tensor) {
    SHALE_TRY(const ValueId id, define(name, where));
    const Declaration& declaration = declared_.at(name);
    if (is_tensor != (declaration.tensor != nullptr))
      return bad_input(where, "expected a {} as result", is_tensor ? "tensor" : "shape");
    if (is_tensor && declaration.tensor->offset() > 1)
      return unsupported(where, "its data lies outside the file (offset {})",
                         declaration.tensor->offset());
    const std::span<const uint8_t> wire =
        bytes_of(is_tensor ? declaration.tensor->data() : declaration.shape->data());
    if (!is_tensor && declaration.shape->rank() > 2 * kMaxRank)
      return bad_input(where, "shape has {} elements, at most {} are meaningful",
                       declaration.shape->rank(), 2 * kMaxRank);
    Result<Tensor> tensor = decode_constant(graph_.value(id).type, wire);
    if (!tensor) return bad_input(where, "{}", tensor.error().message);
    graph_.value(id).constant = *std::move(tensor);
    return {};
  }

  Graph graph_;
  std::unordered_map<std::string, Declaration> declared_;
  std::unordered_map<std::string, ValueId> defined_;
};

class Writer {
 public:
  explicit Writer(const Graph& graph) : graph_(graph) {}

  std::vector<uint8_t> write() {
    std::vector<Offset<tosa::TosaTensor>> tensors;
    std::vector<Offset<tosa::TosaShape>> shapes;
    std::vector<Offset<tosa::TosaOperator>> operators;
    for (const Value& value : graph_.values) {
      if (value.type.dtype == DType::kShape)
        shapes.push_back(shape(value));
      else
        tensors.push_back(tensor(value));
      if (value.is_constant()) operators.push_back(constant(value));
    }
    std::vector<bool> written(graph_.nodes.size());
    for (uint32_t i = 0; i < graph_.nodes.size(); ++i) {
      const Node& node = graph_.nodes[i];
      if (written[i]) continue;
      std::vector<std::string> results(result_count(node.op));
      if (results.size() == 1) {
        results[0] = graph_.value(node.output).name;
      } else {
        const bool imaginary = node.attrs.flag(Attr::kPart);
        const std::optional<NodeId> other = graph_.other_part({i}, written);
        if (other) written[other->index] = true;
        results[imaginary] = graph_.value(node.output).name;
        results[!imaginary] = other ? graph_.value(graph_.node(*other).output).name
                                    : graph_.unique_name(results[imaginary] + ".other");
        // The file's operator has a result that the graph does not want.
        if (!other)
          tensors.push_back(
              tensor({results[!imaginary], graph_.value(node.output).type, std::nullopt}));
      }
      operators.push_back(operation(node, results));
    }
    const auto block = tosa::CreateTosaBasicBlock(
        builder_, builder_.CreateString(graph_.name), builder_.CreateVector(operators),
        builder_.CreateVector(tensors), names(graph_.inputs), names(graph_.outputs),
        builder_.CreateVector(shapes));
    const auto region = tosa::CreateTosaRegion(builder_, builder_.CreateString("main"),
                                               builder_.CreateVector(&block, 1));
    const auto version = tosa::CreateVersion(builder_, 1, 0, 0, false);
    tosa::FinishTosaGraphBuffer(
        builder_, tosa::CreateTosaGraph(builder_, version, builder_.CreateVector(&region, 1)));
    return {builder_.GetBufferPointer(), builder_.GetBufferPointer() + builder_.GetSize()};
  }

 private:
  Offset<Vector<Offset<flatbuffers::String>>> names(const std::vector<ValueId>& ids) {
    std::vector<std::string> list;
    for (const ValueId id : ids) list.push_back(graph_.value(id).name);
    return builder_.CreateVectorOfStrings(list);
  }

  Offset<Vector<uint8_t>> data(const std::vector<uint8_t>& wire) {
    builder_.ForceVectorAlignment(wire.size(), 1, 8);
    return builder_.CreateVector(wire);
  }

  Offset<tosa::TosaTensor> tensor(const Value& value) {
    const auto name = builder_.CreateString(value.name);
    const std::vector<int32_t> dims(value.type.shape.begin(), value.type.shape.end());
    const auto shape = builder_.CreateVector(dims);
    Offset<Vector<uint8_t>> bytes;
    if (value.is_constant()) bytes = data(encode_constant(*value.constant));
    return tosa::CreateTosaTensor(builder_, name, shape, static_cast<tosa::DType>(value.type.dtype),
                                  bytes);
  }

  Offset<tosa::TosaShape> shape(const Value& value) {
    const auto name = builder_.CreateString(value.name);
    return tosa::CreateTosaShape(builder_, name, static_cast<uint32_t>(value.type.shape[0]),
                                 data(value.constant->bytes));
  }

  Offset<tosa::TosaOperator> constant(const Value& value) {
    const bool is_shape = value.type.dtype == DType::kShape;
    const auto attribute = is_shape ? tosa::CreateConstShapeAttribute(builder_).Union()
                                    : tosa::CreateConstAttribute(builder_).Union();
    const auto inputs = builder_.CreateVectorOfStrings({});
    const auto outputs = builder_.CreateVectorOfStrings({value.name});
    return tosa::CreateTosaOperator(
        builder_, is_shape ? tosa::Op::CONST_SHAPE : tosa::Op::CONST,
        is_shape ? tosa::Attribute::ConstShapeAttribute : tosa::Attribute::ConstAttribute,
        attribute, inputs, outputs);
  }

  Offset<tosa::TosaOperator> operation(const Node& node, const std::vector<std::string>& results) {
    const OpInfo& info = op_info(node.op);
    std::vector<Offset<void>> vectors(info.attrs.size());
    for (size_t field = 0; field < info.attrs.size(); ++field) {
      const std::span<const int64_t> values = node.attrs.list(info.attrs[field]);
      const AttrKind kind = attr_info(info.attrs[field]).kind;
      if (kind == AttrKind::kIntList) {
        vectors[field] =
            builder_.CreateVector(std::vector<int32_t>(values.begin(), values.end())).Union();
      } else if (kind == AttrKind::kElement) {
        const TensorType type{graph_.value(node.inputs[0]).type.dtype, {}};
        vectors[field] = data(encode_constant(Tensor::from_ints(type, values))).Union();
      }
    }
    const flatbuffers::uoffset_t start = builder_.StartTable();
    for (size_t field = 0; field < info.attrs.size(); ++field) {
      const int64_t value = node.attrs.get(info.attrs[field]);
      switch (attr_info(info.attrs[field]).kind) {
        case AttrKind::kInt:
          builder_.AddElement<int32_t>(slot(field), static_cast<int32_t>(value), 0);
          break;
        case AttrKind::kBool:
          builder_.AddElement<uint8_t>(slot(field), value != 0 ? 1 : 0, 0);
          break;
        case AttrKind::kIntList:
        case AttrKind::kElement: builder_.AddOffset(slot(field), vectors[field]); break;
        case AttrKind::kPart: break;
        default: builder_.AddElement<uint32_t>(slot(field), static_cast<uint32_t>(value), 0);
      }
    }
    const Offset<void> attribute(builder_.EndTable(start));
    return tosa::CreateTosaOperator(builder_, static_cast<tosa::Op>(info.wire),
                                    static_cast<tosa::Attribute>(info.wire), attribute,
                                    names(node.inputs), builder_.CreateVectorOfStrings(results));
  }

  const Graph& graph_;
  flatbuffers::FlatBufferBuilder builder_;
};

}  // namespace

bool is_tosa(std::span<const uint8_t> bytes) {
  return bytes.size() >= 8 && std::equal(bytes.begin() + 4, bytes.begin() + 8, "TOSA");
}

Result<Graph> read_tosa(std::span<const uint8_t> bytes) {
  if (bytes.size() < 8)
    return bad_input("", "found {} bytes, a TOSA file has at least 8", bytes.size());
  if (!is_tosa(bytes))
    return bad_input("offset 4", "found the file identifier \"{}\", expected \"TOSA\"", [&] {
      std::string shown;
      for (size_t i = 4; i < 8; ++i)
        shown += bytes[i] >= 32 && bytes[i] < 127 ? static_cast<char>(bytes[i]) : '?';
      return shown;
    }());
  // FlatBuffers measures alignment from the buffer's address.
  const std::vector<uint64_t> aligned = [&] {
    std::vector<uint64_t> copy((bytes.size() + 7) / 8);
    std::copy(bytes.begin(), bytes.end(), reinterpret_cast<uint8_t*>(copy.data()));
    return copy;
  }();
  const uint8_t* data = reinterpret_cast<const uint8_t*>(aligned.data());
  flatbuffers::Verifier verifier(data, bytes.size());
  if (!tosa::VerifyTosaGraphBuffer(verifier))
    return bad_input("", "the FlatBuffers structure is broken or cut off ({} bytes)", bytes.size());
  return Reader().read(*tosa::GetTosaGraph(data));
}

std::vector<uint8_t> write_tosa(const Graph& graph) { return Writer(graph).write(); }

}  // namespace shale
