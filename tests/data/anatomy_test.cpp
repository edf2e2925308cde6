// Anatomical limits as data: well formed, wide enough for daily motion, inside the published
// ranges.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "pipeline/humanoid.h"
#include "tests/data/data_files.h"

namespace limber::test {
namespace {

using Eigen::Vector3d;
using nlohmann::json;

const json& anatomy() {
  static const json d = read_json(kData / "limits/anatomy.json");
  return d;
}

Vector3d vector(const json& v) {
  return {v[0].get<double>(), v[1].get<double>(), v[2].get<double>()};
}

void expect_well_formed(const std::string& name, const json& limit, const char* ranges_key) {
  const json& axes = limit["axes"];
  const std::string type = limit["type"];
  const std::size_t count = type == "ball" ? 3 : type == "universal" ? 2 : 1;
  ASSERT_EQ(axes.size(), count) << name;
  ASSERT_EQ(limit[ranges_key].size(), count) << name;
  for (std::size_t k = 0; k < count; ++k) {
    EXPECT_NEAR(vector(axes[k]).norm(), 1.0, 1e-9) << name;
    EXPECT_LT(limit[ranges_key][k][0], 0.0) << name;  // the T-pose lies inside
    EXPECT_GT(limit[ranges_key][k][1], 0.0) << name;
  }
  if (count > 1) {
    EXPECT_NEAR(vector(axes[0]).dot(vector(axes[1])), 0.0, 1e-9) << name;
  }
  if (count > 2) {
    EXPECT_NEAR(vector(axes[0]).cross(vector(axes[1])).dot(vector(axes[2])), 1.0, 1e-9) << name;
  }
  const std::string citation = limit["citation"];
  const std::string key = citation.substr(0, citation.find_first_of(",:"));
  EXPECT_TRUE(anatomy()["citations"].contains(key)) << name << ": " << citation;
}

TEST(Anatomy, IsWellFormed) {
  for (const auto& [role, limit] : anatomy()["roles"].items()) {
    const auto known = role_named(role);
    ASSERT_TRUE(known) << role;
    EXPECT_NE(side_of(*known), Side::right) << role << ": the right side is the mirror image";
    expect_well_formed(role, limit, "ranges_deg");
  }
  for (const auto& [chain, limit] : anatomy()["shares"].items()) {
    expect_well_formed(chain, limit, "total_deg");
    expect_well_formed(chain, limit, "one_joint_deg");
    for (const json& role : limit["roles"]) EXPECT_TRUE(role_named(role.get<std::string>()));
  }
}

TEST(Anatomy, CoversEveryMovingRole) {
  for (int r = 0; r < kRoleCount; ++r) {
    const Role role = role_at(r);
    const std::string name(name_of(role));
    if (side_of(role) == Side::right || name == "hips" || name == "jaw" || name == "leftEye") {
      continue;
    }
    bool covered = anatomy()["roles"].contains(name);
    for (const auto& [chain, limit] : anatomy()["shares"].items()) {
      for (const json& shared_role : limit["roles"]) covered |= shared_role == name;
    }
    EXPECT_TRUE(covered) << name;
  }
}

/// How far out a direction of the bone (T-pose: `bone`) lies: 1 on the ellipse's edge.
double swing_reach(const json& limit, const Vector3d& bone, const Vector3d& direction) {
  const Vector3d to = direction.normalized();
  const double angle = std::acos(std::clamp(bone.dot(to), -1.0, 1.0)) / kRadians;
  const Vector3d axis = bone.cross(to).normalized();
  double sum = 0.0;
  for (int k = 0; k < 2; ++k) {
    const double s = angle * axis.dot(vector(limit["axes"][k]));
    const json& range = limit["ranges_deg"][k];
    const double bound = s > 0.0 ? range[1].get<double>() : -range[0].get<double>();
    sum += (s / bound) * (s / bound);
  }
  return std::sqrt(sum);
}

TEST(Anatomy, LetsTheLeftArmGoWhereArmsGo) {
  const json& arm = anatomy()["roles"]["leftUpperArm"];
  const Vector3d t_pose = Vector3d::UnitX();
  const auto reach = [&](double x, double y, double z) {
    return swing_reach(arm, t_pose, {x, y, z});
  };
  EXPECT_LT(reach(0, -1, 0), 0.85);          // hanging
  EXPECT_LT(reach(-0.15, -1, 0.1), 0.9);     // hanging, before the body
  EXPECT_LT(reach(0.1, -0.9, 0.45), 0.9);    // swung forward in a walk
  EXPECT_LT(reach(0.2, -0.87, -0.45), 1.0);  // and back
  EXPECT_LT(reach(0.05, 1, 0), 0.9);         // overhead
  EXPECT_LT(reach(0, 0, 1), 0.8);            // forward
  EXPECT_LT(reach(-0.5, -0.3, 0.8), 1.0);    // hand on the other shoulder
  EXPECT_GT(reach(0.3, 0, -1), 1.1);         // straight back is not human
  EXPECT_GT(reach(-1, 0, -0.1), 1.2);        // through the body neither
}

TEST(Anatomy, LetsTheLeftLegGoWhereLegsGo) {
  const json& leg = anatomy()["roles"]["leftUpperLeg"];
  const Vector3d t_pose = -Vector3d::UnitY();
  const auto reach = [&](double x, double y, double z) {
    return swing_reach(leg, t_pose, {x, y, z});
  };
  EXPECT_LT(reach(0.2, 0, 1), 0.8);        // sitting
  EXPECT_LT(reach(0.2, 0.6, 1), 0.95);     // a deep squat
  EXPECT_LT(reach(0, -0.85, -0.5), 0.85);  // stretched back in a run
  EXPECT_LT(reach(0.7, -0.7, 0), 0.75);    // a side step
  EXPECT_GT(reach(0, 0, -1), 1.5);         // back up is not human
}

/// Bones of figures do not meet at square hinges: recorded elbows flex about an axis up to 30
/// degrees off the T-pose's, shins turn, knuckles give. A joint that allowed its one axis alone
/// would have to break the direction of the bone instead.
TEST(Anatomy, GivesHingesTheSidePlayOfRecordedOnes) {
  for (const auto& [name, limit] : anatomy()["roles"].items()) {
    const auto role = role_named(name);
    ASSERT_TRUE(role) << name;
    if (is_thumb(*role)) continue;
    ASSERT_EQ(limit["type"], "ball") << name;
    for (int k = 0; k < 2; ++k) {
      EXPECT_LE(limit["ranges_deg"][k][0].get<double>(), -5.0) << name;
      EXPECT_GE(limit["ranges_deg"][k][1].get<double>(), 5.0) << name;
    }
  }
}

TEST(Anatomy, LiesInsideThePublishedRanges) {
  if (!shared()) GTEST_SKIP() << kNoShared;
  const json table = read_json(*shared() / "evals/limits.json")["bones"];
  for (const auto& [role, ours] : anatomy()["roles"].items()) {
    const json& theirs = table[role];
    if (theirs.contains("cone")) {
      double most = 0.0;
      for (const json& range : ours["ranges_deg"]) {
        most = std::max(most, std::max(-range[0].get<double>(), range[1].get<double>()));
      }
      EXPECT_LE(most, theirs["cone"].get<double>()) << role;
      continue;
    }
    for (std::size_t k = 0; k < ours["axes"].size(); ++k) {
      for (const auto& [axis, range] : {std::pair{"axis", "twist"}, std::pair{"axis_a", "swing_a"},
                                        std::pair{"axis_b", "swing_b"}}) {
        if (!theirs.contains(axis)) continue;
        const double along = vector(ours["axes"][k]).dot(vector(theirs[axis]));
        if (std::abs(along) < 0.999) continue;
        double low = theirs[range][0], high = theirs[range][1];
        if (along < 0.0) std::tie(low, high) = std::pair{-high, -low};
        EXPECT_GE(ours["ranges_deg"][k][0].get<double>(), low) << role << " " << range;
        EXPECT_LE(ours["ranges_deg"][k][1].get<double>(), high) << role << " " << range;
      }
    }
  }
}

}  // namespace
}  // namespace limber::test
