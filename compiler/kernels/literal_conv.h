// compiler/kernels/literal_conv.h -- what the families share that write weights into the code.
//
// Stored int8 codes are multiplied as unsigned bytes, u = q + 128: a byte of a fetched word becomes
// a number by one mask or shift, and with the usual zero point of -128 it is x - zp itself. What
// the offset adds, (128 + zp) * sum(w), comes off the bias. INT16 is multiplied as it is.
#pragma once

#include <functional>
#include <set>

#include "compiler/kernels/codegen.h"
#include "ir/base/integer.h"

namespace shale {

/// Float32 holds integers below this exactly.
inline constexpr int64_t kFloatExact = int64_t{1} << 24;
/// Doubles the same.
inline constexpr int64_t kDoubleExact = int64_t{1} << 53;
/// Most invocations of a workgroup, along x.
inline constexpr int64_t kLiteralLocalX = 64;

/// Tiles of output pixels, and the texels of one value that a tile is made from.
struct Tiling {
  ValueId source;
  int64_t outside = 0;                         ///< code that a texel outside of `source` has
  int64_t tile_height = 1, tile_width = 1;     ///< output pixels
  int64_t step_y = 1, step_x = 1;              ///< source texels from tile to tile
  std::vector<std::array<int64_t, 2>> texels;  ///< (row, column) from the tile's first texel

  /// The texel that the tile below has at the place of this one, or nothing if none is the same.
  std::optional<size_t> below(size_t index) const;
};

/// What a convolution multiplies.
enum class Numbers {
  kBytes,  ///< INT8 by INT8 or INT4
  kWords,  ///< INT16 by INT8, with accumulators of INT48
};

/// A conv2d or depthwise_conv2d with constant weights and bias and what is fused around it; writes fetches and
/// results, while the families write the sums in between.
class LiteralConv {
 public:
  /// True for a group of such numbers that this class can express on the profile: fetches can follow its views, and
  /// its tensors fit texel buffers.
  static bool supports(const GroupProblem& problem, const DeviceProfile& profile,
                       Numbers numbers = Numbers::kBytes);

  LiteralConv(const GroupProblem& problem, const DeviceProfile& profile);

  const Graph& graph() const { return graph_; }
  const Node& node() const { return node_; }
  Codegen& codegen() { return codegen_; }
  /// OHWI, of a depthwise convolution as if it were a whole one.
  const Shape& weight_shape() const { return taps_; }
  /// Zero point taken off; 0 for an input channel that the output channel does not read.
  int64_t weight(int64_t oc, int64_t ky, int64_t kx, int64_t c) const;
  bool is_depthwise() const { return node_.op == Op::kDepthwiseConv2d; }
  /// The input channels [first, second) that output channels [first, last) read.
  std::array<int64_t, 2> read_by(int64_t first, int64_t last) const;
  /// NHWC of the convolution's result.
  const Shape& out() const { return graph_.value(node_.output).type.shape; }
  int64_t input_zero_point() const { return graph_.value(node_.inputs[3]).constant->get(0); }
  DType input_dtype() const { return graph_.value(node_.inputs[0]).type.dtype; }
  std::span<const int64_t> ints(Attr attr) const { return node_.attrs.list(attr); }
  /// The node of the group that makes `id`, or null.
  const Node* folded(ValueId id) const;

  /// Channels of a fetch: those of 16 bytes (uvec4), of 4 or a single one (uint), the most that every
  /// fetched tensor allows. A tensor of int8 whose texels begin within words is fetched in words, too, two for each
  /// four channels.
  int64_t lanes() const { return lanes_; }
  const char* texel_type() const { return is_wide() ? "uvec4" : "uint"; }
  /// Expression of `lanes()` channels from `c` on of value `id` at row y, column x of image n, int8 as
  /// bytes u; outside the value each is that of the code `outside`.
  std::string fetch(ValueId id, int64_t c, const std::string& y, const std::string& x,
                    int64_t outside);
  /// Expression (uint) of channel `c` of texel `index` of a Tiling, shifted left by `shift` (0 or 8 to
  /// 24).
  std::string byte(size_t index, int64_t c, int shift = 0) const;
  /// Expression (of an integer) of channel `c` of texel `index` of a Tiling, of int8 u.
  std::string number(size_t index, int64_t c) const;
  /// The sum of channel `c` of two texels, the second one shifted left by `shift`.
  std::string byte_pair(const std::array<size_t, 2>& texels, int64_t c, int shift) const {
    return fmt::format("({} | {})", byte(texels[0], c), byte(texels[1], c, shift));
  }
  /// Statements that take the double in variable `sum`, a + 2^shift b with |a| < 2^(shift-1), apart
  /// into doubles `sum`_0 = a and `sum`_1 = b.
  std::string split(const std::string& sum, int shift);
  /// A GLSL literal of exactly this value.
  static std::string double_literal(double value);

  /// Sums of w * u as expressions.
  struct Sums {
    std::function<std::string(int64_t oc)> expression;
    bool floating = false;  ///< not wrapped: may be scaled in doubles where the proof allows
    /// By output channel how far they are too low; nowhere if empty.
    std::vector<int64_t> less = {};
  };
  /// Appends bias, fused elementwise nodes and stores for channels [first, last) of the result at
  /// row y, column x, guarded where (y, x) may lie outside. `suffix` keeps the locals of unrolled
  /// copies apart.
  void results(std::string& text, int64_t first, int64_t last, const std::string& y,
               const std::string& x, const Sums& sums, const std::string& suffix);

