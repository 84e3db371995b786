#include "compiler/cost/layers.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "compiler/cost/cost.h"
#include "ir/base/file.h"
#include "ir/verify/verify.h"

namespace shale {
namespace {

using Json = nlohmann::json;

constexpr const char* kSrpo = R"([
  {"op": "conv2d", "k": 5, "stride": 1, "cin": 3, "cout": 16, "bias": true, "act": "relu", "at": "lr"},
  {"op": "conv2d", "k": 5, "stride": 1, "cin": 16, "cout": 16, "bias": true, "act": "relu", "at": "lr"},
  {"op": "upsample", "mode": "nearest", "factor": 2, "channels": 16},
  {"op": "conv2d", "k": 5, "stride": 1, "cin": 16, "cout": 2, "bias": true, "act": null, "at": "hr"}])";

std::vector<Layer> parsed(std::string_view json, int64_t scale = 2, int64_t channels = 0) {
  Result<std::vector<Layer>> layers = parse_layers(json, scale, channels);
  if (layers) return *std::move(layers);
  ADD_FAILURE() << layers.error().text();
  return {};
}

LayerCounts counts(std::string_view json) { return count_layers(parsed(json)); }

std::string refusal(std::string_view json, int64_t scale = 2) {
  const Result<std::vector<Layer>> layers = parse_layers(json, scale, 0);
  return layers ? "accepted" : layers.error().text();
}

/// The graph must be legal and cost what the list of layers says.
void expect_graph_agrees(const std::string& name, std::span<const Layer> layers, int64_t h,
                         int64_t w) {
  const Result<Graph> graph =
      graph_of_layers("layers", layers, h, w);  // `name` may be a text of lines
  ASSERT_TRUE(graph) << name << ": " << graph.error().text();
  const Result<void> legal = verify(*graph);
  ASSERT_TRUE(legal) << name << ": " << legal.error().text();
  const LayerCounts count = count_layers(layers);
  uint64_t macs = 0;
  for (const Node& node : graph->nodes) macs += node_macs(*graph, node);
  const double pixels = static_cast<double>(h * w);
  EXPECT_EQ(parameter_count(*graph), count.parameters) << name;
  EXPECT_DOUBLE_EQ(static_cast<double>(macs), count.macs() * pixels) << name;
  EXPECT_DOUBLE_EQ(static_cast<double>(counter_operations(*graph)),
                   count.counter_operations() * pixels)
      << name;
}

TEST(Layers, CountsSrpo) {
  const LayerCounts count = counts(kSrpo);
  EXPECT_EQ(count.parameters, 8434u);
  EXPECT_EQ(count.macs_lr, 1200 + 6400);
  EXPECT_EQ(count.macs_hr, 3200);
  EXPECT_EQ(count.counter_bias, 40);
  EXPECT_EQ(count.counter_activation, 32);
  EXPECT_EQ(count.counter_upsample, 64);
  EXPECT_EQ(count.counter_operations(), 10936);
  expect_graph_agrees("srpo", parsed(kSrpo), 720, 1080);
}

TEST(Layers, ChargesTransposedConvolutionTwice) {
  // FSRCNN in small: a true multiply happens at an input position, the counter takes every output
  // position.
  const LayerCounts count = counts(R"([
    {"op": "conv2d", "k": 5, "cin": 1, "cout": 4, "bias": true, "act": "prelu", "at": "lr"},
    {"op": "conv2d", "k": 1, "cin": 4, "cout": 2, "bias": true, "act": "PReLU"},
    {"op": "conv2d", "k": [3, 3], "cout": 2, "bias": true}, {"op": "prelu"},
    {"op": "conv2d", "k": 1, "cin": 2, "cout": 4, "bias": true, "act": "prelu", "at": "lr"},
    {"op": "transpose_conv2d", "k": 9, "stride": 2, "cin": 4, "cout": 1, "bias": true, "at": "hr"}])");
  EXPECT_EQ(count.parameters, 100u + 4 + 4 + 8 + 2 + 2 + 36 + 2 + 2 + 8 + 4 + 4 + 324 + 1);
  EXPECT_EQ(count.macs(), 100 + 8 + 36 + 8 + 324);
  EXPECT_EQ(count.macs_hr, 0);
  EXPECT_EQ(count.counter_macs, 100 + 8 + 36 + 8 + 4 * 324);
  EXPECT_EQ(count.counter_bias, 4 + 2 + 2 + 4 + 4);
  EXPECT_EQ(count.counter_activation, 4 + 2 + 2 + 4);
}

