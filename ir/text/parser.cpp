#include <algorithm>
#include <cctype>
#include <charconv>
#include <unordered_map>

#include "ir/text/text.h"

namespace shale {
namespace {

class Parser {
 public:
  explicit Parser(std::string_view text) : text_(text) {}

  Result<Graph> parse() {
    SHALE_TRY_VOID(expect_word("graph"));
    skip_space();
    if (peek() == '"') {
      SHALE_TRY(graph_.name, quoted());
    } else {
      graph_.name = std::string(plain());
      if (graph_.name.empty()) return fail("expected the graph's name");
    }
    SHALE_TRY_VOID(expect('{'));
    for (;;) {
      skip_space();
      if (peek() == '%') {
        SHALE_TRY_VOID(node());
        continue;
      }
      const std::string_view word = plain();
      if (word == "input")
        SHALE_TRY_VOID(input());
      else if (word == "const")
        SHALE_TRY_VOID(constant());
      else if (word == "return")
        break;
      else
        return fail("expected 'input', 'const', a node or 'return'");
    }
    do {
      SHALE_TRY(const ValueId id, use());
      graph_.outputs.push_back(id);
    } while (accept(','));
    SHALE_TRY_VOID(expect('}'));
    skip_space();
    if (at_ < text_.size()) return fail("expected the end of the text");
    return std::move(graph_);
  }

 private:
  Error fail(std::string_view message) const {
    size_t line = 1, column = 1;
    for (size_t i = 0; i < at_ && i < text_.size(); ++i) {
      if (text_[i] == '\n')
        ++line, column = 1;
      else
        ++column;
    }
    return {ErrorCode::kBadInput, std::string(message),
            fmt::format("line {}, column {}", line, column)};
  }

  char peek() const { return at_ < text_.size() ? text_[at_] : '\0'; }

  void skip_space() {
    while (at_ < text_.size()) {
      if (text_[at_] == '#') {
        while (at_ < text_.size() && text_[at_] != '\n') ++at_;
      } else if (std::isspace(static_cast<unsigned char>(text_[at_])) != 0) {
        ++at_;
      } else {
        break;
      }
    }
  }

  bool accept(char c) {
    skip_space();
    if (peek() != c) return false;
    ++at_;
    return true;
  }

  Result<void> expect(char c) {
    if (!accept(c)) return fail(fmt::format("expected '{}'", c));
    return {};
  }

  /// A run of name characters, possibly empty.
  std::string_view plain() {
    skip_space();
    const size_t start = at_;
    while (at_ < text_.size()) {
      const auto c = static_cast<unsigned char>(text_[at_]);
      if (std::isalnum(c) == 0 && c != '_' && c != '.' && c != '$' && c != '/' && c != '-') break;
      ++at_;
    }
    return text_.substr(start, at_ - start);
  }

  Result<void> expect_word(std::string_view word) {
    if (plain() != word) return fail(fmt::format("expected '{}'", word));
    return {};
  }

  Result<std::string> quoted() {
    SHALE_TRY_VOID(expect('"'));
    std::string result;
    for (;;) {
      if (at_ >= text_.size()) return fail("the string has no end");
      const char c = text_[at_++];
      if (c == '"') return result;
      if (c != '\\') {
        result += c;
        continue;
      }
      if (at_ >= text_.size()) return fail("the string has no end");
      const char escaped = text_[at_++];
      if (escaped != 'x') {
        result += escaped;
        continue;
      }
      uint8_t byte = 0;
      if (!hex_byte(at_, byte)) return fail("expected two hexadecimal digits");
      at_ += 2;
      result += static_cast<char>(byte);
    }
  }

  bool hex_byte(size_t at, uint8_t& byte) const {
    if (at + 2 > text_.size()) return false;
    const auto [end, error] = std::from_chars(text_.data() + at, text_.data() + at + 2, byte, 16);
    return error == std::errc() && end == text_.data() + at + 2;
  }

  Result<int64_t> integer() {
    skip_space();
    int64_t value = 0;
    const auto [end, error] =
        std::from_chars(text_.data() + at_, text_.data() + text_.size(), value);
    if (error != std::errc()) return fail("expected an integer of 64 bits");
    at_ = static_cast<size_t>(end - text_.data());
    return value;
  }

