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
  const F4 taps[5] = {mix(mix(at(1, 1), at(2, 1), x.t), mix(at(1, 2), at(2, 2), x.t), y.t), mix(at(0, 1), at(0, 2), y.t),
                      mix(at(3, 1), at(3, 2), y.t), mix(at(1, 0), at(2, 0), x.t), mix(at(1, 3), at(2, 3), x.t)};
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
  return std::min(std::min(sum[0], sum[1]), sum[2]) < 0.0f ? minimum(maximum(sum, low), high) : sum;
}

}  // namespace

extern "C" {

/// Sizes and pictures of the post pass of n frames; null pointers where there is none. Layouts: planes `[n, c, rows,
/// columns]`, but the kernel and its gradient `[n, rows, columns, channels]`.
struct Post {
  std::int32_t n, w, h, out_w, out_h, kernel_w, kernel_h, channels, padded_w, padded_h, network_w, network_h;
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
      const Pair row = pair_at((static_cast<float>(y) + 0.5f) * static_cast<float>(p.network_h) / static_cast<float>(p.out_h) - 0.5f, p.padded_h);
      for (int x = 0; x < p.out_w; ++x) {
        const int at = y * p.out_w + x;
        const Pair column = pair_at((static_cast<float>(x) + 0.5f) * static_cast<float>(p.network_w) / static_cast<float>(p.out_w) - 0.5f, p.padded_w);
        const int corner[4] = {row.a * p.padded_w + column.a, row.a * p.padded_w + column.b,
                               row.b * p.padded_w + column.a, row.b * p.padded_w + column.b};
        const float share[4] = {(1 - row.t) * (1 - column.t), (1 - row.t) * column.t, row.t * (1 - column.t),
                                row.t * column.t};
        float parameter[3];
        for (int c = 0; c < 3; ++c) {
          const float* plane = temporal + c * padded;
          parameter[c] = plane[corner[0]] * share[0] + plane[corner[1]] * share[1] + plane[corner[2]] * share[2] +
                         plane[corner[3]] * share[3];
        }
        const float up = parameter[0] * parameter[0], down = (1 - parameter[0]) * (1 - parameter[0]);
        const float theta = up / (up + down), alpha = 0.35f * parameter[1] + 0.05f;

        // The sparse filter.
        const std::int32_t* taps = p.taps + ((y % p.tile_h) * p.tile_w + x % p.tile_w) * p.max_taps * 4;
        const int base_x = x / p.tile_w * p.step_x, base_y = y / p.tile_h * p.step_y;
        F4 sum = splat(0.0f), squares = splat(0.0f), centre = splat(0.0f);
        F4 samples[16];
        int places[16], count = 0;
        bool has_centre = false;
        for (; count < p.max_taps && taps[4 * count + 2] >= -1; ++count) {
          const int lx = base_x + taps[4 * count], ly = base_y + taps[4 * count + 1], channel = taps[4 * count + 2];
          const F4 sample = colour[static_cast<std::size_t>(clamped(ly, 0, p.h - 1) * p.w + clamped(lx, 0, p.w - 1))];
          const int kx = clamped(lx >> p.shift, 0, p.kernel_w - 1), ky = clamped(ly >> p.shift, 0, p.kernel_h - 1);
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
          float u = p.motion[n * 2 * texels + my * p.w + mx], v = p.motion[(n * 2 + 1) * texels + my * p.w + mx];
          const float su = u * static_cast<float>(p.out_w), sv = v * static_cast<float>(p.out_h);
          if (!(std::sqrt(su * su + sv * sv) > 0.1f)) u = v = 0.0f;
          const float rx = (static_cast<float>(x) + 0.5f) / static_cast<float>(p.out_w) - u, ry = (static_cast<float>(y) + 0.5f) / static_cast<float>(p.out_h) - v;
          onscreen = rx >= 0.0f && rx < 1.0f && ry >= 0.0f && ry < 1.0f ? 1.0f : 0.0f;
          px = rx * static_cast<float>(p.out_w) - 0.5f;
          py = ry * static_cast<float>(p.out_h) - 0.5f;
          if (p.cubic) {
            past = catmull_rom(history.data(), p.out_w, p.out_h, px, py);
          } else {
            const Pair cx = pair_at(px, p.out_w), cy = pair_at(py, p.out_h);
            const F4 *a = &history[static_cast<std::size_t>(cy.a * p.out_w)], *b = &history[static_cast<std::size_t>(cy.b * p.out_w)];
            const F4 top = a[cx.a] + (a[cx.b] - a[cx.a]) * cx.t, bottom = b[cx.a] + (b[cx.b] - b[cx.a]) * cx.t;
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
        float g_theta = p.g_theta[n * pixels + at], g_alpha = p.g_alpha[n * pixels + at], g_gamma = 0.0f;
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
            const bool below = clear[c] < m1[c] - sigma[c], above = clear[c] > m1[c] + sigma[c];
            if (!below && !above) {
              g_clear[c] += g_held[c];
              continue;
            }
            g_m1[c] += g_held[c];
            const float g_sigma = above ? g_held[c] : -g_held[c];
            g_gamma += g_sigma * 2.0f * root[c];
            if (std::fabs(variance[c]) >= 1e-7f) {
              const float g_variance = g_sigma * parameter[2] / root[c] * (variance[c] < 0.0f ? -1.0f : 1.0f);
              g_m2[c] += g_variance;
              g_m1[c] -= 2.0f * m1[c] * g_variance;
            }
          }
          if (p.g_history) {
            const Pair cx = pair_at(px, p.out_w), cy = pair_at(py, p.out_h);
            for (int c = 0; c < 3; ++c)
              if (past[c] < 0.0f || past[c] > 1.0f) g_clear[c] = 0.0f;
            back[static_cast<std::size_t>(cy.a * p.out_w + cx.a)] += g_clear * ((1 - cy.t) * (1 - cx.t));
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
        const float slope[3] = {g_theta * 2.0f * parameter[0] * (1 - parameter[0]) / (whole * whole), g_alpha * 0.35f,
                                g_gamma};
        for (int c = 0; c < 3; ++c)
          for (int i = 0; i < 4; ++i) p.g_temporal[(n * 4 + c) * padded + corner[i]] += slope[c] * share[i];
      }
    }
    if (!p.g_history) continue;
    for (int i = 0; i < pixels; ++i) {  // T and the exposure of the history
      const float* x = p.history + n * 3 * pixels + i;
      const F4 exposed = F4{x[0], x[pixels], x[2 * pixels], 0.0f} * exposure, g = back[static_cast<std::size_t>(i)];
      const F4 inside = minimum(maximum(exposed, splat(0.0f)), splat(kHalfMax));
      const int largest = inside[0] >= inside[1] ? (inside[0] >= inside[2] ? 0 : 2) : (inside[1] >= inside[2] ? 1 : 2);
      const float s = 1.0f / (1.0f + inside[largest]);
      F4 slope = g * s;
      slope[largest] -= sum3(g * inside) * s * s;
      for (int c = 0; c < 3; ++c)
        p.g_history[(n * 3 + c) * pixels + i] =
            exposed[c] >= 0.0f && exposed[c] <= kHalfMax ? slope[c] * exposure : 0.0f;
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
  const float pool = pooled_w * pooled_h ? s.low / static_cast<float>(s.count * pooled_w * pooled_h) : 0.0f;
  const float haar = s.grid * 4.0f / static_cast<float>(3 * s.count * size);
  double value = 0.0, filtered_value = 0.0;
  const auto sign = [](float x) { return static_cast<float>((x > 0.0f) - (x < 0.0f)); };
  for (int plane = 0; plane < s.count; ++plane) {
    const int at = plane * size;
    const float exposure = s.exposure[plane / 3];
    float *wanted = s.wanted + at, *error = s.error + at, *slope = s.slope + at;
    float sums[2] = {0.0f, 0.0f};
    for (int i = 0; i < size; ++i) {
      const float t = s.truth[at + i] * exposure, x = s.output[at + i] * exposure, f = s.filtered[at + i];
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
        const int corner = y * s.w + x, place[4] = {corner, corner + 1, corner + s.w, corner + s.w + 1};
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
