// The JSON Schema of targets and our parser judge alike, as far as a schema can know: which names a
// rig has, and that a quaternion is unit, only the parser sees.

#include <gtest/gtest.h>

#include <functional>
#include <stdexcept>

#include "importers/rig_json.h"
#include "importers/targets_json.h"
#include "tests/data/schema_agreement.h"

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
  expect_schema_and_parser_agree(
      kData / "schemas/targets.schema.json", cases(),
      [](const Case& c) {
        const auto rig = read_rig_json(read_text(kData / "rigs" / (c.rig + ".json")));
        if (!rig) throw std::runtime_error(c.rig + ": " + rig.error().message);
        return read_targets_json(c.document.dump(), *rig);
      },
      15);
}

}  // namespace
}  // namespace limber::test
