// The mannequin of any rig is a valid, closed, outward surface that follows the rig.

#include "assets/model/mannequin.h"

#include <gtest/gtest.h>

#include <map>

#include "importers/rig_json.h"
#include "tests/exporters/support.h"

namespace limber::test {
namespace {

std::vector<Rig> shipped_rigs() {
  std::vector<Rig> rigs;
  for (const char* name :
       {"hand", "biped", "biped-foot-root", "biped-full", "biped-hands", "arm2", "arm3"}) {
    auto rig = read_rig_json(read_text(std::filesystem::path(LIMBER_SOURCE_DIR) /
                                       "assets/data/rigs" / (std::string(name) + ".json")));
    EXPECT_TRUE(rig.ok()) << name;
    if (rig) rigs.push_back(std::move(*rig));
  }
  return rigs;
}

TEST(Mannequin, IsValidAndOfModestSize) {
  for (const Rig& rig : shipped_rigs()) {
    const Character character = mannequin(rig);
    ASSERT_TRUE(validate(character).ok()) << validate(character).error().message;
    std::size_t triangles = 0;
    for (const Mesh& mesh : character.meshes) triangles += mesh.triangles.size() / 3;
    EXPECT_GT(triangles, 500U) << rig.name;
    EXPECT_LT(triangles, 25000U) << rig.name;
    EXPECT_EQ(character.roles[0], rig.joints[0].role);
  }
}

TEST(Mannequin, SurfaceIsClosedAndFacesOutward) {
  for (const Rig& rig : shipped_rigs()) {
    for (const Mesh& mesh : mannequin(rig).meshes) {
      // Closed: every directed edge has its opposite as often. Outward: positive volume, and the
      // vertex normals agree with the faces.
      std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
      double volume = 0.0;
      std::size_t against = 0;
      for (std::size_t t = 0; t < mesh.triangles.size(); t += 3) {
        Eigen::Vector3d p[3];
        for (int k = 0; k < 3; ++k) {
          const std::uint32_t a = mesh.triangles[t + k], b = mesh.triangles[t + (k + 1) % 3];
          ++edges[{a, b}];
          p[k] = mesh.positions[a].cast<double>();
        }
        volume += p[0].dot(p[1].cross(p[2])) / 6.0;
        const Eigen::Vector3d face = (p[1] - p[0]).cross(p[2] - p[0]);
        against += face.dot(mesh.normals[mesh.triangles[t]].cast<double>()) < 0.0 ? 1 : 0;
      }
      for (const auto& [edge, count] : edges) {
        const auto back = edges.find({edge.second, edge.first});
        ASSERT_TRUE(back != edges.end() && back->second == count) << mesh.name;
      }
      EXPECT_GT(volume, 0.0) << mesh.name;
      EXPECT_LT(against, mesh.triangles.size() / 3 / 50) << mesh.name;
    }
  }
}

TEST(Mannequin, HandOfOneCapsuleHasItsVolume) {
  Rig rig;
  rig.name = "pill";
  RigJoint joint;
  joint.name = "only";
  joint.capsules = {{{0, 0, 0}, {0.3, 0, 0}, 0.1}};
  rig.joints = {joint};
  const Character character = mannequin(rig);
  ASSERT_EQ(character.meshes.size(), 1U);  // a fixed joint shows no ball
  const Mesh& mesh = character.meshes[0];
  double volume = 0.0;
  for (std::size_t t = 0; t < mesh.triangles.size(); t += 3) {
    const auto p = [&](int k) {
      return Eigen::Vector3d(mesh.positions[mesh.triangles[t + k]].cast<double>());
    };
    volume += p(0).dot(p(1).cross(p(2))) / 6.0;
  }
  // A cylinder and a ball; the chords of the triangles lose a few percent.
  const double exact = M_PI * 0.01 * 0.3 + 4.0 / 3.0 * M_PI * 0.001;
  EXPECT_LT(volume, exact);
  EXPECT_GT(volume, 0.93 * exact);
}

TEST(Mannequin, EveryMovingJointOfARigWithoutCapsulesIsDrawn) {
  Rig rig;
  rig.name = "stick";
  for (int i = 0; i < 3; ++i) {
    RigJoint joint;
    joint.name = "link" + std::to_string(i);
    joint.parent = i - 1;
    joint.type = JointType::hinge;
    joint.offset = i == 0 ? Eigen::Vector3d::Zero() : Eigen::Vector3d(0.2, 0, 0);
    rig.joints.push_back(joint);
  }
  const Character character = mannequin(rig);
  std::vector<int> vertices(3, 0);
  float reach = 0.0F;
  for (const Influence& i : character.meshes.at(0).influences) ++vertices[i.skin_joint];
  for (const Eigen::Vector3f& p : character.meshes[0].positions) reach = std::max(reach, p.x());
  for (const int n : vertices) EXPECT_GT(n, 20);
  EXPECT_GT(reach, 0.45F);  // the last link goes on beyond its joint at 0.4
}

}  // namespace
}  // namespace limber::test
