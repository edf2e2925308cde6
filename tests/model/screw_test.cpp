#include "assets/model/screw.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <vector>

#include "tests/model/random_motion.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using test::Random;

double distance(const DualVector& a, const DualVector& b) {
  return (a.real - b.real).norm() + (a.dual - b.dual).norm();
}
double distance(const DualQuaternion& a, const DualQuaternion& b) {
  return (a.matrix() - b.matrix()).norm();
}

DualVector random_line(Random& random) {
  return DualVector::line(random.vector(2.0), random.unit());
}
DualVector random_twist(Random& random) { return {random.vector(2.0), random.vector(2.0)}; }

/// Screws whose laws are tried: no turn, tiny, any, half a turn; no slide, tiny, large.
std::vector<Screw> screws(Random& random) {
  std::vector<Screw> all;
  for (const double angle : {0.0, 1e-8, 0.3, 2.9, M_PI - 1e-8, M_PI}) {
    for (const double slide : {0.0, 1e-8, -0.7, 30.0}) {
      for (int i = 0; i < 5; ++i) all.push_back({random_line(random), angle, slide});
    }
  }
  return all;
}

/// Turns p about the axis by Rodrigues' formula and slides it: nothing of dual quaternions.
Vector3d moved(const Screw& screw, const Vector3d& p) {
  const Vector3d n = screw.axis.real, a = n.cross(screw.axis.dual), r = p - a;
  const double c = std::cos(screw.angle), s = std::sin(screw.angle);
  return a + c * r + s * n.cross(r) + (1.0 - c) * n.dot(r) * n + screw.slide * n;
}

/// Central difference of something that depends on time, at 0.
template <class T>
T slope(const std::function<T(double)>& f, double h = 1e-5) {
  return (0.5 / h) * (f(h) + (-1.0) * f(-h));
}

TEST(Screw, TurnsAboutItsLineAndSlidesAlongIt) {
  Random random(1);
  for (const Screw& screw : screws(random)) {
    const DualQuaternion m = motion_of(screw);
    EXPECT_NEAR(m.real.norm(), 1.0, 1e-14);
    EXPECT_NEAR(m.real.coeffs().dot(m.dual.coeffs()), 0.0, 1e-13);
    const Vector3d p = random.vector(2.0), q = p + random.unit();
    EXPECT_LT((m.transform_point(p) - moved(screw, p)).norm(), 2e-13);
    // A line goes where two of its points go.
    const Vector3d to = moved(screw, p), along = moved(screw, q) - to;
    EXPECT_LT(distance(m.transform_line(DualVector::line(p, q - p)), DualVector::line(to, along)),
              1e-12);
    EXPECT_LT(distance(m.transform_line(screw.axis), screw.axis), 1e-12) << "the axis stays";
  }
}

TEST(Screw, IsRecoveredFromItsMotion) {
  Random random(2);
  for (const Screw& screw : screws(random)) {
    const DualQuaternion m = motion_of(screw);
    for (const DualQuaternion& q : {m, -m}) {
      const Screw back = screw_of(q);
      EXPECT_LT(distance(motion_of(back), m), 1e-12);
      EXPECT_NEAR(back.angle, screw.angle, 1e-13);
      if (screw.angle > 0.1 && screw.angle < 3.0) {
        EXPECT_NEAR(back.slide, screw.slide, 1e-12);
        EXPECT_LT(distance(back.axis, screw.axis), 1e-11);
      }
    }
  }
  const Screw slide = screw_of(DualQuaternion::from_translation({0, 3, 4}));
  EXPECT_EQ(slide.angle, 0.0);
  EXPECT_NEAR(slide.slide, 5.0, 1e-15);
  EXPECT_LT((slide.axis.real - Vector3d(0, 0.6, 0.8)).norm(), 1e-15);
  EXPECT_EQ(screw_of(DualQuaternion::identity()).slide, 0.0);
}

