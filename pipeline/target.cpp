#include "pipeline/target.h"

#include <algorithm>

#include "assets/model/mannequin.h"
#include "importers/rig_json.h"
#include "pipeline/anatomy.h"
#include "pipeline/embedded.h"
#include "pipeline/file_io.h"
#include "pipeline/reading_budget.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

bool contains(const std::vector<std::int32_t>& list, std::int32_t joint) {
  return std::find(list.begin(), list.end(), joint) != list.end();
}

std::optional<AnatomicalLimit> limit_of(const Figure& figure, std::int32_t joint,
                                        std::optional<Role> role) {
  if (contains(figure.spine, joint)) return shared_spine_limit(figure.spine.size());
  const std::size_t neck = figure.neck.size() + (figure.has(Role::head) ? 1 : 0);
  if (contains(figure.neck, joint) || role == Role::head) return shared_neck_limit(neck);
  return role ? anatomical_limit(*role) : std::nullopt;
}

/// A ball without limits: joints that move freely, or that follow a namesake in the source.
void make_unlimited(RigJoint& row) {
  row.type = JointType::ball;
  row.axes = {Vector3d::UnitX(), Vector3d::UnitY(), Vector3d::UnitZ()};
  row.limits = {};
}

void finish(Target& target) {
  target.joint_of_row.clear();
  for (const RigJoint& row : target.rig.joints) {
    target.joint_of_row.push_back(target.character.skeleton.find(row.name));
  }
}

/// The thumbs of `t_pose`, seen from their palms, in place of the rig's own.
void take_thumbs(const Target& target, std::span<const DualQuaternion> t_pose,
                 std::vector<DualQuaternion>& rest) {
  for (int r = kFirstLeft; r < kRoleCount; ++r) {
    const Role hand = on_side(Role::leftHand, side_of(role_at(r)));
    if (!is_thumb(role_at(r)) || !target.figure.has(role_at(r)) || !target.figure.has(hand))
      continue;
    const std::int32_t j = target.figure.at(role_at(r)), palm = target.figure.at(hand);
    rest[j] = rest[palm] * t_pose[palm].conjugate() * t_pose[j];
  }
}

/// Figure and calibration of a rig: q = 0 is its T-pose by definition, but for thumbs, which point
/// as the rig's maker liked; else only lengths are measured.
Result<Target> target_from_rig(Rig rig, const std::string& label, const TargetOptions& options) {
  Target target;
  target.label = label;
  target.character = mannequin(rig);
  auto figure = identify_figure(target.character, options.roles);
  if (!figure) return figure.error();
  target.figure = std::move(*figure);
  auto calibration =
      calibrate(target.character, target.figure, {ReferenceChoice::rest, 0}, {}, nullptr);
  if (!calibration) return calibration.error();
  target.calibration = std::move(*calibration);
  const std::int32_t root = target.figure.root();
  const std::vector<DualQuaternion> t_pose = target.calibration.model_from_joint;
  const Quaterniond canonical = t_pose[root].rotation();
  model_from_local(target.character.skeleton, target.character.skeleton.rest_parent_from_joint,
                   target.calibration.model_from_joint);
  if (target.figure.is_hand()) {
    target.world_from_t_pose =
        target.calibration.model_from_joint[root].rotation() * canonical.conjugate();
  }
  take_thumbs(target, t_pose, target.calibration.model_from_joint);
  target.facts.format = "ikrig";
  target.facts.reader = "limber-rig";
  target.facts.joints = rig.size();
  rig.effectors.clear();
  if (!options.limits) {
    for (RigJoint& row : rig.joints) {
      if (row.limited()) make_unlimited(row);
    }
  }
  target.rig = std::move(rig);
  finish(target);
  return target;
}

Result<Target> target_from_character(Imported imported, const std::string& label,
                                     const TargetOptions& options) {
  Target target;
  target.label = label;
  target.character = std::move(imported.character);
  target.facts = imported.facts;
  target.warnings = imported.warnings;
  auto figure = identify_figure(target.character, options.roles);
  if (!figure) return figure.error();
  target.figure = std::move(*figure);
  const Clip* clip = imported.clips.empty() ? nullptr : &imported.clips.front();
  auto calibration = calibrate(target.character, target.figure, {}, imported.reference_pose, clip);
  if (!calibration) return calibration.error();
  target.calibration = std::move(*calibration);
  target.rig = limited_rig(target.character, target.figure, target.calibration, options.limits);
  target.rig.name = label;
  finish(target);
  return target;
}

}  // namespace

std::vector<std::string> shipped_rig_names() {
  std::vector<std::string> names;
  for (const std::string_view file : embedded_files("rigs/")) {
    if (!file.ends_with(".json") || file.ends_with(".schema.json")) continue;
    names.emplace_back(file.substr(5, file.size() - 10));
  }
  return names;
}

