#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/skeleton.h"
#include "validation/contact_detection.h"

namespace limber {

/// A point that is fixed to a joint, in the joint's space, m.
struct AttachedPoint {
  std::int32_t joint = 0;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
};

/// One of the two motions that are compared.
struct MotionSide {
  const Skeleton* skeleton = nullptr;
  const Clip* clip = nullptr;
  std::vector<std::string> roles;  ///< [joint] VRM 1.0 humanoid name, or ""
  double stature_m = 1.75;         ///< of the figure that stands straight
  double floor_y = 0.0;            ///< m
  /// Points of the soles (see sole_points). None: penetration is not measured.
  std::vector<AttachedPoint> soles;
};

struct MotionOptions {
  double scale = 1.0;         ///< output leg length / source leg length; source lengths times this
  ContactOptions contacts{};  ///< its `scale` is set from the source's stature
  double max_rate_hz =
      60.0;  ///< faster sources are measured at their rate divided by a whole number
};

/// A foot point of both motions and the source's contacts, over common frames.
struct FootTrack {
  std::string name;  ///< leftFoot, leftToes, rightFoot, rightToes
  bool left = false;
  std::vector<Eigen::Vector3d> source, output;  ///< world, m, unscaled
  std::vector<FrameInterval> contacts;          ///< of the source
};

struct ContactFigures {
  double slide_cm_s = 0.0;  ///< mean horizontal speed during the source's contacts
  double drift_cm = 0.0;    ///< mean over contacts of the largest excursion from its first frame
  double penetration_cm = 0.0;  ///< mean depth of the deepest sole point below the floor
};

/// Every figure of a less that of b.
ContactFigures less(const ContactFigures& a, const ContactFigures& b);

struct MotionMetrics {
  double rate_hz = 0.0;  ///< at which everything was measured
  std::int64_t frames = 0;
  std::vector<FootTrack> feet;  ///< the intervals count frames of rate_hz
  std::int64_t intervals = 0;   ///< contacts, all foot points
  ContactFigures source;        ///< scaled to the output's size
  ContactFigures output;
  double jerk_ratio = 0.0;  ///< 0: not measured (fewer than five frames, no common joint)
  double jerk_p99_source = 0.0, jerk_p99_output = 0.0;  ///< m/s3; the source's at output's size
  double max_angular_velocity_ratio = 0.0;
  std::int64_t pops = 0;  ///< joint-frames
  struct Pop {
    std::string role;
    std::int64_t frame = 0;
  };
  std::vector<Pop> pop_list;  ///< the first 20
};

/// Contacts, sliding, penetration and smoothness of `output` against `source`, both sampled from
/// their first frame on at one rate. The definitions are common to retargeting benchmarks:
///  - contacts: see contact_detection.h, of the source's ankles and toes; slide is the output's
///    horizontal speed in those frames;
///  - jerk ratio: mean |third difference| of hips, head, hands and feet (fingertips, for hands)
///    over the scaled source's; its 99th percentile is taken over all their frames;
///  - angular velocity: largest rotation speed of a role against the nearest common role above it;
///  - pop: joint-frame whose angular acceleration exceeds 6 times the larger of that joint's 99.9th
///    percentile in the source, a quarter of all joints', and 3.3 rad/s2, with no such source
///    frame within two.
MotionMetrics measure_motion(const MotionSide& source, const MotionSide& output,
                             const MotionOptions& = {});

/// Sole points under ankle (heel), ball and toe tip, from a pose that stands on `floor_y`
/// (model_from_joint, facing +Z).
std::vector<AttachedPoint> sole_points(const Skeleton&, std::span<const std::string> roles,
                                       std::span<const DualQuaternion> standing_model_from_joint,
                                       double floor_y, double stature_m);

}  // namespace limber
