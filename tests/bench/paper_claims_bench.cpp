// What Kenwright 2013 claims of its method (sections IX and X), counted here and printed beside its
// words. Motions are made here from seeds; with the shared workloads at hand, those run as well.
// `--quick` runs a few frames of everything.
#include <fmt/format.h>

#include <chrono>
#include <cstring>
#include <filesystem>

#include "pipeline/bench_command.h"
#include "solver/joint_chart.h"
#include "tests/solver/seeded_motion.h"

namespace limber {
namespace {

using test::MotionOptions;

constexpr double kVisibleMm = 5.0, kVisibleDeg = 2.0;  // what the eye accepts
constexpr double kDegrees = 180.0 / M_PI;

struct Variant {
  const char* name;
  IkMethod method;
  int sweeps;
  double relaxation;
};
constexpr Variant kVariants[] = {{"paper, 1 sweep", IkMethod::pgs_paper, 1, 1.0},
                                 {"paper, relaxed 1.3", IkMethod::pgs_paper, 1, 1.3},
                                 {"paper, 2 sweeps", IkMethod::pgs_paper, 2, 1.0},
                                 {"paper, 3 sweeps", IkMethod::pgs_paper, 3, 1.0},
                                 {"pgs (default)", IkMethod::pgs, 1, 1.0}};

IkSolver make(const Rig& rig, const Variant& variant, double mm, double deg) {
  return std::move(IkSolver::create(rig, {.method = variant.method,
                                          .stop_position_m = 1e-3 * mm,
                                          .stop_orientation_rad = deg / kDegrees,
                                          .sweeps = variant.sweeps,
                                          .relaxation = variant.relaxation})
                       .value());
}

double percentile(std::vector<double> values, double p) {
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, static_cast<std::size_t>(p * values.size()))];
}

double mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

/// The largest turn of any joint, degrees.
double largest_turn_deg(const Pose& a, const Pose& b) {
  double most = 0.0;
  for (std::size_t j = 0; j < a.size(); ++j) {
    most = std::max(most, rotation_angle(a[j].rotation(), b[j].rotation()));
  }
  return most * kDegrees;
}

/// One variant over one motion: per frame its iterations and microseconds.
struct Tally {
  std::vector<double> iterations, us;
  int reached = 0;
};

/// Every frame goes to every variant in turn, so that all meet the same machine; each starts at
/// its own last solution.
std::vector<Tally> run(const Rig& rig, const std::vector<Pose>& motion, double mm, double deg) {
  std::vector<IkSolver> solvers;
  for (const Variant& variant : kVariants) solvers.push_back(make(rig, variant, mm, deg));
  std::vector<Tally> tallies(solvers.size());
  std::vector<Pose> poses(solvers.size(), motion[0]);
  for (std::size_t f = 1; f < motion.size(); ++f) {
    const auto targets = test::targets_at(rig, motion[f]);
    for (std::size_t s = 0; s < solvers.size(); ++s) {
      const auto start = std::chrono::steady_clock::now();
      const IkReport report = solvers[s].solve(targets, poses[s]);
      const std::chrono::duration<double, std::micro> time =
          std::chrono::steady_clock::now() - start;
      tallies[s].iterations.push_back(report.relinearisations);
      tallies[s].us.push_back(time.count());
      tallies[s].reached += report.reached;
    }
  }
  return tallies;
}

double reached_percent(const Tally& t) {
  return 100.0 * t.reached / static_cast<double>(t.us.size());
}

void print(const std::vector<Tally>& tallies) {
  fmt::print("  {:20} {:>6} {:>5} {:>6} {:>9} {:>10} {:>12}\n", "iterations", "median", "p99",
             "mean", "reached %", "us median", "frames / s");
  for (std::size_t s = 0; s < tallies.size(); ++s) {
    const Tally& t = tallies[s];
    const double us = percentile(t.us, 0.5);
    fmt::print("  {:20} {:6.0f} {:5.0f} {:6.2f} {:9.1f} {:10.2f} {:12.0f}\n", kVariants[s].name,
               percentile(t.iterations, 0.5), percentile(t.iterations, 0.99), mean(t.iterations),
               reached_percent(t), us, 1e6 / us);
  }
}

/// Poses that have nothing to do with each other.
std::vector<Pose> sporadic(const Rig& rig, unsigned seed, int frames) {
  test::Random random(seed);
  std::vector<Pose> poses;
  for (int f = 0; f < frames; ++f) {
    poses.push_back(test::seeded_motion(rig, static_cast<unsigned>(random.integer(0, 1 << 30)), 1,
                                        {.amplitude = 1.6}, false)[0]);
  }
  return poses;
}

