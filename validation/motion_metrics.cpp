#include "validation/motion_metrics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

namespace limber {
namespace {

constexpr double kReferenceStature = 1.75;
constexpr std::size_t kListedPops = 20;

std::int32_t find_role(const MotionSide& side, const std::string& role) {
  const auto it = std::find(side.roles.begin(), side.roles.end(), role);
  return it == side.roles.end() ? kNoJoint : static_cast<std::int32_t>(it - side.roles.begin());
}

/// A motion at the common rate, in model space.
struct Sampled {
  std::vector<DualQuaternion> model_from_joint;  // [frame * joints + joint]
  std::int64_t joints = 0;

  const DualQuaternion& at(std::int64_t frame, std::int64_t joint) const {
    return model_from_joint[frame * joints + joint];
  }
};

Sampled sample(const MotionSide& side, double rate_hz) {
  const bool same = std::abs(side.clip->rate_hz - rate_hz) < 1e-9 * rate_hz;
  const Clip resampled = same ? Clip{} : resample(*side.clip, rate_hz);
  const Clip& clip = same ? *side.clip : resampled;
  Sampled out;
  out.joints = clip.joints;
  out.model_from_joint.resize(clip.parent_from_joint.size());
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    model_from_local(
        *side.skeleton, clip.frame(f),
        {out.model_from_joint.data() + f * out.joints, static_cast<std::size_t>(out.joints)});
  }
  return out;
}

using Track = std::vector<Eigen::Vector3d>;

Track track_of(const Sampled& motion, std::span<const std::int32_t> joints, std::int64_t frames) {
  Track track;
  for (std::int64_t f = 0; f < frames; ++f) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const std::int32_t joint : joints) sum += motion.at(f, joint).translation();
    track.push_back(sum / static_cast<double>(joints.size()));
  }
  return track;
}

/// The joints whose mean is the ball of the foot: the toes, else the foot's children.
std::vector<std::int32_t> ball_joints(const MotionSide& side, const std::string& prefix) {
  const std::int32_t toes = find_role(side, prefix + "Toes");
  if (toes != kNoJoint) return {toes};
  const std::int32_t foot = find_role(side, prefix + "Foot");
  std::vector<std::int32_t> children;
  for (std::int32_t i = 0; i < side.skeleton->size(); ++i) {
    if (foot != kNoJoint && side.skeleton->parents[i] == foot) children.push_back(i);
  }
  return children;
}

std::vector<FootTrack> foot_tracks(const MotionSide& source, const MotionSide& output,
                                   const Sampled& s, const Sampled& o, std::int64_t frames) {
  std::vector<FootTrack> feet;
  for (const std::string prefix : {"left", "right"}) {
    const std::int32_t sf = find_role(source, prefix + "Foot");
    const std::int32_t of = find_role(output, prefix + "Foot");
    if (sf == kNoJoint || of == kNoJoint) continue;
    FootTrack ankle{prefix + "Foot", prefix == "left", {}, {}, {}};
    ankle.source = track_of(s, std::array{sf}, frames);
    ankle.output = track_of(o, std::array{of}, frames);
    feet.push_back(std::move(ankle));
    const std::vector<std::int32_t> sb = ball_joints(source, prefix),
                                    ob = ball_joints(output, prefix);
    if (sb.empty() || ob.empty()) continue;
    FootTrack ball{prefix + "Toes", prefix == "left", {}, {}, {}};
    ball.source = track_of(s, sb, frames);
    ball.output = track_of(o, ob, frames);
    feet.push_back(std::move(ball));
  }
  return feet;
}

bool is_ankle(const FootTrack& foot) { return foot.name.ends_with("Foot"); }

void find_contacts(std::vector<FootTrack>& feet, double rate_hz, const ContactOptions& options) {
  for (const bool ankle : {true, false}) {
    std::vector<Track> pooled;
    for (const FootTrack& foot : feet) {
      if (is_ankle(foot) == ankle) pooled.push_back(foot.source);
    }
    const double floor = floor_level(pooled);
    for (FootTrack& foot : feet) {
      if (is_ankle(foot) == ankle) {
        foot.contacts = detect_contacts(foot.source, rate_hz, floor, options);
      }
    }
  }
}

