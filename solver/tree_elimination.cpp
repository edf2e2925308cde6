// Elimination along the tree.
//
// Effectors are masses, so J'WJ is the joint-space mass matrix of the tree and damping its
// armature: the damped step is an articulated-body computation (Featherstone 2008, chapter 7),
// one coordinate at a time, all in world axes about one origin so that nothing is transformed.
//
// A node with everything outside it answers a twist v of its inner side with the wrench I v + p
// (p = minus the pulls). Let coordinate k with twist S and armature m be its innermost one. With
//   U = I S,  D = S'U + m,  u = -S'p,
// stationarity in its step d, S'(I (v + S d) + p) + m d = 0, gives d = (u - U'v) / D and
//   I <- I - U U' / D,  p <- p + U u / D      felt by what is inside of k.
// A coordinate held at d = h only adds its push: p <- p + U h; the objective's gradient along it is
// U'v + D h - u, its multiplier. Tips to roots eliminates, roots to tips substitutes. Both are
// exact for the given active set.
//
// The active set: lock what left its range, eliminate again (only nodes whose limits changed, and
// those inside of them), release what the objective pulls inwards; semi-smooth Newton. Locking
// alone ends, so after kReleasePasses nothing is released any more and the loop is finite; the
// caller's next linearisation releases the rest.
//
// Newton (load.curved, see jacobian.cpp) adds to the objective -1/2 d k.v per coordinate, k the
// turn of the outer pull by S. It couples d with v alone: U = I S - k / 2 everywhere above. Pivots
// may then lose their sign; `definite` tells, and the caller goes back to Gauss-Newton.
//
// Rows (row_solver.cpp) push with J'lambda. The elimination is H = L D L' with the coordinates as
// columns of L: its tip-to-root pass applied to a row's J alone is the forward substitution
// L^-1 J', which touches only the paths from the row's nodes to the roots, and its root-to-tip pass
// the backward one.
//
// A swing on its ellipse turns its two coordinates into tangent and normal: the normal one is held
// so that the swing ends on the tangent line, the tangent one is free. The border curves away from
// that line by kappa (tau - tau_p)^2 / 2, tau_p where it touches, against which the objective
// presses with its multiplier lambda, so lambda kappa joins the tangent's armature and pulls
// towards tau_p: the Hessian of the Lagrangian, not of the line.
#include "solver/tree_elimination.h"

#include <algorithm>
#include <cmath>

