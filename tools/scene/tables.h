// tools/scene/tables.h -- what the shader reads for one frame: a block of constants, primitives and
// materials as texels, and for every tile of the picture and every cell of the shadow grid the list
// of primitives that can matter there. Pure functions, no device.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "tools/scene/frame_source.h"
#include "tools/scene/pose.h"
#include "tools/scene/scene.h"

namespace shale {

/// A part of a picture that is rendered, in output pixels.
struct Window {
  Extent full;            ///< of the whole picture
  uint32_t x = 0, y = 0;  ///< left top corner of the part
  Extent size;
  bool operator==(const Window&) const = default;
};

using Float4 = std::array<float, 4>;
using Int4 = std::array<int32_t, 4>;
using Uint2 = std::array<uint32_t, 2>;

/// The uniform block of shaders/scene/trace.comp, std140. Positions are relative to the eye.
struct FrameBlock {
  Float4 corner;  ///< direction at the left top corner of the whole picture, view z is 1
  Float4 step_x;  ///< change of direction per output pixel
  Float4 step_y;
  Float4 depth;       ///< nearest and farthest view z, a and b of depth = a + b / z
  Float4 size;        ///< whole picture in output pixels, and 1 / those
  Float4 window;      ///< left top corner in output pixels, scale of motion
  Float4 sky_was[3];  ///< direction to x, y, w of the previous frame's clip space
  Float4 sun;         ///< direction; cosine of the disc's radius
  Float4 sun_color;   ///< brightness of the disc in w
  Float4 zenith;      ///< w: clouds
  Float4 horizon;     ///< w: fog
  Float4 ground;      ///< w: stars
  Float4 ambient;     ///< w: exposure
  Float4 grid_u;      ///< position to column of the shadow grid; offset in w
  Float4 grid_v;
  /// Position, 1 / range^2; colour; direction, cosine of the outer cone; half sides of a rectangle,
  /// with 1 / the difference of the cones' cosines.
  Float4 lights[5 * kMaxLights];
  Float4 harmonics[9];  ///< what a white surface reflects, by powers of its normal
  Float4 overlays
      [4 *
       kMaxOverlays];  ///< rectangle in uv; colour, rows; background, opacity; scroll, aspect, seed
  Int4 grid;           ///< columns, rows, first texel of the table
  Int4 tiles;  ///< columns, rows, first texel of the table, log2 of the side in output pixels
  Int4 bases;  ///< first texel of materials, particles and tree; 1 if the view stands still
};

static_assert(sizeof(FrameBlock) % sizeof(Float4) == 0);

struct FrameTables {
  FrameBlock block;
  std::vector<Float4> texels;
  std::vector<Uint2> lists;
};

/// Texels of a primitive and of a material, as the shader has them.
inline constexpr uint32_t kPrimitiveTexels = 9;
inline constexpr uint32_t kMaterialTexels = 6;

/// A frame and the one it came from.
struct FramePoses {
  double frame = 0;
  CameraPose camera, camera_was;
  std::vector<Affine> nodes, nodes_was;
};

/// With `continued` false the frame before, which is `step` earlier, is taken to be the same as this
/// one.
FramePoses frame_poses(const Scene& scene, double frame, bool continued, double step = 1);

/// Errors: kUnsupported if the lists take more than `max_texels` even with the largest tiles.
Result<FrameTables> frame_tables(const Scene& scene, const FramePoses& poses, const Window& window,
                                 bool reverse_depth, uint32_t max_texels);

struct Point2 {
  double x = 0, y = 0;
};

/// Calls `emit` once for every cell (column, row) of a grid of unit cells that the convex hull of
/// `points` touches, or comes closer to than `margin`. Cells may be added, none is missed.
void cover_cells(std::span<const Point2> points, double margin, int32_t columns, int32_t rows,
                 const std::function<void(int32_t, int32_t)>& emit);

/// The same projection that the shader uses, and its inverse.
struct Projection {
  double tan_x = 1, tan_y = 1;  ///< of half the field of view
  double a = 1, b = 0;          ///< depth = a + b / view z
};
Projection projection_of(const SceneCamera& camera, Extent full, bool reverse_depth);

}  // namespace shale
