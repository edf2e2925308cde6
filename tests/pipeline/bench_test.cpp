// `limber bench`: what it counts, on a workload small enough to know the answer.
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/pipeline/program.h"

namespace {

using limber_test::Folder;
using limber_test::limber;
using nlohmann::json;

/// A hinge with a point 1 m from it that turns by 0.1 rad per frame.
json turning_hinge(int frames) {
  json work = {
      {"format", "ikwork/1"},
      {"rig", "HINGE"},
      {"set", "turning"},
      {"start", "previous"},
      {"joints",
       {{{"name", "hinge"},
         {"parent", -1},
         {"type", "hinge"},
         {"offset", {0, 0, 0}},
         {"rest", {1, 0, 0, 0}},
         {"axes", {{0, 0, 1}}},
         {"limits", {{-2, 2}}},
         {"dof", 1},
         {"dof_index", 0}}}},
      {"effectors",
       {{{"name", "tip"},
         {"joint", 0},
         {"offset", {1, 0, 0}},
         {"strong", true},
         {"kind", "pose"},
         {"weight_pos", 1.0},
         {"weight_rot", 1.0}}}},
      {"tolerance",
       {{"stop_pos", 1e-4}, {"stop_rot", 8.7266e-4}, {"success_pos", 1e-3}, {"success_rot", 0.01}}},
      {"truth_q", json::array()},
      {"targets", json::array()}};
  for (int f = 0; f < frames; ++f) {
    const double q = 0.1 * f;
    work["truth_q"].push_back({q});
    work["targets"].push_back(
        {{std::cos(q), std::sin(q), 0.0, std::cos(0.5 * q), 0.0, 0.0, std::sin(0.5 * q)}});
  }
  return work;
}

json bench(const json& work, std::vector<std::string> options) {
  const Folder folder;
  const auto path = folder / "work.json";
  limber_test::write_text(path, work.dump());
  std::vector<std::string> arguments{"bench", path.string(), "--json"};
  arguments.insert(arguments.end(), options.begin(), options.end());
  const auto run = limber(arguments);
  EXPECT_EQ(run.exit_code, 0);
  return json::parse(run.out, nullptr, false);
}

TEST(Bench, IterationsAreCountedForEverySolver) {
  for (const char* solver : {"pgs", "pgs-paper", "ceres"}) {
    const json result = bench(turning_hinge(15), {"--solver", solver, "--start", "previous"});
    EXPECT_GE(result["iterations"]["median"], 1.0) << solver;
    EXPECT_LE(result["iterations"]["median"], result["iterations"]["p99"]) << solver;
  }
}

TEST(Bench, BothTolerancesDecideWhereASolverMayStop) {
  // A turn of 0.1 rad: 0.1 m and 5.73 degrees from frame to frame.
  const auto median = [](std::vector<std::string> options) {
    options.insert(options.end(), {"--solver", "pgs-paper", "--start", "previous"});
    return bench(turning_hinge(15), options)["iterations"]["median"].get<double>();
  };
  EXPECT_EQ(median({"--stop-mm", "150", "--stop-deg", "8"}), 0.0);
  EXPECT_GE(median({"--stop-mm", "150", "--stop-deg", "1"}), 1.0);
  EXPECT_GE(median({"--stop-mm", "10", "--stop-deg", "8"}), 1.0);
  EXPECT_GE(median({"--stop-mm", "150"}), 1.0);  // the other one stays the workload's
}

/// The same hinge, swinging: q = sin of an even share of a turn per frame.
json swinging_hinge(int period, int frames) {
  json work = turning_hinge(frames);
  for (int f = 0; f < frames; ++f) {
    const double q = std::sin(2.0 * M_PI * f / period);
    work["truth_q"][f] = {q};
    work["targets"][f] = {
        {std::cos(q), std::sin(q), 0.0, std::cos(0.5 * q), 0.0, 0.0, std::sin(0.5 * q)}};
  }
  return work;
}

TEST(Bench, ACycleTellsItsSeam) {
  // From the last frame into the first the hinge turns by sin(2 pi / 50), its fastest step; the one
  // before was sin(4 pi / 50) - sin(2 pi / 50).
  const double degree = M_PI / 180.0, turn = std::sin(2.0 * M_PI / 50) / degree;
  const double jump = 2.0 * turn - std::sin(4.0 * M_PI / 50) / degree;
  for (const int frames : {50, 51}) {
    const json cycle = bench(swinging_hinge(50, frames), {"--cycle"})["cycle"];
    EXPECT_EQ(cycle["period"], 50);
    EXPECT_EQ(cycle["last_frame_repeats_first"], frames == 51);
    EXPECT_EQ(cycle["closed"], true);
    EXPECT_NEAR(cycle["seam"]["angle_deg"], turn, 1e-3);
    EXPECT_NEAR(cycle["seam"]["position_mm"], 0.0, 1e-9);  // of joints; the tip is no joint
    EXPECT_NEAR(cycle["seam"]["velocity_jump_deg"], jump, 1e-3);
    EXPECT_NEAR(cycle["elsewhere"]["angle_deg"], turn, 1e-3);
  }
}

TEST(Bench, ACycleIsRefusedWhereThereIsNone) {
  const Folder folder;
  const auto path = folder / "work.json";
  limber_test::write_text(path, swinging_hinge(50, 37).dump());
  EXPECT_EQ(limber({"bench", path.string(), "--cycle"}).exit_code, 2);
  EXPECT_EQ(limber({"bench", path.string()}).exit_code, 0);
  EXPECT_EQ(limber({"bench", path.string(), "--cycle", "--lanes", "2"}).exit_code, 2);
}

TEST(Bench, OptionsOutOfRangeAreUsageErrors) {
  for (const char* option : {"--stop-mm", "--stop-deg", "--sweeps"}) {
    EXPECT_EQ(limber({"bench", "work.json", option, "-1"}).exit_code, 2) << option;
  }
}

}  // namespace