namespace limber {

namespace {

constexpr int kMaxPasses = 24;
constexpr int kReleasePasses = 8;
constexpr int kTangentPasses = 6;
constexpr double kTouch = 1e-10;  // rad, m: nearer to a limit counts as on it
constexpr double kSlide = 1e-9;   // rad: shorter ways along a tangent count as none
constexpr double kWall = 1e-9;    // rad: a side of the ellipse that has no width

}  // namespace

TreeElimination::TreeElimination(const IkTree& tree)
    : tree_(tree),
      felt_(tree.nodes.size()),
      lock_(tree.coordinate_count(), Lock::none),
      swing_(tree.nodes.size()),
      pivot_(tree.coordinate_count()),
      outside_(tree.nodes.size()),
      twist_(tree.nodes.size()),
      multiplier_(tree.coordinate_count(), 0.0),
      dirty_(tree.nodes.size(), 1) {}

void TreeElimination::reset(const Eigen::VectorXd& x) {
  for (std::int32_t k = 0; k < tree_.coordinate_count(); ++k) {
    lock_[k] = x[k] >= tree_.max[k] - kTouch   ? Lock::max
               : x[k] <= tree_.min[k] + kTouch ? Lock::min
                                               : Lock::none;
  }
  for (std::size_t n = 0; n < tree_.nodes.size(); ++n) {
    swing_[n] = SwingLock{};
    const IkNode& node = tree_.nodes[n];
    if (!node.ellipse) continue;
    const Eigen::Vector2d at(x[node.coordinate], x[node.coordinate + 1]);
    if (node.swing.level(at) >= 1.0 - 1e-9) hold_swing(swing_[n], node.swing, at);
  }
}

void TreeElimination::linearise(const Eigen::VectorXd& x, const IkKinematics& kinematics,
                                const EffectorLoad& load) {
  kinematics_ = &kinematics;
  load_ = &load;
  for (std::size_t n = 0; n < tree_.nodes.size(); ++n) {
    SwingLock& lock = swing_[n];
    if (!lock.active || lock.corner) continue;
    const IkNode& node = tree_.nodes[n];
    const Eigen::Vector2d at = x.segment<2>(node.coordinate);
    const double level = node.swing.level(at);
    hold_swing(lock, node.swing, level < 1.0 && level > 0.25 ? at / std::sqrt(level) : at);
    lock.slide = 0.0;
    lock.reach = 1.0;
  }
}

void TreeElimination::hold_swing(SwingLock& lock, const SwingEllipse& ellipse,
                                 const Eigen::Vector2d& wish) {
  lock.active = true;
  lock.point = ellipse.project(wish);
  lock.normal = wish - lock.point;
  const double a = wish.x() < 0.0 ? -ellipse.min0 : ellipse.max0;
  const double b = wish.y() < 0.0 ? -ellipse.min1 : ellipse.max1;
  // A side without width is a wall, and where it meets the border there is a corner.
  lock.corner = (a < kWall && std::abs(wish.y()) > b) || (b < kWall && std::abs(wish.x()) > a);
  const double out = lock.normal.norm();
  if (out > 1e-9) {
    lock.normal /= out;
  } else if (a < kWall || b < kWall) {
    lock.normal = a < kWall ? Eigen::Vector2d(wish.x() < 0.0 ? -1.0 : 1.0, 0.0)
                            : Eigen::Vector2d(0.0, wish.y() < 0.0 ? -1.0 : 1.0);
  } else {
    lock.normal = {lock.point.x() / (a * a), lock.point.y() / (b * b)};
    lock.normal.normalize();
  }
  lock.curvature = a < kWall || b < kWall ? 0.0 : std::min(ellipse.curvature(lock.point), 1e6);
}

void TreeElimination::prepare_pivots(std::int32_t n, const Eigen::VectorXd& x, double damping) {
  const IkNode& node = tree_.nodes[n];
  for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
    Pivot& pivot = pivot_[k];
    pivot.axis = kinematics_->axis[k];
    pivot.locked = lock_[k] != Lock::none;
    pivot.diagonal = damping * tree_.damping[k];
    pivot.pull = pivot.diagonal * wish_[k];
    pivot.held = !pivot.locked           ? 0.0
                 : lock_[k] == Lock::max ? tree_.max[k] - x[k]
                                         : tree_.min[k] - x[k];
  }
  const SwingLock& swing = swing_[n];
  if (!swing.active) return;
  const Eigen::Vector2d ahead = swing.point - x.segment<2>(node.coordinate);
  // Coordinate 0 becomes the tangent (-ny, nx), coordinate 1 the normal.
  Pivot& tangent = pivot_[node.coordinate];
  Pivot& normal = pivot_[node.coordinate + 1];
  if (swing.corner) {
    tangent.locked = normal.locked = true;
    tangent.held = ahead.x();
    normal.held = ahead.y();
    return;
  }
  const Vector6 axis0 = tangent.axis, axis1 = normal.axis;
  tangent.axis = swing.normal.x() * axis1 - swing.normal.y() * axis0;
  normal.axis = swing.normal.x() * axis0 + swing.normal.y() * axis1;
  const double stiffness = swing.press * swing.curvature;
  tangent.diagonal += stiffness;
  const double wish0 = tangent.pull, wish1 = normal.pull;
  tangent.pull = swing.normal.x() * wish1 - swing.normal.y() * wish0;
  normal.pull = swing.normal.x() * wish0 + swing.normal.y() * wish1;
  tangent.pull += stiffness * (swing.normal.x() * ahead.y() - swing.normal.y() * ahead.x());
  normal.locked = true;
  normal.held = swing.normal.dot(ahead);
}

void TreeElimination::eliminate(std::int32_t n, const Eigen::VectorXd& x, double damping) {
  prepare_pivots(n, x, damping);
  const IkNode& node = tree_.nodes[n];
  Outside& out = outside_[n];
  out.inertia = load_->inertia[n];
  out.bias = -load_->pull[n];
  for (std::int32_t c = tree_.children_begin[n]; c < tree_.children_begin[n + 1]; ++c) {
    out.inertia += outside_[tree_.children[c]].inertia;
    out.bias += outside_[tree_.children[c]].bias;
  }
  for (std::int32_t k = node.coordinate + node.coordinates - 1; k >= node.coordinate; --k) {
    Pivot& pivot = pivot_[k];
    pivot.momentum = out.inertia * pivot.axis;
    pivot.diagonal += pivot.axis.dot(pivot.momentum);
    if (load_->curved) pivot.momentum -= 0.5 * turn_of_pull(pivot.axis, load_->outer_pull[n]);
    pivot.drive = pivot.pull - pivot.axis.dot(out.bias);
    if (pivot.locked) {
      if (pivot.held != 0.0) out.bias += pivot.held * pivot.momentum;
      continue;
    }
    definite_ = definite_ && pivot.diagonal > 0.0;
    pivot.inverse = pivot.diagonal > 0.0 ? 1.0 / pivot.diagonal : 0.0;
    out.inertia.add_outer(pivot.momentum, -pivot.inverse);
    out.bias += (pivot.drive * pivot.inverse) * pivot.momentum;
  }
}

