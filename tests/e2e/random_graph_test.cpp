// Differential test over random graphs: for each, the interpreter on the raw graph, the interpreter
// after the pass pipeline, and the device with passes must agree bit for bit; so must the device
// with the same nodes unfused, and for every fourth graph the device without passes.
//
// With --real the graphs are of FP32 and FP16; the interpreter after the passes gives the same bits, and
// the devices' results lie in the bounds of ir/reference/bounds.h, as the interpreter's own do.
//
// A graph's seed is its number: `random_graph_test --seed 1234 --count 1` repeats one that failed.
#include "tests/e2e/random_graph.h"

#include <fmt/format.h>

#include <memory>

#include "compiler/driver/compile.h"
#include "ir/reference/bounds.h"
#include "ir/text/text.h"
#include "ir/verify/verify.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

constexpr int kNoDevice = 77;  // the exit code that CTest counts as skipped

struct Arguments {
  uint64_t seed = 1;
  uint64_t count = 1000;
  uint64_t validated = 0;
  bool real = false;
};

/// What a device should give.
struct Expected {
  std::vector<Tensor> values;
  std::vector<Bounds> bounds;  ///< empty: exactly the values
};

/// What did not hold, or nothing.
using Failure = std::optional<std::string>;

Failure compare(const char* what, const Result<std::vector<Tensor>>& found,
                const Expected& expected) {
  if (!found) return fmt::format("{}: {}", what, found.error().text());
  if (found->size() != expected.values.size())
    return fmt::format("{}: {} outputs, expected {}", what, found->size(), expected.values.size());
  for (size_t i = 0; i < expected.values.size(); ++i)
    if (const auto difference = expected.bounds.empty()
                                    ? first_difference((*found)[i], expected.values[i])
                                    : first_outside((*found)[i], expected.bounds[i]))
      return fmt::format("{}: output {}: {}", what, i, *difference);
  return std::nullopt;
}

/// Selection leaves small pictures to the generic kernel, so most graphs ask for the others where they
/// can serve, and these take turns.
CompileOptions options(bool optimize, uint64_t turn) {
  CompileOptions result;
  const std::span<const KernelFamily> families = all_kernels();
  result.prefer = families[turn % families.size()].name;
  if (turn % 4 != 3)
    for (const KernelFamily& family : families.first(families.size() - 1))
      result.kernels.emplace_back(family.name);
  result.pass_options.optimize = optimize;
  result.pass_options.verify_each = true;
  return result;
}

class Checker {
 public:
  explicit Checker(const ToolDevice& device) : device_(device) {}

  Failure check(const RandomGraph& random, bool without_passes, uint64_t turn) {
    if (const auto verified = verify(random.graph); !verified)
      return "the raw graph: " + verified.error().text();
    const Result<std::vector<Tensor>> raw = interpret(random.graph, random.inputs);
    if (!raw) return "the interpreter: " + raw.error().text();
    Expected expected{*raw, {}};

    const Result<Compiled> compiled = compile_graph(random.graph, 0, options(true, turn));
    if (!compiled) return "compiling with passes: " + compiled.error().text();
    if (const auto failure = compare("the interpreter after the passes",
                                     interpret(compiled->graph, random.inputs), expected))
      return failure;
    if (has_reals(random.graph)) {
      Result<std::vector<Bounds>> bounds = interpret_bounds(random.graph, random.inputs);
      if (!bounds) return "the bounds: " + bounds.error().text();
      expected.bounds = *std::move(bounds);
      for (const Bounds& output : expected.bounds)
        for (const Bound& bound : output) ++elements, anything += bound.is_anything();
      if (const auto failure = compare("the interpreter against its bounds", raw, expected))
        return failure;
    }
    if (const auto failure = run("the device with passes", *compiled, random, expected))
      return failure;

    if (const auto failure = check_tiles(random, turn)) return failure;
    if (turn % 4 == 1)
      if (const auto failure = check_start(random, turn, expected)) return failure;

    Graph unfused = compiled->graph;
    bool was_fused = false;
    for (Node& node : unfused.nodes) was_fused = was_fused || node.group != 0, node.group = 0;
    if (was_fused) {
      ++fused;
      const Result<Compiled> plain = compile_graph(std::move(unfused), 0, options(false, turn));
      if (!plain) return "compiling unfused: " + plain.error().text();
      if (const auto failure = run("the device unfused", *plain, random, expected)) return failure;
    }
    if (!without_passes) return std::nullopt;
    const Result<Compiled> plain = compile_graph(random.graph, 0, options(false, turn));
    if (!plain) return "compiling without passes: " + plain.error().text();
    return run("the device without passes", *plain, random, expected);
  }

