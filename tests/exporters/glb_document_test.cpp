// A character that came as glTF keeps its document: only what the animation needs is added.

#include <gtest/gtest.h>

#include <cstring>
#include <nlohmann/json.hpp>

#include "exporters/exporter.h"
#include "importers/file_resolver.h"
#include "tests/exporters/support.h"

namespace limber::test {
namespace {

using Json = nlohmann::ordered_json;

struct Glb {
  Json json;
  std::vector<std::byte> bin;
};

std::uint32_t word(std::span<const std::byte> bytes, std::size_t at) {
  std::uint32_t value = 0;
  std::memcpy(&value, bytes.data() + at, 4);
  return value;
}

/// Takes a GLB apart by the specification alone (glTF 2.0, section 4.4).
Glb take_apart(std::span<const std::byte> file) {
  Glb glb;
  EXPECT_EQ(word(file, 0), 0x46546C67U);
  EXPECT_EQ(word(file, 4), 2U);
  EXPECT_EQ(word(file, 8), file.size());
  const std::uint32_t length = word(file, 12);
  EXPECT_EQ(length % 4, 0U);
  glb.json = Json::parse(std::string(reinterpret_cast<const char*>(file.data()) + 20, length));
  if (file.size() == 20 + length) return glb;
  const std::size_t bin = 20 + length;
  EXPECT_EQ(word(file, bin + 4), 0x004E4942U);
  EXPECT_EQ(file.size(), bin + 8 + word(file, bin));
  glb.bin.assign(file.begin() + static_cast<std::ptrdiff_t>(bin) + 8, file.end());
  return glb;
}

std::vector<std::byte> view_bytes(const Json& json, std::size_t view,
                                  const std::vector<std::vector<std::byte>>& buffers) {
  const Json& v = json["bufferViews"][view];
  const auto& buffer = buffers.at(v["buffer"].get<std::size_t>());
  const auto begin = buffer.begin() + v.value("byteOffset", std::ptrdiff_t{0});
  return {begin, begin + v["byteLength"].get<std::ptrdiff_t>()};
}

/// Everything but what an export may touch is the same, and what it touches still means the same.
void expect_kept(const GltfDocument& document, std::span<const std::byte> file) {
  const Glb out = take_apart(file);
  const Json before = Json::parse(document.json);
  for (const auto& [key, value] : before.items()) {
    if (key == "animations" || key == "buffers" || key == "bufferViews" || key == "accessors" ||
        key == "nodes" || key == "images") {
      continue;
    }
    EXPECT_EQ(out.json.value(key, Json()), value) << key;
  }
  EXPECT_EQ(out.json["animations"].size(), 1U);
  EXPECT_EQ(out.json["buffers"].size(), 1U);
  const Json none = Json::array();
  const auto& views = before.value("bufferViews", none);
  for (std::size_t v = 0; v < views.size(); ++v) {
    EXPECT_EQ(view_bytes(before, v, document.buffers), view_bytes(out.json, v, {out.bin}));
  }
  const auto& accessors = before.value("accessors", none);
  for (std::size_t a = 0; a < accessors.size(); ++a) {
    EXPECT_EQ(out.json["accessors"][a], accessors[a]);
  }
  for (std::size_t n = 0; n < before["nodes"].size(); ++n) {
    Json old_node = before["nodes"][n], new_node = out.json["nodes"][n];
    if (old_node.contains("matrix") && !new_node.contains("matrix")) {
      old_node.erase("matrix");
      for (const char* key : {"translation", "rotation", "scale"}) new_node.erase(key);
    }
    EXPECT_EQ(old_node, new_node) << "node " << n;
  }
  if (!document.buffers.empty() && !document.buffers[0].empty()) {
    const auto& old_bin = document.buffers[0];
    ASSERT_LE(old_bin.size(), out.bin.size());
    EXPECT_TRUE(std::equal(old_bin.begin(), old_bin.end(), out.bin.begin()));
  }
}

/// Animates a character from a file, checks that the document is kept and that the motion is back.
void expect_round_trip(const Imported& source, bool second_reader) {
  const Character& character = source.character;
  ASSERT_TRUE(character.has_document);
  Random random(21);
  // A joint below others slides, so that the folded scale of those must be undone.
  std::int32_t sliding = character.skeleton.size() - 1;
  while (sliding > 0 && character.skeleton.parents[sliding] == kNoJoint) --sliding;
  const Clip clip = random_clip(character.skeleton, 15, random, sliding);
  double size = 1.0;  // a figure of many metres is resolved less finely by float32
  std::vector<DualQuaternion> model(character.skeleton.parents.size());
  model_from_local(character.skeleton, character.skeleton.rest_parent_from_joint, model);
  for (const DualQuaternion& m : model) size = std::max(size, m.translation().norm());
  const auto glb = export_glb(character, clip);
  ASSERT_TRUE(glb.ok()) << glb.error().message;
  expect_kept(character.document, *glb);
  const auto back = read_back(*glb, "glb", ReaderChoice::automatic);
  ASSERT_TRUE(back.ok()) << back.error().message;
  ASSERT_EQ(back->clips.size(), 1U);
  const Difference d = compare(character.skeleton, clip, back->character.skeleton, back->clips[0]);
  EXPECT_EQ(d.joints, character.skeleton.size());
  EXPECT_LT(d.metres, 1e-5 * size);
  EXPECT_LT(d.radians, 1e-5);
  if (!second_reader) return;
  const auto again = read_back(*glb, "glb", ReaderChoice::assimp);
  ASSERT_TRUE(again.ok()) << again.error().message;
  ASSERT_EQ(again->clips.size(), 1U);
  const Difference e =
      compare(character.skeleton, clip, again->character.skeleton, again->clips[0]);
  EXPECT_GE(e.joints, character.skeleton.size() - 1);
  EXPECT_LT(e.metres, 1e-5 * size);
  EXPECT_LT(e.radians, 1e-5);
}

std::vector<std::byte> floats(std::initializer_list<float> values) {
  const auto bytes = std::as_bytes(std::span(values.begin(), values.size()));
  return {bytes.begin(), bytes.end()};
}

/// A file with what patching must cope with: two buffers and a picture beside it, scaled and
/// matrix nodes, an old animation, extras and extensions that nobody knows.
struct Awkward {
  std::vector<std::byte> a, b, picture;
  std::string json;

