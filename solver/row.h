#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "solver/ik_tree.h"

namespace limber {

/// One scalar row that may join any branches of the tree. With d the step of the coordinates and
/// lambda the row's multiplier it asks for
///   J d + value + compliance lambda = 0,  or, one-sided,  >= 0 with lambda >= 0 (one of them 0).
/// J d = wrench . twist of node_a - counter . twist of node_b + sum of coefficient * d[coordinate].
/// A soft row stands for the cost value^2 / compliance; a hard one has no compliance.
struct Row {
  struct Term {
    std::int32_t node = -1, coordinate = 0;  ///< node -1: no term
    double coefficient = 0.0;
  };
  std::int64_t id = 0;                    ///< the same row at another place has the same one
  std::int32_t node_a = -1, node_b = -1;  ///< -1: the world
  Eigen::Vector3d force = Eigen::Vector3d::Zero(), point = Eigen::Vector3d::Zero();  ///< world
  Eigen::Vector3d torque = Eigen::Vector3d::Zero();
  Eigen::Vector3d apart = Eigen::Vector3d::Zero();  ///< from where node_b is pushed to `point`
  /// (torque + (point - origin) x force, force), the counter's at point - apart; see anchor()
  Vector6 wrench = Vector6::Zero(), counter = Vector6::Zero();
  std::array<Term, 2> terms;
  double value = 0.0;      ///< m or rad
  double tolerance = 0.0;  ///< hard: a violation that counts as none
  double compliance = 0.0;
  bool one_sided = false;
  double lambda = 0.0;
  double place = 0.0;  ///< the outer loop's: value, while it tries others

  bool hard() const { return compliance == 0.0; }
  /// How far `v`, as a value, is from what the row allows.
  double violation(double v) const { return one_sided ? (v < 0.0 ? -v : 0.0) : std::abs(v); }
  /// By how much that is more than none.
  double excess(double v) const { return std::max(violation(v) - tolerance, 0.0); }
  /// Takes the wrenches about `origin`.
  void anchor(const Eigen::Vector3d& origin) {
    wrench << torque + (point - origin).cross(force), force;
    counter << torque + (point - apart - origin).cross(force), force;
  }
  /// J d for given twists of the nodes and step of the coordinates.
  double rate(std::span<const Vector6> node_twist, const Eigen::VectorXd& step) const {
    double sum = 0.0;
    if (node_a >= 0) sum += wrench.dot(node_twist[node_a]);
    if (node_b >= 0) sum -= counter.dot(node_twist[node_b]);
    for (const Term& term : terms) {
      if (term.node >= 0) sum += term.coefficient * step[term.coordinate];
    }
    return sum;
  }
};

/// J'lambda: what rows push with. It joins the pull of the effectors.
struct RowPush {
  std::vector<Vector6> wrench;  ///< [node] (torque, force) about kinematics.origin
  std::vector<double> force;    ///< [coordinate]

  explicit RowPush(const IkTree& tree)
      : wrench(tree.nodes.size(), Vector6::Zero()),
        force(static_cast<std::size_t>(tree.coordinate_count()), 0.0) {}
  void clear() {
    for (Vector6& w : wrench) w.setZero();
    for (double& f : force) f = 0.0;
  }
  void add(const Row& row, double lambda) {
    if (row.node_a >= 0) wrench[row.node_a] += lambda * row.wrench;
    if (row.node_b >= 0) wrench[row.node_b] -= lambda * row.counter;
    for (const Row::Term& term : row.terms) {
      if (term.node >= 0) force[term.coordinate] += lambda * term.coefficient;
    }
  }
};

}  // namespace limber