  /// The bits of a float of this type: a decimal number, inf, -inf, nan, or 0x and the bits.
  Result<int64_t> real_element(DType dtype) {
    skip_space();
    const char* const end = text_.data() + text_.size();
    const char* const start = text_.data() + at_;
    if (text_.substr(at_).starts_with("0x")) {
      uint32_t bits = 0;
      const auto [stop, error] = std::from_chars(start + 2, end, bits, 16);
      if (error != std::errc() || bits >> (dtype_info(dtype).bits - 1) > 1)
        return fail(fmt::format("expected the {} bits of a float", dtype_info(dtype).bits));
      at_ += static_cast<size_t>(stop - start);
      return element_bits(dtype, bits);
    }
    float value = 0;
    const auto [stop, error] = std::from_chars(start, end, value);
    if (error != std::errc()) return fail("expected a number that fits float");
    at_ += static_cast<size_t>(stop - start);
    return real_bits(dtype, value);
  }

  /// "[a,b,...]"; `open` also takes '?' for kDynamic.
  Result<std::vector<int64_t>> list(bool open) {
    SHALE_TRY_VOID(expect('['));
    std::vector<int64_t> values;
    if (accept(']')) return values;
    do {
      if (open && accept('?')) {
        values.push_back(kDynamic);
      } else {
        SHALE_TRY(const int64_t value, integer());
        if (open && value < 1) return fail(fmt::format("dimension {} is below 1", value));
        values.push_back(value);
      }
    } while (accept(','));
    SHALE_TRY_VOID(expect(']'));
    return values;
  }

  Result<std::vector<int64_t>> real_list(DType dtype) {
    SHALE_TRY_VOID(expect('['));
    std::vector<int64_t> values;
    if (accept(']')) return values;
    do {
      SHALE_TRY(const int64_t value, real_element(dtype));
      values.push_back(value);
    } while (accept(','));
    SHALE_TRY_VOID(expect(']'));
    return values;
  }

  Result<TensorType> type() {
    SHALE_TRY_VOID(expect(':'));
    const std::string_view name = plain();
    const std::optional<DType> dtype = dtype_from_name(name);
    if (!dtype || *dtype == DType::kUnknown)
      return fail(fmt::format("'{}' is no element type", name));
    if (*dtype == DType::kShape) {
      SHALE_TRY(std::vector<int64_t> length, list(false));
      if (length.size() != 1 || length[0] < 0 || length[0] > 2 * kMaxRank)
        return fail(fmt::format("a shape has 0 to {} elements", 2 * kMaxRank));
      return TensorType{*dtype, std::move(length)};
    }
    SHALE_TRY(Shape shape, list(true));
    if (static_cast<int64_t>(shape.size()) > kMaxRank)
      return fail(fmt::format("rank {} is above the level's {}", shape.size(), kMaxRank));
    return TensorType{*dtype, std::move(shape)};
  }

  Result<std::string> name() {
    SHALE_TRY_VOID(expect('%'));
    if (peek() == '"') return quoted();
    std::string result(plain());
    if (result.empty()) return fail("expected a name after '%'");
    return result;
  }

  Result<ValueId> define(std::string wanted, TensorType value_type) {
    const ValueId id{static_cast<uint32_t>(graph_.values.size())};
    if (!names_.emplace(wanted, id).second)
      return fail(fmt::format("%{} is defined twice", wanted));
    graph_.values.push_back({std::move(wanted), std::move(value_type), std::nullopt});
    return id;
  }

  Result<ValueId> use() {
    skip_space();
    SHALE_TRY(const std::string wanted, name());
    const auto found = names_.find(wanted);
    if (found == names_.end()) return fail(fmt::format("%{} is not defined above", wanted));
    return found->second;
  }

  Result<void> input() {
    skip_space();
    SHALE_TRY(std::string wanted, name());
    SHALE_TRY(TensorType value_type, type());
    if (value_type.dtype == DType::kShape) return fail("an input is a tensor, not a shape");
    SHALE_TRY(const ValueId id, define(std::move(wanted), std::move(value_type)));
    graph_.inputs.push_back(id);
    return {};
  }

  Result<void> constant() {
    skip_space();
    SHALE_TRY(std::string wanted, name());
    SHALE_TRY(const TensorType value_type, type());
    const bool is_shape = value_type.dtype == DType::kShape;
    const std::optional<int64_t> count =
        is_shape ? std::optional(value_type.shape[0]) : element_count(value_type.shape);
    if (!count) return fail(fmt::format("{} has no fixed size", type_text(value_type)));
    SHALE_TRY_VOID(expect('='));
    skip_space();
    Tensor tensor{value_type, {}};
    if (peek() == '[') {
      SHALE_TRY(const std::vector<int64_t> values,
                is_float(value_type.dtype) ? real_list(value_type.dtype) : list(false));
      if (static_cast<int64_t>(values.size()) != *count)
        return fail(fmt::format("found {} elements, {} has {}", values.size(),
                                type_text(value_type), *count));
      if (is_integer(value_type.dtype) || value_type.dtype == DType::kBool) {
        const IntRange range = dtype_range(value_type.dtype);
        for (const int64_t value : values)
          if (value < range.min || value > range.max)
            return fail(fmt::format("{} is outside {}..{}", value, range.min, range.max));
      }
      tensor = Tensor::from_ints(value_type, values);
    } else {
      SHALE_TRY_VOID(expect_word("hex"));
      SHALE_TRY_VOID(expect('"'));
      const size_t bytes = static_cast<size_t>(*count) * dtype_info(value_type.dtype).host_bytes;
      if (text_.size() - at_ < 2 * bytes)
        return fail(fmt::format("expected {} bytes of hex", bytes));
      tensor.bytes.resize(bytes);
      for (uint8_t& byte : tensor.bytes) {
        if (!hex_byte(at_, byte)) return fail("expected two hexadecimal digits");
        at_ += 2;
      }
      SHALE_TRY_VOID(expect('"'));
    }
    SHALE_TRY(const ValueId id, define(std::move(wanted), value_type));
    graph_.value(id).constant = std::move(tensor);
    return {};
  }

