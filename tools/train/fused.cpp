// The v1 passes on T-mapped colours for one CPU thread, value and gradient: what nss_passes.py computes in hundreds of
// small steps. Called by fused.py through plain C functions; arrays are float32, sizes in texels, checked there.
//
// Colours are four floats, the last one 1 (or 0 for a gradient), so that a weighted sum of colours carries its weight.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

namespace {

using F4 = float __attribute__((vector_size(16)));

constexpr float kHalfMax = 65504.0f;

float max3(F4 x) { return std::max(std::max(x[0], x[1]), x[2]); }
float sum3(F4 x) { return x[0] + x[1] + x[2]; }
F4 minimum(F4 a, F4 b) { return a < b ? a : b; }
F4 maximum(F4 a, F4 b) { return a > b ? a : b; }
F4 splat(float x) { return F4{x, x, x, x}; }
float clamped(float x, float low, float high) { return std::min(std::max(x, low), high); }
int clamped(int x, int low, int high) { return std::min(std::max(x, low), high); }

/// T of exposed colour.
F4 karis(F4 x) {
  x = x / (1.0f + max3(x));
  x[3] = 1.0f;
  return x;
}

struct Inverse {
  F4 value;
  float share;  // 1 / (1 - max)
  int largest;
  bool free;  // below the clamp of the maximum
};

Inverse karis_inverse(F4 x) {
  const int largest = x[0] >= x[1] ? (x[0] >= x[2] ? 0 : 2) : (x[1] >= x[2] ? 1 : 2);
  const bool free = x[largest] <= 1.0f - 1e-7f;
  const float share = 1.0f / (1.0f - std::min(x[largest], 1.0f - 1e-7f));
  return {minimum(x * share, splat(kHalfMax)), share, largest, free};
}

/// Gradient of karis_inverse at x.
F4 karis_inverse_slope(const Inverse& y, F4 x, F4 g) {
  const F4 wide = x * y.share;
  for (int c = 0; c < 3; ++c)
    if (wide[c] > kHalfMax) g[c] = 0.0f;
  F4 out = g * y.share;
  if (y.free) out[y.largest] += sum3(g * x) * y.share * y.share;
  return out;
}

/// A planar picture `[3, count]`, exposed, limited and T-mapped.
std::vector<F4> mapped(const float* planes, int count, float exposure) {
  std::vector<F4> out(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i) {
    const F4 x = F4{planes[i], planes[count + i], planes[2 * count + i], 0.0f} * exposure;
    out[static_cast<std::size_t>(i)] = karis(minimum(maximum(x, splat(0.0f)), splat(kHalfMax)));
  }
  return out;
}

/// Two texels of an axis and the share of the second.
struct Pair {
  int a, b;
  float t;
};

/// Bilinear interpolation at texel coordinate `x`, clamped to the picture.
Pair pair_at(float x, int size) {
  x = clamped(x, 0.0f, static_cast<float>(size - 1));
  const int a = static_cast<int>(x);
  return {a, std::min(a + 1, size - 1), x - static_cast<float>(a)};
}

struct Cubic {
  int at[4];  // -1, 0, 1, 2
  float w0, w12, w3, t;
};

Cubic cubic_at(float position, int size) {
  const float base = std::floor(position), f = position - base, f2 = f * f, f3 = f2 * f;
  const float w0 = f2 - 0.5f * (f3 + f), w1 = 1.5f * f3 - 2.5f * f2 + 1.0f, w3 = 0.5f * (f3 - f2);
  const float w2 = 1.0f - w0 - w1 - w3;
  Cubic out{{}, w0, w1 + w2, w3, w2 / (w1 + w2)};
  const int first = static_cast<int>(clamped(base, -2.0f, static_cast<float>(size + 1)));
  for (int i = 0; i < 4; ++i) out.at[i] = clamped(first - 1 + i, 0, size - 1);
  return out;
}

/// Five bilinear taps of Catmull-Rom without corners, with dering; image rows of `w`.
F4 catmull_rom(const F4* image, int w, int h, float px, float py) {
  const Cubic x = cubic_at(px, w), y = cubic_at(py, h);
  const auto at = [&](int i, int j) { return image[y.at[j] * w + x.at[i]]; };
  const auto mix = [](F4 a, F4 b, float t) { return a + (b - a) * t; };
  const F4 taps[5] = {mix(mix(at(1, 1), at(2, 1), x.t), mix(at(1, 2), at(2, 2), x.t), y.t),
                      mix(at(0, 1), at(0, 2), y.t), mix(at(3, 1), at(3, 2), y.t),
                      mix(at(1, 0), at(2, 0), x.t), mix(at(1, 3), at(2, 3), x.t)};
  const float weights[5] = {x.w12 * y.w12, x.w0 * y.w12, x.w3 * y.w12, x.w12 * y.w0, x.w12 * y.w3};
  F4 sum = splat(0.0f), low = taps[0], high = taps[0];
  float total = 0.0f;
  for (int i = 0; i < 5; ++i) {
    sum += taps[i] * weights[i];
    total += weights[i];
    low = minimum(low, taps[i]);
    high = maximum(high, taps[i]);
  }
  sum /= splat(total);
  constexpr float kNoOvershoot = 0.875f;  // shaders/include/color.glsl
  const bool beyond = std::min(std::min(sum[0], sum[1]), sum[2]) < 0.0f ||
                      std::max(std::max(sum[0], sum[1]), sum[2]) > kNoOvershoot;
  return beyond ? minimum(maximum(sum, low), high) : sum;
}

}  // namespace

