// Wavefront OBJ and MTL, and images.
#include <stb/stb_image.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>
#include <string_view>

#include "tools/scene/mesh.h"

namespace shale {
namespace {

constexpr float kCreaseCosine = 0.70710678f;
constexpr float kAbsentOpacity = 0.3f;

/// Words of a line, one after the other.
class Words {
 public:
  Words(std::string_view line, std::string where) : rest_(line), where_(std::move(where)) {}

  std::string_view next() {
    const size_t first = rest_.find_first_not_of(" \t\r");
    if (first == std::string_view::npos) return rest_ = {};
    rest_.remove_prefix(first);
    const size_t end = std::min(rest_.find_first_of(" \t\r"), rest_.size());
    const std::string_view word = rest_.substr(0, end);
    rest_.remove_prefix(end);
    return word;
  }
  /// All that is left, without blanks at its ends.
  std::string_view rest() const {
    const size_t first = rest_.find_first_not_of(" \t\r");
    if (first == std::string_view::npos) return {};
    return rest_.substr(first, rest_.find_last_not_of(" \t\r") - first + 1);
  }
  Result<float> number() {
    const std::string_view word = next();
    float value = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc{} || end != word.data() + word.size() || !std::isfinite(value))
      return bad_input(where_, "found \"{}\", expected a number", word);
    return value;
  }
  Result<Float3> numbers3() {
    Float3 value{};
    for (float& v : value) {
      SHALE_TRY(v, number());
    }
    return value;
  }
  const std::string& where() const { return where_; }

 private:
  std::string_view rest_;
  std::string where_;
};

/// Calls `take` with the words of every line that is not empty and no comment.
template <typename Take>
Result<void> each_line(const std::vector<uint8_t>& bytes, const std::string& where, Take take) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  size_t number = 0;
  for (size_t at = 0; at < text.size();) {
    const size_t end = std::min(text.find('\n', at), text.size());
    ++number;
    const std::string_view line = text.substr(at, end - at);
    at = end + 1;
    const size_t first = line.find_first_not_of(" \t\r");
    if (first == std::string_view::npos || line[first] == '#') continue;
    Words words(line, fmt::format("{}:{}", where, number));
    SHALE_TRY_VOID(take(words.next(), words));
  }
  return {};
}

std::string folder_of(const std::string& name) {
  const size_t slash = name.rfind('/');
  return slash == std::string::npos ? "" : name.substr(0, slash + 1);
}

/// Without the folders of whoever made the file.
std::string base_of(std::string_view path) {
  const size_t slash = path.find_last_of("/\\");
  return std::string(slash == std::string_view::npos ? path : path.substr(slash + 1));
}

