// What surrounds a lane kernel: starts, and what the kernel leaves to doubles.
#include "solver/lane_solver.h"

#include <algorithm>
#include <array>

#include "solver/ik_descent.h"
#include "solver/ik_tree.h"
#include "solver/joint_chart.h"
#include "solver/lane_problem.h"

namespace limber {

struct LaneSolver::State {
  State(const Rig& source, const IkOptions& options, IkSolver&& one)
      : rig(source),
        tree(source),
        problem(tree, source, options),
        lanes(problem),
        poses(LaneSolver::lanes * problem.joints),
        alone(std::move(one)),
        exact(tree.make_state()),
        kernel(lane_kernels().front()) {
    lanes.poses = reinterpret_cast<double*>(poses.data());
    for (std::size_t n = 0; n < problem.nodes.size(); ++n) {
      if (problem.nodes[n].thin) {
        thin.push_back({n, JointChart(rig.joints[problem.nodes[n].joint])});
      }
    }
  }

  std::span<DualQuaternion> pose(int lane) {
    return std::span(poses).subspan(lane * problem.joints, problem.joints);
  }
  void write(int lane, std::vector<Pack>& x, std::vector<Pack>& turn) const;
  void store_thin(int lane);
  void solve_alone(int lane, std::span<const EffectorTarget>);
  void shift_answers();

  struct Thin {
    std::size_t node;
    JointChart chart;
  };

  Rig rig;
  IkTree tree;
  LaneProblem problem;
  LaneState lanes;
  std::vector<DualQuaternion> poses;  ///< [lane * joints + joint]
  IkSolver alone;
  IkState exact;  ///< of one lane, in doubles
  std::vector<Thin> thin;
  std::array<IkReport, LaneSolver::lanes> reports;
  NamedLaneKernel kernel;
};

/// `exact` to floats.
void LaneSolver::State::write(int lane, std::vector<Pack>& x, std::vector<Pack>& turn) const {
  for (std::size_t k = 0; k < x.size(); ++k) x[k].lane[lane] = static_cast<float>(exact.x[k]);
  for (std::size_t n = 0; n < problem.nodes.size(); ++n) {
    const Eigen::Quaterniond& q = exact.rotation[n];
    turn[4 * n].lane[lane] = static_cast<float>(q.w());
    for (int i = 0; i < 3; ++i) turn[4 * n + 1 + i].lane[lane] = static_cast<float>(q.vec()[i]);
  }
}

/// Joints with a range that floats cannot keep: projected and composed in doubles.
void LaneSolver::State::store_thin(int lane) {
  if (thin.empty()) return;
  for (std::size_t k = 0; k < lanes.x.size(); ++k) exact.x[k] = lanes.x[k].lane[lane];
  tree.project(exact.x);
  for (const Thin& t : thin) {
    const IkNode& node = tree.nodes[t.node];
    const std::span<const double> w(&exact.x[node.coordinate],
                                    static_cast<std::size_t>(node.coordinates));
    pose(lane)[node.joint] = t.chart.parent_from_joint(w);
  }
}

void LaneSolver::State::solve_alone(int lane, std::span<const EffectorTarget> targets) {
  reports[lane] = alone.solve(targets, pose(lane));
  tree.load(pose(lane), exact);
  write(lane, lanes.x, lanes.turn);
  lanes.fresh.lane[lane] = 1.0f;
}

void LaneSolver::State::shift_answers() {
  std::swap(lanes.before, lanes.last);
  std::swap(lanes.before_turn, lanes.last_turn);
  std::swap(lanes.last, lanes.x);
  std::swap(lanes.last_turn, lanes.turn);
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
  LaneSolver solver(std::move(state));
  const Pose rest = skeleton_of(rig).rest_parent_from_joint;
  for (int lane = 0; lane < lanes; ++lane) solver.start(lane, rest);
  return solver;
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

void LaneSolver::start(int lane, std::span<const DualQuaternion> start) {
  State& s = *state_;
  std::ranges::copy(start, s.pose(lane).begin());
  for (std::int32_t joint = 0; joint < s.rig.size(); ++joint) {
    project_joint(s.rig, joint, s.pose(lane));
  }
  s.tree.load(start, s.exact);
  s.write(lane, s.lanes.last, s.lanes.last_turn);
  s.write(lane, s.lanes.before, s.lanes.before_turn);
  s.lanes.fresh.lane[lane] = 1.0f;
}

int LaneSolver::follow(std::span<const EffectorTarget> targets) {
  State& s = *state_;
  const std::size_t effectors = s.problem.effectors.size();
  s.kernel.follow(s.problem, s.lanes, reinterpret_cast<const double*>(targets.data()));
  int alone = 0;
  for (int lane = 0; lane < lanes; ++lane) {
    s.store_thin(lane);
    IkReport& report = s.reports[lane];
    report = {};
    report.relinearisations = static_cast<int>(s.lanes.relinearisations.lane[lane]);
    report.tree_passes = static_cast<int>(s.lanes.tree_passes.lane[lane]);
    report.reached = report.converged = s.lanes.missed.lane[lane] == 0.0f;
    if (report.reached) continue;
    s.solve_alone(lane, targets.subspan(lane * effectors, effectors));
    ++alone;
  }
  s.shift_answers();
  return alone;
}

void LaneSolver::pose(int lane, std::span<DualQuaternion> pose) const {
  std::ranges::copy(state_->pose(lane), pose.begin());
}

IkReport LaneSolver::report(int lane) const { return state_->reports[lane]; }

}  // namespace limber
