#include "tools/scene/dataset.h"

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "ir/base/file.h"
#include "tools/scene/exr.h"
#include "tools/scene/json_fields.h"

namespace shale {
namespace {

namespace fs = std::filesystem;
using OrderedJson = nlohmann::ordered_json;

constexpr uint32_t kMaxSide = 8192;
constexpr size_t kMaxFrames = 100000;
constexpr double kHuge = 1e30;
/// What exp(2) is to a sequence that tells no exposure.
constexpr double kDefaultExposure = 7.38905609893065;

std::string number_text(uint32_t number) { return fmt::format("{:04}", number); }

/// 2, 1.5, 1.7: at most three decimals, none that are 0.
std::string ratio_text(double ratio) {
  std::string text = fmt::format("{:.3f}", ratio);
  while (text.back() == '0') text.pop_back();
  if (text.back() == '.') text.pop_back();
  return text;
}

/// A ratio in the name of a JSON key: x1_5_index.
std::string ratio_key(std::string folder) {
  std::replace(folder.begin(), folder.end(), '.', '_');
  return folder + "_index";
}

/// The number in "x1.5" or "x1_5"; 0 if it is none.
double ratio_of(std::string folder) {
  std::replace(folder.begin(), folder.end(), '_', '.');
  double value = 0;
  if (folder.empty() || folder[0] != 'x') return 0;
  const char* end = folder.data() + folder.size();
  const auto [at, error] = std::from_chars(folder.data() + 1, end, value);
  return error == std::errc() && at == end && value >= 1 && value <= 16 ? value : 0;
}

Result<void> make_folder(const fs::path& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (error) return io_error(path.string(), "cannot create: {}", error.message());
  return {};
}

Result<std::array<float, 2>> parse_jitter(const Fields& frame, const Fields& root,
                                          const std::string& ratio, Extent render) {
  constexpr double kSlack = 1 + 1e-3;  // the quotient was rounded
  if (frame.has("NormalizedPerRatioJitter")) {
    SHALE_TRY(const std::vector<Fields> all, frame.list("NormalizedPerRatioJitter", 64));
    int64_t index = 0;
    if (root.has("UpscalingRatiosIndices")) {
      const Fields indices = root.child("UpscalingRatiosIndices");
      SHALE_TRY(index, indices.integer(ratio_key(ratio).c_str(), 0, 63));
    }
    if (static_cast<size_t>(index) >= all.size())
      return bad_input(frame.where(), "\"NormalizedPerRatioJitter\" has {} entries, ratio {} is {}",
                       all.size(), ratio, index);
    const Fields& entry = all[static_cast<size_t>(index)];
    const double x = 0.5 / render.width * kSlack, y = 0.5 / render.height * kSlack;
    SHALE_TRY(const double jx, entry.number("X", -x, x));
    SHALE_TRY(const double jy, entry.number("Y", -y, y));
    return std::array{std::clamp(static_cast<float>(jx * render.width), -0.5f, 0.5f),
                      std::clamp(static_cast<float>(jy * render.height), -0.5f, 0.5f)};
  }
  if (!frame.has("Jitter"))
    return bad_input(frame.where(), "\"Jitter\" is missing, expected {{\"X\": ..., \"Y\": ...}}");
  const Fields jitter = frame.child("Jitter");
  SHALE_TRY(const double x, jitter.number("X", -0.5, 0.5));
  SHALE_TRY(const double y, jitter.number("Y", -0.5, 0.5));
  return std::array{static_cast<float>(x), static_cast<float>(y)};
}

Result<FrameCamera> parse_frame_camera(const Fields& frame, const Fields& root,
                                       const std::string& ratio, Extent render) {
  constexpr double kPi = 3.1415926;
  FrameCamera camera;
  SHALE_TRY(const double fov_x, frame.number("FovX", 1e-3, kPi));
  SHALE_TRY(const double fov_y, frame.number("FovY", 1e-3, kPi));
  SHALE_TRY(const double near, frame.number("CameraNearPlane", 1e-9, kHuge));
  SHALE_TRY(const double far, frame.number("CameraFarPlane", -1, kHuge));
  if (far > 0 && far <= near)
    return bad_input(frame.where(),
                     "\"CameraFarPlane\" is {}, expected more than the near plane, "
                     "{}, or -1",
                     far, near);
  camera.fov_x = static_cast<float>(fov_x);
  camera.fov_y = static_cast<float>(fov_y);
  camera.near_plane = static_cast<float>(near);
  camera.far_plane = far > 0 ? static_cast<float>(far) : 0;
  SHALE_TRY(camera.jitter, parse_jitter(frame, root, ratio, render));
  SHALE_TRY(const double exposure, frame.number("Exposure", 1e-9, 1e9, kDefaultExposure));
  camera.exposure = static_cast<float>(exposure);
  SHALE_TRY(camera.cut, frame.flag("CameraCut", false));
  if (frame.has("ViewProjection")) {
    SHALE_TRY(const std::vector<double> values, frame.numbers("ViewProjection", 16, -kHuge, kHuge));
    std::transform(values.begin(), values.end(), camera.view_projection.begin(),
                   [](double v) { return static_cast<float>(v); });
  }
  return camera;
}

}  // namespace

std::string ratio_folder(Extent render, Extent output) {
  return "x" + ratio_text(static_cast<double>(output.width) / render.width);
}

Result<DatasetWriter> DatasetWriter::create(const std::string& root, const SequenceInfo& info) {
  DatasetWriter writer(root, info);
  const std::string ratio = ratio_folder(info.render, info.output);
  const std::string name = number_text(info.number);
  for (const std::string& folder :
       {std::string("ground_truth"), std::string("motion_gt"), std::string("depth_gt"),
        ratio + "/color", ratio + "/depth", ratio + "/motion"})
    SHALE_TRY_VOID(make_folder(fs::path(root) / folder / name));
  return writer;
}

Result<void> DatasetWriter::add(const SourceFrame& frame) {
  const fs::path root(root_), ratio = root / ratio_folder(info_.render, info_.output);
  const fs::path file = fs::path(number_text(info_.number)) /
                        (number_text(static_cast<uint32_t>(cameras_.size())) + ".exr");
  const auto write = [&](const fs::path& folder, const FloatImage& image,
                         ExrPrecision precision) -> Result<void> {
    if (image.empty()) return {};
    return write_exr((folder / file).string(), image, precision);
  };
  SHALE_TRY_VOID(write(ratio / "color", frame.color, ExrPrecision::kHalf));
  SHALE_TRY_VOID(write(ratio / "depth", frame.depth, ExrPrecision::kFloat));
  SHALE_TRY_VOID(write(ratio / "motion", frame.motion, ExrPrecision::kHalf));
  SHALE_TRY_VOID(write(root / "ground_truth", frame.truth, ExrPrecision::kHalf));
  SHALE_TRY_VOID(write(root / "motion_gt", frame.truth_motion, ExrPrecision::kHalf));
  SHALE_TRY_VOID(write(root / "depth_gt", frame.truth_depth, ExrPrecision::kFloat));
  cameras_.push_back(frame.camera);
  return {};
}

Result<void> DatasetWriter::finish() {
  const std::string ratio = ratio_folder(info_.render, info_.output);
  OrderedJson json{
      {"Version", "1.0.1"},
      {"EmulatedFramerate", info_.frame_rate},
      {"TargetResolution", {{"X", info_.output.width}, {"Y", info_.output.height}}},
      {"Samples", {{"Sequence", "Halton"}, {"Count", info_.jitter_phases}, {"Quantized", true}}},
      {"ReverseZ", !cameras_.empty() && cameras_[0].reverse_depth},
      {"UpscalingRatiosIndices", {{ratio_key(ratio), 0}}},
      {"Frames", OrderedJson::array()}};
  for (size_t i = 0; i < cameras_.size(); ++i) {
    const FrameCamera& c = cameras_[i];
    const double x = c.jitter[0], y = c.jitter[1];
    json["Frames"].push_back(
        {{"Frame", i},
         {"FovX", c.fov_x},
         {"FovY", c.fov_y},
         {"CameraNearPlane", c.near_plane},
         {"CameraFarPlane", c.far_plane > 0 ? c.far_plane : -1.0f},
         {"ViewProjection", c.view_projection},
         {"Jitter", {{"X", x}, {"Y", y}}},
         {"NormalizedPerRatioJitter",
          OrderedJson::array({{{"X", x / info_.render.width}, {"Y", y / info_.render.height}}})},
         {"Exposure", c.exposure},
         {"CameraCut", c.cut}});
  }
  return write_text((fs::path(root_) / (number_text(info_.number) + ".json")).string(),
                    json.dump(1) + "\n");
}

Result<std::unique_ptr<DatasetSource>> DatasetSource::open(const std::string& json_path,
                                                           const std::string& ratio) {
  SHALE_TRY(const std::string text, read_text(json_path));
  auto source = std::unique_ptr<DatasetSource>(new DatasetSource());
  source->root_ = fs::path(json_path).parent_path().string();
  source->name_ = fs::path(json_path).stem().string();
  if (Result<void> parsed = source->parse(text, ratio); !parsed) {
    Error error = parsed.error();
    error.where = error.where.empty() ? json_path : json_path + ": " + error.where;
    return error;
  }
  return source;
}

Result<void> DatasetSource::parse(const std::string& text, const std::string& ratio) {
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, false);
  if (json.is_discarded() || !json.is_object()) return bad_input("", "is not a JSON object");
  const Fields root(json, "sequence");
  if (!root.has("TargetResolution"))
    return bad_input("sequence", "\"TargetResolution\" is missing, expected an object");
  const Fields target = root.child("TargetResolution");
  SHALE_TRY(const int64_t width, target.integer("X", 1, kMaxSide));
  SHALE_TRY(const int64_t height, target.integer("Y", 1, kMaxSide));
  output_ = {static_cast<uint32_t>(width), static_cast<uint32_t>(height)};
  ratio_ = ratio;
  if (ratio_.empty() && root.has("UpscalingRatiosIndices") &&
      root.json()["UpscalingRatiosIndices"].is_object()) {
    for (const auto& [key, index] : root.json()["UpscalingRatiosIndices"].items()) {
      if (!key.ends_with("_index") || ratio_of(key.substr(0, key.size() - 6)) == 0) continue;
      ratio_ = "x" + ratio_text(ratio_of(key.substr(0, key.size() - 6)));
      break;
    }
  }
  if (ratio_.empty()) ratio_ = "x2";
  const double factor = ratio_of(ratio_);
  if (factor == 0) return bad_input("ratio", "\"{}\" is none, expected such as x2 or x1.5", ratio_);
  render_ = {static_cast<uint32_t>(std::lround(output_.width / factor)),
             static_cast<uint32_t>(std::lround(output_.height / factor))};
  if (render_.width == 0 || render_.height == 0)
    return bad_input("sequence", "{}x{} is too small for ratio {}", width, height, ratio_);
  SHALE_TRY(frame_rate_, root.number("EmulatedFramerate", 1e-3, 1e6, 30.0));
  SHALE_TRY(const bool reverse, root.flag("ReverseZ", false));
  SHALE_TRY(const std::vector<Fields> frames, root.list("Frames", kMaxFrames));
  if (frames.empty()) return bad_input("sequence", "\"Frames\" is empty, expected at least 1");
  for (const Fields& frame : frames) {
    SHALE_TRY(FrameCamera camera, parse_frame_camera(frame, root, ratio_, render_));
    camera.reverse_depth = reverse;
    // Nothing is continued from before a sequence.
    camera.cut = camera.cut || cameras_.empty();
    cameras_.push_back(camera);
  }
  return {};
}

