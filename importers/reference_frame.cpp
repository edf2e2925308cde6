#include "importers/reference_frame.h"

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

constexpr double kJumpRad = M_PI / 18.0;  // ten degrees from one frame to the next
constexpr double kAtRestRad = M_PI / 180.0;
constexpr double kShareAtRest = 0.7;      // of the joints, in frame 0
constexpr double kShareThatLeaves = 0.2;  // of the joints, from frame 0 to frame 1

/// Largest rotation of any joint between two frames, rad.
double largest_step(const Clip& clip, std::int64_t from, std::int64_t to) {
  double largest = 0.0;
  for (std::int32_t j = 0; j < clip.joints; ++j) {
    largest = std::max(largest, rotation_angle(clip.frame(from)[j].real, clip.frame(to)[j].real));
  }
  return largest;
}

double share_at_rest(const Skeleton& skeleton, const Clip& clip, std::int64_t frame) {
  std::int64_t resting = 0;
  for (std::int32_t j = 0; j < clip.joints; ++j) {
    resting += rotation_angle(clip.frame(frame)[j].real, skeleton.rest_parent_from_joint[j].real) <
               kAtRestRad;
  }
  return double(resting) / double(clip.joints);
}

}  // namespace

bool jumps_from_first_frame(const Clip& clip) {
  if (clip.frames() < 3) return false;
  const double jump = largest_step(clip, 0, 1);
  return jump > kJumpRad && jump > 2.0 * largest_step(clip, 1, 2);
}

bool starts_with_reference_frame(const Skeleton& skeleton, const Clip& clip) {
  if (!jumps_from_first_frame(clip)) return false;
  const double first = share_at_rest(skeleton, clip, 0);
  return first > kShareAtRest && first - share_at_rest(skeleton, clip, 1) > kShareThatLeaves;
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

}  // namespace limber
