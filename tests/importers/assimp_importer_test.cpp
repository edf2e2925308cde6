// What comes out of assimp, against the formats' own definitions and our exact readers.

#include "importers/assimp_importer.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/importers/support.h"

namespace limber::test {
namespace {

using Eigen::Vector3d;

constexpr double kDegree = M_PI / 180.0;

Result<Imported> read_text(std::string_view text, std::string_view extension,
                           const ImportOptions& options = {}) {
  return import_with_assimp(bytes_of(text), extension, no_uris, options);
}

// ---- FBX, written here from Autodesk's published transform formula

constexpr long long kTicksPerSecond = 46186158000LL;

struct FbxNode {
  std::string name;
  int parent = -1;
  Vector3d translation = Vector3d::Zero(), rotation_deg = Vector3d::Zero();
  Vector3d pre_deg = Vector3d::Zero(), post_deg = Vector3d::Zero();
  Vector3d rotation_pivot = Vector3d::Zero(), rotation_offset = Vector3d::Zero();
  Vector3d turn_deg_per_key = Vector3d::Zero();  ///< animated rotation
  Vector3d slide_per_key = Vector3d::Zero();     ///< animated translation
};

struct FbxFile {
  std::vector<FbxNode> nodes;
  int keys = 0;
  int up_axis = 1;
  double unit_cm = 1.0;
  std::string settings;  ///< further global settings
};

std::string vector_property(const char* name, const Vector3d& v) {
  return fmt::format("P: \"{}\", \"Vector3D\", \"Vector\", \"\",{},{},{}\n", name, v.x(), v.y(),
                     v.z());
}

/// FBX 7.4 in ASCII.
std::string to_fbx(const FbxFile& file) {
  std::string out = fmt::format(
      "; FBX 7.4.0 project file\nFBXHeaderExtension: {{\nFBXHeaderVersion: 1003\n"
      "FBXVersion: 7400\n}}\nGlobalSettings: {{\nVersion: 1000\nProperties70: {{\n"
      "P: \"UpAxis\", \"int\", \"Integer\", \"\",{}\nP: \"UpAxisSign\", \"int\", \"Integer\", "
      "\"\",1\nP: \"UnitScaleFactor\", \"double\", \"Number\", \"\",{}\n"
      "P: \"TimeMode\", \"enum\", \"\", \"\",6\n{}}}\n}}\nObjects: {{\n",
      file.up_axis, file.unit_cm, file.settings);
  std::string links = "Connections: {\n";
  const auto connect = [&](int child, int parent) {
    links += fmt::format("C: \"OO\",{},{}\n", child, parent);
  };
  const auto connect_property = [&](int child, int parent, const std::string& property) {
    links += fmt::format("C: \"OP\",{},{}, \"{}\"\n", child, parent, property);
  };
  int id = 100000;
  const int stack = id++, layer = id++;
  for (std::size_t n = 0; n < file.nodes.size(); ++n) {
    const FbxNode& node = file.nodes[n];
    const int model = 1000 + static_cast<int>(n);
    out += fmt::format(
        "Model: {}, \"Model::{}\", \"LimbNode\" {{\nVersion: 232\n"
        "Properties70: {{\nP: \"RotationActive\", \"bool\", \"\", \"\",1\n",
        model, node.name);
    out += vector_property("RotationOffset", node.rotation_offset);
    out += vector_property("RotationPivot", node.rotation_pivot);
    out += vector_property("PreRotation", node.pre_deg);
    out += vector_property("PostRotation", node.post_deg);
    out += vector_property("Lcl Translation", node.translation);
    out += vector_property("Lcl Rotation", node.rotation_deg);
    out += "}\n}\n";
    connect(model, node.parent < 0 ? 0 : 1000 + node.parent);
    for (const bool turn : {true, false}) {
      const Vector3d& rate = turn ? node.turn_deg_per_key : node.slide_per_key;
      const Vector3d& start = turn ? node.rotation_deg : node.translation;
      if (rate.isZero() || file.keys == 0) continue;
      const int curve_node = id++;
      out += fmt::format("AnimationCurveNode: {}, \"AnimCurveNode::{}\", \"\" {{\n}}\n", curve_node,
                         turn ? "R" : "T");
      connect(curve_node, layer);
      connect_property(curve_node, model, turn ? "Lcl Rotation" : "Lcl Translation");
      for (int k = 0; k < 3; ++k) {
        std::string times, values;
        for (int key = 0; key < file.keys; ++key) {
          const char* comma = key == 0 ? "" : ",";
          times += fmt::format("{}{}", comma, key * kTicksPerSecond / 30);
          values += fmt::format("{}{}", comma, start[k] + key * rate[k]);
        }
        const int curve = id++;
        out += fmt::format(
            "AnimationCurve: {}, \"AnimCurve::\", \"\" {{\nDefault: 0\n"
            "KeyVer: 4008\nKeyTime: *{} {{\na: {}\n}}\n"
            "KeyValueFloat: *{} {{\na: {}\n}}\n}}\n",
            curve, file.keys, times, file.keys, values);
        connect_property(curve, curve_node, std::string("d|") + "XYZ"[k]);
      }
    }
  }
  if (file.keys > 0) {
    const long long stop = (file.keys - 1) * kTicksPerSecond / 30;
    out += fmt::format(
        "AnimationStack: {}, \"AnimStack::Take 001\", \"\" {{\nProperties70: {{\n"
        "P: \"LocalStart\", \"KTime\", \"Time\", \"\",0\n"
        "P: \"LocalStop\", \"KTime\", \"Time\", \"\",{}\n}}\n}}\n"
        "AnimationLayer: {}, \"AnimLayer::Base\", \"\" {{\n}}\n",
        stack, stop, layer);
    connect(layer, stack);
  }
  return out + "}\n" + links + "}\n";
}

Eigen::Quaterniond euler_xyz(const Vector3d& deg) {
  return Eigen::AngleAxisd(deg.z() * kDegree, Vector3d::UnitZ()) *
         Eigen::AngleAxisd(deg.y() * kDegree, Vector3d::UnitY()) *
         Eigen::AngleAxisd(deg.x() * kDegree, Vector3d::UnitX());
}

/// T Roff Rp Rpre R Rpost^-1 Rp^-1 (FBX SDK, "Computing transformation matrices"; no scale).
DualQuaternion fbx_local(const FbxNode& n, int key) {
  const auto t = [](const Vector3d& v) { return DualQuaternion::from_translation(v); };
  const auto r = [](const Eigen::Quaterniond& q) { return DualQuaternion::from_rotation(q); };
  return t(n.translation + key * n.slide_per_key) * t(n.rotation_offset) * t(n.rotation_pivot) *
         r(euler_xyz(n.pre_deg)) * r(euler_xyz(n.rotation_deg + key * n.turn_deg_per_key)) *
         r(euler_xyz(n.post_deg).conjugate()) * t(-n.rotation_pivot);
}

FbxFile arm_with_pivots() {
  FbxFile file;
  file.keys = 5;
  file.nodes.push_back({.name = "hips", .translation = {0, 100, 0}, .slide_per_key = {1, 0, 2}});
  file.nodes.push_back({.name = "spine",
                        .parent = 0,
                        .translation = {0, 20, 1},
                        .rotation_deg = {5, 10, 15},
                        .pre_deg = {30, -20, 10},
                        .turn_deg_per_key = {2, -3, 4}});
  file.nodes.push_back({.name = "post",
                        .parent = 1,
                        .translation = {0, 30, 0},
                        .rotation_deg = {0, 20, 0},
                        .pre_deg = {10, 20, 30},
                        .post_deg = {0, 40, 10},
                        .turn_deg_per_key = {0, 5, 1}});
  file.nodes.push_back({.name = "pivoted",
                        .parent = 2,
                        .translation = {15, 0, 0},
                        .rotation_deg = {0, 0, 10},
                        .pre_deg = {0, 15, 0},
                        .rotation_pivot = {2, 3, -1},
                        .rotation_offset = {0.5, 0, 1},
                        .turn_deg_per_key = {3, 0, 6}});
  file.nodes.push_back({.name = "still",
                        .parent = 3,
                        .translation = {12, 0, 0},
                        .pre_deg = {0, 0, 45},
                        .rotation_pivot = {1, 0, 0}});
  file.nodes.push_back(
      {.name = "tip", .parent = 4, .translation = {8, 1, 0}, .turn_deg_per_key = {1, 1, 1}});
  return file;
}

void expect_fbx_motion(const FbxFile& file, const Imported& imported, double unit_m,
                       const Eigen::Quaterniond& turn) {
  const Skeleton& skeleton = imported.character.skeleton;
  ASSERT_EQ(imported.clips.size(), 1U);
  const Clip& clip = imported.clips[0];
  ASSERT_EQ(clip.frames(), file.keys);
  EXPECT_EQ(clip.rate_hz, 30.0);
  ASSERT_EQ(skeleton.size(), static_cast<int>(file.nodes.size()));
  std::vector<DualQuaternion> model(skeleton.parents.size()), expected(file.nodes.size());
  for (int key = 0; key < file.keys; ++key) {
    model_from_local(skeleton, clip.frame(key), model);
    for (std::size_t n = 0; n < file.nodes.size(); ++n) {
      const int parent = file.nodes[n].parent;
      expected[n] = parent < 0 ? fbx_local(file.nodes[n], key)
                               : expected[parent] * fbx_local(file.nodes[n], key);
      const std::int32_t j = skeleton.find(file.nodes[n].name);
      ASSERT_NE(j, kNoJoint) << file.nodes[n].name;
      const Vector3d place = turn * (unit_m * expected[n].translation());
      EXPECT_LT((model[j].translation() - place).norm(), 2e-4 * unit_m)
          << file.nodes[n].name << key;
      EXPECT_LT(rotation_angle<double>(model[j].rotation(), turn * expected[n].rotation()), 3e-6)
          << file.nodes[n].name << " at key " << key;
    }
  }
}

TEST(AssimpFbx, PivotsPreAndPostRotationsFollowTheFormula) {
  const FbxFile file = arm_with_pivots();
  const auto imported = read_text(to_fbx(file), "fbx");
  ASSERT_TRUE(imported.ok()) << imported.error().code << ": " << imported.error().message;
  expect_fbx_motion(file, *imported, 0.01, Eigen::Quaterniond::Identity());
  for (const std::string& name : imported->character.skeleton.names) {
    EXPECT_EQ(name.find("AssimpFbx"), std::string::npos) << "a helper became a joint";
  }
}

TEST(AssimpFbx, UnitAndUpAxisAreApplied) {
  FbxFile file = arm_with_pivots();
  file.up_axis = 2;
  file.unit_cm = 2.54;
  const auto imported = read_text(to_fbx(file), "fbx");
  ASSERT_TRUE(imported.ok()) << imported.error().message;
  const Eigen::Quaterniond upright(Eigen::AngleAxisd(-M_PI / 2, Vector3d::UnitX()));
  expect_fbx_motion(file, *imported, 0.0254, upright);
  EXPECT_EQ(imported->facts.up, "+Z");
  EXPECT_NEAR(imported->facts.unit_m, 0.0254, 1e-9);

  ImportOptions given;
  given.unit_m = 0.5;
  given.up = 'y';
  const auto overridden = read_text(to_fbx(file), "fbx", given);
  ASSERT_TRUE(overridden.ok());
  expect_fbx_motion(file, *overridden, 0.5, Eigen::Quaterniond::Identity());
}

std::string int_property(const char* name, int value) {
  return fmt::format("P: \"{}\", \"int\", \"Integer\", \"\",{}\n", name, value);
}

TEST(AssimpFbx, FrontIsWhereTheFileSaysItIs) {
  FbxFile file = arm_with_pivots();
  const auto axes = [](int left, int left_sign, int front, int front_sign) {
    return int_property("CoordAxis", left) + int_property("CoordAxisSign", left_sign) +
           int_property("FrontAxis", front) + int_property("FrontAxisSign", front_sign);
  };
  const auto about = [](const Vector3d& axis, double angle_rad) {
    return Eigen::Quaterniond(Eigen::AngleAxisd(angle_rad, axis));
  };
  const auto expect_turn = [&](const Eigen::Quaterniond& turn) {
    const auto imported = read_text(to_fbx(file), "fbx");
    ASSERT_TRUE(imported.ok()) << imported.error().message;
    expect_fbx_motion(file, *imported, 0.01, turn);
  };
  file.settings = axes(0, -1, 2, -1);  // -Z is to the front
  expect_turn(about(Vector3d::UnitY(), M_PI));
  file.settings = axes(2, -1, 0, 1);  // +X is
  expect_turn(about(Vector3d::UnitY(), -M_PI / 2));
  file.settings = axes(0, 1, 2, -1);  // a left-handed space: the up axis alone is believed
  expect_turn(Eigen::Quaterniond::Identity());
}

TEST(AssimpFbx, RestPoseIsTheStaticTransform) {
  FbxFile file = arm_with_pivots();
  file.keys = 0;
  const auto imported = read_text(to_fbx(file), "fbx");
  ASSERT_TRUE(imported.ok()) << imported.error().message;
  const Skeleton& skeleton = imported->character.skeleton;
  for (const FbxNode& node : file.nodes) {
    const std::int32_t j = skeleton.find(node.name);
    ASSERT_NE(j, kNoJoint);
    const DualQuaternion expected = fbx_local(node, 0);
    const DualQuaternion& rest = skeleton.rest_parent_from_joint[j];
    EXPECT_LT((rest.translation() - 0.01 * expected.translation()).norm(), 1e-6) << node.name;
    EXPECT_LT(rotation_angle(rest.rotation(), expected.rotation()), 1e-6) << node.name;
  }
}

TEST(AssimpFbx, AnAbsurdUnitIsGuessedWithAWarning) {
  FbxFile file;  // a person 1,700 units high: 17 m if they were centimetres
  const auto add = [&](const char* name, int parent, Vector3d at) {
    file.nodes.push_back({.name = name, .parent = parent, .translation = at});
  };
  add("Hips", -1, {0, 950, 0});
  add("Spine", 0, {0, 250, 0});
  add("Head", 1, {0, 350, 0});
  add("LeftUpLeg", 0, {90, -50, 0});
  add("LeftLeg", 3, {0, -420, 0});
  add("LeftFoot", 4, {0, -410, 0});
  add("RightUpLeg", 0, {-90, -50, 0});
  add("RightLeg", 6, {0, -420, 0});
  add("RightFoot", 7, {0, -410, 0});
  const auto imported = read_text(to_fbx(file), "fbx");
  ASSERT_TRUE(imported.ok()) << imported.error().message;
  EXPECT_TRUE(has_warning(*imported, "unit-guessed"));
  EXPECT_NEAR(imported->facts.unit_m, 0.001, 1e-9);
  const auto& rest = imported->character.skeleton.rest_parent_from_joint;
  EXPECT_NEAR(rest[0].translation().y(), 0.95, 1e-6);
}

TEST(AssimpFbx, OldAndBrokenFilesAreRefusedWithACode) {
  const auto code = [](std::string_view text) {
    const auto r = read_text(text, "fbx");
    return r.ok() ? std::string("ok") : r.error().code;
  };
  EXPECT_EQ(code("; FBX 6.1.0 project file\nFBXHeaderExtension:  {\nFBXVersion: 6100\n}\n"),
            "fbx-version-unsupported");
  std::string binary = "Kaydara FBX Binary  ";
  binary += std::string("\0\x1a\0", 3);
  binary += std::string("\x70\x17\0\0", 4);  // 6000
  EXPECT_EQ(code(binary + std::string(100, '\0')), "fbx-version-unsupported");
  EXPECT_EQ(code("hello"), "assimp-rejected");
  EXPECT_EQ(code(to_fbx({})), "no-skeleton");
}

// ---- Collada

/// Two joints along Z (the file's up), a skin with broken weights, inches.
std::string collada() {
  return R"(<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="inch" meter="0.0254"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g" name="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 0 0 10 0 0 20</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="2"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2 1 3 2</p></triangles>
</mesh></geometry></library_geometries>
<library_controllers><controller id="c"><skin source="#g">
<bind_shape_matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</bind_shape_matrix>
<source id="j"><Name_array id="ja" count="2">a b</Name_array><technique_common>
<accessor source="#ja" count="2"><param name="JOINT" type="name"/></accessor></technique_common></source>
<source id="m"><float_array id="ma" count="32">1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
1 0 0 0 0 1 0 0 0 0 1 -10 0 0 0 1</float_array><technique_common>
<accessor source="#ma" count="2" stride="16"><param name="TRANSFORM" type="float4x4"/></accessor>
</technique_common></source>
<source id="w"><float_array id="wa" count="3">1 0.5 0</float_array><technique_common>
<accessor source="#wa" count="3"><param name="WEIGHT" type="float"/></accessor></technique_common></source>
<joints><input semantic="JOINT" source="#j"/><input semantic="INV_BIND_MATRIX" source="#m"/></joints>
<vertex_weights count="4"><input semantic="JOINT" source="#j" offset="0"/>
<input semantic="WEIGHT" source="#w" offset="1"/><vcount>1 1 2 1</vcount>
<v>0 0 0 2 0 1 1 0 1 1</v></vertex_weights></skin></controller></library_controllers>
<library_visual_scenes><visual_scene id="s">
<node id="a" sid="a" name="a" type="JOINT"><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
<node id="b" sid="b" name="b" type="JOINT"><matrix>0 0 1 0 0 1 0 0 -1 0 0 10 0 0 0 1</matrix></node>
</node>
<node id="n" name="n"><instance_controller url="#c"><skeleton>#a</skeleton></instance_controller></node>
</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>)";
}

TEST(AssimpCollada, UnitsUpAxisBindPoseAndWeights) {
  const auto imported = read_text(collada(), "dae");
  ASSERT_TRUE(imported.ok()) << imported.error().code << ": " << imported.error().message;
  const Character& character = imported->character;
  EXPECT_NEAR(imported->facts.unit_m, 0.0254, 1e-9);
  EXPECT_EQ(imported->facts.up, "+Z");
  ASSERT_EQ(character.skeleton.size(), 2);
  const std::int32_t b = character.skeleton.find("b");
  std::vector<DualQuaternion> rest(2);
  model_from_local(character.skeleton, character.skeleton.rest_parent_from_joint, rest);
  EXPECT_LT((rest[b].translation() - Vector3d(0, 0.254, 0)).norm(), 1e-6);
  // The node of b is turned by 90 degrees, its bind matrix is not: rest is not bind.
  ASSERT_EQ(character.bind_model_from_joint.size(), 2U);
  EXPECT_NEAR(rotation_angle(rest[b].rotation(), character.bind_model_from_joint[b].rotation()),
              M_PI / 2, 1e-5);
  ASSERT_EQ(character.meshes.size(), 1U);
  const Mesh& mesh = character.meshes[0];
  EXPECT_TRUE(has_warning(*imported, "weights-normalised"));
  EXPECT_TRUE(has_warning(*imported, "weights-missing"));
  for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
    float sum = 0.0F;
    for (auto i = mesh.influence_begin[v]; i < mesh.influence_begin[v + 1]; ++i) {
      sum += mesh.influences[i].weight;
    }
    EXPECT_NEAR(sum, 1.0F, 1e-6F);
  }
  // At rest the vertex on b's origin stays there; the one 10 inches beyond is swung to +X.
  std::vector<Eigen::Vector3f> posed(mesh.positions.size());
  skin_positions(mesh, rest, posed);
  for (std::size_t v = 0; v < posed.size(); ++v) {
    if (mesh.positions[v].z() != 20.0F) continue;
    EXPECT_LT((posed[v].cast<double>() - Vector3d(0.254, 0.254, 0)).norm(), 1e-6);
  }
}

