#include "tests/bench/peers/limber_contestants.h"

#include <algorithm>
#include <optional>

#include "pipeline/workload_run.h"
#include "tests/bench/peers/frame_loop.h"
#include "validation/ceres_refiner.h"

namespace limber::peers {

namespace {

/// Where a motion arrives that goes on for one more frame at the same speed: per joint
/// after (before^-1 after), a free joint's translation likewise.
void go_on(const Rig& rig, std::span<const DualQuaternion> before,
           std::span<const DualQuaternion> after, std::span<DualQuaternion> next) {
  for (std::size_t i = 0; i < next.size(); ++i) {
    const Eigen::Quaterniond& a = after[i].real;
    const Eigen::Quaterniond turned = (a * (before[i].real.conjugate() * a)).normalized();
    Eigen::Vector3d translation = after[i].translation();
    if (rig.joints[i].type == JointType::free) {
      translation += translation - before[i].translation();
    }
    next[i] = DualQuaternion::from_rotation_translation(turned, translation);
  }
}

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
    go_on(work_->rig, before, after, next);
  }
  void pose(const State& state, std::span<DualQuaternion> parent_from_joint) const {
    std::copy(state.begin(), state.end(), parent_from_joint.begin());
  }

 protected:
  const Workload* work_ = nullptr;

 private:
  Start start_;
};

class Ours : public Contestant {
 public:
  Ours(IkMethod method, Start start, std::size_t lanes)
      : method_(method), start_(start), lanes_(lanes) {}

  std::string name() const override {
    if (method_ == IkMethod::pgs_paper) return "ours, pgs-paper";
    if (lanes_ > 1) return "ours, 8 lanes";
    return start_ == Start::extrapolated ? "ours" : "ours, previous start";
  }
  std::string setting() const override {
    if (method_ == IkMethod::pgs_paper) return "Kenwright 2013 as limber bench --solver pgs-paper";
    if (lanes_ > 1) return "as limber bench --lanes 8: eight equal runs, each from its own truth";
    return "as limber bench: follows the motion, mends the frames that it does not reach";
  }
  bool ours() const override { return method_ == IkMethod::pgs && lanes_ == 1; }
  Start start() const override { return start_; }
  Result<void> prepare(const Workload& work) override {
    work_ = &work;
    options_ = options_for(work, method_);
    options_.extrapolate = start_ == Start::extrapolated;
    Result<WorkloadRun> tried = run_workload(work, options_, 1);
    if (!tried) return tried.error();
    return {};
  }
  Answer solve_all(std::size_t frames) override {
    WorkloadRun run = std::move(run_workload(*work_, options_, frames, lanes_).value());
    return {std::move(run.clip), std::move(run.us), std::move(run.iterations)};
  }

 private:
  const Workload* work_ = nullptr;
  IkMethod method_;
  Start start_;
  std::size_t lanes_;
  IkOptions options_;
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

std::unique_ptr<Contestant> make_ours(IkMethod method, Start start, std::size_t lanes) {
  return std::make_unique<Ours>(method, start, lanes);
}

std::unique_ptr<Contestant> make_ceres() { return std::make_unique<CeresContestant>(); }

}  // namespace limber::peers
