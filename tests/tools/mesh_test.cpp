// Meshes: what the loaders read and refuse, and what rays see of triangles and textures.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <random>

#include "ir/base/file.h"
#include "tests/support/vulkan_fixture.h"
#include "tools/scene/scene_source.h"
#include "tools/scene/tables.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

class MeshTest : public VulkanTest {
 protected:
  void SetUp() override {
    VulkanTest::SetUp();
    root_ = fs::path(testing::TempDir()) / "shale_mesh_test";
    fs::remove_all(root_);
    fs::create_directories(root_);
  }
  void TearDown() override {
    fs::remove_all(root_);
    VulkanTest::TearDown();
  }

  void write(const std::string& name, const std::string& text) const {
    must(write_text((root_ / name).string(), text));
  }
  /// A TGA of RGBA texels.
  void write_tga(const std::string& name, uint32_t width, uint32_t height,
                 const std::vector<uint8_t>& rgba) const {
    std::vector<uint8_t> bytes{0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0};
    for (const uint32_t side : {width, height}) {
      bytes.push_back(static_cast<uint8_t>(side));
      bytes.push_back(static_cast<uint8_t>(side >> 8));
    }
    bytes.insert(bytes.end(), {32, 0x28});  // from the top, 8 bits of alpha
    for (size_t i = 0; i < rgba.size(); i += 4)
      bytes.insert(bytes.end(), {rgba[i + 2], rgba[i + 1], rgba[i], rgba[i + 3]});
    must(write_file((root_ / name).string(), bytes));
  }
  Result<MeshModel> obj(const std::string& text) const {
    write("a.obj", text);
    return load_obj(*open_folder(root_.string()), "a.obj");
  }
  std::string at(const std::string& name) const { return (root_ / name).string(); }

  /// A scene of one model, with `rest` after its objects.
  Result<Scene> scene_of(const std::string& file, const std::string& objects,
                         const std::string& camera, const std::string& rest = "") const {
    return parse_scene(
        R"({"schema": "shale-scene/1", "frames": 6, "camera": {"near": 0.05, )" + camera +
            R"(}, "sun": {"direction": [0, 0, 1], "color": [0, 0, 0]},
      "sky": {"zenith": [0, 0, 0], "horizon": [0, 0, 0], "ground": [0, 0, 0],
              "harmonics": [[3.5449077018110318, 3.5449077018110318, 3.5449077018110318],
                [0,0,0],[0,0,0],[0,0,0],[0,0,0],[0,0,0],[0,0,0],[0,0,0],[0,0,0]]},
      "models": {"m": {"file": ")" +
            file + R"(", "specular": 0}}, "objects": [)" + objects + "]" + rest + "}",
        root_.string());
  }
  static std::unique_ptr<SceneSource> source_of(Scene scene, Extent render, Extent output) {
    SceneOptions options;
    options.render = render;
    options.output = output;
    return must(SceneSource::create(context(), std::move(scene), options));
  }

  fs::path root_;
};

TEST_F(MeshTest, ObjectsAreReadWithMaterialsAndNormals) {
  write(
      "m.mtl",
      "newmtl red one\nKd 1 0 0\nNs 80\nnewmtl pane\nd 0.1\nnewmtl photo\nmap_Kd C:\\art\\p.tga\n");
  write_tga("p.tga", 2, 1, {255, 0, 0, 255, 0, 255, 0, 0});
  const MeshModel model =
      must(obj("# comment\r\nmtllib m.mtl\r\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\n"
               "vt 0 0\nvt 1 0.25\nvt 1 1\ns 1\nusemtl red one\nf 1 2 3 4\n"
               "usemtl pane\nf 1 2 5\nf 1 2\nusemtl photo\nf -5/1 -4/2 -1/3\nl 1 2\n"));
  ASSERT_EQ(model.triangles.size(), 3u);  // a fan of two, no pane, one with a picture
  EXPECT_EQ(model.materials[0].name, "red one");
  EXPECT_EQ(model.materials[0].color, (Float3{1, 0, 0}));
  EXPECT_EQ(model.materials[2].texture, 0);
  EXPECT_TRUE(model.materials[2].cut_out);
  EXPECT_EQ(model.textures[0].pixels, (std::vector<uint8_t>{255, 0, 0, 255, 0, 255, 0, 0}));
  EXPECT_EQ(model.triangles[1].at[1], (Float3{1, 1, 0}));
  EXPECT_EQ(model.triangles[2].uv[1], (Float2{1, 0.75f}));
  // The fan is flat, the third triangle bends off by a right angle.
  EXPECT_EQ(model.triangles[0].normal[0][0], 0);
  EXPECT_GT(model.triangles[0].normal[0][2], 0);
  EXPECT_EQ(model.triangles[2].normal[0][2], 0);
}

