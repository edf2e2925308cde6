#pragma once

#include <span>

#include "assets/model/result.h"
#include "assets/model/rig.h"
#include "solver/ik_solver.h"

namespace limber {

struct RefineOptions {
  int max_iterations = 15;
  double enough_cost = 0.0;  ///< J at which the answer is good enough; 0: go on to the minimum
  double stop_cost = 1e-10;  ///< J at stop tolerance: below it two costs count as equal
};

struct RefineReport {
  double cost_before = 0.0;
  double cost_after = 0.0;
  /// (J_before - J_after) / max(J_after, stop_cost), in percent (DESIGN section 4).
  double gap_percent = 0.0;
  int iterations = 0;
};

/// Minimises the solver's own effector objective from the given pose with Ceres, bounds on smooth
/// coordinates, sharing the objective but not the method. The pose becomes Ceres's answer, within
/// limits; never worse than it was. Relative effectors are the solver's, couplings are stiff
/// residuals; capsules and speeds are not seen. Error `refine-rows`: the rig asks for more than
/// that (strict priorities, couplings of a ball's swing).
Result<RefineReport> refine_with_ceres(const Rig&, std::span<const EffectorTarget>,
                                       std::span<DualQuaternion> parent_from_joint,
                                       const RefineOptions& = {});

}  // namespace limber
