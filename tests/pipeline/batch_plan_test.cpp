// What a job asks for, and what is refused before any work.
#include "pipeline/batch_plan.h"

#include <gtest/gtest.h>

#include "pipeline/batch_job.h"
#include "tests/pipeline/program.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using limber_test::write_text;

/// Runs from a folder of its own, with these empty files in it.
class Place {
 public:
  explicit Place(const std::vector<std::string>& files) : before_(fs::current_path()) {
    fs::current_path(folder_.string());
    for (const std::string& file : files) {
      const fs::path path = folder_ / file;
      fs::create_directories(path.parent_path());
      write_text(path, "");
    }
  }
  ~Place() { fs::current_path(before_); }

 private:
  limber_test::Folder folder_;
  fs::path before_;
};

/// "path>folder+stem" of each source; the error's code where there is one.
std::string planned(const std::vector<std::string>& sources,
                    const std::vector<std::string>& labels = {"hero"}) {
  BatchJob job;
  job.sources = sources;
  job.output = "out";
  const auto plan = plan_batch(job, labels);
  if (!plan) return plan.error().code;
  std::string text;
  for (const BatchSource& s : plan->sources) {
    text += (text.empty() ? "" : " ") + s.path + ">" + s.folder + s.stem;
  }
  return text;
}

TEST(BatchPlan, PatternsKeepTheFoldersBelowTheirFixedPart) {
  const Place place({"in/a.bvh", "in/x/b.bvh", "in/x/y/c.bvh", "in/x/n.txt", "in/.h/d.bvh"});
  EXPECT_EQ(planned({"in/*.bvh"}), "in/a.bvh>a");
  EXPECT_EQ(planned({"in/**/*.bvh"}), "in/a.bvh>a in/x/b.bvh>x/b in/x/y/c.bvh>x/y/c");
  EXPECT_EQ(planned({"in/x/**/*.bvh"}), "in/x/b.bvh>b in/x/y/c.bvh>y/c");
  EXPECT_EQ(planned({"in/?/[bn].bvh"}), "in/x/b.bvh>x/b");
  EXPECT_EQ(planned({"in/**/y/*"}), "in/x/y/c.bvh>x/y/c");
  EXPECT_EQ(planned({"./in/*.bvh", "in/a.bvh"}), "in/a.bvh>a");  // once
}

TEST(BatchPlan, FoldersAndListsStandForTheirFiles) {
  const Place place({"in/a.bvh", "in/x/b.FBX", "in/n.txt", "out/o.bvh"});
  EXPECT_EQ(planned({"in"}), "in/a.bvh>a in/x/b.FBX>x/b");
  EXPECT_EQ(planned({"."}), "in/a.bvh>in/a in/x/b.FBX>in/x/b");  // and not its own outputs
  write_text("list.txt", "in/x/b.FBX\r\nmissing.bvh\n\n");
  EXPECT_EQ(planned({"@list.txt"}), "in/x/b.FBX>b missing.bvh>missing");
  EXPECT_EQ(planned({"@none.txt"}), "file-missing");
}

TEST(BatchPlan, RefusesWhatMatchesNothing) {
  const Place place({"in/a.bvh"});
  EXPECT_EQ(planned({"in/*.fbx"}), "job-no-sources");
  EXPECT_EQ(planned({"in/a.bvh", "inn/*.bvh"}), "job-no-sources");
}

TEST(BatchPlan, RefusesCollisionsBeforeWork) {
  const Place place({"a/walk.bvh", "a/walk.fbx", "b/Walk.bvh", "c/caf\xC3\xA9.bvh",
                     "d/cafe\xCC\x81.bvh",
                     "e/stra\xC3\x9F"
                     "e.bvh",
                     "f/STRASSE.bvh", "g/x:y.bvh", "h/x_y.bvh"});
  EXPECT_EQ(planned({"a/*"}), "output-collision");
  EXPECT_EQ(planned({"a/*.bvh", "b/*"}), "output-collision");  // case
  EXPECT_EQ(planned({"c/*", "d/*"}), "output-collision");      // composed or not
  EXPECT_EQ(planned({"e/*", "f/*"}), "output-collision");      // full case folding
  EXPECT_EQ(planned({"g/*", "h/*"}), "output-collision");      // made safe
  EXPECT_EQ(planned({"a/*.bvh"}, {"hero", "HERO"}), "output-collision");
  EXPECT_EQ(planned({"**/[Ww]alk.bvh"}), "a/walk.bvh>a/walk b/Walk.bvh>b/Walk");
}

TEST(BatchJob, ErrorsNameThePointer) {
  const auto message = [](const std::string& text) {
    const auto job = job_from_json(text);
    return job ? std::string("fine") : job.error().code + " " + job.error().message;
  };
  const std::string rest = R"(, "targets": ["t"], "output": "o"})";
  EXPECT_EQ(message(R"({"sources": ["a"])" + rest), "fine");
  EXPECT_EQ(message(R"({"sources": ["a"], "targets": [{"path": "t", "map": "m"}], "output": "o",
                        "options": {"formats": ["glb"], "rate": 30}, "caps": {"wall_s": 5}})"),
            "fine");
  const std::pair<const char*, const char*> faults[] = {
      {R"({"sources": "a")", "/sources"},
      {R"({"sources": ["a", 7])", "/sources/1"},
      {R"({"sources": ["a"], "sorces": [])", "/sorces"},
      {R"({"sources": ["a"], "options": {"rate": {}})", "/options/rate"},
      {R"({"sources": ["a"], "options": {"target": "x"})", "/options/target"},
      {R"({"sources": ["a"], "caps": {"wall_s": 0})", "/caps/wall_s"},
      {R"({"sources": ["a"], "caps": {"cpu_s": 1e99})", "/caps/cpu_s"},
      {R"({"sources": ["a"], "rig": "g.json")", "/rig"}};
  for (const auto& [start, pointer] : faults) {
    EXPECT_EQ(message(start + rest).find(std::string("job-field at ") + pointer + ":"), 0U)
        << start << " gave " << message(start + rest);
  }
  EXPECT_EQ(message(R"({"sources": ["a"], "targets": ["t"]})").find("job-field at /output:"), 0U);
  EXPECT_EQ(message("{").find("job-json"), 0U);
}

TEST(BatchJob, ShardsCountFromOne) {
  EXPECT_EQ(parse_shard("7/7")->number, 7);
  for (const char* wrong : {"0/3", "4/3", "1", "1/", "/3", "1/3x", "-1/3", "a/b", ""}) {
    EXPECT_FALSE(parse_shard(wrong).ok()) << wrong;
  }
}

}  // namespace
}  // namespace limber
