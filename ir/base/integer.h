// ir/base/integer.h -- arithmetic of sizes.
#pragma once

#include <cstdint>

namespace shale {

/// a / b rounded up; a >= 0, b > 0.
inline int64_t ceil_div(int64_t a, int64_t b) { return (a + b - 1) / b; }

}  // namespace shale
