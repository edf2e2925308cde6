// The strict rig parser: the rigs of the benchmark load, and every mistake names its place.

#include "importers/rig_json.h"

#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/importers/support.h"

namespace limber::test {
namespace {

using nlohmann::json;

json small_rig() {
  return {
      {"format", "ikrig/1"},
      {"name", "two"},
      {"ndof", 4},
      {"citations", {{"AAOS", "American Academy of Orthopaedic Surgeons 1965"}}},
      {"joints",
       {{{"name", "shoulder"},
         {"role", "leftUpperArm"},
         {"parent", -1},
         {"type", "ball"},
         {"offset", {0, 1, 0}},
         {"rest", {1, 0, 0, 0}},
         {"axes", {{0, 0, 1}, {0, -1, 0}, {1, 0, 0}}},
         {"limits", {{-9, 9}, {-9, 9}, {-9, 9}}},
         {"twist_swing", {{"swing0", {-1, 2}}, {"swing1", {-0.5, 0.5}}, {"twist", {-0.3, 0.4}}}},
         {"capsule", {{"from", {0, 0, 0}}, {"to", {0.3, 0, 0}}, {"radius", 0.05}}},
         {"citation", "AAOS"}},
        {{"name", "elbow"},
         {"parent", 0},
         {"type", "hinge"},
         {"offset", {0.3, 0, 0}},
         {"axes", {{0, -1, 0}}},
         {"limits", {{0, 2.5}}},
         {"dof_index", 3}}}},
      {"effectors",
       {{{"name", "hand"},
         {"joint", 1},
         {"offset", {0.3, 0, 0}},
         {"kind", "line"},
         {"axis", {1, 0, 0}}}}},
      {"couplings",
       {{{"from_joint", 1}, {"from_dof", 0}, {"to_joint", 0}, {"to_dof", 2}, {"ratio", 0.5}}}}};
}

TEST(RigJson, ReadsEveryField) {
  const auto rig = read_rig_json(small_rig().dump());
  ASSERT_TRUE(rig) << rig.error().message;
  ASSERT_EQ(rig->size(), 2);
  const RigJoint& shoulder = rig->joints[0];
  EXPECT_EQ(shoulder.role, "leftUpperArm");
  EXPECT_EQ(shoulder.limits[0].max, 2.0);  // from twist_swing, not from limits
  EXPECT_EQ(shoulder.limits[2].min, -0.3);
  ASSERT_EQ(shoulder.capsules.size(), 1u);
  EXPECT_EQ(shoulder.capsules[0].radius, 0.05);
  EXPECT_EQ(shoulder.citation, "American Academy of Orthopaedic Surgeons 1965");
  EXPECT_EQ(rig->joints[1].limits[0].max, 2.5);
  EXPECT_EQ(rig->effectors[0].kind, EffectorKind::line);
  EXPECT_EQ(rig->couplings[0].ratio, 0.5);
  EXPECT_EQ(rig->couplings[0].to_dof, 2);
}

TEST(RigJson, ReadsWhatJoinsBranches) {
  json doc = small_rig();
  doc["joints"][1]["weight"] = 3.0;
  doc["joints"][1]["max_speed"] = 4.0;
  doc["effectors"][0]["relative_to"] = 0;
  doc["effectors"][0]["priority"] = 1;
  doc["collisions"] = {{0, "elbow"}};
  const auto rig = read_rig_json(doc.dump());
  ASSERT_TRUE(rig) << rig.error().message;
  EXPECT_EQ(rig->joints[1].weight, 3.0);
  EXPECT_EQ(rig->joints[1].max_speed, 4.0);
  EXPECT_EQ(rig->effectors[0].relative_to, 0);
  EXPECT_EQ(rig->effectors[0].priority, 1);
  ASSERT_EQ(rig->collisions.size(), 1u);
  EXPECT_EQ(rig->collisions[0].joint_b, 1);
}

TEST(RigJson, WithoutLimitsAJointIsUnlimited) {
  json doc = small_rig();
  doc["joints"][0].erase("twist_swing");  // its limits box does not bind
  doc.erase("couplings");                 // a ball without limits has no coordinate to couple
  doc["joints"][1]["limits"] = nullptr;
  const auto rig = read_rig_json(doc.dump());
  ASSERT_TRUE(rig) << rig.error().message;
  EXPECT_FALSE(rig->joints[0].limited());
  EXPECT_FALSE(rig->joints[1].limited());
}

TEST(RigJson, MistakesNameTheirPlace) {
  const auto complaint = [](auto&& change) {
    json doc = small_rig();
    change(doc);
    const auto rig = read_rig_json(doc.dump());
    EXPECT_FALSE(rig);
    if (rig) return std::string();
    EXPECT_EQ(rig.error().code, "rig-json");
    return rig.error().message.substr(0, rig.error().message.find(": "));
  };
  EXPECT_EQ(complaint([](json& d) { d["format"] = "ikrig/2"; }), "/format");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["offest"] = 1; }), "/joints/1");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["parent"] = 1; }), "/joints/1/parent");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["type"] = "screw"; }), "/joints/1/type");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["offset"] = {0, 1}; }), "/joints/1/offset");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["offset"][2] = "a"; }), "/joints/1/offset/2");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["axes"] = {{1, 1, 0}}; }), "/joints/1/axes/0");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["limits"] = {{2, 1}}; }), "/joints/1/limits/0");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["name"] = "shoulder"; }), "/joints/1/name");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["dof_index"] = 2; }), "/joints/1/dof_index");
  EXPECT_EQ(complaint([](json& d) { d["joints"][0]["axes"][2] = {-1, 0, 0}; }), "/joints/0");
  EXPECT_EQ(complaint([](json& d) { d["joints"][0]["capsule"]["radius"] = 0; }),
            "/joints/0/capsule/radius");
  EXPECT_EQ(complaint([](json& d) { d["joints"][1]["twist_swing"] = json::object(); }),
            "/joints/1/twist_swing");
  EXPECT_EQ(complaint([](json& d) { d["effectors"][0]["joint"] = 2; }), "/effectors/0/joint");
  EXPECT_EQ(complaint([](json& d) { d["effectors"][0].erase("axis"); }), "/effectors/0");
  EXPECT_EQ(complaint([](json& d) { d["effectors"][0]["strong"] = 1; }), "/effectors/0/strong");
  EXPECT_EQ(complaint([](json& d) { d["couplings"][0]["to_dof"] = 3; }), "/couplings/0/to_dof");
  EXPECT_EQ(complaint([](json& d) { d["joints"][0].erase("twist_swing"); }), "/couplings/0");
  EXPECT_EQ(complaint([](json& d) { d["joints"][0]["weight"] = 0; }), "/joints/0/weight");
  EXPECT_EQ(complaint([](json& d) { d["joints"][0]["max_speed"] = -1; }), "/joints/0/max_speed");
  EXPECT_EQ(complaint([](json& d) { d["effectors"][0]["relative_to"] = 1; }),
            "/effectors/0/relative_to");
  EXPECT_EQ(complaint([](json& d) { d["effectors"][0]["priority"] = -1; }),
            "/effectors/0/priority");
  EXPECT_EQ(complaint([](json& d) { d["collisions"] = {{1, 1}}; }), "/collisions/0");
  EXPECT_EQ(complaint([](json& d) { d["ndof"] = 5; }), "/ndof");
}

