#include <Eigen/Geometry>
#include <algorithm>
#include <cstring>
#include <string>

#include "exporters/gltf_document.h"

namespace limber {
namespace {

Error broken(std::string message) {
  return Error{.code = "glb-document",
               .message = std::move(message),
               .hint = "check the file with the Khronos validator"};
}

/// Extensions may name a buffer too (EXT_meshopt_compression does).
void move_view(Json& view, const std::vector<std::size_t>& offset_of_buffer) {
  if (const auto it = view.find("buffer"); it != view.end()) {
    const std::size_t offset = offset_of_buffer.at(it->get<std::size_t>());
    *it = 0;
    if (offset != 0) view["byteOffset"] = view.value("byteOffset", std::size_t{0}) + offset;
  }
  if (const auto it = view.find("extensions"); it != view.end()) {
    for (Json& extension : *it) {
      if (extension.is_object()) move_view(extension, offset_of_buffer);
    }
  }
}

/// All buffers end to end, the first one untouched in front, and every view moved along.
Result<std::vector<std::byte>> merge_buffers(Json& json, const GltfDocument& document) {
  std::vector<std::byte> bytes;
  std::vector<std::size_t> offsets;
  const std::size_t count = json.contains("buffers") ? json["buffers"].size() : 0;
  if (count > document.buffers.size()) return broken("a buffer of the document is missing");
  for (std::size_t b = 0; b < count; ++b) {
    if (document.buffers[b].size() < json["buffers"][b].value("byteLength", std::size_t{0})) {
      return broken("buffer " + std::to_string(b) + " is shorter than its byteLength");
    }
    bytes.resize((bytes.size() + 3) / 4 * 4);
    offsets.push_back(bytes.size());
    bytes.insert(bytes.end(), document.buffers[b].begin(), document.buffers[b].end());
  }
  if (count == 0) return bytes;
  json["buffers"][0].erase("uri");
  if (count > 1) {
    json["buffers"].erase(json["buffers"].begin() + 1, json["buffers"].end());
    for (Json& view : json["bufferViews"]) move_view(view, offsets);
  }
  return bytes;
}

/// The mime type that the bytes themselves show; empty where unknown.
std::string sniff_image(std::span<const std::byte> bytes) {
  const auto starts = [&](std::size_t at, std::string_view magic) {
    return bytes.size() >= at + magic.size() &&
           std::memcmp(bytes.data() + at, magic.data(), magic.size()) == 0;
  };
  if (starts(0, "\x89PNG")) return "image/png";
  if (starts(0, "\xFF\xD8\xFF")) return "image/jpeg";
  if (starts(0, "\xABKTX 20")) return "image/ktx2";
  if (starts(0, "RIFF") && starts(8, "WEBP")) return "image/webp";
  return {};
}

/// Pictures beside the file move into the buffer.
void embed_images(Json& json, const GltfDocument& document, GltfBuffer& buffer) {
  if (!json.contains("images")) return;
  for (std::size_t i = 0; i < json["images"].size(); ++i) {
    const Json& image = json["images"][i];
    const std::string uri = image.value("uri", std::string());
    const auto found = document.external_images.find(uri);
    if (uri.empty() || found == document.external_images.end()) continue;
    const std::string mime = sniff_image(found->second);
    if (mime.empty()) continue;
    const std::size_t view = buffer.add_view(found->second);  // may move what json holds
    Json& embedded = json["images"][i];
    embedded.erase("uri");
    embedded["bufferView"] = view;
    embedded["mimeType"] = mime;
  }
}

/// glTF forbids animating a node that is given as a matrix.
void matrix_to_trs(Json& node) {
  const auto it = node.find("matrix");
  if (it == node.end()) return;
  const auto m = it->get<std::vector<double>>();
  node.erase("matrix");
  if (m.size() != 16) return;
  const Eigen::Matrix4d matrix = Eigen::Map<const Eigen::Matrix4d>(m.data());  // column-major
  Eigen::Matrix3d r = matrix.topLeftCorner<3, 3>();
  Eigen::Vector3d scale = r.colwise().norm();
  if (r.determinant() < 0.0) scale.x() = -scale.x();
  for (int k = 0; k < 3; ++k) r.col(k) /= scale[k] != 0.0 ? scale[k] : 1.0;
  const Eigen::Quaterniond q = Eigen::Quaterniond(r).normalized();
  node["translation"] = {matrix(0, 3), matrix(1, 3), matrix(2, 3)};
  node["rotation"] = {q.x(), q.y(), q.z(), q.w()};
  if (!scale.isApproxToConstant(1.0, 1e-12)) node["scale"] = {scale.x(), scale.y(), scale.z()};
}

}  // namespace

Result<GltfTarget> patch_document(const Character& character,
                                  const std::vector<JointMotion>& motions,
                                  const GlbOptions& options) {
  const GltfDocument& document = character.document;
  const std::size_t joints = character.skeleton.parents.size();
  if (document.node_of_joint.size() != joints || document.parent_scale.size() != joints) {
    return broken("the document does not belong to this skeleton");
  }
  GltfTarget target;
  target.json = Json::parse(document.json);
  if (!target.json.is_object()) return broken("the document is no JSON object");
  auto merged = merge_buffers(target.json, document);
  if (!merged) return merged.error();
  GltfBuffer buffer(target.json, std::move(*merged));
  embed_images(target.json, document, buffer);
  target.bytes = std::move(buffer).take_bytes();

  Json& nodes = target.json["nodes"];
  target.space = {document.node_of_joint, document.parent_scale, document.canonical_from_file};
  for (std::size_t j = 0; j < joints; ++j) {
    target.space.metres_per_unit[j] *= document.unit_m;
    const std::int32_t node = document.node_of_joint[j];
    if (node < 0 || static_cast<std::size_t>(node) >= nodes.size()) {
      return broken("joint '" + character.skeleton.names[j] + "' has no node");
    }
    if (motions[j].rotates || motions[j].translates) matrix_to_trs(nodes[node]);
  }
  if (options.replace_animations) target.json.erase("animations");
  return target;
}

}  // namespace limber
