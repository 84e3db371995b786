#include "compiler/kernels/select.h"

#include <algorithm>

namespace shale {
namespace {

constexpr KernelFamily kKernels[] = {
#define SHALE_KERNEL(prefix, name, literals) \
  {name, prefix##_supports, prefix##_work, literals, prefix##_emit},
#include "compiler/kernels/kernels.def"
};
constexpr const KernelFamily& kGeneric = kKernels[std::size(kKernels) - 1];  // supports everything

/// A family that can make a group.
struct Candidate {
  const KernelFamily* family = nullptr;
  int64_t products = 0;
  double run_us = 0, driver_us = 0;

  double total_us(double runs) const { return driver_us + runs * run_us; }
};

Candidate candidate(const KernelFamily& family, const GroupProblem& problem,
                    const DeviceProfile& profile) {
  const WorkTable work = family.work(problem, profile);
  Candidate candidate{.family = &family, .run_us = work_time_us(work, profile.ns)};
  if (family.literals) candidate.products = family.literals(problem, profile);
  candidate.driver_us = profile.driver_us_per_product * static_cast<double>(candidate.products) +
                        profile.driver_us_per_module * work[Work::kDispatch];
  return candidate;
}

bool is_allowed(const KernelFamily& family, const SelectOptions& options) {
  return options.allowed.empty() || std::find(options.allowed.begin(), options.allowed.end(),
                                              family.name) != options.allowed.end();
}

/// The families among which a group's is chosen, in table order; one where it is asked for by name.
Result<std::vector<Candidate>> candidates(const GroupProblem& problem, const DeviceProfile& profile,
                                          const SelectOptions& options,
                                          std::map<std::string, std::string>& refused) {
  const auto one = [&](const KernelFamily& family) {
    return std::vector<Candidate>{candidate(family, problem, profile)};
  };
  const std::string& name = problem.graph->value(problem.group.result).name;
  if (const auto choice = options.choices.find(name); choice != options.choices.end()) {
    const KernelFamily* family = find_kernel(choice->second);
    if (!family) return bad_input("--choices", "\"{}\" is no kernel family", choice->second);
    if (family->supports(problem, profile)) return one(*family);
    refused[name] =
        fmt::format("\"{}\" cannot make \"{}\" for {}", choice->second, name, profile.name);
  }
  const KernelFamily* preferred = options.prefer.empty() ? nullptr : find_kernel(options.prefer);
  if (preferred && preferred->supports(problem, profile)) return one(*preferred);
  std::vector<Candidate> found;
  for (const KernelFamily& family : kKernels) {
    // A family that was asked for by name serves wherever it can, faster than the generic or not.
    const bool is_last_resort = &family == &kGeneric && found.empty();
    if ((is_allowed(family, options) || is_last_resort) && family.supports(problem, profile))
      found.push_back(candidate(family, problem, profile));
  }
  return found;
}

/// The family without weights in its code whose first result is there soonest, if that is sooner than `chosen`'s.
std::optional<Candidate> start_candidate(const GroupProblem& problem, const Candidate& chosen,
                                         const DeviceProfile& profile,
                                         const SelectOptions& options) {
  if (chosen.products == 0) return std::nullopt;
  std::optional<Candidate> soonest;
  for (const KernelFamily& family : kKernels) {
    if (family.literals || !is_allowed(family, options) || !family.supports(problem, profile))
      continue;
    const Candidate other = candidate(family, problem, profile);
    if (!soonest || other.total_us(1) < soonest->total_us(1)) soonest = other;
  }
  if (soonest && soonest->total_us(1) >= chosen.total_us(1)) return std::nullopt;
  return soonest;
}

}  // namespace

std::span<const KernelFamily> all_kernels() { return kKernels; }

const KernelFamily* find_kernel(std::string_view name) {
  for (const KernelFamily& family : kKernels)
    if (family.name == name) return &family;
  return nullptr;
}

void Selection::add(const Selection& other) {
  families.insert(families.end(), other.families.begin(), other.families.end());
  start_families.insert(start_families.end(), other.start_families.begin(),
                        other.start_families.end());
  products += other.products;
  run_us += other.run_us;
  driver_us += other.driver_us;
  start_us += other.start_us;
  refused.insert(other.refused.begin(), other.refused.end());
}

Result<Selection> select_kernels(std::span<const GroupProblem> problems,
                                 const DeviceProfile& profile, const SelectOptions& options) {
  const double runs = std::max(options.expected_runs, 1.0);
  std::vector<std::vector<Candidate>> choices;
  std::vector<const Candidate*> chosen;
  Selection selection;
  int64_t products = 0;
  for (const GroupProblem& problem : problems) {
    SHALE_TRY(std::vector<Candidate> found,
              candidates(problem, profile, options, selection.refused));
    choices.push_back(std::move(found));
  }
  for (const std::vector<Candidate>& group : choices) {
    chosen.push_back(
        &*std::min_element(group.begin(), group.end(), [&](const Candidate& a, const Candidate& b) {
          return a.total_us(runs) < b.total_us(runs);
        }));
    products += chosen.back()->products;
  }
  // Beyond the bound the code goes first that gains the least for a product.
  while (products > profile.most_products) {
    size_t at = 0;
    const Candidate* next = nullptr;
    double least = 0;
    for (size_t i = 0; i < choices.size(); ++i)
      for (const Candidate& other : choices[i]) {
        const int64_t saved = chosen[i]->products - other.products;
        if (saved <= 0) continue;
        const double loss =
            (other.total_us(runs) - chosen[i]->total_us(runs)) / static_cast<double>(saved);
        if (!next || loss < least) next = &other, least = loss, at = i;
      }
    if (!next) break;  // what is left was asked for by name
    products += next->products - chosen[at]->products;
    chosen[at] = next;
  }
  selection.products = products;
  for (const Candidate* each : chosen) {
    selection.families.push_back(each->family);
    selection.run_us += each->run_us;
    selection.driver_us += each->driver_us;
  }
  for (size_t i = 0; i < chosen.size(); ++i) {
    std::optional<Candidate> start;
    if (selection.driver_us > options.start_us)
      start = start_candidate(problems[i], *chosen[i], profile, options);
    selection.start_families.push_back(start ? start->family : nullptr);
    selection.start_us += start ? start->driver_us : chosen[i]->driver_us;
  }
  return selection;
}

}  // namespace shale
