#include "tools/scene/tables.h"

#include <algorithm>
#include <bit>
#include <limits>

#include "tools/scene/bvh.h"

namespace shale {
namespace {

constexpr double kDegrees = 3.14159265358979323846 / 180;
constexpr int32_t kSmallestTileLog2 = 3;
constexpr int32_t kLargestTileLog2 = 12;
constexpr uint32_t kMostEntries = 1u << 24;  ///< 128 MiB; with more, tiles are made larger
/// Positions are rounded to float on the device; that is far less than this part of a pixel.
constexpr double kPixelMargin = 1.0 / 64;

Float4 float4(const Vec3& v, double w) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z),
          static_cast<float>(w)};
}

/// Whole numbers below 2^24 stand in texels as floats: bits of small integers would be denormal.
float number(uint32_t value) { return static_cast<float>(value); }

/// Corners of a primitive's box in world space; 4 for a quad, which is flat, else 8. Edges connect
/// corners whose numbers differ in one bit.
struct Corners {
  std::array<Vec3, 8> at;
  uint32_t count = 8;
};

Corners corners_of(const Primitive& primitive, const Affine& to_world) {
  Corners corners;
  corners.count = primitive.shape == PrimitiveShape::kQuad ? 4 : 8;
  for (uint32_t i = 0; i < corners.count; ++i) {
    const Vec3 unit{i & 1 ? 1.0 : -1.0, i & 2 ? 1.0 : -1.0,
                    corners.count == 4 ? 0.0 : (i & 4 ? 1.0 : -1.0)};
    corners.at[i] = to_world.point(unit);
  }
  return corners;
}

/// A list that is filled in two rounds over the same pairs: count, then store.
class CellLists {
 public:
  CellLists(int32_t columns, int32_t rows, size_t most)
      : columns_(columns),
        most_(most),
        counts_(static_cast<size_t>(columns) * static_cast<size_t>(rows)) {}

  void add(int32_t column, int32_t row, const Uint2& entry) {
    if (entries() >= most_) return;
    const auto cell = static_cast<uint32_t>(row * columns_ + column);
    ++counts_[cell];
    pairs_.push_back({cell, entry});
  }
  size_t entries() const { return pairs_.size(); }
  size_t cells() const { return counts_.size(); }
  uint32_t count(size_t cell) const { return counts_[cell]; }

  /// Appends the entries, those of a cell together and in the order they were added; `first` gets
  /// where each cell starts.
  void append_to(std::vector<Uint2>& lists, std::vector<uint32_t>& first) const {
    first.resize(counts_.size());
    uint32_t at = static_cast<uint32_t>(lists.size());
    for (size_t i = 0; i < counts_.size(); ++i) {
      first[i] = at;
      at += counts_[i];
    }
    lists.resize(at);
    std::vector<uint32_t> next = first;
    for (const auto& [cell, entry] : pairs_) lists[next[cell]++] = entry;
  }

 private:
  int32_t columns_;
  size_t most_;  ///< entries; a list that is so long does not fit and is thrown away
  std::vector<uint32_t> counts_;
  std::vector<std::pair<uint32_t, Uint2>> pairs_;
};

/// Bits: primitive 0..15, shape 16..17, cutout 18..20.
uint32_t entry_bits(uint32_t index, const Primitive& primitive, const Material& material) {
  return index | static_cast<uint32_t>(primitive.shape) << 16 |
         static_cast<uint32_t>(material.cutout) << 18;
}

struct Posed {
  Affine to_world;  ///< of the unit shape, relative to the eye
  Corners corners;  ///< relative to the eye
};

/// A primitive as the picture sees it.
struct Seen {
  uint32_t index;
  double nearest;               ///< smallest view z
  std::vector<Point2> outline;  ///< in output pixels of the whole picture
};

