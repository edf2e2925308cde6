// Real files against the facts that were measured with other tools, and damaged files.

#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "tests/importers/support.h"

namespace limber::test {
namespace {

using nlohmann::json;

std::vector<json> manifest_items(const std::filesystem::path& path) {
  std::ifstream in(path);
  return json::parse(in)["items"];
}

bool own_format(const std::string& file) {
  for (const char* end : {".bvh", ".gltf", ".glb", ".vrm"}) {
    if (file.ends_with(end)) return true;
  }
  return false;
}

/// Where we mean to differ from the manifest, and why.
const std::map<std::string, std::string> kUpDiffers = {
    {"bvh/makehuman_pose_sit01_6ch.bvh",
     "the manifest takes the zero-filled positions literally, which collapses the body; with the "
     "offsets kept the figure sits upright along +Z"}};

const std::map<std::string, std::string> kReferenceFrameUnnoticed = {
    {"bvh/cmu_daz_10_03_soccer_kick.bvh",
     "its frame 0 is as wide as high, a T-pose; the arms leave it over five frames, which the "
     "manifest takes for motion"}};

std::string wanted_up(const json& item) {
  const auto& facts = item["facts"];
  if (kUpDiffers.contains(item["file"])) return "+Z";
  return facts.value("up_axis", std::string("+Y")).substr(0, 2);
}

double wanted_unit(const std::string& units) {
  if (units.starts_with("CMU")) return 0.0254 / 0.45;
  if (units.starts_with("inch")) return 0.0254;
  if (units.starts_with("decimetres")) return 0.1;
  if (units.starts_with("cm")) return 0.01;
  if (units.starts_with("m")) return 1.0;
  return 0.0;  // the manifest does not say
}

TEST(Corpus, FactsEqualTheManifest) {
  LIMBER_NEEDS_SHARED(data);
  int seen = 0;
  for (const json& item : manifest_items(*data / "manifest.json")) {
    const std::string file = item["file"];
    if (!own_format(file)) continue;
    SCOPED_TRACE(file);
    ++seen;
    const auto imported = import_file(*data / file);
    ASSERT_TRUE(imported) << imported.error().message;
    const SourceFacts& facts = imported->facts;
    const json& truth = item["facts"];
    EXPECT_EQ(facts.joints, truth["joints"].get<std::int64_t>());
    EXPECT_EQ(facts.frames, truth["frames"].get<std::int64_t>());
    if (truth["fps"].is_number()) {
      // the manifest inverts the rounded frame time; ours is snapped
      EXPECT_NEAR(facts.rate_hz, truth["fps"].get<double>(), 1e-3 * facts.rate_hz);
    }
    EXPECT_EQ(facts.up, wanted_up(item));
    const double unit = wanted_unit(item.value("units", ""));
    if (file.ends_with(".bvh") && unit > 0.0) {
      EXPECT_NEAR(facts.unit_m, unit, 1e-9) << facts.unit_evidence;
    }
    bool reference = kReferenceFrameUnnoticed.contains(file);
    for (const json& odd : truth.value("odd", json::array())) {
      reference = reference || odd.get<std::string>().starts_with("frame 0 is a separate");
    }
    EXPECT_EQ(facts.reference_frame_dropped, reference);
    EXPECT_EQ(imported->character.skeleton.size() > 0, true);
  }
  EXPECT_GE(seen, 30);
}

/// "reject" means an error; else an error, a warning, or nothing wrong that concerns motion.
TEST(Corpus, DamagedFilesEndAsTheirManifestSays) {
  LIMBER_NEEDS_SHARED(data);
  // Loaded without a word on purpose.
  const std::map<std::string, std::string> silent = {
      {"bvh/path_traversal_name.bvh", "a joint may be called so; no file is named after a joint"}};
  int seen = 0;
  for (const json& item : manifest_items(*data / "malformed" / "manifest.json")) {
    const std::string file = item["file"];
    const std::filesystem::path path = *data / "malformed" / file;
    if (!own_format(file) || !std::filesystem::exists(path)) continue;
    SCOPED_TRACE(file + ": " + item.value("what", ""));
    ++seen;
    const auto imported = import_file(path);
    const std::string expect = item["expect"];
    if (!imported) {
      EXPECT_NE(imported.error().code, "import-internal") << imported.error().message;
      EXPECT_FALSE(imported.error().hint.empty());
      EXPECT_FALSE(expect.starts_with("load") && expect.find("reject") == std::string::npos);
      continue;
    }
    EXPECT_FALSE(expect.starts_with("reject with")) << "must not load";
    if (!silent.contains(file)) {
      EXPECT_FALSE(imported->warnings.empty()) << "loaded in silence";
    }
  }
  EXPECT_GE(seen, 80);
}

TEST(Corpus, CrashersOfOtherReadersAreSurvived) {
  LIMBER_NEEDS_SHARED(data);
  for (const auto& entry : std::filesystem::directory_iterator(*data / "malformed" / "crashers")) {
    if (!own_format(entry.path().string())) continue;
    SCOPED_TRACE(entry.path().filename());
    const auto imported = import_file(entry.path());
    if (!imported) {
      EXPECT_NE(imported.error().code, "import-internal");
    }
  }
}

}  // namespace
}  // namespace limber::test