  Result<void> node() {
    SHALE_TRY(std::string wanted, name());
    SHALE_TRY_VOID(expect('='));
    const std::string_view op_name = plain();
    const std::optional<Op> op = op_from_name(op_name);
    if (!op) return fail(fmt::format("'{}' is no operator", op_name));
    const OpInfo& info = op_info(*op);
    Node result{.op = *op, .attrs = {}, .inputs = {}, .output = {}, .group = 0};
    do {
      SHALE_TRY(const ValueId id, use());
      result.inputs.push_back(id);
    } while (accept(','));
    if (result.inputs.size() < info.min_operands || result.inputs.size() > info.max_operands)
      return fail(fmt::format("{} has {} operands, expected {} to {}", info.name,
                              result.inputs.size(), info.min_operands, info.max_operands));
    for (const Attr attr : info.attrs)
      result.attrs.set(attr, attr_info(attr).kind == AttrKind::kIntList ? std::vector<int64_t>{}
                                                                        : std::vector<int64_t>{0});
    if (accept('{')) {
      do SHALE_TRY_VOID(attribute(info, graph_.value(result.inputs[0]).type.dtype, result.attrs));
      while (accept(','));
      SHALE_TRY_VOID(expect('}'));
    }
    SHALE_TRY(TensorType result_type, type());
    if (result_type.dtype == DType::kShape) return fail("a node's result is a tensor, not a shape");
    if (accept('@')) {
      SHALE_TRY(const int64_t group, integer());
      if (group < 1 || group > UINT32_MAX) return fail("a group is a number above 0");
      result.group = static_cast<uint32_t>(group);
    }
    SHALE_TRY(result.output, define(std::move(wanted), std::move(result_type)));
    graph_.nodes.push_back(std::move(result));
    return {};
  }

  Result<void> attribute(const OpInfo& op, DType operand, Attrs& attrs) {
    const std::string_view attr_name = plain();
    const std::optional<Attr> attr = attr_from_name(attr_name);
    if (!attr || std::find(op.attrs.begin(), op.attrs.end(), *attr) == op.attrs.end())
      return fail(fmt::format("{} has no attribute '{}'", op.name, attr_name));
    SHALE_TRY_VOID(expect('='));
    skip_space();
    const AttrKind kind = attr_info(*attr).kind;
    if (kind == AttrKind::kIntList) {
      SHALE_TRY(std::vector<int64_t> values, list(false));
      attrs.set(*attr, std::move(values));
      return {};
    }
    if (kind == AttrKind::kElement && is_float(operand)) {
      SHALE_TRY(const int64_t value, real_element(operand));
      attrs.set(*attr, value);
      return {};
    }
    if (std::isalpha(static_cast<unsigned char>(peek())) == 0) {
      SHALE_TRY(const int64_t value, integer());
      attrs.set(*attr, value);
      return {};
    }
    const std::string_view word = plain();
    const std::span<const std::string_view> names = attr_value_names(kind);
    const auto named = std::find(names.begin(), names.end(), word);
    const std::optional<DType> dtype = dtype_from_name(word);
    if (kind == AttrKind::kBool && (word == "true" || word == "false"))
      attrs.set(*attr, word == "true");
    else if (kind == AttrKind::kDType && dtype)
      attrs.set(*attr, static_cast<int64_t>(*dtype));
    else if (named != names.end())
      attrs.set(*attr, named - names.begin());
    else
      return fail(fmt::format("'{}' is no value of {}", word, attr_name));
    return {};
  }

  std::string_view text_;
  size_t at_ = 0;
  Graph graph_;
  std::unordered_map<std::string, ValueId> names_;
};

}  // namespace

Result<Graph> parse_text(std::string_view text) { return Parser(text).parse(); }

}  // namespace shale
