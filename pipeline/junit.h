#pragma once

#include <string>
#include <vector>

#include "pipeline/job.h"

namespace limber {

/// The clips as one JUnit test suite: a test case per clip, failures with their codes, warnings on
/// its standard output. Characters that XML cannot hold become U+FFFD.
std::string junit_xml(const std::vector<ClipSummary>&, const std::string& suite);

}  // namespace limber
