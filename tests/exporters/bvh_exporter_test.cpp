// BVH written and read back is the clip; its text follows the rules that other programs need.

#include <gtest/gtest.h>

#include <set>
#include <sstream>

#include "exporters/exporter.h"
#include "tests/exporters/support.h"

namespace limber::test {
namespace {

Eigen::Quaterniond zxy(double z, double x, double y) {
  return Eigen::AngleAxisd(z, Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(x, Eigen::Vector3d::UnitX()) *
         Eigen::AngleAxisd(y, Eigen::Vector3d::UnitY());
}

/// Offsets as they stand, no rest rotation: what a BVH can hold.
Skeleton bvh_skeleton(int joints, Random& random) {
  Skeleton skeleton = random_skeleton(joints, random);
  for (DualQuaternion& q : skeleton.rest_parent_from_joint) {
    q = DualQuaternion::from_translation(q.translation());
  }
  return skeleton;
}

/// The motion rows of a BVH.
std::vector<std::vector<double>> rows(const std::string& bvh) {
  std::istringstream in(bvh.substr(bvh.find("Frame Time:")));
  std::string line;
  std::getline(in, line);
  std::vector<std::vector<double>> out;
  while (std::getline(in, line)) {
    std::istringstream numbers(line);
    out.emplace_back(std::istream_iterator<double>(numbers), std::istream_iterator<double>());
  }
  return out;
}

class BvhRoundTrip : public testing::TestWithParam<ReaderChoice> {
 protected:
  void expect_same(const Character& character, const Clip& clip) {
    const auto bvh = export_bvh(character, clip);
    ASSERT_TRUE(bvh.ok()) << bvh.error().message;
    const auto back = read_back(to_bytes(*bvh), "bvh", GetParam());
    ASSERT_TRUE(back.ok()) << back.error().code << ": " << back.error().message;
    ASSERT_EQ(back->clips.size(), 1U);
    ASSERT_EQ(back->clips[0].frames(), clip.frames());
    EXPECT_NEAR(back->clips[0].rate_hz, clip.rate_hz, 1e-5 * clip.rate_hz);
    const Difference d =
        compare(character.skeleton, clip, back->character.skeleton, back->clips[0]);
    EXPECT_EQ(d.joints, character.skeleton.size());
    EXPECT_LT(d.metres, 1e-5);
    EXPECT_LT(d.radians, 1e-5);
  }
};

TEST_P(BvhRoundTrip, RandomMotion) {
  Random random(11);
  for (int n = 0; n < 5; ++n) {
    const Character character = bare_character(random_skeleton(12, random));
    expect_same(character, random_clip(character.skeleton, 30, random));
  }
}

TEST_P(BvhRoundTrip, AJointThatSlides) {
  Random random(12);
  const Character character = bare_character(random_skeleton(9, random));
  expect_same(character, random_clip(character.skeleton, 20, random, 6));
}

TEST_P(BvhRoundTrip, ThroughGimbalLock) {
  Random random(13);
  const Character character = bare_character(bvh_skeleton(3, random));
  Clip clip;
  clip.rate_hz = 60.0;
  clip.joints = 3;
  for (int f = 0; f <= 100; ++f) {
    // x runs through 90 degrees, exactly at frame 50, while z and y turn as well.
    const double x = M_PI / 2 + 0.01 * (f - 50);
    for (int j = 0; j < 3; ++j) {
      const auto& rest = character.skeleton.rest_parent_from_joint[j];
      clip.parent_from_joint.push_back(DualQuaternion::from_rotation_translation(
          zxy(0.3 + 0.01 * f, j == 1 ? -x : x, 0.02 * f), rest.translation()));
    }
  }
  expect_same(character, clip);
  // At 90 degrees only z + y (or y - z) is told; neither may jump there.
  const auto values = rows(*export_bvh(character, clip));
  for (std::size_t f = 1; f < values.size(); ++f) {
    for (std::size_t c = 3; c < values[f].size(); ++c) {
      EXPECT_LT(std::abs(values[f][c] - values[f - 1][c]), 5.0) << "frame " << f << " value " << c;
    }
  }
}

TEST_P(BvhRoundTrip, SeveralRootsHangBelowOne) {
  Random random(14);
  Skeleton skeleton = random_skeleton(6, random);
  skeleton.parents[3] = kNoJoint;
  const Character character = bare_character(std::move(skeleton));
  expect_same(character, random_clip(character.skeleton, 10, random));
}

INSTANTIATE_TEST_SUITE_P(Readers, BvhRoundTrip,
                         testing::Values(ReaderChoice::automatic, ReaderChoice::assimp),
                         [](const auto& info) {
                           return info.param == ReaderChoice::assimp ? "assimp" : "own";
                         });

TEST(Bvh, AnglesNeverJump) {
  Random random(15);
  const Character character = bare_character(bvh_skeleton(2, random));
  Clip clip;
  clip.rate_hz = 30.0;
  clip.joints = 2;
  for (int f = 0; f < 200; ++f) {  // three full turns about y, wobbling in x far from 90 degrees
    for (int j = 0; j < 2; ++j) {
      clip.parent_from_joint.push_back(DualQuaternion::from_rotation_translation(
          zxy(0.2 * std::sin(0.1 * f), 0.5 * std::sin(0.07 * f), 6.0 * M_PI * f / 199.0),
          character.skeleton.rest_parent_from_joint[j].translation()));
    }
  }
  const auto bvh = export_bvh(character, clip);
  ASSERT_TRUE(bvh.ok());
  const auto values = rows(*bvh);
  ASSERT_EQ(values.size(), 200U);
  for (std::size_t f = 1; f < values.size(); ++f) {
    ASSERT_EQ(values[f].size(), 9U);
    for (std::size_t c = 3; c < 9; ++c) EXPECT_LT(std::abs(values[f][c] - values[f - 1][c]), 15.0);
  }
  EXPECT_NEAR(values.back()[5], 1080.0, 1e-4);  // the turns are counted, not folded
}

TEST(Bvh, KnownAnglesAreWrittenInTheOrderOfTheChannels) {
  Random random(16);
  const Character character = bare_character(bvh_skeleton(1, random));
  Clip clip;
  clip.joints = 1;
  const double degree = M_PI / 180.0;
  clip.parent_from_joint = {DualQuaternion::from_rotation_translation(
      zxy(10 * degree, 20 * degree, 30 * degree), {1.0, 2.0, -3.0})};
  const auto bvh = export_bvh(character, clip);
  ASSERT_TRUE(bvh.ok());
  const std::vector<double> expected = {100, 200, -300, 10, 20, 30};
  ASSERT_EQ(rows(*bvh).size(), 1U);
  for (int k = 0; k < 6; ++k) EXPECT_NEAR(rows(*bvh)[0][k], expected[k], 1e-6);
  EXPECT_NE(bvh->find("CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"),
            std::string::npos);
}

TEST(Bvh, NamesHaveNoSpacesAndStayUnique) {
  Random random(17);
  Skeleton skeleton = bvh_skeleton(4, random);
  skeleton.names = {"the hips", "the_hips", "a{b}", "\tc"};
  const Character character = bare_character(std::move(skeleton));
  const auto bvh = export_bvh(character, random_clip(character.skeleton, 2, random));
  ASSERT_TRUE(bvh.ok());
  std::istringstream in(*bvh);
  std::set<std::string> names;
  std::string word;
  while (in >> word && word != "MOTION") {
    if (word != "ROOT" && word != "JOINT") continue;
    in >> word;
    EXPECT_EQ(word.find_first_of("{} \t"), std::string::npos);
    EXPECT_TRUE(names.insert(word).second) << word;
  }
  EXPECT_EQ(names.size(), 4U);
}

TEST(Bvh, AStillEndJointBecomesAnEndSiteAgain) {
  Skeleton skeleton;
  skeleton.names = {"Hips", "Head", "Head_End"};
  skeleton.parents = {kNoJoint, 0, 1};
  for (const double y : {1.0, 0.5, 0.2}) {
    skeleton.rest_parent_from_joint.push_back(DualQuaternion::from_translation({0, y, 0}));
  }
  const Character character = bare_character(std::move(skeleton));
  Clip clip;
  clip.joints = 3;
  clip.parent_from_joint = character.skeleton.rest_parent_from_joint;
  const auto bvh = export_bvh(character, clip);
  ASSERT_TRUE(bvh.ok());
  EXPECT_EQ(bvh->find("Head_End"), std::string::npos);
  EXPECT_NE(bvh->find("OFFSET 0.000000 20.000000 0.000000"), std::string::npos);
}

TEST(Bvh, OtherEndJointsKeepTheirNames) {
  Skeleton skeleton;
  skeleton.names = {"Head", "HeadTop_End"};
  skeleton.parents = {kNoJoint, 0};
  skeleton.rest_parent_from_joint.assign(2, DualQuaternion::from_translation({0, 0.2, 0}));
  const Character character = bare_character(std::move(skeleton));
  Clip clip;
  clip.joints = 2;
  clip.parent_from_joint = character.skeleton.rest_parent_from_joint;
  const auto bvh = export_bvh(character, clip);
  ASSERT_TRUE(bvh.ok());
  EXPECT_NE(bvh->find("JOINT HeadTop_End"), std::string::npos);
}

TEST(Bvh, UnitScalesLengthsOnly) {
  Random random(18);
  const Character character = bare_character(random_skeleton(3, random));
  const Clip clip = random_clip(character.skeleton, 3, random);
  const auto cm = export_bvh(character, clip), m = export_bvh(character, clip, {.unit_m = 1.0});
  ASSERT_TRUE(cm.ok() && m.ok());
  for (int k = 0; k < 6; ++k) {
    EXPECT_NEAR(rows(*cm)[2][k], rows(*m)[2][k] * (k < 3 ? 100.0 : 1.0), 1e-4);
  }
  EXPECT_EQ(export_bvh(character, clip, {.unit_m = 0.0}).error().code, "export-option");
}

}  // namespace
}  // namespace limber::test
