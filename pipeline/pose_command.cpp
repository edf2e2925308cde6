#include "pipeline/pose_command.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <set>

#include "importers/targets_json.h"
#include "pipeline/commands.h"
#include "pipeline/embedded.h"
#include "pipeline/file_io.h"
#include "pipeline/pose_effectors.h"
#include "pipeline/pose_solve.h"
#include "pipeline/version.h"
#include "validation/pose_sheet.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

constexpr double kDegrees = 180.0 / M_PI;

json as_json(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }
json as_json(const Eigen::Quaterniond& q) { return {q.w(), q.x(), q.y(), q.z()}; }

const char* name_of(SolverChoice solver) {
  return solver == SolverChoice::pgs         ? "pgs"
         : solver == SolverChoice::pgs_paper ? "pgs-paper"
                                             : "ceres";
}

// ---- what a pose came to, in words and as JSON

std::string verdict_of(const PoseOutcome& pose) {
  return pose.failed ? "failed" : pose.reached ? "reached" : "best reach";
}

std::string error_line(const Rig& rig, const PoseOutcome& pose) {
  const EffectorOutcome* worst = pose.worst();
  if (worst == nullptr) return "";
  return fmt::format("worst error {:.2f} mm, {:.2f} deg ({})", 1e3 * worst->position_error_m,
                     kDegrees * worst->angle_error_rad, rig.effectors[worst->asked.effector].name);
}

std::string solver_line(const PoseOutcome& pose) {
  std::string line = fmt::format("{} iterations", pose.solver.relinearisations);
  if (pose.searched > 0) line += fmt::format(" (+ {} from other starts)", pose.searched);
  return line + (pose.limits.violations == 0
                     ? fmt::format(", {} joint limits kept", pose.limits.joints)
                     : fmt::format(", {} LIMITS BROKEN", pose.limits.violations));
}

std::string contact_line(const Rig& rig, const PoseOutcome& pose) {
  std::set<std::int32_t> joints;
  for (const LimitContact& contact : pose.contacts) joints.insert(contact.joint);
  if (joints.empty()) return "no joint on a limit";
  std::string line = fmt::format("{} on a limit: ", joints.size());
  for (const std::int32_t j : joints) {
    if (line.back() != ' ') line += ", ";
    line += rig.joints[j].name;
  }
  return line;
}

json joints_json(const Rig& rig, const PoseOutcome& pose) {
  const std::vector<std::int32_t> begin = dof_begin(rig);
  std::vector<double> q(static_cast<std::size_t>(dof_count(rig)));
  coordinates_from_pose(rig, pose.parent_from_joint, q);
  json joints = json::array();
  for (std::int32_t j = 0; j < rig.size(); ++j) {
    const DualQuaternion& local = pose.parent_from_joint[j];
    joints.push_back({{"name", rig.joints[j].name},
                      {"q", std::vector<double>(q.begin() + begin[j], q.begin() + begin[j + 1])},
                      {"rotation", as_json(local.rotation().normalized())},
                      {"translation", as_json(local.translation())}});
  }
  return joints;
}

json effectors_json(const Rig& rig, const PoseOutcome& pose) {
  json effectors = json::array();
  for (const EffectorOutcome& e : pose.effectors) {
    json target = json::object();
    if (e.asked.position) target["position"] = as_json(*e.asked.position);
    if (e.asked.rotation) target["rotation"] = as_json(*e.asked.rotation);
    json entry{{"name", rig.effectors[e.asked.effector].name},
               {"weight", e.asked.weight},
               {"target", target},
               {"reached",
                {{"position", as_json(e.reached.translation())},
                 {"rotation", as_json(e.reached.rotation().normalized())}}}};
    if (e.asked.position) entry["position_error_mm"] = 1e3 * e.position_error_m;
    if (e.asked.rotation) entry["orientation_error_deg"] = kDegrees * e.angle_error_rad;
    entry["reachable"] = e.reachable;
    effectors.push_back(std::move(entry));
  }
  return effectors;
}

