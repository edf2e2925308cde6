// Naming conventions as data: whole, consistent, and true to real files.

#include <gtest/gtest.h>

#include <map>
#include <set>

#include "importers/importer.h"
#include "pipeline/humanoid.h"
#include "tests/data/data_files.h"

namespace limber::test {
namespace {

using nlohmann::json;

const json& document() {
  static const json d = read_json(kData / "conventions/conventions.json");
  return d;
}

const json& convention(const std::string& name) {
  for (const json& c : document()["conventions"]) {
    if (c["name"] == name) return c;
  }
  ADD_FAILURE() << "no convention " << name;
  static const json none = json::object();
  return none;
}

TEST(Conventions, KeepTheFormat) {
  const std::set<std::string> kinds = {"twist", "metacarpal", "helper", "tip",
                                       "spine", "neck",       "eye"};
  std::set<std::string> names;
  for (const json& c : document()["conventions"]) {
    const std::string name = c["name"];
    EXPECT_TRUE(names.insert(name).second) << name << " twice";
    EXPECT_FALSE(c["notes"].get<std::string>().empty()) << name;
    std::set<std::string> joints;
    for (const auto& [role, joint] : c["names"].items()) {
      EXPECT_TRUE(role_named(role)) << name << ": " << role;
      EXPECT_TRUE(joints.insert(joint.get<std::string>()).second) << name << ": " << joint;
    }
    for (const auto& [joint, kind] : c["extra"].items()) {
      EXPECT_TRUE(kinds.contains(kind.get<std::string>())) << name << ": " << joint;
      EXPECT_FALSE(joints.contains(joint)) << name << ": " << joint << " has a role";
    }
  }
  EXPECT_GE(names.size(), 40u);
}

TEST(Conventions, NameBothSidesOrEitherHand) {
  for (const json& c : document()["conventions"]) {
    const bool either = c.value("hand", "") == "either";
    for (const auto& [role, joint] : c["names"].items()) {
      const auto known = role_named(role);
      if (!known) continue;
      const std::string other(name_of(mirrored(*known)));
      EXPECT_EQ(c["names"].contains(other), !either) << c["name"] << " " << role;
      EXPECT_TRUE(!either || side_of(*known) == Side::right) << c["name"] << " " << role;
    }
  }
}

// The traps: one name, different joints (documented by the makers of each convention).
TEST(Conventions, AreWholeListsBecauseSingleNamesCollide) {
  EXPECT_EQ(convention("humanik")["names"]["leftLowerLeg"], "LeftLeg");
  EXPECT_EQ(convention("soma77")["names"]["leftUpperLeg"], "LeftLeg");
  EXPECT_EQ(convention("humanik")["names"]["leftShoulder"], "LeftShoulder");
  EXPECT_EQ(convention("xsens_bvh")["names"]["leftUpperArm"], "LeftShoulder");
  EXPECT_EQ(convention("unity_humanoid")["names"]["leftThumbMetacarpal"], "LeftThumbProximal");
  EXPECT_EQ(convention("godot_humanoid")["names"]["leftThumbProximal"], "LeftThumbProximal");
  EXPECT_EQ(convention("smpl")["names"]["leftToes"], "left_foot");
  for (const auto& [role, joint] : convention("vrm1")["names"].items()) EXPECT_EQ(role, joint);
  EXPECT_EQ(convention("vrm1")["names"].size(), std::size_t(kRoleCount));
}

/// Joints of the file that the convention knows neither as a role nor as an extra.
std::set<std::string> unknown_joints(const std::filesystem::path& file, const json& c) {
  std::set<std::string> known, unknown;
  for (const auto& [role, joint] : c["names"].items()) known.insert(joint.get<std::string>());
  for (const auto& [joint, kind] : c["extra"].items()) known.insert(joint);
  const auto imported = import_file(file);
  EXPECT_TRUE(imported.ok()) << file;
  if (!imported.ok()) return {"?"};
  for (const std::string& joint : imported->character.skeleton.names) {
    if (!joint.ends_with("_End") && !known.contains(joint)) unknown.insert(joint);
  }
  return unknown;
}

TEST(Conventions, KnowEveryJointOfRealFiles) {
  const std::filesystem::path folder = "/usr/share/assimp/models/BVH";
  if (!std::filesystem::is_directory(folder)) GTEST_SKIP() << "assimp-testmodels not installed";
  EXPECT_EQ(unknown_joints(folder / "01_01.bvh", convention("cmu_bvh")), std::set<std::string>{});
  EXPECT_EQ(unknown_joints(folder / "01_03.bvh", convention("cmu_bvh")), std::set<std::string>{});
  EXPECT_EQ(unknown_joints(folder / "Boxing_Toes.bvh", convention("simple_joint_bvh")),
            std::set<std::string>{});
}

TEST(Conventions, KnowEveryJointOfSharedFiles) {
  if (!shared()) GTEST_SKIP() << kNoShared;
  const std::map<std::string, std::string> files = {
      {"bvh/cmu_mb_12_01_walk.bvh", "cmu_bvh"},
      {"bvh/cmu_max_131_01_start_walk_stop.bvh", "cmu_max"},
      {"bvh/cmu_daz_10_03_soccer_kick.bvh", "poser_daz_bvh"},
      {"bvh/derived_crossarms_fingers.bvh", "biped_renamed"},
      {"bvh/derived_roll_fingers.bvh", "vrm1"},
      {"bvh/fair_zombie_zup.bvh", "humanik"},
      {"bvh/freebvh_mixamo_names_55j.bvh", "mixamo"},
      {"bvh/mixed_orders_60j.bvh", "forefoot_60j"},
      {"bvh/mocapbank_19j_tabs.bvh", "biovision"},
      {"bvh/rokoko_jesse_dance_60j.bvh", "humanik"},
      {"bvh/t2m_20fps.bvh", "lafan1"},
      {"bvh/xsens_style_crlf.bvh", "xsens_bvh"},
  };
  for (const auto& [file, name] : files) {
    EXPECT_EQ(unknown_joints(*shared() / "data" / file, convention(name)), std::set<std::string>{})
        << file;
  }
}

}  // namespace
}  // namespace limber::test
