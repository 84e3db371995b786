#version 450
// One frame of a scene by casting rays: colour, depth and motion of one sample a pixel, or of a grid
// of samples whose colours are averaged and whose nearest gives depth and motion.
//
// An invocation is a pixel, a workgroup 8x8 pixels. Primitives are unit shapes in a space of their
// own: `texels` holds 9 RGBA texels for each (tables.cpp). `lists` names, for every tile of the
// picture and every cell of a grid perpendicular to the sun, the primitives that can be met there,
// nearest first; so a ray looks at few, and a shadow ray stays in one cell. Directions are scaled to
// a view z of 1, so a ray's parameter is the view z. Positions are relative to the eye.
//
// CPU drivers run both sides of every branch; so patterns are computed without branches where that
// is not much, and features that a scene lacks are cut off by specialization. No branch or loop hangs
// on uniforms alone: lavapipe would make their values constants, and compile the shader again for
// every submission.
layout(local_size_x = 64) in;

// One bit for each kind of pattern and of cutout that the scene uses.
layout(constant_id = 0) const uint kPatterns = 0xFFFFFFFFu;
layout(constant_id = 1) const uint kCutouts = 0xFFFFFFFFu;
layout(constant_id = 2) const bool kHasRoundCutouts = true;
layout(constant_id = 3) const bool kHasParticles = true;
layout(constant_id = 4) const int kOverlays = 4;
layout(constant_id = 5) const uint kLights = 16u;
layout(constant_id = 6) const bool kHasClouds = true;
// One bit for each light: casts shadows, is a rectangle, is a cone.
layout(constant_id = 7) const uint kShadows = 0xFFFFu;
layout(constant_id = 8) const uint kAreas = 0xFFFFu;
layout(constant_id = 9) const uint kCones = 0xFFFFu;
layout(constant_id = 10) const bool kHasSignals = true;
layout(constant_id = 11) const bool kHasChanges = true;
layout(constant_id = 12) const bool kHasHarmonics = true;

// The numbers of tools/scene/scene.h.
const uint kChecker = 1u, kStripes = 2u, kLines = 3u, kBricks = 4u, kDots = 5u, kNoise = 6u,
           kGlyphs = 7u, kWindows = 8u, kCells = 9u, kSmooth = 10u;
const uint kLeaves = 1u, kGrass = 2u, kMesh = 3u, kPickets = 4u, kDisc = 5u, kCutGlyphs = 6u;
bool has_pattern(uint kind) { return (kPatterns >> kind & 1u) != 0u; }
bool has_cutout(uint kind) { return (kCutouts >> kind & 1u) != 0u; }

const int kMaxLights = 16;
const int kMaxOverlays = 4;
const int kPrimitiveTexels = 9;
const int kMaterialTexels = 6;

layout(std140, binding = 0) uniform Frame {
  vec4 corner, step_x, step_y;
  vec4 depth;
  vec4 size;
  vec4 window;
  vec4 sky_was[3];
  vec4 sun, sun_color;
  vec4 zenith, horizon, ground, ambient;
  vec4 grid_u, grid_v;
  vec4 lights[5 * kMaxLights];
  vec4 harmonics[9];
  vec4 overlays[4 * kMaxOverlays];
  ivec4 grid;
  ivec4 tiles;
  ivec4 bases;
} frame;
layout(binding = 1) uniform samplerBuffer texels;
layout(binding = 2) uniform usamplerBuffer lists;
/// r g b, depth, motion x y of a pixel; rows of a band.
layout(std430, binding = 3) writeonly buffer Out { float values[]; } result;

layout(push_constant) uniform Push {
  vec2 jitter;    // pixels of this grid
  vec2 scale;     // output pixels per pixel of this grid
  ivec2 origin;   // first pixel of the window in this grid
  ivec2 extent;   // of the window
  int first_row;  // of the band
  int end_row;
  int samples;    // along a side of a pixel
} push;

const uint kSphere = 0u, kCylinder = 1u, kBox = 2u, kQuad = 3u;
const float kFar = 1e30;

uint hash(uvec2 cell, uint seed) {
  uint h = cell.x * 0x9E3779B1u + cell.y * 0x85EBCA77u + seed * 0xC2B2AE3Du;
  h ^= h >> 15;
  h *= 0x2C1B3C6Du;
  h ^= h >> 12;
  h *= 0x297A2D39u;
  return h ^ (h >> 15);
}

/// Three numbers in [0, 1) of one hash.
vec3 parts(uint h) { return vec3(uvec3(h, h >> 10, h >> 20) & 1023u) * (1.0 / 1024.0); }

