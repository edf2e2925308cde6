#include "assets/generate/hand_gestures.h"

#include <algorithm>
#include <cmath>

#include "assets/generate/track.h"

namespace limber::generate {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kRadians = EIGEN_PI / 180.0;
constexpr std::array<const char*, kFingers> kNames = {"Thumb", "Index", "Middle", "Ring", "Little"};

// A hand 19 cm long. The right hand of the T-pose points to -X, palm down, thumb to +Z.
struct FingerShape {
  Vector3d base;     // of the metacarpal
  Vector3d knuckle;  // of the proximal joint (the thumb: its first joint)
  std::array<double, 3> length;
};
const std::array<FingerShape, kFingers> kShape = {{
    {{-2.2, -1.0, 2.8}, {-2.2, -1.0, 2.8}, {4.6, 3.5, 2.8}},
    {{-2.6, 0.1, 1.6}, {-9.4, 0.0, 2.6}, {4.4, 2.6, 2.2}},
    {{-2.7, 0.2, 0.3}, {-9.2, 0.2, 0.4}, {4.9, 3.0, 2.3}},
    {{-2.6, 0.1, -0.8}, {-8.6, 0.0, -1.7}, {4.5, 2.8, 2.3}},
    {{-2.5, -0.1, -1.7}, {-7.8, -0.4, -3.5}, {3.6, 2.2, 2.2}},
}};

// The thumb lies half way between forward and sideways, its nail up and outwards.
const Vector3d kThumbBone = Vector3d(-1, 0, 1).normalized();
const Vector3d kPalmarAxis = Vector3d(1, 0, 1).normalized();
const Vector3d kAcrossAxis = -Vector3d::UnitY();
const Vector3d kThumbBendAxis =
    AngleAxisd(55.0 * kRadians, kThumbBone) * Vector3d(1, 0, 1).normalized();

Quaterniond turn(double degrees, const Vector3d& axis) {
  return Quaterniond(AngleAxisd(degrees * kRadians, axis));
}

HandPose blend(const HandPose& a, const HandPose& b, double t) {
  const auto mix = [t](double x, double y) { return x + (y - x) * t; };
  HandPose r;
  r.thumb_palmar = mix(a.thumb_palmar, b.thumb_palmar);
  r.thumb_across = mix(a.thumb_across, b.thumb_across);
  r.thumb_turn = mix(a.thumb_turn, b.thumb_turn);
  r.thumb_bend = mix(a.thumb_bend, b.thumb_bend);
  r.thumb_end = mix(a.thumb_end, b.thumb_end);
  r.cup = mix(a.cup, b.cup);
  for (int f = 0; f < 4; ++f) {
    r.spread[f] = mix(a.spread[f], b.spread[f]);
    r.knuckle[f] = mix(a.knuckle[f], b.knuckle[f]);
    r.middle[f] = mix(a.middle[f], b.middle[f]);
    r.end[f] = mix(a.end[f], b.end[f]);
  }
  return r;
}

/// The end of every joint's bone in the wrist's space, cm: the next joint, or the fingertip.
std::vector<Vector3d> bone_ends(const std::vector<MadeJoint>& joints, const HandPose& pose) {
  const std::vector<Quaterniond> local = right_hand_rotations(joints, pose, 0.0);
  std::vector<Quaterniond> rotation(joints.size());
  std::vector<Vector3d> position(joints.size()), end(joints.size());
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const int parent = joints[j].parent;
    rotation[j] = parent < 0 ? local[j] : rotation[parent] * local[j];
    position[j] = parent < 0 ? Vector3d::Zero()
                             : Vector3d(position[parent] + rotation[parent] * joints[j].offset);
    end[j] = position[j] + rotation[j] * joints[j].tip;
    if (parent >= 0) end[parent] = position[j];
  }
  return end;
}

Vector3d bone_end(const MadeClip& hand, const HandPose& pose, const char* joint) {
  return bone_ends(hand.joints, pose)[hand.find(joint)];
}

void open_hand(HandPose& pose, int from) {
  for (int f = from; f < 4; ++f) {
    pose.knuckle[f] = 12.0;
    pose.middle[f] = 14.0;
    pose.end[f] = 8.0;
  }
}

/// What reaches: five angles of the thumb, then spread, knuckle and middle joint of one finger.
constexpr int kAngles = 8;
using Angles = Eigen::Matrix<double, kAngles, 1>;
using Residual = Eigen::Matrix<double, 3 + kAngles, 1>;
using Jacobian = Eigen::Matrix<double, 3 + kAngles, kAngles>;
const Angles kLow = (Angles() << 0, -20, -25, 0, -5, -14, 15, 20).finished();
const Angles kHigh = (Angles() << 62, 66, 34, 64, 75, 14, 88, 100).finished();
const Angles kHome = (Angles() << 34, 16, 5, 18, 22, 0, 50, 45).finished();

