#include "assets/model/dual_quaternion.h"

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

#include "tests/model/random_motion.h"

namespace limber {
namespace {

using Eigen::Matrix4d;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using test::Random;

/// Motions at which every law is tried: identity, within 1e-8 of it, anything, half turns, -q.
std::vector<DualQuaternion> motions() {
  Random random(1);
  std::vector<DualQuaternion> all{DualQuaternion::identity(), -DualQuaternion::identity()};
  for (int i = 0; i < 20; ++i) {
    all.push_back(DualQuaternion::from_rotation_translation(random.small_rotation(1e-8),
                                                            random.vector(1e-8)));
    all.push_back(random.motion());
    all.push_back(-random.motion());
    const Vector3d axis = random.unit();
    all.push_back(DualQuaternion::from_rotation_translation(
        Quaterniond(Eigen::AngleAxisd(M_PI, axis)), random.vector()));
  }
  return all;
}

double distance(const DualQuaternion& a, const DualQuaternion& b) {
  return (a.matrix() - b.matrix()).norm();
}

double coefficients_apart(const DualQuaternion& a, const DualQuaternion& b) {
  return (a.real.coeffs() - b.real.coeffs()).norm() + (a.dual.coeffs() - b.dual.coeffs()).norm();
}

TEST(DualQuaternion, ActsAsItsMatrix) {
  Random random(2);
  for (const DualQuaternion& q : motions()) {
    const Vector3d p = random.vector(), d = random.unit();
    EXPECT_LT((q.transform_point(p) - (q.matrix() * p.homogeneous()).head<3>()).norm(), 1e-14);
    EXPECT_LT((q.transform_direction(d) - q.matrix().topLeftCorner<3, 3>() * d).norm(), 1e-14);
    EXPECT_LT(distance(q, DualQuaternion::from_matrix(q.matrix())), 1e-12);
    EXPECT_LT(distance(q, -q), 1e-15);
  }
}

TEST(DualQuaternion, ProductsComposeRightToLeft) {
  Random random(3);
  for (const DualQuaternion& a : motions()) {
    const DualQuaternion b = random.motion(), c = random.motion();
    EXPECT_LT(((a * b).matrix() - a.matrix() * b.matrix()).norm(), 1e-13);
    EXPECT_LT(coefficients_apart((a * b) * c, a * (b * c)), 1e-13);
  }
}

TEST(DualQuaternion, RotationComesBeforeTranslation) {
  // A quarter turn about z, then 1 m along x: the point (1, 0, 0) goes to (0, 1, 0) + (1, 0, 0).
  const DualQuaternion q = DualQuaternion::from_rotation_translation(
      Quaterniond(Eigen::AngleAxisd(M_PI / 2, Vector3d::UnitZ())), Vector3d::UnitX());
  EXPECT_LT((q.transform_point(Vector3d::UnitX()) - Vector3d(1, 1, 0)).norm(), 1e-15);
  EXPECT_LT((q.translation() - Vector3d::UnitX()).norm(), 1e-15);
}

TEST(DualQuaternion, ConjugatesAndTheSandwichMovePoints) {
  Random random(4);
  for (const DualQuaternion& q : motions()) {
    EXPECT_LT(distance(q * q.conjugate(), DualQuaternion::identity()), 1e-13);
    const DualQuaternion b = random.motion();
    EXPECT_LT(coefficients_apart((q * b).conjugate(), b.conjugate() * q.conjugate()), 1e-13);
    EXPECT_LT(coefficients_apart((q * b).dual_conjugate(), q.dual_conjugate() * b.dual_conjugate()),
              1e-13);
    EXPECT_LT(coefficients_apart((q * b).full_conjugate(), b.full_conjugate() * q.full_conjugate()),
              1e-13);
    const Vector3d p = random.vector();
    DualQuaternion point;  // 1 + eps p
    point.dual = Quaterniond(0, p.x(), p.y(), p.z());
    const DualQuaternion moved = q * point * q.full_conjugate();
    EXPECT_LT((moved.dual.vec() - q.transform_point(p)).norm(), 1e-13);
    EXPECT_NEAR(moved.real.w(), 1.0, 1e-14);
  }
}

TEST(DualQuaternion, InverseOfAnyButZeroDivisors) {
  Random random(5);
  for (int i = 0; i < 50; ++i) {
    DualQuaternion q;
    q.real.coeffs() = 3.0 * Eigen::Vector4d(random.normal(), random.normal(), random.normal(), 0.1);
    q.dual.coeffs() = Eigen::Vector4d(random.normal(), random.normal(), random.normal(), 1.0);
    const auto inverse = q.inverse();
    ASSERT_TRUE(inverse.ok());
    EXPECT_LT(coefficients_apart(q * *inverse, DualQuaternion::identity()), 1e-12);
    EXPECT_LT(coefficients_apart(*inverse * q, DualQuaternion::identity()), 1e-12);
  }
  DualQuaternion zero_divisor;
  zero_divisor.real = Quaterniond(0, 0, 0, 0);
  zero_divisor.dual = Quaterniond(1, 2, 3, 4);
  ASSERT_FALSE(zero_divisor.inverse().ok());
  EXPECT_EQ(zero_divisor.inverse().error().code, "dual-quaternion-zero-divisor");
  EXPECT_LT((zero_divisor * zero_divisor).dual.norm(), 1e-15);  // it does divide zero
}

TEST(DualQuaternion, NormalisingMendsDriftAndKeepsTheMotion) {
  Random random(6);
  for (const DualQuaternion& q : motions()) {
    // A dual scalar a + eps b is what normalising must take off again (Kenwright 2012 takes off a^2
    // and leaves b).
    const double a = random.uniform(0.2, 3.0), b = random.uniform(-1.0, 1.0);
    DualQuaternion drifted = a * q;
    drifted.dual.coeffs() += b * q.real.coeffs();
    const DualQuaternion mended = drifted.normalized();
    EXPECT_NEAR(mended.real.norm(), 1.0, 1e-15);
    EXPECT_NEAR(mended.real.coeffs().dot(mended.dual.coeffs()), 0.0, 1e-14);
    EXPECT_LT(distance(mended, q), 1e-12);
  }
}

TEST(DualQuaternion, LogAndExpAreInverse) {
  for (const DualQuaternion& q : motions()) {
    EXPECT_LT(distance(DualQuaternion::exp(q.log()), q), 1e-12);
    EXPECT_LE(q.log().real.norm(), M_PI + 1e-12);
    EXPECT_LT(distance(DualQuaternion::exp((-q).log()), q), 1e-12);
  }
}

TEST(DualQuaternion, ExpIsTheScrewMotionOfItsTwist) {
  Random random(7);
  for (int i = 0; i < 30; ++i) {
    // Angle and slide along one axis through a point: known without any exponential.
    const Vector3d axis = random.unit(), point = random.vector();
    const double angle = random.uniform(-3.0, 3.0), slide = random.uniform(-1.0, 1.0);
    const DualVector twist{angle * axis, slide * axis + point.cross(angle * axis)};
    const Eigen::AngleAxisd turn(angle, axis);
    const DualQuaternion q = DualQuaternion::exp(twist);
    const Vector3d p = random.vector();
    const Vector3d moved = point + turn * (p - point) + slide * axis;
    EXPECT_LT((q.transform_point(p) - moved).norm(), 1e-13);
  }
}

TEST(DualQuaternion, ExpAgreesAcrossItsSeries) {
  // The series must join the closed form: compare with the 4x4 power series of the twist.
  Random random(8);
  for (const double angle : {0.0, 1e-9, 0.9e-6, 1.1e-6, 1e-3, 0.1}) {
    const DualVector twist{angle * random.unit(), random.vector()};
    Matrix4d generator = Matrix4d::Zero(), term = Matrix4d::Identity(), sum = term;
    for (int k = 0; k < 3; ++k) {
      generator.block<3, 1>(0, k) = twist.real.cross(Vector3d::Unit(k));
    }
    generator.block<3, 1>(0, 3) = twist.dual;
    for (int k = 1; k < 20; ++k) {
      term = term * generator / k;
      sum += term;
    }
    EXPECT_LT((DualQuaternion::exp(twist).matrix() - sum).norm(), 1e-14) << angle;
    const DualVector back = DualQuaternion::exp(twist).log();
    EXPECT_LT((back.real - twist.real).norm() + (back.dual - twist.dual).norm(), 1e-12) << angle;
  }
}

TEST(DualQuaternion, LinesMoveWithTheirPoints) {
  Random random(9);
  for (const DualQuaternion& q : motions()) {
    const Vector3d p = random.vector(), d = random.unit();
    const DualVector line = DualVector::line(p, d);
    const DualVector moved = q.transform_line(line);
    const DualVector expected = DualVector::line(q.transform_point(p), q.transform_direction(d));
    EXPECT_LT((moved.real - expected.real).norm() + (moved.dual - expected.dual).norm(), 1e-13);
    // Any other point of it gives the same line.
    const DualVector same = DualVector::line(p + 0.7 * d, d);
    EXPECT_LT((same.dual - line.dual).norm(), 1e-14);
  }
}

TEST(DualQuaternion, TwistsAreVelocities) {
  Random random(10);
  const DualVector twist{random.vector(), random.vector()};
  const Vector3d p = random.vector();
  const double h = 1e-5;
  const auto at = [&](double t) { return DualQuaternion::exp(t * twist).transform_point(p); };
  EXPECT_LT(((at(h) - at(-h)) / (2 * h) - twist.velocity_at(p)).norm(), 1e-9);
  // Seen from elsewhere: the moved twist moves the moved point with the turned velocity.
  const DualQuaternion q = random.motion();
  const Vector3d seen = q.transform_line(twist).velocity_at(q.transform_point(p));
  EXPECT_LT((seen - q.transform_direction(twist.velocity_at(p))).norm(), 1e-13);
}

TEST(DualQuaternion, ScrewInterpolation) {
  Random random(11);
  for (const DualQuaternion& a : motions()) {
    const DualQuaternion b = random.motion();
    EXPECT_LT(distance(sclerp(a, b, 0.0), a), 1e-12);
    EXPECT_LT(distance(sclerp(a, b, 1.0), b), 1e-11);
    EXPECT_LT(distance(sclerp(a, -b, 0.3), sclerp(a, b, 0.3)), 1e-11);
    // Constant speed: equal parts are equal motions.
    const DualQuaternion first = sclerp(a, b, 0.25), second = sclerp(a, b, 0.5);
    EXPECT_LT(distance(a.conjugate() * first, first.conjugate() * second), 1e-11);
    // It moves with whoever looks (left invariant).
    const DualQuaternion frame = random.motion();
    EXPECT_LT(distance(sclerp(frame * a, frame * b, 0.4), frame * sclerp(a, b, 0.4)), 1e-11);
  }
}

TEST(DualQuaternion, Blending) {
  Random random(12);
  for (const DualQuaternion& a : motions()) {
    const DualQuaternion b = random.motion();
    const std::array<DualQuaternion, 2> pair{a, b}, flipped{a, -b};
    const auto blend = [](const std::array<DualQuaternion, 2>& q, double w) {
      const std::array<double, 2> weights{1.0 - w, w};
      return dlb<double>(q, weights);
    };
    EXPECT_LT(distance(blend(pair, 0.0), a), 1e-13);
    EXPECT_LT(distance(blend(pair, 1.0), b), 1e-13);
    EXPECT_LT(distance(blend(pair, 0.3), blend(flipped, 0.3)), 1e-13);
    // Of two, the middle is the screw's middle (Kavan et al. 2008).
    EXPECT_LT(distance(blend(pair, 0.5), sclerp(a, b, 0.5)), 1e-9);
  }
}

TEST(DualQuaternion, BatchMayAlias) {
  Random random(13);
  std::vector<DualQuaternion> a, b, expected;
  for (int i = 0; i < 9; ++i) {
    a.push_back(random.motion());
    b.push_back(random.motion());
    expected.push_back(a.back() * b.back());
  }
  multiply<double>(a, b, a);
  for (int i = 0; i < 9; ++i) EXPECT_LT(coefficients_apart(a[i], expected[i]), 1e-15);
}

TEST(DualQuaternion, DerivativesByJetsMeetFiniteDifferences) {
  using Jet = ceres::Jet<double, 6>;
  Random random(14);
  for (const double size : {0.0, 1e-8, 1e-3, 1.0}) {
    const DualVector at{size * random.vector(), random.vector()};
    const Vector3d p = random.vector();
    DualVectorT<Jet> xi;
    for (int k = 0; k < 3; ++k) {
      xi.real[k] = Jet(at.real[k], k);
      xi.dual[k] = Jet(at.dual[k], 3 + k);
    }
    const auto moved = DualQuaternionT<Jet>::exp(xi).transform_point(p.cast<Jet>());
    for (int k = 0; k < 6; ++k) {
      const double h = 1e-5;
      DualVector plus = at, minus = at;
      (k < 3 ? plus.real[k] : plus.dual[k - 3]) += h;
      (k < 3 ? minus.real[k] : minus.dual[k - 3]) -= h;
      const Vector3d slope = (DualQuaternion::exp(plus).transform_point(p) -
                              DualQuaternion::exp(minus).transform_point(p)) /
                             (2 * h);
      for (int i = 0; i < 3; ++i) EXPECT_NEAR(moved[i].v[k], slope[i], 1e-8) << size;
    }
  }
}

TEST(Rotation, AngleLogExp) {
  Random random(15);
  for (int i = 0; i < 50; ++i) {
    const Vector3d axis = random.unit();
    const double angle = random.uniform(0.0, M_PI);
    const Quaterniond a = random.rotation();
    const Quaterniond b = a * Quaterniond(Eigen::AngleAxisd(angle, axis));
    EXPECT_NEAR(rotation_angle(a, b), angle, 1e-14);
    Quaterniond minus_b = b;
    minus_b.coeffs() *= -1.0;
    EXPECT_NEAR(rotation_angle(a, minus_b), angle, 1e-14);
    EXPECT_LT((rotation_log<double>(a.conjugate() * b) - angle * axis).norm(), 1e-11);
    EXPECT_LT(rotation_angle(rotation_exp<double>(angle * axis),
                             Quaterniond(Eigen::AngleAxisd(angle, axis))),
              1e-14);
  }
}

TEST(DualQuaternion, FloatKeepsFloatPrecision) {
  Random random(16);
  for (int i = 0; i < 20; ++i) {
    const DualQuaternion q = random.motion();
    DualQuaternionT<float> f{q.real.cast<float>(), q.dual.cast<float>()};
    const Vector3d p = random.vector();
    EXPECT_LT((f.transform_point(p.cast<float>()).cast<double>() - q.transform_point(p)).norm(),
              3e-6);
    EXPECT_LT((DualQuaternionT<float>::exp(f.log()).matrix() - f.matrix()).norm(), 2e-5F);
  }
}

}  // namespace
}  // namespace limber
