#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "importers/failure.h"
#include "importers/gltf_document.h"

namespace limber::gltf {

namespace {

/// Vertices and indices of all primitives together; one accessor may be used by many.
constexpr std::size_t kMaxElements = std::size_t{1} << 26;

struct Losses {
  std::int64_t unnormalised = 0, weightless = 0;
  std::int64_t skipped_primitives = 0, skipped_meshes = 0;
  std::size_t elements = 0;

  void add_elements(std::size_t count) {
    elements += count;
    if (elements > kMaxElements) {
      fail("gltf-size", fmt::format("more than {} vertices and indices", kMaxElements),
           "the file asks for far more geometry than it holds");
    }
  }
};

template <class Vector>
std::vector<Vector> read_vectors(const Accessor& accessor) {
  constexpr std::size_t kSize = Vector::RowsAtCompileTime;
  std::vector<Vector> out(accessor.count);
  for (std::size_t i = 0; i < accessor.count; ++i) {
    for (std::size_t k = 0; k < kSize; ++k) {
      out[i][static_cast<Eigen::Index>(k)] = static_cast<float>(accessor.element(i)[k]);
    }
  }
  return out;
}

std::vector<std::uint32_t> read_indices(Document& document, const JsonView& primitive,
                                        std::size_t vertices) {
  std::vector<std::uint32_t> indices;
  const std::int64_t source = document.index_of(primitive, "indices", "accessors");
  if (source < 0) {
    for (std::size_t i = 0; i < vertices; ++i) indices.push_back(static_cast<std::uint32_t>(i));
    return indices;
  }
  const Accessor& accessor = document.accessor(source, {"SCALAR"});
  if (!accessor.integers) primitive.at("indices").complain("indices must be integers");
  indices.reserve(accessor.count);
  for (const double value : accessor.values) {
    if (!(value >= 0.0 && value < double(vertices))) {
      fail("gltf-accessor",
           fmt::format("{}: vertex {} of {}", primitive.at("indices").pointer(), value, vertices),
           "the file is damaged: export it again");
    }
    indices.push_back(static_cast<std::uint32_t>(value));
  }
  return indices;
}

/// Triangles of modes 4 (list), 5 (strip) and 6 (fan); degenerate ones are left out.
std::vector<std::uint32_t> to_triangles(const std::vector<std::uint32_t>& in, std::int64_t mode) {
  std::vector<std::uint32_t> out;
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (a != b && b != c && a != c) out.insert(out.end(), {a, b, c});
  };
  if (mode == 4) {
    for (std::size_t i = 0; i + 2 < in.size(); i += 3) add(in[i], in[i + 1], in[i + 2]);
  }
  for (std::size_t i = 0; mode == 5 && i + 2 < in.size(); ++i) {
    i % 2 == 0 ? add(in[i], in[i + 1], in[i + 2]) : add(in[i + 1], in[i], in[i + 2]);
  }
  for (std::size_t i = 1; mode == 6 && i + 1 < in.size(); ++i) add(in[0], in[i], in[i + 1]);
  return out;
}

/// Influences from every JOINTS_n / WEIGHTS_n pair, made to sum to one.
void read_influences(Document& document, const JsonView& primitive, std::size_t skin_joints,
                     Mesh& mesh, Losses& losses) {
  const JsonView attributes = primitive.at("attributes");
  std::vector<std::pair<const Accessor*, const Accessor*>> sets;
  for (int n = 0; n < 16; ++n) {
    const std::string joints_key = fmt::format("JOINTS_{}", n);
    const std::string weights_key = fmt::format("WEIGHTS_{}", n);
    const auto joints = document.index_of(attributes, joints_key.c_str(), "accessors");
    const auto weights = document.index_of(attributes, weights_key.c_str(), "accessors");
    if (joints < 0 || weights < 0) break;
    sets.emplace_back(&document.accessor(joints, {"VEC4"}),
                      &document.accessor(weights, {"VEC4"}, true));
    if (!sets.back().first->integers) attributes.complain(joints_key + " must be integers");
    if (sets.back().first->count != mesh.positions.size() ||
        sets.back().second->count != mesh.positions.size()) {
      attributes.complain(joints_key + " has another count than POSITION");
    }
  }
  mesh.influence_begin.reserve(mesh.positions.size() + 1);
  mesh.influence_begin.push_back(0);
  for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
    const std::size_t begin = mesh.influences.size();
    double sum = 0.0;
    for (const auto& [joints, weights] : sets) {
      for (std::size_t k = 0; k < 4; ++k) {
        const double weight = weights->element(v)[k];
        if (!(weight > 0.0) || !std::isfinite(weight)) continue;
        const double joint = joints->element(v)[k];
        if (!(joint < double(skin_joints))) {
          attributes.complain(
              fmt::format("vertex {} hangs on skin joint {} of {}", v, joint, skin_joints));
        }
        mesh.influences.push_back({static_cast<std::uint32_t>(joint), static_cast<float>(weight)});
        sum += weight;
      }
    }
    if (mesh.influences.size() == begin) {
      mesh.influences.push_back({0, 1.0F});
      sum = 1.0;
      ++losses.weightless;
    }
    if (std::abs(sum - 1.0) > 1e-3) ++losses.unnormalised;
    for (std::size_t k = begin; k < mesh.influences.size(); ++k) {
      mesh.influences[k].weight = static_cast<float>(mesh.influences[k].weight / sum);
    }
    mesh.influence_begin.push_back(static_cast<std::uint32_t>(mesh.influences.size()));
  }
}

