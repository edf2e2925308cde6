#include "pipeline/dressed_rig.h"

#include <filesystem>
#include <numeric>

#include "assets/model/mannequin.h"
#include "importers/rig_json.h"
#include "pipeline/file_io.h"
#include "pipeline/target.h"

namespace limber {
namespace {

/// A mannequin's joints are the rig's, row by row.
DressedRig dressed(Rig rig) {
  DressedRig out;
  out.character = mannequin(rig);
  out.joint_of_row.resize(rig.joints.size());
  std::iota(out.joint_of_row.begin(), out.joint_of_row.end(), 0);
  out.rig = std::move(rig);
  return out;
}

}  // namespace

Result<DressedRig> dressed_rig(const std::string& name_or_path) {
  if (auto rig = shipped_rig(name_or_path)) return dressed(std::move(*rig));
  if (std::filesystem::path(name_or_path).extension() == ".json") {
    const auto text = read_text(name_or_path);
    if (!text) return text.error();
    auto rig = read_rig_json(*text);
    if (rig) return dressed(std::move(*rig));
    rig.error().file = name_or_path;
    return rig.error();
  }
  auto target = load_target(name_or_path, {});
  if (!target) return target.error();
  DressedRig out{std::move(target->rig), std::move(target->character),
                 std::move(target->joint_of_row)};
  for (std::size_t i = 0; i < out.joint_of_row.size(); ++i) {
    out.character.roles[out.joint_of_row[i]] = out.rig.joints[i].role;
  }
  return out;
}

}  // namespace limber