void TreeElimination::substitute(Eigen::VectorXd& step) {
  for (std::size_t n = 0; n < tree_.nodes.size(); ++n) {
    const IkNode& node = tree_.nodes[n];
    Vector6& twist = twist_[n];
    if (node.parent < 0) {
      twist.setZero();
    } else {
      twist = twist_[node.parent];
    }
    for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
      const Pivot& pivot = pivot_[k];
      const double feel = pivot.momentum.dot(twist);
      if (pivot.locked) {
        step[k] = pivot.held;
        multiplier_[k] = feel + pivot.diagonal * pivot.held - pivot.drive;
      } else {
        step[k] = (pivot.drive - feel) * pivot.inverse;
      }
      twist += step[k] * pivot.axis;
    }
    if (!swing_[n].active || swing_[n].corner) continue;
    const Eigen::Vector2d& normal = swing_[n].normal;
    const double along = step[node.coordinate], out = step[node.coordinate + 1];
    step[node.coordinate] = out * normal.x() - along * normal.y();
    step[node.coordinate + 1] = out * normal.y() + along * normal.x();
  }
}

void TreeElimination::solve_again(std::span<const Vector6> pull, Eigen::VectorXd& step) {
  for (std::size_t n = tree_.nodes.size(); n-- > 0;) {
    const IkNode& node = tree_.nodes[n];
    Vector6& bias = outside_[n].bias;
    bias = -pull[n];
    for (std::int32_t c = tree_.children_begin[n]; c < tree_.children_begin[n + 1]; ++c) {
      bias += outside_[tree_.children[c]].bias;
    }
    for (std::int32_t k = node.coordinate + node.coordinates - 1; k >= node.coordinate; --k) {
      Pivot& pivot = pivot_[k];
      pivot.held = 0.0;
      pivot.drive = -pivot.axis.dot(bias);
      if (!pivot.locked) bias += (pivot.drive * pivot.inverse) * pivot.momentum;
    }
  }
  substitute(step);
}

EliminationStats TreeElimination::solve_free(const Eigen::VectorXd& x, double damping,
                                             const Eigen::VectorXd& wish, Eigen::VectorXd& step) {
  std::fill(lock_.begin(), lock_.end(), Lock::none);
  std::fill(swing_.begin(), swing_.end(), SwingLock{});
  wish_ = wish.data();
  definite_ = true;
  for (std::size_t n = tree_.nodes.size(); n-- > 0;) {
    eliminate(static_cast<std::int32_t>(n), x, damping);
  }
  if (definite_) substitute(step);
  return {.passes = 1, .settled = true, .definite = definite_};
}

void TreeElimination::respond(const Row& row, Eigen::Ref<Eigen::VectorXd> half) {
  half.setZero();
  std::int32_t n = std::max(row.node_a, row.node_b);
  for (const Row::Term& term : row.terms) n = std::max(n, term.node);
  for (std::int32_t m = 0; m <= n; ++m) felt_[m].setZero();
  if (row.node_a >= 0) felt_[row.node_a] += row.wrench;
  if (row.node_b >= 0) felt_[row.node_b] -= row.counter;
  for (; n >= 0; --n) {
    const IkNode& node = tree_.nodes[n];
    Vector6& felt = felt_[n];
    std::array<double, 6> force{};
    bool pushed = !felt.isZero(0.0);
    for (const Row::Term& term : row.terms) {
      if (term.node != n) continue;
      force[term.coordinate - node.coordinate] += term.coefficient;
      pushed = true;
    }
    if (!pushed) continue;
    for (std::int32_t k = node.coordinate + node.coordinates - 1; k >= node.coordinate; --k) {
      const Pivot& pivot = pivot_[k];
      const double drive = force[k - node.coordinate] + pivot.axis.dot(felt);
      half[k] = drive * std::sqrt(pivot.inverse);
      felt -= (drive * pivot.inverse) * pivot.momentum;
    }
    if (node.parent >= 0) felt_[node.parent] += felt;
  }
}

void TreeElimination::complete(const Eigen::VectorXd& half, Eigen::VectorXd& step) {
  for (std::size_t n = 0; n < tree_.nodes.size(); ++n) {
    const IkNode& node = tree_.nodes[n];
    Vector6& twist = felt_[n];
    if (node.parent < 0) {
      twist.setZero();
    } else {
      twist = felt_[node.parent];
    }
    for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
      const Pivot& pivot = pivot_[k];
      const double change =
          half[k] * std::sqrt(pivot.inverse) - pivot.inverse * pivot.momentum.dot(twist);
      step[k] += change;
      twist += change * pivot.axis;
    }
    twist_[n] += twist;
  }
}

