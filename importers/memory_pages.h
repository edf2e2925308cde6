#pragma once

#include <cstddef>
#include <span>

namespace limber {

/// Gives the memory of whole pages back to the system; they read as zeros from now on.
void forget_pages(std::span<std::byte> bytes);

/// Asks the system for large pages where it has them: a fault for each small page of a long motion
/// costs as much as computing what is stored there. `memory` need not be initialised, and what is
/// in it stays.
void prefer_large_pages(void* memory, std::size_t bytes);

}  // namespace limber