float value_noise(vec2 p, uint seed) {
  vec2 cell = floor(p), f = p - cell;
  f = f * f * (3.0 - 2.0 * f);
  uvec2 c = uvec2(ivec2(cell));
  float a = float(hash(c, seed) >> 8), b = float(hash(c + uvec2(1, 0), seed) >> 8);
  float d = float(hash(c + uvec2(0, 1), seed) >> 8), e = float(hash(c + uvec2(1, 1), seed) >> 8);
  return mix(mix(a, b, f.x), mix(d, e, f.x), f.y) * (1.0 / 16777216.0);
}

/// Three octaves; 0 to 1 around 0.5.
float fractal_noise(vec2 p, uint seed) {
  float sum = 0.0, weight = 0.53;
  for (int octave = 0; octave < 3; ++octave) {
    sum += weight * value_noise(p, seed);
    p = p * 2.03 + vec2(17.3, 9.1);
    weight *= 0.5;
  }
  return sum * (1.0 / 0.9275);
}

// Letters A to Z and digits, 3 columns by 5 rows, top row in the highest bits.
const uint kFont[36] = uint[](
    0x2BED, 0x6BAE, 0x3923, 0x6B6E, 0x79A7, 0x79A4, 0x396B, 0x5BED, 0x7497, 0x126A, 0x5BAD, 0x4927,
    0x5FED, 0x6B6D, 0x2B6A, 0x6BA4, 0x2B73, 0x6BAD, 0x388E, 0x7492, 0x5B6F, 0x5B6A, 0x5BFD, 0x5AAD,
    0x5A92, 0x72A7, 0x7B6F, 0x2C97, 0x62A7, 0x628E, 0x5BC9, 0x798E, 0x39EF, 0x7292, 0x7BEF, 0x7BCE);

/// 1 on the strokes of a text; `p` counts glyphs to the right and lines downwards.
float glyphs(vec2 p, uint seed) {
  vec2 cell = floor(p);
  ivec2 dot_at = ivec2((p - cell) * vec2(4.0, 7.0)) - ivec2(0, 1);
  uint h = hash(uvec2(ivec2(cell)), seed);
  uint line = hash(uvec2(0u, uint(int(cell.y))), seed ^ 0x55u);
  bool blank = (h >> 24) < 40u || cell.x > 6.0 + float(line & 31u);
  bool inside = dot_at.x < 3 && dot_at.y >= 0 && dot_at.y < 5 && !blank;
  int bit = clamp(14 - (dot_at.y * 3 + dot_at.x), 0, 14);
  return inside ? float((kFont[h % 36u] >> bit) & 1u) : 0.0;
}

struct Space {
  vec4 x, y, z;  // rows of world to unit space
};

Space space_of(int primitive) {
  int at = primitive * kPrimitiveTexels;
  return Space(texelFetch(texels, at), texelFetch(texels, at + 1), texelFetch(texels, at + 2));
}

/// Where the ray o + t d is inside of the unit shape; empty if y < x. Sphere: round in x, y and z.
/// Cylinder: round in x and z, within y. Box: within x, y and z. Quad: a box without thickness.
vec2 crossed(uint shape, vec3 o, vec3 d) {
  bool is_round = shape < kBox;
  vec3 side = vec3(is_round ? kFar : 1.0, shape == kSphere ? kFar : 1.0,
                   is_round ? kFar : shape == kQuad ? 0.0 : 1.0);
  d = mix(d, vec3(1e-20), lessThan(abs(d), vec3(1e-20)));
  vec3 inverse = 1.0 / d;
  vec3 middle = -o * inverse, reach = side * abs(inverse);
  vec3 enter = middle - reach, leave = middle + reach;
  vec2 span = vec2(max(max(enter.x, enter.y), enter.z), min(min(leave.x, leave.y), leave.z));
  // The point nearest to the axis or centre first: its distance is exact where o and d are large.
  float along = shape == kSphere ? 1.0 : 0.0;
  vec3 dr = vec3(d.x, d.y * along, d.z), r = vec3(o.x, o.y * along, o.z);
  float a = 1.0 / max(dot(dr, dr), 1e-30);
  float t = -dot(r, dr) * a;
  r += t * dr;
  float inside = 1.0 - dot(r, r);
  float wide = sqrt(max(inside, 0.0) * a);
  if (is_round) span = inside > 0.0 ? vec2(max(span.x, t - wide), min(span.y, t + wide)) : vec2(1.0, 0.0);
  return span;
}

