// Limits of written files, recomputed from the file's text and the rig's JSON alone: nothing of the
// solver, the rig model or the readers is used here. Rotations are 3x3 matrices throughout.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/pipeline/program.h"

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using limber_test::Folder;
using nlohmann::json;

constexpr double kTolerance = 1e-4;  // rad, of a written file

Matrix3d about(const Vector3d& axis, double angle) {
  return Eigen::AngleAxisd(angle, axis).toRotationMatrix();
}

/// Joint names and per-frame local rotations of a BVH with one ROOT.
struct BvhRotations {
  std::vector<std::string> names;
  std::vector<std::vector<std::string>> channels;
  std::vector<std::vector<Matrix3d>> frames;
};

BvhRotations read_bvh(const std::string& text) {
  BvhRotations out;
  std::istringstream in(text);
  std::string word;
  while (in >> word && word != "MOTION") {
    if (word == "ROOT" || word == "JOINT") {
      in >> word;
      out.names.push_back(word);
    } else if (word == "CHANNELS") {
      int n = 0;
      in >> n;
      out.channels.emplace_back();
      for (int k = 0; k < n; ++k) {
        in >> word;
        out.channels.back().push_back(word);
      }
    }
  }
  long frames = 0;
  double frame_time = 0.0;
  in >> word >> frames >> word >> word >> frame_time;
  for (long f = 0; f < frames; ++f) {
    out.frames.emplace_back();
    for (const auto& channels : out.channels) {
      Matrix3d r = Matrix3d::Identity();
      for (const std::string& channel : channels) {
        double value = 0.0;
        in >> value;
        if (channel.size() != 9) continue;  // Xrotation and so on; positions are longer
        const Vector3d axis = Vector3d::Unit(channel[0] - 'X');
        r = r * about(axis, value * M_PI / 180.0);
      }
      out.frames.back().push_back(r);
    }
  }
  return out;
}

Vector3d vector_of(const json& v) {
  return {v[0].get<double>(), v[1].get<double>(), v[2].get<double>()};
}

double outside(double x, const json& range) {
  return std::max({0.0, range[0].get<double>() - x, x - range[1].get<double>()});
}

double angle_of(const Matrix3d& r) {
  const Vector3d v(r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1));
  return std::atan2(v.norm(), r.trace() - 1.0);
}

/// Turn about `axis` that is left when the axis has been swung back to where it was.
double twist_of(const Matrix3d& r, const Vector3d& axis, Matrix3d& swing) {
  const Vector3d moved = r * axis;
  const Vector3d cross = axis.cross(moved);
  swing = cross.norm() < 1e-12
              ? Matrix3d::Identity().eval()
              : about(cross.normalized(), std::atan2(cross.norm(), axis.dot(moved)));
  const Matrix3d rest = swing.transpose() * r;
  const Vector3d side = axis.unitOrthogonal();
  return std::atan2(axis.dot(side.cross(rest * side)), side.dot(rest * side));
}

/// Radians by which a joint's rotation lies outside its limits.
double excess(const json& joint, const Matrix3d& local) {
  const std::string type = joint["type"];
  const json& rest = joint["rest"];
  const Matrix3d r = Eigen::Quaterniond(rest[0].get<double>(), rest[1].get<double>(),
                                        rest[2].get<double>(), rest[3].get<double>())
                         .normalized()
                         .toRotationMatrix()
                         .transpose() *
                     local;
  if (type == "hinge") {
    const Vector3d axis = vector_of(joint["axes"][0]);
    Matrix3d off;
    const double angle = twist_of(r, axis, off);
    return std::max(outside(angle, joint["limits"][0]), angle_of(off));
  }
  if (type == "universal") {
    // R = rot(a0, q0) rot(a1, q1): a1 is moved by q0 alone.
    const Vector3d a0 = vector_of(joint["axes"][0]), a1 = vector_of(joint["axes"][1]);
    const Vector3d moved = r * a1;
    const double q0 = std::atan2(a0.dot(a1.cross(moved)), a1.dot(moved));
    const Matrix3d rest1 = about(a0, q0).transpose() * r;
    Matrix3d off;
    const double q1 = twist_of(rest1, a1, off);
    return std::max(
        {outside(q0, joint["limits"][0]), outside(q1, joint["limits"][1]), angle_of(off)});
  }
  if (type == "ball" && joint.contains("twist_swing") && !joint["twist_swing"].is_null()) {
    const json& limits = joint["twist_swing"];
    const Vector3d a0 = vector_of(joint["axes"][0]), a1 = vector_of(joint["axes"][1]);
    Matrix3d swing;
    const double twist = twist_of(r, vector_of(joint["axes"][2]), swing);
    const Eigen::AngleAxisd turn(swing);
    const double s0 = turn.angle() * turn.axis().dot(a0), s1 = turn.angle() * turn.axis().dot(a1);
    const double b0 = std::abs(limits["swing0"][s0 > 0.0 ? 1 : 0].get<double>());
    const double b1 = std::abs(limits["swing1"][s1 > 0.0 ? 1 : 0].get<double>());
    const double share = std::hypot(s0 / b0, s1 / b1);
    const double beyond = share > 1.0 ? std::hypot(s0, s1) * (1.0 - 1.0 / share) : 0.0;
    return std::max(beyond, outside(twist, limits["twist"]));
  }
  return 0.0;
}

