// Laws of rest alignment: what a motion looks like does not hang on the rest pose that its file
// happens to have, nor on how its joints' axes lie.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "pipeline/retarget.h"
#include "pipeline/target.h"
#include "tests/pipeline/performance.h"
#include "tests/pipeline/program.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using limber_test::Performance;
using limber_test::posed_clip;
using limber_test::read_performance;

constexpr double kDeg = M_PI / 180.0;

/// [joint] World rotation from the T-pose to a rest pose.
using Turns = std::vector<Quaterniond>;

/// Every joint of both arms turned about Z, the left one by `deg`, the right one in mirror image.
Turns arms_lowered(const Performance& t_pose, double deg) {
  Turns out(t_pose.calibration.model_from_joint.size(), Quaterniond::Identity());
  for (const Side side : {Side::left, Side::right}) {
    const double angle = (side == Side::left ? -deg : deg) * kDeg;
    const std::int32_t arm = t_pose.figure.at(on_side(Role::leftUpperArm, side));
    std::vector<std::uint8_t> in_arm(out.size(), 0);
    for (const std::int32_t j : t_pose.figure.order) {
      const std::int32_t parent = t_pose.figure.parents[j];
      in_arm[j] = j == arm || (parent != kNoJoint && in_arm[parent] != 0);
      if (in_arm[j] != 0) out[j] = Quaterniond(AngleAxisd(angle, Vector3d::UnitZ()));
    }
  }
  return out;
}

/// A rest pose that is no pose: every joint turned anyhow.
Turns folded(const Performance& t_pose) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  Turns out;
  for (std::size_t j = 0; j < t_pose.calibration.model_from_joint.size(); ++j) {
    out.push_back(Quaterniond(normal(random), normal(random), normal(random), normal(random)));
    out.back().normalize();
  }
  return out;
}

/// The same motion on a skeleton whose rest pose is the T-pose turned by `turns` and whose joints'
/// axes are the world's there, as a BVH file's are.
Performance with_rest(const Performance& from, const Turns& turns) {
  Performance out = from;
  const Skeleton& skeleton = from.character.skeleton;
  const std::size_t n = skeleton.parents.size();
  std::vector<Quaterniond> new_from_old(n);
  std::vector<DualQuaternion> model(n);
  for (std::size_t j = 0; j < n; ++j) {
    new_from_old[j] = turns[j] * from.calibration.model_from_joint[j].rotation();
  }
  const auto convert = [&](std::span<const DualQuaternion> local, std::span<DualQuaternion> to) {
    model_from_local(skeleton, local, model);
    for (std::size_t j = 0; j < n; ++j) {
      model[j] = DualQuaternion::from_rotation_translation(
          model[j].rotation() * new_from_old[j].conjugate(), model[j].translation());
    }
    local_from_model(skeleton, model, to);
  };
  for (std::int64_t f = 0; f < from.clip.frames(); ++f) {
    convert(from.clip.frame(f), {out.clip.parent_from_joint.data() + std::size_t(f) * n, n});
  }
  Pose t_pose(n);
  local_from_model(skeleton, from.calibration.model_from_joint, t_pose);
  convert(t_pose, out.character.skeleton.rest_parent_from_joint);
  for (DualQuaternion& rest : out.character.skeleton.rest_parent_from_joint) {
    rest = DualQuaternion::from_rotation_translation(Quaterniond::Identity(), rest.translation());
  }
  return out;
}

/// Five frames of the T-pose come first.
Performance after_t_pose(Performance performance) {
  Pose pose(performance.calibration.model_from_joint.size());
  local_from_model(performance.character.skeleton, performance.calibration.model_from_joint, pose);
  auto& frames = performance.clip.parent_from_joint;
  for (int f = 0; f < 5; ++f) frames.insert(frames.begin(), pose.begin(), pose.end());
  return performance;
}

