#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "validation/rasteriser.h"
#include "validation/sheet_canvas.h"

namespace limber {

/// One effector of a pose: the ideal frame (red) and the one that was reached (green), in world
/// space (Kenwright 2013, section III and figures 5 to 7).
struct PoseMark {
  std::int32_t joint = 0;  ///< of the skeleton, which carries the effector
  DualQuaternion target;
  DualQuaternion reached;
  bool oriented = true;  ///< false: a point alone is asked for, no axes are drawn
};

struct PoseCell {
  std::string name;
  std::string verdict;                            ///< reached, best reach, failed
  std::vector<DualQuaternion> parent_from_joint;  ///< on the character's skeleton
  std::vector<PoseMark> marks;
  std::vector<std::int32_t> tinted_joints;  ///< on a limit
  std::vector<std::string> lines;           ///< below the picture; too long ones are cut
  std::string limit_line;                   ///< last, in the tint's colour, over two lines
};

struct PoseSheet {
  std::string title, detail, description;  ///< cut where too long
  const Character* character = nullptr;
  std::vector<PoseCell> cells;  ///< at least one
};

/// One picture of a pose. The camera projects world points to pixels of the whole sheet; what is
/// outside of the box is not drawn.
struct PoseView {
  std::int32_t pose = 0;
  Box box;
  Camera camera;
};

struct PosePicture {
  Image image;
  std::vector<PoseView> views;
};

/// Draws a card per pose: a body from the front and from the side, or close to the hand whose
/// fingers are pulled; a hand from its back and from the thumb's side. Same input, same pixels.
/// Error: `sheet-input`.
Result<PosePicture> render_pose_sheet(const PoseSheet&);

}  // namespace limber
