#include "importers/memory_pages.h"

#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>

namespace limber {

namespace {

/// Advises on the whole pages among the bytes; where the system takes no advice, nothing changes.
void advise(void* memory, std::size_t bytes, int advice) {
  static const auto page = static_cast<std::uintptr_t>(::sysconf(_SC_PAGESIZE));
  const auto begin = reinterpret_cast<std::uintptr_t>(memory);
  const std::uintptr_t first = (begin + page - 1) / page * page;
  const std::uintptr_t end = (begin + bytes) / page * page;
  if (first < end) ::madvise(reinterpret_cast<void*>(first), end - first, advice);
}

}  // namespace

void forget_pages(std::span<std::byte> bytes) { advise(bytes.data(), bytes.size(), MADV_DONTNEED); }

void prefer_large_pages(void* memory, std::size_t bytes) {
  constexpr std::size_t kLarge = std::size_t{2} << 20;
  if (bytes >= 2 * kLarge) advise(memory, bytes, MADV_HUGEPAGE);
}

}  // namespace limber
