#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>
#include <vector>

#include "assets/model/rig.h"
#include "solver/ik_solver.h"
#include "validation/pose_chart.h"

namespace limber {

/// The solver's effector objective as a sum of squared residuals in the coordinates of a PoseChart,
/// with an analytic Jacobian: what Ceres minimises.
///
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

  PoseChart& chart() { return chart_; }
  const PoseChart& chart() const { return chart_; }
  Eigen::Index residuals() const { return residuals_; }

  /// Residuals at x; their squares sum to the objective. `jacobian` may be null.
  void evaluate(const Eigen::VectorXd& x, Eigen::VectorXd& residual,
                Eigen::MatrixXd* jacobian) const;
  double cost(const Eigen::VectorXd& x) const;

  /// The objective of any pose, within limits or not.
  double cost_of_pose(std::span<const DualQuaternion> parent_from_joint) const;

 private:
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
  PoseChart chart_;
  Eigen::Index residuals_ = 0;
};

}  // namespace limber
