#include "validation/contact_sheet.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "validation/sheet_parts.h"

namespace limber {
namespace {

constexpr std::size_t kColumns = 10;
constexpr std::int32_t kMargin = 36, kCellGap = 10, kCaption = 24, kRowLabel = 34, kRowGap = 10;
constexpr std::int32_t kHeadHeight = 104, kCellHeight = 310, kWidestCell = 330, kHandHeight = 200;
constexpr double kFingersMoveRad = 0.1;  // from here on, hands are shown from near
constexpr std::int32_t kInnerWidth = 2088;

Error invalid(std::string message) {
  return {.code = "sheet-input", .message = std::move(message), .hint = "draw a clip with frames"};
}

bool playable(const SheetFigure& figure) {
  return figure.character != nullptr && figure.clip != nullptr && figure.clip->frames() > 0 &&
         figure.clip->joints == figure.character->skeleton.size();
}

/// One figure with its model, ready to be posed.
struct Actor {
  const SheetFigure* figure = nullptr;
  std::unique_ptr<FigureModel> model;
  std::vector<DualQuaternion> model_from_joint;
  double floor_y = 0.0;  // drawn as y = 0

  Eigen::Quaterniond first_turn{1, 0, 0, 0};
  bool followed = false;  // the camera turns with the wrist

  Actor(const SheetFigure& f, BodyPlan plan, std::span<const std::int32_t> tinted)
      : figure(&f),
        model(std::make_unique<FigureModel>(*f.character, std::move(plan), tinted)),
        model_from_joint(f.character->skeleton.parents.size()) {}

  const BodyPlan& plan() const { return model->plan(); }
  const Skeleton& skeleton() const { return figure->character->skeleton; }

