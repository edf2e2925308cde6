#include "tests/bench/peers/geometric.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

namespace limber::peers {

namespace {

constexpr double kRotationArm2 = 0.01;  // (0.1 m/rad)^2
constexpr double kStay = 1e-6;          // share of B that prefers no turn where B leaves it open
constexpr double kTwistShare = 1e-2;    // FABRIK: orientations beside positions
constexpr double kFurther = 0.01;       // FABRIK: the next bone's end beside this one's
constexpr int kPatience = 20;           // iterations without a better pose

/// The rotation nearest to B: maximises trace(T' B).
Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& b) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(b, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d u = svd.matrixU();
  if ((u * svd.matrixV().transpose()).determinant() < 0.0) u.col(2) = -u.col(2);
  return u * svd.matrixV().transpose();
}

/// The angle about `axis` that maximises trace(T' B).
double best_angle(const Eigen::Vector3d& axis, const Eigen::Matrix3d& b) {
  const Eigen::Vector3d cross(b(2, 1) - b(1, 2), b(0, 2) - b(2, 0), b(1, 0) - b(0, 1));
  return std::atan2(axis.dot(cross), b.trace() - axis.dot(b * axis));
}

Eigen::Matrix3d about(const Eigen::Vector3d& axis, double angle) {
  return Eigen::AngleAxisd(angle, axis).toRotationMatrix();
}

/// Calls step(state) until the task is reached, the cap is met or no better pose comes for a while.
template <class Step>
int iterate(Task& task, State& state, State& best_state, int max_iterations, Step step) {
  task.evaluate(state);
  best_state = state;
  double best = task.cost();
  int iterations = 0;
  for (int idle = 0; !task.reached() && iterations < max_iterations && idle < kPatience; ++idle) {
    ++iterations;
    step(state);
    task.evaluate(state);
    if (task.reached()) return iterations;
    if (task.cost() < 0.9999 * best) {
      best = task.cost();
      best_state = state;
      idle = -1;
    }
  }
  if (!task.reached()) {
    state = best_state;
    task.evaluate(state);
  }
  return iterations;
}

}  // namespace

Eigen::Matrix3d turn_joint(const Coordinates& coordinates, std::int32_t i,
                           const Eigen::Matrix3d& parent_rest, const Eigen::Matrix3d& wanted,
                           State& state) {
  const RigJoint& joint = coordinates.rig().joints[i];
  const Eigen::Matrix3d before = coordinates.rotation(i, state).toRotationMatrix();
  const Eigen::Matrix3d b = wanted + kStay * wanted.norm() * Eigen::Matrix3d::Identity();
  if (joint.type == JointType::ball || joint.type == JointType::free) {
    const Eigen::Matrix3d local = parent_rest.transpose() * nearest_rotation(b) * parent_rest;
    coordinates.set_rotation(i, Eigen::Quaterniond(Eigen::Matrix3d(local * before)), state);
  } else {
    // The axis nearest to the effectors first; the next one sees what it has done.
    Eigen::Matrix3d left = b;
    for (int k = dof_count(joint.type) - 1; k >= 0; --k) {
      const Eigen::Index dof = coordinates.begin(i) + k;
      Eigen::Vector3d axis = joint.axes[k];
      if (k == 1) axis = about(joint.axes[0], state.q[dof - 1]) * axis;
      axis = parent_rest * axis;
      const double old = state.q[dof];
      state.q[dof] = std::clamp(old + best_angle(axis, left), coordinates.lower()[dof],
                                coordinates.upper()[dof]);
      // r has turned: sum w d (T r)' = B T'.
      left = (left * about(axis, state.q[dof] - old).transpose()).eval();
    }
  }
  const Eigen::Matrix3d after = coordinates.rotation(i, state).toRotationMatrix();
  return parent_rest * after * before.transpose() * parent_rest.transpose();
}

// ---- CCD

Ccd::Ccd(Task& task) : task_(task), kinematics_(task.coordinates()) {
  const Rig& rig = task.coordinates().rig();
  below_.resize(rig.joints.size());
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    for (const std::int32_t i : kinematics_.joints(e)) below_[i].push_back(e);
  }
  position_.resize(rig.effectors.size());
  rotation_.resize(rig.effectors.size());
}

int Ccd::solve(State& state) {
  return iterate(task_, state, best_, 500, [&](State& s) { sweep(s); });
}

