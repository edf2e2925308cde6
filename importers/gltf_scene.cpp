#include <fmt/format.h>

#include <Eigen/SVD>
#include <cmath>

#include "importers/failure.h"
#include "importers/gltf_document.h"

namespace limber::gltf {

namespace {

Eigen::Quaterniond read_rotation(const JsonView& view, Warnings& warnings) {
  view.array_of(4);
  const Eigen::Quaterniond q(view[3].number(), view[0].number(), view[1].number(),
                             view[2].number());
  const double norm = q.norm();
  if (!(norm > 1e-9)) view.complain("a rotation of length zero");
  if (std::abs(norm - 1.0) > 1e-3) {
    warnings.push_back({"rotation-not-unit",
                        fmt::format("{}: the length is {:.4g}; normalised", view.pointer(), norm)});
  }
  return q.normalized();
}

Eigen::Matrix4d read_matrix(const JsonView& view) {
  view.array_of(16);
  Eigen::Matrix4d m;
  for (Eigen::Index k = 0; k < 16; ++k) m(k % 4, k / 4) = view[std::size_t(k)].number();
  return m;
}

/// Matrix = T R S. What is left over (shear) is lost, with a warning.
void decompose(const Eigen::Matrix4d& m, const JsonView& view, Node& node, Warnings& warnings) {
  node.translation = m.topRightCorner<3, 1>();
  Eigen::Matrix3d basis = m.topLeftCorner<3, 3>();
  node.scale = basis.colwise().norm();
  if (basis.determinant() < 0.0) node.scale = -node.scale;
  if (!(node.scale.cwiseAbs().minCoeff() > 0.0)) {
    node.rotation = Eigen::Quaterniond::Identity();
    return;
  }
  for (int k = 0; k < 3; ++k) basis.col(k) /= node.scale[k];
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(basis, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d rotation = svd.matrixU() * svd.matrixV().transpose();
  if ((rotation - basis).norm() > 1e-3) {
    warnings.push_back({"gltf-shear",
                        fmt::format("{}: the matrix shears; only its rotation and "
                                    "scale were kept",
                                    view.pointer()),
                        node.name});
  }
  node.rotation = Eigen::Quaterniond(rotation).normalized();
}

Node read_node(const Document& document, std::size_t index, Warnings& warnings) {
  const JsonView view = document.item("nodes", static_cast<std::int64_t>(index));
  Node node;
  if (const auto name = view.find("name")) node.name = name->string();
  node.mesh = document.index_of(view, "mesh", "meshes");
  node.skin = document.index_of(view, "skin", "skins");
  if (const auto matrix = view.find("matrix")) {
    if (view.has("translation") || view.has("rotation") || view.has("scale")) {
      warnings.push_back(
          {"gltf-matrix-and-trs",
           fmt::format("{}: both a matrix and TRS; the matrix was taken", view.pointer()),
           node.name});
    }
    decompose(read_matrix(*matrix), *matrix, node, warnings);
  } else {
    if (const auto t = view.find("translation")) node.translation = t->vector3();
    if (const auto r = view.find("rotation")) node.rotation = read_rotation(*r, warnings);
    if (const auto s = view.find("scale")) node.scale = s->vector3();
  }
  if (node.scale.cwiseAbs().minCoeff() < 1e-9) {
    node.scale = (node.scale.array().abs() < 1e-9).select(Eigen::Array3d::Ones(), node.scale);
    warnings.push_back({"scale-zero",
                        fmt::format("{}: a scale of zero was taken as one", view.pointer()),
                        node.name});
  }
  return node;
}

void link_children(const Document& document, std::vector<Node>& nodes) {
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const JsonView view = document.item("nodes", static_cast<std::int64_t>(i));
    const auto children = view.find("children");
    for (std::size_t c = 0; children && c < children->array().size(); ++c) {
      const auto child = static_cast<std::int32_t>(
          (*children)[c].integer(0, static_cast<std::int64_t>(nodes.size()) - 1));
      if (nodes[child].parent >= 0 || child == static_cast<std::int32_t>(i)) {
        fail("gltf-node-cycle",
             fmt::format("{}: node {} has two parents", (*children)[c].pointer(), child),
             "the node hierarchy must be a tree: export the file again");
      }
      nodes[child].parent = static_cast<std::int32_t>(i);
      nodes[i].children.push_back(child);
    }
  }
  // With one parent each, whatever no root reaches runs in a circle.
  std::vector<std::int32_t> reached;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    if (nodes[i].parent < 0) reached.push_back(static_cast<std::int32_t>(i));
  }
  for (std::size_t k = 0; k < reached.size(); ++k) {
    const auto& children = nodes[reached[k]].children;
    reached.insert(reached.end(), children.begin(), children.end());
  }
  if (reached.size() != nodes.size()) {
    fail("gltf-node-cycle", "/nodes: some nodes are their own ancestors",
         "the node hierarchy must be a tree: export the file again");
  }
}

Skin read_skin(Document& document, std::size_t index, std::size_t nodes) {
  const JsonView view = document.item("skins", static_cast<std::int64_t>(index));
  const JsonView joints = view.at("joints");
  if (joints.array().size() == 0) joints.complain("a skin needs joints");
  Skin skin;
  for (std::size_t i = 0; i < joints.size(); ++i) {
    const auto joint = joints[i].integer(0, static_cast<std::int64_t>(nodes) - 1);
    skin.joints.push_back(static_cast<std::int32_t>(joint));
  }
  const std::int64_t binds = document.index_of(view, "inverseBindMatrices", "accessors");
  if (binds < 0) return skin;
  const Accessor& matrices = document.accessor(binds, {"MAT4"});
  if (matrices.integers) view.complain("inverse bind matrices must be floats");
  if (matrices.count < skin.joints.size()) {
    view.complain(
        fmt::format("{} joints but {} inverse bind matrices", skin.joints.size(), matrices.count));
  }
  for (std::size_t i = 0; i < skin.joints.size(); ++i) {
    const Eigen::Matrix4d m = Eigen::Map<const Eigen::Matrix4d>(matrices.element(i).data());
    if (!(std::abs(m.topLeftCorner<3, 3>().determinant()) > 1e-30)) {
      view.complain(fmt::format("inverse bind matrix {} cannot be inverted", i));
    }
    skin.inverse_binds.push_back(m);
  }
  return skin;
}

/// Whether all joints are `top` or below it.
bool all_below(const Scene& scene, std::int32_t top, const std::vector<std::int32_t>& joints) {
  std::vector<std::uint8_t> below(scene.nodes.size(), 0);
  std::vector<std::int32_t> open = {top};
  while (!open.empty()) {
    const std::int32_t node = open.back();
    open.pop_back();
    below[node] = 1;
    open.insert(open.end(), scene.nodes[node].children.begin(), scene.nodes[node].children.end());
  }
  return std::all_of(joints.begin(), joints.end(), [&](std::int32_t j) { return below[j] != 0; });
}

/// glTF 2.0, section 3.7.3.2: a skin's joints have a common root, and `skeleton`, where it is
/// given, is that root or above it. We need neither; whoever wrote the file may have meant another.
void check_roots(const JsonView& view, const Scene& scene, const Skin& skin, std::int64_t skeleton,
                 Warnings& warnings) {
  std::int32_t root = skin.joints.front();
  while (scene.nodes[root].parent >= 0) root = scene.nodes[root].parent;
  if (!all_below(scene, root, skin.joints)) {
    warnings.push_back({"gltf-skin-roots", view.pointer() + ": the joints have no common root; "
                                                            "each tree was kept"});
  }
  if (skeleton >= 0 && !all_below(scene, static_cast<std::int32_t>(skeleton), skin.joints)) {
    warnings.push_back({"gltf-skin-roots",
                        fmt::format("{}: 'skeleton' is node {}, which is not above all joints; it "
                                    "was ignored",
                                    view.pointer(), skeleton)});
  }
}

/// VRM 0 names the thumb's joints one step further out than VRM 1.
std::string role_of_vrm0(const std::string& bone) {
  for (const char* side : {"left", "right"}) {
    const std::string s = side;
    if (bone == s + "ThumbProximal") return s + "ThumbMetacarpal";
    if (bone == s + "ThumbIntermediate") return s + "ThumbProximal";
  }
  return bone;
}

void read_vrm_roles(const Document& document, Scene& scene) {
  scene.vrm_roles.resize(scene.nodes.size());
  const auto extensions = document.root().find("extensions");
  if (!extensions || scene.nodes.empty()) return;
  const auto last = static_cast<std::int64_t>(scene.nodes.size()) - 1;
  for (const char* key : {"VRMC_vrm", "VRMC_vrm_animation"}) {
    const auto vrm = extensions->find(key);
    if (!vrm) continue;
    scene.is_vrm = true;
    const JsonView bones = vrm->at("humanoid").at("humanBones");
    for (const auto& [bone, unused] : bones.object().value().items()) {
      scene.vrm_roles[bones.at(bone.c_str()).at("node").integer(0, last)] = bone;
    }
    return;
  }
  const auto vrm = extensions->find("VRM");
  if (!vrm) return;
  scene.is_vrm = true;
  const JsonView bones = vrm->at("humanoid").at("humanBones");
  for (std::size_t i = 0; i < bones.array().size(); ++i) {
    const std::int64_t node = bones[i].at("node").integer(-1, last);
    if (node >= 0) scene.vrm_roles[node] = role_of_vrm0(bones[i].at("bone").string());
  }
}

}  // namespace

Scene read_scene(Document& document, Warnings& warnings) {
  Scene scene;
  const std::size_t total = document.count("nodes");
  if (total == 0) fail("gltf-empty", "the file has no nodes", "it holds nothing to animate");
  if (total > kMaxNodes) fail("gltf-size", fmt::format("more than {} nodes", kMaxNodes));
  for (std::size_t i = 0; i < total; ++i) scene.nodes.push_back(read_node(document, i, warnings));
  link_children(document, scene.nodes);
  for (std::size_t i = 0; i < document.count("skins"); ++i) {
    scene.skins.push_back(read_skin(document, i, total));
    const JsonView view = document.item("skins", static_cast<std::int64_t>(i));
    check_roots(view, scene, scene.skins.back(), document.index_of(view, "skeleton", "nodes"),
                warnings);
  }
  read_vrm_roles(document, scene);
  return scene;
}

Eigen::Matrix4d local_matrix(const Node& node) {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() = node.rotation.toRotationMatrix() * node.scale.asDiagonal();
  m.topRightCorner<3, 1>() = node.translation;
  return m;
}

}  // namespace limber::gltf
