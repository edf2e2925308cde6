#include "importers/gltf_reader.h"

#include <fmt/format.h>

#include <set>

#include "importers/failure.h"
#include "importers/figure_guess.h"
#include "importers/gltf_document.h"

namespace limber {

namespace {

std::int64_t count_joints(const gltf::Scene& scene) {
  if (scene.skins.empty()) return static_cast<std::int64_t>(scene.nodes.size());
  std::set<std::int32_t> joints;
  for (const gltf::Skin& skin : scene.skins) {
    joints.insert(skin.joints.begin(), skin.joints.end());
  }
  return static_cast<std::int64_t>(joints.size());
}

std::string scene_name(const gltf::Document& document) {
  const std::int64_t index = document.index_of(document.root(), "scene", "scenes");
  if (index < 0) return "";
  const auto name = document.item("scenes", index).find("name");
  return name ? name->string() : "";
}

void fill_facts(const gltf::Document& document, const gltf::Scene& scene,
                std::string_view extension, const ImportOptions& options, SourceFacts& facts) {
  facts.format = extension == "vrm" && scene.is_vrm ? "vrm" : document.is_glb() ? "glb" : "gltf";
  facts.reader = "limber-gltf";
  facts.unit_m = options.unit_m.value_or(1.0);
  facts.unit_evidence = options.unit_m ? "given as an option" : "glTF is in metres";
  facts.up = options.up.value_or('y') == 'z' ? "+Z" : "+Y";
  facts.joints = count_joints(scene);
}

Imported read(std::span<const std::byte> bytes, std::string_view extension,
              const UriResolver& resolver, const ImportOptions& options) {
  Imported imported;
  Character& character = imported.character;
  gltf::Document document(bytes, resolver, imported.warnings);
  const gltf::Scene scene = gltf::read_scene(document, imported.warnings);
  const gltf::Joints joints =
      gltf::build_skeleton(document, scene, options, character, imported.warnings);
  gltf::build_bind_pose(scene, joints, character);
  gltf::build_meshes(document, scene, joints, character, imported.warnings);
  gltf::build_materials(document, resolver, character, imported.warnings);
  gltf::RawTiming timing;
  imported.clips =
      gltf::build_clips(document, scene, joints, character.skeleton, timing, imported.warnings);
  fill_facts(document, scene, extension, options, imported.facts);
  imported.facts.clips = static_cast<std::int64_t>(imported.clips.size());
  imported.facts.rate_hz = timing.rate_hz;
  imported.facts.frames = timing.frames;
  character.name = scene_name(document);
  character.has_document = true;
  character.document.node_of_joint = joints.node_of_joint;
  character.document.parent_scale = joints.parent_scale;
  character.document.unit_m = joints.unit_m;
  character.document.canonical_from_file = joints.canonical_from_file;
  document.move_into(character.document);
  return imported;
}

}  // namespace

Result<Imported> import_gltf(std::span<const std::byte> bytes, std::string_view extension,
                             const UriResolver& resolver, const ImportOptions& options) {
  return guarded<Imported>(
      [&]() -> Result<Imported> { return read(bytes, extension, resolver, options); });
}

}  // namespace limber
