// What a batch promises when it is killed and when the disk fails (DESIGN, "Nothing is lost"),
// tried at every system call that writes. A fault is planted in the running program, not in a model
// of it.
#include <gtest/gtest.h>
#include <time.h>

#include "tests/pipeline/batch_ground.h"

namespace {

using limber_test::BatchGround;
using Tree = std::map<std::string, std::string>;

#if defined(__SANITIZE_ADDRESS__)
#define SKIP_UNDER_SANITIZER() GTEST_SKIP() << "the sanitizer wants to be preloaded first"
#else
#define SKIP_UNDER_SANITIZER()
#endif

/// Items that succeed with two clips, fail and crash, in folders.
void furnish(BatchGround& ground) {
  ground.put({{"walk.txt", "twin 1"}, {"a/run.txt", "bad 2"}, {"a/b/jump.txt", "crash"}});
}

Tree undisturbed() {
  BatchGround ground;
  furnish(ground);
  EXPECT_EQ(ground.run(), 1);
  return ground.tree();
}

long calls_of(BatchGround& ground) {
  EXPECT_EQ(ground.run({"-j", "1"}, ground.with_fault("count")), 1);
  const long calls = ground.counted();
  ground.clear();
  return calls;
}

/// Everything that can be seen is whole and right; what is missing is not there yet.
void expect_part_of(const Tree& part, const Tree& whole, const std::string& when) {
  for (const auto& [name, content] : part) {
    const auto found = whole.find(name);
    ASSERT_NE(found, whole.end()) << when << ": " << name << " was left over";
    EXPECT_EQ(content, found->second) << when << ": " << name << " is not whole";
  }
}

/// Resumes, and finds all as if nothing had been.
void expect_resumes(const BatchGround& ground, const Tree& whole, const std::string& when) {
  expect_part_of(ground.tree(), whole, when);
  const auto finished = ground.reports();
  EXPECT_EQ(ground.run({"--resume"}), 1) << when;
  EXPECT_EQ(ground.tree(), whole) << when;
  EXPECT_EQ(ground.leftovers(), 0U) << when;
  const auto now = ground.reports();
  for (const auto& [name, identity] : finished) {
    EXPECT_EQ(now.at(name), identity) << when << ": " << name << " was made again";
  }
}

TEST(BatchFaults, KilledAtEveryCallItResumesAsIfNothingHadBeen) {
  SKIP_UNDER_SANITIZER();
  const Tree whole = undisturbed();
  ASSERT_EQ(whole.size(), 8U);
  BatchGround ground;
  furnish(ground);
  const long calls = calls_of(ground);
  ASSERT_GT(calls, 30);
  for (long n = 1; n <= calls; ++n) {
    ground.clear();
    const std::string when = "killed at call " + std::to_string(n);
    EXPECT_EQ(ground.run({"-j", "1"}, ground.with_fault("kill:" + std::to_string(n))), -SIGKILL)
        << when;
    expect_resumes(ground, whole, when);
  }
}

TEST(BatchFaults, KilledAgainAndAgainItEndsAllTheSame) {
  SKIP_UNDER_SANITIZER();
  const Tree whole = undisturbed();
  BatchGround ground;
  furnish(ground);
  int runs = 0;
  // Enough calls to commit an item, not enough to put all its files into place.
  while (ground.run({"-j", "1", "--resume"}, ground.with_fault("kill:38")) == -SIGKILL) {
    expect_part_of(ground.tree(), whole, "run " + std::to_string(runs));
    ASSERT_LT(++runs, 20);
  }
  EXPECT_GT(runs, 1);
  expect_resumes(ground, whole, "in the end");
}

TEST(BatchFaults, AChildKilledAtAnyCallIsTriedOnceMore) {
  SKIP_UNDER_SANITIZER();
  BatchGround ground;
  ground.put({{"walk.txt", "ok 1"}});
  ASSERT_EQ(ground.run(), 0);
  const Tree whole = ground.tree();
  ground.clear();
  ASSERT_EQ(ground.run({"-j", "1"}, ground.with_fault("count")), 0);
  const long calls = ground.counted();
  int children = 0;
  for (long n = 1; n <= calls; ++n) {
    ground.clear();
    const int code = ground.run({"-j", "1"}, ground.with_fault("crash:" + std::to_string(n)));
    if (code == -SIGKILL) continue;  // the parent's own call
    ++children;
    EXPECT_EQ(code, 0) << n;
    EXPECT_EQ(ground.tree(), whole) << n;
    EXPECT_EQ(ground.lines("ran")["walk@hero"], "  x2") << n;
  }
  EXPECT_GE(children, 12);
}

class DiskFault : public testing::TestWithParam<const char*> {};

TEST_P(DiskFault, StopsTheBatchAndLosesNothing) {
  SKIP_UNDER_SANITIZER();
  const Tree whole = undisturbed();
  BatchGround ground;
  furnish(ground);
  const long calls = calls_of(ground);
  for (const char* onwards : {"", "+"}) {
    for (long n = 1; n <= calls; ++n) {
      ground.clear();
      const std::string fault = GetParam() + (":" + std::to_string(n)) + onwards;
      EXPECT_EQ(ground.run({"-j", "1"}, ground.with_fault(fault)), 3) << fault;
      if (!ground.tree().empty() || limber_test::fs::exists(ground.out() / ".limber/work")) {
        expect_resumes(ground, whole, fault);
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(BatchFaults, DiskFault, testing::Values("ENOSPC", "EIO", "EFBIG"));

TEST(BatchFaults, KilledAtRandomTimesItResumes) {
  const int kItems = 24;
  std::map<std::string, std::string> sources;
  for (int i = 0; i < kItems; ++i) {
    sources["c" + std::to_string(i) + ".txt"] = "slow " + std::to_string(i % 4);
  }
  BatchGround reference;
  reference.put(sources);
  ASSERT_EQ(reference.run(), 0);
  BatchGround ground;
  ground.put(sources);
  std::uint32_t state = 7;
  int killed = 0;
  for (int k = 0; k < 100; ++k) {
    if (k % 10 == 0) ground.clear();
    const pid_t pid = ground.start({"-j", "4", "--resume"});
    state = state * 1664525U + 1013904223U;  // Numerical Recipes' generator
    const timespec pause{0, static_cast<long>((state >> 16) % 30) * 1'000'000L};
    ::nanosleep(&pause, nullptr);
    ::kill(pid, SIGKILL);
    const auto finished = ground.reports();
    killed += BatchGround::finish(pid) == -SIGKILL;
    expect_part_of(ground.tree(), reference.tree(), "kill " + std::to_string(k));
    if (k % 10 != 9) continue;
    ASSERT_EQ(ground.run({"-j", "4", "--resume"}), 0);
    EXPECT_EQ(ground.tree(), reference.tree());
    EXPECT_EQ(ground.leftovers(), 0U);
    const auto now = ground.reports();
    for (const auto& [name, identity] : finished) EXPECT_EQ(now.at(name), identity) << name;
  }
  EXPECT_GT(killed, 50);
}

}  // namespace
