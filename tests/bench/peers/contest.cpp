#include "tests/bench/peers/contest.h"

#include <malloc.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "validation/contact_detection.h"
#include "validation/limit_check.h"

namespace limber::peers {

namespace {

constexpr std::size_t kPilotFrames = 20;
constexpr std::size_t kFewestFrames = 50;
constexpr double kAllowedExcessDeg = 0.5;  // of a solved frame, as the workloads' judge has it

struct Entry {
  Contestant* contestant = nullptr;
  Score score;
  Answer answer;                            // of the last round
  std::vector<std::vector<double>> rounds;  // [round][frame] us
};

std::size_t heap_in_use() {
  const struct mallinfo2 info = mallinfo2();
  return info.uordblks + info.hblkhd;
}

/// Prepares a contestant and lets it try a few frames, to see what it costs.
Entry admit(const Workload& work, Contestant& contestant, const ContestOptions& options) {
  Entry entry;
  entry.contestant = &contestant;
  entry.score.name = contestant.name();
  entry.score.setting = contestant.setting();
  entry.score.ours = contestant.ours();
  entry.score.start = contestant.start();
  const std::size_t before = heap_in_use();
  if (Result<void> ready = contestant.prepare(work); !ready) {
    entry.score.absent = ready.error().message;
    return entry;
  }
  contestant.solve_all(1);
  const std::size_t after = heap_in_use();
  entry.score.heap_bytes = after > before ? after - before : 0;

  const std::size_t pilot = std::min(kPilotFrames, work.frames());
  const std::vector<double> us = contestant.solve_all(pilot).us;
  const double s = 1e-6 * std::accumulate(us.begin(), us.end(), 0.0) / static_cast<double>(pilot);
  const double affordable = options.budget_s / std::max(s, 1e-9);
  const auto all = static_cast<double>(work.frames());
  entry.score.rounds = std::clamp(static_cast<int>(affordable / all), 1, options.rounds);
  entry.score.frames = static_cast<std::size_t>(std::min(affordable, all));
  entry.score.frames = std::max(entry.score.frames, std::min(kFewestFrames, work.frames()));
  return entry;
}

double largest_second_difference(const std::vector<std::vector<Eigen::Vector3d>>& path) {
  double largest = 0.0;
  for (std::size_t f = 2; f < path.size(); ++f) {
    for (std::size_t i = 0; i < path[f].size(); ++i) {
      const Eigen::Vector3d d = path[f][i] - 2.0 * path[f - 1][i] + path[f - 2][i];
      largest = std::max(largest, d.norm());
    }
  }
  return largest;
}

/// [frame][joint] in world space.
std::vector<std::vector<Eigen::Vector3d>> joint_paths(const Rig& rig, const Clip& clip) {
  const Skeleton skeleton = skeleton_of(rig);
  Pose world(rig.joints.size());
  std::vector<std::vector<Eigen::Vector3d>> path;
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    model_from_local(skeleton, clip.frame(f), world);
    std::vector<Eigen::Vector3d>& row = path.emplace_back();
    for (const DualQuaternion& joint : world) row.push_back(joint.translation());
  }
  return path;
}

/// The workloads' jerk ratio: largest second difference of any joint's position, over the truth's.
double jerk_ratio(const Workload& work, const Clip& clip) {
  if (work.rest_start) return 0.0;
  Clip truth = clip;
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    pose_from_coordinates(work.rig, work.truth_q[static_cast<std::size_t>(f)], truth.frame(f));
  }
  const double true_motion = largest_second_difference(joint_paths(work.rig, truth));
  const double motion = largest_second_difference(joint_paths(work.rig, clip));
  return true_motion > 0.0 ? motion / true_motion : 0.0;
}

bool within_limits(const Rig& rig, std::span<const DualQuaternion> pose) {
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const double excess = limit_excess(rig.joints[i], pose[i].rotation());
    if (!(excess * 180.0 / M_PI < kAllowedExcessDeg)) return false;
  }
  return true;
}

void judge_poses(const Workload& work, const Clip& clip, Score& score) {
  const Skeleton skeleton = skeleton_of(work.rig);
  Pose world(work.rig.joints.size());
  std::vector<double> mm, deg;
  std::size_t solved = 0;
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    model_from_local(skeleton, clip.frame(f), world);
    const EffectorMiss miss =
        worst_miss(work.rig, work.targets[static_cast<std::size_t>(f)], world);
    mm.push_back(miss.position_mm);
    deg.push_back(miss.orientation_deg);
    solved += miss.position_mm < 1e3 * work.success_pos &&
              miss.orientation_deg < work.success_rot * 180.0 / M_PI &&
              within_limits(work.rig, clip.frame(f));
  }
  const LimitReport limits = check_joint_limits(work.rig, clip);
  score.violations = limits.violations;
  score.max_violation_deg = limits.max_violation_deg;
  score.position_mm_median = percentile(mm, 50.0);
  score.position_mm_p99 = percentile(mm, 99.0);
  score.orientation_deg_median = percentile(deg, 50.0);
  score.orientation_deg_p99 = percentile(deg, 99.0);
  score.success = static_cast<double>(solved) / static_cast<double>(clip.frames());
  score.jerk_ratio = jerk_ratio(work, clip);
}

void judge(const Workload& work, Entry& entry) {
  Score& score = entry.score;
  std::vector<double>& us = score.us;
  us.resize(score.frames);
  std::vector<double> over_rounds;
  for (std::size_t f = 0; f < score.frames; ++f) {
    over_rounds.clear();
    for (const std::vector<double>& round : entry.rounds) over_rounds.push_back(round[f]);
    us[f] = percentile(over_rounds, 50.0);
  }
  const auto mean = [](const auto& values) {
    return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  };
  score.us_median = percentile(us, 50.0);
  score.us_mean = mean(us);
  score.us_p99 = percentile(us, 99.0);
  score.iterations_mean = mean(entry.answer.iterations);
  judge_poses(work, entry.answer.clip, score);
}

}  // namespace

std::vector<Score> hold_contest(const Workload& work,
                                std::vector<std::unique_ptr<Contestant>>& contestants,
                                const ContestOptions& options) {
  std::vector<Entry> entries;
  for (const auto& contestant : contestants) entries.push_back(admit(work, *contestant, options));
  for (int round = 0; round < options.rounds; ++round) {
    for (Entry& entry : entries) {
      if (round >= entry.score.rounds) continue;
      entry.answer = entry.contestant->solve_all(entry.score.frames);
      entry.rounds.push_back(entry.answer.us);
    }
  }
  std::vector<Score> scores;
  for (Entry& entry : entries) {
    if (entry.score.absent.empty()) judge(work, entry);
    scores.push_back(std::move(entry.score));
  }
  return scores;
}

}  // namespace limber::peers
