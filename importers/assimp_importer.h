#pragma once

#include <cstddef>
#include <span>
#include <string_view>

#include "importers/importer.h"

namespace limber {

/// Reads a file with assimp: FBX and Collada by default, BVH and glTF where asked for. assimp
/// sees the bytes and what `resolver` grants, never the file system. Its known defects are mended
/// or refused: pivot helper nodes, folded scale, bind pose from the offset matrices, broken
/// weights.
Result<Imported> import_with_assimp(std::span<const std::byte> bytes, std::string_view extension,
                                    const UriResolver& resolver, const ImportOptions& options);

}  // namespace limber