/// Positions, normals, uvs, triangles and material; false where it is no surface.
bool read_surface(Document& document, const JsonView& primitive, Mesh& mesh, Losses& losses) {
  const auto mode_view = primitive.find("mode");
  const std::int64_t mode = mode_view ? mode_view->integer(0, 6) : 4;
  const JsonView attributes = primitive.at("attributes");
  const std::int64_t position = document.index_of(attributes, "POSITION", "accessors");
  if (mode < 4 || position < 0) return false;
  const Accessor& positions = document.accessor(position, {"VEC3"});
  losses.add_elements(positions.count);
  mesh.positions = read_vectors<Eigen::Vector3f>(positions);
  const std::int64_t normal = document.index_of(attributes, "NORMAL", "accessors");
  if (normal >= 0) {
    mesh.normals = read_vectors<Eigen::Vector3f>(document.accessor(normal, {"VEC3"}));
    for (Eigen::Vector3f& n : mesh.normals) n = n.stableNormalized();
  }
  const std::int64_t uv = document.index_of(attributes, "TEXCOORD_0", "accessors");
  if (uv >= 0) mesh.uvs = read_vectors<Eigen::Vector2f>(document.accessor(uv, {"VEC2"}));
  if (mesh.normals.size() != mesh.positions.size()) mesh.normals.clear();
  if (mesh.uvs.size() != mesh.positions.size()) mesh.uvs.clear();
  mesh.triangles = to_triangles(read_indices(document, primitive, positions.count), mode);
  losses.add_elements(mesh.triangles.size());
  mesh.material = static_cast<std::int32_t>(document.index_of(primitive, "material", "materials"));
  return true;
}

/// Where a mesh without a skin hangs: the nearest joint at or above its node.
std::optional<SkinJoint> carrier(const Scene& scene, const Joints& joints, std::int32_t node) {
  Eigen::Matrix4d joint_from_mesh = Eigen::Matrix4d::Identity();
  while (node >= 0 && joints.joint_of_node[node] < 0) {
    joint_from_mesh = local_matrix(scene.nodes[node]) * joint_from_mesh;
    node = scene.nodes[node].parent;
  }
  if (node < 0) return std::nullopt;
  const std::int32_t joint = joints.joint_of_node[node];
  return SkinJoint{joint, joints.joint_from_file_joint(joint) * joint_from_mesh};
}

std::vector<SkinJoint> skin_joints(const Skin& skin, const Joints& joints) {
  std::vector<SkinJoint> out;
  for (std::size_t k = 0; k < skin.joints.size(); ++k) {
    const std::int32_t joint = joints.joint_of_node[skin.joints[k]];
    const Eigen::Matrix4d inverse_bind =
        skin.inverse_binds.empty() ? Eigen::Matrix4d::Identity().eval() : skin.inverse_binds[k];
    out.push_back({joint, joints.joint_from_file_joint(joint) * inverse_bind});
  }
  return out;
}

void read_node_meshes(Document& document, const Scene& scene, const Joints& joints,
                      std::int32_t index, Character& character, Losses& losses) {
  const Node& node = scene.nodes[index];
  const JsonView source = document.item("meshes", node.mesh);
  std::vector<SkinJoint> skin;
  if (node.skin >= 0) {
    skin = skin_joints(scene.skins[node.skin], joints);
  } else if (const auto joint = carrier(scene, joints, index)) {
    skin = {*joint};
  } else {
    ++losses.skipped_meshes;
    return;
  }
  const JsonView primitives = source.at("primitives");
  for (std::size_t p = 0; p < primitives.array().size(); ++p) {
    Mesh mesh;
    const auto name = source.find("name");
    mesh.name = name ? name->string() : node.name;
    if (!read_surface(document, primitives[p], mesh, losses)) {
      ++losses.skipped_primitives;
      continue;
    }
    mesh.skin = skin;
    if (node.skin >= 0) {
      read_influences(document, primitives[p], skin.size(), mesh, losses);
    } else {
      mesh.influences.assign(mesh.positions.size(), Influence{0, 1.0F});
      for (std::size_t v = 0; v <= mesh.positions.size(); ++v) {
        mesh.influence_begin.push_back(static_cast<std::uint32_t>(v));
      }
    }
    character.meshes.push_back(std::move(mesh));
  }
}

