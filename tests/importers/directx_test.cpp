// DirectX files, written by hand: left-handed, Y up, row vectors.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/importers/support.h"

namespace limber::test {
namespace {

/// Row-major, for row vectors: a turn by a quarter about Y, as Direct3D turns, takes +Z to +X.
/// All numbers have a point, as exporters write them: assimp takes the comma of "1,0" for one.
std::string matrix(bool quarter_turn, const Eigen::Vector3d& place) {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  if (quarter_turn) m.topLeftCorner<3, 3>() << 0, 0, -1, 0, 1, 0, 1, 0, 0;
  m.bottomLeftCorner<1, 3>() = place.transpose();
  std::string out;
  for (int row = 0; row < 4; ++row) {
    for (int c = 0; c < 4; ++c) {
      out += fmt::format("{}{:.6f}", row + c == 0 ? "" : ",", m(row, c));
    }
  }
  return out;
}

std::string animation(const char* joint, bool turns, const Eigen::Vector3d& place) {
  return fmt::format(
      "Animation {{\n{{ {} }}\nAnimationKey {{\n4;\n2;\n0; 16; {};;,\n30; 16; {};;;\n}}\n}}\n",
      joint, matrix(false, place), matrix(turns, place));
}

/// Two joints; the first turns by a quarter within a second.
std::string figure() {
  const Eigen::Vector3d a(0, 1, 0), b(0, 0.5, 2);
  return "xof 0303txt 0032\nAnimTicksPerSecond { 30; }\nFrame above {\nFrame a {\n"
         "FrameTransformMatrix { " +
         matrix(false, a) + ";; }\nFrame b {\nFrameTransformMatrix { " + matrix(false, b) +
         ";; }\n}\n}\n}\nAnimationSet turn {\n" + animation("a", true, a) +
         animation("b", false, b) + "}\n";
}

TEST(DirectX, BecomesRightHandedWithItsMotion) {
  ImportOptions options;
  options.unit_m = 1.0;
  const auto imported = import_text(figure(), "x", options);
  ASSERT_TRUE(imported) << imported.error().message;
  EXPECT_EQ(imported->facts.format, "x");
  EXPECT_EQ(imported->facts.up, "+Y");
  const Skeleton& skeleton = imported->character.skeleton;
  const std::int32_t b = skeleton.find("b");
  ASSERT_NE(b, kNoJoint);
  const auto rest = joint_positions(skeleton, skeleton.rest_parent_from_joint);
  EXPECT_LT((rest[b] - Eigen::Vector3d(0, 1.5, -2)).norm(), 1e-6);
  ASSERT_EQ(imported->clips.size(), 1U);
  const Clip& clip = imported->clips[0];
  EXPECT_EQ(clip.name, "turn");
  EXPECT_DOUBLE_EQ(clip.duration_s(), 1.0);
  const auto first = joint_positions(skeleton, clip.frame(0));
  const auto last = joint_positions(skeleton, clip.frame(clip.frames() - 1));
  EXPECT_LT((first[b] - Eigen::Vector3d(0, 1.5, -2)).norm(), 1e-6);
  EXPECT_LT((last[b] - Eigen::Vector3d(2, 1.5, 0)).norm(), 1e-6);
}

TEST(DirectX, FilesOfSurfacesAloneAreRefusedWithTheReason) {
  for (const char* kind : {"obj", "stl", "ply"}) {
    const auto imported = import_text("v 0 0 0\n", kind);
    ASSERT_FALSE(imported);
    EXPECT_EQ(imported.error().code, "format-unknown");
    EXPECT_NE(imported.error().message.find("neither joints nor motion"), std::string::npos);
  }
}

/// assimp's own models, where they are installed.
TEST(DirectX, RealFilesKeepEveryInvariant) {
  const std::filesystem::path folder = "/usr/share/assimp/models/X";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no models; apt install assimp-testmodels";
  for (const auto& [name, clips, frames] :
       {std::tuple("BCN_Epileptic.X", 1, 100), std::tuple("anim_test.x", 1, 24)}) {
    const auto imported = import_file(folder / name);
    ASSERT_TRUE(imported) << imported.error().message;
    EXPECT_EQ(imported->clips.size(), std::size_t(clips)) << name;
    EXPECT_EQ(imported->facts.frames, frames) << name;
  }
}

}  // namespace
}  // namespace limber::test
