#pragma once

#include <cstdint>
#include <vector>

#include "pipeline/effectors.h"
#include "pipeline/target.h"

namespace limber {

/// Deeper by this much is not yet a fault, m: flesh gives way, and capsules are no truer than that.
inline constexpr double kFleshGivesM = 0.005;

/// How a clip was kept from passing through its own body. Depths count beyond those that the source
/// itself has in the same frame, scaled to the target's girth.
struct SelfContactFigures {
  bool measured = false;                 ///< both figures are bodies with arms
  std::vector<std::uint8_t> pressed;     ///< [frame] 1: parts were pushed apart
  std::vector<double> before_m, left_m;  ///< [frame] largest depth, before and after

  bool presses(std::int64_t frame) const { return measured && pressed[frame] != 0; }
  std::int64_t pressed_frames() const;
};

/// Pushes hands and forearms out of torso, head, thighs and the other arm, wherever they are deeper
/// in them than the source's are, by more than flesh gives (see self_contacts.cpp). `clip` holds
/// the solved motion on the rows of `rig`, whose effectors are the track's; frames without anything
/// to push stay as they are to the bit, and joints stay within their limits.
Result<SelfContactFigures> keep_parts_apart(const SourceMotion&, const Target&, const Rig&,
                                            const EffectorTrack&, Clip& clip);

}  // namespace limber
