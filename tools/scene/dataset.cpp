#include "tools/scene/dataset.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>

#include "ir/base/file.h"
#include "ir/base/json.h"
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

/// The number in "x1.5" or "x1_5"; 0 if it is none.
double ratio_of(std::string folder) {
  std::replace(folder.begin(), folder.end(), '_', '.');
  double value = 0;
  if (folder.empty() || folder[0] != 'x') return 0;
  const char* end = folder.data() + folder.size();
  const auto [at, error] = std::from_chars(folder.data() + 1, end, value);
  return error == std::errc() && at == end && value >= 1 && value <= 16 ? value : 0;
}

bool same_ratio(double a, double b) { return std::abs(a - b) < 1e-6; }

/// The ratios of a sequence, each with its place in lists by ratio; none where it does not tell them.
Result<std::map<double, size_t>> ratio_indices(const Fields& root) {
  std::map<double, size_t> places;
  if (!root.has("UpscalingRatiosIndices")) return places;
  const Fields indices = root.child("UpscalingRatiosIndices");
  if (!indices.json().is_object())
    return bad_input(root.where(), "\"UpscalingRatiosIndices\" is no object");
  constexpr std::string_view kSuffix = "_index";
  for (const auto& [key, value] : indices.json().items()) {
    if (!key.ends_with(kSuffix)) continue;
    const double ratio = ratio_of(key.substr(0, key.size() - kSuffix.size()));
    if (ratio == 0) continue;
    SHALE_TRY(const int64_t index, indices.integer(key.c_str(), 0, 63));
    places[ratio] = static_cast<size_t>(index);
  }
  return places;
}

/// Takes a regular file away; of a link to one the link.
Result<void> remove_file(const fs::path& path) {
  std::error_code error;
  if (!fs::is_regular_file(path, error)) return {};
  fs::remove(path, error);
  if (error) return io_error(path.string(), "cannot remove: {}", error.message());
  return {};
}

/// The pictures that an earlier sequence left in the folder.
Result<void> remove_pictures(const fs::path& folder) {
  std::vector<fs::path> pictures;
  std::error_code error;
  fs::directory_iterator it(folder, error);
  for (; !error && it != fs::directory_iterator(); it.increment(error))
    if (it->path().extension() == ".exr" &&
        it->path().stem().string().find_first_not_of("0123456789") == std::string::npos)
      pictures.push_back(it->path());
  if (error) return io_error(folder.string(), "cannot list: {}", error.message());
  for (const fs::path& picture : pictures) SHALE_TRY_VOID(remove_file(picture));
  return {};
}

