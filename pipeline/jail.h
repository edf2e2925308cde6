#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace limber {

/// What a process that reads files of strangers may still touch.
struct JailRules {
  /// Each file that exists, with the folder it lies in: what it refers to lies there. Names that
  /// are no files (a shipped rig's) grant nothing.
  std::vector<std::filesystem::path> reads = {};
  std::vector<std::filesystem::path> writes = {};  ///< folders for outputs; they must exist
  bool may_fork = false;  ///< a clip's process checks its files in children
};

/// The folder that an output file lies in; none where there is no output.
std::vector<std::filesystem::path> folder_of(const std::filesystem::path& output);

/// What this kernel can confine a process with.
struct JailSupport {
  int landlock_abi = 0;  ///< 0: no Landlock
  bool seccomp = false;
  bool complete() const { return landlock_abi > 0 && seccomp; }
};
JailSupport jail_support();

/// Confines the calling, single-threaded process for good, and all it starts. Landlock: nothing is
/// read but the rules' folders and the system's shared libraries, nothing written but the output
/// folders, nothing executed, no TCP port, no signal to a process outside. seccomp: a list of the
/// system calls that reading, solving and writing need; no sockets, no new program, no new process
/// (unless allowed), no tracing, no io_uring. What the kernel lacks is left out; returns what
/// holds.
JailSupport enter_jail(const JailRules&);

}  // namespace limber