HandPose with_angles(HandPose pose, int finger, const Angles& x) {
  pose.thumb_palmar = x[0];
  pose.thumb_across = x[1];
  pose.thumb_turn = x[2];
  pose.thumb_bend = x[3];
  pose.thumb_end = x[4];
  if (finger == 0) return pose;
  pose.spread[finger - 1] = x[5];
  pose.knuckle[finger - 1] = x[6];
  pose.middle[finger - 1] = x[7];
  pose.end[finger - 1] = 0.6 * x[7];  // the end joint follows the middle one
  return pose;
}

/// One damped least-squares step; angles that stand at a bound and would leave it stay there.
Angles bounded_step(const Angles& x, const Jacobian& jacobian, const Residual& r, double damping) {
  Angles step = Angles::Zero(), movable = Angles::Ones();
  for (int round = 0; round < kAngles; ++round) {
    const Jacobian free = jacobian * movable.asDiagonal();
    Eigen::Matrix<double, kAngles, kAngles> a = free.transpose() * free;
    a.diagonal().array() += damping;
    step = -a.ldlt().solve(free.transpose() * r).cwiseProduct(movable);
    bool settled = true;
    for (int k = 0; k < kAngles; ++k) {
      const bool leaves = (x[k] <= kLow[k] && step[k] < 0.0) || (x[k] >= kHigh[k] && step[k] > 0.0);
      if (movable[k] == 0.0 || !leaves) continue;
      movable[k] = 0.0;
      settled = false;
    }
    if (settled) break;
  }
  return (x + step).cwiseMax(kLow).cwiseMin(kHigh);
}

/// Closes a gap (cm) with the thumb and, unless it is 0, one finger: Levenberg-Marquardt with a
/// weak pull to a relaxed hand. Always the same start and steps, so always the same answer.
template <class Gap>
HandPose reach(const HandPose& pose, int finger, const Gap& gap) {
  const auto residual = [&](const Angles& x) {
    Residual r;
    r.head<3>() = gap(with_angles(pose, finger, x));
    r.tail<kAngles>() = 3e-4 * (x - kHome);
    return r;
  };
  Angles x = kHome;
  double damping = 1e-4;
  for (int step = 0; step < 300; ++step) {
    const Residual r = residual(x);
    Jacobian jacobian;
    for (int k = 0; k < kAngles; ++k) {
      Angles moved = x;
      moved[k] += 1e-4;
      jacobian.col(k) = (residual(moved) - r) / 1e-4;
    }
    const Angles next = bounded_step(x, jacobian, r, damping);
    const bool better = residual(next).squaredNorm() < r.squaredNorm();
    if (better) x = next;
    damping = better ? std::max(damping * 0.3, 1e-9) : std::min(damping * 4.0, 1e3);
  }
  return with_angles(pose, finger, x);
}

/// Thumb and finger tip on tip. The palm hollows for the outer fingers.
HandPose pinch(const MadeClip& hand, int finger) {
  HandPose pose;
  open_hand(pose, 0);
  pose.cup = 9.0 * (finger - 1);
  const std::string tip = std::string("right") + kNames[finger] + "Distal";
  return reach(pose, finger, [&](const HandPose& p) -> Vector3d {
    return bone_end(hand, p, "rightThumbDistal") - bone_end(hand, p, tip.c_str());
  });
}

/// The thumb's tip at a place.
HandPose thumb_to(const MadeClip& hand, const HandPose& pose, const Vector3d& place) {
  return reach(pose, 0, [&](const HandPose& p) -> Vector3d {
    return bone_end(hand, p, "rightThumbDistal") - place;
  });
}

void fold(HandPose& pose, int finger) {
  pose.knuckle[finger] = 84.0;
  pose.middle[finger] = 98.0;
  pose.end[finger] = 62.0;
}

HandPose folded_fingers() {
  HandPose pose;
  for (int f = 0; f < 4; ++f) fold(pose, f);
  pose.spread = {-2.0, 0.0, 3.0, 6.0};
  pose.cup = 12.0;
  return pose;
}

/// Fingers counted from the index finger are up; the thumb holds the others down, or lies in the
/// palm when there are none.
HandPose count(const MadeClip& hand, int fingers) {
  HandPose pose = folded_fingers();
  for (int f = 0; f < fingers; ++f) {
    pose.knuckle[f] = pose.middle[f] = pose.end[f] = 2.0;
    pose.spread[f] = (1.5 - f) * 6.0;
  }
  if (fingers == 4) {
    pose.cup = 4.0;
    return thumb_to(hand, pose, {-7.2, -2.0, -1.0});
  }
  const std::string held = std::string("right") + kNames[std::max(fingers, 1) + 1];
  const Vector3d phalanx = 0.5 * (bone_end(hand, pose, (held + "Proximal").c_str()) +
                                  bone_end(hand, pose, (held + "Intermediate").c_str()));
  return thumb_to(hand, pose, phalanx + Vector3d(0, -1.5, 0.3));
}

HandPose spread_hand() {
  HandPose pose;
  pose.thumb_across = -18.0;
  pose.spread = {15.0, 3.0, -9.0, -18.0};
  pose.knuckle = {-8.0, -8.0, -8.0, -8.0};
  return pose;
}

}  // namespace

