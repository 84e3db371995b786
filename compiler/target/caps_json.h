// compiler/target/caps_json.h -- a device's capabilities as text, to compile for a device that is
// not at hand.
#pragma once

#include <string>
#include <string_view>

#include "ir/base/result.h"
#include "ir/package/caps.h"

namespace shale {

inline constexpr std::string_view kCapsSchema = "shale-caps/1";

/// A JSON object of kCapsSchema with a member for each of DeviceCaps. Names are those of the
/// driver: what is not UTF-8 in them is replaced.
std::string caps_json(const DeviceCaps& caps);

/// Reads untrusted JSON: what caps_json writes, or what `shale doctor --json` prints, of which the
/// first device counts. Members that are not known are left alone; a feature that is not named is not
/// there.
/// Errors: kBadInput naming the member.
Result<DeviceCaps> parse_caps(const std::string& text);

}  // namespace shale
