#include "compiler/driver/frame.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

namespace shale {
namespace {

using Json = nlohmann::json;

constexpr uint32_t kMaxEntries = 64;
constexpr double kMaxScale = 16;
constexpr uint32_t kMaxHistory = 8;
constexpr uint32_t kMaxLocalSize = 32;

/// A JSON object with the path that messages name it by.
class Fields {
 public:
  Fields(const Json& json, std::string where) : json_(json), where_(std::move(where)) {}

  const std::string& where() const { return where_; }
  bool has(const char* key) const { return json_.is_object() && json_.contains(key); }

  Result<std::string> text(const char* key) const {
    if (!has(key) || !json_[key].is_string() || json_[key].get_ref<const std::string&>().empty())
      return bad_input(where_, "\"{}\" must be a text", key);
    return json_[key].get<std::string>();
  }

  Result<double> number(const char* key, double low, double high,
                        std::optional<double> absent = {}) const {
    if (!has(key) && absent) return *absent;
    if (!has(key) || !json_[key].is_number())
      return bad_input(where_, "\"{}\" must be a number", key);
    const double value = json_[key].get<double>();
    if (!(value >= low && value <= high))
      return bad_input(where_, "\"{}\" is {}, expected {} to {}", key, value, low, high);
    return value;
  }

  Result<int64_t> integer(const char* key, int64_t low, int64_t high,
                          std::optional<int64_t> absent = {}) const {
    if (!has(key) && absent) return *absent;
    SHALE_TRY(const double value, number(key, static_cast<double>(low), static_cast<double>(high)));
    if (value != std::floor(value))
      return bad_input(where_, "\"{}\" is {}, expected an integer", key, value);
    return static_cast<int64_t>(value);
  }

  Result<std::vector<Fields>> list(const char* key) const {
    std::vector<Fields> items;
    if (!has(key)) return items;
    if (!json_[key].is_array() || json_[key].size() > kMaxEntries)
      return bad_input(where_, "\"{}\" must be a list of at most {} entries", key, kMaxEntries);
    for (size_t i = 0; i < json_[key].size(); ++i)
      items.emplace_back(json_[key][i], fmt::format("{}.{}[{}]", where_, key, i));
    return items;
  }

  const Json& json() const { return json_; }

