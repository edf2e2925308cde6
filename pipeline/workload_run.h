#pragma once

#include <optional>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/result.h"
#include "pipeline/workload.h"
#include "solver/ik_cycle.h"

namespace limber {

/// What a solver made of a workload's frames.
struct WorkloadRun {
  Clip clip;                    ///< parent_from_joint, one row per frame
  std::vector<double> us;       ///< [frame] from targets to pose
  std::vector<int> iterations;  ///< [frame] linearisations
  std::optional<CycleReport> cycle;
};

/// Solves the first `frames` frames as the workload asks: lone poses from rest, a motion from the
/// truth of its first frame on, followed frame by frame. `lanes` > 1 cuts a motion into so many
/// equal runs, each from its own truth; pgs solves eight of them side by side.
Result<WorkloadRun> run_workload(const Workload&, const IkOptions&, std::size_t frames,
                                 std::size_t lanes = 1);
/// Solves a motion as the cycle that it is. Time and linearisations are shared out evenly: no frame
/// is done before the last one. Error: also `clip-open`.
Result<WorkloadRun> run_workload_cycle(const Workload&, const IkOptions&);
/// run_workload with Ceres, from each frame's start alone: rest, or the frame before.
Result<WorkloadRun> run_workload_with_ceres(const Workload&, std::size_t frames,
                                            std::size_t lanes = 1);

}  // namespace limber