Result<std::array<float, 2>> parse_jitter(const Fields& frame, std::optional<size_t> index,
                                          double ratio, Extent render) {
  constexpr double kSlack = 1 + 1e-3;  // the quotient was rounded
  for (const char* key : {"NormalizedPerRatioJitter", "QuantisedPerRatioJitter"}) {
    if (!frame.has(key)) continue;
    SHALE_TRY(const std::vector<Fields> all, frame.list(key, 64));
    // One entry needs no index; without one for the ratio the plain jitter has to do.
    const size_t at = index.value_or(all.size() == 1 ? 0 : SIZE_MAX);
    if (!index && at >= all.size() && frame.has("Jitter")) continue;
    if (at >= all.size())
      return bad_input(frame.where(), "\"{}\" has {} entries, ratio {} is {}", key, all.size(),
                       ratio, index ? std::to_string(*index) : "not in UpscalingRatiosIndices");
    const Fields& entry = all[at];
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
                                       std::optional<size_t> index, double ratio, Extent render) {
  constexpr double kPi = 3.1415926;
  FrameCamera camera;
  SHALE_TRY(const double fov_x, frame.number("FovX", 1e-3, kPi));
  SHALE_TRY(const double fov_y, frame.number("FovY", 1e-3, kPi));
  // Older captures tell them once.
  const bool once = !frame.has("CameraNearPlane") && root.has("NearPlane");
  const Fields& planes = once ? root : frame;
  SHALE_TRY(const double near, planes.number(once ? "NearPlane" : "CameraNearPlane", 1e-9, kHuge));
  SHALE_TRY(const double far, planes.number(once ? "FarPlane" : "CameraFarPlane", -1, kHuge));
  if (far > 0 && far <= near)
    return bad_input(frame.where(),
                     "\"CameraFarPlane\" is {}, expected more than the near plane, "
                     "{}, or -1",
                     far, near);
  camera.fov_x = static_cast<float>(fov_x);
  camera.fov_y = static_cast<float>(fov_y);
  camera.near_plane = static_cast<float>(near);
  camera.far_plane = far > 0 ? static_cast<float>(far) : 0;
  SHALE_TRY(camera.jitter, parse_jitter(frame, index, ratio, render));
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

double ratio_of_sizes(Extent render, Extent output) {
  const double exact = static_cast<double>(output.width) / render.width;
  const auto gives = [&](double ratio, bool or_nearest) {
    const auto side = [&](uint32_t from, uint32_t to) {
      return std::floor(from / ratio) == to || (or_nearest && std::lround(from / ratio) == to);
    };
    return side(output.width, render.width) && side(output.height, render.height);
  };
  const auto rounded = [&](double unit) { return std::round(exact * unit) / unit; };
  for (const bool or_nearest : {false, true})
    for (const double unit : {1.0, 10.0, 100.0, 1000.0})
      if (gives(rounded(unit), or_nearest)) return rounded(unit);
  return rounded(1000);
}

std::string ratio_folder(double ratio) {
  std::string text = fmt::format("x{:.3f}", ratio);
  while (text.back() == '0') text.pop_back();
  if (text.back() == '.') text.pop_back();
  std::replace(text.begin(), text.end(), '.', '_');
  return text;
}

bool is_sequence_file(const std::string& path) {
  const std::string stem = fs::path(path).stem().string();
  const size_t digits = std::min(stem.find_first_not_of("0123456789"), stem.size());
  return fs::path(path).extension() == ".json" && digits >= 4 &&
         (digits == stem.size() || stem[digits] == '_');
}

Result<DatasetWriter> DatasetWriter::create(const std::string& root, const SequenceInfo& info) {
  DatasetWriter writer(root, info);
  if (info.ratio == 0) writer.info_.ratio = ratio_of_sizes(info.render, info.output);
  const std::string ratio = ratio_folder(writer.info_.ratio);
  const std::string name = number_text(info.number);
  // First what makes an earlier sequence whole, then its pictures, which would pass for the new one's.
  SHALE_TRY_VOID(remove_file(fs::path(root) / (name + ".json")));
  for (const std::string& folder :
       {std::string("ground_truth"), std::string("motion_gt"), std::string("depth_gt"),
        ratio + "/color", ratio + "/depth", ratio + "/motion"}) {
    const fs::path of_sequence = fs::path(root) / folder / name;
    SHALE_TRY_VOID(make_folder(of_sequence.string()));
    SHALE_TRY_VOID(remove_pictures(of_sequence));
  }
  return writer;
}

Result<void> DatasetWriter::add(const SourceFrame& frame) {
  const fs::path root(root_), ratio = root / ratio_folder(info_.ratio);
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
  OrderedJson json{{"Version", "1.0.1"},
                   {"EmulatedFramerate", info_.frame_rate},
                   {"TargetResolution", {{"X", info_.output.width}, {"Y", info_.output.height}}},
                   {"Samples",
                    {{"Sequence", info_.sampling == "halton" ? "Halton" : info_.sampling},
                     {"Count", info_.jitter_phases},
                     {"Quantized", info_.sampling == "halton"}}},
                   {"ReverseZ", !cameras_.empty() && cameras_[0].reverse_depth},
                   {"UpscalingRatiosIndices", {{ratio_folder(info_.ratio) + "_index", 0}}},
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
                                                           double ratio) {
  SHALE_TRY(const std::string text, read_text(json_path));
  auto source = std::unique_ptr<DatasetSource>(new DatasetSource());
  source->root_ = fs::path(json_path).parent_path().string();
  source->name_ = fs::path(json_path).stem().string();
  if (Result<void> parsed = source->parse(text, ratio); !parsed) {
    // That of a picture names the picture.
    Error error = parsed.error();
    if (error.where == "sequence" || error.where.starts_with("sequence.") || error.where.empty())
      error.file = json_path;
    return error;
  }
  return source;
}

Result<void> DatasetSource::choose_ratio(double wanted, const std::map<double, size_t>& own) {
  std::map<double, std::string> folders;  // those that hold this sequence
  std::string others;                     // pictures of another one that had its name
  std::error_code error;
  fs::directory_iterator it(root_.empty() ? "." : root_, error);
  for (; !error && it != fs::directory_iterator(); it.increment(error)) {
    const std::string folder = it->path().filename().string();
    const double ratio = ratio_of(folder);
    std::error_code ignored;
    if (ratio == 0 || !fs::is_directory(it->path() / "color" / name_, ignored)) continue;
    if (!own.empty() && !own.contains(ratio)) {
      others += (others.empty() ? "" : ", ") + folder;
      continue;
    }
    const auto [known, is_new] = folders.emplace(ratio, folder);
    if (!is_new && folder == ratio_folder(ratio)) known->second = folder;
  }
  if (error) return io_error(root_, "cannot list: {}", error.message());
  std::string list;
  for (const auto& [ratio, folder] : folders) list += (list.empty() ? "" : ", ") + folder;
  if (folders.empty() && !others.empty())
    return bad_input("", "has no pictures of a ratio that \"UpscalingRatiosIndices\" names, but {}",
                     others);
  if (folders.empty())
    return bad_input("", "has no pictures beside it, expected a folder such as x2/color/{}", name_);
  const double asked = wanted != 0 ? wanted : 2;
  for (const auto& [ratio, folder] : folders)
    if (same_ratio(ratio, asked) || (wanted == 0 && folders.size() == 1)) {
      ratio_ = ratio;
      folder_ = folder;
      return {};
    }
  if (wanted != 0) return bad_input("", "has no pictures of ratio {}, it has {}", wanted, list);
  return bad_input("", "has pictures of several ratios, choose one with --ratio: {}", list);
}

Result<void> DatasetSource::measure_pictures() {
  size_t count = kMaxFrames;
  for (const char* kind : {"color", "depth", "motion"}) {
    const std::string folder = (fs::path(root_) / folder_ / kind / name_).string();
    std::error_code error;
    size_t pictures = 0;
    fs::directory_iterator it(folder, error);
    for (; !error && it != fs::directory_iterator(); it.increment(error))
      pictures += it->path().extension() == ".exr" ? 1 : 0;
    if (error) return io_error(folder, "cannot list: {}", error.message());
    if (pictures == 0) return bad_input(folder, "holds no picture, expected such as 0000.exr");
    count = std::min(count, pictures);
  }
  if (cameras_.size() > count) cameras_.resize(count);
  const std::string first = picture(folder_ + "/color", 0);
  SHALE_TRY(render_, exr_size(first));
  const auto fits = [&](uint32_t side, uint32_t of) {
    const double exact = of / ratio_;
    return std::abs(side - std::floor(exact)) <= 1 || std::abs(side - std::round(exact)) <= 1;
  };
  if (!fits(render_.width, output_.width) || !fits(render_.height, output_.height))
    return bad_input(first, "has {}x{} pixels, {}x{} at ratio {} makes {}x{}", render_.width,
                     render_.height, output_.width, output_.height, ratio_,
                     std::floor(output_.width / ratio_), std::floor(output_.height / ratio_));
  return {};
}

Result<void> DatasetSource::parse(const std::string& text, double ratio) {
  SHALE_TRY(const nlohmann::json json, parse_json(text));
  if (!json.is_object()) return bad_input("", "is no JSON object");
  const Fields root(json, "sequence");
  if (!root.has("TargetResolution"))
    return bad_input("sequence", "\"TargetResolution\" is missing, expected an object");
  const Fields target = root.child("TargetResolution");
  SHALE_TRY(const int64_t width, target.integer("X", 1, kMaxSide));
  SHALE_TRY(const int64_t height, target.integer("Y", 1, kMaxSide));
  output_ = {static_cast<uint32_t>(width), static_cast<uint32_t>(height)};
  SHALE_TRY(frame_rate_, root.number("EmulatedFramerate", 1e-3, 1e6, 30.0));
  SHALE_TRY(const bool reverse, root.flag("ReverseZ", false));
  SHALE_TRY(const std::vector<Fields> frames, root.list("Frames", kMaxFrames));
  if (frames.empty()) return bad_input("sequence", "\"Frames\" is empty, expected at least 1");
  SHALE_TRY(const auto ratios, ratio_indices(root));
  SHALE_TRY_VOID(choose_ratio(ratio, ratios));
  cameras_.resize(frames.size());
  SHALE_TRY_VOID(measure_pictures());
  const auto place = ratios.find(ratio_);
  std::optional<size_t> index;
  if (place != ratios.end()) index = place->second;
  for (size_t i = 0; i < cameras_.size(); ++i) {
    SHALE_TRY(cameras_[i], parse_frame_camera(frames[i], root, index, ratio_, render_));
    cameras_[i].reverse_depth = reverse;
    // Nothing is continued from before a sequence.
    cameras_[i].cut = cameras_[i].cut || i == 0;
  }
  return {};
}

std::string DatasetSource::picture(const std::string& folder, uint32_t index) const {
  return (fs::path(root_) / folder / name_ / (number_text(index) + ".exr")).string();
}

Result<SourceFrame> DatasetSource::frame(uint32_t index, bool with_truth) {
  if (index >= cameras_.size())
    return bad_input(name_, "frame {} is asked for, the sequence has {}", index, cameras_.size());
  SourceFrame frame;
  frame.camera = cameras_[index];
  SHALE_TRY(frame.color, read_exr(picture(folder_ + "/color", index), 3, render_));
  SHALE_TRY(frame.depth, read_exr(picture(folder_ + "/depth", index), 1, render_));
  SHALE_TRY(frame.motion, read_exr(picture(folder_ + "/motion", index), 2, render_));
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
    if (is_sequence_file(it->path().string())) paths.push_back(it->path().string());
  }
  if (error) return io_error(root, "cannot list: {}", error.message());
  if (paths.empty()) return bad_input(root, "holds no sequence, expected files such as 0000.json");
  std::sort(paths.begin(), paths.end());
  return paths;
}

}  // namespace shale
