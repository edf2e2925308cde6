// Feet that stand: flat, on the floor, in one place; feet in the air: as they were.
#include "pipeline/foot_contacts.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kRate = 60.0;
constexpr std::int64_t kStands = 60, kLifts = 30;  // frames
constexpr double kPitch = 4.0 * std::numbers::pi / 180.0;

/// Stands for a second, its toes a little up as recorded feet have them, swings 30 cm high and 60
/// cm far, and stands again.
FootPath step() {
  FootPath path;
  path.rate_hz = kRate;
  path.heel = {0.0, -0.08, -0.05};
  path.ball = {0.0, -0.08, 0.13};
  path.toe_joint = {0.0, -0.06, 0.13};
  path.tip = {0.0, -0.08, 0.19};
  const Quaterniond pitched(AngleAxisd(-kPitch, Vector3d::UnitX()));
  for (std::int64_t f = 0; f < kStands + kLifts + kStands; ++f) {
    const double t = std::clamp(double(f - kStands) / kLifts, 0.0, 1.0);
    const Vector3d ankle(0.0, 0.08 + 0.3 * std::pow(std::sin(std::numbers::pi * t), 2), 0.6 * t);
    path.source_ankle.push_back(ankle);
    path.source_toe.push_back(ankle + Vector3d(0.0, -0.06, 0.13));
    path.ankle.push_back(ankle + Vector3d(0.0, 0.01, 0.0));
    path.foot_turn.push_back(pitched);
    path.toes_turn.push_back(Quaterniond::Identity());
  }
  return path;
}

double height(const FootPath& path, std::int64_t f, const Vector3d& sole_point) {
  return (path.ankle[f] + path.foot_turn[f] * sole_point).y() - path.floor_y;
}

TEST(FootContacts, AStandingFootLiesFlatOnTheFloor) {
  FootPath path = step();
  plant(path, 0.08, 0.02);
  for (const std::int64_t f : {kStands / 2, kStands + kLifts + kStands / 2}) {
    ASSERT_EQ(path.contact[f], 1);
    EXPECT_NEAR(height(path, f, path.heel), 0.0, 1e-9) << f;
    EXPECT_NEAR(height(path, f, path.ball), 0.0, 1e-9) << f;
    EXPECT_EQ(path.hold[f], 1.0);
  }
}

TEST(FootContacts, AFootInTheAirKeepsItsTurnAndIsHeldByLittle) {
  const FootPath before = step();
  FootPath path = before;
  plant(path, 0.08, 0.02);
  const std::int64_t highest = kStands + kLifts / 2;
  EXPECT_EQ(path.contact[highest], 0);
  EXPECT_LT(path.foot_turn[highest].angularDistance(before.foot_turn[highest]), 1e-12);
  EXPECT_EQ(path.hold[highest], 0.0);
}

TEST(FootContacts, NoPartOfTheSoleIsBelowTheFloorInAnyFrame) {
  FootPath path = step();
  plant(path, 0.08, 0.02);
  for (std::int64_t f = 0; f < std::ssize(path.ankle); ++f) {
    EXPECT_GE(height(path, f, path.heel), -1e-12) << f;
    EXPECT_GE(height(path, f, path.ball), -1e-12) << f;
  }
}

/// A foot is flattened by ten degrees at most: one that stands on its toes stays there.
TEST(FootContacts, AFootOnItsToesStaysOnItsToes) {
  FootPath path = step();
  const Quaterniond on_toes(AngleAxisd(40.0 * std::numbers::pi / 180.0, Vector3d::UnitX()));
  for (Quaterniond& turn : path.foot_turn) turn = on_toes;
  plant(path, 0.08, 0.02);
  EXPECT_GT(height(path, kStands / 2, path.heel), 0.05);
  EXPECT_NEAR(height(path, kStands / 2, path.ball), 0.0, 1e-9);
}

/// Turns change gradually: nothing is flattened from one frame to the next.
TEST(FootContacts, FlatteningComesAndGoesSmoothly) {
  FootPath path = step();
  plant(path, 0.08, 0.02);
  for (std::int64_t f = 1; f < std::ssize(path.ankle); ++f) {
    EXPECT_LT(path.foot_turn[f].angularDistance(path.foot_turn[f - 1]), 0.5 * kPitch) << f;
  }
}

}  // namespace
}  // namespace limber