  uint64_t fused = 0;
  uint64_t started = 0;                     ///< with start forms
  uint64_t elements = 0, anything = 0;      ///< of bounds; those that bound nothing
  std::map<std::string, uint64_t> kernels;  ///< dispatches of each family

  uint64_t changed_runs = 0, changed_parts = 0;  ///< by tiles; of which not all ran

 private:
  /// By tiles: a run, one with some elements of an input changed, one with the old ones again; all as the
  /// interpreter has them.
  Failure check_tiles(const RandomGraph& random, uint64_t turn) {
    CompileOptions by_tiles = options(true, turn);
    by_tiles.tiles = 0;
    const Result<Compiled> compiled = compile_graph(random.graph, 0, by_tiles);
    if (!compiled) return "compiling by tiles: " + compiled.error().text();
    const Result<Package> package = read_package(write_package(compiled->package));
    if (!package) return "the package by tiles is refused: " + package.error().text();
    if (has_reals(random.graph)) return std::nullopt;  // the same code, and results in bounds only
    Result<NetworkRun> run = NetworkRun::create(device_, *package, random.inputs);
    if (!run) return "by tiles: " + run.error().text();
    std::vector<Tensor> changed = random.inputs;
    Random draw(turn);
    for (Tensor& input : changed)
      if (!input.bytes.empty() && draw.chance(60)) {
        const Tensor other = random_tensor(draw, input.type);
        const int64_t first = draw.between(0, input.count() - 1);
        for (int64_t i = first; i < std::min(first + draw.between(1, 40), input.count()); ++i)
          input.set(i, other.get(i));
      }
    const std::vector<Tensor>* const turns[] = {&random.inputs, &changed, &random.inputs};
    for (const std::vector<Tensor>* inputs : turns) {
      const Result<std::vector<Tensor>> expected = interpret(random.graph, *inputs);
      if (!expected) continue;  // of the changed ones TOSA need not give a result
      if (const auto set = run->set_inputs(*inputs); !set) return set.error().text();
      const auto ran = run->run_changes();
      if (!ran) return "by tiles: " + ran.error().text();
      ++changed_runs;
      changed_parts += ran->share < 0.99;
      if (const auto failure = compare("the device by tiles", run->outputs(), {*expected, {}}))
        return failure;
    }
    return std::nullopt;
  }

  /// By the kernels of the start, and by those that replace them.
  Failure check_start(const RandomGraph& random, uint64_t turn, const Expected& expected) {
    CompileOptions soon = options(true, turn);
    soon.start_us = 0;
    const Result<Compiled> compiled = compile_graph(random.graph, 0, soon);
    if (!compiled) return "compiling with a start: " + compiled.error().text();
    if (compiled->package.variants[0].segments[0].start_forms.empty()) return std::nullopt;
    const Result<Package> package = read_package(write_package(compiled->package));
    if (!package) return "the package with a start is refused: " + package.error().text();
    Result<NetworkRun> run =
        NetworkRun::create(device_, *package, random.inputs, nullptr, Compile::kByHost);
    if (!run) return "with a start: " + run.error().text();
    ++started;
    for (const char* what : {"the device at the start", "the device behind the start"}) {
      if (const auto ran = run->run(); !ran) return fmt::format("{}: {}", what, ran.error().text());
      if (const auto failure = compare(what, run->outputs(), expected)) return failure;
      if (const auto made = run->finish(); !made) return "with a start: " + made.error().text();
    }
    return std::nullopt;
  }

  Failure run(const char* what, const Compiled& compiled, const RandomGraph& random,
              const Expected& expected) {
    // What the runtime gets is what a file holds.
    const Result<Package> package = read_package(write_package(compiled.package));
    if (!package)
      return fmt::format("{}: its package is refused: {}", what, package.error().text());
    for (const Dispatch& dispatch : package->variants[0].segments[0].dispatches)
      ++kernels[dispatch.kernel];
    return compare(what, run_network(device_, *package, random.inputs), expected);
  }

