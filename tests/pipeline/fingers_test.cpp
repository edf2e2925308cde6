// Laws of hands: thumbs have one axis whatever their rest, fingers meet their limits softly and
// keep out of the arm's business, and a pinch touches on a hand of other proportions.
#include <gtest/gtest.h>

#include <cmath>

#include "assets/model/mannequin.h"
#include "pipeline/limit_approach.h"
#include "pipeline/retarget.h"
#include "solver/swing_twist.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kDeg = M_PI / 180.0;

TEST(LimitApproach, KeepsWhatIsFarAndEndsOnTheBorder) {
  const double border = 1.0, largest = 1.3, knee = 0.7;
  const LimitApproach bend(border, largest, 0.5);
  EXPECT_EQ(bend(0.2), 0.2);
  EXPECT_NEAR(bend(largest), border, 1e-12);
  const double h = 1e-5;
  EXPECT_NEAR((bend(knee + h) - bend(knee - h)) / (2 * h), 1.0, 1e-4) << "a jump of speed";
  for (double x = 0.0; x < largest; x += 0.01) {
    const double slope = (bend(x + h) - bend(x)) / h;
    EXPECT_GT(slope, 0.2) << "sticks at " << x;
    EXPECT_LT(slope, 1.0 + 1e-6) << "hastens at " << x;
  }
  const LimitApproach inside(border, 0.99, 0.5);
  EXPECT_EQ(inside(0.98), 0.98);
}

RigJoint joint_with(JointType type) {
  RigJoint joint;
  joint.type = type;
  joint.axes = {-Vector3d::UnitY(), -Vector3d::UnitZ(), Vector3d::UnitX()};
  joint.limits = {Range{-0.5, 0.5}, Range{-0.3, 1.2}, Range{-0.4, 0.4}};
  return joint;
}

TEST(BendIntoLimits, EveryJointTypeEndsInsideAndNeverJumps) {
  for (const JointType type : {JointType::hinge, JointType::universal, JointType::ball}) {
    const RigJoint joint = joint_with(type);
    std::vector<Quaterniond> turns;
    for (int f = 0; f <= 200; ++f) {
      const double s = std::sin(2.0 * M_PI * f / 200.0);
      turns.push_back(Quaterniond(AngleAxisd(0.7 * s, joint.axes[0])) *
                      Quaterniond(AngleAxisd(0.3 + 1.2 * s, joint.axes[1])) *
                      Quaterniond(AngleAxisd(0.2 * s, joint.axes[2])));
    }
    std::vector<Quaterniond> bent = turns;
    bend_into_limits(joint, Vector3d::UnitX(), bent);
    for (std::size_t f = 0; f < bent.size(); ++f) {
      EXPECT_LT(rotation_angle(bent[f], project_into_limits(joint, bent[f])), 1e-9);
    }
    // Speed may change by what bending over the whole excess needs, not at once.
    double jerked = 0.0, clamped = 0.0;
    const auto kink = [](const std::vector<Quaterniond>& q, std::size_t f) {
      const AngleAxisd a(q[f - 1].conjugate() * q[f]), b(q[f].conjugate() * q[f + 1]);
      return (b.angle() * b.axis() - a.angle() * a.axis()).norm();
    };
    std::vector<Quaterniond> hard;
    for (const Quaterniond& turn : turns) hard.push_back(project_into_limits(joint, turn));
    for (std::size_t f = 1; f + 1 < turns.size(); ++f) {
      jerked = std::max(jerked, kink(bent, f));
      clamped = std::max(clamped, kink(hard, f));
    }
    EXPECT_LT(jerked, 0.5 * clamped) << to_string(type);
  }
}

TEST(BendIntoLimits, LeavesABallThatStaysInsideAlone) {
  const RigJoint joint = joint_with(JointType::ball);
  std::vector<Quaterniond> turns{Quaterniond(AngleAxisd(0.4, joint.axes[1])),
                                 Quaterniond(AngleAxisd(-0.2, joint.axes[0]))};
  const std::vector<Quaterniond> before = turns;
  bend_into_limits(joint, Vector3d::UnitX(), turns);
  for (std::size_t f = 0; f < turns.size(); ++f) EXPECT_EQ(turns[f].coeffs(), before[f].coeffs());
}