  /// Variable that holds the channels around `c` of texel `index` of a Tiling.
  std::string texel(size_t index, int64_t c) const {
    return fmt::format("t{}_{}", index, c / lanes_);
  }
  /// Fetches input channels [first, second) of the texels of each of the invocation's tiles and runs `body` on them, in
  /// which `row` and `x` are the tile's.
  std::string over_rows(const Tiling& tiling, const std::string& body,
                        std::array<int64_t, 2> channels);
  /// Parts of the rows of tiles, even ones: an invocation makes all tiles of its column in one part.
  int64_t row_parts(const Tiling& tiling) const;
  /// Rows of tiles of a cell, where the problem asks for cells.
  int64_t cell_tiles(const Tiling& tiling) const;
  /// Fetches for a tile of one such loop over `channels`, on average.
  double fetches(const Tiling& tiling, std::array<int64_t, 2> channels) const;
  /// Tiles along y and x.
  std::array<int64_t, 2> tiles(const Tiling& tiling) const;

  /// `x`, `y`, `n` are the invocation's ids, of a grid of tiling's columns and loops over rows.
  KernelSource finish(const Tiling& tiling, const std::string& body);
  /// True if that grid can be dispatched.
  bool fits_grid(const Tiling& tiling) const;

  /// Output channels whose sums are live together, of `channels` in a module: few and equal groups,
  /// in fours so that results make words.
  int64_t channels_per_loop(int64_t channels) const;
  int64_t live_sums() const { return profile_.live_sums; }

 private:
  /// A RESCALE of sums as u = floor(sum * factor + constant), exact in doubles, where u = q + half is to
  /// be limited to [0, 2 half).
  struct Scale {
    ValueId output;
    double factor, constant;
    int64_t half;  ///< 128 or 32768
  };
  /// For sums that lack `added`. Nothing if the group has no such node, or one with products that a
  /// double may not hold.
  std::optional<Scale> scale_in_doubles(int64_t oc, int64_t added) const;
  /// Added to the sum of w * u to make the accumulator.
  int64_t offset(int64_t oc) const;
  /// A fetch takes 16 bytes.
  bool is_wide() const { return lanes_ > 1 && lanes_ * element_bytes_ == 16; }
  /// Channels of the result that are stored together: whole words, wide ones where `first` and `last` allow.
  int64_t stored_together(int64_t first, int64_t last) const;
  std::vector<int64_t> leaf_channels(ValueId id) const;
  /// The tensor that is fetched, where it is one.
  const Value& leaf() const;
  /// Channels [c, c + 4) of a texel that may begin within a word.
  std::string split_word(size_t binding, const Shape& shape, int64_t c);
  std::string inside(ValueId id, int64_t c);

  const GroupProblem& problem_;
  const DeviceProfile& profile_;
  const Graph& graph_;
  const Node& node_;
  const Tensor& weight_;
  Shape taps_;
  std::vector<std::optional<NodeId>> producers_;
  Codegen codegen_;
  int64_t element_bytes_, lanes_ = 1;
  bool split_words_ = false;
  std::set<std::string> functions_;
};

/// Invocations along x that run, idle lanes included: they come in eights.
int64_t literal_lanes(int64_t grid_x);

/// What sums are made in.
enum class Arithmetic {
  kInt32,       ///< any sums: TOSA's legal results wrap back into range
  kFloat32,     ///< partial sums below 2^24 in magnitude
  kDoublePair,  ///< two tiles next to each other at once, as a + 2^kPairSpacing b in doubles
  kDouble,      ///< partial sums below 2^53 in magnitude
};
inline constexpr int kPairSpacing = 24;
/// Sums of each tile have to stay below this in magnitude.
inline constexpr int64_t kPairExact = int64_t{1} << (kPairSpacing - 1);

/// A convolution as sums over texels of one value:
///   sum(pixel, oc) = sum over taps and c of weight(pixel, tap, oc, c) * u(texel of the tap, c).
/// The Tiling is of one invocation: of two tiles of the map with kDoublePair, of one without.
struct TapMap : Tiling {
  Arithmetic arithmetic = Arithmetic::kFloat32;
  /// For each tap its texel; with kDoublePair that of the tile to the right, too.
  std::vector<std::array<size_t, 2>> taps;
  int64_t products_per_channel = 0;  ///< with all weights of an output channel other than 0
  std::function<int64_t(int64_t pixel, size_t tap, int64_t oc, int64_t c)> weight;

  /// Makes the taps from the texels of one tile and, for kDoublePair, pairs of tiles.
  void finish(Arithmetic own);
  int64_t sides() const { return arithmetic == Arithmetic::kDoublePair ? 2 : 1; }
  /// Pixels of a tile of the map.
  int64_t pixels() const { return tile_height * tile_width / sides(); }
  int64_t products(const LiteralConv& conv) const;
};

/// Code for the map, as few modules as `most_products` (in one module) allows.
std::vector<KernelSource> emit_taps(const GroupProblem& problem, const DeviceProfile& profile,
                                    const TapMap& map, int64_t most_products);
/// What that code does.
WorkTable tap_work(const GroupProblem& problem, const DeviceProfile& profile, const TapMap& map,
                   int64_t most_products);
/// Number of modules of emit_taps; nothing if even a part of the channels is too much for one, or
/// the grid too large to be dispatched.
std::optional<int64_t> count_tap_modules(const LiteralConv& conv, const TapMap& map,
                                         int64_t most_products);

}  // namespace shale
