// limber pose: what it refuses, with a stable code, the place and the way out.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/pipeline/program.h"

namespace {

using limber_test::Folder;
using limber_test::limber;
using limber_test::text_of;
using limber_test::write_text;
using nlohmann::json;

/// Runs with targets that must be refused; returns the error.
json refusal(const std::string& rig, const std::string& text) {
  const Folder folder;
  write_text(folder / "targets.json", text);
  const auto run = limber({"pose", rig, "--targets", (folder / "targets.json").string(), "--json"});
  EXPECT_EQ(run.exit_code, 2) << text;
  const json out = json::parse(run.out, nullptr, false);
  if (!out.is_object() || !out.contains("error")) {
    ADD_FAILURE() << text << "\n" << run.out;
    return json::object({{"code", ""}, {"message", ""}, {"hint", ""}});
  }
  EXPECT_FALSE(out["error"]["hint"].get<std::string>().empty()) << text;
  EXPECT_NE(out["error"]["file"].get<std::string>().find("targets.json"), std::string::npos);
  return out["error"];
}

TEST(PoseErrors, NameThePlaceAndTheWayOut) {
  struct Case {
    const char *row, *code, *place;
  };
  for (const Case& c : {
           Case{R"({"effector": "tail", "offset": [0,0,0]})", "targets-effector",
                "/poses/0/targets/0/effector"},
           Case{R"({"offset": [0,0,0]})", "targets-json", "/poses/0/targets/0"},
           Case{R"({"effector": "index_tip"})", "targets-json", "/poses/0/targets/0"},
           Case{R"({"effector": "index_tip", "offset": [0,0]})", "targets-json",
                "/poses/0/targets/0/offset"},
           Case{R"({"effector": "index_tip", "offset": [0,NaN,0]})", "targets-json", "line 1"},
           Case{R"({"effector": "index_tip", "offset": [0,1e999,0]})", "targets-json", "too large"},
           Case{R"({"effector": "index_tip", "offset": [0,null,0]})", "targets-json",
                "/poses/0/targets/0/offset/1"},
           Case{R"({"effector": "index_tip", "position": [0,2e6,0]})", "targets-json",
                "/poses/0/targets/0/position"},
           Case{R"({"effector": "index_tip", "offset": [0,0,0], "position": [0,0,0]})",
                "targets-json", "'position' and 'offset'"},
           Case{R"({"effector": "index_tip", "rotation": [1,0,0,0], "turn_deg": [0,0,0]})",
                "targets-json", "'rotation' and 'turn_deg'"},
           Case{R"({"effector": "index_tip", "rotation": [1,0.2,0,0]})", "targets-json",
                "/poses/0/targets/0/rotation"},
           Case{R"({"effector": "index_tip", "rotation": [0,0,0,0]})", "targets-json",
                "/poses/0/targets/0/rotation"},
           Case{R"({"effector": "index_tip", "turn_deg": [300,300,0]})", "targets-json",
                "/poses/0/targets/0/turn_deg"},
           Case{R"({"effector": "index_tip", "offset": [0,0,0], "weight": -1})", "targets-json",
                "/poses/0/targets/0/weight"},
           Case{R"({"effector": "index_tip", "offset": [0,0,0], "colour": 1})", "targets-json",
                "colour"},
           Case{R"({"effector": "index_tip", "offset": [0,0,0]},
                   {"effector": "index_tip", "offset": [0,0,1]})",
                "targets-json", "/poses/0/targets/1"},
       }) {
    const json error = refusal(
        "hand",
        std::string(R"({"format": "limber/targets/1", "poses": [{"name": "p", "targets": [)") +
            c.row + "]}]}");
    EXPECT_EQ(error["code"], c.code) << c.row;
    EXPECT_NE(error["message"].get<std::string>().find(c.place), std::string::npos)
        << c.row << "\n"
        << error["message"];
  }
}