TEST(BendIntoLimits, AHingeTurnsSoThatItsBonePointsTheWay) {
  RigJoint hinge = joint_with(JointType::hinge);
  hinge.limits[0] = {-2.0, 2.0};
  // Rolled about its own axis the bone points as before; the angle must not follow the roll.
  const Quaterniond swing(AngleAxisd(0.8, hinge.axes[0]));
  std::vector<Quaterniond> turns{swing * Quaterniond(AngleAxisd(1.0, Vector3d::UnitX()))};
  bend_into_limits(hinge, Vector3d::UnitX(), turns);
  EXPECT_LT(rotation_angle(turns[0], swing), 1e-4);
}

/// A character with its figure and calibration, to perform clips.
struct Performer {
  Character character;
  Figure figure;
  Calibration calibration;

  explicit Performer(Character c) : character(std::move(c)) {
    auto found = identify_figure(character);
    EXPECT_TRUE(found);
    figure = std::move(*found);
    auto calibrated = calibrate(character, figure, {ReferenceChoice::rest, 0}, {}, nullptr);
    EXPECT_TRUE(calibrated);
    calibration = std::move(*calibrated);
  }

  Retargeted onto(const Target& target, const Clip& clip) const {
    RetargetOptions options;
    options.refine = RefineMode::none;
    auto out = retarget_clip({&character, &figure, &calibration, &clip}, target, options);
    EXPECT_TRUE(out) << out.error().message;
    return std::move(*out);
  }
};

