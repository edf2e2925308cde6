#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace limber {

/// What a machine lacks, and what mends it.
struct Lack {
  std::string what;    ///< "no Landlock: clips can read every file of yours"
  std::string mend;    ///< a command, where there is one
  bool stops = false;  ///< clips would fail; otherwise they are less safe, or slower
};

/// What a process is given by its system. Limits are in force now; kUnlimited where there is none.
struct Surroundings {
  static constexpr std::uint64_t kUnlimited = ~std::uint64_t(0);
  int landlock_abi = 0;
  bool seccomp = false;
  std::uint64_t disk_free_bytes = 0;  ///< of the current folder
  bool folder_writable = false;       ///< the current one
  std::uint64_t memory_bytes = 0;     ///< that the machine could give now
  int cores = 1;
  std::uint64_t open_files = kUnlimited, processes = kUnlimited, file_bytes = kUnlimited,
                address_bytes = kUnlimited, cpu_seconds = kUnlimited;
};
Surroundings look_around();

/// What of that keeps batches from running, safely and in full.
std::vector<Lack> lacks_of(const Surroundings&);

/// Libraries that the program stands on, with their versions: those loaded now by the versions that
/// their files carry, the others by those of the build.
std::vector<std::pair<std::string, std::string>> library_versions();

/// `limber doctor`. Exit code 3 where something is lacking without which clips would fail.
int doctor_command(bool json);

}  // namespace limber
