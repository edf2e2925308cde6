#include "validation/image_io.h"

#include <jpeglib.h>  // needs cstdio before it
#include <png.h>

#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <memory>

#include "validation/contact_sheet.h"

namespace limber {
namespace {

constexpr std::int64_t kMostPixels = 8192LL * 8192LL;

Error broken(const char* reason) {
  return {.code = "image-broken",
          .message = std::string("the picture cannot be decoded: ") + reason,
          .hint = "save the texture anew; the figure is drawn without it"};
}

Error too_large() {
  return {.code = "image-too-large",
          .message = "the picture has more than 8192 x 8192 pixels",
          .hint = "scale the texture down; the figure is drawn without it"};
}

Result<TextureImage> decode_png(std::span<const std::byte> bytes) {
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  if (!png_image_begin_read_from_memory(&png, bytes.data(), bytes.size())) {
    return broken(png.message);
  }
  const std::unique_ptr<png_image, decltype(&png_image_free)> release(&png, &png_image_free);
  if (std::int64_t(png.width) * png.height > kMostPixels) return too_large();
  png.format = PNG_FORMAT_RGBA;
  TextureImage image;
  image.width = static_cast<std::int32_t>(png.width);
  image.height = static_cast<std::int32_t>(png.height);
  image.rgba.resize(PNG_IMAGE_SIZE(png));
  if (!png_image_finish_read(&png, nullptr, image.rgba.data(), 0, nullptr)) {
    return broken(png.message);
  }
  return image;
}

struct JpegFailure {
  jpeg_error_mgr manager;  // first: libjpeg hands back a pointer to it
  std::jmp_buf escape;
  char message[JMSG_LENGTH_MAX];
};

[[noreturn]] void leave_jpeg(j_common_ptr info) {
  auto* failure = reinterpret_cast<JpegFailure*>(info->err);
  info->err->format_message(info, failure->message);
  std::longjmp(failure->escape, 1);
}

void stay_silent(j_common_ptr, int) {}

/// Reads header and pixels into `image`; false: `failure` says why. Holds no object with a
/// destructor, for longjmp skips them.
bool read_jpeg(std::span<const std::byte> bytes, JpegFailure& failure, TextureImage& image,
               bool& large) {
  jpeg_decompress_struct info;
  info.err = jpeg_std_error(&failure.manager);
  failure.manager.error_exit = leave_jpeg;
  failure.manager.emit_message = stay_silent;
  jpeg_create_decompress(&info);
  if (setjmp(failure.escape)) {
    jpeg_destroy_decompress(&info);
    return false;
  }
  jpeg_mem_src(&info, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
  jpeg_read_header(&info, TRUE);
  large = std::int64_t(info.image_width) * info.image_height > kMostPixels;
  if (large) {
    jpeg_destroy_decompress(&info);
    return true;
  }
  info.out_color_space = JCS_EXT_RGBA;
  jpeg_start_decompress(&info);
  image.width = static_cast<std::int32_t>(info.output_width);
  image.height = static_cast<std::int32_t>(info.output_height);
  image.rgba.resize(std::size_t(image.width) * image.height * 4);
  while (info.output_scanline < info.output_height) {
    JSAMPROW row = image.rgba.data() + std::size_t(info.output_scanline) * image.width * 4;
    jpeg_read_scanlines(&info, &row, 1);
  }
  jpeg_finish_decompress(&info);
  jpeg_destroy_decompress(&info);
  return true;
}

Result<TextureImage> decode_jpeg(std::span<const std::byte> bytes) {
  JpegFailure failure{};
  TextureImage image;
  bool large = false;
  if (!read_jpeg(bytes, failure, image, large)) return broken(failure.message);
  if (large) return too_large();
  return image;
}

void append_bytes(png_structp png, png_bytep data, png_size_t size) {
  auto* out = static_cast<std::vector<std::byte>*>(png_get_io_ptr(png));
  const auto* bytes = reinterpret_cast<const std::byte*>(data);
  out->insert(out->end(), bytes, bytes + size);
}

bool write_png(const Image& image, std::vector<std::byte>& out) {
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  if (png == nullptr) return false;
  png_infop info = png_create_info_struct(png);
  if (info == nullptr || setjmp(png_jmpbuf(png))) {
    png_destroy_write_struct(&png, &info);
    return false;
  }
  png_set_write_fn(png, &out, append_bytes, nullptr);
  png_set_IHDR(png, info, static_cast<png_uint_32>(image.width),
               static_cast<png_uint_32>(image.height), 8, PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_set_compression_level(png, 3);
  // Sheets are flat colours and repeated cells: filtered rows take twice the time to write and come
  // out no shorter.
  png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_NONE);
  png_write_info(png, info);
  for (std::int32_t y = 0; y < image.height; ++y) {
    png_write_row(png, image.rgb.data() + std::size_t(y) * image.width * 3);
  }
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
  return true;
}

}  // namespace

Result<TextureImage> decode_image(std::span<const std::byte> bytes) {
  const auto starts_with = [&](std::initializer_list<unsigned char> magic) {
    return bytes.size() >= magic.size() &&
           std::memcmp(bytes.data(), magic.begin(), magic.size()) == 0;
  };
  if (starts_with({0x89, 'P', 'N', 'G'})) return decode_png(bytes);
  if (starts_with({0xFF, 0xD8, 0xFF})) return decode_jpeg(bytes);
  return Error{.code = "image-unsupported",
               .message = "the picture is neither PNG nor JPEG",
               .hint = "save the texture as PNG; the figure is drawn without it"};
}

Result<std::vector<std::byte>> encode_png(const Image& image) {
  const bool sized = image.width > 0 && image.height > 0 &&
                     image.rgb.size() == std::size_t(image.width) * image.height * 3;
  std::vector<std::byte> bytes;
  if (!sized || !write_png(image, bytes)) {
    return Error{.code = "png-encode", .message = "the picture cannot be encoded as PNG"};
  }
  return bytes;
}

}  // namespace limber
