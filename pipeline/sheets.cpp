#include "pipeline/sheets.h"

#include <fmt/format.h>

#include <algorithm>

#include "pipeline/figure.h"
#include "validation/contact_detection.h"
#include "validation/contact_sheet.h"
#include "validation/limit_check.h"
#include "validation/rig_sheet.h"

namespace limber {
namespace {

/// The character with the roles that mapping found, so that the sheet can tell left from right.
Character with_roles(const Character& character, const Figure& figure) {
  Character out = character;
  const auto roles = roles_by_joint(figure, character.skeleton.size());
  for (std::size_t j = 0; j < roles.size(); ++j) {
    out.roles[j] = roles[j] ? std::string(name_of(*roles[j])) : "";
  }
  return out;
}

std::vector<std::vector<EffectorMark>> marks_of(const Retargeted& result) {
  std::vector<std::vector<EffectorMark>> marks(static_cast<std::size_t>(result.track.frames));
  std::vector<DualQuaternion> model(result.rig.joints.size());
  for (std::int64_t f = 0; f < result.track.frames; ++f) {
    model_from_rows(result.rig, result.rig_clip.frame(f), model);
    for (std::size_t e = 0; e < result.rig.effectors.size(); ++e) {
      const RigEffector& effector = result.rig.effectors[e];
      if (effector.kind != EffectorKind::pose && effector.kind != EffectorKind::position) continue;
      marks[f].push_back({result.track.at(f)[e].pose.translation(),
                          model[effector.joint].transform_point(effector.offset)});
    }
  }
  return marks;
}

/// [frame] Speed (m/s) of whichever of hands, feet and head is fastest.
std::vector<double> fastest(const Character& character, const Figure& figure, const Clip& clip,
                            double scale) {
  std::vector<std::int32_t> joints;
  for (const Role role :
       {Role::head, Role::leftHand, Role::rightHand, Role::leftFoot, Role::rightFoot}) {
    if (figure.has(role)) joints.push_back(figure.at(role));
  }
  std::vector<DualQuaternion> model(character.skeleton.parents.size());
  std::vector<Eigen::Vector3d> before(joints.size());
  std::vector<double> out(static_cast<std::size_t>(clip.frames()), 0.0);
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    model_from_local(character.skeleton, clip.frame(f), model);
    for (std::size_t i = 0; i < joints.size(); ++i) {
      const Eigen::Vector3d now = model[joints[i]].translation();
      if (f > 0) out[f] = std::max(out[f], scale * clip.rate_hz * (now - before[i]).norm());
      before[i] = now;
    }
  }
  if (out.size() > 1) out[0] = out[1];
  return out;
}

std::vector<std::string> key_figures(const ClipRecord& record) {
  const Retargeted& result = *record.result;
  const FileCheck checked = worst_of(record.checks);
  std::vector<std::string> lines;
  lines.push_back(fmt::format("{} frames at {:g} Hz, scale {:.3f}", result.clip.frames(),
                              result.clip.rate_hz, result.track.scale));
  lines.push_back(fmt::format("limit violations {} (read back, {})", checked.violations,
                              checked.ok ? "certified" : "NOT certified"));
  lines.push_back(fmt::format("effector error p95 {:.1f} mm, worst {:.1f} mm",
                              percentile(result.worst_error_mm, 95.0),
                              percentile(result.worst_error_mm, 100.0)));
  if (!result.refine.gap_percent.empty()) {
    lines.push_back(fmt::format("gap to Ceres median {:.2f} %, p95 {:.2f} %",
                                percentile(result.refine.gap_percent, 50.0),
                                percentile(result.refine.gap_percent, 95.0)));
  }
  if (record.metrics && !record.metrics->feet.empty()) {
    const MotionMetrics& metrics = *record.metrics;
    const std::string slide =
        metrics.intervals == 0 ? "no foot stands"
                               : fmt::format("slide {:.1f} cm/s (source {:.1f})",
                                             metrics.output.slide_cm_s, metrics.source.slide_cm_s);
    lines.push_back(fmt::format("{}, pops {}", slide, metrics.pops));
  }
  if (result.cycle) {
    lines.push_back(fmt::format("goes round in {} frames, seam {:.2f} deg", result.cycle->period,
                                result.cycle->seam_deg));
  }
  return lines;
}

}  // namespace

