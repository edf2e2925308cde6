#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "solver/ik_tree.h"

namespace limber {

/// Six rows per effector, position (m) then rotation (rad), one column per coordinate: how the
/// effector moves with the coordinates. Rows that the effector's kind does not pull are zero.
/// `jacobian` has 6 * effectors rows. Kinematics must have been linearised.
void effector_jacobian(const IkTree&, std::span<const IkGoal>, const IkKinematics&,
                       Eigen::Ref<Eigen::MatrixXd> jacobian);

/// Per node, about kinematics.origin: the inertia and the pull (wrench: torque, force) of the
/// effectors on it.
struct EffectorLoad {
  std::vector<Matrix6> inertia;
  std::vector<Vector6> pull;
};
void effector_load(const IkTree&, std::span<const IkGoal>, const IkKinematics&, EffectorLoad&);

/// Cost that is left if effectors moved by their nodes' twists, errors being linear.
double predicted_cost(const IkTree&, std::span<const IkGoal>, const IkKinematics&,
                      std::span<const Vector6> node_twist);

/// Composite loads (a node with everything outside it), from the tips to the roots.
void compose_load(const IkTree&, EffectorLoad&);

/// A = J'WJ and b = J'We from composite loads.
void normal_equations(const IkTree&, const IkKinematics&, const EffectorLoad& composite,
                      Eigen::Ref<Eigen::MatrixXd> a, Eigen::Ref<Eigen::VectorXd> b);

}  // namespace limber
