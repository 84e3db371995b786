#include "ir/text/text.h"

#include <gtest/gtest.h>

#include <random>

#include "ir/binary/tosa.h"
#include "ir/verify/verify.h"
#include "tests/ir/golden_files.h"
#include "tests/ir/node_case.h"

namespace shale {
namespace {

Graph parsed(const std::string& text) {
  Result<Graph> graph = parse_text(text);
  if (!graph) {
    ADD_FAILURE() << graph.error().text() << "\n" << text;
    return {};
  }
  return *std::move(graph);
}

void expect_round_trip(const Graph& graph) {
  const std::string text = print_text(graph);
  const Graph again = parsed(text);
  EXPECT_TRUE(again == graph) << text;
  EXPECT_EQ(print_text(again), text);
}

TEST(Text, RoundTripsAllGoldenGraphs) {
  size_t count = 0;
  for (const GoldenFile& file : golden_files()) {
    const Result<Graph> graph = read_tosa(file.bytes);
    if (!graph) {
      EXPECT_FALSE(is_legal(file)) << file.name << ": " << graph.error().text();
      continue;
    }
    SCOPED_TRACE(file.name);
    expect_round_trip(*graph);
    ++count;
  }
  EXPECT_GT(count, 0u);
  EXPECT_GE(count, 715u);
}

TEST(Text, ReadsTheExampleOfItsHeader) {
  const Graph graph = parsed(R"(
# a comment before
graph main {  # and one behind
  input %input : i8[1,?,64,3]
  const %w : i8[2,1,1,3] = hex "00ff017f80fe"
  const %b : i32[1] = [ -5 ]
  const %zp : i8[1] = [1]
  const %size : shape[2] = [2,2]
  const %nothing : shape[0] = []
  const %scalar : i48[] = [-140737488355328]
  %acc = conv2d %input, %w, %b, %zp, %zp {pad=[2,2,2,2], acc_type=i32, local_bound=true} : i32[1,64,64,2] @7
  return %acc, %scalar
}
# the end)");
  EXPECT_EQ(graph.name, "main");
  ASSERT_EQ(graph.nodes.size(), 1u);
  const Node& node = graph.nodes[0];
  EXPECT_EQ(node.group, 7u);
  EXPECT_EQ(node.attrs.list(Attr::kPad).size(), 4u);
  EXPECT_TRUE(node.attrs.has(Attr::kStride));  // left out, so empty
  EXPECT_TRUE(node.attrs.list(Attr::kStride).empty());
  EXPECT_TRUE(node.attrs.flag(Attr::kLocalBound));
  EXPECT_EQ(graph.value(graph.inputs[0]).type.shape, (Shape{1, kDynamic, 64, 3}));
  EXPECT_EQ(graph.value(node.inputs[1]).constant->ints(), (Ints{0, -1, 1, 127, -128, -2}));
  EXPECT_EQ(graph.outputs.size(), 2u);
  expect_round_trip(graph);
}

TEST(Text, PrintsSmallConstantsAsListsAndLargeOnesAsHex) {
  Graph graph;
  graph.outputs = {
      graph.add_constant("a", Tensor::zeros({DType::kInt16, {kMaxListedElements}})),
      graph.add_constant("b", Tensor::zeros({DType::kInt16, {kMaxListedElements + 1}}))};
  const std::string text = print_text(graph);
  EXPECT_NE(text.find("const %a : i16[64] = [0,0,"), std::string::npos);
  EXPECT_NE(text.find("const %b : i16[65] = hex \"0000"), std::string::npos);
  expect_round_trip(graph);
}

TEST(Text, RoundTripsEveryTypeAtItsLimits) {
  Graph graph;
  for (const DType dtype :
       {DType::kBool, DType::kInt4, DType::kInt8, DType::kInt16, DType::kInt32, DType::kInt48}) {
    const IntRange range = dtype_range(dtype);
    Tensor tensor = Tensor::zeros({dtype, {3, 100}});
    for (int64_t i = 0; i < tensor.count(); ++i)
      tensor.set(i, i % 3 == 0 ? range.min : i % 3 == 1 ? range.max : 1);
    graph.outputs.push_back(
        graph.add_constant("large_" + std::string(dtype_info(dtype).name), tensor));
    graph.outputs.push_back(
        graph.add_constant("small", Tensor::from_ints({dtype, {2}}, Ints{range.min, range.max})));
  }
  expect_round_trip(graph);
}

TEST(Text, RoundTripsNamesOfAnyCharacters) {
  for (const std::string& name :
       {std::string("plain_1.$/-"), std::string("a b"), std::string("%x"),
        std::string("\"quoted\""), std::string("back\\slash"), std::string("\\x41"),
        std::string("line\nbreak\ttab"), std::string("\x01\x7f"), std::string("d\xc3\xbcne"),
        std::string("\xff\xfe"), std::string("a,b}"), std::string("# no comment"),
        std::string("nul\0inside", 10), std::string("return"), std::string("@1")}) {
    SCOPED_TRACE(name);
    Graph graph;
    graph.name = name;
    const ValueId x = graph.add_input(name, {DType::kInt8, {2}});
    graph.outputs = {graph.add_node(Op::kBitwiseNot, {}, {x}, name + "'", {DType::kInt8, {2}})};
    expect_round_trip(graph);
  }
}

TEST(Text, RoundTripsEveryAttribute) {
  for (const OpInfo& info : all_ops()) {
    Graph graph;
    std::vector<ValueId> operands;
    for (uint32_t i = 0; i < info.min_operands; ++i)
      operands.push_back(graph.add_input("x", {DType::kInt8, {1}}));
    Attrs attrs;
    for (const Attr attr : info.attrs) {
      switch (attr_info(attr).kind) {
        case AttrKind::kIntList: attrs.set(attr, Ints{-1, 2147483647, 0}); break;
        case AttrKind::kBool: attrs.set(attr, 1); break;
        case AttrKind::kElement: attrs.set(attr, -128); break;
        case AttrKind::kDType: attrs.set(attr, static_cast<int64_t>(DType::kInt48)); break;
        case AttrKind::kInt: attrs.set(attr, -3); break;
        default: attrs.set(attr, 2); break;
      }
    }
    graph.outputs = {graph.add_node(info.op, attrs, operands, "y", {DType::kInt32, {}})};
    graph.nodes[0].group = UINT32_MAX;
    expect_round_trip(graph);
    for (const Attr attr : info.attrs)
      if (attr_info(attr).kind != AttrKind::kIntList && attr_info(attr).kind != AttrKind::kBool)
        graph.nodes[0].attrs.set(attr, 99);  // a number that has no name
    expect_round_trip(graph);
  }
}

struct ErrorCase {
  std::string text;
  std::string where, message;
};

TEST(Text, SaysWhereAndWhatIsWrong) {
  const std::string head = "graph main {\n  input %x : i8[2]\n";
  const std::string tail = "\n  return %x\n}";
  const ErrorCase cases[] = {
      {"", "line 1, column 1", "expected 'graph'"},
      {"grape main {", "line 1, column 6", "expected 'graph'"},
      {"graph {", "line 1, column 7", "expected the graph's name"},
      {"graph main", "line 1, column 11", "expected '{'"},
      {"graph \"main", "line 1, column 12", "the string has no end"},
      {"graph \"ma\\xg0\" {", "line 1, column 12", "expected two hexadecimal digits"},
      {"graph main {\n  output %x", "line 2, column 9",
       "expected 'input', 'const', a node or 'return'"},
      {"graph main {\n  input x : i8[2]", "line 2, column 9", "expected '%'"},
      {"graph main {\n  input % : i8[2]", "line 2, column 11", "expected a name after '%'"},
      {"graph main {\n  input %x i8[2]", "line 2, column 12", "expected ':'"},
      {"graph main {\n  input %x : u8[2]", "line 2, column 16", "'u8' is no element type"},
      {"graph main {\n  input %x : shape[2]", "line 2, column 22",
       "an input is a tensor, not a shape"},
      {"graph main {\n  input %x : i8[0]", "line 2, column 18", "dimension 0 is below 1"},
      {"graph main {\n  input %x : i8[2", "line 2, column 18", "expected ']'"},
      {"graph main {\n  input %x : i8[1,1,1,1,1,1,1]", "line 2, column 31",
       "rank 7 is above the level's 6"},
      {"graph main {\n  input %x : i8[99999999999999999999]", "line 2, column 17",
       "expected an integer of 64 bits"},
      {head + "  input %x : i8[2]" + tail, "line 3, column 19", "%x is defined twice"},
      {head + "  const %c : i8[2] = [1,200]" + tail, "line 3, column 29",
       "200 is outside -128..127"},
      {head + "  const %c : i4[1] = [-8]" + tail, "line 3, column 26", "-8 is outside -7..7"},
      {head + "  const %c : i8[2] = [1]" + tail, "line 3, column 25",
       "found 1 elements, i8[2] has 2"},
      {head + "  const %c : i8[?] = [1]" + tail, "line 3, column 19", "i8[?] has no fixed size"},
      {head + "  const %c : i8[2] = hex \"00\"" + tail, "line 3, column 29",
       "expected two hexadecimal digits"},
      {head + "  const %c : i8[2147483647] = hex \"00\"" + tail, "line 3, column 36",
       "expected 2147483647 bytes of hex"},
      {head + "  const %c : i8[2] = hex \"00g1\"" + tail, "line 3, column 29",
       "expected two hexadecimal digits"},
      {head + "  const %c : i8[2] = 5" + tail, "line 3, column 23", "expected 'hex'"},
      {head + "  const %c : shape[13] = []" + tail, "line 3, column 23",
       "a shape has 0 to 12 elements"},
      {head + "  %y = negat %x : i8[2]" + tail, "line 3, column 13", "'negat' is no operator"},
      {head + "  %y = abs %z : i8[2]" + tail, "line 3, column 14", "%z is not defined above"},
      {head + "  %y = abs %x, %x : i8[2]" + tail, "line 3, column 19",
       "abs has 2 operands, expected 1 to 1"},
      {head + "  %y = reverse %x {perms=[0]} : i8[2]" + tail, "line 3, column 25",
       "reverse has no attribute 'perms'"},
      {head + "  %y = reverse %x {axis [0]} : i8[2]" + tail, "line 3, column 25", "expected '='"},
      {head + "  %y = max_pool2d %x {nan_mode=maybe} : i8[2]" + tail, "line 3, column 37",
       "'maybe' is no value of nan_mode"},
      {head + "  %y = reverse %x {axis=0 : i8[2]" + tail, "line 3, column 27", "expected '}'"},
      {head + "  %y = reverse %x : shape[2]" + tail, "line 3, column 29",
       "a node's result is a tensor, not a shape"},
      {head + "  %y = reverse %x : i8[2] @0" + tail, "line 3, column 29",
       "a group is a number above 0"},
      {head + "  %y = reverse %x : i8[2] @4294967296" + tail, "line 3, column 38",
       "a group is a number above 0"},
      {head + "  return %y\n}", "line 3, column 12", "%y is not defined above"},
      {head + "  return %x", "line 3, column 12", "expected '}'"},
      {head + "  return %x\n} more", "line 4, column 3", "expected the end of the text"},
  };
  for (const ErrorCase& row : cases) {
    const Result<Graph> graph = parse_text(row.text);
    ASSERT_FALSE(graph) << row.text;
    EXPECT_EQ(graph.error().code, ErrorCode::kBadInput);
    EXPECT_EQ(graph.error().where, row.where) << row.text << "\n" << row.message;
    EXPECT_EQ(graph.error().message, row.message) << row.text;
  }
}

std::string small_text() {
  return R"(graph main {
  input %"a b" : i8[1,4,?,2]
  const %w : i8[2,1,1,2] = [1,-2,3,4]
  const %h : i8[2] = hex "01fe"
  const %p : shape[8] = [0,0,1,1,1,1,0,0]
  %y = pad %"a b", %p, %h : i8[1,6,6,2] @2
  %z = resize %y, %p, %p, %p {mode=nearest} : i8[1,6,6,2]
  %c = rescale %z, %w, %w, %h, %h {scale32=true, rounding_mode=double} : i16[]
  return %c, %y
}
)";
}

TEST(Text, SurvivesEveryCut) {
  const std::string text = small_text();
  ASSERT_TRUE(parse_text(text)) << parse_text(text).error().text();
  const size_t end = text.rfind('}');
  for (size_t length = 0; length <= end; ++length)
    EXPECT_FALSE(parse_text(std::string_view(text).substr(0, length))) << length;
}

TEST(Text, SurvivesAnyByteAnywhere) {
  const std::string text = small_text();
  size_t accepted = 0;
  for (size_t at = 0; at < text.size(); ++at)
    for (int byte = 0; byte < 256; ++byte) {
      std::string changed = text;
      changed[at] = static_cast<char>(byte);
      // Either refused with a place, or a graph that prints and parses again.
      const Result<Graph> graph = parse_text(changed);
      if (!graph) {
        ASSERT_TRUE(graph.error().where.starts_with("line ")) << changed;
        continue;
      }
      ++accepted;
      const Result<Graph> again = parse_text(print_text(*graph));
      ASSERT_TRUE(again) << again.error().text() << "\n" << changed;
      ASSERT_TRUE(*again == *graph) << changed;
    }
  EXPECT_GT(accepted, text.size());
}

TEST(Text, SurvivesRandomEdits) {
  std::mt19937_64 random(77);
  const std::string pieces = "%\"\\{}[]=:,@?#-0123456789 \nabcxinputconsthexreturn";
  for (int round = 0; round < 20000; ++round) {
    std::string text = small_text();
    for (uint64_t edits = 1 + random() % 4; edits > 0; --edits) {
      const size_t at = random() % text.size();
      switch (random() % 3) {
        case 0: text.erase(at, 1 + random() % 8); break;
        case 1: text.insert(at, 1, pieces[random() % pieces.size()]); break;
        default: text.insert(at, text.substr(random() % text.size(), random() % 40)); break;
      }
      if (text.empty()) text = " ";
    }
    const Result<Graph> graph = parse_text(text);
    if (!graph) continue;
    const Result<Graph> again = parse_text(print_text(*graph));
    ASSERT_TRUE(again && *again == *graph) << text;
    (void)verify(*graph);
  }
}

}  // namespace
}  // namespace shale