TEST_F(MeshTest, FilesThatAreWrongNameTheLine) {
  write("m.mtl", "newmtl a\nKd 1 x 0\n");
  write("n.mtl", "newmtl a\nmap_Kd none.png\n");
  const struct {
    std::string text, expected;
  } kCases[]{
      {"v 0 0\n", at("a.obj") + ":1: found \"\", expected a number"},
      {"v 0 0 1e\n", at("a.obj") + ":1: found \"1e\", expected a number"},
      {"v 0 0 nan\n", at("a.obj") + ":1: found \"nan\", expected a number"},
      {"v 0 0 0\n\nf 1 1 2\n", at("a.obj") + ":3: vertex 2 is named, the file has 1 so far"},
      {"v 0 0 0\nf 1 1 -2\n", at("a.obj") + ":2: vertex -2 is named, the file has 1 so far"},
      {"v 0 0 0\nf 1/1 1/1 1/1\n",
       at("a.obj") + ":2: texture coordinate 1 is named, the file has 0 so far"},
      {"v 0 0 0\nf 1 a 1\n", at("a.obj") + ":2: found \"a\", expected the number of a vertex"},
      {"mtllib m.mtl\n", at("m.mtl") + ":2: found \"x\", expected a number"},
      {"mtllib n.mtl\n",
       at("n.mtl") + ":2: names the picture " + at("none.png") + ", which is not there"},
      {"mtllib no.mtl\n",
       at("a.obj") + ":1: names the materials " + at("no.mtl") + ", which is not there"},
  };
  for (const auto& test : kCases) EXPECT_EQ(error_text(obj(test.text)), test.expected);
  write("a.png", "PNG");
  EXPECT_NE(error_text(decode_texture({'P', 'N', 'G'}, "x")).find("x: is no picture"),
            std::string::npos);
}

TEST_F(MeshTest, ModelsOfAScenesAreNamedWhereTheyAreMissing) {
  const auto with = [](const std::string& model) {
    return error_text(
        parse_scene(R"({"schema": "shale-scene/1", "frames": 1, "sun": {"direction": [0, 1, 0]},
      "camera": {"path": [{"frame": 0, "eye": [0, 0, 1], "target": [0, 0, 0]}]}, "models": {"m": )" +
                    model + "}}"));
  };
  EXPECT_EQ(
      with(
          R"({"package": "sweethome3d-furniture", "version": "1.8-1", "library": "None", "model": "x"})"),
      "scene.models.m: needs the package sweethome3d-furniture (1.8-1), which has "
      "/usr/share/sweethome3d/furniture/None.sh3f: apt-get install sweethome3d-furniture");
  EXPECT_EQ(
      with(R"({"file": "x.fbx"})"),
      "scene.models.m: \"file\" is \"x.fbx\", expected one that ends with .obj, .gltf or .glb");
  EXPECT_EQ(with(R"({"package": "quake"})"),
            "scene.models.m: \"package\" is \"quake\", expected one of sweethome3d-furniture, "
            "openarena-081-maps");
}

