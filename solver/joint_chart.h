#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>

#include "assets/model/rig.h"
#include "solver/swing_twist.h"

namespace limber {

/// Grassia's dynamic reparameterisation: the same rotation, with |w| <= pi.
/// (1 - 2 pi / |w|) w where |w| > pi (Kenwright 2013, section VII.A.2; its singularities, |w| = 2 n
/// pi, are then at least pi away).
Eigen::Vector3d shift_exponential_map(const Eigen::Vector3d& w);

/// dR = (J dw) R for R = exp(w): the left Jacobian of the exponential map. Any w below 2 pi.
Eigen::Matrix3d exponential_map_jacobian(const Eigen::Vector3d& w);

/// The coordinates of one joint as exponential maps, and the limits in them, by type:
///  - hinge, universal: one and two angles (rad), each an exponential map about a fixed axis
///  - ball with limits: swing0, swing1, twist (rad), R = exp(swing) exp(twist)
///  - ball without: a rotation vector (rad)
///  - free: translation (m, parent's axes, from the offset), then a rotation vector (rad)
class JointChart {
 public:
  static constexpr int kMost = 6;

  explicit JointChart(const RigJoint&);

  std::int32_t size() const { return dof_count(joint_.type); }

  /// Coordinates of a local transform that lies within the limits, and back.
  void coordinates(const DualQuaternion& parent_from_joint, std::span<double> w) const;
  DualQuaternion parent_from_joint(std::span<const double> w) const;

  /// Per coordinate, the twist of a unit rate, in the parent's space.
  void twists(std::span<const double> w, std::span<DualVector> twist) const;

  /// Per coordinate, its own range; infinite where there is none or the ellipse says it.
  Range range(int coordinate) const { return ranges_[coordinate]; }
  /// The first two coordinates are bounded by swing().
  bool has_ellipse() const { return ellipse_; }
  const SwingEllipse& swing() const { return swing_; }

  /// Shifts unlimited exponential maps away from their singularity, in place.
  void shift(std::span<double> w) const;

 private:
  RigJoint joint_;
  Eigen::Matrix3d parent_from_triad_;  ///< rotation; columns: rest * axes
  bool swing_twist_ = false;           ///< a ball with limits
  bool ellipse_ = false;
  SwingEllipse swing_{};
  std::array<Range, kMost> ranges_;
};

}  // namespace limber
