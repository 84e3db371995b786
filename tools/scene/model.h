// tools/scene/model.h -- models that a scene names: where they come from, and what rays need of them.
#pragma once

#include <string>

#include "tools/scene/bvh.h"
#include "tools/scene/json_fields.h"
#include "tools/scene/mesh.h"

namespace shale {

/// A model in metres, y up, with a tree over its triangles, which lie in the tree's order.
struct SceneModel {
  std::string name;
  MeshModel mesh;
  Bvh tree;
};

/// Triangles of a leaf.
inline constexpr uint32_t kLeafTriangles = 4;

/// `fields` as the scene format says for an entry of "models"; files lie relative to `folder`.
/// Errors: kBadInput; kIo if a package is missing, with the command that installs it.
Result<SceneModel> load_model(const std::string& name, const Fields& fields,
                              const std::string& folder);

/// What the shader reads of all models of a scene: words by four.
struct ModelBuffers {
  std::vector<uint32_t>
      geometry;                  ///< nodes (2 x 4 words), then triangles (5 x 4), materials (2 x 4)
  std::vector<uint32_t> texels;  ///< of each texture: where its levels start, then RGBA8 of each
  uint32_t first_triangle = 0, first_material = 0;  ///< in units of 4 words
};
/// Errors: kUnsupported if a model has more than 2^24 of anything.
Result<ModelBuffers> model_buffers(const std::vector<SceneModel>& models);

/// First node, triangle and material of each model in those buffers.
struct ModelPart {
  uint32_t node = 0, triangle = 0, material = 0;
};
std::vector<ModelPart> model_parts(const std::vector<SceneModel>& models);

/// All levels down to 1x1, each texel the mean of the 2x2 above it (3 along an odd side's end), in
/// linear light; RGB as roots, which halves of a byte's steps in the dark, alpha as it is.
std::vector<std::vector<uint32_t>> mip_levels(const MeshTexture& texture);

}  // namespace shale
