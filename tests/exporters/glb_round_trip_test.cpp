// A clip written to GLB and read back, by our reader and by assimp, is the clip.

#include <gtest/gtest.h>

#include "exporters/exporter.h"
#include "tests/exporters/support.h"

namespace limber::test {
namespace {

class GlbRoundTrip : public testing::TestWithParam<ReaderChoice> {
 protected:
  /// Exports, reads back and compares joints and time.
  Imported expect_same(const Character& character, const Clip& clip, double metres = 1e-5,
                       double radians = 1e-5) {
    const auto glb = export_glb(character, clip);
    EXPECT_TRUE(glb.ok()) << glb.error().message;
    if (!glb) return {};
    auto back = read_back(*glb, "glb", GetParam());
    EXPECT_TRUE(back.ok()) << back.error().code << ": " << back.error().message;
    if (!back || back->clips.size() != 1) {
      ADD_FAILURE() << "no clip came back";
      return {};
    }
    const Clip& read = back->clips[0];
    EXPECT_EQ(read.frames(), clip.frames());
    EXPECT_NEAR(read.rate_hz, clip.rate_hz, 1e-6 * clip.rate_hz);
    if (read.frames() != clip.frames()) return {};
    const Difference d = compare(character.skeleton, clip, back->character.skeleton, read);
    EXPECT_EQ(d.joints, character.skeleton.size());
    EXPECT_LT(d.metres, metres);
    EXPECT_LT(d.radians, radians);
    return std::move(*back);
  }
};

TEST_P(GlbRoundTrip, BareSkeletonKeepsEveryPose) {
  Random random(1);
  for (int n = 0; n < 5; ++n) {
    const Character character = bare_character(random_skeleton(12, random));
    expect_same(character, random_clip(character.skeleton, 40, random, 5));
  }
}

TEST_P(GlbRoundTrip, RatesFromFilmToMotionCapture) {
  Random random(2);
  const Character character = bare_character(random_skeleton(6, random));
  for (const double rate : {24.0, 25.0, 30.0, 60.0, 120.0, 240.0}) {
    Clip clip = random_clip(character.skeleton, 31, random);
    clip.rate_hz = rate;
    expect_same(character, clip);
  }
}

TEST_P(GlbRoundTrip, SeveralRoots) {
  Random random(3);
  Skeleton skeleton = random_skeleton(8, random);
  skeleton.parents[4] = kNoJoint;
  Character character = bare_character(std::move(skeleton));
  const Clip clip = random_clip(character.skeleton, 10, random);
  expect_same(character, clip);
  character.meshes.push_back(random_mesh(character.skeleton, 30, 2, random));
  expect_same(character, clip);
}

TEST_P(GlbRoundTrip, SkinnedVerticesStandWhereTheyStood) {
  Random random(4);
  Character character = bare_character(random_skeleton(9, random));
  character.meshes.push_back(random_mesh(character.skeleton, 60, 3, random));
  character.meshes[0].material = 0;
  character.materials.push_back({"red", {1.0F, 0.2F, 0.1F, 1.0F}, -1, true});
  const Clip clip = random_clip(character.skeleton, 12, random);
  const Imported back = expect_same(character, clip);
  ASSERT_EQ(back.character.meshes.size(), 1U);
  const Mesh& mesh = back.character.meshes[0];
  // Readers may order and weld vertices anew, so corners of triangles are compared.
  ASSERT_EQ(mesh.triangles.size(), character.meshes[0].triangles.size());
  for (const std::int64_t f : {0, 5, 11}) {
    const auto corners = [&](const Character& c, const Clip& motion) {
      std::vector<DualQuaternion> model(c.skeleton.parents.size());
      model_from_local(c.skeleton, motion.frame(f), model);
      std::vector<Eigen::Vector3f> posed(c.meshes[0].positions.size()), out;
      skin_positions(c.meshes[0], model, posed);
      for (const std::uint32_t i : c.meshes[0].triangles) out.push_back(posed[i]);
      return out;
    };
    const auto before = corners(character, clip), after = corners(back.character, back.clips[0]);
    for (std::size_t i = 0; i < before.size(); ++i) {
      EXPECT_LT((before[i] - after[i]).norm(), 2e-5F) << "corner " << i << ", frame " << f;
    }
  }
}

TEST_P(GlbRoundTrip, StillClipKeepsItsLength) {
  Random random(5);
  const Character character = bare_character(random_skeleton(4, random));
  Clip clip;
  clip.joints = 4;
  for (int f = 0; f < 7; ++f) {
    const auto& rest = character.skeleton.rest_parent_from_joint;
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), rest.begin(), rest.end());
  }
  const auto glb = export_glb(character, clip);
  ASSERT_TRUE(glb.ok());
  const auto back = read_back(*glb, "glb", GetParam());
  ASSERT_TRUE(back.ok()) << back.error().message;
  ASSERT_EQ(back->clips.size(), 1U);
  EXPECT_EQ(back->clips[0].frames(), 7);
}

INSTANTIATE_TEST_SUITE_P(Readers, GlbRoundTrip,
                         testing::Values(ReaderChoice::automatic, ReaderChoice::assimp),
                         [](const auto& info) {
                           return info.param == ReaderChoice::assimp ? "assimp" : "own";
                         });

TEST(Glb, SameInputSameBytes) {
  Random random(6);
  Character character = bare_character(random_skeleton(10, random));
  character.meshes.push_back(random_mesh(character.skeleton, 50, 6, random));
  const Clip clip = random_clip(character.skeleton, 20, random);
  const auto a = export_glb(character, clip), b = export_glb(character, clip);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(*a, *b);
}

TEST(Glb, TheSignOfAQuaternionMakesNoDifference) {
  Random random(7);
  const Character character = bare_character(random_skeleton(5, random));
  const Clip clip = random_clip(character.skeleton, 20, random);
  Clip flipped = clip;
  for (std::size_t i = 0; i < flipped.parent_from_joint.size(); ++i) {
    if (random.integer(0, 1) == 1) flipped.parent_from_joint[i] = -flipped.parent_from_joint[i];
  }
  const auto a = export_glb(character, clip), b = export_glb(character, flipped);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(*a, *b);
}

TEST(Glb, BadInputIsRefused) {
  Random random(8);
  const Character character = bare_character(random_skeleton(3, random));
  Clip clip = random_clip(character.skeleton, 3, random);
  EXPECT_EQ(export_glb(character, clip, {.joints = {3}}).error().code, "export-option");
  clip.parent_from_joint[4].real.x() = std::nan("");
  const auto bad = export_glb(character, clip);
  ASSERT_FALSE(bad.ok());
  EXPECT_EQ(bad.error().code, "clip-invalid");
  EXPECT_EQ(bad.error().frame, 1);
}

}  // namespace
}  // namespace limber::test
