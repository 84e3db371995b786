#include "tools/eval/html_report.h"

#include <fmt/format.h>
#include <stb/stb_image.h>
#include <stb/stb_image_write.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <thread>

#include "tools/eval/chart_js.h"
#include "tools/eval/data_page.h"
#include "tools/eval/page.h"
#include "tools/eval/tonemap.h"

namespace shale {
namespace {

using Json = nlohmann::ordered_json;

// Colours of errors.

/// Black through purple and orange to pale yellow, of evenly rising lightness. Ours: corners between
/// which it is linear, in code values.
constexpr std::array<std::array<float, 3>, 9> kErrorRamp{{{0, 0, 4},
                                                          {29, 17, 71},
                                                          {81, 18, 124},
                                                          {130, 38, 129},
                                                          {183, 55, 121},
                                                          {231, 82, 99},
                                                          {252, 137, 97},
                                                          {254, 195, 135},
                                                          {252, 253, 191}}};

std::array<uint8_t, 3> error_colour(float value) {
  const float at = std::clamp(value, 0.0f, 1.0f) * (kErrorRamp.size() - 1);
  const size_t low = std::min(static_cast<size_t>(at), kErrorRamp.size() - 2);
  const float part = at - static_cast<float>(low);
  std::array<uint8_t, 3> colour{};
  for (size_t c = 0; c < 3; ++c)
    colour[c] = static_cast<uint8_t>(
        std::lround(kErrorRamp[low][c] + part * (kErrorRamp[low + 1][c] - kErrorRamp[low][c])));
  return colour;
}

// Pictures.

Picture cut_out(const Picture& picture, const Crop& crop) {
  Picture result = Picture::filled(crop.width, crop.height, 0);
  for (uint32_t y = 0; y < crop.height; ++y)
    std::copy_n(picture.at(crop.x, crop.y + y), size_t{crop.width} * 4, result.at(0, y));
  return result;
}

/// The mean of two by two pixels; an odd last row or column is dropped.
PngPicture halved(const PngPicture& png) {
  int width = 0, height = 0, channels = 0;
  stbi_uc* const pixels = stbi_load_from_memory(
      png.bytes.data(), static_cast<int>(png.bytes.size()), &width, &height, &channels, 4);
  SHALE_CHECK(pixels);  // encode_png made it
  Picture half = Picture::filled(std::max(png.width / 2, 1u), std::max(png.height / 2, 1u), 0);
  for (uint32_t y = 0; y < half.height; ++y)
    for (uint32_t x = 0; x < half.width; ++x)
      for (uint32_t c = 0; c < 3; ++c) {
        uint32_t sum = 2;
        for (uint32_t i = 0; i < 4; ++i)
          sum += pixels[(size_t{std::min(2 * y + i / 2, png.height - 1)} * png.width +
                         std::min(2 * x + i % 2, png.width - 1)) *
                            4 +
                        c];
        half.at(x, y)[c] = static_cast<uint8_t>(sum / 4);
      }
  stbi_image_free(pixels);
  return encode_png(half);
}

size_t base64_size(const PngPicture& png) { return (png.bytes.size() + 2) / 3 * 4; }

/// All whole pictures of a report.
template <typename Report, typename Visit>
void each_whole_picture(Report& report, const Visit& visit) {
  for (auto& scene : report.scenes)
    for (auto& shown : scene.shown) {
      visit(shown.reference);
      for (auto& picture : shown.results) visit(picture);
      for (auto& picture : shown.error_maps) visit(picture);
    }
}

std::string base64(const std::vector<uint8_t>& bytes) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    const size_t left = std::min<size_t>(bytes.size() - i, 3);
    uint32_t group = 0;
    for (size_t k = 0; k < 3; ++k) group = group << 8 | (k < left ? bytes[i + k] : 0u);
    for (size_t k = 0; k < 4; ++k) text += k <= left ? kDigits[group >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

// JSON.

template <typename Value>
void put(Json& json, const char* key, const std::optional<Value>& value) {
  if (value) json[key] = *value;
}

Json if_ssim_json(const IfSsimValue& value) {
  return {{"value", value.value},
          {"valid_centres", value.valid_centres ? Json(*value.valid_centres) : Json(nullptr)},
          {"masked_fraction", value.masked_fraction}};
}

Json trail_json(const Trail& trail) {
  Json codes = Json::array();
  for (uint32_t age = 0; age < kTrailFrames; ++age)
    codes.push_back(trail.pixels[age] ? Json(trail.codes[age]) : Json(nullptr));
  Json json{{"codes_by_frame", std::move(codes)}, {"pixels_by_frame", trail.pixels}};
  put(json, "codes", trail.mean(0));
  put(json, "codes_from_frame_3", trail.mean(3));
  return json;
}

void put_temporal(Json& json, const TemporalMetrics& temporal) {
  put(json, "brightness_codes", temporal.brightness_codes);
  if (temporal.lag)
    json["lag"] = {{"frames", temporal.lag->frames},
                   {"open_fraction", temporal.lag->open_fraction},
                   {"pixels", temporal.lag->events}};
  if (temporal.trail) json["trail"] = trail_json(*temporal.trail);
  if (temporal.sky_trail) json["sky_trail"] = trail_json(*temporal.sky_trail);
  if (temporal.grid)
    json["grid"] = {{"codes_over_truth", temporal.grid->output_codes - temporal.grid->truth_codes},
                    {"output_codes", temporal.grid->output_codes},
                    {"truth_codes", temporal.grid->truth_codes},
                    {"windows", temporal.grid->windows}};
}

void put_part(Json& json, const char* key, const PartMetrics& part) {
  if (part.frames == 0) return;
  Json& to = json[key] = {{"frames", part.frames}};
  put(to, "psnr_db", part.psnr_db);
  put(to, "ssim", part.ssim);
  put(to, "flip", part.flip);
  put(to, "brightness_codes", part.brightness_codes);
}

}  // namespace

namespace {

Json generated_json(const GeneratedMetrics& means) {
  Json json{{"frames", means.frames}};
  put(json, "psnr_db", means.psnr_db);
  put(json, "ssim", means.ssim);
  put(json, "flip", means.flip);
  put(json, "judder_db", means.judder_db);
  put(json, "time_ms", means.time_ms);
  json["latency_frames"] = means.latency_frames;
  for (size_t k = 0; k < kPixelKinds; ++k) {
    Json& kind = json["pixels"][pixel_kind_name(static_cast<PixelKind>(k))];
    kind["share"] = means.kinds[k].share;
    put(kind, "psnr_db", means.kinds[k].psnr_db);
  }
  return json;
}

}  // namespace

Json sequence_json(const SequenceMetrics& means) {
  Json json{{"frames", means.frames}};
  put(json, "psnr_db", means.psnr_db);
  put(json, "ssim", means.ssim);
  put(json, "ssim_valid", means.ssim_valid);
  put(json, "ssim_luma", means.ssim_luma);
  put(json, "ssim_luma_valid", means.ssim_luma_valid);
  put(json, "flip", means.flip);
  if (means.if_ssim) {
    Json value = if_ssim_json(means.if_ssim->at_t);
    value["half_threshold"] = if_ssim_json(means.if_ssim->at_half_t);
    value["double_threshold"] = if_ssim_json(means.if_ssim->at_double_t);
    value["pairs"] = means.if_ssim->pairs;
    value["disocclusion_mask"] = means.if_ssim->disocclusion_mask;
    json["if_ssim"] = std::move(value);
  }
  if (means.still) {
    json["still"] = {{"std_code_values", means.still->code_values}};
    put(json["still"], "psnr_db", means.still->psnr_db);
    json["still"]["frames"] = means.still->frames;
    put(json["still"], "rest_code_values", means.still->rest_code_values);
  }
  put_temporal(json, means.temporal);
  put_part(json, "first_frames", means.first);
  put_part(json, "later_frames", means.later);
  put(json, "time_ms", means.time_ms);
  return json;
}

namespace {

/// A column of the tables: where its value lies in the JSON of a method's means, and how it is shown.
struct Column {
  const char *title, *unit;
  Json::json_pointer at;
  int digits;
  int better;  ///< 1: higher, -1: lower, 0: neither
};

const std::vector<Column>& columns() {
  static const std::vector<Column> kColumns{
      {"PSNR", "dB, higher", Json::json_pointer("/psnr_db"), 2, 1},
      {"SSIM", "higher", Json::json_pointer("/ssim"), 4, 1},
      {"SSIM valid", "higher", Json::json_pointer("/ssim_valid"), 4, 1},
      {"SSIM luma", "higher", Json::json_pointer("/ssim_luma"), 4, 1},
      {"FLIP", "lower", Json::json_pointer("/flip"), 4, -1},
      {"time", "ms, lower", Json::json_pointer("/time_ms"), 2, -1},
      {"IF-SSIM", "higher", Json::json_pointer("/if_ssim/value"), 4, 1},
      {"IF valid", "higher", Json::json_pointer("/if_ssim/valid_centres"), 4, 1},
      {"IF at T/2", "higher", Json::json_pointer("/if_ssim/half_threshold/value"), 4, 1},
      {"IF at 2T", "higher", Json::json_pointer("/if_ssim/double_threshold/value"), 4, 1},
      {"IF masked", "fraction", Json::json_pointer("/if_ssim/masked_fraction"), 3, 0},
      {"still std", "codes, lower", Json::json_pointer("/still/std_code_values"), 3, -1},
      {"still PSNR", "dB, higher", Json::json_pointer("/still/psnr_db"), 2, 1},
      {"rest", "codes, lower", Json::json_pointer("/still/rest_code_values"), 3, -1},
      {"lag", "frames, lower", Json::json_pointer("/lag/frames"), 2, -1},
      {"lag open", "fraction, lower", Json::json_pointer("/lag/open_fraction"), 3, -1},
      {"brightness", "codes over truth", Json::json_pointer("/brightness_codes"), 2, 0},
      {"trail", "codes, lower", Json::json_pointer("/trail/codes"), 2, -1},
      {"trail from 3", "codes, lower", Json::json_pointer("/trail/codes_from_frame_3"), 2, -1},
      {"sky trail", "codes, lower", Json::json_pointer("/sky_trail/codes"), 2, -1},
      {"sky from 3", "codes, lower", Json::json_pointer("/sky_trail/codes_from_frame_3"), 2, -1},
      {"grid", "codes over truth, lower", Json::json_pointer("/grid/codes_over_truth"), 3, -1},
      {"PSNR first 10", "dB, higher", Json::json_pointer("/first_frames/psnr_db"), 2, 1},
      {"PSNR later", "dB, higher", Json::json_pointer("/later_frames/psnr_db"), 2, 1},
      {"SSIM first 10", "higher", Json::json_pointer("/first_frames/ssim"), 4, 1},
      {"SSIM later", "higher", Json::json_pointer("/later_frames/ssim"), 4, 1},
      {"FLIP first 10", "lower", Json::json_pointer("/first_frames/flip"), 4, -1},
      {"FLIP later", "lower", Json::json_pointer("/later_frames/flip"), 4, -1},
      {"generated PSNR", "dB, higher", Json::json_pointer("/generated/psnr_db"), 2, 1},
      {"generated SSIM", "higher", Json::json_pointer("/generated/ssim"), 4, 1},
      {"generated FLIP", "lower", Json::json_pointer("/generated/flip"), 4, -1},
      {"judder", "dB, lower", Json::json_pointer("/generated/judder_db"), 2, -1},
      {"seen in all", "dB, higher", Json::json_pointer("/generated/pixels/seen_in_all/psnr_db"), 2,
       1},
      {"in some", "dB, higher", Json::json_pointer("/generated/pixels/seen_in_some/psnr_db"), 2, 1},
      {"in none", "dB, higher", Json::json_pointer("/generated/pixels/seen_in_none/psnr_db"), 2, 1},
      {"border", "dB, higher", Json::json_pointer("/generated/pixels/border/psnr_db"), 2, 1},
      {"moving", "dB, higher", Json::json_pointer("/generated/pixels/moving/psnr_db"), 2, 1},
      {"motionless", "dB, higher", Json::json_pointer("/generated/pixels/motionless/psnr_db"), 2,
       1},
  };
  return kColumns;
}

std::optional<double> value_at(const Json& json, const Json::json_pointer& at) {
  if (!json.contains(at) || !json.at(at).is_number()) return std::nullopt;
  return json.at(at).get<double>();
}

/// The mean of each column over the scenes that have it, in the form of a scene's means.
Json mean_of_scenes(const Json& scenes, size_t method) {
  Json mean = Json::object();
  for (const Column& column : columns()) {
    double sum = 0;
    int count = 0;
    for (const Json& scene : scenes)
      if (const auto value = value_at(scene["methods"][method]["means"], column.at))
        sum += *value, ++count;
    if (count > 0) mean[column.at] = sum / count;
  }
  return mean;
}

// The page.

class PageWriter {
 public:
  template <typename... Args>
  void add(fmt::format_string<Args...> format, Args&&... args) {
    fmt::format_to(std::back_inserter(text_), format, std::forward<Args>(args)...);
  }
  void raw(std::string_view text) { text_ += text; }

