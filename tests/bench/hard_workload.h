#pragma once

#include <cstdint>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/rig.h"
#include "solver/ik_solver.h"

namespace limber::test {

/// The 99-DOF rig with closed hands that are pressed together and moved about in front of the body,
/// while the trunk sways: what rows are for. Made from a seed, the same everywhere.
///
/// The source is a smooth motion that knows nothing of rows: fists closed a little further than
/// there is room for, fingers bent out of proportion, fists a little into each other. All targets
/// are its own.
struct HardWorkload {
  double rate_hz = 120.0;
  Clip source;

  /// Eight couplings (each finger's last joint bends by 2/3 of the one before), the right hand's
  /// target in the left hand's space, capsules apart, finger joints no faster than 0.4 rad/s.
  Rig rig;
  std::vector<std::vector<EffectorTarget>> targets;  ///< [frame][effector]
  IkOptions options;

  /// The same without rows: what the tree alone can express.
  Rig tree_rig;
  std::vector<std::vector<EffectorTarget>> tree_targets;
  IkOptions tree_options;

  std::size_t frames() const { return targets.size(); }
};

/// `body`: the shipped rig biped-hands.
HardWorkload make_hard_workload(const Rig& body, std::int64_t frames = 600, unsigned seed = 1);

/// Solves it frame after frame, each from the one before (the first from the source's), into `out`.
/// `with_rows`: the rig with rows, else the tree's. `each` sees every report.
struct HardRun {
  Clip clip;
  std::vector<IkReport> reports;
  std::vector<double> us;  ///< wall time per frame
};
HardRun run_hard_workload(const HardWorkload&, bool with_rows);

}  // namespace limber::test