/// Position on the surface in metres, for patterns.
vec2 surface(uint shape, vec3 p, vec3 half_size) {
  vec3 m = p * half_size;
  vec3 size = abs(p);
  // Flat parts: the two coordinates other than that of the face.
  vec2 flat_xy = m.xy;
  if (shape == kBox && size.x >= max(size.y, size.z)) flat_xy = m.zy;
  if (shape == kBox && size.y > max(size.x, size.z)) flat_xy = m.xz;
  float around = atan(p.z, p.x) * half_size.x;
  float ring = length(p.xz);
  vec2 curved = vec2(around, shape == kSphere ? atan(p.y, ring) * half_size.y : m.y);
  if (shape == kCylinder && (1.0 - size.y) * half_size.y < (1.0 - ring) * half_size.x) curved = m.xz;
  return shape < kBox ? curved : flat_xy;
}

/// A leaf in the middle of a cell: a tilted ellipse.
bool leaf(vec2 uv, uint seed, vec2 slender, float amount) {
  vec2 cell = floor(uv), c = uv - cell - 0.5;
  vec3 random = parts(hash(uvec2(ivec2(cell)), seed));
  vec2 axis = normalize(random.xy - 0.499);
  vec2 q = vec2(dot(c, axis), dot(c, vec2(-axis.y, axis.x))) * slender;
  return dot(q, q) < 1.0 && random.z < amount;
}

/// True where a surface with this cutout is there. `height` runs from -1 at the foot to 1.
bool is_solid(uint kind, vec2 uv, float height, float amount, uint seed, vec2 unit) {
  vec2 cell = floor(uv), f = uv - cell;
  float up = height * 0.5 + 0.5;
  bool solid = true;
  if (has_cutout(kLeaves) && kind == kLeaves)
    solid = leaf(uv, seed, vec2(2.0, 4.4), amount) || leaf(uv + 0.5, seed ^ 0xABCDu, vec2(2.1, 5.0), amount);
  if (has_cutout(kGrass) && kind == kGrass) {
    // A bent blade in each column, thinner towards the tip.
    vec3 blade = parts(hash(uvec2(uint(int(cell.x)), 7u), seed));
    float rise = up / (0.35 + 0.65 * blade.x);
    float off = abs(f.x - 0.5 - (blade.y - 0.5) * 0.8 * rise * rise);
    solid = rise < 1.0 && off < 0.5 * amount * (1.0 - rise);
  }
  if (has_cutout(kMesh) && kind == kMesh) solid = min(f.x, f.y) < amount;
  if (has_cutout(kPickets) && kind == kPickets) {
    float point = 1.0 - abs(2.0 * f.x / max(amount, 1e-3) - 1.0);
    solid = (f.x < amount && up < 0.93 + 0.07 * point) || abs(up - 0.25) < 0.04 || abs(up - 0.75) < 0.04;
  }
  if (has_cutout(kDisc) && kind == kDisc) solid = dot(unit, unit) < 1.0;
  if (has_cutout(kCutGlyphs) && kind == kCutGlyphs) solid = glyphs(vec2(uv.x, -uv.y), seed) > 0.5;
  return solid;
}

bool is_cut_out(uint entry, vec3 p) {
  int at = int(entry & 0xFFFFu) * kPrimitiveTexels;
  vec3 half_size = texelFetch(texels, at + 6).xyz;
  vec3 cut = texelFetch(texels, at + 8).xyz;
  uint shape = entry >> 16 & 3u;
  vec2 uv = surface(kHasRoundCutouts ? shape : max(shape, kBox), p, half_size) * cut.x;
  return !is_solid(entry >> 18 & 7u, uv, p.y, cut.y, uint(cut.z), p.xy);
}

const uint kNone = 0xFFFFFFFFu;
bool may_be_cut_out(uint entry) { return kCutouts > 1u && (entry >> 18 & 7u) != 0u; }

// Both searches below walk a list, and stop at a cut-out primitive that the ray meets to look at its
// pattern: CPU drivers run all of a loop's body for every entry, and most entries are not met. Cut-out
// primitives are hollow: where the near side has a hole, the far side may be met.

