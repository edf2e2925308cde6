#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/dual_quaternion.h"
#include "assets/model/result.h"

namespace limber {

inline constexpr std::int32_t kNoJoint = -1;

/// The joints of a character, parents first. Joint i is row i of every array.
/// Canonical space: right-handed, Y up, metres. Scale has been folded out (see Character).
struct Skeleton {
  std::vector<std::string> names;                      ///< unique, non-empty, UTF-8
  std::vector<std::int32_t> parents;                   ///< parents[i] < i; kNoJoint marks a root
  std::vector<DualQuaternion> rest_parent_from_joint;  ///< rest pose (authored default), unit

  std::int32_t size() const { return static_cast<std::int32_t>(parents.size()); }
  std::int32_t find(std::string_view name) const;  ///< kNoJoint where there is none
};

/// Checks every invariant stated above, finite values included. Error: `skeleton-invalid`.
Result<void> validate(const Skeleton&);

/// children[i] lists the joints whose parent is i, in order.
std::vector<std::vector<std::int32_t>> children_of(const Skeleton&);

/// Forward kinematics: model_from_joint[i] = model_from_joint[parent] * parent_from_joint[i].
/// Spans have skeleton.size() entries and may alias.
void model_from_local(const Skeleton&, std::span<const DualQuaternion> parent_from_joint,
                      std::span<DualQuaternion> model_from_joint);

/// The inverse of model_from_local.
void local_from_model(const Skeleton&, std::span<const DualQuaternion> model_from_joint,
                      std::span<DualQuaternion> parent_from_joint);

}  // namespace limber
