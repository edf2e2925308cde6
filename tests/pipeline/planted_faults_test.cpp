// `limber validate` finds what is wrong with a file, whoever wrote it: each fault is planted into
// good files, a GLB and a BVH of ours and a GLB that three.js wrote.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>

#include "assets/model/mannequin.h"
#include "exporters/exporter.h"
#include "importers/importer.h"
#include "pipeline/target.h"
#include "tests/pipeline/program.h"

namespace limber_test {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;
using limber::Clip;
using limber::DualQuaternion;
using nlohmann::json;

constexpr double kDegree = M_PI / 180.0;
constexpr std::int64_t kFrames = 150;
constexpr const char* kRig = "biped-full";

Quaterniond about(const Vector3d& axis, double degrees) {
  return Quaterniond(Eigen::AngleAxisd(degrees * kDegree, axis));
}

/// 0 outside [first, last], a smooth hump of height 1 inside.
double hump(std::int64_t frame, std::int64_t first, std::int64_t last) {
  if (frame <= first || frame >= last) return 0.0;
  return std::pow(std::sin(M_PI * double(frame - first) / double(last - first)), 2);
}

/// A body that stands, waves with its right arm, swings the left one and lifts its left foot once.
struct Performer {
  limber::Rig rig = *limber::shipped_rig(kRig);
  limber::Character character = limber::mannequin(rig);
  Clip clip;

  Performer() {
    clip.rate_hz = 30.0;
    clip.joints = character.skeleton.size();
    for (std::int64_t f = 0; f < kFrames; ++f) {
      const auto& rest = character.skeleton.rest_parent_from_joint;
      clip.parent_from_joint.insert(clip.parent_from_joint.end(), rest.begin(), rest.end());
      const double wave = std::sin(0.2 * double(f)), lift = hump(f, 75, 148);
      turn(f, "leftUpperArm",
           about(Vector3d::UnitZ(), -65.0) * about(Vector3d::UnitY(), 15 * wave));
      turn(f, "leftLowerArm", about(Vector3d::UnitY(), -15.0));
      turn(f, "rightUpperArm", about(Vector3d::UnitZ(), -10.0 + 15.0 * wave));
      turn(f, "rightLowerArm", about(Vector3d::UnitY(), 60.0 - 25.0 * wave));
      turn(f, "leftUpperLeg", about(Vector3d::UnitX(), -35.0 * lift));
      turn(f, "leftLowerLeg", about(Vector3d::UnitX(), 55.0 * lift));
    }
  }

  void turn(std::int64_t frame, const std::string& joint, const Quaterniond& by) {
    DualQuaternion& local = clip.frame(frame)[character.skeleton.find(joint)];
    local = local * DualQuaternion::from_rotation(by);
  }
};

/// A file read back, to be spoilt.
struct Motion {
  limber::Character character;
  Clip clip;

