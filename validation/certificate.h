#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/result.h"
#include "assets/model/skeleton.h"

namespace limber {

struct CertificateOptions {
  double position_m = 1e-4;     ///< largest allowed joint position error
  double rotation_rad = 1e-3;   ///< largest allowed rotation error; infinite: not judged
  double bone_relative = 1e-3;  ///< largest allowed bone length deviation, relative
  double rate_relative = 1e-4;  ///< largest allowed rate deviation, relative
  /// Formats without joint orientations (BVH) turn each joint's space by a constant. True: that
  /// constant, read from the first frame, is taken off before rotations are compared.
  bool ignore_joint_spaces = false;
};

/// How a written clip, read back, differs from the one that was meant.
struct CertificateReport {
  bool ok = false;                  ///< all joints found, counts equal, errors within the options
  std::vector<std::string> faults;  ///< one sentence each; empty where ok
  std::int32_t joints = 0;          ///< joints compared
  std::vector<std::string> missing_joints;  ///< of the first that the second lacks
  std::int64_t frames_a = 0, frames_b = 0;
  double rate_a_hz = 0.0, rate_b_hz = 0.0;
  struct Worst {
    double value = 0.0;
    std::string joint;
    std::int64_t frame = -1;
  };
  Worst position_m;     ///< in model space
  Worst rotation_rad;   ///< in model space
  Worst bone_relative;  ///< |length in b / length in a - 1|, joint to nearest compared ancestor
};

/// Compares two clips joint by joint, paired by name, over their common frames. Joints that only
/// the second has are ignored (readers add end sites and scene roots).
/// Error: `certificate-no-joints` where no name is common.
Result<CertificateReport> compare_clips(const Skeleton& a, const Clip& a_clip, const Skeleton& b,
                                        const Clip& b_clip, const CertificateOptions& = {});

}  // namespace limber
