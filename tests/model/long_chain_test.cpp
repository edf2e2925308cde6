// Drift laws of long products. One rounding errs by at most u (unit roundoff); a product of unit
// forms errs by a few u. Errors of unlike steps are unlike, so after n they have walked about
// sqrt(n) of them; errors of one repeated step are alike, so they add up to n of them. Mending
// makes a product rigid again; where it went astray it does not know.
//
// One form is worse: a quaternion whose length is 1 + d turns a vector wrongly by some d of it, and
// that is not taken back. d walks, so over unlike vectors the position's error grows with
// sum sqrt(k) of random signs, that is with n. The dual quaternion's product carries its length as
// a common factor, which comes off at the end.

#include "tests/model/long_chain.h"

#include <gtest/gtest.h>

#include "tests/model/random_motion.h"

namespace limber::test {
namespace {

/// About eight standard deviations of what one product adds to any entry of A'A - 1 (at most 8
/// times the error of a quaternion's length: A = |q|^2 R + (1 - |q|^2) 1).
constexpr double kWalk = 50.0;
/// The worst that one product can add to it: 8 u for a quaternion product, twice over for the
/// rounded step, times the same 8.
constexpr double kWorst = 128.0;
constexpr double kLever = 2.0 * 1.7321 * Wander::kRoom;  // m: the farthest that an angle can act

double roundoff_of(const Traveller& t) {
  return t.scalar == "float" ? unit_roundoff<float>() : unit_roundoff<double>();
}

std::string told(const Traveller& t) {
  return t.scalar + " " + t.form + ", mended: " + to_string(t.mending);
}

bool loses_its_place(const Traveller& t) {
  return t.form == QuaternionVectorForm<double>::name && t.mending != Mending::each;
}

class WanderingChain : public testing::TestWithParam<int> {};

TEST_P(WanderingChain, ErrorsWalkAndMendingMendsTheShapeAlone) {
  const int products = GetParam();
  Travellers all;
  for (const Mending m : {Mending::never, Mending::at_the_end, Mending::each}) {
    add_travellers(m, all);
  }
  Wander wander(1);
  for (int k = 0; k < products; ++k) {
    const ExactMotion step = wander.step();
    for (auto& traveller : all) traveller->step(step);
  }
  for (const auto& traveller : all) {
    const double u = roundoff_of(*traveller), walk = kWalk * u * std::sqrt(products);
    const Drift drift = traveller->drift(wander.pose());
    EXPECT_LT(drift.not_rigid, traveller->mending == Mending::never ? walk : kWalk * u)
        << told(*traveller);
    EXPECT_LT(drift.angle_rad, walk) << told(*traveller);
    EXPECT_LT(drift.position_m,
              kLever * (loses_its_place(*traveller) ? kWalk * u * products : walk))
        << told(*traveller);
    // Rigid, and still off by more than one product's roundings: those of all before are in it.
    if (products < 10000) continue;
    EXPECT_GT(drift.position_m, 3.0 * u) << told(*traveller);
  }
}

INSTANTIATE_TEST_SUITE_P(Products, WanderingChain, testing::Values(100, 10000, 100000));

TEST(RepeatedStep, ErrorsAddUpInProportionToTheNumberOfProducts) {
  constexpr int kPerTurn = 100, kProducts = 100 * kPerTurn + kPerTurn / 2;
  Travellers all;
  add_travellers(Mending::never, all);
  add_travellers(Mending::each, all);
  const ExactMotion step = turntable_step(kPerTurn);
  for (auto& traveller : all) {
    for (int k = 0; k < kProducts; ++k) traveller->step(step);
    const Drift drift = traveller->drift(turntable_step(2));
    const double worst = kWorst * roundoff_of(*traveller) * kProducts;
    EXPECT_LT(drift.not_rigid, worst) << told(*traveller);
    EXPECT_LT(drift.angle_rad, worst) << told(*traveller);
    if (loses_its_place(*traveller)) continue;
    EXPECT_LT(drift.position_m, 2.0 * worst) << told(*traveller);  // the path is within 2 m
  }
}

TEST(LongChain, ALengthThatDriftedComesOffAtTheEndButForQuaternionAndVector) {
  const ExactMotion a = Wander(4).step(), b = Wander(5).step();
  const Seen exact = (a * b).matrix().topRows<3>().cast<double>();
  auto dual = DualQuaternionForm<double>::from(a);
  dual.q = 1.001 * dual.q;
  dual = (dual * DualQuaternionForm<double>::from(b)).mended();
  EXPECT_LT((dual.seen() - exact).norm(), 1e-14);
  auto pair = QuaternionVectorForm<double>::from(a);
  pair.rotation.coeffs() *= 1.001;
  pair = (pair * QuaternionVectorForm<double>::from(b)).mended();
  EXPECT_LT((pair.seen() - exact).leftCols<3>().norm(), 1e-14);
  EXPECT_GT((pair.seen() - exact).col(3).norm(), 1e-3);
}

TEST(LongChain, MatricesErrAlikeWithAndWithoutTheirLastRow) {
  FormTraveller<Matrix3x4Form<float>> three(Mending::never);
  FormTraveller<Matrix4x4Form<float>> four(Mending::never);
  Wander wander(6);
  for (int k = 0; k < 1000; ++k) {
    const ExactMotion step = wander.step();
    three.step(step);
    four.step(step);
  }
  EXPECT_EQ(three.pose().seen(), four.pose().seen());
}

TEST(LongChain, ADualQuaternionKeepsBothItsConditionsToTheWalk) {
  // |real| = 1 and real . dual = 0, the second in metres: the dual part is half the translation.
  constexpr int kProducts = 100000;
  FormTraveller<DualQuaternionForm<double>> never(Mending::never), each(Mending::each);
  Wander wander(2);
  for (int k = 0; k < kProducts; ++k) {
    const ExactMotion step = wander.step();
    never.step(step);
    each.step(step);
  }
  const auto beyond = [](const DualQuaternion& q) {
    return std::max(std::abs(q.real.norm() - 1.0), std::abs(q.real.coeffs().dot(q.dual.coeffs())));
  };
  const double u = unit_roundoff<double>();
  EXPECT_LT(beyond(never.pose().q), kWalk * u * std::sqrt(kProducts));
  EXPECT_LT(beyond(each.pose().q), 8.0 * u);
}

TEST(LongChain, DividingByTheSquareOfTheLengthNeverSettles) {
  // Kenwright 2012, appendix 13.1: Normalize divides by real . real, not by its root. A length of
  // 1 + d becomes 1 / (1 + d), and back again the next time.
  Random random(3);
  DualQuaternion q = 1.001 * random.motion();
  const auto printed = [](const DualQuaternion& a) { return 1.0 / a.real.squaredNorm() * a; };
  EXPECT_NEAR(printed(q).real.norm(), 1.0 / 1.001, 1e-15);
  for (int k = 0; k < 10; ++k) q = printed(q);
  EXPECT_NEAR(q.real.norm(), 1.001, 1e-13);
  EXPECT_NEAR(q.normalized().real.norm(), 1.0, 1e-15);
}

}  // namespace
}  // namespace limber::test
