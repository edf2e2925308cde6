#include "pipeline/doctor.h"

#include <fmt/format.h>
#include <link.h>
#include <sys/resource.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string_view>
#include <system_error>

#include "importers/importer.h"
#include "pipeline/commands.h"
#include "pipeline/embedded.h"
#include "pipeline/jail.h"
#include "pipeline/process_pool.h"
#include "pipeline/target.h"
#include "pipeline/version.h"
#include "solver/lane_solver.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

constexpr std::uint64_t kMiB = 1 << 20;

std::uint64_t limit_of(__rlimit_resource resource) {
  struct rlimit limit {};
  if (::getrlimit(resource, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) {
    return Surroundings::kUnlimited;
  }
  return limit.rlim_cur;
}

/// What the kernel could give without swapping (proc(5), MemAvailable).
std::uint64_t available_memory() {
  std::ifstream in("/proc/meminfo");
  for (std::string word; in >> word;) {
    std::uint64_t kib = 0;
    if (word == "MemAvailable:" && in >> kib) return kib << 10;
  }
  return 0;
}

/// A shared library's file is called libNAME.so.VERSION; its other names are links to that one.
void add_loaded(const char* path, std::vector<std::pair<std::string, std::string>>& out) {
  // What the build names; the others come with them.
  constexpr auto kOurs = std::to_array<std::string_view>(
      {"assimp", "fmt", "jpeg", "md", "opencv_core", "opencv_imgproc", "png16", "pugixml",
       "seccomp", "utf8proc", "xxhash", "z"});
  std::error_code error;
  const std::string file = fs::canonical(path, error).filename().string();
  const std::size_t so = file.find(".so.");
  if (error || so == std::string::npos || !file.starts_with("lib")) return;
  std::string name = file.substr(3, so - 3);
  if (std::find(kOurs.begin(), kOurs.end(), name) == kOurs.end()) return;
  out.emplace_back(std::move(name), file.substr(so + 4));
}

std::string megabytes(std::uint64_t bytes) {
  return bytes == Surroundings::kUnlimited ? "unlimited" : fmt::format("{} MiB", bytes / kMiB);
}

std::string count(std::uint64_t number, const char* unit = "") {
  return number == Surroundings::kUnlimited ? "unlimited" : fmt::format("{}{}", number, unit);
}

json facts_json(const Surroundings& here) {
  const auto number = [](std::uint64_t n) {
    return n == Surroundings::kUnlimited ? json(nullptr) : json(n);
  };
  json libraries = json::object();
  for (const auto& [name, version] : library_versions()) libraries[name] = version;
  json lacks = json::array();
  for (const Lack& lack : lacks_of(here)) {
    lacks.push_back({{"what", lack.what}, {"mend", lack.mend}, {"stops", lack.stops}});
  }
  const IsolationLimits caps;
  return {{"version", kVersion},
          {"libraries", libraries},
          {"simd", LaneSolver::levels()},
          {"sandbox", sandbox_level()},
          {"landlock_abi", here.landlock_abi},
          {"seccomp", here.seccomp},
          {"disk_free_bytes", here.disk_free_bytes},
          {"folder_writable", here.folder_writable},
          {"memory_available_bytes", here.memory_bytes},
          {"cores", here.cores},
          {"limits",
           {{"open_files", number(here.open_files)},
            {"processes", number(here.processes)},
            {"file_bytes", number(here.file_bytes)},
            {"address_bytes", number(here.address_bytes)},
            {"cpu_seconds", number(here.cpu_seconds)}}},
          {"caps_of_a_clip",
           {{"memory_bytes", caps.memory_bytes},
            {"cpu_seconds", caps.cpu_seconds},
            {"wall_seconds", caps.wall_seconds},
            {"file_bytes", caps.file_bytes}}},
          {"readable", readable_extensions()},
          {"writable", {"glb", "bvh"}},
          {"rigs", shipped_rig_names()},
          {"conventions", embedded_files("conventions/").size()},
          {"lacks", lacks}};
}

std::string joined(const std::vector<std::string>& words) {
  return fmt::format("{}", fmt::join(words, " "));
}

void print_facts(const Surroundings& here) {
  fmt::print("Limber {}\n", kVersion);
  std::vector<std::string> libraries;
  for (const auto& [name, version] : library_versions()) libraries.push_back(name + " " + version);
  fmt::print("  libraries    {}\n", fmt::join(libraries, ", "));
  fmt::print("  SIMD         {}\n", joined(LaneSolver::levels()));
  fmt::print("  clips run in {}\n", sandbox_level());
  const IsolationLimits caps;
  fmt::print("  a clip gets  {} memory, {} s CPU, {} s wall time, {} a file\n",
             megabytes(caps.memory_bytes), caps.cpu_seconds, caps.wall_seconds,
             megabytes(caps.file_bytes));
  fmt::print("  machine      {} cores, {} memory available, {} free here\n", here.cores,
             megabytes(here.memory_bytes), megabytes(here.disk_free_bytes));
  fmt::print("  limits       {} open files, {} processes, file size {}, memory {}, CPU {}\n",
             count(here.open_files), count(here.processes), megabytes(here.file_bytes),
             megabytes(here.address_bytes), count(here.cpu_seconds, " s"));
  fmt::print("  reads        {}\n", joined(readable_extensions()));
  fmt::print("  rigs         {}\n", joined(shipped_rig_names()));
  const std::vector<Lack> lacks = lacks_of(here);
  if (lacks.empty()) fmt::print("nothing is missing\n");
  for (const Lack& lack : lacks) {
    fmt::print("{}: {}\n  mend it: {}\n", lack.stops ? "missing" : "could be better", lack.what,
               lack.mend);
  }
}

}  // namespace

