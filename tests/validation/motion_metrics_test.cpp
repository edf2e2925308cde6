#include "validation/motion_metrics.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/validation/walker.h"

namespace limber {
namespace {

using Eigen::Vector3d;

/// A foot point: stands still at the origin for `stand` seconds, then moves on in a hop of 0.5 s.
std::vector<Vector3d> steps(double rate, double stand, int count) {
  std::vector<Vector3d> track;
  const auto standing = static_cast<int>(std::lround(stand * rate));
  const auto moving = static_cast<int>(std::lround(0.5 * rate));
  for (int n = 0; n < count; ++n) {
    for (int f = 0; f < standing; ++f) track.emplace_back(0.8 * n, 0.08, 0.0);
    for (int f = 0; f < moving; ++f) {
      const double t = (f + 0.5) / moving;
      track.emplace_back(0.8 * n + 0.8 * t, 0.08 + 0.2 * std::sin(M_PI * t), 0.0);
    }
  }
  return track;
}

TEST(Contacts, StepsAreFoundAndTrimmedInside) {
  const std::vector<Vector3d> track = steps(60.0, 0.5, 3);
  const std::vector<FrameInterval> contacts = detect_contacts(track, 60.0, 0.08);
  ASSERT_EQ(contacts.size(), 3u);
  for (std::size_t n = 0; n < 3; ++n) {
    const auto begin = static_cast<std::int64_t>(60 * n), end = begin + 30;
    EXPECT_GE(contacts[n].begin, begin);
    EXPECT_LE(contacts[n].end, end);
    EXPECT_GE(contacts[n].end - contacts[n].begin, 20);
  }
  EXPECT_EQ(contacts[0].begin, 0) << "the clip's own start is no touch-down";
}

TEST(Contacts, HeightSpeedAndScaleDecide) {
  std::vector<Vector3d> high(60, Vector3d(0, 0.036, 0)), slides;
  EXPECT_TRUE(detect_contacts(high, 60.0, 0.0).empty());
  EXPECT_EQ(detect_contacts(high, 60.0, 0.0, {.scale = 1.1}).size(), 1u);
  for (int f = 0; f < 60; ++f) slides.emplace_back(0.16 * f / 60.0, 0.0, 0.0);
  EXPECT_TRUE(detect_contacts(slides, 60.0, 0.0).empty());
  EXPECT_EQ(detect_contacts(slides, 60.0, 0.0, {.scale = 1.1}).size(), 1u);
}

TEST(Contacts, ShortOnesVanishAndShortGapsClose) {
  // 0.05 s on the floor is none; a blink of 2 frames at 60 Hz (0.033 s) does not part a contact.
  std::vector<Vector3d> touch(60, Vector3d(0, 0.3, 0)), blink(60, Vector3d::Zero());
  for (int f = 30; f < 33; ++f) touch[f] = Vector3d::Zero();
  EXPECT_TRUE(detect_contacts(touch, 60.0, 0.0, {.speed_m_s = 100.0}).empty());
  for (int f = 30; f < 32; ++f) blink[f].y() = 0.04;
  const ContactOptions fast{.speed_m_s = 100.0};
  EXPECT_EQ(detect_contacts(blink, 60.0, 0.0, fast), (std::vector<FrameInterval>{{0, 60}}));
  for (int f = 30; f < 36; ++f) blink[f].y() = 0.04;
  EXPECT_EQ(detect_contacts(blink, 60.0, 0.0, fast).size(), 2u);
}

TEST(Contacts, HysteresisHoldsWhatHasBegunWhicheverWayTimeRuns) {
  std::vector<Vector3d> track;
  for (int f = 0; f < 60; ++f) track.emplace_back(0.0, 0.03 + 0.02 * std::sin(f * 0.9), 0.0);
  const ContactOptions nervous{.speed_m_s = 100.0, .min_s = 0.0, .gap_s = 0.0, .trim_s = 0.0};
  ContactOptions calm = nervous;
  calm.release_height = 1.5;
  EXPECT_GT(detect_contacts(track, 60.0, 0.0, nervous).size(), 3u);
  EXPECT_EQ(detect_contacts(track, 60.0, 0.0, calm), (std::vector<FrameInterval>{{0, 60}}));
  std::vector<Vector3d> lifts;  // never low enough to begin
  for (int f = 0; f < 60; ++f) lifts.emplace_back(0.0, 0.04, 0.0);
  EXPECT_TRUE(detect_contacts(lifts, 60.0, 0.0, calm).empty());
  const std::vector<Vector3d> back(track.rbegin(), track.rend());
  EXPECT_EQ(detect_contacts(back, 60.0, 0.0, calm), detect_contacts(track, 60.0, 0.0, calm));
}

TEST(Contacts, PercentileIsLinearBetweenRanks) {
  EXPECT_DOUBLE_EQ(percentile({4, 1, 3, 2}, 50), 2.5);
  EXPECT_DOUBLE_EQ(percentile({4, 1, 3, 2}, 100), 4);
  EXPECT_DOUBLE_EQ(percentile({0, 10}, 3), 0.3);
  EXPECT_DOUBLE_EQ(percentile({}, 3), 0);
}

/// A figure that stands for three seconds and moves its arms.
struct Standing {
  Character character = test::walker_skeleton();
  Clip clip;