/// Nearest primitive on the ray from the eye; kNone is the sky.
uint nearest(vec2 position, vec3 d, out float t) {
  ivec2 tile = ivec2(position - frame.window.xy) >> frame.tiles.w;
  tile = clamp(tile, ivec2(0), frame.tiles.xy - 1);
  uvec2 list = texelFetch(lists, frame.tiles.z + 2 * (tile.y * frame.tiles.x + tile.x)).xy;
  float near = frame.depth.x;
  t = frame.depth.y;
  uint found = kNone;
  uint i = 0u;
  uint candidate = kNone;
  float at = 0.0, far_side = 0.0;
  vec3 o = vec3(0.0), ray = vec3(0.0);
  do {
    while (candidate == kNone && i < list.y) {
      uvec2 entry = texelFetch(lists, int(list.x + i)).xy;
      ++i;
      if (uintBitsToFloat(entry.y) > t) i = list.y;  // all others are farther still
      Space s = space_of(int(entry.x & 0xFFFFu));
      ray = vec3(dot(s.x.xyz, d), dot(s.y.xyz, d), dot(s.z.xyz, d));
      o = vec3(s.x.w, s.y.w, s.z.w);
      vec2 span = crossed(entry.x >> 16 & 3u, o, ray);
      at = span.x > near ? span.x : span.y;
      far_side = span.y;
      bool met = span.x <= span.y && at > near && at < t;
      if (may_be_cut_out(entry.x)) {
        if (met) candidate = entry.x;
      } else if (met) {
        t = at;
        found = entry.x;
      }
    }
    if (kCutouts <= 1u || candidate == kNone) break;
    if (!is_cut_out(candidate, o + at * ray)) {
      t = at;
      found = candidate;
      candidate = kNone;
    } else {
      if (at == far_side || far_side >= t) candidate = kNone;
      at = far_side;
    }
  } while (true);
  return found;
}

/// 0 if something stands between `p` and the sun. `own` is the primitive that p lies on.
float sunlight(vec3 p, uint own) {
  ivec2 cell = ivec2(floor(vec2(dot(frame.grid_u.xyz, p) + frame.grid_u.w,
                                dot(frame.grid_v.xyz, p) + frame.grid_v.w)));
  bool outside = any(lessThan(cell, ivec2(0))) || any(greaterThanEqual(cell, frame.grid.xy));
  cell = clamp(cell, ivec2(0), frame.grid.xy - 1);
  uvec2 list = texelFetch(lists, frame.grid.z + cell.y * frame.grid.x + cell.x).xy;
  if (outside || own == kNone) list.y = 0u;
  float height = dot(frame.sun.xyz, p);
  float light = 1.0;
  uint i = 0u;
  uint candidate = kNone;
  float at = 0.0, far_side = 0.0;
  vec3 o = vec3(0.0), ray = vec3(0.0);
  do {
    while (candidate == kNone && i < list.y) {
      uvec2 entry = texelFetch(lists, int(list.x + i)).xy;
      ++i;
      if (uintBitsToFloat(entry.y) < height) i = list.y;  // all others lie lower still
      Space s = space_of(int(entry.x & 0xFFFFu));
      ray = vec3(dot(s.x.xyz, frame.sun.xyz), dot(s.y.xyz, frame.sun.xyz),
                 dot(s.z.xyz, frame.sun.xyz));
      o = vec3(dot(s.x.xyz, p) + s.x.w, dot(s.y.xyz, p) + s.y.w, dot(s.z.xyz, p) + s.z.w);
      vec2 span = crossed(entry.x >> 16 & 3u, o, ray);
      at = span.x > 0.0 ? span.x : span.y;
      far_side = span.y;
      bool met = span.x <= span.y && span.y > 0.0;
      if (may_be_cut_out(entry.x)) {
        if (met) candidate = entry.x;
      } else if (met && entry.x != own) {
        light = 0.0;
        i = list.y;
      }
    }
    if (kCutouts <= 1u || candidate == kNone) break;
    if (!is_cut_out(candidate, o + at * ray)) {
      light = 0.0;
      i = list.y;
      candidate = kNone;
    } else {
      if (at == far_side) candidate = kNone;
      at = far_side;
    }
  } while (true);
  return light;
}

