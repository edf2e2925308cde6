#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "pipeline/calibration.h"
#include "pipeline/figure.h"

namespace limber {

/// Spine, neck and head from one body to another. Joints share the source's curve whatever their
/// counts and lengths are, and the target's trunk leans as the source's does: the way from between
/// the hip joints to between the shoulders has turned alike since the T-pose.
class TrunkTransfer {
 public:
  /// The figures and calibrations must outlive it.
  TrunkTransfer(const Figure& from, const Calibration& from_t_pose, const Figure& to,
                const Calibration& to_t_pose);

  /// `since[joint]`: world rotation since the T-pose of the target's joints. Sets those of spine,
  /// neck and head; those of hips and clavicles must be there.
  void frame(std::span<const DualQuaternion> source_model_from_joint,
             std::span<Eigen::Quaterniond> since) const;

 private:
  /// A piece of the way from the hips to the shoulders, which one joint turns; T-pose axes.
  struct Bone {
    std::int32_t joint;
    Eigen::Vector3d span;
  };

  void list_bones();
  void lean(const Eigen::Vector3d& wanted, std::span<Eigen::Quaterniond> since) const;

  const Figure& from_;
  const Figure& to_;
  const Calibration& from_t_pose_;
  const Calibration& to_t_pose_;
  std::vector<double> source_neck_, target_neck_;
  std::vector<Bone> bones_;  // empty where a figure has no shoulders, or the target no spine
  Eigen::Matrix3d source_axes_;
  Eigen::Vector3d target_axis_;
};

}  // namespace limber
