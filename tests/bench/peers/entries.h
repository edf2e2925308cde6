#pragma once

#include <memory>
#include <vector>

#include "tests/bench/peers/contestant.h"

namespace limber::peers {

/// Everybody, ours first. A new solver joins here. Where a workload's frames stand alone there is
/// only one start, and contestants that differ in it alone are left out.
std::vector<std::unique_ptr<Contestant>> all_contestants(const Workload&);

}  // namespace limber::peers