TEST(Screw, RateIsTheDerivativeOfTheMotion) {
  // The axis itself is carried along by a motion; eq. 13 has all three terms then.
  Random random(3);
  for (int trial = 0; trial < 50; ++trial) {
    const DualVector line = random_line(random), carry = random_twist(random);
    const double angle = random.uniform(-3.0, 3.0), slide = random.uniform(-1.0, 1.0);
    const double turning = random.uniform(-2.0, 2.0), sliding = random.uniform(-2.0, 2.0);
    const auto at = [&](double t) {
      return motion_of(Screw{DualQuaternion::exp(t * carry).transform_line(line),
                             angle + turning * t, slide + sliding * t});
    };
    const MovingTransform m =
        motion_of({line, angle, slide}, {cross(carry, line), turning, sliding});
    const DualQuaternion expected = slope<DualQuaternion>([&](double t) { return at(t); });
    const DualQuaternion off = m.derivative() + -1.0 * expected;
    EXPECT_LT(off.real.coeffs().norm() + off.dual.coeffs().norm(), 1e-8);
    EXPECT_LT(distance(MovingTransform::from_derivative(m.a_from_b, m.derivative()).twist, m.twist),
              1e-12);
  }
}

/// A frame that turns about a moving point at a constant rate, and a point and line that move in
/// it.
struct Scene {
  DualQuaternion start;
  DualVector twist_a, twist_b;  // before and after `start`
  Vector3d p, v, n, turn;       // in b: the point, its velocity, a direction and how it turns

  Scene(Random& random, double size)
      : start(DualQuaternion::from_rotation_translation(random.rotation(), random.vector(2.0))),
        twist_a(size * random_twist(random)),
        twist_b(size * random_twist(random)),
        p(random.vector()),
        v(size * random.vector()),
        n(random.unit()),
        turn(size * random.vector()) {}

  DualQuaternion motion(double t) const {
    return DualQuaternion::exp(t * twist_a) * start * DualQuaternion::exp(t * twist_b);
  }
  MovingTransform moving() const {
    return MovingTransform{DualQuaternion::identity(), twist_a} * MovingTransform{start, {}} *
           MovingTransform{DualQuaternion::identity(), twist_b};
  }
  Vector3d direction(double t) const { return rotation_exp(Vector3d(t * turn)) * n; }
  MovingPoint point() const { return {p, v}; }
  MovingLine line() const { return MovingLine::through({p, v}, n, turn.cross(n)); }
};

TEST(Velocity, OfTransformsPointsAndLinesMeetFiniteDifferences) {
  Random random(4);
  for (int trial = 0; trial < 60; ++trial) {
    const Scene s(random, trial % 3 == 0 ? 1e-8 : 1.0);
    const MovingTransform m = s.moving();
    const DualQuaternion rate = slope<DualQuaternion>([&](double t) { return s.motion(t); });
    const DualQuaternion off = m.derivative() + -1.0 * rate;
    EXPECT_LT(off.real.coeffs().norm() + off.dual.coeffs().norm(), 1e-8);

    const auto point_at = [&](double t) {  // by matrices
      return Vector3d((s.motion(t).matrix() * (s.p + t * s.v).homogeneous()).head<3>());
    };
    const auto line_at = [&](double t) {
      const Matrix3d r = s.motion(t).matrix().topLeftCorner<3, 3>();
      return DualVector::line(point_at(t), r * s.direction(t));
    };
    const MovingPoint p = transform(m, s.point());
    EXPECT_LT((p.position - point_at(0)).norm(), 1e-14);
    EXPECT_LT((p.velocity - slope<Vector3d>(point_at)).norm(), 1e-8);
    const MovingLine l = transform(m, s.line());
    EXPECT_LT(distance(l.line, line_at(0)), 1e-14);
    EXPECT_LT(distance(l.velocity, slope<DualVector>(line_at)), 2e-8);
  }
}

TEST(Velocity, ByTwistAndByDerivativeAgree) {
  Random random(5);
  for (int trial = 0; trial < 60; ++trial) {
    const Scene s(random, trial % 3 == 0 ? 1e-8 : 1.0);
    const MovingTransform m = s.moving();
    const MovingPoint p = transform(m, s.point());
    const MovingPoint q = transform_by_derivative(m.a_from_b, m.derivative(), s.point());
    EXPECT_LT((p.position - q.position).norm() + (p.velocity - q.velocity).norm(), 1e-13);
    const MovingLine k = transform(m, s.line());
    const MovingLine l = transform_by_derivative(m.a_from_b, m.derivative(), s.line());
    EXPECT_LT(distance(k.line, l.line) + distance(k.velocity, l.velocity), 1e-13);
  }
}

