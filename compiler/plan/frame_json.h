// compiler/plan/frame_json.h -- how frame.json is read: what the parts of its parser share.
#pragma once

#include <cmath>

#include "compiler/plan/frame.h"
#include "ir/base/json.h"

namespace shale::frame_json {

using Json = nlohmann::json;

inline constexpr uint32_t kMaxEntries = 64;
inline constexpr double kMaxRatio = 16;
inline constexpr uint32_t kMaxDivide = 64;
inline constexpr uint32_t kMaxMultiple = 256;
inline constexpr uint32_t kMaxHistory = 8;
inline constexpr uint32_t kMaxLocalSize = 32;
inline constexpr size_t kMaxBoundChannels = 1024;

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

bool is_identifier(const std::string& name);
/// The field "name". Names become preprocessor definitions, so they are identifiers.
Result<std::string> identifier(const Fields& fields);
/// "render", "output", or {"of": one of them, "divide": N or [N, N], "multiple": N}.
Result<FrameSize> parse_size(const Fields& fields, const char* key = "size");

/// What files of schema "shale-frame/1" had and nobody has to say any more.
Result<void> refuse_old_fields(const Fields& fields);

/// Which of the sets of weights is read, of how many; one is what frames without sets have.
struct SetIndex {
  size_t index = 0, count = 1;
};

// Of frame_passes.cpp.
Result<FrameProgram> parse_program(const Fields& fields, std::string name, SetIndex set = {});
Result<FramePromise> parse_promise(const Fields& fields);
/// The forms of passes and the names that they take.
Result<void> check_forms(const Frame& frame);

}  // namespace shale::frame_json