/// A level of one quad and one patch, in the layout of IBSP 46.
std::vector<uint8_t> small_level() {
  std::vector<uint8_t> bytes(8 + 17 * 8);
  const auto put = [&](size_t at, uint32_t value) { std::memcpy(&bytes[at], &value, 4); };
  std::memcpy(bytes.data(), "IBSP", 4);
  put(4, 46);
  const auto lump = [&](size_t index, size_t size) {
    put(8 + 8 * index, static_cast<uint32_t>(bytes.size()));
    put(12 + 8 * index, static_cast<uint32_t>(size));
    bytes.resize(bytes.size() + size);
    return bytes.size() - size;
  };
  const size_t textures = lump(1, 2 * 72);
  std::memcpy(&bytes[textures], "textures/stone", 14);
  std::memcpy(&bytes[textures + 72], "textures/common/clip", 20);
  const size_t vertices = lump(10, 13 * 44);
  for (size_t i = 0; i < 13; ++i) {
    // A quad of 100 units, and a net of 3x3 over the same.
    const size_t x = i < 4 ? i % 2 : (i - 4) % 3, y = i < 4 ? i / 2 : (i - 4) / 3;
    const float step = i < 4 ? 100.0f : 50.0f;
    const std::array<float, 10> v{static_cast<float>(x) * step,
                                  static_cast<float>(y) * step,
                                  0,
                                  static_cast<float>(x),
                                  static_cast<float>(y),
                                  0,
                                  0,
                                  0,
                                  0,
                                  1};
    std::memcpy(&bytes[vertices + 44 * i], v.data(), sizeof(v));
  }
  const size_t corners = lump(11, 6 * 4);
  for (size_t i = 0; i < 6; ++i) put(corners + 4 * i, std::array<uint32_t, 6>{0, 1, 2, 2, 1, 3}[i]);
  const size_t faces = lump(13, 3 * 104);
  const auto face = [&](size_t index, uint32_t texture, uint32_t type, uint32_t first,
                        uint32_t count, uint32_t indices, uint32_t side) {
    const size_t at = faces + 104 * index;
    for (const auto& [offset, value] : {std::pair{0u, texture},
                                        {8u, type},
                                        {12u, first},
                                        {16u, count},
                                        {20u, 0u},
                                        {24u, indices},
                                        {96u, side},
                                        {100u, side}})
      put(at + offset, value);
  };
  face(0, 0, 1, 0, 4, 6, 0);
  face(1, 0, 2, 4, 9, 0, 3);
  face(2, 1, 1, 0, 4, 6, 0);  // never drawn
  return bytes;
}

TEST_F(MeshTest, LevelsAreReadWithTheirPatches) {
  fs::create_directories(root_ / "textures");
  write_tga("textures/stone.tga", 1, 1, {10, 20, 30, 255});
  const auto archive = open_folder(root_.string());
  const std::vector<uint8_t> bytes = small_level();
  must(write_file(at("l.bsp"), bytes));
  const MeshModel model = must(load_level({archive.get()}, "l.bsp"));
  ASSERT_EQ(model.triangles.size(), 2u + 72u);
  EXPECT_EQ(model.textures.size(), 1u);
  // x right, y of the level is away: 100 units are 3 m.
  EXPECT_EQ(model.triangles[1].at[2], (Float3{3, 0, -3}));
  EXPECT_EQ(model.triangles[0].normal[0], (Float3{0, 1, 0}));
  double area = 0;
  for (size_t i = 2; i < model.triangles.size(); ++i) {
    const auto& t = model.triangles[i].at;
    area += std::abs((t[1][0] - t[0][0]) * (t[2][2] - t[0][2]) -
                     (t[2][0] - t[0][0]) * (t[1][2] - t[0][2])) /
            2;
  }
  EXPECT_NEAR(area, 9, 1e-4);  // a flat patch covers its square
  // Cut short or of other bytes: an error or a level, never more.
  for (size_t size = 0; size < bytes.size(); size += 61) {
    must(write_file(at("l.bsp"), std::span(bytes).first(size)));
    EXPECT_NE(error_text(load_level({archive.get()}, "l.bsp")).find(at("l.bsp")),
              std::string::npos);
  }
  std::mt19937 random(2);
  for (int round = 0; round < 300; ++round) {
    std::vector<uint8_t> broken = bytes;
    for (int i = 0; i < 6; ++i)
      broken[4 + random() % (broken.size() - 4)] = static_cast<uint8_t>(random());
    must(write_file(at("l.bsp"), broken));
    (void)load_level({archive.get()}, "l.bsp");
  }
  std::vector<uint8_t> wrong = bytes;
  wrong[4] = 47;
  must(write_file(at("l.bsp"), wrong));
  EXPECT_EQ(error_text(load_level({archive.get()}, "l.bsp")),
            at("l.bsp") + ": is no level of IBSP version 46");
}

