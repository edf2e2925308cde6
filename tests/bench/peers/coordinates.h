#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <random>
#include <span>
#include <vector>

#include "assets/model/result.h"
#include "assets/model/rig.h"
#include "solver/swing_twist.h"

namespace limber::peers {

/// A pose as the peers keep it, so that limits are ranges and ellipses:
/// hinge 1, universal 2: angles (rad); ball 3: swing0, swing1, twist (rad); free 6: translation (m)
/// and three that stay zero, since its rotation is `turn`.
struct State {
  Eigen::VectorXd q;
  Eigen::Quaterniond turn{1, 0, 0, 0};
};

/// The coordinates of a rig and their limits.
class Coordinates {
 public:
  /// Error `bench-peers`: a free joint below the root, an unlimited ball, couplings, effectors of
  /// other kinds than pose and position.
  static Result<Coordinates> of(const Rig&);

  const Rig& rig() const { return *rig_; }
  Eigen::Index dofs() const { return begin_.back(); }
  /// The joint's first coordinate.
  Eigen::Index begin(std::int32_t joint) const { return begin_[static_cast<std::size_t>(joint)]; }
  /// Bounds of coordinates that have a range of their own; infinite for swings and free joints.
  const Eigen::VectorXd& lower() const { return lower_; }
  const Eigen::VectorXd& upper() const { return upper_; }
  /// The joints whose two swings share an ellipse.
  struct Swing {
    Eigen::Index dof;
    SwingEllipse ellipse;
  };
  const std::vector<Swing>& swings() const { return swings_; }

  State from_pose(std::span<const DualQuaternion> parent_from_joint) const;
  void to_pose(const State&, std::span<DualQuaternion> parent_from_joint) const;
  /// A joint's own rotation R.
  Eigen::Quaterniond rotation(std::int32_t joint, const State&) const;
  /// Angular velocity per coordinate of a ball, in the joint's own space.
  Eigen::Matrix3d ball_columns(std::int32_t joint, const State&) const;

  /// q + step, a free joint's rotation turned by exp of its step in its own space; no limits.
  void add(const Eigen::VectorXd& step, State&) const;
  /// Every coordinate to the nearest allowed one.
  void clamp(State&) const;
  /// One joint's rotation: the nearest that its type can express and its limits allow.
  void set_rotation(std::int32_t joint, const Eigen::Quaterniond&, State&) const;
  /// after + (after - before), within limits.
  void extrapolate(const State& before, const State& after, State& next) const;
  /// That share of the way to the middle of the ranges; swings to the middle of their ellipse's
  /// box.
  void towards_middle(double share, State&) const;
  /// Anywhere within the limits; a free root stays where it is.
  void randomise(std::mt19937_64&, State&) const;

 private:
  const Rig* rig_ = nullptr;
  std::vector<Eigen::Index> begin_;  // [joint], and the total
  Eigen::VectorXd lower_, upper_;
  std::vector<Swing> swings_;
};

}  // namespace limber::peers
