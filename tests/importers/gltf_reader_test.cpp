// The glTF reader against hand-computed values, on documents made here.

#include <gtest/gtest.h>

#include <cstring>
#include <nlohmann/json.hpp>

#include "tests/importers/support.h"

namespace limber::test {
namespace {

using nlohmann::json;

/// Builds a document and its one buffer ("data.bin").
class Maker {
 public:
  json doc = {{"asset", {{"version", "2.0"}}}};

  template <class T>
  int view(const std::vector<T>& values) {
    while (buffer_.size() % 4 != 0) buffer_.push_back(std::byte{0});
    const std::size_t offset = buffer_.size();
    const auto bytes = std::as_bytes(std::span(values));
    buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
    doc["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", offset}, {"byteLength", bytes.size()}});
    return int(doc["bufferViews"].size()) - 1;
  }

  template <class T>
  int accessor(const std::vector<T>& values, const char* type, bool normalized = false) {
    const std::size_t size = std::string(type) == "SCALAR" ? 1
                             : std::string(type) == "MAT4" ? 16
                                                           : std::size_t(type[3] - '0');
    json a = {{"bufferView", view(values)},
              {"componentType", component_type(T{})},
              {"type", type},
              {"count", values.size() / size}};
    if (normalized) a["normalized"] = true;
    doc["accessors"].push_back(a);
    return int(doc["accessors"].size()) - 1;
  }

  Result<Imported> import(const ImportOptions& options = {}) {
    if (!buffer_.empty()) {
      doc["buffers"] = {{{"uri", "data.bin"}, {"byteLength", buffer_.size()}}};
    }
    const std::string text = doc.dump();
    const UriResolver resolver = [&](std::string_view uri) -> Result<std::vector<std::byte>> {
      if (uri == "data.bin") return buffer_;
      return Error{.code = "uri-missing", .message = std::string(uri)};
    };
    return import_bytes(bytes_of(text), "gltf", resolver, options);
  }

 private:
  static int component_type(std::int8_t) { return 5120; }
  static int component_type(std::uint8_t) { return 5121; }
  static int component_type(std::int16_t) { return 5122; }
  static int component_type(std::uint16_t) { return 5123; }
  static int component_type(std::uint32_t) { return 5125; }
  static int component_type(float) { return 5126; }

  std::vector<std::byte> buffer_;
};

/// One node whose translation follows one sampler.
Maker moving_node(const std::vector<float>& times, const std::vector<float>& xyz,
                  const char* interpolation) {
  Maker maker;
  maker.doc["nodes"] = {{{"name", "a"}}};
  const int input = maker.accessor(times, "SCALAR");
  const int output = maker.accessor(xyz, "VEC3");
  maker.doc["animations"] = {
      {{"samplers", {{{"input", input}, {"output", output}, {"interpolation", interpolation}}}},
       {"channels", {{{"sampler", 0}, {"target", {{"node", 0}, {"path", "translation"}}}}}}}};
  return maker;
}

double x_at(const Imported& imported, std::int64_t frame) {
  return imported.clips.at(0).frame(frame)[0].translation().x();
}

TEST(GltfAnimation, LinearIsSampledBetweenSparseKeys) {
  const auto imported =
      moving_node({0.0F, 0.5F, 1.0F}, {0, 0, 0, 6, 0, 0, 0, 0, 0}, "LINEAR").import();
  ASSERT_TRUE(imported) << imported.error().message;
  const Clip& clip = imported->clips[0];
  EXPECT_EQ(imported->facts.rate_hz, 2.0);
  EXPECT_EQ(imported->facts.frames, 3);
  EXPECT_EQ(clip.rate_hz, 24.0);
  ASSERT_EQ(clip.frames(), 25);
  for (int f = 0; f <= 24; ++f) {
    EXPECT_NEAR(x_at(*imported, f), f <= 12 ? 0.5 * f : 0.5 * (24 - f), 1e-6) << f;
  }
  EXPECT_EQ(clip.key_times_s, (std::vector<double>{0.0, 0.5, 1.0}));
  EXPECT_EQ(clip.interpolation, "linear");
}

