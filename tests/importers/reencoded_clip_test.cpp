// Whole clips written anew in every dialect: once canonical, they move as the original does.

#include <gtest/gtest.h>

#include "tests/importers/bvh_dialects.h"
#include "tests/importers/support.h"

namespace limber::test {
namespace {

constexpr int kFrames = 150;

/// A clip's joints without End Sites, and the first seconds of its motion.
struct Original {
  Imported imported;
  std::vector<std::int32_t> joints;  ///< of the skeleton, document order

  explicit Original(Imported from) : imported(std::move(from)) {
    for (std::int32_t j = 0; j < imported.character.skeleton.size(); ++j) {
      if (imported.character.deforming[j] != 0) joints.push_back(j);
    }
  }
  const Skeleton& skeleton() const { return imported.character.skeleton; }
  const Clip& clip() const { return imported.clips[0]; }
  int frames() const { return std::min(kFrames, static_cast<int>(clip().frames())); }

  Performance performance() const {
    std::vector<int> row(skeleton().parents.size(), -1);
    Performance out;
    for (std::size_t k = 0; k < joints.size(); ++k) {
      const std::int32_t j = joints[k];
      const std::int32_t parent = skeleton().parents[j];
      row[j] = static_cast<int>(k);
      out.joints.push_back({skeleton().names[j], parent == kNoJoint ? -1 : row[parent],
                            skeleton().rest_parent_from_joint[j].translation()});
    }
    out.rotation = [this](int k, int f) { return clip().frame(f)[joints[k]].rotation(); };
    out.root = [this](int f) { return clip().frame(f)[joints[0]].translation(); };
    return out;
  }
};

/// Largest distance of a joint from where the original has it, m.
double largest_miss(const Original& original, const Imported& copy) {
  const auto& deforming = copy.character.deforming;
  double miss = 0.0;
  for (int f = 0; f < original.frames(); ++f) {
    const auto wanted = joint_positions(original.skeleton(), original.clip().frame(f));
    const auto found = joint_positions(copy.character.skeleton, copy.clips[0].frame(f));
    std::size_t k = 0;
    for (std::size_t j = 0; j < found.size(); ++j) {
      if (deforming[j] == 0) continue;
      miss = std::max(miss, (found[j] - wanted[original.joints[k++]]).norm());
    }
    EXPECT_EQ(k, original.joints.size());
  }
  return miss;
}

void expect_all_dialects_agree(const std::filesystem::path& path) {
  auto imported = import_file(path);
  ASSERT_TRUE(imported) << imported.error().message;
  const Original original(std::move(*imported));
  for (NamedDialect& named : dialects()) {
    SCOPED_TRACE(named.name);
    Dialect& dialect = named.dialect;
    dialect.frames = original.frames();
    const auto copy = import_text(BvhWriter(dialect, original.performance()).write(), "bvh");
    ASSERT_TRUE(copy) << copy.error().message;
    EXPECT_NEAR(copy->facts.unit_m, dialect.unit_m, 1e-12) << copy->facts.unit_evidence;
    ASSERT_EQ(copy->clips[0].frames(), original.frames());
    EXPECT_EQ(copy->character.skeleton.names[0],
              dialect.name_prefix_utf8 + original.skeleton().names[0]);
    EXPECT_LT(largest_miss(original, *copy), 1e-4);
  }
}

TEST(ReencodedClip, OurOwnBodyMovesAlikeInEveryDialect) {
  expect_all_dialects_agree(std::filesystem::path(LIMBER_SOURCE_DIR) /
                            "assets/data/clips/body_range_of_motion.bvh");
}

TEST(ReencodedClip, ARealJumpMovesAlikeInEveryDialect) {
  const std::filesystem::path jump = "/usr/share/assimp/models/BVH/01_01.bvh";
  if (!std::filesystem::exists(jump)) GTEST_SKIP() << "assimp-testmodels is not installed";
  expect_all_dialects_agree(jump);
}

}  // namespace
}  // namespace limber::test
