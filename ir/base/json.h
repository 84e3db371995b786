// ir/base/json.h -- JSON of files that nobody vouches for.
#pragma once

#include <nlohmann/json.hpp>
#include <string_view>

#include "ir/base/result.h"

namespace shale {

/// Far above what any file here has: values are copied and compared by recursion, which ends with the
/// stack.
inline constexpr int kMaxJsonDepth = 64;

/// The value of a text, in which comments are allowed. `Json` is nlohmann::json or its ordered kin.
/// Errors: kBadInput with the byte, counted from 1, where it stops to be JSON; or if it is nested
/// deeper than kMaxJsonDepth.
template <typename Json = nlohmann::json>
Result<Json> parse_json(std::string_view text) {
  bool is_deep = false;
  const auto is_shallow = [&](int depth, typename Json::parse_event_t, const Json&) {
    is_deep = is_deep || depth > kMaxJsonDepth;
    return !is_deep;
  };
  try {
    Json json = Json::parse(text, is_shallow, true, true);
    if (is_deep) return bad_input("", "is nested deeper than {} levels", kMaxJsonDepth);
    return json;
  } catch (const nlohmann::json::parse_error& error) {
    return bad_input("", "is not valid JSON at byte {}", error.byte);
  } catch (const nlohmann::json::exception&) {  // a number beyond a double's range
    return bad_input("", "is not valid JSON, a number is out of range");
  }
}

}  // namespace shale
