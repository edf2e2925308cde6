#include "validation/rig_sheet.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "validation/sheet_parts.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr std::int32_t kMargin = 36, kInnerWidth = 2088, kHead = 104, kViewHeight = 1040, kGap = 16;
constexpr std::int32_t kTableColumns = 3, kTableLine = 24;
constexpr int kArcSteps = 24;
constexpr double kAlong = 0.9;  // cosine: an axis that lies along the bone turns it about itself
constexpr double kConeOfBone = 0.5, kLongestCone = 0.14, kLeafCone = 0.05;  // of bone; of size
constexpr double kSeenThrough = 0.4;

Quaterniond turn(double angle, const Vector3d& axis) {
  return Quaterniond(AngleAxisd(angle, axis));
}

double along(const Range& range, int k) {
  return range.min + (range.max - range.min) * k / kArcSteps;
}

bool lies_along(const Vector3d& axis, const Vector3d& bone) {
  return std::abs(axis.dot(bone)) > kAlong;
}

/// A range about +-bone as a range about bone.
Range about_bone(const Range& range, const Vector3d& axis, const Vector3d& bone) {
  return axis.dot(bone) > 0.0 ? range : Range{-range.max, -range.min};
}

void add_arc(const Range& range, const Vector3d& axis, const Vector3d& bone, LimitShape& shape) {
  if (lies_along(axis, bone)) {
    shape.twist = about_bone(range, axis, bone);
    return;
  }
  for (int k = 0; k <= kArcSteps; ++k) {
    shape.border.push_back(turn(along(range, k), axis) * bone);
  }
}

void add_box(const RigJoint& joint, const Vector3d& bone, LimitShape& shape) {
  const auto add = [&](double a, double b) {
    shape.border.push_back(turn(a, joint.axes[0]) * (turn(b, joint.axes[1]) * bone));
  };
  const Range &a = joint.limits[0], &b = joint.limits[1];
  for (int k = 0; k < kArcSteps; ++k) add(along(a, k), b.min);
  for (int k = 0; k < kArcSteps; ++k) add(a.max, along(b, k));
  for (int k = 0; k < kArcSteps; ++k) add(along(a, kArcSteps - k), b.max);
  for (int k = 0; k < kArcSteps; ++k) add(a.min, along(b, kArcSteps - k));
  shape.closed = true;
}

void add_ellipse(const RigJoint& joint, const Vector3d& bone, LimitShape& shape) {
  for (int k = 0; k < 3 * kArcSteps; ++k) {
    const double angle = 2.0 * M_PI * k / (3 * kArcSteps), c = std::cos(angle), s = std::sin(angle);
    const double s0 = c * (c < 0.0 ? -joint.limits[0].min : joint.limits[0].max);
    const double s1 = s * (s < 0.0 ? -joint.limits[1].min : joint.limits[1].max);
    shape.border.push_back(rotation_exp(Vector3d(s0 * joint.axes[0] + s1 * joint.axes[1])) * bone);
  }
  shape.closed = true;
  shape.twist = about_bone(joint.limits[2], joint.axes[2], bone);
}

/// One joint's shape where it is drawn.
struct Cone {
  LimitShape shape;
  Vector3d apex, bone;  // world; along the bone, as long as the cone
  Quaterniond rotation;
  Vector3d axis;  // in the joint's space, square to the bone: where twists are counted from
  Eigen::Vector3f color;
};

class RigScene {
 public:
  explicit RigScene(const RigSheet& sheet)
      : sheet_(sheet),
        model_(sheet.parent_from_joint.size()),
        figure_(*sheet.character, plan_of(*sheet.character), {}) {
    model_from_local(sheet.character->skeleton, sheet.parent_from_joint, model_);
    surfaces_ = figure_.pose(model_, 1.0, Vector3d::Zero());
    Vector3d low = Vector3d::Constant(1e9), high = -low;
    for (const Vector3d& p : points()) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    size_ = std::max((high - low).maxCoeff(), 1e-3);
    for (std::size_t i = 0; i < sheet.rig->joints.size(); ++i) add_cone(i);
  }

  void draw(Canvas& canvas, const Box& box, bool from_side) const {
    const BodyPlan& plan = figure_.plan();
    const Skeleton& skeleton = sheet_.character->skeleton;
    const ViewDirection view =
        from_side ? side_view(skeleton, plan, model_) : front_view(skeleton, plan, model_);
    const Vector3d anchor = model_[plan.pelvis].translation();
    RowCamera row(view, box.width, box.height);
    row.include(points(), anchor);
    row.fit();
    CellScene scene;
    scene.surfaces = surfaces_;
    scene.anchor = anchor;
    scene.camera = row.at(anchor);
    scene.ground = view.ground;
    scene.up = view.up;
    scene.size = size_;
    draw_scene(canvas, box, scene);
    std::vector<Surface> cones;
    for (const Cone& cone : cones_) cones.push_back(surface_of(cone));
    scene.surfaces = cones;
    draw_through(canvas, box, scene, kSeenThrough);
    for (const Cone& cone : cones_) draw_lines(canvas, box, scene.camera, cone);
  }