bool TreeElimination::update_box(std::int32_t n, const Eigen::VectorXd& x,
                                 const Eigen::VectorXd& step, bool may_release) {
  const IkNode& node = tree_.nodes[n];
  bool changed = false;
  for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
    const double end = x[k] + step[k];
    if (lock_[k] == Lock::none) {
      if (end > tree_.max[k] + kTouch) {
        lock_[k] = Lock::max;
      } else if (end < tree_.min[k] - kTouch) {
        lock_[k] = Lock::min;
      } else {
        continue;
      }
      changed = true;
    } else if (may_release && tree_.min[k] < tree_.max[k]) {
      // At the upper bound the objective must want more (gradient < 0), at the lower one less.
      const double outward = lock_[k] == Lock::max ? -multiplier_[k] : multiplier_[k];
      if (outward >= 0.0) continue;
      lock_[k] = Lock::none;
      changed = true;
    }
  }
  return changed;
}

bool TreeElimination::update_swing(std::int32_t n, const Eigen::VectorXd& x,
                                   const Eigen::VectorXd& step, bool may_release) {
  const IkNode& node = tree_.nodes[n];
  if (!node.ellipse) return false;
  SwingLock& lock = swing_[n];
  const Eigen::Vector2d end = x.segment<2>(node.coordinate) + step.segment<2>(node.coordinate);
  if (!lock.active) {
    if (node.swing.level(end) <= 1.0 + 1e-10) return false;
    lock = SwingLock{};
    hold_swing(lock, node.swing, end);
    return true;
  }
  if (lock.corner) {
    // It holds as long as the objective's pull stays in the corner's normal cone.
    if (!may_release) return false;
    const std::int32_t k = node.coordinate;
    const double scale = std::max(pivot_[k].diagonal, pivot_[k + 1].diagonal);
    const Eigen::Vector2d wish =
        lock.point - Eigen::Vector2d(multiplier_[k], multiplier_[k + 1]) / scale;
    if ((node.swing.project(wish) - lock.point).norm() < kTouch) return false;
    if (node.swing.level(wish) <= 1.0) {
      lock.active = lock.corner = false;
    } else {
      hold_swing(lock, node.swing, wish);
    }
    lock.press = 0.0;
    return true;
  }
  const double press = -multiplier_[node.coordinate + 1];
  if (may_release && press < 0.0) {
    lock.active = false;
    lock.press = 0.0;
    return true;
  }
  lock.press = std::max(press, 0.0);
  // Slid along the tangent: take up the border again where that ended. Slides to and fro halve, so
  // that a border which bends away under a long one is bisected.
  const Eigen::Vector2d tangent(-lock.normal.y(), lock.normal.x());
  const double slide = tangent.dot(end - lock.point);
  if (std::abs(slide) < slide_tolerance_ || std::abs(slide) * lock.curvature < slide_bend_) {
    return false;
  }
  lock.reach = slide * lock.slide < 0.0 ? 0.5 * std::min(lock.reach, std::abs(lock.slide))
                                        : 2.0 * lock.reach;
  lock.slide = std::clamp(slide, -lock.reach, lock.reach);
  hold_swing(lock, node.swing, lock.point + lock.slide * tangent);
  return true;
}

EliminationStats TreeElimination::solve(const Eigen::VectorXd& x, double damping,
                                        const Eigen::VectorXd& wish, Eigen::VectorXd& step) {
  EliminationStats stats;
  wish_ = wish.data();
  definite_ = true;
  std::fill(dirty_.begin(), dirty_.end(), std::uint8_t(1));
  const auto nodes = static_cast<std::int32_t>(tree_.nodes.size());
  while (stats.passes < kMaxPasses && !stats.settled && definite_) {
    ++stats.passes;
    for (std::int32_t n = nodes - 1; n >= 0; --n) {
      if (!dirty_[n]) continue;
      eliminate(n, x, damping);
      if (tree_.nodes[n].parent >= 0) dirty_[tree_.nodes[n].parent] = 1;
      dirty_[n] = 0;
    }
    if (!definite_) break;
    substitute(step);
    slide_tolerance_ = std::max(kSlide, slide_part_ * step.cwiseAbs().maxCoeff());
    stats.settled = true;
    for (std::int32_t n = 0; n < nodes; ++n) {
      const bool box = update_box(n, x, step, stats.passes <= kReleasePasses);
      const bool swing = stats.passes <= kTangentPasses || !swing_[n].active
                             ? update_swing(n, x, step, stats.passes <= kReleasePasses)
                             : false;
      if (box || swing) {
        dirty_[n] = 1;
        stats.settled = false;
      }
    }
  }
  stats.definite = definite_;
  return stats;
}

}  // namespace limber
