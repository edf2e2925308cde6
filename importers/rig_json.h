#pragma once

#include <string_view>

#include "assets/model/result.h"
#include "assets/model/rig.h"

namespace limber {

/// Reads format `ikrig/1` (assets/data/rigs/ikrig.schema.json). Unknown keys, wrong types and
/// broken invariants are errors that carry the JSON pointer: code `rig-json`.
Result<Rig> read_rig_json(std::string_view text);

}  // namespace limber