  std::int32_t joint(const std::string& name) const { return character.skeleton.find(name); }
  void set_rotation(std::int64_t frame, const std::string& name, const Quaterniond& rotation) {
    DualQuaternion& local = clip.frame(frame)[joint(name)];
    local = DualQuaternion::from_rotation_translation(rotation.normalized(), local.translation());
  }
  Quaterniond rotation(std::int64_t frame, const std::string& name) const {
    return clip.frame(frame)[joint(name)].rotation();
  }
};

struct Fault {
  const char* name;
  std::function<void(Motion&)> plant;
  std::vector<std::string> codes;  ///< any of these is right
  std::string joint;               ///< that the one named begins with
};

const limber::RigJoint& row(const std::string& name) {
  static const limber::Rig rig = *limber::shipped_rig(kRig);
  return rig.joints[rig.find(name)];
}

/// The elbow one degree further than it may bend, for one frame, coming and going smoothly.
void bend_beyond(Motion& m) {
  const limber::RigJoint& elbow = row("leftLowerArm");
  const double most = elbow.limits[0].max + kDegree;
  for (std::int64_t f = 40; f < 90; ++f) {
    const Quaterniond now = m.rotation(f, elbow.name);
    const Quaterniond bent = elbow.rest * Quaterniond(Eigen::AngleAxisd(most, elbow.axes[0]));
    m.set_rotation(f, elbow.name, now.slerp(hump(f, 40, 90), bent));
  }
}

void drop_frame(Motion& m) {
  auto& poses = m.clip.parent_from_joint;
  poses.erase(poses.begin() + 70 * m.clip.joints, poses.begin() + 71 * m.clip.joints);
}

void scale_bone(Motion& m) {
  const std::int32_t shank = m.joint("rightLowerLeg");
  for (std::int64_t f = 0; f < m.clip.frames(); ++f) {
    DualQuaternion& local = m.clip.frame(f)[shank];
    local = DualQuaternion::from_rotation_translation(local.rotation(), 1.02 * local.translation());
  }
}

/// The right foot, which stands all the time, goes 6 cm forward and back.
void slide_foot(Motion& m) {
  for (std::int64_t f = 20; f < 60; ++f) {
    m.set_rotation(
        f, "rightUpperLeg",
        about(Vector3d::UnitX(), -4.0 * hump(f, 20, 60)) * m.rotation(f, "rightUpperLeg"));
  }
}

/// Each arm takes the other's part, as a rig with its hands the wrong way round does.
Quaterniond mirror(const Quaterniond& q) { return {q.w(), q.x(), -q.y(), -q.z()}; }

std::string other_side(const std::string& name) {
  if (name.starts_with("left")) return "right" + name.substr(4);
  if (name.starts_with("right")) return "left" + name.substr(5);
  return name;
}

void swap_hands(Motion& m) {
  for (std::int64_t f = 0; f < m.clip.frames(); ++f) {
    for (const std::string part : {"Shoulder", "UpperArm", "LowerArm", "Hand"}) {
      if (m.joint("left" + part) == limber::kNoJoint) continue;
      const Quaterniond left = m.rotation(f, "left" + part), right = m.rotation(f, "right" + part);
      m.set_rotation(f, "left" + part, mirror(right));
      m.set_rotation(f, "right" + part, mirror(left));
    }
  }
}

void pop_elbow(Motion& m) {
  const limber::RigJoint& elbow = row("rightLowerArm");
  const double middle = 0.5 * (elbow.limits[0].min + elbow.limits[0].max);
  m.set_rotation(55, elbow.name,
                 elbow.rest * Quaterniond(Eigen::AngleAxisd(middle, elbow.axes[0])));
}

void mirror_clip(Motion& m) {
  const Clip whole = m.clip;
  for (std::int64_t f = 0; f < whole.frames(); ++f) {
    for (std::int32_t j = 0; j < whole.joints; ++j) {
      const std::int32_t twin = m.joint(other_side(m.character.skeleton.names[j]));
      const DualQuaternion& from = whole.frame(f)[twin == limber::kNoJoint ? j : twin];
      const Vector3d t = from.translation();
      m.clip.frame(f)[j] = DualQuaternion::from_rotation_translation(mirror(from.rotation()),
                                                                     {-t.x(), t.y(), t.z()});
    }
  }
}

std::vector<Fault> faults() {
  return {{"a joint beyond its limit", bend_beyond, {"limits-violated"}, "leftLowerArm"},
          {"a dropped frame", drop_frame, {"clip-frames"}, ""},
          {"a scaled bone", scale_bone, {"bone-length"}, "rightLowerLeg"},
          {"a slid foot", slide_foot, {"foot-slips"}, "right"},
          {"swapped hands", swap_hands, {"sides-arms-swapped"}, ""},
          {"a popped elbow", pop_elbow, {"motion-pops"}, "rightLowerArm"},
          {"a wrong rate", [](Motion& m) { m.clip.rate_hz = 25.0; }, {"clip-rate"}, ""},
          {"a mirrored clip", mirror_clip, {"sides-mirrored"}, ""}};
}

Motion read(const fs::path& path) {
  const std::string text = text_of(path);
  const auto bytes = std::as_bytes(std::span(text.data(), text.size()));
  limber::ImportOptions options;
  options.keep_reference_frame = true;
  auto imported = limber::import_bytes(
      bytes, path.extension().string().substr(1),
      [](std::string_view) { return limber::Error{.code = "uri-refused", .message = ""}; },
      options);
  EXPECT_TRUE(imported) << path;
  return {std::move(imported->character), std::move(imported->clips.front())};
}

void write(const fs::path& path, const Motion& m) {
  if (path.extension() == ".bvh") {
    const auto text = limber::export_bvh(m.character, m.clip);
    ASSERT_TRUE(text);
    write_text(path, *text);
    return;
  }
  const auto bytes = limber::export_glb(m.character, m.clip);
  ASSERT_TRUE(bytes);
  write_text(path, std::string(reinterpret_cast<const char*>(bytes->data()), bytes->size()));
}

/// Source and good outputs, made by the program itself.
class PlantedFaults : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new Folder;
    const Performer performer;
    write_text(*folder_ / "source.bvh", *limber::export_bvh(performer.character, performer.clip));
    const auto run = limber({"retarget", (*folder_ / "source.bvh").string(), "--target", kRig, "-o",
                             folder_->string(), "--refine", "none"});
    ASSERT_EQ(run.exit_code, 0) << run.out;
  }
  static void TearDownTestSuite() { delete folder_; }

  static fs::path good(const std::string& extension) {
    return *folder_ / (std::string("source@") + kRig + "." + extension);
  }

  static json validated(const fs::path& file) {
    const auto run = limber({"validate", file.string(), "--source",
                             (*folder_ / "source.bvh").string(), "--rig", kRig, "--json"});
    json found = json::parse(run.out, nullptr, false);
    EXPECT_EQ(run.exit_code, found.value("status", "") == "fail" ? 1 : 0) << run.out;
    return found;
  }

  static bool names(const json& found, const Fault& fault) {
    for (const json& finding : found["findings"]) {
      const bool right = std::ranges::count(fault.codes, finding["code"].get<std::string>()) > 0;
      if (right && finding.value("joint", "").starts_with(fault.joint)) return true;
    }
    return false;
  }

  /// `rewrite` makes the file that is judged of one that we wrote.
  static void expect_found(const std::string& extension,
                           const std::function<fs::path(const fs::path&)>& rewrite) {
    const Motion whole = read(good(extension));
    const fs::path file = *folder_ / ("planted." + extension);
    write(file, whole);
    const json clean = validated(rewrite(file));
    EXPECT_EQ(clean["status"], "pass") << clean["findings"];
    for (const Fault& fault : faults()) {
      Motion spoilt = whole;
      fault.plant(spoilt);
      write(file, spoilt);
      const json found = validated(rewrite(file));
      EXPECT_NE(found["status"], "pass") << fault.name;
      EXPECT_TRUE(names(found, fault)) << fault.name << "\n" << found["findings"].dump(1);
    }
  }

  static Folder* folder_;
};
Folder* PlantedFaults::folder_ = nullptr;

