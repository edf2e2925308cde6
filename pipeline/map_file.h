#pragma once

#include <filesystem>
#include <string_view>

#include "assets/model/result.h"
#include "pipeline/figure.h"

namespace limber {

/// Roles that a map file gives to both sides. A file written by `limber map` gives every role.
struct MapFile {
  RoleOverrides source, target;
};

/// Reads `limber-map/1`. Errors carry the JSON pointer: code `map-file`.
Result<MapFile> read_map_file(const std::filesystem::path&);
Result<MapFile> read_map_json(std::string_view text);

}  // namespace limber
