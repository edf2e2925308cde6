#include "validation/pose_sheet.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "validation/figure_model.h"
#include "validation/pose_marks.h"
#include "validation/sheet_parts.h"
#include "validation/sheet_view.h"

namespace limber {
namespace {

using Eigen::Vector3d;

constexpr std::int32_t kMargin = 36, kGap = 18, kPadding = 14, kViewGap = 8;
constexpr std::int32_t kHead = 96, kCardWidth = 684, kViewHeight = 430;
constexpr std::int32_t kTitle = 44, kLine = 21, kFoot = 12, kLabel = 18;  // of a card, px
constexpr std::size_t kMostColumns = 3;
constexpr double kAxis = 0.1;        // length of a mark's longest axis, over the figure's size
constexpr double kFarAway = 100.0;   // m from the origin
constexpr double kMostMissed = 0.7;  // how far a target is followed, over the figure's size

Error invalid(std::string message) {
  return {.code = "sheet-input", .message = std::move(message), .hint = "draw at least one pose"};
}

Rgb color_of_verdict(const std::string& verdict) {
  return verdict == "reached"  ? palette::kPass
         : verdict == "failed" ? palette::kFail
                               : palette::kWarn;
}

struct Bounds {
  Vector3d low = Vector3d::Constant(1e9), high = Vector3d::Constant(-1e9);
  void include(const Vector3d& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  double size() const { return std::max((high - low).maxCoeff(), 1e-3); }
};

std::vector<Vector3d> points_of(std::span<const Surface> surfaces) {
  std::vector<Vector3d> points;
  for (const Surface& s : surfaces) {
    const std::size_t step = std::max<std::size_t>(1, s.triangles.size() / 1200);
    for (std::size_t i = 0; i < s.triangles.size(); i += step) {
      const Eigen::Vector3f& p = s.positions[s.triangles[i]];
      if (p.allFinite()) points.push_back(p.cast<double>());
    }
  }
  return points;
}

/// What one picture of a card shows, and from where.
struct Shot {
  BodyPlan plan;
  bool side = false;               ///< from the side, or the thumb's side
  const char* label = "";          ///< in the picture's corner
  std::vector<std::size_t> marks;  ///< of the cell
};

/// The shots of one cell: the whole figure, then the hands whose fingers are pulled (their marks
/// are drawn there alone), else the side.
std::vector<Shot> shots_of(const Character& character, const PoseCell& cell) {
  const BodyPlan whole = plan_of(character);
  std::vector<std::size_t> all(cell.marks.size());
  for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
  std::vector<Shot> shots{{whole, false, "", all}};
  for (const auto& [side, label] :
       {std::pair{BodySide::left, "left hand"}, std::pair{BodySide::right, "right hand"}}) {
    if (whole.hand_only) break;
    Shot hand{{}, false, label, {}};
    for (const std::size_t i : all) {
      const std::int32_t joint = cell.marks[i].joint;
      if (whole.fingers[joint] >= 0 && whole.sides[joint] == side) hand.marks.push_back(i);
    }
    if (hand.marks.empty()) continue;
    hand.plan = hand_plan_of(character, side);
    if (!hand.plan.hand_only) continue;
    std::erase_if(shots[0].marks, [&](std::size_t i) {  // they would hide the small hand
      return std::find(hand.marks.begin(), hand.marks.end(), i) != hand.marks.end();
    });
    shots.push_back(std::move(hand));
  }
  if (shots.size() == 1) {
    const char* label = whole.hand_only ? "thumb's side" : whole.stands ? "side" : "from above";
    shots.push_back({whole, true, label, all});
  }
  return shots;
}

/// The widths of a card's pictures: a body's whole figure gets the most room.
std::vector<Box> boxes_of(const std::vector<Shot>& shots) {
  const auto count = static_cast<std::int32_t>(shots.size());
  const std::int32_t room = kCardWidth - 2 * kPadding - (count - 1) * kViewGap;
  const double share = shots[0].plan.hand_only ? 0.5 : count == 2 ? 0.58 : 0.38;
  const auto first = static_cast<std::int32_t>(share * room);
  std::vector<Box> boxes;
  std::int32_t x = kPadding;
  for (std::int32_t i = 0; i < count; ++i) {
    const std::int32_t width = i == 0 ? first : (room - first) / (count - 1);
    boxes.push_back({x, 0, width, kViewHeight});
    x += width + kViewGap;
  }
  return boxes;
}

/// Rests on the floor y = 0, or on the lowest level that the figure at rest touches, where that is
/// clearly another one.
double floor_of(const Character& character, const BodyPlan& plan) {
  if (!plan.stands) return 0.0;
  FigureModel model(character, plan, {});
  std::vector<DualQuaternion> rest(character.skeleton.parents.size());
  model_from_local(character.skeleton, character.skeleton.rest_parent_from_joint, rest);
  Bounds bounds;
  for (const Vector3d& p : points_of(model.pose(rest, 1.0, Vector3d::Zero()))) bounds.include(p);
  const double lowest = bounds.low.y(), size = bounds.size();
  return lowest < -0.1 * size || lowest > 0.5 * size ? lowest : 0.0;
}

/// What neither stands nor is a hand (an arm, a tool) is seen from above, front at the bottom.
ViewDirection view_from_above(const Eigen::Vector3d& forward) {
  ViewDirection view;
  view.towards_eye = (Vector3d::UnitY() + 0.25 * forward).normalized();
  view.up = -forward;
  view.ground = false;
  return view;
}

/// The view's direction: a body keeps the one it has at rest, so that its turns show; a hand is
/// followed.
ViewDirection direction_of(const Shot& shot, const Skeleton& skeleton,
                           std::span<const DualQuaternion> posed) {
  std::vector<DualQuaternion> rest(posed.size());
  model_from_local(skeleton, skeleton.rest_parent_from_joint, rest);
  const std::span<const DualQuaternion> seen = shot.plan.hand_only ? posed : rest;
  if (!shot.side) return front_view(skeleton, shot.plan, seen);
  if (shot.plan.hand_only || shot.plan.stands) return side_view(skeleton, shot.plan, seen);
  return view_from_above(facing_of(shot.plan, seen));
}

class Artist {
 public:
  Artist(const Character& character, const BodyPlan& whole)
      : character_(character), floor_y_(floor_of(character, whole)) {}

