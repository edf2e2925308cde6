#pragma once

#include <memory>

#include "tests/bench/peers/contestant.h"

namespace limber::peers {

/// Limber as `limber bench` runs it.
std::unique_ptr<Contestant> make_ours(IkMethod, Start, std::size_t lanes = 1);

/// The second solver that Limber checks itself with, from each frame's start alone.
std::unique_ptr<Contestant> make_ceres();

}  // namespace limber::peers
