// runtime/vk/processor.h -- the vectors that a driver on the CPU compiles shaders for.
#pragma once

#include <string>

#include "ir/package/caps.h"

namespace shale::vk {

/// What this processor has, as far as Mesa's GALLIUM_OVERRIDE_CPU_CAPS leaves it to the driver: "avx"
/// keeps AVX2 (seen in the machine code that Mesa 22.3 makes), "nosse" to "sse4.1" leave SSE.
Processor driver_processor();

/// What the processor calls itself ("AMD EPYC 9R14"), for figures that name their machine; its
/// architecture where it does not say.
std::string processor_model();

}  // namespace shale::vk
