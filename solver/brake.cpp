// Out of reach, a best reach may cease to be one, and the descent ends in another, far away. What
// is shown goes there in its time: it has inertia. With a the anchor, to which the last answer
// drifts by its own speed, and M = m diag(lever^2), lever the distance to the farthest effector,
//   x = argmin f(x) + (x - a)' M (x - a),  x in C.
// That is an implicit step of a body of mass m in the field f: the acceleration is what f pulls
// with over m. While m is small x is the best reach itself; as m grows, x tends to the start. So m
// is the least that keeps every joint's second difference within kMostBend and what the targets'
// own is and was of late: it grows within a frame until that holds and fades afterwards. kDrag
// takes speed from the drift so that a body does not swing about where it is pulled to. Limits stop
// a body at once whatever its mass, so the drift ends in front of them: with the speed v and r left
// to go it slows down by
//   a = v^2 / (2 r + v)
// per frame, of which v - a, v - 2 a, .. add up to r. In front of an ellipse r lies along the ray
// from its middle; along the border the drift is free. m also grows where a, times the lever, would
// be kHardest times what the bend may be: what comes too fast cannot be stopped softly any more.
//
// M takes the damping's place in the linear problem: a frame costs one elimination or two, and no
// other descent beside them.
//
// Targets that jump are followed as they do. What is lost for one frame alone, or for a few frames
// by little, is wound rather than out of reach: it is left to whoever mends it (ik_clip.cpp) and
// may hurry.
#include "solver/brake.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace limber {

namespace {

constexpr double kMostBend = 1.2e-3;      // m per frame^2
constexpr double kJumpingTargets = 0.25;  // m per frame^2: a cut
constexpr double kHurry = 3.0;            // times kMostBend, for what is wound
constexpr int kLongLost = 16;             // frames; a wound clip is mended before
constexpr double kHardest = 3.0;          // times kMostBend, in front of a limit
constexpr double kCalming = 0.8;          // per frame, of what targets' own bends allow
constexpr double kDrag = 0.2;             // of the speed, per frame
constexpr double kLeastMass = 1e-3;       // an effector of weight 1 has the mass 1
constexpr double kMostMass = 10.0;
constexpr double kGrow = 2.0, kGrowFast = 4.0, kFade = 0.7;
constexpr double kLight = 0.5;    // of what the bend may be: the mass fades
constexpr int kSteps = 10;        // relinearisations for one mass, at most
constexpr double kLevel = 1e-3;   // a relative fall below this ends them
constexpr double kUnfelt = 1e-6;  // inertia of what no effector feels

bool turns_freely(const IkNode& node) {
  return !node.chart && (node.type == JointType::ball || node.type == JointType::free);
}

/// The first of the three coordinates that such a node turns by.
std::int32_t turn_of(const IkNode& node) {
  return node.coordinate + (node.type == JointType::free ? 3 : 0);
}

/// By how much a speed must fall per frame to end with `left` to go.
double braking(double speed, double left) {
  return speed > 0.0 ? speed * speed / (2.0 * std::max(left, 0.0) + speed) : 0.0;
}

/// The speed of a drift with `left` to go.
double drift_speed(double speed, double left) {
  return speed - std::max(kDrag * speed, braking(speed, left));
}

}  // namespace

Brake::Brake(IkDescent& descent)
    : descent_(descent),
      inertia_(Eigen::VectorXd::Constant(descent.step.size(), kUnfelt)),
      own_damping_(inertia_),
      start_(descent.now),
      coasted_(descent.now),
      aim_(descent.now.rotation),
      goal_last_(descent.goals.size(), Eigen::Vector3d::Zero()),
      goal_before_(goal_last_) {
  const IkTree& tree = descent.tree;
  for (std::size_t e = 0; e < tree.effectors.size(); ++e) {
    for (std::int32_t n = tree.effectors[e].node; n >= 0; n = tree.nodes[n].parent) {
      const IkNode& node = tree.nodes[n];
      const double lever2 =
          (descent.at_now.error[e].point - descent.at_now.position[n]).squaredNorm();
      for (std::int32_t i = 0; i < node.coordinates; ++i) {
        const bool metres = node.type == JointType::free && i < 3;
        double& inertia = inertia_[node.coordinate + i];
        inertia = std::max(inertia, metres ? 1.0 : lever2);
      }
    }
  }
  for (auto* places : {&place_, &place_last_, &place_before_}) {
    places->resize(tree.nodes.size() + tree.effectors.size());
  }
}

