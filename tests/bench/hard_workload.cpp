#include "tests/bench/hard_workload.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <random>
#include <stdexcept>
#include <string>

namespace limber::test {

namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kDegree = M_PI / 180.0;
constexpr double kPress = 0.006;  // m, of the right hand into the left one
constexpr int kFirstSolves = 150;
constexpr double kFingerSpeed = 0.4;  // rad/s, a little less than the source's fastest

/// A sum of three slow waves of at most `size`.
class Wave {
 public:
  Wave(std::mt19937_64& engine, double size) {
    for (int i = 0; i < 3; ++i) {
      std::uniform_real_distribution<double> unit(0.0, 1.0);
      size_[i] = size / 3.0 * (0.6 + 0.4 * unit(engine));
      rate_[i] = 2.0 * M_PI * (0.15 + 0.2 * i + 0.1 * unit(engine));  // up to 0.65 Hz
      phase_[i] = 2.0 * M_PI * unit(engine);
    }
  }
  double at(double t) const {
    double sum = 0.0;
    for (int i = 0; i < 3; ++i) sum += size_[i] * std::sin(rate_[i] * t + phase_[i]);
    return sum;
  }

 private:
  std::array<double, 3> size_{}, rate_{}, phase_{};
};

struct Wave3 {
  Wave x, y, z;
  Wave3(std::mt19937_64& engine, double size) : x(engine, size), y(engine, size), z(engine, size) {}
  Vector3d at(double t) const { return {x.at(t), y.at(t), z.at(t)}; }
};

std::int32_t joint_of(const Rig& rig, const std::string& role) {
  const std::int32_t joint = rig.find_role(role);
  if (joint == kNoJoint) throw std::runtime_error("no joint " + role);
  return joint;
}

RigEffector& effector_of(Rig& rig, const std::string& name) {
  for (RigEffector& effector : rig.effectors) {
    if (effector.name == name) return effector;
  }
  throw std::runtime_error("no effector " + name);
}

const std::array<const char*, 4> kFingers = {"Index", "Middle", "Ring", "Little"};

/// The pose's hinge or universal joint bent by `bend` about its last axis, `spread` about the
/// other.
void bend(const Rig& rig, const std::string& role, double by, double spread, Pose& pose) {
  const std::int32_t j = joint_of(rig, role);
  const RigJoint& joint = rig.joints[j];
  const int last = dof_count(joint.type) - 1;
  const auto clamped = [&](int k, double angle) {
    return std::clamp(angle, joint.limits[k].min, joint.limits[k].max);
  };
  Quaterniond r(Eigen::AngleAxisd(clamped(last, by), joint.axes[last]));
  if (last == 1) r = Quaterniond(Eigen::AngleAxisd(clamped(0, spread), joint.axes[0])) * r;
  pose[j] = DualQuaternion::from_rotation_translation(joint.rest * r, joint.offset);
}

/// Fists, each finger on waves of its own.
struct Fists {
  std::vector<Wave> waves;
  explicit Fists(std::mt19937_64& engine) {
    for (int i = 0; i < 2 * 4 * 3; ++i) waves.emplace_back(engine, 7.0 * kDegree);
  }
  void close(const Rig& rig, double t, Pose& pose) const {
    auto wave = waves.begin();
    for (const std::string side : {"left", "right"}) {
      for (const std::string finger : kFingers) {
        bend(rig, side + finger + "Proximal", 74.0 * kDegree + (wave++)->at(t), 0.0, pose);
        bend(rig, side + finger + "Intermediate", 94.0 * kDegree + (wave++)->at(t), 0.0, pose);
        bend(rig, side + finger + "Distal", 45.0 * kDegree + (wave++)->at(t), 0.0, pose);
      }
      bend(rig, side + "ThumbMetacarpal", 20.0 * kDegree, 0.0, pose);
      bend(rig, side + "ThumbProximal", 35.0 * kDegree, 0.0, pose);
      bend(rig, side + "ThumbDistal", 40.0 * kDegree, 0.0, pose);
    }
  }
};

/// Where the hands are: thumbs up, palms facing each other, left x = side > 0.
DualQuaternion hand_pose(double side, const Vector3d& middle, double apart) {
  const Vector3d x_left = Vector3d(-0.5 * side, 0.0, 0.85).normalized();
  Eigen::Matrix3d axes;
  // The rig's right hand has its bone along -x.
  axes.col(0) = side * x_left;
  axes.col(2) = Vector3d::UnitY();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  if (side < 0.0) axes.col(1) = -axes.col(1), axes.col(2) = -axes.col(2);
  return DualQuaternion::from_rotation_translation(Quaterniond(axes),
                                                   middle + side * apart * Vector3d::UnitX());
}

std::vector<EffectorTarget> targets_of(const Rig& rig, std::span<const DualQuaternion> world) {
  std::vector<EffectorTarget> targets;
  for (const RigEffector& effector : rig.effectors) {
    const DualQuaternion& joint = world[effector.joint];
    targets.push_back({.pose = DualQuaternion::from_rotation_translation(
                           joint.rotation(), joint.transform_point(effector.offset))});
  }
  return targets;
}

/// The source motion: trunk and hands by plain IK on waves, fingers set.
Clip make_source(const Rig& body, std::int64_t frames, double rate_hz, std::mt19937_64& engine) {
  Rig rig = body;
  std::erase_if(rig.effectors, [](const RigEffector& e) {
    return e.name.ends_with("_tip") && !e.name.ends_with("toe_tip");
  });
  for (const char* hand : {"l_hand", "r_hand"}) effector_of(rig, hand).weight_rot = 0.3;
  const Wave3 sway(engine, 0.02), reach(engine, 0.05), nod(engine, 0.15);
  const Fists fists(engine);
  Clip clip;
  clip.rate_hz = rate_hz;
  clip.joints = rig.size();
  Pose pose(rig.joints.size()), world(rig.joints.size());
  pose_from_coordinates(rig, std::vector<double>(dof_count(rig), 0.0), pose);
  model_from_local(skeleton_of(rig), pose, world);
  const std::vector<EffectorTarget> rest = targets_of(rig, world);
  Result<IkSolver> solver = IkSolver::create(rig, {.stop_at_tolerance = false});
  if (!solver) throw std::runtime_error(solver.error().message);
  for (std::int64_t f = 0; f < frames; ++f) {
    const double t = static_cast<double>(f) / rate_hz;
    std::vector<EffectorTarget> targets = rest;
    for (std::size_t e = 0; e < targets.size(); ++e) {
      const std::string& name = rig.effectors[e].name;
      EffectorTarget& target = targets[e];
      const Vector3d middle = Vector3d(0.0, 1.12, 0.36) + sway.at(t) + reach.at(t);
      if (name == "pelvis" || name == "head") {
        target.pose =
            DualQuaternion::from_translation(sway.at(t) - Vector3d(0, 0.09, 0)) * target.pose;
      } else if (name == "l_hand") {
        target.pose = hand_pose(1.0, middle, 0.03);
      } else if (name == "r_hand") {
        target.pose = hand_pose(-1.0, middle, 0.03);
      } else if (name.ends_with("elbow")) {
        target.weight = 0.0;
      }
      if (name == "head") {
        target.pose = target.pose * DualQuaternion::from_rotation(rotation_exp(nod.at(t)));
      }
    }
    fists.close(rig, t, pose);
    // The first frame starts at rest, far away: it is solved until it stays.
    for (int i = 0; i < (f == 0 ? 20 : 1); ++i) solver->solve(targets, pose);
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  return clip;
}

void add_rows(Rig& rig) {
  for (const std::string side : {"left", "right"}) {
    for (const std::string finger : kFingers) {
      rig.couplings.push_back({.from_joint = joint_of(rig, side + finger + "Intermediate"),
                               .to_joint = joint_of(rig, side + finger + "Distal"),
                               .ratio = 2.0 / 3.0});
    }
  }
  effector_of(rig, "r_hand").relative_to = joint_of(rig, "leftHand");
  // A finger that slips off another one snaps to its next rest: it is to take its time.
  for (RigJoint& joint : rig.joints) {
    bool finger = joint.role.find("Thumb") != std::string::npos;
    for (const char* name : kFingers) finger = finger || joint.role.find(name) != std::string::npos;
    if (finger) joint.max_speed = kFingerSpeed;
  }
}

}  // namespace

HardWorkload make_hard_workload(const Rig& body, std::int64_t frames, unsigned seed) {
  std::mt19937_64 engine(seed);
  HardWorkload work;
  work.tree_rig = body;
  for (RigEffector& effector : work.tree_rig.effectors) {
    const bool fingertip = effector.name.ends_with("_tip") && effector.kind == EffectorKind::pose;
    if (!fingertip) continue;
    effector.strong = false;
    effector.weight_pos = 0.5;
    effector.weight_rot = 0.2;
  }
  work.source = make_source(body, frames, work.rate_hz, engine);
  work.rig = work.tree_rig;
  add_rows(work.rig);
  // Until the cost stops falling: the fingertips have their say.
  work.tree_options.stop_at_tolerance = false;
  work.options = work.tree_options;
  work.options.collision = true;
  work.options.dt = 1.0 / work.rate_hz;
  const Skeleton skeleton = skeleton_of(body);
  const std::int32_t left = joint_of(body, "leftHand");
  Pose world(body.joints.size());
  for (std::int64_t f = 0; f < frames; ++f) {
    model_from_local(skeleton, work.source.frame(f), world);
    work.tree_targets.push_back(targets_of(work.tree_rig, world));
    work.targets.push_back(work.tree_targets.back());
    for (std::size_t e = 0; e < work.rig.effectors.size(); ++e) {
      if (work.rig.effectors[e].relative_to == kNoJoint) continue;
      DualQuaternion& pose = work.targets.back()[e].pose;
      pose = DualQuaternion::from_translation({kPress, 0.0, 0.0}) * pose;
      pose = world[left].conjugate() * pose;
    }
  }
  return work;
}

HardRun run_hard_workload(const HardWorkload& work, bool with_rows) {
  const Rig& rig = with_rows ? work.rig : work.tree_rig;
  const auto& targets = with_rows ? work.targets : work.tree_targets;
  Result<IkSolver> solver = IkSolver::create(rig, with_rows ? work.options : work.tree_options);
  if (!solver) throw std::runtime_error(solver.error().message);
  HardRun run;
  run.clip.rate_hz = work.rate_hz;
  run.clip.joints = rig.size();
  Pose pose(work.source.frame(0).begin(), work.source.frame(0).end());
  for (std::size_t f = 0; f < targets.size(); ++f) {
    // The first frame leaves the source's, as far as fingers may go at a time, until it stays.
    for (int i = 0; f == 0 && i < kFirstSolves; ++i) solver->solve(targets[0], pose);
    const auto start = std::chrono::steady_clock::now();
    run.reports.push_back(solver->solve(targets[f], pose));
    const auto end = std::chrono::steady_clock::now();
    run.us.push_back(std::chrono::duration<double, std::micro>(end - start).count());
    run.clip.parent_from_joint.insert(run.clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  return run;
}

}  // namespace limber::test