extern "C" {

/// Sizes and pictures of the post pass of n frames; null pointers where there is none. Layouts: planes `[n, c, rows,
/// columns]`, but the kernel and its gradient `[n, rows, columns, channels]`.
struct Post {
  std::int32_t n, w, h, out_w, out_h, kernel_w, kernel_h, channels, padded_w, padded_h, network_w,
      network_h;
  std::int32_t shift, cubic, tile_w, tile_h, step_x, step_y, max_taps;
  float floor;
  const std::int32_t* taps;  // per cell max_taps of (dx, dy, channel, centre); channel -2 ends
  const float *colour, *motion, *exposure, *kernel, *temporal, *history;
  float *output, *filtered, *theta, *alpha;
  const float *g_output, *g_filtered, *g_theta, *g_alpha;
  float *g_kernel, *g_temporal, *g_history;
};

/// The results, or with g_kernel the gradients, which are added up: the caller clears them.
void shale_post(const Post* argument) {
  const Post& p = *argument;
  const int texels = p.w * p.h, pixels = p.out_w * p.out_h, padded = p.padded_w * p.padded_h;
  const int cells = p.kernel_w * p.kernel_h;
  std::vector<F4> back(p.g_history ? static_cast<std::size_t>(pixels) : 0);
  for (int n = 0; n < p.n; ++n) {
    const float exposure = p.exposure[n];
    const std::vector<F4> colour = mapped(p.colour + n * 3 * texels, texels, exposure);
    std::vector<F4> history;
    if (p.history) history = mapped(p.history + n * 3 * pixels, pixels, exposure);
    std::fill(back.begin(), back.end(), splat(0.0f));
    const float* kernel = p.kernel + n * cells * p.channels;
    const float* temporal = p.temporal + n * 4 * padded;
    for (int y = 0; y < p.out_h; ++y) {
      const Pair row = pair_at((static_cast<float>(y) + 0.5f) * static_cast<float>(p.network_h) /
                                       static_cast<float>(p.out_h) -
                                   0.5f,
                               p.padded_h);
      for (int x = 0; x < p.out_w; ++x) {
        const int at = y * p.out_w + x;
        const Pair column =
            pair_at((static_cast<float>(x) + 0.5f) * static_cast<float>(p.network_w) /
                            static_cast<float>(p.out_w) -
                        0.5f,
                    p.padded_w);
        const int corner[4] = {row.a * p.padded_w + column.a, row.a * p.padded_w + column.b,
                               row.b * p.padded_w + column.a, row.b * p.padded_w + column.b};
        const float share[4] = {(1 - row.t) * (1 - column.t), (1 - row.t) * column.t,
                                row.t * (1 - column.t), row.t * column.t};
        float parameter[3];
        for (int c = 0; c < 3; ++c) {
          const float* plane = temporal + c * padded;
          parameter[c] = plane[corner[0]] * share[0] + plane[corner[1]] * share[1] +
                         plane[corner[2]] * share[2] + plane[corner[3]] * share[3];
        }
        const float up = parameter[0] * parameter[0],
                    down = (1 - parameter[0]) * (1 - parameter[0]);
        const float theta = up / (up + down), alpha = 0.35f * parameter[1] + 0.05f;

        // The sparse filter.
        const std::int32_t* taps =
            p.taps + ((y % p.tile_h) * p.tile_w + x % p.tile_w) * p.max_taps * 4;
        const int base_x = x / p.tile_w * p.step_x, base_y = y / p.tile_h * p.step_y;
        F4 sum = splat(0.0f), squares = splat(0.0f), centre = splat(0.0f);
        F4 samples[16];
        int places[16], count = 0;
        bool has_centre = false;
        for (; count < p.max_taps && taps[4 * count + 2] >= -1; ++count) {
          const int lx = base_x + taps[4 * count], ly = base_y + taps[4 * count + 1],
                    channel = taps[4 * count + 2];
          const F4 sample = colour[static_cast<std::size_t>(clamped(ly, 0, p.h - 1) * p.w +
                                                            clamped(lx, 0, p.w - 1))];
          const int kx = clamped(lx >> p.shift, 0, p.kernel_w - 1),
                    ky = clamped(ly >> p.shift, 0, p.kernel_h - 1);
          places[count] = channel < 0 ? -1 : (ky * p.kernel_w + kx) * p.channels + channel;
          const float weight = channel < 0 ? 1.0f : std::max(kernel[places[count]], p.floor);
          samples[count] = sample;
          sum += sample * weight;
          squares += sample * sample * weight;
          if (taps[4 * count + 3]) centre = sample, has_centre = true;
        }
        const float inverse = 1.0f / sum[3];
        const F4 m1 = sum * inverse, m2 = squares * inverse;

        // The history, and what is made of both.
        F4 mixed = m1, past = splat(0.0f), held = m1, sigma = splat(0.0f), root = splat(0.0f);
        float blend = 0.0f, onscreen = 0.0f, px = 0.0f, py = 0.0f;
        if (p.history) {
          const int mx = (2 * x + 1) * p.w / (2 * p.out_w), my = (2 * y + 1) * p.h / (2 * p.out_h);
          float u = p.motion[n * 2 * texels + my * p.w + mx],
                v = p.motion[(n * 2 + 1) * texels + my * p.w + mx];
          const float su = u * static_cast<float>(p.out_w), sv = v * static_cast<float>(p.out_h);
          if (!(std::sqrt(su * su + sv * sv) > 0.1f)) u = v = 0.0f;
          const float rx = (static_cast<float>(x) + 0.5f) / static_cast<float>(p.out_w) - u,
                      ry = (static_cast<float>(y) + 0.5f) / static_cast<float>(p.out_h) - v;
          onscreen = rx >= 0.0f && rx < 1.0f && ry >= 0.0f && ry < 1.0f ? 1.0f : 0.0f;
          px = rx * static_cast<float>(p.out_w) - 0.5f;
          py = ry * static_cast<float>(p.out_h) - 0.5f;
          if (p.cubic) {
            past = catmull_rom(history.data(), p.out_w, p.out_h, px, py);
          } else {
            const Pair cx = pair_at(px, p.out_w), cy = pair_at(py, p.out_h);
            const F4 *a = &history[static_cast<std::size_t>(cy.a * p.out_w)],
                     *b = &history[static_cast<std::size_t>(cy.b * p.out_w)];
            const F4 top = a[cx.a] + (a[cx.b] - a[cx.a]) * cx.t,
                     bottom = b[cx.a] + (b[cx.b] - b[cx.a]) * cx.t;
            past = top + (bottom - top) * cy.t;
          }
        }
        const F4 clear = minimum(maximum(past, splat(0.0f)), splat(1.0f));
        F4 variance = splat(0.0f), unmixed = m1;
        if (p.history) {
          variance = m2 - m1 * m1;
          for (int c = 0; c < 4; ++c) root[c] = std::sqrt(std::max(std::fabs(variance[c]), 1e-7f));
          sigma = root * (2.0f * parameter[2]);
          held = minimum(maximum(clear, m1 - sigma), m1 + sigma);
          blend = theta * onscreen;
          unmixed = mixed = held + (clear - held) * blend;
          if (has_centre) mixed = mixed + (centre - mixed) * alpha;
        }
        const Inverse shown = karis_inverse(mixed), filtered = karis_inverse(m1);

        if (!p.g_kernel) {
          for (int c = 0; c < 3; ++c) {
            p.output[(n * 3 + c) * pixels + at] = shown.value[c] / exposure;
            p.filtered[(n * 3 + c) * pixels + at] = filtered.value[c];
          }
          p.theta[n * pixels + at] = theta;
          p.alpha[n * pixels + at] = alpha;
          continue;
        }

        F4 g = splat(0.0f), g_filtered = splat(0.0f);
        for (int c = 0; c < 3; ++c) {
          g[c] = p.g_output[(n * 3 + c) * pixels + at] / exposure;
          g_filtered[c] = p.g_filtered[(n * 3 + c) * pixels + at];
        }
        g = karis_inverse_slope(shown, mixed, g);
        F4 g_m1 = karis_inverse_slope(filtered, m1, g_filtered), g_m2 = splat(0.0f);
        float g_theta = p.g_theta[n * pixels + at], g_alpha = p.g_alpha[n * pixels + at],
              g_gamma = 0.0f;
        if (!p.history) {
          g_m1 += g;
        } else {
          if (has_centre) {
            g_alpha += sum3(g * (centre - unmixed));
            g = g * (1.0f - alpha);
          }
          g_theta += onscreen * sum3(g * (clear - held));
          F4 g_held = g * (1.0f - blend), g_clear = g * blend;
          for (int c = 0; c < 3; ++c) {
            const bool below = clear[c]<m1[c] - sigma[c], above = clear[c]> m1[c] + sigma[c];
            if (!below && !above) {
              g_clear[c] += g_held[c];
              continue;
            }
            g_m1[c] += g_held[c];
            const float g_sigma = above ? g_held[c] : -g_held[c];
            g_gamma += g_sigma * 2.0f * root[c];
            if (std::fabs(variance[c]) >= 1e-7f) {
              const float g_variance =
                  g_sigma * parameter[2] / root[c] * (variance[c] < 0.0f ? -1.0f : 1.0f);
              g_m2[c] += g_variance;
              g_m1[c] -= 2.0f * m1[c] * g_variance;
            }
          }
          if (p.g_history) {
            const Pair cx = pair_at(px, p.out_w), cy = pair_at(py, p.out_h);
            for (int c = 0; c < 3; ++c)
              if (past[c] < 0.0f || past[c] > 1.0f) g_clear[c] = 0.0f;
            back[static_cast<std::size_t>(cy.a * p.out_w + cx.a)] +=
                g_clear * ((1 - cy.t) * (1 - cx.t));
            back[static_cast<std::size_t>(cy.a * p.out_w + cx.b)] += g_clear * ((1 - cy.t) * cx.t);
            back[static_cast<std::size_t>(cy.b * p.out_w + cx.a)] += g_clear * (cy.t * (1 - cx.t));
            back[static_cast<std::size_t>(cy.b * p.out_w + cx.b)] += g_clear * (cy.t * cx.t);
          }
        }
        g_m1[3] = g_m2[3] = 0.0f;
        for (int i = 0; i < count; ++i) {
          const int place = places[i];
          if (place < 0 || kernel[place] < p.floor) continue;
          p.g_kernel[n * cells * p.channels + place] +=
              inverse * sum3(g_m1 * (samples[i] - m1) + g_m2 * (samples[i] * samples[i] - m2));
        }
        const float whole = up + down;
        const float slope[3] = {
            g_theta * 2.0f * parameter[0] * (1 - parameter[0]) / (whole * whole), g_alpha * 0.35f,
            g_gamma};
        for (int c = 0; c < 3; ++c)
          for (int i = 0; i < 4; ++i)
            p.g_temporal[(n * 4 + c) * padded + corner[i]] += slope[c] * share[i];
      }
    }
    if (!p.g_history) continue;
    for (int i = 0; i < pixels; ++i) {  // T and the exposure of the history
      const float* x = p.history + n * 3 * pixels + i;
      const F4 exposed = F4{x[0], x[pixels], x[2 * pixels], 0.0f} * exposure,
               g = back[static_cast<std::size_t>(i)];
      const F4 inside = minimum(maximum(exposed, splat(0.0f)), splat(kHalfMax));
      const int largest = inside[0] >= inside[1] ? (inside[0] >= inside[2] ? 0 : 2)
                                                 : (inside[1] >= inside[2] ? 1 : 2);
      const float s = 1.0f / (1.0f + inside[largest]);
      F4 slope = g * s;
      slope[largest] -= sum3(g * inside) * s * s;
      for (int c = 0; c < 3; ++c)
        p.g_history[(n * 3 + c) * pixels + i] =
            exposed[c] >= 0.0f && exposed[c] <= kHalfMax ? slope[c] * exposure : 0.0f;
    }
  }
}

/// Sizes and pictures of the pre pass of n frames at a network of the render size; null pointers where there is none.
struct Pre {
  std::int32_t n, w, h, out_w, out_h, padded_w, padded_h, reverse;
  float jitter_x, jitter_y, full_w, full_h;
  const float *colour, *depth, *motion, *exposure, *camera, *history, *memory, *feedback;
  float *input, *raw, *disocclusion, *kept, *nearest;  // input `[n, 12, h, w]`, kept `[n, 4, h, w]`
  const float* g_input;
  float *g_history, *g_feedback;
};

/// The results, or with g_input the gradients, which are added up: the caller clears them.
void shale_pre(const Pre* argument) {
  const Pre& p = *argument;
  const int texels = p.w * p.h, pixels = p.out_w * p.out_h, padded = p.padded_w * p.padded_h;
  const float w = static_cast<float>(p.w), h = static_cast<float>(p.h);
  const float out_w = static_cast<float>(p.out_w), out_h = static_cast<float>(p.out_h);
  const auto cut = [&](float& u, float& v) {
    const float x = u * w, y = v * h;
    if (!(std::sqrt(x * x + y * y) > 0.1f)) u = v = 0.0f;
  };
  const auto nearer = [&](float a, float b) { return p.reverse ? a > b : a < b; };
  // Bilinear at uv (rx, ry) of a part of w x h texels in a padded picture.
  const auto inside_padded = [&](float r, float size, int whole) {
    return pair_at(r * size - 0.5f, whole);
  };

  if (p.g_input) {
    for (int n = 0; n < p.n; ++n)
      for (int at = 0; at < texels; ++at) {
        float u = p.raw[n * 2 * texels + at], v = p.raw[(n * 2 + 1) * texels + at];
        cut(u, v);
        const float rx = (static_cast<float>(at % p.w) + 0.5f) / w - u,
                    ry = (static_cast<float>(at / p.w) + 0.5f) / h - v;
        const float* g = p.g_input + n * 12 * texels + at;
        if (p.g_history) {
          const Pair x = pair_at(rx * out_w - 0.5f, p.out_w),
                     y = pair_at(ry * out_h - 0.5f, p.out_h);
          const int corner[4] = {y.a * p.out_w + x.a, y.a * p.out_w + x.b, y.b * p.out_w + x.a,
                                 y.b * p.out_w + x.b};
          const float share[4] = {(1 - y.t) * (1 - x.t), (1 - y.t) * x.t, y.t * (1 - x.t),
                                  y.t * x.t};
          F4 sum = splat(0.0f), slope = splat(0.0f);
          for (int c = 0; c < 3; ++c)
            for (int i = 0; i < 4; ++i)
              sum[c] += p.history[(n * 3 + c) * pixels + corner[i]] * share[i];
          const F4 exposed = sum * p.exposure[n],
                   held = minimum(maximum(exposed, splat(0.0f)), splat(kHalfMax));
          const int largest =
              held[0] >= held[1] ? (held[0] >= held[2] ? 0 : 2) : (held[1] >= held[2] ? 1 : 2);
          const float s = 1.0f / (1.0f + held[largest]);
          for (int c = 0; c < 3; ++c) slope[c] = g[c * texels] * s;
          slope[largest] -=
              (g[0] * held[0] + g[texels] * held[1] + g[2 * texels] * held[2]) * s * s;
          for (int c = 0; c < 3; ++c) {
            if (exposed[c] < 0.0f || exposed[c] > kHalfMax) continue;
            for (int i = 0; i < 4; ++i)
              p.g_history[(n * 3 + c) * pixels + corner[i]] += slope[c] * p.exposure[n] * share[i];
          }
        }
        if (p.g_feedback && !(p.disocclusion[n * texels + at] > 0.01f)) {
          const Pair x = inside_padded(rx, w, p.padded_w), y = inside_padded(ry, h, p.padded_h);
          const int corner[4] = {y.a * p.padded_w + x.a, y.a * p.padded_w + x.b,
                                 y.b * p.padded_w + x.a, y.b * p.padded_w + x.b};
          const float share[4] = {(1 - y.t) * (1 - x.t), (1 - y.t) * x.t, y.t * (1 - x.t),
                                  y.t * x.t};
          for (int c = 0; c < 4; ++c)
            for (int i = 0; i < 4; ++i)
              p.g_feedback[(n * 4 + c) * padded + corner[i]] += g[(7 + c) * texels] * share[i];
        }
      }
    return;
  }

  const int columns = (p.w + 1) / 2, rows = (p.h + 1) / 2;
  std::vector<float> z_old(static_cast<std::size_t>(columns * rows));
  std::vector<F4> work(static_cast<std::size_t>(texels)), now(work.size());
  const float length = std::hypot(p.full_w, p.full_h);
  const float power = 1.0f + 2.0f * std::min(length / std::hypot(1920.0f, 1080.0f), 1.0f);
  const float unit = std::hypot(1.0f / p.full_w, 1.0f / p.full_h);
  const auto ramp = [](float x, float low, float high) {
    return clamped((x - low) / (high - low), 0.0f, 1.0f);
  };
  const auto lerp = [](float a, float b, float t) { return a + (b - a) * t; };
  for (int n = 0; n < p.n; ++n) {
    const float *depth = p.depth + n * texels, *mu = p.motion + n * 2 * texels, *mv = mu + texels;
    const float *camera = p.camera + 4 * n, exposure = p.exposure[n];
    const auto view_z = [&](float d) { return camera[1] / (d - camera[0]); };

    // 2.4 b: what the surfaces of now looked like one frame ago.
    std::fill(z_old.begin(), z_old.end(), p.reverse ? 0.0f : 1.0f);
    for (int y = 0; y < rows; ++y)
      for (int x = 0; x < columns; ++x) {
        int best = 2 * y * p.w + 2 * x;
        for (int i = 1; i < 4; ++i) {
          const int at = std::min(2 * y + i / 2, p.h - 1) * p.w + std::min(2 * x + i % 2, p.w - 1);
          if (nearer(depth[at], depth[best])) best = at;
        }
        float u = mu[best], v = mv[best];
        cut(u, v);
        const float px = ((static_cast<float>(x) + 0.5f) / static_cast<float>(columns) - u) *
                             static_cast<float>(columns) -
                         0.5f;
        const float py = ((static_cast<float>(y) + 0.5f) / static_cast<float>(rows) - v) *
                             static_cast<float>(rows) -
                         0.5f;
        const float bx = std::floor(px), by = std::floor(py), fx = px - bx, fy = py - by;
        const float value = std::floor(depth[best] * 2147483648.0f) / 2147483648.0f;
        for (int i = 0; i < 4; ++i) {
          const float weight = (i / 2 ? fy : 1 - fy) * (i % 2 ? fx : 1 - fx);
          const float tx = bx + static_cast<float>(i % 2), ty = by + static_cast<float>(i / 2);
          if (!(weight > 0.1f) || tx < 0 || ty < 0 || tx >= static_cast<float>(columns) ||
              ty >= static_cast<float>(rows))
            continue;
          float& cell = z_old[static_cast<std::size_t>(static_cast<int>(ty) * columns +
                                                       static_cast<int>(tx))];
          if (nearer(value, cell)) cell = value;
        }
      }
    for (float& cell : z_old) cell = view_z(cell);

    // The current colour without jitter, and its work colour (Y, Co, Cg).
    for (int at = 0; at < texels; ++at) {
      const Pair x = pair_at(static_cast<float>(at % p.w) - p.jitter_x, p.w),
                 y = pair_at(static_cast<float>(at / p.w) - p.jitter_y, p.h);
      const auto texel = [&](int c, int row, int column) {
        return std::min(p.colour[(n * 3 + c) * texels + row * p.w + column] * exposure, kHalfMax);
      };
      F4 colour = splat(0.0f);
      for (int c = 0; c < 3; ++c)
        colour[c] = (1 - y.t) * ((1 - x.t) * texel(c, y.a, x.a) + x.t * texel(c, y.a, x.b)) +
                    y.t * ((1 - x.t) * texel(c, y.b, x.a) + x.t * texel(c, y.b, x.b));
      now[static_cast<std::size_t>(at)] = colour;
      const float r = std::sqrt(colour[0]), g = std::sqrt(colour[1]), b = std::sqrt(colour[2]),
                  t = b + (r - b) * 0.5f;
      work[static_cast<std::size_t>(at)] = F4{t + (g - t) * 0.5f, r - b, g - t, 0.0f};
    }
    const auto distance = [](F4 a, F4 b) {
      const F4 d = (a - b) * (a - b);
      return std::sqrt(d[0] + 1.5625f * (d[1] + d[2]));
    };

    const float scale =
        1.37e-5f * length * std::sqrt(camera[2] * camera[2] + camera[3] * camera[3] + 1.0f);
    for (int y = 0; y < p.h; ++y)
      for (int x = 0; x < p.w; ++x) {
        const int at = y * p.w + x;
        int best = at;
        for (int dy = -1; dy <= 2; ++dy)
          for (int dx = -1; dx <= 2; ++dx) {
            const int tap = clamped(y + dy, 0, p.h - 1) * p.w + clamped(x + dx, 0, p.w - 1);
            if (nearer(depth[tap], depth[best])) best = tap;
          }
        float u = mu[best], v = mv[best];
        p.raw[n * 2 * texels + at] = u;
        p.raw[(n * 2 + 1) * texels + at] = v;
        p.nearest[n * texels + at] = depth[best];
        cut(u, v);
        const float rx = (static_cast<float>(x) + 0.5f) / w - u,
                    ry = (static_cast<float>(y) + 0.5f) / h - v;

        // 2.2
        const float z = view_z(depth[best]);
        const float px = rx * static_cast<float>(columns) - 0.5f,
                    py = ry * static_cast<float>(rows) - 0.5f;
        const float bx = std::floor(px), by = std::floor(py), fx = px - bx, fy = py - by;
        float kept = 0.0f, total = 0.0f;
        for (int i = 0; i < 4; ++i) {
          const float weight = (i / 2 ? fy : 1 - fy) * (i % 2 ? fx : 1 - fx);
          const float tx = bx + static_cast<float>(i % 2), ty = by + static_cast<float>(i / 2);
          if (tx < 0 || ty < 0 || tx >= static_cast<float>(columns) ||
              ty >= static_cast<float>(rows)) {
            total += weight;
            continue;
          }
          const float before = z_old[static_cast<std::size_t>(static_cast<int>(ty) * columns +
                                                              static_cast<int>(tx))];
          const float difference = z - before;
          if (!(weight > 0.1f) || !(difference > 0.0f)) continue;
          const float close =
              clamped(scale * std::max(z, before) / std::max(difference, 1e-30f), 0.0f, 1.0f);
          kept += weight * (close < 1.0f ? std::pow(close, power) : 1.0f);
          total += weight;
        }
        const float mask =
            total > 0.0f ? clamped(1.0f - kept / std::max(total, 1e-30f), 0.0f, 1.0f) : 0.0f;
        p.disocclusion[n * texels + at] = mask;
        const bool disoccluded = mask > 0.01f;

        float* input = p.input + n * 12 * texels + at;
        F4 past = splat(0.0f);
        if (p.history) {
          const Pair cx = pair_at(rx * out_w - 0.5f, p.out_w),
                     cy = pair_at(ry * out_h - 0.5f, p.out_h);
          for (int c = 0; c < 3; ++c) {
            const float *a = p.history + (n * 3 + c) * pixels + cy.a * p.out_w,
                        *b = p.history + (n * 3 + c) * pixels + cy.b * p.out_w;
            past[c] = (1 - cy.t) * ((1 - cx.t) * a[cx.a] + cx.t * a[cx.b]) +
                      cy.t * ((1 - cx.t) * b[cx.a] + cx.t * b[cx.b]);
          }
          past = karis(minimum(maximum(past * exposure, splat(0.0f)), splat(kHalfMax)));
        }
        const F4 shown = karis(now[static_cast<std::size_t>(at)]);
        for (int c = 0; c < 3; ++c) {
          input[c * texels] = past[c];
          input[(3 + c) * texels] = shown[c];
        }
        const float su = u * (w / p.full_w), sv = v * (h / p.full_h);
        input[6 * texels] = std::sqrt(
            (clamped(std::sqrt(su * su + sv * sv), unit, 200 * unit) - unit) / (199 * unit));

        const Pair mx = inside_padded(rx, w, p.padded_w), my = inside_padded(ry, h, p.padded_h);
        const auto sampled = [&](const float* planes, int c) {
          const float *a = planes + (n * 4 + c) * padded + my.a * p.padded_w,
                      *b = planes + (n * 4 + c) * padded + my.b * p.padded_w;
          return (1 - my.t) * ((1 - mx.t) * a[mx.a] + mx.t * a[mx.b]) +
                 my.t * ((1 - mx.t) * b[mx.a] + mx.t * b[mx.b]);
        };
        for (int c = 0; c < 4; ++c)
          input[(7 + c) * texels] = p.feedback && !disoccluded ? sampled(p.feedback, c) : 0.0f;

        // 2.5
        F4 state = splat(0.0f);
        if (p.memory)
          for (int c = 0; c < 4; ++c) state[c] = sampled(p.memory, c);
        const F4 own = work[static_cast<std::size_t>(at)],
                 previous{(state[0] + 1) * 4, state[1] * 8, state[2] * 8, 0.0f};
        const float last = (state[3] + 1) * 0.5f;
        float sum = 0.0f, most = 0.0f;
        for (int i = 0; i < 4; ++i) {
          static constexpr int kX[4] = {0, 0, 1, -1}, kY[4] = {-1, 1, 0, 0};
          const float d =
              distance(own, work[static_cast<std::size_t>(clamped(y + kY[i], 0, p.h - 1) * p.w +
                                                          clamped(x + kX[i], 0, p.w - 1))]);
          sum += d;
          most = std::max(most, d);
        }
        const float s =
            0.75f * lerp(distance(own, previous), std::max(sum - most, 0.0f) / 3, 0.30f);
        const float recall = ramp(s, 0.065f, 0.42f), mean = ramp(s, 0.07f, 0.23f);
        const float entry =
            std::sqrt(recall) * std::sqrt(ramp(std::max(s - last, 0.0f), 0.025f, 0.16f)) * mean;
        const float heat = ramp(last, 0.11f, 0.21f), floor = lerp(0.177f, 0.157f, heat),
                    ceiling = lerp(0.33f, 0.305f, heat);
        float sg = clamped((lerp(last, s, 0.3f) - floor) / (ceiling - floor), 0.0f, 1.0f);
        sg *= sg;
        const float hold = ramp(last, 0.18f, 0.28f);
        const float raw = std::max(entry, 0.8f * last * std::max(sg, 0.12f * hold * hold));
        const float decay = std::max(sg, 0.5f * heat * heat);
        float next = lerp(
            last, raw,
            raw > last ? lerp(0.08f, 0.22f, std::sqrt(recall * mean)) : lerp(0.24f, 0.05f, decay));
        float visible = lerp(last, next, next > last ? 0.75f : 0.80f);
        if (disoccluded ||
            std::fabs(state[0]) + std::fabs(state[1]) + std::fabs(state[2]) + std::fabs(state[3]) <
                1e-4f)
          next = visible = 0.0f;
        input[11 * texels] = visible;
        const float stored[4] = {own[0] / 4 - 1, own[1] / 8, own[2] / 8, 2 * next - 1};
        for (int c = 0; c < 4; ++c)
          p.kept[(n * 4 + c) * texels + at] =
              std::floor(clamped(stored[c], -1.0f, 1.0f) * 127 + 0.5f) / 127;
      }
  }
}

/// Planes `[count, h, w]`, h and w even; exposure per three planes. Of the display pictures d(x) = sqrt(x / (1 + x)):
/// truth, error, the loss L_S of train_nss.py and mean|filtered - truth|, and what their gradients need.
struct Spatial {
  std::int32_t count, h, w;
  float low, grid;
  const float *output, *filtered, *truth, *exposure;
  float *wanted, *error, *slope, *steep, *filtered_slope;
  double value[2];
};

void shale_spatial(Spatial* argument) {
  Spatial& s = *argument;
  const int size = s.h * s.w, pooled_w = s.w / 8, pooled_h = s.h / 8;
  const float every = 1.0f / static_cast<float>(s.count * size);
  const float along_x = 0.25f / static_cast<float>(s.count * s.h * (s.w - 1));
  const float along_y = 0.25f / static_cast<float>(s.count * (s.h - 1) * s.w);
  const float pool =
      pooled_w * pooled_h ? s.low / static_cast<float>(s.count * pooled_w * pooled_h) : 0.0f;
  const float haar = s.grid * 4.0f / static_cast<float>(3 * s.count * size);
  double value = 0.0, filtered_value = 0.0;
  const auto sign = [](float x) { return static_cast<float>((x > 0.0f) - (x < 0.0f)); };
  for (int plane = 0; plane < s.count; ++plane) {
    const int at = plane * size;
    const float exposure = s.exposure[plane / 3];
    float *wanted = s.wanted + at, *error = s.error + at, *slope = s.slope + at;
    float sums[2] = {0.0f, 0.0f};
    for (int i = 0; i < size; ++i) {
      const float t = s.truth[at + i] * exposure, x = s.output[at + i] * exposure,
                  f = s.filtered[at + i];
      const float share = 1.0f / (1.0f + x), f_share = 1.0f / (1.0f + f);
      const float y = std::sqrt(x * share + 1e-4f), fy = std::sqrt(f * f_share + 1e-4f);
      wanted[i] = std::sqrt(t / (1.0f + t) + 1e-4f);
      const float e = y - wanted[i], fe = fy - wanted[i];
      error[i] = e;
      s.steep[at + i] = share * share * 0.5f / y * exposure;
      s.filtered_slope[at + i] = sign(fe) * f_share * f_share * 0.5f / fy * every;
      slope[i] = (sign(e) + 8.0f * e) * every;
      sums[0] += std::fabs(e) + 4.0f * e * e;
      sums[1] += std::fabs(fe);
    }
    value += sums[0] * every;
    filtered_value += sums[1] * every;
    float steps[2] = {0.0f, 0.0f};
    for (int y = 0; y < s.h; ++y) {
      const float* e = error + y * s.w;
      float* g = slope + y * s.w;
      for (int x = 0; x + 1 < s.w; ++x) {
        const float d = e[x + 1] - e[x];
        steps[0] += std::fabs(d);
        g[x + 1] += sign(d) * along_x;
        g[x] -= sign(d) * along_x;
      }
      for (int x = 0; y + 1 < s.h && x < s.w; ++x) {
        const float d = e[x + s.w] - e[x];
        steps[1] += std::fabs(d);
        g[x + s.w] += sign(d) * along_y;
        g[x] -= sign(d) * along_y;
      }
    }
    value += steps[0] * along_x + steps[1] * along_y;
    for (int y = 0; y < pooled_h * 8; y += 8)
      for (int x = 0; x < pooled_w * 8; x += 8) {
        float mean = 0.0f;
        for (int i = 0; i < 64; ++i) mean += error[(y + i / 8) * s.w + x + i % 8];
        value += pool * std::fabs(mean) / 64.0f;
        const float g = pool / 64.0f * sign(mean);
        for (int i = 0; i < 64; ++i) slope[(y + i / 8) * s.w + x + i % 8] += g;
      }
    for (int y = 0; y < s.h; y += 2)
      for (int x = 0; x < s.w; x += 2) {
        const int corner = y * s.w + x,
                  place[4] = {corner, corner + 1, corner + s.w, corner + s.w + 1};
        static constexpr float kSigns[3][4] = {{1, -1, 1, -1}, {1, 1, -1, -1}, {1, -1, -1, 1}};
        for (const auto& signs : kSigns) {
          float truth = 0.0f, found = 0.0f;
          for (int i = 0; i < 4; ++i) {
            truth += signs[i] * wanted[place[i]];
            found += signs[i] * error[place[i]];
          }
          if (!(std::fabs(truth) < 0.04f)) continue;
          value += haar * std::fabs(found) / 4.0f;
          for (int i = 0; i < 4; ++i) slope[place[i]] += haar / 4.0f * sign(found) * signs[i];
        }
      }
  }
  s.value[0] = value;
  s.value[1] = filtered_value;
}

}  // extern "C"
