// The command-line contract: exit codes, outputs, isolation of bad clips, determinism.
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "tests/pipeline/program.h"

namespace {

using limber_test::Folder;
using limber_test::limber;
using limber_test::own_clip;
using limber_test::text_of;
using limber_test::write_text;
using nlohmann::json;

std::string gestures() { return own_clip("gestures_right_hand.bvh").string(); }
std::string body() { return own_clip("body_range_of_motion.bvh").string(); }

/// Retargets one source that must be refused; returns its report.
json refused(const std::string& source, int exit_code) {
  const Folder folder;
  const auto run = limber({"retarget", source, "--target", "biped-full", "-o", folder.string()});
  EXPECT_EQ(run.exit_code, exit_code) << source;
  const std::string stem = std::filesystem::path(source).stem().string();
  const auto report = folder / (stem + "@biped-full.report.json");
  EXPECT_TRUE(std::filesystem::exists(report));
  EXPECT_FALSE(std::filesystem::exists(folder / (stem + "@biped-full.glb")));
  return json::parse(text_of(report), nullptr, false);
}

std::string tiny_bvh(const std::string& row) {
  return "HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 0\n CHANNELS 3 Zrotation Xrotation Yrotation\n"
         " End Site\n {\n  OFFSET 0 1 0\n }\n}\nMOTION\nFrames: 1\nFrame Time: 0.033333\n" +
         row + "\n";
}

TEST(Contract, MissingSourceFailsTheClip) {
  const json report = refused("/nonexistent/walk.bvh", 1);
  EXPECT_EQ(report["status"], "fail");
  EXPECT_EQ(report["errors"][0]["code"], "file-missing");
}

TEST(Contract, BvhWithNanFailsTheClip) {
  const Folder folder;
  write_text(folder / "nan.bvh", tiny_bvh("0 nan 0"));
  const json report = refused((folder / "nan.bvh").string(), 1);
  EXPECT_EQ(report["errors"][0]["code"], "bvh-nan");
  EXPECT_EQ(report["errors"][0]["joint"], "Hips");
  EXPECT_EQ(report["errors"][0]["frame"], 0);
}

TEST(Contract, TruncatedGlbFailsTheClip) {
  const Folder folder;
  ASSERT_EQ(limber({"retarget", body(), "--target", "biped-full", "-o", folder.string(), "--refine",
                    "none"})
                .exit_code,
            0);
  const std::string whole = text_of(folder / "body_range_of_motion@biped-full.glb");
  write_text(folder / "cut.glb", whole.substr(0, whole.size() / 2));
  const json report = refused((folder / "cut.glb").string(), 1);
  EXPECT_EQ(report["errors"][0]["code"], "gltf-container");
}

TEST(Contract, UnknownConventionFailsTheClipAndLeavesAMap) {
  const Folder folder;
  write_text(folder / "stick.bvh", tiny_bvh("0 0 0"));
  const auto run = limber({"retarget", (folder / "stick.bvh").string(), "--target", "biped-full",
                           "-o", (folder / "out").string()});
  EXPECT_EQ(run.exit_code, 1);
  const json report = json::parse(text_of(folder / "out/stick@biped-full.report.json"));
  EXPECT_EQ(report["errors"][0]["code"], "map-not-a-figure");
  const json map = json::parse(text_of(folder / "out/stick@biped-full.map.json"));
  EXPECT_EQ(map["format"], "limber-map/1");
  EXPECT_EQ(map["source"]["joints"][0], "Hips");
}

TEST(Contract, BadTargetsAndUsageAreTheCallersFault) {
  const Folder folder;
  const std::string out = folder.string();
  EXPECT_EQ(limber({"retarget", body(), "--target", "no-such-rig", "-o", out}).exit_code, 2);
  write_text(folder / "rig.json", "{\"format\": \"ikrig/1\", \"joints\": 7}");
  EXPECT_EQ(
      limber({"retarget", body(), "--target", (folder / "rig.json").string(), "-o", out}).exit_code,
      2);
  EXPECT_EQ(limber({"retarget", body(), "--target", "biped-full", "-o", out, "--map",
                    (folder / "none.json").string()})
                .exit_code,
            2);
  EXPECT_EQ(limber({"retarget", body(), "--target", "biped-full", "-o", out, "--limits", "maybe"})
                .exit_code,
            2);
  EXPECT_EQ(limber({"frobnicate"}).exit_code, 2);
}

TEST(Contract, OneBadClipNeverStopsTheRest) {
  const Folder folder;
  write_text(folder / "broken.bvh", "HIERARCHY\nROOT Hips\n{\n");
  const auto run =
      limber({"retarget", (folder / "broken.bvh").string(), body(), gestures(), "--target",
              "biped-full", "-o", (folder / "out").string(), "--refine", "none", "--json"});
  EXPECT_EQ(run.exit_code, 1);
  const json summary = json::parse(run.out);
  EXPECT_EQ(summary["failed"], 2);  // the broken file, and a lone hand for a body
  EXPECT_TRUE(std::filesystem::exists(folder / "out/body_range_of_motion@biped-full.glb"));
  const json hand = json::parse(text_of(folder / "out/gestures_right_hand@biped-full.report.json"));
  EXPECT_EQ(hand["errors"][0]["code"], "map-figures-differ");
}

TEST(Contract, ReportsHaveWhatTheyPromise) {
  const Folder folder;
  ASSERT_EQ(limber({"retarget", body(), "--target", "biped-full", "-o", folder.string()}).exit_code,
            0);
  const json report = json::parse(text_of(folder / "body_range_of_motion@biped-full.report.json"));
  for (const char* key : {"schema", "limber_version", "status", "errors", "warnings", "source",
                          "target", "map", "output", "solver", "effectors", "limits", "contacts",
                          "smoothness", "refine", "certificate", "timeline"}) {
    EXPECT_TRUE(report.contains(key)) << key;
  }
  EXPECT_EQ(report["limits"]["violations"], 0);
  EXPECT_EQ(report["certificate"]["ok"], true);
  EXPECT_EQ(report["certificate"]["reader"], "assimp");
  EXPECT_LT(report["certificate"]["joints_max_error_m"].get<double>(), 1e-4);
  EXPECT_EQ(report["output"]["files"].size(), 3U);
}

TEST(Contract, TimeIsToldOnceByJointAndOnceByFrame) {
  const Folder folder;
  limber({"retarget", body(), "--target", "biped-full", "-o", folder.string(), "--refine", "none"});
  const json report = json::parse(text_of(folder / "body_range_of_motion@biped-full.report.json"));
  const json& timeline = report["timeline"];
  const auto largest = [](const json& values) {
    return std::ranges::max(values.get<std::vector<double>>());
  };
  double error_mm = 0.0;
  for (const json& effector : report["effectors"]) {
    if (!effector.contains("position_error_mm")) continue;
    error_mm = std::max(error_mm, effector["position_error_mm"]["max"].get<double>());
  }
  EXPECT_NEAR(largest(timeline["error_mm"]), error_mm, 0.006);
  const json& limits = report["limits"];
  EXPECT_NEAR(largest(timeline["source_excess_deg"]), limits["source_excess_deg"], 0.006);
  ASSERT_FALSE(limits["bent"].empty());
  for (const json& joint : limits["bent"]) {
    std::int64_t sum = 0;
    for (const json& frames : joint["frames_by_excess"]) sum += frames.get<std::int64_t>();
    EXPECT_EQ(sum, joint["frames"]) << joint["joint"];
  }
  ASSERT_FALSE(limits["at_limit"].empty());
  EXPECT_LE(largest(timeline["joints_at_limit"]), double(limits["at_limit"].size()));
  EXPECT_LE(limits["at_limit"][0]["frames"], report["output"]["frames"]);
  for (const char* track : {"error_mm", "joints_at_limit", "left_contact", "right_contact"}) {
    EXPECT_EQ(timeline[track].size(), timeline["samples"]) << track;
  }
}

/// Verdicts of ajv on documents by the shipped report schema.
json schema_verdicts(const Folder& folder, const json& documents) {
  write_text(folder / "documents.json", documents.dump());
  const auto root = limber_test::source_root();
  const std::string command = "node '" + (root / "tests/data/schema_verdicts.mjs").string() +
                              "' '" + (root / "assets/data/schemas/report.schema.json").string() +
                              "' '" + (folder / "documents.json").string() + "' '" +
                              (folder / "verdicts.json").string() + "'";
  if (std::system(command.c_str()) != 0) return {};
  return json::parse(text_of(folder / "verdicts.json"));
}

TEST(Contract, ReportsFollowTheirSchema) {
  if (std::getenv("LIMBER_NODE_MODULES") == nullptr) {
    GTEST_SKIP() << "npm packages not installed (LIMBER_NODE_MODULES)";
  }
  const Folder folder;
  write_text(folder / "broken.bvh", "HIERARCHY\nROOT Hips\n{\n");
  limber({"retarget", (folder / "broken.bvh").string(), body(), gestures(), "--target",
          "biped-hands", "-o", (folder / "out").string()});
  limber({"retarget", gestures(), "--target", "hand", "-o", (folder / "out").string(), "--limits",
          "off", "--refine", "none", "--gates", "default"});
  json documents = json::array();
  for (const auto& entry : std::filesystem::directory_iterator(folder / "out")) {
    const std::string name = entry.path().string();
    if (name.ends_with(".report.json")) documents.push_back(json::parse(text_of(name)));
  }
  ASSERT_EQ(documents.size(), 4U);
  const std::size_t good = documents.size();
  json wrong = documents[0];
  wrong["status"] = "perhaps";
  documents.push_back(wrong);
  wrong = documents[0];
  wrong["surprise"] = 1;
  documents.push_back(wrong);
  const json verdicts = schema_verdicts(folder, documents);
  ASSERT_EQ(verdicts.size(), documents.size());
  for (std::size_t i = 0; i < documents.size(); ++i) {
    EXPECT_EQ(verdicts[i]["valid"], i < good) << verdicts[i]["errors"];
  }
}

TEST(Contract, SameInputSameBytesAtAnyProcessCount) {
  const Folder folder;
  for (const char* n : {"1", "2"}) {
    ASSERT_EQ(
        limber({"retarget", body(), "--target", "biped-full", "-o", (folder / n).string(), "-j", n})
            .exit_code,
        0);
  }
  for (const char* suffix : {".glb", ".bvh", ".png", ".report.json"}) {
    const std::string name = std::string("body_range_of_motion@biped-full") + suffix;
    EXPECT_TRUE(text_of(folder / ("1/" + name)) == text_of(folder / ("2/" + name))) << suffix;
  }
}

TEST(Contract, MapsCanBeEditedAndReused) {
  const Folder folder;
  const std::string map = (folder / "m.json").string();
  ASSERT_EQ(limber({"map", body(), "biped-full", "-o", map}).exit_code, 0);
  json edited = json::parse(text_of(map));
  edited["source"]["roles"]["leftToes"] = "";
  write_text(map, edited.dump());
  ASSERT_EQ(limber({"retarget", body(), "--target", "biped-full", "-o", folder.string(), "--map",
                    map, "--refine", "none"})
                .exit_code,
            0);
  edited["source"]["roles"]["leftToes"] = "no such joint";
  write_text(map, edited.dump());
  EXPECT_EQ(
      limber({"retarget", body(), "--target", "biped-full", "-o", folder.string(), "--map", map})
          .exit_code,
      1);
}

TEST(Contract, ValidateAcceptsOurOutputAndCatchesAnotherClip) {
  const Folder folder;
  ASSERT_EQ(limber({"retarget", body(), "--target", "biped-full", "-o", folder.string(), "--refine",
                    "none"})
                .exit_code,
            0);
  const std::string glb = (folder / "body_range_of_motion@biped-full.glb").string();
  EXPECT_EQ(limber({"validate", glb, "--source", body(), "--rig", "biped-full"}).exit_code, 0);
  if (const auto other = limber_test::cmu_clip("01_03.bvh"); !other.empty()) {
    EXPECT_EQ(limber({"validate", glb, "--source", other.string()}).exit_code, 1);
  }
}

}  // namespace
