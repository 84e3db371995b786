#include "compiler/plan/frame.h"

#include <gtest/gtest.h>

#include "tests/compiler/frame_support.h"

namespace shale {
namespace {

TEST(FrameJson, ReadsEveryField) {
  const Frame frame = must(parse_frame(kFrame));
  ASSERT_EQ(frame.images.size(), 4u);
  EXPECT_EQ(frame.images[0].name, "color");
  EXPECT_EQ(frame.images[0].category, Category::kImageInput);
  EXPECT_EQ(frame.images[0].format, ImageFormat::kRgba8Unorm);
  EXPECT_EQ(frame.images[1].category, Category::kImageOutput);
  EXPECT_EQ(frame.images[1].shows, "kept");
  EXPECT_TRUE(frame.images[1].size.of_output);
  EXPECT_EQ(frame.images[2].category, Category::kImageHistory);
  EXPECT_EQ(frame.images[2].history_depth, 3u);
  EXPECT_EQ(frame.images[3].size({10, 6}, {20, 12}), (FrameExtent{8, 8}));
  EXPECT_EQ(frame.images[3].size({33, 32}, {66, 64}), (FrameExtent{16, 8}));
  ASSERT_EQ(frame.tensors.size(), 1u);
  EXPECT_EQ(frame.tensors[0].quantization, (Quantization{0.5f, -3}));
  ASSERT_TRUE(frame.tensors[0].size);
  EXPECT_EQ(frame.render, (FrameExtent{10, 6}));
  EXPECT_EQ(frame.max_ratio, 3.0);
  ASSERT_EQ(frame.params.size(), 3u);
  EXPECT_EQ(frame.params[0].default_values, std::vector<float>{0.5f});
  EXPECT_EQ(frame.params[1].offset_bytes, 8u);
  EXPECT_EQ(frame.params[2].offset_bytes, 16u);
  EXPECT_EQ(frame.params[2].source, ParamSource::kReset);
  ASSERT_EQ(frame.views.size(), 1u);
  EXPECT_EQ(frame.views[0].view.first_channel, 1u);
  ASSERT_EQ(frame.programs.size(), 1u);
  EXPECT_EQ(frame.programs[0].name, "frame");
  const std::vector<FramePass>& passes = frame.programs[0].passes;
  ASSERT_EQ(passes.size(), 3u);
  ASSERT_EQ(passes[0].defines.size(), 2u);
  EXPECT_EQ(passes[0].workgroup[0], 8u);
  EXPECT_EQ(passes[0].workgroup[1], 4u);
  EXPECT_EQ(passes[0].clears, std::vector<std::string>{"marks"});
  ASSERT_EQ(passes[0].bindings.size(), 4u);
  const FrameBinding& old = passes[0].bindings[1];
  EXPECT_EQ(old.name, "kept");
  EXPECT_EQ(old.handle, "old");
  EXPECT_EQ(old.frames_back, 2u);
  EXPECT_TRUE(old.reads && !old.writes);
  EXPECT_TRUE(!passes[0].bindings[2].reads && passes[0].bindings[2].writes);
  EXPECT_TRUE(passes[0].bindings[3].reads && passes[0].bindings[3].writes);
  EXPECT_EQ(passes[1].graph, "main");
  EXPECT_EQ(graph_files(frame), std::vector<std::string>{"main"});
}

TEST(FrameJson, ReadsThePatternOfItsSamples) {
  const auto pattern = [](const std::string& field) {
    std::string text(kFrame);
    text.insert(text.find("\"render\""), field);
    return must(parse_frame(text)).pattern;
  };
  EXPECT_EQ(pattern(""), SamplingPattern{});
  EXPECT_EQ(pattern("\"pattern\": \"mnss\", ").kind, SamplingPattern::Kind::kMnss);
  EXPECT_EQ(pattern("\"pattern\": [[0.25, -0.25], [0, 0.5]], "),
            must(pattern_of({{0.25f, -0.25f}, {0, 0.5f}})));
}

TEST(FrameJson, ReadsProgramsWithGraphsOfTheirOwn) {
  const Frame frame =
      must(parse_frame(R"({"schema": "shale-frame/2", "render": [4, 4], "output": [4, 4],
    "tensors": [{"name": "flow", "scale": 0.5, "depth": 2}],
    "programs": [
      {"name": "upscale", "passes": [{"graph": "a.tosa"}]},
      {"name": "generate", "passes": [{"name": "flow_net", "graph": "b.tosa", "tensors": {"output": "flow"}}, {"graph": "a.tosa"}]}]})"));
  ASSERT_EQ(frame.programs.size(), 2u);
  EXPECT_EQ(frame.programs[1].name, "generate");
  EXPECT_EQ(frame.programs[1].passes[0].name, "flow_net");
  EXPECT_EQ(frame.programs[1].passes[0].tensors.at("output"), "flow");
  EXPECT_EQ(graph_files(frame), (std::vector<std::string>{"a.tosa", "b.tosa"}));
  EXPECT_EQ(frame.tensors[0].history_depth, 2u);
}

TEST(FrameJson, MakesAProgramOfEachSetOfWeights) {
  const std::string json = R"({"schema": "shale-frame/2", "render": [4, 4], "output": [4, 4],
    "params": [{"name": "jitter", "type": "vec2"}, {"name": "fresh", "type": "int", "reset": true}],
    "sets": {"chosen_by": "jitter", "at": [[0, 0.5], [-0.25, 0]]},
    "passes": [{"graph": ["a.tosa", "b.tosa"]}, {"name": "both", "graph": "c.tosa"}]})";
  const Frame frame = must(parse_frame(json));
  EXPECT_EQ(frame.chosen_by, "jitter");
  ASSERT_EQ(frame.programs.size(), 2u);
  EXPECT_EQ(frame.programs[1].name, "set_1");
  EXPECT_EQ(frame.programs[1].at, (std::vector<float>{-0.25f, 0}));
  EXPECT_EQ(frame.programs[0].passes[0].graph, "a.tosa");
  EXPECT_EQ(frame.programs[1].passes[0].graph, "b.tosa");
  EXPECT_EQ(frame.programs[1].passes[1].graph, "c.tosa");
  EXPECT_EQ(frame.programs[1].passes[1].name, "both_1");
  EXPECT_EQ(graph_files(frame), (std::vector<std::string>{"a.tosa", "c.tosa", "b.tosa"}));
  const char* const rows[][3] = {
      {"\"chosen_by\": \"jitter\"", "\"chosen_by\": \"index\"",
       "frame.sets: \"chosen_by\" is \"index\", which is no parameter of the host"},
      {"\"chosen_by\": \"jitter\"", "\"chosen_by\": \"fresh\"",
       "frame.sets: \"chosen_by\" is \"fresh\", which is no parameter of the host"},
      {"[[0, 0.5], [-0.25, 0]]", "[]", "frame.sets: \"at\" holds no set"},
      {"[-0.25, 0]", "[-0.25]", "frame.sets.at[1]: must be a list of 2, as \"jitter\" has values"},
      {"[-0.25, 0]", "[-0.25, \"0\"]", "frame.sets.at[1]: must be a list of numbers"},
      {"[-0.25, 0]", "[-0.25, 1e300]", "frame.sets.at[1]: must be a list of numbers"},
      {"\"a.tosa\", \"b.tosa\"", "\"a.tosa\"",
       "frame.passes[0]: \"graph\" must be a file, or one for each of 2 sets"},
      {"\"b.tosa\"", "2", "frame.passes[0]: \"graph\" must be a file, or one for each of 2 sets"},
      {"{\"chosen_by\": \"jitter\", \"at\": [[0, 0.5], [-0.25, 0]]}", "7",
       "frame.sets: \"chosen_by\" must be a text"},
  };
  for (const auto& [from, to, message] : rows)
    EXPECT_EQ(error_text(parse_frame(replaced(json, from, to))), message);
}

