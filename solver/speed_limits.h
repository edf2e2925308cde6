#pragma once

#include <Eigen/Core>

#include "solver/ik_tree.h"

namespace limber {

/// max_speed as ranges: for one solve a coordinate's box becomes what lies within max_speed dt of
/// the frame before. Coordinates without a box (under an ellipse, rotations without limits) get
/// rows instead (rows.h).
class SpeedLimits {
 public:
  SpeedLimits(const Rig&, const IkTree&, double dt);

  bool any() const { return any_; }
  /// Narrows the tree's boxes around `previous` and brings `start` into them.
  void narrow(const IkState& previous, IkTree&, IkState& start) const;
  void widen(IkTree&) const;

 private:
  bool any_ = false;
  Eigen::VectorXd reach_;      ///< [coordinate] infinite: no limit
  Eigen::VectorXd min_, max_;  ///< [coordinate] the tree's own
};

}  // namespace limber
