#pragma once

#include <cstddef>
#include <span>
#include <string_view>

#include "importers/importer.h"

namespace limber {

/// The exact reader of glTF 2.0, GLB and VRM 0 / 1. The document is kept untouched beside what was
/// made of it, so that an export can patch it.
Result<Imported> import_gltf(std::span<const std::byte> bytes, std::string_view extension,
                             const UriResolver&, const ImportOptions& = {});

}  // namespace limber
