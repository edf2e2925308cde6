#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/result.h"

namespace limber {

/// 8-bit RGBA, row-major, not premultiplied.
struct TextureImage {
  std::int32_t width = 0, height = 0;
  std::vector<std::uint8_t> rgba;
};

/// Decodes a PNG or a JPEG, told apart by their first bytes.
/// Errors: `image-unsupported` (neither of them), `image-broken`, `image-too-large`.
Result<TextureImage> decode_image(std::span<const std::byte>);

}  // namespace limber