 private:
  std::vector<Vector3d> points() const {
    std::vector<Vector3d> out;
    for (const Surface& s : surfaces_) {
      const std::size_t step = std::max<std::size_t>(1, s.triangles.size() / 3000);
      for (std::size_t i = 0; i < s.triangles.size(); i += step) {
        out.push_back(s.positions[s.triangles[i]].cast<double>());
      }
    }
    for (const Cone& cone : cones_) {
      for (const Vector3d& d : cone.shape.border) out.push_back(tip(cone, d));
    }
    return out;
  }

  static Vector3d tip(const Cone& cone, const Vector3d& direction) {
    return cone.apex + cone.bone.norm() * (cone.rotation * direction);
  }

  const DualQuaternion& at(std::size_t row) const { return model_[sheet_.joint_of_row[row]]; }

  /// World vector along a joint's bone: to its farthest child, else on from its parent.
  Vector3d bone_of(std::size_t row) const {
    const std::vector<RigJoint>& joints = sheet_.rig->joints;
    Vector3d best = Vector3d::Zero();
    for (std::size_t i = row + 1; i < joints.size(); ++i) {
      if (joints[i].parent != static_cast<std::int32_t>(row)) continue;
      const Vector3d v = at(i).translation() - at(row).translation();
      if (v.norm() > best.norm()) best = v;
    }
    if (best.norm() > 1e-6) return std::min(kConeOfBone, kLongestCone * size_ / best.norm()) * best;
    if (joints[row].parent == kNoJoint) return best;
    best = at(row).translation() - at(std::size_t(joints[row].parent)).translation();
    return best.norm() < 1e-6 ? best : Vector3d(kLeafCone * size_ * best.normalized());
  }

  void add_cone(std::size_t row) {
    const RigJoint& joint = sheet_.rig->joints[row];
    if (!joint.limited()) return;
    Cone cone;
    cone.apex = at(row).translation();
    cone.bone = bone_of(row);
    if (cone.bone.norm() < 1e-6) return;
    cone.rotation = at(row).rotation();
    const Vector3d bone = cone.rotation.conjugate() * cone.bone.normalized();
    cone.shape = limit_shape(joint, bone);
    for (const Vector3d& axis : joint.axes) {
      if (!lies_along(axis, bone)) cone.axis = (axis - axis.dot(bone) * bone).normalized();
    }
    cone.color = SideColors{}.of(figure_.plan(), sheet_.joint_of_row[row]);
    cones_.push_back(std::move(cone));
  }

  static Surface surface_of(const Cone& cone) {
    Surface out;
    const std::size_t n = cone.shape.border.size();
    const auto add = [&](const Vector3d& p, const Vector3d& normal) {
      out.positions.push_back(p.cast<float>());
      out.normals.push_back(normal.normalized().cast<float>());
      out.colors.push_back(cone.color);
    };
    for (std::size_t k = 0; k + (cone.shape.closed ? 0 : 1) < n; ++k) {
      const Vector3d a = tip(cone, cone.shape.border[k]),
                     b = tip(cone, cone.shape.border[(k + 1) % n]);
      const Vector3d normal = (a - cone.apex).cross(b - cone.apex);
      if (normal.norm() < 1e-12) continue;
      for (const Vector3d& p : {cone.apex, a, b}) add(p, normal);
      for (int i = 0; i < 3; ++i) out.triangles.push_back(std::uint32_t(out.triangles.size()));
    }
    return out;
  }

  static void draw_lines(Canvas& canvas, const Box& box, const Camera& camera, const Cone& cone) {
    const Rgb ink = {static_cast<std::uint8_t>(90), 40, 150};
    const auto seen = [&](const Vector3d& p) {
      const Vector3d at = camera.project(p);
      return Eigen::Vector2d(box.x + at.x(), box.y + at.y());
    };
    const auto line = [&](const Vector3d& a, const Vector3d& b, double width, Rgb color) {
      canvas.line(seen(a), seen(b), width, color, 0.85);
    };
    const auto& border = cone.shape.border;
    for (std::size_t k = 0; k + 1 < border.size(); ++k) {
      line(tip(cone, border[k]), tip(cone, border[k + 1]), 1.6, palette::kInk);
    }
    if (cone.shape.closed)
      line(tip(cone, border.back()), tip(cone, border.front()), 1.6, palette::kInk);
    const Range& twist = cone.shape.twist;
    if (twist.max - twist.min < 1e-6) return;
    const Vector3d bone = cone.rotation.conjugate() * cone.bone.normalized();
    const Vector3d centre = cone.apex + 0.75 * cone.bone;
    const auto on_ring = [&](double angle) {
      return Vector3d(centre +
                      0.3 * cone.bone.norm() * (cone.rotation * (turn(angle, bone) * cone.axis)));
    };
    for (int k = 0; k < kArcSteps; ++k) {
      line(on_ring(along(twist, k)), on_ring(along(twist, k + 1)), 2.4, ink);
    }
    line(centre, on_ring(twist.min), 1.2, ink);
    line(centre, on_ring(twist.max), 1.2, ink);
  }

