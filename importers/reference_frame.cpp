// Two shares tell a reference frame from a motion that starts at rest: of the joints at rest in
// frame 0, and of those in frame 1. "At rest" is within three degrees: DAZ conversions correct the
// trunk and the shoulders of their T-pose by one or two.
//
// The jump is looked for joint by joint: the same conversions ease their arms out of the T-pose
// over five frames, so the figure as a whole goes on moving fast, while its hips have jumped.
#include "importers/reference_frame.h"

#include <cmath>

namespace limber {
namespace {

constexpr double kJumpRad = M_PI / 18.0;    // ten degrees from one frame to the next
constexpr double kAtRestRad = M_PI / 60.0;  // three degrees
constexpr double kShareAtRest = 0.7;        // of the joints, in frame 0
constexpr double kShareThatLeaves = 0.2;    // of the joints, from frame 0 to frame 1

bool any_joint_jumps(const Clip& clip) {
  for (std::int32_t j = 0; j < clip.joints; ++j) {
    const auto& now = clip.frame(1)[j].real;
    const double first_step = rotation_angle(clip.frame(0)[j].real, now);
    if (first_step > kJumpRad && first_step > 2.0 * rotation_angle(now, clip.frame(2)[j].real)) {
      return true;
    }
  }
  return false;
}

/// Of the joints that may turn: the tips of a chain are not counted.
double share_at_rest(const Character& character, const Clip& clip, std::int64_t frame) {
  const auto& rest = character.skeleton.rest_parent_from_joint;
  std::int64_t resting = 0, all = 0;
  for (std::int32_t j = 0; j < clip.joints; ++j) {
    if (character.deforming[j] == 0) continue;
    ++all;
    resting += rotation_angle(clip.frame(frame)[j].real, rest[j].real) < kAtRestRad;
  }
  return all == 0 ? 0.0 : double(resting) / double(all);
}

void drop_reference_frame(Imported& imported) {
  Clip& clip = imported.clips.front();
  const auto first = clip.frame(0);
  imported.reference_pose.assign(first.begin(), first.end());
  clip.parent_from_joint.erase(clip.parent_from_joint.begin(),
                               clip.parent_from_joint.begin() + clip.joints);
  clip.start_s = 1.0 / clip.rate_hz;
  imported.facts.reference_frame_dropped = true;
  imported.warnings.push_back(
      {"clip-reference-frame",
       "frame 0 is a reference pose from which the motion jumps; it was dropped", "", 0});
}

}  // namespace

bool starts_with_reference_frame(const Character& character, const Clip& clip) {
  if (clip.frames() < 3 || !any_joint_jumps(clip)) return false;
  const double first = share_at_rest(character, clip, 0);
  return first > kShareAtRest && first - share_at_rest(character, clip, 1) > kShareThatLeaves;
}

void drop_any_reference_frame(Imported& imported) {
  if (imported.clips.size() != 1) return;
  if (starts_with_reference_frame(imported.character, imported.clips.front())) {
    drop_reference_frame(imported);
  }
}

}  // namespace limber
