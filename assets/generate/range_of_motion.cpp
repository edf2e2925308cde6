#include "assets/generate/range_of_motion.h"

#include <algorithm>
#include <cmath>

#include "assets/generate/hand_gestures.h"
#include "assets/generate/track.h"

namespace limber::generate {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kRadians = EIGEN_PI / 180.0;
constexpr double kThigh = 42.0, kShank = 41.0, kAnkleHeight = 8.0, kHipWidth = 9.0, kHipDrop = 5.0;
constexpr double kHipsHeight = kHipDrop + kThigh + kShank + kAnkleHeight;
constexpr double kPace = 1.3;       // seconds per count of the score
constexpr double kDuration = 20.6;  // counts

Quaterniond turn(double degrees, const Vector3d& axis) {
  return Quaterniond(AngleAxisd(degrees * kRadians, axis));
}

/// Rotation by a vector of degrees.
Quaterniond swing(const Vector3d& degrees) {
  const double angle = degrees.norm();
  return angle > 0.0 ? turn(angle, degrees / angle) : Quaterniond::Identity();
}

// ---- the score: what moves when (counts, degrees or cm). Left and right differ where it says so.

struct Score {
  // trunk: forward bend, bend to the left, turn to the left
  Track bend{{9.2, 0}, {9.7, 45}, {10.2, 0}, {10.5, 0}, {11.2, 30}, {11.5, 30}, {12.2, 0}};
  Track lean{{8.2, 0}, {8.6, 24}, {9.0, -24}, {9.4, 0}};
  Track twist{{7.0, 0}, {7.5, 45}, {8.1, -45}, {8.5, 0}};
  // head: nod down, tilt to the left, turn to the left
  Track nod{{2.9, 0}, {3.2, 38}, {3.6, -35}, {3.9, 0}};
  Track tilt{{3.8, 0}, {4.1, 28}, {4.5, -28}, {4.8, 0}};
  Track look{{1.6, 0}, {2.0, 60}, {2.6, -60}, {3.0, 0}};
  // arms from the T-pose: raised, swung forward, turned inwards; clavicle raised
  Track raise{{0.6, 0},    {1.4, -76},  {4.3, -76},  {5.1, 62},   {5.2, 62},   {6.0, -76},
              {6.1, -76},  {6.6, -8},   {6.7, -8},   {7.2, -66},  {10.3, -66}, {11.0, -10},
              {11.7, -10}, {12.2, -72}, {17.6, -72}, {18.1, -40}, {19.5, -40}, {20.2, 0}};
  Track forward{{0.6, 0},   {1.4, 6},  {6.1, 6},   {6.6, 72},  {6.7, 72},
                {7.2, -16}, {7.5, 4},  {10.3, 4},  {11.0, 70}, {11.7, 70},
                {12.2, 5},  {17.6, 5}, {18.1, 45}, {19.5, 45}, {20.2, 0}};
  Track shrug{{0.6, 0},  {1.4, -4}, {4.3, -4},  {5.1, 26},
              {5.2, 26}, {6.0, -4}, {19.5, -4}, {20.2, 0}};
  Track elbow{{0.6, 0},   {1.4, 12},  {4.3, 12},  {5.1, 8},   {5.2, 8},    {6.0, 12},
              {6.6, 5},   {6.7, 5},   {7.2, 15},  {12.3, 15}, {12.7, 125}, {13.0, 125},
              {13.4, 15}, {17.6, 15}, {18.1, 80}, {19.5, 80}, {20.2, 0}};
  Track forearm{{12.3, 0}, {12.6, -55}, {12.7, -55}, {13.05, 40}, {13.4, 0}};
  Track wrist{{18.0, 0}, {18.3, 35}, {18.6, -35}, {18.9, 0}};
  Track fingers{{12.3, 0}, {12.6, 1}, {13.0, 1}, {13.4, 0}, {18.2, 0},
                {18.5, 1}, {18.8, 0}, {19.1, 1}, {19.4, 1}, {19.9, 0}};
  // hips: down, to the left, forward (the squat sits back)
  Track down{{0.6, 0},   {1.2, 1.6},  {10.3, 1.6}, {11.1, 36},
             {11.5, 36}, {12.3, 1.6}, {19.5, 1.6}, {20.2, 0}};
  Track across{{13.2, 0}, {13.6, -8}, {14.9, -8}, {15.3, 8}, {16.5, 8}, {16.7, 0}};
  Track back{{10.3, 0}, {11.1, 12}, {11.5, 12}, {12.3, 0}};
  // feet: height, forward, outwards
  Track left_up{{13.6, 0}, {14.0, 44}, {14.2, 44}, {14.5, 12}, {14.9, 0}};
  Track left_forward{{13.6, 0}, {14.0, 30}, {14.2, 30}, {14.5, 0}};
  Track left_out{{14.1, 0}, {14.5, 24}, {14.9, 0}};
  Track right_up{{15.3, 0}, {15.6, 44}, {15.8, 44}, {16.1, 12}, {16.5, 0}};
  Track right_forward{{15.3, 0}, {15.6, 30}, {15.8, 30}, {16.1, 0}};
  Track right_out{{15.7, 0}, {16.1, 24}, {16.5, 0}};
};

constexpr double kStepsBegin = 16.7, kStep = 0.4;  // four steps, the left foot first

/// Height of a foot that steps, 0 to 1.
double step_height(double t, bool left) {
  const double phase = (t - kStepsBegin) / kStep;
  if (phase < 0.0 || phase >= 4.0) return 0.0;
  if ((int(phase) % 2 == 0) != left) return 0.0;
  const double s = std::sin(EIGEN_PI * (phase - std::floor(phase)));
  return s * s;
}

/// Which leg steps: 1 the left one at its highest, -1 the right one.
double stepping(double t) { return step_height(t, true) - step_height(t, false); }

// ---- the body

struct Body {
  std::vector<MadeJoint> joints;

