// Figures of Leclercq, Lefevre & Blohm 2013 beside ours: the two-link arm on the paper's reach with
// its controller and with Limber's solver, the three-link arm with a tool, ranks and the feedback
// bound. Times are medians per step over interleaved rounds on one core.
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <functional>
#include <memory>

#include "solver/resolved_rate.h"
#include "tests/solver/arm_reach.h"

namespace limber {
namespace {

using Eigen::Vector3d;
using test::ArmReach;
using Clock = std::chrono::steady_clock;

/// From one pose to the next along a reach, by whatever method.
using Stepper = std::function<void(int step, Pose&)>;

struct Runner {
  std::string name;
  Stepper advance;
  double worst_mm = 0.0, worst_deg = 0.0;
  std::vector<double> us = {};
};

void run(Runner& runner, const Rig& rig, const ArmReach& reach) {
  const bool tool = rig.effectors.size() > 1;
  Pose pose = test::reach_start(rig, reach);
  for (int i = 0; i < ArmReach::kSteps; ++i) {
    const auto begin = Clock::now();
    runner.advance(i, pose);
    runner.us.push_back(std::chrono::duration<double, std::micro>(Clock::now() - begin).count());
    const DualQuaternion goal = reach.at(i + 1).a_from_b;
    const Vector3d miss = goal.translation() - test::effector_point(rig, pose);
    runner.worst_mm = std::max(runner.worst_mm, 1e3 * miss.norm());
    if (!tool) continue;
    const RigEffector& e = rig.effectors[0];
    const Vector3d shaft = test::world_of(rig, pose)[e.joint].transform_direction(e.axis);
    const double sine = shaft.cross(goal.transform_direction(e.axis)).norm();
    runner.worst_deg = std::max(runner.worst_deg, std::asin(std::min(1.0, sine)) * 180.0 / M_PI);
  }
}

Runner controller(const Rig& rig, const ArmReach& reach, std::string name, double k1, double k0) {
  auto control = std::make_shared<ResolvedRate>(
      ResolvedRate::create(rig, {.step_s = ArmReach::kStep, .feedback = k1, .damping = k0})
          .value());
  std::vector<MovingTransform> targets(rig.effectors.size());
  return {std::move(name), [=](int i, Pose& pose) mutable {
            std::fill(targets.begin(), targets.end(), reach.at(i));
            control->step(targets, pose);
          }};
}

Runner solver(const Rig& rig, const ArmReach& reach, std::string name, IkMethod method) {
  auto ik = std::make_shared<IkSolver>(
      IkSolver::create(rig,
                       {.method = method, .stop_position_m = 1e-6, .stop_orientation_rad = 1e-5})
          .value());
  std::vector<EffectorTarget> targets(rig.effectors.size());
  return {std::move(name), [=](int i, Pose& pose) mutable {
            for (EffectorTarget& target : targets) target.pose = reach.at(i + 1).a_from_b;
            ik->solve(targets, pose);
          }};
}

void compare(const Rig& rig, const ArmReach& reach, std::vector<Runner> runners) {
  constexpr int kRounds = 5;
  for (int round = 0; round < kRounds; ++round) {
    for (Runner& runner : runners) run(runner, rig, reach);
  }
  for (Runner& runner : runners) {
    auto middle = runner.us.begin() + static_cast<std::ptrdiff_t>(runner.us.size() / 2);
    std::nth_element(runner.us.begin(), middle, runner.us.end());
    const std::string turn =
        rig.effectors.size() > 1 ? fmt::format("{:>9.5f} deg", runner.worst_deg) : "";
    fmt::print("  {:<50} {:>9.4f} mm {:>13} {:>7.2f} us\n", runner.name, runner.worst_mm, turn,
               *middle);
  }
}

void two_link_arm() {
  const Rig rig = test::shipped_rig("arm2");
  const ArmReach reach;
  fmt::print(
      "Two links, 4 DOF, straight reach of {:.2f} cm in 0.8 s, peak {:.0f} cm/s, 1 ms steps\n",
      100.0 * ArmReach::distance(0.8), 100.0 * ArmReach::speed(0.4));
  fmt::print("  {:<50} {:>9} mm\n", "the paper's controller, its figure 4D", "< 0.2");
  compare(rig, reach,
          {controller(rig, reach, "it here, k1 = 1000 /s, k0 = 1 cm^2 (its text)", 1000.0, 1e-4),
           controller(rig, reach, "it here, k1 = 1 /s, k0 = 1000 cm^2 (its caption)", 1.0, 0.1),
           controller(rig, reach, "it here, k1 = 1000 /s, undamped", 1000.0, 0.0),
           controller(rig, reach, "it here, no feedback, undamped", 0.0, 0.0),
           solver(rig, reach, "Limber pgs, stop at 0.001 mm", IkMethod::pgs),
           solver(rig, reach, "Limber pgs-paper, stop at 0.001 mm", IkMethod::pgs_paper)});
}

void three_link_arm() {
  const Rig rig = test::tool_rig({EffectorKind::position, EffectorKind::line});
  const ArmReach reach = test::tool_reach(rig);
  fmt::print(
      "\nThree links, 7 DOF, the same reach with the tool's point and line, turning 25 degrees\n");
  compare(rig, reach,
          {controller(rig, reach, "the paper's controller, k1 = 1000 /s", 1000.0, 0.0),
           solver(rig, reach, "Limber pgs, stop at 0.001 mm", IkMethod::pgs)});
}

void ranks() {
  const auto rank = [](const Rig& rig) {
    Pose pose = test::bent_arm(rig);
    const std::vector<MovingTransform> targets(rig.effectors.size());
    return ResolvedRate::create(rig, {}).value().step(targets, pose).rank;
  };
  const int line = rank(test::tool_rig({EffectorKind::line}));
  fmt::print("\nRank                                              paper   here\n");
  fmt::print("  two links, point (its rows: 2 more, elbow)          5   {} + 2\n",
             rank(test::shipped_rig("arm2")));
  fmt::print("  three links, line (its nine rows)                   8   {} + 2\n", line);
  fmt::print("  three links, point and line                         -   {}\n",
             rank(test::tool_rig({EffectorKind::position, EffectorKind::line})));
}

void feedback_bound() {
  const Rig rig = test::shipped_rig("arm2");
  const ArmReach reach;
  const double bound = ResolvedRate::feedback_bound(ArmReach::kStep);
  fmt::print("\nFeedback at 1 ms, bound {:.0f} /s: error after 40 steps from 0.1 mm\n", bound);
  for (const double part : {0.05, 0.9, 0.99, 1.0, 1.01, 1.1}) {
    MovingTransform target{reach.at(0).a_from_b, {}};
    target.a_from_b = DualQuaternion::from_translation({6e-5, 0, -8e-5}) * target.a_from_b;
    ResolvedRate control = std::move(
        ResolvedRate::create(rig, {.step_s = ArmReach::kStep, .feedback = part * bound}).value());
    Pose pose = test::reach_start(rig, reach);
    for (int i = 0; i < 40; ++i) control.step(std::vector<MovingTransform>{target}, pose);
    const Vector3d miss = target.a_from_b.translation() - test::effector_point(rig, pose);
    fmt::print("  k1 = {:>6.0f} /s  {:>12.3g} mm   ((1 - k1 dt)^40 gives {:.3g})\n", part * bound,
               1e3 * miss.norm(), 0.1 * std::pow(std::abs(1.0 - 2.0 * part), 40));
  }
}

}  // namespace
}  // namespace limber

int main() {
  limber::two_link_arm();
  limber::three_link_arm();
  limber::ranks();
  limber::feedback_bound();
}
