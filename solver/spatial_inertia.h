#pragma once

#include <Eigen/Core>

namespace limber {

template <class T>
using Vector6T = Eigen::Matrix<T, 6, 1>;  ///< (angular, linear about the origin), world axes
using Vector6 = Vector6T<double>;

/// A symmetric 6x6 matrix [A B; B' M] over (angular, linear) twists: 21 numbers, each worked on
/// once.
template <class T>
struct SpatialInertia {
  T a[6];     ///< xx, xy, xz, yy, yz, zz
  T b[3][3];  ///< row: angular, column: linear
  T m[6];

  void set_zero() {
    for (T& v : a) v = T(0);
    for (auto& row : b) {
      for (T& v : row) v = T(0);
    }
    for (T& v : m) v = T(0);
  }

  SpatialInertia& operator+=(const SpatialInertia& o) {
    for (int i = 0; i < 6; ++i) a[i] += o.a[i];
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) b[i][j] += o.b[i][j];
    }
    for (int i = 0; i < 6; ++i) m[i] += o.m[i];
    return *this;
  }

  /// Symmetric blocks A and M, and B.
  void add_blocks(const Eigen::Matrix<T, 3, 3>& angular, const Eigen::Matrix<T, 3, 3>& coupling,
                  const Eigen::Matrix<T, 3, 3>& linear) {
    constexpr int kRow[] = {0, 0, 0, 1, 1, 2}, kColumn[] = {0, 1, 2, 1, 2, 2};
    for (int k = 0; k < 6; ++k) {
      a[k] += angular(kRow[k], kColumn[k]);
      m[k] += linear(kRow[k], kColumn[k]);
    }
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) b[i][j] += coupling(i, j);
    }
  }

  /// An isotropic angular block, and weight n n' in it.
  void add_angular(const T& weight) {
    a[0] += weight;
    a[3] += weight;
    a[5] += weight;
  }
  void add_angular_outer(const T& weight, const Eigen::Matrix<T, 3, 1>& n) {
    a[0] += weight * n.x() * n.x();
    a[1] += weight * n.x() * n.y();
    a[2] += weight * n.x() * n.z();
    a[3] += weight * n.y() * n.y();
    a[4] += weight * n.y() * n.z();
    a[5] += weight * n.z() * n.z();
  }

  /// += scale u u'.
  void add_outer(const Vector6T<T>& u, const T& scale) {
    const Vector6T<T> s = u * scale;
    a[0] += s[0] * u[0];
    a[1] += s[0] * u[1];
    a[2] += s[0] * u[2];
    a[3] += s[1] * u[1];
    a[4] += s[1] * u[2];
    a[5] += s[2] * u[2];
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) b[i][j] += s[i] * u[3 + j];
    }
    m[0] += s[3] * u[3];
    m[1] += s[3] * u[4];
    m[2] += s[3] * u[5];
    m[3] += s[4] * u[4];
    m[4] += s[4] * u[5];
    m[5] += s[5] * u[5];
  }

  /// += the inertia of a point mass at d.
  void add_point(const T& mass, const Eigen::Matrix<T, 3, 1>& d) {
    const T x = mass * d.x(), y = mass * d.y(), z = mass * d.z();
    a[0] += y * d.y() + z * d.z();
    a[1] -= x * d.y();
    a[2] -= x * d.z();
    a[3] += x * d.x() + z * d.z();
    a[4] -= y * d.z();
    a[5] += x * d.x() + y * d.y();
    add_cross(x, y, z);
    m[0] += mass;
    m[3] += mass;
    m[5] += mass;
  }
  /// Coupling block += [v], the matrix with [v] w = v x w.
  void add_cross(const T& x, const T& y, const T& z) {
    b[0][1] -= z;
    b[0][2] += y;
    b[1][0] += z;
    b[1][2] -= x;
    b[2][0] -= y;
    b[2][1] += x;
  }
};

template <class T>
inline Vector6T<T> operator*(const SpatialInertia<T>& i, const Vector6T<T>& v) {
  Vector6T<T> out;
  const T x = v[0], y = v[1], z = v[2], p = v[3], q = v[4], r = v[5];
  out[0] = i.a[0] * x + i.a[1] * y + i.a[2] * z + i.b[0][0] * p + i.b[0][1] * q + i.b[0][2] * r;
  out[1] = i.a[1] * x + i.a[3] * y + i.a[4] * z + i.b[1][0] * p + i.b[1][1] * q + i.b[1][2] * r;
  out[2] = i.a[2] * x + i.a[4] * y + i.a[5] * z + i.b[2][0] * p + i.b[2][1] * q + i.b[2][2] * r;
  out[3] = i.b[0][0] * x + i.b[1][0] * y + i.b[2][0] * z + i.m[0] * p + i.m[1] * q + i.m[2] * r;
  out[4] = i.b[0][1] * x + i.b[1][1] * y + i.b[2][1] * z + i.m[1] * p + i.m[3] * q + i.m[4] * r;
  out[5] = i.b[0][2] * x + i.b[1][2] * y + i.b[2][2] * z + i.m[2] * p + i.m[4] * q + i.m[5] * r;
  return out;
}

}  // namespace limber
