// Eight floats that are worked on side by side, as one number type.
//
// Included by the lane kernel's translation units alone, each of which names its own namespace in
// LIMBER_LANES and is compiled for its own SIMD level. All operations are elementwise IEEE
// arithmetic (no contraction, no approximate reciprocals, no sums across lanes), so that every
// level gives the same bytes. Everything here depends on `Lane`, which differs by namespace:
// nothing compiled for one level can be linked into another.
//
// Intrinsics stand only where GCC 12 makes a poor job of the portable form beside them.
#pragma once

#define EIGEN_MAX_ALIGN_BYTES 32  // one layout of the scratch, whatever the level
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#ifdef __SSE2__
#include <immintrin.h>
#endif

#include "solver/half_angle.h"

namespace limber::LIMBER_LANES {

// clang insists that an array of vectors is aligned as they are, which Eigen's are not at every
// level; GCC takes unaligned ones as they come.
#ifdef __clang__
typedef float Floats __attribute__((vector_size(32), may_alias, aligned(16)));
typedef std::int32_t Bits __attribute__((vector_size(32), may_alias, aligned(16)));
#else
typedef float Floats __attribute__((vector_size(32), may_alias));
typedef std::int32_t Bits __attribute__((vector_size(32), may_alias));
#endif

/// True (all bits) or false (none) per lane.
struct Mask {
  Bits bits;
  friend Mask operator&(Mask a, Mask b) { return {a.bits & b.bits}; }
  friend Mask operator|(Mask a, Mask b) { return {a.bits | b.bits}; }
  Mask operator!() const { return {~bits}; }
};

inline Mask none() { return {Bits{}}; }
inline Mask all() { return !none(); }

inline bool any(Mask m) {
#if defined(__AVX__)
  return _mm256_movemask_ps(__m256(m.bits)) != 0;
#elif defined(__SSE2__)
  const auto* half = reinterpret_cast<const __m128*>(&m.bits);
  return _mm_movemask_ps(_mm_or_ps(half[0], half[1])) != 0;
#else
  std::int32_t sum = 0;
  for (int i = 0; i < 8; ++i) sum |= m.bits[i];
  return sum != 0;
#endif
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
  friend Mask operator>(const Lane& a, const Lane& b) { return b < a; }
  friend Mask operator>=(const Lane& a, const Lane& b) { return b <= a; }
#ifdef __AVX__
  friend Mask operator<(const Lane& a, const Lane& b) {
    return {Bits(_mm256_cmp_ps(a.v, b.v, _CMP_LT_OQ))};
  }
  friend Mask operator<=(const Lane& a, const Lane& b) {
    return {Bits(_mm256_cmp_ps(a.v, b.v, _CMP_LE_OQ))};
  }
#else
  friend Mask operator<(const Lane& a, const Lane& b) { return {Bits(a.v < b.v)}; }
  friend Mask operator<=(const Lane& a, const Lane& b) { return {Bits(a.v <= b.v)}; }
#endif
};

#ifdef __AVX__
inline Lane select(Mask m, const Lane& yes, const Lane& no) {
  return Lane::of(_mm256_blendv_ps(no.v, yes.v, __m256(m.bits)));
}
inline Lane min(const Lane& a, const Lane& b) { return Lane::of(_mm256_min_ps(a.v, b.v)); }
inline Lane max(const Lane& a, const Lane& b) { return Lane::of(_mm256_max_ps(a.v, b.v)); }
inline Lane sqrt(const Lane& a) { return Lane::of(_mm256_sqrt_ps(a.v)); }
#else
inline Lane select(Mask m, const Lane& yes, const Lane& no) {
  return Lane::of(Floats((Bits(yes.v) & m.bits) | (Bits(no.v) & ~m.bits)));
}
/// b where the two do not compare, as the processors' own.
inline Lane min(const Lane& a, const Lane& b) { return select(a < b, a, b); }
inline Lane max(const Lane& a, const Lane& b) { return select(a > b, a, b); }
inline Lane sqrt(const Lane& a) {
  Lane out;
  for (int i = 0; i < 8; ++i) out.v[i] = __builtin_sqrtf(a.v[i]);
  return out;
}
#endif
inline Lane abs(const Lane& a) { return Lane::of(Floats(Bits(a.v) & 0x7fffffff)); }  // no sign
/// To the nearest integer, for |a| < 2^22: the sum has no bits left for a fraction.
inline Lane round(const Lane& a) {
  const Lane shift = 12582912.0f;
  return (a + shift) - shift;
}

using Vector3 = Eigen::Matrix<Lane, 3, 1>;
using Quaternion = Eigen::Quaternion<Lane>;

/// Four of the eight lanes as doubles, for what comes in and goes out.
typedef double Doubles __attribute__((vector_size(32), may_alias));
typedef float HalfFloats __attribute__((vector_size(16), may_alias));
inline constexpr int kHalf = 4;

inline Doubles doubles(const Lane& a, int half) {
  return __builtin_convertvector(reinterpret_cast<const HalfFloats*>(&a.v)[half], Doubles);
}
inline void set_half(Lane& a, int half, const Doubles& d) {
  reinterpret_cast<HalfFloats*>(&a.v)[half] = __builtin_convertvector(d, HalfFloats);
}

/// rows[i][j] <-> rows[j][i]
inline void transpose(Doubles (&rows)[4]) {
  const Doubles a = __builtin_shufflevector(rows[0], rows[1], 0, 4, 2, 6);
  const Doubles b = __builtin_shufflevector(rows[0], rows[1], 1, 5, 3, 7);
  const Doubles c = __builtin_shufflevector(rows[2], rows[3], 0, 4, 2, 6);
  const Doubles d = __builtin_shufflevector(rows[2], rows[3], 1, 5, 3, 7);
  rows[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5);
  rows[1] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
  rows[2] = __builtin_shufflevector(a, c, 2, 3, 6, 7);
  rows[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
}

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
