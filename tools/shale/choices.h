// tools/shale/choices.h -- several sandwiches to play, of which a budget of time chooses one for each frame.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "runtime/frame/budget.h"
#include "tools/shale/player.h"

namespace shale {

/// --budget, --or, --load and --shown-rate.
struct BudgetArguments {
  double budget_ms = 0;             ///< 0 is none
  std::vector<std::string> others;  ///< the cheapest last
  std::string load;        ///< file with a factor on the times of each frame, over and over
  double shown_rate = 60;  ///< frames a second

  /// What makes no sense together with a budget.
  void add_to(CLI::App& app, std::initializer_list<CLI::Option*> excluded);
};

/// Without a budget there is one sandwich, the first.
class Choices {
 public:
  /// Errors: as load_sandwich and Player::create; kBadInput for a sandwich of other sizes or colours, and for a load
  /// that cannot be understood.
  /// `kernels` is for Player::create.
  static Result<Choices> create(const BudgetArguments& arguments, const ToolDevice& device,
                                const std::string& path, const Sandwich& first,
                                const CompileArguments& compile, Compile kernels);

  /// What each costs, by a frame that leaves no trace.
  /// Errors: kBadInput if one costs more than the one before it; kDevice.
  Result<void> measure(const SourceFrame& frame);

  bool has_budget() const { return arguments_.budget_ms > 0; }
  /// Of the next frame. One that comes anew starts without a past.
  Player& next();
  /// The time of the frame that next() played; `entry` gains what is to be said of it.
  void add(const std::vector<DispatchTime>& times, Json& entry);
  Json summary() const;

 private:
  explicit Choices(const BudgetArguments& arguments) : arguments_(arguments) {}
  Result<void> add(const ToolDevice& device, const std::string& path, const Sandwich& sandwich,
                   Compile kernels);
  Result<void> read_load();

  BudgetArguments arguments_;
  std::vector<std::string> paths_;
  std::vector<std::unique_ptr<Player>> players_;
  std::optional<FrameBudget> budget_;
  std::vector<double> load_;
  size_t now_ = 0, frames_ = 0, within_ = 0, switches_ = 0;
};

}  // namespace shale
