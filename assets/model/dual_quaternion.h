#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <span>

#include "assets/model/result.h"

namespace limber {

/// Dual vector real + eps dual. Three readings, all transformed alike by a rigid motion:
///  - line (Pluecker): real = unit direction, dual = moment p x direction for any p on the line;
///  - twist: real = angular velocity (rad/s), dual = velocity of the point now at the origin (m/s);
///  - wrench: real = force (N), dual = torque about the origin (N m).
template <class Scalar>
struct DualVectorT {
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  Vector3 real = Vector3::Zero();
  Vector3 dual = Vector3::Zero();

  static DualVectorT line(const Vector3& point, const Vector3& unit_direction) {
    return {unit_direction, point.cross(unit_direction)};
  }

  friend DualVectorT operator+(const DualVectorT& a, const DualVectorT& b) {
    return {a.real + b.real, a.dual + b.dual};
  }
  friend DualVectorT operator-(const DualVectorT& a, const DualVectorT& b) {
    return {a.real - b.real, a.dual - b.dual};
  }
  friend DualVectorT operator*(const Scalar& s, const DualVectorT& a) {
    return {s * a.real, s * a.dual};
  }

  /// Velocity of the point p that moves with this twist: dual + real x p.
  Vector3 velocity_at(const Vector3& p) const { return dual + real.cross(p); }
};
using DualVector = DualVectorT<double>;

/// Dual quaternion real + eps dual. A *unit* one is the rigid transform `a_from_b`
/// (Kavan et al. 2008): real = rotation (Hamilton), dual = 1/2 t real with t in metres.
/// q and -q are the same transform. Scalar: double, float or ceres::Jet.
///
/// Products compose as functions do: (a_from_b * b_from_c) maps c to a.
template <class Scalar>
struct DualQuaternionT {
  using Quaternion = Eigen::Quaternion<Scalar>;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  using Matrix4 = Eigen::Matrix<Scalar, 4, 4>;
  using DualVectorS = DualVectorT<Scalar>;

  Quaternion real = Quaternion(Scalar(1), Scalar(0), Scalar(0), Scalar(0));
  Quaternion dual = Quaternion(Scalar(0), Scalar(0), Scalar(0), Scalar(0));

  // ---- making one

  static DualQuaternionT identity() { return {}; }

  static DualQuaternionT from_rotation(const Quaternion& rotation) {
    return {rotation, Quaternion(Scalar(0), Scalar(0), Scalar(0), Scalar(0))};
  }

  static DualQuaternionT from_translation(const Vector3& t) {
    const Scalar half(0.5);
    return {Quaternion(Scalar(1), Scalar(0), Scalar(0), Scalar(0)),
            Quaternion(Scalar(0), half * t.x(), half * t.y(), half * t.z())};
  }

  /// T(translation) R(rotation): rotate first, then translate. `rotation` must be unit.
  static DualQuaternionT from_rotation_translation(const Quaternion& rotation,
                                                   const Vector3& translation) {
    return {rotation, from_translation(translation).dual * rotation};
  }

  /// From a rigid 4x4 matrix; scale and shear must have been removed.
  static DualQuaternionT from_matrix(const Matrix4& m) {
    Quaternion rotation(m.template topLeftCorner<3, 3>().eval());
    rotation.normalize();
    return from_rotation_translation(rotation, m.template topRightCorner<3, 1>());
  }

  // ---- reading it

  const Quaternion& rotation() const { return real; }

  /// t = 2 dual real*, for a unit dual quaternion.
  Vector3 translation() const { return Scalar(2) * (dual * real.conjugate()).vec(); }

  Matrix4 matrix() const {
    Matrix4 m = Matrix4::Identity();
    m.template topLeftCorner<3, 3>() = real.toRotationMatrix();
    m.template topRightCorner<3, 1>() = translation();
    return m;
  }

  // ---- algebra (any dual quaternion, unit or not)

