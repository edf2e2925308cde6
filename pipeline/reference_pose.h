#pragma once

#include <Eigen/Geometry>
#include <span>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/clip.h"
#include "assets/model/result.h"
#include "pipeline/calibration.h"
#include "pipeline/figure.h"

namespace limber {

/// A pose of the file that the calibrated T-pose is computed from.
struct ReferencePose {
  std::string name;                   ///< rest, bind, reference-frame, frame:N, motion
  std::vector<DualQuaternion> model;  ///< model from joint
  double cost_deg = 0.0;              ///< how far from standing upright with straight legs
};

/// The first of the file's poses that stands upright, as the choice allows; among poor ones the
/// least bad. Error: `calibration-failed`.
Result<ReferencePose> choose_reference(const Character&, const Figure&, const ReferenceChoice&,
                                       std::span<const DualQuaternion> reference_pose,
                                       const Clip* clip);

double degrees_between(const Eigen::Vector3d&, const Eigen::Vector3d&);

/// The reference pose seen along the figure's own hierarchy.
class ReferenceView {
 public:
  ReferenceView(const Figure& figure, const std::vector<DualQuaternion>& model)
      : figure_(figure), model_(model) {}

  bool has(Role role) const { return figure_.has(role); }
  Eigen::Vector3d p(Role role) const { return model_[figure_.at(role)].translation(); }
  Eigen::Vector3d bone(Role from, Role to) const { return p(to) - p(from); }

  /// The figure's left, horizontal: from hips and shoulders.
  Eigen::Vector3d left() const {
    Eigen::Vector3d v = bone(Role::rightUpperLeg, Role::leftUpperLeg).normalized();
    if (has(Role::leftUpperArm) && has(Role::rightUpperArm)) {
      v += bone(Role::rightUpperArm, Role::leftUpperArm).normalized();
    }
    v.y() = 0.0;
    return v.norm() < 1e-9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d(v.normalized());
  }
  /// From between the hip joints to between the shoulders; up where it has none.
  Eigen::Vector3d trunk() const {
    if (!has(Role::leftUpperArm) || !has(Role::rightUpperArm)) return Eigen::Vector3d::UnitY();
    return 0.5 * (p(Role::leftUpperArm) + p(Role::rightUpperArm) - p(Role::leftUpperLeg) -
                  p(Role::rightUpperLeg));
  }
  Eigen::Vector3d forward() const { return left().cross(Eigen::Vector3d::UnitY()); }

 private:
  const Figure& figure_;
  const std::vector<DualQuaternion>& model_;
};

}  // namespace limber
