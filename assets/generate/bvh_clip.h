#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <string>
#include <vector>

namespace limber::generate {

/// A joint of a skeleton whose rest pose is the T-pose with every joint's axes along the world's
/// (+Y up, facing +Z, its left +X). Centimetres.
struct MadeJoint {
  std::string name;
  int parent = -1;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< from the parent
  Eigen::Vector3d tip = Eigen::Vector3d::Zero();     ///< End Site of a joint without children
};

struct MadeFrame {
  Eigen::Vector3d root = Eigen::Vector3d::Zero();  ///< cm
  std::vector<Eigen::Quaterniond> local;           ///< [joint] parent_from_joint rotation
};

struct MadeClip {
  std::vector<MadeJoint> joints;  ///< parents first, each joint's children in file order
  std::vector<MadeFrame> frames;
  double rate_hz = 30.0;

  int find(const std::string& name) const;
};

/// The clip as BVH: centimetres, ZXY, angles without jumps, three decimals of a degree.
std::string bvh_text(const MadeClip&);

}  // namespace limber::generate