  std::span<const Surface> pose(std::int64_t frame) {
    model_from_local(figure->character->skeleton, figure->clip->frame(frame), model_from_joint);
    return model->pose(model_from_joint, figure->scale, shift());
  }
  Eigen::Vector3d shift() const { return figure->offset - Eigen::Vector3d(0, floor_y, 0); }
  Eigen::Vector3d anchor() const {
    return figure->scale * model_from_joint[plan().pelvis].translation() + shift();
  }
  /// How the followed joint has turned since the first drawn frame.
  Eigen::Quaterniond turned() const {
    return model_from_joint[plan().pelvis].rotation() * first_turn.conjugate();
  }
  Eigen::Quaterniond turn() const { return followed ? turned() : Eigen::Quaterniond::Identity(); }
};

struct Row {
  Actor* actor = nullptr;
  std::string label, detail;
  ViewDirection view;
  std::vector<std::int64_t> frames;  // of the actor's own clip
  bool marks = false;
  Actor* ghost = nullptr;  // its bones are drawn over the actor's cells
  std::vector<std::int64_t> ghost_frames;
  std::size_t first_column = 0;  // not 0: beside the row before, on its right
  std::int32_t cell_height = kCellHeight;
  std::unique_ptr<RowCamera> camera;
  double size = 0.0;  // of the figure, m
};

Row row_of(Actor* actor, std::string label, std::string detail, const ViewDirection& view,
           std::vector<std::int64_t> frames) {
  Row row;
  row.actor = actor;
  row.label = std::move(label);
  row.detail = std::move(detail);
  row.view = view;
  row.frames = std::move(frames);
  return row;
}

std::vector<Eigen::Vector3d> some_points(std::span<const Surface> surfaces) {
  std::vector<Eigen::Vector3d> points;
  for (const Surface& s : surfaces) {
    const std::size_t step = std::max<std::size_t>(1, s.triangles.size() / 2400);
    for (std::size_t i = 0; i < s.triangles.size(); i += step) {
      const Eigen::Vector3f& p = s.positions[s.triangles[i]];
      if (p.allFinite()) points.push_back(p.cast<double>());
    }
  }
  return points;
}

double height_of(std::span<const Eigen::Vector3d> points) {
  Eigen::Vector3d low = Eigen::Vector3d::Constant(1e9), high = -low;
  for (const Eigen::Vector3d& p : points) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  return points.empty() ? 0.0 : (high - low).maxCoeff();
}

struct Grid {
  std::vector<Box> cells;
};

Grid grid_of(std::int32_t top, std::size_t columns, std::int32_t cell_height) {
  Grid grid;
  const double pitch =
      std::min(double(kInnerWidth + kCellGap) / double(columns), double(kWidestCell));
  for (std::size_t c = 0; c < columns; ++c) {
    const auto x0 = static_cast<std::int32_t>(std::lround(kMargin + pitch * double(c)));
    const auto x1 = static_cast<std::int32_t>(std::lround(kMargin + pitch * double(c + 1)));
    grid.cells.push_back({x0, top + kCaption, x1 - x0 - kCellGap, cell_height});
  }
  return grid;
}

/// Frame, time and the frame's error, above the figure.
void draw_caption(Canvas& canvas, const Box& cell, const ContactSheet& sheet, std::int64_t frame,
                  bool marks, bool worst) {
  const Clip& clip = *sheet.target.clip;
  const double y = cell.y - 8, time = clip.start_s + static_cast<double>(frame) / clip.rate_hz;
  const double used =
      canvas.text(cell.x + 1, y, fmt::format("{}", frame), 9.5, palette::kInk, Align::left, 1.2);
  canvas.text(cell.x + 10 + used, y, fmt::format("{:.2f} s", time), 9.5, palette::kMuted);
  if (!marks) return;
  const double x = cell.x + cell.width - 1;
  const auto f = static_cast<std::size_t>(frame);
  if (f < sheet.error_mm.size()) {
    const Rgb color = worst ? palette::kTarget : palette::kMuted;
    canvas.text(x, y, fmt::format("{:.1f} mm", sheet.error_mm[f]), 9.5, color, Align::right,
                worst ? 1.3 : 1.0);
  }
}

/// Feet and toes; empty where no joint is known as one.
std::vector<std::int32_t> foot_joints(const BodyPlan& plan) {
  std::vector<std::int32_t> out;
  for (std::size_t j = 0; j < plan.roles.size(); ++j) {
    const std::string& role = plan.roles[j];
    if (role.ends_with("Foot") || role.ends_with("Toes")) out.push_back(std::int32_t(j));
  }
  return out;
}

/// Files whose floor is not y = 0 stand on the lowest level that their feet come to (a sword may
/// hang lower); small faults are shown.
void find_floor(Actor& actor, std::span<const std::int64_t> frames) {
  const std::vector<std::int32_t> feet = foot_joints(actor.plan());
  double lowest = 1e9, size = 0.0;
  for (const std::int64_t frame : frames) {
    const std::vector<Eigen::Vector3d> points = some_points(actor.pose(frame));
    size = std::max(size, height_of(points));
    for (const Eigen::Vector3d& p : points) {
      if (feet.empty()) lowest = std::min(lowest, p.y());
    }
    for (const std::int32_t j : feet) {
      const double y = actor.model_from_joint[j].translation().y();
      lowest = std::min(lowest, actor.figure->scale * y + actor.figure->offset.y());
    }
  }
  if (size == 0.0) return;
  if (lowest < -0.1 * size || lowest > 0.5 * size) actor.floor_y = lowest;
}

/// The camera follows a hand's turns where they would hide the fingers.
bool turns_much(Actor& actor, std::span<const std::int64_t> frames) {
  bool much = false;
  for (const std::int64_t frame : frames) {
    actor.pose(frame);
    if (frame == frames.front())
      actor.first_turn = actor.model_from_joint[actor.plan().pelvis].rotation();
    much = much || rotation_angle(actor.turned(), Eigen::Quaterniond::Identity()) > 0.8;
  }
  return much;
}

/// Fits the row's camera to all of its frames; fixes the row's height.
void frame_row(Row& row, std::size_t columns) {
  row.camera =
      std::make_unique<RowCamera>(row.view, grid_of(0, columns, 0).cells[0].width, row.cell_height);
  for (const std::int64_t frame : row.frames) {
    const std::vector<Eigen::Vector3d> points = some_points(row.actor->pose(frame));
    row.camera->include(points, row.actor->anchor(), row.actor->turn());
    row.size = std::max(row.size, height_of(points));
  }
  row.size = std::max(row.size, 1e-3);
  row.cell_height = row.camera->fit();
}

/// The bones between joints with roles of a source as it is now posed, at the target's size: its
/// floor on the target's, its pelvis over the target's.
std::vector<GhostBone> ghost_bones(const Actor& source, const Actor& target, double scale) {
  const auto place = [&](std::int32_t j) {
    return Eigen::Vector3d(scale * (source.model_from_joint[j].translation() + source.shift()));
  };
  Eigen::Vector3d over = target.anchor() - place(source.plan().pelvis);
  over.y() = 0.0;
  std::vector<GhostBone> bones;
  for (std::int32_t j = 0; j < source.skeleton().size(); ++j) {
    if (source.plan().roles[j].empty() || source.plan().fingers[j] >= 0) continue;
    std::int32_t parent = source.skeleton().parents[j];
    while (parent != kNoJoint && source.plan().roles[parent].empty()) {
      parent = source.skeleton().parents[parent];
    }
    if (parent != kNoJoint) bones.emplace_back(place(parent) + over, place(j) + over);
  }
  return bones;
}

void draw_row(Canvas& canvas, const Row& row, const ContactSheet& sheet,
              std::span<const std::int64_t> frames, std::size_t columns, std::int32_t top) {
  const Grid grid = grid_of(top + kRowLabel, columns, row.cell_height);
  const double left = grid.cells[row.first_column].x;
  canvas.text(left, top + 22, row.label, 11, palette::kInk, Align::left, 1.3);
  const double used = Canvas::text_width(row.label, 11) + 16;
  canvas.text(left + used, top + 22,
              Canvas::fitted(row.detail, 9.5, kMargin + kInnerWidth - left - used), 9.5,
              palette::kMuted);
  const auto worst = std::max_element(sheet.error_mm.begin(), sheet.error_mm.end());
  for (std::size_t c = 0; c < frames.size(); ++c) {
    const Box& cell = grid.cells[row.first_column + c];
    CellScene scene;
    scene.surfaces = row.actor->pose(row.frames[c]);
    scene.anchor = row.actor->anchor();
    scene.camera = row.camera->at(scene.anchor, row.actor->turn());
    scene.ground = row.view.ground;
    scene.up = row.actor->turn() * row.view.up;
    scene.size = row.size;
    draw_scene(canvas, cell, scene);
    if (row.ghost != nullptr) {
      row.ghost->pose(row.ghost_frames[c]);
      draw_ghost(canvas, cell, scene.camera,
                 ghost_bones(*row.ghost, *row.actor, sheet.ghost_scale));
    }
    const auto f = static_cast<std::size_t>(frames[c]);
    if (row.marks && f < sheet.marks.size()) {
      Camera of_marks = scene.camera;
      of_marks.eye.y() += row.actor->floor_y;
      draw_marks(canvas, cell, of_marks, sheet.marks[f]);
    }
    const bool is_worst = worst != sheet.error_mm.end() && *worst >= 0.05 &&
                          worst - sheet.error_mm.begin() == frames[c];
    draw_caption(canvas, cell, sheet, frames[c], row.marks, is_worst);
  }
}

std::string detail_of(const Actor& actor) {
  const SheetFigure& figure = *actor.figure;
  std::string detail = fmt::format("{}{}{} joints, {} frames at {:g} Hz", figure.label,
                                   figure.label.empty() ? "" : "   ", figure.clip->joints,
                                   figure.clip->frames(), figure.clip->rate_hz);
  if (actor.floor_y != 0.0)
    detail += fmt::format("   (floor drawn at y = {:.2f} m)", actor.floor_y);
  if (actor.followed) detail += "   (the view turns with the wrist)";
  return detail;
}

/// What the sheet shows, in rows from the top.
struct Cast {
  std::unique_ptr<Actor> source, target;
  std::vector<std::unique_ptr<Actor>> hands;
  std::vector<std::int64_t> frames, source_frames;
  std::vector<Row> rows;
};

/// Whether the fingers that a plan shows turn anywhere in these frames.
bool fingers_move(const SheetFigure& figure, const BodyPlan& plan,
                  std::span<const std::int64_t> frames) {
  const auto first = figure.clip->frame(frames.front());
  for (const std::int64_t frame : frames) {
    const auto now = figure.clip->frame(frame);
    for (std::size_t j = 0; j < plan.fingers.size(); ++j) {
      if (plan.fingers[j] < 0) continue;
      if (rotation_angle(first[j].rotation(), now[j].rotation()) > kFingersMoveRad) return true;
    }
  }
  return false;
}

/// Every `step`-th of them.
std::vector<std::int64_t> every(std::size_t step, std::span<const std::int64_t> frames) {
  std::vector<std::int64_t> out;
  for (std::size_t i = 0; i < frames.size(); i += step) out.push_back(frames[i]);
  return out;
}

/// The hands of two bodies whose fingers move, from near: source above target, left beside right.
void add_hands(const ContactSheet& sheet, Cast& cast) {
  std::vector<BodySide> sides;
  for (const BodySide side : {BodySide::left, BodySide::right}) {
    const BodyPlan source = hand_plan_of(*sheet.source.character, side),
                   target = hand_plan_of(*sheet.target.character, side);
    if (source.crop != kNoJoint && target.crop != kNoJoint &&
        fingers_move(sheet.source, source, cast.source_frames)) {
      sides.push_back(side);
    }
  }
  for (const bool of_source : {true, false}) {
    const SheetFigure& figure = of_source ? sheet.source : sheet.target;
    for (const BodySide side : sides) {
      auto hand = std::make_unique<Actor>(
          figure, hand_plan_of(*figure.character, side),
          of_source ? std::span<const std::int32_t>{} : std::span(sheet.tinted_joints));
      const auto frames = every(sides.size(), of_source ? cast.source_frames : cast.frames);
      turns_much(*hand, frames);
      hand->followed = true;
      hand->pose(frames.front());
      Row row = row_of(hand.get(), of_source ? "SOURCE" : "TARGET",
                       side == BodySide::left ? "left hand" : "right hand",
                       front_view(hand->skeleton(), hand->plan(), hand->model_from_joint), frames);
      row.cell_height = kHandHeight;
      if (side != sides.front()) row.first_column = (cast.frames.size() + 1) / 2;
      cast.rows.push_back(std::move(row));
      cast.hands.push_back(std::move(hand));
    }
  }
}

/// A hand is compared with the source's hand of its side, not with the whole figure.
BodyPlan plan_of_source(const ContactSheet& sheet, const Actor& target) {
  const std::int32_t knuckle = knuckle_of(target.skeleton(), target.plan(), 1);
  if (!target.plan().hand_only || knuckle == kNoJoint) return plan_of(*sheet.source.character);
  const BodySide side = target.plan().sides[knuckle];
  const BodyPlan whole = plan_of(*sheet.source.character);
  if (whole.hand_only || side == BodySide::centre) return whole;
  return hand_plan_of(*sheet.source.character, side);
}

Cast cast_of(const ContactSheet& sheet) {
  Cast cast;
  cast.target =
      std::make_unique<Actor>(sheet.target, plan_of(*sheet.target.character), sheet.tinted_joints);
  Actor& target = *cast.target;
  cast.frames = choose_frames(sheet, target.plan(), kColumns);
  if (target.plan().stands) find_floor(target, cast.frames);
  bool follow = target.plan().hand_only && turns_much(target, cast.frames);
  Actor* leader = &target;
  if (sheet.source.character != nullptr) {
    cast.source = std::make_unique<Actor>(sheet.source, plan_of_source(sheet, target),
                                          std::span<const std::int32_t>{});
    Actor& source = *cast.source;
    for (const std::int64_t f : cast.frames) {
      cast.source_frames.push_back(frame_at_same_time(*sheet.target.clip, f, *sheet.source.clip));
    }
    if (source.plan().stands) find_floor(source, cast.source_frames);
    follow = (source.plan().hand_only && turns_much(source, cast.source_frames)) || follow;
    source.followed = follow && source.plan().hand_only;
    source.pose(cast.source_frames.front());
    if (target.plan().stands && source.plan().stands) leader = &source;
  }
  target.followed = follow && target.plan().hand_only;
  target.pose(cast.frames.front());

  // One direction for all rows, from the source's first frame: a target that faces elsewhere shows.
  const auto front_of = [](const Actor& actor) {
    return front_view(actor.skeleton(), actor.plan(), actor.model_from_joint);
  };
  const ViewDirection front = front_of(*leader);
  const ViewDirection side =
      side_view(leader->skeleton(), leader->plan(), leader->model_from_joint);
  if (cast.source) {
    Actor& source = *cast.source;
    const ViewDirection own = leader == &source ? front : front_of(source);
    cast.rows.push_back(row_of(&source, "SOURCE", detail_of(source), own, cast.source_frames));
  }
  const char* from = target.plan().hand_only ? "from the thumb's side" : "from the side";
  cast.rows.push_back(row_of(&target, "TARGET", detail_of(target), front, cast.frames));
  cast.rows.push_back(row_of(&target, "TARGET", from, side, cast.frames));
  if (cast.source && sheet.ghost_scale > 0.0 && target.plan().stands &&
      cast.source->plan().stands) {
    cast.rows.back().detail += ", the source's bones over it";
    cast.rows.back().ghost = cast.source.get();
    cast.rows.back().ghost_frames = cast.source_frames;
  }
  if (cast.source && target.plan().stands) add_hands(sheet, cast);
  for (Row& row : cast.rows) {
    row.marks = row.actor == &target;
    frame_row(row, cast.frames.size());
  }
  return cast;
}

/// [row] its top, and below the last one. Rows that stand beside each other share it.
std::vector<std::int32_t> tops_of(std::span<const Row> rows, std::int32_t top) {
  std::vector<std::int32_t> tops;
  std::int32_t height = 0;
  for (const Row& row : rows) {
    if (row.first_column == 0) top += height, height = 0;
    tops.push_back(top);
    height = std::max(height, kRowLabel + kCaption + row.cell_height + kRowGap);
  }
  tops.push_back(top + height);
  return tops;
}

}  // namespace

Result<Image> render_contact_sheet(const ContactSheet& sheet) {
  if (!playable(sheet.target)) return invalid("the target has no frames for its joints");
  if (sheet.source.character != nullptr && !playable(sheet.source)) {
    return invalid("the source has no frames for its joints");
  }
  const Cast cast = cast_of(sheet);
  const std::vector<std::int32_t> tops = tops_of(cast.rows, kMargin + kHeadHeight - 14);
  const std::int32_t strips = strips_height(sheet), y = tops.back();
  Canvas canvas(kInnerWidth + 2 * kMargin, y + 14 + strips + kMargin, palette::kPage);
  const Box head{kMargin, kMargin - 8, kInnerWidth, kHeadHeight};
  draw_head(canvas, head, sheet, cast.target->plan());
  for (std::size_t i = 0; i < cast.rows.size(); ++i) {
    const Row& row = cast.rows[i];
    const bool all = row.frames.size() == cast.frames.size();
    draw_row(canvas, row, sheet, all ? cast.frames : every(2, cast.frames), cast.frames.size(),
             tops[i]);
  }
  draw_strips(canvas, {kMargin, y + 14, kInnerWidth, strips}, sheet, cast.frames);
  return canvas.take();
}

}  // namespace limber
