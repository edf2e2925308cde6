#pragma once

#include "importers/importer.h"

namespace limber {

/// True where frame 0 is a pose of its own that the motion does not start from: nearly every
/// joint is as the rest pose has it, many leave that at once, and some joint jumps and then hardly
/// moves on. MotionBuilder and DAZ conversions of the CMU library keep a T-pose there.
bool starts_with_reference_frame(const Character&, const Clip&);

/// Takes such a frame 0 of the only clip out as Imported::reference_pose; later frames keep their
/// times.
void drop_any_reference_frame(Imported&);

}  // namespace limber
