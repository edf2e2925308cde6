#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/rig.h"
#include "validation/limit_check.h"
#include "validation/motion_metrics.h"

namespace limber {

/// Something wrong with a motion file, found by comparing it with its source and a rig.
struct MotionFault {
  std::string code;
  std::string message;
  bool fails = false;  ///< a broken promise; else doubtful looks
  std::string joint;   ///< or a role; empty: none
  std::int64_t frame = -1;
};
using MotionFaults = std::vector<MotionFault>;

/// `clip-frames`, `clip-rate`, `clip-duration`: the output neither has the source's frames at the
/// source's rate nor is the source at another rate. `clip-key-missing`: a file with a key in nearly
/// every frame has none in some.
MotionFaults timing_faults(const Clip& source, const Clip& output);

/// `limits-violated`, with the worst joint and frame.
MotionFaults limit_faults(const Rig&, const LimitReport&);

/// `bone-length`: a bone of the clip (on the rig's joints) is longer or shorter than the rig's, by
/// more than 0.5 % after the size that most bones agree on. Roots are free.
MotionFaults bone_faults(const Rig&, const Clip& on_rig);

/// `foot-slips`: within one of the source's contacts a foot strays further from its mean place than
/// the source's foot does, by more than `kSlipM`.
inline constexpr double kSlipM = 0.03;
MotionFaults contact_faults(const MotionMetrics&, const MotionSide& output, double scale);

/// `motion-pops`, with the first.
MotionFaults pop_faults(const MotionMetrics&, const Clip& output);

/// How limbs point: `sides-arms-swapped`, `sides-swapped`, `sides-mirrored` where the source with
/// its sides exchanged explains the output and as it is does not; `limbs-differ` where neither
/// does. A file may face another way than its source, by quarter turns.
MotionFaults side_faults(const MotionSide& source, const MotionSide& output);

}  // namespace limber
