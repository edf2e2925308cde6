#pragma once

#include <string>

#include "pipeline/job.h"

namespace limber {

/// Reads the target in a process of its own, so that nothing of a stranger's file comes near the
/// caller: its label, or why it cannot be read (`sandbox-unavailable`: why it was not tried).
Result<std::string> check_target(const std::string& target, const JobOptions&);
/// The label without reading the target.
std::string label_of(const std::string& target);

}  // namespace limber
