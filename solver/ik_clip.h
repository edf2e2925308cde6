#pragma once

#include <compare>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "solver/ik_solver.h"

namespace limber {

/// Solves a clip frame by frame and mends what following it got into.
///
/// What the targets leave open (a swivel, a spine) depends on the frames before, and may lead into
/// a corner of the limits from where the next target cannot be reached although the rig could. Such
/// a frame is solved anew from elsewhere, and the frames before it are led over to that solution,
/// each still on its targets, so that nothing jumps. What bends sharply for all that is smoothed.
class IkClipSolver {
 public:
  /// `targets`: [frame * effectors], gone round where there are more poses. `poses`: [frame *
  /// joints], parent from joint; the first frame holds the start, answers are written as they come.
  /// Both and the solver outlive this.
  IkClipSolver(IkSolver& solver, const Rig&, std::span<const EffectorTarget> targets,
               std::span<DualQuaternion> poses);

  std::int64_t frames() const { return frames_; }
  /// Solves the next frame. Earlier answers may change with it.
  IkReport next();
  /// How many frames were mended, and for how many of those no smooth way was found.
  int mended() const { return mended_; }
  int jumps() const { return jumps_; }

 private:
  std::span<const EffectorTarget> targets(std::int64_t frame) const;
  std::span<DualQuaternion> pose(std::int64_t frame) const;
  void watch(std::int64_t frame, const IkReport&);
  bool follow_to(std::int64_t frame, std::int64_t from, std::int64_t to,
                 std::span<DualQuaternion> pose);
  bool try_elsewhere(std::int64_t frame, std::size_t start, std::span<DualQuaternion> other,
                     IkReport&);
  void look_elsewhere(std::int64_t frame, IkReport&);
  bool mend(std::int64_t frame, IkReport&);
  bool join(std::int64_t frame, std::span<const DualQuaternion> other);
  std::int64_t lead_over(std::int64_t frame, std::span<const DualQuaternion> other,
                         std::int64_t count);
  std::int64_t follow_back(std::int64_t frame, std::int64_t least);
  bool join_earlier(std::int64_t frame, std::int64_t least);
  void mark_rough(std::int64_t first, std::int64_t last);
  double kink(std::int64_t frame) const;
  bool sharp(std::int64_t frame) const;
  double worst_kink(std::int64_t first, std::int64_t last) const;
  void smooth_rough(std::int64_t frame);
  void smooth_stretch(std::int64_t first, std::int64_t last, std::int64_t now);
  void smooth(std::int64_t frame, std::int64_t stride);
  static std::span<DualQuaternion> row(std::vector<DualQuaternion>&, std::int64_t index,
                                       std::int32_t joints);

  std::span<DualQuaternion> elsewhere(std::size_t start) {
    return row(elsewhere_, static_cast<std::int64_t>(start), joints_);
  }

  /// Another solution of a frame.
  struct Other {
    bool ends = false;  ///< soon
    double turn = 0.0;  ///< from the frame's answer (rad)
    std::size_t start = 0;
    auto operator<=>(const Other&) const = default;
  };

  IkSolver& solver_;
  std::int32_t joints_, effectors_;
  std::int64_t frames_, next_ = 0, retry_ = 0, patience_ = 1, jumped_ = -1;
  std::span<const EffectorTarget> targets_;
  std::span<DualQuaternion> poses_;
  std::vector<DualQuaternion> elsewhere_;  ///< [start * joint]
  std::vector<Other> others_;              ///< the best first
  double way_bend_ = 0.0;  ///< rad per frame^2, at most on a way from one solution to another
  double credit_;          ///< frames that may be solved again
  std::vector<DualQuaternion> way_;  ///< [frame * joint] from one solution to another, backwards
  std::vector<DualQuaternion>
      back_;  ///< [frame * joint] the other solution, backwards; 0: the frame
  std::vector<DualQuaternion> between_;        ///< [joint]
  std::int64_t rough_first_ = 0, rough_ = -1;  ///< frames to be smoothed; -1: none
  int mended_ = 0, jumps_ = 0, calm_ = 0;
};

}  // namespace limber
