// One parameter block per frame: its free coordinates, box bounds. Residual blocks: a frame's pull
// (1 frame), and w (m(f-1) - 2 m(f) + m(f+1)) (3 frames). So J'J is block-pentadiagonal in time,
// and its factor, in the order of the frames, fills nothing outside the band: time and memory are
// linear in the frames.
//
// The factorisation is Eigen's simplicial LDL', not SuiteSparse: SuiteSparse calls the BLAS that
// happens to be installed, whose kernels differ from processor to processor, and the same input
// must give the same bytes. At this band (about 100 to 150 coordinates) supernodes gain little.
//
// Bounds. Ceres projects its steps onto the box, and creeps where many bounds are active: its steps
// do not know of them. So each round first finds what a bound holds, by the sign of the gradient,
// and leaves that out, then minimises the rest. Coordinates that a round let go or brought to a
// bound are looked at again by the next (an active set method; Nocedal and Wright, ch. 16.7).
#include "validation/clip_window.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

constexpr double kOnBound = 1e-12;  // rad: this near, a coordinate is on its bound
constexpr double kSlope = 1e-13;    // gradient below which a bound neither holds nor lets go

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Columns of the free coordinates, times a factor, into what Ceres wants.
void put_columns(const Eigen::MatrixXd& by_x, const std::vector<int>& free, double factor,
                 double* out) {
  Eigen::Map<RowMajor> map(out, by_x.rows(), static_cast<Eigen::Index>(free.size()));
  for (std::size_t k = 0; k < free.size(); ++k) {
    map.col(static_cast<Eigen::Index>(k)) = factor * by_x.col(free[k]);
  }
}

}  // namespace

/// What Ceres evaluates: all frames' rows at once, before any residual block is asked for.
class WindowState : public ceres::EvaluationCallback {
 public:
  explicit WindowState(ClipWindow& window) : window_(window) {}

  void PrepareForEvaluation(bool with_jacobian, bool is_new) override {
    if (!is_new && (!with_jacobian || has_jacobian_)) return;
    for (ClipWindow::Frame& frame : window_.frames_) {
      if (!frame.free.empty()) window_.evaluate(frame, with_jacobian);
    }
    has_jacobian_ = with_jacobian;
  }

  /// E and C of one frame.
  class Pull : public ceres::CostFunction {
   public:
    explicit Pull(const ClipWindow::Frame& frame) : frame_(frame) {
      set_num_residuals(static_cast<int>(frame.rows.pull.size()));
      mutable_parameter_block_sizes()->push_back(static_cast<int>(frame.free.size()));
    }
    bool Evaluate(double const* const*, double* residuals, double** jacobians) const override {
      const Eigen::VectorXd& pull = frame_.rows.pull;
      Eigen::VectorXd::Map(residuals, pull.size()) = pull;
      if (jacobians != nullptr && jacobians[0] != nullptr) {
        put_columns(frame_.rows.pull_by_x, frame_.free, 1.0, jacobians[0]);
      }
      return pull.allFinite();
    }

   private:
    const ClipWindow::Frame& frame_;
  };

  /// The bend over three frames, of which some are free.
  class Bend : public ceres::CostFunction {
   public:
    Bend(const ClipWindow& window, std::size_t first) : window_(window), first_(first) {
      set_num_residuals(static_cast<int>(window.frames_[first].rows.motion.size()));
      for (std::size_t k = 0; k < 3; ++k) {
        const auto count = static_cast<int>(window.frames_[first + k].free.size());
        if (count > 0) mutable_parameter_block_sizes()->push_back(count);
      }
    }
    bool Evaluate(double const* const*, double* residuals, double** jacobians) const override {
      const Eigen::VectorXd bend = window_.bend(first_);
      Eigen::VectorXd::Map(residuals, bend.size()) = bend;
      std::size_t block = 0;
      for (std::size_t k = 0; k < 3 && jacobians != nullptr; ++k) {
        const ClipWindow::Frame& frame = window_.frames_[first_ + k];
        if (frame.free.empty()) continue;
        double* out = jacobians[block++];
        if (out != nullptr) {
          put_columns(frame.rows.motion_by_x, frame.free, k == 1 ? -2.0 : 1.0, out);
        }
      }
      return bend.allFinite();
    }

   private:
    const ClipWindow& window_;
    std::size_t first_;
  };

  void add_to(ceres::Problem& problem) {
    std::vector<ClipWindow::Frame>& frames = window_.frames_;
    for (ClipWindow::Frame& frame : frames) {
      if (frame.free.empty()) continue;
      problem.AddResidualBlock(new Pull(frame), nullptr, frame.values.data());
      const PoseChart& chart = frame.problem.chart();
      for (std::size_t k = 0; k < frame.free.size(); ++k) {
        const double low = chart.lower()[frame.free[k]], high = chart.upper()[frame.free[k]];
        const int index = static_cast<int>(k);
        if (std::isfinite(low)) problem.SetParameterLowerBound(frame.values.data(), index, low);
        if (std::isfinite(high)) problem.SetParameterUpperBound(frame.values.data(), index, high);
      }
    }
    for (std::size_t first = 0; first + 2 < frames.size(); ++first) {
      std::vector<double*> blocks;
      for (std::size_t k = 0; k < 3; ++k) {
        if (!frames[first + k].free.empty()) blocks.push_back(frames[first + k].values.data());
      }
      if (!blocks.empty()) problem.AddResidualBlock(new Bend(window_, first), nullptr, blocks);
    }
  }

