// When frame 0 is a separate reference pose, and when it is the start of a motion.
#include "importers/reference_frame.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

constexpr double kDeg = M_PI / 180.0;

/// Ten joints in a row; joint j is turned by angle(j, frame) about X.
template <class Angle>
Imported row_of_joints(std::int64_t frames, const Angle& angle) {
  Imported imported;
  Clip clip;
  clip.joints = 10;
  clip.rate_hz = 120.0;
  for (std::int32_t j = 0; j < clip.joints; ++j) {
    imported.character.skeleton.names.push_back("joint" + std::to_string(j));
    imported.character.skeleton.parents.push_back(j - 1);
    imported.character.skeleton.rest_parent_from_joint.push_back(
        DualQuaternion::from_translation({0.0, 0.1, 0.0}));
  }
  for (std::int64_t f = 0; f < frames; ++f) {
    for (std::int32_t j = 0; j < clip.joints; ++j) {
      clip.parent_from_joint.push_back(
          imported.character.skeleton.rest_parent_from_joint[j] *
          DualQuaternion::from_rotation(
              Eigen::Quaterniond(Eigen::AngleAxisd(angle(j, f), Eigen::Vector3d::UnitX()))));
    }
  }
  imported.character.deforming.assign(10, 1);
  imported.clips.push_back(clip);
  return imported;
}

bool detected(const Imported& imported) {
  return starts_with_reference_frame(imported.character, imported.clips.front());
}

TEST(ReferenceFrame, IsTheRestPoseThatTheMotionJumpsFrom) {
  const auto jump = [](std::int32_t, std::int64_t f) {
    return f == 0 ? 0.0 : (30.0 + 0.5 * f) * kDeg;
  };
  EXPECT_TRUE(detected(row_of_joints(20, jump)));
  const auto smooth = [](std::int32_t, std::int64_t f) { return 3.0 * f * kDeg; };
  EXPECT_FALSE(detected(row_of_joints(20, smooth)));
  const auto elsewhere = [](std::int32_t, std::int64_t f) { return (f == 0 ? 60.0 : 20.0) * kDeg; };
  EXPECT_FALSE(detected(row_of_joints(20, elsewhere)));
  EXPECT_FALSE(detected(row_of_joints(2, jump)));
}

/// As DAZ conversions have it: the root jumps, the arms take five frames, fingers never move, and
/// the trunk of the T-pose is corrected by a degree or two.
TEST(ReferenceFrame, MayBeLeftSlowlyByAllButOneJoint) {
  const auto eased = [](std::int32_t j, std::int64_t f) {
    if (j >= 6) return 0.0;
    if (j == 0) return (f == 0 ? 0.0 : 50.0 + 0.1 * f) * kDeg;
    return (j == 1 ? 1.5 : 0.0) * kDeg + std::min<double>(f, 5.0) * 20.0 * kDeg;
  };
  EXPECT_TRUE(detected(row_of_joints(20, eased)));
  const auto nobody_jumps = [&](std::int32_t j, std::int64_t f) {
    return eased(j == 0 ? 1 : j, f);
  };
  EXPECT_FALSE(detected(row_of_joints(20, nobody_jumps)));
}

TEST(ReferenceFrame, TipsOfChainsDoNotCount) {
  const auto four_of_ten_leave = [](std::int32_t j, std::int64_t f) {
    return (j < 4 && f > 0 ? 40.0 + 0.1 * f : 0.0) * kDeg;
  };
  Imported imported = row_of_joints(20, four_of_ten_leave);
  EXPECT_TRUE(detected(imported));
  std::fill_n(imported.character.deforming.begin(), 4, 0);  // those that stay are what counts
  EXPECT_FALSE(detected(imported));
}

TEST(ReferenceFrame, IsDroppedAndLaterFramesKeepTheirTimes) {
  Imported imported = row_of_joints(20, [](std::int32_t j, std::int64_t f) {
    return f == 0 ? 0.0 : (20.0 + double(j + f)) * kDeg;
  });
  const Clip before = imported.clips.front();
  drop_any_reference_frame(imported);
  const Clip& after = imported.clips.front();
  EXPECT_EQ(after.frames(), before.frames() - 1);
  EXPECT_DOUBLE_EQ(after.start_s, 1.0 / before.rate_hz);
  ASSERT_EQ(imported.reference_pose.size(), 10U);
  EXPECT_TRUE(after.frame(0)[3].real.isApprox(before.frame(1)[3].real));
  EXPECT_TRUE(imported.facts.reference_frame_dropped);
  EXPECT_EQ(imported.warnings.back().code, "clip-reference-frame");
}

}  // namespace
}  // namespace limber
