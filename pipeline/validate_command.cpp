#include <fmt/format.h>

#include "pipeline/commands.h"

namespace limber {

int validate_command(const ValidateArgs&) { return kUsage; }

}  // namespace limber