json limits_json(const Rig& rig, const PoseOutcome& pose) {
  json at_border = json::array();
  for (const LimitContact& contact : pose.contacts) {
    at_border.push_back({{"joint", rig.joints[contact.joint].name},
                         {"coordinate", contact.coordinate},
                         {"side", contact.side}});
  }
  return {{"joints", pose.limits.joints},
          {"violations", pose.limits.violations},
          {"max_violation_deg", pose.limits.max_violation_deg},
          {"at_border", at_border}};
}

json pose_json(const Rig& rig, const PoseOutcome& pose) {
  const IkReport& solver = pose.solver;
  return {{"name", pose.name},
          {"status", verdict_of(pose)},
          {"joints", joints_json(rig, pose)},
          {"effectors", effectors_json(rig, pose)},
          {"limits", limits_json(rig, pose)},
          {"solver",
           {{"relinearisations", solver.relinearisations},
            {"tree_passes", solver.tree_passes},
            {"sweeps", solver.sweeps},
            {"residual", solver.residual},
            {"cost", solver.cost},
            {"converged", solver.converged},
            {"searched_relinearisations", pose.searched}}},
          {"ceres", {{"cost", pose.refined_cost}}}};
}

// ---- the sheet

/// The target as a whole frame: what is left free is drawn as it was reached.
PoseMark mark_of(const DressedRig& dressed, const EffectorOutcome& e) {
  const RigEffector& effector = dressed.rig.effectors[e.asked.effector];
  PoseMark mark;
  mark.joint = dressed.joint_of_row[effector.joint];
  mark.reached = e.reached;
  mark.target =
      DualQuaternion::from_rotation_translation(e.asked.rotation.value_or(e.reached.rotation()),
                                                e.asked.position.value_or(e.reached.translation()));
  mark.oriented = e.asked.rotation.has_value();
  return mark;
}

struct Drawn {
  std::vector<std::byte> png;
  json views = json::array();
  std::int32_t width = 0, height = 0;
};

json view_json(const PoseView& view) {
  const Eigen::Matrix3d& r = view.camera.view_from_world;
  return {{"pose", view.pose},
          {"box", {view.box.x, view.box.y, view.box.width, view.box.height}},
          {"eye", as_json(view.camera.eye)},
          {"right", as_json(Eigen::Vector3d(r.row(0)))},
          {"up", as_json(Eigen::Vector3d(r.row(1)))},
          {"back", as_json(Eigen::Vector3d(r.row(2)))},
          {"focal_px", view.camera.focal_px},
          {"centre_px", {view.camera.centre_px.x(), view.camera.centre_px.y()}}};
}

Result<Drawn> draw(const DressedRig& dressed, const std::vector<PoseOutcome>& poses,
                   const PoseArgs& args, const std::string& description) {
  PoseSheet sheet;
  sheet.title = fmt::format("{}: {}", dressed.rig.name, fs::path(args.targets).stem().string());
  sheet.description = description;
  sheet.character = &dressed.character;
  sheet.detail = fmt::format("{} joints, {} degrees of freedom, solver {}", dressed.rig.size(),
                             dof_count(dressed.rig), name_of(args.solver));
  for (const PoseOutcome& pose : poses) {
    PoseCell cell;
    cell.name = pose.name;
    cell.verdict = verdict_of(pose);
    cell.parent_from_joint = dressed.character.skeleton.rest_parent_from_joint;
    skeleton_local_from_rows(dressed.rig, dressed.joint_of_row, dressed.character.skeleton,
                             pose.parent_from_joint, cell.parent_from_joint);
    for (const EffectorOutcome& e : pose.effectors) cell.marks.push_back(mark_of(dressed, e));
    for (const LimitContact& contact : pose.contacts) {
      cell.tinted_joints.push_back(dressed.joint_of_row[contact.joint]);
    }
    cell.lines = {error_line(dressed.rig, pose), solver_line(pose)};
    cell.limit_line = contact_line(dressed.rig, pose);
    sheet.cells.push_back(std::move(cell));
  }
  const auto picture = render_pose_sheet(sheet);
  if (!picture) return picture.error();
  auto png = encode_png(picture->image);
  if (!png) return png.error();
  Drawn drawn{std::move(*png), json::array(), picture->image.width, picture->image.height};
  for (const PoseView& view : picture->views) drawn.views.push_back(view_json(view));
  return drawn;
}