  const ToolDevice& device_;
};

int run(const Arguments& arguments) {
  fmt::print("graphs {} to {}, the first {} under validation\n", arguments.seed,
             arguments.seed + arguments.count - 1, arguments.validated);
  RandomGraphCounts counts;
  std::map<std::string, uint64_t> kernels;
  uint64_t failures = 0, fused = 0, started = 0, changed_runs = 0, changed_parts = 0, elements = 0,
           anything = 0;
  std::unique_ptr<ToolDevice> device;
  for (uint64_t i = 0; i < arguments.count; ++i) {
    const bool validated = i < arguments.validated;
    if (i == 0 || i == arguments.validated) {
      Result<ToolDevice> opened =
          ToolDevice::open({.name = {}, .cache = {}, .validation = validated});
      if (!opened) {
        fmt::print("skipped: {}\n", opened.error().text());
        return opened.error().code == ErrorCode::kDevice ? kNoDevice : 1;
      }
      device = std::make_unique<ToolDevice>(*std::move(opened));
    }
    const uint64_t seed = arguments.seed + i;
    const RandomGraph random = random_graph(seed, counts, arguments.real);
    Checker checker(*device);
    Failure failure = checker.check(random, seed % 4 == 0, seed);
    const std::vector<std::string> messages = device->take_validation_messages();
    if (!failure && !messages.empty()) failure = "validation: " + messages.front();
    changed_runs += checker.changed_runs, changed_parts += checker.changed_parts;
    fused += checker.fused, started += checker.started, elements += checker.elements,
        anything += checker.anything;
    for (const auto& [name, count] : checker.kernels) kernels[name] += count;
    if (!failure) continue;
    ++failures;
    fmt::print("FAILED: graph of seed {}: {}\n{}\n", seed, *failure, print_text(random.graph));
    if (failures == 10) break;
  }
  const uint64_t drawn = counts.kept + counts.illegal + counts.unpredictable;
  fmt::print(
      "{} nodes drawn: {} kept, {:.1f} % illegal, {:.1f} % without a result; {} graphs fused\n",
      drawn, counts.kept, 100.0 * static_cast<double>(counts.illegal) / static_cast<double>(drawn),
      100.0 * static_cast<double>(counts.unpredictable) / static_cast<double>(drawn), fused);
  fmt::print("{} runs by tiles, {} of them of a part\n", changed_runs, changed_parts);
  fmt::print("{} graphs with kernels of a start\n", started);
  if (!arguments.real && arguments.count >= 500 && started == 0) {
    fmt::print("FAILED: no graph has kernels of a start\n");
    ++failures;
  }
  for (const auto& [name, count] : kernels) fmt::print("{} dispatches of {}\n", count, name);
  if (arguments.real)
    fmt::print("{} elements bounded, {:.1f} % by nothing\n", elements,
               100.0 * static_cast<double>(anything) / static_cast<double>(elements));
  if (arguments.real && anything * 4 > elements) {
    fmt::print("FAILED: the bounds say too little\n");
    ++failures;
  }
  for (const Op op : random_graph_ops(arguments.real)) {
    fmt::print("{} {}\n", counts.ops[op], op_info(op).name);
    if (arguments.count >= 500 && counts.ops[op] == 0) {
      fmt::print("FAILED: no graph has this operator\n");
      ++failures;
    }
  }
  fmt::print("{} failures\n", failures);
  return failures == 0 ? 0 : 1;
}

}  // namespace
}  // namespace shale

int main(int count, char** values) {
  shale::Arguments arguments;
  CLI::App app("Differential test over random graphs");
  app.add_option("--seed", arguments.seed,
                 "seed of the first graph; the next one has the next number")
      ->envname("SHALE_RANDOM_SEED");
  app.add_option("--count", arguments.count, "number of graphs")->envname("SHALE_RANDOM_COUNT");
  app.add_option("--validated", arguments.validated,
                 "how many of them run under the validation layer");
  app.add_flag("--real", arguments.real, "graphs of floats");
  CLI11_PARSE(app, count, values);
  return shale::run(arguments);
}
