// Contacts between capsules.
//
// A capsule is all points within its radius of a segment, so two of them are as far apart as their
// segments are, less both radii. The nearest points of two segments are found by minimising over
// one, clamping, minimising over the other, clamping (C. Ericson, Real-Time Collision Detection,
// 2005, section 5.1.9).
//
// Fingers lie side by side. Of nearly parallel segments the nearest points jump from one end to
// the other when an angle changes sign, and a single row there would let them roll and jump. So
// nearly parallel pairs also give the distances of their ends from the other segment: each of them
// is at least the distance of the capsules, so none asks for more than the capsules do.
// Features: 0 nearest points inside both segments; 1, 2 the ends of a; 3, 4 the ends of b.
//
// Joints are spheres first. A list of those near each other stays valid until one has moved half of
// its margin (L. Verlet, Phys. Rev. 159, 1967).
#include "solver/capsule_contacts.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace limber {

namespace {

using Eigen::Vector3d;

constexpr double kMargin = 0.05;      // m, of the list of near joints
constexpr double kParallel = 0.1;     // squared sine below which ends count too
constexpr double kRestOverlap = 0.2;  // of the smaller radius, allowed at rest
constexpr double kPoint = 1e-12;      // m^2: shorter segments are points

struct Nearest {
  double s = 0.0, t = 0.0;  // along the segments, 0 to 1
  double sine2 = 0.0;       // between their directions
};

/// Along segment (from, along), the parameter nearest to p.
double nearest_on(const Vector3d& from, const Vector3d& along, const Vector3d& p) {
  const double length2 = along.squaredNorm();
  return length2 < kPoint ? 0.0 : std::clamp(along.dot(p - from) / length2, 0.0, 1.0);
}

Nearest nearest_points(const Vector3d& p, const Vector3d& u, const Vector3d& q, const Vector3d& v) {
  Nearest out;
  const double uu = u.squaredNorm(), vv = v.squaredNorm(), uv = u.dot(v);
  const Vector3d r = p - q;
  const double denominator = uu * vv - uv * uv;
  if (uu >= kPoint && vv >= kPoint) {
    out.sine2 = denominator / (uu * vv);
    if (out.sine2 > 1e-12) {
      out.s = std::clamp((uv * v.dot(r) - vv * u.dot(r)) / denominator, 0.0, 1.0);
    }
  }
  out.t = nearest_on(q, v, p + out.s * u);
  out.s = nearest_on(p, u, q + out.t * v);
  return out;
}

bool is_end(double parameter) { return parameter == 0.0 || parameter == 1.0; }

}  // namespace

CapsuleGap capsule_gap(const Capsule& a, const Capsule& b) {
  const Vector3d u = a.to - a.from, v = b.to - b.from;
  const Nearest near = nearest_points(a.from, u, b.from, v);
  CapsuleGap out{0.0, a.from + near.s * u, b.from + near.t * v};
  out.gap = (out.on_a - out.on_b).norm() - a.radius - b.radius;
  return out;
}

CapsuleContacts::CapsuleContacts(const Rig& rig, const IkTree& tree) {
  std::vector<std::int32_t> first_body;
  std::vector<Body> at_rest;
  std::vector<DualQuaternion> rest(rig.joints.size()), model(rig.joints.size());
  pose_from_coordinates(rig, std::vector<double>(dof_count(rig), 0.0), rest);
  model_from_local(skeleton_of(rig), rest, model);
  for (std::int32_t j = 0; j < rig.size(); ++j) {
    const RigJoint& joint = rig.joints[j];
    const DualQuaternion& node_from_joint = tree.node_from_joint[j];
    Group group;
    group.node = tree.node_of[j];
    first_body.push_back(static_cast<std::int32_t>(bodies_.size()));
    for (const Capsule& c : joint.capsules) {
      bodies_.push_back({group.node, node_from_joint.transform_point(c.from),
                         node_from_joint.transform_point(c.to), c.radius});
      at_rest.push_back(
          {j, model[j].transform_point(c.from), model[j].transform_point(c.to), c.radius});
      group.centre += 0.5 * (bodies_.back().from + bodies_.back().to);
    }
    if (!joint.capsules.empty()) group.centre /= static_cast<double>(joint.capsules.size());
    for (std::size_t b = first_body[j]; b < bodies_.size(); ++b) {
      const double reach =
          std::max((bodies_[b].from - group.centre).norm(), (bodies_[b].to - group.centre).norm());
      group.radius = std::max(group.radius, reach + bodies_[b].radius);
    }
    groups_.push_back(group);
  }
  first_body.push_back(static_cast<std::int32_t>(bodies_.size()));
  add_pairs(rig, first_body, at_rest);
  from_.resize(bodies_.size());
  to_.resize(bodies_.size());
  centre_.resize(groups_.size());
  gathered_.assign(groups_.size(), Vector3d::Constant(std::numeric_limits<double>::infinity()));
  near_.reserve(group_pairs_.size());
}

