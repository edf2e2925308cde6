#pragma once

#include <cstdint>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/clip.h"
#include "exporters/exporter.h"
#include "exporters/gltf_buffer.h"

namespace limber {

/// How canonical local transforms become a file's node transforms (see GltfDocument).
struct NodeSpace {
  std::vector<std::int32_t> node_of_joint;
  std::vector<double> metres_per_unit;  ///< [joint] unit_m * parent_scale
  Eigen::Quaterniond canonical_from_file{1, 0, 0, 0};

  /// A root joint stands below nothing, so it alone takes the turn of the file's up axis.
  DualQuaternion file_from_canonical(const Skeleton&, std::int32_t joint,
                                     const DualQuaternion& parent_from_joint) const;
};

/// What the clip does to one joint, compared with the skeleton's rest pose.
struct JointMotion {
  bool rotates = false;     ///< turns, or stands turned away from its rest
  bool translates = false;  ///< moves, or stands moved away from its rest
};
std::vector<JointMotion> joint_motions(const Skeleton&, const Clip&);

/// Appends one animation: a shared time accessor, linear samplers, key f at start_s + f / rate_hz
/// seconds (glTF knows no time before 0).
void add_animation(Json& document, GltfBuffer&, const Skeleton&, const Clip&, const NodeSpace&,
                   const std::vector<JointMotion>&);

}  // namespace limber
