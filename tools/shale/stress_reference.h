// tools/shale/stress_reference.h -- beside a sandwich on a device, frame by frame, what it would be with less rounding.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "tools/reference/nss_v1.h"
#include "tools/shale/player.h"

namespace shale {

/// The frame with 32-bit floats in place of half floats in all images that passes write. Tiles never rest there: what is held at
/// rest is a half float.
/// Errors: kUnsupported if no pass writes half floats, so that it would be the same frame.
Result<Frame> wide_frame(Frame frame);

/// Player::play(); of a sandwich that generates, with the first of two pictures for each frame below it: at a third of the
/// way between the frames, or beyond them, where both do not count alike.
Result<FloatImage> play_all(Player& player, const SourceFrame& frame);

class StressReference {
 public:
  /// The passes of NSS v1 in double precision, beside a player of this sandwich.
  /// Errors: kUnsupported, saying why there is none: other passes, settled tiles, or a size at which the model takes long.
  static Result<StressReference> create(const Sandwich& sandwich, const Player& player,
                                        bool has_tolerance, nss_v1::Rounding rounding);
  /// The sandwich of a wide_frame() on the same device, with a network that sees its own past.
  explicit StressReference(std::unique_ptr<Player> wide) : wide_(std::move(wide)) {}

  /// The next frame starts without a past. Frames with a cut do so themselves.
  void reset();

  /// What the player's last frame would show, linear. Of the model in double precision: the network by the exact interpreter
  /// from the model's codes; or, with `of_device`, as the device had it, which is the same for the same codes, and cheap.
  /// Errors: those of the interpreter, of Player::read_tensor and Player::play.
  Result<FloatImage> play(const SourceFrame& frame, const Player& player, bool of_device);

 private:
  struct Model {
    Graph graph;
    nss_v1::Model passes;
  };
  explicit StressReference(Model model) : model_(std::move(model)) {}

  std::optional<Model> model_;
  std::unique_ptr<Player> wide_;  ///< if there is no model
};

}  // namespace shale
