#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "assets/model/skeleton.h"

namespace limber {

/// One dual quaternion per joint: parent_from_joint.
using Pose = std::vector<DualQuaternion>;

/// Motion at a uniform rate. Frame f is at start_s + f / rate_hz seconds.
struct Clip {
  std::string name;                               ///< as the file has it; may be empty
  double rate_hz = 30.0;                          ///< > 0
  double start_s = 0.0;                           ///< time stamp of frame 0
  std::int32_t joints = 0;                        ///< = skeleton size
  std::vector<DualQuaternion> parent_from_joint;  ///< [frame * joints + joint], unit

  // What the file had before it was sampled; for reports, never needed to play the clip.
  std::string interpolation = "linear";  ///< linear, step, cubicspline or mixed
  std::vector<double> key_times_s;       ///< union of the file's key times

  std::int64_t frames() const {
    return joints == 0 ? 0 : static_cast<std::int64_t>(parent_from_joint.size()) / joints;
  }
  double duration_s() const { return frames() < 2 ? 0.0 : double(frames() - 1) / rate_hz; }
  std::span<const DualQuaternion> frame(std::int64_t f) const {
    return {parent_from_joint.data() + f * joints, static_cast<std::size_t>(joints)};
  }
  std::span<DualQuaternion> frame(std::int64_t f) {
    return {parent_from_joint.data() + f * joints, static_cast<std::size_t>(joints)};
  }
};

/// Checks sizes, rate, unit length and finite values. Error: `clip-invalid`, with joint and frame.
Result<void> validate(const Skeleton&, const Clip&);

/// Chooses q or -q per joint so that consecutive frames lie on one hemisphere.
void make_signs_continuous(Clip&);

/// The same motion at another rate, by screw interpolation of each joint. The first frame stays;
/// the last one is at or before the original's last.
Clip resample(const Clip&, double rate_hz);

}  // namespace limber
