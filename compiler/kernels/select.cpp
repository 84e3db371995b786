#include <algorithm>

#include "compiler/kernels/kernel.h"

namespace shale {
namespace {

constexpr KernelFamily kKernels[] = {
#define SHALE_KERNEL(prefix, name, literals) \
  {name, prefix##_supports, prefix##_work, literals, prefix##_emit},
#include "compiler/kernels/kernels.def"
};

/// The driver's compile time is spread over so many frames, minutes to hours of them: drivers keep
/// the code on disk. A layer that gains less in them is not worth more code.
constexpr double kFramesPerStart = 100000;

double weighed_us(const KernelFamily& family, const GroupProblem& problem,
                  const DeviceProfile& profile) {
  const double setup_us =
      family.literals
          ? profile.driver_us_per_product * static_cast<double>(family.literals(problem, profile))
          : 0;
  return work_time_us(family.work(problem, profile), profile.ns) + setup_us / kFramesPerStart;
}

}  // namespace

std::span<const KernelFamily> all_kernels() { return kKernels; }

const KernelFamily* find_kernel(std::string_view name) {
  for (const KernelFamily& family : kKernels)
    if (family.name == name) return &family;
  return nullptr;
}

const KernelFamily& select_kernel(const GroupProblem& problem, const DeviceProfile& profile,
                                  std::span<const std::string> allowed) {
  const KernelFamily& generic = kKernels[std::size(kKernels) - 1];  // supports everything
  const KernelFamily* best = nullptr;
  double best_us = 0;
  for (const KernelFamily& family : kKernels) {
    if (&family == &generic || !family.supports(problem, profile)) continue;
    if (!allowed.empty() && std::find(allowed.begin(), allowed.end(), family.name) == allowed.end())
      continue;
    const double time_us = weighed_us(family, problem, profile);
    if (!best || time_us < best_us) best = &family, best_us = time_us;
  }
  if (!best) return generic;
  // A family that was asked for by name serves wherever it can.
  const bool faster = work_time_us(best->work(problem, profile), profile.ns) <=
                      work_time_us(generic.work(problem, profile), profile.ns);
  return faster || !allowed.empty() ? *best : generic;
}

}  // namespace shale