  void notes(const std::vector<std::string>& notes) {
    if (notes.empty()) return;
    raw("<ul class=\"dim\">\n");
    for (const std::string& note : notes) add("<li>{}</li>\n", escaped(note));
    raw("</ul>\n");
  }

  /// `zoom` 0: as wide as the layout makes it.
  void image(const PngPicture& png, const std::string& alt, uint32_t zoom = 0,
             const char* classes = "") {
    add("<img{}{} alt=\"{}\" width=\"{}\" height=\"{}\" src=\"data:image/png;base64,",
        *classes ? " " : "", *classes ? fmt::format("class=\"{}\"", classes) : "", escaped(alt),
        png.width * std::max(zoom, 1u), png.height * std::max(zoom, 1u));
    raw(base64(png.bytes));
    raw("\">");
  }

  std::string take() { return std::move(text_); }

 private:
  std::string text_;
};

/// Rows are methods; `means` by method, in the form of sequence_json.
void write_table(PageWriter& page, const std::vector<std::string>& methods,
                 const std::vector<const Json*>& means) {
  std::vector<const Column*> present;
  for (const Column& column : columns())
    if (std::any_of(means.begin(), means.end(),
                    [&](const Json* json) { return value_at(*json, column.at).has_value(); }))
      present.push_back(&column);
  page.raw("<div class=\"scroll\"><table>\n<thead><tr><th scope=\"col\">method</th>");
  for (const Column* column : present)
    page.add("<th scope=\"col\">{}<small>{}</small></th>", column->title, column->unit);
  page.raw("</tr></thead>\n<tbody>\n");
  const auto shown = [](double value, const Column& column) {
    return fmt::format("{:.{}f}", value, column.digits);
  };
  // What looks the same as the best is the best too; a lone value is not marked.
  std::vector<std::string> best(present.size());
  for (size_t i = 0; i < present.size(); ++i) {
    const int better = present[i]->better;
    std::optional<double> top;
    size_t values = 0;
    for (const Json* json : means)
      if (const auto value = value_at(*json, present[i]->at)) {
        if (!top || *value * better > *top * better) top = value;
        ++values;
      }
    if (values > 1 && better != 0) best[i] = shown(*top, *present[i]);
  }
  for (size_t m = 0; m < methods.size(); ++m) {
    page.add("<tr><td>{}</td>", escaped(methods[m]));
    for (size_t i = 0; i < present.size(); ++i) {
      const auto value = value_at(*means[m], present[i]->at);
      const std::string text = value ? shown(*value, *present[i]) : "\u2013";
      page.add("<td{}>{}</td>", value && text == best[i] ? " class=\"best\"" : "", text);
    }
    page.raw("</tr>\n");
  }
  page.raw("</tbody></table></div>\n");
}

void write_slider(PageWriter& page, const EvalReport& report, const ShownFrame& shown,
                  const std::string& id) {
  std::vector<std::string> names{"reference"};
  std::vector<const PngPicture*> pictures{&shown.reference};
  for (size_t m = 0; m < shown.results.size(); ++m) {
    names.push_back(report.methods[m]);
    pictures.push_back(&shown.results[m]);
  }
  // At first the last method beside the reference: the one that the report is about, most often.
  const size_t left = names.size() - 1, right = 0;
  const auto choice = [&](const char* label, size_t chosen) {
    page.add("<label>{} <select>", label);
    for (size_t i = 0; i < names.size(); ++i)
      page.add("<option{}>{}</option>", i == chosen ? " selected" : "", escaped(names[i]));
    page.raw("</select></label>\n");
  };
  page.add("<div class=\"choices\" id=\"{}\">\n", id);
  choice("left", left);
  choice("right", right);
  page.raw("<label><input type=\"checkbox\"> actual pixels</label>\n");
  page.raw(
      "<span class=\"dim\">the divider follows the pointer; arrow keys move it too</span></div>\n");
  page.add(
      "<div class=\"compare\" data-choices=\"{}\"><div class=\"stage\" tabindex=\"0\" "
      "role=\"slider\" aria-label=\"divider\" aria-valuemin=\"0\" aria-valuemax=\"100\" "
      "aria-valuenow=\"50\">\n",
      id);
  for (size_t i = 0; i < names.size(); ++i) {
    page.image(*pictures[i], names[i], 0, i == left ? "left" : i == right ? "right" : "");
    page.raw("\n");
  }
  page.add(
      "<span class=\"divider\"></span><span class=\"tag from\">{}</span>"
      "<span class=\"tag to\">{}</span>\n</div></div>\n",
      escaped(names[left]), escaped(names[right]));
}

void write_shown(PageWriter& page, const EvalReport& report, const EvalScene& scene,
                 const ShownFrame& shown, const std::string& id) {
  const uint32_t number = scene.first_frame + shown.index;
  page.add("<h3>Frame {}</h3>\n", number);
  write_slider(page, report, shown, id);
  if (!shown.crops.empty()) page.add("<h3>Frame {}: where the methods differ most</h3>\n", number);
  for (size_t c = 0; c < shown.crops.size(); ++c) {
    const Crop& crop = shown.crops[c];
    page.add(
        "<p class=\"dim\">{}x{} pixels at ({}, {}), magnified twice</p>\n<div class=\"row\">\n",
        crop.width, crop.height, crop.x, crop.y);
    const auto figure = [&](const PngPicture& png, const std::string& name) {
      page.raw("<figure class=\"crop\">");
      page.image(png, name, 2);
      page.add("<figcaption>{}</figcaption></figure>\n", escaped(name));
    };
    figure(shown.reference_crops[c], "reference");
    for (size_t m = 0; m < shown.result_crops[c].size(); ++m)
      figure(shown.result_crops[c][m], report.methods[m]);
    page.raw("</div>\n");
  }
  if (shown.error_maps.empty()) return;
  std::string stops;
  for (const auto& colour : kErrorRamp)
    stops +=
        fmt::format("{}rgb({},{},{})", stops.empty() ? "" : ",", colour[0], colour[1], colour[2]);
  page.add(
      "<h3>Frame {}: FLIP</h3>\n<p class=\"dim\">0 <span class=\"scale\" style=\"background:"
      "linear-gradient(90deg,{})\"></span> 1</p>\n<div class=\"maps\">\n",
      number, stops);
  for (size_t m = 0; m < shown.error_maps.size(); ++m) {
    page.raw("<figure>");
    page.image(shown.error_maps[m], "FLIP of " + report.methods[m]);
    std::string mean;
    if (m < scene.methods.size() && shown.index < scene.methods[m].frames.size())
      if (const auto flip = scene.methods[m].frames[shown.index].metrics.flip)
        mean = fmt::format(", mean {:.4f}", *flip);
    page.add("<figcaption>{}{}</figcaption></figure>\n", escaped(report.methods[m]), mean);
  }
  page.raw("</div>\n");
}

constexpr std::string_view kDefinitions =
    R"(<footer class="dim"><p>Pictures are compared as a display shows them, RGB of 8 bits. PSNR: over pixels and
channels; means are of dB, equal frames count as 100 dB. SSIM: 11x11 Gaussian of 1.5 pixels, per channel, zero
padding by 5; "valid" leaves out the border of 5, "luma" is of Rec. 709 luma. FLIP: the mean of the LDR map.
IF-SSIM: SSIM between a frame and the one before, warped by the reference's motion, at half size, with
disocclusions and changes of shading masked; wholly masked windows count as 1, so the masked fraction is given, and
as "IF valid" the mean of the windows with a valid centre. Its threshold T is an approximation, so T/2 and 2T are given.
Still std: deviation over time while the camera does not move, from 16 frames after it stopped; rest: of the pixels that do
not change in the truth.</p>
<p>Lag: frames until a pixel whose brightness changed by 24 codes or more has made 90 % of it, 16 at most; open: not made by
then. Brightness: output less truth. Trail: mean absolute error of what was uncovered in the last 8 frames; "from 3": 3 to 7
frames ago; the sky apart. Grid: deviation of the phases of the jitter's grid from each other in smooth places, above the
truth's.</p></footer>
)";

void check_shape(const EvalReport& report) {
  for (const EvalScene& scene : report.scenes) {
    SHALE_CHECK(scene.methods.size() == report.methods.size());
    for (const ShownFrame& shown : scene.shown) {
      SHALE_CHECK(shown.results.size() <= report.methods.size());
      SHALE_CHECK(shown.error_maps.size() <= report.methods.size());
      SHALE_CHECK(shown.reference_crops.size() == shown.crops.size());
      SHALE_CHECK(shown.result_crops.size() == shown.crops.size());
      for (const auto& crops : shown.result_crops)
        SHALE_CHECK(crops.size() <= report.methods.size());
    }
  }
}

}  // namespace

Picture error_colours(const FloatImage& map) {
  SHALE_CHECK(map.channels == 1);
  // A table is fine enough: 8 bits of colour.
  std::array<std::array<uint8_t, 3>, 1024> table;
  for (size_t i = 0; i < table.size(); ++i)
    table[i] = error_colour(static_cast<float>(i) / (table.size() - 1));
  Picture picture = Picture::filled(map.width, map.height, 0);
  for (size_t i = 0; i < map.values.size(); ++i) {
    const float value = map.values[i] > 0 ? std::min(map.values[i], 1.0f) : 0;
    std::copy_n(table[static_cast<size_t>(value * (table.size() - 1) + 0.5f)].begin(), 3,
                &picture.rgba[4 * i]);
  }
  return picture;
}

PngPicture encode_png(const Picture& picture) {
  std::vector<uint8_t> rgb(size_t{picture.width} * picture.height * 3);
  for (size_t i = 0; i < rgb.size() / 3; ++i) std::copy_n(&picture.rgba[4 * i], 3, &rgb[3 * i]);
  PngPicture png{picture.width, picture.height, {}};
  const auto append = [](void* context, void* data, int size) {
    auto* const to = static_cast<std::vector<uint8_t>*>(context);
    const auto* const from = static_cast<const uint8_t*>(data);
    to->insert(to->end(), from, from + size);
  };
  SHALE_CHECK(stbi_write_png_to_func(append, &png.bytes, static_cast<int>(png.width),
                                     static_cast<int>(png.height), 3, rgb.data(),
                                     static_cast<int>(png.width * 3)) != 0);
  return png;
}

std::vector<Crop> choose_crops(std::span<const FloatImage> error_maps, uint32_t count,
                               uint32_t width, uint32_t height) {
  if (error_maps.empty() || error_maps[0].empty()) return {};
  const uint32_t full_width = error_maps[0].width, full_height = error_maps[0].height;
  width = std::min(width, full_width);
  height = std::min(height, full_height);
  constexpr uint32_t kStep = 8;
  const auto positions = [](uint32_t full, uint32_t part) {
    std::vector<uint32_t> result;
    for (uint32_t at = 0; at + part <= full; at += kStep) result.push_back(at);
    if (result.back() + part < full) result.push_back(full - part);
    return result;
  };
  const std::vector<uint32_t> xs = positions(full_width, width),
                              ys = positions(full_height, height);
  // Sums of the window means and of their squares over the methods.
  std::vector<double> sum(xs.size() * ys.size()), square(sum.size());
  for (const FloatImage& map : error_maps) {
    SHALE_CHECK(map.width == full_width && map.height == full_height && map.channels == 1);
    const size_t stride = size_t{full_width} + 1;
    std::vector<double> integral(stride * (size_t{full_height} + 1));
    for (uint32_t y = 0; y < full_height; ++y) {
      double row = 0;
      for (uint32_t x = 0; x < full_width; ++x) {
        row += *map.at(x, y);
        integral[(y + 1) * stride + x + 1] = integral[y * stride + x + 1] + row;
      }
    }
    for (size_t j = 0; j < ys.size(); ++j)
      for (size_t i = 0; i < xs.size(); ++i) {
        const size_t top = ys[j] * stride, bottom = (ys[j] + height) * stride;
        const double mean = (integral[bottom + xs[i] + width] - integral[bottom + xs[i]] -
                             integral[top + xs[i] + width] + integral[top + xs[i]]) /
                            (static_cast<double>(width) * height);
        sum[j * xs.size() + i] += mean;
        square[j * xs.size() + i] += mean * mean;
      }
  }
  const auto methods = static_cast<double>(error_maps.size());
  std::vector<double> score(sum.size());
  bool differ = false;
  for (size_t i = 0; i < sum.size(); ++i) {
    score[i] = square[i] / methods - sum[i] / methods * (sum[i] / methods);
    differ = differ || score[i] > 1e-9;
  }
  if (!differ) score = sum;
  std::vector<Crop> crops;
  while (crops.size() < count) {
    std::optional<size_t> best;
    for (size_t i = 0; i < score.size(); ++i) {
      const uint32_t x = xs[i % xs.size()], y = ys[i / xs.size()];
      const bool is_free = std::none_of(crops.begin(), crops.end(), [&](const Crop& crop) {
        return x < crop.x + width && crop.x < x + width && y < crop.y + height &&
               crop.y < y + height;
      });
      if (is_free && (!best || score[i] > score[*best])) best = i;
    }
    if (!best) break;
    crops.push_back({xs[*best % xs.size()], ys[*best / xs.size()], width, height});
  }
  return crops;
}

ShownFrame show_frame(uint32_t index, const FloatImage& reference,
                      std::span<const FloatImage> results, std::span<const FloatImage> error_maps) {
  SHALE_CHECK(results.size() == error_maps.size());
  ShownFrame shown;
  shown.index = index;
  shown.crops = choose_crops(error_maps);
  shown.results.resize(results.size());
  shown.error_maps.resize(results.size());
  shown.reference_crops.resize(shown.crops.size());
  shown.result_crops.assign(shown.crops.size(), std::vector<PngPicture>(results.size()));
  // Encoding is slow and pictures do not depend on each other.
  const size_t jobs = 2 * results.size() + 1;
  const auto work = [&](size_t job) {
    if (job > results.size()) {
      const size_t m = job - results.size() - 1;
      shown.error_maps[m] = encode_png(error_colours(error_maps[m]));
      return;
    }
    const Picture picture = to_picture(job == 0 ? reference : results[job - 1]);
    (job == 0 ? shown.reference : shown.results[job - 1]) = encode_png(picture);
    for (size_t c = 0; c < shown.crops.size(); ++c)
      (job == 0 ? shown.reference_crops[c] : shown.result_crops[c][job - 1]) =
          encode_png(cut_out(picture, shown.crops[c]));
  };
  const size_t threads = std::clamp<size_t>(std::thread::hardware_concurrency(), 1, 8);
  std::vector<std::jthread> workers;
  for (size_t t = 0; t < threads; ++t)
    workers.emplace_back([&, t] {
      for (size_t job = t; job < jobs; job += threads) work(job);
    });
  workers.clear();
  return shown;
}

Json metrics_json(const FrameMetrics& metrics) {
  Json json = Json::object();
  if (metrics.psnr_db) {
    json["psnr_db"] = std::isinf(*metrics.psnr_db) ? Json(nullptr) : Json(*metrics.psnr_db);
    if (std::isinf(*metrics.psnr_db)) json["psnr_infinite"] = true;
  }
  if (metrics.ssim) {
    json["ssim"] = metrics.ssim->full;
    put(json, "ssim_valid", metrics.ssim->valid);
    json["ssim_luma"] = metrics.ssim->luma;
    put(json, "ssim_luma_valid", metrics.ssim->luma_valid);
  }
  put(json, "flip", metrics.flip);
  return json;
}

Json report_json(const EvalReport& report) {
  check_shape(report);
  Json json{{"title", report.title},     {"device", report.device},   {"notes", report.notes},
            {"methods", report.methods}, {"mean_of_scenes", nullptr}, {"scenes", Json::array()}};
  for (const EvalScene& scene : report.scenes) {
    Json entry{{"name", scene.name},     {"size", scene.size},
               {"frames", scene.frames}, {"first_frame", scene.first_frame},
               {"notes", scene.notes},   {"methods", Json::array()},
               {"shown", Json::array()}};
    for (size_t m = 0; m < scene.methods.size(); ++m) {
      Json method{{"method", report.methods[m]},
                  {"means", sequence_json(scene.methods[m].means)},
                  {"frames", Json::array()}};
      put(method["means"], "share_run", scene.methods[m].share_run);
      if (scene.methods[m].generated)
        method["means"]["generated"] = generated_json(*scene.methods[m].generated);
      for (const FrameResult& frame : scene.methods[m].frames) {
        Json one = metrics_json(frame.metrics);
        put(one, "time_ms", frame.time_ms);
        if (frame.kept_promise) one["kept_promise"] = *frame.kept_promise;
        method["frames"].push_back(std::move(one));
      }
      entry["methods"].push_back(std::move(method));
    }
    for (const ShownFrame& shown : scene.shown) {
      Json one{{"index", shown.index}, {"crops", Json::array()}};
      for (const Crop& crop : shown.crops)
        one["crops"].push_back(
            {{"x", crop.x}, {"y", crop.y}, {"width", crop.width}, {"height", crop.height}});
      entry["shown"].push_back(std::move(one));
    }
    json["scenes"].push_back(std::move(entry));
  }
  json["mean_of_scenes"] = Json::array();
  for (size_t m = 0; m < report.methods.size(); ++m)
    json["mean_of_scenes"].push_back(
        {{"method", report.methods[m]}, {"means", mean_of_scenes(json["scenes"], m)}});
  return json;
}

std::string report_html(const EvalReport& original, size_t max_bytes) {
  const Json json = report_json(original);
  EvalReport report = original;
  // What is not a whole picture stays: scripts, numbers, crops.
  size_t fixed_bytes = chart_js::kEmbeddedFiles[0].text.size() + (size_t{1} << 20);
  for (const EvalScene& scene : report.scenes)
    for (const ShownFrame& shown : scene.shown) {
      for (const PngPicture& crop : shown.reference_crops) fixed_bytes += base64_size(crop);
      for (const auto& crops : shown.result_crops)
        for (const PngPicture& crop : crops) fixed_bytes += base64_size(crop);
    }
  constexpr uint32_t kLargestShrink = 16;
  uint32_t shrink = 1;
  for (; shrink < kLargestShrink; shrink *= 2) {
    size_t bytes = fixed_bytes;
    each_whole_picture(report, [&](const PngPicture& png) { bytes += base64_size(png); });
    if (bytes <= max_bytes) break;
    each_whole_picture(report, [](PngPicture& png) { png = halved(png); });
  }

  PageWriter page;
  page.raw("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
  page.raw("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n");
  page.add("<title>{}</title>\n<style>\n", escaped(report.title));
  page.raw(page::kEmbeddedFiles[0].text);
  page.add("</style>\n</head>\n<body>\n<h1>{}</h1>\n", escaped(report.title));
  if (!report.device.empty()) page.add("<p class=\"dim\">{}</p>\n", escaped(report.device));
  page.notes(report.notes);
  if (shrink > 1)
    page.add(
        "<p class=\"dim\">Whole pictures are shown at 1/{} of their size, to keep this page "
        "small; crops are not.</p>\n",
        shrink);
  const auto means_of = [](const Json& methods) {
    std::vector<const Json*> means;
    for (const Json& method : methods) means.push_back(&method["means"]);
    return means;
  };
  if (report.scenes.size() > 1) {
    page.raw("<nav>\n");
    for (size_t s = 0; s < report.scenes.size(); ++s)
      page.add("<a href=\"#scene{}\">{}</a>\n", s, escaped(report.scenes[s].name));
    page.add("</nav>\n<h2>Mean of {} scenes</h2>\n", report.scenes.size());
    write_table(page, report.methods, means_of(json["mean_of_scenes"]));
  }
  for (size_t s = 0; s < report.scenes.size(); ++s) {
    const EvalScene& scene = report.scenes[s];
    page.add("<h2 id=\"scene{}\">{}</h2>\n<p class=\"dim\">{}{}{} frames</p>\n", s,
             escaped(scene.name), escaped(scene.size), scene.size.empty() ? "" : ", ",
             scene.frames);
    page.notes(scene.notes);
    if (std::any_of(scene.methods.begin(), scene.methods.end(), [](const MethodResult& method) {
          return method.means.if_ssim && !method.means.if_ssim->disocclusion_mask;
        }))
      page.raw(
          "<p class=\"dim\">There is no depth for all frames: IF-SSIM masks by colour "
          "alone.</p>\n");
    write_table(page, report.methods, means_of(json["scenes"][s]["methods"]));
    page.add("<div class=\"charts\" id=\"charts{}\"></div>\n", s);
    for (size_t f = 0; f < scene.shown.size(); ++f)
      write_shown(page, report, scene, scene.shown[f], fmt::format("choices{}-{}", s, f));
  }
  page.raw(kDefinitions);
  page.add("<script type=\"application/json\" id=\"report\">{}</script>\n", script_json(json));
  page.raw("<script>\n");
  page.raw(chart_js::kEmbeddedFiles[0].text);
  page.raw("\n</script>\n<script>\n");
  page.raw(page::kEmbeddedFiles[1].text);
  page.raw("</script>\n</body>\n</html>\n");
  return page.take();
}

}  // namespace shale
