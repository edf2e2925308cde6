// One pose of a shipped rig: everything stays where it is, the left hand comes forward.

#include <cmath>
#include <cstdio>

#include "pipeline/target.h"
#include "solver/ik_solver.h"

int main() {
  using namespace limber;
  const Rig rig = *shipped_rig("biped-full");
  auto solver = IkSolver::create(rig);
  if (!solver) return std::fprintf(stderr, "%s\n", solver.error().message.c_str()), 1;

  Pose pose = skeleton_of(rig).rest_parent_from_joint;  // the start, and later the answer
  Pose world(pose.size());
  model_from_rows(rig, pose, world);
  std::vector<EffectorTarget> targets;
  std::size_t hand = 0;
  for (const RigEffector& effector : rig.effectors) {
    if (effector.name == "l_hand") hand = targets.size();
    targets.push_back({world[effector.joint] * DualQuaternion::from_translation(effector.offset)});
    // Elbows and knees bend as they like.
    if (effector.kind == EffectorKind::position) targets.back().weight = 0.0;
  }
  targets[hand].pose = DualQuaternion::from_translation({-0.05, 0.0, 0.05}) * targets[hand].pose;

  const IkReport report = solver->solve(targets, pose);
  std::printf("%s in %d steps, every effector within %.3f mm\n",
              report.reached ? "reached" : "not reached", report.relinearisations,
              1e3 * std::sqrt(report.cost));
}
