// glTF 2.0, by tinygltf.
#define TINYGLTF_NO_INCLUDE_STB_IMAGE
#define TINYGLTF_NO_INCLUDE_STB_IMAGE_WRITE
#include <tiny_gltf.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <map>

#include "ir/base/file.h"
#include "ir/base/json.h"
#include "tools/scene/mesh.h"
#include "tools/scene/vector.h"

namespace shale {
namespace {

constexpr int kMaxDepth = 64;
constexpr size_t kMaxVisits = 100'000;
constexpr size_t kMaxElements = 16 * kMaxTriangles;
constexpr size_t kMaxTexels = size_t{1} << 26;
constexpr size_t kMaxImageBytes = size_t{1} << 28;
constexpr size_t kGlbText = 20;

class GltfReader {
 public:
  explicit GltfReader(std::string where) : where_(std::move(where)) {}

  Result<MeshModel> read(const std::vector<uint8_t>& bytes, const std::string& folder,
                         bool binary) {
    SHALE_TRY_VOID(check_json(bytes, binary));
    tinygltf::TinyGLTF loader;
    std::string error, warning;
    loader.SetFsCallbacks({&exists, &as_it_is, &read_whole, nullptr, nullptr});
    loader.SetImageLoader(&keep_image, this);
    const auto size = static_cast<unsigned>(std::min<size_t>(bytes.size(), 1u << 31));
    const bool loaded =
        binary
            ? loader.LoadBinaryFromMemory(&file_, &error, &warning, bytes.data(), size, folder)
            : loader.LoadASCIIFromString(&file_, &error, &warning,
                                         reinterpret_cast<const char*>(bytes.data()), size, folder);
    if (!loaded) {
      while (!error.empty() && error.back() == '\n') error.pop_back();
      return bad_input(where_, "is no glTF that can be read: {}", error);
    }
    SHALE_TRY_VOID(read_materials());
    const int scene = file_.defaultScene >= 0 ? file_.defaultScene : 0;
    if (static_cast<size_t>(scene) >= file_.scenes.size())
      return bad_input(where_, "has {} scenes, scene {} is shown", file_.scenes.size(), scene);
    for (const int node : file_.scenes[static_cast<size_t>(scene)].nodes)
      SHALE_TRY_VOID(read_node(node, Affine{}, 0));
    return std::move(model_);
  }

 private:
  /// The library copies parts of the JSON by recursion.
  Result<void> check_json(const std::vector<uint8_t>& bytes, bool binary) const {
    std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    if (binary) {  // 12 bytes of header, size and type of the chunk of JSON, and that
      if (text.size() < kGlbText) return bad_input(where_, "ends after {} bytes", text.size());
      uint32_t size = 0;
      std::memcpy(&size, bytes.data() + kGlbText - 8, sizeof(size));
      text = text.substr(kGlbText, size);
    }
    if (const Result<nlohmann::json> json = parse_json(text); !json)
      return bad_input(where_, "is no glTF that can be read: {}", json.error().text());
    return {};
  }

  // What the library does with files: it takes names as they are, and of images the bytes.
  static bool exists(const std::string& path, void*) {
    std::error_code ignored;
    return std::filesystem::exists(path, ignored);
  }
  static std::string as_it_is(const std::string& path, void*) { return path; }
  static bool read_whole(std::vector<unsigned char>* to, std::string* error,
                         const std::string& path, void*) {
    Result<std::vector<uint8_t>> bytes = read_file(path);
    if (!bytes) return *error += bytes.error().text(), false;
    *to = *std::move(bytes);
    return true;
  }
  static bool keep_image(tinygltf::Image* image, int, std::string* error, std::string*, int, int,
                         const unsigned char* bytes, int size, void* reader) {
    if (image->bufferView >= 0) return true;  // the bytes may lie behind the buffer's end
    size_t& kept = static_cast<GltfReader*>(reader)->image_bytes_;
    kept += static_cast<size_t>(size);
    if (kept > kMaxImageBytes)
      return *error += fmt::format("images of more than {} bytes", kMaxImageBytes), false;
    image->image.assign(bytes, bytes + size);
    return true;
  }

  static const std::string& label(const tinygltf::Image& image) {
    return image.uri.empty() ? image.name : image.uri;
  }

