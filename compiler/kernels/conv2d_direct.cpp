// conv2d_s8_f64pair, conv2d_s8_f32exact, conv2d_s8_i32, conv2d_s8_phase and conv2d_s8_phase32: sums of
// products with the weights as literals in the code.
//
// Meaning of a workgroup: a strip of 64 tiles of output pixels; one invocation makes all output
// channels of one tile (of the module's slice of channels), as many sums at a time as the processor has
// registers for.
// Source: ours; figures in compiler/kernels/README.md.
//
// f64pair makes two tiles in one go: the byte of one and, 24 bits up, that of the other are one
// number, a weight times it is both products, and a double holds both sums, exactly while each is
// below 2^23; the range proof of the actual weights decides. f32exact makes one tile in float32,
// exact below 2^24. The bias is added afterwards, so it does not count. i32 is the same in int32
// arithmetic and needs no proof: TOSA's legal results wrap back into range.
//
// phase is for a convolution over a nearest upsampling: the output pixels over one source texel see
// only a few source texels, and taps that fall on the same texel share one weight, their sum. 3x3 over x2 has
// 4 products in place of 9. An exact rewrite: integers are added in
// another order, and the largest partial sum is no larger than before.
#include <algorithm>
#include <map>

#include "compiler/kernels/literal_conv.h"