TEST_F(MeshTest, GltfNodesStandInTheirPlaces) {
  // Three positions in a buffer, under two nodes: moved by (1, 2, 3), then twice as large.
  std::vector<float> positions{0, 0, 0, 1, 0, 0, 0, 1, 0};
  std::vector<uint8_t> buffer(36);
  std::memcpy(buffer.data(), positions.data(), 36);
  must(write_file(at("b.bin"), buffer));
  const auto text = [](const std::string& count) {
    return R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
      "nodes": [{"translation": [1, 2, 3], "children": [1]}, {"scale": [2, 2, 2], "mesh": 0}],
      "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1, 1]}, "alphaMode": "MASK"}],
      "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
      "accessors": [{"bufferView": 0, "componentType": 5126, "count": )" +
           count + R"(, "type": "VEC3"}],
      "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": "b.bin", "byteLength": 36}]})";
  };
  write("a.gltf", text("3"));
  const auto archive = open_folder(root_.string());
  const MeshModel model = must(load_gltf(*archive, "a.gltf"));
  ASSERT_EQ(model.triangles.size(), 1u);
  EXPECT_EQ(model.triangles[0].at[1], (Float3{3, 2, 3}));
  EXPECT_EQ(model.triangles[0].at[2], (Float3{1, 4, 3}));
  EXPECT_EQ(model.materials[0].color, (Float3{0.5f, 0.25f, 1}));
  write("a.gltf", text("4"));
  EXPECT_EQ(error_text(load_gltf(*archive, "a.gltf")),
            at("a.gltf") + ": accessor 0 with 4 elements ends behind its buffer of 36 bytes");
  write("a.gltf", "{");
  EXPECT_EQ(error_text(load_gltf(*archive, "a.gltf")),
            at("a.gltf") + ": is no glTF that can be read: is not valid JSON at byte 2");
}

// A small file may name much: what it asks for is bounded, and what lies outside it is not read.
TEST_F(MeshTest, GltfThatAsksForTooMuchIsRefused) {
  const auto archive = open_folder(root_.string());
  const auto refusal = [&](const std::string& rest) {
    write("a.gltf",
          R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}])" + rest + "}");
    return error_text(load_gltf(*archive, "a.gltf"));
  };
  EXPECT_EQ(refusal(", \"extras\": " + std::string(200000, '[') + std::string(200000, ']')),
            at("a.gltf") + ": is no glTF that can be read: is nested deeper than 64 levels");
  std::string nodes = "{}";
  for (int i = 0; i < 40; ++i)
    nodes = fmt::format(R"({{"children": [{0}, {0}]}}, )", 40 - i) + nodes;
  EXPECT_EQ(refusal(", \"nodes\": [" + nodes + "]"),
            at("a.gltf") + ": more than 100000 nodes are shown");
  const std::string buffer =
      R"(, "nodes": [{}], "buffers": [{"byteLength": 3, "uri": "data:application/octet-stream;base64,AAAA"}])";
  EXPECT_EQ(refusal(buffer +
                    R"(, "bufferViews": [{"buffer": 0, "byteOffset": 1000000000, "byteLength": 36}],
      "images": [{"bufferView": 0, "mimeType": "image/png", "name": "far"}])"),
            at("a.gltf") + ": image \"far\" ends behind its buffer of 3 bytes");
  EXPECT_NE(refusal(R"(, "nodes": [{}], "buffers": [{"byteLength": 3, "uri": "../"}])")
                .find("is a folder"),
            std::string::npos);
}

