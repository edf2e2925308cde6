// `--refine clip` as a user runs it.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/pipeline/program.h"

namespace limber_test {
namespace {

using nlohmann::json;

constexpr const char* kStem = "body_range_of_motion@biped-full";

json refined_into(const fs::path& folder) {
  const auto run =
      limber({"retarget", own_clip("body_range_of_motion.bvh").string(), "--target", "biped-full",
              "--rate", "10", "--refine", "clip", "-o", folder.string()});
  EXPECT_EQ(run.exit_code, 0) << run.out;
  return json::parse(text_of(folder / (std::string(kStem) + ".report.json")), nullptr, false);
}

TEST(ClipRefinement, IsNeverWorseAndKeepsLimitsInTheFile) {
  const Folder folder;
  const json report = refined_into(folder / "a");
  const json& refine = report["refine"];
  EXPECT_EQ(refine["mode"], "clip");
  EXPECT_GT(refine["frames"], 0) << "the solver's gap is told, too";
  const json& clip = refine["clip"];
  EXPECT_EQ(clip["improved"], true);
  EXPECT_LT(clip["cost"]["after"]["total"].get<double>(),
            clip["cost"]["before"]["total"].get<double>());
  EXPECT_LT(clip["jerk_p99_m_s3"]["after"].get<double>(),
            clip["jerk_p99_m_s3"]["before"].get<double>());
  EXPECT_LE(clip["slide_cm_s"]["after"].get<double>(), clip["slide_cm_s"]["before"].get<double>());
  EXPECT_EQ(report["limits"]["violations"], 0);
  EXPECT_EQ(report["certificate"]["ok"], true);
}

TEST(ClipRefinement, GivesTheSameBytesOnEveryRun) {
  const Folder folder;
  refined_into(folder / "a");
  refined_into(folder / "b");
  for (const char* extension : {".glb", ".bvh", ".report.json"}) {
    EXPECT_EQ(text_of((folder / "a") / (std::string(kStem) + extension)),
              text_of(folder / "b" / (std::string(kStem) + extension)))
        << extension;
  }
}

}  // namespace
}  // namespace limber_test
