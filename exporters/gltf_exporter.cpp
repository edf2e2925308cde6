#include <algorithm>
#include <exception>

#include "exporters/exporter.h"
#include "exporters/gltf_document.h"

namespace limber {
namespace {

/// Which joints get channels: those asked for always rotate, the rest not at all. A glTF animation
/// needs one channel at least.
std::vector<JointMotion> channels_of(const Skeleton& skeleton, const Clip& clip,
                                     const GlbOptions& options) {
  std::vector<JointMotion> motions = joint_motions(skeleton, clip);
  if (!options.joints.empty()) {
    std::vector<JointMotion> asked(motions.size());
    for (const std::int32_t j : options.joints) asked[j] = {true, motions[j].translates};
    motions = std::move(asked);
  } else {
    for (JointMotion& m : motions) m.rotates |= m.translates;
  }
  const bool any =
      std::any_of(motions.begin(), motions.end(), [](const JointMotion& m) { return m.rotates; });
  if (!any) motions[0].rotates = true;
  return motions;
}

Result<std::vector<std::byte>> export_checked(const Character& character, const Clip& clip,
                                              const GlbOptions& options) {
  const std::vector<JointMotion> motions = channels_of(character.skeleton, clip, options);
  Result<GltfTarget> target = character.has_document ? patch_document(character, motions, options)
                                                     : new_document(character, options);
  if (!target) return target.error();
  GltfBuffer buffer(target->json, std::move(target->bytes));
  add_animation(target->json, buffer, character.skeleton, clip, target->space, motions);
  if (buffer.size() > 0xFFFF0000U) {
    return Error{.code = "glb-too-large",
                 .message = "the file would exceed the 4 GB that GLB can hold",
                 .hint = "export a shorter range or a lower rate"};
  }
  return std::move(buffer).finish();
}

}  // namespace

Result<std::vector<std::byte>> export_glb(const Character& character, const Clip& clip,
                                          const GlbOptions& options) {
  if (auto r = validate(character); !r) return r.error();
  if (auto r = validate(character.skeleton, clip); !r) return r.error();
  for (const std::int32_t j : options.joints) {
    if (j < 0 || j >= character.skeleton.size()) {
      return Error{.code = "export-option", .message = "GlbOptions::joints names no joint"};
    }
  }
  try {
    return export_checked(character, clip, options);
  } catch (const std::exception& e) {
    return Error{.code = "glb-document",
                 .message = std::string("the character's glTF document is broken: ") + e.what(),
                 .hint = "check the file with the Khronos validator"};
  }
}

}  // namespace limber
