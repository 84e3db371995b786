// compiler/plan/frame.h -- frame.json: the passes around a network, and the images between them.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "compiler/plan/needs.h"
#include "ir/base/sampling_pattern.h"
#include "ir/package/package.h"

namespace shale {

struct FrameExtent {
  uint32_t width = 0, height = 0;
  bool operator==(const FrameExtent&) const = default;
};

/// A size that follows from the render or the output size: divided by `divide` (rounded up), then
/// rounded up to a multiple.
struct FrameSize {
  bool of_output = false;
  std::array<uint32_t, 2> divide{1, 1};  ///< width, height
  uint32_t multiple = 1;

  FrameExtent operator()(FrameExtent render, FrameExtent output) const;
};

struct FrameImage {
  std::string name;
  Category category = Category::kImageInternal;
  ImageFormat format = ImageFormat::kNone;
  FrameSize size;
  uint32_t history_depth = 0;  ///< 2 or more for history images
  std::string shows;           ///< of an output: the image whose texels of this frame it gets
};

struct FrameTensor {
  std::string name;
  Quantization quantization;
  std::optional<FrameSize> size;  ///< of a graph input whose height and width follow the frame's
  uint32_t history_depth = 0;     ///< 2 or more where results of earlier frames are kept
};

/// What a pass reads, writes or updates, by the name that its accessors have: fetch_NAME, store_NAME.
struct FrameBinding {
  std::string name;    ///< of an image or a tensor
  std::string handle;  ///< in the shader; the name itself where nothing else is said
  bool reads = false, writes = false;  ///< both: updated, by atomic maxima
  uint32_t frames_back = 0;
};

/// A part of what values lie in: a range, or that of something the pass reads, of one channel or of all.
struct BoundPart {
  double low = 0, high = 0;
  std::string of;  ///< if it is not empty
  std::optional<uint32_t> channel;
};
/// What a pass promises of something that it writes, whatever it reads: the hull of the parts, once for all channels or for
/// each. In real values, of tensors before they are quantized.
struct BoundContract {
  std::string name;
  std::vector<std::vector<BoundPart>> channels;
};

/// How a pass of shaders is where a promise of the frame is kept.
struct PassForm {
  std::string promise;
  bool is_left_out = false;
  std::vector<std::pair<std::string, std::string>> defines;  ///< behind the pass's own
  std::vector<FrameBinding> bindings;  ///< all of them, in place of the pass's
};

/// One pass of shaders, or a network's place.
struct FramePass {
  std::string name;
  std::string graph;  ///< model file, relative to frame.json; empty for a pass of shaders
  std::map<std::string, std::string>
      tensors;         ///< of a graph: names in the frame of its inputs and outputs
  std::string shader;  ///< path, relative to frame.json
  std::string over;    ///< image or tensor whose pixels are the invocations; empty with `over_size`
  std::optional<FrameSize> over_size;
  uint32_t workgroup[2] = {8, 8};
  std::vector<std::pair<std::string, std::string>> defines;  ///< name and value for the shader
  std::vector<std::string> clears;  ///< images that are filled with zeros before it
  std::vector<FrameBinding> bindings;
  std::vector<PassForm> forms;  ///< at most one a promise
  std::vector<BoundContract> bounds;
};

/// Something that a scene may rule out, on which passes have other forms.
struct FramePromise {
  std::string name;
  std::optional<double> motion_pixels;  ///< no motion is longer, render pixels
  std::optional<bool> finite;
  FramePass check;  ///< finds out whether a frame keeps it: it raises the image kBrokenImage
};
/// r32_uint, 1x1, in frames with a promise that is kept: a check stores a number above 0 where it is broken.
inline constexpr const char* kBrokenImage = "broken";
/// Behind the checks: the grids of passes that have another form, of which either is empty.
inline constexpr const char* kGridsImage = "grids";

/// How tiles of a frame may be left as they are.
struct FrameSettles {
  std::string image;  ///< a history rgba16_float: where it comes to rest
  std::string
      exposure;  ///< a parameter of the host, one float: a factor on its colours; may be empty
};

/// What is recorded at once.
struct FrameProgram {
  std::string name;
  std::vector<FramePass> passes;
  std::vector<float> at;  ///< with Frame::chosen_by: the values that choose it
  /// Of the program that makes pictures between or beyond rendered frames: Generator's times.
  std::optional<std::array<float, 2>> generates;
};

/// As View, with the resource by name.
struct FrameView {
  std::string name;
  View view;
};

struct Frame {
  FrameExtent render, output;               ///< where nobody asks for others
  SamplingPattern pattern;                  ///< that the rendered frames should have
  double min_ratio = 1.0, max_ratio = 1.0;  ///< of output to render size
  std::vector<Param> params;                ///< with their offsets
  std::vector<FrameView> views;
  std::vector<FrameImage> images;
  std::vector<FrameTensor> tensors;
  std::vector<FramePromise> promises;
  std::optional<FrameSettles> settles;
  std::vector<FrameProgram> programs;  ///< at least one
  std::string chosen_by;               ///< the parameter that chooses among the programs, or empty
};

/// The model files of a frame's graphs, each once, in the order of the passes.
std::vector<std::string> graph_files(const Frame& frame);

/// Reads untrusted JSON of schema "shale-frame/2"; the form is in compiler/driver/README.md.
/// Errors: kBadInput naming the field.
Result<Frame> parse_frame(const std::string& json);

/// The promises of the frame that a scene with these needs keeps at this render size.
std::vector<const FramePromise*> kept_promises(const Frame& frame, const SceneNeeds& needs,
                                               FrameExtent render);
/// Its conditions, for people: "motion_pixels at most 0.03".
std::string promise_text(const FramePromise& promise);

/// Takes the frame's own sizes for what is not given; an output size that is not given follows from
/// the render size by the frame's own ratio.
struct FrameSizes {
  std::optional<FrameExtent> render, output;
};

/// The render and the output size.
/// Errors: kBadInput if a side is outside 1 to 16384, or the ratio of output to render size is one
/// that the frame does not offer.
Result<std::pair<FrameExtent, FrameExtent>> frame_sizes(const Frame& frame,
                                                        const FrameSizes& wanted);

/// Text of a shader by its path in frame.json.
using ShaderLoader = std::function<Result<std::string>(const std::string& path)>;

}  // namespace shale