namespace shale {
namespace {

/// Most products in a module: bounds the driver's compile time, which grows faster than the code,
/// and in integer arithmetic much faster (16,500 integer products took it six minutes).
int64_t most_products(Arithmetic arithmetic) {
  return arithmetic == Arithmetic::kInt32 ? 4608 : 40960;
}
/// The same of a tile of pixels: doubles of one tile have as many conversions as products, and 16,448 of those take the
/// driver three minutes.
int64_t most_in_tile(Arithmetic arithmetic) {
  return arithmetic == Arithmetic::kDouble ? 4608 : most_products(arithmetic);
}
constexpr int64_t kMaxModules = 64;
constexpr int64_t kMaxUpsampling = 4;

/// The tap that makes output pixel `out` read input offset `in` along an axis, or nothing.
std::optional<int64_t> tap(int64_t in, int64_t out, int64_t stride, int64_t dilation,
                           int64_t taps) {
  const int64_t distance = in - out * stride;
  if (distance < 0 || distance % dilation != 0 || distance / dilation >= taps) return std::nullopt;
  return distance / dilation;
}

/// Input offsets along an axis that any tap of any pixel of the tile reads, each once and in order:
/// with a large stride or dilation they are few in a wide span.
std::set<int64_t> offsets(int64_t pixels, int64_t stride, int64_t taps, int64_t dilation) {
  std::set<int64_t> result;
  for (int64_t pixel = 0; pixel < pixels; ++pixel)
    for (int64_t tap = 0; tap < taps; ++tap) result.insert(pixel * stride + tap * dilation);
  return result;
}

/// A tile is one pixel where there are many channels; with fewer it is as many pixels as fill the
/// live sums, so that neighbours share their fetches.
TapMap direct_map(const LiteralConv& conv, Arithmetic arithmetic) {
  const Shape& taps = conv.weight_shape();
  const int64_t channels = conv.out()[3], read = conv.is_depthwise() ? 1 : taps[3];
  TapMap map;
  map.source = conv.node().inputs[0];
  map.outside = conv.input_zero_point();
  if (channels <= 8) {
    map.tile_height = channels > 4 ? 1 : channels > 1 ? 2 : 4;
    map.tile_width = channels > 2 ? 2 : 4;
    if (map.tile_height * map.tile_width * channels * taps[1] * taps[2] * read >
        most_in_tile(arithmetic))
      map.tile_height = map.tile_width = 1;
  }
  map.products_per_channel = map.tile_height * map.tile_width * taps[1] * taps[2] * read;
  const std::span<const int64_t> stride = conv.ints(Attr::kStride), pad = conv.ints(Attr::kPad),
                                 dilation = conv.ints(Attr::kDilation);
  map.step_y = map.tile_height * stride[0];
  map.step_x = map.tile_width * stride[1];
  std::vector<std::array<int64_t, 2>> from;  // without the padding
  for (const int64_t row : offsets(map.tile_height, stride[0], taps[1], dilation[0]))
    for (const int64_t column : offsets(map.tile_width, stride[1], taps[2], dilation[1])) {
      from.push_back({row, column});
      map.texels.push_back({row - pad[0], column - pad[2]});
    }
  map.weight = [&conv, from, stride, dilation, width = map.tile_width](
                   int64_t pixel, size_t texel, int64_t oc, int64_t c) -> int64_t {
    const Shape& shape = conv.weight_shape();
    const auto ky = tap(from[texel][0], pixel / width, stride[0], dilation[0], shape[1]);
    const auto kx = tap(from[texel][1], pixel % width, stride[1], dilation[1], shape[2]);
    return ky && kx ? conv.weight(oc, *ky, *kx, c) : 0;
  };
  map.finish(arithmetic);
  return map;
}

int64_t floor_div(int64_t a, int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }

/// Factors f along both axes if the resize is nearest and reads floor(o / f), else nothing.
std::optional<std::array<int64_t, 2>> upsampling(const Graph& graph, const Node& resize) {
  const Shape& from = graph.value(resize.inputs[0]).type.shape;
  const Shape& to = graph.value(resize.output).type.shape;
  const std::vector<int64_t> scale = graph.value(resize.inputs[1]).constant->ints(),
                             offset = graph.value(resize.inputs[2]).constant->ints();
  std::array<int64_t, 2> factors{};
  for (size_t axis = 0; axis < 2; ++axis) {
    const int64_t size = from[axis + 1], n = scale[2 * axis], d = scale[2 * axis + 1];
    const int64_t factor = factors[axis] = to[axis + 1] / size;
    if (factor < 1 || factor > kMaxUpsampling || to[axis + 1] != factor * size) return std::nullopt;
    for (int64_t o = 0; o < to[axis + 1]; ++o) {
      const int64_t position = o * d + offset[axis], base = floor_div(position, n);
      const int64_t nearest = base + (2 * (position - base * n) >= n);
      if (std::clamp<int64_t>(nearest, 0, size - 1) != o / factor) return std::nullopt;
    }
  }
  return factors;
}

/// The convolution over the operand of the upsampling before it, or nothing if there is none.
std::optional<TapMap> upsampled_map(const LiteralConv& conv, Arithmetic arithmetic) {
  const Graph& graph = conv.graph();
  const std::span<const int64_t> stride = conv.ints(Attr::kStride),
                                 dilation = conv.ints(Attr::kDilation),
                                 own_pad = conv.ints(Attr::kPad);
  if (stride[0] != 1 || stride[1] != 1 || dilation[0] != 1 || dilation[1] != 1) return std::nullopt;
  std::array<int64_t, 2> pad{own_pad[0], own_pad[2]};
  TapMap map;
  map.outside = conv.input_zero_point();
  const Node* view = conv.folded(conv.node().inputs[0]);
  if (view && view->op == Op::kPad) {
    const int64_t outside = graph.value(view->inputs[2]).constant->get(0);
    const bool pads = std::any_of(own_pad.begin(), own_pad.end(), [](int64_t p) { return p != 0; });
    if (pads && outside != map.outside) return std::nullopt;
    map.outside = outside;
    const std::vector<int64_t> padding = graph.value(view->inputs[1]).constant->ints();
    pad[0] += padding[2];
    pad[1] += padding[4];
    view = conv.folded(view->inputs[0]);
  }
  if (!view || view->op != Op::kResize) return std::nullopt;
  const std::optional<std::array<int64_t, 2>> factors = upsampling(graph, *view);
  if (!factors) return std::nullopt;
  map.source = view->inputs[0];
  map.tile_height = (*factors)[0];
  map.tile_width = (*factors)[1];

  // What a pixel at phase `a` reads by tap `k`, along an axis.
  const auto texel_of = [factors, pad](size_t axis, int64_t a, int64_t k) {
    return floor_div(a + k - pad[axis], (*factors)[axis]);
  };
  const Shape& taps = conv.weight_shape();
  for (int64_t row = texel_of(0, 0, 0); row <= texel_of(0, map.tile_height - 1, taps[1] - 1); ++row)
    for (int64_t column = texel_of(1, 0, 0); column <= texel_of(1, map.tile_width - 1, taps[2] - 1);
         ++column)
      map.texels.push_back({row, column});
  // Taps of all phases along an axis, those on one texel counted once.
  const auto distinct = [&](size_t axis, int64_t phases) {
    int64_t count = 0;
    for (int64_t a = 0; a < phases; ++a)
      count += texel_of(axis, a, taps[axis + 1] - 1) - texel_of(axis, a, 0) + 1;
    return count;
  };
  map.products_per_channel = distinct(0, map.tile_height) * distinct(1, map.tile_width) *
                             (conv.is_depthwise() ? 1 : taps[3]);
  map.weight = [&conv, texel_of, width = map.tile_width, texels = map.texels](
                   int64_t pixel, size_t texel, int64_t oc, int64_t c) {
    int64_t sum = 0;
    const Shape& shape = conv.weight_shape();
    for (int64_t ky = 0; ky < shape[1]; ++ky)
      for (int64_t kx = 0; kx < shape[2]; ++kx)
        if (texel_of(0, pixel / width, ky) == texels[texel][0] &&
            texel_of(1, pixel % width, kx) == texels[texel][1])
          sum += conv.weight(oc, ky, kx, c);
    return sum;
  };
  map.finish(arithmetic);
  return map;
}

using MakeMap = std::optional<TapMap> (*)(const LiteralConv& conv);

std::optional<TapMap> pair_map(const LiteralConv& conv) {
  return direct_map(conv, Arithmetic::kDoublePair);
}
std::optional<TapMap> float_map(const LiteralConv& conv) {
  return direct_map(conv, Arithmetic::kFloat32);
}
std::optional<TapMap> integer_map(const LiteralConv& conv) {
  return direct_map(conv, Arithmetic::kInt32);
}
std::optional<TapMap> double_map(const LiteralConv& conv) {
  return direct_map(conv, Arithmetic::kDouble);
}
std::optional<TapMap> pair_phase_map(const LiteralConv& conv) {
  return upsampled_map(conv, Arithmetic::kDoublePair);
}
std::optional<TapMap> float_phase_map(const LiteralConv& conv) {
  return upsampled_map(conv, Arithmetic::kFloat32);
}

/// Every sum is proven to stay where the arithmetic is exact.
bool is_exact(const GroupProblem& problem, Arithmetic arithmetic) {
  if (arithmetic == Arithmetic::kInt32) return true;
  const int64_t limit = arithmetic == Arithmetic::kFloat32  ? kFloatExact
                        : arithmetic == Arithmetic::kDouble ? kDoubleExact
                                                            : kPairExact;
  return problem.proof &&
         std::all_of(problem.proof->magnitude.begin(), problem.proof->magnitude.end(),
                     [&](int64_t bound) { return bound < limit; });
}

template <MakeMap make, Numbers numbers = Numbers::kBytes>
bool supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!LiteralConv::supports(problem, profile, numbers)) return false;
  const LiteralConv conv(problem, profile);
  const std::optional<TapMap> map = make(conv);
  if (!map || !is_exact(problem, map->arithmetic)) return false;
  const bool in_doubles =
      map->arithmetic == Arithmetic::kDoublePair || map->arithmetic == Arithmetic::kDouble;
  if (in_doubles && !profile.caps.features.has(Feature::kFloat64)) return false;
  const std::optional<int64_t> modules =
      count_tap_modules(conv, *map, most_products(map->arithmetic));
  return modules && *modules <= kMaxModules;
}