TEST(PoseErrors, OfTheFileAsAWhole) {
  const json row = {{"effector", "index_tip"}, {"offset", {0, 0, 0}}};
  const json pose = {{"name", "p"}, {"targets", json::array({row})}};
  const json good = {{"format", "limber/targets/1"}, {"poses", json::array({pose})}};
  const auto with = [&](const json::json_pointer& place, const json& value) {
    json changed = good;
    changed[place] = value;
    return changed.dump();
  };
  using Pointer = json::json_pointer;
  EXPECT_EQ(refusal("hand", "{")["code"], "targets-json");
  EXPECT_EQ(refusal("hand", "[]")["code"], "targets-json");
  EXPECT_EQ(refusal("hand", with(Pointer("/format"), "limber/targets/2"))["code"], "targets-json");
  EXPECT_EQ(refusal("hand", with(Pointer("/poses"), json::array()))["code"], "targets-json");
  EXPECT_EQ(refusal("hand", with(Pointer("/poses"), json(65, good["poses"][0])))["code"],
            "targets-json");
  EXPECT_EQ(refusal("hand", with(Pointer("/poses/0/name"), ""))["code"], "targets-json");
  EXPECT_EQ(refusal("hand", with(Pointer("/poses/0/start"), "now"))["code"], "targets-json");
  EXPECT_EQ(refusal("hand", with(Pointer("/poses/0/targets"), json::array()))["code"],
            "targets-json");
  EXPECT_EQ(refusal("hand", with(Pointer("/hold"), {"tail"}))["code"], "targets-effector");
  EXPECT_EQ(refusal("hand", with(Pointer("/poses/0/posture"), {{"tail", {1}}}))["code"],
            "targets-joint");
  EXPECT_EQ(refusal("hand", with(Pointer("/poses/0/posture"), {{"rightHand", {1}}}))["code"],
            "targets-json");
  // A position effector follows no rotation.
  json arm = good;
  arm["poses"][0]["targets"][0] = {{"effector", "hand"}, {"rotation", {1, 0, 0, 0}}};
  EXPECT_EQ(refusal("arm2", arm.dump())["code"], "targets-json");
}

TEST(PoseErrors, OfTheCommandLine) {
  const Folder folder;
  EXPECT_EQ(limber({"pose", "hand"}).exit_code, 2);
  EXPECT_EQ(limber({"pose", "no-such-rig", "--example"}).exit_code, 2);
  EXPECT_EQ(limber({"pose", "hand", "--targets", (folder / "none.json").string()}).exit_code, 2);
  EXPECT_EQ(limber({"pose", "hand", "--targets", "hand-poses", "--solver", "fast"}).exit_code, 2);
  EXPECT_EQ(limber({"pose", "hand", "--targets", "hand-poses", "--example"}).exit_code, 2);
  write_text(folder / "file", "no folder");
  const std::string sheet = (folder / "file/sheet.png").string();
  EXPECT_EQ(limber({"pose", "hand", "--targets", "hand-poses", "-o", sheet}).exit_code, 3);
  const auto json_error = limber({"pose", "hand", "--targets", "none", "--json"});
  const json error = json::parse(json_error.out)["error"];
  EXPECT_EQ(error["code"], "file-missing");
  EXPECT_NE(error["hint"].get<std::string>().find("hand-poses"), std::string::npos);
}

TEST(PoseErrors, ARigWithoutEffectorsOrRoles) {
  const Folder folder;
  json rig = json::parse(text_of(limber_test::source_root() / "assets/data/rigs/arm2.json"));
  rig.erase("effectors");
  for (json& joint : rig["joints"]) joint.erase("role");
  write_text(folder / "bare.json", rig.dump());
  const auto run = limber({"pose", (folder / "bare.json").string(), "--example", "--json"});
  EXPECT_EQ(run.exit_code, 2);
  EXPECT_EQ(json::parse(run.out)["error"]["code"], "rig-no-effectors");
}

}  // namespace