  int add(const std::string& name, const std::string& parent, const Vector3d& offset,
          const Vector3d& tip = Vector3d::Zero()) {
    int p = -1;
    for (int i = 0; i < int(joints.size()); ++i) {
      if (joints[i].name == parent) p = i;
    }
    joints.push_back({name, p, offset, tip});
    return int(joints.size()) - 1;
  }
};

std::string mirrored_name(const std::string& right) { return "left" + right.substr(5); }
Vector3d mirrored(const Vector3d& v) { return {-v.x(), v.y(), v.z()}; }
/// The mirror image of a rotation: axes are pseudovectors.
Quaterniond mirrored(const Quaterniond& q) { return {q.w(), q.x(), -q.y(), -q.z()}; }

std::vector<MadeJoint> body_joints() {
  Body body;
  body.add("hips", "", {0, kHipsHeight, 0});
  body.add("spine", "hips", {0, 9, 0});
  body.add("chest", "spine", {0, 12, 0});
  body.add("upperChest", "chest", {0, 13, 0});
  body.add("neck", "upperChest", {0, 18, 0});
  body.add("head", "neck", {0, 9, 1}, {0, 18, 0});
  const std::vector<MadeJoint> hand = right_hand_joints(false);
  for (const bool left : {true, false}) {
    const std::string side = left ? "left" : "right";
    const double s = left ? 1.0 : -1.0;
    body.add(side + "Shoulder", "upperChest", {3 * s, 13, 0});
    body.add(side + "UpperArm", side + "Shoulder", {14 * s, 0, 0});
    body.add(side + "LowerArm", side + "UpperArm", {28 * s, 0, 0});
    const int wrist = body.add(side + "Hand", side + "LowerArm", {25 * s, 0, 0});
    for (std::size_t j = 1; j < hand.size(); ++j) {
      MadeJoint joint = hand[j];
      joint.parent += wrist;
      if (left) {
        joint = {mirrored_name(joint.name), joint.parent, mirrored(joint.offset),
                 mirrored(joint.tip)};
      }
      body.joints.push_back(joint);
    }
  }
  for (const bool left : {true, false}) {
    const std::string side = left ? "left" : "right";
    const double s = left ? 1.0 : -1.0;
    body.add(side + "UpperLeg", "hips", {kHipWidth * s, -kHipDrop, 0});
    body.add(side + "LowerLeg", side + "UpperLeg", {0, -kThigh, 0});
    body.add(side + "Foot", side + "LowerLeg", {0, -kShank, 0});
    body.add(side + "Toes", side + "Foot", {0, -6, 13}, {0, 0, 7});
  }
  return body.joints;
}

/// World rotations of thigh and shank that bring the ankle to its place, the knee pointing ahead.
struct Leg {
  Quaterniond thigh, shank;
};
Leg reach(const Vector3d& hip, const Vector3d& ankle, const Vector3d& ahead) {
  const Vector3d to_ankle = ankle - hip;
  const double r = std::min(to_ankle.norm(), kThigh + kShank);
  const auto angle = [](double cosine) { return std::acos(std::clamp(cosine, -1.0, 1.0)); };
  const double knee = angle((r * r - kThigh * kThigh - kShank * kShank) / (2.0 * kThigh * kShank));
  const double lift = angle((kThigh * kThigh + r * r - kShank * kShank) / (2.0 * kThigh * r));
  const Vector3d down = to_ankle.normalized();
  const Vector3d knee_axis = ahead.cross(down).normalized();
  Eigen::Matrix3d m;
  m.col(0) = knee_axis;
  m.col(1) = -(AngleAxisd(-lift, knee_axis) * down);
  m.col(2) = m.col(0).cross(m.col(1));
  const Quaterniond thigh(m);
  return {thigh, thigh * Quaterniond(AngleAxisd(knee, Vector3d::UnitX()))};
}

class Dancer {
 public:
  explicit Dancer(const MadeClip& clip) : clip_(clip), hand_(right_hand_joints(false)) {}

