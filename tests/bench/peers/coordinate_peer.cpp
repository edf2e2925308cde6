#include "tests/bench/peers/coordinate_peer.h"

#include "tests/bench/peers/frame_loop.h"

namespace limber::peers {

namespace {
constexpr int kRestarts = 24;
}

Result<void> CoordinatePeer::prepare(const Workload& work) {
  Result<Coordinates> coordinates = Coordinates::of(work.rig);
  if (!coordinates) return coordinates.error();
  work_ = &work;
  coordinates_ = std::move(coordinates.value());
  if (entry_.mujoco) {
    kinematics_ = mujoco_kinematics(*coordinates_);
  } else {
    kinematics_ = std::make_unique<PlainKinematics>(*coordinates_);
  }
  if (kinematics_ == nullptr) {
    return Error{.code = "bench-peers",
                 .message = has_mujoco() ? "MuJoCo refuses the rig" : "not installed"};
  }
  task_ = std::make_unique<Task>(work, *kinematics_);
  method_ = entry_.make(*task_);
  return {};
}

Answer CoordinatePeer::solve_all(std::size_t frames) {
  method_ = entry_.make(*task_);  // what a method learns on the way is not carried into a new run
  return solve_frames(*this, *work_, frames, entry_.start);
}

State CoordinatePeer::state_of(std::span<const double> q) const {
  Pose pose(work_->rig.joints.size());
  pose_from_coordinates(work_->rig, q, pose);
  return coordinates_->from_pose(pose);
}

void CoordinatePeer::extrapolate(const State& before, const State& after, State& next) const {
  coordinates_->extrapolate(before, after, next);
}

int CoordinatePeer::solve(std::size_t frame, State& state) {
  task_->aim(frame);
  start_ = state;
  int iterations = method_->solve(state);
  if (!task_->reached() && entry_.rescue) {
    iterations += work_->rest_start ? restart(state) : unwind(state);
  }
  return iterations;
}

/// Tries to leave a corner of the limits; what does not arrive is dropped.
int CoordinatePeer::unwind(State& state) {
  int iterations = 0;
  best_ = state;
  for (int third = 1; third <= 3; ++third) {
    state = start_;
    coordinates_->towards_middle(third / 3.0, state);
    iterations += method_->solve(state);
    if (task_->reached()) return iterations;
  }
  state = best_;
  return iterations;
}

/// Tries other starts, the same ones for every frame, until one arrives; else keeps the best.
int CoordinatePeer::restart(State& state) {
  int iterations = 0;
  double best = task_->cost();
  best_ = state;
  std::mt19937_64 random(1);
  for (int k = 0; k < kRestarts; ++k) {
    state = start_;
    coordinates_->randomise(random, state);
    iterations += method_->solve(state);
    if (task_->reached()) return iterations;
    if (task_->cost() < best) {
      best = task_->cost();
      best_ = state;
    }
  }
  state = best_;
  return iterations;
}

void CoordinatePeer::pose(const State& state, std::span<DualQuaternion> parent_from_joint) const {
  coordinates_->to_pose(state, parent_from_joint);
}

}  // namespace limber::peers
