#include "tests/bench/peers/limber_contestants.h"

#include <algorithm>
#include <optional>

#include "tests/bench/peers/frame_loop.h"

namespace limber::peers {

namespace {

class Ours : public Contestant {
 public:
  Ours(IkMethod method, Start start) : method_(method), start_(start) {}

  std::string name() const override {
    if (method_ == IkMethod::pgs_paper) return "ours, pgs-paper";
    return start_ == Start::extrapolated ? "ours" : "ours, previous start";
  }
  std::string setting() const override {
    if (method_ == IkMethod::pgs_paper) return "Kenwright 2013, as limber bench --solver pgs-paper";
    return "as limber bench; stops at a tenth of the tolerance";
  }
  Start start() const override { return start_; }

  Result<void> prepare(const Workload& work) override {
    work_ = &work;
    Result<IkSolver> solver = IkSolver::create(work.rig, options_for(work, method_));
    if (!solver) return solver.error();
    solver_.emplace(std::move(solver.value()));
    return {};
  }

  Answer solve_all(std::size_t frames) override {
    return solve_frames(*this, *work_, frames, start_);
  }

  using State = Pose;
  State state_of(std::span<const double> q) const {
    Pose pose(work_->rig.joints.size());
    pose_from_coordinates(work_->rig, q, pose);
    return pose;
  }
  void extrapolate(const State& before, const State& after, State& next) const {
    limber::extrapolate(work_->rig, before, after, next);
  }
  int solve(std::size_t frame, State& state) {
    return solver_->solve(work_->targets[frame], state).relinearisations;
  }
  bool reached() const { return true; }  // it sees to other starts itself
  void pose(const State& state, std::span<DualQuaternion> parent_from_joint) const {
    std::copy(state.begin(), state.end(), parent_from_joint.begin());
  }

 private:
  IkMethod method_;
  Start start_;
  const Workload* work_ = nullptr;
  std::optional<IkSolver> solver_;
};

}  // namespace

std::unique_ptr<Contestant> make_ours(IkMethod method, Start start) {
  return std::make_unique<Ours>(method, start);
}

}  // namespace limber::peers
