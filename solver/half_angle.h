#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>

namespace limber {

/// What the kinematics ask of a number type: a double, or a pack of floats (solver/lane.h).
template <class T>
struct Real;
template <>
struct Real<double> {
  using Scalar = double;
  static constexpr int terms = 13;  ///< of the series below, for rounding to be all that is wrong
};

/// Of an angle: cos(angle / 2) and sin(angle / 2) / angle.
template <class T>
struct HalfAngle {
  T cosine, sinc;
};

namespace detail {

/// (-1)^k / (2k)! and (-1)^k / (2k + 1)!
template <class Scalar, int N>
constexpr std::array<Scalar, N> alternating_inverse_factorials(bool odd) {
  std::array<Scalar, N> out{};
  double value = 1.0;
  for (int k = 0; k < N; ++k) {
    out[k] = static_cast<Scalar>(value);
    value /= odd ? -(2.0 * k + 2.0) * (2.0 * k + 3.0) : -(2.0 * k + 1.0) * (2.0 * k + 2.0);
  }
  return out;
}

/// sum c_k x^k as four interleaved Horner chains, so that none waits long for itself.
template <class T, std::size_t N>
inline T power_series(const std::array<typename Real<T>::Scalar, N>& c, const T& x) {
  const T x2 = x * x, x4 = x2 * x2;
  T chain[4];
  for (std::size_t j = 0; j < 4; ++j) {
    std::size_t k = j + 4 * ((N - 1 - j) / 4);
    chain[j] = T(c[k]);
    while (k >= 4) {
      k -= 4;
      chain[j] = chain[j] * x4 + T(c[k]);
    }
  }
  return (chain[0] + x * chain[1]) + x2 * (chain[2] + x * chain[3]);
}

}  // namespace detail

/// cos and sinc are power series in the angle's square: no root, no quotient, no special case at
/// zero, and only elementwise arithmetic, so every type T gives the same on every processor.
/// Exact to rounding for |angle| <= 4.4 (a swing within pi on each of its two axes).
template <class T>
inline HalfAngle<T> half_angle(const T& angle2) {
  using Scalar = typename Real<T>::Scalar;
  constexpr int n = Real<T>::terms;
  constexpr auto cosine = detail::alternating_inverse_factorials<Scalar, n>(false);
  constexpr auto sine = detail::alternating_inverse_factorials<Scalar, n>(true);
  const T h2 = angle2 * T(Scalar(0.25));
  return {detail::power_series<T, n>(cosine, h2),
          T(Scalar(0.5)) * detail::power_series<T, n>(sine, h2)};
}

}  // namespace limber
