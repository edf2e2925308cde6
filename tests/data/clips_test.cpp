// The clips that we ship do what they are for: tips meet, feet stand, the T-pose begins and ends.

#include <gtest/gtest.h>

#include <algorithm>

#include "importers/importer.h"
#include "tests/data/data_files.h"

namespace limber::test {
namespace {

using Eigen::Vector3d;

struct Motion {
  Skeleton skeleton;
  Clip clip;
  std::vector<std::vector<DualQuaternion>> model;  // [frame][joint]

  Vector3d at(std::int64_t frame, const std::string& joint) const {
    return model[frame][skeleton.find(joint)].translation();
  }
  std::int64_t frame(double seconds) const { return std::llround(seconds * clip.rate_hz); }
};

Motion load(const std::string& name) {
  ImportOptions options;
  options.unit_m = 0.01;
  options.keep_reference_frame = true;
  auto imported = import_file(kData / "clips" / name, options);
  EXPECT_TRUE(imported.ok()) << name << ": " << (imported.ok() ? "" : imported.error().message);
  Motion motion;
  if (!imported.ok() || imported->clips.size() != 1) return motion;
  motion.skeleton = imported->character.skeleton;
  motion.clip = imported->clips[0];
  for (std::int64_t f = 0; f < motion.clip.frames(); ++f) {
    motion.model.emplace_back(motion.skeleton.size());
    model_from_local(motion.skeleton, motion.clip.frame(f), motion.model.back());
  }
  return motion;
}

void expect_t_pose(const Motion& motion, std::int64_t frame) {
  for (std::int32_t j = 0; j < motion.skeleton.size(); ++j) {
    EXPECT_LT(rotation_angle(motion.model[frame][j].rotation(), Eigen::Quaterniond::Identity()),
              1e-6)
        << motion.skeleton.names[j] << " in frame " << frame;
  }
}

/// Fastest turn of any joint, degrees per second.
double fastest_turn(const Motion& motion) {
  double fastest = 0.0;
  for (std::int64_t f = 1; f < motion.clip.frames(); ++f) {
    for (std::int32_t j = 0; j < motion.skeleton.size(); ++j) {
      fastest = std::max(fastest, rotation_angle(motion.clip.frame(f - 1)[j].rotation(),
                                                 motion.clip.frame(f)[j].rotation()));
    }
  }
  return fastest * motion.clip.rate_hz / kRadians;
}

const Motion& gestures() {
  static const Motion motion = load("gestures_right_hand.bvh");
  return motion;
}
const Motion& body() {
  static const Motion motion = load("body_range_of_motion.bvh");
  return motion;
}

TEST(Gestures, AreARightHandAtThirtyHertz) {
  EXPECT_NEAR(gestures().clip.rate_hz, 30.0, 1e-9);
  EXPECT_EQ(gestures().skeleton.names[0], "rightHand");
  EXPECT_GT(gestures().clip.duration_s(), 8.0);
  EXPECT_LT(gestures().clip.duration_s(), 14.0);
  expect_t_pose(gestures(), 0);
  expect_t_pose(gestures(), gestures().clip.frames() - 1);
  // Palm down, fingers to -X, thumb forward.
  EXPECT_LT(gestures().at(0, "rightMiddleDistal_End").x(), -0.15);
  EXPECT_GT(gestures().at(0, "rightThumbDistal_End").z(), 0.05);
}

TEST(Gestures, ThumbMeetsEveryFingerTip) {
  for (const std::string finger : {"Index", "Middle", "Ring", "Little"}) {
    double nearest = 1.0;
    for (std::int64_t f = 0; f < gestures().clip.frames(); ++f) {
      nearest = std::min(nearest, (gestures().at(f, "rightThumbDistal_End") -
                                   gestures().at(f, "right" + finger + "Distal_End"))
                                      .norm());
    }
    EXPECT_LT(nearest, 0.003) << finger;
  }
}

/// A finger is up where its tip is farther from the wrist than its knuckle by most of its length.
int fingers_up(std::int64_t frame) {
  int up = 0;
  for (const std::string finger : {"Index", "Middle", "Ring", "Little"}) {
    const double tip = gestures().at(frame, "right" + finger + "Distal_End").norm();
    const double knuckle = gestures().at(frame, "right" + finger + "Proximal").norm();
    up += tip > knuckle + 0.05;
  }
  return up;
}

TEST(Gestures, CountFromFistToFour) {
  std::vector<int> seen;  // held for at least a quarter of a second
  for (std::int64_t f = 0; f + 8 < gestures().clip.frames(); ++f) {
    const int up = fingers_up(f);
    bool held = true;
    for (int k = 1; k < 8; ++k) held &= fingers_up(f + k) == up;
    if (held && (seen.empty() || seen.back() != up)) seen.push_back(up);
  }
  const std::vector<int> count = {0, 1, 2, 3, 4};
  EXPECT_NE(std::search(seen.begin(), seen.end(), count.begin(), count.end()), seen.end());
}

TEST(RangeOfMotion, IsABodyOfOneMetreSeventyFive) {
  EXPECT_NEAR(body().clip.rate_hz, 30.0, 1e-9);
  expect_t_pose(body(), 0);
  expect_t_pose(body(), body().clip.frames() - 1);
  EXPECT_NEAR(body().at(0, "head_End").y(), 1.75, 0.02);
  EXPECT_GT(body().at(0, "leftHand").x(), 0.5);
  EXPECT_GT(body().at(0, "leftToes").z(), 0.1);
}

TEST(RangeOfMotion, FeetStandThroughTheSquat) {
  double lowest = 1.0;
  for (const std::string foot : {"leftFoot", "rightFoot"}) {
    const Vector3d planted = body().at(0, foot);
    for (std::int64_t f = 0; f < body().frame(17.0); ++f) {
      EXPECT_LT((body().at(f, foot) - planted).norm(), 5e-5) << foot << " in frame " << f;
      lowest = std::min(lowest, body().at(f, "hips").y());
    }
  }
  EXPECT_LT(lowest, body().at(0, "hips").y() - 0.3);
}

TEST(RangeOfMotion, MovesWhatItPromises) {
  double hand_up = 0.0, hand_ahead = 0.0, left_knee = 0.0, right_knee = 0.0, fist = 1.0;
  double look = 0.0;
  for (std::int64_t f = 0; f < body().clip.frames(); ++f) {
    hand_up = std::max(hand_up, body().at(f, "leftHand").y());
    hand_ahead = std::max(hand_ahead, body().at(f, "rightHand").z());
    left_knee = std::max(left_knee, body().at(f, "leftLowerLeg").y());
    right_knee = std::max(right_knee, body().at(f, "rightLowerLeg").y());
    fist = std::min(
        fist, (body().at(f, "leftMiddleDistal_End") - body().at(f, "leftMiddleProximal")).norm());
    const Eigen::Quaterniond head = body().model[f][body().skeleton.find("head")].rotation();
    look = std::max(look, std::abs((head * Vector3d::UnitZ()).x()));
  }
  EXPECT_GT(hand_up, 1.85);
  EXPECT_GT(hand_ahead, 0.4);
  EXPECT_GT(left_knee, 0.7);
  EXPECT_NEAR(left_knee, right_knee, 0.02);
  EXPECT_LT(fist, 0.05);
  EXPECT_GT(look, std::sin(50 * kRadians));
}

TEST(Clips, TurnNoFasterThanPeopleDo) {
  EXPECT_LT(fastest_turn(gestures()), 700.0);  // fingers of a pianist reach about 1000
  EXPECT_LT(fastest_turn(body()), 700.0);
}

TEST(Clips, AreSmall) {
  for (const auto& entry : std::filesystem::directory_iterator(kData / "clips")) {
    EXPECT_LT(entry.file_size(), 700'000u) << entry.path();
  }
}

}  // namespace
}  // namespace limber::test