  /// An image as a file holds it.
  Result<std::vector<uint8_t>> image_bytes(const tinygltf::Image& image) const {
    if (image.bufferView < 0) return image.image;
    SHALE_TRY(const auto* view, item(file_.bufferViews, image.bufferView, "buffer view"));
    SHALE_TRY(const auto* buffer, item(file_.buffers, view->buffer, "buffer"));
    const size_t begin = view->byteOffset, size = view->byteLength;
    if (begin > buffer->data.size() || size > buffer->data.size() - begin)
      return bad_input(where_, "image \"{}\" ends behind its buffer of {} bytes", label(image),
                       buffer->data.size());
    const auto first = buffer->data.begin() + static_cast<ptrdiff_t>(begin);
    return std::vector<uint8_t>(first, first + static_cast<ptrdiff_t>(size));
  }

  Result<void> add_texture(MeshTexture texture) {
    texels_ += texture.pixels.size() / 4;
    if (texels_ > kMaxTexels)
      return bad_input(where_, "textures of more than {} texels", kMaxTexels);
    model_.textures.push_back(std::move(texture));
    return {};
  }

  template <typename Item>
  Result<const Item*> item(const std::vector<Item>& all, int index, const char* what) const {
    if (index < 0 || static_cast<size_t>(index) >= all.size())
      return bad_input(where_, "{} {} is named, the file has {}", what, index, all.size());
    return &all[static_cast<size_t>(index)];
  }

  Result<void> read_materials() {
    for (const tinygltf::Image& image : file_.images) {
      SHALE_TRY(const std::vector<uint8_t> bytes, image_bytes(image));
      SHALE_TRY(MeshTexture texture,
                decode_texture(bytes, fmt::format("{}: image \"{}\"", where_, label(image))));
      SHALE_TRY_VOID(add_texture(std::move(texture)));
    }
    for (const tinygltf::Material& from : file_.materials) {
      MeshMaterial m;
      m.name = from.name;
      const auto& pbr = from.pbrMetallicRoughness;
      for (size_t a = 0; a < 3 && a < pbr.baseColorFactor.size(); ++a)
        m.color[a] = static_cast<float>(pbr.baseColorFactor[a]);
      for (size_t a = 0; a < 3 && a < from.emissiveFactor.size(); ++a)
        m.emission[a] = static_cast<float>(from.emissiveFactor[a]);
      const double smooth = 1 - std::clamp(pbr.roughnessFactor, 0.0, 1.0);
      m.specular = static_cast<float>(0.5 * smooth);
      m.shininess = static_cast<float>(8 + 120 * smooth * smooth);
      if (pbr.baseColorTexture.index >= 0) {
        SHALE_TRY(const auto* texture, item(file_.textures, pbr.baseColorTexture.index, "texture"));
        SHALE_TRY(const auto* image, item(file_.images, texture->source, "image"));
        m.texture = static_cast<int>(image - file_.images.data());
      }
      if (from.alphaMode == "MASK") {
        const double alpha = pbr.baseColorFactor.size() == 4 ? pbr.baseColorFactor[3] : 1;
        SHALE_TRY_VOID(cut_out(m, alpha, from.alphaCutoff));
      }
      model_.materials.push_back(std::move(m));
    }
    model_.materials.emplace_back();  // for what has none
    return {};
  }

  /// What is seen of a material is where its texture's alpha times `alpha` reaches `cutoff`. Rays look for a half, so the texture
  /// of another cutoff is one of its own, whose alpha passes a half there.
  Result<void> cut_out(MeshMaterial& material, double alpha, double cutoff) {
    if (!std::isfinite(alpha) || !std::isfinite(cutoff))
      return bad_input(where_, "material \"{}\" has an alpha of {} and a cutoff of {}",
                       material.name, alpha, cutoff);
    if (material.texture < 0 || cutoff <= 0) return {};
    material.cut_out = true;
    const double scale = 0.5 * std::max(alpha, 0.0) / cutoff;
    if (scale == 1.0) return {};
    const auto [known, is_new] =
        cut_outs_.try_emplace({material.texture, scale}, static_cast<int>(model_.textures.size()));
    if (!is_new) return material.texture = known->second, Result<void>();
    MeshTexture texture = model_.textures[static_cast<size_t>(material.texture)];
    for (size_t i = 3; i < texture.pixels.size(); i += 4)
      texture.pixels[i] = static_cast<uint8_t>(
          std::lround(std::min(scale * static_cast<double>(texture.pixels[i]), 255.0)));
    material.texture = known->second;
    return add_texture(std::move(texture));
  }

