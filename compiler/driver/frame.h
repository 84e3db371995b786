// compiler/driver/frame.h -- frame.json: the passes around a network, and the images between them.
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "ir/graph/graph.h"
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
  bool is_linear = false;      ///< its texels lie in a buffer
  uint32_t history_depth = 0;  ///< 2 or more for history images
};

struct FrameTensor {
  std::string name;
  Quantization quantization;
  std::optional<FrameSize> size;  ///< of a graph input whose height and width follow the frame's
};

struct FrameBinding {
  uint32_t binding = 0;
  std::string name;  ///< of an image or a tensor
  bool is_image = false;
  bool reads = false, writes = false;
  bool loads = false;  ///< read as a storage image: on CPU drivers half the cost of texelFetch
  uint32_t frames_back = 0;
  ImageFormat texels = ImageFormat::kNone;  ///< a buffer read as a texel buffer of this format
};

/// One pass; `is_graph` stands for the network's place. A transfer has a kernel of transfers, its
/// ends as bindings, and neither shader nor grid.
struct FramePass {
  std::string name;
  bool is_graph = false;
  std::string_view transfer;
  std::string shader;  ///< path, relative to frame.json
  std::string over;    ///< image or tensor whose pixels are the invocations; empty with `over_size`
  std::optional<FrameSize> over_size;
  uint32_t workgroup[2] = {8, 8};
  std::vector<std::pair<std::string, std::string>> defines;  ///< name and value for the shader
  std::vector<FrameBinding> bindings;
};

/// As View, with the resource by name.
struct FrameView {
  std::string name;
  View view;
};

struct Frame {
  FrameExtent render, output;               ///< where nobody asks for others
  double min_ratio = 1.0, max_ratio = 1.0;  ///< of output to render size
  std::vector<Param> params;                ///< with their offsets
  std::vector<FrameView> views;
  std::vector<FrameImage> images;
  std::vector<FrameTensor> tensors;
  std::vector<FramePass> passes;
};

/// Reads untrusted JSON of schema "shale-frame/1"; the form is in compiler/driver/README.md.
/// Errors: kBadInput naming the field.
Result<Frame> parse_frame(const std::string& json);

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

/// Bytes that the passes of a frame read and write at these sizes: images and tensors, each binding
/// once and whole. `graph` has the tensors' shapes; null if there is no network.
double pass_bytes(const Frame& frame, FrameExtent render, FrameExtent output, const Graph* graph);

/// Text of a shader by its path in frame.json.
using ShaderLoader = std::function<Result<std::string>(const std::string& path)>;

}  // namespace shale