// ---- confinement

TEST(Assimp, FilesAreReadThroughTheResolverAlone) {
  std::vector<std::string> asked;
  const UriResolver resolver = [&](std::string_view uri) -> Result<std::vector<std::byte>> {
    asked.emplace_back(uri);
    return Error{"uri-refused", "no"};
  };
  const char* gltf = R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
    "nodes": [{"name": "a", "mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    "buffers": [{"uri": "/etc/hostname", "byteLength": 36}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}]})";
  const auto imported = import_with_assimp(bytes_of(gltf), "gltf", resolver, {});
  EXPECT_FALSE(imported.ok());
  ASSERT_FALSE(asked.empty());
  for (const std::string& uri : asked) EXPECT_NE(uri.find("hostname"), std::string::npos);
}

TEST(Assimp, ContentIsNotSniffedForOtherFormats) {
  const char* obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
  for (const char* extension : {"fbx", "dae", "bvh", "glb", "gltf"}) {
    const auto r = read_text(obj, extension);
    ASSERT_FALSE(r.ok()) << extension;
    EXPECT_EQ(r.error().code, "assimp-rejected") << extension;
  }
}

// ---- against our exact readers

/// Largest distance of joints of one name over up to 50 frames, and how many were compared.
std::pair<double, int> difference(const Imported& a, const Imported& b) {
  const Skeleton &s = a.character.skeleton, &t = b.character.skeleton;
  std::vector<DualQuaternion> model_s(s.parents.size()), model_t(t.parents.size());
  double worst = 0.0;
  int compared = 0;
  const std::int64_t frames = std::min(a.clips[0].frames(), b.clips[0].frames());
  for (std::int64_t f = 0; f < frames; f += std::max<std::int64_t>(1, frames / 50)) {
    model_from_local(s, a.clips[0].frame(f), model_s);
    model_from_local(t, b.clips[0].frame(f), model_t);
    compared = 0;
    for (std::int32_t j = 0; j < s.size(); ++j) {
      const std::int32_t k = t.find(s.names[j]);
      if (k == kNoJoint) continue;
      ++compared;
      worst = std::max(worst, (model_s[j].translation() - model_t[k].translation()).norm());
    }
  }
  return {worst, compared};
}

TEST(Assimp, SharedGlbClipsAgreeWithTheExactReader) {
  LIMBER_NEEDS_SHARED(data);
  for (const char* name :
       {"mocap_other/viverse_idle_53j.glb", "mocap_other/viverse_roll_fingers.glb",
        "mocap_other/viverse_walk_53j.glb"}) {
    SCOPED_TRACE(name);
    ImportOptions with_assimp;
    with_assimp.reader = ReaderChoice::assimp;
    const auto own = import_file(*data / name);
    const auto other = import_file(*data / name, with_assimp);
    ASSERT_TRUE(own.ok() && other.ok());
    ASSERT_EQ(own->clips.size(), other->clips.size());
    EXPECT_EQ(own->clips[0].frames(), other->clips[0].frames());
    const auto [worst, compared] = difference(*own, *other);
    EXPECT_LT(worst, 1e-4);
    EXPECT_GT(compared, 40);
  }
}

TEST(Assimp, SharedFiguresStandUprightAtHumanSize) {
  LIMBER_NEEDS_SHARED(data);
  for (const char* name : {"ozz_arnaud.fbx", "quaternius_male_casual.fbx",
                           "genea_tpose_fingers.fbx", "gazebo_walk.dae"}) {
    SCOPED_TRACE(name);
    const auto imported = import_file(*data / "characters" / name);
    ASSERT_TRUE(imported.ok()) << imported.error().message;
    const Character& character = imported->character;
    Eigen::Vector3f low = Eigen::Vector3f::Constant(1e9F), high = -low;
    for (const Mesh& mesh : character.meshes) {
      std::vector<Eigen::Vector3f> posed(mesh.positions.size());
      skin_positions(mesh, character.bind_model_from_joint, posed);
      for (const Eigen::Vector3f& p : posed) {
        low = low.cwiseMin(p);
        high = high.cwiseMax(p);
      }
    }
    const Eigen::Vector3f size = high - low;  // a T-pose: as wide as high, and thin
    EXPECT_GT(size.y(), 1.4F);
    EXPECT_LT(size.y(), 2.1F);
    EXPECT_GT(size.x(), 1.2F);
    EXPECT_LT(size.z(), 0.6F);
  }
}

}  // namespace
}  // namespace limber::test
