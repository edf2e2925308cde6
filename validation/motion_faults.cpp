// Sides. Let d be the directions of upper arms, forearms, thighs and shanks, frame by frame. The
// source predicts them, d' = Y d, Y a turn about the vertical by quarters that suits best; and so
// does each way to confuse its sides: exchanged arms, all limbs exchanged, or the mirror image,
// with limbs exchanged and x reversed. Where a wrong prediction is off by less than half of what
// the right one is, the output is that. Motions that are their own mirror image are explained by
// both alike, and are fine.
#include "validation/motion_faults.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace limber {
namespace {

using Eigen::Vector3d;

constexpr double kDegrees = 180.0 / M_PI;
constexpr double kBoneRelative = 5e-3;
constexpr double kShortBone = 1e-3;          // m
constexpr double kNearlyAll = 0.9;           // of the frames have keys: all should
constexpr double kUnlike = 5.0 / kDegrees;   // limbs that are nearer are as they should be
constexpr double kExplained = 0.5;           // of the error is left where something explains it
constexpr double kDiffer = 35.0 / kDegrees;  // a limb's mean from which it does something else
constexpr std::int64_t kSamples = 400;

MotionFault fault(std::string code, std::string message, bool fails) {
  return {std::move(code), std::move(message), fails, {}, -1};
}

// ---- time

/// The first frame without a key of its own, where nearly all have one; else -1.
std::int64_t frame_without_key(const Clip& clip) {
  std::vector<std::uint8_t> has(static_cast<std::size_t>(clip.frames()), 0);
  std::int64_t count = 0;
  for (const double t : clip.key_times_s) {
    const double at = (t - clip.start_s) * clip.rate_hz;
    const auto f = static_cast<std::int64_t>(std::llround(at));
    if (f < 0 || f >= clip.frames() || std::abs(at - double(f)) > 0.25 || has[f] != 0) continue;
    has[f] = 1;
    ++count;
  }
  if (double(count) < kNearlyAll * double(clip.frames()) || count == clip.frames()) return -1;
  return std::ranges::find(has, std::uint8_t{0}) - has.begin();
}

// ---- bones

struct Bone {
  std::int32_t joint = 0;
  double rest_m = 0.0;
};

std::vector<Bone> bones_of(const Rig& rig) {
  std::vector<Bone> bones;
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const double length = rig.joints[i].offset.norm();
    const bool root = rig.joints[i].parent == kNoJoint || rig.joints[i].type == JointType::free;
    if (!root && length > kShortBone) bones.push_back({i, length});
  }
  return bones;
}

// ---- sides

struct Limb {
  const char *from, *to;  // behind left and right
  bool arm;
};
constexpr std::array<Limb, 4> kLimbs = {
    Limb{"UpperArm", "LowerArm", true}, Limb{"LowerArm", "Hand", true},
    Limb{"UpperLeg", "LowerLeg", false}, Limb{"LowerLeg", "Foot", false}};
constexpr std::array<const char*, 2> kSides = {"left", "right"};

/// [limb][side]; zero where a figure lacks it.
using Directions = std::array<std::array<Vector3d, 2>, kLimbs.size()>;

std::int32_t joint_of(const MotionSide& side, const std::string& role) {
  const auto it = std::ranges::find(side.roles, role);
  return it == side.roles.end() ? kNoJoint : static_cast<std::int32_t>(it - side.roles.begin());
}

Directions directions(const MotionSide& side, std::int64_t frame) {
  std::vector<DualQuaternion> model(side.skeleton->parents.size());
  model_from_local(*side.skeleton, side.clip->frame(frame), model);
  Directions out;
  for (std::size_t l = 0; l < kLimbs.size(); ++l) {
    for (std::size_t s = 0; s < 2; ++s) {
      const std::int32_t from = joint_of(side, std::string(kSides[s]) + kLimbs[l].from);
      const std::int32_t to = joint_of(side, std::string(kSides[s]) + kLimbs[l].to);
      out[l][s] =
          from == kNoJoint || to == kNoJoint
              ? Vector3d::Zero()
              : Vector3d((model[to].translation() - model[from].translation()).stableNormalized());
    }
  }
  return out;
}

/// A way to take the source's limbs: from the other side, and as in a mirror.
struct Reading {
  const char *code, *message;
  bool swaps_arms, mirrors_arms, swaps_legs, mirrors_legs;
};
constexpr const char* kArms = "each arm does what the source's other arm does";
constexpr std::array<Reading, 5> kReadings = {
    Reading{"", "", false, false, false, false},
    Reading{"sides-arms-swapped", kArms, true, false, false, false},
    Reading{"sides-arms-swapped", kArms, true, true, false, false},
    Reading{"sides-swapped", "each side does what the source's other side does", true, false, true,
            false},
    Reading{"sides-mirrored", "the motion is the mirror image of the source's", true, true, true,
            true}};

