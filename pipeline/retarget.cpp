#include "pipeline/retarget.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "pipeline/clip_passes.h"
#include "pipeline/self_contacts.h"
#include "pipeline/source_cycle.h"
#include "solver/swing_twist.h"
#include "validation/ceres_refiner.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr std::size_t kRefinedWorst = 4;  // frames with the largest error that Ceres checks
constexpr std::size_t kRefinedEven = 8;   // and an even sample
constexpr double kBentTolerance = M_PI / 180.0;
constexpr double kReachableM = 1e-3;
constexpr double kNeighbourLapS = 1.5;  // of the laps before and after that a cycle's frames feel

std::string name_of(SolverChoice choice) {
  switch (choice) {
    case SolverChoice::pgs:
      return "pgs";
    case SolverChoice::pgs_paper:
      return "pgs-paper";
    case SolverChoice::ceres:
      return "ceres";
  }
  return "";
}

/// Joints that follow a namesake in the source have no limits: they turn as it does.
void release_carried(Rig& rig, const EffectorTrack& track) {
  const std::size_t rows = rig.joints.size();
  for (std::size_t i = 0; i < rows; ++i) {
    RigJoint& row = rig.joints[i];
    if (row.type != JointType::fixed) continue;
    for (std::int64_t f = 0; f < track.frames; ++f) {
      if (rotation_angle(track.guess[std::size_t(f) * rows + i].rotation(), row.rest) < 1e-9) {
        continue;
      }
      row.type = JointType::ball;
      row.limits = {};
      break;
    }
  }
}

/// Solves a clip in passes and joins the best of them.
///
/// A frame may have several local minima (an arm behind the back, a limit that can be passed on
/// either side), and the best one may change from frame to frame; taking it every time makes the
/// motion jump. So each frame is solved three times: from its own first guess, from the frame
/// before and from the frame after. Where they differ, the cheapest way through the clip is taken
/// (see join_passes).
class ClipSolver {
 public:
  ClipSolver(const RetargetOptions& options, Retargeted& out)
      : options_(options),
        out_(out),
        rows_(out.rig.joints.size()),
        frames_(out.track.frames),
        held_(rows_, 0) {
    for (const RigEffector& effector : out.rig.effectors) {
      for (std::int32_t i = effector.joint; i != kNoJoint; i = out.rig.joints[i].parent)
        held_[i] = 1;
    }
  }

  Result<void> run() {
    IkOptions ik;
    ik.method = options_.solver == SolverChoice::pgs_paper ? IkMethod::pgs_paper : IkMethod::pgs;
    ik.stop_at_tolerance = false;
    auto solver = IkSolver::create(out_.rig, ik);
    if (!solver) return solver.error();
    solver_ = &*solver;
    out_.rig_clip.joints = static_cast<std::int32_t>(rows_);
    out_.solver.name = name_of(options_.solver);
    if (options_.solver != SolverChoice::ceres) {
      out_.solver.relinearisations.assign(static_cast<std::size_t>(frames_), 0.0);
    }
    Pass from_guess(frames_, rows_), forward(frames_, rows_), backward(frames_, rows_);
    for (std::int64_t f = 0; f < frames_; ++f) {
      if (auto r = solve(f, guess(f), from_guess); !r) return r;
    }
    for (std::int64_t f = 0; f < frames_; ++f) {
      if (auto r = solve(f, f == 0 ? guess(f) : forward.pose(f - 1), forward); !r) return r;
    }
    for (std::int64_t f = frames_ - 1; f >= 0; --f) {
      const bool settled = same_solution(from_guess, forward, f);
      if (settled) {
        std::ranges::copy(forward.pose(f), backward.pose(f).begin());
        backward.cost[f] = forward.cost[f];
      } else if (auto r = solve(f, f == frames_ - 1 ? guess(f) : backward.pose(f + 1), backward);
                 !r) {
        return r;
      }
    }
    out_.rig_clip.parent_from_joint =
        join_passes(std::array<const Pass*, 3>{&from_guess, &forward, &backward});
    return {};
  }

 private:
  std::span<const DualQuaternion> guess(std::int64_t f) const {
    return {out_.track.guess.data() + f * std::int64_t(rows_), rows_};
  }

