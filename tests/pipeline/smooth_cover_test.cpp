// The laws of covers: nowhere below what they cover, bends bounded, nothing where nothing is.
#include "pipeline/smooth_cover.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

namespace limber {
namespace {

constexpr std::int64_t kReach = 5;
constexpr double kBend = 1e-3;

/// Bumps with kinks at their feet and a lone spike, from -0.1 up.
std::vector<double> rough() {
  std::vector<double> v;
  for (int f = 0; f < 300; ++f) {
    const double bump = 0.3 * std::max(0.0, std::sin(0.02 * f)) + (f == 250 ? 0.2 : 0.0);
    v.push_back(bump - 0.1 + 0.01 * std::max(0.0, std::sin(1.7 * f)));
  }
  return v;
}

TEST(SmoothCover, WindowIsAnEvenAverage) {
  const std::vector<double> w = smooth_window(kReach);
  ASSERT_EQ(w.size(), 2u * kReach + 1);
  EXPECT_NEAR(std::accumulate(w.begin(), w.end(), 0.0), 1.0, 1e-12);
  for (std::size_t k = 0; k < w.size(); ++k) EXPECT_NEAR(w[k], w[w.size() - 1 - k], 1e-15);
}

TEST(SmoothCover, MeanKeepsAStraightLineAwayFromTheEnds) {
  std::vector<double> line;
  for (int f = 0; f < 40; ++f) line.push_back(0.5 * f - 3.0);
  const std::vector<double> mean = smooth_mean<double>(line, smooth_window(kReach));
  for (std::size_t f = kReach; f + kReach < line.size(); ++f) EXPECT_NEAR(mean[f], line[f], 1e-12);
}

TEST(SmoothCover, IsNowhereBelow) {
  const std::vector<double> v = rough(), cover = smooth_cover(v, kReach, kBend);
  for (std::size_t f = 0; f < v.size(); ++f) EXPECT_GE(cover[f], v[f] - 1e-12) << f;
}

/// Maxima and averages of functions that bend down by so much do so by no more (at the ends, where
/// the motion begins and stops, nothing is asked; here it is level there).
TEST(SmoothCover, BendsDownNoMoreThanAsked) {
  const std::vector<double> cover = smooth_cover(rough(), kReach, kBend);
  for (std::size_t f = 1; f + 1 < cover.size(); ++f) {
    EXPECT_GE(cover[f - 1] - 2.0 * cover[f] + cover[f + 1], -kBend - 1e-12) << f;
  }
}

TEST(SmoothCover, RisesInTimeForASpike) {
  std::vector<double> v(200, 0.0);
  v[100] = 0.05;
  const std::vector<double> cover = smooth_cover(v, kReach, kBend);
  // A parabola of that bend is 0.05 high after sqrt(2 * 0.05 / kBend) = 10 frames.
  EXPECT_GE(cover[100], 0.05 - 1e-12);
  EXPECT_GT(cover[95], 0.02);
  EXPECT_EQ(cover[100 - 10 - 2 * kReach - 1], 0.0);
  EXPECT_EQ(cover[100 + 10 + 2 * kReach + 1], 0.0);
}

TEST(SmoothCover, OfALevelIsTheLevel) {
  for (const double level : smooth_cover(std::vector<double>(30, -0.07), kReach, kBend)) {
    EXPECT_NEAR(level, -0.07, 1e-15);
  }
}

}  // namespace
}  // namespace limber
