#pragma once

#include <memory>

#include "tests/bench/peers/contestant.h"

namespace limber::peers {

/// Limber as `limber bench` runs it.
std::unique_ptr<Contestant> make_ours(IkMethod, Start);

}  // namespace limber::peers
