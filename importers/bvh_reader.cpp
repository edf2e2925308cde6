#include "importers/bvh_reader.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

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

/// Largest absolute position value of a joint over all frames; nullopt without position channels.
std::optional<double> largest_position(const BvhDocument& document, const BvhJoint& joint) {
  std::optional<double> largest;
  for (std::size_t c = 0; c < joint.channels.size(); ++c) {
    if (is_rotation(joint.channels[c])) continue;
    largest = largest.value_or(0.0);
    for (std::int64_t f = 0; f < document.frames(); ++f) {
      largest = std::max(*largest, std::abs(document.row(f)[joint.channel_begin + c]));
    }
  }
  return largest;
}

/// Non-root joints whose position channels hold nothing but zeros (give or take rounding) although
/// OFFSET is not zero: some exporters fill six channels everywhere. Taken literally they would
/// collapse the body.
std::vector<std::uint8_t> zero_filled_joints(const BvhDocument& document, Warnings& warnings) {
  std::vector<std::uint8_t> zero_filled(document.joints.size(), 0);
  double longest = 0.0;
  for (const BvhJoint& joint : document.joints) {
    if (joint.parent >= 0) longest = std::max(longest, joint.offset.norm());
  }
  std::int64_t count = 0;
  for (std::size_t i = 0; i < document.joints.size(); ++i) {
    const BvhJoint& joint = document.joints[i];
    if (joint.parent < 0 || joint.offset.isZero(0.0)) continue;
    const std::optional<double> largest = largest_position(document, joint);
    if (!largest || *largest > std::max(1e-2 * joint.offset.norm(), 1e-4 * longest)) continue;
    zero_filled[i] = 1;
    ++count;
  }
  if (count > 0) {
    warnings.push_back({"bvh-zero-positions",
                        fmt::format("the position channels of {} joints hold zeros only; their "
                                    "OFFSETs were kept",
                                    count)});
  }
  return zero_filled;
}

/// T(position) R(first rotation channel) R(second) R(third).
DualQuaternion local_transform(const BvhJoint& joint, std::span<const double> row,
                               bool keep_offset) {
  constexpr double kHalfDegree = std::numbers::pi / 360.0;
  Eigen::Vector3d position = joint.offset;
  Eigen::Quaterniond rotation(1, 0, 0, 0);
  for (std::size_t c = 0; c < joint.channels.size(); ++c) {
    const double value = row[joint.channel_begin + c];
    const int axis = axis_of(joint.channels[c]);
    if (is_rotation(joint.channels[c])) {
      const double half = std::remainder(value, 720.0) * kHalfDegree;
      Eigen::Quaterniond turn(std::cos(half), 0, 0, 0);
      turn.vec()[axis] = std::sin(half);
      rotation = rotation * turn;
    } else if (!keep_offset) {
      position[axis] = value;
    }
  }
  return DualQuaternion::from_rotation_translation(rotation.normalized(), position);
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

Clip build_clip(const BvhDocument& document, Warnings& warnings) {
  Clip clip;
  clip.rate_hz = snap_rate_hz(document.frame_time_s, document.frame_time_text);
  clip.joints = static_cast<std::int32_t>(document.joints.size());
  const auto zero_filled = zero_filled_joints(document, warnings);
  clip.parent_from_joint.reserve(document.joints.size() * document.frames());
  for (std::int64_t f = 0; f < document.frames(); ++f) {
    const std::span<const double> row = document.row(f);
    for (std::size_t i = 0; i < document.joints.size(); ++i) {
      clip.parent_from_joint.push_back(
          local_transform(document.joints[i], row, zero_filled[i] != 0));
    }
  }
  return clip;
}

double zero_angle_share(const BvhDocument& document, std::int64_t frame) {
  const std::span<const double> row = document.row(frame);
  std::int64_t zeros = 0;
  std::int64_t all = 0;
  for (const BvhJoint& joint : document.joints) {
    for (std::size_t c = 0; c < joint.channels.size(); ++c) {
      if (!is_rotation(joint.channels[c])) continue;
      ++all;
      if (std::abs(row[joint.channel_begin + c]) < 1e-6) ++zeros;
    }
  }
  return all == 0 ? 0.0 : double(zeros) / double(all);
}

/// MotionBuilder conversions of the CMU library hold a reference pose in frame 0: nearly all angles
/// are zero there, and the figure jumps to frame 1.
bool holds_reference_frame(const BvhDocument& document, const Clip& clip) {
  if (clip.frames() < 3) return false;
  const double zeros = zero_angle_share(document, 0);
  if (zeros < 0.7 || zeros - zero_angle_share(document, 1) < 0.2) return false;
  return jumps_from_first_frame(clip);
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

Imported build(BvhDocument document, const ImportOptions& options) {
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
  imported.facts.frames = document.frames();
  if (document.frames() == 0) {
    imported.warnings.push_back({"bvh-no-frames", "the file holds a skeleton without motion"});
  } else {
    Clip clip = build_clip(document, imported.warnings);
    imported.facts.rate_hz = clip.rate_hz;
    imported.facts.clips = 1;
    const bool drop = !options.keep_reference_frame && holds_reference_frame(document, clip);
    imported.clips.push_back(std::move(clip));
    if (drop) drop_reference_frame(imported);
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
    return build(parse_bvh(text), options);
  });
}

}  // namespace limber
