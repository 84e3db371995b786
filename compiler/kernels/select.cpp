#include <algorithm>

#include "compiler/kernels/kernel.h"

namespace shale {
namespace {

constexpr KernelFamily kKernels[] = {
#define SHALE_KERNEL(name, supports, time_us, emit) {name, supports, time_us, emit},
#include "compiler/kernels/kernels.def"
};

}  // namespace

std::span<const KernelFamily> all_kernels() { return kKernels; }

const KernelFamily& select_kernel(const GroupProblem& problem, const DeviceProfile& profile,
                                  std::span<const std::string> allowed) {
  const KernelFamily* best = nullptr;
  double best_us = 0;
  for (const KernelFamily& family : kKernels) {
    const bool is_generic = &family == &kKernels[std::size(kKernels) - 1];
    if (!allowed.empty() && !is_generic &&
        std::find(allowed.begin(), allowed.end(), family.name) == allowed.end())
      continue;
    if (!family.supports(problem, profile)) continue;
    const double time_us = family.time_us(problem, profile);
    if (!best || time_us < best_us) best = &family, best_us = time_us;
  }
  return *best;  // the generic kernel supports everything
}

}  // namespace shale
