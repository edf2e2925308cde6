#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "pipeline/clip_record.h"
#include "pipeline/dressed_rig.h"

namespace limber {

/// The contact sheet of a retargeted clip as PNG.
Result<std::vector<std::byte>> draw_clip_sheet(const ClipRecord&, const SourceMotion&,
                                               const std::string& title);

/// The sheet of any file: its character playing a clip, or standing in its rest pose.
Result<std::vector<std::byte>> draw_file_sheet(const Character&, const Clip* clip,
                                               const std::string& title);

/// A rig's limits, drawn on the figure that wears it.
Result<std::vector<std::byte>> draw_rig_sheet(const DressedRig&);

}  // namespace limber
