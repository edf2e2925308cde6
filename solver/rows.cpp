// Rows that join branches.
//
// Relative effector. Point p of node a, its goal g and goal rotation carried by node b. Moving b by
// a twist is moving a by the opposite one, then both: the distance feels the first alone. So with
// the twist of a less that of b, taken at p, r = p - g has the row (force c at p, no torque) per
// axis c of b, and the rotation still to be made, negated, has the row (torque c): the six rows of
// an effector, as a wrench on a and its opposite on b. (Along axes of b, because r turns with b.)
// Lines, directions and gazes see less or more of that motion: effector_rows.h. Cost mass |r|^2:
// compliance 1 / mass.
//
// Strict priorities. The strongest level is solved alone. Each weaker one follows under hard rows
// J_0 d = 0 that hold what came before where it ended, so it moves in their null space only
// (B. Siciliano, J.-J. Slotine, ICAR 1991). The held effectors also stay masses in the tree, with
// goals where they are: on the rows that changes nothing, and it keeps the problem well posed. What
// a gaze keeps is the image of its target: held is the direction, fixed in the eye, in which the
// target is. So its angle to the target stays, reached or not, and the tree's goal remains the
// target, at a cost that is constant on the rows.
//
// Coupling: q_to - ratio q_from - offset = 0. Speed: +-(q - q_previous) <= max_speed dt, where the
// tree's boxes cannot say it: under an ellipse, and for rotations without limits, whose difference
// is log(R R_previous') in the axes that their steps turn about. Contact: gap + n.(v_a - v_b) >= 0
// with the velocities at the contact. Separation: n.(a - b) - least >= 0, the velocities at
// a and at b: taken both at a, a part would be turned about its own axis in vain.
#include "solver/rows.h"

#include <algorithm>
#include <cmath>

#include "assets/model/eye_head_shoulder.h"
#include "solver/effector_rows.h"

namespace limber {

namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr std::int64_t kCouplingId = std::int64_t(1) << 32, kSpeedId = std::int64_t(2) << 32,
                       kContactId = std::int64_t(3) << 32, kApartId = std::int64_t(4) << 32;
constexpr double kHeld = 1e-7;      // m, m/rad: what counts as held
constexpr double kCoupled = 1e-6;   // rad, m
constexpr double kSpeed = 1e-6;     // rad, m
constexpr double kTouching = 1e-5;  // m
constexpr double kSight = 0.03;     // m: contacts farther apart wait for the next relinearisation

Row::Term term_of(const IkTree& tree, std::int32_t joint, std::int32_t dof, double coefficient) {
  const std::int32_t node = tree.node_of[joint];
  return {node, tree.nodes[node].coordinate + dof, coefficient};
}

/// From a node's space (-1: the world's) to the world's.
void to_world(std::int32_t node, const IkKinematics& k, Quaterniond& rotation, Vector3d& position) {
  if (node < 0) return;
  position = k.position[node] + k.rotation[node] * position;
  rotation = k.rotation[node] * rotation;
}

}  // namespace

IkRows::IkRows(const Rig& rig, const IkTree& tree, const IkOptions& options)
    : tree_(tree),
      stop_position_m_(options.stop_position_m),
      stop_orientation_rad_(options.stop_orientation_rad),
      previous_(tree.make_state()),
      collision_(options.collision),
      capsules_(options.collision ? rig : Rig{}, tree) {
  for (const RigEffector& effector : rig.effectors) {
    priority_.push_back(effector.priority);
    levels_.push_back(effector.priority);
    Link link;
    link.soft = effector.relative_to != kNoJoint;
    if (link.soft) {
      link.base_node = tree.node_of[effector.relative_to];
      link.base_rotation = tree.node_from_joint[effector.relative_to].rotation();
      link.base_position = tree.node_from_joint[effector.relative_to].translation();
    }
    none_ = none_ && !link.soft;
    links_.push_back(link);
  }
  std::sort(levels_.begin(), levels_.end());
  levels_.erase(std::unique(levels_.begin(), levels_.end()), levels_.end());
  for (const Coupling& c : rig.couplings) {
    couplings_.push_back({term_of(tree, c.from_joint, c.from_dof, -c.ratio),
                          term_of(tree, c.to_joint, c.to_dof, 1.0), c.ratio, c.offset});
  }
  for (std::size_t n = 0; n < tree.nodes.size() && options.dt > 0.0; ++n) {
    const IkNode& node = tree.nodes[n];
    const double reach = rig.joints[node.joint].max_speed * options.dt;
    if (reach == 0.0) continue;
    const bool turns = !node.chart && node.coordinates >= 3;
    const std::int32_t first = node.coordinate + (node.type == JointType::free ? 3 : 0);
    const std::int32_t count = turns ? 3 : node.ellipse ? 2 : 0;
    for (std::int32_t k = first; k < first + count; ++k) {
      speeds_.push_back({{static_cast<std::int32_t>(n), k, 1.0}, reach, turns, first});
    }
  }
  collision_ = collision_ && capsules_.pair_count() > 0;
  none_ = none_ && levels_.size() <= 1 && couplings_.empty() && speeds_.empty() && !collision_ &&
          options.separations == 0;
  capacity_ = 6 * links_.size() + couplings_.size() + 2 * speeds_.size() +
              (collision_ ? kMaxContacts : 0) + static_cast<std::size_t>(options.separations);
  separations_.reserve(static_cast<std::size_t>(options.separations));
  if (collision_) contacts_.reserve(kMaxContacts);
}

