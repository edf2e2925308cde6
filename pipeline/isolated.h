#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "assets/model/result.h"

namespace limber {

enum class SandboxMode : std::uint8_t { automatic, require, off };

struct IsolationLimits {
  std::uint64_t memory_bytes = std::uint64_t(4) << 30;
  std::uint32_t cpu_seconds = 120;
  std::uint64_t file_bytes = std::uint64_t(1) << 30;
};

/// Runs `work` in a child process of its own and returns the text it returns. A crash, a caught
/// exception or a broken limit costs the child alone. Call from a single-threaded process.
/// Errors: `process-crashed` (signal), `process-limit` (memory, CPU), `process-failed`.
Result<std::string> run_isolated(const std::function<std::string()>& work,
                                 SandboxMode = SandboxMode::automatic, const IsolationLimits& = {});

/// A child that runs while the parent goes on; `pid` and the read end of its answer.
struct IsolatedChild {
  int pid = -1;
  int answer_fd = -1;
};
Result<IsolatedChild> start_isolated(const std::function<std::string()>& work, SandboxMode,
                                     const IsolationLimits&);
/// Waits for the child and collects its answer.
Result<std::string> finish_isolated(IsolatedChild);

/// What confines a child here, in words.
std::string sandbox_level();
bool sandbox_available();

}  // namespace limber
