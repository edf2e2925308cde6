// The JSON Schema of rigs and our parser judge alike: ajv (npm) reads the schema, we read the rig.

#include <gtest/gtest.h>

#include <functional>

#include "importers/rig_json.h"
#include "tests/data/schema_agreement.h"

namespace limber::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// Rigs as shipped, and rigs with one thing wrong or merely unusual.
std::vector<DocumentCase> cases() {
  std::vector<DocumentCase> out;
  for (const auto& entry : fs::directory_iterator(kData / "rigs")) {
    const std::string name = entry.path().filename().string();
    if (!name.ends_with(".schema.json")) out.push_back({name, read_json(entry.path())});
  }
  const json hand = read_json(kData / "rigs/hand.json");
  const auto vary = [&](const std::string& name, const std::function<void(json&)>& change) {
    test::vary(out, hand, name, change);
  };
  const auto joint = [](json& d, int i) -> json& { return d["joints"][i]; };
  vary("no format", [&](json& d) { d.erase("format"); });
  vary("other format", [&](json& d) { d["format"] = "ikrig/2"; });
  vary("unknown key", [&](json& d) { d["colour"] = "red"; });
  vary("unknown joint key", [&](json& d) { joint(d, 0)["colour"] = "red"; });
  vary("no joints", [&](json& d) { d["joints"] = json::array(); });
  vary("nameless joint", [&](json& d) { joint(d, 1)["name"] = ""; });
  vary("joint without parent", [&](json& d) { joint(d, 1).erase("parent"); });
  vary("unknown type", [&](json& d) { joint(d, 1)["type"] = "slider"; });
  vary("short offset", [&](json& d) { joint(d, 1)["offset"] = {0, 1}; });
  vary("word for a number", [&](json& d) { joint(d, 1)["offset"] = {0, 1, "2"}; });
  vary("hinge with two axes", [&](json& d) { joint(d, 2)["axes"] = {{1, 0, 0}, {0, 1, 0}}; });
  vary("hinge without axes", [&](json& d) { joint(d, 2).erase("axes"); });
  vary("hinge with twist_swing",
       [&](json& d) { joint(d, 2)["twist_swing"] = joint(d, 0)["twist_swing"]; });
  vary("twist_swing without twist", [&](json& d) { joint(d, 0)["twist_swing"].erase("twist"); });
  vary("capsule without radius", [&](json& d) { joint(d, 0)["capsules"][0].erase("radius"); });
  vary("flat capsule", [&](json& d) { joint(d, 0)["capsules"][0]["radius"] = 0; });
  vary("unknown effector kind", [&](json& d) { d["effectors"][0]["kind"] = "magnet"; });
  vary("negative weight", [&](json& d) { d["effectors"][0]["weight_pos"] = -1; });
  vary("line without axis", [&](json& d) { d["effectors"][0]["kind"] = "line"; });
  vary("gaze without axis", [&](json& d) { d["effectors"][0]["kind"] = "gaze"; });
  vary("unlimited hinge", [&](json& d) { joint(d, 2).erase("limits"); });
  vary("single capsule", [&](json& d) {
    joint(d, 2)["capsule"] = joint(d, 2)["capsules"][0];
    joint(d, 2).erase("capsules");
  });
  vary("a coupling", [&](json& d) {
    d["couplings"] = {{{"from_joint", 5}, {"to_joint", 6}, {"ratio", 0.6}}};
  });
  return out;
}

TEST(RigSchema, AndParserAgree) {
  const char* modules = std::getenv("LIMBER_NODE_MODULES");
  if (!modules) GTEST_SKIP() << "npm packages not installed (LIMBER_NODE_MODULES)";
  expect_schema_and_parser_agree(
      kData / "rigs/ikrig.schema.json", cases(),
      [](const DocumentCase& c) { return read_rig_json(c.document.dump()); }, 15);
}

}  // namespace
}  // namespace limber::test
