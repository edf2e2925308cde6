#include "pipeline/measure.h"

#include <algorithm>

namespace limber {
MotionSide motion_side(const MeasuredMotion& measured) {
  const SourceMotion& motion = measured.motion;
  MotionSide side;
  side.skeleton = &motion.character->skeleton;
  side.clip = motion.clip;
  for (const auto& role : roles_by_joint(*motion.figure, motion.character->skeleton.size())) {
    side.roles.emplace_back(role ? name_of(*role) : "");
  }
  side.stature_m = std::max(0.1, motion.calibration->height);
  side.floor_y = measured.floor_y;
  if (motion.figure->is_body()) {
    side.soles = sole_points(*side.skeleton, side.roles, motion.calibration->model_from_joint,
                             motion.calibration->sole, side.stature_m);
  }
  return side;
}

MotionMetrics measure_against(const MeasuredMotion& source, const MeasuredMotion& output,
                              double scale) {
  MotionOptions options;
  options.scale = scale;
  return measure_motion(motion_side(source), motion_side(output), options);
}

std::optional<Clip> clip_on_rig(const Skeleton& skeleton, const Clip& clip, const Rig& rig) {
  std::vector<std::int32_t> joint_of_row;
  for (const RigJoint& row : rig.joints) {
    joint_of_row.push_back(skeleton.find(row.name));
    if (joint_of_row.back() == kNoJoint) return std::nullopt;
  }
  Clip out = clip;
  out.joints = rig.size();
  out.parent_from_joint.resize(std::size_t(clip.frames()) * rig.joints.size());
  std::vector<DualQuaternion> model(skeleton.parents.size());
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    model_from_local(skeleton, clip.frame(f), model);
    for (std::size_t i = 0; i < rig.joints.size(); ++i) {
      const std::int32_t parent = rig.joints[i].parent;
      const DualQuaternion& m = model[joint_of_row[i]];
      out.frame(f)[i] = parent == kNoJoint ? m : model[joint_of_row[parent]].conjugate() * m;
    }
  }
  return out;
}

}  // namespace limber