TEST_F(MeshTest, GltfMaterialsCutOutAtTheirOwnCutoff) {
  std::vector<uint8_t> buffer(36);
  must(write_file(at("b.bin"), buffer));
  write_tga("t.tga", 2, 1, {9, 9, 9, 100, 9, 9, 9, 200});
  const auto text = [](const std::string& materials) {
    return R"({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
      "images": [{"uri": "t.tga"}], "textures": [{"source": 0}], "materials": [)" +
           materials + R"(],
      "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
      "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
      "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": "b.bin", "byteLength": 36}]})";
  };
  const auto material = [](const std::string& alpha, const std::string& mask) {
    return R"({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, )" + alpha +
           R"(], "baseColorTexture": {"index": 0}})" + mask + "}";
  };
  const std::string masks = R"(, "alphaMode": "MASK")";
  const auto archive = open_folder(root_.string());
  write("a.gltf",
        text(material("1", "") + "," + material("1", masks) + "," +
             material("1", masks + R"(, "alphaCutoff": 0.3)") + "," + material("0.5", masks) + "," +
             material("1", masks + R"(, "alphaCutoff": 1.5)") + "," +
             material("1", masks + R"(, "alphaCutoff": 0)")));
  const MeshModel model = must(load_gltf(*archive, "a.gltf"));
  // Of the two texels, of alpha 100 and 200 of 255, which stay.
  const auto kept = [&](size_t index) {
    const MeshMaterial& m = model.materials[index];
    const auto& pixels = model.textures[static_cast<size_t>(m.texture)].pixels;
    return std::array{!m.cut_out || pixels[3] >= 128, !m.cut_out || pixels[7] >= 128};
  };
  EXPECT_EQ(kept(0), (std::array{true, true}));
  EXPECT_EQ(kept(1), (std::array{false, true}));
  EXPECT_EQ(kept(2), (std::array{true, true}));
  EXPECT_EQ(kept(3), (std::array{false, false}));
  EXPECT_EQ(kept(4), (std::array{false, false}));
  EXPECT_EQ(kept(5), (std::array{true, true}));
  EXPECT_EQ(model.textures.size(), 4u);
}

// --- Rays ---

TEST(Bvh, EveryBoxIsInOneLeafWithinItsParents) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> part(0, 1);
  for (const size_t count : {1u, 2u, 5u, 1000u}) {
    for (const bool same : {false, true}) {
      std::vector<Box> boxes(count);
      for (Box& box : boxes) {
        for (size_t a = 0; a < 3; ++a) {
          box.low[a] = same ? 1 : part(random) * 10;
          box.high[a] = box.low[a] + (same ? 0 : part(random));
        }
      }
      const Bvh tree = build_bvh(boxes, 4);
      EXPECT_LE(tree.depth, 60u);
      EXPECT_EQ(tree.nodes[0].next, tree.nodes.size());
      std::vector<int> seen(count);
      for (size_t i = 0; i < tree.nodes.size(); ++i) {
        const BvhNode& node = tree.nodes[i];
        EXPECT_LE(node.count, 4u);
        for (uint32_t k = node.first; k < node.first + node.count; ++k) ++seen[tree.order[k]];
        for (uint32_t k = static_cast<uint32_t>(i) + 1; k < node.next; ++k)
          for (size_t a = 0; a < 3; ++a) {
            ASSERT_GE(tree.nodes[k].box.low[a], node.box.low[a]);
            ASSERT_LE(tree.nodes[k].box.high[a], node.box.high[a]);
          }
      }
      for (const int times : seen) EXPECT_EQ(times, 1);
    }
  }
}

constexpr const char* kFront =
    R"("fov_y": 60, "path": [{"frame": 0, "eye": [0, 0, 4], "target": [0, 0, 0]}])";

