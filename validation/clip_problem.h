#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/rig.h"
#include "solver/ik_solver.h"
#include "validation/contact_detection.h"
#include "validation/effector_problem.h"

namespace limber {

/// A point of the rig that stands still during some frames.
struct StandingPoint {
  std::int32_t joint = 0;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< m, in the joint's space
  std::vector<FrameInterval> contacts;
};

/// What a whole clip is asked for.
struct ClipGoals {
  std::span<const EffectorTarget> targets;    ///< [frame * effectors + effector]
  std::vector<StandingPoint> standing;        ///< on horizontal ground
  std::span<const DualQuaternion> reference;  ///< [frame * joints + joint] bends as it should
  double rate_hz = 60.0;
};

/// Weights of what is asked for beyond the effectors.
struct ClipWeights {
  double contact = 60.0;      ///< of a standing point's horizontal distance from its place
  double smooth_s = 0.025;    ///< 1 / angular frequency (rad/s) above which departures are smoothed
  double turn_radius = 0.25;  ///< m per rad, of joints' turns in what is smoothed
};

/// The parts of a clip's cost, m^2.
struct ClipCost {
  double effectors = 0.0, contacts = 0.0, smoothness = 0.0;
  double total() const { return effectors + contacts + smoothness; }
};

/// The objective of a whole clip, frame by frame (derivation in clip_problem.cpp). Rig and goals
/// outlive it.
class ClipProblem {
 public:
  /// `clip` says where standing points stand: at their mean place in each contact.
  ClipProblem(const Rig&, const ClipGoals&, const ClipWeights&, const Clip& clip);

  /// One frame's coordinates and rows; starts from a pose.
  EffectorProblem frame(std::int64_t frame,
                        std::span<const DualQuaternion> parent_from_joint) const;

  /// What one frame contributes at x. Its pull's squares are part of the cost; so are those of
  /// m(f - 1) - 2 m(f) + m(f + 1), m the motion.
  struct Rows {
    Eigen::VectorXd pull, motion;
    Eigen::MatrixXd pull_by_x, motion_by_x;  ///< empty where not asked for
  };
  void evaluate(const EffectorProblem&, std::int64_t frame, const Eigen::VectorXd& x,
                bool with_jacobian, Rows&) const;

  ClipCost cost(const Clip&) const;

  std::int64_t frames() const { return frames_; }
  /// [coordinate] 1: belongs to a joint that carries an effector or stands above one that does.
  const std::vector<std::uint8_t>& moves() const { return moves_; }

 private:
  void add_points(const ClipGoals&, const ClipWeights&);
  void place_targets(const ClipGoals&, const Clip&);
  std::vector<Eigen::Vector3d> standing_places(const StandingPoint&, const Clip&) const;
  void turn_rows(const PoseChart&, std::int64_t frame, const Eigen::VectorXd& x, bool with_jacobian,
                 Rows&) const;

  Rig rig_;                              // with effectors for contacts and for what is smoothed
  std::vector<EffectorTarget> targets_;  // [frame * effectors + effector]
  std::span<const DualQuaternion> reference_;
  std::vector<StandingPoint> standing_;
  std::vector<std::int32_t> turning_;  // joints whose turns are smoothed
  std::vector<std::uint8_t> moves_;
  std::int64_t frames_ = 0;
  Eigen::Index effector_rows_ = 0, contact_rows_ = 0, point_rows_ = 0;
  double smooth_ = 0.0, turn_radius_ = 0.0;
};

}  // namespace limber
