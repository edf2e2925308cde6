#pragma once

#include <cstddef>
#include <span>

#include "importers/importer.h"

namespace limber {

/// The exact BVH reader. Position channels replace OFFSET (as in MotionBuilder and Blender), except
/// where a joint's are zero in every frame while its OFFSET is not. End Sites become joints named
/// '<parent>_End' that deform nothing, so that toe and finger tips and the crown are known.
Result<Imported> import_bvh(std::span<const std::byte> bytes, const ImportOptions& = {});

}  // namespace limber
