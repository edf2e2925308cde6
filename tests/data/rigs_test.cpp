// The rigs that we ship: what the papers say of them, left like right, sources named.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <map>

#include "assets/model/rig.h"
#include "importers/rig_json.h"
#include "tests/data/data_files.h"

namespace limber::test {
namespace {

using Eigen::Vector3d;

Rig rig(const std::string& name) {
  auto read = read_rig_json(read_text(kData / "rigs" / (name + ".json")));
  EXPECT_TRUE(read.ok()) << name << ": " << (read.ok() ? "" : read.error().message);
  return read.ok() ? std::move(*read) : Rig{};
}

const std::vector<std::string> kRigs = {
    "hand", "biped", "biped-foot-root", "biped-full", "biped-hands", "arm2", "arm3"};

std::string role_of_other_side(const std::string& role) {
  if (role.starts_with("left")) return "right" + role.substr(4);
  if (role.starts_with("right")) return "left" + role.substr(5);
  return role;
}

/// Joint spaces in the world at coordinates q.
std::vector<DualQuaternion> model_at(const Rig& r, const std::vector<double>& q) {
  std::vector<DualQuaternion> local(r.joints.size()), model(r.joints.size());
  pose_from_coordinates(r, q, local);
  model_from_local(skeleton_of(r), local, model);
  return model;
}

TEST(Rigs, HaveTheLinksAndFreedomsTheirSourcesGive) {
  struct Fact {
    const char* name;
    std::int32_t joints, dof, strong;
  };
  // Kenwright 2013: 17 links (forearm and 16), 22 DOF, five fingertips; foot base and five
  // effectors, one more holds the base. Kenwright 2012: 16 links, 36 DOF. Leclercq et al. 2013.
  for (const Fact& fact :
       {Fact{"hand", 16, 22, 5}, Fact{"biped", 16, 36, 6}, Fact{"biped-foot-root", 16, 36, 6},
        Fact{"biped-full", 22, 53, 6}, Fact{"biped-hands", 56, 99, 16}, Fact{"arm2", 2, 4, 1},
        Fact{"arm3", 3, 7, 1}}) {
    const Rig r = rig(fact.name);
    EXPECT_EQ(r.name, fact.name);
    EXPECT_EQ(r.size(), fact.joints) << fact.name;
    EXPECT_EQ(dof_count(r), fact.dof) << fact.name;
    std::int32_t strong = 0;
    for (const RigEffector& e : r.effectors) strong += e.strong;
    EXPECT_EQ(strong, fact.strong) << fact.name;
  }
}

TEST(Rigs, NameTheSourceOfEveryLimit) {
  for (const std::string& name : kRigs) {
    const auto document = read_json(kData / "rigs" / (name + ".json"));
    for (const auto& joint : document["joints"]) {
      if (joint["type"] == "free") continue;
      const std::string citation = joint["citation"];
      const std::string key = citation.substr(0, citation.find_first_of(",:"));
      EXPECT_TRUE(document["citations"].contains(key)) << name << " " << joint["name"];
    }
  }
}

TEST(Rigs, EveryMovingJointIsLimitedAndHasAVolume) {
  for (const std::string& name : kRigs) {
    for (const RigJoint& joint : rig(name).joints) {
      EXPECT_TRUE(joint.limited() || joint.type == JointType::free) << name << " " << joint.name;
      EXPECT_FALSE(joint.capsules.empty()) << name << " " << joint.name;
      EXPECT_TRUE(joint.role.empty() || joint.role == joint.name) << name << " " << joint.name;
    }
  }
}

TEST(Rigs, RightIsTheMirrorImageOfLeft) {
  const Vector3d point(-1, 1, 1), axis(1, -1, -1);  // of points, and of axes of rotation
  for (const std::string name : {"biped", "biped-full", "biped-hands"}) {
    const Rig r = rig(name);
    for (const RigJoint& left : r.joints) {
      if (!left.name.starts_with("left")) continue;
      const std::int32_t other = r.find(role_of_other_side(left.name));
      ASSERT_NE(other, kNoJoint) << left.name;
      const RigJoint& right = r.joints[other];
      EXPECT_TRUE(right.offset.isApprox(left.offset.cwiseProduct(point), 1e-12)) << left.name;
      const Vector3d turn = rotation_log(left.rest).cwiseProduct(axis);
      EXPECT_LT(rotation_angle(right.rest, rotation_exp(turn)), 1e-9) << left.name;
      for (std::int32_t k = 0; k < dof_count(left.type); ++k) {
        EXPECT_TRUE(right.axes[k].isApprox(left.axes[k].cwiseProduct(axis), 1e-12)) << left.name;
        EXPECT_DOUBLE_EQ(right.limits[k].min, left.limits[k].min) << left.name;
        EXPECT_DOUBLE_EQ(right.limits[k].max, left.limits[k].max) << left.name;
      }
      ASSERT_EQ(right.capsules.size(), left.capsules.size()) << left.name;
      for (std::size_t k = 0; k < left.capsules.size(); ++k) {
        EXPECT_TRUE(right.capsules[k].from.isApprox(left.capsules[k].from.cwiseProduct(point)));
        EXPECT_TRUE(right.capsules[k].to.isApprox(left.capsules[k].to.cwiseProduct(point)));
      }
    }
  }
}

TEST(Rigs, StandInTPoseWithSolesOnTheFloor) {
  for (const std::string name : {"biped", "biped-foot-root", "biped-full", "biped-hands"}) {
    const Rig r = rig(name);
    const auto model = model_at(r, std::vector<double>(dof_count(r), 0.0));
    double lowest = 1.0, highest = 0.0;
    for (std::int32_t j = 0; j < r.size(); ++j) {
      for (const Capsule& c : r.joints[j].capsules) {
        for (const Vector3d& end : {c.from, c.to}) {
          const double y = model[j].transform_point(end).y();
          lowest = std::min(lowest, y - c.radius);
          highest = std::max(highest, y + c.radius);
        }
      }
    }
    EXPECT_NEAR(lowest, 0.0, 0.004) << name;
    EXPECT_GT(highest, 1.7) << name;
    EXPECT_LT(highest, 1.9) << name;
    const Vector3d hand = model[r.find("leftHand")].translation();
    EXPECT_GT(hand.x(), 0.6) << name;  // its left is +X
    EXPECT_NEAR(hand.y(), model[r.find("leftUpperArm")].translation().y(), 0.02) << name;
  }
}

// The same body hung up by its foot: opposite joint motion gives the same relative placement.
TEST(Rigs, FootRootIsTheBipedTurnedAbout) {
  const Rig from_hips = rig("biped"), from_foot = rig("biped-foot-root");
  std::vector<double> q(36, 0.0), p(36, 0.0);
  const auto at = [](const Rig& r, const char* joint) { return dof_begin(r)[r.find(joint)]; };
  const auto set = [&](const char* joint, int k, double value) {
    q[at(from_hips, joint) + k] = p[at(from_foot, joint) + k] = value;
  };
  set("head", 0, 0.3);
  set("leftUpperLeg", 1, 0.4);
  set("leftLowerLeg", 0, 0.9);
  set("rightUpperArm", 2, -0.5);
  q[at(from_hips, "rightFoot")] = p[at(from_foot, "rightLowerLeg") + 1] = 0.3;
  q[at(from_hips, "rightFoot") + 1] = p[at(from_foot, "rightLowerLeg")] = -0.2;
  q[at(from_hips, "rightLowerLeg")] = p[at(from_foot, "rightUpperLeg")] = 0.7;
  const Vector3d hip(-0.6, 0.2, 0.1);  // a rotation vector; the inverse has the opposite one
  for (int k = 0; k < 3; ++k) {
    q[at(from_hips, "rightUpperLeg") + k] = hip[k];
    p[at(from_foot, "hips") + k] = -hip[k];
  }
  const auto a = model_at(from_hips, q), b = model_at(from_foot, p);
  const DualQuaternion foot_a = a[from_hips.find("rightFoot")];
  const DualQuaternion foot_b = b[from_foot.find("rightFoot")];
  for (const char* joint : {"spine", "head", "leftHand", "rightHand", "leftFoot"}) {
    const auto relative_a = foot_a.conjugate() * a[from_hips.find(joint)];
    const auto relative_b = foot_b.conjugate() * b[from_foot.find(joint)];
    EXPECT_LT((relative_a.translation() - relative_b.translation()).norm(), 1e-9) << joint;
    EXPECT_LT(rotation_angle(relative_a.rotation(), relative_b.rotation()), 1e-9) << joint;
  }
  const auto pelvis_a = a[0].translation();
  const RigEffector& pelvis = from_foot.effectors[1];
  const Vector3d pelvis_b = b[pelvis.joint].transform_point(pelvis.offset);
  EXPECT_LT(
      (foot_a.conjugate().transform_point(pelvis_a) - foot_b.conjugate().transform_point(pelvis_b))
          .norm(),
      1e-9);
}

TEST(Rigs, AreThoseOfTheWorkloads) {
  if (!shared()) GTEST_SKIP() << kNoShared;
  const std::map<std::string, std::string> same = {{"hand", "hand22"},
                                                   {"biped-full", "biped53"},
                                                   {"biped-hands", "bodyhands99"},
                                                   {"arm2", "arm4"},
                                                   {"arm3", "arm7"}};
  for (const auto& [ours, theirs] : same) {
    const Rig a = rig(ours);
    const auto b = read_rig_json(read_text(*shared() / "workloads/rigs" / (theirs + ".json")));
    ASSERT_TRUE(b.ok()) << b.error().message;
    ASSERT_EQ(a.size(), b->size());
    for (std::int32_t j = 0; j < a.size(); ++j) {
      const RigJoint &x = a.joints[j], &y = b->joints[j];
      EXPECT_EQ(x.parent, y.parent);
      EXPECT_EQ(x.type, y.type);
      EXPECT_EQ(x.offset, y.offset);
      EXPECT_EQ(x.rest.coeffs(), y.rest.coeffs());
      for (std::int32_t k = 0; k < dof_count(x.type) && x.type != JointType::free; ++k) {
        EXPECT_EQ(x.axes[k], y.axes[k]);
        EXPECT_EQ(x.limits[k].min, y.limits[k].min);
        EXPECT_EQ(x.limits[k].max, y.limits[k].max);
      }
    }
    ASSERT_EQ(a.effectors.size(), b->effectors.size());
    for (std::size_t e = 0; e < a.effectors.size(); ++e) {
      EXPECT_EQ(a.effectors[e].joint, b->effectors[e].joint);
      EXPECT_EQ(a.effectors[e].offset, b->effectors[e].offset);
      EXPECT_EQ(a.effectors[e].weight_pos, b->effectors[e].weight_pos);
      EXPECT_EQ(a.effectors[e].weight_rot, b->effectors[e].weight_rot);
    }
  }
}

}  // namespace
}  // namespace limber::test