Float3 minus(const Float3& a, const Float3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
float dot3(const Float3& a, const Float3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
/// Twice the area long.
Float3 plane_of(const std::array<Float3, 3>& at) {
  const Float3 a = minus(at[1], at[0]), b = minus(at[2], at[0]);
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

class ObjReader {
 public:
  ObjReader(const Archive& archive, const std::string& name)
      : archive_(archive), name_(name), where_(archive.where(name)) {
    model_.name = name;
  }

  Result<MeshModel> read() {
    SHALE_TRY(const std::vector<uint8_t> bytes, archive_.read(name_));
    SHALE_TRY_VOID(each_line(bytes, where_,
                             [&](std::string_view key, Words& words) { return line(key, words); }));
    smooth();
    return std::move(model_);
  }

 private:
  struct Corner {
    uint32_t at = 0;
    std::optional<uint32_t> uv, normal;
  };

  Result<void> line(std::string_view key, Words& words) {
    if (key == "v") {
      SHALE_TRY(const Float3 v, words.numbers3());
      at_.push_back(v);
    } else if (key == "vt") {
      SHALE_TRY(const float u, words.number());
      SHALE_TRY(const float v, words.number());
      uv_.push_back({u, 1 - v});
    } else if (key == "vn") {
      SHALE_TRY(const Float3 n, words.numbers3());
      normal_.push_back(n);
    } else if (key == "f") {
      return face(words);
    } else if (key == "usemtl") {
      const std::string name(words.rest());
      const auto known = materials_.find(name);
      material_ = known == materials_.end() ? add_material(name) : known->second;
    } else if (key == "mtllib") {
      return library(folder_of(name_) + base_of(words.rest()), words.where());
    }
    return {};  // lines, groups, smoothing and whatever else has no influence
  }

  uint32_t add_material(const std::string& name) {
    const auto index = static_cast<uint32_t>(model_.materials.size());
    model_.materials.emplace_back().name = name;
    opacity_.push_back(1);
    materials_[name] = index;
    return index;
  }

  Result<uint32_t> index_of(std::string_view word, size_t count, const char* of,
                            const std::string& where) const {
    int64_t value = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc{} || end != word.data() + word.size())
      return bad_input(where, "found \"{}\", expected the number of a {}", word, of);
    const int64_t index = value < 0 ? static_cast<int64_t>(count) + value : value - 1;
    if (index < 0 || index >= static_cast<int64_t>(count))
      return bad_input(where, "{} {} is named, the file has {} so far", of, value, count);
    return static_cast<uint32_t>(index);
  }

  Result<void> face(Words& words) {
    std::vector<Corner> corners;
    for (std::string_view word = words.next(); !word.empty(); word = words.next()) {
      Corner corner;
      const size_t slash = std::min(word.find('/'), word.size());
      SHALE_TRY(corner.at, index_of(word.substr(0, slash), at_.size(), "vertex", words.where()));
      if (slash < word.size()) {
        const std::string_view rest = word.substr(slash + 1);
        const size_t second = std::min(rest.find('/'), rest.size());
        if (second > 0) {
          SHALE_TRY(corner.uv, index_of(rest.substr(0, second), uv_.size(), "texture coordinate",
                                        words.where()));
        }
        if (second + 1 < rest.size()) {
          SHALE_TRY(corner.normal,
                    index_of(rest.substr(second + 1), normal_.size(), "normal", words.where()));
        }
      }
      corners.push_back(corner);
    }
    // Files from modelling programs have faces of two corners: lines, which show nothing.
    if (corners.size() < 3) return {};
    if (material_ == kNoMaterial) material_ = add_material("");
    if (opacity_[material_] < kAbsentOpacity) return {};
    for (size_t i = 2; i < corners.size(); ++i) {
      MeshTriangle triangle;
      std::array<uint32_t, 3> own{};
      for (size_t k = 0; k < 3; ++k) {
        const Corner& corner = corners[k == 0 ? 0 : i - 2 + k];
        own[k] = corner.at;
        triangle.at[k] = at_[corner.at];
        if (corner.uv) triangle.uv[k] = uv_[*corner.uv];
        if (corner.normal) triangle.normal[k] = normal_[*corner.normal];
      }
      triangle.material = material_;
      // Without area it cannot be met.
      const Float3 plane = plane_of(triangle.at);
      if (!(dot3(plane, plane) > 0)) continue;
      if (model_.triangles.size() >= kMaxTriangles)
        return bad_input(words.where(), "more than {} triangles", kMaxTriangles);
      model_.triangles.push_back(triangle);
      corners_.push_back(own);
    }
    return {};
  }

  Result<void> library(const std::string& name, const std::string& from) {
    if (!archive_.has(name))
      return bad_input(from, "names the materials {}, which is not there", archive_.where(name));
    SHALE_TRY(const std::vector<uint8_t> bytes, archive_.read(name));
    uint32_t own = kNoMaterial;
    return each_line(bytes, archive_.where(name), [&](std::string_view key, Words& words) {
      return material_line(key, words, name, own);
    });
  }

  Result<void> material_line(std::string_view key, Words& words, const std::string& library,
                             uint32_t& own) {
    if (key == "newmtl") {
      own = add_material(std::string(words.rest()));
      return {};
    }
    if (own == kNoMaterial) return {};
    MeshMaterial& m = model_.materials[own];
    if (key == "Kd") {
      SHALE_TRY(m.color, words.numbers3());
    } else if (key == "Ke") {
      SHALE_TRY(m.emission, words.numbers3());
    } else if (key == "Ks") {
      SHALE_TRY(const Float3 ks, words.numbers3());
      m.specular = std::clamp((ks[0] + ks[1] + ks[2]) / 3, 0.0f, 1.0f);
    } else if (key == "Ns") {
      SHALE_TRY(const float ns, words.number());
      m.shininess = std::clamp(ns, 4.0f, 200.0f);
    } else if (key == "d") {
      SHALE_TRY(opacity_[own], words.number());
    } else if (key == "map_Kd" || key == "map_d") {
      const std::string file = folder_of(library) + base_of(words.rest());
      if (!archive_.has(file))
        return bad_input(words.where(), "names the picture {}, which is not there",
                         archive_.where(file));
      if (key == "map_d" && m.texture >= 0) {
        m.cut_out = true;
        return mask(m.texture, file);
      }
      SHALE_TRY(m.texture, texture(file));
      const std::vector<uint8_t>& pixels = model_.textures[static_cast<size_t>(m.texture)].pixels;
      for (size_t i = 3; i < pixels.size() && !m.cut_out; i += 4) m.cut_out = pixels[i] < 128;
      m.color = {1, 1, 1};
    }
    return {};
  }

  Result<int> texture(const std::string& file) {
    const auto known = textures_.find(file);
    if (known != textures_.end()) return known->second;
    SHALE_TRY(const std::vector<uint8_t> bytes, archive_.read(file));
    SHALE_TRY(MeshTexture texture, decode_texture(bytes, archive_.where(file)));
    const auto index = static_cast<int>(model_.textures.size());
    model_.textures.push_back(std::move(texture));
    return textures_[file] = index;
  }

  /// Alpha from a picture of its own, if that is as large; else it has none.
  Result<void> mask(int texture_index, const std::string& file) {
    SHALE_TRY(const std::vector<uint8_t> bytes, archive_.read(file));
    SHALE_TRY(const MeshTexture alpha, decode_texture(bytes, archive_.where(file)));
    MeshTexture& texture = model_.textures[static_cast<size_t>(texture_index)];
    if (alpha.width != texture.width || alpha.height != texture.height)
      return bad_input(archive_.where(file), "has {}x{} pixels, its colours have {}x{}",
                       alpha.width, alpha.height, texture.width, texture.height);
    // A PNG's own alpha, or the brightness of a picture without.
    bool own = false;
    for (size_t i = 3; i < alpha.pixels.size(); i += 4) own = own || alpha.pixels[i] != 255;
    for (size_t i = 0; i < alpha.pixels.size(); i += 4)
      texture.pixels[i + 3] = alpha.pixels[i + (own ? 3 : 0)];
    return {};
  }

  /// Normals of corners that the file gives none.
  void smooth() {
    std::vector<uint32_t> first(at_.size() + 1);
    for (const auto& own : corners_)
      for (const uint32_t at : own) ++first[at + 1];
    for (size_t i = 1; i < first.size(); ++i) first[i] += first[i - 1];
    std::vector<uint32_t> faces(first.back()), next(first.begin(), first.end() - 1);
    std::vector<Float3> planes(corners_.size());
    for (size_t f = 0; f < corners_.size(); ++f) {
      planes[f] = plane_of(model_.triangles[f].at);
      for (const uint32_t at : corners_[f]) faces[next[at]++] = static_cast<uint32_t>(f);
    }
    for (size_t f = 0; f < corners_.size(); ++f)
      for (size_t k = 0; k < 3; ++k) {
        Float3& normal = model_.triangles[f].normal[k];
        if (dot3(normal, normal) > 0) continue;
        const float own = std::sqrt(dot3(planes[f], planes[f]));
        // Corners where very many meet are centres of fans: their own plane will do.
        const uint32_t begin = first[corners_[f][k]], end = first[corners_[f][k] + 1];
        if (end - begin > 64) {
          normal = planes[f];
          continue;
        }
        for (uint32_t i = begin; i < end; ++i) {
          const Float3& other = planes[faces[i]];
          if (dot3(other, planes[f]) < kCreaseCosine * own * std::sqrt(dot3(other, other)))
            continue;
          for (size_t a = 0; a < 3; ++a) normal[a] += other[a];
        }
      }
  }

  static constexpr uint32_t kNoMaterial = 0xFFFFFFFFu;
  const Archive& archive_;
  const std::string name_, where_;
  MeshModel model_;
  std::vector<Float3> at_, normal_;
  std::vector<Float2> uv_;
  std::vector<std::array<uint32_t, 3>> corners_;  ///< vertices of each triangle
  std::vector<float> opacity_;                    ///< by material
  std::map<std::string, uint32_t> materials_;
  std::map<std::string, int> textures_;
  uint32_t material_ = kNoMaterial;
};

}  // namespace

Result<MeshTexture> decode_texture(const std::vector<uint8_t>& bytes, const std::string& where) {
  int width = 0, height = 0, channels = 0;
  const auto size = static_cast<int>(std::min<size_t>(bytes.size(), 1u << 30));
  if (stbi_info_from_memory(bytes.data(), size, &width, &height, &channels) == 0)
    return bad_input(where, "is no picture that can be read: {}", stbi_failure_reason());
  if (width < 1 || height < 1 || static_cast<uint32_t>(std::max(width, height)) > kMaxTextureSide)
    return bad_input(where, "has {}x{} pixels, expected at most {} a side", width, height,
                     kMaxTextureSide);
  stbi_uc* pixels = stbi_load_from_memory(bytes.data(), size, &width, &height, &channels, 4);
  if (pixels == nullptr)
    return bad_input(where, "is no picture that can be read: {}", stbi_failure_reason());
  MeshTexture texture{where, static_cast<uint32_t>(width), static_cast<uint32_t>(height), {}};
  texture.pixels.assign(pixels, pixels + size_t{texture.width} * texture.height * 4);
  stbi_image_free(pixels);
  return texture;
}

Result<MeshModel> load_obj(const Archive& archive, const std::string& name) {
  return ObjReader(archive, name).read();
}

}  // namespace shale