/// 0 if something stands between `p` and `p + way`. `own` is the primitive that p lies on; without
/// one there is nothing to be lit.
float lamplight(vec3 p, vec3 way, uint own) {
  vec3 slope = 1.0 / mix(way, vec3(1e-20), lessThan(abs(way), vec3(1e-20)));
  int node = own == kNone ? -1 : 0;
  float light = 1.0;
  do {
    uint leaf = kNone;
    while (node >= 0 && leaf == kNone) {
      vec4 low = texelFetch(texels, frame.bases.z + 2 * node);
      vec4 high = texelFetch(texels, frame.bases.z + 2 * node + 1);
      vec3 a = (low.xyz - p) * slope, b = (high.xyz - p) * slope;
      vec3 enter = min(a, b), leave = max(a, b);
      bool met = max(max(enter.x, enter.y), max(enter.z, 0.0)) <=
                 min(min(leave.x, leave.y), min(leave.z, 1.0));
      bool is_leaf = high.w >= 0.0;
      if (met && is_leaf) leaf = uint(high.w);
      node = met && !is_leaf ? node + 1 : int(low.w);
    }
    if (leaf == kNone) break;
    Space s = space_of(int(leaf & 0xFFFFu));
    vec3 ray = vec3(dot(s.x.xyz, way), dot(s.y.xyz, way), dot(s.z.xyz, way));
    vec3 o = vec3(dot(s.x.xyz, p) + s.x.w, dot(s.y.xyz, p) + s.y.w, dot(s.z.xyz, p) + s.z.w);
    vec2 span = crossed(leaf >> 16 & 3u, o, ray);
    bool met = span.x <= span.y;
    bool near_side = met && span.x > 0.0 && span.x < 1.0;
    bool far_side = met && span.y > 0.0 && span.y < 1.0;
    bool blocked = (near_side || far_side) && leaf != own;
    if (may_be_cut_out(leaf))
      blocked = (near_side && !is_cut_out(leaf, o + span.x * ray)) ||
                (far_side && !is_cut_out(leaf, o + span.y * ray));
    if (blocked) {
      light = 0.0;
      node = -1;
    }
  } while (true);
  return light;
}

/// The part of what a surface at the origin reflects that comes from a rectangle of unit radiance.
/// Source: Lambert's formula for polygons; what is below the horizon is subtracted.
float seen_rectangle(vec3 middle, vec3 u, vec3 v, vec3 normal) {
  vec3 corners[4] = vec3[](normalize(middle - u - v), normalize(middle + u - v),
                           normalize(middle + u + v), normalize(middle - u + v));
  float sum = 0.0;
  for (int i = 0; i < 4; ++i) {
    vec3 a = corners[i], b = corners[(i + 1) & 3];
    vec3 across = cross(a, b);
    float sine = length(across);
    sum += atan(sine, dot(a, b)) / max(sine, 1e-9) * dot(across, normal);
  }
  return max(-sum, 0.0) * (1.0 / 6.28318531);
}

struct Surface {
  vec3 color, emission;
  float specular, shininess;
};

/// Colour of a material at `uv` metres; `noise` is fractal noise there, 0 to 1.
Surface patterned(vec4 a, vec4 b, vec4 cells, vec4 more, float shininess, vec2 uv, float noise,
                  vec3 tint, vec3 glow, uint seed, vec3 unit) {
  uint kind = uint(cells.w);
  vec2 q = uv * cells.xy;
  float row = floor(q.y);
  if (kind == kBricks) q.x += 0.5 * mod(row, 2.0);
  vec2 cell = floor(q), f = q - cell;
  vec3 random = parts(hash(uvec2(ivec2(cell)), seed));
  float width = cells.z;
  float edge_x = width * cells.x / max(cells.x, cells.y), edge_y = width * cells.y / max(cells.x, cells.y);
  bool line = f.x < edge_x || f.y < edge_y;
  bool pane = abs(f.x - 0.5) < 0.32 && abs(f.y - 0.5) < 0.34 && abs(f.x - 0.5) > 0.02;
  bool lit = random.z < width;
  float mask = 0.0;
  if (kind == kChecker) mask = mod(cell.x + cell.y, 2.0);
  if (kind == kStripes) mask = f.x < width ? 1.0 : 0.0;
  if (kind == kLines || kind == kBricks) mask = line ? 1.0 : 0.0;
  if (kind == kDots) mask = dot(f - 0.5, f - 0.5) < width * width ? 1.0 : 0.0;
  if (kind == kNoise) mask = smoothstep(width - 0.15, width + 0.15, noise);
  if (kind == kWindows) mask = pane && lit ? 1.0 : 0.0;
  if (kind == kCells) mask = random.x;
  // Smooth waves along all three axes of the unit shape, for tests of motion.
  if (has_pattern(kSmooth) && kind == kSmooth) mask = dot(sin(unit * 3.0), vec3(1.0 / 6.0)) + 0.5;
  if (has_pattern(kGlyphs) && kind == kGlyphs) mask = glyphs(vec2(q.x, -q.y), seed);
  float tone = 1.0 + more.x * (random.y * 2.0 - 1.0);
  if ((kind == kLines || kind == kBricks || kind == kStripes) && mask > 0.5) tone = 1.0;
  tone *= 1.0 + more.y * (noise * 2.0 - 1.0);
  Surface s;
  s.color = mix(a.rgb, b.rgb, mask) * tone;
  s.specular = more.w;
  s.shininess = shininess;
  // Dark panes: almost black, and polished.
  if (kind == kWindows && pane && !lit) {
    s.color = a.rgb * 0.08;
    s.specular = max(more.w, 0.6);
  }
  s.emission = s.color * mix(a.w, b.w, mask) * glow;
  s.color *= tint;
  return s;
}

