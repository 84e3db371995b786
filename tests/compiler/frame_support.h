// tests/compiler/frame_support.h -- a small frame with every kind of field, and its shaders.
#pragma once

#include <map>
#include <string>

#include "compiler/driver/compile.h"
#include "tests/compiler/graph_support.h"

namespace shale {

inline constexpr const char* kFrame = R"({
  "schema": "shale-frame/2",
  "render": [10, 6],
  "output": [20, 12],
  "ratio": [1.5, 3],
  "params": [
    {"name": "near", "type": "float", "default": [0.5]},
    {"name": "jitter", "type": "vec2"},
    {"name": "fresh", "type": "int", "reset": true}
  ],
  "images": [
    {"name": "color", "role": "input", "format": "rgba8_unorm", "size": "render"},
    {"name": "shown", "role": "output", "format": "rgba16_float", "size": "output", "shows": "kept"},
    {"name": "kept", "role": "history", "format": "rgba16_float", "size": "output", "depth": 3},
    {"name": "marks", "role": "internal", "format": "r32_uint", "size": {"of": "render", "divide": 4, "multiple": 8}}
  ],
  "tensors": [{"name": "x", "scale": 0.5, "zero_point": -3, "size": "render"}],
  "views": [{"title": "input", "of": "x", "first": 1, "channels": 3}],
  "passes": [
    {"name": "pre", "shader": "pre.comp", "over": "color", "workgroup": [8, 4], "defines": {"SIDE": 2, "LEAST": 0.25},
      "clears": ["marks"], "reads": ["color", {"of": "kept", "frames_back": 2, "as": "old"}], "writes": ["x"], "updates": ["marks"]},
    {"graph": "main"},
    {"name": "post", "shader": "post.comp", "over": "shown",
      "reads": ["y", "marks"], "writes": ["kept"]}
  ]
})";

inline constexpr const char* kNetwork =
    "graph main {\n input %x : i8[1,6,10,4]\n %y = bitwise_not %x : i8[1,6,10,4]\n return %y\n}";

/// The shaders of kFrame, which use every accessor that they name for something.
inline std::map<std::string, std::string> frame_shaders() {
  return {{"pre.comp", R"(#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
SHALE_PARAMS;
void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= X_WIDTH || at.y >= X_HEIGHT) return;
  const float scale = float(X_SCALE) * float(X_ZERO_POINT + X_CHANNELS + COLOR_WIDTH + SIDE) * LEAST * params.near;
  const vec3 past = rgb_of(sample_old(vec2(at) / vec2(COLOR_WIDTH, COLOR_HEIGHT)));
  store_word_x(at.y * X_WIDTH + at.x, uint(fetch_color(at).r * scale + past.r) + uint(params.fresh));
  max_marks(ivec2(0), uint(at.x));
})"},
          {"post.comp", R"(#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= SHOWN_WIDTH || at.y >= SHOWN_HEIGHT) return;
  store_kept(at, half4(vec3(codes_y(0).xyz) + float(fetch_marks(ivec2(0)))));
})"}};
}

/// Options for kFrame with changes; shaders as given.
inline CompileOptions frame_options(const std::string& json,
                                    std::map<std::string, std::string> shaders = frame_shaders()) {
  CompileOptions options;
  options.optimize_spirv = false;
  options.frame = must(parse_frame(json), json);
  options.load_shader = [shaders =
                             std::move(shaders)](const std::string& path) -> Result<std::string> {
    const auto found = shaders.find(path);
    if (found == shaders.end()) return io_error(path, "cannot be read");
    return found->second;
  };
  return options;
}

inline Result<Compiled> compile_frame(const CompileOptions& options,
                                      const std::string& network = kNetwork) {
  return compile({reinterpret_cast<const uint8_t*>(network.data()), network.size()}, options);
}

}  // namespace shale
