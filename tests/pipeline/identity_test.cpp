// Laws of the whole pipeline: a clip onto its own skeleton is itself, a held T-pose is a held
// T-pose.
#include <gtest/gtest.h>

#include <cmath>

#include "importers/importer.h"
#include "pipeline/retarget.h"
#include "pipeline/target.h"
#include "tests/pipeline/program.h"

namespace limber {
namespace {

using limber_test::Folder;

Imported read(const std::filesystem::path& path, bool keep_reference_frame = false) {
  ImportOptions options;
  options.keep_reference_frame = keep_reference_frame;
  if (keep_reference_frame && path.extension() == ".bvh") options.unit_m = 0.01;
  auto imported = import_file(path, options);
  EXPECT_TRUE(imported) << path << ": " << (imported ? "" : imported.error().message);
  return imported ? std::move(*imported) : Imported{};
}

/// Largest joint distance (m) and rotation (rad) between two clips of one skeleton, by name.
std::pair<double, double> difference(const Imported& a, const Imported& b) {
  const Clip& ca = a.clips.front();
  const Clip& cb = b.clips.front();
  EXPECT_EQ(ca.frames(), cb.frames());
  std::vector<DualQuaternion> ma(a.character.skeleton.parents.size());
  std::vector<DualQuaternion> mb(b.character.skeleton.parents.size());
  double metres = 0.0, radians = 0.0;
  for (std::int64_t f = 0; f < std::min(ca.frames(), cb.frames()); ++f) {
    model_from_local(a.character.skeleton, ca.frame(f), ma);
    model_from_local(b.character.skeleton, cb.frame(f), mb);
    for (std::int32_t j = 0; j < a.character.skeleton.size(); ++j) {
      const std::int32_t k = b.character.skeleton.find(a.character.skeleton.names[j]);
      if (k == kNoJoint || !a.character.deforming[j]) continue;
      metres = std::max(metres, (ma[j].translation() - mb[k].translation()).norm());
      radians = std::max(radians, rotation_angle(ma[j].rotation(), mb[k].rotation()));
    }
  }
  return {metres, radians};
}

void expect_identity(const std::filesystem::path& clip, const std::string& format) {
  SCOPED_TRACE(clip.string());
  const Folder folder;
  const auto run = limber_test::limber(
      {"retarget", clip.string(), "--target", clip.string(), "-o", folder.string(), "--limits",
       "off", "--contacts", "off", "--collision", "off", "--refine", "none", "--formats", format});
  ASSERT_EQ(run.exit_code, 0);
  const std::string stem = clip.stem().string();
  const Imported before = read(clip);
  const Imported after = read(folder / (stem + "@" + stem + "." + format), true);
  ASSERT_FALSE(after.clips.empty());
  const auto [metres, radians] = difference(before, after);
  EXPECT_LT(metres, 1e-4);
  EXPECT_LT(radians * 180.0 / M_PI, 0.01);
}

TEST(Identity, OwnClips) {
  expect_identity(limber_test::own_clip("body_range_of_motion.bvh"), "glb");
  expect_identity(limber_test::own_clip("body_range_of_motion.bvh"), "bvh");
  expect_identity(limber_test::own_clip("gestures_right_hand.bvh"), "glb");
}

TEST(Identity, RealMotionCapture) {
  const auto clip = limber_test::cmu_clip("01_03.bvh");
  if (clip.empty()) GTEST_SKIP() << "Debian package assimp-testmodels is not installed";
  expect_identity(clip, "glb");
  expect_identity(clip, "bvh");
  expect_identity(limber_test::cmu_clip("Boxing_Toes.bvh"), "glb");
}

TEST(Identity, SharedClips) {
  if (limber_test::shared("bvh").empty()) GTEST_SKIP() << "../shared is not there";
  for (const char* name :
       {"bvh/cmu_max_131_01_start_walk_stop.bvh", "bvh/rokoko_jesse_dance_60j.bvh",
        "bvh/derived_roll_fingers.bvh", "bvh/fair_zombie_zup.bvh", "bvh/xsens_style_crlf.bvh",
        "mocap_other/viverse_walk_53j.glb"}) {
    expect_identity(limber_test::shared(name), "glb");
  }
}

/// Joint positions, [frame * joints + joint].
std::vector<Eigen::Vector3d> positions(const Imported& imported) {
  const Skeleton& skeleton = imported.character.skeleton;
  std::vector<DualQuaternion> model(skeleton.parents.size());
  std::vector<Eigen::Vector3d> out;
  for (std::int64_t f = 0; f < imported.clips.front().frames(); ++f) {
    model_from_local(skeleton, imported.clips.front().frame(f), model);
    for (const DualQuaternion& joint : model) out.push_back(joint.translation());
  }
  return out;
}

/// Mean distance between the positions of two clips in % of the stature, but for the height at
/// which the figure's floor lies: one floor per clip is part of a retarget.
double mean_distance_percent(const Imported& before, const Imported& after) {
  const auto a = positions(before), b = positions(after);
  EXPECT_EQ(a.size(), b.size());
  double rise = 0.0, sum = 0.0, top = -1e9, bottom = 1e9;
  for (std::size_t i = 0; i < a.size(); ++i) rise += (b[i].y() - a[i].y()) / double(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    sum += (b[i] - a[i] - Eigen::Vector3d(0.0, rise, 0.0)).norm() / double(a.size());
    if (i < before.character.skeleton.parents.size()) {
      top = std::max(top, a[i].y());
      bottom = std::min(bottom, a[i].y());
    }
  }
  return 100.0 * sum / (top - bottom);
}

/// A clip onto another figure and from there back onto its own skeleton.
void expect_back(const std::filesystem::path& clip, const std::string& target) {
  const std::string stem = clip.stem().string(),
                    other = std::filesystem::path(target).stem().string();
  SCOPED_TRACE(stem + " onto " + other + " and back");
  const Folder folder;
  const auto retarget = [&](const std::string& source, const std::string& onto) {
    return limber_test::limber({"retarget", source, "--target", onto, "-o", folder.string(),
                                "--refine", "none", "--formats", "glb"})
        .exit_code;
  };
  ASSERT_EQ(retarget(clip.string(), target), 0);
  const std::string there = stem + "@" + other;
  ASSERT_EQ(retarget((folder / (there + ".glb")).string(), clip.string()), 0);
  EXPECT_LT(mean_distance_percent(read(clip), read(folder / (there + "@" + stem + ".glb"), true)),
            2.0);
}

TEST(Identity, ThereAndBack) {
  expect_back(limber_test::own_clip("body_range_of_motion.bvh"), "biped-hands");
  const auto cmu = limber_test::cmu_clip("01_03.bvh");
  if (!cmu.empty()) expect_back(cmu, "biped-full");
  const auto walk = limber_test::shared("bvh/freebvh_mixamo_names_55j.bvh");
  const auto arnaud = limber_test::shared("characters/ozz_arnaud.fbx");
  if (!walk.empty() && !arnaud.empty()) expect_back(walk, arnaud.string());
}

/// A clip that holds the calibrated T-pose of `imported` for five frames.
Clip held_t_pose(const Imported& imported, const Calibration& calibration) {
  Clip clip;
  clip.rate_hz = 30.0;
  clip.joints = imported.character.skeleton.size();
  Pose pose(calibration.model_from_joint.size());
  local_from_model(imported.character.skeleton, calibration.model_from_joint, pose);
  for (int f = 0; f < 5; ++f) {
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  return clip;
}

void expect_t_pose(const std::filesystem::path& source_path, const std::string& target_name) {
  SCOPED_TRACE(source_path.string() + " onto " + target_name);
  const Imported source = read(source_path);
  const auto figure = identify_figure(source.character);
  ASSERT_TRUE(figure);
  const auto calibration = calibrate(source.character, *figure, {}, source.reference_pose,
                                     source.clips.empty() ? nullptr : &source.clips.front());
  ASSERT_TRUE(calibration);
  const auto target = load_target(target_name, {});
  ASSERT_TRUE(target) << target.error().message;
  const Clip clip = held_t_pose(source, *calibration);
  const SourceMotion motion{&source.character, &*figure, &*calibration, &clip};
  RetargetOptions options;
  options.refine = RefineMode::none;
  const auto result = retarget_clip(motion, *target, options);
  ASSERT_TRUE(result) << result.error().message;
  std::vector<DualQuaternion> model(target->character.skeleton.parents.size());
  model_from_local(target->character.skeleton, result->clip.frame(2), model);
  for (int r = 0; r < kRoleCount; ++r) {
    const std::int32_t j = target->figure.joint[r];
    if (j == kNoJoint) continue;
    EXPECT_LT(
        rotation_angle(model[j].rotation(), target->calibration.model_from_joint[j].rotation()) *
            180.0 / M_PI,
        0.5)
        << name_of(role_at(r));
  }
  const std::int32_t foot = target->figure.at(Role::leftFoot);
  EXPECT_NEAR(model[foot].translation().y(), target->calibration.ankle_height, 2e-3);
}

TEST(TPose, IsKept) {
  expect_t_pose(limber_test::own_clip("body_range_of_motion.bvh"), "biped-full");
  expect_t_pose(limber_test::own_clip("body_range_of_motion.bvh"), "biped-hands");
  const auto cmu = limber_test::cmu_clip("01_03.bvh");
  if (!cmu.empty()) expect_t_pose(cmu, "biped-full");
  for (const char* name : {"bvh/cmu_iclone_02_03_run.bvh", "bvh/rokoko_jesse_dance_60j.bvh",
                           "bvh/xsens_style_crlf.bvh", "mocap_other/viverse_walk_53j.glb"}) {
    if (const auto path = limber_test::shared(name); !path.empty()) {
      expect_t_pose(path, "biped-full");
    }
  }
}

}  // namespace
}  // namespace limber
