#include "tools/eval/data_page.h"

#include <fmt/format.h>

#include "tools/eval/chart_js.h"
#include "tools/eval/page.h"

namespace shale {

using Json = nlohmann::ordered_json;

std::string escaped(const std::string& text) {
  const std::string valid =
      Json::parse(Json(text).dump(-1, ' ', false, Json::error_handler_t::replace))
          .get<std::string>();
  std::string result;
  for (const char c : valid) {
    switch (c) {
      case '&': result += "&amp;"; break;
      case '<': result += "&lt;"; break;
      case '>': result += "&gt;"; break;
      case '"': result += "&quot;"; break;
      case '\'': result += "&#39;"; break;
      default: result += c;
    }
  }
  return result;
}

std::string script_json(const Json& json) {
  const std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  std::string result;
  for (const char c : text) {
    if (c == '<')
      result += "\\u003c";
    else
      result += c;
  }
  return result;
}

std::string data_page(const std::string& title, const Json& data, std::string_view script) {
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<title>{0}</title>\n<style>\n{1}</style>\n</head>\n<body>\n<h1>{0}</h1>\n"
      "<main id=\"main\"></main>\n"
      "<script type=\"application/json\" id=\"data\">{2}</script>\n"
      "<script>\n{3}\n</script>\n<script>\n{4}</script>\n<script>\n{5}</script>\n"
      "</body>\n</html>\n",
      escaped(title), page::kEmbeddedFiles[0].text, script_json(data),
      chart_js::kEmbeddedFiles[0].text, page::kEmbeddedFiles[2].text, script);
}

}  // namespace shale
