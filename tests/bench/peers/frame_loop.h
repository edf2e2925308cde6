#pragma once

#include <chrono>
#include <utility>

#include "tests/bench/peers/contestant.h"

namespace limber::peers {

/// The loop over frames that all contestants share, whatever they keep a pose in. `Method` has
///   using State;                                   what it moves; copied from frame to frame
///   State state_of(std::span<const double> q);     from canonical coordinates
///   void extrapolate(const State& before, const State& after, State& next);
///   int solve(std::size_t frame, State&);          returns the iterations
///   bool reached() const;                          whether the last solve arrived
///   void pose(const State&, std::span<DualQuaternion> parent_from_joint);
/// Where an extrapolated start does not arrive, the frame is tried again from the last solution.
/// The first frame of a motion starts at its truth, a lone pose at rest. Timed are the start from
/// earlier solutions and the solve.
template <class Method>
Answer solve_frames(Method& method, const Workload& work, std::size_t frames, Start start) {
  using Clock = std::chrono::steady_clock;
  const std::vector<double> zero(work.truth_q.front().size(), 0.0);
  Answer answer;
  answer.clip.joints = work.rig.size();
  answer.clip.parent_from_joint.resize(frames * work.rig.joints.size());
  answer.us.reserve(frames);
  answer.iterations.reserve(frames);
  typename Method::State first = method.state_of(work.rest_start ? zero : work.truth_q.front());
  typename Method::State before = first, after = first, state = first;
  for (std::size_t f = 0; f < frames; ++f) {
    const bool extrapolated = start == Start::extrapolated && !work.rest_start && f >= 2;
    const auto begin = Clock::now();
    if (work.rest_start || f == 0) {
      state = first;
    } else if (extrapolated) {
      method.extrapolate(before, after, state);
    } else {
      state = after;
    }
    int iterations = method.solve(f, state);
    if (extrapolated && !method.reached()) {
      state = after;
      iterations += method.solve(f, state);
    }
    std::swap(before, after);
    after = state;
    const auto end = Clock::now();
    answer.us.push_back(std::chrono::duration<double, std::micro>(end - begin).count());
    answer.iterations.push_back(iterations);
    method.pose(state, answer.clip.frame(static_cast<std::int64_t>(f)));
  }
  return answer;
}

}  // namespace limber::peers
