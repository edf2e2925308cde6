// The effector Jacobian and the normal equations (Kenwright 2013, sections VI and VII; its figure 8
// is rebuilt here from rigid-body motion).
//
// Under the twist S = (a, v) about o, a point r moves by v + a x (r - o) and an orientation turns
// by a. Those are the six rows of one effector and one coordinate.
//
// Rotation error: e = log(goal current*). The gradient of 1/2 |e|^2 along a turn w is exactly -e.w
// (e is an eigenvector of the log's derivative), so the plain residual is the right pull for
// isotropic weights, and identity is used for its derivative. Of a direction or line, turning about
// the current axis changes nothing: those rows lose that component.
//
// A gaze turns by w and its eye moves by u; the direction n to the target at distance r then turns
// by -(n x u) / r. Both take from the error, which so sees the turn w + (n x u) / r, again without
// its component along the axis: rows B = (1 - a a') [1 - [n/r] [d], [n/r]] of a twist, an inertia
// j B'B and a pull j B'e. As e lies across a and n, that pull is the gradient at any error.
//
// A mass m (m^2: weights) at r with isotropic inertia j has, about o with d = r - o, the spatial
// inertia [ j 1 - [d] M [d], [d] M; -M [d], M ], M = m 1, and for a line M = m (1 - n n'). The sum
// over the effectors outside coordinate k is the composite inertia I_k, and
//   (J'WJ)_kl = S_l' I_k S_k  for l at or above k,   (J'We)_k = S_k' (composite pull).
//
// Newton. J'WJ leaves out the errors' second derivatives, which matter as much as it where errors
// stay large: out of reach, or many effectors in conflict. To second order a node moves by the
// twist
//   xi = xi_inner + S q + 1/2 [xi_inner, S q],   [(a, v), (b, w)] = (a x b, a x w + v x b),
// and a point by v + a x d + 1/2 a x (v + a x d). With the force F = m e that pulls at d, the
// point's term -F.(1/2 a x (v + a x d)) is the symmetric addition to its inertia
//   [ (d.F) 1 - 1/2 (d F' + F d'), 1/2 [F]; -1/2 [F], 0 ],
// the rotation's Hessian across e is theta/2 cot(theta/2) instead of 1, and the bracket couples the
// coordinate with its inner side by -1/2 q pull.[xi_inner, S] (see tree_elimination.cpp). What is
// still left out is the second derivative of the swing's own chart; it acts on the torque about the
// ball, which vanishes at an optimum inside the ball's limits.
#include "solver/jacobian.h"

#include <cmath>

#include "solver/effector_rows.h"

