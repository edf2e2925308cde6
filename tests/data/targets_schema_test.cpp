// The JSON Schema of targets and our parser judge alike, as far as a schema can know: which names a
// rig has, and that a quaternion is unit, only the parser sees.

#include <gtest/gtest.h>
#include <unistd.h>

#include <functional>

#include "importers/rig_json.h"
#include "importers/targets_json.h"
#include "tests/data/data_files.h"

namespace limber::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct Case {
  std::string name, rig;
  json document;
};

std::vector<Case> cases() {
  std::vector<Case> out;
  for (const auto& entry : fs::directory_iterator(kData / "poses")) {
    const std::string name = entry.path().filename().string();
    out.push_back(
        {name, name.starts_with("hand") ? "hand" : "biped-foot-root", read_json(entry.path())});
  }
  const json start = {
      {"format", "limber/targets/1"},
      {"hold", {"thumb_tip"}},
      {"poses",
       {{{"name", "p"},
         {"start", "previous"},
         {"posture", {{"rightHand", {0, 10, 0}}}},
         {"targets",
          {{{"effector", "index_tip"}, {"offset", {0, 0, 0.01}}, {"turn_deg", {0, 5, 0}}},
           {{"effector", "ring_tip"}, {"rotation", {1, 0, 0, 0}}, {"weight", 2}}}}}}}};
  const auto vary = [&](const std::string& name, const std::function<void(json&)>& change) {
    json document = start;
    change(document);
    out.push_back({name, "hand", document});
  };
  const auto pose = [](json& d) -> json& { return d["poses"][0]; };
  const auto row = [&](json& d) -> json& { return pose(d)["targets"][0]; };
  vary("as it is", [](json&) {});
  vary("no format", [](json& d) { d.erase("format"); });
  vary("other format", [](json& d) { d["format"] = "limber/targets/9"; });
  vary("unknown key", [](json& d) { d["colour"] = "red"; });
  vary("no poses", [](json& d) { d["poses"] = json::array(); });
  vary("too many poses", [](json& d) { d["poses"] = json(65, d["poses"][0]); });
  vary("held twice", [](json& d) { d["hold"] = {"thumb_tip", "thumb_tip"}; });
  vary("nameless pose", [&](json& d) { pose(d)["name"] = ""; });
  vary("unknown pose key", [&](json& d) { pose(d)["colour"] = "red"; });
  vary("unknown start", [&](json& d) { pose(d)["start"] = "now"; });
  vary("posture of a word", [&](json& d) { pose(d)["posture"]["rightHand"] = {0, "10", 0}; });
  vary("posture beyond a turn", [&](json& d) { pose(d)["posture"]["rightHand"] = {0, 400, 0}; });
  vary("no targets but a hold", [&](json& d) { pose(d).erase("targets"); });
  vary("no effector", [&](json& d) { row(d).erase("effector"); });
  vary("unknown row key", [&](json& d) { row(d)["colour"] = "red"; });
  vary("two positions", [&](json& d) { row(d)["position"] = {0, 0, 0}; });
  vary("two rotations", [&](json& d) { row(d)["rotation"] = {1, 0, 0, 0}; });
  vary("neither", [&](json& d) { d["poses"][0]["targets"][1].erase("rotation"); });
  vary("short offset", [&](json& d) { row(d)["offset"] = {0, 0}; });
  vary("far offset", [&](json& d) { row(d)["offset"] = {0, 0, 2e6}; });
  vary("short rotation", [&](json& d) { d["poses"][0]["targets"][1]["rotation"] = {1, 0, 0}; });
  vary("negative weight", [&](json& d) { row(d)["weight"] = -1; });
  vary("huge weight", [&](json& d) { row(d)["weight"] = 1e7; });
  return out;
}

TEST(TargetsSchema, AndParserAgree) {
  const char* modules = std::getenv("LIMBER_NODE_MODULES");
  if (!modules) GTEST_SKIP() << "npm packages not installed (LIMBER_NODE_MODULES)";
  const fs::path folder =
      fs::temp_directory_path() / ("limber-targets-" + std::to_string(getpid()));
  fs::create_directories(folder);
  const std::vector<Case> all = cases();
  json documents = json::array();
  for (const Case& c : all) documents.push_back(c.document);
  std::ofstream(folder / "documents.json") << documents;
  const std::string command = "node '" + (kSource / "tests/data/schema_verdicts.mjs").string() +
                              "' '" + (kData / "schemas/targets.schema.json").string() + "' '" +
                              (folder / "documents.json").string() + "' '" +
                              (folder / "verdicts.json").string() + "'";
  ASSERT_EQ(std::system(command.c_str()), 0);
  const json verdicts = read_json(folder / "verdicts.json");
  ASSERT_EQ(verdicts.size(), all.size());
  int refused = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const auto rig = read_rig_json(read_text(kData / "rigs" / (all[i].rig + ".json")));
    ASSERT_TRUE(rig.ok());
    const bool schema = verdicts[i]["valid"];
    const auto parsed = read_targets_json(all[i].document.dump(), *rig);
    EXPECT_EQ(parsed.ok(), schema) << all[i].name << "\n  schema: " << verdicts[i]["errors"]
                                   << "\n  parser: " << (parsed.ok() ? "" : parsed.error().message);
    EXPECT_TRUE(schema || !all[i].name.ends_with(".json")) << all[i].name;
    refused += !schema;
  }
  EXPECT_GE(refused, 15);
  fs::remove_all(folder);
}

}  // namespace
}  // namespace limber::test