  /// Solves frame f from `start` (projected into the limits first) into the pass.
  Result<void> solve(std::int64_t f, std::span<const DualQuaternion> start, Pass& pass) {
    const std::span<DualQuaternion> result = pass.pose(f);
    std::ranges::copy(start, result.begin());
    follow_guess(f, result);
    project_into_limits(out_.rig, result);
    if (options_.solver == SolverChoice::ceres) {
      auto r = refine_with_ceres(out_.rig, out_.track.at(f), result, {.max_iterations = 50});
      if (!r) return r.error();
      pass.cost[f] = r->cost_after;
      return {};
    }
    const IkReport report = solver_->solve(out_.track.at(f), result);
    pass.cost[f] = report.cost;
    out_.solver.relinearisations[f] += report.relinearisations;
    out_.solver.tree_passes += report.tree_passes;
    out_.solver.sweeps += report.sweeps;
    out_.solver.residual_max = std::max(out_.solver.residual_max, report.residual);
    return {};
  }

  /// Joints that follow a namesake start from this frame's rotation whatever the start was, and so
  /// do those that no effector holds: fingers.
  void follow_guess(std::int64_t f, std::span<DualQuaternion> result) const {
    for (std::size_t i = 0; i < rows_; ++i) {
      const RigJoint& row = out_.rig.joints[i];
      const bool carried = row.type == JointType::ball && !row.limited() && row.role.empty();
      if (carried || held_[i] == 0) result[i] = guess(f)[i];
    }
  }

  const RetargetOptions& options_;
  Retargeted& out_;
  std::size_t rows_;
  std::int64_t frames_;
  std::vector<std::uint8_t> held_;  // [row] has an effector on itself or further out
  IkSolver* solver_ = nullptr;
};

void measure_errors(Retargeted& out) {
  std::vector<std::size_t> strong;
  for (std::size_t e = 0; e < out.rig.effectors.size(); ++e) {
    if (!out.rig.effectors[e].strong) continue;
    strong.push_back(e);
    out.errors.push_back(
        {.name = out.rig.effectors[e].name, .position_mm = {}, .orientation_deg = {}});
  }
  std::vector<DualQuaternion> model(out.rig.joints.size());
  for (std::int64_t f = 0; f < out.track.frames; ++f) {
    model_from_rows(out.rig, out.rig_clip.frame(f), model);
    double worst = 0.0;
    for (std::size_t s = 0; s < strong.size(); ++s) {
      const RigEffector& effector = out.rig.effectors[strong[s]];
      const DualQuaternion& target = out.track.at(f)[strong[s]].pose;
      EffectorError& error = out.errors[s];
      bool reached = true;
      if (effector.kind == EffectorKind::pose || effector.kind == EffectorKind::position) {
        const Vector3d p = model[effector.joint].transform_point(effector.offset);
        const double d = (p - target.translation()).norm();
        error.position_mm.push_back(1e3 * d);
        worst = std::max(worst, 1e3 * d);
        reached = d < kReachableM;
      }
      if (effector.kind != EffectorKind::position) {
        error.orientation_deg.push_back(
            rotation_angle(model[effector.joint].rotation(), target.rotation()) * 180.0 / M_PI);
      }
      error.reachable_frames += reached;
    }
    out.worst_error_mm.push_back(worst);
  }
}

void find_bent_joints(Retargeted& out) {
  Clip guess = out.rig_clip;
  guess.parent_from_joint = out.track.unbent;
  ClipExcess excess = limit_excess(out.rig, guess, kBentTolerance);
  for (const JointExcess& joint : excess.joints) {
    out.bent.push_back({out.rig.joints[joint.joint].name, joint});
    out.source_excess_deg = std::max(out.source_excess_deg, joint.max_deg);
  }
  std::ranges::stable_sort(out.bent, std::ranges::greater(),
                           [](const BentJoint& joint) { return joint.excess.frames; });
  out.frame_excess_deg = std::move(excess.max_deg);
}

void find_joints_at_limit(Retargeted& out) {
  LimitOccupancy occupancy = limit_occupancy(out.rig, out.rig_clip);
  for (std::size_t j = 0; j < out.rig.joints.size(); ++j) {
    if (occupancy.frames[j] == 0) continue;
    out.at_limit.push_back({out.rig.joints[j].name, occupancy.frames[j]});
  }
  std::ranges::stable_sort(out.at_limit, std::ranges::greater(), &JointAtLimit::frames);
  out.frame_joints_at_limit = std::move(occupancy.joints);
}