class Tables {
 public:
  Tables(const Scene& scene, const FramePoses& poses, const Window& window, bool reverse_depth)
      : scene_(scene),
        poses_(poses),
        window_(window),
        reverse_(reverse_depth),
        projection_(projection_of(scene.camera, window.full, reverse_depth)) {}

  Result<FrameTables> build(uint32_t max_texels) {
    pose_primitives();
    fill_block();
    add_primitives();
    add_materials();
    add_particles();
    add_caster_tree();
    if (tables_.texels.size() > max_texels)
      return unsupported(scene_.name, "needs {} texels, the device binds {}", tables_.texels.size(),
                         max_texels);
    see_primitives();
    for (int32_t log2 = kSmallestTileLog2; log2 <= kLargestTileLog2; ++log2) {
      // Coarser cells for the shadows as well: both lists share the buffer.
      const double coarser = std::ldexp(1.0, log2 - kSmallestTileLog2);
      tables_.lists.clear();
      most_entries_ = std::min(max_texels, kMostEntries);
      add_tiles(log2);
      add_shadow_grid(coarser);
      if (tables_.lists.size() < most_entries_) return std::move(tables_);
    }
    return unsupported(scene_.name, "needs more than {} list entries", most_entries_);
  }

 private:
  Vec3 view(const Vec3& relative) const {
    return {dot(relative, poses_.camera.right), dot(relative, poses_.camera.up),
            dot(relative, poses_.camera.forward)};
  }
  /// View coordinates to output pixels of the whole picture.
  Point2 pixel(const Vec3& v) const {
    return {(v.x / (v.z * projection_.tan_x) * 0.5 + 0.5) * window_.full.width,
            (0.5 - v.y / (v.z * projection_.tan_y) * 0.5) * window_.full.height};
  }
  double farthest() const { return scene_.camera.far_plane > 0 ? scene_.camera.far_plane : 1e30; }

  void pose_primitives() {
    for (const Primitive& primitive : scene_.primitives) {
      Posed posed;
      posed.to_world = unit_to_world(primitive, poses_.nodes);
      posed.to_world.at = posed.to_world.at - poses_.camera.eye;
      posed.corners = corners_of(primitive, posed.to_world);
      posed_.push_back(posed);
    }
  }

  static Affine unit_to_world(const Primitive& primitive, const std::vector<Affine>& nodes) {
    Affine result = nodes[static_cast<size_t>(primitive.node)];
    result.x = result.x * primitive.half.x;
    result.y = result.y * primitive.half.y;
    result.z = result.z * primitive.half.z;
    return result;
  }

