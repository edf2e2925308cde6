// What surrounds a lane kernel: doubles to floats and back, and the frames that it gives up.
#include "solver/lane_solver.h"

#include <algorithm>
#include <array>

#include "solver/lane_problem.h"

namespace limber {

struct LaneSolver::State {
  State(const Rig& source, const IkOptions& options, IkSolver&& one)
      : rig(source),
        tree(source),
        problem(configured(tree, options)),
        lanes(problem),
        alone(std::move(one)),
        states(LaneSolver::lanes, tree.make_state()),
        goals(tree.effectors.size()),
        pose(skeleton_of(source).rest_parent_from_joint),
        outside(LaneSolver::lanes, pose),
        kernel(lane_kernels().front()) {}

  static LaneProblem configured(const IkTree& tree, const IkOptions& options);
  void read(int lane, const std::vector<Pack>& x, const std::vector<Pack>& turn, IkState&) const;
  void write(int lane, const IkState&, std::vector<Pack>& x, std::vector<Pack>& turn) const;
  void set_goals(int lane, std::span<const EffectorTarget>);
  void solve_alone(int lane, std::span<const EffectorTarget>);

  Rig rig;
  IkTree tree;
  LaneProblem problem;
  LaneState lanes;
  IkSolver alone;
  std::vector<IkState> states;  ///< [lane] answers, in doubles
  std::vector<IkGoal> goals;
  Pose pose;
  std::vector<Pose> outside;  ///< [lane] joints that are no node
  std::array<IkReport, LaneSolver::lanes> reports;
  NamedLaneKernel kernel;
};

namespace {

constexpr double kEase = 5e-4, kCalm = 0.9;  // as ik_solver.cpp
constexpr double kFloatDamping = 1e-5;       // what floats can tell from nothing

}  // namespace

LaneProblem LaneSolver::State::configured(const IkTree& tree, const IkOptions& options) {
  LaneProblem p(tree);
  const auto square = [](double v) { return static_cast<float>(v * v); };
  p.stop_position2 = square(options.stop_position_m);
  p.stop_rotation2 = square(options.stop_orientation_rad);
  p.ease = static_cast<float>(kEase);
  p.calm = static_cast<float>(kCalm);
  p.damping = static_cast<float>(std::max(options.damping, kFloatDamping));
  p.extrapolate = options.extrapolate;
  return p;
}

void LaneSolver::State::read(int lane, const std::vector<Pack>& x, const std::vector<Pack>& turn,
                             IkState& out) const {
  for (std::size_t k = 0; k < x.size(); ++k) out.x[k] = x[k].lane[lane];
  for (std::size_t n = 0; n < problem.nodes.size(); ++n) {
    if (!problem.nodes[n].turns) continue;
    const Pack* q = &turn[4 * n];
    out.rotation[n] =
        Eigen::Quaterniond(q[0].lane[lane], q[1].lane[lane], q[2].lane[lane], q[3].lane[lane])
            .normalized();
  }
  tree.project(out.x);
}

void LaneSolver::State::write(int lane, const IkState& in, std::vector<Pack>& x,
                              std::vector<Pack>& turn) const {
  for (std::size_t k = 0; k < x.size(); ++k) x[k].lane[lane] = static_cast<float>(in.x[k]);
  for (std::size_t n = 0; n < problem.nodes.size(); ++n) {
    const Eigen::Quaterniond& q = in.rotation[n];
    turn[4 * n].lane[lane] = static_cast<float>(q.w());
    for (int i = 0; i < 3; ++i) turn[4 * n + 1 + i].lane[lane] = static_cast<float>(q.vec()[i]);
  }
}

void LaneSolver::State::set_goals(int lane, std::span<const EffectorTarget> targets) {
  tree.resolve(targets, goals);
  for (std::size_t e = 0; e < goals.size(); ++e) {
    const IkGoal& goal = goals[e];
    for (int i = 0; i < 3; ++i) {
      lanes.goal_position[3 * e + i].lane[lane] = static_cast<float>(goal.position[i]);
      lanes.goal_rotation[4 * e + 1 + i].lane[lane] = static_cast<float>(goal.rotation.vec()[i]);
    }
    lanes.goal_rotation[4 * e].lane[lane] = static_cast<float>(goal.rotation.w());
    lanes.mass[e].lane[lane] = static_cast<float>(goal.mass);
    lanes.inertia[e].lane[lane] = static_cast<float>(goal.inertia);
  }
}

void LaneSolver::State::solve_alone(int lane, std::span<const EffectorTarget> targets) {
  read(lane, lanes.x, lanes.turn, states[lane]);
  tree.store(states[lane], pose);
  reports[lane] = alone.solve(targets, pose);
  tree.load(pose, states[lane]);
  write(lane, states[lane], lanes.x, lanes.turn);
}

LaneSolver::LaneSolver(std::unique_ptr<State> state) : state_(std::move(state)) {}
LaneSolver::LaneSolver(LaneSolver&&) noexcept = default;
LaneSolver& LaneSolver::operator=(LaneSolver&&) noexcept = default;
LaneSolver::~LaneSolver() = default;

Result<LaneSolver> LaneSolver::create(const Rig& rig, const IkOptions& options) {
  Result<IkSolver> one = IkSolver::create(rig, options);
  if (!one) return one.error();
  auto state = std::make_unique<State>(rig, options, std::move(one.value()));
  for (const IkEffector& effector : state->tree.effectors) {
    if (effector.node >= 0 &&
        (effector.kind == EffectorKind::pose || effector.kind == EffectorKind::position ||
         effector.kind == EffectorKind::orientation)) {
      continue;
    }
    return Error{.code = "solver-lanes",
                 .message = "lanes solve poses, positions and orientations of joints that move",
                 .hint = "use one lane, or leave out the other effectors"};
  }
  return LaneSolver(std::move(state));
}

const char* LaneSolver::level() const { return state_->kernel.level; }

std::vector<std::string> LaneSolver::levels() {
  std::vector<std::string> out;
  for (const NamedLaneKernel& kernel : lane_kernels()) out.emplace_back(kernel.level);
  return out;
}

void LaneSolver::use_level(const std::string& level) {
  for (const NamedLaneKernel& kernel : lane_kernels()) {
    if (kernel.level == level) state_->kernel = kernel;
  }
}

void LaneSolver::start(int lane, std::span<const DualQuaternion> pose) {
  State& s = *state_;
  s.tree.load(pose, s.states[lane]);
  s.write(lane, s.states[lane], s.lanes.last, s.lanes.last_turn);
  s.write(lane, s.states[lane], s.lanes.x, s.lanes.turn);
  s.outside[lane].assign(pose.begin(), pose.end());
  s.lanes.answers = 1;
}

int LaneSolver::follow(std::span<const EffectorTarget> targets) {
  State& s = *state_;
  const std::size_t effectors = s.goals.size();
  const auto of = [&](int lane) { return targets.subspan(lane * effectors, effectors); };
  for (int lane = 0; lane < lanes; ++lane) s.set_goals(lane, of(lane));
  s.kernel.follow(s.problem, s.lanes);
  int alone = 0;
  for (int lane = 0; lane < lanes; ++lane) {
    s.reports[lane] = {};
    s.reports[lane].relinearisations = s.lanes.relinearisations;
    s.reports[lane].tree_passes = s.lanes.tree_passes;
    s.reports[lane].reached = s.lanes.missed[lane] == 0;
    if (s.lanes.missed[lane] != 0) {
      s.solve_alone(lane, of(lane));
      ++alone;
    } else {
      s.read(lane, s.lanes.x, s.lanes.turn, s.states[lane]);
    }
  }
  std::swap(s.lanes.before, s.lanes.last);
  std::swap(s.lanes.before_turn, s.lanes.last_turn);
  s.lanes.last = s.lanes.x;
  s.lanes.last_turn = s.lanes.turn;
  s.lanes.answers = std::min(s.lanes.answers + 1, 2);
  return alone;
}

void LaneSolver::pose(int lane, std::span<DualQuaternion> pose) const {
  const State& s = *state_;
  for (const std::int32_t joint : s.tree.outside) pose[joint] = s.outside[lane][joint];
  s.tree.store(s.states[lane], pose);
}

IkReport LaneSolver::report(int lane) const { return state_->reports[lane]; }

}  // namespace limber
