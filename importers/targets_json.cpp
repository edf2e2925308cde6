#include "importers/targets_json.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "importers/failure.h"
#include "importers/json_view.h"

namespace limber {

namespace {

constexpr const char* kCode = "targets-json";
constexpr std::size_t kMostPoses = 64;
constexpr double kFarthest = 1e6;    // m
constexpr double kUnitSlack = 1e-3;  // quaternions are typed by hand: 0.707 is welcome
constexpr double kRadians = M_PI / 180.0;

bool takes_position(EffectorKind kind) {
  return kind != EffectorKind::orientation && kind != EffectorKind::direction;
}
bool takes_rotation(EffectorKind kind) { return kind != EffectorKind::position; }

template <class Rows>
std::string names_of(const Rows& rows) {
  std::vector<std::string> names;
  for (const auto& row : rows) names.push_back(row.name);
  return fmt::format("{}", fmt::join(names, ", "));
}

std::int32_t read_effector(const JsonView& view, const Rig& rig) {
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    if (rig.effectors[e].name == view.string()) return static_cast<std::int32_t>(e);
  }
  fail("targets-effector",
       fmt::format("{}: the rig has no effector '{}'", view.pointer(), view.string()),
       "its effectors: " + names_of(rig.effectors));
}

Eigen::Vector3d read_point(const JsonView& view) {
  const Eigen::Vector3d p = view.vector3();
  if (p.cwiseAbs().maxCoeff() > kFarthest) view.complain("farther than a million metres");
  return p;
}

Eigen::Quaterniond read_rotation(const JsonView& view) {
  view.array_of(4);
  const Eigen::Quaterniond q(view[0].number(), view[1].number(), view[2].number(),
                             view[3].number());
  if (!(std::abs(q.norm() - 1.0) <= kUnitSlack)) {
    view.complain("a unit quaternion (w, x, y, z) is expected");
  }
  return q.normalized();
}

/// A rotation vector in degrees: its direction is the axis, its length the angle.
Eigen::Quaterniond read_turn(const JsonView& view) {
  const Eigen::Vector3d degrees = view.vector3();
  if (degrees.norm() > 360.0) view.complain("more than a whole turn");
  return rotation_exp(Eigen::Vector3d(kRadians * degrees));
}

/// World transforms of all effectors; the rest pose, or a posture's coordinates.
class Reference {
 public:
  explicit Reference(const Rig& rig)
      : rig_(rig), q_(static_cast<std::size_t>(dof_count(rig)), 0.0), begin_(dof_begin(rig)) {
    place();
  }
  void take(const JsonView& posture) {
    for (const auto& [name, unused] : posture.object().value().items()) {
      const JsonView values = posture.at(name.c_str());
      const std::int32_t joint = rig_.find(name);
      if (joint == kNoJoint) {
        fail("targets-joint", fmt::format("{}: the rig has no joint '{}'", values.pointer(), name),
             "its joints: " + names_of(rig_.joints));
      }
      const JointType type = rig_.joints[joint].type;
      if (type == JointType::free) values.complain("a free joint has no angles");
      values.array_of(static_cast<std::size_t>(dof_count(type)));
      for (std::size_t k = 0; k < values.size(); ++k) {
        const double degrees = values[k].number();
        if (std::abs(degrees) > 360.0) values[k].complain("more than a whole turn");
        q_[begin_[joint] + k] = kRadians * degrees;
      }
    }
    place();
  }
  const DualQuaternion& of(std::int32_t effector) const { return world_from_effector_[effector]; }

 private:
  void place() {
    const Skeleton skeleton = skeleton_of(rig_);
    std::vector<DualQuaternion> world(rig_.joints.size());
    pose_from_coordinates(rig_, q_, world);
    model_from_local(skeleton, world, world);
    world_from_effector_.clear();
    for (const RigEffector& effector : rig_.effectors) {
      const DualQuaternion& joint = world[effector.joint];
      world_from_effector_.push_back(DualQuaternion::from_rotation_translation(
          joint.rotation(), joint.transform_point(effector.offset)));
    }
  }