  Awkward() {
    a = floats({0, 0, 0, 1, 0, 0, 0, 1, 0});  // three positions
    a.resize(a.size() + 3);                   // a length that is no multiple of four
    b = floats({0, 0.5F, 0, 0, 0, 1, 0, 0, 1, 0});
    picture = to_bytes("\x89PNG\r\n\x1a\n and so on");
    Json j = Json::parse(R"({
      "asset": {"version": "2.0", "generator": "someone else", "extras": {"mark": 7}},
      "scene": 0,
      "scenes": [{"nodes": [0]}],
      "extensionsUsed": ["NOBODY_knows"],
      "extensions": {"NOBODY_knows": {"buffer": "not a number", "list": [1, 2.5, null]}},
      "extras": {"float": 0.1, "big": 12345678901234567890},
      "nodes": [
        {"name": "Armature", "rotation": [-0.7071067811865476, 0, 0, 0.7071067811865476],
         "scale": [0.01, 0.01, 0.01], "children": [1], "extras": {"a": [1]}},
        {"name": "hips", "matrix": [0,1,0,0, -1,0,0,0, 0,0,1,0, 3,4,90,1], "children": [2, 3]},
        {"name": "spine", "translation": [0, 0, 20], "scale": [2, 2, 2], "children": [4]},
        {"name": "leg", "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,-40,1]},
        {"name": "head", "translation": [0, 1, 15]},
        {"name": "still", "matrix": [2,0,0,0, 0,2,0,0, 0,0,2,0, 1,2,3,1]}],
      "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
      "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
      "textures": [{"source": 0}],
      "images": [{"uri": "a%20picture.png"}],
      "buffers": [{"uri": "a.bin", "byteLength": 39}, {"uri": "b.bin", "byteLength": 40}],
      "bufferViews": [{"buffer": 0, "byteLength": 36},
                      {"buffer": 1, "byteLength": 8},
                      {"buffer": 1, "byteOffset": 8, "byteLength": 32}],
      "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
         "min": [0, 0, 0], "max": [1, 1, 0]},
        {"bufferView": 1, "componentType": 5126, "count": 2, "type": "SCALAR",
         "min": [0], "max": [0.5]},
        {"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC4"}],
      "animations": [{"name": "old", "samplers": [{"input": 1, "output": 2}],
                      "channels": [{"sampler": 0, "target": {"node": 4, "path": "rotation"}}]}]
    })");
    j["scenes"][0]["nodes"].push_back(5);
    j["nodes"][5]["mesh"] = 0;
    json = j.dump();
  }

