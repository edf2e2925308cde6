#include "tests/bench/peers/limber_contestants.h"

#include <algorithm>
#include <optional>

#include "tests/bench/peers/frame_loop.h"
#include "validation/ceres_refiner.h"

namespace limber::peers {

namespace {

/// Limber's own pose is what these move.
class PoseContestant : public Contestant {
 public:
  explicit PoseContestant(Start start) : start_(start) {}
  Start start() const override { return start_; }
  Answer solve_all(std::size_t frames) override {
    return solve_frames(*this, *work_, frames, start_);
  }

  using State = Pose;
  virtual int solve(std::size_t frame, State& state) = 0;
  virtual bool reached() const { return true; }
  State state_of(std::span<const double> q) const {
    Pose pose(work_->rig.joints.size());
    pose_from_coordinates(work_->rig, q, pose);
    return pose;
  }
  void extrapolate(const State& before, const State& after, State& next) const {
    limber::extrapolate(work_->rig, before, after, next);
  }
  void pose(const State& state, std::span<DualQuaternion> parent_from_joint) const {
    std::copy(state.begin(), state.end(), parent_from_joint.begin());
  }

 protected:
  const Workload* work_ = nullptr;

 private:
  Start start_;
};

class Ours : public PoseContestant {
 public:
  Ours(IkMethod method, Start start) : PoseContestant(start), method_(method) {}

  std::string name() const override {
    if (method_ == IkMethod::pgs_paper) return "ours, pgs-paper";
    return start() == Start::extrapolated ? "ours" : "ours, previous start";
  }
  std::string setting() const override {
    if (method_ == IkMethod::pgs_paper) return "Kenwright 2013 as limber bench --solver pgs-paper";
    return "as limber bench: stops at a tenth of the tolerance; restarts and unwinds by itself";
  }
  bool ours() const override { return method_ == IkMethod::pgs; }
  Result<void> prepare(const Workload& work) override {
    work_ = &work;
    Result<IkSolver> solver = IkSolver::create(work.rig, options_for(work, method_));
    if (!solver) return solver.error();
    solver_.emplace(std::move(solver.value()));
    return {};
  }
  int solve(std::size_t frame, State& state) override {
    return solver_->solve(work_->targets[frame], state).relinearisations;
  }

 private:
  IkMethod method_;
  std::optional<IkSolver> solver_;
};

class CeresContestant : public PoseContestant {
 public:
  CeresContestant() : PoseContestant(Start::extrapolated) {}

  std::string name() const override { return "Ceres LM"; }
  std::string setting() const override {
    return "bounds on the swing chart, dense normal Cholesky, rounds of held bounds, at most 100 "
           "iterations, one start; stops where the cost alone says that all are within tolerance; "
           "allocates anew for every solve";
  }
  Result<void> prepare(const Workload& work) override {
    work_ = &work;
    return {};
  }
  int solve(std::size_t frame, State& state) override {
    // Where |r| is below both tolerances, every effector is: 0.1 m/rad weighs a rotation.
    const double enough = std::min(work_->stop_pos, 0.1 * work_->stop_rot);
    const auto refined = refine_with_ceres(work_->rig, work_->targets[frame], state,
                                           {.max_iterations = 100, .enough_cost = enough * enough});
    return refined ? refined->iterations : 0;
  }
};

}  // namespace

std::unique_ptr<Contestant> make_ours(IkMethod method, Start start) {
  return std::make_unique<Ours>(method, start);
}

std::unique_ptr<Contestant> make_ceres() { return std::make_unique<CeresContestant>(); }

}  // namespace limber::peers