Vector3d predicted(const Directions& source, std::size_t limb, std::size_t side,
                   const Reading& reading, int quarters) {
  const bool arm = kLimbs[limb].arm;
  const bool swaps = arm ? reading.swaps_arms : reading.swaps_legs;
  Vector3d d = source[limb][swaps ? 1 - side : side];
  if (arm ? reading.mirrors_arms : reading.mirrors_legs) d.x() = -d.x();
  for (int q = 0; q < quarters; ++q) d = Vector3d(d.z(), d.y(), -d.x());
  return d;
}

/// How far a prediction is off: mean angles, rad.
struct Misfit {
  double mean = 0.0;
  struct OfLimb {
    double sum = 0.0, worst = 0.0;
    std::int64_t count = 0, frame = -1;  // the worst; counts samples
    double mean() const { return count == 0 ? 0.0 : sum / double(count); }
  };
  std::array<std::array<OfLimb, 2>, kLimbs.size()> limbs;
};

Misfit misfit(const std::vector<Directions>& source, const std::vector<Directions>& output,
              const Reading& reading, int quarters) {
  Misfit out;
  double sum = 0.0;
  std::int64_t count = 0;
  for (std::size_t k = 0; k < source.size(); ++k) {
    for (std::size_t l = 0; l < kLimbs.size(); ++l) {
      for (std::size_t s = 0; s < 2; ++s) {
        const Vector3d is = output[k][l][s], should = predicted(source[k], l, s, reading, quarters);
        if (is.isZero(0.0) || should.isZero(0.0)) continue;
        const double angle = std::atan2(is.cross(should).norm(), is.dot(should));
        Misfit::OfLimb& limb = out.limbs[l][s];
        limb.sum += angle;
        ++limb.count;
        if (angle > limb.worst) limb.worst = angle, limb.frame = static_cast<std::int64_t>(k);
        sum += angle;
        ++count;
      }
    }
  }
  out.mean = count == 0 ? 0.0 : sum / double(count);
  return out;
}

Misfit best_misfit(const std::vector<Directions>& source, const std::vector<Directions>& output,
                   const Reading& reading) {
  Misfit best = misfit(source, output, reading, 0);
  for (int quarters = 1; quarters < 4; ++quarters) {
    Misfit other = misfit(source, output, reading, quarters);
    if (other.mean < best.mean) best = other;
  }
  return best;
}

MotionFaults limb_faults(const Misfit& as_is, std::int64_t stride) {
  MotionFaults out;
  const Misfit::OfLimb* worst = nullptr;
  for (std::size_t l = 0; l < kLimbs.size(); ++l) {
    for (std::size_t s = 0; s < 2; ++s) {
      const Misfit::OfLimb& limb = as_is.limbs[l][s];
      if (limb.mean() < kDiffer || (worst != nullptr && limb.mean() <= worst->mean())) continue;
      worst = &limb;
      out = {fault("limbs-differ",
                   fmt::format("a limb points {:.0f} degrees away from where the source's does, in "
                               "the mean",
                               kDegrees * limb.mean()),
                   true)};
      out.back().joint = std::string(kSides[s]) + kLimbs[l].from;
      out.back().frame = limb.frame * stride;
    }
  }
  return out;
}

}  // namespace

MotionFaults timing_faults(const Clip& source, const Clip& output) {
  MotionFaults out;
  const bool same_rate = std::abs(output.rate_hz / source.rate_hz - 1.0) < 1e-3;
  const bool same_frames = output.frames() == source.frames();
  const double longer = output.duration_s() - source.duration_s();
  if (same_rate && !same_frames) {
    out.push_back(fault("clip-frames",
                        fmt::format("the source's {} frames became {} at the same rate",
                                    source.frames(), output.frames()),
                        true));
  } else if (!same_rate && same_frames && source.frames() > 1) {
    out.push_back(fault("clip-rate",
                        fmt::format("the source's {:.6g} Hz became {:.6g} Hz with the same frames",
                                    source.rate_hz, output.rate_hz),
                        true));
  } else if (!same_rate && !(std::abs(longer) < 1.0 / output.rate_hz)) {
    out.push_back(fault("clip-duration",
                        fmt::format("the source's {:.3f} s became {:.3f} s", source.duration_s(),
                                    output.duration_s()),
                        true));
  }
  if (const std::int64_t missing = frame_without_key(output); missing >= 0) {
    out.push_back(fault("clip-key-missing",
                        "nearly every frame has a key of its own, but this one has none", true));
    out.back().frame = missing;
  }
  return out;
}

