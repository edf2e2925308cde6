#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "validation/contact_sheet.h"
#include "validation/figure_model.h"
#include "validation/rasteriser.h"

namespace limber {

/// Which frames to draw: the asked ones, or `count` chosen ones, sorted: the first and the last,
/// the worst error, the poses that differ most from the mean and from each other, and even ones.
std::vector<std::int64_t> choose_frames(const ContactSheet&, const BodyPlan&, std::size_t count);

/// The frame of `source` that is played at the time of the target's frame.
std::int64_t frame_at_same_time(const Clip& target, std::int64_t frame, const Clip& source);

/// Unit horizontal direction in which a figure looks, from left and right joints; +Z if unknown.
Eigen::Vector3d facing_of(const BodyPlan&, std::span<const DualQuaternion> model_from_joint);

/// From where a row is drawn: direction from figure to eye, and what is up in the picture.
struct ViewDirection {
  Eigen::Vector3d towards_eye{0, 0, 1};
  Eigen::Vector3d up{0, 1, 0};
  bool ground = true;  ///< draw the floor, follow horizontally; else follow everywhere
};

/// Three-quarter front view of a body, dorsal-oblique view of a hand.
ViewDirection front_view(const Skeleton&, const BodyPlan&,
                         std::span<const DualQuaternion> model_from_joint);
/// The same, turned by 90 degrees about `up`, and square to the figure.
ViewDirection side_view(const Skeleton&, const BodyPlan&,
                        std::span<const DualQuaternion> model_from_joint);

/// One camera for all cells of a row, moved along with the figure.
class RowCamera {
 public:
  RowCamera(const ViewDirection&, std::int32_t width, std::int32_t height);

  /// Widens the frame so that these points fit when the figure stands at `anchor`, turned by
  /// `turn` since the first frame.
  void include(std::span<const Eigen::Vector3d> points, const Eigen::Vector3d& anchor,
               const Eigen::Quaterniond& turn = Eigen::Quaterniond::Identity());
  /// To be called after the last include. Gives the cell height that is used, at most the one
  /// that was asked for: wide figures need less.
  std::int32_t fit();

  Camera at(const Eigen::Vector3d& anchor,
            const Eigen::Quaterniond& turn = Eigen::Quaterniond::Identity()) const;
  const ViewDirection& view() const { return view_; }

 private:
  Eigen::Vector3d base_of(const Eigen::Vector3d& anchor) const;

  ViewDirection view_;
  std::int32_t width_, height_;
  std::vector<Eigen::Vector3d> points_;  // relative to the base
  Camera camera_;                        // at base zero
};

}  // namespace limber
