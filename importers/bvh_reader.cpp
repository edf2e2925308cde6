#include "importers/bvh_reader.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "importers/bvh_motion.h"
#include "importers/bvh_parser.h"
#include "importers/failure.h"
#include "importers/figure_guess.h"
#include "importers/joint_names.h"
#include "importers/reference_frame.h"
#include "importers/text_encoding.h"

namespace limber {

namespace {

std::vector<std::string> joint_names(const BvhDocument& document, Warnings& warnings) {
  std::vector<std::string> names;
  for (const BvhJoint& joint : document.joints) names.push_back(joint.name);
  if (const char* encoding = repair_names(names)) {
    warnings.push_back(
        {"text-encoding", fmt::format("joint names are not UTF-8; read as {}", encoding)});
  }
  std::vector<std::uint8_t> generated(names.size(), 0);
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (!document.joints[i].end_site) continue;
    const std::int32_t parent = document.joints[i].parent;
    names[i] = (names[parent].empty() ? "joint_" + std::to_string(parent) : names[parent]) + "_End";
    generated[i] = 1;
  }
  make_names_valid(names, generated, "joint_", warnings);
  return names;
}

Skeleton build_skeleton(const BvhDocument& document, Warnings& warnings) {
  Skeleton skeleton;
  skeleton.names = joint_names(document, warnings);
  for (const BvhJoint& joint : document.joints) {
    skeleton.parents.push_back(joint.parent);
    skeleton.rest_parent_from_joint.push_back(DualQuaternion::from_translation(joint.offset));
  }
  return skeleton;
}

/// Unit and axes: from the options, else guessed. Motion and rest pose may use different axes.
void settle_space(Imported& imported, const ImportOptions& options) {
  Skeleton& skeleton = imported.character.skeleton;
  const Clip* clip = imported.clips.empty() ? nullptr : imported.clips.data();
  UpGuess up = guess_up(skeleton, clip);
  if (options.up) {
    up.up = up.rest_up = *options.up == 'z' ? "+Z" : "+Y";
  } else if (up.up != up.rest_up) {
    imported.warnings.push_back({"up-axis-mixed", up.evidence});
  }
  imported.facts.up = up.up;
  if (options.unit_m) {
    imported.facts.unit_m = *options.unit_m;
    imported.facts.unit_evidence = "given as an option";
  } else {
    const UnitGuess unit = guess_unit(skeleton, clip, up.up);
    imported.facts.unit_m = unit.unit_m;
    imported.facts.unit_evidence = unit.evidence;
    if (!unit.plausible) {
      imported.warnings.push_back({"unit-implausible", unit.evidence});
    } else if (!unit.certain) {
      imported.warnings.push_back({"unit-guessed", unit.evidence});
    }
  }
  const double unit_m = imported.facts.unit_m;
  const Eigen::Quaterniond canonical_from_motion = canonical_from_up(up.up);
  for (Clip& c : imported.clips) {
    make_canonical(skeleton, c.parent_from_joint, unit_m, canonical_from_motion);
  }
  make_canonical(skeleton, imported.reference_pose, unit_m, canonical_from_motion);
  make_canonical(skeleton, skeleton.rest_parent_from_joint, unit_m, canonical_from_up(up.rest_up));
}

Imported build(BvhDocument document, BvhMotion& motion, const ImportOptions& options) {
  Imported imported;
  imported.warnings = std::move(document.warnings);
  imported.facts.format = "bvh";
  imported.facts.reader = "limber-bvh";
  imported.character.skeleton = build_skeleton(document, imported.warnings);
  for (const BvhJoint& joint : document.joints) {
    imported.character.deforming.push_back(joint.end_site ? 0 : 1);
    imported.facts.joints += joint.end_site ? 0 : 1;
  }
  imported.character.roles.resize(document.joints.size());
  imported.facts.frames = document.frames;
  if (document.frames == 0) {
    imported.warnings.push_back({"bvh-no-frames", "the file holds a skeleton without motion"});
  } else {
    Clip clip = motion.finish(document, imported.warnings);
    imported.facts.rate_hz = clip.rate_hz;
    imported.facts.clips = 1;
    imported.clips.push_back(std::move(clip));
    if (!options.keep_reference_frame) drop_any_reference_frame(imported);
  }
  settle_space(imported, options);
  return imported;
}

}  // namespace

Result<Imported> import_bvh(std::span<const std::byte> bytes, const ImportOptions& options) {
  return guarded<Imported>([&]() -> Result<Imported> {
    std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
    BvhMotion motion;
    BvhDocument document = parse_bvh(
        text,
        [&](const BvhDocument& so_far, std::span<const double> row) { motion.add(so_far, row); },
        options.on_passed);
    return build(std::move(document), motion, options);
  });
}

}  // namespace limber
