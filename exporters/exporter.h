#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/clip.h"
#include "assets/model/result.h"
#include "assets/model/rig.h"

namespace limber {

struct GlbOptions {
  /// Animated joints; empty: all that move or differ from the rest pose.
  std::vector<std::int32_t> joints = {};
  /// Drop the animations the document already has, so that the clip is the only one.
  bool replace_animations = true;
  std::string generator = "Limber 0.1.0";  ///< of a new document; a kept one keeps its own
};

/// A GLB that plays `clip` on `character`. A character with a glTF document keeps it (meshes,
/// skins, materials, extras, unknown extensions; the old BIN is a byte prefix of the new one); any
/// other is written anew from its meshes. Rotations are unit and sign-continuous; translations are
/// written only for joints whose translation moves or differs from the rest pose.
Result<std::vector<std::byte>> export_glb(const Character&, const Clip&, const GlbOptions& = {});

struct BvhOptions {
  double unit_m = 0.01;  ///< metres per BVH unit; MotionBuilder and Blender expect centimetres
  int decimals = 6;
};

/// BVH of the skeleton: the root with six channels, every other joint with three rotations (ZXY);
/// a joint whose translation moves gets six as well. Further roots of the skeleton hang below one
/// ROOT. Euler angles are unwrapped.
Result<std::string> export_bvh(const Character&, const Clip&, const BvhOptions& = {});

/// Format `ikrig/1`, readable by read_rig_json without loss.
std::string write_rig_json(const Rig&);

}  // namespace limber
