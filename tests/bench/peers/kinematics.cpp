#include "tests/bench/peers/kinematics.h"

#include <algorithm>

namespace limber::peers {

Kinematics::Kinematics(const Coordinates& coordinates) : coordinates_(coordinates) {
  const Rig& rig = coordinates.rig();
  for (const RigEffector& effector : rig.effectors) {
    std::vector<std::int32_t> joints;
    for (std::int32_t i = effector.joint; i != kNoJoint; i = rig.joints[i].parent) {
      joints.push_back(i);
    }
    std::reverse(joints.begin(), joints.end());
    std::vector<Eigen::Index> chain;
    for (const std::int32_t i : joints) {
      for (int k = 0; k < dof_count(rig.joints[i].type); ++k) {
        chain.push_back(coordinates.begin(i) + k);
      }
    }
    joints_.push_back(std::move(joints));
    chains_.push_back(std::move(chain));
  }
}

PlainKinematics::PlainKinematics(const Coordinates& coordinates)
    : Kinematics(coordinates),
      rotation_(coordinates.rig().joints.size()),
      origin_(coordinates.rig().joints.size()),
      axis_(3, coordinates.dofs()) {}

void PlainKinematics::set(const State& state) {
  const Rig& rig = coordinates_.rig();
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const RigJoint& joint = rig.joints[i];
    Eigen::Vector3d offset = joint.offset;
    if (joint.type == JointType::free) offset += state.q.segment<3>(coordinates_.begin(i));
    const Eigen::Quaterniond local = joint.rest * coordinates_.rotation(i, state);
    if (joint.parent == kNoJoint) {
      origin_[i] = offset;
      rotation_[i] = local;
    } else {
      origin_[i] = origin_[joint.parent] + rotation_[joint.parent] * offset;
      rotation_[i] = rotation_[joint.parent] * local;
    }
  }
}

Eigen::Vector3d PlainKinematics::position(std::size_t e) const {
  const RigEffector& effector = coordinates_.rig().effectors[e];
  return origin_[effector.joint] + rotation_[effector.joint] * effector.offset;
}

Eigen::Quaterniond PlainKinematics::rotation(std::size_t e) const {
  return rotation_[coordinates_.rig().effectors[e].joint];
}

void PlainKinematics::prepare_jacobian(const State& state) {
  const Rig& rig = coordinates_.rig();
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const RigJoint& joint = rig.joints[i];
    const Eigen::Matrix3d world = rotation_[i].toRotationMatrix();
    const Eigen::Index at = coordinates_.begin(i);
    switch (joint.type) {
      case JointType::fixed:
        break;
      case JointType::hinge:
        axis_.col(at) = world * joint.axes[0];
        break;
      case JointType::universal: {
        const Eigen::AngleAxisd back(-state.q[at + 1], joint.axes[1]);
        axis_.col(at) = world * (back * joint.axes[0]);
        axis_.col(at + 1) = world * joint.axes[1];
        break;
      }
      case JointType::ball:
        axis_.middleCols<3>(at) = world * coordinates_.ball_columns(i, state);
        break;
      case JointType::free:
        axis_.middleCols<3>(at).setIdentity();
        axis_.middleCols<3>(at + 3) = world;
        break;
    }
  }
}

void PlainKinematics::jacobian(std::size_t e, ChainJacobian& jacobian) {
  const Eigen::Vector3d point = position(e);
  Eigen::Index column = 0;
  for (const std::int32_t i : joints(e)) {
    const RigJoint& joint = coordinates_.rig().joints[i];
    const Eigen::Vector3d arm = point - origin_[i];
    for (int k = 0; k < dof_count(joint.type); ++k, ++column) {
      const Eigen::Vector3d axis = axis_.col(coordinates_.begin(i) + k);
      if (joint.type == JointType::free && k < 3) {
        jacobian.col(column) << axis, Eigen::Vector3d::Zero();
      } else {
        jacobian.col(column) << axis.cross(arm), axis;
      }
    }
  }
}

}  // namespace limber::peers
