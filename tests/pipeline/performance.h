// A clip whose figure and T-pose are known, and clips that are posed joint by joint.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <functional>
#include <vector>

#include "importers/importer.h"
#include "pipeline/calibration.h"
#include "pipeline/figure.h"

namespace limber_test {

/// A clip whose figure and T-pose are known.
struct Performance {
  limber::Character character;
  limber::Figure figure;
  limber::Calibration calibration;
  limber::Clip clip;
};

inline Performance read_performance(const std::filesystem::path& path) {
  auto imported = limber::import_file(path, {});
  EXPECT_TRUE(imported);
  auto figure = limber::identify_figure(imported->character);
  EXPECT_TRUE(figure);
  auto calibration = limber::calibrate(imported->character, *figure, {}, imported->reference_pose,
                                       &imported->clips.front());
  EXPECT_TRUE(calibration);
  return {std::move(imported->character), std::move(*figure), std::move(*calibration),
          std::move(imported->clips.front())};
}

/// A clip at 30 Hz on a figure's skeleton: `turn` is what a joint adds in a frame to its parent's
/// turn since the T-pose, `place` where the whole figure is moved.
inline limber::Clip posed_clip(
    const Performance& t_pose, int frames,
    const std::function<Eigen::Quaterniond(limber::Role, int frame)>& turn,
    const std::function<limber::DualQuaternion(int frame)>& place = [](int) {
      return limber::DualQuaternion::identity();
    }) {
  const auto& skeleton = t_pose.character.skeleton;
  const auto roles = limber::roles_by_joint(t_pose.figure, skeleton.size());
  const auto& rest = t_pose.calibration.model_from_joint;
  limber::Clip clip;
  clip.rate_hz = 30.0;
  clip.joints = skeleton.size();
  std::vector<limber::DualQuaternion> model(rest.size());
  std::vector<Eigen::Quaterniond> since(rest.size());
  limber::Pose local(rest.size());
  for (int f = 0; f < frames; ++f) {
    for (const std::int32_t j : t_pose.figure.order) {
      const std::int32_t parent = t_pose.figure.parents[j];
      const bool root = parent == limber::kNoJoint;
      since[j] = root ? Eigen::Quaterniond::Identity() : since[parent];
      Eigen::Vector3d at = rest[j].translation();
      if (!root)
        at = model[parent].translation() + since[parent] * (at - rest[parent].translation());
      if (roles[j]) since[j] = since[j] * turn(*roles[j], f);
      model[j] =
          limber::DualQuaternion::from_rotation_translation(since[j] * rest[j].rotation(), at);
    }
    for (limber::DualQuaternion& joint : model) joint = place(f) * joint;
    limber::local_from_model(skeleton, model, local);
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), local.begin(), local.end());
  }
  return clip;
}

}  // namespace limber_test