void measure_slide(const std::vector<FootTrack>& feet, Track FootTrack::*motion, double scale,
                   double rate_hz, ContactFigures& figures) {
  double path = 0.0, drift = 0.0;
  std::int64_t steps = 0, contacts = 0;
  const auto flat = [](const Eigen::Vector3d& v) { return std::hypot(v.x(), v.z()); };
  for (const FootTrack& foot : feet) {
    const Track& p = foot.*motion;
    for (const FrameInterval& c : foot.contacts) {
      double furthest = 0.0;
      for (std::int64_t f = c.begin + 1; f < c.end; ++f) {
        path += flat(p[f] - p[f - 1]);
        furthest = std::max(furthest, flat(p[f] - p[c.begin]));
        ++steps;
      }
      drift += furthest;
      ++contacts;
    }
  }
  if (steps > 0) figures.slide_cm_s = 100.0 * scale * path * rate_hz / static_cast<double>(steps);
  if (contacts > 0) figures.drift_cm = 100.0 * scale * drift / static_cast<double>(contacts);
}

double mean_penetration_cm(const MotionSide& side, const Sampled& motion, std::int64_t frames) {
  if (side.soles.empty() || frames == 0) return 0.0;
  double sum = 0.0;
  for (std::int64_t f = 0; f < frames; ++f) {
    double lowest = side.floor_y;
    for (const AttachedPoint& p : side.soles) {
      lowest = std::min(lowest, motion.at(f, p.joint).transform_point(p.offset).y());
    }
    sum += side.floor_y - lowest;
  }
  return 100.0 * sum / static_cast<double>(frames);
}

/// [frame] m/s3
std::vector<double> jerk_of(const Track& p, double rate_hz) {
  std::vector<double> jerk;
  for (std::size_t f = 0; f + 3 < p.size(); ++f) {
    jerk.push_back((p[f + 3] - 3.0 * p[f + 2] + 3.0 * p[f + 1] - p[f]).norm() *
                   std::pow(rate_hz, 3));
  }
  return jerk;
}

/// The roles whose places jerk is measured at, of those that both figures have.
std::vector<std::string> jerk_roles(const MotionSide& source, const MotionSide& output) {
  std::vector<std::string> roles = {"hips",      "head",     "leftHand",
                                    "rightHand", "leftFoot", "rightFoot"};
  const auto missing = [&](const std::string& role) {
    return find_role(source, role) == kNoJoint || find_role(output, role) == kNoJoint;
  };
  std::erase_if(roles, missing);
  if (roles.empty() || (roles.size() == 1 && roles[0].ends_with("Hand"))) {  // a hand alone
    roles.clear();
    for (const std::string& role : source.roles) {
      if (role.ends_with("Distal") && !missing(role)) roles.push_back(role);
    }
  }
  return roles;
}

void measure_jerk(const MotionSide& source, const MotionSide& output, const Sampled& s,
                  const Sampled& o, double scale, MotionMetrics& metrics) {
  const std::vector<std::string> roles = jerk_roles(source, output);
  const auto of_all = [&](const MotionSide& side, const Sampled& motion, double& mean) {
    std::vector<double> all;
    for (const std::string& role : roles) {
      const std::vector<double> jerk = jerk_of(
          track_of(motion, std::array{find_role(side, role)}, metrics.frames), metrics.rate_hz);
      all.insert(all.end(), jerk.begin(), jerk.end());
    }
    mean = 0.0;
    for (const double j : all) mean += j / static_cast<double>(all.size());
    return percentile(std::move(all), 99.0);
  };
  double in_source = 0.0, in_output = 0.0;
  metrics.jerk_p99_source = scale * of_all(source, s, in_source);
  metrics.jerk_p99_output = of_all(output, o, in_output);
  metrics.jerk_ratio = in_output / std::max(in_source * scale, 1e-3);
}