TEST(Layers, TakesTheUsualSpellings) {
  const double expected = 4 * 9 * 8 * 3;
  for (const char* op :
       {"transpose_conv2d", "conv_transpose2d", "ConvTranspose2d", "deconv", "transposed_conv2d"})
    for (const char* at : {"", R"(, "at": "lr")", R"(, "at": "hr")"}) {
      const std::string json = fmt::format(
          R"([{{"op": "{}", "k": 3, "stride": 2, "cin": 8, "cout": 3, "bias": false{}}}])", op, at);
      EXPECT_EQ(counts(json).counter_macs, expected) << json;
    }
  EXPECT_EQ(counts(R"([{"op": "Conv2d", "k": [1, 3], "cin": 2, "cout": 2, "groups": 2}])").macs(),
            3 * 2);
  EXPECT_EQ(counts(R"([{"op": "depthwise_conv2d", "k": 3, "cin": 4, "cout": 4, "bias": false}])")
                .parameters,
            36u);
  EXPECT_EQ(parsed(R"([{"op": "PixelShuffle", "factor": 2, "channels": 12}])")[0].out_channels, 3);
}

TEST(Layers, FollowsTheGridWhereTheFileDoesNotNameIt) {
  const std::string head = R"([{"op": "conv2d", "k": 3, "cin": 1, "cout": 8, "bias": false}, )";
  const std::string tail = R"({"op": "conv2d", "k": 1, "cout": 1, "bias": false}])";
  EXPECT_EQ(counts(head + R"({"op": "depth_to_space", "factor": 2}, )" + tail).macs_hr, 4 * 2);
  EXPECT_EQ(counts(head + R"({"op": "upsample", "factor": 3}, )" + tail).macs_hr, 9 * 8);
  EXPECT_EQ(counts(head + R"({"op": "max_pool2d", "k": 2}, )" + tail).macs(), 72 + 8 / 4.0);
  const std::vector<Layer> strided =
      parsed(head + R"({"op": "conv2d", "k": 3, "stride": [2, 1], "cout": 8}, )" + tail);
  EXPECT_EQ(strided[2].in.h, (Ratio{1, 2}));
  EXPECT_EQ(strided[2].in.w, (Ratio{1, 1}));
}

TEST(Layers, CountsPoolingAtItsInputAndBatchNormTwice) {
  const LayerCounts count =
      counts(R"([{"op": "avg_pool2d", "k": 2, "channels": 6}, {"op": "batch_norm"}])");
  EXPECT_EQ(count.counter_other, 6 + 2 * 6 / 4.0);
  EXPECT_EQ(count.parameters, 12u);
}

TEST(Layers, GivesNothingForFreeOperators) {
  const LayerCounts count =
      counts(R"([{"op": "conv2d", "k": 3, "cin": 1, "cout": 24, "bias": false, "act": "sigmoid"},
    {"op": "depth_to_space", "factor": 2}, {"op": "split", "parts": ["value", "query", "key"]},
    {"op": "softmax_of", "arg": "query*key", "axis": "channel"}, {"op": "weighted_sum", "axis": "channel"}, {"op": "tanh"}])");
  EXPECT_EQ(count.parameters, 216u);
  EXPECT_EQ(count.counter_operations(), 216);
}

