// tools/scene/mesh.h -- triangles with textures, as files hold them: OBJ with MTL, levels of
// OpenArena (IBSP 46), glTF 2.0.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "tools/scene/archive.h"

namespace shale {

/// Bounds of a model; a file with more is refused.
inline constexpr size_t kMaxTriangles = 1u << 22;
inline constexpr uint32_t kMaxTextureSide = 4096;

using Float2 = std::array<float, 2>;
using Float3 = std::array<float, 3>;

struct MeshTexture {
  std::string name;
  uint32_t width = 0, height = 0;
  std::vector<uint8_t> pixels;  ///< RGBA, sRGB, from the top
};

struct MeshMaterial {
  std::string name;
  Float3 color{0.8f, 0.8f, 0.8f};  ///< linear; times the texture
  Float3 emission{};               ///< linear
  int texture = -1;
  bool cut_out = false;  ///< where the texture's alpha is below a half
  float specular = 0, shininess = 32;
};

struct MeshTriangle {
  std::array<Float3, 3> at{};
  std::array<Float3, 3> normal{};  ///< all 0: that of the plane
  std::array<Float2, 3> uv{};      ///< v runs downwards, as rows of the texture do
  uint32_t material = 0;
};

struct MeshModel {
  std::string name;
  std::vector<MeshTriangle> triangles;
  std::vector<MeshMaterial> materials;
  std::vector<MeshTexture> textures;
};

/// Polygons become fans; corners without a normal get the mean of the faces around that bend by less
/// than 45 degrees. Materials with an opacity below 0.3 are left out, the rest is opaque; alpha of
/// textures cuts out.
/// Errors: kIo, kBadInput naming file and line.
Result<MeshModel> load_obj(const Archive& archive, const std::string& name);

/// A level without its light maps. Patches are cut into 6 x 6 quads a piece; sky, what is never
/// drawn and billboards are left out. A texture that is in no archive is a plain grey, as games
/// have shaders there. Metres, y up.
/// Errors: kIo, kBadInput naming file and offset. Source: the format as the OpenArena tools write it.
Result<MeshModel> load_level(const std::vector<const Archive*>& archives, const std::string& name);

/// The nodes of the file's scene in their places at rest. `name` ends with .gltf or .glb.
/// Errors: kIo, kBadInput.
Result<MeshModel> load_gltf(const Archive& archive, const std::string& name);

/// JPEG, PNG or TGA.
/// Errors: kBadInput.
Result<MeshTexture> decode_texture(const std::vector<uint8_t>& bytes, const std::string& where);

}  // namespace shale
