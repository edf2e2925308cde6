// Laws of clips that go round.
#include <gtest/gtest.h>

#include <cmath>

#include "pipeline/retarget.h"
#include "pipeline/source_cycle.h"
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

constexpr int kPeriod = 40;
constexpr double kDeg = M_PI / 180.0;

/// A walk: legs step, arms swing.
Quaterniond walking(Role role, int frame) {
  const double out = side_of(role) == Side::left ? 1.0 : -1.0;
  const double phase = 2.0 * M_PI * frame / kPeriod + (out > 0.0 ? 0.0 : M_PI);
  const auto turn = [](double angle, const Vector3d& axis) {
    return Quaterniond(AngleAxisd(angle, axis));
  };
  switch (side_of(role) == Side::right ? mirrored(role) : role) {
    case Role::leftUpperArm:
      return turn(-1.3 * out, Vector3d::UnitZ()) *
             turn(-0.5 * out * std::sin(phase), Vector3d::UnitY());
    case Role::leftLowerArm:
      return turn(-out * (0.6 + 0.3 * std::sin(phase)), Vector3d::UnitY());
    case Role::leftUpperLeg:
      return turn(-0.15 - 0.4 * std::sin(phase), Vector3d::UnitX());
    case Role::leftLowerLeg:
      return turn(0.45 + 0.4 * std::cos(phase), Vector3d::UnitX());
    default:
      return Quaterniond::Identity();
  }
}

/// Where a walk round a circle has come to.
DualQuaternion on_circle(int frame) {
  const Quaterniond turn(AngleAxisd(0.8 * frame / kPeriod, Vector3d::UnitY()));
  return DualQuaternion::from_rotation_translation(turn, turn * Vector3d(1.5, 0.0, 0.0));
}

/// `frames` of the walk, from frame `first` of it on.
Performance walk(int first, int frames) {
  Performance out =
      limber_test::read_performance(limber_test::own_clip("body_range_of_motion.bvh"));
  out.clip = posed_clip(
      out, frames, [first](Role role, int f) { return walking(role, f + first); },
      [first](int f) { return on_circle(f + first); });
  return out;
}

std::optional<SourceCycle> cycle_of(const Performance& source) {
  return find_cycle({&source.character, &source.figure, &source.calibration, &source.clip});
}

Retargeted retargeted(const Performance& source, const Target& target) {
  RetargetOptions options;
  options.refine = RefineMode::none;
  auto out = retarget_clip({&source.character, &source.figure, &source.calibration, &source.clip},
                           target, options);
  EXPECT_TRUE(out);
  return std::move(*out);
}

TEST(Cycle, IsFoundWithTheMotionOfALap) {
  for (const int frames : {kPeriod, kPeriod + 1}) {
    const auto cycle = cycle_of(walk(3, frames));
    ASSERT_TRUE(cycle) << frames;
    EXPECT_EQ(cycle->period, kPeriod);
    EXPECT_EQ(cycle->repeats_first, frames > kPeriod);
    EXPECT_NEAR(rotation_angle(cycle->lap.rotation(), Quaterniond::Identity()), 0.8, 1e-3);
    EXPECT_NEAR(cycle->way_m, 2.0 * 1.5 * std::sin(0.4), 5e-3);  // a chord
  }
}

TEST(Cycle, IsNotSeenInWhatDoesNotClose) {
  EXPECT_FALSE(cycle_of(walk(0, kPeriod - 5)));
  EXPECT_FALSE(cycle_of(walk(0, kPeriod + 5)));
  Performance still = walk(0, kPeriod);
  still.clip = posed_clip(still, kPeriod, [](Role role, int) { return walking(role, 0); });
  EXPECT_FALSE(cycle_of(still));
}

TEST(Cycle, ComesOutTheSameWhereverItBegins) {
  const auto target = load_target("biped-full", {});
  ASSERT_TRUE(target);
  const Retargeted whole = retargeted(walk(0, kPeriod), *target);
  ASSERT_TRUE(whole.cycle);
  EXPECT_LT(whole.cycle->seam_deg, 0.01);
  EXPECT_LT(whole.cycle->seam_mm, 0.01);
  for (const int first : {7, 20, 33}) {
    const Retargeted later = retargeted(walk(first, kPeriod), *target);
    double apart_deg = 0.0;
    for (int f = 0; f < kPeriod; ++f) {
      const auto a = whole.clip.frame((f + first) % kPeriod), b = later.clip.frame(f);
      for (std::int32_t j = 0; j < whole.clip.joints; ++j) {
        if (j == target->figure.root()) continue;
        apart_deg = std::max(apart_deg, rotation_angle(a[j].rotation(), b[j].rotation()) / kDeg);
      }
    }
    EXPECT_LT(apart_deg, 0.05) << "from frame " << first;
  }
}

}  // namespace
}  // namespace limber