TEST_F(MeshTest, RaysMeetTheNearestOfManyTriangles) {
  std::mt19937 random(9);
  std::uniform_real_distribution<double> part(-1, 1);
  std::string text;
  std::vector<std::array<Vec3, 3>> soup;
  for (int i = 0; i < 400; ++i) {
    const Vec3 middle{2 * part(random), part(random), part(random)};
    std::array<Vec3, 3> t;
    for (Vec3& corner : t) {
      corner = middle + Vec3{part(random), part(random), part(random)} * 0.3;
      text += fmt::format("v {:.9g} {:.9g} {:.9g}\n", corner.x, corner.y, corner.z);
    }
    soup.push_back(t);
    text += "f -3 -2 -1\n";
  }
  write("a.obj", text);
  // Twice, one of them turned and smaller.
  const Scene scene = must(scene_of("a.obj", R"({"shape": "mesh", "model": "m"},
    {"shape": "mesh", "model": "m", "at": [0.3, -0.5, 0.2], "rotate": [20, 130, 40]})",
                                    kFront));
  const FramePoses poses = frame_poses(scene, 0, false);
  const Extent size{96, 72};
  const Projection p = projection_of(scene.camera, size, false);
  const auto source = source_of(scene, size, size);
  const SourceFrame frame = must(source->frame(0, false));
  size_t hits = 0, off = 0;
  for (uint32_t y = 0; y < size.height; ++y)
    for (uint32_t x = 0; x < size.width; ++x) {
      const double sx = x + 0.5 + frame.camera.jitter[0], sy = y + 0.5 + frame.camera.jitter[1];
      const Vec3 d = poses.camera.forward +
                     poses.camera.right * ((sx / size.width * 2 - 1) * p.tan_x) +
                     poses.camera.up * ((1 - sy / size.height * 2) * p.tan_y);
      double nearest = 1e30;
      for (const Instance& instance : scene.instances)
        for (const auto& t : soup) {
          const Affine& pose = poses.nodes[static_cast<size_t>(instance.node)];
          const Vec3 a = pose.point(t[0]), e1 = pose.point(t[1]) - a, e2 = pose.point(t[2]) - a;
          const Vec3 q = cross(d, e2), from = poses.camera.eye - a, r = cross(from, e1);
          const double scale = dot(e1, q), u = dot(from, q) / scale, v = dot(d, r) / scale;
          const double at = dot(e2, r) / scale;
          if (u >= 0 && v >= 0 && u + v <= 1 && at > 0.05) nearest = std::min(nearest, at);
        }
      const float depth = *frame.depth.at(x, y);
      const double z = depth == 1 ? 1e30 : p.b / (depth - p.a);
      hits += nearest < 1e30 ? 1 : 0;
      // An edge in float may fall to the other side.
      if (std::abs(z - nearest) > 1e-4 * std::min(nearest, z)) ++off;
    }
  EXPECT_GT(hits, 2000u);
  EXPECT_LE(off, 6u);
}

/// A box of six quads with corners at +-1, with texture coordinates.
std::string box_text() {
  std::string text = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";
  for (int i = 0; i < 8; ++i)
    text += fmt::format("v {} {} {}\n", i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
  for (const auto& f : {std::array{1, 2, 4, 3},
                        {5, 6, 8, 7},
                        {1, 2, 6, 5},
                        {3, 4, 8, 7},
                        {1, 3, 7, 5},
                        {2, 4, 8, 6}})
    text += fmt::format("f {}/1 {}/2 {}/3 {}/4\n", f[0], f[1], f[2], f[3]);
  return text;
}

TEST_F(MeshTest, MotionReprojectsAsForPrimitives) {
  write("a.obj", box_text());
  const Scene scene = must(scene_of(
      "a.obj", R"({"at": [0.2, 0.1, -1], "animate": {"interpolation": "linear",
      "path": [{"frame": 0, "at": [-0.5, 0, 0]}, {"frame": 5, "at": [0.7, 0.3, 0.4]}], "spin": {"axis": [0.3, 1, 0.2], "degrees": 9}},
      "scatter": {"count": 1, "area": [0, 0, 0], "scale": [0.8, 0.8]}, "objects": [{"shape": "mesh", "model": "m"}]})",
      R"("fov_y": 55, "interpolation": "linear", "path": [{"frame": 0, "eye": [-1, 1.6, 5], "target": [0, 0, 0]},
         {"frame": 5, "eye": [1.2, 1.9, 4.2], "target": [0.3, 0.2, -0.3], "roll": 6}])"));
  const Extent size{96, 54};
  const FramePoses poses = frame_poses(scene, 3, true);
  const Projection p = projection_of(scene.camera, size, false);
  const auto source = source_of(scene, size, size);
  must(source->frame(2, false));
  const SourceFrame frame = must(source->frame(3, false));
  const auto node = static_cast<size_t>(scene.instances[0].node);
  size_t seen = 0;
  double largest = 0;
  for (uint32_t y = 0; y < size.height; ++y)
    for (uint32_t x = 0; x < size.width; ++x) {
      const float depth = *frame.depth.at(x, y);
      const float* m = frame.motion.at(x, y);
      if (depth == 1) continue;
      const double sx = x + 0.5 + frame.camera.jitter[0], sy = y + 0.5 + frame.camera.jitter[1];
      const Vec3 d = poses.camera.forward +
                     poses.camera.right * ((sx / size.width * 2 - 1) * p.tan_x) +
                     poses.camera.up * ((1 - sy / size.height * 2) * p.tan_y);
      const Vec3 at = poses.camera.eye + d * (p.b / (depth - p.a));
      const Vec3 local = inverse_orthogonal(poses.nodes[node]).point(at);
      EXPECT_NEAR(std::max({std::abs(local.x), std::abs(local.y), std::abs(local.z)}), 1, 2e-3);
      const Vec3 was = poses.nodes_was[node].point(local) - poses.camera_was.eye;
      const double z = dot(was, poses.camera_was.forward);
      const double u = 0.5 + 0.5 * dot(was, poses.camera_was.right) / (z * p.tan_x);
      const double v = 0.5 - 0.5 * dot(was, poses.camera_was.up) / (z * p.tan_y);
      // As for primitives: depth in float places a point to 1e-5 m here.
      EXPECT_NEAR(m[0], sx / size.width - u, 1e-5);
      EXPECT_NEAR(m[1], sy / size.height - v, 1e-5);
      largest = std::max(largest, std::hypot(double{m[0]}, double{m[1]}));
      ++seen;
    }
  EXPECT_GT(seen, 300u);
  EXPECT_GT(largest, 0.01);
}

