// tools/eval/wide.h -- loops for the registers that the processor has.
#pragma once

/// Before a function of plain loops over floats: it is compiled for wider registers, too, and the form is chosen when the
/// program starts. All forms have the same results, because the library is compiled without contraction of floats.
/// Sanitizers' builds have the plain form: what chooses would run before they are ready.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define SHALE_WIDE __attribute__((target_clones("default", "avx2", "avx512f")))
#else
#define SHALE_WIDE
#endif