void expect_within_limits(const std::filesystem::path& clip, const std::string& rig_name) {
  SCOPED_TRACE(clip.string() + " onto " + rig_name);
  const Folder folder;
  const auto run = limber_test::limber({"retarget", clip.string(), "--target", rig_name, "-o",
                                        folder.string(), "--refine", "none", "--formats", "bvh"});
  ASSERT_EQ(run.exit_code, 0);
  const json rig = json::parse(limber_test::limber({"rig", "show", rig_name, "--json"}).out);
  const BvhRotations motion =
      read_bvh(limber_test::text_of(folder / (clip.stem().string() + "@" + rig_name + ".bvh")));
  ASSERT_FALSE(motion.frames.empty());
  std::map<std::string, std::size_t> column;
  for (std::size_t i = 0; i < motion.names.size(); ++i) column[motion.names[i]] = i;
  long checked = 0;
  double worst = 0.0;
  std::string worst_joint;
  for (const json& joint : rig["joints"]) {
    ASSERT_TRUE(column.contains(joint["name"])) << joint["name"];
    const std::size_t i = column[joint["name"]];
    for (std::size_t f = 0; f < motion.frames.size(); ++f, ++checked) {
      const double e = excess(joint, motion.frames[f][i]);
      if (e > worst) worst = e, worst_joint = joint["name"].get<std::string>();
    }
  }
  EXPECT_LT(worst, kTolerance) << worst_joint;
  EXPECT_GT(checked, 100);
}

TEST(IndependentLimits, OwnMotions) {
  expect_within_limits(limber_test::own_clip("body_range_of_motion.bvh"), "biped-full");
  expect_within_limits(limber_test::own_clip("body_range_of_motion.bvh"), "biped-hands");
  expect_within_limits(limber_test::own_clip("gestures_right_hand.bvh"), "hand");
}

TEST(IndependentLimits, RealMotionCapture) {
  if (limber_test::cmu_clip("01_01.bvh").empty()) {
    GTEST_SKIP() << "Debian package assimp-testmodels is not installed";
  }
  expect_within_limits(limber_test::cmu_clip("01_01.bvh"), "biped-full");
  expect_within_limits(limber_test::cmu_clip("Boxing_Toes.bvh"), "biped-full");
}

TEST(IndependentLimits, SharedClips) {
  if (limber_test::shared("bvh").empty()) GTEST_SKIP() << "../shared is not there";
  for (const char* name : {"bvh/cmu_iclone_05_03_dance.bvh", "bvh/rokoko_jesse_dance_60j.bvh",
                           "bvh/mocapbank_19j_tabs.bvh", "mocap_other/viverse_roll_fingers.glb"}) {
    expect_within_limits(limber_test::shared(name), "biped-full");
  }
}

TEST(IndependentLimits, CheckSeesAViolation) {
  // One degree past the knee's range and one degree off its axis.
  const json knee = {
      {"type", "hinge"}, {"rest", {1, 0, 0, 0}}, {"axes", {{1, 0, 0}}}, {"limits", {{0.0, 1.0}}}};
  EXPECT_NEAR(excess(knee, about(Vector3d::UnitX(), 1.0 + M_PI / 180)), M_PI / 180, 1e-12);
  EXPECT_GT(excess(knee, about(Vector3d::UnitX(), 0.5) * about(Vector3d::UnitY(), M_PI / 180)),
            0.9 * M_PI / 180);
  EXPECT_NEAR(excess(knee, about(Vector3d::UnitX(), 0.7)), 0.0, 1e-12);
}

}  // namespace
