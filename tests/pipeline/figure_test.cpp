// Understanding skeletons: roles, mirror images, limits of any character, unnamed joints.
#include <gtest/gtest.h>

#include <filesystem>
#include <regex>

#include "pipeline/anatomy.h"
#include "pipeline/codes.h"
#include "pipeline/conventions.h"
#include "pipeline/target.h"
#include "tests/pipeline/program.h"
#include "validation/limit_check.h"

namespace limber {
namespace {

TEST(Humanoid, MirroringTwiceIsTheSameRole) {
  for (int i = 0; i < kRoleCount; ++i) {
    const Role role = role_at(i);
    EXPECT_EQ(mirrored(mirrored(role)), role);
    EXPECT_EQ(role_named(name_of(role)), role);
    const auto parent = parent_of(role);
    if (parent) {
      EXPECT_EQ(parent_of(mirrored(role)), mirrored(*parent)) << name_of(role);
    }
  }
}

TEST(Anatomy, RightSideIsTheMirrorImage) {
  for (int i = kFirstLeft; i < kFirstRight; ++i) {
    const auto left = anatomical_limit(role_at(i));
    const auto right = anatomical_limit(mirrored(role_at(i)));
    ASSERT_EQ(left.has_value(), right.has_value());
    if (!left) continue;
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d m(left->axes[k].x(), -left->axes[k].y(), -left->axes[k].z());
      EXPECT_LT((m - right->axes[k]).norm(), 1e-12) << name_of(role_at(i));
      EXPECT_EQ(left->ranges[k].min, right->ranges[k].min);
    }
  }
}

TEST(Target, ShippedBodyRigsAreCalibratedAsTheyAre) {
  for (const char* name : {"biped", "biped-full", "biped-hands"}) {
    const auto target = load_target(name, {});
    ASSERT_TRUE(target) << target.error().message;
    EXPECT_TRUE(target->figure.is_body());
    // Fingers alone: the palm's axis runs to the middle knuckle, the fingers' along the hand.
    const bool fingers = target->figure.has_fingers(Side::left);
    EXPECT_LT(target->calibration.residual_deg, fingers ? 1.0 : 1e-3) << name;
    EXPECT_NEAR(target->calibration.sole, 0.0, 0.03) << name;
  }
}

TEST(Target, EveryRigStandsWithinItsOwnLimits) {
  for (const std::string& name : shipped_rig_names()) {
    const auto rig = shipped_rig(name);
    ASSERT_TRUE(rig) << name;
    EXPECT_TRUE(validate(*rig)) << name;
  }
}

/// Clavicles that hang from the neck (3ds Max Biped) make no trunk of it: it turns with the head.
TEST(Figure, AJointThatIsCalledNeckIsOneAlthoughTheArmsHangFromIt) {
  const auto target = load_target("biped-full", {});
  ASSERT_TRUE(target);
  const Figure& usual = target->figure;
  const std::int32_t neck = usual.at(Role::neck);
  Character character = target->character;
  for (const Role shoulder : {Role::leftShoulder, Role::rightShoulder}) {
    character.skeleton.parents[usual.at(shoulder)] = neck;
  }
  const auto figure = identify_figure(character);
  ASSERT_TRUE(figure);
  EXPECT_EQ(figure->neck, usual.neck);
  EXPECT_EQ(figure->spine, usual.spine);
}

/// The body rig with names that mean nothing: topology and geometry must find the same joints.
TEST(Figure, UnnamedSkeletonsAreFoundByTheirShape) {
  const auto target = load_target("biped-full", {});
  ASSERT_TRUE(target);
  Character anonymous = target->character;
  for (std::size_t j = 0; j < anonymous.roles.size(); ++j) {
    anonymous.roles[j].clear();
    anonymous.skeleton.names[j] = "node_" + std::to_string(j);
  }
  const auto figure = identify_figure(anonymous);
  ASSERT_TRUE(figure);
  EXPECT_EQ(figure->convention, "topology");
  for (const Role role :
       {Role::hips, Role::head, Role::leftUpperArm, Role::leftLowerArm, Role::leftHand,
        Role::rightUpperArm, Role::rightHand, Role::leftUpperLeg, Role::leftLowerLeg,
        Role::leftFoot, Role::rightLowerLeg, Role::rightFoot}) {
    EXPECT_EQ(figure->at(role), target->figure.at(role)) << name_of(role);
  }
}

TEST(Figure, AChairIsRefused) {
  Character chair;
  chair.skeleton.names = {"seat", "back", "leg1", "leg2"};
  chair.skeleton.parents = {-1, 0, 0, 0};
  chair.skeleton.rest_parent_from_joint.resize(4);
  chair.deforming.assign(4, 1);
  chair.roles.assign(4, "");
  const auto figure = identify_figure(chair);
  ASSERT_FALSE(figure);
  EXPECT_EQ(figure.error().code, "map-not-a-figure");
}

TEST(Codes, AreSortedUniqueAndComplete) {
  const auto codes = all_codes();
  for (std::size_t i = 0; i < codes.size(); ++i) {
    EXPECT_FALSE(codes[i].meaning.empty());
    EXPECT_FALSE(codes[i].way_out.empty());
    if (i > 0) {
      EXPECT_LT(codes[i - 1].code, codes[i].code);
    }
    EXPECT_EQ(find_code(codes[i].code), &codes[i]);
  }
}

/// Literals of our sources that look like codes but are names.
bool is_no_code(const std::string& text) {
  for (const char* name : {"in-place", "limber-bvh", "limber-gltf", "limber-rig", "pgs-paper",
                           "reference-frame", "system-out"}) {
    if (text == name) return true;
  }
  return false;
}

TEST(Codes, EveryCodeInTheSourcesIsExplained) {
  const std::regex literal("\"([a-z0-9]+(?:-[a-z0-9]+)+)\"");
  int seen = 0;
  for (const char* folder :
       {"assets/model", "importers", "exporters", "solver", "validation", "pipeline"}) {
    for (const auto& entry :
         std::filesystem::directory_iterator(limber_test::source_root() / folder)) {
      if (!entry.is_regular_file() || entry.path().filename() == "codes.cpp") continue;
      const std::string text = limber_test::text_of(entry.path());
      for (std::sregex_iterator it(text.begin(), text.end(), literal), end; it != end; ++it) {
        const std::string code = (*it)[1];
        if (is_no_code(code)) continue;
        EXPECT_NE(find_code(code), nullptr) << code << " in " << entry.path();
        ++seen;
      }
    }
  }
  EXPECT_GT(seen, 50);
}

}  // namespace
}  // namespace limber