vec3 sky_color(vec3 d, float noise) {
  float up = d.y;
  vec3 color = mix(frame.horizon.rgb, frame.zenith.rgb, sqrt(clamp(up, 0.0, 1.0)));
  color = mix(color, frame.ground.rgb, clamp(-up * 6.0, 0.0, 1.0));
  if (kHasClouds) {
    float cloud = smoothstep(0.45, 0.75, noise) * frame.zenith.w * smoothstep(0.0, 0.15, up);
    color = mix(color, frame.horizon.rgb * 1.4, cloud);
    vec2 q = d.xz / (1.0 + abs(d.y)) * 160.0;
    vec2 cell = floor(q), f = q - cell;
    vec3 random = parts(hash(uvec2(ivec2(cell)), 99u));
    vec2 c = f - 0.2 - 0.6 * random.xy;
    color += random.z < 0.06 && dot(c, c) < 0.012 ? vec3(frame.ground.w * (1.0 - cloud)) : vec3(0.0);
  }
  float facing = dot(d, frame.sun.xyz);
  return color + (facing > frame.sun.w ? frame.sun_color.rgb * frame.sun_color.w : vec3(0.0));
}

struct Sample {
  vec3 color;
  float z;  // view z; frame.depth.y and above is the sky
  vec2 motion;
};