TEST(Velocity, InverseUndoesPointAndLine) {
  Random random(6);
  for (int trial = 0; trial < 40; ++trial) {
    const Scene s(random, 1.0);
    const MovingTransform m = s.moving();
    const MovingPoint p = transform(m.inverse(), transform(m, s.point()));
    EXPECT_LT((p.position - s.p).norm() + (p.velocity - s.v).norm(), 1e-13);
    const MovingLine l = transform(m.inverse(), transform(m, s.line()));
    EXPECT_LT(distance(l.line, s.line().line) + distance(l.velocity, s.line().velocity), 1e-13);
    EXPECT_LT(distance((m * m.inverse()).twist, DualVector{}), 1e-13);
  }
}

TEST(Velocity, OfALineIsThatOfAnyOfItsPoints) {
  // Appendix B: another point of the line, sliding along it as it likes.
  Random random(7);
  for (int trial = 0; trial < 40; ++trial) {
    const Vector3d p = random.vector(), v = random.vector(), n = random.unit();
    const Vector3d rate = random.vector().cross(n);
    const double along = random.uniform(-2, 2), sliding = random.uniform(-2, 2);
    const MovingPoint other{p + along * n, v + along * rate + sliding * n};
    EXPECT_LT(distance(MovingLine::through({p, v}, n, rate).velocity,
                       MovingLine::through(other, n, rate).velocity),
              1e-14);
  }
}

TEST(ShortestRotation, TakesOneDirectionToTheOtherAcrossBoth) {
  Random random(8);
  for (const double angle : {0.0, 1e-15, 1e-8, 1e-3, 1.0, M_PI - 1e-3, M_PI - 1e-8, M_PI - 1e-15}) {
    for (int i = 0; i < 20; ++i) {
      const Vector3d a = random.unit(), across = a.cross(random.unit()).normalized();
      const Vector3d b = std::cos(angle) * a + std::sin(angle) * across;
      const Quaterniond q = shortest_rotation(a, b);
      EXPECT_NEAR(q.norm(), 1.0, 1e-14);
      EXPECT_LT((q * a - b).norm(), 3e-14) << angle;
      EXPECT_NEAR(2.0 * std::atan2(q.vec().norm(), q.w()), angle, 3e-14);
      EXPECT_NEAR(q.vec().dot(a), 0.0, 3e-14) << "Listing: the axis is across the first";
    }
  }
  const Vector3d x = Vector3d::UnitX();
  EXPECT_LT((shortest_rotation(x, -x) * x + x).norm(), 1e-15);
}

TEST(ShortestRotation, IsHalfTheProductOfAppendixC1) {
  // As printed, the product of the two directions turns by twice their angle.
  Random random(9);
  for (int i = 0; i < 20; ++i) {
    const Vector3d a = random.unit(), b = random.unit();
    const Quaterniond pure_a(0, a.x(), a.y(), a.z()), pure_b(0, b.x(), b.y(), b.z());
    const Quaterniond product = pure_b * pure_a.conjugate(), q = shortest_rotation(a, b);
    EXPECT_LT((product.coeffs() - (q * q).coeffs()).norm(), 1e-14);
    EXPECT_GT((product * a - b).norm(), 1e-3);
  }
}

/// Distance and angle of two lines by the textbook, from a point and a direction each.
void expect_shortest(const Screw& s, const DualVector& from, const DualVector& to, double within) {
  const Vector3d p = from.real.cross(from.dual), q = to.real.cross(to.dual);
  const Vector3d across = from.real.cross(to.real);
  EXPECT_LT(distance(motion_of(s).transform_line(from), to), within);
  EXPECT_NEAR(s.angle, std::atan2(across.norm(), from.real.dot(to.real)), 2e-8);
  const double apart = across.norm() > 1e-6 ? std::abs((q - p).dot(across.normalized()))
                                            : (q - p).cross(from.real).norm();
  EXPECT_NEAR(std::abs(s.slide), apart, within);
  // The axis meets both lines at right angles.
  EXPECT_NEAR(s.axis.real.dot(from.real), 0.0, 1e-7);
  EXPECT_NEAR(dot(s.axis, from).dual, 0.0, within);
  EXPECT_NEAR(dot(s.axis, to).dual, 0.0, within);
}

