#include "compiler/plan/run_pass.h"

#include <algorithm>

namespace shale {
namespace {

constexpr const char* kChoicePass = "choose_passes";
constexpr uint32_t kWordsOfRow = 4096;  // of images of words

/// Pixels of what the pass goes over.
Result<FrameExtent> grid_of(const Variant& variant, const FramePass& pass,
                            const LoweringOptions& options) {
  if (pass.over_size) return (*pass.over_size)(options.render, options.output);
  for (const Resource& resource : variant.resources) {
    if (resource.name != pass.over) continue;
    if (is_image(resource.category)) return FrameExtent{resource.width, resource.height};
    if (resource.shape.size() == 4 && resource.shape[1] <= kMaxImageExtent &&
        resource.shape[2] <= kMaxImageExtent)
      return FrameExtent{static_cast<uint32_t>(resource.shape[2]),
                         static_cast<uint32_t>(resource.shape[1])};
  }
  return bad_input(pass_label(pass), "there is no image, graph input or output \"{}\" to go over",
                   pass.over);
}

}  // namespace

std::string pass_label(const FramePass& pass) { return "pass \"" + pass.name + "\""; }

Result<uint32_t> find_resource(const Variant& variant, const std::string& name,
                               const std::string& where) {
  for (uint32_t i = 0; i < variant.resources.size(); ++i) {
    const Resource& resource = variant.resources[i];
    if (resource.name == name && resource.category != Category::kWeights &&
        resource.category != Category::kIntermediate)
      return i;
  }
  return bad_input(where, "there is no image, graph input or output \"{}\"", name);
}

std::vector<RunPass> run_passes(const FrameProgram& program,
                                std::span<const FramePromise* const> kept) {
  std::vector<RunPass> passes;
  bool has_forms = false;
  for (const FramePass& pass : program.passes) {
    RunPass special{pass, Runs::kKept};
    bool is_left_out = false, has_form = false;
    for (const FramePromise* promise : kept)
      for (const PassForm& form : pass.forms) {
        if (form.promise != promise->name) continue;
        has_form = true;
        is_left_out = is_left_out || form.is_left_out;
        special.pass.name += "_" + promise->name;
        special.pass.bindings = form.bindings;
        for (const auto& define : form.defines) {
          std::erase_if(special.pass.defines,
                        [&](const auto& other) { return other.first == define.first; });
          special.pass.defines.push_back(define);
        }
      }
    passes.push_back(
        {pass, has_form ? Runs::kBroken : Runs::kInAllFrames, !has_form || is_left_out});
    has_forms = has_forms || has_form;
    if (!has_form || is_left_out) continue;
    special.pass.clears.clear();  // what the full form cleared
    passes.push_back(std::move(special));
  }
  if (!has_forms) return passes;
  std::vector<RunPass> checked;
  for (const FramePromise* promise : kept) checked.push_back({promise->check});
  checked.front().pass.clears.push_back(kBrokenImage);
  FramePass choice;
  choice.name = kChoicePass;
  choice.workgroup[0] = choice.workgroup[1] = 1;
  choice.bindings = {{kBrokenImage, kBrokenImage, true, false, 0},
                     {kGridsImage, kGridsImage, false, true, 0}};
  checked.push_back({std::move(choice)});
  checked.insert(checked.end(), std::make_move_iterator(passes.begin()),
                 std::make_move_iterator(passes.end()));
  return checked;
}

Result<std::array<uint32_t, 3>> workgroups_of(const Variant& variant, const FramePass& pass,
                                              const LoweringOptions& options) {
  SHALE_TRY(const FrameExtent grid, grid_of(variant, pass, options));
  return std::array{(grid.width + pass.workgroup[0] - 1) / pass.workgroup[0],
                    (grid.height + pass.workgroup[1] - 1) / pass.workgroup[1], 1u};
}

Result<std::string> choice_shader(const Variant& variant, std::span<const RunPass> passes,
                                  const LoweringOptions& options) {
  std::string stores;
  size_t word = 0;
  for (const RunPass& each : passes) {
    if (each.runs == Runs::kInAllFrames) continue;
    SHALE_TRY(const auto workgroups, workgroups_of(variant, each.pass, options));
    for (const uint32_t count : workgroups)
      stores += fmt::format("  store_{}(ivec2({}, 0), {}kept ? {}u : 0u);\n", kGridsImage, word++,
                            each.runs == Runs::kKept ? "" : "!", count);
  }
  return fmt::format(R"(#version 450
#include "access.glsl"
layout(local_size_x = 1) in;
void main() {{
  const bool kept = fetch_{}(ivec2(0)) == 0u;
{}}}
)",
                     kBrokenImage, stores);
}

Resource words_image(std::string name, Category category, uint64_t words) {
  Resource image;
  image.name = std::move(name);
  image.category = category;
  image.format = ImageFormat::kR32Uint;
  image.history_depth = category == Category::kImageHistory ? 1 : 0;
  image.width = static_cast<uint32_t>(std::min<uint64_t>(words, kWordsOfRow));
  image.height = static_cast<uint32_t>((words + image.width - 1) / image.width);
  image.size_bytes = uint64_t{linear_pitch(image.format, image.width)} * image.height * 4;
  return image;
}

}  // namespace shale
