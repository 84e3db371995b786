#include "tools/shale/choices.h"

#include <algorithm>
#include <charconv>
#include <limits>
#include <sstream>

#include "ir/base/file.h"

namespace shale {
namespace {

constexpr int kMeasured = 8;  ///< frames that tell what a choice costs

double total_ms(const std::vector<DispatchTime>& times) {
  double us = 0;
  for (const DispatchTime& time : times) us += time.time_us;
  return us / 1000;
}

}  // namespace

void BudgetArguments::add_to(CLI::App& app, std::initializer_list<CLI::Option*> excluded) {
  CLI::Option* budget =
      app.add_option(
             "--budget", budget_ms,
             "milliseconds a frame may take: cheaper sandwiches step in where it does not hold")
          ->check(number_in(1e-3, 1e6));
  for (CLI::Option* option : excluded) budget->excludes(option);
  app.add_option("--or", others,
                 "a cheaper sandwich for --budget (again for more, the cheapest last)")
      ->needs(budget);
  app.add_option(
         "--load", load,
         "recorded load for --budget: a file with a factor on times for each frame, a line each")
      ->needs(budget);
  app.add_option("--shown-rate", shown_rate,
                 "frames a second, for the times of --budget (default 60)")
      ->check(number_in(1, 1000))
      ->needs(budget);
}

Result<Choices> Choices::create(const BudgetArguments& arguments, const ToolDevice& device,
                                const std::string& path, const Sandwich& first,
                                const CompileArguments& compile, Compile kernels) {
  Choices choices(arguments);
  SHALE_TRY_VOID(choices.add(device, path, first, kernels));
  const Player& best = *choices.players_[0];
  for (const std::string& own : arguments.others) {
    CompileArguments sized = compile;
    sized.ratio = 0;
    SHALE_TRY(const Sandwich other,
              load_sandwich(own, sized, best.render_size(), best.output_size()));
    SHALE_TRY_VOID(choices.add(device, own, other, kernels));
    const Player& player = *choices.players_.back();
    if (player.render_size() != best.render_size() || player.output_size() != best.output_size() ||
        player.is_display() != best.is_display())
      return bad_input(own, "takes or makes other pictures than {}", path);
  }
  if (!arguments.load.empty()) SHALE_TRY_VOID(choices.read_load());
  return choices;
}

Result<void> Choices::measure(const SourceFrame& frame) {
  if (arguments_.budget_ms == 0) return {};
  std::vector<double> costs;
  for (const std::unique_ptr<Player>& player : players_) {
    SHALE_TRY_VOID(player->warm_up(frame));
    // The least of several: other work on the machine only ever adds.
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i < kMeasured; ++i) {
      std::vector<DispatchTime> times;
      SHALE_TRY_VOID(player->play(frame, &times));
      least = std::min(least, total_ms(times));
    }
    player->reset();
    costs.push_back(least);
  }
  Result<FrameBudget> budget = FrameBudget::create(
      costs, {.budget_ms = arguments_.budget_ms, .frame_seconds = 1 / arguments_.shown_rate});
  if (!budget)
    return bad_input("--or", "{}; the times are those of the first frame, in the order given",
                     budget.error().text());
  budget_ = *std::move(budget);
  return {};
}

Player& Choices::next() {
  const size_t choice = budget_ ? budget_->choice() : 0;
  if (choice != now_) {
    players_[choice]->reset();
    ++switches_;
  }
  now_ = choice;
  return *players_[choice];
}

void Choices::add(const std::vector<DispatchTime>& times, Json& entry) {
  if (!budget_) return;
  const double load = load_.empty() ? 1 : load_[frames_ % load_.size()],
               ms = total_ms(times) * load;
  budget_->add(ms);
  within_ += ms <= arguments_.budget_ms ? 1 : 0;
  ++frames_;
  entry.update({{"model", paths_[now_]}, {"frame_ms", ms}, {"load", load}});
}

Json Choices::summary() const {
  return {
      {"budget_ms", arguments_.budget_ms},
      {"frames", frames_},
      {"within", static_cast<double>(within_) / static_cast<double>(std::max<size_t>(frames_, 1))},
      {"switches", switches_}};
}

Result<void> Choices::add(const ToolDevice& device, const std::string& path,
                          const Sandwich& sandwich, Compile kernels) {
  SHALE_TRY(players_.emplace_back(), Player::create(device, sandwich.package, kernels));
  paths_.push_back(path);
  return {};
}

Result<void> Choices::read_load() {
  SHALE_TRY(const std::string text, read_text(arguments_.load));
  std::istringstream lines(text);
  size_t number = 0;
  for (std::string line; std::getline(lines, line);) {
    ++number;
    double factor = 0;
    const auto [end, status] = std::from_chars(line.data(), line.data() + line.size(), factor);
    if (status != std::errc() || end != line.data() + line.size() ||
        !(factor > 0 && factor <= 1000))
      return bad_input(arguments_.load,
                       "line {} is \"{}\", expected a factor of more than 0, up to 1000", number,
                       one_line(line.substr(0, 40)));
    load_.push_back(factor);
  }
  if (load_.empty()) return bad_input(arguments_.load, "is empty, expected a factor a line");
  return {};
}

}  // namespace shale