TEST_F(MeshTest, ATexturedQuadIsTheMeanOfItsTexelsAtEveryLevel) {
  // A quad of 2 m with a picture of 32x32, seen head on: at a distance of z a pixel is
  // 2 tan(30) z / 64 m, which is 32 / 2 times as many texels.
  constexpr uint32_t kSide = 32;
  std::mt19937 random(4);
  std::vector<uint8_t> rgba;
  for (uint32_t i = 0; i < kSide * kSide; ++i)
    for (int c = 0; c < 4; ++c)
      rgba.push_back(c == 3 ? 255 : static_cast<uint8_t>(random() & 1 ? 255 : 40));
  write_tga("p.tga", kSide, kSide, rgba);
  write("m.mtl", "newmtl a\nmap_Kd p.tga\n");
  write("a.obj",
        "mtllib m.mtl\nusemtl a\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 "
        "1\nvt 0 1\n"
        "f 1/1 2/2 3/3 4/4\n");
  const auto linear = [](uint8_t byte) {
    const double c = byte / 255.0;
    return c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4);
  };
  const Extent size{64, 64};
  const double tan = std::tan(30 * 3.14159265358979 / 180);
  for (const double level : {0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 1.5}) {
    const double z = std::exp2(level) / (kSide / 2.0) * size.width / (2 * tan);
    const Scene scene = must(scene_of(
        "a.obj", R"({"shape": "mesh", "model": "m"})",
        fmt::format(
            R"("fov_y": 60, "path": [{{"frame": 0, "eye": [0, 0, {:.12g}], "target": [0, 0, 0]}}])",
            z)));
    const SourceFrame frame = must(source_of(scene, size, size)->frame(0, false));
    // Bilinear between means of 2^l x 2^l texels, repeated over the edge.
    const auto at_level = [&](int l, double u, double v, int c) {
      const int side = static_cast<int>(kSide) >> l;
      const auto texel = [&](int i, int j) {
        i = (i + side) % side;
        j = (j + side) % side;
        double sum = 0;
        for (int y = j << l; y < (j + 1) << l; ++y)
          for (int x = i << l; x < (i + 1) << l; ++x)
            sum += linear(rgba[static_cast<size_t>(4 * (y * static_cast<int>(kSide) + x) + c)]);
        return sum / (1 << (2 * l));
      };
      const double x = u * side - 0.5, y = v * side - 0.5;
      const int i = static_cast<int>(std::floor(x)), j = static_cast<int>(std::floor(y));
      const double a = x - i, b = y - j;
      return (1 - b) * ((1 - a) * texel(i, j) + a * texel(i + 1, j)) +
             b * ((1 - a) * texel(i, j + 1) + a * texel(i + 1, j + 1));
    };
    size_t seen = 0;
    for (uint32_t y = 0; y < size.height; ++y)
      for (uint32_t x = 0; x < size.width; ++x) {
        if (*frame.depth.at(x, y) == 1) continue;
        ++seen;
        const double u =
            ((x + 0.5 + frame.camera.jitter[0]) / size.width * 2 - 1) * tan * z / 2 + 0.5;
        const double v =
            ((y + 0.5 + frame.camera.jitter[1]) / size.height * 2 - 1) * tan * z / 2 + 0.5;
        for (int c = 0; c < 3; ++c) {
          const int l = static_cast<int>(level);
          const double part = level - l;
          const double expected = (1 - part) * at_level(l, u, v, c) +
                                  (part > 0 ? part * at_level(std::min(l + 1, 5), u, v, c) : 0.0);
          // Roots in 8 bits: a step is 2 / 255 at most, half of it is rounded. The level is off by
          // 1e-5, a texel's place by 1e-4.
          EXPECT_NEAR(frame.color.at(x, y)[c], expected, 1.0 / 255 + 5e-4)
              << level << " at " << x << "," << y;
        }
      }
    EXPECT_GT(seen, level < 5 ? 3u : 0u) << level;
  }
}

