#pragma once

#include <Eigen/Core>

#include "solver/ik_tree.h"

namespace limber {

// What one effector's errors see of a motion of its node, taken at the effector's point: the point
// moves by u, the node turns by w. Every Jacobian is made of these (head of jacobian.cpp):
//   position: u, and of a line, which may slide along itself, (1 - n n') u;
//   rotation: w, about an axis a (1 - a a') w, and of a gaze (1 - a a') (w + ray x u).
// The transposes are rows: the component of an error along a direction c, as a wrench at the point.

inline Eigen::Vector3d seen_move(const IkEffector& effector, const IkGoal& goal,
                                 const Eigen::Vector3d& move) {
  if (effector.kind != EffectorKind::line) return move;
  return move - goal.axis.dot(move) * goal.axis;
}

inline Eigen::Vector3d seen_turn(const IkEffector& effector, const IkError& error,
                                 const Eigen::Vector3d& turn, const Eigen::Vector3d& move) {
  if (!has_axis(effector.kind)) return turn;
  Eigen::Vector3d seen = turn;
  if (effector.kind == EffectorKind::gaze) seen += error.ray.cross(move);
  return seen - error.axis.dot(seen) * error.axis;
}

/// One row: it sees torque . turn + force . move.
struct EffectorRow {
  Eigen::Vector3d torque = Eigen::Vector3d::Zero(), force = Eigen::Vector3d::Zero();
  /// About an origin from which the effector's point is at `arm`.
  Vector6 wrench(const Eigen::Vector3d& arm) const {
    Vector6 w;
    w << torque + arm.cross(force), force;
    return w;
  }
};

/// direction . seen_move.
inline EffectorRow move_row(const IkEffector& effector, const IkGoal& goal,
                            const Eigen::Vector3d& direction) {
  return {.force = seen_move(effector, goal, direction)};
}

/// direction . seen_turn.
inline EffectorRow turn_row(const IkEffector& effector, const IkError& error,
                            const Eigen::Vector3d& direction) {
  if (!has_axis(effector.kind)) return {.torque = direction};
  EffectorRow row{.torque = direction - error.axis.dot(direction) * error.axis};
  if (effector.kind == EffectorKind::gaze) row.force = row.torque.cross(error.ray);
  return row;
}

/// What turning is weighted with; a gaze whose target is at the eye has no rows.
inline double turning_weight(const IkEffector& effector, const IkGoal& goal, const IkError& error) {
  return effector.kind == EffectorKind::gaze && error.ray.isZero(0.0) ? 0.0 : goal.inertia;
}

}  // namespace limber
