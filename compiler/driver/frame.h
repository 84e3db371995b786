// compiler/driver/frame.h -- frame.json: the passes around a network, and the images between them.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "ir/package/package.h"

namespace shale {

struct FrameImage {
  std::string name;
  Category category = Category::kImageInternal;
  ImageFormat format = ImageFormat::kNone;
  double scale = 1.0;          ///< of the network input's height and width
  uint32_t history_depth = 0;  ///< 2 or more for history images
};

struct FrameTensor {
  std::string name;
  Quantization quantization;
};

struct FrameBinding {
  uint32_t binding = 0;
  std::string name;  ///< of an image or a tensor
  bool is_image = false;
  bool reads = false, writes = false;
  uint32_t frames_back = 0;
};

/// One pass; `is_graph` stands for the network's place.
struct FramePass {
  std::string name;
  bool is_graph = false;
  std::string shader;  ///< path, relative to frame.json
  std::string over;    ///< image whose pixels are the invocations
  uint32_t workgroup[2] = {8, 8};
  std::vector<FrameBinding> bindings;
};

struct Frame {
  std::vector<FrameImage> images;
  std::vector<FrameTensor> tensors;
  std::vector<FramePass> passes;
};

/// Reads untrusted JSON of schema "shale-frame/1"; the form is in compiler/driver/README.md.
/// Errors: kBadInput naming the field.
Result<Frame> parse_frame(const std::string& json);

/// Text of a shader by its path in frame.json.
using ShaderLoader = std::function<Result<std::string>(const std::string& path)>;

}  // namespace shale
