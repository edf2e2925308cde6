#include "exporters/gltf_animation.h"

#include <algorithm>

namespace limber {
namespace {

// Below these a joint counts as resting: far under float32's own resolution.
constexpr double kStillRotation = 1e-9;
constexpr double kStillMetres = 1e-8;

std::vector<float> rotations(const Skeleton& skeleton, const Clip& clip, const NodeSpace& space,
                             std::int32_t joint) {
  std::vector<float> out;
  out.reserve(4 * clip.frames());
  Eigen::Quaterniond before(1, 0, 0, 0);
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    Eigen::Quaterniond q =
        space.file_from_canonical(skeleton, joint, clip.frame(f)[joint]).rotation().normalized();
    if (before.coeffs().dot(q.coeffs()) < 0.0) q.coeffs() = -q.coeffs();
    before = q;
    for (const double c : {q.x(), q.y(), q.z(), q.w()}) out.push_back(static_cast<float>(c));
  }
  return out;
}

std::vector<float> translations(const Skeleton& skeleton, const Clip& clip, const NodeSpace& space,
                                std::int32_t joint) {
  std::vector<float> out;
  out.reserve(3 * clip.frames());
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    const Eigen::Vector3d t =
        space.file_from_canonical(skeleton, joint, clip.frame(f)[joint]).translation();
    for (int k = 0; k < 3; ++k) out.push_back(static_cast<float>(t[k]));
  }
  return out;
}

}  // namespace

DualQuaternion NodeSpace::file_from_canonical(const Skeleton& skeleton, std::int32_t joint,
                                              const DualQuaternion& parent_from_joint) const {
  DualQuaternion local = parent_from_joint;
  if (skeleton.parents[joint] == kNoJoint) {
    local = DualQuaternion::from_rotation(canonical_from_file.conjugate()) * local;
  }
  return DualQuaternion::from_rotation_translation(local.rotation(),
                                                   local.translation() / metres_per_unit[joint]);
}

std::vector<JointMotion> joint_motions(const Skeleton& skeleton, const Clip& clip) {
  std::vector<JointMotion> motions(skeleton.parents.size());
  for (std::int32_t j = 0; j < skeleton.size(); ++j) {
    const DualQuaternion& rest = skeleton.rest_parent_from_joint[j];
    for (std::int64_t f = 0; f < clip.frames(); ++f) {
      const DualQuaternion& q = clip.frame(f)[j];
      motions[j].rotates |= rotation_angle(rest.rotation(), q.rotation()) > kStillRotation;
      motions[j].translates |= (q.translation() - rest.translation()).norm() > kStillMetres;
    }
  }
  return motions;
}

void add_animation(Json& document, GltfBuffer& buffer, const Skeleton& skeleton, const Clip& clip,
                   const NodeSpace& space, const std::vector<JointMotion>& motions) {
  std::vector<float> times;
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    times.push_back(static_cast<float>(std::max(0.0, clip.start_s) + double(f) / clip.rate_hz));
  }
  const std::size_t input = buffer.add_floats(times, "SCALAR", true);
  Json samplers = Json::array(), channels = Json::array();
  const auto add_channel = [&](std::int32_t joint, const char* path, std::size_t output) {
    channels.push_back({{"sampler", samplers.size()},
                        {"target", {{"node", space.node_of_joint[joint]}, {"path", path}}}});
    samplers.push_back({{"input", input}, {"interpolation", "LINEAR"}, {"output", output}});
  };
  for (std::int32_t j = 0; j < skeleton.size(); ++j) {
    if (motions[j].rotates) {
      add_channel(j, "rotation",
                  buffer.add_floats(rotations(skeleton, clip, space, j), "VEC4", false));
    }
    if (motions[j].translates) {
      add_channel(j, "translation",
                  buffer.add_floats(translations(skeleton, clip, space, j), "VEC3", false));
    }
  }
  Json animation;
  animation["name"] = clip.name.empty() ? "clip" : clip.name;
  animation["channels"] = std::move(channels);
  animation["samplers"] = std::move(samplers);
  document["animations"].push_back(std::move(animation));
}

}  // namespace limber
