#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <random>

#include "assets/model/dual_quaternion.h"

namespace limber::test {

/// Seeded source of rotations and motions.
class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}

  double uniform(double a, double b) {
    return std::uniform_real_distribution<double>(a, b)(engine_);
  }
  int integer(int a, int b) { return std::uniform_int_distribution<int>(a, b)(engine_); }
  Eigen::Vector3d vector(double size = 1.0) {
    return {uniform(-size, size), uniform(-size, size), uniform(-size, size)};
  }
  Eigen::Vector3d unit() {
    Eigen::Vector3d v = normal3();
    while (v.norm() < 1e-3) v = normal3();
    return v.normalized();
  }
  Eigen::Quaterniond rotation() {
    const Eigen::Vector3d v = normal3();
    return Eigen::Quaterniond(normal(), v.x(), v.y(), v.z()).normalized();
  }
  /// A rotation by at most `angle` (rad).
  Eigen::Quaterniond small_rotation(double angle) {
    return Eigen::Quaterniond(Eigen::AngleAxisd(uniform(-angle, angle), unit()));
  }
  DualQuaternion motion() {
    return DualQuaternion::from_rotation_translation(rotation(), vector(2.0));
  }
  double normal() { return std::normal_distribution<double>()(engine_); }

 private:
  Eigen::Vector3d normal3() { return {normal(), normal(), normal()}; }
  std::mt19937_64 engine_;
};

}  // namespace limber::test