template <MakeMap make>
WorkTable work(const GroupProblem& problem, const DeviceProfile& profile) {
  const LiteralConv conv(problem, profile);
  const TapMap map = *make(conv);
  return tap_work(problem, profile, map, most_products(map.arithmetic));
}

template <MakeMap make>
std::vector<KernelSource> emit(const GroupProblem& problem, const DeviceProfile& profile) {
  const LiteralConv conv(problem, profile);
  const TapMap map = *make(conv);
  return emit_taps(problem, profile, map, most_products(map.arithmetic));
}

template <MakeMap make>
int64_t literals(const GroupProblem& problem, const DeviceProfile& profile) {
  const LiteralConv conv(problem, profile);
  return make(conv)->products(conv);
}

}  // namespace

int64_t conv2d_direct_literals(const GroupProblem& problem, const DeviceProfile& profile) {
  return literals<float_map>(problem, profile);
}

int64_t conv2d_phase_literals(const GroupProblem& problem, const DeviceProfile& profile) {
  return literals<float_phase_map>(problem, profile);
}

bool conv2d_f64pair_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return supports<pair_map>(problem, profile);
}
WorkTable conv2d_f64pair_work(const GroupProblem& problem, const DeviceProfile& profile) {
  return work<pair_map>(problem, profile);
}
Result<std::vector<KernelSource>> conv2d_f64pair_emit(const GroupProblem& problem,
                                                      const DeviceProfile& profile) {
  return emit<pair_map>(problem, profile);
}

