#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/skeleton.h"

namespace limber {

/// Guesses what formats without unit and up axis (BVH above all) leave unsaid, from the figure
/// itself. Skeleton and clip are in file space: any unit, any axes.

struct UpGuess {
  std::string up = "+Y";       ///< of the motion where there is one
  std::string rest_up = "+Y";  ///< of the rest pose; differs where offsets and motion disagree
  std::string evidence;
};
UpGuess guess_up(const Skeleton&, const Clip* clip);

struct UnitGuess {
  double unit_m = 1.0;
  std::string evidence;
  bool certain = true;    ///< false: no head and feet were found to measure
  bool plausible = true;  ///< false: no known unit gives a human size, unit_m makes it 1.72 m
};
UnitGuess guess_unit(const Skeleton&, const Clip* clip, std::string_view up);

/// The rotation that takes the file's up axis ("+Y", "-Z", ...) to +Y.
Eigen::Quaterniond canonical_from_up(std::string_view up);

/// "m", "cm", "mm", "dm", "inch", "CMU unit" or the number of metres.
std::string unit_name(double unit_m);

/// Multiplies every translation by `unit_m` and turns the roots (in place).
void make_canonical(const Skeleton&, std::span<DualQuaternion> parent_from_joint, double unit_m,
                    const Eigen::Quaterniond& canonical_from_file);

}  // namespace limber