  void fill_block() {
    FrameBlock& b = tables_.block;
    const CameraPose& c = poses_.camera;
    const double w = window_.full.width, h = window_.full.height;
    b.corner = float4(c.forward - c.right * projection_.tan_x + c.up * projection_.tan_y, 0);
    b.step_x = float4(c.right * (2 * projection_.tan_x / w), 0);
    b.step_y = float4(c.up * (-2 * projection_.tan_y / h), 0);
    b.depth = {static_cast<float>(scene_.camera.near_plane), static_cast<float>(farthest()),
               static_cast<float>(projection_.a), static_cast<float>(projection_.b)};
    b.size = {static_cast<float>(w), static_cast<float>(h), static_cast<float>(1 / w),
              static_cast<float>(1 / h)};
    b.window = {static_cast<float>(window_.x), static_cast<float>(window_.y),
                static_cast<float>(w / window_.size.width),
                static_cast<float>(h / window_.size.height)};
    const CameraPose& was = poses_.camera_was;
    b.sky_was[0] = float4(was.right * (1 / projection_.tan_x), 0);
    b.sky_was[1] = float4(was.up * (1 / projection_.tan_y), 0);
    b.sky_was[2] = float4(was.forward, 0);
    const Vec3 sun = sun_direction(scene_.sun, poses_.frame);
    b.sun = float4(sun, std::cos(scene_.sun.disc / 2 * kDegrees));
    b.sun_color = float4(scene_.sun.color * signal(scene_.sun.signal), scene_.sun.disc > 0 ? 8 : 0);
    const Vec3 sky = signal(scene_.sky.signal);
    b.zenith = float4(scene_.sky.zenith * sky, scene_.sky.clouds);
    b.horizon = float4(scene_.sky.horizon * sky, scene_.sky.fog);
    b.ground = float4(scene_.sky.ground * sky, scene_.sky.stars);
    b.ambient = float4(scene_.sky.ambient * sky, exposure_at(scene_, poses_.frame));
    fill_lights();
    fill_harmonics(sky);
    for (Float4& value : b.overlays) value = {};
    for (size_t i = 0; i < scene_.overlays.size(); ++i) {
      const Overlay& o = scene_.overlays[i];
      Float4* at = &b.overlays[4 * i];
      // Without size nothing is inside.
      if (poses_.frame < o.first || poses_.frame > o.last || o.width == 0 || o.height == 0)
        continue;
      at[0] = {static_cast<float>(o.x), static_cast<float>(o.y), static_cast<float>(o.width),
               static_cast<float>(o.height)};
      at[1] = float4(o.color, o.rows);
      at[2] = float4(o.background, o.opacity);
      at[3] = {static_cast<float>(o.scroll * poses_.frame),
               static_cast<float>(o.width * w / (o.height * h)),
               number(scene_hash(scene_.seed, 0x60000000u + static_cast<uint32_t>(i)) >> 8), 0};
    }
    b.bases = {0, 0, 0, same_view() ? 1 : 0};
  }

  Vec3 signal(int index, uint32_t variant = 0) const {
    return signal_value(scene_, index, poses_.frame, variant);
  }

  void fill_lights() {
    std::fill(std::begin(tables_.block.lights), std::end(tables_.block.lights), Float4{});
    for (size_t i = 0; i < scene_.lights.size(); ++i) {
      const Light& light = scene_.lights[i];
      const Affine& pose = poses_.nodes[static_cast<size_t>(light.node)];
      const double outer = std::cos(light.cone_outer / 2 * kDegrees);
      const double inner = std::cos(light.cone_inner / 2 * kDegrees);
      Float4* at = &tables_.block.lights[5 * i];
      at[0] = float4(pose.at - poses_.camera.eye, 1 / (light.range * light.range));
      at[1] = float4(light.color * signal(light.signal, light.variant), 0);
      at[2] = float4(normalized(pose.y * -1, {0, -1, 0}), outer);
      at[3] = float4(pose.x * (light.size_x / 2), inner > outer ? 1 / (inner - outer) : 0);
      at[4] = float4(pose.z * (light.size_z / 2), 0);
    }
  }

  /// Source: Ramamoorthi and Hanrahan, An Efficient Representation for Irradiance Environment Maps,
  /// 2001; the factors of the bands are 1, 2/3 and 1/4 of pi, which the reflection divides away.
  void fill_harmonics(const Vec3& sky) {
    if (!scene_.sky.harmonics) return;
    constexpr double kFactors[9]{
        0.28209479177387814,        0.4886025119029199 * 2 / 3, 0.4886025119029199 * 2 / 3,
        0.4886025119029199 * 2 / 3, 1.0925484305920792 / 4,     1.0925484305920792 / 4,
        0.31539156525252005 / 4,    1.0925484305920792 / 4,     0.5462742152960396 / 4};
    for (size_t i = 0; i < 9; ++i)
      tables_.block.harmonics[i] = float4((*scene_.sky.harmonics)[i] * sky * kFactors[i], 0);
  }

  bool same_view() const { return poses_.camera == poses_.camera_was; }