TEST(Layers, BuildsGraphsThatCostWhatTheListSays) {
  for (
      const char* json : {
          kSrpo,
          R"([{"op": "conv2d", "k": 3, "cin": 1, "cout": 24, "bias": false}, {"op": "depth_to_space", "factor": 2},
               {"op": "split", "parts": ["value", "query", "key"]}, {"op": "softmax_of", "arg": "query*key"},
               {"op": "weighted_sum"}])",
          R"([{"op": "conv2d", "k": 3, "cin": 1, "cout": 16, "bias": false}, {"op": "pixel_shuffle", "factor": 2},
               {"op": "split", "parts": ["value", "key"]}, {"op": "softmax_of", "arg": "key"}, {"op": "weighted_sum"}])",
          R"([{"op": "conv2d", "k": 3, "cin": 2, "cout": 8, "act": "relu6"}, {"op": "deconv", "k": 9, "stride": 2, "cout": 1}])",
          R"([{"op": "deconv", "k": 2, "stride": 3, "cin": 4, "cout": 2, "bias": false}, {"op": "reduce_sum"}])",
          R"([{"op": "conv2d", "k": [3, 5], "stride": 2, "cin": 4, "cout": 1, "bias": true}, {"op": "sigmoid"}])",
          R"([{"op": "conv2d", "k": 3, "groups": 6, "cin": 6, "cout": 12}, {"op": "max_pool2d", "k": 2},
               {"op": "avg_pool2d", "k": 3, "stride": 1}, {"op": "tanh"}, {"op": "relu"}])",
          R"([{"op": "conv2d", "k": 3, "cin": 4, "cout": 1, "at": "hr"}, {"op": "conv2d", "k": 3, "cin": 8, "cout": 16, "at": "hr"},
               {"op": "conv2d", "k": 3, "cin": 3, "cout": 2, "at": "lr"}])",
      })
    expect_graph_agrees(json, parsed(json), 12, 20);
}

TEST(Layers, BuildsTheSameGraphTwice) {
  const Result<Graph> a = graph_of_layers("srpo", parsed(kSrpo), 4, 6),
                      b = graph_of_layers("srpo", parsed(kSrpo), 4, 6);
  ASSERT_TRUE(a && b);
  EXPECT_EQ(*a, *b);
}

TEST(Layers, SaysWhatHasNoGraph) {
  const auto error = [](std::string_view json, int64_t h = 4) {
    const Result<Graph> graph = graph_of_layers("x", parsed(json), h, 4);
    return graph ? std::string("built") : graph.error().text();
  };
  EXPECT_EQ(error(R"([{"op": "prelu", "channels": 2}])"),
            "layers[0] (prelu): has no INT8 graph; it can only be counted");
  EXPECT_EQ(error(R"([{"op": "batch_norm", "channels": 2}])"),
            "layers[0] (batch_norm): has no INT8 graph; it can only be counted");
  EXPECT_EQ(error(R"([{"op": "upsample", "mode": "bilinear", "factor": 2, "channels": 2}])"),
            "layers[0] (upsample): has no INT8 graph; it can only be counted");
  EXPECT_EQ(error(R"([{"op": "max_pool2d", "k": 2, "channels": 2}])", 5),
            "layers[0] (max_pool2d): 5x4 pixels do not give a whole number of positions");
  EXPECT_EQ(error(R"([{"op": "conv2d", "k": 1, "stride": 2, "cin": 2, "cout": 2}])"),
            "layers[0] (conv2d): a stride above the kernel size has no INT8 graph here");
  EXPECT_EQ(error("[]"), "layers: the list is empty");
  EXPECT_EQ(error(R"([{"op": "weighted_sum", "channels": 2}])"),
            "layers[0] (weighted_sum): there is no split before that tells what is summed");
  EXPECT_EQ(error(R"([{"op": "conv2d", "k": 1024, "cin": 65536, "cout": 65536, "bias": false}])"),
            "4503599627370496 parameters, a graph is built for up to 268435456");
  EXPECT_EQ(error(kSrpo, 0), "0x4 pixels, expected 1 to 16384 a side");
}

