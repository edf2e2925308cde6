#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/clip.h"
#include "assets/model/result.h"
#include "assets/model/rig.h"

namespace limber {

/// 8-bit RGB, row-major, no padding.
struct Image {
  std::int32_t width = 0, height = 0;
  std::vector<std::uint8_t> rgb;
};

Result<std::vector<std::byte>> encode_png(const Image&);

/// One figure of the sheet: a character and its motion. A character without meshes is drawn as
/// bones with volume.
struct SheetFigure {
  const Character* character = nullptr;
  const Clip* clip = nullptr;
  std::string label;   ///< ASCII is drawn; other characters become '?'
  double scale = 1.0;  ///< draws the figure larger or smaller (source to target size)
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
};

struct EffectorMark {
  Eigen::Vector3d target;   ///< red
  Eigen::Vector3d reached;  ///< green
};

struct LimitTime {
  std::string joint;
  double share = 0.0;  ///< of the frames in which it stands on a limit, 0 to 1
};

struct ContactSheet {
  std::string title;                     ///< e.g. "walk@hero"
  std::string verdict;                   ///< pass, warn, fail
  std::vector<std::string> key_figures;  ///< short lines for the head
  SheetFigure source;                    ///< character may be null: target alone
  SheetFigure target;
  std::vector<std::vector<EffectorMark>> marks;  ///< [target frame][effector]; may be empty
  std::vector<double> error_mm;  ///< [target frame], worst effector error; may be empty
  /// [target frame], m/s, of whatever is fastest; the source's at the target's size. May be empty.
  std::vector<double> speed, source_speed;
  std::vector<std::uint8_t> left_contact, right_contact;  ///< [target frame]; may be empty
  std::vector<std::int64_t> frames;         ///< frames of the target to draw; empty: 10 chosen
  std::vector<std::int32_t> tinted_joints;  ///< joints on a limit somewhere; may be empty
  std::vector<LimitTime> at_limit;          ///< most first; may be empty
  /// Size of the source's bones that are drawn over the target, pelvis on pelvis; 0: none.
  double ghost_scale = 0.0;
};

/// Draws source and target side by side for 8-12 frames, close-ups of hands whose fingers move, and
/// along time the error, the speed and the contacts. Same input, same pixels.
Result<Image> render_contact_sheet(const ContactSheet&);

}  // namespace limber
