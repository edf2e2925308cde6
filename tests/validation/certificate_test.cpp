#include "validation/certificate.h"

#include <gtest/gtest.h>

#include "tests/validation/walker.h"

namespace limber {
namespace {

using Eigen::Vector3d;

struct Walk {
  Skeleton skeleton = test::walker_skeleton().skeleton;
  Clip clip = test::walk_clip(skeleton, 60, 30.0);
};

CertificateReport compare(const Walk& a, const Walk& b, const CertificateOptions& options = {}) {
  const auto report = compare_clips(a.skeleton, a.clip, b.skeleton, b.clip, options);
  EXPECT_TRUE(report.ok());
  return report.ok() ? *report : CertificateReport{};
}

TEST(Certificate, AClipEqualsItself) {
  const Walk walk;
  const CertificateReport r = compare(walk, walk);
  EXPECT_TRUE(r.ok) << (r.faults.empty() ? "" : r.faults[0]);
  EXPECT_EQ(r.joints, walk.skeleton.size());
  EXPECT_EQ(r.position_m.value, 0.0);
}

TEST(Certificate, TheSignOfAQuaternionIsNoDifference) {
  const Walk a;
  Walk b;
  for (DualQuaternion& q : b.clip.parent_from_joint) q = -q;
  EXPECT_LT(compare(a, b).rotation_rad.value, 1e-15);
}

TEST(Certificate, ADroppedFrameIsFound) {
  const Walk a;
  Walk b;
  const auto frame = b.clip.parent_from_joint.begin() + 20 * b.clip.joints;
  b.clip.parent_from_joint.erase(frame, frame + b.clip.joints);
  const CertificateReport r = compare(a, b);
  EXPECT_FALSE(r.ok);
  EXPECT_EQ(r.frames_a, 60);
  EXPECT_EQ(r.frames_b, 59);
  EXPECT_GE(r.position_m.frame, 20) << "the frames before the gap are equal";
}

TEST(Certificate, AScaledBoneIsFoundWhereItIs) {
  const Walk a;
  Walk b;
  const std::int32_t elbow = b.skeleton.find("leftLowerArm");
  for (std::int64_t f = 0; f < b.clip.frames(); ++f) {
    DualQuaternion& q = b.clip.frame(f)[elbow];
    q = DualQuaternion::from_rotation_translation(q.rotation(), Vector3d(1.02 * q.translation()));
  }
  const CertificateReport r = compare(a, b);
  EXPECT_FALSE(r.ok);
  EXPECT_EQ(r.bone_relative.joint, "leftLowerArm");
  EXPECT_NEAR(r.bone_relative.value, 0.02, 1e-12);
  // The upper arm is 28 cm long: the elbow and all below it are 5.6 mm off.
  EXPECT_NEAR(r.position_m.value, 0.0056, 1e-9);
}

TEST(Certificate, ATurnedJointIsFoundAtItsFrame) {
  const Walk a;
  Walk b;
  DualQuaternion& q = b.clip.frame(33)[b.skeleton.find("head")];
  q = q * DualQuaternion::from_rotation(rotation_exp(Vector3d(0, 0.01, 0)));
  const CertificateReport r = compare(a, b);
  EXPECT_FALSE(r.ok);
  EXPECT_EQ(r.rotation_rad.joint, "head");
  EXPECT_EQ(r.rotation_rad.frame, 33);
  EXPECT_NEAR(r.rotation_rad.value, 0.01, 1e-12);
  EXPECT_LT(r.position_m.value, 1e-12);
}

TEST(Certificate, ConstantJointSpacesCanBeIgnoredAndMotionCannot) {
  const Walk a;
  Walk b;  // the head's own axes turned: the same motion in a format without joint orientations
  const std::int32_t head = b.skeleton.find("head");
  for (std::int64_t f = 0; f < b.clip.frames(); ++f) {
    DualQuaternion& q = b.clip.frame(f)[head];
    q = q * DualQuaternion::from_rotation(rotation_exp(Vector3d(0.3, 0.4, 0.5)));
  }
  EXPECT_FALSE(compare(a, b).ok);
  EXPECT_TRUE(compare(a, b, {.ignore_joint_spaces = true}).ok);
  DualQuaternion& q = b.clip.frame(40)[head];
  q = q * DualQuaternion::from_rotation(rotation_exp(Vector3d(0.05, 0, 0)));
  const CertificateReport r = compare(a, b, {.ignore_joint_spaces = true});
  EXPECT_FALSE(r.ok);
  EXPECT_EQ(r.rotation_rad.frame, 40);
  EXPECT_NEAR(r.rotation_rad.value, 0.05, 1e-12);
}

TEST(Certificate, OtherRateMissingJointAndNoCommonName) {
  const Walk a;
  Walk b;
  b.clip.rate_hz = 30.01;
  EXPECT_FALSE(compare(a, b).ok);
  Walk renamed;
  renamed.skeleton.names[7] = "thing";
  const CertificateReport r = compare(a, renamed);
  EXPECT_FALSE(r.ok);
  EXPECT_EQ(r.missing_joints, std::vector<std::string>{a.skeleton.names[7]});
  for (std::string& name : renamed.skeleton.names) name += "_x";
  EXPECT_EQ(compare_clips(a.skeleton, a.clip, renamed.skeleton, renamed.clip).error().code,
            "certificate-no-joints");
}

TEST(Certificate, NaNNeverPasses) {
  const Walk a;
  Walk b;
  b.clip.frame(3)[2].dual.x() = std::nan("");
  EXPECT_FALSE(compare(a, b).ok);
}

}  // namespace
}  // namespace limber
