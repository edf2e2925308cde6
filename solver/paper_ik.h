#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/rig.h"
#include "assets/model/skeleton.h"
#include "solver/ik_solver.h"
#include "solver/ik_tree.h"
#include "solver/joint_chart.h"
#include "solver/pgs.h"

namespace limber {

/// Inverse kinematics as Kenwright 2013 has it: "Inverse Kinematics with Dual-Quaternions,
/// Exponential-Maps, and Joint Limits". The derivation opens paper_ik.cpp.
///
/// One iteration is one relinearisation with IkOptions::sweeps sweeps (the paper: one). The pose
/// given is the paper's warm start: pass the last frame's solution.
class PaperIk {
 public:
  /// `rig` must be valid.
  PaperIk(const Rig& rig, const IkOptions&);

  /// As IkSolver::solve; allocates nothing.
  IkReport solve(std::span<const EffectorTarget>, std::span<DualQuaternion> parent_from_joint);

  /// Sets up the linear problem at a pose, which is first brought into its limits.
  void linearise(std::span<const EffectorTarget>, std::span<DualQuaternion> parent_from_joint);
  /// min 1/2 x'Ax - b'x, A = J'J + damping 1 (eq. 30), b = J'e (eq. 29), within limits. Views of
  /// this object.
  LimitedProblem problem() const { return {a_, b_, at_, min_, max_, ellipses_}; }
  /// Six rows per effector: position (m) times its weight, rotation (rad) times 0.1 m/rad and its
  /// weight. One column per coordinate.
  const Eigen::MatrixXd& jacobian() const { return jacobian_; }
  /// Target minus current, weighted as the rows of the Jacobian.
  const Eigen::VectorXd& error() const { return error_; }
  /// Coordinates of the joints that carry effectors, by joint, as JointChart orders them.
  const Eigen::VectorXd& coordinates() const { return w_; }

 private:
  struct MovingJoint {
    std::int32_t joint = 0;
    std::int32_t first = 0;  ///< coordinate
    JointChart chart;
  };

  void add_limits(const MovingJoint&);
  void load(std::span<const EffectorTarget>, std::span<DualQuaternion> parent_from_joint);
  void evaluate();
  void differentiate();
  void multiply();
  void set_up_linear_problem();
  double residual();
  void move();
  void keep_best();
  void descend(IkReport&);
  bool acceptable() const;
  bool within_tolerance() const;
  std::span<double> of(const MovingJoint& m) { return {&w_[m.first], std::size_t(m.chart.size())}; }

  Rig rig_;
  IkOptions options_;
  Skeleton skeleton_;
  std::vector<MovingJoint> joints_;
  std::vector<IkEffector> effectors_;
  std::vector<std::vector<std::int32_t>> chains_;  ///< [effector] coordinates that move it
  std::vector<EllipseLimit> ellipses_;
  Eigen::VectorXd min_, max_;

  std::vector<IkGoal> goals_;
  std::vector<IkError> errors_;
  Pose local_, world_;
  std::vector<DualVector> twists_;  ///< [coordinate] of a unit rate, world
  double cost_ = 0.0, best_cost_ = 0.0;
  Eigen::VectorXd w_, at_, best_, step_, end_, error_, b_, gradient_, diagonal_;
  Eigen::MatrixXd jacobian_, a_;
};

}  // namespace limber
