#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>
#include <vector>

#include "solver/ik_descent.h"

namespace limber {

/// Keeps best reaches from jumping while a clip is followed; brake.cpp tells how.
class Brake {
 public:
  /// `descent` outlives this and stands in its rest pose; `at_now` is its place.
  explicit Brake(IkDescent& descent);

  /// A new place, with no frames before it. `searching`: what follows from here looks for another
  /// solution and may go as far as it likes.
  void forget(bool searching = false);
  /// The goals of a frame that has its answer.
  void remember(std::span<const IkGoal>);

  /// True: the frame needs no descent before slow_down().
  bool on() const;
  /// Whether the answer that the descent ended in comes too fast to be shown.
  bool too_fast(const IkState& before, const IkState& last);
  /// From the start of the frame, `now`, to an answer near it. `before`, `last`: the answers to the
  /// frames before.
  void slow_down(const IkState& before, const IkState& last, IkReport&);

  /// The targets' own largest second difference (m), with the goals of the frame at hand.
  double pace() const;

 private:
  double most_bend() const;
  bool wound() const;
  double bend();
  void find_places(const IkState&, std::vector<Eigen::Vector3d>&);
  static void take_places(const IkKinematics&, std::vector<Eigen::Vector3d>&);
  void aim(const IkState& before, const IkState& last);
  void slow_swing(const EllipseLimit&, const IkState& before, const IkState& last);
  void measure_way(const IkState& from);
  bool coast(IkReport&);
  double hardest_braking(const IkState& last) const;
  void try_mass(const IkState& last, IkReport&, double most);
  bool let_go(IkReport&, double most);

  IkDescent& descent_;
  Eigen::VectorXd inertia_;      ///< [coordinate] lever^2, of a mass of 1
  Eigen::VectorXd own_damping_;  ///< the tree's, while inertia_ is in its place
  IkState start_, coasted_;
  std::vector<Eigen::Quaterniond> aim_;  ///< [node] where a rotation without limits drifts
  std::vector<Eigen::Vector3d> place_, place_last_, place_before_;  ///< nodes, then effectors
  std::vector<Eigen::Vector3d> goal_last_, goal_before_;            ///< [effector]
  int goals_ = 0;   ///< frames that goal_last_ and goal_before_ know
  int missed_ = 0;  ///< frames in a row
  bool on_ = false, searching_ = false;
  double mass_ = 0.0;
  double lively_ = 0.0;  ///< m per frame^2, what targets did of late
};

}  // namespace limber
