// tools/shale/stress_reference.h -- a model in double precision beside a sandwich on a device, frame by frame.
#pragma once

#include <string>

#include "tools/reference/nss_v1.h"
#include "tools/shale/player.h"

namespace shale {

class StressReference {
 public:
  /// Beside a player of this sandwich.
  /// Errors: kUnsupported, saying why there is none: other passes than the modelled ones, settled tiles, or a size at which the
  /// model takes long.
  static Result<StressReference> create(const Sandwich& sandwich, const Player& player,
                                        bool has_tolerance, nss_v1::Rounding rounding);

  /// The next frame starts without a past. Frames with a cut do so themselves.
  void reset() { model_.reset(); }

  /// What the player's last frame would show, linear: the passes by the model, the network by the exact interpreter from the
  /// model's codes; or, with `of_device`, as the device had it, which is the same for the same codes, and cheap.
  /// Errors: those of the interpreter and of Player::read_tensor.
  Result<FloatImage> play(const SourceFrame& frame, const Player& player, bool of_device);

 private:
  StressReference(Graph graph, const nss_v1::Form& form, nss_v1::Rounding rounding)
      : graph_(std::move(graph)), model_(form, rounding) {}

  Graph graph_;
  nss_v1::Model model_;
};

}  // namespace shale
