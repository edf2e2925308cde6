// A jailed process is told to misbehave, and must not be able to.

#include "pipeline/jail.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <seccomp.h>
#include <spawn.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <csignal>
#include <functional>
#include <new>
#include <thread>

#include "pipeline/isolated.h"
#include "pipeline/reading_budget.h"
#include "tests/pipeline/program.h"

namespace limber {
namespace {

using limber_test::Folder;
using limber_test::own_clip;
using limber_test::text_of;
using limber_test::write_text;
namespace fs = std::filesystem;

#define LIMBER_NEEDS_JAIL() \
  if (!sandbox_available()) GTEST_SKIP() << "this kernel confines by " << sandbox_level() << " only"

/// "ok", or the name of the error that a call ended with.
std::string outcome(long result) { return result >= 0 ? "ok" : ::strerrorname_np(errno); }

std::string opens(const fs::path& path, int flags = O_RDONLY) {
  return outcome(::open(path.c_str(), flags | O_CLOEXEC | O_NONBLOCK, 0600));
}

/// What `work` says from inside a jail with these rules.
std::string inside(const JailRules& rules, const std::function<std::string()>& work) {
  const auto answer = run_isolated(work, {.may = rules, .sandbox = SandboxMode::require});
  return answer ? *answer : answer.error().code;
}

// ---- files

class JailedFiles : public testing::Test {
 protected:
  void SetUp() override {
    LIMBER_NEEDS_JAIL();
    for (const char* name : {"in", "out", "other"}) fs::create_directory(root_ / name);
    write_text(root_ / "in/clip.bvh", "clip");
    write_text(root_ / "in/near.bin", "near");
    write_text(root_ / "other/secret.bin", "secret");
    rules_.reads = {root_ / "in/clip.bvh"};
    rules_.writes = {root_ / "out"};
  }
  std::string open_inside(const fs::path& path, int flags = O_RDONLY) const {
    return inside(rules_, [&] { return opens(path, flags); });
  }