  /// 48 multiplications and 40 additions (Kenwright 2012, section 11, states 42 and 38).
  friend DualQuaternionT operator*(const DualQuaternionT& a, const DualQuaternionT& b) {
    return {a.real * b.real, sum(a.real * b.dual, a.dual * b.real)};
  }
  friend DualQuaternionT operator+(const DualQuaternionT& a, const DualQuaternionT& b) {
    return {sum(a.real, b.real), sum(a.dual, b.dual)};
  }
  friend DualQuaternionT operator*(const Scalar& s, const DualQuaternionT& q) {
    DualQuaternionT r;
    r.real.coeffs() = s * q.real.coeffs();
    r.dual.coeffs() = s * q.dual.coeffs();
    return r;
  }
  DualQuaternionT operator-() const { return Scalar(-1) * *this; }

  /// Quaternion conjugate real* + eps dual*: the inverse of a unit one; reverses products.
  DualQuaternionT conjugate() const { return {real.conjugate(), dual.conjugate()}; }
  /// Dual conjugate real - eps dual; keeps the order of products.
  DualQuaternionT dual_conjugate() const {
    DualQuaternionT r = *this;
    r.dual.coeffs() = -r.dual.coeffs();
    return r;
  }
  /// Both at once, real* - eps dual*: the one in the sandwich product that moves points.
  DualQuaternionT full_conjugate() const { return conjugate().dual_conjugate(); }

  /// Inverse of a non-unit dual quaternion: real^-1 - eps real^-1 dual real^-1.
  /// A pure dual number (real = 0) divides zero and has none: error `dual-quaternion-zero-divisor`.
  Result<DualQuaternionT> inverse() const {
    const Scalar n2 = real.squaredNorm();
    if (!(n2 > Scalar(0))) {
      return Error{"dual-quaternion-zero-divisor",
                   "a dual quaternion whose real part is zero has no inverse"};
    }
    Quaternion inverse_real = real.conjugate();
    inverse_real.coeffs() /= n2;
    DualQuaternionT r{inverse_real, inverse_real * dual * inverse_real};
    r.dual.coeffs() = -r.dual.coeffs();
    return r;
  }

  /// The nearest unit dual quaternion along the ray: divides by |real| and removes the dual part's
  /// component along the real part, so that real . dual = 0 (Kenwright 2012 omits the second step).
  /// 20 multiplications, 10 additions, a division and a root.
  DualQuaternionT normalized() const {
    const Scalar inverse_norm = Scalar(1) / real.norm();
    DualQuaternionT r = inverse_norm * *this;
    const Scalar along = r.real.coeffs().dot(r.dual.coeffs());
    r.dual.coeffs() -= along * r.real.coeffs();
    return r;
  }

  // ---- rigid transform (unit only)

  Vector3 transform_point(const Vector3& p_in_b) const { return real * p_in_b + translation(); }
  Vector3 transform_direction(const Vector3& d_in_b) const { return real * d_in_b; }
  /// Lines, twists and wrenches: q v q* with the dual parts carried along.
  DualVectorS transform_line(const DualVectorS& in_b) const {
    const Vector3 direction = real * in_b.real;
    return {direction, real * in_b.dual + translation().cross(direction)};
  }

  /// Screw logarithm: the twist xi, applied for one second, that is this motion; exp(log(q)) = q.
  /// Takes the shorter of q and -q, so |xi.real| <= pi.
  DualVectorS log() const {
    using std::atan2;
    using std::sqrt;
    const Scalar sign = real.w() < Scalar(0) ? Scalar(-1) : Scalar(1);
    const Scalar w = sign * real.w();
    const Vector3 v = sign * real.vec();
    const Scalar n2 = v.squaredNorm();
    Scalar a, b;  // vec = a omega; d(vec) = a v + b (omega.v) omega
    if (n2 < Scalar(1e-12)) {
      const Scalar angle2 = Scalar(4) * n2;
      series(angle2, a, b);
      // the series is in theta, and theta = 2 |vec| to the order that is kept
    } else {
      const Scalar n = sqrt(n2);
      const Scalar angle = Scalar(2) * atan2(n, w);
      a = n / angle;
      b = (Scalar(0.5) * w - a) / (angle * angle);
    }
    const Vector3 omega = v / a;
    const Scalar s = Scalar(-2) * sign * dual.w() / a;
    return {omega, (sign * dual.vec() - b * s * omega) / a};
  }

