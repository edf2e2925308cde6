// Gates: what they say of a report is arithmetic on its figures, and the exit code tells a missed
// gate from a clip that failed.
#include "pipeline/gates.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <nlohmann/json.hpp>
#include <pugixml.hpp>

#include "pipeline/junit.h"
#include "tests/pipeline/program.h"

namespace {

using limber::GateLevel;
using limber_test::Folder;
using limber_test::limber;
using limber_test::own_clip;
using limber_test::text_of;
using limber_test::write_text;
using nlohmann::json;

constexpr const char* kReport = R"({
  "smoothness": {"pops": 3},
  "certificate": {"ok": false},
  "map": {"confidence": 0.7},
  "effectors": [{"name": "leftHand", "error": {"p95": 4.0}}, {"name": "head", "error": {"p95": 9.0}},
                {"name": "pelvis"}]})";

limber::GateVerdict judge(const limber::Gate& gate) {
  return limber::judge_gates({.description = "", .gates = {gate}}, kReport).front();
}

TEST(Gates, LevelsThemselvesPass) {
  const auto level = [](double warn, double fail) {
    return judge({.figure = "smoothness/pops", .warn = warn, .fail = fail}).level;
  };
  EXPECT_EQ(level(3, 4), GateLevel::pass);
  EXPECT_EQ(level(2, 3), GateLevel::warn);
  EXPECT_EQ(level(1, 2), GateLevel::fail);
}

TEST(Gates, AtLeastTurnsThemRound) {
  const auto level = [](double warn, double fail) {
    return judge({.figure = "map/confidence", .warn = warn, .fail = fail, .at_least = true}).level;
  };
  EXPECT_EQ(level(0.7, 0.5), GateLevel::pass);
  EXPECT_EQ(level(0.8, 0.7), GateLevel::warn);
  EXPECT_EQ(level(0.9, 0.8), GateLevel::fail);
}

TEST(Gates, TheWorstOfAllElementsCounts) {
  const auto all = judge({.figure = "effectors/*/error/p95", .fail = 5.0});
  EXPECT_EQ(all.level, GateLevel::fail);
  EXPECT_EQ(all.figure, "effectors/head/error/p95");
  EXPECT_EQ(all.value, 9.0);
  EXPECT_EQ(judge({.figure = "effectors/leftHand/error/p95", .fail = 5.0}).level, GateLevel::pass);
  EXPECT_EQ(judge({.figure = "effectors/1/error/p95", .fail = 5.0}).level, GateLevel::fail);
  const auto least = judge({.figure = "effectors/*/error/p95", .fail = 5.0, .at_least = true});
  EXPECT_EQ(least.figure, "effectors/leftHand/error/p95");
}

TEST(Gates, WhatWasNotMeasuredPassesUnlessRequired) {
  limber::Gate gate{.figure = "refine/gap_percent/p95", .fail = 5.0};
  EXPECT_EQ(judge(gate).level, GateLevel::pass);
  EXPECT_FALSE(judge(gate).value.has_value());
  gate.required = true;
  EXPECT_EQ(judge(gate).level, GateLevel::fail);
}

TEST(Gates, TruthIsOne) {
  const limber::Gate gate{.figure = "certificate/ok", .fail = 1.0, .at_least = true};
  EXPECT_EQ(judge(gate).level, GateLevel::fail);
}

std::string body() { return own_clip("body_range_of_motion.bvh").string(); }

std::string gates_file(const Folder& folder, const json& gates) {
  const auto path = folder / "gates.json";
  write_text(path, json{{"format", "limber/gates/1"}, {"gates", gates}}.dump());
  return path.string();
}

TEST(Gates, AMissedOneAloneExitsWithFour) {
  const Folder folder;
  const auto run = [&](const std::vector<std::string>& sources, double fail) {
    std::vector<std::string> arguments{"retarget"};
    arguments.insert(arguments.end(), sources.begin(), sources.end());
    const std::string gates =
        gates_file(folder, {{{"figure", "solver/tree_passes"}, {"fail", fail}}});
    for (const std::string& a :
         {std::string("--target"), std::string("biped-full"), std::string("-o"),
          (folder / "out").string(), std::string("--refine"), std::string("none"),
          std::string("--gates"), gates, std::string("--junit"), (folder / "j.xml").string()}) {
      arguments.push_back(a);
    }
    return limber(arguments).exit_code;
  };
  const auto report = [&] {
    return json::parse(text_of(folder / "out/body_range_of_motion@biped-full.report.json"));
  };
  EXPECT_EQ(run({body()}, 1e12), 0);
  EXPECT_EQ(report()["status"], "pass");
  EXPECT_EQ(report()["gates"][0]["level"], "pass");
  EXPECT_EQ(run({body()}, 0), 4);
  EXPECT_EQ(report()["status"], "fail");
  EXPECT_EQ(report()["errors"][0]["code"], "gate-missed");
  EXPECT_EQ(report()["gates"][0]["value"], report()["solver"]["tree_passes"]);
  EXPECT_TRUE(std::filesystem::exists(folder / "out/body_range_of_motion@biped-full.glb"));
  pugi::xml_document junit;
  ASSERT_TRUE(junit.load_file((folder / "j.xml").c_str()));
  EXPECT_STREQ(junit.select_node("//testsuite/testcase/failure/@type").attribute().value(),
               "gate-missed");
  write_text(folder / "broken.bvh", "HIERARCHY\nROOT Hips\n{\n");
  EXPECT_EQ(run({(folder / "broken.bvh").string(), body()}, 0), 1);
  ASSERT_TRUE(junit.load_file((folder / "j.xml").c_str()));
  EXPECT_EQ(junit.select_nodes("//testcase").size(), 2U);
  EXPECT_STREQ(junit.select_node("//testsuite/@failures").attribute().value(), "2");
}

TEST(Gates, AFileThatIsNoneIsAUsageError) {
  const Folder folder;
  write_text(folder / "gates.json", "{}");
  for (const std::string& gates : {(folder / "gates.json").string(), std::string("no-such-file")}) {
    EXPECT_EQ(limber({"retarget", body(), "--target", "biped-full", "-o", folder.string(),
                      "--gates", gates})
                  .exit_code,
              2);
  }
}

TEST(Gates, ValidateKeepsThemToo) {
  const Folder folder;
  ASSERT_EQ(limber({"retarget", body(), "--target", "biped-full", "-o", folder.string(), "--gates",
                    "default"})
                .exit_code,
            0);
  const std::string glb = (folder / "body_range_of_motion@biped-full.glb").string();
  const auto validate = [&](const std::string& gates) {
    return limber({"validate", glb, "--source", body(), "--gates", gates}).exit_code;
  };
  EXPECT_EQ(validate("default"), 0);
  EXPECT_EQ(validate(gates_file(folder, {{{"figure", "frames"}, {"fail", 1}}})), 4);
}

TEST(Junit, HoldsAnyName) {
  const std::string hostile = "a<b>&\"'\x1b[31m\xE2\x80\xAE]]>\n";
  const limber::ClipSummary clip{.source = hostile,
                                 .clip = "",
                                 .stem = hostile,
                                 .status = limber::Status::fail,
                                 .code = "x",
                                 .message = hostile};
  pugi::xml_document document;
  ASSERT_TRUE(document.load_string(limber::junit_xml({clip}, hostile).c_str()));
  std::string expected = hostile;
  expected.replace(expected.find('\x1b'), 1, "\xEF\xBF\xBD");
  EXPECT_EQ(document.select_node("//failure/@message").attribute().value(), expected);
}

}  // namespace