Retargeted retargeted(const Performance& performance, const Target& target) {
  const auto calibration =
      calibrate(performance.character, performance.figure, {}, {}, &performance.clip);
  EXPECT_TRUE(calibration);
  RetargetOptions options;
  options.refine = RefineMode::none;
  auto out =
      retarget_clip({&performance.character, &performance.figure, &*calibration, &performance.clip},
                    target, options);
  EXPECT_TRUE(out);
  return std::move(*out);
}

/// Largest angle (degrees) between the joints of two results.
double difference_deg(const Target& target, const Clip& a, const Clip& b) {
  EXPECT_EQ(a.frames(), b.frames());
  const Skeleton& skeleton = target.character.skeleton;
  std::vector<DualQuaternion> ma(skeleton.parents.size()), mb(skeleton.parents.size());
  double out = 0.0;
  for (std::int64_t f = 0; f < a.frames(); ++f) {
    model_from_local(skeleton, a.frame(f), ma);
    model_from_local(skeleton, b.frame(f), mb);
    for (std::size_t j = 0; j < ma.size(); ++j) {
      out = std::max(out, rotation_angle(ma[j].rotation(), mb[j].rotation()) / kDeg);
    }
  }
  return out;
}

TEST(RestPose, OneMotionOnAnyRestGivesOneResult) {
  const auto target = load_target("biped-full", {});
  ASSERT_TRUE(target);
  const Performance source =
      after_t_pose(read_performance(limber_test::own_clip("body_range_of_motion.bvh")));
  const Turns t_pose(source.calibration.model_from_joint.size(), Quaterniond::Identity());
  const Clip expected = retargeted(with_rest(source, t_pose), *target).clip;
  const std::pair<const char*, Turns> rests[] = {{"A", arms_lowered(source, 45.0)},
                                                 {"arms down", arms_lowered(source, 80.0)},
                                                 {"folded", folded(source)}};
  for (const auto& [name, turns] : rests) {
    const Clip clip = retargeted(with_rest(source, turns), *target).clip;
    EXPECT_LT(difference_deg(*target, clip, expected), 0.5) << name;
  }
}

/// Hanging arms that swing, turn and bend, and legs that step on the spot. Nobody stands in a
/// T-pose.
Quaterniond stepping(Role role, int frame) {
  const double out = side_of(role) == Side::left ? 1.0 : -1.0, phase = 0.3 * frame + out;
  const auto turn = [](double angle, const Vector3d& axis) {
    return Quaterniond(AngleAxisd(angle, axis));
  };
  switch (side_of(role) == Side::right ? mirrored(role) : role) {
    case Role::leftUpperArm:
      return turn(-1.2 * out, Vector3d::UnitZ()) * turn(0.5 * std::sin(phase), Vector3d::UnitX());
    case Role::leftLowerArm:
      return turn(-out * (0.8 + 0.5 * std::cos(phase)), Vector3d::UnitY());
    case Role::leftUpperLeg:
      return turn(-0.6 - 0.5 * std::sin(phase), Vector3d::UnitX());
    case Role::leftLowerLeg:
      return turn(0.6 + 0.5 * std::sin(phase), Vector3d::UnitX());
    default:
      return Quaterniond::Identity();
  }
}

TEST(RestPose, BendingElbowsAndKneesTellHowLimbsAreTurned) {
  Performance source = read_performance(limber_test::own_clip("body_range_of_motion.bvh"));
  source.clip = posed_clip(source, 60, stepping);
  const Turns turns = folded(source);
  const Performance performance = with_rest(source, turns);
  const auto calibration =
      calibrate(performance.character, performance.figure, {}, {}, &performance.clip);
  ASSERT_TRUE(calibration);
  EXPECT_EQ(calibration->reference, "motion");
  for (const Role left :
       {Role::leftUpperArm, Role::leftLowerArm, Role::leftUpperLeg, Role::leftLowerLeg}) {
    for (const Side side : {Side::left, Side::right}) {
      const std::int32_t j = source.figure.at(on_side(left, side));
      EXPECT_LT(
          rotation_angle(calibration->model_from_joint[j].rotation(), turns[j].conjugate()) / kDeg,
          1e-6)
          << name_of(on_side(left, side));
    }
  }
}

}  // namespace
}  // namespace limber