MotionFaults limit_faults(const Rig& rig, const LimitReport& limits) {
  if (limits.violations == 0) return {};
  MotionFault out = fault("limits-violated",
                          fmt::format("{} joint-frames beyond their limits, worst {:.4f} degrees",
                                      limits.violations, limits.max_violation_deg),
                          true);
  if (!limits.worst.empty()) {
    out.joint = rig.joints[limits.worst.front().joint].name;
    out.frame = limits.worst.front().frame;
  }
  return {out};
}

MotionFaults bone_faults(const Rig& rig, const Clip& on_rig) {
  const std::vector<Bone> bones = bones_of(rig);
  if (bones.empty() || on_rig.frames() == 0) return {};
  std::vector<double> ratios;
  for (const Bone& bone : bones) {
    ratios.push_back(on_rig.frame(0)[bone.joint].translation().norm() / bone.rest_m);
  }
  const double size = percentile(ratios, 50.0);
  double worst = kBoneRelative;
  MotionFaults out;
  for (std::int64_t f = 0; f < on_rig.frames(); ++f) {
    for (const Bone& bone : bones) {
      const double length = on_rig.frame(f)[bone.joint].translation().norm();
      const double off = length / (size * bone.rest_m) - 1.0;
      // Rounding of short bones is no fault.
      if (!(std::abs(off) > worst) || std::abs(length - size * bone.rest_m) < 0.5 * kShortBone) {
        continue;
      }
      worst = std::abs(off);
      out = {fault("bone-length",
                   fmt::format("the bone to this joint is {:.2f} % {} than the rig's",
                               100.0 * worst, off > 0.0 ? "longer" : "shorter"),
                   true)};
      out.back().joint = rig.joints[bone.joint].name;
      out.back().frame = f;
    }
  }
  return out;
}

MotionFaults contact_faults(const MotionMetrics& metrics, const MotionSide& output, double scale) {
  const auto stray = [](std::span<const Vector3d> p, const FrameInterval& c, std::int64_t& frame) {
    Vector3d mean = Vector3d::Zero();
    for (std::int64_t f = c.begin; f < c.end; ++f) mean += p[f] / double(c.end - c.begin);
    double worst = 0.0;
    for (std::int64_t f = c.begin; f < c.end; ++f) {
      const double d = std::hypot(p[f].x() - mean.x(), p[f].z() - mean.z());
      if (d > worst) worst = d, frame = f;
    }
    return worst;
  };
  double worst = kSlipM;
  MotionFaults out;
  for (const FootTrack& foot : metrics.feet) {
    for (const FrameInterval& contact : foot.contacts) {
      std::int64_t frame = contact.begin, ignored = 0;
      const double own = scale * stray(foot.source, contact, ignored);
      const double more = stray(foot.output, contact, frame) - own;
      if (!(more > worst)) continue;
      worst = more;
      out = {fault("foot-slips",
                   fmt::format("a foot that stands in the source strays {:.1f} cm further than the "
                               "source's",
                               100.0 * more),
                   false)};
      out.back().joint = foot.name;
      out.back().frame = std::llround(double(frame) * output.clip->rate_hz / metrics.rate_hz);
    }
  }
  return out;
}

MotionFaults pop_faults(const MotionMetrics& metrics, const Clip& output) {
  if (metrics.pops == 0) return {};
  MotionFault out =
      fault("motion-pops",
            fmt::format("{} joint-frames jump where the source does not", metrics.pops), false);
  if (!metrics.pop_list.empty()) {
    out.joint = metrics.pop_list.front().role;
    out.frame =
        std::llround(double(metrics.pop_list.front().frame) * output.rate_hz / metrics.rate_hz);
  }
  return {out};
}

MotionFaults side_faults(const MotionSide& source, const MotionSide& output) {
  const std::int64_t stride = 1 + output.clip->frames() / kSamples;
  std::vector<Directions> s, o;
  for (std::int64_t f = 0; f < output.clip->frames(); f += stride) {
    const auto at = std::llround(double(f) * source.clip->rate_hz / output.clip->rate_hz);
    if (at >= source.clip->frames()) break;
    s.push_back(directions(source, at));
    o.push_back(directions(output, f));
  }
  const Misfit as_is = best_misfit(s, o, kReadings[0]);
  if (as_is.mean < kUnlike) return limb_faults(as_is, stride);
  const Reading* explains = nullptr;
  double least = kExplained * as_is.mean;
  for (const Reading& reading : std::span(kReadings).subspan(1)) {
    const double mean = best_misfit(s, o, reading).mean;
    if (mean < least) least = mean, explains = &reading;
  }
  if (explains == nullptr) return limb_faults(as_is, stride);
  return {fault(explains->code,
                fmt::format("{}: limbs are {:.0f} degrees off, read so only {:.0f}",
                            explains->message, kDegrees * as_is.mean, kDegrees * least),
                true)};
}

}  // namespace limber