  Folder root_;
  JailRules rules_;
};

TEST_F(JailedFiles, TheInputsFolderIsReadAndNothingElse) {
  EXPECT_EQ(open_inside(root_ / "in/clip.bvh"), "ok");
  EXPECT_EQ(open_inside(root_ / "in/near.bin"), "ok");
  for (const char* path : {"/etc/passwd", "/proc/self/environ", "/dev/zero", "/root", "/home"}) {
    EXPECT_EQ(open_inside(path), "EACCES") << path;
  }
  EXPECT_EQ(open_inside(root_ / "other/secret.bin"), "EACCES");
  EXPECT_EQ(open_inside(root_ / "in/../other/secret.bin"), "EACCES");
  EXPECT_EQ(open_inside(root_ / "in/missing.bin"), "ENOENT");
}

TEST_F(JailedFiles, LinksAndPipesLeadNowhere) {
  fs::create_symlink(root_ / "other/secret.bin", root_ / "in/link.bin");
  fs::create_symlink("/etc", root_ / "in/folder");
  ASSERT_EQ(::mkfifo((root_ / "other/pipe").c_str(), 0600), 0);
  fs::create_symlink(root_ / "other/pipe", root_ / "in/pipe");
  EXPECT_EQ(open_inside(root_ / "in/link.bin"), "EACCES");
  EXPECT_EQ(open_inside(root_ / "in/folder/passwd"), "EACCES");
  EXPECT_EQ(open_inside(root_ / "in/pipe"), "EACCES");
}

TEST_F(JailedFiles, AnInputThatIsALinkItselfIsRead) {
  fs::create_symlink(root_ / "other/secret.bin", root_ / "in/given.bvh");
  rules_.reads = {root_ / "in/given.bvh"};
  EXPECT_EQ(open_inside(root_ / "in/given.bvh"), "ok");
  write_text(root_ / "other/neighbour.bin", "");
  EXPECT_EQ(open_inside(root_ / "other/neighbour.bin"), "EACCES");
}

TEST_F(JailedFiles, WritingEndsAtTheOutputFolder) {
  EXPECT_EQ(open_inside(root_ / "out/new.glb", O_WRONLY | O_CREAT), "ok");
  EXPECT_EQ(open_inside(root_ / "out/new.glb", O_WRONLY | O_TRUNC), "ok");
  EXPECT_EQ(open_inside(root_ / "in/clip.bvh", O_WRONLY), "EACCES");
  EXPECT_EQ(open_inside(root_ / "in/clip.bvh", O_RDONLY | O_TRUNC), "EACCES");
  EXPECT_EQ(open_inside(root_ / "in/new.bin", O_WRONLY | O_CREAT), "EACCES");
  EXPECT_EQ(open_inside(root_ / "new.bin", O_WRONLY | O_CREAT), "EACCES");
  const std::string in = root_ / "in/clip.bvh", out = root_ / "out/stolen.bvh";
  const auto moved = inside(rules_, [&] { return outcome(::rename(in.c_str(), out.c_str())); });
  EXPECT_NE(moved, "ok");
  EXPECT_EQ(inside(rules_, [&] { return outcome(::unlink(in.c_str())); }), "EACCES");
  EXPECT_EQ(inside(rules_, [&] { return outcome(::chmod(in.c_str(), 0777)); }), "EPERM");
  EXPECT_EQ(inside(rules_, [&] { return outcome(::link(in.c_str(), out.c_str())); }), "EPERM");
  EXPECT_EQ(text_of(root_ / "in/clip.bvh"), "clip");
}

TEST_F(JailedFiles, NamesThatAreNoFilesGrantNothing) {
  const fs::path here = fs::current_path();
  fs::current_path(root_ / "other");
  rules_.reads = {"biped-full"};  // a shipped rig: its folder would be the current one
  const std::string seen = open_inside("secret.bin");
  fs::current_path(here);
  EXPECT_EQ(seen, "EACCES");
}

TEST_F(JailedFiles, AChildsJailIsNoWiderThanItsParents) {
  rules_.may_fork = true;
  const auto from_child = [&](const JailRules& child_rules, const fs::path& path) {
    return inside(rules_, [&] { return inside(child_rules, [&] { return opens(path); }); });
  };
  EXPECT_EQ(from_child({}, root_ / "in/clip.bvh"), "EACCES");
  EXPECT_EQ(from_child({.reads = {root_ / "other/secret.bin"}}, root_ / "other/secret.bin"),
            "EACCES");
  EXPECT_EQ(from_child(rules_, root_ / "in/clip.bvh"), "ok");
}

// ---- system calls

TEST(JailedCalls, NoNetworkNoProgramsNoProcesses) {
  LIMBER_NEEDS_JAIL();
  const auto refused = [](const char* what, const std::function<long()>& call) {
    EXPECT_EQ(inside({}, [&] { return outcome(call()); }), "EPERM") << what;
  };
  refused("TCP", [] { return ::socket(AF_INET, SOCK_STREAM, 0); });
  refused("UDP", [] { return ::socket(AF_INET6, SOCK_DGRAM, 0); });
  refused("unix", [] { return ::socket(AF_UNIX, SOCK_STREAM, 0); });
  refused("pair", [] {
    int ends[2];
    return ::socketpair(AF_UNIX, SOCK_STREAM, 0, ends);
  });
  refused("exec", [] {
    char program[] = "/bin/true";
    char* arguments[] = {program, nullptr};
    return ::execve(program, arguments, nullptr);
  });
  refused("fork", [] { return ::fork(); });
  refused("kill", [] { return ::kill(::getppid(), 0); });
  refused("trace", [] { return ::ptrace(PTRACE_TRACEME, 0, nullptr, nullptr); });
  refused("io_uring", [] { return ::syscall(SYS_io_uring_setup, 1, nullptr); });
  refused("bpf", [] { return ::syscall(SYS_bpf, 0, nullptr, 0); });
  refused("namespace", [] { return ::syscall(SYS_unshare, 0x10000000); });
  refused("memfd", [] { return ::syscall(SYS_memfd_create, "x", 0); });
  refused("typing into the terminal", [] { return ::ioctl(STDIN_FILENO, TIOCSTI, "x"); });
  refused("signal to the parent",
          [] { return ::syscall(SYS_tgkill, ::getppid(), ::getppid(), 0); });
}

TEST(JailedCalls, SpawningIsRefused) {
  LIMBER_NEEDS_JAIL();
  for (const bool may_fork : {false, true}) {
    const auto spawned = inside({.may_fork = may_fork}, [] {
      char program[] = "/bin/true";
      char* arguments[] = {program, nullptr};
      pid_t pid = 0;
      return std::string(
          ::strerrorname_np(::posix_spawn(&pid, program, nullptr, nullptr, arguments, nullptr)));
    });
    EXPECT_EQ(spawned, "EPERM");
  }
}

TEST(JailedCalls, ThreadsCharacterSetsAndAssertsStillWork) {
  LIMBER_NEEDS_JAIL();
  EXPECT_EQ(inside({},
                   [] {
                     int sum = 0;
                     std::thread([&] { sum = 42; }).join();
                     return std::to_string(sum);
                   }),
            "42");
  EXPECT_EQ(inside({}, []() -> std::string { ::abort(); }), "process-crashed");
}

TEST(JailedCalls, OnlyTheAnswerIsOpen) {
  LIMBER_NEEDS_JAIL();
  const int secret = ::open("/etc/passwd", O_RDONLY | O_CLOEXEC);
  ASSERT_GE(secret, 0);
  const auto seen = inside({}, [&] {
    char byte;
    return outcome(secret == 3 ? -1 : ::pread(secret, &byte, 1, 0));
  });
  ::close(secret);
  EXPECT_NE(seen, "ok");
}

// ---- limits

std::string ended_by(const IsolationLimits& limits, const std::function<std::string()>& work) {
  const auto answer = run_isolated(work, {.limits = limits});
  return answer ? "answered" : answer.error().code;
}

TEST(IsolatedLimits, EndlessLoopsSleepsAndSpeechesEnd) {
  EXPECT_EQ(ended_by({.cpu_seconds = 1},
                     [] {
                       volatile bool on = true;
                       while (on) {
                       }
                       return std::string();
                     }),
            "process-limit");
  EXPECT_EQ(ended_by({.wall_seconds = 1},
                     [] {
                       std::this_thread::sleep_for(std::chrono::minutes(10));
                       return std::string();
                     }),
            "process-timeout");
  EXPECT_EQ(ended_by({.answer_bytes = 1000}, [] { return std::string(200'000, 'x'); }),
            "process-limit");
  EXPECT_EQ(ended_by({.answer_bytes = 1000}, [] { return std::string(1000, 'x'); }), "answered");
}

TEST(IsolatedLimits, MemoryAndFilesEnd) {
  if (!kMemoryCanBeLimited) GTEST_SKIP() << "AddressSanitizer maps more than any limit";
  EXPECT_EQ(ended_by({.memory_bytes = std::uint64_t(1) << 30},
                     [] { return std::string(std::size_t(2) << 30, 'x'); }),
            "process-limit");
  const Folder folder;
  const fs::path path = folder / "large";
  const auto answer = run_isolated(
      [&] {
        const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT, 0600);
        const std::string block(100'000, 'x');
        while (::write(fd, block.data(), block.size()) > 0) {
        }
        return std::string("no end");
      },
      {.may = {.writes = {path.parent_path()}}, .limits = {.file_bytes = 150'000}});
  ASSERT_FALSE(answer.ok()) << *answer;
  EXPECT_EQ(answer.error().code, "process-limit");
  EXPECT_EQ(fs::file_size(path), 150'000U);
}

TEST(IsolatedLimits, ReadingHasABudgetThatEndsWithIt) {
  if (!kMemoryCanBeLimited) GTEST_SKIP() << "AddressSanitizer maps more than any limit";
  const auto answer = run_isolated([] {
    const auto fits = [](std::size_t bytes) {
      void* memory = ::operator new(bytes, std::nothrow);
      ::operator delete(memory);
      return memory != nullptr ? std::string("1") : std::string("0");
    };
    const std::size_t two_gigabytes = std::size_t(2) << 30;
    std::string seen = fits(two_gigabytes);
    {
      const ReadingBudget small(1000);
      seen += fits(two_gigabytes);
    }
    {
      const ReadingBudget large(100'000'000);
      seen += fits(two_gigabytes);
    }
    return seen + fits(two_gigabytes);
  });
  ASSERT_TRUE(answer.ok()) << answer.error().message;
  EXPECT_EQ(*answer, "1011");
}

// ---- what the program promises

/// Runs `limber` where the kernel has no Landlock, as far as it can tell.
int without_landlock(const std::vector<std::string>& arguments) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    ::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0);
    scmp_filter_ctx filter = ::seccomp_init(SCMP_ACT_ALLOW);
    ::seccomp_rule_add(filter, SCMP_ACT_ERRNO(ENOSYS), SCMP_SYS(landlock_create_ruleset), 0);
    if (::seccomp_load(filter) != 0) ::_exit(99);
    ::_exit(limber_test::limber(arguments).exit_code);
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

TEST(Sandbox, RequireRefusesWhereTheJailIsNotWhole) {
  const Folder folder;
  const auto arguments = [&](const char* mode) {
    return std::vector<std::string>{"retarget",  own_clip("gestures_right_hand.bvh").string(),
                                    "--target",  "hand",
                                    "-o",        (folder / mode).string(),
                                    "--refine",  "none",
                                    "--sandbox", mode};
  };
  EXPECT_EQ(without_landlock(arguments("require")), 3);
  EXPECT_FALSE(fs::exists(folder / "require/gestures_right_hand@hand.glb"));
  EXPECT_EQ(without_landlock(arguments("auto")), 0);
  if (sandbox_available()) {
    EXPECT_EQ(limber_test::limber(arguments("require")).exit_code, 0);
  }
}

}  // namespace
}  // namespace limber
