// Eight floats that are worked on side by side, as one number type.
//
// Included by the lane kernel's translation units alone, each of which names its own namespace in
// LIMBER_LANES and is compiled for its own SIMD level. All operations are elementwise IEEE
// arithmetic (no contraction, no approximate reciprocals, no sums across lanes), so that every
// level gives the same bytes. Everything here depends on `Lane`, which differs by namespace:
// nothing compiled for one level can be linked into another.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>

#include "solver/half_angle.h"

namespace limber::LIMBER_LANES {

typedef float Floats __attribute__((vector_size(32), may_alias));
typedef std::int32_t Bits __attribute__((vector_size(32), may_alias));

/// True or false per lane.
struct Mask {
  Bits bits;
  friend Mask operator&(Mask a, Mask b) { return {a.bits & b.bits}; }
  friend Mask operator|(Mask a, Mask b) { return {a.bits | b.bits}; }
  Mask operator!() const { return {~bits}; }
};

inline bool any(Mask m) {
  std::int32_t sum = 0;
  for (int i = 0; i < 8; ++i) sum |= m.bits[i];
  return sum != 0;
}

struct Lane {
  Floats v;
  Lane() = default;
  template <class S>
  requires std::is_arithmetic_v<S> Lane(S s) {  // implicit: the constants of formulas
    const auto f = static_cast<float>(s);
    v = Floats{f, f, f, f, f, f, f, f};
  }
  static Lane of(Floats v) {
    Lane out;
    out.v = v;
    return out;
  }
  Lane operator-() const { return of(-v); }
  Lane& operator+=(const Lane& o) { return v += o.v, *this; }
  Lane& operator-=(const Lane& o) { return v -= o.v, *this; }
  Lane& operator*=(const Lane& o) { return v *= o.v, *this; }
  friend Lane operator+(const Lane& a, const Lane& b) { return of(a.v + b.v); }
  friend Lane operator-(const Lane& a, const Lane& b) { return of(a.v - b.v); }
  friend Lane operator*(const Lane& a, const Lane& b) { return of(a.v * b.v); }
  friend Lane operator/(const Lane& a, const Lane& b) { return of(a.v / b.v); }
  friend Mask operator<(const Lane& a, const Lane& b) { return {Bits(a.v < b.v)}; }
  friend Mask operator>(const Lane& a, const Lane& b) { return {Bits(a.v > b.v)}; }
  friend Mask operator<=(const Lane& a, const Lane& b) { return {Bits(a.v <= b.v)}; }
  friend Mask operator>=(const Lane& a, const Lane& b) { return {Bits(a.v >= b.v)}; }
};

inline Lane select(Mask m, const Lane& yes, const Lane& no) {
  return Lane::of(m.bits ? yes.v : no.v);
}
inline Lane min(const Lane& a, const Lane& b) { return select(a < b, a, b); }
inline Lane max(const Lane& a, const Lane& b) { return select(a > b, a, b); }
inline Lane abs(const Lane& a) { return max(a, -a); }
inline Lane sqrt(const Lane& a) {
  Lane out;
  for (int i = 0; i < 8; ++i) out.v[i] = __builtin_sqrtf(a.v[i]);
  return out;
}
/// To the nearest integer, for |a| < 2^22: the sum has no bits left for a fraction.
inline Lane round(const Lane& a) {
  const Lane shift = 12582912.0f;
  return (a + shift) - shift;
}

using Vector3 = Eigen::Matrix<Lane, 3, 1>;
using Quaternion = Eigen::Quaternion<Lane>;

}  // namespace limber::LIMBER_LANES

namespace limber {
template <>
struct Real<LIMBER_LANES::Lane> {
  using Scalar = float;
  static constexpr int terms = 8;
};
}  // namespace limber

template <>
struct Eigen::NumTraits<limber::LIMBER_LANES::Lane>
    : Eigen::GenericNumTraits<limber::LIMBER_LANES::Lane> {
  using Real = limber::LIMBER_LANES::Lane;
  using NonInteger = Real;
  using Nested = Real;
  using Literal = Real;
  enum {
    IsComplex = 0,
    IsInteger = 0,
    IsSigned = 1,
    RequireInitialization = 0,
    ReadCost = 1,
    AddCost = 1,
    MulCost = 1
  };
};
