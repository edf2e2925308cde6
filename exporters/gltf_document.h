#pragma once

#include <cstddef>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/result.h"
#include "exporters/exporter.h"
#include "exporters/gltf_animation.h"
#include "exporters/gltf_buffer.h"

namespace limber {

/// A document ready to receive an animation.
struct GltfTarget {
  Json json;
  std::vector<std::byte> bytes;  ///< of buffer 0
  NodeSpace space;
};

/// The character's own document, made self-contained: one buffer that starts with the old one.
/// Animated nodes given as a matrix are rewritten as translation, rotation and scale.
Result<GltfTarget> patch_document(const Character&, const std::vector<JointMotion>&,
                                  const GlbOptions&);

/// A new document from the character's joints, meshes, materials and textures.
Result<GltfTarget> new_document(const Character&, const GlbOptions&);

}  // namespace limber