/// The paper's biped: the foot is the base, head, pelvis, hands and the other foot are effectors.
Rig planted_biped() {
  Rig rig = test::shipped_rig("biped-foot-root");
  rig.name = "biped on its foot";
  rig.joints[0].type = JointType::fixed;
  std::erase_if(rig.effectors, [](const RigEffector& effector) { return effector.joint == 0; });
  return rig;
}

/// Brisk human speed: a body's curves are slower than a hand's.
MotionOptions brisk(const Rig& rig) {
  if (rig.name == "hand") return {};
  return {.slowest_hz = 0.06, .fastest_hz = 0.3};
}

void iterations(const Rig& rig, int frames) {
  fmt::print("\n== {}: iterations to {} mm and {} degrees (iteration: one relinearisation)\n",
             rig.name, kVisibleMm, kVisibleDeg);
  MotionOptions motion = brisk(rig), slow = motion;
  slow.slowest_hz *= 0.1;
  slow.fastest_hz *= 0.1;
  fmt::print("\nlittle movement ({:.3f}-{:.3f} Hz at {:.0f} frames/s). The paper: 1 to 2.\n",
             slow.slowest_hz, slow.fastest_hz, slow.frames_hz);
  print(run(rig, test::seeded_motion(rig, 1, frames, slow), kVisibleMm, kVisibleDeg));
  fmt::print("\ncoherent ({}-{} Hz). The paper: 2 or 3; well above 100 frames/s.\n",
             motion.slowest_hz, motion.fastest_hz);
  print(run(rig, test::seeded_motion(rig, 2, frames, motion), kVisibleMm, kVisibleDeg));
  fmt::print("\nsporadic (each pose unlike the last). The paper: about 10 or more.\n");
  print(run(rig, sporadic(rig, 3, frames), kVisibleMm, kVisibleDeg));
}

/// Share of the joints' coordinates that rest on a limit, in percent.
double share_at_limits(const Rig& rig, const std::vector<Pose>& motion) {
  int at = 0, all = 0;
  for (std::int32_t j = 0; j < rig.size(); ++j) {
    if (!rig.joints[j].limited()) continue;
    const JointChart chart(rig.joints[j]);
    for (const Pose& pose : motion) {
      double w[JointChart::kMost] = {};
      chart.coordinates(pose[j], w);
      for (int k = 0; k < chart.size(); ++k) {
        const bool in_ellipse = chart.has_ellipse() && k < 2;
        const double level = chart.swing().level({w[0], w[1]});
        at += in_ellipse ? level > 1.0 - 1e-6
                         : w[k] - chart.range(k).min < 1e-6 || chart.range(k).max - w[k] < 1e-6;
        ++all;
      }
    }
  }
  return 100.0 * at / all;
}

Rig widened(Rig rig, double scale) {
  for (RigJoint& joint : rig.joints) {
    for (Range& range : joint.limits) range = {scale * range.min, scale * range.max};
  }
  return rig;
}

/// The same targets twice: with the rig's limits, and with wider ones, where none is in the way.
void with_and_without_limits(const Rig& rig, const std::vector<Pose>& motion, double mm,
                             double deg) {
  const auto with = run(rig, motion, mm, deg), without = run(widened(rig, 1.5), motion, mm, deg);
  fmt::print("  {:20} {:>7} {:>6} {:>10} | {:>7} {:>6} {:>10}\n", "iterations", "median", "mean",
             "reached %", "median", "mean", "reached %");
  for (std::size_t s = 0; s < with.size(); ++s) {
    fmt::print("  {:20}", kVariants[s].name);
    for (const Tally* t : {&with[s], &without[s]}) {
      fmt::print(" {:7.0f} {:6.2f} {:10.1f}{}", percentile(t->iterations, 0.5), mean(t->iterations),
                 reached_percent(*t), t == &with[s] ? " |" : "\n");
    }
  }
}