  /// Draws one shot of a cell into a box of the canvas.
  PoseView draw(Canvas&, const Box&, const PoseCell&, const Shot&) const;

 private:
  const Character& character_;
  double floor_y_;  // drawn as y = 0
};

PoseView Artist::draw(Canvas& canvas, const Box& box, const PoseCell& cell,
                      const Shot& shot) const {
  std::vector<DualQuaternion> model(character_.skeleton.parents.size());
  model_from_local(character_.skeleton, cell.parent_from_joint, model);
  ViewDirection view = direction_of(shot, character_.skeleton, model);
  Vector3d shift(0.0, -floor_y_, 0.0);
  if (model[shot.plan.pelvis].translation().norm() > kFarAway) {  // surfaces are single precision
    shift = -model[shot.plan.pelvis].translation();
    view.ground = false;
  }
  const auto moved =
      DualQuaternion::from_rotation_translation(Eigen::Quaterniond::Identity(), shift);
  for (DualQuaternion& joint : model) joint = moved * joint;
  FigureModel figure(character_, shot.plan, cell.tinted_joints);
  CellScene scene;
  scene.surfaces = figure.pose(model, 1.0, Vector3d::Zero());
  scene.anchor = model[shot.plan.pelvis].translation();
  std::vector<Vector3d> points = points_of(scene.surfaces);
  Bounds bounds;
  for (const Vector3d& p : points) bounds.include(p);
  scene.size = bounds.size();
  const double most = kMostMissed * scene.size, axis = kAxis * scene.size;
  std::vector<PoseMark> marks;
  for (const std::size_t i : shot.marks) {
    marks.push_back(cell.marks[i]);
    for (const Vector3d& p : extent_of(cell.marks[i], axis, most)) points.push_back(p + shift);
  }
  const std::int32_t room = box.height - (*shot.label != '\0' ? kLabel : 0);
  RowCamera framing(view, box.width, room);
  framing.include(points, scene.anchor);
  const std::int32_t height = framing.fit();
  scene.camera = framing.at(scene.anchor);
  scene.camera.centre_px.y() += (view.ground ? 1.0 : 0.5) * (room - height);
  scene.ground = view.ground;
  scene.up = view.up;
  draw_scene(canvas, box, scene);

  PoseView out{0, box, scene.camera};
  out.camera.eye -= shift;
  out.camera.centre_px += Eigen::Vector2d(box.x, box.y);
  draw_pose_marks(canvas, box, out.camera, marks, axis, most);
  canvas.text(box.x + 9, box.y + box.height - 9, shot.label, 9, palette::kMuted);
  return out;
}

void draw_badge(Canvas& canvas, double right, double base, const std::string& verdict) {
  std::string word = verdict;
  for (char& c : word) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  const auto width = static_cast<std::int32_t>(Canvas::text_width(word, 9) + 24);
  const auto x = static_cast<std::int32_t>(right) - width;
  canvas.rounded({x, static_cast<std::int32_t>(base) - 17, width, 25}, 12.5,
                 color_of_verdict(verdict));
  canvas.text(x + 0.5 * width, base, word, 9, {255, 255, 255}, Align::centre, 1.4);
}

/// Title and what the rig is; description and legend below.
void draw_head(Canvas& canvas, const PoseSheet& sheet, const BodyPlan& whole, bool tinted,
               std::int32_t width) {
  const double right = kMargin + width, base = kMargin + 22, below = kMargin + 62;
  const double detail = Canvas::text_width(sheet.detail, 10) + 30;
  canvas.text(kMargin, base, Canvas::fitted(sheet.title, 19, width - detail), 19, palette::kInk,
              Align::left, 0.95);
  canvas.text(right, base, sheet.detail, 10, palette::kMuted, Align::right);
  const double legend = draw_legend(canvas, {right, below}, whole, true, tinted);
  const double room = legend - kMargin;
  if (room < 60.0) return;
  canvas.text(kMargin, below, Canvas::fitted(sheet.description, 10, room), 10, palette::kMuted);
}

/// The text on two lines, broken after a comma; the second is cut where it is too long.
std::array<std::string, 2> in_two_lines(const std::string& text, double room) {
  std::size_t end = text.size();
  while (Canvas::text_width(text.substr(0, end), 10) > room) {
    const std::size_t comma = text.rfind(", ", end - 2);
    if (comma == std::string::npos || comma < 2) return {Canvas::fitted(text, 10, room), ""};
    end = comma + 1;
  }
  if (end == text.size()) return {text, ""};
  return {text.substr(0, end), Canvas::fitted(text.substr(end + 1), 10, room)};
}

/// Name and verdict above the pictures, figures below.
void draw_words(Canvas& canvas, const Box& card, const PoseCell& cell) {
  const double left = card.x + kPadding, right = card.x + card.width - kPadding;
  const double room = right - left;
  canvas.text(left, card.y + 30, Canvas::fitted(cell.name, 13, room - 150), 13, palette::kInk,
              Align::left, 1.2);
  draw_badge(canvas, right, card.y + 29, cell.verdict);
  double y = card.y + kTitle + kViewHeight + kLine + 2;
  for (const std::string& line : cell.lines) {
    canvas.text(left, y, Canvas::fitted(line, 10, room), 10, palette::kInk);
    y += kLine;
  }
  for (const std::string& line : in_two_lines(cell.limit_line, room)) {
    canvas.text(left, y, line, 10, cell.tinted_joints.empty() ? palette::kMuted : palette::kTint);
    y += kLine;
  }
}

}  // namespace

Result<PosePicture> render_pose_sheet(const PoseSheet& sheet) {
  if (sheet.character == nullptr || sheet.cells.empty()) return invalid("there is no pose to draw");
  std::size_t lines = 0;
  bool tinted = false;
  for (const PoseCell& cell : sheet.cells) {
    if (cell.parent_from_joint.size() != sheet.character->skeleton.parents.size()) {
      return invalid("a pose does not fit the character's joints");
    }
    lines = std::max(lines, cell.lines.size() + 2);
    tinted = tinted || !cell.tinted_joints.empty();
  }
  const BodyPlan whole = plan_of(*sheet.character);
  const std::size_t count = sheet.cells.size();
  const std::size_t columns = count == 4 ? 2 : std::min(count, kMostColumns);
  const std::size_t rows = (count + columns - 1) / columns;
  const auto card_height = kTitle + kViewHeight + static_cast<std::int32_t>(lines) * kLine + kFoot;
  const auto across = [](std::size_t n, std::int32_t size) {
    return static_cast<std::int32_t>(n) * (size + kGap) - kGap;
  };
  const std::int32_t width = across(columns, kCardWidth), height = across(rows, card_height);
  Canvas canvas(width + 2 * kMargin, height + kHead + 2 * kMargin, palette::kPage);
  draw_head(canvas, sheet, whole, tinted, width);
  const Artist artist(*sheet.character, whole);
  PosePicture picture;
  for (std::size_t i = 0; i < count; ++i) {
    const PoseCell& cell = sheet.cells[i];
    const auto column = static_cast<std::int32_t>(i % columns);
    const auto row = static_cast<std::int32_t>(i / columns);
    const Box card{kMargin + column * (kCardWidth + kGap),
                   kMargin + kHead + row * (card_height + kGap), kCardWidth, card_height};
    canvas.rounded(card, 10.0, palette::kCard);
    draw_words(canvas, card, cell);
    const std::vector<Shot> shots = shots_of(*sheet.character, cell);
    const std::vector<Box> boxes = boxes_of(shots);
    for (std::size_t s = 0; s < shots.size(); ++s) {
      Box box = boxes[s];
      box.x += card.x;
      box.y = card.y + kTitle;
      picture.views.push_back(artist.draw(canvas, box, cell, shots[s]));
      picture.views.back().pose = static_cast<std::int32_t>(i);
    }
  }
  picture.image = canvas.take();
  return picture;
}

}  // namespace limber
