// `limber batch` itself on real clips: the job's file, exit codes, events, the same bytes for any
// number of processes and shards, and a kill.
#include <gtest/gtest.h>

#include <cstring>
#include <nlohmann/json.hpp>
#include <pugixml.hpp>
#include <set>

#include "tests/pipeline/batch_ground.h"

namespace {

using limber_test::BatchGround;
using limber_test::limber;
using limber_test::own_clip;
using limber_test::text_of;
using limber_test::write_text;
using nlohmann::json;
namespace fs = std::filesystem;

constexpr const char* kQuick =
    R"("targets": ["biped-full", "hand"], "options": {"refine": "none", "range": "0:3"})";

/// A body, a hand and a broken file, each in a folder; a body is no hand and the other way round.
class Ground : public BatchGround {
 public:
  Ground() : BatchGround(LIMBER_PROGRAM) {
    set_leading({"batch"});
    put({{"broken.bvh", "HIERARCHY\nROOT Hips\n{\n"}});
    for (const char* name : {"body_range_of_motion.bvh", "gestures_right_hand.bvh"}) {
      fs::create_directories(in() / "own");
      fs::copy(own_clip(name), in() / "own" / name);
    }
    write_job(kQuick);
  }
  void write_job(const std::string& rest) const {
    write_text(job(), R"({"sources": ["in/**/*.bvh"], "output": "out", )" + rest + "}");
  }
};

TEST(BatchProgram, ListsExactlyWhatItWillWrite) {
  const Ground ground;
  EXPECT_EQ(ground.run({"--dry-run", "--json"}), 0);
  EXPECT_FALSE(fs::exists(ground.out()));
  std::set<std::string> planned;
  std::istringstream in(ground.log());
  for (std::string line; std::getline(in, line);) {
    if (!line.starts_with("{")) continue;
    const json event = json::parse(line);
    for (const std::string path : event["outputs"]) planned.insert(path);
  }
  EXPECT_EQ(planned.size(), 3U * 2U * 4U);
  EXPECT_EQ(ground.run(), 1);
  const auto tree = ground.tree();
  EXPECT_TRUE(tree.contains("own/body_range_of_motion@biped-full.png"));
  EXPECT_TRUE(tree.contains("own/gestures_right_hand@hand.glb"));
  EXPECT_TRUE(tree.contains("broken@hand.report.json"));
  for (const auto& [name, content] : tree) EXPECT_TRUE(planned.contains("out/" + name)) << name;
}

TEST(BatchProgram, TheSameBytesForAnyProcessesShardsAndPlace) {
  const Ground ground;
  ASSERT_EQ(ground.run({"-j", "1"}), 1);
  const auto whole = ground.tree();
  const Ground other;  // another folder
  for (const char* shard : {"3/3", "1/3", "2/3"}) {
    const int code = other.run({"-j", "2", "--shard", shard});
    EXPECT_TRUE(code == 0 || code == 1) << shard;
  }
  EXPECT_EQ(other.tree(), whole);
  EXPECT_EQ(other.run({"--resume", "--json"}), 1);
  const std::string log = other.log();
  EXPECT_EQ(log.find("\"event\":\"item\""), std::string::npos) << log;
  const json end = json::parse(log.substr(log.find("{\"event\":\"end\"")));
  EXPECT_EQ(end["items"], 6);
  EXPECT_EQ(end["finished_before"], 6);
  EXPECT_EQ(end["exit_code"], 1);
  // What `limber retarget` makes of a clip is what a batch makes of it.
  const limber_test::Folder alone;
  const fs::path before = fs::current_path();
  fs::current_path(ground.in().parent_path());
  EXPECT_EQ(limber({"retarget", "in/own/body_range_of_motion.bvh", "--target", "biped-full",
                    "--refine", "none", "--range", "0:3", "-o", alone.string()})
                .exit_code,
            0);
  fs::current_path(before);
  for (const auto& [name, content] : BatchGround::tree_of(alone.string())) {
    EXPECT_EQ(content, whole.at("own/" + name)) << name;
  }
}

/// A short clip of a body as a GLB of ours.
fs::path make_glb(const limber_test::Folder& folder) {
  EXPECT_EQ(
      limber({"retarget", own_clip("body_range_of_motion.bvh").string(), "--target", "biped-full",
              "--refine", "none", "--range", "0:3", "--formats", "glb", "-o", folder.string()})
          .exit_code,
      0);
  return folder / "body_range_of_motion@biped-full.glb";
}

TEST(BatchProgram, FilesThatASourceRefersToAreInputs) {
  const limber_test::Folder made;
  // The GLB's two chunks as a .gltf and its buffer beside it (glTF 2.0, section 4.4).
  const std::string glb = text_of(make_glb(made));
  std::uint32_t json_bytes = 0;
  std::memcpy(&json_bytes, glb.data() + 12, 4);
  json document = json::parse(glb.substr(20, json_bytes));
  document["buffers"][0]["uri"] = "walk.bin";
  const Ground ground;
  fs::remove_all(ground.in());
  fs::create_directories(ground.in());
  write_text(ground.in() / "walk.gltf", document.dump());
  write_text(ground.job(), R"({"sources": ["in/walk.gltf"], "output": "out", "targets":)"
                           R"(["biped-full"], "options": {"refine": "none"}})");
  EXPECT_EQ(ground.run(), 1) << "the buffer is missing";
  EXPECT_EQ(ground.run({"--resume"}), 1);
  EXPECT_EQ(ground.log().find("[1/1]"), std::string::npos) << "nothing has changed";
  write_text(ground.in() / "walk.bin", glb.substr(20 + json_bytes + 8));
  EXPECT_EQ(ground.run({"--resume"}), 0) << ground.log();
  EXPECT_TRUE(ground.tree().contains("walk@biped-full.glb"));
}

TEST(BatchProgram, FaultsOfTheCallerEndItBeforeWork) {
  const Ground ground;
  const auto refused = [&](const std::string& rest, const std::string& words) {
    ground.write_job(rest);
    const int code = ground.run({"--json"});
    EXPECT_NE(ground.log().find(words), std::string::npos) << ground.log();
    EXPECT_TRUE(ground.tree().empty());
    return code;
  };
  EXPECT_EQ(refused(R"("targets": ["no-such-rig"])", "file-missing"), 2);
  EXPECT_EQ(
      refused(R"("targets": ["hand"], "options": {"refine": "perhaps"})", "at /options/refine"), 2);
  EXPECT_EQ(refused(R"("targets": ["hand"], "options": {"colour": 3})", "at /options/colour"), 2);
  EXPECT_EQ(refused(R"("targets": ["hand", "hand"])", "output-collision"), 2);
  EXPECT_EQ(refused(R"("targets": "hand")", "at /targets"), 2);
  ground.write_job(kQuick);
  EXPECT_EQ(ground.run({"--shard", "4/3"}), 2);
  ground.clear();
  write_text(ground.out(), "a file where the folder should be");
  EXPECT_EQ(ground.run(), 3);
}

/// The animations of a GLB that limber wrote, each once more under the name "again", so that it
/// holds several clips.
void repeat_clips(const fs::path& from, const fs::path& to) {
  const std::string glb = text_of(from);
  std::uint32_t json_bytes = 0;
  std::memcpy(&json_bytes, glb.data() + 12, 4);
  json document = json::parse(glb.substr(20, json_bytes));
  json again = document["animations"][0];
  again["name"] = "again";
  document["animations"].push_back(again);
  std::string text = document.dump();
  text.resize((text.size() + 3) / 4 * 4, ' ');
  std::string out = glb.substr(0, 20) + text + glb.substr(20 + json_bytes);
  const auto whole = static_cast<std::uint32_t>(out.size());
  const auto part = static_cast<std::uint32_t>(text.size());
  std::memcpy(out.data() + 8, &whole, 4);
  std::memcpy(out.data() + 12, &part, 4);
  write_text(to, out);
}

TEST(BatchProgram, AClipOfSeveralComesOutAsIfItWereAlone) {
  const limber_test::Folder made;
  const Ground ground;
  fs::remove_all(ground.in());
  fs::create_directories(ground.in());
  repeat_clips(make_glb(made), ground.in() / "two.glb");
  const auto tree_with = [&](const std::string& options) {
    ground.clear();
    write_text(ground.job(), R"({"sources": ["in/two.glb"], "output": "out", "targets":)"
                             R"(["biped-full"], "options": {"refine": "none")" +
                                 options + "}}");
    EXPECT_EQ(ground.run(), 0) << ground.log();
    return ground.tree();
  };
  const auto alone = tree_with(R"(, "clip": "again")");
  EXPECT_EQ(alone.size(), 4U);
  const auto both = tree_with("");
  EXPECT_EQ(both.size(), 8U);
  for (const auto& [name, content] : alone) EXPECT_EQ(both.at(name), content) << name;
}

TEST(BatchProgram, TellsVerdictsOfAllRunsAsJUnit) {
  const Ground ground;
  const fs::path verdicts = ground.in().parent_path() / "verdicts.xml";
  ASSERT_EQ(ground.run({"--junit", verdicts.string()}), 1);
  const std::string first = text_of(verdicts);
  pugi::xml_document document;
  ASSERT_TRUE(document.load_string(first.c_str()));
  const auto suite = document.child("testsuites").child("testsuite");
  EXPECT_EQ(suite.attribute("tests").as_int(), 6);
  const auto failures = suite.select_nodes("testcase/failure").size();
  EXPECT_EQ(suite.attribute("failures").as_ullong(), failures);
  EXPECT_GT(failures, 0U);
  EXPECT_TRUE(suite.find_child_by_attribute("testcase", "name", "own/gestures_right_hand@hand"));
  EXPECT_STREQ(suite.find_child_by_attribute("testcase", "name", "broken@hand")
                   .child("failure")
                   .attribute("type")
                   .value(),
               "bvh-syntax");
  ASSERT_EQ(ground.run({"--resume", "-j", "2", "--junit", verdicts.string()}), 1);
  EXPECT_EQ(text_of(verdicts), first);
}

TEST(BatchProgram, AClipThatOnlyAGateFailsIsToldApart) {
  Ground ground;
  fs::remove(ground.in() / "broken.bvh");
  fs::remove(ground.in() / "own/gestures_right_hand.bvh");
  const fs::path gates = ground.job().parent_path() / "gates.json";
  const auto write_gates = [&](const char* limit) {
    write_text(gates, std::string(R"({"format": "limber/gates/1", "gates": )") +
                          R"([{"figure": "target/joints", "fail": )" + limit + "}]}");
  };
  ground.write_job(R"("targets": ["biped-full"], "gates": "gates.json",)"
                   R"("options": {"refine": "none", "range": "0:3"})");
  write_gates("3");
  EXPECT_EQ(ground.run(), 4) << ground.log();
  write_gates("300");
  EXPECT_EQ(ground.run({"--resume"}), 0) << "other gates are other work\n" << ground.log();
  EXPECT_EQ(ground.run({"--resume"}), 0);
  EXPECT_EQ(ground.log().find("[1/1]"), std::string::npos) << "nothing has changed";
}

TEST(BatchProgram, KilledItResumes) {
#if defined(__SANITIZE_ADDRESS__)
  GTEST_SKIP() << "the sanitizer wants to be preloaded first";
#endif
  Ground ground;
  // In the jail no clip's process can kill its parent.
  ground.write_job(R"("targets": ["biped-full", "hand"],)"
                   R"("options": {"refine": "none", "range": "0:3", "sandbox": "off"})");
  ASSERT_EQ(ground.run({"-j", "1"}, ground.with_fault("count")), 1);
  const auto whole = ground.tree();
  const long calls = ground.counted();
  ASSERT_GT(calls, 60);
  for (long n = 7; n <= calls; n += calls / 5) {
    ground.clear();
    ASSERT_EQ(ground.run({"-j", "1"}, ground.with_fault("kill:" + std::to_string(n))), -SIGKILL);
    for (const auto& [name, content] : ground.tree()) EXPECT_EQ(content, whole.at(name)) << name;
    const auto finished = ground.reports();
    EXPECT_EQ(ground.run({"--resume", "-j", "2"}), 1);
    EXPECT_EQ(ground.tree(), whole) << n;
    const auto now = ground.reports();
    for (const auto& [name, identity] : finished) EXPECT_EQ(now.at(name), identity) << name;
  }
}

TEST(BatchProgram, JobsFollowTheirSchema) {
  if (std::getenv("LIMBER_NODE_MODULES") == nullptr) {
    GTEST_SKIP() << "npm packages not installed (LIMBER_NODE_MODULES)";
  }
  const json good = json::parse(R"([
    {"sources": ["a"], "targets": ["t"], "output": "o"},
    {"$schema": "s", "sources": ["@l", "**/*.bvh"], "targets": [{"path": "t", "map": "m"}, "u"],
     "output": "o", "map": "m", "gates": "default", "caps": {"wall_s": 9},
     "options": {"rate": 30, "formats": ["glb"], "limits": "off", "reference": "frame:3"}}])");
  const json bad = json::parse(R"([
    {"sources": [], "targets": ["t"], "output": "o"},
    {"sources": ["a"], "targets": ["t"]},
    {"sources": ["a"], "targets": ["t"], "output": "o", "colour": 1},
    {"sources": ["a"], "targets": ["t"], "output": "o", "options": {"refine": "perhaps"}},
    {"sources": ["a"], "targets": ["t"], "output": "o", "caps": {"cpu_s": 0}}])");
  const limber_test::Folder folder;
  json documents = good;
  documents.insert(documents.end(), bad.begin(), bad.end());
  write_text(folder / "documents.json", documents.dump());
  const auto root = limber_test::source_root();
  const std::string command = "node '" + (root / "tests/data/schema_verdicts.mjs").string() +
                              "' '" + (root / "assets/data/schemas/job.schema.json").string() +
                              "' '" + (folder / "documents.json").string() + "' '" +
                              (folder / "verdicts.json").string() + "'";
  ASSERT_EQ(std::system(command.c_str()), 0);
  const json verdicts = json::parse(text_of(folder / "verdicts.json"));
  const Ground ground;
  for (std::size_t i = 0; i < documents.size(); ++i) {
    EXPECT_EQ(verdicts[i]["valid"], i < good.size()) << verdicts[i]["errors"];
    if (i < good.size()) continue;
    write_text(ground.job(), documents[i].dump());  // the program refuses what the schema refuses
    EXPECT_EQ(ground.run(), 2) << documents[i];
  }
}

}  // namespace