  /// The body at count t of the score.
  MadeFrame at(double t) {
    frame_.local.assign(clip_.joints.size(), Quaterniond::Identity());
    const double sway = -5.0 * stepping(t);  // over the standing foot
    frame_.root = {score_.across.at(t) + sway, kHipsHeight - score_.down.at(t), -score_.back.at(t)};
    trunk(t);
    for (const bool left : {true, false}) {
      arm(t, left);
      leg(t, left);
    }
    return frame_;
  }

 private:
  Quaterniond& local(const std::string& name) { return frame_.local[clip_.find(name)]; }

  void trunk(double t) {
    const Vector3d whole(score_.bend.at(t), score_.twist.at(t), -score_.lean.at(t));
    for (const char* joint : {"spine", "chest", "upperChest"}) local(joint) = swing(whole / 3.0);
    const Vector3d head(score_.nod.at(t), score_.look.at(t), -score_.tilt.at(t));
    for (const char* joint : {"neck", "head"}) local(joint) = swing(head / 2.0);
  }

  /// Written for the right side (the arm along -X) and mirrored.
  void arm(double t, bool left) {
    const std::string side = left ? "left" : "right";
    const auto set = [&](const std::string& joint, const Quaterniond& right) {
      local(side + joint) = left ? mirrored(right) : right;
    };
    const double step = 16.0 * stepping(t) * (left ? -1.0 : 1.0);
    set("Shoulder", swing({0, 0, -score_.shrug.at(t)}));
    set("UpperArm", swing({0, score_.forward.at(t) + step, -score_.raise.at(t)}));
    set("LowerArm", turn(score_.elbow.at(t) + std::abs(step), Vector3d::UnitY()) *
                        turn(score_.forearm.at(t), Vector3d::UnitX()));
    HandPose pose = fist_;
    const double s = score_.fingers.at(t);
    for (double* angle : {&pose.thumb_palmar, &pose.thumb_across, &pose.thumb_turn,
                          &pose.thumb_bend, &pose.thumb_end}) {
      *angle *= s;
    }
    for (auto* angles : {&pose.spread, &pose.knuckle, &pose.middle, &pose.end}) {
      for (double& angle : *angles) angle *= s;
    }
    const std::vector<Quaterniond> hand = right_hand_rotations(hand_, pose, score_.wrist.at(t));
    for (std::size_t j = 0; j < hand.size(); ++j) set(hand_[j].name.substr(5), hand[j]);
  }

  void leg(double t, bool left) {
    const std::string side = left ? "left" : "right";
    const double s = left ? 1.0 : -1.0;
    const double up = (left ? score_.left_up : score_.right_up).at(t) + 14.0 * step_height(t, left);
    const double ahead =
        (left ? score_.left_forward : score_.right_forward).at(t) + 6.0 * step_height(t, left);
    const double out = (left ? score_.left_out : score_.right_out).at(t);
    const Vector3d ankle(s * (kHipWidth + out), kAnkleHeight + up, ahead);
    const Vector3d hip = frame_.root + Vector3d(s * kHipWidth, -kHipDrop, 0);
    const Leg bent = reach(hip, ankle, Vector3d::UnitZ());
    const Quaterniond foot =
        turn(std::min(up, 25.0), Vector3d::UnitX());  // toes hang when it lifts
    local(side + "UpperLeg") = bent.thigh;
    local(side + "LowerLeg") = bent.thigh.conjugate() * bent.shank;
    local(side + "Foot") = bent.shank.conjugate() * foot;
  }

  const MadeClip& clip_;
  const std::vector<MadeJoint> hand_;
  const Score score_;
  const HandPose fist_ = fist();
  MadeFrame frame_;
};

}  // namespace

MadeClip range_of_motion() {
  MadeClip clip;
  clip.joints = body_joints();
  Dancer dancer(clip);
  const int frames = int(kDuration * kPace * clip.rate_hz) + 1;
  for (int f = 0; f < frames; ++f) clip.frames.push_back(dancer.at(f / clip.rate_hz / kPace));
  return clip;
}

}  // namespace limber::generate
