// Parts of a body stay apart as far as the source's do. Distances are measured in the written file
// by sampling, without the solver's.
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
      const Vector3d turn = -down * rig.joints[arm].axes[0] + 0.1 * std::sin(0.3 * f) * rig.joints[arm].axes[2];
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

/// [frame] [arm part][body part] depth (m) of a file's own motion, with the figure's capsules on
/// joints of those names.
std::vector<std::array<std::array<double, 4>, 4>> depths(const std::filesystem::path& path,
                                                         const Target& figure) {
  const auto imported = import_file(path, {});
  EXPECT_TRUE(imported) << path;
  const auto capsules = body_capsules(figure.character, figure.figure, figure.calibration);
  std::vector<std::array<std::array<double, 4>, 4>> out;
  const Skeleton& skeleton = imported->character.skeleton;
  std::vector<DualQuaternion> model(skeleton.parents.size());
  for (std::int64_t f = 0; f < imported->clips.front().frames(); ++f) {
    model_from_local(skeleton, imported->clips.front().frame(f), model);
    const auto placed = [&](const PartCapsule& c) {
      const std::int32_t j = skeleton.find(figure.character.skeleton.names[c.joint]);
      return Capsule{model[j].transform_point(c.capsule.from),
                     model[j].transform_point(c.capsule.to), c.capsule.radius};
    };
    out.push_back({});
    for (const PartCapsule& a : capsules) {
      for (const PartCapsule& b : capsules) {
        const auto row = std::ranges::find(kArms, a.part), column = std::ranges::find(kBody, b.part);
        if (row == kArms.end() || column == kBody.end()) continue;
        double& depth = out.back()[row - kArms.begin()][column - kBody.begin()];
        depth = std::max(depth, sampled_depth(placed(a), placed(b)));
      }
    }
  }
  return out;
}

}  // namespace
}  // namespace limber