  static Affine pose_of(const tinygltf::Node& node) {
    Affine pose;
    if (node.matrix.size() == 16) {
      const auto& m = node.matrix;
      return {{m[0], m[1], m[2]}, {m[4], m[5], m[6]}, {m[8], m[9], m[10]}, {m[12], m[13], m[14]}};
    }
    if (node.translation.size() == 3)
      pose.at = {node.translation[0], node.translation[1], node.translation[2]};
    if (node.rotation.size() == 4) {
      const double x = node.rotation[0], y = node.rotation[1], z = node.rotation[2],
                   w = node.rotation[3];
      pose.x = {1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)};
      pose.y = {2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)};
      pose.z = {2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)};
    }
    if (node.scale.size() == 3) {
      pose.x = pose.x * node.scale[0];
      pose.y = pose.y * node.scale[1];
      pose.z = pose.z * node.scale[2];
    }
    return pose;
  }

  Result<void> read_node(int index, const Affine& parent, int depth) {
    if (depth > kMaxDepth) return bad_input(where_, "nodes are nested deeper than {}", kMaxDepth);
    if (++visits_ > kMaxVisits)
      return bad_input(where_, "more than {} nodes are shown", kMaxVisits);
    SHALE_TRY(const tinygltf::Node* node, item(file_.nodes, index, "node"));
    const Affine pose = parent * pose_of(*node);
    if (node->mesh >= 0) {
      SHALE_TRY(const tinygltf::Mesh* mesh, item(file_.meshes, node->mesh, "mesh"));
      for (const tinygltf::Primitive& primitive : mesh->primitives)
        SHALE_TRY_VOID(read_primitive(primitive, pose));
    }
    for (const int child : node->children) SHALE_TRY_VOID(read_node(child, pose, depth + 1));
    return {};
  }

  /// `components` numbers for each element; integers as they are, or parts of 1 if they are
  /// normalized.
  Result<std::vector<double>> values(int index, size_t components) {
    SHALE_TRY(const tinygltf::Accessor* accessor, item(file_.accessors, index, "accessor"));
    SHALE_TRY(const tinygltf::BufferView* view,
              item(file_.bufferViews, accessor->bufferView, "buffer view"));
    SHALE_TRY(const tinygltf::Buffer* buffer, item(file_.buffers, view->buffer, "buffer"));
    const int own = tinygltf::GetNumComponentsInType(static_cast<uint32_t>(accessor->type));
    const int bytes =
        tinygltf::GetComponentSizeInBytes(static_cast<uint32_t>(accessor->componentType));
    const int stride = accessor->ByteStride(*view);
    if (own < 0 || static_cast<size_t>(own) != components || bytes <= 0 || stride <= 0 ||
        accessor->sparse.isSparse)
      return bad_input(where_, "accessor {} has {} components, expected {} in one view", index, own,
                       components);
    const size_t element = components * static_cast<size_t>(bytes);
    const size_t begin = view->byteOffset + accessor->byteOffset;
    if (accessor->count > 3 * kMaxTriangles || begin > buffer->data.size() ||
        (accessor->count > 0 && (accessor->count - 1) * static_cast<size_t>(stride) + element >
                                    buffer->data.size() - begin))
      return bad_input(where_, "accessor {} with {} elements ends behind its buffer of {} bytes",
                       index, accessor->count, buffer->data.size());
    elements_ += accessor->count;
    if (elements_ > kMaxElements)
      return bad_input(where_, "its nodes show more than {} vertices and indices", kMaxElements);
    std::vector<double> result(accessor->count * components);
    for (size_t i = 0; i < accessor->count; ++i)
      for (size_t c = 0; c < components; ++c) {
        const uint8_t* at =
            &buffer->data[begin + i * static_cast<size_t>(stride) + c * static_cast<size_t>(bytes)];
        double& value = result[i * components + c];
        uint32_t bits = 0;
        std::memcpy(&bits, at, std::min<size_t>(static_cast<size_t>(bytes), 4));
        switch (accessor->componentType) {
          case TINYGLTF_COMPONENT_TYPE_FLOAT: {
            float number = 0;
            std::memcpy(&number, &bits, 4);
            value = number;
            break;
          }
          case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
            value = bits / (accessor->normalized ? 255.0 : 1.0);
            break;
          case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
            value = bits / (accessor->normalized ? 65535.0 : 1.0);
            break;
          case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT: value = bits; break;
          default:
            return bad_input(where_,
                             "accessor {} has components of type {}, expected floats or "
                             "unsigned integers",
                             index, accessor->componentType);
        }
        if (!std::isfinite(value) || std::abs(value) > 4e9)
          return bad_input(where_, "accessor {} holds {}", index, value);
      }
    return result;
  }

  Result<void> read_primitive(const tinygltf::Primitive& primitive, const Affine& pose) {
    if (primitive.mode != -1 && primitive.mode != TINYGLTF_MODE_TRIANGLES) return {};
    const auto attribute = [&](const char* name) {
      const auto found = primitive.attributes.find(name);
      return found == primitive.attributes.end() ? -1 : found->second;
    };
    SHALE_TRY(const std::vector<double> at, values(attribute("POSITION"), 3));
    const size_t vertices = at.size() / 3;
    std::vector<double> normals, uvs, indices;
    if (attribute("NORMAL") >= 0) {
      SHALE_TRY(normals, values(attribute("NORMAL"), 3));
    }
    if (attribute("TEXCOORD_0") >= 0) {
      SHALE_TRY(uvs, values(attribute("TEXCOORD_0"), 2));
    }
    if (primitive.indices >= 0) {
      SHALE_TRY(indices, values(primitive.indices, 1));
    } else {
      for (size_t i = 0; i < vertices; ++i) indices.push_back(static_cast<double>(i));
    }
    if ((!normals.empty() && normals.size() != at.size()) ||
        (!uvs.empty() && uvs.size() != 2 * vertices))
      return bad_input(where_, "a mesh has {} positions, {} normals and {} texture coordinates",
                       vertices, normals.size() / 3, uvs.size() / 2);
    const size_t last = model_.materials.size() - 1;
    const size_t material = primitive.material < 0 ? last : static_cast<size_t>(primitive.material);
    if (material > last)
      return bad_input(where_, "material {} is named, the file has {}", material, last);
    // Normals turn with the inverse transpose, which these products are up to a factor; a mirror
    // turns them over, but a surface is seen from both sides.
    const Affine turn{cross(pose.y, pose.z), cross(pose.z, pose.x), cross(pose.x, pose.y), {}};
    for (size_t i = 0; i + 2 < indices.size(); i += 3) {
      MeshTriangle triangle;
      triangle.material = static_cast<uint32_t>(material);
      for (size_t k = 0; k < 3; ++k) {
        const auto v = static_cast<size_t>(indices[i + k]);
        if (v >= vertices)
          return bad_input(where_, "vertex {} is named, its mesh has {}", v, vertices);
        const auto put = [](const Vec3& from) {
          return Float3{static_cast<float>(from.x), static_cast<float>(from.y),
                        static_cast<float>(from.z)};
        };
        triangle.at[k] = put(pose.point({at[3 * v], at[3 * v + 1], at[3 * v + 2]}));
        if (!normals.empty())
          triangle.normal[k] = put(normalized(
              turn.direction({normals[3 * v], normals[3 * v + 1], normals[3 * v + 2]}), {}));
        if (!uvs.empty())
          triangle.uv[k] = {static_cast<float>(uvs[2 * v]), static_cast<float>(uvs[2 * v + 1])};
      }
      if (model_.triangles.size() >= kMaxTriangles)
        return bad_input(where_, "more than {} triangles", kMaxTriangles);
      model_.triangles.push_back(triangle);
    }
    return {};
  }

  const std::string where_;
  tinygltf::Model file_;
  MeshModel model_;
  std::map<std::pair<int, double>, int> cut_outs_;  ///< textures of a cutoff of their own
  // What a small file may ask for again and again.
  size_t visits_ = 0, elements_ = 0, texels_ = 0, image_bytes_ = 0;
};

}  // namespace

Result<MeshModel> load_gltf(const Archive& archive, const std::string& name) {
  SHALE_TRY(const std::vector<uint8_t> bytes, archive.read(name));
  const std::string where = archive.where(name);
  const size_t slash = where.rfind('/');
  SHALE_TRY(MeshModel model,
            GltfReader(where).read(bytes, slash == std::string::npos ? "." : where.substr(0, slash),
                                   name.ends_with(".glb")));
  model.name = name;
  return model;
}

}  // namespace shale
