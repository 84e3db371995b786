// Levels of OpenArena: IBSP 46.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>

#include "tools/scene/mesh.h"

namespace shale {
namespace {

constexpr float kMetres = 0.03f;  ///< of a unit
constexpr uint32_t kSteps = 6;    ///< quads along a side of a patch's piece
constexpr uint32_t kSky = 0x4, kNeverDrawn = 0x80;
enum Lump : size_t { kTextures = 1, kVertices = 10, kMeshVertices = 11, kFaces = 13, kLumps = 17 };
constexpr uint32_t kTextureBytes = 72, kVertexBytes = 44, kFaceBytes = 104;
constexpr uint32_t kMaxControls = 1u << 14;  ///< of a patch

struct Corner {
  Float3 at{}, normal{};
  Float2 uv{};
};

class LevelReader {
 public:
  LevelReader(const std::vector<const Archive*>& archives, const std::string& name)
      : archives_(archives), name_(name) {}

  Result<MeshModel> read() {
    SHALE_TRY(const Archive* archive, holder(name_));
    where_ = archive->where(name_);
    SHALE_TRY(bytes_, archive->read(name_));
    if (bytes_.size() < 8 + 8 * kLumps || std::memcmp(bytes_.data(), "IBSP", 4) != 0 ||
        u32(4) != 46)
      return bad_input(where_, "is no level of IBSP version 46");
    SHALE_TRY_VOID(find(kTextures, kTextureBytes));
    SHALE_TRY_VOID(find(kVertices, kVertexBytes));
    SHALE_TRY_VOID(find(kMeshVertices, 4));
    SHALE_TRY_VOID(find(kFaces, kFaceBytes));
    model_.name = name_;
    SHALE_TRY_VOID(read_textures());
    for (uint32_t i = 0; i < count(kFaces, kFaceBytes); ++i) SHALE_TRY_VOID(read_face(i));
    return std::move(model_);
  }

 private:
  struct Range {
    uint32_t offset = 0, size = 0;
  };

  Result<const Archive*> holder(const std::string& name) const {
    for (const Archive* archive : archives_)
      if (archive->has(name)) return archive;
    return io_error(archives_.front()->where(name), "is not in the archive");
  }

  uint32_t u32(size_t at) const {
    uint32_t value = 0;
    std::memcpy(&value, &bytes_[at], 4);
    return value;
  }
  float f32(size_t at) const {
    float value = 0;
    std::memcpy(&value, &bytes_[at], 4);
    return value;
  }
  uint32_t count(Lump lump, uint32_t entry) const { return lumps_[lump].size / entry; }

  Result<void> find(Lump lump, uint32_t entry) {
    const size_t at = 8 + 8 * size_t{lump};
    const Range range{u32(at), u32(at + 4)};
    if (uint64_t{range.offset} + range.size > bytes_.size() || range.size % entry != 0)
      return bad_input(
          where_, "offset {}: lump {} is {} bytes at {}, expected entries of {} bytes within {}",
          at, static_cast<size_t>(lump), range.size, range.offset, entry, bytes_.size());
    lumps_[lump] = range;
    return {};
  }

  Result<void> read_textures() {
    for (uint32_t i = 0; i < count(kTextures, kTextureBytes); ++i) {
      const size_t at = lumps_[kTextures].offset + size_t{i} * kTextureBytes;
      const char* text = reinterpret_cast<const char*>(&bytes_[at]);
      const std::string name(text, strnlen(text, 64));
      MeshMaterial material;
      material.name = name;
      material.color = {0.35f, 0.35f, 0.35f};
      const bool hidden = (u32(at + 64) & (kSky | kNeverDrawn)) != 0 ||
                          name.find("/common/") != std::string::npos ||
                          name.find("/skies/") != std::string::npos;
      hidden_.push_back(hidden);
      for (const char* type : {".tga", ".jpg", ".png"}) {
        if (hidden) break;
        const auto found = holder(name + type);
        if (!found) continue;
        SHALE_TRY(const std::vector<uint8_t> bytes, (*found)->read(name + type));
        SHALE_TRY(MeshTexture texture, decode_texture(bytes, (*found)->where(name + type)));
        for (size_t k = 3; k < texture.pixels.size(); k += 4)
          material.cut_out = material.cut_out || texture.pixels[k] < 128;
        material.texture = static_cast<int>(model_.textures.size());
        material.color = {1, 1, 1};
        model_.textures.push_back(std::move(texture));
        break;
      }
      model_.materials.push_back(std::move(material));
    }
    return {};
  }

  Corner corner(uint32_t index) const {
    const size_t at = lumps_[kVertices].offset + size_t{index} * kVertexBytes;
    Corner c;
    // z up to y up.
    c.at = {f32(at) * kMetres, f32(at + 8) * kMetres, -f32(at + 4) * kMetres};
    c.uv = {f32(at + 12), f32(at + 16)};
    c.normal = {f32(at + 28), f32(at + 36), -f32(at + 32)};
    return c;
  }