TEST(Layers, RefusesBadLists) {
  EXPECT_EQ(refusal("[{"), "is not valid JSON at byte 3");
  EXPECT_EQ(refusal("{}"), "layers: must be a list of at most 1024 layers");
  EXPECT_EQ(refusal("[1]"), "layers[0]: a layer must be an object");
  EXPECT_EQ(refusal(R"([{"k": 3}])"), "layers[0]: \"op\" must be a text");
  EXPECT_EQ(refusal(R"([{"op": "lstm"}])"),
            "layers[0] (lstm): \"lstm\" is no operator that can be counted");
  EXPECT_EQ(refusal(R"([{"op": "conv2d", "k": 3, "cin": 1, "cout": 1, "act": "swish"}])"),
            "layers[0] (conv2d): \"swish\" is no activation that can be counted");
  const auto conv = [](const std::string& fields) {
    return refusal(R"([{"op": "conv2d", )" + fields + "}]");
  };
  const std::string where = "layers[0] (conv2d): ";
  EXPECT_EQ(conv(R"("cin": 1, "cout": 1)"), where + "\"k\" is missing");
  EXPECT_EQ(conv(R"("k": 0, "cin": 1, "cout": 1)"), where + "\"k\" must be 1 to 1024");
  EXPECT_EQ(conv(R"("k": 18446744073709551615, "cin": 1, "cout": 1)"),
            where + "\"k\" must be 1 to 1024");
  EXPECT_EQ(conv(R"("k": -9223372036854775808, "cin": 1, "cout": 1)"),
            where + "\"k\" must be 1 to 1024");
  EXPECT_EQ(conv(R"("k": 2.5, "cin": 1, "cout": 1)"), where + "\"k\" must be an integer");
  EXPECT_EQ(conv(R"("k": [3, 3, 3], "cin": 1, "cout": 1)"),
            where + "\"k\" must be a number or [h,w]");
  EXPECT_EQ(conv(R"("k": [3, "3"], "cin": 1, "cout": 1)"), where + "\"k\" must be an integer");
  EXPECT_EQ(conv(R"("k": 3, "cout": 1)"), where + "\"cin\" is missing");
  EXPECT_EQ(conv(R"("k": 3, "cin": 1)"), where + "\"cout\" is missing");
  EXPECT_EQ(conv(R"("k": 3, "cin": 1, "cout": 1, "bias": 1)"),
            where + "\"bias\" must be true or false");
  EXPECT_EQ(conv(R"("k": 3, "cin": 3, "cout": 4, "groups": 2)"),
            where + "2 groups do not divide 3 input and 4 output channels");
  EXPECT_EQ(conv(R"("k": 3, "cin": 1, "cout": 1, "at": "mr")"),
            where + "\"at\" is \"mr\", expected \"lr\" or \"hr\"");
  EXPECT_EQ(refusal(R"([{"op": "conv2d", "k": 3, "cin": 1, "cout": 1, "at": "hr"}])", 0),
            where + "\"at\" is \"hr\", but the scale is not given");
  EXPECT_EQ(refusal(R"([{"op": "depth_to_space", "factor": 2, "channels": 6}])"),
            "layers[0] (depth_to_space): 6 channels are no multiple of 4");
  EXPECT_EQ(refusal(R"([{"op": "split", "parts": [], "channels": 6}])"),
            "layers[0] (split): \"parts\" must be a list of 1 to 16 names");
  EXPECT_EQ(refusal(R"([{"op": "softmax_of", "arg": "a**b", "channels": 6}])"),
            "layers[0] (softmax_of): \"arg\" is \"a**b\", expected names joined by *");
  std::string growing = R"([{"op": "conv2d", "k": 1, "cin": 1, "cout": 1})";
  for (int i = 0; i < 100; ++i) growing += R"(, {"op": "upsample", "factor": 64})";
  EXPECT_EQ(refusal(growing + "]"),
            "layers[4] (upsample): the grid is 16777216/1 of the input, which is beyond 1048576");
  EXPECT_EQ(refusal(std::string(100000, '[')), "is not valid JSON at byte 100001");
}