TEST(GltfAnimation, StepsFallOnTheirFrame) {
  std::vector<float> times, values;
  for (int k = 0; k <= 30; ++k) {
    times.push_back(float(k) / 30.0F);
    values.insert(values.end(), {float(k), 0, 0});
  }
  const auto imported = moving_node(times, values, "STEP").import();
  ASSERT_TRUE(imported);
  EXPECT_EQ(imported->clips[0].rate_hz, 30.0);
  ASSERT_EQ(imported->clips[0].frames(), 31);
  for (int k = 0; k <= 30; ++k) EXPECT_EQ(x_at(*imported, k), double(k));
}

TEST(GltfAnimation, CubicSplineEqualsHermiteByHand) {
  // (in-tangent, value, out-tangent) per key; span 1 s: at u = 1/2 the basis is
  // 1/2 v0 + 1/8 b0 + 1/2 v1 - 1/8 a1 = 0 + 1 + 5 + 1.
  const auto imported =
      moving_node({0.0F, 1.0F}, {0, 0, 0, 0, 0, 0, 8, 0, 0, -8, 0, 0, 10, 0, 0, 0, 0, 0},
                  "CUBICSPLINE")
          .import();
  ASSERT_TRUE(imported) << imported.error().message;
  const Clip& clip = imported->clips[0];
  EXPECT_EQ(clip.rate_hz, 24.0);
  EXPECT_NEAR(x_at(*imported, 0), 0.0, 1e-12);
  EXPECT_NEAR(x_at(*imported, 12), 7.0, 1e-6);
  EXPECT_NEAR(x_at(*imported, 24), 10.0, 1e-6);
  EXPECT_EQ(clip.interpolation, "cubicspline");
}

TEST(GltfAnimation, CubicTangentsScaleWithTheKeySpan) {
  // Span 2 s: 1/2 v0 + 2/8 b0 + 1/2 v1 - 2/8 a1 with b0 = 4, a1 = 0, v = 0.
  const auto imported =
      moving_node({0.0F, 2.0F}, {0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0},
                  "CUBICSPLINE")
          .import();
  ASSERT_TRUE(imported);
  EXPECT_NEAR(x_at(*imported, 24), 1.0, 1e-6);  // at t = 1 s
}

TEST(GltfAnimation, NormalisedRotationsAreExact) {
  Maker maker;
  maker.doc["nodes"] = {{{"name", "a"}}};
  const int input = maker.accessor(std::vector<float>{0.0F, 1.0F / 24.0F}, "SCALAR");
  const int output =
      maker.accessor(std::vector<std::int16_t>{0, 0, 0, 32767, 0, 0, 23170, 23170}, "VEC4", true);
  maker.doc["animations"] = {
      {{"samplers", {{{"input", input}, {"output", output}}}},
       {"channels", {{{"sampler", 0}, {"target", {{"node", 0}, {"path", "rotation"}}}}}}}};
  const auto imported = maker.import();
  ASSERT_TRUE(imported) << imported.error().message;
  ASSERT_EQ(imported->clips[0].frames(), 2);
  const auto turned = imported->clips[0].frame(1)[0].transform_direction({1, 0, 0});
  EXPECT_LT((turned - Eigen::Vector3d(0, 1, 0)).norm(), 1e-12);  // 90 degrees about z
}

TEST(GltfAnimation, KeyTimesGiveTheRate) {
  const auto rate = [](double hz, int keys, double start = 0.0) {
    std::vector<float> times, values;
    for (int k = 0; k < keys; ++k) {
      times.push_back(float(start + k / hz));
      values.insert(values.end(), {float(k), 0, 0});
    }
    const auto imported = moving_node(times, values, "LINEAR").import();
    EXPECT_TRUE(imported);
    if (!imported) return 0.0;
    EXPECT_EQ(imported->clips[0].frames(), keys);
    EXPECT_NEAR(imported->clips[0].start_s, start, 1e-6);
    for (int k = 0; k < keys; ++k) EXPECT_NEAR(x_at(*imported, k), k, 2e-3);
    return imported->clips[0].rate_hz;
  };
  for (const double hz : {20.0, 24.0, 25.0, 30.0, 48.0, 60.0, 100.0, 120.0}) {
    EXPECT_EQ(rate(hz, 200), hz);
    EXPECT_EQ(rate(hz, 200, 10.0 / hz), hz);
  }
  EXPECT_DOUBLE_EQ(rate(30000.0 / 1001.0, 200), 30000.0 / 1001.0);
}

