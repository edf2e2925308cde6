// Parts of a body stay apart as far as the source's do. Distances are measured in the written file
// by sampling, without the solver's.
#include "pipeline/self_contacts.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "assets/model/mannequin.h"
#include "exporters/exporter.h"
#include "importers/importer.h"
#include "pipeline/body_capsules.h"
#include "pipeline/target.h"
#include "tests/pipeline/program.h"

namespace limber {
namespace {

using Eigen::Vector3d;
using limber_test::Folder;
using nlohmann::json;

constexpr int kFrames = 90;
constexpr double kRateHz = 30.0;
constexpr std::array kArms = {BodyPart::leftForearm, BodyPart::rightForearm, BodyPart::leftHand,
                              BodyPart::rightHand};
constexpr std::array kBody = {BodyPart::torso, BodyPart::head, BodyPart::leftThigh,
                              BodyPart::rightThigh};

/// biped-full whose shoulder joints are `shoulder_m` from the clavicles' inner ends.
Rig biped(double shoulder_m) {
  Rig rig = *shipped_rig("biped-full");
  rig.joints[rig.find("leftUpperArm")].offset.x() = shoulder_m;
  rig.joints[rig.find("rightUpperArm")].offset.x() = -shoulder_m;
  rig.effectors.clear();
  return rig;
}

/// Both arms sink from 20 degrees below the horizontal to `lowest_deg`, stay and rise again, and
/// swing a little forth and back.
Clip lowered_arms(const Rig& rig, double lowest_deg) {
  Clip clip;
  clip.rate_hz = kRateHz;
  clip.joints = rig.size();
  const std::vector<std::int32_t> begin = dof_begin(rig);
  for (int f = 0; f < kFrames; ++f) {
    const double part = std::clamp(1.5 * std::sin(M_PI * f / (kFrames - 1.0)), 0.0, 1.0);
    const double down = (20.0 + (lowest_deg - 20.0) * part) * M_PI / 180.0;
    std::vector<double> q(dof_count(rig), 0.0);
    q[begin[0] + 1] = 0.05;  // clear of the floor
    for (const char* name : {"leftUpperArm", "rightUpperArm"}) {
      const std::int32_t arm = rig.find(name);
      const Vector3d turn =
          -down * rig.joints[arm].axes[0] + 0.1 * std::sin(0.3 * f) * rig.joints[arm].axes[2];
      for (int k = 0; k < 3; ++k) q[begin[arm] + k] = turn[k];
    }
    clip.parent_from_joint.resize(clip.parent_from_joint.size() + rig.joints.size());
    pose_from_coordinates(rig, q, clip.frame(f));
  }
  return clip;
}

/// A file with the motion, and one with the rig.
std::string write_source(const Folder& folder, const Rig& rig, const Clip& clip) {
  const auto text = export_bvh(mannequin(rig), clip, {.unit_m = 0.01, .decimals = 9});
  EXPECT_TRUE(text);
  limber_test::write_text(folder / "motion.bvh", *text);
  return (folder / "motion.bvh").string();
}
std::string write_target(const Folder& folder, const Rig& rig) {
  limber_test::write_text(folder / "narrow.json", write_rig_json(rig));
  return (folder / "narrow.json").string();
}

/// Depth of capsule a in capsule b by sampling a and taking the nearest point of b's axis.
double sampled_depth(const Capsule& a, const Capsule& b) {
  constexpr int kSamples = 2000;
  double nearest = 1e9;
  const Vector3d along = b.to - b.from;
  for (int i = 0; i <= kSamples; ++i) {
    const Vector3d p = a.from + double(i) / kSamples * (a.to - a.from);
    const double t = std::clamp(along.dot(p - b.from) / along.squaredNorm(), 0.0, 1.0);
    nearest = std::min(nearest, (p - b.from - t * along).norm());
  }
  return std::max(0.0, a.radius + b.radius - nearest);
}

using Depths = std::vector<std::array<std::array<double, 4>, 4>>;  // [frame][arm part][body part] m

/// Depths in a file's own motion, with the figure's capsules on joints of those names.
Depths depths(const std::filesystem::path& path, const Target& figure) {
  ImportOptions options;
  options.keep_reference_frame = true;
  const auto imported = import_file(path, options);
  EXPECT_TRUE(imported) << path;
  const auto capsules = body_capsules(figure.figure, figure.calibration);
  const Skeleton& skeleton = imported->character.skeleton;
  std::vector<DualQuaternion> model(skeleton.parents.size());
  std::vector<DualQuaternion> named(figure.character.skeleton.parents.size());
  Depths out;
  for (std::int64_t f = 0; f < imported->clips.front().frames(); ++f) {
    model_from_local(skeleton, imported->clips.front().frame(f), model);
    for (std::size_t j = 0; j < named.size(); ++j) {
      named[j] = model[skeleton.find(figure.character.skeleton.names[j])];
    }
    out.push_back({});
    for (const PartCapsule& a : capsules) {
      for (const PartCapsule& b : capsules) {
        const auto row = std::ranges::find(kArms, a.part),
                   column = std::ranges::find(kBody, b.part);
        if (row == kArms.end() || column == kBody.end()) continue;
        double& depth = out.back()[row - kArms.begin()][column - kBody.begin()];
        depth = std::max(depth, sampled_depth(a.placed(named), b.placed(named)));
      }
    }
  }
  return out;
}

/// [frame] The largest depth of `target` beyond `scale` times the source's of the same parts.
std::vector<double> beyond(const Depths& target, const Depths& source, double scale) {
  std::vector<double> out;
  for (std::size_t f = 0; f < target.size(); ++f) {
    out.push_back(0.0);
    for (std::size_t a = 0; a < 4; ++a) {
      for (std::size_t b = 0; b < 4; ++b) {
        out.back() = std::max(out.back(), target[f][a][b] - scale * source[f][a][b]);
      }
    }
  }
  return out;
}

Target load(const std::string& path) {
  auto target = load_target(path, {});
  EXPECT_TRUE(target) << path;
  return std::move(*target);
}

/// Retargets and gives the written file and its report.
std::pair<std::filesystem::path, json> retarget(const Folder& folder, const std::string& source,
                                                const std::string& target,
                                                const std::string& collision) {
  const auto out = folder / collision;
  const auto run =
      limber_test::limber({"retarget", source, "--target", target, "-o", out.string(),
                           "--collision", collision, "--refine", "none", "--formats", "glb"});
  EXPECT_EQ(run.exit_code, 0);
  return {out / "motion@narrow.glb",
          json::parse(limber_test::text_of(out / "motion@narrow.report.json"))};
}

double largest(const std::vector<double>& x) { return *std::ranges::max_element(x); }

TEST(SelfContacts, PartsStayAsFarApartAsTheSources) {
  const Folder folder;
  const Rig wide = biped(0.19), narrow = biped(0.02);
  const std::string source = write_source(folder, wide, lowered_arms(wide, 78.0));
  const std::string target = write_target(folder, narrow);
  const Target from = load(source), to = load(target);
  const double scale =
      girth_scale(to.figure, to.calibration) / girth_scale(from.figure, from.calibration);
  const Depths allowed = depths(source, from);
  const auto [with, report] = retarget(folder, source, target, "on");
  const auto [without, plain_report] = retarget(folder, source, target, "off");
  const std::vector<double> left = beyond(depths(with, to), allowed, scale);
  const std::vector<double> before = beyond(depths(without, to), allowed, scale);
  EXPECT_GT(largest(before), 0.02);
  EXPECT_LT(largest(left), kFleshGivesM + 5e-4);
  EXPECT_GT(report["self_contacts"]["pressed_frames"].get<int>(), 0);
  EXPECT_NEAR(report["self_contacts"]["depth_before_cm"].get<double>(), 100.0 * largest(before),
              0.05);
  EXPECT_NEAR(report["self_contacts"]["depth_cm"].get<double>(), 100.0 * largest(left), 0.05);
  EXPECT_FALSE(plain_report.contains("self_contacts"));
  EXPECT_EQ(report["limits"]["violations"].get<int>(), 0);
  EXPECT_EQ(report["smoothness"]["pops"].get<int>(), 0);
}

TEST(SelfContacts, FramesFarFromAnyStayAsTheyAre) {
  const Folder folder;
  const Rig wide = biped(0.19), narrow = biped(0.02);
  const std::string source = write_source(folder, wide, lowered_arms(wide, 78.0));
  const std::string target = write_target(folder, narrow);
  const auto with = import_file(retarget(folder, source, target, "on").first, {});
  const auto without = import_file(retarget(folder, source, target, "off").first, {});
  ASSERT_TRUE(with && without);
  const auto same = [&](std::int64_t f) {
    const auto a = with->clips.front().frame(f), b = without->clips.front().frame(f);
    for (std::size_t j = 0; j < a.size(); ++j) {
      if (rotation_angle(a[j].rotation(), b[j].rotation()) > 1e-7) return false;
    }
    return true;
  };
  EXPECT_TRUE(same(0));  // the arms are out sideways there
  EXPECT_TRUE(same(1));
  EXPECT_TRUE(same(kFrames - 1));
  EXPECT_FALSE(same(kFrames / 2));
}

TEST(SelfContacts, WhatTouchesInTheSourceGoesOnTouching) {
  const Folder folder;
  const Rig narrow = biped(0.02);
  const std::string source = write_source(folder, narrow, lowered_arms(narrow, 78.0));
  const std::string target = write_target(folder, narrow);
  const Target from = load(source), to = load(target);
  const Depths touching = depths(source, from);
  const auto [with, report] = retarget(folder, source, target, "on");
  const Depths kept = depths(with, to);
  double deepest = 0.0;
  for (std::size_t f = 0; f < kept.size(); ++f) {
    for (std::size_t a = 0; a < 4; ++a) {
      for (std::size_t b = 0; b < 4; ++b) {
        EXPECT_NEAR(kept[f][a][b], touching[f][a][b], 1e-3) << f;
        deepest = std::max(deepest, touching[f][a][b]);
      }
    }
  }
  EXPECT_GT(deepest, 0.02);
}

}  // namespace
}  // namespace limber