std::string table_with(const std::string& row) {
  return R"({"schema": "cost-tables/1", "rows": [)" + row + "]}";
}

std::string table_refusal(const std::string& json) {
  const auto rows = parse_cost_table(json);
  return rows ? "accepted" : rows.error().text();
}

TEST(CostTable, RefusesBadTables) {
  EXPECT_EQ(table_refusal("nonsense"), "is not valid JSON at byte 2");
  EXPECT_EQ(table_refusal("[]"), "is no JSON object of schema \"cost-tables/1\"");
  EXPECT_EQ(table_refusal(R"({"schema": "cost-tables/2"})"),
            "\"schema\" is \"cost-tables/2\", expected \"cost-tables/1\"");
  EXPECT_EQ(table_refusal(R"({"schema": "cost-tables/1"})"),
            "\"rows\" must be a list of at most 10000 rows");
  EXPECT_EQ(table_refusal(table_with("3")), "rows[0]: must be an object");
  EXPECT_EQ(table_refusal(table_with("{}")), "rows[0]: \"id\" must be a text");
  EXPECT_EQ(table_refusal(table_with(R"({"id": "a"}, {"id": "a"})")),
            "rows[1]: the id \"a\" is used twice");
  EXPECT_EQ(table_refusal(table_with(R"({"id": "a", "convention": "flops"})")),
            "row \"a\": \"convention\" is \"flops\", expected \"mac\" or \"counter_A\"");
  EXPECT_EQ(table_refusal(table_with(R"({"id": "a", "layers": [{"op": "lstm"}]})")),
            "row \"a\", layers[0] (lstm): \"lstm\" is no operator that can be counted");
  for (const char* stated : {R"("8.43X")", R"("K")", R"("")", R"("1.2.3K")", "8.43", "-1", "[]"})
    EXPECT_EQ(
        table_refusal(table_with(fmt::format(R"({{"id": "a", "params_stated": {}}})", stated))),
        "row \"a\": \"params_stated\" must be an integer or a text like \"8.43K\"");
  EXPECT_EQ(table_refusal(table_with(R"({"id": "a", "flops_stated_g": "6"})")),
            "row \"a\": \"flops_stated_g\" must be a number of at least 0");
  EXPECT_EQ(table_refusal(table_with(R"({"id": "a", "resolution_reproducing": {"w": 5}})")),
            "row \"a\", \"resolution_reproducing\": \"h\" is missing");
}

TEST(CostTable, ComparesToThePrintedDigit) {
  const auto verdict = [](const std::string& fields) {
    const std::string row = R"({"id": "a", "scale": 2, "convention": "counter_A", "layers": )" +
                            std::string(kSrpo) + fields + "}";
    const auto rows = parse_cost_table(table_with(row));
    if (!rows) return rows.error().text();
    const RowCheck check = check_row(rows->front());
    return fmt::format("{}, {}", agreement_text(check.parameters),
                       agreement_text(check.giga_agreement));
  };
  const std::string size = R"(, "resolution_reproducing": {"w": 1080, "h": 720})";
  EXPECT_EQ(verdict(R"(, "params_stated": "8.43K", "flops_stated_g": 8.5)" + size),
            "reproduced, reproduced");
  EXPECT_EQ(verdict(R"(, "params_stated": "8.44K", "flops_stated_g": 8.51)" + size),
            "differs, differs");
  EXPECT_EQ(
      verdict(R"(, "params_stated": 8434, "flops_stated_g": 8.51, "tolerance_g": 0.01)" + size),
      "reproduced, reproduced");
  EXPECT_EQ(verdict(R"(, "params_stated": 8430)"), "differs, not stated");
  EXPECT_EQ(verdict(R"(, "params_stated": "8K", "flops_stated_g": 8.5)"),
            "reproduced, no resolution");
  EXPECT_EQ(verdict(R"(, "params_stated": null, "flops_stated_g": null)"),
            "not stated, not stated");
  EXPECT_EQ(verdict(R"(, "params_stated": "0.01M")"), "reproduced, not stated");
}

