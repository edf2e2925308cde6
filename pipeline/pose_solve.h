#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "importers/targets_json.h"
#include "pipeline/retarget.h"
#include "validation/limit_check.h"

namespace limber {

/// How one named effector ended.
struct EffectorOutcome {
  TargetRow asked;
  DualQuaternion reached;         ///< world_from_effector of the answer
  double position_error_m = 0.0;  ///< 0 where no position is asked for; a line's: its distance
  double angle_error_rad = 0.0;   ///< 0 where no rotation is asked for; directions: between axes
  /// Ceres gets within 1 mm (within 0.5 degrees where no position is asked for), from the answer,
  /// or from a clearly nearer pose that other starts lead to.
  bool reachable = false;
};

struct PoseOutcome {
  std::string name;
  std::vector<DualQuaternion> parent_from_joint;  ///< on the rig's joints
  std::vector<EffectorOutcome> effectors;
  bool reached = false;  ///< every strong effector that is named is within 1 mm and 0.5 degrees
  std::vector<LimitContact> contacts;
  LimitReport limits;
  IkReport solver;          ///< of ceres: its iterations as relinearisations, and the cost
  int searched = 0;         ///< relinearisations from other starts, beyond those of `solver`
  double refined_cost = 0;  ///< after Ceres
  bool failed = false;      ///< a limit is broken or a number is not finite

  /// The effector with the largest position error, or angle where no position counts; null: none.
  const EffectorOutcome* worst() const;
};

/// Solves the poses in order, each from rest or from the one before. A pose that stands alone and
/// is not reached is tried again from other starts, always the same ones; what they find is taken
/// where it gets there, or is clearly nearer.
/// Errors: those of the solver.
Result<std::vector<PoseOutcome>> solve_poses(const Rig&, const TargetsFile&, SolverChoice);

}  // namespace limber