/// What is seen at `position`, in output pixels of the whole picture.
Sample look(vec2 position) {
  vec3 d = frame.corner.xyz + frame.step_x.xyz * position.x + frame.step_y.xyz * position.y;
  float t;
  uint entry = nearest(position, d, t);
  bool sky = entry == kNone;
  int primitive = sky ? 0 : int(entry & 0xFFFFu);
  uint shape = entry >> 16 & 3u;
  int at = primitive * kPrimitiveTexels;
  Space s = space_of(primitive);
  float reach = sky ? 1.0 : t;
  vec3 p = d * reach;
  vec3 unit = vec3(s.x.w, s.y.w, s.z.w) +
              reach * vec3(dot(s.x.xyz, d), dot(s.y.xyz, d), dot(s.z.xyz, d));
  vec4 half_material = texelFetch(texels, at + 6);
  vec4 tint_seed = texelFetch(texels, at + 7);
  uint material = uint(half_material.w);
  uint seed = uint(tint_seed.w);

  // Motion: the same place of the shape, or the same direction, as the frame before saw it.
  vec3 was = vec3(dot(frame.sky_was[0].xyz, d), dot(frame.sky_was[1].xyz, d),
                  dot(frame.sky_was[2].xyz, d));
  if (!sky) {
    vec4 u = vec4(unit, 1.0);
    was = vec3(dot(texelFetch(texels, at + 3), u), dot(texelFetch(texels, at + 4), u),
               dot(texelFetch(texels, at + 5), u));
  }
  vec2 uv_was = vec2(0.5, -0.5) * was.xy / max(was.z, 1e-6) + 0.5;
  vec2 motion = clamp(position * frame.size.zw - uv_was, vec2(-2.0), vec2(2.0));
  bool still = mix((material & 0x100u) != 0u, frame.bases.w != 0, sky);
  if (still) motion = vec2(0.0);

  // Surface.
  vec3 normal;
  vec3 size = abs(unit);
  vec3 face = size.x >= max(size.y, size.z) ? vec3(unit.x, 0.0, 0.0)
              : size.y >= size.z            ? vec3(0.0, unit.y, 0.0)
                                            : vec3(0.0, 0.0, unit.z);
  bool cap = (1.0 - size.y) * half_material.y < (1.0 - length(unit.xz)) * half_material.x;
  if (shape == kSphere) face = unit;
  if (shape == kCylinder) face = cap ? vec3(0.0, unit.y, 0.0) : vec3(unit.x, 0.0, unit.z);
  if (shape == kQuad) face = vec3(0.0, 0.0, 1.0);
  normal = normalize(face.x * s.x.xyz + face.y * s.y.xyz + face.z * s.z.xyz);
  if (dot(normal, d) > 0.0) normal = -normal;
  int m = frame.bases.x + int(material & 0xFFu) * kMaterialTexels;
  vec4 more = texelFetch(texels, m + 3);
  vec2 uv = surface(shape, unit, half_material.xyz);
  vec4 shine_change = texelFetch(texels, m + 4);
  if (kHasChanges) {
    uv -= shine_change.yz;
    seed ^= uint(shine_change.w);
  }
  vec3 glow = vec3(1.0);
  if (kHasSignals) glow = texelFetch(texels, m + 5).rgb;
  vec3 direction = normalize(d);
  vec2 noise_at = sky ? direction.xz / (0.12 + abs(direction.y)) * 1.7 : uv * more.z;
  float noise = fractal_noise(noise_at, sky ? 5u : seed);
  Surface surface = patterned(texelFetch(texels, m), texelFetch(texels, m + 1),
                              texelFetch(texels, m + 2), more, shine_change.x, uv,
                              noise, tint_seed.rgb, glow, seed, unit);

  // Light.
  float bias = 1e-4 + 2e-4 * reach;
  float facing = max(dot(normal, frame.sun.xyz), 0.0);
  uint own = sky || facing <= 0.0 ? kNone : entry;
  vec3 sun = frame.sun_color.rgb * (facing * sunlight(p + normal * bias, own));
  vec3 halfway = normalize(frame.sun.xyz - direction);
  float shine = pow(max(dot(normal, halfway), 0.0), surface.shininess) * surface.specular;
  vec3 ambient = frame.ambient.rgb * (0.75 + 0.25 * normal.y);
  if (kHasHarmonics) {
    vec3 n = normal;
    ambient = frame.harmonics[0].rgb + frame.harmonics[1].rgb * n.y + frame.harmonics[2].rgb * n.z +
              frame.harmonics[3].rgb * n.x + frame.harmonics[4].rgb * (n.x * n.y) +
              frame.harmonics[5].rgb * (n.y * n.z) +
              frame.harmonics[6].rgb * (3.0 * n.z * n.z - 1.0) +
              frame.harmonics[7].rgb * (n.x * n.z) +
              frame.harmonics[8].rgb * (n.x * n.x - n.y * n.y);
    ambient = max(ambient, vec3(0.0));
  }
  vec3 light = sun + ambient;
  vec3 color = surface.color * light + sun * shine + surface.emission;
  // A hint of the sky on what is polished.
  vec3 mirrored = reflect(direction, normal);
  float grazing = 1.0 - max(-dot(direction, normal), 0.0);
  color += mix(frame.horizon.rgb, frame.zenith.rgb, clamp(mirrored.y, 0.0, 1.0)) *
           (min(surface.specular, 1.0) * (0.08 + 0.6 * grazing * grazing * grazing));
  if (kLights > 0u) {
    for (int i = 0; i < int(kLights); ++i) {
      vec3 to = frame.lights[5 * i].xyz - p;
      float square = dot(to, to);
      float window = max(1.0 - square * frame.lights[5 * i].w, 0.0);
      vec3 way = to * inversesqrt(square + 1e-6);
      float diffuse = max(dot(normal, way), 0.0) * window * window / (1.0 + square);
      vec4 facing = frame.lights[5 * i + 2];
      vec4 u = frame.lights[5 * i + 3];
      vec3 v = frame.lights[5 * i + 4].xyz;
      bool area = (kAreas >> i & 1u) != 0u;
      if (area) {
        // Glints are those of the rectangle's point that is nearest to the mirrored ray.
        float behind = dot(facing.xyz, mirrored);
        vec3 hit = mirrored * (dot(facing.xyz, to) / min(behind, -1e-3)) - to;
        vec2 on = clamp(vec2(dot(hit, u.xyz) / dot(u.xyz, u.xyz), dot(hit, v) / dot(v, v)), -1.0, 1.0);
        way = normalize(to + on.x * u.xyz + on.y * v);
        diffuse = dot(facing.xyz, to) < 0.0 ? window * window * seen_rectangle(to, u.xyz, v, normal) : 0.0;
      }
      if ((kCones >> i & 1u) != 0u) {
        float inside = clamp((-dot(facing.xyz, way) - facing.w) * u.w, 0.0, 1.0);
        diffuse *= inside * inside;
      }
      if ((kShadows >> i & 1u) != 0u) {
        uint lit = sky || !(diffuse > 1e-5) ? kNone : entry;
        vec3 from = p + normal * bias;
        // A point's own, or four of a rectangle, whose half sides are 0 for a point.
        int rays = area ? 4 : 1;
        float seen = 0.0;
        for (int k = 0; k < rays; ++k) {
          vec2 side = vec2(k & 1, k >> 1) - 0.5;
          seen += lamplight(from, to - normal * bias + side.x * u.xyz + side.y * v, lit);
        }
        diffuse *= seen / float(rays);
      }
      float glint = pow(max(dot(normal, normalize(way - direction)), 0.0), surface.shininess);
      color += frame.lights[5 * i + 1].rgb * diffuse * (surface.color + glint * surface.specular);
    }
  }
  float clear = exp(-frame.horizon.w * reach * length(d));
  color = mix(frame.horizon.rgb, color, clear);
  if (sky) color = sky_color(direction, noise);

  if (kHasParticles) {
    ivec2 tile = clamp(ivec2(position - frame.window.xy) >> frame.tiles.w, ivec2(0), frame.tiles.xy - 1);
    uvec2 list =
        texelFetch(lists, frame.tiles.z + 2 * (tile.y * frame.tiles.x + tile.x) + 1).xy;
    for (uint i = 0u; i < list.y; ++i) {
      int index = frame.bases.y + 2 * int(texelFetch(lists, int(list.x + i)).x);
      vec4 disc = texelFetch(texels, index), glow = texelFetch(texels, index + 1);
      vec2 off = (position - disc.xy) * disc.z;
      float inside = 1.0 - dot(off, off);
      float strength = inside <= 0.0 || disc.w > t ? 0.0 : disc.z < 0.0 ? inside * inside : 1.0;
      color = color * (1.0 - glow.w * strength) + glow.rgb * strength;
    }
  }
  if (kOverlays > 0) {
    for (int i = 0; i < kOverlays; ++i) {
      vec4 rect = frame.overlays[4 * i], ink = frame.overlays[4 * i + 1];
      vec4 back = frame.overlays[4 * i + 2], text = frame.overlays[4 * i + 3];
      vec2 q = (position * frame.size.zw - rect.xy) / rect.zw;
      bool inside = all(greaterThanEqual(q, vec2(0.0))) && all(lessThan(q, vec2(1.0)));
      vec2 glyph_at = vec2(q.x * ink.w * text.y * 1.75 - 0.5, q.y * ink.w + text.x);
      float stroke = glyph_at.x > 0.0 ? glyphs(glyph_at, uint(text.z)) : 0.0;
      vec3 over = mix(mix(color, back.rgb, back.w), ink.rgb, stroke);
      color = inside ? over : color;
    }
  }
  return Sample(color, sky ? kFar : t, motion * frame.window.zw);
}