/// The published figures that the project collected.
class PublishedTable : public testing::Test {
 protected:
  void SetUp() override {
    const Result<std::string> text = read_text(SHALE_SOURCE_DIR "/tests/golden/cost_tables.json");
    ASSERT_TRUE(text) << text.error().text();
    json_ = Json::parse(*text);
    Result<std::vector<CostRow>> rows = parse_cost_table(*text);
    ASSERT_TRUE(rows) << rows.error().text();
    rows_ = *std::move(rows);
  }

  Json json_;
  std::vector<CostRow> rows_;
};

TEST_F(PublishedTable, OfSrpoIsReproduced) {
  size_t found = 0;
  for (const CostRow& row : rows_) {
    if (!row.id.starts_with("srpo_t1_")) continue;
    ++found;
    const RowCheck check = check_row(row);
    EXPECT_EQ(check.parameters, Agreement::kReproduced)
        << row.id << ": " << check.counts.parameters;
    EXPECT_EQ(check.giga_agreement, Agreement::kReproduced) << row.id << ": " << check.giga;
    EXPECT_EQ(row.lr_h * row.lr_w, 777600) << row.id;
    if (row.id == "srpo_t1_srpo") {
      EXPECT_EQ(check.counts.parameters, 8434u);
      EXPECT_EQ(fmt::format("{:.2f}", check.giga), "8.50");
    }
  }
  EXPECT_GE(found, 4u);
}

TEST_F(PublishedTable, HasNoRowThatDiffers) {
  for (const CostRow& row : rows_) {
    EXPECT_EQ(row.layers.empty(), row.is_timing()) << row.id;
    const RowCheck check = check_row(row);
    EXPECT_FALSE(check.differs()) << row.id << ": " << check.counts.parameters << " parameters, "
                                  << check.giga << " G";
    EXPECT_EQ(check.parameters == Agreement::kNotStated, !row.parameters_stated) << row.id;
  }
}

TEST_F(PublishedTable, HoldsTheCountsThatWereDerivedByHand) {
  for (size_t i = 0; i < rows_.size(); ++i) {
    if (rows_[i].layers.empty()) continue;
    const std::string& id = rows_[i].id;
    const LayerCounts count = count_layers(rows_[i].layers);
    const Json& row = json_["rows"][i];
    EXPECT_EQ(Json(count.parameters), row["params"]) << id;
    const double scale = static_cast<double>(rows_[i].scale);
    const std::pair<const char*, double> figures[] = {
        {"macs_per_lr_px", count.macs()},
        {"macs_per_hr_px", count.macs() / (scale * scale)},
        {"counter_macs_per_lr_px", count.counter_macs},
        {"bias_per_lr_px", count.counter_bias},
        {"act_per_lr_px", count.counter_activation},
        {"upsample_per_lr_px", count.counter_upsample},
        {"counter_ops_per_lr_px", count.counter_operations()},
    };
    for (const auto& [name, value] : figures)  // a row holds some of them
      EXPECT_EQ(value, row["computed"].value(name, value)) << id << " " << name;
  }
}

TEST_F(PublishedTable, HoldsNetworksWhoseGraphsCostTheSame) {
  size_t built = 0;
  for (const CostRow& row : rows_) {
    if (row.layers.empty()) continue;
    expect_graph_agrees(row.id, row.layers, 24, 40);
    ++built;
  }
  EXPECT_GE(built, 18u);
}

}  // namespace
}  // namespace shale