  const Rig& rig_;
  std::vector<double> q_;
  std::vector<std::int32_t> begin_;
  std::vector<DualQuaternion> world_from_effector_;
};

/// Refuses what the effector's kind cannot follow, and what leaves it nothing to follow.
void check_kind(const JsonView& view, const TargetRow& row, EffectorKind kind) {
  if (row.position && !takes_position(kind)) {
    view.complain(
        fmt::format("this effector is of kind {}: it takes no position", to_string(kind)));
  }
  if (row.rotation && !takes_rotation(kind)) {
    view.complain(
        fmt::format("this effector is of kind {}: it takes no rotation", to_string(kind)));
  }
  const bool both = kind == EffectorKind::line;
  if (both ? !(row.position && row.rotation) : !(row.position || row.rotation)) {
    view.complain(both
                      ? "a line effector needs 'position' or 'offset', and 'rotation' or 'turn_deg'"
                      : "one of 'position', 'offset', 'rotation', 'turn_deg' is missing");
  }
}

TargetRow read_row(const JsonView& view, const Rig& rig, const Reference& reference) {
  view.only({"effector", "position", "offset", "rotation", "turn_deg", "weight"});
  TargetRow row;
  row.effector = read_effector(view.at("effector"), rig);
  const DualQuaternion& from = reference.of(row.effector);
  if (view.has("position") && view.has("offset")) {
    view.complain("'position' and 'offset' exclude each other");
  }
  if (view.has("rotation") && view.has("turn_deg")) {
    view.complain("'rotation' and 'turn_deg' exclude each other");
  }
  if (const auto given = view.find("position")) row.position = read_point(*given);
  if (const auto given = view.find("offset"))
    row.position = from.translation() + read_point(*given);
  if (const auto given = view.find("rotation")) row.rotation = read_rotation(*given);
  if (const auto given = view.find("turn_deg")) row.rotation = read_turn(*given) * from.rotation();
  if (const auto given = view.find("weight")) {
    row.weight = given->number();
    if (row.weight < 0.0 || row.weight > kFarthest) given->complain("expected 0 to 1e6");
  }
  check_kind(view, row, rig.effectors[row.effector].kind);
  return row;
}

/// An effector that stays where it is, as far as its kind can be held.
TargetRow held(std::int32_t effector, const Rig& rig, const Reference& reference) {
  TargetRow row;
  row.effector = effector;
  const EffectorKind kind = rig.effectors[effector].kind;
  if (takes_position(kind)) row.position = reference.of(effector).translation();
  if (takes_rotation(kind)) row.rotation = reference.of(effector).rotation();
  return row;
}

std::vector<std::int32_t> read_hold(const JsonView& view, const Rig& rig) {
  std::vector<std::int32_t> hold;
  for (std::size_t i = 0; i < view.array().size(); ++i) {
    const std::int32_t effector = read_effector(view[i], rig);
    if (std::find(hold.begin(), hold.end(), effector) != hold.end()) {
      view[i].complain("the effector is named twice");
    }
    hold.push_back(effector);
  }
  return hold;
}

PoseTargets read_pose(const JsonView& view, const Rig& rig, const std::vector<std::int32_t>& hold) {
  view.only({"name", "start", "posture", "targets"});
  PoseTargets pose;
  pose.name = view.at("name").string();
  if (pose.name.empty()) view.at("name").complain("a name is expected");
  if (const auto start = view.find("start")) {
    if (start->string() != "rest" && start->string() != "previous") {
      start->complain("'rest' or 'previous' is expected");
    }
    pose.start = start->string() == "rest" ? PoseStart::rest : PoseStart::previous;
  }
  Reference reference(rig);
  if (const auto posture = view.find("posture")) reference.take(*posture);
  const auto named = [&](std::int32_t effector) {
    return std::any_of(pose.rows.begin(), pose.rows.end(),
                       [&](const TargetRow& row) { return row.effector == effector; });
  };
  if (const auto targets = view.find("targets")) {
    for (std::size_t i = 0; i < targets->array().size(); ++i) {
      const TargetRow row = read_row((*targets)[i], rig, reference);
      if (named(row.effector)) (*targets)[i].complain("the effector is named twice");
      pose.rows.push_back(row);
    }
  }
  for (const std::int32_t effector : hold) {
    if (!named(effector)) pose.rows.push_back(held(effector, rig, reference));
  }
  if (pose.rows.empty()) view.complain("no effector is named, in 'targets' or in 'hold'");
  std::sort(pose.rows.begin(), pose.rows.end(),
            [](const TargetRow& a, const TargetRow& b) { return a.effector < b.effector; });
  return pose;
}

TargetsFile read_targets(const JsonView& root, const Rig& rig) {
  root.only({"$schema", "format", "description", "hold", "poses"});
  if (root.at("format").string() != "limber/targets/1") {
    root.at("format").complain("the format is not 'limber/targets/1'");
  }
  TargetsFile file;
  if (const auto schema = root.find("$schema")) schema->string();
  if (const auto description = root.find("description")) file.description = description->string();
  std::vector<std::int32_t> hold;
  if (const auto given = root.find("hold")) hold = read_hold(*given, rig);
  const JsonView poses = root.at("poses");
  if (poses.array().size() == 0) poses.complain("there is no pose");
  if (poses.size() > kMostPoses) poses.complain(fmt::format("more than {} poses", kMostPoses));
  for (std::size_t i = 0; i < poses.size(); ++i) {
    file.poses.push_back(read_pose(poses[i], rig, hold));
  }
  return file;
}

}  // namespace

Result<TargetsFile> read_targets_json(std::string_view text, const Rig& rig) {
  return guarded<TargetsFile>([&]() -> Result<TargetsFile> {
    const nlohmann::json document = parse_json(text, kCode, true);
    return read_targets(JsonView(document, kCode), rig);
  });
}

}  // namespace limber
