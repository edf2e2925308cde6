// The batch's core with a make-believe clip's work (fake_batch.cpp): what runs again and what does
// not, what a bad item costs, shards, interrupts.
#include <gtest/gtest.h>
#include <time.h>

#include "pipeline/batch_record.h"
#include "tests/pipeline/batch_ground.h"

namespace {

using limber_test::BatchGround;
using limber_test::text_of;
using limber_test::write_text;
namespace fs = std::filesystem;

void wait_for(const fs::path& path) {
  for (int k = 0; k < 500 && !fs::exists(path); ++k) {
    const timespec pause{0, 10'000'000L};
    ::nanosleep(&pause, nullptr);
  }
}

TEST(Batch, MirrorsFoldersAndCrossesTargets) {
  BatchGround ground;
  ground.put({{"walk.txt", "ok"}, {"a/b/walk.txt", "ok"}}, R"("targets": ["hero", "troll"])");
  EXPECT_EQ(ground.run(), 0);
  const auto tree = ground.tree();
  EXPECT_EQ(tree.size(), 12U);
  for (const char* name : {"walk@hero.glb", "walk@troll.bvh", "a/b/walk@hero.report.json"}) {
    EXPECT_TRUE(tree.contains(name)) << name;
  }
}

TEST(Batch, ASecondRunFindsNothingToDo) {
  BatchGround ground;
  ground.put({{"x.txt", "ok"}, {"y.txt", "bad"}});
  EXPECT_EQ(ground.run(), 1);
  const auto first = ground.reports();
  EXPECT_EQ(ground.run({"--resume"}), 1);  // the bad one is still bad
  EXPECT_TRUE(ground.lines("ran").empty());
  EXPECT_EQ(ground.reports(), first);
  EXPECT_EQ(ground.run(), 1);  // without --resume everything runs
  EXPECT_EQ(ground.lines("ran").size(), 2U);
}

TEST(Batch, WhatChangedRunsAgainAndNothingElse) {
  BatchGround ground;
  const std::string targets = R"("targets": ["hero"])";
  ground.put({{"x.txt", "ok 1"}, {"y.txt", "ok 2"}, {"z.txt", "ref z.bin"}});
  ASSERT_EQ(ground.run(), 0);
  const auto ran_again = [&](std::vector<std::string> options = {}) {
    options.push_back("--resume");
    EXPECT_EQ(ground.run(options), 0);
    std::string names;
    for (const auto& [name, rest] : ground.lines("ran")) names += name + " ";
    return names;
  };
  write_text(ground.in() / "x.txt", "ok 3");
  EXPECT_EQ(ran_again(), "x@hero ");
  write_text(ground.in() / "y.txt", "ok 2");  // another time, the same content
  EXPECT_EQ(ran_again(), "");
  write_text(ground.in() / "z.bin", "what it refers to has come");
  EXPECT_EQ(ran_again(), "z@hero ");
  write_text(ground.in() / "z.bin", "what it refers to has gone");
  EXPECT_EQ(ran_again(), "z@hero ");
  fs::remove(ground.out() / "x@hero.glb");
  EXPECT_EQ(ran_again(), "x@hero ");
  fs::resize_file(ground.out() / "y@hero.bvh", 7);
  EXPECT_EQ(ran_again(), "y@hero ");
  ground.put({}, targets + R"(, "options": {"rate": 30})");
  EXPECT_EQ(ran_again(), "x@hero y@hero z@hero ");
}

TEST(Batch, VerifyReadsWhatResumeTrusts) {
  BatchGround ground;
  ground.put({{"x.txt", "ok 1"}, {"y.txt", "ok 2"}});
  ASSERT_EQ(ground.run(), 0);
  const auto whole = ground.tree();
  // Same size and time, other content: as a failing disk does it.
  const auto time = fs::last_write_time(ground.in() / "y.txt");
  write_text(ground.in() / "y.txt", "ok 3");
  fs::last_write_time(ground.in() / "y.txt", time);
  std::string spoilt = text_of(ground.out() / "x@hero.glb");
  spoilt[5] ^= 1;
  write_text(ground.out() / "x@hero.glb", spoilt);
  EXPECT_EQ(ground.run({"--resume"}), 0);
  EXPECT_EQ(ground.lines("ran").size(), 0U);
  EXPECT_EQ(ground.run({"--verify"}), 0);
  EXPECT_EQ(ground.lines("ran").size(), 2U);
  EXPECT_EQ(ground.tree().at("x@hero.glb"), whole.at("x@hero.glb"));
  EXPECT_NE(ground.tree().at("y@hero.glb"), whole.at("y@hero.glb"));
}

TEST(Batch, OutputsThatAreNoLongerMadeGo) {
  BatchGround ground;
  ground.put({{"x.txt", "ok"}});
  ASSERT_EQ(ground.run(), 0);
  write_text(ground.out() / "mine.txt", "not of the batch");
  write_text(ground.in() / "x.txt", "bad");
  ASSERT_EQ(ground.run({"--resume"}), 1);
  EXPECT_EQ(ground.tree().size(), 2U);
  EXPECT_TRUE(ground.tree().contains("x@hero.report.json"));
  EXPECT_TRUE(ground.tree().contains("mine.txt"));
}

TEST(Batch, ABadItemCostsItselfAlone) {
  const std::map<std::string, std::string> good = {{"g1.txt", "ok 1"}, {"s/g2.txt", "ok 2"}};
  BatchGround alone;
  alone.put(good);
  ASSERT_EQ(alone.run(), 0);
  auto sources = good;
  sources.insert({{"crash.txt", "crash"},
                  {"flaky.txt", "flaky"},
                  {"hang.txt", "hang"},
                  {"hog.txt", "hog"},
                  {"liar.txt", "liar"},
                  {"mute.txt", "mute"},
                  {"bad.txt", "bad"}});
  BatchGround ground;
  ground.put(sources, R"("targets": ["hero"], "caps": {"wall_s": 2, "memory_mb": 512})");
  EXPECT_EQ(ground.run({"-j", "3"}), 1);
  const auto ran = ground.lines("ran");
  EXPECT_EQ(ran.at("crash@hero"), " process-crashed x2");
  EXPECT_EQ(ran.at("flaky@hero"), "  x2");
  EXPECT_EQ(ran.at("hang@hero"), " process-timeout x1");
#if !defined(__SANITIZE_ADDRESS__)
  EXPECT_NE(ran.at("hog@hero").find("process-"), std::string::npos);
#endif
  EXPECT_EQ(ran.at("liar@hero"), " process-failed x2");
  EXPECT_EQ(ran.at("mute@hero"), " process-failed x2");
  const auto tree = ground.tree();
  for (const auto& [name, content] : alone.tree()) EXPECT_EQ(tree.at(name), content) << name;
  for (const auto& [name, content] : sources) {
    EXPECT_TRUE(tree.contains(name.substr(0, name.size() - 4) + "@hero.report.json")) << name;
  }
  EXPECT_FALSE(tree.contains("passwd"));
  EXPECT_EQ(ground.leftovers(), 0U);
}

TEST(Batch, EachClipOfAFileHasItsOwnTimeAndItsOwnEnd) {
  BatchGround ground;
  ground.put({{"many.txt", "parts ooo"}, {"mixed.txt", "parts oxhfo"}},
             R"("targets": ["hero"], "caps": {"wall_s": 1})");
  EXPECT_EQ(ground.run({"-j", "2"}), 1);
  EXPECT_EQ(ground.lines("ran").at("many@hero"), "  x1") << "1.8 s, no clip of it more than 1";
  EXPECT_EQ(ground.lines("ran").at("mixed@hero"), "  x1");
  const auto clips = ground.lines("clip");
  EXPECT_EQ(clips.size(), 8U);
  EXPECT_EQ(clips.at("mixed#0@hero"), " ");
  EXPECT_EQ(clips.at("mixed#1@hero"), " process-crashed");
  EXPECT_EQ(clips.at("mixed#2@hero"), " process-timeout");
  EXPECT_EQ(clips.at("mixed#3@hero"), " ") << "crashed once, then well";
  EXPECT_EQ(clips.at("mixed#4@hero"), " ");
  EXPECT_EQ(ground.tree().size(), 6U * 3U + 2U);
}

TEST(Batch, FailedItemsRunAgainOnRequest) {
  BatchGround ground;
  ground.put({{"x.txt", "ok"}, {"y.txt", "mute"}});
  EXPECT_EQ(ground.run(), 1);
  EXPECT_EQ(ground.run({"--retry-failed"}), 1);
  ASSERT_EQ(ground.lines("ran").size(), 1U);
  EXPECT_TRUE(ground.lines("ran").contains("y@hero"));
}

std::map<std::string, std::string> many(int n) {
  std::map<std::string, std::string> sources;
  for (int i = 0; i < n; ++i) {
    sources[std::string(1, char('a' + i % 3)) + "/c" + std::to_string(i) + ".txt"] =
        i % 5 == 0 ? "bad " + std::to_string(i) : "slow " + std::to_string(i % 4);
  }
  return sources;
}

TEST(Batch, TheSameTreeForAnyNumberOfProcessesAndShards) {
  BatchGround ground;
  ground.put(many(20), R"("targets": ["hero", "troll"])");
  ASSERT_EQ(ground.run({"-j", "1"}), 1);
  const auto whole = ground.tree();
  ground.clear();
  ASSERT_EQ(ground.run({"-j", "8"}), 1);
  EXPECT_EQ(ground.tree(), whole);
  for (const int n : {3, 7}) {
    ground.clear();
    std::vector<pid_t> shards;  // all at once, as a cluster runs them
    for (int i = 1; i <= n; ++i) {
      shards.push_back(ground.start({"--shard", std::to_string(i) + "/" + std::to_string(n)}));
    }
    for (const pid_t shard : shards) EXPECT_LE(BatchGround::finish(shard), 1);  // some have no bad
    EXPECT_EQ(ground.tree(), whole) << n;
    EXPECT_EQ(ground.run({"--resume"}), 1);  // the whole batch knows what its shards did
    EXPECT_TRUE(ground.lines("ran").empty()) << n;
  }
}

TEST(Batch, AMovedFolderResumesWithNothingToDo) {
  BatchGround ground;
  ground.put({{"x.txt", "ok"}, {"a/y.txt", "ok"}});
  ASSERT_EQ(ground.run(), 0);
  const limber_test::Folder elsewhere;
  fs::rename(ground.in(), elsewhere / "in");
  fs::rename(ground.out(), elsewhere / "out");
  fs::copy(ground.job(), elsewhere / "job.json");
  const auto there = limber_test::fs::path(elsewhere / "job.json").string();
  const std::string command = std::string(LIMBER_FAKE_BATCH) + " '" + there + "' --resume > '" +
                              (elsewhere / "log").string() + "'";
  EXPECT_EQ(std::system(command.c_str()), 0);
  EXPECT_EQ(text_of(elsewhere / "log"), "end passed 2 failed 0 before 2 left 0\n");
}

TEST(Batch, OneInterruptDrainsTwoStop) {
  BatchGround ground;
  ground.put({{"a.txt", "slow 700"}, {"b.txt", "ok"}, {"c.txt", "ok"}});
  const auto begun = [&] {
    for (int k = 0; k < 500; ++k) {
      if (fs::exists(ground.out() / ".limber/work") && ground.leftovers() > 0) return;
      const timespec pause{0, 5'000'000L};
      ::nanosleep(&pause, nullptr);
    }
  };
  pid_t pid = ground.start({"-j", "1"});
  begun();
  ::kill(pid, SIGTERM);
  EXPECT_EQ(BatchGround::finish(pid), 130);
  EXPECT_EQ(ground.tree().size(), 3U);  // a, and nothing else
  EXPECT_EQ(ground.run({"--resume"}), 0);
  EXPECT_EQ(ground.lines("ran").size(), 2U);

  ground.clear();
  write_text(ground.in() / "a.txt", "slow 60000");
  pid = ground.start({"-j", "1"});
  begun();
  ::kill(pid, SIGINT);
  const timespec pause{0, 100'000'000L};
  ::nanosleep(&pause, nullptr);
  ::kill(pid, SIGINT);
  EXPECT_EQ(BatchGround::finish(pid), 130);
  EXPECT_TRUE(ground.tree().empty());
  EXPECT_EQ(ground.leftovers(), 0U);
  write_text(ground.in() / "a.txt", "ok");
  EXPECT_EQ(ground.run({"--resume"}), 0);
}

TEST(Batch, TwoRunsNeverShareAFolder) {
  BatchGround ground;
  ground.put({{"a.txt", "slow 60000"}});
  const pid_t pid = ground.start();
  wait_for(ground.out() / ".limber/records.jsonl");
  EXPECT_EQ(ground.run(), 3);
  ::kill(pid, SIGKILL);
  BatchGround::finish(pid);
  write_text(ground.in() / "a.txt", "ok");
  EXPECT_EQ(ground.run(), 0);  // the lock does not outlive its holder
}

TEST(BatchRecord, SurvivesItsJournal) {
  const limber_test::Folder folder;
  limber::BatchRecord record{.item = "a/walk@hero",
                             .recipe = "r",
                             .staged = "s",
                             .inputs = {{"in/\"walk\".bvh", 12, 34567890123456789, "h"}},
                             .files = {{"a/walk@hero.glb", 5, 0, "g"}},
                             .removes = {"a/walk@hero.bvh"},
                             .clips = {{.source = "in",
                                        .clip = "c",
                                        .stem = "walk@hero",
                                        .status = limber::Status::warn,
                                        .code = "x",
                                        .message = "line\nbreak"}},
                             .attempts = 2,
                             .seconds = 0.5};
  const fs::path path = folder / "records.jsonl";
  {
    auto journal = limber::Journal::open(path);
    ASSERT_TRUE(journal.ok());
    ASSERT_TRUE(journal->append(record).ok());
  }
  const std::string line = text_of(path);
  // A torn copy of the line at every length, then a writer that goes on.
  for (std::size_t n = 1; n < line.size() - 1; n += 7) {
    write_text(path, line + line.substr(0, n));
    auto journal = limber::Journal::open(path);
    ASSERT_TRUE(journal.ok());
    ASSERT_TRUE(journal->append(record).ok());
    int found = 0;
    limber::read_journal(path, [&](const limber::BatchRecord& read) {
      ++found;
      EXPECT_EQ(limber::to_json_line(read), line);
    });
    EXPECT_EQ(found, 2) << n;
  }
}

}  // namespace