  const RigSheet& sheet_;
  std::vector<DualQuaternion> model_;
  FigureModel figure_;
  std::span<const Surface> surfaces_;
  std::vector<Cone> cones_;
  double size_ = 1.0;
};

std::string ranges_of(const RigJoint& joint) {
  if (!joint.limited()) return joint.type == JointType::fixed ? "" : "no limits";
  std::string out;
  for (std::int32_t k = 0; k < dof_count(joint.type); ++k) {
    out += fmt::format("{}{:.0f} to {:.0f}", k == 0 ? "" : ",  ",
                       joint.limits[k].min * 180.0 / M_PI, joint.limits[k].max * 180.0 / M_PI);
  }
  return out;
}

/// What moves, with its ranges; right joints that mirror a left one are left out.
std::vector<const RigJoint*> listed(const Rig& rig) {
  std::vector<const RigJoint*> out;
  for (const RigJoint& joint : rig.joints) {
    if (joint.type == JointType::fixed) continue;
    const bool mirrored = joint.name.starts_with("right") &&
                          std::ranges::any_of(rig.joints, [&](const RigJoint& other) {
                            return other.name == "left" + joint.name.substr(5) &&
                                   ranges_of(other) == ranges_of(joint);
                          });
    if (!mirrored) out.push_back(&joint);
  }
  return out;
}

void draw_table(Canvas& canvas, const Box& box, const std::vector<const RigJoint*>& joints) {
  canvas.rounded(box, 10, palette::kCard);
  const std::int32_t width = (box.width - 40) / kTableColumns;
  const std::size_t rows = (joints.size() + kTableColumns - 1) / kTableColumns;
  for (std::size_t i = 0; i < joints.size(); ++i) {
    const double x = box.x + 20 + width * static_cast<std::int32_t>(i / rows);
    const double y = box.y + 34 + kTableLine * static_cast<std::int32_t>(i % rows);
    canvas.text(x, y, Canvas::fitted(joints[i]->name, 9.5, 240), 9.5, palette::kInk, Align::left,
                1.1);
    canvas.text(x + 256, y, to_string(joints[i]->type), 9, palette::kMuted);
    canvas.text(x + 352, y, ranges_of(*joints[i]), 9, palette::kMuted);
  }
}

}  // namespace

LimitShape limit_shape(const RigJoint& joint, const Vector3d& bone) {
  LimitShape shape;
  if (!joint.limited()) return shape;
  if (joint.type == JointType::ball) {
    add_ellipse(joint, bone, shape);
  } else if (joint.type == JointType::universal && !lies_along(joint.axes[0], bone) &&
             !lies_along(joint.axes[1], bone)) {
    add_box(joint, bone, shape);
  } else {
    for (std::int32_t k = 0; k < dof_count(joint.type); ++k) {
      add_arc(joint.limits[k], joint.axes[k], bone, shape);
    }
  }
  return shape;
}

Result<Image> render_rig_sheet(const RigSheet& sheet) {
  if (sheet.rig == nullptr || sheet.character == nullptr ||
      sheet.joint_of_row.size() != sheet.rig->joints.size() ||
      sheet.parent_from_joint.size() != sheet.character->skeleton.parents.size()) {
    return Error{.code = "sheet-input",
                 .message = "the rig, its figure and its pose do not fit each other",
                 .hint = "draw a rig with the figure that wears it"};
  }
  const std::vector<const RigJoint*> joints = listed(*sheet.rig);
  const auto rows = static_cast<std::int32_t>((joints.size() + kTableColumns - 1) / kTableColumns);
  const Box table{kMargin, kMargin + kHead + kViewHeight + kGap, kInnerWidth,
                  rows * kTableLine + 40};
  Canvas canvas(kInnerWidth + 2 * kMargin, table.y + table.height + kMargin, palette::kPage);
  canvas.text(kMargin, kMargin + 22, Canvas::fitted(sheet.title, 19, kInnerWidth), 19,
              palette::kInk, Align::left, 0.95);
  const auto line = [&](std::int32_t below, const std::string& words) {
    canvas.text(kMargin, kMargin + below, Canvas::fitted(words, 10, kInnerWidth), 10,
                palette::kMuted);
  };
  line(50,
       "Cones and arcs: how far a bone swings.  Rings: how far it turns about itself.  Below, "
       "degrees about the joint's axes; right joints where they differ from left ones.");
  line(74, sheet.description);
  const RigScene scene(sheet);
  const std::int32_t width = (kInnerWidth - kGap) / 2;
  scene.draw(canvas, {kMargin, kMargin + kHead, width, kViewHeight}, false);
  scene.draw(canvas, {kMargin + width + kGap, kMargin + kHead, width, kViewHeight}, true);
  draw_table(canvas, table, joints);
  return canvas.take();
}

}  // namespace limber