/// B of all effectors below, seen from the pivot (which a free root brings along).
Eigen::Matrix3d Ccd::fit(std::int32_t i, const Eigen::Vector3d& pivot,
                         const Eigen::Vector3d& wanted_pivot) const {
  const Rig& rig = task_.coordinates().rig();
  Eigen::Matrix3d b = Eigen::Matrix3d::Zero();
  for (const std::size_t e : below_[i]) {
    const RigEffector& effector = rig.effectors[e];
    const EffectorTarget& target = task_.targets()[e];
    const double wp = target.weight * effector.weight_pos;
    b += wp * wp * (target.pose.translation() - wanted_pivot) * (position_[e] - pivot).transpose();
    if (effector.kind == EffectorKind::position) continue;
    // |T' - R|^2 of two rotation matrices is twice their angle squared.
    const double wr = target.weight * effector.weight_rot;
    b += 0.5 * kRotationArm2 * wr * wr * target.pose.rotation().toRotationMatrix() *
         rotation_[e].transpose();
  }
  return b;
}

void Ccd::move_below(std::int32_t i, const Eigen::Vector3d& pivot, const Eigen::Matrix3d& turn,
                     const Eigen::Vector3d& shift) {
  for (const std::size_t e : below_[i]) {
    position_[e] = pivot + shift + turn * (position_[e] - pivot);
    rotation_[e] = (turn * rotation_[e]).eval();
  }
}

void Ccd::sweep(State& state) {
  const Rig& rig = task_.coordinates().rig();
  kinematics_.set(state);
  for (std::size_t e = 0; e < position_.size(); ++e) {
    position_[e] = kinematics_.position(e);
    rotation_[e] = kinematics_.rotation(e).toRotationMatrix();
  }
  for (std::int32_t i = rig.size() - 1; i >= 0; --i) {
    const RigJoint& joint = rig.joints[i];
    if (joint.type == JointType::fixed || below_[i].empty()) continue;
    if (joint.type == JointType::free) {
      place_root(state);
      continue;
    }
    Eigen::Quaterniond parent_rest = joint.rest;
    if (joint.parent != kNoJoint)
      parent_rest = kinematics_.joint_rotation(joint.parent) * joint.rest;
    const Eigen::Vector3d& pivot = kinematics_.joint_origin(i);
    const Eigen::Matrix3d turn = turn_joint(task_.coordinates(), i, parent_rest.toRotationMatrix(),
                                            fit(i, pivot, pivot), state);
    move_below(i, pivot, turn, Eigen::Vector3d::Zero());
  }
}

/// Procrustes: the effectors' weighted centre to that of their targets, and the best turn about it.
void Ccd::place_root(State& state) {
  const Rig& rig = task_.coordinates().rig();
  Eigen::Vector3d centre = Eigen::Vector3d::Zero(), wanted = centre;
  double sum = 0.0;
  for (const std::size_t e : below_[0]) {
    const double w = task_.targets()[e].weight * rig.effectors[e].weight_pos;
    centre += w * w * position_[e];
    wanted += w * w * task_.targets()[e].pose.translation();
    sum += w * w;
  }
  if (!(sum > 0.0)) return;
  centre /= sum;
  wanted /= sum;
  const Eigen::Matrix3d turn = turn_joint(
      task_.coordinates(), 0, rig.joints[0].rest.toRotationMatrix(), fit(0, centre, wanted), state);
  const Eigen::Vector3d origin = kinematics_.joint_origin(0);
  state.q.head<3>() += wanted + turn * (origin - centre) - origin;
}

// ---- FABRIK

Fabrik::Fabrik(Task& task) : task_(task), kinematics_(task.coordinates()) {
  const std::size_t n = task.coordinates().rig().joints.size();
  const Rig& rig = task.coordinates().rig();
  origin_.resize(n);
  weight_.resize(n);
  rotation_.resize(n);
  placed_.resize(n);
  turned_.resize(n);
  children_ = children_of(skeleton_of(rig));
  effectors_.resize(n);
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    effectors_[rig.effectors[e].joint].push_back(e);
  }
}

int Fabrik::solve(State& state) {
  return iterate(task_, state, best_, 500, [&](State& s) {
    inwards(s);
    outwards(s);
  });
}

void Fabrik::ask(std::int32_t i, const Eigen::Vector3d& origin, double weight) {
  origin_[i] += weight * origin;
  weight_[i] += weight;
}

