#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "pipeline/effectors.h"
#include "pipeline/trunk_transfer.h"

namespace limber {

/// World rotation since the T-pose that each target joint is to have, one frame at a time. The
/// source and the target must outlive it.
class RotationTransfer {
 public:
  RotationTransfer(const SourceMotion&, const Target&, FingerMode);

  /// `since[joint]` of every target joint, from the source's joints in model space. A joint whose
  /// role the source lacks goes with the next one towards the hips; spine and neck of any joint
  /// counts share the same curve.
  void frame(std::span<const DualQuaternion> model_from_joint,
             std::span<Eigen::Quaterniond> since) const;

  /// The source joint whose local rotation an unmapped target joint copies, or kNoJoint.
  std::int32_t carried(std::int32_t target_joint) const { return carried_[target_joint]; }

 private:
  std::optional<Role> nearest_source_parent(Role) const;
  Eigen::Quaterniond absent_finger(Role) const;
  void turn_pelvis(std::span<const DualQuaternion> model,
                   std::span<Eigen::Quaterniond> since) const;
  void settle_hand(std::span<const DualQuaternion> model,
                   std::span<Eigen::Quaterniond> since) const;
  void find_carried();

  const SourceMotion& source_;
  const Target& target_;
  FingerMode fingers_;
  std::vector<std::optional<Role>> roles_;
  std::vector<std::int32_t> carried_;
  std::optional<TrunkTransfer> trunk_;  // between bodies
};

}  // namespace limber
