#pragma once

#include <cstdint>
#include <span>

#include "assets/model/result.h"
#include "solver/ik_solver.h"

namespace limber {

/// How a clip's targets go on after its last frame.
enum class Closing : std::uint8_t {
  none,       ///< not into its first
  continues,  ///< into its first, as one frame goes into the next
  repeats,    ///< the last frame is the first once more
};
/// `targets`: [frame * effectors]. Into the first: by a step, and a change of step, of at most
/// twice what the targets have elsewhere.
Closing closing_of(const Rig&, std::span<const EffectorTarget> targets);

/// How poses go on from one frame to the next, by the joint that does so most.
struct PoseStep {
  double way_m = 0.0, turn_rad = 0.0;  ///< of a joint's place in the world; relative to its parent
  /// How much that step differs, as a vector, from the steps before and after: the jump of velocity
  /// per frame.
  double way_change_m = 0.0, turn_change_rad = 0.0;
};
struct CycleSteps {
  PoseStep seam;       ///< from the last frame into the first
  PoseStep elsewhere;  ///< the largest of the others, each figure by itself
};
/// Of frames that go round: `poses` [frame * joints], parent from joint, without a repeated one.
CycleSteps cycle_steps(const Rig&, std::span<const DualQuaternion> poses);

struct CycleReport {
  Closing closing = Closing::none;
  std::int64_t period = 0;     ///< frames, a repeated one not counted
  int laps = 0;                ///< solved
  bool closed = false;         ///< false: no way was found round the seam, which stays open
  bool led_over = false;       ///< laps did not meet, and one was led over into the other
  double apart_rad = 0.0;      ///< of the two laps, where the answer goes from one to the other
  std::int64_t unreached = 0;  ///< frames of the answer with a strong effector off its target
  int mended = 0, jumps = 0;   ///< as IkClipSolver's, in all laps
  int relinearisations = 0;    ///< in all
  CycleSteps steps;
};

/// Solves a clip that is a cycle so that its solution is one too: what the targets leave open comes
/// back to where it was, and the last frame flows into the first in place and speed. Where laps met
/// (closed, not led_over, nothing mended) the answer is the same at whatever frame the cycle
/// begins. Every limited joint is within its limits (1e-5 degrees). max_speed holds within a lap;
/// leading one lap over into another does not count it. `targets`: [frame * effectors]. `poses`:
/// [frame * joints], parent from joint; the first frame holds the start, all are written. Error:
/// `clip-open`, the targets close in no way; `poses` stay.
Result<CycleReport> solve_cycle(IkSolver&, const Rig&, std::span<const EffectorTarget> targets,
                                std::span<DualQuaternion> poses);

}  // namespace limber
