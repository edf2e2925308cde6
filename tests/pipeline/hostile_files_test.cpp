// Files that refer to what is none of their business: no byte of it may show in any output.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "tests/pipeline/program.h"

namespace {

using limber_test::Folder;
using limber_test::limber;
using limber_test::own_clip;
using limber_test::text_of;
using limber_test::write_text;
using nlohmann::json;
namespace fs = std::filesystem;

const std::string kCanary = "CANARY-7f3a91-do-not-read";

std::string base64(const std::string& bytes) {
  static const char* digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t bits = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      bits = bits << 8 | (i + k < bytes.size() ? std::uint8_t(bytes[i + k]) : 0U);
    }
    for (std::size_t k = 0; k < 4; ++k) {
      out += i + k > bytes.size() ? '=' : digits[bits >> (18 - 6 * k) & 63];
    }
  }
  return out;
}

/// A folder "in" with the hostile file, and beside it what the file must not see.
class Hostile : public testing::Test {
 protected:
  void SetUp() override {
    fs::create_directory(root_ / "in");
    write_text(root_ / "canary.bin", canary_);
    fs::create_symlink(root_ / "canary.bin", root_ / "in/link.bin");
    fs::create_symlink("..", root_ / "in/up");
    ASSERT_EQ(::mkfifo((root_ / "in/pipe.bin").c_str(), 0600), 0);
  }

  /// Twelve ways to name a file outside, and some that are no file.
  std::vector<std::string> hostile_uris() const {
    const std::string outside = (root_ / "canary.bin").string();
    std::string encoded = outside;
    for (std::size_t at = 0; (at = encoded.find('/', at)) != std::string::npos;) {
      encoded.replace(at, 1, "%2F");
    }
    return {outside,
            "file://" + outside,
            "FILE:" + outside,
            "file:../canary.bin",
            "//localhost" + outside,
            encoded,
            "../canary.bin",
            "./../canary.bin",
            "%2e%2e/canary.bin",
            "..\\canary.bin",
            "link.bin",
            "up/canary.bin",
            "http://127.0.0.1:1/canary.bin",
            "/proc/self/environ",
            "/dev/zero",
            "pipe.bin"};
  }

  /// Nothing that the program said or wrote holds the canary, plain or in base64 at any phase.
  void expect_no_canary(const std::string& text, const std::string& where) const {
    EXPECT_EQ(text.find(kCanary), std::string::npos) << where;
    for (std::size_t phase = 0; phase < 3; ++phase) {
      const std::string coded = base64(std::string(phase, 'x') + kCanary);
      EXPECT_EQ(text.find(coded.substr(4, coded.size() - 8)), std::string::npos) << where;
    }
  }
  void expect_no_canary(const fs::path& folder) const {
    if (!fs::exists(folder)) return;
    for (const auto& entry : fs::directory_iterator(folder)) {
      expect_no_canary(text_of(entry.path()), entry.path().string());
    }
  }

  Folder root_;
  std::string canary_ = [] {
    std::string text;
    while (text.size() < 4096) text += kCanary;
    return text;
  }();
};

/// One joint's motion, whose keys lie in an external buffer.
std::string gltf_with_buffer(const std::string& uri) {
  return json{{"asset", {{"version", "2.0"}}},
              {"buffers", {{{"uri", uri}, {"byteLength", 64}}}},
              {"bufferViews", {{{"buffer", 0}, {"byteLength", 64}}}},
              {"accessors",
               {{{"bufferView", 0}, {"componentType", 5121}, {"count", 2}, {"type", "SCALAR"}},
                {{"bufferView", 0},
                 {"componentType", 5121},
                 {"count", 2},
                 {"type", "VEC4"},
                 {"normalized", true}}}},
              {"animations",
               {{{"channels", {{{"sampler", 0}, {"target", {{"node", 0}, {"path", "rotation"}}}}}},
                 {"samplers", {{{"input", 0}, {"output", 1}}}}}}},
              {"nodes", {{{"name", "a"}}}},
              {"scenes", {{{"nodes", {0}}}}}}
      .dump();
}

