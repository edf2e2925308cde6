#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>
#include <vector>

#include "assets/model/rig.h"
#include "solver/ik_solver.h"

namespace limber {

/// The solver's effector objective as a sum of squared residuals in coordinates with box bounds,
/// with an analytic Jacobian: what Ceres minimises.
///
/// Coordinates per joint (x):
///  - hinge 1, universal 2: the angles;
///  - limited ball 3: a chart of the unit disc that maps onto the swing ellipse, then the twist.
///    Near the centre the chart is (X, Y), inside the square |X|, |Y| <= 0.7; further out it is
///    polar (r, angle), r <= 1. s0 = X S0, s1 = Y S1, S the bound of that side's sign;
///  - unlimited ball 3: a rotation vector v from the rotation at the start, R = R_start exp(v);
///  - free 6: translation (m), then v as above.
/// Relative effectors count as the solver counts them. Couplings are residuals of
/// kCouplingWeight m per rad (or m) that they are missed by, behind the effectors'; they belong to
/// cost(), not to cost_of_pose(). Couplings of a ball's swing, priorities, capsules and speeds are
/// not in this objective: see `lacks`.
class EffectorProblem {
 public:
  static constexpr double kCouplingWeight = 100.0;

  EffectorProblem(const Rig&, std::span<const EffectorTarget>);

  /// Null where this objective holds all that the rig asks for (capsules and speeds aside, which
  /// are options of the solver); else what it lacks.
  static const char* lacks(const Rig&);

  /// Takes the coordinates of a pose, brought into the limits, and picks a chart for each ball.
  void start_from(std::span<const DualQuaternion> parent_from_joint);
  /// Picks the charts anew for the current x.
  void rechart();

  const Eigen::VectorXd& x() const { return x_; }
  void set_x(const Eigen::VectorXd& x) { x_ = x; }
  const Eigen::VectorXd& lower() const { return lower_; }
  const Eigen::VectorXd& upper() const { return upper_; }
  Eigen::Index residuals() const { return residuals_; }

  /// Residuals at x; their squares sum to the objective. `jacobian` may be null.
  void evaluate(const Eigen::VectorXd& x, Eigen::VectorXd& residual,
                Eigen::MatrixXd* jacobian) const;
  double cost(const Eigen::VectorXd& x) const;
  void pose(const Eigen::VectorXd& x, std::span<DualQuaternion> parent_from_joint) const;

  /// The objective of any pose, within limits or not.
  double cost_of_pose(std::span<const DualQuaternion> parent_from_joint) const;

 private:
  enum class Chart : std::uint8_t { none, centre, polar };

  void choose_chart(std::int32_t joint, const Eigen::Vector2d& disc);
  Eigen::Vector2d disc_point(std::int32_t joint, const double* x) const;
  /// Rotation R of the joint; the columns are its angular velocity per coordinate, in the space
  /// that R maps into (before rest and parent). Returns how many columns there are.
  int rotation(std::int32_t joint, const double* x, Eigen::Quaterniond& r,
               Eigen::Matrix<double, 3, 3>* columns) const;
  int ball_rotation(std::int32_t joint, const double* x, Eigen::Quaterniond& r,
                    Eigen::Matrix<double, 3, 3>* columns) const;
  void effector_rows(std::size_t effector, std::span<const DualQuaternion> world, Eigen::Index row,
                     Eigen::VectorXd& residual, Eigen::Matrix<double, 6, 6>* by_motion) const;
  void coupling_rows(const Eigen::VectorXd& x, Eigen::Index row, Eigen::VectorXd& residual,
                     Eigen::MatrixXd* jacobian) const;
  /// Adds, for the rows of an effector, what the coordinates at or above `joint` do to a point.
  void chain_columns(std::int32_t joint, const Eigen::Vector3d& point,
                     std::span<const DualQuaternion> world, const Eigen::Matrix3Xd& turns,
                     const Eigen::Matrix<double, 6, 6>& by_motion, Eigen::Index row,
                     Eigen::Index rows, Eigen::MatrixXd& jacobian) const;
  void model_pose(std::span<const DualQuaternion> parent_from_joint,
                  std::vector<DualQuaternion>& world) const;

  const Rig& rig_;
  std::span<const EffectorTarget> targets_;
  std::vector<std::int32_t> begin_;            // [joint] first coordinate
  std::vector<Chart> chart_;                   // [joint]
  std::vector<Eigen::Quaterniond> reference_;  // [joint] R_start of unlimited rotations
  Eigen::VectorXd x_, lower_, upper_;
  Eigen::Index residuals_ = 0;
};

}  // namespace limber