Surroundings look_around() {
  Surroundings here;
  const JailSupport jail = jail_support();
  here.landlock_abi = jail.landlock_abi;
  here.seccomp = jail.seccomp;
  struct statvfs disk {};
  if (::statvfs(".", &disk) == 0) here.disk_free_bytes = disk.f_bavail * disk.f_frsize;
  here.folder_writable = ::access(".", W_OK) == 0;
  here.memory_bytes = available_memory();
  here.cores = processes_or_cores(0);
  here.open_files = limit_of(RLIMIT_NOFILE);
  here.processes = limit_of(RLIMIT_NPROC);
  here.file_bytes = limit_of(RLIMIT_FSIZE);
  here.address_bytes = limit_of(RLIMIT_AS);
  here.cpu_seconds = limit_of(RLIMIT_CPU);
  return here;
}

std::vector<Lack> lacks_of(const Surroundings& here) {
  const IsolationLimits caps;
  const auto cores = static_cast<std::uint64_t>(here.cores);
  constexpr std::uint64_t kLeastDisk = 1024 * kMiB, kMemoryOfAClip = 512 * kMiB;
  constexpr std::uint64_t kFilesOfAClip = 4, kProcessesOfAClip = 3;
  std::vector<Lack> out;
  const auto lack = [&](bool stops, std::string what, std::string mend) {
    out.push_back({std::move(what), std::move(mend), stops});
  };
  if (here.landlock_abi == 0) {
    lack(false, "no Landlock: a hostile file that takes over its reader can read your files",
         "boot Linux 5.13 or later with lsm=landlock,... (cat /sys/kernel/security/lsm tells the "
         "others); in a container, let its seccomp profile allow landlock_create_ruleset");
  }
  if (!here.seccomp) {
    lack(false, "no seccomp filters: a hostile file that takes over its reader can use the network",
         "boot a kernel with CONFIG_SECCOMP_FILTER=y");
  }
  if (!here.folder_writable) {
    lack(true, "the current folder cannot be written to", "cd to another, or name one with -o");
  }
  if (here.disk_free_bytes < kLeastDisk) {
    lack(false, megabytes(here.disk_free_bytes) + " are free on this disk",
         "df -h . ; a batch that fills it stops, and goes on with --resume");
  }
  if (here.memory_bytes < kMemoryOfAClip * cores) {
    lack(false,
         fmt::format("{} of memory for {} clips at a time", megabytes(here.memory_bytes),
                     here.cores),
         fmt::format("-j {}", std::max<std::uint64_t>(1, here.memory_bytes / kMemoryOfAClip)));
  }
  if (here.open_files < 64 + kFilesOfAClip * cores) {
    lack(true, fmt::format("only {} files may be open", here.open_files), "ulimit -n 1024");
  }
  if (here.processes < kProcessesOfAClip * cores + 16) {
    lack(true, fmt::format("only {} processes may run", here.processes), "ulimit -u 1024");
  }
  if (here.file_bytes < caps.file_bytes) {
    lack(false, "files are limited to " + megabytes(here.file_bytes), "ulimit -f unlimited");
  }
  if (here.address_bytes < caps.memory_bytes) {
    lack(false, "memory is limited to " + megabytes(here.address_bytes), "ulimit -v unlimited");
  }
  if (here.cpu_seconds < caps.cpu_seconds) {
    lack(true, "CPU time is limited to " + count(here.cpu_seconds, " s"), "ulimit -t unlimited");
  }
  return out;
}

std::vector<std::pair<std::string, std::string>> library_versions() {
  std::vector<std::pair<std::string, std::string>> out;
  ::dl_iterate_phdr(
      [](struct dl_phdr_info* info, std::size_t, void* list) {
        add_loaded(info->dlpi_name,
                   *static_cast<std::vector<std::pair<std::string, std::string>>*>(list));
        return 0;
      },
      &out);
  out.emplace_back("ceres", LIMBER_CERES_VERSION);
  out.emplace_back("eigen", fmt::format("{}.{}.{}", EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION,
                                        EIGEN_MINOR_VERSION));
  out.emplace_back("nlohmann_json",
                   fmt::format("{}.{}.{}", NLOHMANN_JSON_VERSION_MAJOR, NLOHMANN_JSON_VERSION_MINOR,
                               NLOHMANN_JSON_VERSION_PATCH));
  std::sort(out.begin(), out.end());
  return out;
}

int doctor_command(bool as_json) {
  const Surroundings here = look_around();
  if (as_json) {
    fmt::print("{}\n", facts_json(here).dump(2, ' ', false, json::error_handler_t::replace));
  } else {
    print_facts(here);
  }
  const std::vector<Lack> lacks = lacks_of(here);
  const bool stops =
      std::any_of(lacks.begin(), lacks.end(), [](const Lack& lack) { return lack.stops; });
  return stops ? kEnvironment : kAllPassed;
}

}  // namespace limber