RowPlace IkRows::make_place() const {
  RowPlace place;
  place.rows.reserve(none_ ? 0 : capacity_);
  return place;
}

/// The link's goal, and for an effector of the tree its goal too, becomes where it is; of a gaze
/// the link's axis, where its goal is.
void IkRows::hold(std::size_t e, const IkKinematics& k, IkGoal& goal) {
  const IkEffector& effector = tree_.effectors[e];
  Link& link = links_[e];
  Quaterniond base = link.base_rotation, world = effector.rotation;
  Vector3d origin = link.base_position, point = effector.offset;
  to_world(effector.node, k, world, point);
  to_world(link.base_node, k, base, origin);
  link.held = true;
  link.axis = effector.axis;
  if (effector.kind == EffectorKind::gaze) {
    link.goal = goal;
    const Vector3d sight = world.conjugate() * (origin + base * goal.position - point);
    if (sight.norm() > kNearestGaze) link.axis = sight.normalized();
    return;
  }
  link.goal.mass = goal.mass;
  link.goal.inertia = goal.inertia;
  link.goal.position = base.conjugate() * (point - origin);
  link.goal.rotation = base.conjugate() * world;
  link.goal.axis = link.goal.rotation * effector.axis;
  goal.position = point;
  goal.rotation = world;
  goal.axis = world * effector.axis;
}

void IkRows::aim(std::span<const EffectorTarget> targets, std::int32_t level,
                 const IkKinematics& here, std::span<IkGoal> goals) {
  aim_at_all(targets, goals);
  for (std::size_t e = 0; e < links_.size(); ++e) {
    IkGoal& goal = links_[e].soft ? links_[e].goal : goals[e];
    if (priority_[e] > level) {
      goal.mass = goal.inertia = 0.0;
    } else if (priority_[e] < level) {
      IkGoal held = goal;
      hold(e, here, held);
      if (!links_[e].soft) goals[e] = held;
    }
  }
}

void IkRows::aim_at_all(std::span<const EffectorTarget> targets, std::span<IkGoal> goals) {
  tree_.resolve(targets, goals);
  for (std::size_t e = 0; e < links_.size(); ++e) {
    links_[e].held = false;
    if (!links_[e].soft) continue;
    links_[e].goal = goals[e];
    goals[e].mass = goals[e].inertia = 0.0;
  }
}

void IkRows::add_link(std::size_t e, const IkKinematics& k, RowPlace& place) const {
  const Link& link = links_[e];
  IkEffector effector = tree_.effectors[e];
  if (link.held) effector.axis = link.axis;
  Quaterniond base = link.base_rotation, world = effector.rotation;
  Vector3d origin = link.base_position, point = effector.offset;
  to_world(effector.node, k, world, point);
  to_world(link.base_node, k, base, origin);
  IkGoal goal = link.goal;
  goal.position = origin + base * goal.position;
  goal.rotation = base * goal.rotation;
  goal.axis = base * goal.axis;
  IkError error;
  measure_error(effector, goal, world, point, error);
  if (!link.held && effector.strong) {
    place.reached = place.reached && error.position.norm() <= stop_position_m_ &&
                    error.rotation.norm() <= stop_orientation_rad_;
  }
  Row row;
  row.node_a = effector.node;
  row.node_b = link.base_node;
  row.point = point;
  row.tolerance = kHeld;
  const Eigen::Matrix3d axes = base.toRotationMatrix();
  const auto add = [&](int index, const EffectorRow& seen, double value, double weight) {
    row.id = static_cast<std::int64_t>(6 * e) + index;
    row.torque = seen.torque;
    row.force = seen.force;
    row.value = value;
    row.compliance = link.held ? 0.0 : 1.0 / weight;
    place.rows.push_back(row);
  };
  for (int c = 0; c < 3 && goal.mass > 0.0; ++c) {
    const Vector3d axis = axes.col(c);
    add(c, move_row(effector, goal, axis), -error.position.dot(axis), goal.mass);
  }
  const double turning = turning_weight(effector, goal, error);
  for (int c = 0; c < 3 && turning > 0.0; ++c) {
    const Vector3d axis = axes.col(c);
    add(3 + c, turn_row(effector, error, axis), -error.rotation.dot(axis), turning);
  }
}

