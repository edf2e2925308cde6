#pragma once

#include <Eigen/Core>
#include <vector>

#include "solver/ik_solver.h"
#include "solver/ik_tree.h"
#include "solver/jacobian.h"
#include "solver/pgs.h"
#include "solver/row_solver.h"
#include "solver/rows.h"
#include "solver/tree_elimination.h"

namespace limber {

/// m^2. A frame that misses by more is out of reach, not wound into a corner of its limits.
inline constexpr double kWoundCost = 0.05 * 0.05;

/// The outer loop on one frame's goals: from the state `now` to the optimum that it leads to.
struct IkDescent {
  IkDescent(const Rig&, const IkOptions&);

  /// Descends from `now`; afterwards `at_now` is its place. `following`: at least one
  /// relinearisation, from the active limits and the damping that the last descent ended with, what
  /// the goals leave open pulled to `anchor`.
  void descend(IkReport&, bool following = false);
  void evaluate(const IkState&, IkKinematics&, RowPlace&);
  bool reached(const IkKinematics&) const;
  /// What a linear problem at `now` needs; `curved`: with the errors' curvature.
  void linearise(bool curved = false);

  Rig rig;
  IkOptions options;
  IkTree tree;
  TreeElimination elimination;
  std::vector<IkGoal> goals;
  std::vector<EllipseLimit> ellipses;
  IkState now, next;
  IkKinematics at_now, at_next;
  EffectorLoad load;
  IkRows rows;
  RowPlace rows_now, rows_next;
  RowSolver row_solver;
  double penalty = 0.0, settled_damping = 0.0;
  Eigen::VectorXd step, wish, anchor, gradient, diagonal, end;  ///< [coordinate]

 private:
  bool done(const IkKinematics&, const RowPlace&) const;
  double measure_residual(double damping);
  double predicted_fall(double damping) const;
  EliminationStats solve_linear(double damping, IkReport&);
  EliminationStats solve_rows(double damping, IkReport&);
  double predicted_row_fall() const;
  void bend_step(double damping, IkReport&);
  void step_again();
  void settle_rows(IkReport&);
  double merit(const IkKinematics&, const RowPlace&) const;
  void carry_multipliers();
};

}  // namespace limber
