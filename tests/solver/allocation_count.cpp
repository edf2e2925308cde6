#include "tests/solver/allocation_count.h"

#include <atomic>
#include <cstdlib>

namespace {
std::atomic<std::size_t> count{0};
}  // namespace

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__)
// glibc lets a program bring its own malloc; this one counts and passes on. Eigen and operator new
// both end here.
extern "C" void* __libc_malloc(std::size_t);
extern "C" void* malloc(std::size_t size) {
  count.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
#endif

namespace limber::test {

std::size_t allocation_count() { return count.load(); }

}  // namespace limber::test