void IkRows::add_speeds(const IkState& state, RowPlace& place) const {
  for (std::size_t i = 0; i < speeds_.size(); ++i) {
    const SpeedTerm& speed = speeds_[i];
    const std::int32_t k = speed.term.coordinate, n = speed.term.node;
    double way = state.x[k] - previous_.x[k];
    if (speed.turn) {
      const Quaterniond turned = state.rotation[n] * previous_.rotation[n].conjugate();
      way = rotation_log(turned)[k - speed.first];
    }
    for (const double side : {-1.0, 1.0}) {
      Row row;
      row.id = kSpeedId + static_cast<std::int64_t>(2 * i) + (side > 0.0);
      row.terms[0] = {n, k, side};
      row.value = speed.reach + side * way;
      row.one_sided = true;
      row.tolerance = kSpeed;
      place.rows.push_back(row);
    }
  }
}

void IkRows::add_contacts(const IkKinematics& kinematics, RowPlace& place) {
  capsules_.find(kinematics, kSight, contacts_);
  for (const CapsuleContact& contact : contacts_) {
    Row row;
    row.id = kContactId + 8 * std::int64_t(contact.pair) + contact.feature;
    row.node_a = contact.node_a;
    row.node_b = contact.node_b;
    row.force = contact.normal;
    row.point = contact.point;
    row.value = contact.gap;
    row.one_sided = true;
    row.tolerance = kTouching;
    place.rows.push_back(row);
  }
}

void IkRows::add_separations(const IkKinematics& kinematics, RowPlace& place) const {
  for (std::size_t i = 0; i < separations_.size(); ++i) {
    const Separation& apart = separations_[i];
    Row row;
    row.id = kApartId + static_cast<std::int64_t>(i);
    row.node_a = tree_.node_of[apart.joint_a];
    row.node_b = tree_.node_of[apart.joint_b];
    if (row.node_a == row.node_b) continue;
    Quaterniond unused = Quaterniond::Identity();
    Vector3d a = tree_.node_from_joint[apart.joint_a].transform_point(apart.point_a);
    Vector3d b = tree_.node_from_joint[apart.joint_b].transform_point(apart.point_b);
    to_world(row.node_a, kinematics, unused, a);
    to_world(row.node_b, kinematics, unused, b);
    row.force = apart.normal;
    row.point = a;
    row.apart = a - b;
    row.value = apart.normal.dot(a - b) - apart.least;
    row.one_sided = true;
    row.tolerance = kTouching;
    place.rows.push_back(row);
  }
}

void IkRows::judge(RowPlace& place) const {
  place.cost = place.excess = place.worst = 0.0;
  for (const Row& row : place.rows) {
    if (!row.hard()) {
      place.cost += row.value * row.value / row.compliance;
      continue;
    }
    place.excess += row.excess(row.value);
    place.worst = std::max(place.worst, row.violation(row.value) / row.tolerance);
  }
}

void IkRows::build(const IkState& state, const IkKinematics& kinematics, RowPlace& place) {
  place.rows.clear();
  place.reached = true;
  for (std::size_t e = 0; e < links_.size(); ++e) {
    if (links_[e].soft || links_[e].held) add_link(e, kinematics, place);
  }
  for (std::size_t i = 0; i < couplings_.size(); ++i) {
    const CoupledPair& pair = couplings_[i];
    Row row;
    row.id = kCouplingId + static_cast<std::int64_t>(i);
    row.terms = {pair.from, pair.to};
    row.value =
        state.x[pair.to.coordinate] - pair.ratio * state.x[pair.from.coordinate] - pair.offset;
    row.tolerance = kCoupled;
    place.rows.push_back(row);
  }
  add_speeds(state, place);
  if (collision_) add_contacts(kinematics, place);
  add_separations(kinematics, place);
  judge(place);
}

void IkRows::anchor(const IkKinematics& kinematics, RowPlace& place) const {
  for (Row& row : place.rows) row.anchor(kinematics.origin);
}

}  // namespace limber