TEST_F(MeshTest, AlphaLeavesHolesForEyesAndForLight) {
  // Left half there, right half not; a floor behind, lit head on.
  write_tga("p.tga", 2, 1, {255, 255, 255, 255, 255, 255, 255, 0});
  write("m.mtl", "newmtl a\nmap_Kd p.tga\n");
  write("a.obj",
        "mtllib m.mtl\nusemtl a\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 "
        "1\nvt 0 1\n"
        "f 1/1 2/2 3/3 4/4\n");
  std::string text = R"({"schema": "shale-scene/1", "frames": 1,
    "camera": {"fov_y": 40, "path": [{"frame": 0, "eye": [4, 0, 5], "target": [0, 0, 0]}]},
    "sun": {"direction": [0, 0, 1], "color": [1, 1, 1]},
    "sky": {"zenith": [0, 0, 0], "horizon": [0, 0, 0], "ground": [0, 0, 0], "ambient": [0, 0, 0]},
    "materials": {"white": {"color": [1, 1, 1]}}, "models": {"m": {"file": "a.obj"}},
    "objects": [{"shape": "quad", "at": [0, 0, -2], "size": [60, 60], "material": "white"}, {"shape": "mesh", "model": "m"}]})";
  const Scene scene = must(parse_scene(text, root_.string()));
  const Extent size{80, 60};
  const CameraPose pose = camera_pose(scene.camera, 0);
  const Projection p = projection_of(scene.camera, size, false);
  const SourceFrame frame = must(source_of(scene, size, size)->frame(0, false));
  size_t cards = 0, shadows = 0, lit = 0;
  for (uint32_t y = 0; y < size.height; ++y)
    for (uint32_t x = 0; x < size.width; ++x) {
      const double sx = x + 0.5 + frame.camera.jitter[0], sy = y + 0.5 + frame.camera.jitter[1];
      const Vec3 d = pose.forward + pose.right * ((sx / size.width * 2 - 1) * p.tan_x) +
                     pose.up * ((1 - sy / size.height * 2) * p.tan_y);
      const Vec3 card = pose.eye + d * (-pose.eye.z / d.z),
                 wall = pose.eye + d * ((-2 - pose.eye.z) / d.z);
      const auto solid = [](const Vec3& at, double margin) {
        return at.x > -1 + margin && at.x < -margin && std::abs(at.y) < 1 - margin;
      };
      const double z = p.b / (*frame.depth.at(x, y) - p.a);
      const bool on_card = std::abs(dot(card - pose.eye, pose.forward) - z) < 0.05;
      // Away from the edges by 0.02 m.
      if (solid(card, -0.02) != solid(card, 0.02)) continue;
      EXPECT_EQ(on_card, solid(card, 0)) << x << "," << y;
      if (on_card) {
        ++cards;
        continue;
      }
      if (solid(wall, -0.02) != solid(wall, 0.02)) continue;
      const bool dark = solid(wall, 0);
      EXPECT_EQ(*frame.color.at(x, y) == 0, dark) << x << "," << y;
      ++(dark ? shadows : lit);
    }
  EXPECT_GT(cards, 50u);
  EXPECT_GT(shadows, 50u);
  EXPECT_GT(lit, 500u);
}

}  // namespace
}  // namespace shale