/// Speeds and accelerations of one role's rotation against another's.
struct Turning {
  std::string role;
  std::vector<double> speed_s, speed_o;                ///< rad/s, one less than frames
  std::vector<double> acceleration_s, acceleration_o;  ///< rad/s2, two less
};

void turning_of(const Sampled& motion, std::int32_t joint, std::int32_t above, std::int64_t frames,
                double rate_hz, std::vector<double>& speed, std::vector<double>& acceleration) {
  const auto relative = [&](std::int64_t f) -> Eigen::Quaterniond {
    const Eigen::Quaterniond r = motion.at(f, joint).rotation();
    return above == kNoJoint ? r : motion.at(f, above).rotation().conjugate() * r;
  };
  Eigen::Quaterniond before = relative(0);
  Eigen::Vector3d velocity_before = Eigen::Vector3d::Zero();
  for (std::int64_t f = 1; f < frames; ++f) {
    const Eigen::Quaterniond now = relative(f);
    const Eigen::Vector3d velocity =
        rate_hz * rotation_log(Eigen::Quaterniond(before.conjugate() * now));
    speed.push_back(velocity.norm());
    if (f > 1) acceleration.push_back((velocity - velocity_before).norm() * rate_hz);
    before = now;
    velocity_before = velocity;
  }
}

std::vector<Turning> common_turnings(const MotionSide& source, const MotionSide& output,
                                     const Sampled& s, const Sampled& o, std::int64_t frames,
                                     double rate_hz) {
  // Spines have unequal joint counts; eyes and jaws are rarely recorded.
  const std::set<std::string> left_out = {"leftEye", "rightEye", "jaw",
                                          "spine",   "chest",    "upperChest"};
  const bool body = find_role(source, "hips") != kNoJoint && find_role(output, "hips") != kNoJoint;
  const auto common = [&](const std::string& role) {
    return !role.empty() && !left_out.contains(role) && find_role(output, role) != kNoJoint;
  };
  std::vector<Turning> turnings;
  for (std::int32_t i = 0; i < source.skeleton->size(); ++i) {
    const std::string& role = source.roles[i];
    if (!common(role) || (!body && role.ends_with("Hand"))) continue;
    std::int32_t above = source.skeleton->parents[i];
    while (above != kNoJoint && !common(source.roles[above]))
      above = source.skeleton->parents[above];
    const std::int32_t above_o = above == kNoJoint ? above : find_role(output, source.roles[above]);
    Turning t;
    t.role = role;
    turning_of(s, i, above, frames, rate_hz, t.speed_s, t.acceleration_s);
    turning_of(o, find_role(output, role), above_o, frames, rate_hz, t.speed_o, t.acceleration_o);
    turnings.push_back(std::move(t));
  }
  return turnings;
}

void find_pops(const std::vector<Turning>& turnings, MotionMetrics& metrics) {
  std::vector<double> all;
  for (const Turning& t : turnings) {
    all.insert(all.end(), t.acceleration_s.begin(), t.acceleration_s.end());
  }
  const double pooled = percentile(std::move(all), 99.9);
  for (const Turning& t : turnings) {
    const double own = percentile(t.acceleration_s, 99.9);
    const double threshold = std::max(6.0 * std::max(own, 0.25 * pooled), 20.0);
    const auto frames = static_cast<std::int64_t>(t.acceleration_o.size());
    for (std::int64_t f = 0; f < frames; ++f) {
      bool excused = !(t.acceleration_o[f] > threshold);
      for (std::int64_t g = std::max<std::int64_t>(f - 2, 0); g <= f + 2 && g < frames; ++g) {
        excused = excused || t.acceleration_s[g] > threshold;
      }
      if (excused) continue;
      ++metrics.pops;
      // The acceleration between frames f, f+1 and f+2 belongs to the middle one.
      if (metrics.pop_list.size() < kListedPops) metrics.pop_list.push_back({t.role, f + 1});
    }
  }
}