std::vector<MadeJoint> right_hand_joints(bool metacarpals) {
  std::vector<MadeJoint> joints = {{"rightHand"}};
  for (int f = 0; f < kFingers; ++f) {
    const FingerShape& shape = kShape[f];
    const std::string finger = std::string("right") + kNames[f];
    const Vector3d bone = f == 0 ? kThumbBone : Vector3d(-1, 0, 0);
    int parent = 0;
    Vector3d offset = shape.knuckle;
    if (f > 0 && metacarpals) {
      joints.push_back({finger + "Metacarpal", 0, shape.base});
      parent = int(joints.size()) - 1;
      offset = shape.knuckle - shape.base;
    }
    const std::array<const char*, 3> thumb = {"Metacarpal", "Proximal", "Distal"};
    const std::array<const char*, 3> other = {"Proximal", "Intermediate", "Distal"};
    for (int k = 0; k < 3; ++k) {
      joints.push_back({finger + (f == 0 ? thumb[k] : other[k]), parent, offset});
      parent = int(joints.size()) - 1;
      offset = shape.length[k] * bone;
    }
    joints.back().tip = offset;
  }
  return joints;
}

std::vector<Quaterniond> right_hand_rotations(const std::vector<MadeJoint>& joints,
                                              const HandPose& pose, double wrist_extension) {
  const Vector3d up = Vector3d::UnitY(), bend = Vector3d::UnitZ();
  std::vector<Quaterniond> local;
  for (const MadeJoint& joint : joints) {
    const std::string& name = joint.name;
    const auto is = [&](const char* part) { return name.find(part) != std::string::npos; };
    Quaterniond q = Quaterniond::Identity();
    if (is("Hand")) q = turn(-wrist_extension, bend);
    if (is("ThumbMetacarpal")) {
      const Vector3d swing = pose.thumb_palmar * kPalmarAxis + pose.thumb_across * kAcrossAxis;
      if (swing.norm() > 0.0) q = turn(swing.norm(), swing.normalized());
      q = q * turn(pose.thumb_turn, kThumbBone);
    }
    if (is("RingMetacarpal")) q = turn(0.5 * pose.cup, bend);
    if (is("LittleMetacarpal")) q = turn(pose.cup, bend);
    if (is("ThumbProximal")) q = turn(pose.thumb_bend, kThumbBendAxis);
    if (is("ThumbDistal")) q = turn(pose.thumb_end, kThumbBendAxis);
    for (int f = 0; f < 4; ++f) {
      if (!is(kNames[f + 1])) continue;
      if (is("Proximal")) q = turn(pose.spread[f], up) * turn(pose.knuckle[f], bend);
      if (is("Intermediate")) q = turn(pose.middle[f], bend);
      if (is("Distal")) q = turn(pose.end[f], bend);
    }
    local.push_back(q);
  }
  return local;
}

HandPose fist() {
  MadeClip hand;
  hand.joints = right_hand_joints(true);
  return count(hand, 0);
}

MadeClip hand_gestures() {
  MadeClip clip;
  clip.joints = right_hand_joints(true);
  HandPose relaxed;
  open_hand(relaxed, 0);
  HandPose folded = folded_fingers();  // fingers first, then the thumb over them
  folded.thumb_palmar = 30.0;

  struct Key {
    HandPose pose;
    double wrist;           // extension, degrees
    double move_s, hold_s;  // to get there, and there
  };
  std::vector<Key> keys = {
      {{}, 0, 0.0, 0.4},       {folded, 12, 0.45, 0.0},       {fist(), 15, 0.25, 0.4},
      {folded, 12, 0.25, 0.0}, {spread_hand(), 0, 0.45, 0.4}, {relaxed, 0, 0.4, 0.1}};
  for (int finger = 1; finger < kFingers; ++finger) {
    keys.push_back({pinch(clip, finger), 0, 0.4, 0.3});
    keys.push_back({relaxed, 0, 0.3, 0.0});
  }
  keys.push_back({folded, 0, 0.4, 0.0});
  for (int fingers = 1; fingers <= 4; ++fingers)
    keys.push_back({count(clip, fingers), 5, 0.35, 0.35});
  keys.push_back({spread_hand(), 5, 0.4, 0.4});
  keys.push_back({{}, 0, 0.5, 0.3});

  double arrived = 0.0;
  for (std::size_t k = 0; k < keys.size(); ++k) {
    const Key& from = keys[k == 0 ? 0 : k - 1];
    const Key& to = keys[k];
    const double leave = arrived;
    arrived = leave + to.move_s;
    const double until = arrived + to.hold_s;
    for (auto f = clip.frames.size(); double(f) / clip.rate_hz < until - 1e-9;
         f = clip.frames.size()) {
      const double t = to.move_s > 0.0 ? (double(f) / clip.rate_hz - leave) / to.move_s : 1.0;
      const double s = minimum_jerk(t);
      const double wrist = from.wrist + (to.wrist - from.wrist) * s;
      const HandPose pose = blend(from.pose, to.pose, s);
      clip.frames.push_back({Vector3d::Zero(), right_hand_rotations(clip.joints, pose, wrist)});
    }
    arrived = until;
  }
  return clip;
}

}  // namespace limber::generate