TEST(GltfAnimation, MillisecondTimesStillMeanThirtyHertz) {
  std::vector<float> times, values;
  for (int k = 0; k < 100; ++k) {
    times.push_back(float(std::round(k * 1000.0 / 30.0) / 1000.0));
    values.insert(values.end(), {float(k), 0, 0});
  }
  const auto imported = moving_node(times, values, "STEP").import();
  ASSERT_TRUE(imported);
  EXPECT_EQ(imported->clips[0].rate_hz, 30.0);
  ASSERT_EQ(imported->clips[0].frames(), 100);
  for (int k = 0; k < 100; ++k) EXPECT_EQ(x_at(*imported, k), double(k));
}

TEST(GltfAnimation, AFewKeysOverHoursMustNotAskForAllMemory) {
  const auto imported =
      moving_node({0.0F, 0.001F, 1e9F}, {0, 0, 0, 1, 0, 0, 2, 0, 0}, "LINEAR").import();
  ASSERT_FALSE(imported);
  EXPECT_EQ(imported.error().code, "gltf-size");
}

TEST(GltfAnimation, KeyTimesMustRise) {
  const auto imported =
      moving_node({0.0F, 1.0F, 1.0F}, {0, 0, 0, 1, 0, 0, 2, 0, 0}, "LINEAR").import();
  ASSERT_FALSE(imported);
  EXPECT_EQ(imported.error().code, "gltf-animation");
}

TEST(GltfAnimation, SparseValuesReplaceTheirElements) {
  Maker maker =
      moving_node({0.0F, 1.0F / 30.0F, 2.0F / 30.0F}, {1, 0, 0, 2, 0, 0, 3, 0, 0}, "STEP");
  maker.doc["accessors"][1]["sparse"] = {
      {"count", 1},
      {"indices",
       {{"bufferView", maker.view(std::vector<std::uint8_t>{1})}, {"componentType", 5121}}},
      {"values", {{"bufferView", maker.view(std::vector<float>{9, 0, 0})}}}};
  const auto imported = maker.import();
  ASSERT_TRUE(imported) << imported.error().message;
  EXPECT_EQ(x_at(*imported, 0), 1.0);
  EXPECT_EQ(x_at(*imported, 1), 9.0);
  EXPECT_EQ(x_at(*imported, 2), 3.0);
}

TEST(GltfAnimation, SparseWithoutBufferViewStartsFromZeros) {
  Maker maker = moving_node({0.0F, 1.0F / 30.0F}, {5, 0, 0, 5, 0, 0}, "STEP");
  maker.doc["accessors"][1].erase("bufferView");
  maker.doc["accessors"][1]["sparse"] = {
      {"count", 1},
      {"indices",
       {{"bufferView", maker.view(std::vector<std::uint16_t>{1})}, {"componentType", 5123}}},
      {"values", {{"bufferView", maker.view(std::vector<float>{4, 0, 0})}}}};
  const auto imported = maker.import();
  ASSERT_TRUE(imported) << imported.error().message;
  EXPECT_EQ(x_at(*imported, 0), 0.0);
  EXPECT_EQ(x_at(*imported, 1), 4.0);
}

// ---- skeleton and scale

