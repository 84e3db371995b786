#include "runtime/vk/processor.h"

#include <cstdlib>
#include <string_view>

namespace shale::vk {

Processor driver_processor() {
#if defined(__x86_64__) || defined(__i386__)
  const char* set = std::getenv("GALLIUM_OVERRIDE_CPU_CAPS");
  const std::string_view most = set ? set : "";
  if (most == "nosse" || most.starts_with("sse") || most == "ssse3") return Processor::kSse;
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && most != "avx")
    return Processor::kAvx512;
  return __builtin_cpu_supports("avx2") ? Processor::kAvx2 : Processor::kSse;
#elif defined(__aarch64__)
  return Processor::kNeon;
#else
  return Processor::kUnknown;
#endif
}

}  // namespace shale::vk