TEST_F(Hostile, BuffersOutsideTheFolderAreRefused) {
  for (const std::string& uri : hostile_uris()) {
    SCOPED_TRACE(uri);
    const fs::path file = root_ / "in/hostile.gltf";
    write_text(file, gltf_with_buffer(uri));
    for (const char* reader : {"auto", "assimp"}) {
      const auto run = limber({"inspect", file.string(), "--json", "--reader", reader});
      EXPECT_EQ(run.exit_code, 1) << reader << run.out;
      const json facts = json::parse(run.out, nullptr, false);
      ASSERT_TRUE(facts.contains("error")) << reader;
      if (reader == std::string("auto")) {
        EXPECT_TRUE(facts["error"]["code"] == "uri-refused" ||
                    facts["error"]["code"] == "file-unreadable" ||
                    facts["error"]["code"] == "uri-missing")
            << facts["error"];
      }
      expect_no_canary(run.out, reader);
    }
  }
}

/// A shipped rig's figure with a clip, as a glTF whose only buffer is embedded.
json character() {
  const Folder folder;
  const auto run = limber({"retarget", own_clip("gestures_right_hand.bvh").string(), "--target",
                           "hand", "-o", folder.string(), "--refine", "none", "--formats", "glb"});
  EXPECT_EQ(run.exit_code, 0);
  const std::string glb = text_of(folder / "gestures_right_hand@hand.glb");
  std::uint32_t length = 0;
  std::memcpy(&length, glb.data() + 12, 4);
  json document = json::parse(glb.substr(20, length));
  document["buffers"][0]["uri"] =
      "data:application/octet-stream;base64," + base64(glb.substr(28 + length));
  return document;
}

TEST_F(Hostile, TexturesOfATargetStayOutside) {
  json document = character();
  ASSERT_TRUE(document.contains("meshes"));
  document["images"] = json::array();
  document["textures"] = json::array();
  for (const std::string& uri : hostile_uris()) {
    document["textures"].push_back({{"source", document["images"].size()}});
    document["images"].push_back({{"uri", uri}});
  }
  document["materials"] = json::array();
  for (std::size_t i = 0; i < document["textures"].size(); ++i) {
    document["materials"].push_back(
        {{"pbrMetallicRoughness", {{"baseColorTexture", {{"index", i}}}}}});
  }
  std::size_t next = 0;
  for (json& mesh : document["meshes"]) {
    for (json& primitive : mesh["primitives"]) {
      primitive["material"] = next++ % document["materials"].size();
    }
  }
  const fs::path target = root_ / "in/target.gltf", out = root_ / "out";
  write_text(target, document.dump());
  for (const char* reader : {"auto", "assimp"}) {
    const auto run = limber({"retarget", own_clip("gestures_right_hand.bvh").string(), "--target",
                             target.string(), "-o", out.string(), "--refine", "none", "--reader",
                             reader, "--json"});
    EXPECT_LE(run.exit_code, 2) << reader;
    expect_no_canary(run.out, reader);
    expect_no_canary(out);
  }
}

TEST_F(Hostile, ColladaEntitiesAndTexturesStayOutside) {
  for (const std::string& uri : hostile_uris()) {
    SCOPED_TRACE(uri);
    const fs::path file = root_ / "in/hostile.dae";
    write_text(file, fmt::format(R"(<?xml version="1.0"?>
<!DOCTYPE COLLADA [<!ENTITY secret SYSTEM "{0}">]>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<library_images><image id="i"><init_from>{0}</init_from></image></library_images>
<library_visual_scenes><visual_scene id="s"><node id="a" name="n&secret;" type="JOINT">
<node id="b" name="b" type="JOINT"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>)",
                                 uri));
    const auto run = limber({"inspect", file.string(), "--json"});
    EXPECT_LE(run.exit_code, 1);
    EXPECT_FALSE(json::parse(run.out, nullptr, false).is_discarded());
    expect_no_canary(run.out, uri);
  }
}