void read_morph_names(const Document& document, Character& character) {
  std::set<std::string> seen;
  for (std::size_t m = 0; m < document.count("meshes"); ++m) {
    const JsonView mesh = document.item("meshes", static_cast<std::int64_t>(m));
    const JsonView primitives = mesh.at("primitives");
    if (primitives.array().size() == 0) continue;
    const auto targets = primitives[0].find("targets");
    if (!targets) continue;
    const auto mesh_name = mesh.find("name");
    const auto extras = mesh.find("extras");
    const auto names = extras && extras->is_object() ? extras->find("targetNames") : std::nullopt;
    for (std::size_t t = 0; t < targets->array().size(); ++t) {
      const bool named = names && names->is_array() && t < names->size() && (*names)[t].is_string();
      const std::string name =
          named ? (*names)[t].string()
                : fmt::format("{}_{}", mesh_name ? mesh_name->string() : "mesh", t);
      if (seen.insert(name).second) character.morph_targets.push_back(name);
    }
  }
}

}  // namespace

void build_meshes(Document& document, const Scene& scene, const Joints& joints,
                  Character& character, Warnings& warnings) {
  Losses losses;
  for (std::size_t i = 0; i < scene.nodes.size(); ++i) {
    if (scene.nodes[i].mesh < 0) continue;
    read_node_meshes(document, scene, joints, static_cast<std::int32_t>(i), character, losses);
  }
  read_morph_names(document, character);
  const auto warn = [&](std::int64_t count, const char* code, const char* what) {
    if (count > 0) warnings.push_back({code, fmt::format("{} {}", count, what)});
  };
  warn(losses.unnormalised, "weights-normalised",
       "vertices had weights that do not sum to one; normalised");
  warn(losses.weightless, "weights-missing",
       "vertices have no weights; they hang on their skin's first joint");
  warn(losses.skipped_primitives, "gltf-no-surface", "primitives are points or lines; not drawn");
  warn(losses.skipped_meshes, "gltf-mesh-apart", "meshes hang on no joint; not drawn");
}

namespace {

std::string sniff_image(std::span<const std::byte> bytes) {
  const auto at = [&](std::size_t i) {
    return i < bytes.size() ? std::to_integer<int>(bytes[i]) : -1;
  };
  if (at(0) == 0x89 && at(1) == 'P' && at(2) == 'N' && at(3) == 'G') return "image/png";
  if (at(0) == 0xFF && at(1) == 0xD8 && at(2) == 0xFF) return "image/jpeg";
  return "";
}

/// The bytes of each image; external ones also go into the document, which an export copies.
std::vector<std::vector<std::byte>> read_images(Document& document, const UriResolver& resolver,
                                                Character& character, Warnings& warnings) {
  std::vector<std::vector<std::byte>> images(document.count("images"));
  for (std::size_t i = 0; i < images.size(); ++i) {
    const JsonView view = document.item("images", static_cast<std::int64_t>(i));
    const std::int64_t source = document.index_of(view, "bufferView", "bufferViews");
    if (source >= 0) {
      const auto bytes = document.buffer_view(source);
      images[i].assign(bytes.begin(), bytes.end());
      continue;
    }
    const auto uri = view.find("uri");
    if (!uri) continue;
    Result<std::vector<std::byte>> bytes = resolver(uri->string());
    if (!bytes) {
      warnings.push_back({"texture-missing", bytes.error().message});
      continue;
    }
    images[i] = std::move(*bytes);
    if (!uri->string().starts_with("data:")) {
      character.document.external_images[uri->string()] = images[i];
    }
  }
  return images;
}

}  // namespace

void build_materials(Document& document, const UriResolver& resolver, Character& character,
                     Warnings& warnings) {
  const auto images = read_images(document, resolver, character, warnings);
  std::vector<std::int32_t> texture_of_image(images.size(), -1);
  const auto texture_row = [&](const JsonView& info) -> std::int32_t {
    const std::int64_t texture = document.index_of(info, "index", "textures");
    if (texture < 0) return -1;
    const std::int64_t image =
        document.index_of(document.item("textures", texture), "source", "images");
    if (image < 0 || images[image].empty()) return -1;
    if (texture_of_image[image] >= 0) return texture_of_image[image];
    const std::string type = sniff_image(images[image]);
    if (type.empty()) {
      warnings.push_back({"texture-unsupported",
                          fmt::format("image {} is neither PNG nor JPEG; not drawn", image)});
      return -1;
    }
    texture_of_image[image] = static_cast<std::int32_t>(character.textures.size());
    character.textures.push_back({type, images[image]});
    return texture_of_image[image];
  };
  for (std::size_t i = 0; i < document.count("materials"); ++i) {
    const JsonView view = document.item("materials", static_cast<std::int64_t>(i));
    Material material;
    material.base_color = Eigen::Vector4f::Ones();
    if (const auto name = view.find("name")) material.name = name->string();
    if (const auto sided = view.find("doubleSided")) material.double_sided = sided->boolean();
    if (const auto pbr = view.find("pbrMetallicRoughness")) {
      if (const auto factor = pbr->find("baseColorFactor")) {
        factor->array_of(4);
        for (std::size_t k = 0; k < 4; ++k) {
          material.base_color[static_cast<Eigen::Index>(k)] =
              static_cast<float>((*factor)[k].number());
        }
      }
      if (const auto texture = pbr->find("baseColorTexture")) {
        material.base_color_texture = texture_row(*texture);
      }
    }
    character.materials.push_back(std::move(material));
  }
}

}  // namespace limber::gltf
