// FBX as Blender reads it, where Blender is installed: an importer that shares no line with
// assimp's. Joints of one name stand in the same places, on the file's own key frames.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/importers/support.h"

namespace limber::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr double kTolerance_m = 1e-3;

/// What Blender says of the files, by path; null where it could not be asked.
json ask_blender(const std::vector<fs::path>& files) {
  if (std::system("command -v blender >/dev/null 2>&1") != 0) return nullptr;
  const fs::path answer =
      fs::temp_directory_path() / fmt::format("limber-blender-{}.json", ::getpid());
  std::string command =
      fmt::format("blender -b --python '{}' -- '{}'",
                  LIMBER_SOURCE_DIR "/tests/importers/blender_joints.py", answer.string());
  for (const fs::path& file : files) command += " '" + file.string() + "'";
  const int status = std::system((command + " >/dev/null 2>&1").c_str());
  std::ifstream in(answer);
  json told = status == 0 && in ? json::parse(in, nullptr, false) : json(nullptr);
  fs::remove(answer);
  return told;
}

/// Largest distance between joints of one name; Blender has Z up.
struct Distance {
  double largest_m = 0.0;
  std::string joint;
  int joints = 0, poses = 0;

  void compare(const Skeleton& skeleton, std::span<const DualQuaternion> pose, const json& places) {
    const auto points = joint_positions(skeleton, pose);
    int shared = 0;
    for (const auto& [name, place] : places.items()) {
      const std::int32_t j = skeleton.find(name);
      if (j == kNoJoint) continue;
      ++shared;
      const Eigen::Vector3d theirs(place[0], place[2], -place[1].get<double>());
      const double away = (points[j] - theirs).norm();
      if (away > largest_m) std::tie(largest_m, joint) = std::pair(away, name);
    }
    joints = std::max(joints, shared);
    ++poses;
  }
};

/// Blender numbers frames from 1 at time 0; a take may start later. Keys between our samples are
/// left out: there, how each side interpolates would be compared.
Distance compare_action(const Imported& ours, const Clip& clip, const json& action,
                        double blender_rate_hz) {
  Distance distance;
  const double first = action["frames"][0]["frame"];
  for (const json& posed : action["frames"]) {
    const double seconds = (posed["frame"].get<double>() - first) / blender_rate_hz;
    const double sample = seconds * clip.rate_hz;
    const auto frame = static_cast<std::int64_t>(std::round(sample));
    if (std::abs(sample - double(frame)) > 1e-3 || frame >= clip.frames()) continue;
    distance.compare(ours.character.skeleton, clip.frame(frame), posed["places"]);
  }
  return distance;
}

const Clip* clip_of(const Imported& ours, const std::string& take) {
  for (const Clip& clip : ours.clips) {
    if (("|" + take + "|").find("|" + clip.name + "|") != std::string::npos) return &clip;
  }
  return nullptr;
}

void expect_near(const Distance& distance) {
  EXPECT_LT(distance.largest_m, kTolerance_m) << "at " << distance.joint;
  EXPECT_GE(distance.joints, 15);
  EXPECT_GE(distance.poses, 1);
  testing::Test::RecordProperty("largest_um", int(1e6 * distance.largest_m));
}

/// In the unit that the file states: where that makes giants, ours is guessed, Blender's is not.
Result<Imported> read_as_stated(const fs::path& path) {
  ImportOptions options;
  options.keep_reference_frame = true;
  const auto guessed = import_file(path, options);
  if (!guessed) return guessed;
  double stated_cm = 1.0;
  std::sscanf(guessed->facts.unit_evidence.c_str(), "UnitScaleFactor %lf cm", &stated_cm);
  options.unit_m = 0.01 * stated_cm;
  return import_file(path, options);
}

void compare_file(const fs::path& path, const json& theirs) {
  const auto ours = read_as_stated(path);
  ASSERT_TRUE(ours.ok()) << ours.error().message;
  if (theirs["actions"].empty()) {
    EXPECT_TRUE(ours->clips.empty());
    Distance distance;
    const Skeleton& skeleton = ours->character.skeleton;
    for (const json& still : theirs["still"]) {
      distance.compare(skeleton, skeleton.rest_parent_from_joint, still["places"]);
    }
    expect_near(distance);
  }
  EXPECT_EQ(theirs["actions"].size(), ours->clips.size());
  for (const json& action : theirs["actions"]) {
    SCOPED_TRACE(action["take"].get<std::string>());
    const Clip* clip = clip_of(*ours, action["take"]);
    ASSERT_NE(clip, nullptr);
    expect_near(compare_action(*ours, *clip, action, theirs["rate_hz"]));
  }
}

TEST(Blender, SeesFbxJointsWhereWeDo) {
  LIMBER_NEEDS_SHARED(data);
  std::vector<fs::path> files;
  for (const char* folder : {"characters", "mocap_other"}) {
    for (const auto& entry : fs::directory_iterator(*data / folder)) {
      if (entry.path().extension() == ".fbx") files.push_back(entry.path());
    }
  }
  const json told = ask_blender(files);
  if (told.is_null()) GTEST_SKIP() << "Blender cannot be asked; apt install blender python3-numpy";
  for (const fs::path& path : files) {
    SCOPED_TRACE(path.filename());
    compare_file(path, told[path.string()]);
  }
  EXPECT_GE(files.size(), 8U);
}

}  // namespace
}  // namespace limber::test