std::string DatasetSource::picture(const char* folder, uint32_t index) const {
  return (fs::path(root_) / folder / name_ / (number_text(index) + ".exr")).string();
}

Result<SourceFrame> DatasetSource::frame(uint32_t index, bool with_truth) {
  if (index >= cameras_.size())
    return bad_input(name_, "frame {} is asked for, the sequence has {}", index, cameras_.size());
  SourceFrame frame;
  frame.camera = cameras_[index];
  SHALE_TRY(frame.color, read_exr(picture((ratio_ + "/color").c_str(), index), 3, render_));
  SHALE_TRY(frame.depth, read_exr(picture((ratio_ + "/depth").c_str(), index), 1, render_));
  SHALE_TRY(frame.motion, read_exr(picture((ratio_ + "/motion").c_str(), index), 2, render_));
  if (!with_truth) return frame;
  std::error_code ignored;
  if (const std::string path = picture("ground_truth", index); fs::exists(path, ignored)) {
    SHALE_TRY(frame.truth, read_exr(path, 3, output_));
  }
  if (const std::string path = picture("motion_gt", index); fs::exists(path, ignored)) {
    SHALE_TRY(frame.truth_motion, read_exr(path, 2, output_));
  }
  if (const std::string path = picture("depth_gt", index); fs::exists(path, ignored)) {
    SHALE_TRY(frame.truth_depth, read_exr(path, 1, output_));
  }
  return frame;
}

Result<std::vector<std::string>> dataset_sequences(const std::string& root) {
  std::vector<std::string> paths;
  std::error_code error;
  fs::directory_iterator it(root, error);
  for (; !error && it != fs::directory_iterator(); it.increment(error)) {
    const std::string stem = it->path().stem().string();
    const bool digits = !stem.empty() && std::all_of(stem.begin(), stem.end(),
                                                     [](char c) { return c >= '0' && c <= '9'; });
    if (digits && it->path().extension() == ".json") paths.push_back(it->path().string());
  }
  if (error) return io_error(root, "cannot list: {}", error.message());
  if (paths.empty()) return bad_input(root, "holds no sequence, expected files such as 0000.json");
  std::sort(paths.begin(), paths.end());
  return paths;
}

}  // namespace shale
