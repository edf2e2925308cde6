#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/rig.h"

namespace limber {

/// Coordinates x of a rig's pose in which its limits are a box.
///
///  - hinge 1, universal 2: the angles;
///  - limited ball 3: a chart of the unit disc that maps onto the swing ellipse, then the twist.
///    Near the centre the chart is (X, Y), inside the square |X|, |Y| <= 0.7; further out it is
///    polar (r, angle), r <= 1. s0 = X S0, s1 = Y S1, S the bound of that side's sign;
///  - unlimited ball 3: a rotation vector v from the rotation at the start, R = R_start exp(v);
///  - free 6: translation (m), then v as above.
class PoseChart {
 public:
  explicit PoseChart(const Rig&);

  /// Takes the coordinates of a pose, brought into the limits, and picks a chart for each ball.
  void start_from(std::span<const DualQuaternion> parent_from_joint);
  /// Picks the charts anew for the current x, and makes it the start of unlimited rotations.
  void rechart();

  const Eigen::VectorXd& x() const { return x_; }
  void set_x(const Eigen::VectorXd& x) { x_ = x; }
  const Eigen::VectorXd& lower() const { return lower_; }
  const Eigen::VectorXd& upper() const { return upper_; }
  /// [joint] its first coordinate; one more entry holds the total.
  const std::vector<std::int32_t>& begin() const { return begin_; }

  /// A joint's own rotation R at its coordinates; the columns are R's angular velocity per
  /// coordinate that turns (the last ones of the joint), in the space that R maps into, before rest
  /// and parent. Returns how many columns there are.
  int rotation(std::int32_t joint, const double* x, Eigen::Quaterniond& r,
               Eigen::Matrix3d* columns) const;
  void pose(const Eigen::VectorXd& x, std::span<DualQuaternion> parent_from_joint) const;
  /// [coordinate] World angular velocity of what hangs on it, zero for translations. `world`:
  /// model_from_joint at x.
  void turns(const Eigen::VectorXd& x, std::span<const DualQuaternion> world,
             Eigen::Matrix3Xd& turns) const;

 private:
  enum class Chart : std::uint8_t { none, centre, polar };

  void choose_chart(std::int32_t joint, const Eigen::Vector2d& disc);
  Eigen::Vector2d disc_point(std::int32_t joint, const double* x) const;
  int ball_rotation(std::int32_t joint, const double* x, Eigen::Quaterniond& r,
                    Eigen::Matrix3d* columns) const;

  const Rig* rig_;
  std::vector<std::int32_t> begin_;
  std::vector<Chart> chart_;                   // [joint]
  std::vector<Eigen::Quaterniond> reference_;  // [joint] R_start of unlimited rotations
  Eigen::VectorXd x_, lower_, upper_;
};

/// Left Jacobian of SO(3): exp(v + dv) = exp(Jl dv) exp(v) to first order.
Eigen::Matrix3d left_jacobian(const Eigen::Vector3d& v);
/// Inverse right Jacobian of SO(3): log(exp(v) exp(dw)) = v + Jr^-1 dw to first order.
Eigen::Matrix3d inverse_right_jacobian(const Eigen::Vector3d& v);
Eigen::Matrix3d cross_matrix(const Eigen::Vector3d&);

}  // namespace limber
