// tools/eval/flip.h -- the two halves of LDR-FLIP: features of a picture, and their difference.
// metrics.h has the public face.
#pragma once

#include "tools/eval/metrics.h"

namespace shale {

/// Features of an RGB picture in [0, 1].
FlipFeatures flip_features(const FloatImage& picture, double pixels_per_degree, uint32_t threads);

/// Mean of the map between a reference's features and a picture of its size. `map` may be null.
double flip_difference(const FlipFeatures& reference, const FloatImage& test,
                       double pixels_per_degree, uint32_t threads, FloatImage* map);

}  // namespace shale
