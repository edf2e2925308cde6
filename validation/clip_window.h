#pragma once

#include <cstdint>
#include <vector>

#include "validation/clip_problem.h"

namespace limber {

/// Some frames of a clip in a row, solved as one sparse problem by Ceres (clip_window.cpp); the
/// frames around them stay, and count.
class ClipWindow {
 public:
  /// Frames [begin, end) of the clip.
  ClipWindow(const ClipProblem&, const Clip&, std::int64_t begin, std::int64_t end);

  /// One round: holds what its bounds hold, and minimises over the rest. False: nothing gained.
  bool minimise(int max_iterations, double enough);
  void write(Clip&) const;
  std::int64_t iterations() const { return iterations_; }

 private:
  friend class WindowState;
  struct Frame {
    std::int64_t index = 0;
    EffectorProblem problem;
    std::vector<int> free;       ///< coordinates that may move; empty for frames around the window
    std::vector<double> values;  ///< of those, Ceres's own
    ClipProblem::Rows rows;
  };

  bool solved(const Frame& frame) const { return frame.index >= begin_ && frame.index < end_; }
  Eigen::VectorXd coordinates(const Frame&) const;
  void evaluate(Frame&, bool with_jacobian) const;
  double cost() const;
  Eigen::VectorXd bend(std::size_t first) const;
  void choose_free();
  Eigen::VectorXd gradient(std::size_t frame) const;

  const ClipProblem& problem_;
  std::int64_t begin_, end_;
  std::vector<Frame> frames_;  ///< up to two before the window, the window, up to two after it
  std::int64_t iterations_ = 0;
  double cost_ = 0.0;
};

}  // namespace limber