 private:
  const Json& json_;
  std::string where_;
};

/// Names become preprocessor definitions, so they are identifiers.
Result<std::string> identifier(const Fields& fields) {
  SHALE_TRY(const std::string name, fields.text("name"));
  const bool valid = std::all_of(name.begin(), name.end(),
                                 [](unsigned char c) { return std::isalnum(c) != 0 || c == '_'; });
  if (!valid || std::isdigit(static_cast<unsigned char>(name[0])) != 0)
    return bad_input(fields.where(), "the name \"{}\" is no identifier", name);
  return name;
}

Result<FrameImage> parse_image(const Fields& fields) {
  FrameImage image;
  SHALE_TRY(image.name, identifier(fields));
  SHALE_TRY(const std::string role, fields.text("role"));
  if (role == "input")
    image.category = Category::kImageInput;
  else if (role == "output")
    image.category = Category::kImageOutput;
  else if (role == "internal")
    image.category = Category::kImageInternal;
  else if (role == "history")
    image.category = Category::kImageHistory;
  else
    return bad_input(fields.where(), "role \"{}\" is none of input, output, internal, history",
                     role);
  SHALE_TRY(const std::string format, fields.text("format"));
  const std::optional<ImageFormat> known = image_format_from_name(format);
  if (!known || *known == ImageFormat::kRgba8Sint || *known == ImageFormat::kR8Sint)
    return bad_input(fields.where(), "format \"{}\" is no image format", format);
  image.format = *known;
  SHALE_TRY(image.scale, fields.number("scale", 1.0 / kMaxScale, kMaxScale, 1.0));
  if (image.category == Category::kImageHistory) {
    SHALE_TRY(const int64_t depth, fields.integer("depth", 2, kMaxHistory, 2));
    image.history_depth = static_cast<uint32_t>(depth);
  }
  return image;
}

Result<FrameTensor> parse_tensor(const Fields& fields) {
  FrameTensor tensor;
  SHALE_TRY(tensor.name, identifier(fields));
  SHALE_TRY(const double scale, fields.number("scale", 1e-12, 1e12));
  SHALE_TRY(const int64_t zero_point, fields.integer("zero_point", -32768, 65535, 0));
  tensor.quantization = {static_cast<float>(scale), static_cast<int32_t>(zero_point)};
  return tensor;
}

Result<FrameBinding> parse_binding(const Fields& fields) {
  FrameBinding binding;
  SHALE_TRY(const int64_t number, fields.integer("binding", 0, 63));
  binding.binding = static_cast<uint32_t>(number);
  binding.is_image = fields.has("image");
  SHALE_TRY(binding.name, fields.text(binding.is_image ? "image" : "tensor"));
  SHALE_TRY(const std::string access, fields.text("access"));
  if (access != "read" && access != "write")
    return bad_input(fields.where(), "access \"{}\" is neither read nor write", access);
  binding.reads = access == "read";
  binding.writes = access == "write";
  SHALE_TRY(const int64_t back, fields.integer("frames_back", 0, kMaxHistory - 1, 0));
  binding.frames_back = static_cast<uint32_t>(back);
  if (binding.writes && back != 0)
    return bad_input(fields.where(), "only this frame's image can be written");
  return binding;
}

Result<FramePass> parse_pass(const Fields& fields) {
  FramePass pass;
  pass.is_graph = fields.has("graph");
  if (pass.is_graph) {
    pass.name = "graph";
    return pass;
  }
  SHALE_TRY(pass.name, identifier(fields));
  SHALE_TRY(pass.shader, fields.text("shader"));
  SHALE_TRY(pass.over, fields.text("over"));
  if (fields.has("workgroup")) {
    const Json& size = fields.json()["workgroup"];
    if (!size.is_array() || size.size() != 2 || !size[0].is_number_unsigned() ||
        !size[1].is_number_unsigned())
      return bad_input(fields.where(), "\"workgroup\" must be two whole numbers");
    for (size_t i = 0; i < 2; ++i) {
      const uint64_t value = size[i].get<uint64_t>();
      if (value < 1 || value > kMaxLocalSize)
        return bad_input(fields.where(), "workgroup size {} is outside 1..{}", value,
                         kMaxLocalSize);
      pass.workgroup[i] = static_cast<uint32_t>(value);
    }
  }
  SHALE_TRY(const std::vector<Fields> bindings, fields.list("bindings"));
  for (const Fields& binding : bindings) {
    SHALE_TRY(FrameBinding parsed, parse_binding(binding));
    for (const FrameBinding& other : pass.bindings)
      if (other.binding == parsed.binding)
        return bad_input(binding.where(), "binding {} is used twice", parsed.binding);
    pass.bindings.push_back(std::move(parsed));
  }
  return pass;
}

}  // namespace

Result<Frame> parse_frame(const std::string& text) {
  const Json json = Json::parse(text, nullptr, false, true);
  if (json.is_discarded() || !json.is_object()) return bad_input("", "is not valid JSON");
  const Fields root(json, "frame");
  SHALE_TRY(const std::string schema, root.text("schema"));
  if (schema != "shale-frame/1")
    return bad_input("frame", "schema \"{}\" is unknown, expected \"shale-frame/1\"", schema);
  Frame frame;
  SHALE_TRY(const std::vector<Fields> images, root.list("images"));
  for (const Fields& fields : images) {
    SHALE_TRY(FrameImage image, parse_image(fields));
    frame.images.push_back(std::move(image));
  }
  SHALE_TRY(const std::vector<Fields> tensors, root.list("tensors"));
  for (const Fields& fields : tensors) {
    SHALE_TRY(FrameTensor tensor, parse_tensor(fields));
    frame.tensors.push_back(std::move(tensor));
  }
  SHALE_TRY(const std::vector<Fields> passes, root.list("passes"));
  for (const Fields& fields : passes) {
    SHALE_TRY(FramePass pass, parse_pass(fields));
    frame.passes.push_back(std::move(pass));
  }
  if (std::count_if(frame.passes.begin(), frame.passes.end(),
                    [](const FramePass& pass) { return pass.is_graph; }) != 1)
    return bad_input("frame.passes", "exactly one entry must be {{\"graph\": ...}}");
  return frame;
}

}  // namespace shale
