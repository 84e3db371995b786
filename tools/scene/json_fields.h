// tools/scene/json_fields.h -- fields of JSON objects from untrusted files, with errors that say where.
#pragma once

#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "ir/base/result.h"
#include "tools/scene/vector.h"

namespace shale {

/// A JSON object with the path that messages name it by. Borrows the JSON.
class Fields {
 public:
  using Json = nlohmann::json;

  Fields(const Json& json, std::string where) : json_(&json), where_(std::move(where)) {}

  const Json& json() const { return *json_; }
  const std::string& where() const { return where_; }
  bool has(const char* key) const { return json_->is_object() && json_->contains(key); }

  /// Errors: kBadInput if this is no object, or has a field that is not among `known`.
  Result<void> only(std::initializer_list<const char*> known) const {
    if (!json_->is_object())
      return bad_input(where_, "found {}, expected an object", json_->type_name());
    for (const auto& [key, value] : json_->items()) {
      bool found = false;
      for (const char* name : known) found = found || key == name;
      if (found) continue;
      std::string names;
      for (const char* name : known) names += fmt::format("{}{}", names.empty() ? "" : ", ", name);
      return bad_input(where_, "field \"{}\" is unknown, expected one of {}", key, names);
    }
    return {};
  }

  Result<std::string> text(const char* key, std::optional<std::string> absent = {}) const {
    if (!has(key) && absent) return *absent;
    if (!has(key)) return missing(key, "a text");
    const Json& value = (*json_)[key];
    if (!value.is_string() || value.get_ref<const std::string&>().empty())
      return wrong(key, value, "a text");
    return value.get<std::string>();
  }

  Result<bool> flag(const char* key, std::optional<bool> absent = {}) const {
    if (!has(key) && absent) return *absent;
    if (!has(key)) return missing(key, "true or false");
    const Json& value = (*json_)[key];
    if (!value.is_boolean()) return wrong(key, value, "true or false");
    return value.get<bool>();
  }

  Result<double> number(const char* key, double low, double high,
                        std::optional<double> absent = {}) const {
    if (!has(key) && absent) return *absent;
    if (!has(key)) return missing(key, "a number");
    return as_number((*json_)[key], fmt::format("\"{}\"", key), low, high);
  }

  Result<int64_t> integer(const char* key, int64_t low, int64_t high,
                          std::optional<int64_t> absent = {}) const {
    if (!has(key) && absent) return *absent;
    SHALE_TRY(const double value, number(key, static_cast<double>(low), static_cast<double>(high)));
    if (value != std::floor(value))
      return bad_input(where_, "\"{}\" is {}, expected a whole number", key, value);
    return static_cast<int64_t>(value);
  }

  /// `count` numbers.
  Result<std::vector<double>> numbers(const char* key, size_t count, double low,
                                      double high) const {
    if (!has(key)) return missing(key, fmt::format("a list of {} numbers", count));
    const Json& value = (*json_)[key];
    if (!value.is_array() || value.size() != count)
      return wrong(key, value, fmt::format("a list of {} numbers", count));
    std::vector<double> result;
    for (size_t i = 0; i < count; ++i) {
      SHALE_TRY(const double item,
                as_number(value[i], fmt::format("\"{}\"[{}]", key, i), low, high));
      result.push_back(item);
    }
    return result;
  }

  /// `rows` lists of `columns` numbers, one after the other.
  Result<std::vector<double>> matrix(const char* key, size_t rows, size_t columns, double low,
                                     double high) const {
    const std::string expected = fmt::format("a list of {} lists of {} numbers", rows, columns);
    if (!has(key)) return missing(key, expected);
    const Json& value = (*json_)[key];
    if (!value.is_array() || value.size() != rows) return wrong(key, value, expected);
    std::vector<double> result;
    for (size_t r = 0; r < rows; ++r) {
      if (!value[r].is_array() || value[r].size() != columns) return wrong(key, value[r], expected);
      for (size_t c = 0; c < columns; ++c) {
        SHALE_TRY(const double item,
                  as_number(value[r][c], fmt::format("\"{}\"[{}][{}]", key, r, c), low, high));
        result.push_back(item);
      }
    }
    return result;
  }

  Result<Vec3> vec3(const char* key, double low, double high,
                    std::optional<Vec3> absent = {}) const {
    if (!has(key) && absent) return *absent;
    SHALE_TRY(const std::vector<double> v, numbers(key, 3, low, high));
    return Vec3{v[0], v[1], v[2]};
  }

  /// The index of the text among `names`.
  Result<uint32_t> choice(const char* key, std::initializer_list<const char*> names,
                          std::optional<uint32_t> absent = {}) const {
    if (!has(key) && absent) return *absent;
    SHALE_TRY(const std::string found, text(key));
    std::string all;
    uint32_t index = 0;
    for (const char* name : names) {
      if (found == name) return index;
      all += fmt::format("{}{}", all.empty() ? "" : ", ", name);
      ++index;
    }
    return bad_input(where_, "\"{}\" is \"{}\", expected one of {}", key, found, all);
  }

  Fields child(const char* key) const {
    return Fields((*json_)[key], fmt::format("{}.{}", where_, key));
  }

  /// Empty if absent.
  Result<std::vector<Fields>> list(const char* key, size_t most) const {
    std::vector<Fields> items;
    if (!has(key)) return items;
    const Json& value = (*json_)[key];
    if (!value.is_array()) return wrong(key, value, "a list");
    if (value.size() > most)
      return bad_input(where_, "\"{}\" has {} entries, expected at most {}", key, value.size(),
                       most);
    for (size_t i = 0; i < value.size(); ++i)
      items.emplace_back(value[i], fmt::format("{}.{}[{}]", where_, key, i));
    return items;
  }

 private:
  Error missing(const char* key, const std::string& expected) const {
    return bad_input(where_, "\"{}\" is missing, expected {}", key, expected);
  }
  Error wrong(const char* key, const Json& value, const std::string& expected) const {
    return bad_input(where_, "\"{}\" is {}, expected {}", key, described(value), expected);
  }
  static std::string described(const Json& value) {
    if (value.is_array()) return fmt::format("a list of {}", value.size());
    return value.is_object() ? "an object" : short_text(value);
  }
  static std::string short_text(const Json& value) {
    std::string text = value.dump(-1, ' ', true, Json::error_handler_t::replace);
    if (text.size() > 60) text = text.substr(0, 60) + "...";
    return text;
  }
  Result<double> as_number(const Json& json, const std::string& name, double low,
                           double high) const {
    if (!json.is_number())
      return bad_input(where_, "{} is {}, expected a number", name, described(json));
    const double value = json.get<double>();
    if (!(value >= low && value <= high))
      return bad_input(where_, "{} is {}, expected {} to {}", name, value, low, high);
    return value;
  }

  const Json* json_;
  std::string where_;
};

}  // namespace shale