/// root (x100, turned a quarter about x) > hip > knee, a two-joint skin, one triangle.
Maker scaled_skin() {
  Maker maker;
  const float h = std::sqrt(0.5F);
  maker.doc["nodes"] = {{{"name", "mesh"}, {"mesh", 0}, {"skin", 0}},
                        {{"name", "armature"},
                         {"scale", {100, 100, 100}},
                         {"rotation", {-h, 0, 0, h}},
                         {"children", {2}}},
                        {{"name", "hip"}, {"translation", {0.0, 0.0, 0.01}}, {"children", {3}}},
                        {{"name", "knee"}, {"translation", {0.0, 0.0, -0.005}}}};
  // Inverse of the joints' world matrices, column by column: scale 1/100, turned back.
  const auto inverse_world = [](float y) {
    // world = T(0, y, 0) Rx(-90) S(100): (x, y, z) -> (100 x, 100 z + y, -100 y)
    return std::vector<float>{0.01F, 0, 0, 0, 0, 0, 0.01F, 0, 0, -0.01F, 0, 0, 0, 0, -0.01F * y, 1};
  };
  std::vector<float> binds = inverse_world(1.0F);
  const std::vector<float> knee = inverse_world(0.5F);
  binds.insert(binds.end(), knee.begin(), knee.end());
  const int ibm = maker.accessor(binds, "MAT4");
  maker.doc["skins"] = {{{"joints", {2, 3}}, {"inverseBindMatrices", ibm}}};
  const int position = maker.accessor(std::vector<float>{0, 1, 0, 0, 0.5, 0, 0.2F, 0.5, 0}, "VEC3");
  const int joints =
      maker.accessor(std::vector<std::uint8_t>{0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}, "VEC4");
  const int weights = maker.accessor(
      std::vector<std::uint8_t>{255, 0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0}, "VEC4", true);
  maker.doc["meshes"] = {
      {{"primitives",
        {{{"attributes",
           {{"POSITION", position}, {"JOINTS_0", joints}, {"WEIGHTS_0", weights}}}}}}}};
  return maker;
}

TEST(GltfSkeleton, ScaleIsFoldedIntoTranslationsAndSkin) {
  const auto imported = scaled_skin().import();
  ASSERT_TRUE(imported) << imported.error().message;
  const Character& c = imported->character;
  ASSERT_EQ(c.skeleton.names, (std::vector<std::string>{"armature", "hip", "knee"}));
  const auto points = joint_positions(c.skeleton, c.skeleton.rest_parent_from_joint);
  EXPECT_LT((points[1] - Eigen::Vector3d(0, 1, 0)).norm(), 1e-6);
  EXPECT_LT((points[2] - Eigen::Vector3d(0, 0.5, 0)).norm(), 1e-6);
  EXPECT_EQ(c.document.parent_scale, (std::vector<double>{1.0, 100.0, 100.0}));
  EXPECT_EQ(c.document.node_of_joint, (std::vector<std::int32_t>{1, 2, 3}));
  EXPECT_EQ(c.deforming, (std::vector<std::uint8_t>{0, 1, 1}));

  // At rest the skin lies where the mesh was drawn.
  ASSERT_EQ(c.meshes.size(), 1u);
  std::vector<DualQuaternion> model(3);
  model_from_local(c.skeleton, c.skeleton.rest_parent_from_joint, model);
  std::vector<Eigen::Vector3f> skinned(3);
  skin_positions(c.meshes[0], model, skinned);
  for (int v = 0; v < 3; ++v) EXPECT_LT((skinned[v] - c.meshes[0].positions[v]).norm(), 1e-6F) << v;

  // The bind pose is the rest pose here.
  for (int j = 0; j < 3; ++j) {
    EXPECT_LT((c.bind_model_from_joint[j].translation() - points[j]).norm(), 1e-6) << j;
    EXPECT_LT(rotation_angle(c.bind_model_from_joint[j].real, model[j].real), 1e-6) << j;
  }
}