void main() {
  // Morton order: neighbours in the index, which CPU drivers run together, are close by.
  uint i = gl_LocalInvocationIndex;
  ivec2 pixel = ivec2(int(i & 1u) | int(i >> 1 & 2u) | int(i >> 2 & 4u),
                      int(i >> 1 & 1u) | int(i >> 2 & 2u) | int(i >> 3 & 4u));
  pixel += ivec2(gl_WorkGroupID.xy) * 8 + ivec2(0, push.first_row);
  bool inside = pixel.x < push.extent.x && pixel.y < push.end_row;
  int count = inside ? push.samples * push.samples : 0;
  float spacing = 1.0 / float(push.samples);
  float exposure = frame.ambient.w;
  vec3 sum = vec3(0.0);
  Sample seen = Sample(vec3(0.0), 2.0 * kFar, vec2(0.0));
  for (int k = 0; k < count; ++k) {
    vec2 sub = (vec2(k % push.samples, k / push.samples) + 0.5) * spacing;
    Sample s = look((vec2(pixel + push.origin) + sub + push.jitter) * push.scale);
    vec3 exposed = s.color * exposure;
    sum += exposed / (1.0 + max(max(exposed.r, exposed.g), exposed.b));
    if (s.z < seen.z) seen = s;
  }
  if (!inside) return;
  sum *= spacing * spacing;
  float most = min(max(max(sum.r, sum.g), sum.b), 1.0 - 1e-7);
  vec3 color = mix(seen.color, sum / ((1.0 - most) * exposure), bvec3(push.samples > 1));
  bool sky = seen.z >= frame.depth.y;
  // Below infinity: what is nearer than the far plane is at most there.
  float depth = clamp(frame.depth.z + frame.depth.w / seen.z, 0.0, 1.0);
  depth = mix(depth, step(frame.depth.w, 0.0), sky);
  int at = 6 * ((pixel.y - push.first_row) * push.extent.x + pixel.x);
  result.values[at] = color.r;
  result.values[at + 1] = color.g;
  result.values[at + 2] = color.b;
  result.values[at + 3] = depth;
  result.values[at + 4] = seen.motion.x;
  result.values[at + 5] = seen.motion.y;
}
