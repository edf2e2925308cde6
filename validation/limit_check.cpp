#include "validation/limit_check.h"

#include <algorithm>
#include <cmath>

#include "validation/joint_angles.h"

namespace limber {
namespace {

constexpr double kDegrees = 180.0 / M_PI;
constexpr std::size_t kWorst = 20;

bool checked(const RigJoint& joint) {
  return joint.type == JointType::hinge || joint.type == JointType::universal || joint.limited();
}

double hinge_excess(const RigJoint& joint, const Eigen::Matrix3d& r) {
  const double angle = nearest_in_range(joint.limits[0], joint_angles(joint, r)[0]);
  return rotation_angle(r.transpose() * rotation_about(joint.axes[0], angle));
}

double universal_excess(const RigJoint& joint, const Eigen::Matrix3d& r) {
  // With the other angle held, each is a hinge whose best angle is known; the turns alternate
  // inside the box until nothing moves.
  RigJoint first = joint, second = joint;
  first.type = second.type = JointType::hinge;
  second.axes[0] = joint.axes[1];
  Eigen::Vector3d q = joint_angles(joint, r);
  q[0] = nearest_in_range(joint.limits[0], q[0]);
  q[1] = nearest_in_range(joint.limits[1], q[1]);
  for (int i = 0; i < 100; ++i) {
    const Eigen::Vector3d before = q;
    const Eigen::Matrix3d seen0 = r * rotation_about(joint.axes[1], -q[1]);
    q[0] = nearest_in_range(joint.limits[0], joint_angles(first, seen0)[0]);
    const Eigen::Matrix3d seen1 = rotation_about(joint.axes[0], -q[0]) * r;
    q[1] = nearest_in_range(joint.limits[1], joint_angles(second, seen1)[0]);
    if ((q - before).cwiseAbs().maxCoeff() < 1e-14) break;
  }
  return rotation_angle(r.transpose() * rotation_about(joint.axes[0], q[0]) *
                        rotation_about(joint.axes[1], q[1]));
}

double ball_excess(const RigJoint& joint, const Eigen::Matrix3d& r) {
  const Eigen::Vector3d angles = joint_angles(joint, r);
  const double swing = (nearest_swing(joint, angles.head<2>()) - angles.head<2>()).norm();
  const double allowed = nearest_in_range(joint.limits[2], angles[2]);
  return std::hypot(swing, std::remainder(angles[2] - allowed, 2.0 * M_PI));
}

template <class Visit>
void for_each_excess(const Rig& rig, const Clip& clip, Visit visit) {
  for (std::int64_t frame = 0; frame < clip.frames(); ++frame) {
    for (std::int32_t joint = 0; joint < rig.size(); ++joint) {
      if (!checked(rig.joints[joint])) continue;
      visit(joint, frame, limit_excess(rig.joints[joint], clip.frame(frame)[joint].rotation()));
    }
  }
}

}  // namespace

double limit_excess(const RigJoint& joint, const Eigen::Quaterniond& parent_from_joint) {
  if (!checked(joint)) return 0.0;
  const Eigen::Matrix3d r = joint_rotation(joint, parent_from_joint);
  switch (joint.type) {
    case JointType::hinge:
      return hinge_excess(joint, r);
    case JointType::universal:
      return universal_excess(joint, r);
    case JointType::ball:
      return ball_excess(joint, r);
    case JointType::fixed:
    case JointType::free:
      break;
  }
  return 0.0;
}

LimitReport check_joint_limits(const Rig& rig, const Clip& clip, double tolerance_rad) {
  LimitReport report;
  report.joints =
      static_cast<std::int32_t>(std::count_if(rig.joints.begin(), rig.joints.end(), checked));
  double largest = 0.0;
  for_each_excess(rig, clip, [&](std::int32_t joint, std::int64_t frame, double excess) {
    largest = std::max(largest, excess);
    if (!(excess <= tolerance_rad)) {  // NaN is a violation
      ++report.violations;
      report.worst.push_back({joint, frame, excess});
    }
  });
  report.max_violation_deg = largest * kDegrees;
  std::stable_sort(
      report.worst.begin(), report.worst.end(),
      [](const LimitFinding& a, const LimitFinding& b) { return a.excess_rad > b.excess_rad; });
  if (report.worst.size() > kWorst) report.worst.resize(kWorst);
  return report;
}

ClipExcess limit_excess(const Rig& rig, const Clip& clip, double tolerance_rad) {
  ClipExcess out;
  out.joints.resize(rig.joints.size());
  out.max_deg.assign(static_cast<std::size_t>(clip.frames()), 0.0);
  for_each_excess(rig, clip, [&](std::int32_t joint, std::int64_t frame, double excess) {
    JointExcess& of_joint = out.joints[joint];
    const double deg = excess * kDegrees;
    of_joint.joint = joint;
    of_joint.max_deg = std::max(of_joint.max_deg, deg);
    out.max_deg[frame] = std::max(out.max_deg[frame], deg);
    if (excess <= tolerance_rad) return;
    ++of_joint.frames;
    ++of_joint.frames_by_excess[std::ranges::lower_bound(kExcessEdgesDeg, deg) -
                                kExcessEdgesDeg.begin()];
  });
  std::erase_if(out.joints, [](const JointExcess& j) { return j.frames == 0; });
  return out;
}

std::vector<std::int32_t> joints_at_limit(const Rig& rig, const Clip& clip, double margin_rad) {
  Rig narrowed = rig;
  for (RigJoint& joint : narrowed.joints) {
    for (Range& range : joint.limits) {
      if (range.max - range.min <= 2.0 * margin_rad) continue;  // a locked axis tells nothing
      const bool swing = joint.type == JointType::ball && &range != &joint.limits[2];
      const double low = range.min + margin_rad, high = range.max - margin_rad;
      range = swing ? Range{std::min(low, 0.0), std::max(high, 0.0)} : Range{low, high};
    }
  }
  std::vector<std::int32_t> joints;
  for (const JointExcess& j : limit_excess(narrowed, clip, 1e-9).joints) joints.push_back(j.joint);
  return joints;
}

namespace {

/// The joint with its ranges narrowed by the margin; a swing's never beyond zero.
RigJoint narrowed_swing(RigJoint ball, double margin) {
  for (int k = 0; k < 2; ++k) {
    Range& range = ball.limits[k];
    if (range.max - range.min <= 2.0 * margin) continue;
    range = {std::min(range.min + margin, 0.0), std::max(range.max - margin, 0.0)};
  }
  return ball;
}

}  // namespace

std::vector<LimitContact> limit_contacts(const Rig& rig,
                                         std::span<const DualQuaternion> parent_from_joint,
                                         double margin_rad) {
  std::vector<LimitContact> contacts;
  for (std::int32_t j = 0; j < rig.size(); ++j) {
    const RigJoint& joint = rig.joints[j];
    if (!joint.limited()) continue;
    const Eigen::Vector3d q =
        joint_angles(joint, joint_rotation(joint, parent_from_joint[j].rotation()));
    const auto check = [&](int k, const char* coordinate) {
      const Range& range = joint.limits[k];
      if (range.max - range.min <= 2.0 * margin_rad) return;
      if (q[k] < range.min + margin_rad) contacts.push_back({j, coordinate, "min"});
      if (q[k] > range.max - margin_rad) contacts.push_back({j, coordinate, "max"});
    };
    if (joint.type == JointType::hinge) check(0, "angle");
    if (joint.type == JointType::universal) {
      check(0, "angle0");
      check(1, "angle1");
    }
    if (joint.type != JointType::ball) continue;
    const RigJoint inner = narrowed_swing(joint, margin_rad);
    const Eigen::Vector2d swing = q.head<2>();
    if ((nearest_swing(inner, swing) - swing).norm() > 1e-9) {
      contacts.push_back({j, "swing", "border"});
    }
    check(2, "twist");
  }
  return contacts;
}

LimitOccupancy limit_occupancy(const Rig& rig, const Clip& clip, double margin_rad) {
  LimitOccupancy out;
  out.frames.assign(rig.joints.size(), 0);
  for (std::int64_t frame = 0; frame < clip.frames(); ++frame) {
    std::int32_t count = 0, last = -1;  // a joint's contacts follow one another
    for (const LimitContact& contact : limit_contacts(rig, clip.frame(frame), margin_rad)) {
      if (contact.joint == last) continue;
      last = contact.joint;
      ++out.frames[last];
      ++count;
    }
    out.joints.push_back(count);
  }
  return out;
}

}  // namespace limber
