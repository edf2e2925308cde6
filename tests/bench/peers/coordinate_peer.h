#pragma once

#include <memory>
#include <optional>
#include <string>

#include "tests/bench/peers/contestant.h"
#include "tests/bench/peers/task.h"

namespace limber::peers {

/// A method that improves a pose of a task, given in coordinates.
class Method {
 public:
  virtual ~Method() = default;
  /// Moves the state, which stays within limits; returns iterations.
  virtual int solve(State&) = 0;
};

/// What a method is called and how it is made.
struct MethodEntry {
  std::string name, setting;
  std::unique_ptr<Method> (*make)(Task&);
  Start start = Start::previous;
  bool mujoco = false;  ///< MuJoCo's kinematics, else the plain ones
  /// Starts again where the first start does not arrive, as Limber does: a lone pose from 24
  /// others, a frame of a motion from thirds of the way to the middle of the ranges.
  bool rescue = true;
};

/// Solves frame by frame with a method on the shared kinematics.
class CoordinatePeer : public Contestant {
 public:
  explicit CoordinatePeer(MethodEntry entry) : entry_(std::move(entry)) {}

  std::string name() const override { return entry_.name; }
  std::string setting() const override { return entry_.setting; }
  Start start() const override { return entry_.start; }
  Result<void> prepare(const Workload&) override;
  Answer solve_all(std::size_t frames) override;

  // What the loop over frames asks for.
  using State = peers::State;
  State state_of(std::span<const double> q) const;
  void extrapolate(const State& before, const State& after, State& next) const;
  int solve(std::size_t frame, State&);
  bool reached() const { return task_->reached(); }
  void pose(const State&, std::span<DualQuaternion> parent_from_joint) const;

 private:
  int restart(State&);
  int unwind(State&);

  MethodEntry entry_;
  const Workload* work_ = nullptr;
  std::optional<Coordinates> coordinates_;
  std::unique_ptr<Kinematics> kinematics_;
  std::unique_ptr<Task> task_;
  std::unique_ptr<Method> method_;
  State start_, best_;
};

}  // namespace limber::peers