TEST(GltfSkeleton, UnitOptionScalesSkeletonAndSkinAlike) {
  ImportOptions options;
  options.unit_m = 0.01;
  const auto imported = scaled_skin().import(options);
  ASSERT_TRUE(imported);
  const Character& c = imported->character;
  const auto points = joint_positions(c.skeleton, c.skeleton.rest_parent_from_joint);
  EXPECT_LT((points[1] - Eigen::Vector3d(0, 0.01, 0)).norm(), 1e-8);
  std::vector<DualQuaternion> model(3);
  model_from_local(c.skeleton, c.skeleton.rest_parent_from_joint, model);
  std::vector<Eigen::Vector3f> skinned(3);
  skin_positions(c.meshes[0], model, skinned);
  EXPECT_LT((skinned[0] - Eigen::Vector3f(0, 0.01F, 0)).norm(), 1e-7F);
  EXPECT_NEAR(c.bind_model_from_joint[2].translation().y(), 0.005, 1e-8);
}

TEST(GltfSkeleton, UpOptionTurnsTheWholeFigure) {
  Maker maker;
  maker.doc["nodes"] = {{{"name", "a"}, {"translation", {0, 0, 2}}}};
  ImportOptions options;
  options.up = 'z';
  const auto imported = maker.import(options);
  ASSERT_TRUE(imported);
  const auto points = joint_positions(imported->character.skeleton,
                                      imported->character.skeleton.rest_parent_from_joint);
  EXPECT_LT((points[0] - Eigen::Vector3d(0, 2, 0)).norm(), 1e-12);
}

TEST(GltfSkeleton, MissingInverseBindMatricesAreIdentity) {
  Maker maker = scaled_skin();
  maker.doc["skins"][0].erase("inverseBindMatrices");
  const auto imported = maker.import();
  ASSERT_TRUE(imported) << imported.error().message;
  const Character& c = imported->character;
  // Skinning: world of the joint (scale 100 included) times the vertex.
  std::vector<DualQuaternion> model(3);
  model_from_local(c.skeleton, c.skeleton.rest_parent_from_joint, model);
  std::vector<Eigen::Vector3f> skinned(3);
  skin_positions(c.meshes[0], model, skinned);
  EXPECT_LT((skinned[0] - Eigen::Vector3f(0, 1, -100)).norm(), 1e-4F);
}

TEST(GltfSkeleton, MatrixNodesEqualTheirTrs) {
  // T(1,2,3) Rz(90) S(2): columns (0,2,0), (-2,0,0), (0,0,2), (1,2,3)
  Maker maker;
  maker.doc["nodes"] = {{{"name", "a"},
                         {"matrix", {0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 2, 0, 1, 2, 3, 1}},
                         {"children", {1}}},
                        {{"name", "b"}, {"translation", {1, 0, 0}}}};
  const auto imported = maker.import();
  ASSERT_TRUE(imported) << imported.error().message;
  const auto points = joint_positions(imported->character.skeleton,
                                      imported->character.skeleton.rest_parent_from_joint);
  EXPECT_LT((points[1] - Eigen::Vector3d(1, 4, 3)).norm(), 1e-12);
}

TEST(GltfSkeleton, ParentsComeFirstWhateverTheNodeOrder) {
  Maker maker;
  maker.doc["nodes"] = {
      {{"name", "leaf"}}, {{"children", {0}}}, {{"name", "root"}, {"children", {1}}}};
  const auto imported = maker.import();
  ASSERT_TRUE(imported);
  EXPECT_EQ(imported->character.skeleton.names,
            (std::vector<std::string>{"root", "node_1", "leaf"}));
}

