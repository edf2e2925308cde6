// `limber inspect --json` beside facts that other tools measured on the same files. Every
// difference is listed with its reason; an entry that no longer differs is a failure as well.

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "tests/pipeline/program.h"

namespace {

using limber_test::limber;
using limber_test::shared;
using limber_test::text_of;
using nlohmann::json;

constexpr const char* kMotionOnly =
    "without a skin the manifest counts every node, cameras and childless tips among them; ours "
    "are the nodes that move, and their ancestors";
constexpr const char* kStub =
    "each thumb and each index finger is a single joint: named like fingers, but no finger to bend";

/// "file: fact" -> why ours differs.
const std::map<std::string, std::string>& explained() {
  static const std::map<std::string, std::string> all = {
      {"bvh/makehuman_pose_sit01_6ch.bvh: up",
       "the manifest takes the zero-filled positions literally, which collapses the body; with the "
       "offsets kept the figure sits upright along +Z"},
      {"characters/khronos_fox.glb: unit", "drawn in centimetres, but glTF is in metres"},
      {"characters/quaternius_robot.glb: fingers",
       "its palms and fingers are named by number; no chain of a hand is known by such names"},
      {"characters/gazebo_walk.dae: rate",
       "the manifest tells assimp's ticks; the keys are 1/24 s apart"},
      {"characters/genea_tpose_fingers.fbx: joints",
       "22 joints of its skin weigh no vertex, and the manifest leaves them out"},
      {"mocap_other/cmu_07_01_walk.fbx: joints", kMotionOnly},
      {"mocap_other/cmu_09_11_run.fbx: joints", kMotionOnly},
      {"mocap_other/ozz_jog_biped.fbx: joints", kMotionOnly},
      {"mocap_other/ozz_crossarms_fingers.fbx: joints", kMotionOnly},
      {"mocap_other/ozz_jog_biped.fbx: frames",
       "the manifest counts keys, which stand on half frames too; 24 frames' time is 25 samples"},
      {"mocap_other/ozz_crossarms_fingers.fbx: frames",
       "the manifest counts keys, which are sparse; 258 frames' time is 259 samples"},
      {"mocap_other/cmu_07_01_walk.fbx: fingers", kStub},
      {"mocap_other/cmu_09_11_run.fbx: fingers", kStub},
      {"mocap_other/cmu_07_01_walk.fbx: unit", "the armature is scaled by 100, and that is folded"},
      {"mocap_other/cmu_09_11_run.fbx: unit", "the armature is scaled by 100, and that is folded"},
  };
  return all;
}

/// Metres that the manifest's words mean; nullopt where they name no unit.
std::optional<double> metres(const std::string& words) {
  const std::pair<const char*, double> units[] = {
      {"CMU", 0.0254 / 0.45}, {"inch", 0.0254}, {"decimetres", 0.1}, {"cm", 0.01}};
  for (const auto& [word, value] : units) {
    if (words.starts_with(word)) return value;
  }
  if (words == "m" || words.starts_with("m ")) return 1.0;
  return std::nullopt;
}

/// Facts of the manifest that ours contradict.
std::vector<std::string> contradictions(const json& item, const json& ours) {
  std::vector<std::string> out;
  const json& truth = item["facts"];
  if (truth["joints"] != ours["joints"]) out.emplace_back("joints");
  if (truth["frames"] != ours["frames"]) out.emplace_back("frames");
  // The manifest inverts the rounded frame time, ours is snapped; 0 means no motion.
  const double rate = ours["rate_hz"];
  const double wanted = truth["fps"].is_number() ? truth["fps"].get<double>() : 0.0;
  if (std::abs(rate - wanted) > 1e-3 * rate) out.emplace_back("rate");
  const std::string up = truth.value("up_axis", "+Y");  // where it says none, Y is up
  const std::string our_up = ours["up"];
  if (!up.starts_with(our_up) && up != our_up.substr(1) + "_UP") out.emplace_back("up");
  const auto unit = metres(item.value("units", ""));
  if (unit && std::abs(*unit - ours["unit_m"].get<double>()) > 1e-9) out.emplace_back("unit");
  if (truth["fingers"] != ours["fingers"]) out.emplace_back("fingers");
  return out;
}

TEST(Inspect, AgreesWithTheManifest) {
  const auto path = shared("manifest.json");
  if (path.empty()) GTEST_SKIP() << "no shared data beside the sources; set LIMBER_SHARED";
  std::map<std::string, std::string> unseen = explained();
  int files = 0;
  const json manifest = json::parse(text_of(path));
  for (const json& item : manifest["items"]) {
    const std::string file = item["file"];
    if (file.starts_with("joint_limits/") || file.starts_with("hand_tracking/")) continue;
    const auto run = limber({"inspect", shared(file).string(), "--json"});
    ASSERT_EQ(run.exit_code, 0) << file;
    ++files;
    for (const std::string& fact : contradictions(item, json::parse(run.out))) {
      const std::string what = file + ": " + fact;
      EXPECT_EQ(unseen.erase(what), 1U) << what << "\n" << run.out.substr(0, 600);
    }
  }
  for (const auto& [what, why] : unseen) {
    ADD_FAILURE() << what << " is explained (" << why << ") but does not differ";
  }
  EXPECT_GE(files, 40);
}

}  // namespace