std::vector<std::int64_t> frames_to_refine(const Retargeted& out) {
  std::vector<std::int64_t> frames(static_cast<std::size_t>(out.track.frames));
  for (std::size_t i = 0; i < frames.size(); ++i) frames[i] = static_cast<std::int64_t>(i);
  std::stable_sort(frames.begin(), frames.end(), [&](std::int64_t a, std::int64_t b) {
    return out.worst_error_mm[a] > out.worst_error_mm[b];
  });
  frames.resize(std::min(frames.size(), kRefinedWorst));
  for (std::size_t k = 0; k < kRefinedEven; ++k) {
    frames.push_back(std::int64_t(k) * (out.track.frames - 1) / std::int64_t(kRefinedEven - 1));
  }
  std::sort(frames.begin(), frames.end());
  frames.erase(std::unique(frames.begin(), frames.end()), frames.end());
  // Ceres knows nothing of parts that push each other.
  std::erase_if(frames, [&](std::int64_t f) { return out.self_contacts.presses(f); });
  return frames;
}

Result<void> measure_gap(Retargeted& out) {
  for (const std::int64_t f : frames_to_refine(out)) {
    const auto frame = out.rig_clip.frame(f);
    std::vector<DualQuaternion> pose(frame.begin(), frame.end());
    auto report = refine_with_ceres(out.rig, out.track.at(f), pose);
    if (!report) return report.error();
    out.refine.frames.push_back(f);
    out.refine.gap_percent.push_back(report->gap_percent);
  }
  return {};
}

/// The gap is that of the solver's answer; what takes its place weighs neighbours, too.
Result<void> replace_by_optimum(const SourceMotion& source, const Target& target, Retargeted& out) {
  measure_errors(out);
  if (auto r = measure_gap(out); !r) return r;
  out.errors.clear();
  out.worst_error_mm.clear();
  auto refined = refine_clip(source, target, out.rig, out.track, out.rig_clip);
  if (!refined) return refined.error();
  out.refine.clip = std::move(*refined);
  return {};
}

double largest_depth(const SelfContactFigures& contacts) {
  return contacts.left_m.empty() ? 0.0 : *std::ranges::max_element(contacts.left_m);
}

/// The refined clip's parts are pushed apart after it was refined. Where they stay in each other,
/// the solver's own clip says whether that is the refinement's doing.
Result<void> compare_depths(const SourceMotion& source, const Target& target, Clip solved,
                            Retargeted& out) {
  const double depth = largest_depth(out.self_contacts);
  if (depth < 2.0 * kFleshGivesM) return {};
  auto without = keep_parts_apart(source, target, out.rig, out.track, solved);
  if (!without) return without.error();
  const double before = largest_depth(*without);
  if (depth < before + kFleshGivesM) return {};
  out.warnings.push_back(
      {"refine-self-contact",
       fmt::format("parts of the body are {:.1f} cm in each other, {:.1f} without --refine clip",
                   100.0 * depth, 100.0 * before)});
  return {};
}

/// The checked frames that are kept, counted from the first.
void cut(RefineFigures& refine, std::int64_t first, std::int64_t last) {
  RefineFigures kept;
  for (std::size_t k = 0; k < refine.frames.size(); ++k) {
    if (refine.frames[k] < first || refine.frames[k] > last) continue;
    kept.frames.push_back(refine.frames[k] - first);
    kept.gap_percent.push_back(refine.gap_percent[k]);
  }
  refine.frames = std::move(kept.frames);
  refine.gap_percent = std::move(kept.gap_percent);
}

/// Keeps the frames [first, last] of a solved clip.
void cut(Retargeted& out, std::int64_t first, std::int64_t last) {
  EffectorTrack& track = out.track;
  const auto keep = [&](auto& values) {
    if (values.empty()) return;
    const auto per_frame = std::int64_t(values.size()) / track.frames;
    values.erase(values.begin() + (last + 1) * per_frame, values.end());
    values.erase(values.begin(), values.begin() + first * per_frame);
  };
  keep(track.targets);
  keep(track.guess);
  keep(track.unbent);
  keep(track.left_contact);
  keep(track.right_contact);
  keep(out.rig_clip.parent_from_joint);
  keep(out.self_contacts.pressed);
  keep(out.self_contacts.before_m);
  keep(out.self_contacts.left_m);
  cut(out.refine, first, last);
  track.frames = last - first + 1;
}

