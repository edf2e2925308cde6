// Programs that are not Limber judge its GLB files: the Khronos validator and three.js.

#include <gtest/gtest.h>

#include <cstdlib>
#include <nlohmann/json.hpp>

#include "assets/model/mannequin.h"
#include "exporters/exporter.h"
#include "importers/rig_json.h"
#include "tests/exporters/support.h"

namespace limber::test {
namespace {

namespace fs = std::filesystem;

constexpr const char* kNoNode = "npm packages not installed (LIMBER_NODE_MODULES)";

bool has_node() { return std::getenv("LIMBER_NODE_MODULES") != nullptr; }

/// Runs a script of this folder; its output is shown where it fails.
bool run(const std::string& script, const std::vector<fs::path>& arguments) {
  const fs::path log = scratch_folder() / "log.txt";
  std::string command =
      "node '" + (fs::path(LIMBER_SOURCE_DIR) / "tests/exporters" / script).string() + "'";
  for (const fs::path& a : arguments) command += " '" + a.string() + "'";
  const int status = std::system((command + " >'" + log.string() + "' 2>&1").c_str());
  if (status != 0) ADD_FAILURE() << command << "\n" << read_text(log);
  return status == 0;
}

void expect_valid(const Character& character, const Clip& clip, const fs::path& input = {}) {
  const auto glb = export_glb(character, clip);
  ASSERT_TRUE(glb.ok()) << glb.error().message;
  const fs::path file = scratch_folder() / "out.glb";
  write_file(file, *glb);
  run("validate_glb.mjs", input.empty() ? std::vector{file} : std::vector{file, input});
}

/// three.js plays the file; every joint is where our forward kinematics has it.
void expect_three_agrees(const Character& character, const Clip& clip) {
  const auto glb = export_glb(character, clip);
  ASSERT_TRUE(glb.ok()) << glb.error().message;
  const fs::path folder = scratch_folder();
  write_file(folder / "out.glb", *glb);
  const GltfDocument& document = character.document;
  const double metre = character.has_document ? document.unit_m : 1.0;
  const Eigen::Quaterniond turn = character.has_document ? document.canonical_from_file.conjugate()
                                                         : Eigen::Quaterniond::Identity();
  nlohmann::json expected;
  double size = 1.0;  // float32 resolves a figure of many metres less finely
  std::vector<DualQuaternion> model(character.skeleton.parents.size());
  for (const std::int64_t f : {std::int64_t{0}, clip.frames() / 3, clip.frames() - 1}) {
    expected["times"].push_back(double(f) / clip.rate_hz);
    model_from_local(character.skeleton, clip.frame(f), model);
    nlohmann::json positions;
    for (const DualQuaternion& joint : model) {
      const Eigen::Vector3d p = turn * (joint.translation() / metre);
      size = std::max(size, joint.translation().norm());
      positions.push_back({p.x(), p.y(), p.z()});
    }
    expected["positions"].push_back(positions);
  }
  expected["tolerance"] = 1e-5 * size / metre;
  for (std::int32_t j = 0; j < character.skeleton.size(); ++j) {
    expected["nodes"].push_back(character.has_document ? document.node_of_joint[j] : j);
  }
  const std::string text = expected.dump();
  write_file(folder / "expected.json", to_bytes(text));
  run("three_check.mjs", {folder / "out.glb", folder / "expected.json"});
}

Character mannequin_of(const char* rig_name) {
  const auto rig = read_rig_json(read_text(fs::path(LIMBER_SOURCE_DIR) / "assets/data/rigs" /
                                           (std::string(rig_name) + ".json")));
  EXPECT_TRUE(rig.ok());
  return rig ? mannequin(*rig) : Character{};
}

TEST(Judges, MannequinsAreValidAndPlayInThree) {
  if (!has_node()) GTEST_SKIP() << kNoNode;
  for (const char* name : {"biped-full", "hand"}) {
    SCOPED_TRACE(name);
    Random random(31);
    const Character character = mannequin_of(name);
    const Clip clip = random_clip(character.skeleton, 30, random);
    expect_valid(character, clip);
    expect_three_agrees(character, clip);
  }
}

TEST(Judges, ManyInfluencesMaterialsAndRootsAreValid) {
  if (!has_node()) GTEST_SKIP() << kNoNode;
  Random random(32);
  Skeleton skeleton = random_skeleton(14, random);
  skeleton.parents[5] = kNoJoint;
  Character character = bare_character(std::move(skeleton));
  for (const int influences : {1, 4, 6, 11}) {
    character.meshes.push_back(random_mesh(character.skeleton, 40, influences, random));
  }
  character.meshes[0].material = 0;
  character.meshes[1].normals[3].setZero();
  character.materials.push_back({"glass", {0.5F, 2.0F, -1.0F, 0.5F}, -1, true});
  const Clip clip = random_clip(character.skeleton, 10, random);
  expect_valid(character, clip);
  expect_three_agrees(character, clip);
}

TEST(Judges, SharedCharactersGainNoErrorAndPlayInThree) {
  if (!has_node()) GTEST_SKIP() << kNoNode;
  const auto shared = shared_folder();
  if (shared.empty()) GTEST_SKIP() << "no shared data on this machine (LIMBER_SHARED)";
  for (const auto& entry : fs::directory_iterator(shared / "data/characters")) {
    const std::string extension = entry.path().extension();
    SCOPED_TRACE(entry.path().filename().string());
    const auto source = import_file(entry.path());
    ASSERT_TRUE(source.ok()) << source.error().message;
    const bool document = source->character.has_document;
    Random random(33);
    const Clip clip = random_clip(source->character.skeleton, 8, random);
    expect_valid(source->character, clip, document ? entry.path() : fs::path());
    expect_three_agrees(source->character, clip);
  }
}

}  // namespace
}  // namespace limber::test