TEST_F(Hostile, PipesDevicesAndFoldersAreNoFiles) {
  ASSERT_EQ(::mkfifo((root_ / "in/clip.bvh").c_str(), 0600), 0);
  fs::create_directory(root_ / "in/folder.glb");
  fs::create_symlink("/dev/zero", root_ / "in/zero.fbx");
  for (const char* name : {"in/clip.bvh", "in/folder.glb", "in/zero.fbx"}) {
    const auto run = limber({"inspect", (root_ / name).string(), "--json"});
    EXPECT_EQ(run.exit_code, 1) << name;
    EXPECT_EQ(json::parse(run.out)["error"]["code"], "file-unreadable") << name;
  }
}

/// Every damaged file, below the folder of shared data, with what the manifest expects of it; of
/// the crashers it expects nothing but that they are survived.
std::map<std::string, std::string> damaged_files() {
  std::map<std::string, std::string> files;
  const json manifest = json::parse(text_of(limber_test::shared("malformed/manifest.json")));
  for (const json& item : manifest["items"]) files[item["file"]] = item["expect"];
  for (const auto& entry : fs::directory_iterator(limber_test::shared("malformed/crashers"))) {
    files["crashers/" + entry.path().filename().string()];
  }
  return files;
}

#define LIMBER_NEEDS_DAMAGED_FILES()            \
  if (limber_test::shared("malformed").empty()) \
  GTEST_SKIP() << "no shared data beside the sources; set LIMBER_SHARED"

/// What the programs run since have used at most: one after another, so each is held to it.
class Usage {
 public:
  double cpu_s() const { return seconds(now()) - seconds(start_); }
  static double peak_gb() { return double(now().ru_maxrss) * 1024.0 / 1e9; }

