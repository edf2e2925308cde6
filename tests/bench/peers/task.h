#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "pipeline/workload.h"
#include "tests/bench/peers/kinematics.h"

namespace limber::peers {

/// One frame's targets as a least-squares problem: residual r = weight (target - effector), to be
/// brought to zero by steps with r' = r - J step. Positions weigh weight_pos, rotations
/// 0.1 m/rad weight_rot, so that |r|^2 is Limber's effector cost.
class Task {
 public:
  Task(const Workload&, Kinematics&);

  void aim(std::size_t frame) { targets_ = work_.targets[frame]; }
  Kinematics& kinematics() { return kinematics_; }
  const Coordinates& coordinates() const { return kinematics_.coordinates(); }
  std::span<const EffectorTarget> targets() const { return targets_; }
  Eigen::Index rows() const { return rows_.back(); }
  /// First row of an effector: 3 for its position, then 3 for its rotation where it has one.
  Eigen::Index row(std::size_t effector) const { return rows_[effector]; }

  /// Forward kinematics and the residual there.
  void evaluate(const State&);
  const Eigen::VectorXd& residual() const { return residual_; }
  double cost() const { return residual_.squaredNorm(); }
  /// Every strong effector is within the workload's stop tolerances.
  bool reached() const { return reached_; }

  /// J, rows x dofs, at the state last evaluated.
  void dense_jacobian(const State&, Eigen::MatrixXd&);
  /// J'J (both triangles) and J'r, from each effector's chain.
  void normal_equations(const State&, Eigen::MatrixXd& jtj, Eigen::VectorXd& jtr);
  /// J'r alone.
  void descent(const State&, Eigen::VectorXd& jtr);

 private:
  Eigen::Index height(std::size_t effector) const { return rows_[effector + 1] - rows_[effector]; }
  void weighted_jacobian(std::size_t effector, ChainJacobian&);

  const Workload& work_;
  Kinematics& kinematics_;
  std::span<const EffectorTarget> targets_;
  std::vector<Eigen::Index> rows_;
  std::vector<ChainJacobian> chain_jacobian_;  // [effector]
  std::vector<Eigen::MatrixXd> block_;         // [effector]
  Eigen::VectorXd residual_;
  bool reached_ = false;
};

}  // namespace limber::peers