bool conv2d_f32exact_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return supports<float_map>(problem, profile);
}
WorkTable conv2d_f32exact_work(const GroupProblem& problem, const DeviceProfile& profile) {
  return work<float_map>(problem, profile);
}
Result<std::vector<KernelSource>> conv2d_f32exact_emit(const GroupProblem& problem,
                                                       const DeviceProfile& profile) {
  return emit<float_map>(problem, profile);
}

bool conv2d_phase_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return supports<pair_phase_map>(problem, profile);
}
WorkTable conv2d_phase_work(const GroupProblem& problem, const DeviceProfile& profile) {
  return work<pair_phase_map>(problem, profile);
}
Result<std::vector<KernelSource>> conv2d_phase_emit(const GroupProblem& problem,
                                                    const DeviceProfile& profile) {
  return emit<pair_phase_map>(problem, profile);
}

bool conv2d_phase32_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return supports<float_phase_map>(problem, profile);
}
WorkTable conv2d_phase32_work(const GroupProblem& problem, const DeviceProfile& profile) {
  return work<float_phase_map>(problem, profile);
}
Result<std::vector<KernelSource>> conv2d_phase32_emit(const GroupProblem& problem,
                                                      const DeviceProfile& profile) {
  return emit<float_phase_map>(problem, profile);
}

bool conv2d_i32_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return supports<integer_map>(problem, profile);
}
WorkTable conv2d_i32_work(const GroupProblem& problem, const DeviceProfile& profile) {
  return work<integer_map>(problem, profile);
}
Result<std::vector<KernelSource>> conv2d_i32_emit(const GroupProblem& problem,
                                                  const DeviceProfile& profile) {
  return emit<integer_map>(problem, profile);
}

bool conv2d_s16_f64_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return supports<double_map, Numbers::kWords>(problem, profile);
}
WorkTable conv2d_s16_f64_work(const GroupProblem& problem, const DeviceProfile& profile) {
  return work<double_map>(problem, profile);
}
Result<std::vector<KernelSource>> conv2d_s16_f64_emit(const GroupProblem& problem,
                                                      const DeviceProfile& profile) {
  return emit<double_map>(problem, profile);
}

}  // namespace shale
