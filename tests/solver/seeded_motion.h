#pragma once

#include <algorithm>
#include <vector>

#include "tests/solver/test_rigs.h"

namespace limber::test {

/// A sum of three sines within [-1, 1].
class Wave {
 public:
  /// `period` (s) > 0: all of it repeats after that time.
  Wave(Random& random, double slowest_hz, double fastest_hz, double period = 0.0) {
    for (Sine& s : sines_) {
      s = {random.uniform(slowest_hz, fastest_hz), random.uniform(0.0, 2.0 * M_PI),
           random.uniform(0.4, 1.0)};
      if (period > 0.0) s.hz = std::max(1.0, std::round(s.hz * period)) / period;
      size_ += s.size;
    }
  }
  double at(double seconds) const {
    double sum = 0.0;
    for (const Sine& s : sines_) sum += s.size * std::sin(2.0 * M_PI * s.hz * seconds + s.phase);
    return sum / size_;
  }

 private:
  struct Sine {
    double hz, phase, size;
  };
  Sine sines_[3];
  double size_ = 0.0;
};

struct MotionOptions {
  double frames_hz = 120.0;
  double slowest_hz = 0.15, fastest_hz = 0.7;  ///< of the joints' curves
  double amplitude = 0.9;                      ///< share of a joint's range
  /// Shifts every curve towards one of its bounds by this share of the range and cuts it there: 0
  /// keeps off them, 1 rides on them for half of the time.
  double press = 0.0;
  int period = 0;  ///< frames after which all of it repeats; 0: never
};

/// A rotation of the joint for curves u within [-1, 1], its limits' own shape filled.
inline Eigen::Quaterniond rotation_at(const RigJoint& joint, const double* u) {
  const auto angle = [&](int k) {
    if (!joint.limited()) return u[k];
    const Range& range = joint.limits[k];
    return 0.5 * (range.min + range.max) + 0.5 * (range.max - range.min) * u[k];
  };
  switch (joint.type) {
    case JointType::hinge:
      return about(joint.axes[0], angle(0));
    case JointType::universal:
      return about(joint.axes[0], angle(0)) * about(joint.axes[1], angle(1));
    case JointType::ball: {
      if (!joint.limited()) return rotation_exp(Eigen::Vector3d(u[0], u[1], u[2]));
      const double beyond = std::max(1.0, std::hypot(u[0], u[1])), a = u[0] / beyond,
                   b = u[1] / beyond;
      const double s0 = a * (a < 0 ? -joint.limits[0].min : joint.limits[0].max);
      const double s1 = b * (b < 0 ? -joint.limits[1].min : joint.limits[1].max);
      return rotation_exp<double>(s0 * joint.axes[0] + s1 * joint.axes[1]) *
             about(joint.axes[2], angle(2));
    }
    case JointType::free:
      return rotation_exp(Eigen::Vector3d(0.2 * u[3], 0.6 * u[4], 0.2 * u[5]));
    default:
      return Eigen::Quaterniond::Identity();
  }
}

/// Frames of smooth curves within the rig's limits, the same for the same seed. A free joint roams
/// by less than a metre, or stays where `walks` is false.
inline std::vector<Pose> seeded_motion(const Rig& rig, unsigned seed, int frames,
                                       const MotionOptions& options = {}, bool walks = true) {
  Random random(seed);
  std::vector<Wave> waves;
  std::vector<double> shift;
  for (int k = 0; k < dof_count(rig); ++k) {
    waves.emplace_back(random, options.slowest_hz, options.fastest_hz,
                       options.period / options.frames_hz);
    shift.push_back(random.integer(0, 1) == 0 ? -options.press : options.press);
  }
  const std::vector<std::int32_t> first = dof_begin(rig);
  std::vector<Pose> motion(static_cast<std::size_t>(frames));
  for (int f = 0; f < frames; ++f) {
    for (std::int32_t j = 0; j < rig.size(); ++j) {
      const RigJoint& joint = rig.joints[j];
      double u[6] = {};
      for (int k = 0; k < dof_count(joint.type); ++k) {
        const double curve = options.amplitude * waves[first[j] + k].at(f / options.frames_hz);
        u[k] = std::clamp(curve + shift[first[j] + k], -1.0, 1.0);
        if (joint.type == JointType::free && !walks) u[k] = 0.0;
      }
      Eigen::Vector3d offset = joint.offset;
      if (joint.type == JointType::free)
        offset += Eigen::Vector3d(0.5 * u[0], 0.05 * u[1], 0.5 * u[2]);
      motion[f].push_back(
          DualQuaternion::from_rotation_translation(joint.rest * rotation_at(joint, u), offset));
    }
  }
  return motion;
}

}  // namespace limber::test