  void add_primitives() {
    const CameraPose& was = poses_.camera_was;
    for (size_t i = 0; i < scene_.primitives.size(); ++i) {
      const Primitive& primitive = scene_.primitives[i];
      const Material& material = scene_.materials[primitive.material];
      const Affine inverse = inverse_orthogonal(posed_[i].to_world);
      const auto row = [](const Affine& a, int axis) -> Float4 {
        const auto pick = [&](const Vec3& v) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; };
        return {static_cast<float>(pick(a.x)), static_cast<float>(pick(a.y)),
                static_cast<float>(pick(a.z)), static_cast<float>(pick(a.at))};
      };
      for (int axis = 0; axis < 3; ++axis) tables_.texels.push_back(row(inverse, axis));

      Affine before = unit_to_world(primitive, poses_.nodes_was);
      before.at = before.at - was.eye;
      const Affine to_view{
          {was.right.x / projection_.tan_x, was.up.x / projection_.tan_y, was.forward.x},
          {was.right.y / projection_.tan_x, was.up.y / projection_.tan_y, was.forward.y},
          {was.right.z / projection_.tan_x, was.up.z / projection_.tan_y, was.forward.z},
          {}};
      const Affine clip_was = to_view * before;
      for (int axis = 0; axis < 3; ++axis) tables_.texels.push_back(row(clip_was, axis));

      const size_t node = static_cast<size_t>(primitive.node);
      const bool still = same_view() && poses_.nodes[node] == poses_.nodes_was[node];
      tables_.texels.push_back(float4(primitive.half, 0));
      tables_.texels.back()[3] = number(primitive.material | (still ? 0x100u : 0u));
      const auto tint = [&](uint32_t k) {
        return 1 + material.instance_variation *
                       (scene_hash(primitive.seed, k) * 0x1p-32 * 1.6 - 0.8 +
                        (scene_hash(primitive.seed, 7) * 0x1p-32 - 0.5) * 0.4);
      };
      tables_.texels.push_back(float4({tint(4), tint(5), tint(6)}, 0));
      const float seed = number(primitive.seed >> 8);
      tables_.texels.back()[3] = seed;
      tables_.texels.push_back({static_cast<float>(1 / material.cutout_cell),
                                static_cast<float>(material.cutout_amount), seed, 0});
    }
  }

  void add_materials() {
    tables_.block.bases[0] = static_cast<int32_t>(tables_.texels.size());
    for (const Material& m : scene_.materials) {
      tables_.texels.push_back(float4(m.color_a, m.emission_a));
      tables_.texels.push_back(float4(m.color_b, m.emission_b));
      tables_.texels.push_back({static_cast<float>(1 / m.cell_x), static_cast<float>(1 / m.cell_y),
                                static_cast<float>(m.width),
                                number(static_cast<uint32_t>(m.pattern))});
      tables_.texels.push_back({static_cast<float>(m.variation), static_cast<float>(m.grain),
                                static_cast<float>(1 / m.grain_size),
                                static_cast<float>(m.specular)});
      const double drawn = m.change > 0 ? std::floor(poses_.frame / m.change) : 0;
      tables_.texels.push_back(
          {static_cast<float>(m.shininess), static_cast<float>(m.scroll_x * poses_.frame),
           static_cast<float>(m.scroll_y * poses_.frame),
           number(m.change > 0 ? scene_hash(scene_.seed, static_cast<uint32_t>(drawn)) >> 8 : 0)});
      tables_.texels.push_back(float4(signal(m.signal), 0));
    }
  }

  struct SeenParticle {
    double x, y, radius, z;  ///< output pixels, view z
    uint32_t index;
  };

  void add_particles() {
    tables_.block.bases[1] = static_cast<int32_t>(tables_.texels.size());
    const double focal = window_.full.height / (2 * projection_.tan_y);
    uint32_t index = 0;
    for (const Particle& p : particles_at(scene_, poses_.nodes, poses_.frame)) {
      const Vec3 v = view(p.at - poses_.camera.eye);
      if (v.z < std::max(scene_.camera.near_plane, 1e-3) || v.z > farthest()) continue;
      const Point2 at = pixel(v);
      const double radius = p.radius / v.z * focal;
      tables_.texels.push_back({static_cast<float>(at.x), static_cast<float>(at.y),
                                static_cast<float>(p.soft ? -1 / radius : 1 / radius),
                                static_cast<float>(v.z)});
      tables_.texels.push_back(float4(p.color, p.additive ? 0 : p.opacity));
      particles_.push_back({at.x, at.y, radius, v.z, index++});
    }
    std::stable_sort(particles_.begin(), particles_.end(),
                     [](const SeenParticle& a, const SeenParticle& b) { return a.z > b.z; });
  }

  /// A tree of what casts shadows, for rays to lights that have some. A node is two texels: box, and
  /// where its part of the tree ends, negative at the end; the entry of a leaf's primitive, else
  /// negative.
  void add_caster_tree() {
    tables_.block.bases[2] = static_cast<int32_t>(tables_.texels.size());
    if (std::none_of(scene_.lights.begin(), scene_.lights.end(),
                     [](const Light& light) { return light.casts_shadow; }))
      return;
    std::vector<Box> boxes;
    std::vector<uint32_t> indices;
    for (uint32_t i = 0; i < scene_.primitives.size(); ++i) {
      if (!scene_.primitives[i].casts_shadow) continue;
      boxes.push_back(box_of(posed_[i].corners));
      indices.push_back(i);
    }
    const Bvh tree = build_bvh(boxes, 1);
    for (const BvhNode& node : tree.nodes) {
      const Box& b = node.box;
      const bool last = node.next == tree.nodes.size();
      tables_.texels.push_back({b.low[0], b.low[1], b.low[2], last ? -1 : number(node.next)});
      tables_.texels.push_back({b.high[0], b.high[1], b.high[2], -1});
      if (node.count == 0) continue;
      const uint32_t index = indices[tree.order[node.first]];
      const Primitive& primitive = scene_.primitives[index];
      tables_.texels.back()[3] =
          number(entry_bits(index, primitive, scene_.materials[primitive.material]));
    }
    // An empty tree: a box that nothing meets.
    if (tree.nodes.empty()) {
      tables_.texels.push_back({1, 1, 1, -1});
      tables_.texels.push_back({-1, -1, -1, -1});
    }
  }

  /// Slightly larger, since the device computes in float.
  static Box box_of(const Corners& corners) {
    Box box;
    for (uint32_t k = 0; k < corners.count; ++k) {
      const Vec3& p = corners.at[k];
      const double at[3]{p.x, p.y, p.z};
      for (size_t a = 0; a < 3; ++a) {
        const double more = 1e-4 + 1e-6 * std::abs(at[a]);
        box.low[a] = std::min(box.low[a], static_cast<float>(at[a] - more));
        box.high[a] = std::max(box.high[a], static_cast<float>(at[a] + more));
      }
    }
    return box;
  }

  void see_primitives() {
    const double near = scene_.camera.near_plane;
    for (uint32_t i = 0; i < scene_.primitives.size(); ++i) {
      std::array<Vec3, 8> v;
      const Corners& corners = posed_[i].corners;
      for (uint32_t k = 0; k < corners.count; ++k) v[k] = view(corners.at[k]);
      Seen seen{i, std::numeric_limits<double>::infinity(), {}};
      const auto take = [&](const Vec3& at) {
        seen.nearest = std::min(seen.nearest, at.z);
        seen.outline.push_back(pixel(at));
      };
      // Slightly before the near plane: the shader cuts exactly there.
      const double cut = near * 0.999;
      for (uint32_t k = 0; k < corners.count; ++k) {
        if (v[k].z >= cut) take(v[k]);
        for (uint32_t bit = 1; bit < corners.count; bit <<= 1) {
          if (k & bit) continue;
          const Vec3 &a = v[k], &b = v[k | bit];
          if ((a.z < cut) == (b.z < cut)) continue;
          Vec3 at = mix(a, b, (cut - a.z) / (b.z - a.z));
          at.z = cut;
          take(at);
        }
      }
      if (seen.outline.empty() || seen.nearest > farthest()) continue;
      seen_.push_back(std::move(seen));
    }
    std::stable_sort(seen_.begin(), seen_.end(),
                     [](const Seen& a, const Seen& b) { return a.nearest < b.nearest; });
  }

  void add_tiles(int32_t log2) {
    const double side = std::ldexp(1.0, log2);
    const auto count = [&](uint32_t pixels) {
      return static_cast<int32_t>((pixels + (1u << log2) - 1) >> log2);
    };
    const int32_t columns = count(window_.size.width), rows = count(window_.size.height);
    CellLists primitives(columns, rows, most_entries_), particles(columns, rows, most_entries_);
    std::vector<Point2> cells;
    for (const Seen& seen : seen_) {
      const Primitive& primitive = scene_.primitives[seen.index];
      const Material& material = scene_.materials[primitive.material];
      cells.clear();
      for (const Point2& p : seen.outline)
        cells.push_back({(p.x - window_.x) / side, (p.y - window_.y) / side});
      // A little nearer, since the device computes the distance in float.
      const Uint2 entry{
          entry_bits(seen.index, primitive, material),
          std::bit_cast<uint32_t>(static_cast<float>(seen.nearest * (1 - 1e-5) - 1e-5))};
      cover_cells(cells, kPixelMargin / side, columns, rows,
                  [&](int32_t x, int32_t y) { primitives.add(x, y, entry); });
    }
    for (const SeenParticle& p : particles_) {
      const double x = (p.x - window_.x) / side, y = (p.y - window_.y) / side;
      const double r = (p.radius + kPixelMargin) / side;
      const std::array<Point2, 4> box{
          {{x - r, y - r}, {x + r, y - r}, {x - r, y + r}, {x + r, y + r}}};
      cover_cells(box, 0, columns, rows, [&](int32_t cx, int32_t cy) {
        particles.add(cx, cy, {p.index, 0});
      });
    }
    std::vector<Uint2>& out = tables_.lists;
    const size_t base = out.size();
    tables_.block.tiles = {columns, rows, static_cast<int32_t>(base), log2};
    // For a tile: first and number of the primitives, and of the particles.
    out.resize(base + 2 * primitives.cells());
    size_t part = 0;
    for (const CellLists* lists : {&primitives, &particles}) {
      std::vector<uint32_t> first;
      lists->append_to(out, first);
      for (size_t i = 0; i < first.size(); ++i)
        out[base + 2 * i + part] = {first[i], lists->count(i)};
      ++part;
    }
  }

  void add_shadow_grid(double coarser) {
    const Vec3 sun = sun_direction(scene_.sun, poses_.frame);
    const Vec3 helper = std::abs(sun.y) < 0.9 ? Vec3{0, 1, 0} : Vec3{1, 0, 0};
    const Vec3 u = normalized(cross(sun, helper), {1, 0, 0});
    const Vec3 v = cross(sun, u);
    struct Caster {
      uint32_t index;
      double top;
      std::array<Point2, 8> at;
      uint32_t count;
    };
    std::vector<Caster> casters;
    double low_x = 1e30, low_y = 1e30, high_x = -1e30, high_y = -1e30;
    for (uint32_t i = 0; i < scene_.primitives.size(); ++i) {
      if (!scene_.primitives[i].casts_shadow) continue;
      Caster caster{i, -1e30, {}, posed_[i].corners.count};
      for (uint32_t k = 0; k < caster.count; ++k) {
        const Vec3& p = posed_[i].corners.at[k];
        caster.top = std::max(caster.top, dot(sun, p));
        caster.at[k] = {dot(u, p), dot(v, p)};
        low_x = std::min(low_x, caster.at[k].x);
        low_y = std::min(low_y, caster.at[k].y);
        high_x = std::max(high_x, caster.at[k].x);
        high_y = std::max(high_y, caster.at[k].y);
      }
      casters.push_back(caster);
    }
    std::stable_sort(casters.begin(), casters.end(),
                     [](const Caster& a, const Caster& b) { return a.top > b.top; });
    if (casters.empty()) low_x = low_y = high_x = high_y = 0;
    const double width = std::max(high_x - low_x, 1e-3), height = std::max(high_y - low_y, 1e-3);
    // Enough cells that lists stay short, without more cells than the lists are worth.
    const double wanted =
        std::clamp(8.0 * static_cast<double>(casters.size()), 256.0, 16384.0) / (coarser * coarser);
    const double cell = std::max(std::sqrt(width * height / wanted), std::max(width, height) / 512);
    const auto columns = static_cast<int32_t>(std::ceil(width / cell));
    const auto rows = static_cast<int32_t>(std::ceil(height / cell));
    CellLists cells(columns, rows, most_entries_);
    for (const Caster& caster : casters) {
      std::array<Point2, 8> at;
      for (uint32_t k = 0; k < caster.count; ++k)
        at[k] = {(caster.at[k].x - low_x) / cell, (caster.at[k].y - low_y) / cell};
      const Primitive& primitive = scene_.primitives[caster.index];
      const Material& material = scene_.materials[primitive.material];
      const Uint2 entry{entry_bits(caster.index, primitive, material),
                        std::bit_cast<uint32_t>(
                            static_cast<float>(caster.top + std::abs(caster.top) * 1e-5 + 1e-4))};
      cover_cells({at.data(), caster.count}, 1e-3, columns, rows,
                  [&](int32_t x, int32_t y) { cells.add(x, y, entry); });
    }
    FrameBlock& b = tables_.block;
    b.grid_u = float4(u * (1 / cell), -low_x / cell);
    b.grid_v = float4(v * (1 / cell), -low_y / cell);
    std::vector<Uint2>& out = tables_.lists;
    const size_t base = out.size();
    b.grid = {columns, rows, static_cast<int32_t>(base), 0};
    out.resize(base + cells.cells());
    std::vector<uint32_t> first;
    cells.append_to(out, first);
    for (size_t i = 0; i < first.size(); ++i) out[base + i] = {first[i], cells.count(i)};
  }

  const Scene& scene_;
  const FramePoses& poses_;
  const Window window_;
  const bool reverse_;
  const Projection projection_;
  FrameTables tables_{};
  size_t most_entries_ = 0;
  std::vector<Posed> posed_;
  std::vector<Seen> seen_;
  std::vector<SeenParticle> particles_;
};

