// One frame of the tree solver in eight lanes: the arithmetic of ik_tree.cpp, jacobian.cpp and
// tree_elimination.cpp (whose heads derive it), in floats and without branches on data. What is a
// branch there is a mask here; a part that few lanes need (the nearest point on an ellipse, another
// pass of the active set) runs where any lane needs it and is kept where a lane asked for it. So a
// lane's answer depends on its own targets alone, bit for bit.
//
// Gauss-Newton with damping per lane: a step that made a lane worse is taken back and tried with
// more damping. Lanes that do not get within tolerance in kMostRelinearisations say so in `missed`
// and are for the caller.
//
// Included once per SIMD level (solver/lane.h says how levels are kept apart).
#pragma once

#include "solver/lane_elimination.h"
#include "solver/lane_frame.h"
#include "solver/lane_kinematics.h"
#include "solver/lane_transfer.h"

namespace limber::LIMBER_LANES {
namespace {

constexpr int kMostRelinearisations = 8;  // one for eight is cheaper than one alone
constexpr float kLeastDamping = 1e-7f, kMoreDamping = 32.0f, kLessDamping = 0.1f;

void Frame::follow(const double* targets) {
  lane(s_.relinearisations) = lane(s_.tree_passes) = 0;
  read_goals(targets);
  start();
  evaluate();
  Mask active = all();
  Lane damping = lane(s_.damping), was = cost();
  for (int i = 0; i < kMostRelinearisations && any(active); ++i) {
    lane(s_.relinearisations) += flag(active);
    linearise(active);
    load();
    solve(damping, active, i < kEarly);
    move(active);
    evaluate();
    const Mask arrived = done();
    const Lane is = cost();
    const Mask rose = active & (!arrived) & (!(is <= was));
    const Mask fell = active & (!rose);
    const Lane less = max(damping * Lane(kLessDamping), Lane(kLeastDamping));
    damping = select(rose, damping * Lane(kMoreDamping), select(fell, less, damping));
    was = select(fell, is, was);
    active = active & (!arrived);
    if (any(rose)) {
      put_back(rose);
      evaluate();
    }
  }
  lane(s_.damping) = min(damping, Lane(p_.damping));
  lane(s_.missed) = flag(active);
  write_poses();
}

}  // namespace

void follow_frame(const LaneProblem& problem, LaneState& state, const double* targets) {
  Frame(problem, state).follow(targets);
}
std::size_t scratch_packs(const LaneProblem& problem) { return Frame::packs(problem); }

}  // namespace limber::LIMBER_LANES
