#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>

#include "assets/model/result.h"
#include "pipeline/jail.h"

namespace limber {

/// automatic: confined by whatever the kernel has; require: by all of it, or not run at all.
enum class SandboxMode : std::uint8_t { automatic, require, off };

struct IsolationLimits {
  std::uint64_t memory_bytes = std::uint64_t(4) << 30;
  std::uint32_t cpu_seconds = 120;
  std::uint32_t wall_seconds = 300;
  std::uint64_t file_bytes = std::uint64_t(1) << 30;    ///< of each file it writes
  std::uint64_t answer_bytes = std::uint64_t(1) << 28;  ///< of what it says to its parent
};

#if defined(__SANITIZE_ADDRESS__)
inline constexpr bool kMemoryCanBeLimited = false;  // AddressSanitizer maps terabytes
#else
inline constexpr bool kMemoryCanBeLimited = true;
#endif

struct Isolation {
  JailRules may = {};  ///< what it reads and writes; nothing unless said
  SandboxMode sandbox = SandboxMode::automatic;
  IsolationLimits limits = {};
};

/// Runs `work` in a jailed child process and returns the text it returns. A crash, a caught
/// exception or a broken limit costs the child alone. Call from a single-threaded process.
/// Errors: `process-crashed` (signal), `process-limit` (memory, CPU, file, answer),
/// `process-timeout` (wall clock), `process-failed`, `sandbox-unavailable`.
Result<std::string> run_isolated(const std::function<std::string()>& work, const Isolation& = {});

/// A child that runs while the parent goes on; `pid` and the read end of its answer, which does not
/// block.
struct IsolatedChild {
  int pid = -1;
  int answer_fd = -1;
  IsolationLimits limits = {};
  std::chrono::steady_clock::time_point deadline = {};
  std::string answer = {};  ///< what has been read of it
};
Result<IsolatedChild> start_isolated(const std::function<std::string()>& work, const Isolation&);
/// Waits for the child, at most until its deadline, and collects its answer.
Result<std::string> finish_isolated(IsolatedChild);
/// Takes what the child has said so far into its answer and heeds begin_part(). True where there is
/// nothing more to come, or more than may be.
bool hear(IsolatedChild&);

/// Called in an isolated process whose work has parts that may each take the whole wall time, such
/// as the clips of a file: the time counts anew from here. Elsewhere, and once the answer has
/// begun, it does nothing.
void begin_part();

/// Runs a part of an isolated process's work in a process of its own, within the same jail; a crash
/// is tried once more. Errors: those of run_isolated.
Result<std::string> run_part(const std::function<std::string()>& work, const IsolationLimits&);

/// Whether another try may end otherwise: after a crash, not after a broken limit.
bool worth_another_try(const Error&);

/// What confines a child here, in words.
std::string sandbox_level();
/// Whether all of it is there, so that `--sandbox require` can be met.
bool sandbox_available();

}  // namespace limber
