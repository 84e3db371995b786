// compiler/kernels/winograd.h -- F(2x2, 3x3): a 2x2 tile of results from 4x4 texels, with 16 products
// a channel in place of 36.
//   V = B^T d B (input),  U = G g G^T (weights, multiples of 1/4)
//   y = A^T [sum over channels of U * V, position by position] A
// Source: Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", 2015.
#pragma once

#include <cstdlib>
#include <string>

#include "compiler/kernels/literal_conv.h"

namespace shale::winograd {

inline constexpr int kBt[4][4] = {{1, 0, -1, 0}, {0, 1, 1, 0}, {0, -1, 1, 0}, {0, 1, 0, -1}};
// The last position has the other sign in both, as a minus there would be one of a whole sum: drivers
// carry it through the sum step by step.
inline constexpr int kAt[2][4] = {{1, 1, 1, 0}, {0, 1, -1, 1}};
inline constexpr int kG2[4][3] = {{2, 0, 0}, {1, 1, 1}, {1, -1, 1}, {0, 0, -2}};

/// Four times U.
inline int64_t transformed(const LiteralConv& conv, int64_t oc, size_t i, size_t j, int64_t c) {
  int64_t sum = 0;
  for (int64_t ky = 0; ky < 3; ++ky)
    for (int64_t kx = 0; kx < 3; ++kx) sum += kG2[i][ky] * kG2[j][kx] * conv.weight(oc, ky, kx, c);
  return sum;
}

/// What all of 4 U at a position are multiples of. The products leave it out: fewer different weights
/// are fewer constants in the cache.
inline int multiple(size_t i, size_t j) { return (i % 3 == 0 ? 2 : 1) * (j % 3 == 0 ? 2 : 1); }

/// The largest |V| at a position for texels of 0 to 255.
inline int64_t largest_input(size_t i, size_t j) { return i == 1 && j == 1 ? 1020 : 510; }

/// Products of a tile.
inline int64_t products(const LiteralConv& conv) {
  return 16 * conv.weight_shape()[0] * conv.weight_shape()[3];
}

/// True for a convolution of 3x3 and stride 1 whose texels hold whole words.
inline bool applies(const LiteralConv& conv) {
  const Shape& taps = conv.weight_shape();
  const auto all_one = [&](Attr attr) {
    return conv.ints(attr)[0] == 1 && conv.ints(attr)[1] == 1;
  };
  return !conv.is_depthwise() && taps[1] == 3 && taps[2] == 3 && all_one(Attr::kStride) &&
         all_one(Attr::kDilation) && conv.lanes() >= 4;
}

/// `tiles` 2x2 tiles next to each other.
inline Tiling tiling(const LiteralConv& conv, int64_t tiles) {
  Tiling tiling;
  tiling.source = conv.node().inputs[0];
  tiling.outside = conv.input_zero_point();
  tiling.tile_height = tiling.step_y = 2;
  tiling.tile_width = tiling.step_x = 2 * tiles;
  const std::span<const int64_t> pad = conv.ints(Attr::kPad);
  for (int64_t row = 0; row < 4; ++row)
    for (int64_t column = 0; column < 2 * tiles + 2; ++column)
      tiling.texels.push_back({row - pad[0], column - pad[2]});
  return tiling;
}

/// The first input channel of a part of several even ones.
inline int64_t part_start(const LiteralConv& conv, int64_t part, int64_t parts) {
  return conv.weight_shape()[3] * part / parts;
}

/// Sum of terms with signs.
template <typename Term>
std::string combine(const int (&signs)[4], const Term& term) {
  std::string plus, minus;
  for (size_t k = 0; k < 4; ++k)
    if (signs[k] > 0)
      plus += (plus.empty() ? "" : " + ") + term(k);
    else if (signs[k] < 0)
      minus += " - " + term(k);
  return "(" + plus + minus + ")";
}

}  // namespace shale::winograd
