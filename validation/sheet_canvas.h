#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>

#include "validation/contact_sheet.h"

namespace limber {

struct Rgb {
  std::uint8_t r = 0, g = 0, b = 0;
};

/// The sheet's few colours.
namespace palette {
inline constexpr Rgb kPage{244, 246, 248}, kCard{255, 255, 255}, kRule{221, 225, 231};
inline constexpr Rgb kInk{24, 32, 46}, kMuted{98, 107, 122}, kFaint{150, 158, 170};
inline constexpr Rgb kLeft{66, 135, 200}, kRight{236, 144, 58};
inline constexpr Rgb kTarget{214, 40, 40}, kReached{28, 160, 80};
inline constexpr Rgb kPass{28, 140, 84}, kWarn{206, 124, 14}, kFail{198, 40, 40};
inline constexpr Rgb kTint{150, 60, 220}, kGhost{24, 52, 110};
inline constexpr std::array<Rgb, 5> kFingers{
    Rgb{236, 144, 58}, {66, 135, 200}, {60, 172, 156}, {176, 172, 70}, {214, 106, 158}};
inline constexpr std::array kFingerNames{"thumb", "index", "middle", "ring", "little"};
}  // namespace palette

struct Box {
  std::int32_t x = 0, y = 0, width = 0, height = 0;
};

enum class Align : std::uint8_t { left, centre, right };

/// What is drawn with lines and letters. Coordinates in pixels, y down; smooth edges.
class Canvas {
 public:
  Canvas(std::int32_t width, std::int32_t height, Rgb background);

  void fill(const Box&, Rgb, double opacity = 1.0);
  void rounded(const Box&, double radius, Rgb);
  void line(const Eigen::Vector2d& a, const Eigen::Vector2d& b, double width, Rgb,
            double opacity = 1.0);
  void disc(const Eigen::Vector2d& centre, double radius, Rgb, double opacity = 1.0);

  /// `y` is the baseline; `size` the height of capitals in pixels; weight 1 is regular. Other
  /// characters than printable ASCII become '?'. Returns the width drawn.
  double text(double x, double y, const std::string&, double size, Rgb, Align = Align::left,
              double weight = 1.0);
  static double text_width(const std::string&, double size);
  /// The text, cut with ".." so that it fits.
  static std::string fitted(const std::string&, double size, double width);

  void blend(std::int32_t x, std::int32_t y, Rgb, float opacity);
  std::uint8_t* at(std::int32_t x, std::int32_t y) {
    return image_.rgb.data() + (std::size_t(y) * image_.width + x) * 3;
  }
  Image take() { return std::move(image_); }

 private:
  /// Blends by the signed distance to a shape, for pixels inside the box.
  template <class Distance>
  void shape(double x0, double y0, double x1, double y1, Rgb, double opacity, Distance);

  Image image_;
};

}  // namespace limber
