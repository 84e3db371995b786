#include "tools/scene/model.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>

namespace shale {
namespace {

namespace fs = std::filesystem;

constexpr const char* kFurniture = "sweethome3d-furniture";
constexpr const char* kLevels = "openarena-081-maps";
constexpr const char* kLevelTextures = "openarena-081-textures";

/// A zip file of a Debian package.
Result<std::unique_ptr<Archive>> packaged(const Fields& fields, const std::string& package,
                                          const std::string& path) {
  std::error_code none;
  if (!fs::exists(path, none)) {
    SHALE_TRY(const std::string version, fields.text("version"));
    return io_error(fields.where(), "needs the package {} ({}), which has {}: apt-get install {}",
                    package, version, path, package);
  }
  return open_zip(path);
}

/// What the catalogue of a furniture library says of a model.
struct CatalogueEntry {
  std::string file;
  double width = 0;  ///< centimetres
};

Result<CatalogueEntry> catalogue_entry(const Archive& library, const std::string& model,
                                       const std::string& where) {
  SHALE_TRY(const std::vector<uint8_t> bytes, library.read("PluginFurnitureCatalog.properties"));
  const std::string text(bytes.begin(), bytes.end());
  const auto value_of = [&](const std::string& key) -> std::string {
    const size_t at = text.find("\n" + key + "=");
    if (at == std::string::npos) return "";
    const size_t begin = at + key.size() + 2;
    std::string value = text.substr(begin, text.find('\n', begin) - begin);
    while (!value.empty() && (value.back() == '\r' || value.back() == ' ')) value.pop_back();
    return value;
  };
  const std::string ending = "/" + model + ".obj";
  for (int i = 1;; ++i) {
    const std::string file = value_of(fmt::format("model#{}", i));
    if (file.empty()) break;
    if (!file.ends_with(ending)) continue;
    CatalogueEntry entry;
    entry.file = file.substr(file.front() == '/' ? 1 : 0);
    entry.width = std::strtod(value_of(fmt::format("width#{}", i)).c_str(), nullptr);
    return entry;
  }
  return bad_input(where, "\"model\" is \"{}\", which {} has not", model, library.where(""));
}

Box box_of(const MeshTriangle& triangle) {
  Box box;
  for (const Float3& at : triangle.at) box.add({at, at});
  return box;
}

Box box_of(const MeshModel& mesh) {
  Box box;
  for (const MeshTriangle& triangle : mesh.triangles) box.add(box_of(triangle));
  return box;
}

uint32_t bits(float value) {
  uint32_t word = 0;
  std::memcpy(&word, &value, 4);
  return word;
}

/// A unit vector in two 16-bit numbers. Source: Meyer and others, On Floating-Point Normal Vectors,
/// 2010 (octahedral).
uint32_t packed_normal(const Float3& normal, const Float3& plane) {
  Float3 n = normal;
  float sum = std::abs(n[0]) + std::abs(n[1]) + std::abs(n[2]);
  if (!(sum > 0)) {
    n = plane;
    sum = std::abs(n[0]) + std::abs(n[1]) + std::abs(n[2]);
  }
  if (!(sum > 0)) return 0;
  float x = n[0] / sum, y = n[1] / sum;
  if (n[2] < 0) {
    const float fold_x = (1 - std::abs(y)) * (x < 0 ? -1.0f : 1.0f);
    y = (1 - std::abs(x)) * (y < 0 ? -1.0f : 1.0f);
    x = fold_x;
  }
  const auto half = [](float v) {
    return static_cast<uint32_t>(static_cast<uint16_t>(
        static_cast<int16_t>(std::lround(std::clamp(v, -1.0f, 1.0f) * 32767))));
  };
  return half(x) | half(y) << 16;
}

float linear_of(uint8_t srgb) {
  const float c = static_cast<float>(srgb) / 255;
  return c <= 0.04045f ? c / 12.92f : std::pow((c + 0.055f) / 1.055f, 2.4f);
}

}  // namespace

std::vector<std::vector<uint32_t>> mip_levels(const MeshTexture& texture) {
  std::array<float, 256> linear{};
  for (size_t i = 0; i < 256; ++i) linear[i] = linear_of(static_cast<uint8_t>(i));
  uint32_t width = texture.width, height = texture.height;
  std::vector<std::array<float, 4>> level(size_t{width} * height);
  for (size_t i = 0; i < level.size(); ++i) {
    const uint8_t* p = &texture.pixels[4 * i];
    level[i] = {linear[p[0]], linear[p[1]], linear[p[2]], static_cast<float>(p[3]) / 255};
  }
  std::vector<std::vector<uint32_t>> levels;
  while (true) {
    std::vector<uint32_t>& words = levels.emplace_back();
    for (const auto& texel : level) {
      uint32_t word = 0;
      for (size_t c = 0; c < 4; ++c) {
        const float value = c < 3 ? std::sqrt(texel[c]) : texel[c];
        word |= static_cast<uint32_t>(std::lround(std::clamp(value, 0.0f, 1.0f) * 255)) << (8 * c);
      }
      words.push_back(word);
    }
    if (width == 1 && height == 1) return levels;
    const uint32_t w = std::max(width / 2, 1u), h = std::max(height / 2, 1u);
    std::vector<std::array<float, 4>> next(size_t{w} * h);
    for (uint32_t y = 0; y < h; ++y)
      for (uint32_t x = 0; x < w; ++x) {
        // The last one also takes the odd texel.
        const uint32_t end_x = x + 1 == w ? width : 2 * x + 2;
        const uint32_t end_y = y + 1 == h ? height : 2 * y + 2;
        std::array<float, 4> sum{};
        float count = 0;
        for (uint32_t j = 2 * y; j < end_y; ++j)
          for (uint32_t i = 2 * x; i < end_x; ++i, ++count)
            for (size_t c = 0; c < 4; ++c) sum[c] += level[size_t{j} * width + i][c];
        for (size_t c = 0; c < 4; ++c) next[size_t{y} * w + x][c] = sum[c] / count;
      }
    level = std::move(next);
    width = w;
    height = h;
  }
}

Result<SceneModel> load_model(const std::string& name, const Fields& fields,
                              const std::string& folder) {
  SHALE_TRY_VOID(fields.only({"package", "version", "library", "model", "level", "file", "scale",
                              "height", "tint", "specular"}));
  SceneModel model;
  model.name = name;
  double metres = 1;
  bool on_floor = false;
  if (fields.has("file")) {
    SHALE_TRY(const std::string file, fields.text("file"));
    const auto archive = open_folder(folder);
    if (file.ends_with(".obj")) {
      SHALE_TRY(model.mesh, load_obj(*archive, file));
    } else if (file.ends_with(".gltf") || file.ends_with(".glb")) {
      SHALE_TRY(model.mesh, load_gltf(*archive, file));
    } else {
      return bad_input(fields.where(),
                       "\"file\" is \"{}\", expected one that ends with .obj, .gltf or .glb", file);
    }
  } else {
    SHALE_TRY(const uint32_t package, fields.choice("package", {kFurniture, kLevels}));
    SHALE_TRY_VOID(fields.text("version"));
    if (package == 0) {
      SHALE_TRY(const std::string library, fields.text("library"));
      SHALE_TRY(const std::string wanted, fields.text("model"));
      SHALE_TRY(
          const auto archive,
          packaged(fields, kFurniture, "/usr/share/sweethome3d/furniture/" + library + ".sh3f"));
      SHALE_TRY(const CatalogueEntry entry, catalogue_entry(*archive, wanted, fields.where()));
      SHALE_TRY(model.mesh, load_obj(*archive, entry.file));
      const Box box = box_of(model.mesh);
      metres = entry.width > 0 && box.high[0] > box.low[0]
                   ? entry.width / 100 / static_cast<double>(box.high[0] - box.low[0])
                   : 0.01;
      on_floor = true;
    } else {
      SHALE_TRY(const std::string level, fields.text("level"));
      const std::string at = "/usr/share/games/openarena/baseoa/";
      SHALE_TRY(const auto maps, packaged(fields, kLevels, at + "pak1-maps.pk3"));
      SHALE_TRY(const auto textures, packaged(fields, kLevelTextures, at + "pak4-textures.pk3"));
      SHALE_TRY(model.mesh, load_level({maps.get(), textures.get()}, "maps/" + level + ".bsp"));
    }
  }
  if (model.mesh.triangles.empty()) return bad_input(fields.where(), "the model has no triangles");
  const Box box = box_of(model.mesh);
  if (fields.has("height")) {
    SHALE_TRY(const double height, fields.number("height", 1e-3, 1e4));
    if (!(box.high[1] > box.low[1])) return bad_input(fields.where(), "the model has no height");
    metres = height / static_cast<double>(box.high[1] - box.low[1]);
  }
  SHALE_TRY(const double scale, fields.number("scale", 1e-4, 1e4, 1.0));
  metres *= scale;
  SHALE_TRY(const Vec3 tint, fields.vec3("tint", 0, 100, Vec3{1, 1, 1}));
  for (MeshMaterial& m : model.mesh.materials) {
    m.color[0] *= static_cast<float>(tint.x);
    m.color[1] *= static_cast<float>(tint.y);
    m.color[2] *= static_cast<float>(tint.z);
    SHALE_TRY(const double specular, fields.number("specular", 0, 10, double{m.specular}));
    m.specular = static_cast<float>(specular);
  }
  // Furniture stands on its origin.
  Float3 origin{};
  if (on_floor)
    origin = {(box.low[0] + box.high[0]) / 2, box.low[1], (box.low[2] + box.high[2]) / 2};
  std::vector<Box> boxes;
  for (MeshTriangle& triangle : model.mesh.triangles) {
    for (Float3& at : triangle.at)
      for (size_t a = 0; a < 3; ++a) {
        at[a] = static_cast<float>((at[a] - origin[a]) * metres);
        if (!(std::abs(at[a]) < 1e5f))
          return bad_input(fields.where(), "the model reaches {} m, expected less than 100 km",
                           at[a]);
      }
    boxes.push_back(box_of(triangle));
  }
  model.tree = build_bvh(boxes, kLeafTriangles);
  std::vector<MeshTriangle> sorted;
  sorted.reserve(boxes.size());
  for (const uint32_t i : model.tree.order) sorted.push_back(model.mesh.triangles[i]);
  model.mesh.triangles = std::move(sorted);
  model.tree.order = {};
  return model;
}

std::vector<ModelPart> model_parts(const std::vector<SceneModel>& models) {
  std::vector<ModelPart> parts;
  ModelPart next;
  for (const SceneModel& model : models) {
    parts.push_back(next);
    next.node += static_cast<uint32_t>(model.tree.nodes.size());
    next.triangle += static_cast<uint32_t>(model.mesh.triangles.size());
    next.material += static_cast<uint32_t>(model.mesh.materials.size());
  }
  return parts;
}

Result<ModelBuffers> model_buffers(const std::vector<SceneModel>& models) {
  ModelBuffers buffers;
  size_t nodes = 0, triangles = 0;
  for (const SceneModel& model : models) {
    nodes += model.tree.nodes.size();
    triangles += model.mesh.triangles.size();
  }
  // Numbers of nodes and triangles stand in floats.
  if (nodes >= 1u << 24 || triangles >= 1u << 24)
    return unsupported("", "the models have {} triangles, expected less than {}", triangles,
                       1u << 24);
  std::vector<uint32_t>& out = buffers.geometry;
  out.reserve(4 * (2 * nodes + 5 * triangles));
  for (const SceneModel& model : models)
    for (const BvhNode& node : model.tree.nodes) {
      const Box& b = node.box;
      out.insert(out.end(), {bits(b.low[0]), bits(b.low[1]), bits(b.low[2]), node.next,
                             bits(b.high[0]), bits(b.high[1]), bits(b.high[2]),
                             node.count == 0 ? 0 : node.first | node.count << 24});
    }
  buffers.first_triangle = static_cast<uint32_t>(out.size() / 4);
  for (const SceneModel& model : models)
    for (const MeshTriangle& t : model.mesh.triangles) {
      Float3 e1{}, e2{};
      for (size_t a = 0; a < 3; ++a) {
        e1[a] = t.at[1][a] - t.at[0][a];
        e2[a] = t.at[2][a] - t.at[0][a];
      }
      const Float3 plane{e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2],
                         e1[0] * e2[1] - e1[1] * e2[0]};
      const float area = std::sqrt(plane[0] * plane[0] + plane[1] * plane[1] + plane[2] * plane[2]);
      const float uv_area = std::abs((t.uv[1][0] - t.uv[0][0]) * (t.uv[2][1] - t.uv[0][1]) -
                                     (t.uv[2][0] - t.uv[0][0]) * (t.uv[1][1] - t.uv[0][1]));
      // Pictures per metre, as the logarithm that levels count by.
      const float density = area > 0 && uv_area > 0 ? 0.5f * std::log2(uv_area / area) : -100.0f;
      const MeshMaterial& m = model.mesh.materials[t.material];
      const uint32_t cut = m.cut_out && m.texture >= 0 ? 1u << 31 : 0;
      for (size_t k = 0; k < 3; ++k) {
        const Float3& at = k == 0 ? t.at[0] : k == 1 ? e1 : e2;
        out.insert(out.end(),
                   {bits(at[0]), bits(at[1]), bits(at[2]), packed_normal(t.normal[k], plane)});
      }
      out.insert(out.end(), {bits(t.uv[0][0]), bits(t.uv[0][1]), bits(t.uv[1][0]), bits(t.uv[1][1]),
                             bits(t.uv[2][0]), bits(t.uv[2][1]), t.material | cut, bits(density)});
    }
  buffers.first_material = static_cast<uint32_t>(out.size() / 4);
  for (const SceneModel& model : models) {
    std::vector<uint32_t> bases, shapes, counts;
    for (const MeshTexture& texture : model.mesh.textures) {
      const auto levels = mip_levels(texture);
      bases.push_back(static_cast<uint32_t>(buffers.texels.size()));
      shapes.push_back(texture.width | texture.height << 16);
      counts.push_back(static_cast<uint32_t>(levels.size()));
      uint32_t at = static_cast<uint32_t>(buffers.texels.size() + levels.size());
      for (const auto& level : levels) {
        buffers.texels.push_back(at);
        at += static_cast<uint32_t>(level.size());
      }
      for (const auto& level : levels)
        buffers.texels.insert(buffers.texels.end(), level.begin(), level.end());
    }
    for (const MeshMaterial& m : model.mesh.materials) {
      const float most = std::max({m.color[0], m.color[1], m.color[2], 1e-3f});
      const float glow = std::max({m.emission[0], m.emission[1], m.emission[2]}) / most;
      const auto texture = static_cast<size_t>(std::max(m.texture, 0));
      const bool has = m.texture >= 0;
      // Specular in eighths of a thousandth above the shininess.
      const uint32_t shine = static_cast<uint32_t>(m.shininess) |
                             static_cast<uint32_t>(std::min(m.specular, 8.0f) * 8000) << 16;
      out.insert(out.end(), {bits(m.color[0]), bits(m.color[1]), bits(m.color[2]), bits(glow),
                             has ? bases[texture] : 0, has ? shapes[texture] : 0,
                             has ? counts[texture] : 0, shine});
    }
  }
  return buffers;
}

}  // namespace shale
