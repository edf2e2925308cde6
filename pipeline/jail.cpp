// Landlock confines what may be opened (Documentation/userspace-api/landlock.rst of Linux); its
// structures are repeated here, since the kernel may know more than the headers of the build.
// seccomp confines which system calls there are. Both need no privilege and cannot be undone.
#include "pipeline/jail.h"

#include <fcntl.h>
#include <sched.h>
#include <seccomp.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <initializer_list>
#include <system_error>

namespace limber {
namespace {

namespace fs = std::filesystem;

// ---- Landlock

#ifndef SYS_landlock_create_ruleset
constexpr long SYS_landlock_create_ruleset = 444;
constexpr long SYS_landlock_add_rule = 445;
constexpr long SYS_landlock_restrict_self = 446;
#endif

constexpr std::uint64_t bit(int n) { return std::uint64_t(1) << n; }
constexpr std::uint64_t kWriteFile = bit(1), kReadFile = bit(2), kReadFolder = bit(3),
                        kRemoveFile = bit(5), kMakeFolder = bit(7), kMakeRegular = bit(8),
                        kTruncate = bit(14);
constexpr std::uint64_t kReading = kReadFile | kReadFolder;
constexpr std::uint64_t kWriting =
    kWriteFile | kRemoveFile | kMakeFolder | kMakeRegular | kTruncate;

struct RulesetAttributes {
  std::uint64_t handled_fs = 0;
  std::uint64_t handled_net = 0;  // ABI 4
  std::uint64_t scoped = 0;       // ABI 6
};

struct __attribute__((packed)) PathBeneath {
  std::uint64_t allowed = 0;
  std::int32_t parent_fd = -1;
};

int landlock_abi() {
  constexpr unsigned kAskVersion = 1;
  const long abi = ::syscall(SYS_landlock_create_ruleset, nullptr, 0, kAskVersion);
  return abi > 0 ? static_cast<int>(abi) : 0;
}

/// Everything that the kernel knows to handle is handled, so that what no rule allows is refused.
RulesetAttributes all_handled(int abi) {
  RulesetAttributes out;
  const int rights = abi >= 5 ? 16 : abi >= 3 ? 15 : abi >= 2 ? 14 : 13;  // up to IOCTL_DEV
  out.handled_fs = bit(rights) - 1;
  if (abi >= 4) out.handled_net = bit(0) | bit(1);  // bind and connect of TCP
  if (abi >= 6) out.scoped = bit(0) | bit(1);       // abstract sockets, signals
  return out;
}

/// What is not there grants nothing; folders' rights cannot be given to files.
void allow(int ruleset, const fs::path& path, std::uint64_t rights, std::uint64_t handled) {
  const int fd = ::open(path.c_str(), O_PATH | O_CLOEXEC);
  if (fd < 0) return;
  struct stat info {};
  if (::fstat(fd, &info) == 0) {
    if (!S_ISDIR(info.st_mode)) rights &= kReadFile;
    const PathBeneath rule{rights & handled, fd};
    constexpr int kPathBeneath = 1;
    (void)::syscall(SYS_landlock_add_rule, ruleset, kPathBeneath, &rule, 0);
  }
  ::close(fd);
}

bool restrict_files(const JailRules& rules, int abi) {
  const RulesetAttributes handled = all_handled(abi);
  const int ruleset =
      static_cast<int>(::syscall(SYS_landlock_create_ruleset, &handled, sizeof handled, 0));
  if (ruleset < 0) return false;
  // Shared libraries are loaded as they are needed: character sets, for one.
  for (const char* libraries : {"/usr/lib", "/lib", "/lib64", "/etc/ld.so.cache"}) {
    allow(ruleset, libraries, kReading, handled.handled_fs);
  }
  for (const fs::path& file : rules.reads) {
    std::error_code ignored;
    if (!fs::exists(file, ignored)) continue;
    allow(ruleset, file, kReading, handled.handled_fs);  // it may be a link to elsewhere
    const fs::path folder = file.parent_path();
    allow(ruleset, folder.empty() ? "." : folder, kReading, handled.handled_fs);
  }
  for (const fs::path& folder : rules.writes) {
    allow(ruleset, folder.empty() ? "." : folder, kReading | kWriting, handled.handled_fs);
  }
  const bool done = ::syscall(SYS_landlock_restrict_self, ruleset, 0) == 0;
  ::close(ruleset);
  return done;
}

// ---- seccomp

/// What the libraries below us need to read, compute and write; everything else is refused with
/// EPERM. New calls join here when something is found to need them.
constexpr auto kAllowed = std::to_array<int>({
    // files; Landlock says which
    SCMP_SYS(access),
    SCMP_SYS(faccessat),
    SCMP_SYS(faccessat2),
    SCMP_SYS(open),
    SCMP_SYS(openat),
    SCMP_SYS(openat2),
    SCMP_SYS(close),
    SCMP_SYS(close_range),
    SCMP_SYS(read),
    SCMP_SYS(readv),
    SCMP_SYS(pread64),
    SCMP_SYS(write),
    SCMP_SYS(writev),
    SCMP_SYS(pwrite64),
    SCMP_SYS(lseek),
    SCMP_SYS(fstat),
    SCMP_SYS(stat),
    SCMP_SYS(lstat),
    SCMP_SYS(newfstatat),
    SCMP_SYS(statx),
    SCMP_SYS(statfs),
    SCMP_SYS(fstatfs),
    SCMP_SYS(readlink),
    SCMP_SYS(readlinkat),
    SCMP_SYS(getdents64),
    SCMP_SYS(getcwd),
    SCMP_SYS(mkdir),
    SCMP_SYS(mkdirat),
    SCMP_SYS(unlink),
    SCMP_SYS(unlinkat),
    SCMP_SYS(rmdir),
    SCMP_SYS(rename),
    SCMP_SYS(renameat),
    SCMP_SYS(renameat2),
    SCMP_SYS(fsync),
    SCMP_SYS(fdatasync),
    SCMP_SYS(ftruncate),
    SCMP_SYS(fadvise64),
    SCMP_SYS(fcntl),
    SCMP_SYS(dup),
    SCMP_SYS(dup2),
    SCMP_SYS(dup3),
    SCMP_SYS(pipe2),
    SCMP_SYS(poll),
    SCMP_SYS(ppoll),
    SCMP_SYS(umask),
    // memory
    SCMP_SYS(brk),
    SCMP_SYS(mmap),
    SCMP_SYS(munmap),
    SCMP_SYS(mprotect),
    SCMP_SYS(mremap),
    SCMP_SYS(madvise),
    SCMP_SYS(mincore),
    // threads, which share what the process may do, and waiting
    SCMP_SYS(futex),
    SCMP_SYS(set_robust_list),
    SCMP_SYS(get_robust_list),
    SCMP_SYS(rseq),
    SCMP_SYS(set_tid_address),
    SCMP_SYS(sched_yield),
    SCMP_SYS(sched_getaffinity),
    SCMP_SYS(getcpu),
    SCMP_SYS(nanosleep),
    SCMP_SYS(clock_nanosleep),
    SCMP_SYS(membarrier),
    SCMP_SYS(wait4),
    SCMP_SYS(waitid),
    // itself and the clock
    SCMP_SYS(getpid),
    SCMP_SYS(getppid),
    SCMP_SYS(gettid),
    SCMP_SYS(getuid),
    SCMP_SYS(geteuid),
    SCMP_SYS(getgid),
    SCMP_SYS(getegid),
    SCMP_SYS(getrandom),
    SCMP_SYS(uname),
    SCMP_SYS(sysinfo),
    SCMP_SYS(times),
    SCMP_SYS(getrusage),
    SCMP_SYS(clock_gettime),
    SCMP_SYS(clock_getres),
    SCMP_SYS(gettimeofday),
    SCMP_SYS(time),
    SCMP_SYS(getrlimit),
    SCMP_SYS(setrlimit),
    SCMP_SYS(rt_sigaction),
    SCMP_SYS(rt_sigprocmask),
    SCMP_SYS(rt_sigreturn),
    SCMP_SYS(sigaltstack),
    SCMP_SYS(restart_syscall),
    SCMP_SYS(arch_prctl),
    SCMP_SYS(exit),
    SCMP_SYS(exit_group),
    // a tighter jail for a child
    SCMP_SYS(prctl),
    SCMP_SYS(seccomp),
    SCMP_SYS(landlock_create_ruleset),
    SCMP_SYS(landlock_add_rule),
    SCMP_SYS(landlock_restrict_self),
});

class Filter {
 public:
  Filter() : context_(::seccomp_init(SCMP_ACT_ERRNO(EPERM))) { ok_ = context_ != nullptr; }
  ~Filter() {
    if (context_ != nullptr) ::seccomp_release(context_);
  }
  Filter(const Filter&) = delete;
  Filter& operator=(const Filter&) = delete;