TEST(FrameJson, NamesTheFieldThatIsWrong) {
  struct Row {
    const char *from, *to, *message;
  };
  const Row rows[] = {
      {"shale-frame/2", "shale-frame/3", "frame: schema \"shale-frame/3\" is unknown"},
      {"shale-frame/2", "shale-frame/1", "frame: schema \"shale-frame/1\" is no longer read"},
      {"\"schema\": \"shale-frame/2\",", "", "frame: \"schema\" must be a text"},
      {"\"name\": \"color\"", "\"name\": \"\"", "frame.images[0]: \"name\" must be a text"},
      {"\"name\": \"color\"", "\"name\": \"2color\"",
       "frame.images[0]: the name \"2color\" is no identifier"},
      {"\"name\": \"color\"", "\"name\": \"col or\"",
       "frame.images[0]: the name \"col or\" is no identifier"},
      {"\"role\": \"input\"", "\"role\": \"in\"", "frame.images[0]: role \"in\" is none of"},
      {"\"role\": \"input\",", "", "frame.images[0]: \"role\" must be a text"},
      {"\"role\": \"input\",", "\"role\": \"input\", \"linear\": true,",
       "frame.images[0]: \"linear\" is of schema shale-frame/1"},
      {"\"role\": \"input\",", "\"role\": \"input\", \"shows\": \"kept\",",
       "frame.images[0]: \"shows\" is for outputs"},
      {"\"rgba8_unorm\", \"size\": \"render\"}", "\"rgba9\", \"size\": \"render\"}",
       "frame.images[0]: format \"rgba9\" is no image format"},
      {"\"rgba8_unorm\", \"size\": \"render\"}", "\"rgba8_sint\", \"size\": \"render\"}",
       "frame.images[0]: format \"rgba8_sint\" is no image format"},
      {"\"size\": \"output\", \"shows\"", "\"size\": \"window\", \"shows\"",
       "frame.images[1]: \"size\" must be"},
      {"\"divide\": 4", "\"divide\": 0", "frame.images[3].size: \"divide\" is 0"},
      {"\"divide\": 4", "\"divide\": [4]",
       "frame.images[3].size: \"divide\" must be one or two whole numbers from 1 to 64"},
      {"\"divide\": 4", "\"divide\": [4, 0]",
       "frame.images[3].size: \"divide\" must be one or two whole numbers from 1 to 64"},
      {"\"multiple\": 8", "\"multiple\": 1.5", "frame.images[3].size: \"multiple\" is 1.5"},
      {"\"render\": [10, 6]", "\"render\": [10, 0]", "frame: \"render\" has the side 0"},
      {"\"output\": [20, 12]", "\"output\": 20", "frame: \"output\" must be a width and a height"},
      {"\"output\": [20, 12]", "\"output\": [20, 20]", "is a ratio outside 1.5 to 3"},
      {"\"output\": [20, 12]", "\"output\": [20, 12], \"pattern\": 3",
       "frame: \"pattern\" must be halton, mnss, or a list of [x, y]"},
      {"\"output\": [20, 12]", "\"output\": [20, 12], \"pattern\": \"random\"",
       "frame.pattern: \"random\" is none of halton, mnss, and offsets X,Y:X,Y:..."},
      {"\"output\": [20, 12]", "\"output\": [20, 12], \"pattern\": [[0, 0], [0]]",
       "frame.pattern: entry 1 must be [x, y]"},
      {"\"output\": [20, 12]", "\"output\": [20, 12], \"pattern\": [[0, 0.75]]",
       "frame.pattern: the offset 0,0.75 is outside -0.5 to 0.5"},
      {"\"output\": [20, 12]", "\"output\": [20, 12], \"pattern\": []",
       "frame.pattern: has 0 offsets"},
      {"\"output\": [20, 12]", "\"output\": [20, 12], \"settles\": {}",
       "frame.settles: \"image\" must be a text"},
      {"\"output\": [20, 12]", "\"output\": [20, 12], \"settles\": {\"image\": \"color\"}",
       "frame.settles: \"image\" is \"color\", which is no history of rgba16_float"},
      {"[1.5, 3]", "[0.5, 3]", "frame: \"ratio\" is 0.5 to 3, expected a range within 1 to 16"},
      {"[1.5, 3]", "[\"1\", 3]", "frame: \"ratio\" must be the least and the largest ratio"},
      {"\"type\": \"vec2\"", "\"type\": \"mat2\"",
       "frame.params[1]: type \"mat2\" is none of float, vec2..4, int, ivec2..4"},
      {"\"default\": [0.5]", "\"default\": 0.5",
       "frame.params[0]: \"default\" must be a list of 1"},
      {"\"default\": [0.5]", "\"default\": [\"a\"]",
       "frame.params[0]: \"default\" must be a list of numbers"},
      {"\"reset\": true", "\"reset\": 1", "frame.params[2]: \"reset\" must be true or false"},
      {"\"of\": \"x\"", "\"of\": 3", "frame.views[0]: \"of\" must be a text"},
      {"\"channels\": 3", "\"channels\": 4", "frame.views[0]: \"channels\" is 4"},
      {"\"SIDE\": 2", "\"SI DE\": 2", "frame.passes[0]: the definition \"SI DE\" is no name"},
      {"\"SIDE\": 2", "\"SIDE\": \"2\"", "frame.passes[0]: the definition \"SIDE\" is no name"},
      {"\"depth\": 3", "\"depth\": 1", "frame.images[2]: \"depth\" is 1"},
      {"\"depth\": 3", "\"depth\": 2.5", "frame.images[2]: \"depth\" is 2.5, expected an integer"},
      {"\"scale\": 0.5", "\"scale\": 0", "frame.tensors[0]: \"scale\" is 0"},
      {"\"scale\": 0.5,", "", "frame.tensors[0]: \"scale\" must be a number"},
      {"\"zero_point\": -3", "\"zero_point\": 65536", "frame.tensors[0]: \"zero_point\" is 65536"},
      {"{\"name\": \"x\",", "{", "frame.tensors[0]: \"name\" must be a text"},
      {"\"name\": \"pre\"", "\"name\": \"p-r-e\"",
       "frame.passes[0]: the name \"p-r-e\" is no identifier"},
      {"\"shader\": \"pre.comp\",", "", "frame.passes[0]: \"shader\" must be a text"},
      {"\"over\": \"color\",", "", "frame.passes[0]: \"over\" must be a text"},
      {"[8, 4]", "[8]", "frame.passes[0]: \"workgroup\" must be two whole numbers"},
      {"[8, 4]", "[8, -4]", "frame.passes[0]: \"workgroup\" must be two whole numbers"},
      {"[8, 4]", "[8, 33]", "frame.passes[0]: workgroup size 33 is outside 1..32"},
      {"[8, 4]", "[0, 4]", "frame.passes[0]: workgroup size 0 is outside 1..32"},
      {"\"clears\": [\"marks\"]", "\"clears\": [1]", "frame.passes[0].clears[0]: must be a name"},
      {"\"clears\": [\"marks\"]", "\"copy\": \"marks\"",
       "frame.passes[0]: \"copy\" is of schema shale-frame/1"},
      {"\"of\": \"kept\", \"frames", "\"of\": 5, \"frames",
       "frame.passes[0].reads[1]: \"of\" must be a text"},
      {"\"as\": \"old\"", "\"as\": \"color\"",
       "frame.passes[0].reads[1]: the name \"color\" is used twice"},
      {"\"as\": \"old\"", "\"as\": \"o-l-d\"",
       "frame.passes[0].reads[1]: the name \"o-l-d\" is no identifier"},
      {"\"frames_back\": 2", "\"frames_back\": 8",
       "frame.passes[0].reads[1]: \"frames_back\" is 8"},
      {"\"writes\": [\"x\"]", "\"writes\": [{\"of\": \"x\", \"frames_back\": 1}]",
       "frame.passes[0].writes[0]: \"frames_back\" is 1: only this frame's can be written"},
      {"\"reset\": true", "\"time\": 1", "\"time\" must be true or false"},
      {"{\"graph\": \"main\"}", "{\"graph\": 1}", "frame.passes[1]: \"graph\" must be a text"},
      {"{\"graph\": \"main\"}", "{\"graph\": \"main\", \"tensors\": {\"y\": \"a b\"}}",
       "frame.passes[1]: the name of \"y\" is no identifier"},
      {"\"images\": [", "\"images\": 3, \"other\": [",
       "frame: \"images\" must be a list of at most 64 entries"},
      {"\"passes\": [", "\"passes\": {}, \"other\": [",
       "frame: \"passes\" must be a list of at most 64 entries"},
      {"\"passes\": [", "\"passes\": [], \"other\": [", "frame.passes: there is no pass"},
      {"\"passes\": [", "\"programs\": [], \"other\": [", "frame.programs: there is no program"},
      {"\"passes\": [", "\"programs\": [], \"passes\": [",
       "frame: either \"passes\" or \"programs\" must be there"},
      {"{\"graph\": \"main\"},", "7, {\"graph\": \"main\"},",
       "frame.passes[1]: \"name\" must be a text"},
  };
  for (const Row& row : rows) {
    const std::string text = replaced(kFrame, row.from, row.to);
    ASSERT_NE(text, kFrame) << row.from;
    const std::string error = error_text(parse_frame(text));
    EXPECT_NE(error.find(row.message), std::string::npos)
        << "expected: " << row.message << "\nfound:    " << error;
  }
  EXPECT_EQ(error_text(parse_frame("")), "is not valid JSON at byte 1");
  EXPECT_EQ(error_text(parse_frame("[]")), "is no JSON object");
  EXPECT_EQ(error_text(parse_frame(std::string(kFrame, 300))), "is not valid JSON at byte 301");
}

TEST(FrameJson, SurvivesEveryCut) {
  const std::string text = kFrame;
  for (size_t length = 0; length < text.size(); ++length)
    EXPECT_FALSE(parse_frame(text.substr(0, length))) << length;
}

}  // namespace
}  // namespace shale
