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
/// effectors on it. `outer_pull` also holds what pulls on the nodes outside of it.
struct EffectorLoad {
  std::vector<SpatialInertia<double>> inertia;
  std::vector<Vector6> pull, outer_pull;
  bool curved = false;  ///< the inertia holds the second derivatives of the errors
  explicit EffectorLoad(std::size_t nodes = 0)
      : inertia(nodes, SpatialInertia<double>{}),
        pull(nodes, Vector6::Zero()),
        outer_pull(nodes, Vector6::Zero()) {}
};
/// `curved`: Newton instead of Gauss-Newton, see the file's head.
void effector_load(const IkTree&, std::span<const IkGoal>, const IkKinematics&, EffectorLoad&,
                   bool curved = false);

/// The covector k with pull . [v, axis] = k . v for every twist v.
Vector6 turn_of_pull(const Vector6& axis, const Vector6& pull);

/// Cost that is left if effectors moved by their nodes' twists, errors being linear.
double predicted_cost(const IkTree&, std::span<const IkGoal>, const IkKinematics&,
                      std::span<const Vector6> node_twist);

/// Composite loads (a node with everything outside it), from the tips to the roots.
void compose_load(const IkTree&, EffectorLoad&);

/// A = J'WJ and b = J'We from composite loads.
void normal_equations(const IkTree&, const IkKinematics&, const EffectorLoad& composite,
                      Eigen::Ref<Eigen::MatrixXd> a, Eigen::Ref<Eigen::VectorXd> b);

}  // namespace limber