  void allow(int call, std::initializer_list<scmp_arg_cmp> when = {}) {
    add(SCMP_ACT_ALLOW, call, when);
  }
  void refuse(int call, std::uint16_t error) { add(SCMP_ACT_ERRNO(error), call, {}); }
  bool load() { return ok_ && ::seccomp_load(context_) == 0; }

 private:
  void add(std::uint32_t action, int call, std::initializer_list<scmp_arg_cmp> when) {
    if (!ok_) return;
    ok_ = ::seccomp_rule_add_array(context_, action, call, static_cast<unsigned>(when.size()),
                                   when.size() == 0 ? nullptr : when.begin()) == 0;
  }

  scmp_filter_ctx context_;
  bool ok_ = false;
};

bool restrict_calls(const JailRules& rules) {
  Filter filter;
  for (const int call : kAllowed) filter.allow(call);
  // A terminal is asked what it is, never typed into (TIOCSTI).
  for (const unsigned long request : {TCGETS, TIOCGWINSZ, FIONREAD}) {
    filter.allow(SCMP_SYS(ioctl), {SCMP_A1(SCMP_CMP_EQ, request)});
  }
  const auto self = static_cast<scmp_datum_t>(::getpid());
  filter.allow(SCMP_SYS(prlimit64), {SCMP_A0(SCMP_CMP_EQ, 0)});
  filter.allow(SCMP_SYS(tgkill), {SCMP_A0(SCMP_CMP_EQ, self)});  // abort()
  if (rules.may_fork) {
    filter.allow(SCMP_SYS(clone));
  } else {
    filter.allow(SCMP_SYS(clone), {SCMP_A0(SCMP_CMP_MASKED_EQ, CLONE_THREAD, CLONE_THREAD)});
  }
  // Its flags lie behind a pointer, out of the filter's sight; told that it is not there, the C
  // library uses clone.
  filter.refuse(SCMP_SYS(clone3), ENOSYS);
  return filter.load();
}

}  // namespace

std::vector<fs::path> folder_of(const fs::path& output) {
  if (output.empty()) return {};
  return {output.has_parent_path() ? output.parent_path() : fs::path(".")};
}

JailSupport jail_support() {
  JailSupport out;
  out.landlock_abi = landlock_abi();
  constexpr unsigned kActionAvailable = 2;  // SECCOMP_GET_ACTION_AVAIL
  const std::uint32_t action = 0x00050000;  // SECCOMP_RET_ERRNO
  out.seccomp = ::syscall(SYS_seccomp, kActionAvailable, 0, &action) == 0;
  return out;
}

JailSupport enter_jail(const JailRules& rules) {
  JailSupport holds;
  if (::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return holds;
  const int abi = landlock_abi();
  if (abi > 0 && restrict_files(rules, abi)) holds.landlock_abi = abi;
  holds.seccomp = restrict_calls(rules);
  return holds;
}

}  // namespace limber
