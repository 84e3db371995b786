#include "tools/shale/stress_reference.h"

#include <algorithm>

#include "ir/reference/interpreter.h"

namespace shale {
namespace {

/// Render pixels, up to which the model and the interpreter keep up.
constexpr uint32_t kMostPixels = 32 * 18;

/// "temporal" and "kernel" of a network's outputs, which come in the order of `names`.
Result<std::pair<Tensor, Tensor>> outputs_of(const std::vector<const Resource*>& resources,
                                             std::vector<Tensor> tensors) {
  const auto take = [&](std::string_view name) {
    const auto found = std::ranges::find(resources, name, &Resource::name);
    return std::move(tensors[static_cast<size_t>(found - resources.begin())]);
  };
  return std::pair{take("temporal"), take("kernel")};
}

}  // namespace

Result<Frame> wide_frame(Frame frame) {
  frame.settles.reset();
  bool changed = false;
  for (FrameImage& image : frame.images) {
    if (image.category == Category::kImageInput) continue;
    const ImageFormat narrow = image.format;
    if (narrow == ImageFormat::kRgba16Float) image.format = ImageFormat::kRgba32Float;
    if (narrow == ImageFormat::kR16Float) image.format = ImageFormat::kR32Float;
    changed |= image.format != narrow;
  }
  if (!changed)
    return unsupported("", "no reference: no image that passes write has half floats to widen");
  for (FrameProgram& program : frame.programs)
    for (FramePass& pass : program.passes) {
      if (!pass.shader.empty()) pass.defines.emplace_back("SHALE_WIDE", "1");
      pass.bounds.clear();  // of what half floats hold
    }
  return frame;
}

Result<FloatImage> play_all(Player& player, const SourceFrame& frame) {
  SHALE_TRY(FloatImage picture, player.play(frame));
  const std::optional<Generator>& generator = player.variant().generator;
  if (!generator) return picture;
  SHALE_TRY(const FloatImage generated, player.generate(generated_time(*generator, 1, 2)));
  picture.values.insert(picture.values.end(), generated.values.begin(), generated.values.end());
  picture.height += generated.height;
  return picture;
}

Result<StressReference> StressReference::create(const Sandwich& sandwich, const Player& player,
                                                bool has_tolerance, nss_v1::Rounding rounding) {
  if (!sandwich.frame)
    return unsupported("", "no reference: a package does not say what its passes are");
  SHALE_TRY(const nss_v1::Form form, nss_v1::form_of(*sandwich.frame, player.variant()));
  if (sandwich.graphs.size() != 1)
    return unsupported("", "no reference: this sandwich has {} networks, expected 1",
                       sandwich.graphs.size());
  if (has_tolerance)
    return unsupported("", "no reference: settled tiles hold what the passes would change");
  if (form.render.width * form.render.height > kMostPixels)
    return unsupported(
        "", "no reference beyond {} render pixels, such as --render 32x18: it takes long",
        kMostPixels);
  return StressReference(Model{sandwich.graphs[0], nss_v1::Model(form, rounding)});
}

void StressReference::reset() {
  if (wide_)
    wide_->reset();
  else
    model_->passes.reset();
}

Result<FloatImage> StressReference::play(const SourceFrame& frame, const Player& player,
                                         bool of_device) {
  if (wide_) return play_all(*wide_, frame);
  const std::vector<const Resource*> resources = tensors_of(player.variant(), Category::kOutput);
  return model_->passes.play(frame, [&](const Tensor& input) -> Result<std::pair<Tensor, Tensor>> {
    std::vector<Tensor> outputs;
    if (!of_device) {
      SHALE_TRY(outputs, interpret(model_->graph, std::vector{input}));
    } else {
      for (const Resource* resource : resources) {
        SHALE_TRY(Tensor tensor, player.read_tensor(resource->name));
        outputs.push_back(std::move(tensor));
      }
    }
    return outputs_of(resources, std::move(outputs));
  });
}

}  // namespace shale
