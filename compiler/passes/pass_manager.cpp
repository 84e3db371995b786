#include <chrono>

#include "compiler/passes/pass.h"
#include "ir/verify/verify.h"

namespace shale {
namespace {

constexpr PassInfo kPasses[] = {
#define SHALE_PASS(name, function, help) {name, function, help},
#include "compiler/passes/passes.def"
};

}  // namespace

std::span<const PassInfo> all_passes() { return kPasses; }

const PassInfo* find_pass(std::string_view name) {
  for (const PassInfo& pass : kPasses)
    if (pass.name == name) return &pass;
  return nullptr;
}

Result<Change> run_pass(const PassInfo& pass, Graph& graph, const PassContext& context) {
  SHALE_TRY(const Change change, pass.run(graph, context));
  if (change == Change::kChanged) graph.compact();
  return change;
}

Result<std::vector<PassTiming>> run_passes(Graph& graph, const PassContext& context,
                                           const PassOptions& options,
                                           std::span<const std::string_view> names) {
  std::vector<PassTiming> timings;
  for (const std::string_view name : names) {
    const PassInfo* pass = find_pass(name);
    SHALE_CHECK(pass != nullptr);
    const auto start = std::chrono::steady_clock::now();
    SHALE_TRY(const Change change, run_pass(*pass, graph, context));
    const std::chrono::duration<double, std::micro> elapsed =
        std::chrono::steady_clock::now() - start;
    timings.push_back({pass->name, elapsed.count(), change});
    if (options.after) options.after(pass->name, graph);
    if (options.verify_each) {
      if (Result<void> verified = verify(graph); !verified) {
        verified.error().message += fmt::format(" (after pass {})", pass->name);
        return verified.error();
      }
    }
  }
  return timings;
}

}  // namespace shale
