// Our readers and assimp are independent: where both read a file, joints stand in the same places.
// Each file in which they don't is listed with the reason.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "tests/importers/support.h"

namespace limber::test {
namespace {

namespace fs = std::filesystem;

/// Why assimp cannot serve as a judge of a file.
const std::map<std::string, std::string> kLossy = {
    {"mixed_orders_60j.bvh", "Y-up offsets under a Z-up motion: assimp is told one axis for both"},
    {"cesium_man_embedded.gltf", "its nodes have no names; each reader invents its own"},
    {"khronos_simple_skin.gltf", "its nodes have no names; each reader invents its own"},
};

std::vector<fs::path> files_in(const fs::path& folder) {
  std::vector<fs::path> out;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder, ignored)) {
    const std::string extension = entry.path().extension().string();
    if (extension == ".bvh" || extension == ".glb" || extension == ".gltf" || extension == ".vrm") {
      out.push_back(entry.path());
    }
  }
  std::sort(out.begin(), out.end());
  return out;
}

/// Largest distance between joints of one name, as a share of the skeleton's size; told in words
/// where there is nothing to compare.
struct Difference {
  std::string fault;
  double share = 0.0;
};

double extent(const Imported& imported) {
  const Skeleton& skeleton = imported.character.skeleton;
  Eigen::AlignedBox3d box;
  for (const auto& p : joint_positions(skeleton, skeleton.rest_parent_from_joint)) box.extend(p);
  return std::max(box.diagonal().norm(), 1e-3);
}

Difference difference(const Imported& own, const Imported& other) {
  const Skeleton& a = own.character.skeleton;
  const Skeleton& b = other.character.skeleton;
  std::vector<std::pair<std::int32_t, std::int32_t>> shared;
  for (std::int32_t j = 0; j < a.size(); ++j) {
    if (own.character.deforming[j] == 0) continue;
    const std::int32_t k = b.find(a.names[j]);
    if (k == kNoJoint) return {"no joint " + a.names[j]};
    shared.emplace_back(j, k);
  }
  if (own.clips.size() != other.clips.size()) return {"another number of clips"};
  Difference out;
  const double size = extent(own);
  const auto compare = [&](std::span<const DualQuaternion> pose_a,
                           std::span<const DualQuaternion> pose_b) {
    const auto points_a = joint_positions(a, pose_a), points_b = joint_positions(b, pose_b);
    for (const auto& [j, k] : shared) {
      out.share = std::max(out.share, (points_a[j] - points_b[k]).norm() / size);
    }
  };
  compare(a.rest_parent_from_joint, b.rest_parent_from_joint);
  if (out.share > 1e-4) return {"the rest pose differs", out.share};
  for (std::size_t c = 0; c < own.clips.size(); ++c) {
    const Clip& x = own.clips[c];
    const Clip& y = other.clips[c];
    if (x.frames() != y.frames()) return {"another number of frames"};
    const std::int64_t step = std::max<std::int64_t>(1, x.frames() / 50);
    for (std::int64_t f = 0; f < x.frames(); f += step) compare(x.frame(f), y.frame(f));
  }
  return out;
}

/// Both with the unit and axis that ours found: guesses have tests of their own.
Difference read_with_both(const fs::path& path) {
  ImportOptions options;
  options.keep_reference_frame = true;
  const auto own = import_file(path, options);
  if (!own) return {"ours: " + own.error().code + " " + own.error().message};
  options.reader = ReaderChoice::assimp;
  options.unit_m = own->facts.unit_m;
  options.up = own->facts.up == "+Z" ? 'z' : 'y';
  const auto other = import_file(path, options);
  if (!other) return {"assimp: " + other.error().code + " " + other.error().message};
  return difference(*own, *other);
}

TEST(TwoReaders, AgreeOnEveryFileThatIsNotListed) {
  LIMBER_NEEDS_SHARED(data);
  int agreed = 0;
  for (const char* folder : {"bvh", "characters", "mocap_other"}) {
    for (const fs::path& path : files_in(*data / folder)) {
      const Difference found = read_with_both(path);
      const std::string name = path.filename().string();
      SCOPED_TRACE(name + ": " + found.fault);
      const bool same = found.fault.empty() && found.share < 1e-4;
      if (kLossy.contains(name)) {
        EXPECT_FALSE(same) << "listed as lossy, but it is not";
      } else {
        EXPECT_TRUE(same) << "share " << found.share;
        ++agreed;
      }
    }
  }
  EXPECT_GE(agreed, 20);
}

}  // namespace
}  // namespace limber::test
