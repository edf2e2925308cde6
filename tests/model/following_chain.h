#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/model/rigid_forms.h"

namespace limber::test {

// The experiment of Kenwright 2012, section 10.1: rigid links in one chain, each link's transform
// kept in the form under test, a straightforward solver that turns the links so that the end
// follows a target with six degrees of freedom. Every frame multiplies small turns onto the links'
// own transforms, never rebuilt from angles: that is what lets a form drift.
//
// The solver is one damped least-squares step per frame on balls. A turn w about joint j, with r
// the way from there to the end, moves the end by J w = (w x r, w); with (J J' + damping) y =
// error, the step is w = J' y = r x y_position + y_rotation.

/// When links are put right. `links`: a link after each of its updates. `levels`: besides, every
/// product from the root to the end, as the paper does with its matrices.
enum class Repair { never, links, levels };

inline const char* to_string(Repair repair) {
  switch (repair) {
    case Repair::never:
      return "never";
    case Repair::links:
      return "links";
    default:
      return "links + levels";
  }
}

struct Following {
  double not_rigid = 0.0;       ///< of the end's transform: largest entry of A'A - 1
  double link_stretch_m = 0.0;  ///< largest change of a link's length
  double miss_m = 0.0;          ///< end from target, as the form sees it, worst of the last 600
  double rigid_miss_m = 0.0;    ///< the same with rigid bones on the links' rotations
  double joint_step_rad = 0.0;  ///< largest turn of a link between two frames, beyond the first 600
};

/// A target on a smooth closed path in reach; time in seconds.
inline Eigen::Isometry3d following_target(double time) {
  Eigen::Isometry3d target = Eigen::Isometry3d::Identity();
  target.translation() = Eigen::Vector3d(0.9 + 0.3 * std::sin(1.1 * time),
                                         0.5 * std::sin(0.7 * time), 0.5 * std::cos(0.9 * time));
  const Eigen::Vector3d turn(0.8 * std::sin(0.6 * time), 0.7 * std::sin(0.8 * time),
                             0.9 * std::sin(0.5 * time));
  target.linear() = Eigen::AngleAxisd(turn.norm(), turn.stableNormalized()).toRotationMatrix();
  return target;
}

template <class Form>
class FollowingChain {
 public:
  static constexpr int kLinks = 6;
  static constexpr double kLength = 0.3;  // m, along x

  explicit FollowingChain(Repair repair) : repair_(repair) {
    ExactMotion link = ExactMotion::from_translation({kLength, 0, 0});
    // Bent at the start: a straight chain cannot shorten.
    for (int j = 0; j < kLinks; ++j) {
      const long double angle = j % 2 == 0 ? 0.5L : -0.8L;
      const Eigen::Quaternion<long double> bend(
          Eigen::AngleAxis<long double>(angle, Eigen::Matrix<long double, 3, 1>::UnitY()));
      if (j == 0) link = ExactMotion::identity();
      local_.push_back(Form::from(link * ExactMotion::from_rotation(bend)));
      link = ExactMotion::from_translation({kLength, 0, 0});
    }
    world_.resize(kLinks);
  }

  /// One step towards the target; returns the largest turn it made (rad).
  double follow(const Eigen::Isometry3d& target) {
    update_world();
    const Eigen::Matrix<double, 6, 1> error = miss(end_of(world_), target);
    Eigen::Matrix<double, 6, 6> normal = 1e-4 * Eigen::Matrix<double, 6, 6>::Identity();
    const Eigen::Vector3d end = end_of(world_).col(3);
    for (const Seen& joint : world_) {
      Eigen::Matrix<double, 6, 3> columns;
      columns << -cross_matrix(end - joint.col(3)), Eigen::Matrix3d::Identity();
      normal += columns * columns.transpose();
    }
    const Eigen::Matrix<double, 6, 1> y = normal.ldlt().solve(error);
    double largest = 0.0;
    for (int j = 0; j < kLinks; ++j) {
      const Eigen::Vector3d arm = end - world_[j].col(3);
      const Eigen::Vector3d turn = arm.cross(y.head<3>()) + y.tail<3>();
      apply(j, rotation_of(world_[j]).transpose() * turn);
      largest = std::max(largest, turn.norm());
    }
    return largest;
  }

  Following state(const Eigen::Isometry3d& target) {
    update_world();
    Following state;
    state.not_rigid = not_rigid(end_of(world_));
    state.miss_m = miss(end_of(world_), target).template head<3>().norm();
    Eigen::Isometry3d bones = Eigen::Isometry3d::Identity();
    for (int j = 0; j < kLinks; ++j) {
      const Seen local = local_[j].seen();
      if (j > 0) {
        bones.translate(Eigen::Vector3d(kLength, 0, 0));
        state.link_stretch_m =
            std::max(state.link_stretch_m, std::abs(local.col(3).norm() - kLength));
      }
      bones.rotate(rotation_of(local));
    }
    bones.translate(Eigen::Vector3d(kLength, 0, 0));
    state.rigid_miss_m = (bones.translation() - target.translation()).norm();
    return state;
  }

 private:
  static Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
    Eigen::Matrix3d m;
    m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
    return m;
  }

  /// The rotation nearest to a drifted one, to first order of the drift.
  static Eigen::Matrix3d rotation_of(const Seen& seen) {
    const Eigen::Matrix3d a = seen.leftCols<3>();
    return Eigen::Quaterniond(a).normalized().toRotationMatrix();
  }

  static Seen end_of(const std::vector<Seen>& world) {
    Seen end = world.back();
    end.col(3) += kLength * end.col(0);
    return end;
  }

  static Eigen::Matrix<double, 6, 1> miss(const Seen& end, const Eigen::Isometry3d& target) {
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(target.linear() * rotation_of(end).transpose()));
    Eigen::Matrix<double, 6, 1> error;
    error << target.translation() - end.col(3), turn.angle() * turn.axis();
    return error;
  }

  void update_world() {
    Form world;
    for (int j = 0; j < kLinks; ++j) {
      world = j == 0 ? local_[0] : world * local_[j];
      if (repair_ == Repair::levels) world = world.mended();
      world_[j] = world.seen();
    }
  }

  void apply(int j, const Eigen::Vector3d& turn) {
    const ExactMotion step =
        ExactMotion::exp({turn.cast<long double>(), Eigen::Matrix<long double, 3, 1>::Zero()});
    local_[j] = local_[j] * Form::from(step);
    if (repair_ != Repair::never) local_[j] = local_[j].mended();
  }

  Repair repair_;
  std::vector<Form> local_;  // parent from link
  std::vector<Seen> world_;
};

/// Follows the target for so many frames at 60 Hz.
template <class Form>
Following follow(Repair repair, int frames) {
  constexpr int kSettle = 600;
  FollowingChain<Form> chain(repair);
  Following worst;
  for (int f = 0; f < frames; ++f) {
    const Eigen::Isometry3d target = following_target(f / 60.0);
    const double turn = chain.follow(target);
    if (f >= kSettle) worst.joint_step_rad = std::max(worst.joint_step_rad, turn);
    if (f < frames - kSettle) continue;
    const Following now = chain.state(target);
    worst.not_rigid = std::max(worst.not_rigid, now.not_rigid);
    worst.link_stretch_m = std::max(worst.link_stretch_m, now.link_stretch_m);
    worst.miss_m = std::max(worst.miss_m, now.miss_m);
    worst.rigid_miss_m = std::max(worst.rigid_miss_m, now.rigid_miss_m);
  }
  return worst;
}

}  // namespace limber::test
