// Windows of frames are solved one after the other, each with the frames around it as they are, and
// each beginning with the last frames of the one before. Every window's cost holds all terms of the
// clip's that its frames touch, so that of the clip falls with each: block coordinate descent. What
// the seam to frames not yet solved does to the last frames of a window is undone by the overlap.
#include "validation/clip_refiner.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "validation/clip_window.h"
#include "validation/limit_check.h"

namespace limber {
namespace {

constexpr double kInsideLimits = 1e-7;  // rad: what the certificate checks, and then some

Result<void> check_input(const Rig& rig, const ClipGoals& goals, const Clip& clip) {
  const auto frames = static_cast<std::size_t>(clip.frames());
  const auto bad = [](std::string message) {
    return Error{.code = "refine-input",
                 .message = std::move(message),
                 .hint = "give one target per rig effector and one transform per rig joint"};
  };
  if (clip.joints != rig.size()) return bad("clip and rig differ");
  if (goals.targets.size() != frames * rig.effectors.size()) {
    return bad("targets and effectors differ");
  }
  if (goals.reference.size() != frames * rig.joints.size()) return bad("reference and rig differ");
  for (const StandingPoint& point : goals.standing) {
    for (const FrameInterval& c : point.contacts) {
      if (c.begin < 0 || c.end <= c.begin || c.end > clip.frames()) {
        return bad("a contact lies outside the clip");
      }
    }
  }
  if (const char* lacking = EffectorProblem::lacks(rig)) {
    return Error{.code = "refine-rows",
                 .message = std::string("the refiner's objective has no ") + lacking,
                 .hint = "this rig can be solved but not measured against Ceres"};
  }
  return {};
}

}  // namespace

Result<ClipRefineReport> refine_clip_with_ceres(const Rig& rig, const ClipGoals& goals, Clip& clip,
                                                const ClipRefineOptions& options) {
  if (auto r = check_input(rig, goals, clip); !r) return r.error();
  ClipRefineReport report;
  const ClipProblem problem(rig, goals, options.weights, clip);
  report.before = report.after = problem.cost(clip);
  if (!std::isfinite(report.before.total())) {
    return Error{.code = "refine-input", .message = "a pose or a target is not finite"};
  }
  Clip refined = clip;
  const std::int64_t step = std::max<std::int64_t>(options.window - options.overlap, 1);
  for (std::int64_t begin = 0; begin < clip.frames(); begin += step) {
    const std::int64_t end = std::min(begin + options.window, clip.frames());
    ClipWindow window(problem, refined, begin, end);
    int round = 0;
    while (round < options.rounds && window.minimise(options.iterations, options.enough)) ++round;
    window.write(refined);
    report.iterations += window.iterations();
    ++report.windows;
    if (end == clip.frames()) break;
  }
  const ClipCost cost = problem.cost(refined);
  const bool within = check_joint_limits(rig, refined, kInsideLimits).violations == 0;
  report.improved = within && cost.total() < report.before.total();
  if (!report.improved) return report;
  report.after = cost;
  clip = std::move(refined);
  return report;
}

}  // namespace limber
