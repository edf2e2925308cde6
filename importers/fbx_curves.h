#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace limber {

enum class FbxInterpolation : std::uint8_t { hold, hold_next, linear, cubic };
enum class FbxProperty : std::uint8_t { translation, rotation, scaling };

/// A key, and how the curve goes on from it to the next.
struct FbxKey {
  double time_s = 0.0, value = 0.0;
  FbxInterpolation interpolation = FbxInterpolation::linear;
  // Cubic: slopes (per second) where the piece begins and ends, and how far its inner control
  // points stand from its ends, as shares of its duration.
  double slope = 0.0, next_slope = 0.0;
  double weight = 1.0 / 3.0, next_weight = 1.0 / 3.0;
};

/// The value within the piece from one key to the next.
double fbx_value_at(const FbxKey& from, const FbxKey& to, double time_s);

/// One axis of a joint's property in one layer of a take; degrees, or file units.
struct FbxCurve {
  std::string take, layer, joint;
  FbxProperty property = FbxProperty::rotation;
  int axis = 0;
  std::vector<FbxKey> keys;  ///< times ascend; all values are finite
};

/// The curves that move models, in the file's order. Fails (see failure.h) with `fbx-nodes`.
std::vector<FbxCurve> read_fbx_curves(std::span<const std::byte>);

}  // namespace limber
