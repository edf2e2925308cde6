#include "assets/model/eye_head_shoulder.h"

#include <gtest/gtest.h>

#include <cmath>

#include "assets/model/fick.h"
#include "tests/model/random_motion.h"

namespace limber {
namespace {

using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using test::Random;

EyeHeadShoulder random_body(Random& random, double turning) {
  return {.head_in_shoulder = random.vector(0.3),
          .eye_in_head = random.vector(0.1),
          .shoulder_from_head = random.rotation(),
          .head_from_eye = random.rotation(),
          .head_turn = turning * random.vector(3.0),
          .eye_turn = turning * random.vector(8.0)};
}

/// The same body a moment later.
EyeHeadShoulder after(EyeHeadShoulder body, double t) {
  body.shoulder_from_head = rotation_exp(Vector3d(t * body.head_turn)) * body.shoulder_from_head;
  body.head_from_eye = rotation_exp(Vector3d(t * body.eye_turn)) * body.head_from_eye;
  return body;
}

/// Eqs. 16 and 17 with rotation matrices: peel off the head, then the eye.
MovingPoint seen_from_eye(const EyeHeadShoulder& body, const MovingPoint& target) {
  const Matrix3d head = body.shoulder_from_head.toRotationMatrix();
  const Matrix3d eye = body.head_from_eye.toRotationMatrix();
  const Vector3d from_head = target.position - body.head_in_shoulder;  // still in shoulder axes
  const Vector3d in_head = head.transpose() * from_head;
  const Vector3d head_rate = head.transpose() * (target.velocity - body.head_turn.cross(from_head));
  const Vector3d from_eye = in_head - body.eye_in_head;
  return {eye.transpose() * from_eye,
          eye.transpose() * (head_rate - body.eye_turn.cross(from_eye))};
}

TEST(RetinalImage, IsTheTargetPeeledOffByRotationMatrices) {
  Random random(1);
  for (int trial = 0; trial < 60; ++trial) {
    const EyeHeadShoulder body = random_body(random, trial % 3);
    const MovingPoint target{random.vector(2.0), random.vector(2.0)};
    const auto image = retinal_image(body, target);
    ASSERT_TRUE(image.ok());
    const MovingPoint p = seen_from_eye(body, target);
    const double depth = p.position.norm();
    EXPECT_NEAR(image->depth, depth, 1e-14);
    EXPECT_LT((image->direction - p.position / depth).norm(), 1e-14);
    // Section 3.1.1: proj' = p' / d - p d' / d^2, d' = p . p' / d.
    const double depth_rate = p.position.dot(p.velocity) / depth;
    EXPECT_NEAR(image->depth_rate, depth_rate, 1e-12);
    const Vector3d velocity = p.velocity / depth - p.position * (depth_rate / (depth * depth));
    EXPECT_LT((image->velocity - velocity).norm(), 1e-12 * (1.0 + velocity.norm()));
    EXPECT_NEAR(image->velocity.dot(image->direction), 0.0, 1e-12 * (1.0 + velocity.norm()));
  }
}

TEST(RetinalImage, VelocitiesMeetFiniteDifferences) {
  Random random(2);
  for (int trial = 0; trial < 60; ++trial) {
    const EyeHeadShoulder body = random_body(random, trial % 3);
    const MovingPoint target{random.unit() * random.uniform(1.0, 3.0), random.vector(2.0)};
    const double h = 1e-5;
    const auto image_at = [&](double t) {
      return retinal_image(after(body, t),
                           {target.position + t * target.velocity, Vector3d::Zero()})
          .value();
    };
    const RetinalImage image = retinal_image(body, target).value();
    const RetinalImage ahead = image_at(h), behind = image_at(-h);
    EXPECT_LT((image.velocity - (ahead.direction - behind.direction) / (2 * h)).norm(), 2e-6);
    EXPECT_NEAR(image.depth_rate, (ahead.depth - behind.depth) / (2 * h), 1e-7);
  }
}

TEST(RetinalImage, LeadsBackToTheTargetWithItsDepth) {
  Random random(3);
  for (int trial = 0; trial < 60; ++trial) {
    const EyeHeadShoulder body = random_body(random, trial % 3);
    const MovingPoint target{random.vector(2.0), random.vector(2.0)};
    const RetinalImage image = retinal_image(body, target).value();
    const MovingPoint back = target_from_image(body, image);
    EXPECT_LT((back.position - target.position).norm(), 1e-14);
    EXPECT_LT((back.velocity - target.velocity).norm(), 1e-12);
    // A wrong depth puts the target elsewhere on the same ray.
    RetinalImage guess = image;
    guess.depth *= 2.0;
    const Vector3d eye = shoulder_from_eye(body).a_from_b.translation();
    const Vector3d there = target_from_image(body, guess).position;
    EXPECT_LT((there - (eye + 2.0 * (target.position - eye))).norm(), 1e-13);
  }
}

TEST(RetinalImage, OfAHeadRollIsTurnedAgainstIt) {
  // Section 3.1: rolled by 90 degrees to its left shoulder, a head sees up as its left or right.
  EyeHeadShoulder body;
  body.shoulder_from_head = rotation_from_fick({.clockwise = -0.5 * M_PI});  // left ear down
  const RetinalImage image = retinal_image(body, {{0, 0, 1}, {0, 1, 0}}).value();
  EXPECT_LT((image.direction - Vector3d(0, 0, 1)).norm(), 1e-15);
  EXPECT_LT((image.velocity - Vector3d(-1, 0, 0)).norm(), 1e-15) << "up in space, right on the eye";
}

TEST(RetinalImage, OfATargetAtTheEyeIsAnError) {
  Random random(4);
  EyeHeadShoulder body = random_body(random, 1.0);
  body.shoulder_from_head.setIdentity();
  const auto none =
      retinal_image(body, {body.head_in_shoulder + body.eye_in_head, Vector3d::Zero()});
  ASSERT_FALSE(none.ok());
  EXPECT_EQ(none.error().code, "target-at-eye");
}

/// Appendix D.1's matrix, in the paper's axes: x ahead, y left, z up.
Matrix3d paper_matrix(const Fick& f) {
  const double ct = std::cos(f.left), st = std::sin(f.left);
  const double cp = std::cos(f.down), sp = std::sin(f.down);
  const double cs = std::cos(f.clockwise), ss = std::sin(f.clockwise);
  Matrix3d m;
  m << ct * cp, ct * sp * ss - st * cs, ct * sp * cs + st * ss,  //
      st * cp, st * sp * ss + ct * cs, st * sp * cs - ct * ss,   //
      -sp, cp * ss, cp * cs;
  return m;
}

TEST(FickCoordinates, AreThePapersMatrix) {
  Matrix3d ours_from_paper;  // its x, y, z are our z, x, y
  ours_from_paper << 0, 1, 0, 0, 0, 1, 1, 0, 0;
  Random random(5);
  for (int trial = 0; trial < 50; ++trial) {
    const Fick f{random.uniform(-3, 3), random.uniform(-1.5, 1.5), random.uniform(-3, 3)};
    const Matrix3d expected = ours_from_paper * paper_matrix(f) * ours_from_paper.transpose();
    EXPECT_LT((rotation_from_fick(f).toRotationMatrix() - expected).norm(), 1e-14);
  }
}

TEST(FickCoordinates, SayLeftDownAndClockwise) {
  const Vector3d ahead(0, 0, 1), left(1, 0, 0), up(0, 1, 0);
  const double quarter = 0.5 * M_PI;
  EXPECT_LT((rotation_from_fick({.left = quarter}) * ahead - left).norm(), 1e-15);
  EXPECT_LT((rotation_from_fick({.down = quarter}) * ahead + up).norm(), 1e-15);
  EXPECT_LT((rotation_from_fick({.clockwise = quarter}) * up + left).norm(), 1e-15);
}

TEST(FickCoordinates, GoBothWays) {
  Random random(6);
  for (const double size : {0.0, 1e-8, 1.0}) {
    for (int trial = 0; trial < 30; ++trial) {
      const Fick f{size * random.uniform(-M_PI, M_PI), size * random.uniform(-1.57, 1.57),
                   size * random.uniform(-M_PI, M_PI)};
      const Fick back = fick_from_rotation(rotation_from_fick(f));
      EXPECT_NEAR(back.left, f.left, 1e-12);
      EXPECT_NEAR(back.down, f.down, 1e-12);
      EXPECT_NEAR(back.clockwise, f.clockwise, 1e-12);
      const Quaterniond q = random.rotation();
      EXPECT_LT(rotation_angle(rotation_from_fick(fick_from_rotation(q)), q), 1e-14);
    }
  }
}

TEST(FickCoordinates, KeepTheRotationStraightUpAndDown) {
  Random random(7);
  for (const double off : {0.0, 1e-16, 1e-12, 1e-8, 1e-4}) {
    for (const double pole : {-0.5 * M_PI + off, 0.5 * M_PI - off}) {
      const Quaterniond q =
          rotation_from_fick({random.uniform(-3, 3), pole, random.uniform(-3, 3)});
      EXPECT_LT(rotation_angle(rotation_from_fick(fick_from_rotation(q)), q), 1e-14);
    }
  }
}

}  // namespace
}  // namespace limber
