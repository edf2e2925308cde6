#pragma once

#include <string>

#include "pipeline/commands.h"

namespace limber {

/// What `limber validate` finds, as its JSON document: `limber-validation/1`, or {"error": ...},
/// with "usage": true where an argument is at fault. Parses files of strangers: run it jailed.
std::string check_against_source(const ValidateArgs&);

}  // namespace limber