/// How a lap of the solved motion differs from the next, from frame `at` on.
CycleFigures cycle_figures(const SourceCycle& cycle, const Retargeted& out, std::int64_t at) {
  CycleFigures figures{
      .period = cycle.period, .repeats_first = cycle.repeats_first, .way_m = cycle.way_m};
  figures.turn_deg = rotation_angle(cycle.lap.rotation(), Quaterniond::Identity()) * 180.0 / M_PI;
  const auto now = out.rig_clip.frame(at), later = out.rig_clip.frame(at + cycle.period);
  for (std::size_t i = 0; i < now.size(); ++i) {
    Quaterniond expected = now[i].rotation();
    if (out.rig.joints[i].parent == kNoJoint) {
      expected = cycle.lap.rotation() * expected;
      figures.seam_mm = 1e3 * std::abs(later[i].translation().y() - now[i].translation().y());
    }
    figures.seam_deg =
        std::max(figures.seam_deg, rotation_angle(expected, later[i].rotation()) * 180.0 / M_PI);
  }
  return figures;
}

/// Extracts and solves a clip, or a cycle with parts of its neighbouring laps.
Result<void> solve_clip(const SourceMotion& source, const Target& target,
                        const RetargetOptions& options, Retargeted& out) {
  auto track = extract_effectors(source, target, options.effectors);
  if (!track) return track.error();
  out.track = std::move(*track);
  out.rig = target.rig;
  release_carried(out.rig, out.track);
  out.rig.effectors = out.track.effectors;
  out.rig_clip.rate_hz = source.clip->rate_hz;
  out.rig_clip.start_s = source.clip->start_s;
  out.rig_clip.name = source.clip->name;
  if (auto r = ClipSolver(options, out).run(); !r) return r.error();
  const Clip solved = out.rig_clip;
  if (options.refine == RefineMode::clip) {
    if (auto r = replace_by_optimum(source, target, out); !r) return r.error();
  }
  if (options.collision) {
    auto contacts = keep_parts_apart(source, target, out.rig, out.track, out.rig_clip);
    if (!contacts) return contacts.error();
    out.self_contacts = std::move(*contacts);
    if (out.refine.clip) {
      if (auto r = compare_depths(source, target, solved, out); !r) return r.error();
    }
  }
  return {};
}

/// Solves the clip and, where it is a cycle, so much of the laps before and after it that its ends
/// come out as if it went on for ever.
Result<void> solve_in_laps(const SourceMotion& source, const Target& target,
                           const RetargetOptions& options, Retargeted& out) {
  const auto cycle = options.cycles ? find_cycle(source) : std::nullopt;
  std::int64_t first = 0, last = source.clip->frames() - 1;
  if (!cycle) {
    if (auto r = solve_clip(source, target, options, out); !r) return r;
  } else {
    const std::int64_t more =
        std::min<std::int64_t>(cycle->period, std::llround(kNeighbourLapS * source.clip->rate_hz));
    const Clip laps = with_laps(source.character->skeleton, *source.clip, *cycle, more);
    SourceMotion motion = source;
    motion.clip = &laps;
    if (auto r = solve_clip(motion, target, options, out); !r) return r;
    out.cycle = cycle_figures(*cycle, out, more);
    first += more;
    last += more;
  }
  if (options.range) {
    last = first + options.range->second;
    first += options.range->first;
  }
  if (last - first + 1 < out.track.frames) cut(out, first, last);
  out.rig_clip.start_s = source.clip->start_s;
  return {};
}

}  // namespace

Result<Retargeted> retarget_clip(const SourceMotion& source, const Target& target,
                                 const RetargetOptions& options) {
  Retargeted out;
  if (auto r = solve_in_laps(source, target, options, out); !r) return r.error();

  out.clip = clip_on_skeleton(target, out.rig_clip);
  measure_errors(out);
  if (options.limits) {
    find_bent_joints(out);
    find_joints_at_limit(out);
  }
  if (options.refine == RefineMode::frame) {
    if (auto r = measure_gap(out); !r) return r.error();
  }
  return out;
}

}  // namespace limber
