#pragma once

#include <span>

#include "solver/jacobian.h"
#include "tests/solver/test_rigs.h"

namespace limber::test {

/// A rig's tree at a pose, linearised against targets.
struct Linearised {
  Rig rig;
  IkTree tree;
  IkState state;
  IkKinematics kinematics;
  std::vector<IkGoal> goals;
  EffectorLoad load;

  Linearised(Rig source, const Pose& at, std::span<const EffectorTarget> targets)
      : Linearised(std::move(source)) {
    linearise(at, targets);
  }
  /// A random place that fills its limits that far, and targets of another.
  Linearised(Rig source, Random& random, double fill, double target_fill = 1.0)
      : Linearised(std::move(source)) {
    const Pose at = allowed_pose(random, rig, fill);
    linearise(at, targets_at(rig, allowed_pose(random, rig, target_fill)));
  }

  /// J'WJ + damping D and J'We, dense.
  void normal_equations(double damping, Eigen::MatrixXd& a, Eigen::VectorXd& b) const {
    a.resize(tree.coordinate_count(), tree.coordinate_count());
    b.resize(tree.coordinate_count());
    EffectorLoad composite = load;
    compose_load(tree, composite);
    limber::normal_equations(tree, kinematics, composite, a, b);
    a.diagonal() += damping * tree.damping;
  }

 private:
  explicit Linearised(Rig source)
      : rig(std::move(source)),
        tree(rig),
        state(tree.make_state()),
        kinematics(tree.make_kinematics()),
        goals(rig.effectors.size()),
        load(tree.nodes.size()) {}
  void linearise(const Pose& at, std::span<const EffectorTarget> targets) {
    tree.load(at, state);
    tree.resolve(targets, goals);
    tree.evaluate(state, goals, kinematics);
    tree.linearise(state, kinematics);
    effector_load(tree, goals, kinematics, load);
  }
};

}  // namespace limber::test
