#pragma once

#include <limits>

#include "assets/model/dual_quaternion.h"

namespace limber::test {

// Four ways to write a rigid motion, alike in use, so that one experiment can run on each:
//   from(exact)   rounded from an exact motion (long double)
//   a * b         the concatenation, as the form does it directly
//   mended()      back to a rigid motion: normalised, or orthonormalised by Gram-Schmidt
//   seen()        what it does to points as it stands, drifted or not: p -> A p + t, as [A t]
// Scalar: float, double or Counted.

using ExactMotion = DualQuaternionT<long double>;
using Seen = Eigen::Matrix<double, 3, 4>;

template <class S>
Seen seen_by(const Eigen::Matrix<S, 3, 3>& rotation, const Eigen::Matrix<S, 3, 1>& translation) {
  Seen seen;
  seen << rotation.template cast<double>(), translation.template cast<double>();
  return seen;
}

/// 8 numbers.
template <class S>
struct DualQuaternionForm {
  using Scalar = S;
  static constexpr const char* name = "dual quaternion";
  DualQuaternionT<S> q;

  static DualQuaternionForm from(const ExactMotion& exact) {
    DualQuaternionForm form;
    form.q.real.coeffs() = exact.real.coeffs().template cast<S>();
    form.q.dual.coeffs() = exact.dual.coeffs().template cast<S>();
    return form;
  }
  friend DualQuaternionForm operator*(const DualQuaternionForm& a, const DualQuaternionForm& b) {
    return {a.q * b.q};
  }
  DualQuaternionForm mended() const { return {q.normalized()}; }
  Seen seen() const { return seen_by<S>(q.real.toRotationMatrix(), q.translation()); }
};

/// 7 numbers.
template <class S>
struct QuaternionVectorForm {
  using Scalar = S;
  static constexpr const char* name = "quaternion + vector";
  Eigen::Quaternion<S> rotation = Eigen::Quaternion<S>(S(1), S(0), S(0), S(0));
  Eigen::Matrix<S, 3, 1> translation = Eigen::Matrix<S, 3, 1>::Zero();

  static QuaternionVectorForm from(const ExactMotion& exact) {
    QuaternionVectorForm form;
    form.rotation.coeffs() = exact.real.coeffs().template cast<S>();
    form.translation = exact.translation().template cast<S>();
    return form;
  }
  friend QuaternionVectorForm operator*(const QuaternionVectorForm& a,
                                        const QuaternionVectorForm& b) {
    return {a.rotation * b.rotation, a.rotation * b.translation + a.translation};
  }
  QuaternionVectorForm mended() const {
    QuaternionVectorForm form = *this;
    form.rotation.coeffs() = (S(1) / rotation.norm()) * rotation.coeffs();
    return form;
  }
  Seen seen() const { return seen_by<S>(rotation.toRotationMatrix(), translation); }
};

/// Gram-Schmidt on the columns of the 3x3 corner; the third is the cross product of the others.
template <class Matrix>
void orthonormalise(Matrix& m) {
  using S = typename Matrix::Scalar;
  using Vector3 = Eigen::Matrix<S, 3, 1>;
  Vector3 x = m.template block<3, 1>(0, 0), y = m.template block<3, 1>(0, 1);
  x = (S(1) / x.norm()) * x;
  y = y - x.dot(y) * x;
  y = (S(1) / y.norm()) * y;
  m.template block<3, 1>(0, 0) = x;
  m.template block<3, 1>(0, 1) = y;
  m.template block<3, 1>(0, 2) = x.cross(y);
}

/// 12 numbers; the row (0 0 0 1) below them is not multiplied. Written out: Eigen's own expressions
/// of this shape cost two to four times as much.
template <class S>
struct Matrix3x4Form {
  using Scalar = S;
  static constexpr const char* name = "3x4 matrix";
  using Rows = Eigen::Matrix<S, 3, 4, Eigen::RowMajor>;
  Rows m = Rows::Identity();

  static Matrix3x4Form from(const ExactMotion& exact) {
    Matrix3x4Form form;
    form.m = exact.matrix().template topRows<3>().template cast<S>();
    return form;
  }
  friend Matrix3x4Form operator*(const Matrix3x4Form& a, const Matrix3x4Form& b) {
    Matrix3x4Form form{Rows()};
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 4; ++k) {
        form.m(i, k) = a.m(i, 0) * b.m(0, k) + a.m(i, 1) * b.m(1, k) + a.m(i, 2) * b.m(2, k);
      }
      form.m(i, 3) += a.m(i, 3);
    }
    return form;
  }
  Matrix3x4Form mended() const {
    Matrix3x4Form form = *this;
    orthonormalise(form.m);
    return form;
  }
  Seen seen() const { return m.template cast<double>(); }
};

/// 16 numbers.
template <class S>
struct Matrix4x4Form {
  using Scalar = S;
  static constexpr const char* name = "4x4 matrix";
  Eigen::Matrix<S, 4, 4> m = Eigen::Matrix<S, 4, 4>::Identity();

  static Matrix4x4Form from(const ExactMotion& exact) {
    Matrix4x4Form form;
    form.m = exact.matrix().template cast<S>();
    return form;
  }
  friend Matrix4x4Form operator*(const Matrix4x4Form& a, const Matrix4x4Form& b) {
    Matrix4x4Form form{Eigen::Matrix<S, 4, 4>()};
    form.m.noalias() = a.m * b.m;
    return form;
  }
  Matrix4x4Form mended() const {
    Matrix4x4Form form = *this;
    orthonormalise(form.m);
    return form;
  }
  Seen seen() const { return m.template topRows<3>().template cast<double>(); }
};

/// Unit roundoff: the relative error of one rounding.
template <class S>
constexpr double unit_roundoff() {
  return 0.5 * static_cast<double>(std::numeric_limits<S>::epsilon());
}

/// How far [A t] is from rigid: the largest entry of A'A - 1. Off the diagonal is skew, on it twice
/// the scale.
inline double not_rigid(const Seen& seen) {
  const Eigen::Matrix3d a = seen.leftCols<3>();
  return (a.transpose() * a - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
}

}  // namespace limber::test