TEST(ShortestScrew, TakesOneLineToTheOtherAboutTheirCommonPerpendicular) {
  Random random(10);
  for (int i = 0; i < 50; ++i) {
    const DualVector from = random_line(random), to = random_line(random);
    const Screw s = shortest_screw(from, to);
    expect_shortest(s, from, to, 1e-10);
    // Appendix C.2: the product of the lines is that screw twice; and K x L is sin(t) times it.
    const DualQuaternion m = motion_of(s), twice = m * m;
    const DualVector k = cross(from, to);
    EXPECT_LT((twice.real.vec() - k.real).norm() + (twice.dual.vec() - k.dual).norm(), 1e-12);
    EXPECT_NEAR(twice.real.w(), dot(from, to).real, 1e-13);
    EXPECT_NEAR(twice.dual.w(), dot(from, to).dual, 1e-12);
  }
}

TEST(ShortestScrew, HandlesLinesThatMeetAreParallelOrCoincide) {
  Random random(11);
  for (int i = 0; i < 20; ++i) {
    const Vector3d p = random.vector(), n = random.unit();
    const Vector3d across = n.cross(random.unit()).normalized();
    const DualVector line = DualVector::line(p, n);
    const Screw meeting = shortest_screw(line, DualVector::line(p, random.unit()));
    EXPECT_NEAR(meeting.slide, 0.0, 1e-13);
    const Vector3d beside = p + 0.7 * across + 5.0 * n;
    for (const double sign : {1.0, -1.0}) {
      const DualVector parallel = DualVector::line(beside, sign * n);
      const Screw s = shortest_screw(line, parallel);
      expect_shortest(s, line, parallel, 1e-13);
      EXPECT_NEAR(s.slide, 0.7, 1e-13);
      const DualVector same = DualVector::line(p + 3.0 * n, sign * n);
      const Screw none = shortest_screw(line, same);
      expect_shortest(none, line, same, 1e-13);
      EXPECT_NEAR(none.slide, 0.0, 1e-13);
      EXPECT_NEAR(none.angle, sign > 0 ? 0.0 : M_PI, 1e-15);
    }
    for (const double tilt : {1e-12, 1e-9, 1e-7, 1e-5}) {
      const Vector3d tilted = (n + tilt * random.unit()).normalized();
      const DualVector near = DualVector::line(beside, tilted);
      const Screw s = shortest_screw(line, near);
      EXPECT_LT(distance(motion_of(s).transform_line(line), near), 2e-7) << tilt;
    }
  }
}

TEST(ShortestScrew, RateMeetsFiniteDifferences) {
  Random random(12);
  for (int trial = 0; trial < 50; ++trial) {
    const DualVector from = random_line(random), to = random_line(random);
    if (from.real.cross(to.real).norm() < 0.2) continue;
    const DualVector a = random_twist(random), b = random_twist(random);
    const auto at = [&](double t) {
      return shortest_screw(DualQuaternion::exp(t * a).transform_line(from),
                            DualQuaternion::exp(t * b).transform_line(to));
    };
    const auto rate = shortest_screw_rate({from, cross(a, from)}, {to, cross(b, to)});
    ASSERT_TRUE(rate.has_value());
    EXPECT_NEAR(rate->angle, slope<double>([&](double t) { return at(t).angle; }), 1e-6);
    EXPECT_NEAR(rate->slide, slope<double>([&](double t) { return at(t).slide; }), 1e-6);
    const DualVector axis = slope<DualVector>([&](double t) { return at(t).axis; });
    EXPECT_LT(distance(rate->axis, axis), 2e-5);
    // Carried by the screw as it changes, the first line stays on the second.
    const MovingLine carried = transform(motion_of(at(0), *rate), MovingLine{from, cross(a, from)});
    EXPECT_LT(distance(carried.velocity, cross(b, to)), 1e-9);
  }
  const DualVector line = random_line(random);
  EXPECT_FALSE(shortest_screw_rate({line, {}}, {line, {}}).has_value());
}

}  // namespace
}  // namespace limber