double largest(const std::vector<Turning>& turnings, std::vector<double> Turning::*speeds) {
  double top = 0.0;
  for (const Turning& t : turnings) {
    for (const double v : t.*speeds) top = std::max(top, v);
  }
  return top;
}

}  // namespace

ContactFigures less(const ContactFigures& a, const ContactFigures& b) {
  return {.slide_cm_s = a.slide_cm_s - b.slide_cm_s,
          .drift_cm = a.drift_cm - b.drift_cm,
          .penetration_cm = a.penetration_cm - b.penetration_cm};
}

MotionMetrics measure_motion(const MotionSide& source, const MotionSide& output,
                             const MotionOptions& options) {
  MotionMetrics metrics;
  const double native = source.clip->rate_hz;
  metrics.rate_hz = native / std::max(1.0, std::ceil(native / options.max_rate_hz - 1e-3));
  const Sampled s = sample(source, metrics.rate_hz), o = sample(output, metrics.rate_hz);
  if (s.joints == 0 || o.joints == 0) return metrics;
  metrics.frames = static_cast<std::int64_t>(
      std::min(s.model_from_joint.size() / s.joints, o.model_from_joint.size() / o.joints));
  metrics.feet = foot_tracks(source, output, s, o, metrics.frames);
  ContactOptions contacts = options.contacts;
  contacts.scale = source.stature_m / kReferenceStature;
  find_contacts(metrics.feet, metrics.rate_hz, contacts);
  for (const FootTrack& foot : metrics.feet) {
    metrics.intervals += static_cast<std::int64_t>(foot.contacts.size());
  }
  measure_slide(metrics.feet, &FootTrack::source, options.scale, metrics.rate_hz, metrics.source);
  measure_slide(metrics.feet, &FootTrack::output, 1.0, metrics.rate_hz, metrics.output);
  metrics.source.penetration_cm = options.scale * mean_penetration_cm(source, s, metrics.frames);
  metrics.output.penetration_cm = mean_penetration_cm(output, o, metrics.frames);
  if (metrics.frames < 5) return metrics;

  measure_jerk(source, output, s, o, options.scale, metrics);
  const std::vector<Turning> turnings =
      common_turnings(source, output, s, o, metrics.frames, metrics.rate_hz);
  metrics.max_angular_velocity_ratio =
      largest(turnings, &Turning::speed_o) / std::max(largest(turnings, &Turning::speed_s), 1e-6);
  find_pops(turnings, metrics);
  return metrics;
}

std::vector<AttachedPoint> sole_points(const Skeleton& skeleton, std::span<const std::string> roles,
                                       std::span<const DualQuaternion> model_from_joint,
                                       double floor_y, double stature_m) {
  std::vector<AttachedPoint> points;
  const auto attach = [&](std::int32_t joint, Eigen::Vector3d p_in_model) {
    p_in_model.y() = floor_y;
    points.push_back({joint, model_from_joint[joint].conjugate().transform_point(p_in_model)});
  };
  MotionSide side;
  side.skeleton = &skeleton;
  side.roles.assign(roles.begin(), roles.end());
  for (const std::string prefix : {"left", "right"}) {
    const std::int32_t foot = find_role(side, prefix + "Foot");
    if (foot == kNoJoint) continue;
    const Eigen::Vector3d ankle = model_from_joint[foot].translation();
    attach(foot, ankle - Eigen::Vector3d(0, 0, 0.025 * stature_m));
    const std::vector<std::int32_t> ends = ball_joints(side, prefix);
    if (ends.empty()) continue;
    Eigen::Vector3d ball = Eigen::Vector3d::Zero();
    for (const std::int32_t end : ends) ball += model_from_joint[end].translation();
    ball /= static_cast<double>(ends.size());
    attach(foot, ball);
    const std::int32_t toes = find_role(side, prefix + "Toes");
    if (toes != kNoJoint) attach(toes, ball + Eigen::Vector3d(0, 0, 0.035 * stature_m));
  }
  return points;
}

}  // namespace limber
