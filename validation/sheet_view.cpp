#include "validation/sheet_view.h"

#include <algorithm>
#include <cmath>
#include <set>

namespace limber {
namespace {

const Eigen::Vector3d kUp(0, 1, 0);
constexpr std::int64_t kLookedAt = 240;  // frames searched for extreme poses
constexpr double kFarOff = 4.2;          // eye distance in figure sizes

Eigen::Vector3d turned_about(const Eigen::Vector3d& axis, double angle, const Eigen::Vector3d& v) {
  return Eigen::AngleAxisd(angle, axis) * v;
}

Eigen::Vector3d flat(Eigen::Vector3d v) {
  v.y() = 0.0;
  return v;
}

/// Joint positions relative to the pelvis (a hand: seen from its wrist), of evenly picked frames.
struct Poses {
  std::vector<std::int64_t> frames;
  std::vector<Eigen::VectorXd> points;
};

Poses sample_poses(const SheetFigure& figure, const BodyPlan& plan) {
  Poses poses;
  const Skeleton& skeleton = figure.character->skeleton;
  const std::int64_t frames = figure.clip->frames();
  const std::int64_t count = std::min(frames, kLookedAt);
  std::vector<DualQuaternion> model(skeleton.parents.size());
  for (std::int64_t k = 0; k < count; ++k) {
    const std::int64_t frame = count < 2 ? 0 : k * (frames - 1) / (count - 1);
    model_from_local(skeleton, figure.clip->frame(frame), model);
    Eigen::VectorXd p(3 * skeleton.size());
    for (std::int32_t j = 0; j < skeleton.size(); ++j) {
      const DualQuaternion& base = model[plan.pelvis];
      p.segment<3>(3 * j) = plan.hand_only
                                ? base.conjugate().transform_point(model[j].translation())
                                : model[j].translation() - flat(base.translation());
    }
    poses.frames.push_back(frame);
    poses.points.push_back(std::move(p));
  }
  return poses;
}

/// Adds frames whose pose is furthest from the mean pose and from each other.
void add_extremes(const ContactSheet& sheet, const BodyPlan& plan, std::size_t count,
                  std::int64_t spacing, std::set<std::int64_t>& chosen) {
  const Poses poses = sample_poses(sheet.target, plan);
  if (poses.frames.empty()) return;
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(poses.points[0].size());
  for (const Eigen::VectorXd& p : poses.points) mean += p / double(poses.points.size());
  std::vector<double> distance;
  for (const Eigen::VectorXd& p : poses.points) distance.push_back((p - mean).norm());
  for (std::size_t n = 0; n < count; ++n) {
    std::size_t best = poses.frames.size();
    for (std::size_t k = 0; k < poses.frames.size(); ++k) {
      const auto near = [&](std::int64_t f) { return std::abs(f - poses.frames[k]) < spacing; };
      if (std::any_of(chosen.begin(), chosen.end(), near)) continue;
      if (best == poses.frames.size() || distance[k] > distance[best]) best = k;
    }
    if (best == poses.frames.size()) return;
    chosen.insert(poses.frames[best]);
    for (std::size_t k = 0; k < poses.frames.size(); ++k) {
      distance[k] = std::min(distance[k], (poses.points[k] - poses.points[best]).norm());
    }
  }
}

void fill_gaps(std::size_t count, std::set<std::int64_t>& chosen) {
  while (chosen.size() < count) {
    std::int64_t widest = 0, middle = -1;
    for (auto it = chosen.begin(), next = std::next(it); next != chosen.end(); ++it, ++next) {
      if (*next - *it > widest) {
        widest = *next - *it;
        middle = (*next + *it) / 2;
      }
    }
    if (widest < 2) return;
    chosen.insert(middle);
  }
}

/// The hand's own axes: towards the fingers, the thumb's side and the back of the hand.
struct HandAxes {
  Eigen::Vector3d fingers{0, 1, 0}, thumb{1, 0, 0}, back{0, 0, 1};
};

HandAxes hand_axes(const Skeleton& skeleton, const BodyPlan& plan,
                   std::span<const DualQuaternion> model) {
  const std::int32_t index = knuckle_of(skeleton, plan, 1), little = knuckle_of(skeleton, plan, 4);
  HandAxes axes;
  if (index == kNoJoint || little == kNoJoint) return axes;
  const std::int32_t wrist = wrist_of(skeleton, plan);
  const Eigen::Vector3d i = model[index].translation(), l = model[little].translation();
  const Eigen::Vector3d along = 0.5 * (i + l) - model[wrist].translation();
  const Eigen::Vector3d across = i - l;
  if (along.norm() < 1e-6 || across.norm() < 1e-6) return axes;
  axes.fingers = along.normalized();
  axes.thumb = (across - axes.fingers * axes.fingers.dot(across)).normalized();
  axes.back = axes.thumb.cross(axes.fingers);  // of a left hand
  if (plan.sides[index] == BodySide::right) axes.back = -axes.back;
  if (plan.sides[index] == BodySide::centre) {  // fingers and thumb curl away from the back
    double towards_back = 0.0;
    for (std::size_t j = 0; j < plan.fingers.size(); ++j) {
      if (plan.fingers[j] >= 0) towards_back += axes.back.dot(model[j].translation() - i);
    }
    if (towards_back > 0.0) axes.back = -axes.back;
  }
  return axes;
}

}  // namespace

std::vector<std::int64_t> choose_frames(const ContactSheet& sheet, const BodyPlan& plan,
                                        std::size_t count) {
  const std::int64_t frames = sheet.target.clip->frames();
  std::set<std::int64_t> chosen;
  for (const std::int64_t f : sheet.frames) {
    if (f >= 0 && f < frames) chosen.insert(f);
  }
  if (!chosen.empty()) return {chosen.begin(), chosen.end()};
  chosen.insert(0);
  chosen.insert(frames - 1);
  const std::int64_t spacing = std::max<std::int64_t>(1, 2 * frames / (3 * std::int64_t(count)));
  if (!sheet.error_mm.empty()) {
    const auto worst = std::max_element(sheet.error_mm.begin(), sheet.error_mm.end());
    const std::int64_t at = worst - sheet.error_mm.begin();
    if (at < frames) chosen.insert(at);
  }
  add_extremes(sheet, plan, 4, spacing, chosen);
  fill_gaps(count, chosen);
  return {chosen.begin(), chosen.end()};
}

std::int64_t frame_at_same_time(const Clip& target, std::int64_t frame, const Clip& source) {
  const double slack = 1.5 / source.rate_hz + 1.5 / target.rate_hz;
  const bool one_clock =
      target.start_s > source.start_s - slack &&
      target.start_s + target.duration_s() < source.start_s + source.duration_s() + slack;
  double seconds = static_cast<double>(frame) / target.rate_hz;
  if (one_clock) seconds += target.start_s - source.start_s;
  const auto nearest = static_cast<std::int64_t>(std::lround(seconds * source.rate_hz));
  return std::clamp<std::int64_t>(nearest, 0, std::max<std::int64_t>(source.frames() - 1, 0));
}

Eigen::Vector3d facing_of(const BodyPlan& plan, std::span<const DualQuaternion> model) {
  Eigen::Vector3d left = Eigen::Vector3d::Zero();
  for (const auto& [l, r] : plan.pairs) {
    left += flat(model[l].translation() - model[r].translation()).stableNormalized();
  }
  const Eigen::Vector3d forward = left.cross(kUp);
  return forward.norm() > 1e-3 ? Eigen::Vector3d(forward.normalized()) : Eigen::Vector3d(0, 0, 1);
}

ViewDirection front_view(const Skeleton& skeleton, const BodyPlan& plan,
                         std::span<const DualQuaternion> model) {
  ViewDirection view;
  if (plan.hand_only) {
    const HandAxes axes = hand_axes(skeleton, plan, model);
    view.towards_eye = (axes.back + 0.55 * axes.thumb + 0.35 * axes.fingers).normalized();
    view.up = axes.fingers;
    view.ground = false;
    return view;
  }
  view.ground = plan.stands;
  const Eigen::Vector3d forward = facing_of(plan, model);
  const Eigen::Vector3d level = turned_about(kUp, 35.0 * M_PI / 180.0, forward);
  const double rise = 14.0 * M_PI / 180.0;
  view.towards_eye = std::cos(rise) * level + std::sin(rise) * kUp;
  return view;
}

ViewDirection side_view(const Skeleton& skeleton, const BodyPlan& plan,
                        std::span<const DualQuaternion> model) {
  ViewDirection view;
  if (plan.hand_only) {
    const HandAxes axes = hand_axes(skeleton, plan, model);
    view.towards_eye = (axes.thumb - 0.45 * axes.back).normalized();
    view.up = axes.fingers;
    view.ground = false;
    return view;
  }
  view.ground = plan.stands;
  const Eigen::Vector3d level = turned_about(kUp, M_PI_2, facing_of(plan, model));
  const double rise = 7.0 * M_PI / 180.0;
  view.towards_eye = std::cos(rise) * level + std::sin(rise) * kUp;
  return view;
}

RowCamera::RowCamera(const ViewDirection& view, std::int32_t width, std::int32_t height)
    : view_(view), width_(width), height_(height) {}

Eigen::Vector3d RowCamera::base_of(const Eigen::Vector3d& anchor) const {
  return view_.ground ? flat(anchor) : anchor;
}

void RowCamera::include(std::span<const Eigen::Vector3d> points, const Eigen::Vector3d& anchor,
                        const Eigen::Quaterniond& turn) {
  const Eigen::Vector3d base = base_of(anchor);
  for (const Eigen::Vector3d& p : points) points_.push_back(turn.conjugate() * (p - base));
}

std::int32_t RowCamera::fit() {
  if (view_.ground || points_.empty()) points_.push_back(Eigen::Vector3d::Zero());  // the floor
  Eigen::Vector3d low = points_.front(), high = low;
  for (const Eigen::Vector3d& p : points_) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  const double size = std::max((high - low).maxCoeff(), 1e-3);
  const Eigen::Vector3d middle = view_.ground ? Eigen::Vector3d(0, 0.5 * (low.y() + high.y()), 0)
                                              : Eigen::Vector3d(0.5 * (low + high));
  camera_.eye = middle + kFarOff * size * view_.towards_eye;
  camera_.view_from_world = look_at(camera_.eye, middle, view_.up);
  Eigen::Vector2d least(1e9, 1e9), most(-1e9, -1e9);
  for (const Eigen::Vector3d& p : points_) {
    const Eigen::Vector2d seen = camera_.project(p).head<2>();
    least = least.cwiseMin(seen);
    most = most.cwiseMax(seen);
  }
  const double side = 10.0, top = 12.0, bottom = view_.ground ? 24.0 : 12.0;
  const Eigen::Vector2d extent = (most - least).cwiseMax(1e-9);
  camera_.focal_px =
      std::min((width_ - 2.0 * side) / extent.x(), (height_ - top - bottom) / extent.y());
  const Eigen::Vector2d drawn = camera_.focal_px * extent;
  height_ = std::clamp(static_cast<std::int32_t>(std::ceil(drawn.y() + top + bottom)),
                       std::min(height_, 190), height_);
  // Figures stand on a common line near the cell's lower edge.
  const double spare = height_ - drawn.y() - top - bottom;
  const double top_y = top + (view_.ground ? spare : 0.5 * spare);
  camera_.centre_px = Eigen::Vector2d(0.5 * (width_ - drawn.x()), top_y) - camera_.focal_px * least;
  return height_;
}

Camera RowCamera::at(const Eigen::Vector3d& anchor, const Eigen::Quaterniond& turn) const {
  Camera camera = camera_;
  camera.eye = base_of(anchor) + turn * camera_.eye;
  camera.view_from_world = camera_.view_from_world * turn.toRotationMatrix().transpose();
  return camera;
}

}  // namespace limber
