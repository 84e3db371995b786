#include "tools/eval/html_report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>

#include "ir/base/file.h"
#include "tools/eval/tonemap.h"

namespace shale {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kNastyName = "a<script>alert(\"1\")</script>&'b";

/// A made-up picture; `error` lowers it in places.
FloatImage picture(uint32_t width, uint32_t height, double error) {
  FloatImage image{width, height, 3, std::vector<float>(size_t{width} * height * 3)};
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x)
      for (uint32_t c = 0; c < 3; ++c) {
        const double wave = 0.5 + 0.3 * std::sin(0.05 * x * (c + 1)) * std::cos(0.04 * y) +
                            0.1 * (((x / 24) ^ (y / 24)) & 1);
        const double fault = error * std::sin(0.9 * x + c) * std::sin(0.013 * y + 0.01 * x);
        image.at(x, y)[c] =
            static_cast<float>(std::lround(255 * std::clamp(wave + fault, 0.0, 1.0))) / 255;
      }
  return image;
}

EvalReport made_up_report(uint32_t width = 200, uint32_t height = 150, uint32_t frames = 12) {
  EvalReport report;
  report.title = "Upscalers & friends";
  report.device = "a <device>";
  report.notes = {"Depth as in the buffer, hyperbolic."};
  report.methods = {"bilinear", kNastyName, "network"};
  for (const char* name : {"hall", "<b>yard"}) {
    EvalScene scene;
    scene.name = name;
    scene.size = "960x540 to 1920x1080";
    scene.frames = frames;
    scene.first_frame = 100;
    for (size_t m = 0; m < report.methods.size(); ++m) {
      MethodResult result;
      for (uint32_t t = 0; t < frames; ++t) {
        const double wobble = std::sin(0.4 * t + static_cast<double>(m));
        const double at = static_cast<double>(m);
        FrameResult frame;
        frame.metrics.psnr_db = 27 + 2 * at + wobble;
        frame.metrics.ssim = {0.85 + 0.03 * at + 0.01 * wobble, 0.86 + 0.03 * at, 0.88, 0.89};
        frame.metrics.flip = 0.12 - 0.02 * at - 0.005 * wobble;
        if (m != 1) frame.time_ms = 1.5 + at + 0.1 * wobble;
        result.frames.push_back(frame);
      }
      if (m == 2) result.frames[3].metrics.psnr_db = std::numeric_limits<double>::infinity();
      SequenceMetrics& means = result.means;
      const double at = static_cast<double>(m);
      means.frames = frames;
      means.psnr_db = 27.1234 + 2 * at;
      means.ssim = 0.8512345 + 0.03 * at;
      means.ssim_valid = 0.8612345 + 0.03 * at;
      means.flip = 0.1223456 - 0.02 * at;
      const IfSsimValue stability{0.95 + 0.01 * at, 0.94 + 0.01 * at, 0.23};
      means.if_ssim = IfSsim{stability, stability, stability, frames - 1, true};
      if (m == 0) means.still = StillDeviation{0.5, 27.0, 18, 0.4};
      if (m == 0) means.temporal.lag = Lag{2.5, 0.25, 100};
      means.temporal.grid = Grid{0.25 + at, 0.5, 12};
      means.first = {10, 26.5 + at, 0.84, 0.13, -1.5};
      if (m != 1) means.time_ms = 1.5 + at;
      scene.methods.push_back(std::move(result));
    }
    const FloatImage reference = picture(width, height, 0);
    std::vector<FloatImage> results, maps;
    const PreparedReference prepared(reference, {});
    for (const double error : {0.3, 0.2, 0.1}) {
      results.push_back(picture(width, height, error));
      compare(prepared, results.back(), &maps.emplace_back());
    }
    scene.shown.push_back(show_frame(5, reference, results, maps));
    report.scenes.push_back(std::move(scene));
  }
  return report;
}

/// Text between the first `from` and the next `to`.
std::string between(const std::string& text, const std::string& from, const std::string& to) {
  const size_t begin = text.find(from);
  if (begin == std::string::npos) return "";
  const size_t after = begin + from.size();
  return text.substr(after, text.find(to, after) - after);
}

