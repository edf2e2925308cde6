#include "importers/fbx_losses.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "importers/failure.h"
#include "importers/fbx_curves.h"

namespace limber {

namespace {

// Below these nobody sees a difference, and float32 values may have it.
constexpr double kSeen_deg = 1e-2, kSeen_m = 1e-4;
constexpr double kMostFrames = 100.0;  // that are looked at from one key to the next

/// The largest figures of some curves, and where they are.
struct Extent {
  double degrees = 0.0, metres = 0.0;
  std::string joint;  ///< of the largest angle; where there is none, of the largest way

  void note(const FbxCurve& curve, double value, double unit_m) {
    if (curve.property == FbxProperty::rotation && value > degrees) {
      degrees = value;
      joint = curve.joint;
    } else if (curve.property == FbxProperty::translation && value * unit_m > metres) {
      metres = value * unit_m;
      if (degrees == 0.0) joint = curve.joint;
    }
  }
  bool seen() const { return degrees > kSeen_deg || metres > kSeen_m; }
  std::string text() const {
    if (metres <= kSeen_m) return fmt::format("{:.3g} degrees", degrees);
    if (degrees <= kSeen_deg) return fmt::format("{:.3g} mm", 1e3 * metres);
    return fmt::format("{:.3g} degrees and {:.3g} mm", degrees, 1e3 * metres);
  }
};

double on_the_line(const FbxKey& a, const FbxKey& b, double time_s) {
  return a.value + (time_s - a.time_s) / (b.time_s - a.time_s) * (b.value - a.value);
}

/// How far a curve leaves the straight lines between its keys, on the frames of the clip.
double largest_deviation(const FbxCurve& curve, const Clip& clip, double start_s) {
  double largest = 0.0;
  for (std::size_t k = 0; k + 1 < curve.keys.size(); ++k) {
    const FbxKey &a = curve.keys[k], &b = curve.keys[k + 1];
    if (a.interpolation == FbxInterpolation::linear) continue;
    // Frames inside the piece; one within a hundredth of a frame of a key is that key's.
    const auto frame = [&](double time_s) { return (time_s - start_s) * clip.rate_hz; };
    const double last = std::min(frame(b.time_s) - 0.01, double(clip.frames() - 1));
    const double first = std::max(std::ceil(frame(a.time_s) + 0.01), 0.0);
    const double step = std::max(1.0, std::floor((last - first) / kMostFrames));
    for (double f = first; f <= last; f += step) {
      const double time_s = start_s + f / clip.rate_hz;
      const double off = fbx_value_at(a, b, time_s) - on_the_line(a, b, time_s);
      largest = std::max(largest, std::abs(off));
    }
  }
  return largest;
}

void tell_tangents(std::span<const FbxCurve* const> curves, const Clip& clip, double unit_m,
                   Warnings& warnings) {
  double start_s = std::numeric_limits<double>::infinity();
  for (const FbxCurve* curve : curves) start_s = std::min(start_s, curve->keys.front().time_s);
  Extent lost;
  int bent = 0;
  for (const FbxCurve* curve : curves) {
    const double deviation = largest_deviation(*curve, clip, start_s);
    Extent own;
    own.note(*curve, deviation, unit_m);
    bent += own.seen() ? 1 : 0;
    lost.note(*curve, deviation, unit_m);
  }
  if (!lost.seen()) return;
  warnings.push_back(
      {.code = "fbx-tangents",
       .message = fmt::format("'{}': {} of {} curves leave the straight lines between their keys, "
                              "by up to {}; assimp reads the lines",
                              clip.name, bent, curves.size(), lost.text()),
       .joint = lost.joint});
}

void tell_layers(std::span<const FbxCurve* const> curves, const std::string& take, double unit_m,
                 Warnings& warnings) {
  std::set<std::string> layers;
  for (const FbxCurve* curve : curves) layers.insert(curve->layer);
  if (layers.size() < 2) return;
  const std::string& base = curves.front()->layer;
  Extent held;
  int others = 0;
  for (const FbxCurve* curve : curves) {
    if (curve->layer == base) continue;
    ++others;
    double largest = 0.0;
    for (const FbxKey& key : curve->keys) largest = std::max(largest, std::abs(key.value));
    held.note(*curve, largest, unit_m);
  }
  warnings.push_back({.code = "fbx-layers",
                      .message = fmt::format("'{}' has {} animation layers, which assimp does not "
                                             "blend: {} curves beside '{}' hold up to {}",
                                             take, layers.size(), others, base, held.text()),
                      .joint = held.joint});
}

void tell_curves(std::span<const FbxCurve> curves, std::span<const Clip> clips, double unit_m,
                 Warnings& warnings) {
  std::map<std::string, std::vector<const FbxCurve*>> takes;
  for (const FbxCurve& curve : curves) takes[curve.take].push_back(&curve);
  for (const auto& [take, own] : takes) {
    const auto clip = std::find_if(clips.begin(), clips.end(),
                                   [&, name = &take](const Clip& c) { return c.name == *name; });
    if (clip == clips.end()) continue;
    tell_tangents(own, *clip, unit_m, warnings);
    tell_layers(own, take, unit_m, warnings);
  }
}

}  // namespace

void tell_fbx_losses(std::span<const std::byte> bytes, std::span<const Clip> clips, double unit_m,
                     Warnings& warnings) {
  const Result<void> told = guarded<void>([&]() -> Result<void> {
    tell_curves(read_fbx_curves(bytes), clips, unit_m, warnings);
    return {};
  });
  if (told) return;
  warnings.push_back(
      {.code = "fbx-losses-unknown",
       .message = "what assimp loses of tangents and layers could not be measured: " +
                  told.error().message});
}

}  // namespace limber