// ---- the command

/// A shipped example's text by name, or a file's.
Result<std::string> targets_text(const std::string& name_or_path) {
  const std::string_view shipped = embedded_file("poses/" + name_or_path + ".json");
  if (!shipped.empty()) return std::string(shipped);
  auto text = read_text(name_or_path);
  if (text || text.error().code != "file-missing") return text;
  std::string names;
  for (const std::string_view file : embedded_files("poses/")) {
    names += fmt::format(" {}", file.substr(6, file.size() - 11));
  }
  text.error().hint =
      "give a file that starts from `limber pose RIG --example`, or one of:" + names;
  return text;
}

Result<DressedRig> rig_with_effectors(const std::string& name) {
  auto dressed = dressed_rig(name);
  if (!dressed) return dressed;
  add_effectors_of_roles(*dressed);
  if (!dressed->rig.effectors.empty()) return dressed;
  return Error{.code = "rig-no-effectors",
               .message = "the rig has no effectors, and no joints with roles to put them on",
               .file = name,
               .hint = "add \"effectors\" to the rig JSON; see assets/data/rigs/ikrig.schema.json"};
}

void print_lines(const Rig& rig, const std::vector<PoseOutcome>& poses) {
  for (const PoseOutcome& pose : poses) {
    fmt::print("{:24} {:10}  {}\n", pose.name, verdict_of(pose), error_line(rig, pose));
    fmt::print("{:24} {:10}  {}; {}\n", "", "", solver_line(pose), contact_line(rig, pose));
  }
}

int complain(Error error, const std::string& file, const PoseArgs& args, int code) {
  if (error.file.empty()) error.file = file;
  print_error(error, args.json);
  return code;
}

int pose(const PoseArgs& args) {
  const auto dressed = rig_with_effectors(args.rig);
  if (!dressed) return complain(dressed.error(), args.rig, args, kUsage);
  const Rig& rig = dressed->rig;
  if (args.example) {
    fmt::print("{}\n", example_targets(rig));
    return kAllPassed;
  }
  const auto text = targets_text(args.targets);
  if (!text) return complain(text.error(), args.targets, args, kUsage);
  const auto file = read_targets_json(*text, rig);
  if (!file) return complain(file.error(), args.targets, args, kUsage);
  const auto poses = solve_poses(rig, *file, args.solver);
  if (!poses) return complain(poses.error(), args.targets, args, kSomeFailed);

  json out{{"schema", "limber/pose/1"},
           {"limber_version", kVersion},
           {"rig", {{"name", rig.name}, {"joints", rig.size()}, {"dof", dof_count(rig)}}},
           {"targets", args.targets},
           {"solver", name_of(args.solver)},
           {"poses", json::array()}};
  bool failed = false;
  for (const PoseOutcome& pose : *poses) {
    out["poses"].push_back(pose_json(rig, pose));
    failed = failed || pose.failed;
  }
  if (!args.sheet.empty()) {
    const auto drawn = draw(*dressed, *poses, args, file->description);
    const auto written = drawn ? write_whole(args.sheet, drawn->png) : Result<void>(drawn.error());
    if (!written) return complain(written.error(), args.sheet.string(), args, kEnvironment);
    out["sheet"] = {{"path", args.sheet.string()},
                    {"width", drawn->width},
                    {"height", drawn->height},
                    {"views", drawn->views}};
  }
  if (args.json) {
    fmt::print("{}\n", out.dump(1, ' ', false, json::error_handler_t::replace));
  } else {
    print_lines(rig, *poses);
  }
  return failed ? kSomeFailed : kAllPassed;
}

}  // namespace

int pose_command(const PoseArgs& args) {
  return isolated_command([&] { return pose(args); },
                          {.reads = {args.rig, args.targets}, .writes = folder_of(args.sheet)});
}

}  // namespace limber