std::optional<Rig> shipped_rig(const std::string& name) {
  const std::string_view text = embedded_file("rigs/" + name + ".json");
  if (text.empty()) return std::nullopt;
  auto rig = read_rig_json(text);
  if (!rig) return std::nullopt;
  return std::move(*rig);
}

Rig limited_rig(const Character& character, const Figure& figure, const Calibration& calibration,
                bool limits) {
  const Skeleton& skeleton = character.skeleton;
  const auto roles = roles_by_joint(figure, skeleton.size());
  std::vector<std::int32_t> row_of(skeleton.parents.size(), kNoJoint);
  Rig rig;
  for (const std::int32_t j : figure.order) {
    row_of[j] = rig.size();
    const std::int32_t parent = figure.parents[j];
    const DualQuaternion parent_from_joint =
        parent == kNoJoint
            ? calibration.model_from_joint[j]
            : calibration.model_from_joint[parent].conjugate() * calibration.model_from_joint[j];
    RigJoint row;
    row.name = skeleton.names[j];
    row.role = roles[j] ? std::string(name_of(*roles[j])) : "";
    row.parent = parent == kNoJoint ? kNoJoint : row_of[parent];
    row.offset = parent_from_joint.translation();
    row.rest = parent_from_joint.rotation().normalized();
    const std::optional<AnatomicalLimit> limit = limit_of(figure, j, roles[j]);
    if (j == figure.root()) {
      row.type = JointType::free;
    } else if (limit && !limits) {
      make_unlimited(row);
    } else if (limit) {
      const Quaterniond joint_from_model = calibration.model_from_joint[j].rotation().conjugate();
      row.type = limit->type;
      row.limits = limit->ranges;
      row.citation = limit->citation;
      for (int k = 0; k < 3; ++k) row.axes[k] = joint_from_model * limit->axes[k];
    }
    rig.joints.push_back(std::move(row));
  }
  return rig;
}

Result<Target> load_target(const std::string& name_or_path, const TargetOptions& options) {
  const auto with_file = [&](Error error) {
    if (error.file.empty()) error.file = name_or_path;
    return error;
  };
  if (auto rig = shipped_rig(name_or_path)) {
    auto target = target_from_rig(std::move(*rig), name_or_path, options);
    if (!target) return with_file(target.error());
    target->path = name_or_path;
    const std::string_view text = embedded_file("rigs/" + name_or_path + ".json");
    target->sha256 = sha256_hex(std::as_bytes(std::span(text.data(), text.size())));
    return target;
  }
  const std::filesystem::path path(name_or_path);
  auto bytes = read_file(path);
  if (!bytes) {
    Error error = bytes.error();
    if (error.code == "file-missing") error.hint = "give a file, or a rig of `limber rig list`";
    return with_file(std::move(error));
  }
  Result<Target> target = Error{};
  if (path.extension() == ".json") {
    auto rig = read_rig_json({reinterpret_cast<const char*>(bytes->data()), bytes->size()});
    if (!rig) return with_file(rig.error());
    target = target_from_rig(std::move(*rig), path.stem().string(), options);
  } else {
    auto imported = import_within_budget(path, options.import);
    if (!imported) return with_file(imported.error());
    target = target_from_character(std::move(*imported), path.stem().string(), options);
  }
  if (!target) return with_file(target.error());
  target->path = name_or_path;
  target->sha256 = sha256_hex(*bytes);
  return target;
}

void model_from_rows(const Rig& rig, std::span<const DualQuaternion> row_local,
                     std::span<DualQuaternion> model_from_row) {
  for (std::size_t i = 0; i < rig.joints.size(); ++i) {
    const std::int32_t parent = rig.joints[i].parent;
    model_from_row[i] = parent == kNoJoint ? row_local[i] : model_from_row[parent] * row_local[i];
  }
}

void skeleton_local_from_rows(const Rig& rig, std::span<const std::int32_t> joint_of_row,
                              const Skeleton& skeleton, std::span<const DualQuaternion> row_local,
                              std::span<DualQuaternion> parent_from_joint) {
  std::vector<DualQuaternion> model(parent_from_joint.size());
  for (std::size_t i = 0; i < joint_of_row.size(); ++i) {
    const std::int32_t parent = rig.joints[i].parent;
    model[joint_of_row[i]] =
        parent == kNoJoint ? row_local[i] : model[joint_of_row[parent]] * row_local[i];
  }
  local_from_model(skeleton, model, parent_from_joint);
  for (DualQuaternion& q : parent_from_joint) q = q.normalized();
}

void skeleton_local_from_rig(const Target& target, std::span<const DualQuaternion> row_local,
                             std::span<DualQuaternion> parent_from_joint) {
  skeleton_local_from_rows(target.rig, target.joint_of_row, target.character.skeleton, row_local,
                           parent_from_joint);
}

}  // namespace limber