double cross2(const Point2& o, const Point2& a, const Point2& b) {
  return (a.x - o.x) * (b.y - o.y) - (a.y - o.y) * (b.x - o.x);
}

/// Convex hull by Andrew's monotone chain.
std::vector<Point2> hull_of(std::span<const Point2> points) {
  std::vector<Point2> sorted(points.begin(), points.end());
  std::sort(sorted.begin(), sorted.end(), [](const Point2& a, const Point2& b) {
    return a.x < b.x || (a.x == b.x && a.y < b.y);
  });
  if (sorted.size() < 3) return sorted;
  std::vector<Point2> hull(2 * sorted.size());
  size_t n = 0;
  for (const Point2& p : sorted) {
    while (n >= 2 && cross2(hull[n - 2], hull[n - 1], p) <= 0) --n;
    hull[n++] = p;
  }
  const size_t lower = n + 1;
  for (size_t i = sorted.size() - 1; i-- > 0;) {
    while (n >= lower && cross2(hull[n - 2], hull[n - 1], sorted[i]) <= 0) --n;
    hull[n++] = sorted[i];
  }
  hull.resize(n - 1);
  return hull;
}

}  // namespace

void cover_cells(std::span<const Point2> points, double margin, int32_t columns, int32_t rows,
                 const std::function<void(int32_t, int32_t)>& emit) {
  if (points.empty()) return;
  double low_x = points[0].x, high_x = low_x, low_y = points[0].y, high_y = low_y;
  for (const Point2& p : points) {
    low_x = std::min(low_x, p.x);
    high_x = std::max(high_x, p.x);
    low_y = std::min(low_y, p.y);
    high_y = std::max(high_y, p.y);
  }
  // Comparisons in double first: coordinates may be far outside of what an int can hold.
  if (!(high_x + margin >= 0 && low_x - margin < columns && high_y + margin >= 0 &&
        low_y - margin < rows))
    return;
  const auto cell = [](double at, int32_t count) {
    return static_cast<int32_t>(std::clamp(std::floor(at), 0.0, static_cast<double>(count - 1)));
  };
  const int32_t first_x = cell(low_x - margin, columns), last_x = cell(high_x + margin, columns);
  const int32_t first_y = cell(low_y - margin, rows), last_y = cell(high_y + margin, rows);
  if (first_x == last_x || first_y == last_y) {
    for (int32_t y = first_y; y <= last_y; ++y)
      for (int32_t x = first_x; x <= last_x; ++x) emit(x, y);
    return;
  }
  const std::vector<Point2> hull = hull_of(points);
  for (int32_t y = first_y; y <= last_y; ++y) {
    // The hull within the band of this row lies between the ends of its edges there.
    const double low = y - margin, high = y + 1 + margin;
    double left = std::numeric_limits<double>::infinity(), right = -left;
    for (size_t i = 0; i < hull.size(); ++i) {
      const Point2& a = hull[i];
      const Point2& b = hull[(i + 1) % hull.size()];
      if (std::max(a.y, b.y) < low || std::min(a.y, b.y) > high) continue;
      const auto at = [&](double want, const Point2& end) {
        if (end.y >= low && end.y <= high) return end.x;
        return a.x + (b.x - a.x) * (want - a.y) / (b.y - a.y);
      };
      const double ax = at(a.y < low ? low : high, a), bx = at(b.y < low ? low : high, b);
      left = std::min(left, std::min(ax, bx));
      right = std::max(right, std::max(ax, bx));
    }
    if (!(right + margin >= 0 && left - margin < columns)) continue;
    const int32_t end = cell(right + margin, columns);
    for (int32_t x = cell(left - margin, columns); x <= end; ++x) emit(x, y);
  }
}