void Brake::forget(bool searching) {
  on_ = false;
  searching_ = searching;
  goals_ = 0;
}

void Brake::remember(std::span<const IkGoal> goals) {
  lively_ = missed_ > 0 ? kCalming * std::max(lively_, std::min(pace(), kJumpingTargets)) : 0.0;
  std::swap(goal_last_, goal_before_);
  for (std::size_t e = 0; e < goals.size(); ++e) goal_last_[e] = goals[e].position;
  goals_ = std::min(goals_ + 1, 2);
  searching_ = false;
}

double Brake::pace() const {
  double most = 0.0;
  for (std::size_t e = 0; e < goal_last_.size() && goals_ > 1; ++e) {
    const IkGoal& goal = descent_.goals[e];
    if (goal.mass <= 0.0) continue;
    most = std::max(most, (goal.position - 2.0 * goal_last_[e] + goal_before_[e]).norm());
  }
  return most;
}

/// What a joint's second difference may be (m).
double Brake::most_bend() const { return kMostBend + std::max(pace(), lively_); }

/// In a corner of the limits, as far as one can tell, rather than out of reach.
bool Brake::wound() const { return descent_.at_now.cost < kWoundCost && missed_ < kLongLost; }

bool Brake::on() const { return on_ && pace() < kJumpingTargets; }

/// Where a state has its joints and effectors.
void Brake::find_places(const IkState& state, std::vector<Eigen::Vector3d>& places) {
  descent_.tree.evaluate(state, descent_.goals, descent_.at_next);
  take_places(descent_.at_next, places);
}

void Brake::take_places(const IkKinematics& k, std::vector<Eigen::Vector3d>& places) {
  std::ranges::copy(k.position, places.begin());
  std::ranges::transform(k.error, places.begin() + static_cast<std::ptrdiff_t>(k.position.size()),
                         &IkError::point);
}

/// The largest second difference at `at_now` (m).
double Brake::bend() {
  take_places(descent_.at_now, place_);
  double most = 0.0;
  for (std::size_t i = 0; i < place_.size(); ++i) {
    most = std::max(most, (place_[i] - 2.0 * place_last_[i] + place_before_[i]).squaredNorm());
  }
  return std::sqrt(most);
}

bool Brake::too_fast(const IkState& before, const IkState& last) {
  if (descent_.reached(descent_.at_now)) {
    missed_ = 0;
    return false;
  }
  on_ = false;
  if (searching_ || ++missed_ == 1 || pace() >= kJumpingTargets) return false;
  find_places(before, place_before_);
  find_places(last, place_last_);
  return bend() > (wound() ? kHurry : 1.0) * most_bend();
}

/// Where the last answer drifts: the anchor, and aim_ for rotations without limits.
void Brake::aim(const IkState& before, const IkState& last) {
  const IkTree& tree = descent_.tree;
  for (Eigen::Index k = 0; k < inertia_.size(); ++k) {
    const double x = last.x[k], speed = x - before.x[k];
    descent_.anchor[k] = x + (speed > 0.0 ? drift_speed(speed, tree.max[k] - x)
                                          : -drift_speed(-speed, x - tree.min[k]));
  }
  for (const EllipseLimit& e : descent_.ellipses) slow_swing(e, before, last);
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
    if (!turns_freely(tree.nodes[n])) continue;
    const Eigen::Quaterniond turn = last.rotation[n] * before.rotation[n].conjugate();
    aim_[n] =
        (Eigen::Quaterniond::Identity().slerp(1.0 - kDrag, turn) * last.rotation[n]).normalized();
  }
}

/// The same in front of an ellipse, in parts of the ray from its middle.
void Brake::slow_swing(const EllipseLimit& e, const IkState& before, const IkState& last) {
  const auto part = [&e](const Eigen::Vector2d& swing) { return std::sqrt(e.swing.level(swing)); };
  auto drift = descent_.anchor.segment<2>(e.coordinate);
  const Eigen::Vector2d from = last.x.segment<2>(e.coordinate);
  const double here = part(from), there = part(drift);
  const double speed = part(2.0 * from - before.x.segment<2>(e.coordinate)) - here;
  if (!std::isfinite(speed) || !(there > here)) return;
  const double most = here + drift_speed(speed, 1.0 - here);
  if (there > most) drift *= most / there;
}