void CapsuleContacts::add_pairs(const Rig& rig, const std::vector<std::int32_t>& first_body,
                                const std::vector<Body>& at_rest) {
  for (const CollisionPair& joints : collision_pairs(rig)) {
    if (groups_[joints.joint_a].node == groups_[joints.joint_b].node) continue;
    GroupPair group{joints.joint_a, joints.joint_b, static_cast<std::int32_t>(pairs_.size()), 0};
    for (std::int32_t a = first_body[joints.joint_a]; a < first_body[joints.joint_a + 1]; ++a) {
      for (std::int32_t b = first_body[joints.joint_b]; b < first_body[joints.joint_b + 1]; ++b) {
        const Body &p = at_rest[a], &q = at_rest[b];
        const double gap = capsule_gap({p.from, p.to, p.radius}, {q.from, q.to, q.radius}).gap;
        if (gap < -kRestOverlap * std::min(p.radius, q.radius)) continue;
        pairs_.push_back({a, b, std::min(gap, 0.0)});
      }
    }
    group.end = static_cast<std::int32_t>(pairs_.size());
    if (group.end > group.begin) group_pairs_.push_back(group);
  }
}

void CapsuleContacts::place(const IkKinematics& kinematics) {
  const auto world = [&](std::int32_t node, const Vector3d& p) -> Vector3d {
    return node < 0 ? p : kinematics.position[node] + kinematics.rotation[node] * p;
  };
  for (std::size_t b = 0; b < bodies_.size(); ++b) {
    from_[b] = world(bodies_[b].node, bodies_[b].from);
    to_[b] = world(bodies_[b].node, bodies_[b].to);
  }
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    centre_[g] = world(groups_[g].node, groups_[g].centre);
  }
}

void CapsuleContacts::gather() {
  near_.clear();
  for (std::size_t i = 0; i < group_pairs_.size(); ++i) {
    const std::int32_t a = group_pairs_[i].a, b = group_pairs_[i].b;
    const double reach = groups_[a].radius + groups_[b].radius + kMargin;
    if ((centre_[a] - centre_[b]).squaredNorm() < reach * reach) {
      near_.push_back(static_cast<std::int32_t>(i));
    }
  }
  gathered_ = centre_;
}

void CapsuleContacts::find(const IkKinematics& kinematics, double sight,
                           std::vector<CapsuleContact>& out) {
  out.clear();
  place(kinematics);
  const double slack = std::max(0.5 * (kMargin - sight), 0.0);
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    if ((centre_[g] - gathered_[g]).squaredNorm() < slack * slack) continue;
    gather();
    break;
  }
  for (const std::int32_t i : near_) {
    for (std::int32_t pair = group_pairs_[i].begin; pair < group_pairs_[i].end; ++pair) {
      measure(pair, sight, out);
    }
  }
}

void CapsuleContacts::measure(std::int32_t index, double sight,
                              std::vector<CapsuleContact>& out) const {
  const Pair& pair = pairs_[index];
  const Body &a = bodies_[pair.a], &b = bodies_[pair.b];
  const Vector3d &p = from_[pair.a], &q = from_[pair.b];
  const Vector3d u = to_[pair.a] - p, v = to_[pair.b] - q;
  const double apart = a.radius + b.radius + pair.allowed, reach = apart + sight;
  const double bound = reach + 0.5 * (u.norm() + v.norm());
  if ((p + 0.5 * u - q - 0.5 * v).squaredNorm() >= bound * bound) return;
  const auto add = [&](std::int32_t feature, double s, double t) {
    const Vector3d on_a = p + s * u, on_b = q + t * v, across = on_a - on_b;
    const double distance = across.norm();
    if (distance >= reach || out.size() == out.capacity()) return;
    CapsuleContact contact{index, feature, a.node, b.node, {}, {}, distance - apart};
    // Axes that cross have no nearest way out; any way across both will do.
    contact.normal = distance > 1e-9 ? Vector3d(across / distance) : u.cross(v).stableNormalized();
    if (!(contact.normal.squaredNorm() > 0.5)) contact.normal = Vector3d::UnitY();
    contact.point = on_b + (b.radius + 0.5 * (distance - a.radius - b.radius)) * contact.normal;
    out.push_back(contact);
  };
  const Nearest near = nearest_points(p, u, q, v);
  const bool ends = near.sine2 < kParallel;
  if (!ends || (!is_end(near.s) && !is_end(near.t))) add(0, near.s, near.t);
  if (!ends) return;
  add(1, 0.0, nearest_on(q, v, p));
  if (u.squaredNorm() >= kPoint) add(2, 1.0, nearest_on(q, v, p + u));
  // An end of b that is nearest to an end of a is no nearer than the contact already there.
  const double s3 = nearest_on(p, u, q), s4 = nearest_on(p, u, q + v);
  if (!is_end(s3)) add(3, s3, 0.0);
  if (!is_end(s4)) add(4, s4, 1.0);
}

}  // namespace limber
