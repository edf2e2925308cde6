#include "assets/model/skeleton.h"

#include <cmath>
#include <unordered_set>

namespace limber {

std::int32_t Skeleton::find(std::string_view name) const {
  for (std::int32_t i = 0; i < size(); ++i) {
    if (names[i] == name) return i;
  }
  return kNoJoint;
}

Result<void> validate(const Skeleton& skeleton) {
  const auto invalid = [&](std::int32_t joint, std::string message) {
    return Error{.code = "skeleton-invalid",
                 .message = std::move(message),
                 .joint = joint >= 0 && joint < static_cast<std::int32_t>(skeleton.names.size())
                              ? skeleton.names[joint]
                              : std::string(),
                 .hint = "the file's joint hierarchy cannot be used as it is"};
  };
  const std::size_t n = skeleton.parents.size();
  if (n == 0) return invalid(-1, "the skeleton has no joints");
  if (skeleton.names.size() != n || skeleton.rest_parent_from_joint.size() != n) {
    return invalid(-1, "the skeleton's arrays differ in length");
  }
  std::unordered_set<std::string_view> seen;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (skeleton.names[i].empty()) return invalid(i, "a joint has no name");
    if (!seen.insert(skeleton.names[i]).second) return invalid(i, "two joints share a name");
    const std::int32_t parent = skeleton.parents[i];
    if (parent < kNoJoint || parent >= i) return invalid(i, "a joint comes before its parent");
    const DualQuaternion& q = skeleton.rest_parent_from_joint[i];
    if (!q.real.coeffs().allFinite() || !q.dual.coeffs().allFinite()) {
      return invalid(i, "the rest pose is not finite");
    }
    if (std::abs(q.real.squaredNorm() - 1.0) > 1e-9 ||
        std::abs(q.real.coeffs().dot(q.dual.coeffs())) > 1e-9 * (1.0 + q.dual.norm())) {
      return invalid(i, "the rest pose is not a unit dual quaternion");
    }
  }
  return {};
}

std::vector<std::vector<std::int32_t>> children_of(const Skeleton& skeleton) {
  std::vector<std::vector<std::int32_t>> children(skeleton.parents.size());
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (skeleton.parents[i] != kNoJoint) children[skeleton.parents[i]].push_back(i);
  }
  return children;
}

void model_from_local(const Skeleton& skeleton, std::span<const DualQuaternion> parent_from_joint,
                      std::span<DualQuaternion> model_from_joint) {
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    const std::int32_t parent = skeleton.parents[i];
    model_from_joint[i] =
        parent == kNoJoint ? parent_from_joint[i] : model_from_joint[parent] * parent_from_joint[i];
  }
}

void local_from_model(const Skeleton& skeleton, std::span<const DualQuaternion> model_from_joint,
                      std::span<DualQuaternion> parent_from_joint) {
  for (std::int32_t i = skeleton.size() - 1; i >= 0; --i) {
    const std::int32_t parent = skeleton.parents[i];
    parent_from_joint[i] = parent == kNoJoint
                               ? model_from_joint[i]
                               : model_from_joint[parent].conjugate() * model_from_joint[i];
  }
}

}  // namespace limber
