#include "pipeline/certify.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "importers/importer.h"
#include "pipeline/measure.h"
#include "validation/certificate.h"
#include "validation/limit_check.h"

namespace limber {
namespace {

using nlohmann::json;

Result<std::vector<std::byte>> no_external_files(std::string_view uri) {
  return Error{.code = "uri-refused", .message = "an export refers to " + std::string(uri)};
}

/// The rig without leaves that cannot move: readers leave them out, and they have no limits.
Rig without_still_leaves(const Rig& rig) {
  std::vector<std::uint8_t> needed(rig.joints.size(), 0);
  for (std::size_t i = rig.joints.size(); i-- > 0;) {
    needed[i] = needed[i] || rig.joints[i].type != JointType::fixed;
    if (needed[i] && rig.joints[i].parent != kNoJoint) needed[rig.joints[i].parent] = 1;
  }
  Rig out;
  std::vector<std::int32_t> row_of(rig.joints.size(), kNoJoint);
  for (std::size_t i = 0; i < rig.joints.size(); ++i) {
    if (!needed[i]) continue;
    row_of[i] = out.size();
    out.joints.push_back(rig.joints[i]);
    const std::int32_t parent = rig.joints[i].parent;
    out.joints.back().parent = parent == kNoJoint ? kNoJoint : row_of[parent];
  }
  return out;
}

/// A motion without the End Sites of a BVH, which other readers leave out.
struct Bones {
  Skeleton skeleton;
  Clip clip;
};

Bones without_end_sites(const Character& character, const Clip& clip) {
  Bones out;
  std::vector<std::int32_t> kept, row_of(character.skeleton.parents.size(), kNoJoint);
  const auto children = children_of(character.skeleton);
  for (std::int32_t j = 0; j < character.skeleton.size(); ++j) {
    const std::string& name = character.skeleton.names[j];
    if (children[j].empty() && !character.deforming[j] && name.find("_End") != std::string::npos) {
      continue;
    }
    row_of[j] = out.skeleton.size();
    kept.push_back(j);
    const std::int32_t parent = character.skeleton.parents[j];
    out.skeleton.names.push_back(name);
    out.skeleton.parents.push_back(parent == kNoJoint ? kNoJoint : row_of[parent]);
    out.skeleton.rest_parent_from_joint.push_back(character.skeleton.rest_parent_from_joint[j]);
  }
  out.clip = clip;
  out.clip.joints = out.skeleton.size();
  out.clip.parent_from_joint.clear();
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    for (const std::int32_t j : kept) out.clip.parent_from_joint.push_back(clip.frame(f)[j]);
  }
  return out;
}

json read_and_compare(std::span<const std::byte> bytes, const std::string& format,
                      ReaderChoice reader, const Target& target, const Retargeted& meant,
                      bool limits) {
  ImportOptions options;
  options.reader = reader;
  options.up = 'y';
  options.unit_m = format == "bvh" ? 0.01 : 1.0;
  options.keep_reference_frame = true;
  auto imported = import_bytes(bytes, format, no_external_files, options);
  if (!imported) return {{"fault", imported.error().message}};
  if (imported->clips.empty()) return {{"fault", "the file holds no clip"}};
  CertificateOptions certificate;
  certificate.position_m = 1e-4;
  const Bones bones = without_end_sites(target.character, meant.clip);
  auto report = compare_clips(bones.skeleton, bones.clip, imported->character.skeleton,
                              imported->clips.front(), certificate);
  if (!report) return {{"fault", report.error().message}};
  json out{{"ok", report->ok}, {"error_m", report->position_m.value}, {"faults", report->faults}};
  if (limits) {
    const Rig rig = without_still_leaves(meant.rig);
    const auto rig_clip = clip_on_rig(imported->character.skeleton, imported->clips.front(), rig);
    if (!rig_clip) return {{"fault", "joints are missing"}};
    const LimitReport checked = check_joint_limits(rig, *rig_clip);
    out["limited_joints"] = checked.joints;
    out["violations"] = checked.violations;
    out["max_violation_deg"] = checked.max_violation_deg;
    if (!checked.worst.empty()) {
      out["worst_joint"] = rig.joints[checked.worst.front().joint].name;
      out["worst_frame"] = checked.worst.front().frame;
    }
  }
  return out;
}

FileCheck check_with(std::span<const std::byte> bytes, const std::string& format,
                     ReaderChoice reader, const Target& target, const Retargeted& meant,
                     bool limits, SandboxMode sandbox) {
  FileCheck check;
  check.reader = reader == ReaderChoice::assimp ? "assimp" : "limber-" + format;
  const auto answer = run_isolated(
      [&] {
        return read_and_compare(bytes, format, reader, target, meant, limits)
            .dump(-1, ' ', false, json::error_handler_t::replace);
      },
      {.sandbox = sandbox});
  if (!answer) {
    check.faults = {answer.error().message};
    return check;
  }
  const json found = json::parse(*answer, nullptr, false);
  if (found.contains("fault")) {
    check.faults = {found["fault"].get<std::string>()};
    return check;
  }
  check.ok = found["ok"];
  check.joints_max_error_m = found["error_m"];
  check.faults = found["faults"].get<std::vector<std::string>>();
  check.limited_joints = found.value("limited_joints", std::int64_t(0));
  check.violations = found.value("violations", std::int64_t(0));
  check.max_violation_deg = found.value("max_violation_deg", 0.0);
  check.worst_joint = found.value("worst_joint", "");
  check.worst_frame = found.value("worst_frame", std::int64_t(-1));
  return check;
}

}  // namespace

FileCheck certify(std::span<const std::byte> bytes, const std::string& format, const Target& target,
                  const Retargeted& meant, bool limits, SandboxMode sandbox) {
  FileCheck by_assimp =
      check_with(bytes, format, ReaderChoice::assimp, target, meant, limits, sandbox);
  if (by_assimp.ok) return by_assimp;
  FileCheck own =
      check_with(bytes, format, ReaderChoice::automatic, target, meant, limits, sandbox);
  own.reason = "assimp does not read this file back as written (" +
               (by_assimp.faults.empty() ? std::string("unknown") : by_assimp.faults.front()) +
               "); checked with Limber's own reader in a process of its own";
  return own;
}

}  // namespace limber