  Result<void> read_face(uint32_t index) {
    const size_t at = lumps_[kFaces].offset + size_t{index} * kFaceBytes;
    const uint32_t texture = u32(at), type = u32(at + 8);
    const uint32_t first = u32(at + 12), vertices = u32(at + 16);
    const uint32_t mesh = u32(at + 20), indices = u32(at + 24);
    const uint32_t width = u32(at + 96), height = u32(at + 100);
    if (texture >= model_.materials.size())
      return bad_input(where_, "offset {}: face {} has texture {}, the level has {}", at, index,
                       texture, model_.materials.size());
    if (uint64_t{first} + vertices > count(kVertices, kVertexBytes))
      return bad_input(where_, "offset {}: face {} has vertices {} to {}, the level has {}", at,
                       index, first, uint64_t{first} + vertices, count(kVertices, kVertexBytes));
    if (hidden_[texture]) return {};
    if (type == 2) return read_patch(at, index, texture, first, vertices, width, height);
    if (type != 1 && type != 3) return {};
    if (uint64_t{mesh} + indices > count(kMeshVertices, 4))
      return bad_input(where_, "offset {}: face {} has corners {} to {}, the level has {}", at,
                       index, mesh, uint64_t{mesh} + indices, count(kMeshVertices, 4));
    for (uint32_t i = 0; i + 2 < indices; i += 3) {
      std::array<Corner, 3> corners;
      for (uint32_t k = 0; k < 3; ++k) {
        const uint32_t own = u32(lumps_[kMeshVertices].offset + 4 * (size_t{mesh} + i + k));
        if (own >= vertices)
          return bad_input(where_, "offset {}: face {} names vertex {}, it has {}", at, index, own,
                           vertices);
        corners[k] = corner(first + own);
      }
      SHALE_TRY_VOID(add(texture, corners, at));
    }
    return {};
  }

  Result<void> read_patch(size_t at, uint32_t index, uint32_t texture, uint32_t first,
                          uint32_t vertices, uint32_t width, uint32_t height) {
    if (width % 2 == 0 || height % 2 == 0 || width < 3 || height < 3 || width > kMaxControls ||
        height > kMaxControls || uint64_t{width} * height != vertices)
      return bad_input(where_, "offset {}: face {} is a patch of {}x{} with {} vertices", at, index,
                       width, height, vertices);
    for (uint32_t y = 0; y + 2 < height; y += 2)
      for (uint32_t x = 0; x + 2 < width; x += 2) {
        const auto place = [&](uint32_t column, uint32_t row) {
          const auto weights = [](uint32_t step) {
            const float s = static_cast<float>(step) / kSteps, r = 1 - s;
            return std::array<float, 3>{r * r, 2 * r * s, s * s};
          };
          const auto across = weights(column), down = weights(row);
          Corner sum;
          for (uint32_t j = 0; j < 3; ++j)
            for (uint32_t i = 0; i < 3; ++i) {
              const Corner c = corner(first + (y + j) * width + x + i);
              const float weight = across[i] * down[j];
              for (size_t a = 0; a < 3; ++a) {
                sum.at[a] += weight * c.at[a];
                sum.normal[a] += weight * c.normal[a];
              }
              for (size_t a = 0; a < 2; ++a) sum.uv[a] += weight * c.uv[a];
            }
          return sum;
        };
        for (uint32_t row = 0; row < kSteps; ++row)
          for (uint32_t column = 0; column < kSteps; ++column) {
            const Corner a = place(column, row), b = place(column + 1, row);
            const Corner c = place(column, row + 1), d = place(column + 1, row + 1);
            SHALE_TRY_VOID(add(texture, {a, b, c}, at));
            SHALE_TRY_VOID(add(texture, {b, d, c}, at));
          }
      }
    return {};
  }

  Result<void> add(uint32_t material, const std::array<Corner, 3>& corners, size_t at) {
    if (model_.triangles.size() >= kMaxTriangles)
      return bad_input(where_, "offset {}: more than {} triangles", at, kMaxTriangles);
    MeshTriangle triangle;
    for (size_t k = 0; k < 3; ++k) {
      for (const float value :
           {corners[k].at[0], corners[k].at[1], corners[k].at[2], corners[k].uv[0],
            corners[k].uv[1], corners[k].normal[0], corners[k].normal[1], corners[k].normal[2]})
        if (!std::isfinite(value) || std::abs(value) > 1e6f)
          return bad_input(where_, "offset {}: a face has a vertex with {}", at, value);
      triangle.at[k] = corners[k].at;
      triangle.normal[k] = corners[k].normal;
      triangle.uv[k] = corners[k].uv;
    }
    triangle.material = material;
    model_.triangles.push_back(triangle);
    return {};
  }

  const std::vector<const Archive*>& archives_;
  const std::string name_;
  std::string where_;
  std::vector<uint8_t> bytes_;
  std::array<Range, kLumps> lumps_{};
  std::vector<bool> hidden_;
  MeshModel model_;
};

}  // namespace

Result<MeshModel> load_level(const std::vector<const Archive*>& archives, const std::string& name) {
  return LevelReader(archives, name).read();
}

}  // namespace shale
