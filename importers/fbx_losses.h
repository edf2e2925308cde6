#pragma once

#include <span>

#include "assets/model/clip.h"
#include "assets/model/result.h"

namespace limber {

/// What is lost where assimp reads an FBX's animation, in figures. It draws straight lines between
/// keys: `fbx-tangents` tells, per clip, how far the curves of the file leave them on the frames of
/// the clip. It does not blend layers: `fbx-layers` tells how much motion the others hold. Where
/// the file's curves cannot be read a second time, `fbx-losses-unknown`.
/// `unit_m`: metres per unit of the file's translations.
void tell_fbx_losses(std::span<const std::byte> bytes, std::span<const Clip> clips, double unit_m,
                     Warnings&);

}  // namespace limber