  Result<Imported> read() const {
    return import_bytes(to_bytes(json), "gltf",
                        [this](std::string_view uri) -> Result<std::vector<std::byte>> {
                          if (uri == "a.bin") return a;
                          if (uri == "b.bin") return b;
                          if (uri == "a%20picture.png" || uri == "a picture.png") return picture;
                          return Error{"uri-missing", std::string(uri)};
                        });
  }
};

TEST(GlbDocument, AnAwkwardFileIsKeptAndBecomesSelfContained) {
  const Awkward file;
  const auto source = file.read();
  ASSERT_TRUE(source.ok()) << source.error().message;
  expect_round_trip(*source, true);

  Random random(22);
  const Clip clip = random_clip(source->character.skeleton, 4, random);
  const auto glb = export_glb(source->character, clip);
  ASSERT_TRUE(glb.ok());
  const Glb out = take_apart(*glb);
  EXPECT_FALSE(out.json["buffers"][0].contains("uri"));
  const Json& image = out.json["images"][0];
  EXPECT_FALSE(image.contains("uri"));
  EXPECT_EQ(image["mimeType"], "image/png");
  EXPECT_EQ(view_bytes(out.json, image["bufferView"], {out.bin}), file.picture);
  EXPECT_FALSE(out.json["nodes"][1].contains("matrix")) << "an animated node keeps its matrix";
}

TEST(GlbDocument, OnlyMovingJointsGetChannels) {
  const Awkward file;
  const auto source = file.read();
  ASSERT_TRUE(source.ok()) << source.error().message;
  const Character& character = source->character;
  Clip clip;
  clip.joints = character.skeleton.size();
  for (int f = 0; f < 3; ++f) {
    auto pose = character.skeleton.rest_parent_from_joint;
    DualQuaternion& leg = pose[character.skeleton.find("leg")];
    leg = leg * DualQuaternion::from_rotation(
                    Eigen::Quaterniond(Eigen::AngleAxisd(0.1 * f, Eigen::Vector3d::UnitX())));
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  const auto glb = export_glb(character, clip);
  ASSERT_TRUE(glb.ok());
  const Glb out = take_apart(*glb);
  const Json& channels = out.json["animations"][0]["channels"];
  ASSERT_EQ(channels.size(), 1U);
  EXPECT_EQ(channels[0]["target"]["node"], 3);
  EXPECT_EQ(channels[0]["target"]["path"], "rotation");
  EXPECT_TRUE(out.json["nodes"][1].contains("matrix")) << "a still node is left alone";
  // By the specification's own arithmetic: quarter turns about x of half angles 0, 0.05, 0.1.
  const std::size_t sampler = channels[0]["sampler"];
  const Json& accessor =
      out.json["accessors"][out.json["animations"][0]["samplers"][sampler]["output"].get<int>()];
  const auto bytes = view_bytes(out.json, accessor["bufferView"], {out.bin});
  float x = 0.0F;
  std::memcpy(&x, bytes.data() + 2 * 16, 4);
  EXPECT_NEAR(x, std::sin(0.1), 1e-7);
}

TEST(GlbDocument, OldAnimationsStayWhereAsked) {
  const Awkward file;
  const auto source = file.read();
  ASSERT_TRUE(source.ok());
  Random random(23);
  const Clip clip = random_clip(source->character.skeleton, 4, random);
  const auto glb = export_glb(source->character, clip, {.replace_animations = false});
  ASSERT_TRUE(glb.ok());
  const Glb out = take_apart(*glb);
  ASSERT_EQ(out.json["animations"].size(), 2U);
  EXPECT_EQ(out.json["animations"][0]["name"], "old");
  EXPECT_EQ(out.json["animations"][1]["name"], "wander");
}

TEST(GlbDocument, SharedCharactersAreKept) {
  const auto shared = shared_folder();
  if (shared.empty()) GTEST_SKIP() << "no shared data on this machine (LIMBER_SHARED)";
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(shared / "data/characters")) {
    const std::string extension = entry.path().extension();
    if (extension != ".gltf" && extension != ".glb" && extension != ".vrm") continue;
    SCOPED_TRACE(entry.path().filename().string());
    const auto source = import_file(entry.path());
    ASSERT_TRUE(source.ok()) << source.error().message;
    expect_round_trip(*source, false);
    ++files;
  }
  EXPECT_GT(files, 5);
}

}  // namespace
}  // namespace limber::test