  Standing() {
    clip.rate_hz = 60.0;
    clip.joints = character.skeleton.size();
    for (int f = 0; f < 180; ++f) {
      std::vector<DualQuaternion> pose = character.skeleton.rest_parent_from_joint;
      const auto turn = [&](const char* name, const Vector3d& v) {
        const std::int32_t i = character.skeleton.find(name);
        pose[i] = pose[i] * DualQuaternion::from_rotation(rotation_exp(v));
      };
      const double t = f / 60.0;
      turn("leftUpperArm", Vector3d(0, 0.5 * std::sin(3.0 * t), 0));
      turn("rightLowerArm", Vector3d(0, 0.8 * std::sin(2.0 * t), 0));
      clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
    }
  }

  MotionSide side() const {
    MotionSide s;
    s.skeleton = &character.skeleton;
    s.clip = &clip;
    s.roles = character.roles;
    s.stature_m = 1.7;
    std::vector<DualQuaternion> rest(character.skeleton.parents.size());
    model_from_local(character.skeleton, character.skeleton.rest_parent_from_joint, rest);
    s.soles = sole_points(character.skeleton, s.roles, rest, 0.0, s.stature_m);
    return s;
  }
};

TEST(MotionMetrics, AMotionAgainstItselfIsClean) {
  const Standing standing;
  const MotionMetrics m = measure_motion(standing.side(), standing.side());
  EXPECT_EQ(m.frames, 180);
  EXPECT_EQ(m.intervals, 4) << "two ankles and two toes stand throughout";
  EXPECT_LT(m.output.slide_cm_s, 1e-9);
  EXPECT_LT(m.output.penetration_cm, 1e-9);
  EXPECT_NEAR(m.jerk_ratio, 1.0, 1e-12);
  EXPECT_NEAR(m.max_angular_velocity_ratio, 1.0, 1e-12);
  EXPECT_EQ(m.pops, 0);
}

TEST(MotionMetrics, ASlidFootIsMeasured) {
  const Standing source;
  Standing slid;  // the whole figure drifts at 3 cm/s along x
  for (std::int64_t f = 0; f < slid.clip.frames(); ++f) {
    DualQuaternion& hips = slid.clip.frame(f)[0];
    hips = DualQuaternion::from_translation(Vector3d(0.03 * double(f) / 60.0, 0, 0)) * hips;
  }
  const MotionMetrics m = measure_motion(source.side(), slid.side());
  EXPECT_NEAR(m.output.slide_cm_s, 3.0, 1e-9);
  EXPECT_NEAR(m.source.slide_cm_s, 0.0, 1e-9);
  EXPECT_NEAR(m.output.drift_cm, 3.0 * 179.0 / 60.0, 1e-9);
}

TEST(MotionMetrics, ASunkenFigurePenetrates) {
  const Standing source;
  Standing sunk;
  for (std::int64_t f = 0; f < sunk.clip.frames(); ++f) {
    DualQuaternion& hips = sunk.clip.frame(f)[0];
    hips = DualQuaternion::from_translation(Vector3d(0, -0.02, 0)) * hips;
  }
  const MotionMetrics m = measure_motion(source.side(), sunk.side());
  EXPECT_NEAR(m.output.penetration_cm, 2.0, 1e-9) << "the soles are flat in every frame";
  EXPECT_LT(m.source.penetration_cm, 1e-9);
}

TEST(MotionMetrics, APoppedElbowIsFoundAtItsRoleAndFrame) {
  const Standing source;
  Standing popped;
  DualQuaternion& elbow = popped.clip.frame(90)[popped.character.skeleton.find("leftLowerArm")];
  elbow = elbow * DualQuaternion::from_rotation(rotation_exp(Vector3d(0, 0.3, 0)));
  const MotionMetrics m = measure_motion(source.side(), popped.side());
  ASSERT_GE(m.pops, 1);
  for (const MotionMetrics::Pop& pop : m.pop_list) {
    EXPECT_EQ(pop.role, "leftLowerArm");
    EXPECT_NEAR(double(pop.frame), 90.0, 1.0);
  }
  EXPECT_GT(m.max_angular_velocity_ratio, 3.0);
  EXPECT_GT(m.jerk_ratio, 1.5);
  // The same pop in the source excuses it.
  EXPECT_EQ(measure_motion(popped.side(), popped.side()).pops, 0);
}

TEST(MotionMetrics, APopBeginsAtItsThreshold) {
  // The arms' accelerations stay below 5 rad/s2, so the least threshold of 20 rad/s2 holds; a jump
  // by d for one frame is an acceleration of 2 d rate^2.
  const double least = 20.0 / (2.0 * 60.0 * 60.0);
  const Standing source;
  for (const double factor : {0.95, 1.05}) {
    Standing jumped;
    DualQuaternion& head = jumped.clip.frame(90)[jumped.character.skeleton.find("head")];
    head = head * DualQuaternion::from_rotation(rotation_exp(Vector3d(factor * least, 0, 0)));
    EXPECT_EQ(measure_motion(source.side(), jumped.side()).pops, factor > 1.0 ? 1 : 0);
  }
}

TEST(MotionMetrics, ScaleIsTakenOut) {
  const Standing source;
  Standing giant;
  for (DualQuaternion& q : giant.clip.parent_from_joint) {
    q = DualQuaternion::from_rotation_translation(q.rotation(), Vector3d(2.0 * q.translation()));
  }
  MotionSide output = giant.side();
  output.soles.clear();
  MotionOptions options;
  options.scale = 2.0;
  const MotionMetrics m = measure_motion(source.side(), output, options);
  EXPECT_NEAR(m.jerk_ratio, 1.0, 1e-9);
  EXPECT_EQ(m.pops, 0);
}

TEST(MotionMetrics, ConstantJointSpacesChangeNothing) {
  const Standing source;
  Standing turned;  // every joint's own axes turned, as another file would have them
  const Eigen::Quaterniond c = rotation_exp(Vector3d(0.7, -0.4, 1.1));
  const DualQuaternion out = DualQuaternion::from_rotation(c), in = out.conjugate();
  for (std::int64_t f = 0; f < turned.clip.frames(); ++f) {
    for (std::int32_t i = 0; i < turned.clip.joints; ++i) {
      DualQuaternion& q = turned.clip.frame(f)[i];
      q = turned.character.skeleton.parents[i] == kNoJoint ? q * out : in * q * out;
    }
  }
  MotionSide output = turned.side();
  output.soles.clear();
  const MotionMetrics m = measure_motion(source.side(), output);
  EXPECT_NEAR(m.max_angular_velocity_ratio, 1.0, 1e-9);
  EXPECT_NEAR(m.jerk_ratio, 1.0, 1e-9);
  EXPECT_EQ(m.pops, 0);
}

TEST(MotionMetrics, AFastSourceIsMeasuredAtAWholeFractionOfItsRate) {
  Standing source, output;
  source.clip.rate_hz = 120.0;
  output.clip.rate_hz = 120.0;
  const MotionMetrics m = measure_motion(source.side(), output.side());
  EXPECT_DOUBLE_EQ(m.rate_hz, 60.0);
  EXPECT_EQ(m.frames, 90);
}

}  // namespace
}  // namespace limber
