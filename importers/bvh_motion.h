#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/clip.h"
#include "importers/bvh_parser.h"

namespace limber {

/// Makes the clip from the rows of a BVH as they are read, in file units and axes.
class BvhMotion {
 public:
  void add(const BvhDocument&, std::span<const double> row);

  /// The clip of all rows; the signs of its rotations are continuous. Adds `bvh-zero-positions`.
  Clip finish(const BvhDocument&, Warnings&);

 private:
  void begin(const BvhDocument&);
  void turn_block_into_poses(const BvhDocument&);
  void note_positions(const BvhDocument&);
  void keep_offsets(const BvhDocument&, Warnings&);

  std::vector<double> block_;          // [column * kLanes + frame]: rows not yet made into poses
  std::size_t in_block_ = 0;           // frames of it
  std::vector<DualQuaternion> poses_;  // [frame * joints + joint]
  std::vector<double> largest_;        // [joint] absolute value of its position channels
};

}  // namespace limber
