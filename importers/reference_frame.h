#pragma once

#include "importers/importer.h"

namespace limber {

/// True where the figure jumps from frame 0 to frame 1 as it does not go on to move.
bool jumps_from_first_frame(const Clip&);

/// True where frame 0 is the rest pose, nearly joint for joint, and the figure jumps from it: the
/// reference pose that conversions of the CMU library keep there.
bool starts_with_reference_frame(const Skeleton&, const Clip&);

/// Takes frame 0 of the only clip out as Imported::reference_pose; later frames keep their times.
void drop_reference_frame(Imported&);

}  // namespace limber