  /// exp(xi): the rigid motion that the twist xi makes in one second (Rodrigues on dual numbers).
  static DualQuaternionT exp(const DualVectorS& xi) {
    using std::cos;
    using std::sin;
    using std::sqrt;
    const Scalar angle2 = xi.real.squaredNorm();
    Scalar a, b, c;
    if (angle2 < Scalar(1e-12)) {
      series(angle2, a, b);
      c = Scalar(1) - angle2 / Scalar(8);
    } else {
      const Scalar angle = sqrt(angle2);
      c = cos(Scalar(0.5) * angle);
      a = sin(Scalar(0.5) * angle) / angle;
      b = (Scalar(0.5) * c - a) / angle2;
    }
    const Scalar s = xi.real.dot(xi.dual);
    const Vector3 vec = a * xi.real;
    const Vector3 dual_vec = a * xi.dual + b * s * xi.real;
    DualQuaternionT q;
    q.real = Quaternion(c, vec.x(), vec.y(), vec.z());
    q.dual = Quaternion(Scalar(-0.5) * a * s, dual_vec.x(), dual_vec.y(), dual_vec.z());
    return q;
  }

 private:
  static Quaternion sum(const Quaternion& a, const Quaternion& b) {
    Quaternion r;
    r.coeffs() = a.coeffs() + b.coeffs();
    return r;
  }

  /// a = sin(theta/2)/theta and b = (cos(theta/2)/2 - a)/theta^2 about theta = 0.
  static void series(const Scalar& angle2, Scalar& a, Scalar& b) {
    a = Scalar(0.5) - angle2 / Scalar(48);
    b = Scalar(-1.0 / 24.0) + angle2 / Scalar(960);
  }
};
using DualQuaternion = DualQuaternionT<double>;

/// Screw linear interpolation (Kavan et al. 2008): constant-speed motion along the one screw that
/// takes `a` to `b`, the short way round; t = 0 gives a, t = 1 gives b.
template <class Scalar>
DualQuaternionT<Scalar> sclerp(const DualQuaternionT<Scalar>& a, const DualQuaternionT<Scalar>& b,
                               const Scalar& t) {
  return a * DualQuaternionT<Scalar>::exp(t * (a.conjugate() * b).log());
}

/// Dual quaternion linear blending (Kavan et al. 2008): normalised weighted sum, each term on the
/// hemisphere of the first. Weights need not sum to one; at least one must be positive.
template <class Scalar>
DualQuaternionT<Scalar> dlb(std::span<const DualQuaternionT<Scalar>> transforms,
                            std::span<const Scalar> weights) {
  DualQuaternionT<Scalar> sum = weights[0] * transforms[0];
  for (std::size_t i = 1; i < transforms.size(); ++i) {
    const bool opposite = transforms[0].real.coeffs().dot(transforms[i].real.coeffs()) < Scalar(0);
    sum = sum + (opposite ? -weights[i] : weights[i]) * transforms[i];
  }
  return sum.normalized();
}

/// N products at once: out[i] = a[i] * b[i]. `out` may alias either input.
template <class Scalar>
void multiply(std::span<const DualQuaternionT<Scalar>> a,
              std::span<const DualQuaternionT<Scalar>> b, std::span<DualQuaternionT<Scalar>> out) {
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = a[i] * b[i];
}

/// Angle in radians, within [0, pi], of the rotation between two unit quaternions; q and -q alike.
template <class Scalar>
Scalar rotation_angle(const Eigen::Quaternion<Scalar>& a, const Eigen::Quaternion<Scalar>& b) {
  using std::abs;
  using std::atan2;
  const Eigen::Quaternion<Scalar> d = a.conjugate() * b;
  return Scalar(2) * atan2(d.vec().norm(), abs(d.w()));
}

/// Rotation vector (rad) of a unit quaternion, the short way round.
template <class Scalar>
Eigen::Matrix<Scalar, 3, 1> rotation_log(const Eigen::Quaternion<Scalar>& q) {
  return DualQuaternionT<Scalar>::from_rotation(q).log().real;
}

/// Unit quaternion of a rotation vector (rad).
template <class Scalar>
Eigen::Quaternion<Scalar> rotation_exp(const Eigen::Matrix<Scalar, 3, 1>& v) {
  return DualQuaternionT<Scalar>::exp({v, Eigen::Matrix<Scalar, 3, 1>::Zero()}).real;
}

}  // namespace limber