size_t count_of(const std::string& text, const std::string& part) {
  size_t count = 0;
  for (size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++count;
  return count;
}

TEST(HtmlReport, CarriesTheSameDataAsTheJson) {
  const EvalReport report = made_up_report();
  const Json json = report_json(report);
  const std::string html = report_html(report);
  const std::string embedded = between(html, "id=\"report\">", "</script>");
  ASSERT_TRUE(Json::accept(embedded));
  EXPECT_EQ(Json::parse(embedded), json);
  EXPECT_EQ(json["scenes"][0]["methods"][2]["frames"].size(), 12u);
  EXPECT_EQ(json["scenes"][0]["methods"][2]["frames"][3]["psnr_db"], nullptr);
  EXPECT_EQ(json["scenes"][0]["methods"][2]["frames"][3]["psnr_infinite"], true);
  EXPECT_EQ(json["scenes"][1]["methods"][0]["means"]["if_ssim"]["masked_fraction"], 0.23);
  EXPECT_NEAR(json["mean_of_scenes"][0]["means"]["psnr_db"].get<double>(), 27.1234, 1e-9);
  const Json& means = json["scenes"][0]["methods"][0]["means"];
  EXPECT_EQ(means["lag"]["frames"], 2.5);
  EXPECT_EQ(means["still"]["rest_code_values"], 0.4);
  EXPECT_EQ(means["grid"]["codes_over_truth"], -0.25);
  EXPECT_EQ(means["first_frames"]["brightness_codes"], -1.5);
  EXPECT_FALSE(means.contains("later_frames")) << "there are none";
  EXPECT_FALSE(json["scenes"][0]["methods"][1]["means"].contains("lag"));
  EXPECT_NE(html.find("<th scope=\"col\">lag<small>"), std::string::npos);
}

TEST(HtmlReport, TablesShowTheNumbersOfTheJsonAndMarkTheBest) {
  const EvalReport report = made_up_report();
  const std::string html = report_html(report);
  const Json json = report_json(report);
  size_t at = html.find("<h2 id=\"scene0\">");
  at = html.find("<tbody>", at);
  const std::string table = html.substr(at, html.find("</tbody>", at) - at);
  for (const Json& method : json["scenes"][0]["methods"]) {
    const Json& means = method["means"];
    EXPECT_NE(table.find(fmt::format(">{:.2f}<", means["psnr_db"].get<double>())),
              std::string::npos);
    EXPECT_NE(table.find(fmt::format(">{:.4f}<", means["ssim"].get<double>())), std::string::npos);
    EXPECT_NE(table.find(fmt::format(">{:.4f}<", means["flip"].get<double>())), std::string::npos);
  }
  EXPECT_NE(table.find("<td class=\"best\">31.12</td>"), std::string::npos) << table;
  EXPECT_NE(table.find("<td class=\"best\">0.0823</td>"), std::string::npos) << "lower is better";
  EXPECT_EQ(count_of(table, "<td class=\"best\">1.50</td>"), 1u) << table;
  EXPECT_NE(table.find("<td>0.230</td>"), std::string::npos) << "a fraction has no best";
  EXPECT_NE(table.find("<td>0.500</td>"), std::string::npos) << "the only one";
  EXPECT_NE(table.find("\u2013"), std::string::npos) << "the second method has no time";
}

TEST(HtmlReport, IsWellFormedAndNeedsNoNetwork) {
  const std::string html = report_html(made_up_report());
  EXPECT_TRUE(html.starts_with("<!DOCTYPE html>"));
  EXPECT_TRUE(html.ends_with("</html>\n"));
  const std::string body = between(html, "<body>", "<script type=");
  for (const char* tag : {"div", "table", "thead", "tbody", "tr", "th", "td", "figure", "select",
                          "option", "label", "ul", "li", "h2", "h3", "p", "nav", "span"})
    EXPECT_EQ(
        count_of(body, "<" + std::string(tag) + ">") + count_of(body, "<" + std::string(tag) + " "),
        count_of(body, "</" + std::string(tag) + ">"))
        << tag;
  EXPECT_EQ(count_of(body, "<img "), count_of(body, "src=\"data:image/png;base64,"));
  EXPECT_EQ(count_of(body, "http"), 0u);
  EXPECT_EQ(count_of(html, "<link"), 0u);
  EXPECT_EQ(count_of(html, "<script"), 3u);
  EXPECT_EQ(count_of(html, "</script>"), 3u);
}

TEST(HtmlReport, NamesCannotBecomeMarkup) {
  const std::string html = report_html(made_up_report());
  EXPECT_EQ(html.find("<script>alert"), std::string::npos);
  EXPECT_EQ(html.find("<b>yard"), std::string::npos);
  EXPECT_EQ(html.find("a <device>"), std::string::npos);
  EXPECT_NE(html.find("a&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;&amp;&#39;b"),
            std::string::npos);
  EvalReport report;
  report.title = "not \xff UTF-8";
  EXPECT_NE(report_html(report).find("not \uFFFD UTF-8"), std::string::npos);
}

TEST(HtmlReport, PicturesAreHalvedUntilThePageFits) {
  const EvalReport report = made_up_report();
  const std::string whole = report_html(report);
  EXPECT_EQ(whole.find("of their size"), std::string::npos);
  const std::string small = report_html(report, whole.size() + (size_t{1} << 20) - 100'000);
  EXPECT_LT(small.size(), whole.size());
  EXPECT_NE(small.find("1/2 of their size"), std::string::npos);
  EXPECT_NE(small.find("width=\"100\" height=\"75\""), std::string::npos);
  EXPECT_NE(small.find("width=\"320\" height=\"240\""), std::string::npos) << "crops stay";
}

TEST(HtmlReport, SaysWhereDisocclusionsAreNotMasked) {
  EvalReport report = made_up_report();
  EXPECT_EQ(report_html(report).find("masks by colour alone"), std::string::npos);
  report.scenes[1].methods[2].means.if_ssim->disocclusion_mask = false;
  EXPECT_EQ(count_of(report_html(report), "masks by colour alone"), 1u);
}

TEST(HtmlReport, TheSamePageTwice) {
  EXPECT_EQ(report_html(made_up_report()), report_html(made_up_report()));
}

TEST(HtmlReport, AReportWithoutScenesIsAPage) {
  EvalReport report;
  report.title = "empty";
  EXPECT_TRUE(report_html(report).ends_with("</html>\n"));
  EXPECT_EQ(report_json(report)["scenes"].size(), 0u);
}

TEST(HtmlReport, PngsDecodeToTheirPictures) {
  const Picture original = to_picture(picture(37, 21, 0.2));
  const PngPicture png = encode_png(original);
  const std::string path =
      (std::filesystem::temp_directory_path() / "shale_html_report_test.png").string();
  ASSERT_TRUE(write_file(path, png.bytes));
  const Result<Picture> read = load_picture(path);
  std::filesystem::remove(path);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->rgba, original.rgba);
}

// Crops.

FloatImage flat_map(uint32_t width, uint32_t height, float value) {
  return {width, height, 1, std::vector<float>(size_t{width} * height, value)};
}

void raise(FloatImage& map, const Crop& where, float value) {
  for (uint32_t y = where.y; y < where.y + where.height; ++y)
    for (uint32_t x = where.x; x < where.x + where.width; ++x) *map.at(x, y) = value;
}

TEST(ChooseCrops, FindsWhereTheMethodsDiffer) {
  std::vector<FloatImage> maps(3, flat_map(640, 480, 0.1f));
  const Crop different{400, 200, 160, 120}, alike{40, 40, 160, 120};
  raise(maps[1], different, 0.6f);
  for (FloatImage& map : maps) raise(map, alike, 0.9f);
  const std::vector<Crop> crops = choose_crops(maps);
  ASSERT_EQ(crops.size(), 3u);
  EXPECT_EQ(crops[0], different) << "not where all of them fail alike";
  for (size_t i = 0; i < crops.size(); ++i) {
    EXPECT_LE(crops[i].x + crops[i].width, 640u);
    EXPECT_LE(crops[i].y + crops[i].height, 480u);
    for (size_t k = 0; k < i; ++k)
      EXPECT_TRUE(crops[i].x + 160 <= crops[k].x || crops[k].x + 160 <= crops[i].x ||
                  crops[i].y + 120 <= crops[k].y || crops[k].y + 120 <= crops[i].y);
  }
}

TEST(ChooseCrops, OfOneMethodAreWhereItFails) {
  std::vector<FloatImage> maps{flat_map(640, 480, 0.1f)};
  const Crop bad{80, 304, 160, 120};
  raise(maps[0], bad, 0.5f);
  EXPECT_EQ(choose_crops(maps).at(0), bad);
  maps.push_back(maps[0]);
  EXPECT_EQ(choose_crops(maps).at(0), bad) << "equal methods";
}

TEST(ChooseCrops, FitIntoSmallPictures) {
  const std::vector<FloatImage> maps(2, flat_map(100, 300, 0.1f));
  const std::vector<Crop> crops = choose_crops(maps);
  EXPECT_EQ(crops.size(), 2u) << "a third would overlap";
  EXPECT_EQ(crops[0].width, 100u);
  EXPECT_TRUE(choose_crops({}).empty());
}

TEST(ErrorColours, GetLighterWithTheError) {
  FloatImage map{256, 1, 1, std::vector<float>(256)};
  for (uint32_t i = 0; i < 256; ++i) map.values[i] = static_cast<float>(i) / 255;
  const Picture colours = error_colours(map);
  double last = -1;
  for (uint32_t i = 0; i < 256; ++i) {
    const uint8_t* const c = colours.at(i, 0);
    const double lightness = 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
    EXPECT_GE(lightness, last) << i;
    last = lightness;
  }
  map.values = {-1, 2, std::numeric_limits<float>::quiet_NaN()};
  map.width = 3;
  const Picture ends = error_colours(map);
  EXPECT_EQ(ends.at(0, 0)[0], 0);
  EXPECT_EQ(ends.at(1, 0)[0], 252);
  EXPECT_EQ(ends.at(2, 0)[0], 0);
}

// Writes a large page to look at, if told where to.
TEST(HtmlReport, Sample) {
  const char* const path = std::getenv("SHALE_SAMPLE_PAGE");
  if (!path) GTEST_SKIP() << "SHALE_SAMPLE_PAGE names no file";
  EXPECT_TRUE(write_text(path, report_html(made_up_report(960, 540, 60))));
}

}  // namespace
}  // namespace shale