 private:
  ClipWindow& window_;
  bool has_jacobian_ = false;
};

ClipWindow::ClipWindow(const ClipProblem& problem, const Clip& clip, std::int64_t begin,
                       std::int64_t end)
    : problem_(problem), begin_(begin), end_(end) {
  const std::int64_t first = std::max<std::int64_t>(begin - 2, 0);
  const std::int64_t last = std::min(end + 2, clip.frames());
  for (std::int64_t f = first; f < last; ++f) {
    frames_.push_back({f, problem.frame(f, clip.frame(f)), {}, {}, {}});
    evaluate(frames_.back(), false);
  }
  cost_ = cost();
}

Eigen::VectorXd ClipWindow::coordinates(const Frame& frame) const {
  const PoseChart& chart = frame.problem.chart();
  Eigen::VectorXd x = chart.x();
  for (std::size_t k = 0; k < frame.free.size(); ++k) {
    const int i = frame.free[k];
    x[i] = std::clamp(frame.values[k], chart.lower()[i], chart.upper()[i]);
  }
  return x;
}

void ClipWindow::evaluate(Frame& frame, bool with_jacobian) const {
  problem_.evaluate(frame.problem, frame.index, coordinates(frame), with_jacobian, frame.rows);
}

Eigen::VectorXd ClipWindow::bend(std::size_t first) const {
  return frames_[first].rows.motion - 2.0 * frames_[first + 1].rows.motion +
         frames_[first + 2].rows.motion;
}

double ClipWindow::cost() const {
  double sum = 0.0;
  for (const Frame& frame : frames_) {
    if (solved(frame)) sum += frame.rows.pull.squaredNorm();
  }
  for (std::size_t first = 0; first + 2 < frames_.size(); ++first) {
    sum += bend(first).squaredNorm();
  }
  return sum;
}

/// Half the cost's, at the current rows.
Eigen::VectorXd ClipWindow::gradient(std::size_t frame) const {
  const ClipProblem::Rows& rows = frames_[frame].rows;
  Eigen::VectorXd by_motion = Eigen::VectorXd::Zero(rows.motion.size());
  for (std::size_t k = 0; k < 3; ++k) {
    if (frame < k || frame - k + 2 >= frames_.size()) continue;
    by_motion += (k == 1 ? -2.0 : 1.0) * bend(frame - k);
  }
  return rows.pull_by_x.transpose() * rows.pull + rows.motion_by_x.transpose() * by_motion;
}

void ClipWindow::choose_free() {
  for (Frame& frame : frames_) {
    if (!solved(frame)) continue;
    frame.problem.chart().rechart();
    frame.free.clear();
    evaluate(frame, true);
  }
  for (std::size_t f = 0; f < frames_.size(); ++f) {
    Frame& frame = frames_[f];
    if (!solved(frame)) continue;
    const PoseChart& chart = frame.problem.chart();
    const Eigen::VectorXd slope = gradient(f);
    frame.values.clear();
    for (int k = 0; k < slope.size(); ++k) {
      const double x = chart.x()[k], low = chart.lower()[k], high = chart.upper()[k];
      const bool held = (x <= low + kOnBound && slope[k] > -kSlope) ||
                        (x >= high - kOnBound && slope[k] < kSlope);
      if (problem_.moves()[k] == 0 || held || high - low <= 2.0 * kOnBound) continue;
      frame.free.push_back(k);
      frame.values.push_back(x);
    }
  }
}

bool ClipWindow::minimise(int max_iterations, double enough) {
  choose_free();
  WindowState state(*this);
  ceres::Problem::Options problem_options;
  problem_options.evaluation_callback = &state;
  ceres::Problem ceres_problem(problem_options);
  state.add_to(ceres_problem);
  if (ceres_problem.NumResidualBlocks() == 0) return false;
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  options.max_num_iterations = max_iterations;
  options.function_tolerance = 0.1 * enough;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &ceres_problem, &summary);
  iterations_ += static_cast<std::int64_t>(summary.iterations.size()) - 1;

  std::vector<Eigen::VectorXd> kept;
  for (Frame& frame : frames_) {
    kept.push_back(frame.problem.chart().x());
    frame.problem.chart().set_x(coordinates(frame));
    frame.free.clear();
    evaluate(frame, false);
  }
  const double reached = cost();
  if (!summary.IsSolutionUsable() || !(reached < cost_)) {
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      frames_[f].problem.chart().set_x(kept[f]);
      evaluate(frames_[f], false);
    }
    return false;
  }
  const bool gained = reached < cost_ * (1.0 - enough);
  cost_ = reached;
  return gained;
}

void ClipWindow::write(Clip& clip) const {
  for (const Frame& frame : frames_) {
    if (!solved(frame)) continue;
    const PoseChart& chart = frame.problem.chart();
    std::vector<DualQuaternion> pose(clip.frame(frame.index).begin(),
                                     clip.frame(frame.index).end());
    chart.pose(chart.x(), pose);
    for (std::size_t i = 0; i < pose.size(); ++i) {
      const std::int32_t first = chart.begin()[i];
      if (chart.begin()[i + 1] > first && problem_.moves()[first] != 0) {
        clip.frame(frame.index)[i] = pose[i];
      }
    }
  }
}

}  // namespace limber