TEST(GltfSkeleton, UnskinnedMeshOnAJointHasOneInfluence) {
  Maker maker = scaled_skin();
  maker.doc["nodes"].push_back({{"name", "sword"}, {"mesh", 1}, {"scale", {0.01, 0.01, 0.01}}});
  maker.doc["nodes"][3]["children"] = {4};
  const int position = maker.accessor(std::vector<float>{0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
  maker.doc["meshes"].push_back({{"primitives", {{{"attributes", {{"POSITION", position}}}}}}});
  const auto imported = maker.import();
  ASSERT_TRUE(imported) << imported.error().message;
  const Character& c = imported->character;
  ASSERT_EQ(c.meshes.size(), 2u);
  EXPECT_EQ(c.skeleton.find("sword"), kNoJoint);
  const Mesh& sword = c.meshes[1];
  ASSERT_EQ(sword.skin.size(), 1u);
  EXPECT_EQ(c.skeleton.names[sword.skin[0].joint], "knee");
  std::vector<DualQuaternion> model(3);
  model_from_local(c.skeleton, c.skeleton.rest_parent_from_joint, model);
  std::vector<Eigen::Vector3f> posed(3);
  skin_positions(sword, model, posed);
  EXPECT_LT((posed[1] - Eigen::Vector3f(1, 0.5F, 0)).norm(), 1e-5F);   // 100 * 0.01 = 1
  EXPECT_LT((posed[2] - Eigen::Vector3f(0, 0.5F, -1)).norm(), 1e-5F);  // its y is turned to -z
}

TEST(GltfSkeleton, WeightsAreMadeToSumToOne) {
  Maker maker = scaled_skin();
  const int weights =
      maker.accessor(std::vector<float>{0.5, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0}, "VEC4");
  maker.doc["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = weights;
  const auto imported = maker.import();
  ASSERT_TRUE(imported) << imported.error().message;
  EXPECT_TRUE(has_warning(*imported, "weights-normalised"));
  EXPECT_TRUE(has_warning(*imported, "weights-missing"));
  for (const Influence& influence : imported->character.meshes[0].influences) {
    EXPECT_EQ(influence.weight, 1.0F);
  }
}

TEST(GltfSkeleton, VrmRolesOfBothVersions) {
  Maker maker;
  maker.doc["nodes"] = {{{"name", "J_Hips"}, {"children", {1, 2, 3}}},
                        {{"name", "t0"}},
                        {{"name", "t1"}},
                        {{"name", "t2"}}};
  maker.doc["extensions"]["VRM"]["humanoid"]["humanBones"] = {
      {{"bone", "hips"}, {"node", 0}},
      {{"bone", "leftThumbProximal"}, {"node", 1}},
      {{"bone", "leftThumbIntermediate"}, {"node", 2}},
      {{"bone", "leftThumbDistal"}, {"node", 3}}};
  const std::vector<std::string> expected = {"hips", "leftThumbMetacarpal", "leftThumbProximal",
                                             "leftThumbDistal"};
  const auto vrm0 = maker.import();
  ASSERT_TRUE(vrm0) << vrm0.error().message;
  EXPECT_EQ(vrm0->character.roles, expected);
  maker.doc["extensions"] = {{"VRMC_vrm",
                              {{"humanoid",
                                {{"humanBones",
                                  {{"hips", {{"node", 0}}},
                                   {"leftThumbMetacarpal", {{"node", 1}}},
                                   {"leftThumbProximal", {{"node", 2}}},
                                   {"leftThumbDistal", {{"node", 3}}}}}}}}}};
  const auto vrm1 = maker.import();
  ASSERT_TRUE(vrm1) << vrm1.error().message;
  EXPECT_EQ(vrm1->character.roles, expected);
}

TEST(GltfSkeleton, AnimatedScaleIsToldAndLeftAtRest) {
  Maker maker = moving_node({0.0F, 1.0F / 30.0F}, {1, 1, 1, 2, 2, 2}, "LINEAR");
  maker.doc["animations"][0]["channels"][0]["target"]["path"] = "scale";
  const auto imported = maker.import();
  ASSERT_TRUE(imported);
  EXPECT_TRUE(has_warning(*imported, "scale-animated"));
  maker.doc["animations"][0]["channels"][0]["target"]["path"] = "translation";
}

TEST(GltfDocument, IsKeptVerbatim) {
  Maker maker = scaled_skin();
  maker.doc["extras"] = {{"keep", "me"}};
  const auto imported = maker.import();
  ASSERT_TRUE(imported);
  const Character& c = imported->character;
  EXPECT_TRUE(c.has_document);
  EXPECT_EQ(c.document.json, maker.doc.dump());
  ASSERT_EQ(c.document.buffers.size(), 1u);
  EXPECT_EQ(c.document.buffers[0].size(), maker.doc["buffers"][0]["byteLength"].get<std::size_t>());
  EXPECT_FALSE(c.document.binary_chunk);
}

// ---- the GLB container

/// Header, JSON chunk (padded with spaces), BIN chunk.
std::string glb(std::string text, std::string bin) {
  while (text.size() % 4 != 0) text += ' ';
  while (bin.size() % 4 != 0) bin += '\0';
  const auto word = [](std::size_t v) {
    std::string bytes;
    for (int k = 0; k < 4; ++k) bytes += static_cast<char>(v >> (8 * k) & 0xFF);
    return bytes;
  };
  const std::string chunks =
      word(text.size()) + "JSON" + text + word(bin.size()) + std::string("BIN\0", 4) + bin;
  return "glTF" + word(2) + word(12 + chunks.size()) + chunks;
}

const char* const kGlbJson =
    R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":6}],"nodes":[{"name":"a"}]})";

TEST(GltfContainer, KeepsTheBinaryChunk) {
  const auto imported = import_text(glb(kGlbJson, "abcdef"), "glb");
  ASSERT_TRUE(imported) << imported.error().message;
  const GltfDocument& document = imported->character.document;
  EXPECT_TRUE(document.binary_chunk);
  ASSERT_EQ(document.buffers.size(), 1u);
  EXPECT_EQ(document.buffers[0].size(), 8u);  // padding included, as in the file
  EXPECT_EQ(document.buffers[0][5], std::byte{'f'});
  EXPECT_EQ(document.json.find(kGlbJson), 0u);
}

TEST(GltfContainer, EveryCutIsRefused) {
  const std::string whole = glb(kGlbJson, "abcdef");
  for (std::size_t size = 1; size < whole.size(); ++size) {
    const auto imported = import_text(whole.substr(0, size), "glb");
    ASSERT_FALSE(imported) << size;
    EXPECT_NE(imported.error().code, "import-internal");
  }
}

TEST(GltfContainer, TrailingBytesAreIgnoredWithAWarning) {
  const auto imported = import_text(glb(kGlbJson, "abcdef") + "xyz", "glb");
  ASSERT_TRUE(imported);
  EXPECT_TRUE(has_warning(*imported, "gltf-extra-bytes"));
}

TEST(GltfContainer, BinaryShorterThanItsBufferIsRefused) {
  const auto imported = import_text(glb(kGlbJson, "abcd"), "glb");
  ASSERT_FALSE(imported);
  EXPECT_EQ(imported.error().code, "gltf-buffer");
}

// ---- damage

TEST(GltfDamage, HasACode) {
  const auto code = [](auto&& change) {
    Maker maker = scaled_skin();
    change(maker.doc);
    const auto imported = maker.import();
    EXPECT_FALSE(imported);
    if (imported) return std::string();
    EXPECT_FALSE(imported.error().hint.empty()) << imported.error().code;
    return imported.error().code;
  };
  EXPECT_EQ(code([](json& d) { d["nodes"][3]["children"] = {2}; }), "gltf-node-cycle");
  EXPECT_EQ(code([](json& d) { d["nodes"][3]["children"] = {3}; }), "gltf-node-cycle");
  EXPECT_EQ(code([](json& d) { d["nodes"][3]["children"] = {99}; }), "gltf-invalid");
  EXPECT_EQ(code([](json& d) { d["nodes"][3]["children"] = {-1}; }), "gltf-invalid");
  EXPECT_EQ(code([](json& d) { d["skins"][0]["joints"] = {2, 77}; }), "gltf-invalid");
  EXPECT_EQ(code([](json& d) { d["accessors"][0]["count"] = 2000000000; }), "gltf-accessor");
  EXPECT_EQ(code([](json& d) {
              d["accessors"][1]["count"] = 2000000000;
              d["accessors"][1].erase("bufferView");
            }),
            "gltf-accessor");
  EXPECT_EQ(code([](json& d) { d["bufferViews"][0]["byteLength"] = 100000; }), "gltf-buffer");
  EXPECT_EQ(code([](json& d) { d["asset"]["version"] = "1.0"; }), "gltf-version");
  EXPECT_EQ(code([](json& d) { d["extensionsRequired"] = {"KHR_draco_mesh_compression"}; }),
            "gltf-unsupported-extension");
  EXPECT_EQ(code([](json& d) { d.erase("nodes"); }), "gltf-empty");
  EXPECT_EQ(code([](json& d) { d["nodes"][2]["rotation"] = {0, 0, 0, 0}; }), "gltf-invalid");
  EXPECT_EQ(code([](json& d) { d["nodes"] = 7; }), "gltf-invalid");
}

TEST(GltfDamage, NamesTheJsonPointer) {
  Maker maker = scaled_skin();
  maker.doc["nodes"][2]["translation"] = {0, "x", 0};
  const auto imported = maker.import();
  ASSERT_FALSE(imported);
  EXPECT_NE(imported.error().message.find("/nodes/2/translation/1"), std::string::npos)
      << imported.error().message;
}

TEST(GltfDamage, DeepJsonIsRefused) {
  const std::string text = R"({"asset":{"version":"2.0"},"extras":)" + std::string(1000000, '[');
  const auto imported = import_text(text, "gltf");
  ASSERT_FALSE(imported);
  EXPECT_EQ(imported.error().code, "gltf-json");
}

TEST(GltfDamage, AnyDamagedByteIsSurvived) {
  Maker maker = scaled_skin();
  const std::string good = maker.doc.dump();
  std::uint64_t state = 99;
  const auto random = [&] {
    return state = state * 6364136223846793005ULL + 1442695040888963407ULL;
  };
  const UriResolver zeros = [](std::string_view) -> Result<std::vector<std::byte>> {
    return std::vector<std::byte>(4096);
  };
  for (int round = 0; round < 3000; ++round) {
    std::string text = good;
    for (int k = 0; k < 1 + round % 3; ++k) {
      // digits and punctuation make more trouble than letters
      static const char kBytes[] = "0123456789-[]{},:\"e.\\";
      text[(random() >> 20) % text.size()] = kBytes[(random() >> 30) % (sizeof kBytes - 1)];
    }
    const auto imported = import_bytes(bytes_of(text), "gltf", zeros);
    if (!imported) {
      EXPECT_NE(imported.error().code, "import-internal") << imported.error().message;
    }
  }
}

// ---- real characters

TEST(GltfReader, RealSkinsLieOnTheirJointsAtRest) {
  LIMBER_NEEDS_SHARED(data);
  for (const char* file : {"cesium_man_embedded.gltf", "kaykit_knight.glb", "godette.vrm",
                           "quaternius_scifi_f_fingers.glb", "webxr_hand_left.glb",
                           "godotxr_hand_low_L.gltf", "quaternius_robot.glb"}) {
    SCOPED_TRACE(file);
    const auto imported = import_file(*data / "characters" / file);
    ASSERT_TRUE(imported) << imported.error().message;
    const Character& c = imported->character;
    std::vector<DualQuaternion> model(c.skeleton.parents.size());
    model_from_local(c.skeleton, c.skeleton.rest_parent_from_joint, model);
    Eigen::AlignedBox3d bones, skin;
    for (std::size_t j = 0; j < model.size(); ++j) {
      if (c.deforming[j] != 0) bones.extend(model[j].translation());
    }
    for (const Mesh& mesh : c.meshes) {
      std::vector<Eigen::Vector3f> posed(mesh.positions.size());
      skin_positions(mesh, model, posed);
      for (const auto& p : posed) skin.extend(p.cast<double>());
    }
    // The skin encloses the bones, give or take 5 %, and is of their size.
    const double size = bones.diagonal().norm();
    EXPECT_GT(skin.diagonal().norm(), 0.8 * size);
    EXPECT_LT(skin.diagonal().norm(), 2.5 * size);
    EXPECT_LT(skin.exteriorDistance(bones.center()), 1e-9);
  }
}

}  // namespace
}  // namespace limber::test