fs::path as_it_is(const fs::path& file) { return file; }

TEST_F(PlantedFaults, OfOurGlbAreFound) { expect_found("glb", as_it_is); }

TEST_F(PlantedFaults, OfOurBvhAreFound) { expect_found("bvh", as_it_is); }

fs::path by_three(const fs::path& file) {
  const fs::path out = file.parent_path() / "three.glb";
  const fs::path script = source_root() / "tests/pipeline/three_rewrite.mjs";
  const std::string command = "node '" + script.string() + "' '" + file.string() + "' '" +
                              out.string() + "' >'" + out.string() + ".log' 2>&1";
  EXPECT_EQ(std::system(command.c_str()), 0) << text_of(out.string() + ".log");
  return out;
}

TEST_F(PlantedFaults, OfAFileThatThreeWroteAreFound) {
  if (std::getenv("LIMBER_NODE_MODULES") == nullptr) {
    GTEST_SKIP() << "npm packages not installed (LIMBER_NODE_MODULES)";
  }
  expect_found("glb", by_three);
}

TEST_F(PlantedFaults, AKeyThatIsMissingInAFileOfKeysIsFound) {
  // three.js keeps key times as they are: the frame is gone, and the clip lasts as long.
  if (std::getenv("LIMBER_NODE_MODULES") == nullptr) {
    GTEST_SKIP() << "npm packages not installed (LIMBER_NODE_MODULES)";
  }
  ::setenv("THREE_DROP_KEY", "70", 1);
  const json found = validated(by_three(good("glb")));
  ::unsetenv("THREE_DROP_KEY");
  EXPECT_EQ(found["status"], "fail");
  EXPECT_TRUE(names(found, {"", {}, {"clip-key-missing"}, ""})) << found["findings"].dump(1);
}

TEST_F(PlantedFaults, OnlyTheNamedPartOfASourceCounts) {
  const fs::path out = *folder_ / "part";
  const std::string source = (*folder_ / "source.bvh").string();
  ASSERT_EQ(limber({"retarget", source, "--target", kRig, "-o", out.string(), "--refine", "none",
                    "--range", "30:89"})
                .exit_code,
            0);
  const std::string file = (out / "source@biped-full.glb").string();
  EXPECT_EQ(limber({"validate", file, "--source", source}).exit_code, 1);
  EXPECT_EQ(limber({"validate", file, "--source", source, "--range", "30:89"}).exit_code, 0);
  EXPECT_EQ(limber({"validate", file, "--source", source, "--range", "500:600"}).exit_code, 1);
  EXPECT_EQ(limber({"validate", file, "--source", source, "--clip", "no such"}).exit_code, 1);
}

}  // namespace
}  // namespace limber_test