/// The hardest braking in front of limits that `now` leads to (m per frame^2).
double Brake::hardest_braking(const IkState& last) const {
  const IkTree& tree = descent_.tree;
  const Eigen::VectorXd& x = descent_.now.x;
  double most = 0.0;
  for (Eigen::Index k = 0; k < inertia_.size(); ++k) {
    const double speed = x[k] - last.x[k], lever = std::sqrt(inertia_[k]);
    const double left = speed > 0.0 ? tree.max[k] - x[k] : x[k] - tree.min[k];
    most = std::max(most, lever * braking(std::abs(speed), left));
  }
  for (const EllipseLimit& e : descent_.ellipses) {
    const Eigen::Vector2d swing = x.segment<2>(e.coordinate);
    const double here = std::sqrt(e.swing.level(swing));
    const double speed = here - std::sqrt(e.swing.level(last.x.segment<2>(e.coordinate)));
    if (!std::isfinite(speed) || speed <= 0.0) continue;
    const double ray = swing.norm() / here, lever = std::sqrt(inertia_[e.coordinate]);
    most = std::max(most, lever * ray * braking(speed, 1.0 - here));
  }
  return most;
}

/// wish: from there to the anchor.
void Brake::measure_way(const IkState& from) {
  descent_.wish = descent_.anchor - from.x;
  for (std::size_t n = 0; n < descent_.tree.nodes.size(); ++n) {
    const IkNode& node = descent_.tree.nodes[n];
    if (!turns_freely(node)) continue;
    const Eigen::AngleAxisd turn(aim_[n] * from.rotation[n].conjugate());
    descent_.wish.segment<3>(turn_of(node)) = turn.angle() * turn.axis();
  }
}

/// Steps with the present mass from `now`. False: not even the first one led down.
bool Brake::coast(IkReport& report) {
  IkDescent& d = descent_;
  for (int i = 0; i < kSteps; ++i) {
    ++report.relinearisations;
    d.linearise();
    d.elimination.linearise(d.now.x, d.at_now, d.load);
    measure_way(d.now);
    const double here = d.at_now.cost + mass_ * d.wish.cwiseAbs2().dot(inertia_);
    report.tree_passes += d.elimination.solve(d.now.x, mass_, d.wish, d.step).passes;
    d.tree.move(d.now, d.step, d.next);
    d.tree.evaluate(d.next, d.goals, d.at_next);
    measure_way(d.next);
    const double there = d.at_next.cost + mass_ * d.wish.cwiseAbs2().dot(inertia_);
    if (!(there < here)) return i > 0;
    std::swap(d.now, d.next);
    std::swap(d.at_now, d.at_next);
    if (there > (1.0 - kLevel) * here) break;
  }
  return true;
}

/// Finds the mass that the frame needs, and its answer.
void Brake::try_mass(const IkState& last, IkReport& report, double most) {
  IkDescent& d = descent_;
  for (bool first = true;; first = false) {
    d.now = start_;
    d.tree.evaluate(d.now, d.goals, d.at_now);
    d.elimination.reset(d.now.x);
    const double bent =
        coast(report) ? std::max(bend(), hardest_braking(last) / kHardest) : kGrow * most;
    if (bent <= most) {
      if (first && bent < kLight * most) mass_ *= kFade;
      return;
    }
    if (mass_ >= kMostMass) return;
    mass_ *= bent > 3.0 * most ? kGrowFast : kGrow;
  }
}

/// Descends on without inertia; true: that leads no further than it may.
bool Brake::let_go(IkReport& report, double most) {
  IkDescent& d = descent_;
  coasted_ = d.now;
  d.descend(report, true);
  if (d.reached(d.at_now)) missed_ = 0;
  if (missed_ == 0 || bend() < kHurry * most) return true;
  d.now = coasted_;
  d.tree.evaluate(d.now, d.goals, d.at_now);
  d.elimination.reset(d.now.x);
  return false;
}

void Brake::slow_down(const IkState& before, const IkState& last, IkReport& report) {
  IkDescent& d = descent_;
  if (!on_) mass_ = kLeastMass;
  start_ = d.now;
  find_places(before, place_before_);
  find_places(last, place_last_);
  const double most = most_bend();
  aim(before, last);
  own_damping_ = d.tree.damping;
  d.tree.damping = inertia_;
  try_mass(last, report, most);
  d.tree.damping = own_damping_;
  d.elimination.reset(d.now.x);
  on_ = mass_ >= kLeastMass;
  if (wound() && let_go(report, most)) on_ = false;
}

}  // namespace limber
