// tools/scene/vector.h -- vectors and affine maps in double, for the geometry that the host does.
#pragma once

#include <array>
#include <cmath>

namespace shale {

struct Vec3 {
  double x = 0, y = 0, z = 0;
  bool operator==(const Vec3&) const = default;
};

inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(const Vec3& a, const Vec3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(const Vec3& a, double s) { return {a.x * s, a.y * s, a.z * s}; }
inline Vec3 operator*(const Vec3& a, const Vec3& b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
inline double dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline double length(const Vec3& a) { return std::sqrt(dot(a, a)); }
inline Vec3 mix(const Vec3& a, const Vec3& b, double s) { return a + (b - a) * s; }

/// `fallback` where the length is 0.
inline Vec3 normalized(const Vec3& a, const Vec3& fallback) {
  const double l = length(a);
  return l > 0 ? a * (1 / l) : fallback;
}

/// p -> x*p.x + y*p.y + z*p.z + at.
struct Affine {
  Vec3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1}, at;
  bool operator==(const Affine&) const = default;

  Vec3 direction(const Vec3& d) const { return x * d.x + y * d.y + z * d.z; }
  Vec3 point(const Vec3& p) const { return direction(p) + at; }
};

/// First b, then a.
inline Affine operator*(const Affine& a, const Affine& b) {
  return {a.direction(b.x), a.direction(b.y), a.direction(b.z), a.point(b.at)};
}

/// The columns must be orthogonal and not 0.
inline Affine inverse_orthogonal(const Affine& a) {
  const Vec3 x = a.x * (1 / dot(a.x, a.x));
  const Vec3 y = a.y * (1 / dot(a.y, a.y));
  const Vec3 z = a.z * (1 / dot(a.z, a.z));
  return {{x.x, y.x, z.x},
          {x.y, y.y, z.y},
          {x.z, y.z, z.z},
          {-dot(x, a.at), -dot(y, a.at), -dot(z, a.at)}};
}

/// Right-handed turn about a unit axis. Source: Rodrigues' formula.
inline Affine rotation(const Vec3& axis, double degrees) {
  const double angle = degrees * (3.14159265358979323846 / 180);
  const double c = std::cos(angle), s = std::sin(angle);
  const auto turned = [&](const Vec3& v) {
    return v * c + cross(axis, v) * s + axis * (dot(axis, v) * (1 - c));
  };
  return {turned({1, 0, 0}), turned({0, 1, 0}), turned({0, 0, 1}), {}};
}

}  // namespace shale
