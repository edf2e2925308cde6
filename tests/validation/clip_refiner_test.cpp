#include "validation/clip_refiner.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "tests/validation/zoo.h"

namespace limber {
namespace {

using Eigen::Vector3d;

constexpr double kRate = 60.0;

/// A clip on a rig, its targets and its reference.
struct Stage {
  Rig rig;
  Clip clip, reference;
  std::vector<EffectorTarget> targets;
  std::vector<StandingPoint> standing;

  ClipGoals goals() const {
    return {.targets = targets,
            .standing = standing,
            .reference = reference.parent_from_joint,
            .rate_hz = kRate};
  }
  Result<ClipRefineReport> refine(const ClipRefineOptions& options = {}) {
    return refine_clip_with_ceres(rig, goals(), clip, options);
  }
};

/// The zoo, every frame near the one before, with targets that are out of reach half the time.
Stage moving_zoo(std::int64_t frames, Rig rig) {
  std::mt19937 random(7);
  Stage stage{.rig = std::move(rig), .clip = {}, .reference = {}, .targets = {}, .standing = {}};
  const auto from = test::random_pose(stage.rig, random, 0.9);
  const auto to = test::random_pose(stage.rig, random, 0.9);
  stage.clip.joints = stage.rig.size();
  stage.clip.rate_hz = kRate;
  for (std::int64_t f = 0; f < frames; ++f) {
    std::vector<DualQuaternion> pose;
    const double t = 0.5 - 0.5 * std::cos(M_PI * double(f) / double(frames - 1));
    for (std::size_t i = 0; i < from.size(); ++i) {
      pose.push_back(DualQuaternion::from_rotation_translation(
          from[i].rotation().slerp(t, to[i].rotation()),
          (1.0 - t) * from[i].translation() + t * to[i].translation()));
    }
    for (EffectorTarget target : test::targets_at(stage.rig, pose)) {
      target.pose = target.pose * DualQuaternion::from_rotation_translation(
                                      test::random_rotation(random, 0.05),
                                      Vector3d(0.2 * std::sin(0.3 * double(f)), 0.02, 0.0));
      stage.targets.push_back(target);
    }
    stage.clip.parent_from_joint.insert(stage.clip.parent_from_joint.end(), pose.begin(),
                                        pose.end());
  }
  stage.reference = stage.clip;
  stage.standing = {{5, Vector3d(0.1, 0.0, 0.02), {{2, frames / 2}}}};
  return stage;
}

TEST(ClipProblem, JacobiansMeetFiniteDifferences) {
  for (const Rig& rig : {test::zoo(), test::joined_zoo()}) {
    Stage stage = moving_zoo(12, rig);
    std::mt19937 random(3);
    for (DualQuaternion& joint : stage.reference.parent_from_joint) {
      joint = joint * DualQuaternion::from_rotation_translation(test::random_rotation(random, 0.6),
                                                                Vector3d(0.1, -0.2, 0.05));
    }
    const ClipGoals goals = stage.goals();
    const ClipProblem problem(stage.rig, goals, {}, stage.clip);
    for (const std::int64_t f : {1, 4, 11}) {  // in the contact, and not
      const EffectorProblem frame = problem.frame(f, stage.clip.frame(f));
      const Eigen::VectorXd x = frame.chart().x();
      ClipProblem::Rows rows, ahead, behind;
      problem.evaluate(frame, f, x, true, rows);
      const double h = 1e-6;
      for (Eigen::Index k = 0; k < x.size(); ++k) {
        Eigen::VectorXd moved = x;
        moved[k] = x[k] + h;
        problem.evaluate(frame, f, moved, false, ahead);
        moved[k] = x[k] - h;
        problem.evaluate(frame, f, moved, false, behind);
        const Eigen::VectorXd pull = (ahead.pull - behind.pull) / (2.0 * h);
        const Eigen::VectorXd motion = (ahead.motion - behind.motion) / (2.0 * h);
        EXPECT_LT((pull - rows.pull_by_x.col(k)).cwiseAbs().maxCoeff(), 1e-6) << f << " " << k;
        EXPECT_LT((motion - rows.motion_by_x.col(k)).cwiseAbs().maxCoeff(), 1e-7) << f << " " << k;
      }
    }
  }
}

/// One free joint that is pulled to places by a weight of 1.
Stage free_point(const std::vector<Vector3d>& places) {
  Stage stage;
  RigJoint joint;
  joint.name = "point";
  joint.type = JointType::free;
  stage.rig.joints = {joint};
  RigEffector effector;
  effector.kind = EffectorKind::position;
  stage.rig.effectors = {effector};
  stage.clip.joints = 1;
  stage.clip.rate_hz = kRate;
  for (const Vector3d& p : places) {
    stage.targets.push_back({DualQuaternion::from_translation(p), 1.0});
    stage.clip.parent_from_joint.push_back(DualQuaternion::from_translation(p));
    stage.reference.parent_from_joint.push_back(DualQuaternion::identity());
  }
  return stage;
}

/// min |p - t|^2 + w^2 |D p|^2, D the second differences: (1 + w^2 D'D) p = t, solved densely.
Eigen::MatrixX3d spline(const std::vector<Vector3d>& places, double w) {
  const auto n = static_cast<Eigen::Index>(places.size());
  Eigen::MatrixXd d = Eigen::MatrixXd::Zero(n - 2, n);
  for (Eigen::Index f = 0; f + 2 < n; ++f) {
    d(f, f) = d(f, f + 2) = w;
    d(f, f + 1) = -2.0 * w;
  }
  Eigen::MatrixX3d t(n, 3);
  for (Eigen::Index f = 0; f < n; ++f) t.row(f) = places[static_cast<std::size_t>(f)].transpose();
  return (Eigen::MatrixXd::Identity(n, n) + d.transpose() * d).ldlt().solve(t);
}

double farthest(const Clip& clip, const Eigen::MatrixX3d& p) {
  double worst = 0.0;
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    worst = std::max(worst, (clip.frame(f)[0].translation() - p.row(f).transpose()).norm());
  }
  return worst;
}

std::vector<Vector3d> noisy_path(int frames) {
  std::mt19937 random(11);
  std::normal_distribution<double> normal(0.0, 0.01);
  std::vector<Vector3d> places;
  for (int f = 0; f < frames; ++f) {
    places.emplace_back(0.3 * std::sin(0.1 * f) + normal(random), normal(random), 0.002 * f);
  }
  return places;
}

TEST(ClipRefiner, AFreePointFollowsTheSmoothingSpline) {
  const std::vector<Vector3d> places = noisy_path(80);
  Stage stage = free_point(places);
  const ClipRefineOptions options;
  const double w = std::pow(options.weights.smooth_s * kRate, 2);
  ASSERT_GT(farthest(stage.clip, spline(places, w)), 0.005);
  const auto report = stage.refine({.iterations = 30, .enough = 1e-9});
  ASSERT_TRUE(report.ok());
  EXPECT_LT(farthest(stage.clip, spline(places, w)), 1e-6);
}

TEST(ClipRefiner, WindowsComeNearTheWhole) {
  const std::vector<Vector3d> places = noisy_path(300);
  Stage stage = free_point(places);
  const auto report = stage.refine({.window = 60, .overlap = 20, .iterations = 30});
  ASSERT_TRUE(report.ok());
  EXPECT_EQ(report->windows, 7);
  const ClipRefineOptions options;
  const double w = std::pow(options.weights.smooth_s * kRate, 2);
  EXPECT_LT(farthest(stage.clip, spline(places, w)), 1e-4);
}

TEST(ClipRefiner, TheCostIsAsStated) {
  // Frames at 0, 0, 3 cm; targets 1 cm beside; standing in the first two, at their mean place.
  Stage stage = free_point({Vector3d(0, 0, 0), Vector3d(0.02, 0, 0), Vector3d(0.03, 0, 0)});
  for (EffectorTarget& t : stage.targets) {
    t.pose = DualQuaternion::from_translation(Vector3d(0, 0, 0.01)) * t.pose;
  }
  stage.standing = {{0, Vector3d::Zero(), {{0, 2}}}};
  const ClipWeights weights{.contact = 10.0, .smooth_s = 1.0 / kRate, .turn_radius = 0.25};
  const ClipCost cost = ClipProblem(stage.rig, stage.goals(), weights, stage.clip).cost(stage.clip);
  EXPECT_NEAR(cost.effectors, 3 * 1e-4, 1e-12);
  EXPECT_NEAR(cost.contacts, 2 * std::pow(10.0 * 0.01, 2), 1e-12);
  EXPECT_NEAR(cost.smoothness, std::pow(0.01, 2), 1e-12);
}

double largest_excess(const Stage& stage) {
  double worst = 0.0;
  for (std::int64_t f = 0; f < stage.clip.frames(); ++f) {
    const auto frame = stage.clip.frame(f);
    worst = std::max(worst, test::worst_excess(stage.rig, {frame.begin(), frame.end()}));
  }
  return worst;
}

TEST(ClipRefiner, LimitsHoldAndTheCostFalls) {
  for (const Rig& rig : {test::zoo(), test::joined_zoo()}) {
    Stage stage = moving_zoo(50, rig);
    Stage again = moving_zoo(50, rig);
    const auto report = stage.refine();
    ASSERT_TRUE(report.ok());
    EXPECT_TRUE(report->improved);
    EXPECT_LT(report->after.total(), 0.7 * report->before.total());
    EXPECT_LT(largest_excess(stage), 1e-9);
    EXPECT_NEAR(ClipProblem(rig, again.goals(), {}, again.clip).cost(stage.clip).total(),
                report->after.total(), 1e-9 * report->before.total());
    ASSERT_TRUE(again.refine().ok());
    for (std::size_t k = 0; k < stage.clip.parent_from_joint.size(); ++k) {
      const DualQuaternion &a = stage.clip.parent_from_joint[k],
                           &b = again.clip.parent_from_joint[k];
      ASSERT_TRUE(a.real.coeffs() == b.real.coeffs() && a.dual.coeffs() == b.dual.coeffs());
    }
  }
}

TEST(ClipRefiner, NothingWithinLimitsIsCheaperNearby) {
  Stage stage = moving_zoo(30, test::zoo());
  const Clip before = stage.clip;
  ASSERT_TRUE(stage.refine({.rounds = 20, .iterations = 40, .enough = 1e-7}).ok());
  const ClipProblem problem(stage.rig, stage.goals(), {}, before);
  const double best = problem.cost(stage.clip).total();
  std::mt19937 random(5);
  for (int trial = 0; trial < 200; ++trial) {
    Clip other = stage.clip;
    const std::int64_t f = trial % 30;
    for (DualQuaternion& joint : other.frame(f)) {  // cost() brings it into the limits
      joint = joint * DualQuaternion::from_rotation(test::random_rotation(random, 1e-4));
    }
    EXPECT_GT(problem.cost(other).total(), best * (1.0 - 1e-6)) << trial;
  }
}

TEST(ClipRefiner, ABoundLetsGoOfWhatIsPulledInwards) {
  // A hinge of half a metre that stands on either bound; its targets are in the middle.
  for (const double start : {-0.4, 0.7}) {
    Stage stage;
    RigJoint hinge;
    hinge.name = "hinge";
    hinge.type = JointType::hinge;
    hinge.limits[0] = {-0.4, 0.7};
    stage.rig.joints = {hinge};
    RigEffector tip;
    tip.kind = EffectorKind::position;
    tip.offset = {0.0, 0.5, 0.0};
    stage.rig.effectors = {tip};
    stage.clip.joints = 1;
    stage.clip.rate_hz = kRate;
    for (int f = 0; f < 20; ++f) {
      const Vector3d middle = rotation_exp(Vector3d(0.2, 0, 0)) * tip.offset;
      stage.targets.push_back({DualQuaternion::from_translation(middle), 1.0});
      stage.clip.parent_from_joint.push_back(
          DualQuaternion::from_rotation(rotation_exp(Vector3d(start, 0, 0))));
    }
    stage.reference = stage.clip;
    const auto report = stage.refine();
    ASSERT_TRUE(report.ok());
    EXPECT_LT(report->after.total(), 1e-4 * report->before.total()) << start;
  }
}

TEST(ClipRefiner, WhatStandsStaysAndWhatNothingHoldsIsLeftAlone) {
  Stage stage = moving_zoo(40, test::zoo());
  RigJoint finger;
  finger.name = "finger";
  finger.parent = 5;
  finger.type = JointType::hinge;
  finger.limits[0] = {-0.5, 0.5};
  stage.rig.joints.push_back(finger);
  for (Clip* clip : {&stage.clip, &stage.reference}) {
    std::vector<DualQuaternion> wider;
    for (std::int64_t f = 0; f < 40; ++f) {
      wider.insert(wider.end(), clip->frame(f).begin(), clip->frame(f).end());
      const double q = 0.4 * std::sin(double(f));
      wider.push_back(DualQuaternion::from_rotation(rotation_exp(Vector3d(q, 0, 0))));
    }
    clip->parent_from_joint = std::move(wider);
    clip->joints = stage.rig.size();
  }
  const Clip before = stage.clip;
  ASSERT_TRUE(stage.refine().ok());
  const StandingPoint& point = stage.standing[0];
  const auto path = [&](const Clip& clip) {
    std::vector<DualQuaternion> world(stage.rig.joints.size());
    Vector3d last = Vector3d::Zero();
    double sum = 0.0;
    for (std::int64_t f = point.contacts[0].begin; f < point.contacts[0].end; ++f) {
      model_from_local(skeleton_of(stage.rig), clip.frame(f), world);
      const Vector3d p = world[point.joint].transform_point(point.offset);
      if (f > point.contacts[0].begin) sum += std::hypot(p.x() - last.x(), p.z() - last.z());
      last = p;
    }
    return sum;
  };
  EXPECT_LT(path(stage.clip), 0.1 * path(before));
  for (std::int64_t f = 0; f < 40; ++f) {
    EXPECT_TRUE(stage.clip.frame(f).back().real.coeffs() == before.frame(f).back().real.coeffs());
  }
}

TEST(ClipRefiner, BadInputIsAnError) {
  Stage stage = moving_zoo(10, test::zoo());
  stage.targets.pop_back();
  EXPECT_EQ(stage.refine().error().code, "refine-input");
  stage = moving_zoo(10, test::zoo());
  stage.standing[0].contacts = {{3, 11}};
  EXPECT_EQ(stage.refine().error().code, "refine-input");
  stage = moving_zoo(10, test::zoo());
  stage.clip.frame(2)[0].dual.x() = std::nan("");
  EXPECT_EQ(stage.refine().error().code, "refine-input");
  stage = moving_zoo(10, test::zoo());
  stage.rig.effectors[0].priority = 1;
  EXPECT_EQ(stage.refine().error().code, "refine-rows");
}

}  // namespace
}  // namespace limber