 private:
  static struct rusage now() {
    struct rusage used {};
    ::getrusage(RUSAGE_CHILDREN, &used);
    return used;
  }
  static double seconds(const struct rusage& used) {
    return double(used.ru_utime.tv_sec + used.ru_stime.tv_sec) +
           1e-6 * double(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
  }
  struct rusage start_ = now();
};

constexpr double kMost_s = 5.0, kMost_gb = 2.0;

/// Kinds of files that a run left; one that is not whole would be called otherwise.
std::set<std::string> endings_in(const Folder& folder) {
  std::set<std::string> endings;
  for (const auto& entry : fs::directory_iterator(folder.string())) {
    const std::string name = entry.path().filename();
    endings.insert(name.substr(name.ends_with(".json") ? name.find_last_of('.', name.size() - 6)
                                                       : name.find_last_of('.')));
  }
  return endings;
}

void expect_source_ends_as(const std::string& file, const std::string& expectation) {
  const Folder out;
  const Usage usage;
  const auto run = limber({"retarget", limber_test::shared("malformed/" + file).string(),
                           "--target", "biped-full", "-o", out.string(), "--refine", "none",
                           "--formats", "bvh", "--range", "0:2", "--json"});
  EXPECT_LT(usage.cpu_s(), kMost_s);
  ASSERT_TRUE(run.exit_code == 0 || run.exit_code == 1) << run.exit_code;
  const json clips = json::parse(run.out)["clips"];
  ASSERT_EQ(clips.size(), 1U);
  const json report =
      json::parse(text_of(out / (clips[0]["stem"].get<std::string>() + ".report.json")));
  EXPECT_EQ(report["status"], clips[0]["status"]);
  if (report["status"] == "fail") {
    EXPECT_FALSE(report["errors"].empty());
    std::set<std::string> left = endings_in(out);
    left.erase(".map.json");  // where it is the mapping that failed
    EXPECT_EQ(left, std::set<std::string>{".report.json"});
  } else {
    EXPECT_FALSE(expectation.starts_with("reject with")) << "must not be read";
    EXPECT_FALSE(expectation.starts_with("valid file, unsupported")) << "must not be read";
    EXPECT_FALSE(report["warnings"].empty()) << "read without a word";
    EXPECT_EQ(endings_in(out), (std::set<std::string>{".report.json", ".bvh", ".png"}));
  }
}

void expect_target_ends_well(const std::string& file) {
  const Folder out;
  const Usage usage;
  const auto run = limber({"retarget", own_clip("body_range_of_motion.bvh").string(), "--target",
                           limber_test::shared("malformed/" + file).string(), "-o", out.string(),
                           "--refine", "none", "--formats", "glb", "--range", "0:2", "--json"});
  EXPECT_LT(usage.cpu_s(), kMost_s);
  ASSERT_TRUE(run.exit_code >= 0 && run.exit_code <= 2) << run.exit_code;
  const json told = json::parse(run.out);
  if (run.exit_code == 2) {  // an unreadable target: nothing is begun
    EXPECT_FALSE(told["error"]["code"].get<std::string>().empty());
    EXPECT_FALSE(told["error"]["hint"].get<std::string>().empty());
    EXPECT_TRUE(endings_in(out).empty());
  } else {
    EXPECT_EQ(endings_in(out), (std::set<std::string>{".report.json", ".glb", ".png"}));
  }
}

TEST(Damaged, EndsAsItsManifestSays) {
  LIMBER_NEEDS_DAMAGED_FILES();
  int seen = 0;
  for (const auto& [file, expectation] : damaged_files()) {
    SCOPED_TRACE(file + ": " + expectation);
    expect_source_ends_as(file, expectation);
    ++seen;
  }
  EXPECT_GE(seen, 180);
  EXPECT_LT(Usage::peak_gb(), kMost_gb);
}

TEST(Damaged, IsRefusedOrRepairedAsATargetToo) {
  LIMBER_NEEDS_DAMAGED_FILES();
  for (const auto& [file, expectation] : damaged_files()) {
    SCOPED_TRACE(file + ": " + expectation);
    expect_target_ends_well(file);
  }
  EXPECT_LT(Usage::peak_gb(), kMost_gb);
}

/// Every damaged file as a source: one report that says why, or a clip; nothing half-written.
TEST(Damaged, EndsInAReportAndNothingElse) {
  const fs::path root = limber_test::shared("malformed");
  if (root.empty()) GTEST_SKIP() << "no shared data beside the sources";
  std::vector<std::string> arguments = {"retarget"};
  for (const char* folder : {"bvh", "crashers", "dae", "fbx", "gltf", "unsupported"}) {
    for (const auto& entry : fs::directory_iterator(root / folder)) {
      arguments.push_back(entry.path().string());
    }
  }
  const std::size_t sources = arguments.size() - 1;
  const Folder out;
  arguments.insert(arguments.end(), {"--target", "biped-full", "-o", out.string(), "--refine",
                                     "none", "--formats", "bvh", "--json"});
  const auto run = limber(arguments);
  EXPECT_EQ(run.exit_code, 1);
  const json summary = json::parse(run.out);
  std::set<std::string> reported;
  for (const json& clip : summary["clips"]) {
    const std::string stem = clip["stem"];
    reported.insert(clip["source"].get<std::string>());
    const fs::path report = out / (stem + ".report.json");
    ASSERT_TRUE(fs::exists(report)) << stem;
    const json told = json::parse(text_of(report));
    EXPECT_EQ(told["status"], clip["status"]) << stem;
    if (clip["status"] == "fail") {
      EXPECT_FALSE(told["errors"].empty()) << stem;
    }
  }
  EXPECT_EQ(reported.size(), sources);
  for (const auto& entry : fs::directory_iterator(out.string())) {
    EXPECT_FALSE(entry.path().extension() == ".tmp") << entry.path();
  }
}

}  // namespace