namespace limber {

void effector_jacobian(const IkTree& tree, std::span<const IkGoal> goals,
                       const IkKinematics& kinematics, Eigen::Ref<Eigen::MatrixXd> jacobian) {
  jacobian.setZero();
  for (std::size_t e = 0; e < tree.effectors.size(); ++e) {
    const IkEffector& effector = tree.effectors[e];
    const IkError& error = kinematics.error[e];
    const Eigen::Vector3d arm = error.point - kinematics.origin;
    for (std::int32_t n = effector.node; n >= 0; n = tree.nodes[n].parent) {
      for (std::int32_t i = 0; i < tree.nodes[n].coordinates; ++i) {
        const std::int32_t k = tree.nodes[n].coordinate + i;
        Eigen::Vector3d turn = kinematics.axis[k].head<3>();
        Eigen::Vector3d move = kinematics.axis[k].tail<3>() + turn.cross(arm);
        turn = seen_turn(effector, error, turn, move);
        move = seen_move(effector, goals[e], move);
        if (goals[e].mass > 0.0) jacobian.block<3, 1>(6 * e, k) = move;
        if (turning_weight(effector, goals[e], error) > 0.0) {
          jacobian.block<3, 1>(6 * e + 3, k) = turn;
        }
      }
    }
  }
}

namespace {

using Inertia = SpatialInertia<double>;

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// Adds the inertia of m (1 - n n') at d: a line is free to slide along itself.
void add_line_mass(const IkGoal& goal, const Eigen::Vector3d& d, Inertia& inertia) {
  const Eigen::Matrix3d arm = cross_matrix(d);
  const Eigen::Matrix3d mass =
      goal.mass * (Eigen::Matrix3d::Identity() - goal.axis * goal.axis.transpose());
  inertia.add_blocks(-arm * mass * arm, arm * mass, mass);
}

/// Rows B of the file's head, at d: inertia j B'B and pull j B'e.
void add_gaze(const IkEffector& effector, const IkError& error, double weight,
              const Eigen::Vector3d& d, Inertia& inertia, Vector6& pull) {
  for (int i = 0; i < 3; ++i) {
    const Vector6 row = turn_row(effector, error, Eigen::Vector3d::Unit(i)).wrench(d);
    inertia.add_outer(row, weight);
    pull += weight * error.rotation[i] * row;
  }
}

void add_point_curvature(const Eigen::Vector3d& d, const Eigen::Vector3d& force, Inertia& inertia) {
  const Eigen::Matrix3d outer = 0.5 * d * force.transpose();
  inertia.add_blocks(d.dot(force) * Eigen::Matrix3d::Identity() - outer - outer.transpose(),
                     0.5 * cross_matrix(force), Eigen::Matrix3d::Zero());
}

void add_rotation_curvature(const Eigen::Vector3d& error, double weight, Inertia& inertia) {
  const double angle2 = error.squaredNorm();
  if (angle2 < 1e-12) return;
  const double half = 0.5 * std::sqrt(angle2);
  const double across = half / std::tan(half) - 1.0;  // <= 0
  inertia.add_angular(weight * across);
  inertia.add_angular_outer(-weight * across / angle2, error);
}

}  // namespace

Vector6 turn_of_pull(const Vector6& axis, const Vector6& pull) {
  const Eigen::Vector3d turn = axis.head<3>(), slide = axis.tail<3>();
  const Eigen::Vector3d torque = pull.head<3>(), force = pull.tail<3>();
  Vector6 k;
  k.head<3>() = turn.cross(torque) + slide.cross(force);
  k.tail<3>() = turn.cross(force);
  return k;
}

void effector_load(const IkTree& tree, std::span<const IkGoal> goals,
                   const IkKinematics& kinematics, EffectorLoad& load, bool curved) {
  load.curved = curved;
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
    load.inertia[n].set_zero();
    load.pull[n].setZero();
  }
  for (std::size_t e = 0; e < tree.effectors.size(); ++e) {
    const IkEffector& effector = tree.effectors[e];
    if (effector.node < 0) continue;
    const IkGoal& goal = goals[e];
    const IkError& error = kinematics.error[e];
    Inertia& inertia = load.inertia[effector.node];
    Vector6& pull = load.pull[effector.node];
    if (goal.mass > 0.0) {
      const Eigen::Vector3d d = error.point - kinematics.origin;
      const Eigen::Vector3d force = goal.mass * error.position;
      pull.head<3>() += d.cross(force);
      pull.tail<3>() += force;
      if (effector.kind == EffectorKind::line) {
        add_line_mass(goal, d, inertia);
      } else {
        inertia.add_point(goal.mass, d);
      }
      if (curved) add_point_curvature(d, force, inertia);
    }
    const double turning = turning_weight(effector, goal, error);
    if (turning > 0.0 && effector.kind == EffectorKind::gaze) {
      add_gaze(effector, error, turning, error.point - kinematics.origin, inertia, pull);
    } else if (turning > 0.0) {
      pull.head<3>() += goal.inertia * error.rotation;
      inertia.add_angular(goal.inertia);
      if (has_axis(effector.kind)) {
        inertia.add_angular_outer(-goal.inertia, error.axis);
      } else if (curved) {
        add_rotation_curvature(error.rotation, goal.inertia, inertia);
      }
    }
  }
  if (!curved) return;
  load.outer_pull = load.pull;
  for (std::size_t n = tree.nodes.size(); n-- > 0;) {
    const std::int32_t parent = tree.nodes[n].parent;
    if (parent >= 0) load.outer_pull[parent] += load.outer_pull[n];
  }
}

double predicted_cost(const IkTree& tree, std::span<const IkGoal> goals,
                      const IkKinematics& kinematics, std::span<const Vector6> node_twist) {
  double cost = 0.0;
  for (std::size_t e = 0; e < tree.effectors.size(); ++e) {
    const IkEffector& effector = tree.effectors[e];
    const IkError& error = kinematics.error[e];
    const IkGoal& goal = goals[e];
    Eigen::Vector3d move = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();
    if (effector.node >= 0) {
      turn = node_twist[effector.node].head<3>();
      move = node_twist[effector.node].tail<3>() + turn.cross(error.point - kinematics.origin);
    }
    turn = seen_turn(effector, error, turn, move);
    move = seen_move(effector, goal, move);
    cost += goal.mass * (error.position - move).squaredNorm();
    cost += turning_weight(effector, goal, error) * (error.rotation - turn).squaredNorm();
  }
  return cost;
}

void compose_load(const IkTree& tree, EffectorLoad& load) {
  for (std::size_t n = tree.nodes.size(); n-- > 0;) {
    const std::int32_t parent = tree.nodes[n].parent;
    if (parent < 0) continue;
    load.inertia[parent] += load.inertia[n];
    load.pull[parent] += load.pull[n];
  }
}

void normal_equations(const IkTree& tree, const IkKinematics& kinematics,
                      const EffectorLoad& composite, Eigen::Ref<Eigen::MatrixXd> a,
                      Eigen::Ref<Eigen::VectorXd> b) {
  a.setZero();
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
    const IkNode& node = tree.nodes[n];
    for (std::int32_t i = 0; i < node.coordinates; ++i) {
      const std::int32_t k = node.coordinate + i;
      const Vector6 momentum = composite.inertia[n] * kinematics.axis[k];
      b[k] = kinematics.axis[k].dot(composite.pull[n]);
      for (auto m = static_cast<std::int32_t>(n); m >= 0; m = tree.nodes[m].parent) {
        const std::int32_t first = tree.nodes[m].coordinate;
        const std::int32_t last =
            m == static_cast<std::int32_t>(n) ? k : first + tree.nodes[m].coordinates - 1;
        for (std::int32_t l = first; l <= last; ++l) {
          a(l, k) = a(k, l) = kinematics.axis[l].dot(momentum);
        }
      }
    }
  }
}

}  // namespace limber
