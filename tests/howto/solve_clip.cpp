// A clip, frame by frame: the right hand's fingertips beat time, each frame starts where the one
// before ended, and the limits are checked by code that shares nothing with the solver.

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "pipeline/target.h"
#include "solver/ik_solver.h"
#include "validation/limit_check.h"

int main() {
  using namespace limber;
  const Rig rig = *shipped_rig("hand");
  auto solver = IkSolver::create(rig);
  if (!solver) return std::fprintf(stderr, "%s\n", solver.error().message.c_str()), 1;

  Pose pose = skeleton_of(rig).rest_parent_from_joint, world(pose.size());
  Clip clip;
  clip.rate_hz = 60.0;
  clip.joints = rig.size();
  std::vector<double> q(dof_count(rig));
  Pose wanted = pose;
  double worst_m = 0.0;
  for (int frame = 0; frame < 240; ++frame) {
    // Targets that can be met: where the fingertips are when every joint is a fraction bent.
    std::fill(q.begin(), q.end(), 0.15 * (1.0 - std::cos(2.0 * M_PI * frame / 120.0)));
    pose_from_coordinates(rig, q, wanted);
    model_from_rows(rig, wanted, world);
    std::vector<EffectorTarget> targets;
    for (const RigEffector& tip : rig.effectors) {
      targets.push_back({world[tip.joint] * DualQuaternion::from_translation(tip.offset)});
    }
    const IkReport report = solver->solve(targets, pose);
    worst_m = std::max(worst_m, std::sqrt(report.cost));
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  const LimitReport limits = check_joint_limits(rig, clip);
  std::printf("%d frames, within %.3f mm of the targets, %.6f degrees beyond the limits\n",
              static_cast<int>(clip.frames()), 1e3 * worst_m, limits.max_violation_deg);
}
