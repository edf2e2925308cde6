#include "importers/bvh_reader.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "importers/bvh_parser.h"
#include "importers/failure.h"
#include "importers/figure_guess.h"
#include "importers/frame_rate.h"
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

/// rotation = rotation * turn, with a turn by `angle_deg` about one axis: half the products of the
/// general case.
void turn_about(int axis, double angle_deg, Eigen::Quaterniond& rotation) {
  constexpr double kHalfDegree = std::numbers::pi / 360.0;
  constexpr std::array kNext = {1, 2, 0, 1};
  const double turns = std::abs(angle_deg) < 360.0 ? angle_deg : std::remainder(angle_deg, 720.0);
  const double c = std::cos(turns * kHalfDegree), s = std::sin(turns * kHalfDegree);
  const int b = kNext[axis], d = kNext[axis + 1];
  const Eigen::Quaterniond q = rotation;
  rotation.w() = c * q.w() - s * q.vec()[axis];
  rotation.vec()[axis] = c * q.vec()[axis] + s * q.w();
  rotation.vec()[b] = c * q.vec()[b] + s * q.vec()[d];
  rotation.vec()[d] = c * q.vec()[d] - s * q.vec()[b];
}

/// T(position) R(first rotation channel) R(second) R(third).
DualQuaternion local_transform(const BvhJoint& joint, std::span<const double> row) {
  Eigen::Vector3d position = joint.offset;
  Eigen::Quaterniond rotation(1, 0, 0, 0);
  for (std::size_t c = 0; c < joint.channels.size(); ++c) {
    const double value = row[joint.channel_begin + c];
    const int axis = axis_of(joint.channels[c]);
    if (is_rotation(joint.channels[c])) {
      turn_about(axis, value, rotation);
    } else {
      position[axis] = value;
    }
  }
  return DualQuaternion::from_rotation_translation(rotation.normalized(), position);
}

/// Makes the clip row by row, and remembers what is asked of the whole afterwards.
class ClipBuilder {
 public:
  void add(const BvhDocument& document, std::span<const double> row) {
    if (frames_ == 0) begin(document);
    for (std::size_t i = 0; i < document.joints.size(); ++i) {
      const BvhJoint& joint = document.joints[i];
      poses_.push_back(local_transform(joint, row));
      if (joint.parent >= 0 && !joint.channels.empty()) note_position(joint, row, largest_[i]);
    }
    ++frames_;
  }

  Clip finish(const BvhDocument& document, Warnings& warnings) {
    keep_offsets(document, warnings);
    Clip clip;
    clip.rate_hz = snap_rate_hz(document.frame_time_s, document.frame_time_text);
    clip.joints = static_cast<std::int32_t>(document.joints.size());
    clip.parent_from_joint = std::move(poses_);
    return clip;
  }

 private:
  void begin(const BvhDocument& document) {
    poses_.reserve(document.joints.size() * static_cast<std::size_t>(document.expected_frames));
    largest_.resize(document.joints.size(), 0.0);
  }

  static void note_position(const BvhJoint& joint, std::span<const double> row, double& largest) {
    for (std::size_t c = 0; c < joint.channels.size(); ++c) {
      if (is_rotation(joint.channels[c])) continue;
      largest = std::max(largest, std::abs(row[joint.channel_begin + c]));
    }
  }

  /// Non-root joints whose position channels hold nothing but zeros (give or take rounding)
  /// although OFFSET is not zero: some exporters fill six channels everywhere. Taken literally
  /// they would collapse the body.
  void keep_offsets(const BvhDocument& document, Warnings& warnings) {
    double longest = 0.0;
    for (const BvhJoint& joint : document.joints) {
      if (joint.parent >= 0) longest = std::max(longest, joint.offset.norm());
    }
    std::int64_t kept = 0;
    for (std::size_t i = 0; i < document.joints.size(); ++i) {
      const BvhJoint& joint = document.joints[i];
      const bool has_position =
          std::any_of(joint.channels.begin(), joint.channels.end(),
                      [](BvhChannel channel) { return !is_rotation(channel); });
      if (joint.parent < 0 || !has_position || joint.offset.isZero(0.0)) continue;
      if (largest_[i] > std::max(1e-2 * joint.offset.norm(), 1e-4 * longest)) continue;
      ++kept;
      for (std::size_t at = i; at < poses_.size(); at += document.joints.size()) {
        poses_[at] = DualQuaternion::from_rotation_translation(poses_[at].rotation(), joint.offset);
      }
    }
    if (kept == 0) return;
    warnings.push_back({"bvh-zero-positions",
                        fmt::format("the position channels of {} joints hold zeros only; their "
                                    "OFFSETs were kept",
                                    kept)});
  }

  std::vector<DualQuaternion> poses_;  // [frame * joints + joint]
  std::vector<double> largest_;        // [joint] absolute value of its position channels
  std::int64_t frames_ = 0;
};

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

Imported build(BvhDocument document, ClipBuilder& builder, const ImportOptions& options) {
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
    Clip clip = builder.finish(document, imported.warnings);
    imported.facts.rate_hz = clip.rate_hz;
    imported.facts.clips = 1;
    imported.clips.push_back(std::move(clip));
    if (!options.keep_reference_frame) drop_any_reference_frame(imported);
  }
  settle_space(imported, options);
  for (Clip& clip : imported.clips) make_signs_continuous(clip);
  return imported;
}

}  // namespace

Result<Imported> import_bvh(std::span<const std::byte> bytes, const ImportOptions& options) {
  return guarded<Imported>([&]() -> Result<Imported> {
    std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
    ClipBuilder builder;
    BvhDocument document = parse_bvh(
        text,
        [&](const BvhDocument& so_far, std::span<const double> row) { builder.add(so_far, row); },
        options.on_passed);
    return build(std::move(document), builder, options);
  });
}

}  // namespace limber