Result<std::vector<std::byte>> draw_clip_sheet(const ClipRecord& record, const SourceMotion& motion,
                                               const std::string& title) {
  const Target& target = *record.target;
  const Retargeted& result = *record.result;
  const Character source = with_roles(*motion.character, *motion.figure);
  const Character character = with_roles(target.character, target.figure);
  ContactSheet sheet;
  sheet.title = title;
  sheet.verdict = to_string(record.status);
  sheet.key_figures = key_figures(record);
  sheet.source = {&source, motion.clip, "source: " + record.convention, 1.0,
                  Eigen::Vector3d(0.0, -result.track.ground_offset, 0.0)};
  sheet.target = {&character, &result.clip, "target: " + target.label, 1.0,
                  Eigen::Vector3d::Zero()};
  sheet.marks = marks_of(result);
  sheet.error_mm = result.worst_error_mm;
  sheet.left_contact = result.track.left_contact;
  sheet.right_contact = result.track.right_contact;
  sheet.ghost_scale = result.track.scale;
  if (target.figure.is_body() && motion.clip->frames() == result.clip.frames()) {
    sheet.speed = fastest(target.character, target.figure, result.clip, 1.0);
    sheet.source_speed =
        fastest(*motion.character, *motion.figure, *motion.clip, result.track.scale);
  }
  for (const JointAtLimit& joint : result.at_limit) {
    sheet.at_limit.push_back({joint.joint, double(joint.frames) / double(result.track.frames)});
  }
  for (const std::int32_t row : joints_at_limit(result.rig, result.rig_clip)) {
    sheet.tinted_joints.push_back(target.joint_of_row[row]);
  }
  auto image = render_contact_sheet(sheet);
  if (!image) return image.error();
  return encode_png(*image);
}

Result<std::vector<std::byte>> draw_file_sheet(const Character& character, const Clip* clip,
                                               const std::string& title) {
  Clip rest;
  rest.joints = character.skeleton.size();
  rest.parent_from_joint = character.skeleton.rest_parent_from_joint;
  Character drawn = character;
  if (auto figure = identify_figure(character)) drawn = with_roles(character, *figure);
  ContactSheet sheet;
  sheet.title = title;
  sheet.target = {&drawn, clip != nullptr ? clip : &rest,
                  clip != nullptr ? clip->name : "rest pose", 1.0, Eigen::Vector3d::Zero()};
  auto image = render_contact_sheet(sheet);
  if (!image) return image.error();
  return encode_png(*image);
}

Result<std::vector<std::byte>> draw_rig_sheet(const DressedRig& dressed) {
  const std::vector<RigJoint>& joints = dressed.rig.joints;
  std::vector<DualQuaternion> rows;
  for (const RigJoint& joint : joints) {
    rows.push_back(DualQuaternion::from_rotation_translation(joint.rest, joint.offset));
  }
  RigSheet sheet;
  sheet.title = dressed.rig.name;
  sheet.description = dressed.rig.description;
  sheet.rig = &dressed.rig;
  sheet.character = &dressed.character;
  sheet.joint_of_row = dressed.joint_of_row;
  sheet.parent_from_joint.resize(dressed.character.skeleton.parents.size());
  skeleton_local_from_rows(dressed.rig, dressed.joint_of_row, dressed.character.skeleton, rows,
                           sheet.parent_from_joint);
  auto image = render_rig_sheet(sheet);
  if (!image) return image.error();
  return encode_png(*image);
}

}  // namespace limber
