#include "runtime/vk/processor.h"

#include <array>
#include <cstdlib>
#include <cstring>
#include <string_view>
#if defined(__x86_64__) || defined(__i386__)
#include <cpuid.h>
#endif

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

std::string processor_model() {
#if defined(__x86_64__) || defined(__i386__)
  // Source: the brand string, CPUID leaves 0x80000002 to 0x80000004.
  std::array<uint32_t, 12> words{};
  for (uint32_t leaf = 0; leaf < 3; ++leaf) {
    uint32_t* word = words.data() + 4 * leaf;
    if (!__get_cpuid(0x80000002 + leaf, word, word + 1, word + 2, word + 3)) return "x86";
  }
  std::array<char, sizeof(words) + 1> text{};
  std::memcpy(text.data(), words.data(), sizeof(words));
  const std::string_view name = text.data();
  const size_t first = name.find_first_not_of(' '), last = name.find_last_not_of(' ');
  return first == std::string_view::npos ? "x86"
                                         : std::string(name.substr(first, last - first + 1));
#elif defined(__aarch64__)
  return "AArch64";
#else
  return "unknown";
#endif
}

}  // namespace shale::vk