TEST(RigJson, BrokenTextNamesItsLine) {
  const auto cut = read_rig_json("{\n \"format\": \"ikrig/1\",\n \"name\" \"x\"}");
  ASSERT_FALSE(cut);
  EXPECT_NE(cut.error().message.find("line 3"), std::string::npos) << cut.error().message;
  EXPECT_FALSE(read_rig_json(R"({"format":"ikrig/1","format":"ikrig/1"})"));
  EXPECT_FALSE(read_rig_json(std::string(100000, '{')));
  EXPECT_FALSE(read_rig_json(""));
}

TEST(RigJson, BenchmarkRigsLoadWithTheirDegreesOfFreedom) {
  LIMBER_NEEDS_SHARED(data);
  for (const auto& [name, dof] :
       {std::pair("arm4", 4), {"arm7", 7}, {"hand22", 22}, {"biped53", 53}, {"bodyhands99", 99}}) {
    std::ifstream in(*data / ".." / "workloads" / "rigs" / (std::string(name) + ".json"));
    std::stringstream text;
    text << in.rdbuf();
    const auto rig = read_rig_json(text.str());
    ASSERT_TRUE(rig) << name << rig.error().message;
    EXPECT_EQ(dof_count(*rig), dof);
  }
}

}  // namespace
}  // namespace limber::test
