// A frame of a clip, written down and solved again alone, is the frame that the clip has.
#include "pipeline/frame_replay.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "importers/importer.h"
#include "solver/ik_solver.h"
#include "tests/pipeline/program.h"

namespace limber_test {
namespace {

TEST(FrameReplay, SolvesTheFrameAlone) {
  const std::string text = text_of(own_clip("body_range_of_motion.bvh"));
  const auto source = limber::import_bytes(
      std::as_bytes(std::span(text.data(), text.size())), "bvh",
      [](std::string_view) { return limber::Error{.code = "uri-refused", .message = ""}; }, {});
  ASSERT_TRUE(source);
  const auto figure = limber::identify_figure(source->character);
  ASSERT_TRUE(figure);
  const auto calibration =
      limber::calibrate(source->character, *figure, {}, source->reference_pose, nullptr);
  ASSERT_TRUE(calibration);
  const auto target = limber::load_target("biped-full", {});
  ASSERT_TRUE(target);
  limber::RetargetOptions options;
  options.range = {100, 500};
  options.collision = false;
  const auto clip = limber::retarget_clip(
      {&source->character, &*figure, &*calibration, &source->clips.front()}, *target, options);
  ASSERT_TRUE(clip);

  const Folder folder;
  for (const std::int64_t frame : {0, 130, 275}) {
    const limber::FrameReplay replay = limber::replay_of(*clip, frame);
    write_text(folder / "rig.json", replay.rig);
    write_text(folder / "targets.json", replay.targets);
    const auto run =
        limber({"pose", (folder / "rig.json").string(), "--targets",
                (folder / "targets.json").string(), "-o", (folder / "s.png").string(), "--json"});
    ASSERT_EQ(run.exit_code, 0) << run.out;
    const nlohmann::json pose = nlohmann::json::parse(run.out)["poses"][0];
    EXPECT_EQ(pose["limits"]["violations"], 0);
    const double cost =
        limber::effector_cost(clip->rig, clip->track.at(frame), clip->rig_clip.frame(frame));
    // From rest, not from the frames beside it: the same optimum, to the solver's tolerance.
    EXPECT_NEAR(pose["solver"]["cost"].get<double>(), cost, 1e-8 + 1e-3 * cost) << frame;
    EXPECT_NEAR(pose["ceres"]["cost"].get<double>(), cost, 1e-8 + 1e-3 * cost) << frame;
  }
}

}  // namespace
}  // namespace limber_test
