#include "ir/base/sampling_pattern.h"

#include <charconv>
#include <optional>

namespace shale {
namespace {

/// All of the text as a number.
std::optional<float> number(std::string_view text) {
  float value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return {};
  return value;
}

}  // namespace

Result<SamplingPattern> pattern_of(std::vector<std::array<float, 2>> offsets) {
  if (offsets.empty() || offsets.size() > kMaxPatternOffsets)
    return bad_input("pattern", "has {} offsets, expected 1 to {}", offsets.size(),
                     kMaxPatternOffsets);
  for (const auto& [x, y] : offsets)
    if (!(x >= -0.5f && x <= 0.5f && y >= -0.5f && y <= 0.5f))
      return bad_input("pattern", "the offset {},{} is outside -0.5 to 0.5", x, y);
  return SamplingPattern{SamplingPattern::Kind::kList, std::move(offsets)};
}

Result<SamplingPattern> parse_pattern(std::string_view text) {
  if (text == "halton") return SamplingPattern{};
  if (text == "mnss") return SamplingPattern{SamplingPattern::Kind::kMnss, {}};
  std::vector<std::array<float, 2>> offsets;
  for (std::string_view rest = text;;) {
    const size_t colon = rest.find(':');
    const std::string_view pair = rest.substr(0, colon);
    const size_t comma = pair.find(',');
    const auto x = number(pair.substr(0, comma));
    const auto y = comma == pair.npos ? std::nullopt : number(pair.substr(comma + 1));
    if (!x || !y)
      return bad_input("pattern",
                       "\"{}\" is none of halton, mnss, and offsets X,Y:X,Y:... (at \"{}\")", text,
                       pair);
    offsets.push_back({*x, *y});
    if (colon == rest.npos) break;
    rest.remove_prefix(colon + 1);
  }
  return pattern_of(std::move(offsets));
}

std::string pattern_name(const SamplingPattern& pattern) {
  switch (pattern.kind) {
    case SamplingPattern::Kind::kHalton: return "halton";
    case SamplingPattern::Kind::kMnss: return "mnss";
    case SamplingPattern::Kind::kList: return "list";
  }
  SHALE_CHECK(false);
}

std::string pattern_text(const SamplingPattern& pattern) {
  if (pattern.kind != SamplingPattern::Kind::kList) return pattern_name(pattern);
  std::string text;
  for (const auto& [x, y] : pattern.offsets)
    text += fmt::format("{}{},{}", text.empty() ? "" : ":", x, y);
  return text;
}

}  // namespace shale