Clip holding(const Pose& pose, int frames) {
  Clip clip;
  clip.rate_hz = 30.0;
  clip.joints = static_cast<std::int32_t>(pose.size());
  for (int f = 0; f < frames; ++f) {
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  return clip;
}

TEST(Thumb, PointsOneWayInTheTPoseWhateverItsRest) {
  for (const double deg : {-30.0, 0.0, 35.0}) {
    Character character = mannequin(*shipped_rig("hand"));
    DualQuaternion& rest =
        character.skeleton.rest_parent_from_joint[character.skeleton.find("rightThumbMetacarpal")];
    const Vector3d axis = Vector3d(1.0, -2.0, 0.5).normalized();
    rest = DualQuaternion::from_rotation_translation(
        Quaterniond(AngleAxisd(deg * kDeg, axis)) * rest.rotation(), rest.translation());
    const Performer hand(std::move(character));
    const auto p = [&](Role role) { return hand.calibration.position(hand.figure.at(role)); };
    const Vector3d wanted = (-Vector3d::UnitX() + Vector3d::UnitZ()).normalized();
    for (const auto& [from, to] : {std::pair(Role::rightThumbMetacarpal, Role::rightThumbProximal),
                                   std::pair(Role::rightThumbProximal, Role::rightThumbDistal)}) {
      EXPECT_NEAR((p(to) - p(from)).normalized().dot(wanted), 1.0, 1e-9) << deg;
    }
  }
}

/// The hand in a pose in which the tips of thumb and index finger meet.
Pose pinching(const Rig& rig) {
  Rig only = rig;
  std::erase_if(only.effectors, [](const RigEffector& e) {
    return e.name != "thumb_tip" && e.name != "index_tip";
  });
  EXPECT_EQ(only.effectors.size(), 2u);
  for (RigEffector& effector : only.effectors) effector.kind = EffectorKind::position;
  auto solver = IkSolver::create(only);
  EXPECT_TRUE(solver);
  Pose pose = skeleton_of(only).rest_parent_from_joint;
  const std::int32_t knuckle = only.find("rightIndexProximal");
  const Vector3d meet = only.joints[knuckle].offset + Vector3d(0.03, -0.05, 0.0);
  std::vector<EffectorTarget> targets(2);
  for (EffectorTarget& target : targets) {
    target.pose = DualQuaternion::from_rotation_translation(Quaterniond::Identity(), meet);
  }
  EXPECT_TRUE(solver->solve(targets, pose).reached);
  return pose;
}

/// Distance between the two tips where the rig's joints turn as `pose` does.
double tips_apart(const Rig& rig, std::span<const DualQuaternion> pose) {
  Pose own(pose.size());
  std::vector<DualQuaternion> model(pose.size());
  for (std::size_t i = 0; i < pose.size(); ++i) {
    own[i] = DualQuaternion::from_rotation_translation(pose[i].rotation(), rig.joints[i].offset);
  }
  model_from_rows(rig, own, model);
  std::vector<Vector3d> tips;
  for (const RigEffector& effector : rig.effectors) {
    if (effector.name != "thumb_tip" && effector.name != "index_tip") continue;
    tips.push_back(model[effector.joint].transform_point(effector.offset));
  }
  return (tips.at(0) - tips.at(1)).norm();
}

TEST(Pinch, TouchesOnAHandWithAShorterThumb) {
  const Rig hand = *shipped_rig("hand");
  Rig long_thumb = hand;
  for (const char* name : {"rightThumbProximal", "rightThumbDistal"}) {
    long_thumb.joints[long_thumb.find(name)].offset *= 1.25;
  }
  const Pose pose = pinching(long_thumb);
  ASSERT_LT(tips_apart(long_thumb, pose), 1e-3);
  ASSERT_GT(tips_apart(hand, pose), 0.012) << "the same angles alone would do";

  const Performer source(mannequin(long_thumb));
  Pose on_mannequin(source.character.skeleton.parents.size());
  for (std::int32_t j = 0; j < source.character.skeleton.size(); ++j) {
    const std::int32_t row = long_thumb.find(source.character.skeleton.names[j]);
    on_mannequin[j] =
        row == kNoJoint ? source.character.skeleton.rest_parent_from_joint[j] : pose[row];
  }
  const auto target = load_target("hand", {});
  ASSERT_TRUE(target);
  const Retargeted held = source.onto(*target, holding(on_mannequin, 12));
  EXPECT_LT(tips_apart(hand, held.rig_clip.frame(6)), 0.006);

  // Fingers that are only on their way past the thumb do not reach for it.
  const Retargeted passed = source.onto(*target, holding(on_mannequin, 2));
  EXPECT_GT(tips_apart(hand, passed.rig_clip.frame(1)), 0.012);
}

TEST(Fingers, NeverPullAtTheArm) {
  const Performer source(mannequin(*shipped_rig("biped-hands")));
  const auto target = load_target("biped-hands", {});
  ASSERT_TRUE(target);
  const auto find = [&](const char* name) { return source.character.skeleton.find(name); };
  Pose open = source.character.skeleton.rest_parent_from_joint;
  const auto turn = [&](Pose& pose, std::int32_t j, double rad, const Vector3d& axis) {
    ASSERT_NE(j, kNoJoint);
    pose[j] = DualQuaternion::from_rotation_translation(
        pose[j].rotation() * Quaterniond(AngleAxisd(rad, axis)), pose[j].translation());
  };
  turn(open, find("leftUpperArm"), -0.9, Vector3d::UnitZ());
  turn(open, find("leftHand"), 1.6, Vector3d::UnitX());  // more than the wrist can do
  Pose fist = open;
  for (const char* finger : {"leftIndex", "leftMiddle", "leftRing", "leftLittle"}) {
    turn(fist, find((std::string(finger) + "Proximal").c_str()), -1.3, Vector3d::UnitZ());
    turn(fist, find((std::string(finger) + "Intermediate").c_str()), -1.5, Vector3d::UnitZ());
  }
  const Retargeted a = source.onto(*target, holding(open, 3));
  const Retargeted b = source.onto(*target, holding(fist, 3));
  for (const char* joint : {"leftUpperArm", "leftLowerArm", "leftHand"}) {
    const std::int32_t j = target->character.skeleton.find(joint);
    EXPECT_LT(rotation_angle(a.clip.frame(1)[j].rotation(), b.clip.frame(1)[j].rotation()), 1e-9)
        << joint;
  }
  // And close in the palm, wherever the wrist ended.
  const std::int32_t knuckle = target->character.skeleton.find("leftIndexProximal");
  EXPECT_NEAR(
      rotation_angle(a.clip.frame(1)[knuckle].rotation(), b.clip.frame(1)[knuckle].rotation()), 1.3,
      0.02);
}

}  // namespace
}  // namespace limber