void joints_at_limits(const Rig& rig, int frames) {
  fmt::print(
      "\n== {}: joints at their limits. The paper: \"it would take longer to converge\".\n"
      "   The same targets with the limits as they are | half as wide again.\n",
      rig.name);
  MotionOptions pressed = brisk(rig);
  pressed.amplitude = 0.6;
  pressed.press = 0.8;
  const auto riding = test::seeded_motion(rig, 5, frames, pressed);
  for (const auto& [mm, deg] : {std::pair{kVisibleMm, kVisibleDeg}, std::pair{1.0, 0.5}}) {
    fmt::print("\nriding on limits, {:.0f} % of the coordinates; to {} mm and {} degrees\n",
               share_at_limits(rig, riding), mm, deg);
    with_and_without_limits(rig, riding, mm, deg);
  }
  fmt::print("\ntargets that ask for up to a tenth more than the limits; to {} mm and {} degrees\n",
             kVisibleMm, kVisibleDeg);
  with_and_without_limits(rig, test::seeded_motion(widened(rig, 1.1), 5, frames, pressed),
                          kVisibleMm, kVisibleDeg);
}

/// All targets moved out of reach and held, then carried along with a motion.
void best_reach(const Rig& rig, int frames) {
  const auto beyond = [&](const Pose& pose) {
    const Pose world = test::world_of(rig, pose);
    const Eigen::Vector3d root = world[0].translation();
    auto targets = test::targets_at(rig, pose);
    for (EffectorTarget& target : targets) {
      const Eigen::Vector3d out = target.pose.translation() - root;
      if (out.norm() < 0.05) continue;
      target.pose = DualQuaternion::from_translation(0.1 * out.normalized()) * target.pose;
    }
    return targets;
  };
  const auto motion = test::seeded_motion(rig, 7, frames, brisk(rig));
  fmt::print(
      "\n== {}: targets 10 cm out of reach. The paper: a best reach, \"not oscillating or "
      "jittering\".\n   Largest turn of a joint per frame, degrees; cost against pgs.\n",
      rig.name);
  fmt::print("  {:20} {:>10} {:>10} {:>10} {:>12} {:>12} {:>10}\n", "", "held: 1st", "10th",
             "last tenth", "cost / pgs", "moving: max", "of motion");
  const auto held = beyond(motion[0]);
  Pose reference = motion[0];
  IkSolver pgs = make(rig, kVariants[4], 1e-6, 1e-6);
  double reference_cost = 0.0;
  for (int f = 0; f < frames; ++f) reference_cost = pgs.solve(held, reference).cost;
  for (const Variant& variant : kVariants) {
    IkSolver solver = make(rig, variant, kVisibleMm, kVisibleDeg);
    Pose pose = motion[0];
    double first = 0.0, tenth = 0.0, last = 0.0, cost = 0.0;
    for (int f = 0; f < frames; ++f) {
      const Pose before = pose;
      cost = solver.solve(held, pose).cost;
      const double turn = largest_turn_deg(before, pose);
      if (f == 0) first = turn;
      if (f == 9) tenth = turn;
      if (f >= frames * 9 / 10) last = std::max(last, turn);
    }
    double moving = 0.0, of_motion = 0.0;
    for (int f = 1; f < frames; ++f) {
      const Pose before = pose;
      solver.solve(beyond(motion[f]), pose);
      moving = std::max(moving, largest_turn_deg(before, pose));
      of_motion = std::max(of_motion, largest_turn_deg(motion[f - 1], motion[f]));
    }
    fmt::print("  {:20} {:10.2g} {:10.2g} {:10.2g} {:12.6f} {:12.2f} {:10.2f}\n", variant.name,
               first, tenth, last, cost / reference_cost, moving, of_motion);
  }
}

void shared_workloads() {
  const std::filesystem::path folder =
      std::filesystem::path(LIMBER_SOURCE_DIR) / "../shared/workloads";
  for (const char* file : {"hand22_coherent", "hand22_sporadic", "biped53_coherent"}) {
    const auto path = folder / (std::string(file) + ".json.gz");
    if (!std::filesystem::exists(path)) continue;
    fmt::print("\n");
    for (const char* start : {"previous", "extrapolate"}) {
      fmt::print("start: {}; ", start);
      BenchArgs args;
      args.workload = path;
      args.solver = "pgs-paper";
      args.start = start;
      args.stop_mm = kVisibleMm;
      args.stop_deg = kVisibleDeg;
      bench_command(args);
    }
  }
}

}  // namespace
}  // namespace limber

int main(int count, char** arguments) {
  const bool quick = count > 1 && std::strcmp(arguments[1], "--quick") == 0;
  const int frames = quick ? 20 : 2000;
  for (const limber::Rig& rig : {limber::test::shipped_rig("hand"), limber::planted_biped(),
                                 limber::test::shipped_rig("biped-foot-root")}) {
    limber::iterations(rig, frames);
    limber::joints_at_limits(rig, frames);
    limber::best_reach(rig, quick ? 20 : 300);
  }
  if (!quick) limber::shared_workloads();
}
