// tools/eval/data_page.h -- self-contained pages: styles, Chart.js, data and scripts in one file.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace shale {

/// For text and for attributes in double quotes. Names come from files: what is not UTF-8 is replaced.
std::string escaped(const std::string& text);

/// JSON that no tag can end.
std::string script_json(const nlohmann::ordered_json& json);

/// A page that a script draws from data alone, so that its numbers are those of the JSON: `data` lies
/// in the element "data"; `script` runs after data_page.js, whose functions make tables and charts.
/// `title` needs no escaping.
std::string data_page(const std::string& title, const nlohmann::ordered_json& data,
                      std::string_view script);

}  // namespace shale
