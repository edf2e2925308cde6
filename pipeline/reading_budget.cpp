#include "pipeline/reading_budget.h"

#include <sys/resource.h>

#include <algorithm>
#include <system_error>

#include "pipeline/isolated.h"

namespace limber {
namespace {

constexpr std::uint64_t kSeconds = 2;
constexpr std::uint64_t kBytesPerFurtherSecond = 4'000'000;
constexpr std::uint64_t kMemory = std::uint64_t(5) << 28;  // 1.25 GiB
constexpr std::uint64_t kMemoryPerByte = 16;

/// Lowers a limit for a while; returns the one that stood.
std::uint64_t lower(__rlimit_resource resource, std::uint64_t value) {
  struct rlimit limit {};
  ::getrlimit(resource, &limit);
  const std::uint64_t stood = limit.rlim_cur;
  limit.rlim_cur = std::min<rlim_t>(stood, value);
  ::setrlimit(resource, &limit);
  return stood;
}

void restore(__rlimit_resource resource, std::uint64_t value) {
  struct rlimit limit {};
  ::getrlimit(resource, &limit);
  limit.rlim_cur = value;
  ::setrlimit(resource, &limit);
}

}  // namespace

ReadingBudget::ReadingBudget(std::uint64_t file_bytes) {
  struct rusage used {};
  ::getrusage(RUSAGE_SELF, &used);
  const auto seconds = static_cast<std::uint64_t>(used.ru_utime.tv_sec + used.ru_stime.tv_sec) + 1;
  const std::uint64_t bytes = static_cast<std::uint64_t>(used.ru_maxrss) << 10;
  cpu_seconds_ = lower(RLIMIT_CPU, seconds + kSeconds + file_bytes / kBytesPerFurtherSecond);
  memory_bytes_ =
      kMemoryCanBeLimited ? lower(RLIMIT_AS, bytes + kMemory + kMemoryPerByte * file_bytes) : 0;
}

ReadingBudget::~ReadingBudget() {
  restore(RLIMIT_CPU, cpu_seconds_);
  if (kMemoryCanBeLimited) restore(RLIMIT_AS, memory_bytes_);
}

Result<Imported> import_within_budget(const std::filesystem::path& path,
                                      const ImportOptions& options) {
  std::error_code error;
  const std::uintmax_t bytes = std::filesystem::file_size(path, error);
  const ReadingBudget budget(error ? 0 : bytes);
  return import_file(path, options);
}

}  // namespace limber