Projection projection_of(const SceneCamera& camera, Extent full, bool reverse_depth) {
  Projection p;
  p.tan_y = std::tan(camera.fov_y / 2 * kDegrees);
  p.tan_x = p.tan_y * full.width / full.height;
  const double n = camera.near_plane, f = camera.far_plane;
  if (f > 0) {
    p.a = reverse_depth ? -n / (f - n) : f / (f - n);
    p.b = reverse_depth ? n * f / (f - n) : -n * f / (f - n);
  } else {
    p.a = reverse_depth ? 0 : 1;
    p.b = reverse_depth ? n : -n;
  }
  return p;
}

FramePoses frame_poses(const Scene& scene, double frame, bool continued, double step) {
  FramePoses poses;
  poses.frame = frame;
  poses.camera = camera_pose(scene.camera, frame);
  poses.nodes = node_poses(scene, frame);
  poses.camera_was = continued ? camera_pose(scene.camera, frame - step) : poses.camera;
  poses.nodes_was = continued ? node_poses(scene, frame - step) : poses.nodes;
  return poses;
}

Result<FrameTables> frame_tables(const Scene& scene, const FramePoses& poses, const Window& window,
                                 bool reverse_depth, uint32_t max_texels) {
  return Tables(scene, poses, window, reverse_depth).build(max_texels);
}

}  // namespace shale
