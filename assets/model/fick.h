#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace limber {

/// Fick coordinates of an eye or head (Leclercq, Lefevre & Blohm 2013, appendix D): turn about the
/// vertical, then about the turned inter-aural axis, then about the line of sight; radians, as the
/// one who is turned sees it. The space is a face's own: +Z ahead, +X to its left, +Y up (the
/// paper's x, y, z are this z, x, y).
struct Fick {
  double left = 0.0;       ///< horizontal, (-pi, pi]
  double down = 0.0;       ///< vertical, [-pi/2, pi/2]
  double clockwise = 0.0;  ///< torsion, (-pi, pi]
};

/// R = rot(+Y, left) rot(+X, down) rot(+Z, clockwise).
Eigen::Quaterniond rotation_from_fick(const Fick&);
/// Looking straight up or down only the sum or difference of the other two is determined; any pair
/// that makes the rotation is then an answer.
Fick fick_from_rotation(const Eigen::Quaterniond&);

}  // namespace limber
