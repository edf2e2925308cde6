// Good clips among changed files of every format: each file ends in a record, and the good ones
// come out byte for byte as if they had been alone. LIMBER_MUTATED=2000 makes it 2,000 changed
// files of each format and 200 good clips; otherwise it is a taste of that.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cstring>
#include <nlohmann/json.hpp>
#include <set>

#include "tests/fuzz/mutation.h"
#include "tests/pipeline/batch_ground.h"

namespace {

using limber_test::BatchGround;
using limber_test::limber;
using limber_test::own_clip;
using limber_test::text_of;
using limber_test::write_text;
using nlohmann::json;
namespace fs = std::filesystem;

std::size_t mutated_per_format() {
  const char* set = std::getenv("LIMBER_MUTATED");
  return set != nullptr ? std::strtoul(set, nullptr, 10) : 8;
}

/// Three frames of the shipped body clip, from `first` on.
std::string short_clip(std::size_t first) {
  static const std::string text = text_of(own_clip("body_range_of_motion.bvh"));
  const std::size_t motion = text.find("MOTION");
  std::istringstream rest(text.substr(motion));
  std::vector<std::string> lines;
  for (std::string line; std::getline(rest, line);) lines.push_back(line);
  std::string out = text.substr(0, motion) + "MOTION\nFrames: 3\n" + lines[2] + "\n";
  for (std::size_t k = 0; k < 3; ++k) out += lines[3 + (first + k) % (lines.size() - 3)] + "\n";
  return out;
}

/// The files below these folders with an ending, small enough that changes matter.
std::vector<std::string> files_with(const std::string& ending, const std::vector<fs::path>& roots) {
  std::set<fs::path> found;
  for (const fs::path& root : roots) {
    std::error_code none;
    for (const auto& entry : fs::recursive_directory_iterator(root, none)) {
      if (entry.path().extension() == ending && entry.file_size() < 200'000) found.insert(entry);
    }
  }
  std::vector<std::string> texts;
  for (const fs::path& path : found) texts.push_back(text_of(path));
  return texts;
}

/// A GLB of our own and the same as glTF without its bytes, and what the machine has besides.
std::map<std::string, std::vector<std::string>> seeds() {
  const limber_test::Folder folder;
  limber({"retarget", own_clip("gestures_right_hand.bvh").string(), "--target", "hand", "-o",
          folder.string(), "--refine", "none", "--formats", "glb", "--range", "0:2"});
  const std::string glb = text_of(folder / "gestures_right_hand@hand.glb");
  std::uint32_t length = 0;
  if (glb.size() > 20) std::memcpy(&length, glb.data() + 12, 4);
  const std::vector<fs::path> models = {"/usr/share/assimp/models",
                                        limber_test::shared("characters"),
                                        limber_test::shared("mocap_other")};
  std::map<std::string, std::vector<std::string>> all = {
      {"bvh", {short_clip(0), short_clip(50)}}, {"glb", {glb}}, {"gltf", {glb.substr(20, length)}}};
  for (const char* format : {"glb", "gltf", "fbx", "dae", "x"}) {
    for (std::string& text : files_with(std::string(".") + format, models)) {
      all[format].push_back(std::move(text));
    }
  }
  return all;
}

constexpr const char* kJob = R"({"sources": ["in/*"], "targets": ["biped-full"], "output": "out",
 "options": {"refine": "none", "formats": ["bvh"]}})";

class Mixed : public BatchGround {
 public:
  Mixed() : BatchGround(LIMBER_PROGRAM) {
    set_leading({"batch"});
    fs::create_directories(in());
    write_text(job(), kJob);
  }
  void add_good(std::size_t count) const {
    for (std::size_t n = 0; n < count; ++n) {
      write_text(in() / fmt::format("good{}.bvh", n), short_clip(3 * n));
    }
  }
  std::size_t add_mutated(std::size_t per_format) const {
    std::size_t added = 0;
    for (const auto& [format, texts] : seeds()) {
      if (texts.empty()) continue;
      limber::fuzz::Mutator mutator(texts, 1);
      for (std::size_t n = 0; n < per_format; ++n, ++added) {
        write_text(in() / fmt::format("{}{}.{}", format, n, format), mutator.next());
      }
    }
    return added;
  }
};

/// What good clips left, without how long it took.
std::map<std::string, std::string> good_part(std::map<std::string, std::string> tree) {
  std::erase_if(tree, [](const auto& file) {
    return !file.first.starts_with("good") || file.first.ends_with(".timing.json");
  });
  return tree;
}

TEST(MutatedBatch, EveryFileEndsInARecordAndGoodClipsAreAsIfAlone) {
  const std::size_t per_format = mutated_per_format(),
                    good = std::max<std::size_t>(3, per_format / 10);
  const Mixed clean, mixed;
  clean.add_good(good);
  mixed.add_good(good);
  const std::size_t mutated = mixed.add_mutated(per_format);
  EXPECT_EQ(clean.run({"-j", "2"}), 0) << clean.log();
  EXPECT_LE(mixed.run({"-j", "2"}), 1) << mixed.log();
  const auto tree = mixed.tree();
  EXPECT_EQ(good_part(tree), good_part(clean.tree()));
  EXPECT_GE(good_part(tree).size(), 3 * good);

  std::set<std::string> recorded;
  for (const auto& [name, text] : tree) {
    EXPECT_FALSE(name.ends_with(".tmp")) << name;
    if (!name.ends_with(".report.json")) continue;
    const json report = json::parse(text, nullptr, false);
    ASSERT_FALSE(report.is_discarded()) << name;
    if (report["status"] == "fail") {
      EXPECT_FALSE(report["errors"].empty()) << name;
    }
    recorded.insert(fs::path(report["source"]["path"].get<std::string>()).filename());
  }
  EXPECT_EQ(recorded.size(), good + mutated);
  EXPECT_EQ(mixed.leftovers(), 0U);
}

}  // namespace