/// Wanted origins and orientations from the effectors to the root; joints that nobody asks stay.
void Fabrik::inwards(const State& state) {
  const Rig& rig = task_.coordinates().rig();
  kinematics_.set(state);
  std::fill(origin_.begin(), origin_.end(), Eigen::Vector3d::Zero());
  std::fill(rotation_.begin(), rotation_.end(), Eigen::Matrix3d::Zero());
  std::fill(weight_.begin(), weight_.end(), 0.0);
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    const RigEffector& effector = rig.effectors[e];
    const EffectorTarget& target = task_.targets()[e];
    const Eigen::Vector3d at = target.pose.translation();
    const double weight = target.weight * effector.weight_pos;
    if (effector.kind == EffectorKind::pose && effector.weight_rot > 0.0) {
      ask(effector.joint, target.pose.transform_point(-effector.offset), weight);
      rotation_[effector.joint] += weight * target.pose.rotation().toRotationMatrix();
    } else {
      const Eigen::Vector3d back = kinematics_.joint_origin(effector.joint) - at;
      ask(effector.joint, at + effector.offset.norm() * back.stableNormalized(), weight);
    }
  }
  for (std::int32_t i = rig.size() - 1; i >= 0; --i) {
    if (weight_[i] == 0.0) continue;
    origin_[i] /= weight_[i];
    if (!rotation_[i].isZero()) rotation_[i] = nearest_rotation(rotation_[i]);
    ask_parent(i, state);
  }
}

void Fabrik::ask_parent(std::int32_t i, const State& state) {
  const RigJoint& joint = task_.coordinates().rig().joints[i];
  if (joint.parent == kNoJoint) return;
  const Eigen::Vector3d back = kinematics_.joint_origin(joint.parent) - origin_[i];
  ask(joint.parent, origin_[i] + joint.offset.norm() * back.stableNormalized(), weight_[i]);
  if (rotation_[i].isZero()) return;
  const Eigen::Quaterniond local = joint.rest * task_.coordinates().rotation(i, state);
  rotation_[joint.parent] += weight_[i] * rotation_[i] * local.toRotationMatrix().transpose();
}

/// From the root: each joint turns its children's bones towards their wanted origins.
void Fabrik::outwards(State& state) {
  const Rig& rig = task_.coordinates().rig();
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const RigJoint& joint = rig.joints[i];
    Eigen::Matrix3d parent_rest = joint.rest.toRotationMatrix();
    placed_[i] = joint.offset;
    if (joint.parent != kNoJoint) {
      parent_rest = turned_[joint.parent] * parent_rest;
      placed_[i] = placed_[joint.parent] + turned_[joint.parent] * joint.offset;
    } else if (joint.type == JointType::free && weight_[i] > 0.0) {
      placed_[i] = origin_[i];
      state.q.head<3>() = origin_[i] - joint.offset;
    }
    turned_[i] = parent_rest * task_.coordinates().rotation(i, state).toRotationMatrix();
    if (weight_[i] == 0.0 || joint.type == JointType::fixed) continue;
    turned_[i] = turn_joint(task_.coordinates(), i, parent_rest, fit(i, state), state) * turned_[i];
  }
}

/// Sum of w d r' over what hangs on a joint whose place and rotation so far are known.
Eigen::Matrix3d Fabrik::fit(std::int32_t i, const State& state) const {
  const Rig& rig = task_.coordinates().rig();
  Eigen::Matrix3d b = Eigen::Matrix3d::Zero();
  for (const std::int32_t child : children_[i]) {
    const Eigen::Vector3d bone = turned_[i] * rig.joints[child].offset;
    b += weight_[child] * (origin_[child] - placed_[i]) * bone.transpose();
    // One bone further, for the twist about this one: a hinge below finds its plane that way.
    const Eigen::Matrix3d below =
        turned_[i] *
        (rig.joints[child].rest * task_.coordinates().rotation(child, state)).toRotationMatrix();
    for (const std::int32_t next : children_[child]) {
      const Eigen::Vector3d arm = bone + below * rig.joints[next].offset;
      b += kFurther * weight_[next] * (origin_[next] - placed_[i]) * arm.transpose();
    }
    for (const std::size_t e : effectors_[child]) {
      const RigEffector& effector = rig.effectors[e];
      const EffectorTarget& target = task_.targets()[e];
      const Eigen::Vector3d arm = bone + below * effector.offset;
      b += kFurther * target.weight * effector.weight_pos *
           (target.pose.translation() - placed_[i]) * arm.transpose();
    }
  }
  bool carries_orientation = false;
  for (const std::size_t e : effectors_[i]) {
    const RigEffector& effector = rig.effectors[e];
    const EffectorTarget& target = task_.targets()[e];
    const Eigen::Vector3d bone = turned_[i] * effector.offset;
    b += target.weight * effector.weight_pos * (target.pose.translation() - placed_[i]) *
         bone.transpose();
    carries_orientation |= effector.kind == EffectorKind::pose && effector.weight_rot > 0.0;
  }
  if (!rotation_[i].isZero()) {
    const double share = carries_orientation ? 1.0 : kTwistShare;
    b += share * 0.5 * kRotationArm2 * weight_[i] * rotation_[i] * turned_[i].transpose();
  }
  return b;
}

}  // namespace limber::peers
