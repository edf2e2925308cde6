// The parts of one relinearisation, and solves under the load of retargeting.
#include <benchmark/benchmark.h>

#include "solver/tree_elimination.h"
#include "tests/solver/linearised.h"

namespace limber {
namespace {

const char* const kRigs[] = {"hand", "biped-full", "biped-hands"};

/// The shipped rig, or the same under retargeting's load: a weak orientation on every joint.
Rig bench_rig(std::int64_t which, bool loaded) {
  Rig rig = test::shipped_rig(kRigs[which]);
  return loaded ? test::with_posture(std::move(rig), 0.1) : rig;
}

test::Linearised bench_place(const benchmark::State& state) {
  test::Random random(1);
  return {bench_rig(state.range(0), state.range(1) != 0), random, 0.8, 0.8};
}

void forward_kinematics_and_errors(benchmark::State& state) {
  test::Linearised p = bench_place(state);
  for (auto _ : state) p.tree.evaluate(p.state, p.goals, p.kinematics);
  state.SetLabel(kRigs[state.range(0)]);
}
BENCHMARK(forward_kinematics_and_errors)->ArgsProduct({{0, 1, 2}, {0, 1}});

void linearise_and_load(benchmark::State& state) {
  test::Linearised p = bench_place(state);
  for (auto _ : state) {
    p.tree.linearise(p.state, p.kinematics);
    effector_load(p.tree, p.goals, p.kinematics, p.load);
  }
  state.SetLabel(kRigs[state.range(0)]);
}
BENCHMARK(linearise_and_load)->ArgsProduct({{0, 1, 2}, {0, 1}});

void eliminate(benchmark::State& state) {
  test::Linearised p = bench_place(state);
  TreeElimination elimination(p.tree);
  Eigen::VectorXd step(p.tree.coordinate_count());
  const Eigen::VectorXd wish = Eigen::VectorXd::Zero(step.size());
  elimination.linearise(p.state.x, p.kinematics, p.load);
  int passes = 0;
  for (auto _ : state) {
    elimination.reset(p.state.x);
    passes = elimination.solve(p.state.x, 1.0, wish, step).passes;
  }
  state.SetLabel(std::string(kRigs[state.range(0)]) + ", passes " + std::to_string(passes));
}
BENCHMARK(eliminate)->ArgsProduct({{0, 1, 2}, {0, 1}});

/// One frame of retargeting: targets in conflict, a good start, run until the cost stops falling.
void retarget_frame(benchmark::State& state) {
  const Rig rig = bench_rig(state.range(0), true);
  IkSolver solver = std::move(IkSolver::create(rig, {.stop_at_tolerance = false}).value());
  test::Random random(2);
  const Pose truth = test::allowed_pose(random, rig, 0.9);
  auto targets = test::targets_at(rig, truth);
  for (EffectorTarget& target : targets) {
    target.pose = target.pose * DualQuaternion::from_rotation_translation(
                                    random.small_rotation(0.1), random.vector(0.01));
  }
  Pose start = truth;
  solver.solve(targets, start);
  for (DualQuaternion& q : start) {
    q = q * DualQuaternion::from_rotation(random.small_rotation(0.02));
  }
  IkReport report;
  for (auto _ : state) {
    Pose pose = start;
    report = solver.solve(targets, pose);
  }
  state.SetLabel(std::string(kRigs[state.range(0)]) + ", " + std::to_string(rig.effectors.size()) +
                 " effectors, relinearisations " + std::to_string(report.relinearisations));
}
BENCHMARK(retarget_frame)->DenseRange(0, 2);

}  // namespace
}  // namespace limber
