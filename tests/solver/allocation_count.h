#pragma once

#include <cstddef>

namespace limber::test {

/// Calls of malloc so far, by anybody in this process; always 0 where sanitizers own malloc.
std::size_t allocation_count();

}  // namespace limber::test
