#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "importers/failure.h"
#include "importers/gltf_document.h"

namespace limber::gltf {

namespace {

constexpr std::int64_t kMaxCount = std::int64_t{1} << 31;
/// An accessor without data is all zeros and must not be used to ask for memory.
constexpr std::size_t kMaxZeros = std::size_t{1} << 24;

struct Layout {
  std::size_t rows = 1, columns = 1;
  std::size_t component_bytes = 4;
  std::int64_t component_type = 5126;
  bool normalized = false;

  /// Columns of matrices start at multiples of four bytes (glTF 2.0, 3.6.2.4).
  std::size_t column_bytes() const {
    const std::size_t bytes = rows * component_bytes;
    return columns == 1 ? bytes : (bytes + 3) / 4 * 4;
  }
  std::size_t element_bytes() const {
    return columns == 1 ? column_bytes() : (columns - 1) * column_bytes() + rows * component_bytes;
  }
  std::size_t components() const { return rows * columns; }
};

Layout layout_of(const JsonView& view) {
  Layout layout;
  const std::string& type = view.at("type").string();
  constexpr std::array<std::pair<const char*, std::pair<int, int>>, 7> kTypes = {
      {{"SCALAR", {1, 1}},
       {"VEC2", {2, 1}},
       {"VEC3", {3, 1}},
       {"VEC4", {4, 1}},
       {"MAT2", {2, 2}},
       {"MAT3", {3, 3}},
       {"MAT4", {4, 4}}}};
  bool known = false;
  for (const auto& [name, shape] : kTypes) {
    if (type != name) continue;
    layout.rows = static_cast<std::size_t>(shape.first);
    layout.columns = static_cast<std::size_t>(shape.second);
    known = true;
  }
  if (!known) view.at("type").complain(fmt::format("'{}' is no accessor type", type));
  layout.component_type = view.at("componentType").integer(5120, 5126);
  constexpr std::array<std::size_t, 7> kBytes = {1, 1, 2, 2, 0, 4, 4};
  layout.component_bytes = kBytes[static_cast<std::size_t>(layout.component_type - 5120)];
  if (layout.component_bytes == 0) view.at("componentType").complain("5124 is not a glTF type");
  if (const auto normalized = view.find("normalized")) layout.normalized = normalized->boolean();
  if (layout.normalized && layout.component_type >= 5125) {
    view.at("normalized").complain("only 8 and 16 bit integers can be normalised");
  }
  return layout;
}

template <class T>
T load(const std::byte* from) {
  T value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

/// glTF 2.0, 3.6.2.2: signed values map to [-1, 1] with both -MAX and -MAX-1 at -1.
double component(const std::byte* from, const Layout& layout) {
  static_assert(std::endian::native == std::endian::little);
  const bool n = layout.normalized;
  switch (layout.component_type) {
    case 5120:
      return n ? std::max(load<std::int8_t>(from) / 127.0, -1.0) : load<std::int8_t>(from);
    case 5121:
      return n ? load<std::uint8_t>(from) / 255.0 : load<std::uint8_t>(from);
    case 5122:
      return n ? std::max(load<std::int16_t>(from) / 32767.0, -1.0) : load<std::int16_t>(from);
    case 5123:
      return n ? load<std::uint16_t>(from) / 65535.0 : load<std::uint16_t>(from);
    case 5125:
      return load<std::uint32_t>(from);
    default:
      return static_cast<double>(load<float>(from));
  }
}

void decode_element(const std::byte* from, const Layout& layout, double* to) {
  for (std::size_t c = 0; c < layout.columns; ++c) {
    for (std::size_t r = 0; r < layout.rows; ++r) {
      *to++ = component(from + c * layout.column_bytes() + r * layout.component_bytes, layout);
    }
  }
}

std::size_t offset_of(const JsonView& view) {
  const auto offset = view.find("byteOffset");
  return static_cast<std::size_t>(offset ? offset->integer(0, kMaxCount) : 0);
}

[[noreturn]] void beyond(const JsonView& view) {
  fail("gltf-accessor", fmt::format("{}: it reaches beyond its bufferView", view.pointer()),
       "the file is damaged: export it again");
}

/// `count` elements of `stride` bytes, the last one only as long as it needs to be, lie within.
bool fits(std::size_t available, std::size_t offset, std::size_t count, std::size_t stride,
          std::size_t element) {
  if (count == 0) return true;
  if (offset > available || element > available - offset) return false;
  return count - 1 <= (available - offset - element) / stride;
}

}  // namespace

const Accessor& Document::accessor(std::int64_t index,
                                   std::initializer_list<std::string_view> types,
                                   bool allow_non_finite) {
  const JsonView view = item("accessors", index);
  const std::string& type = view.at("type").string();
  if (std::find(types.begin(), types.end(), type) == types.end()) {
    view.at("type").complain(fmt::format("'{}' cannot be used here", type));
  }
  const auto known = accessors_.find(index);
  if (known != accessors_.end()) return known->second;
  return accessors_.emplace(index, decode(view, allow_non_finite)).first->second;
}

Accessor Document::decode(const JsonView& view, bool allow_non_finite) const {
  const Layout layout = layout_of(view);
  Accessor out;
  out.count = static_cast<std::size_t>(view.at("count").integer(1, kMaxCount));
  out.components = layout.components();
  out.integers = layout.component_type != 5126 && !layout.normalized;
  const std::int64_t source = index_of(view, "bufferView", "bufferViews");
  if (source < 0) {
    if (out.count > kMaxZeros) beyond(view);
    out.values.assign(out.count * out.components, 0.0);
  } else {
    const std::span<const std::byte> bytes = buffer_view(source);
    const auto stride_view = item("bufferViews", source).find("byteStride");
    const auto stride = static_cast<std::size_t>(
        stride_view ? stride_view->integer(4, 252)
                    : static_cast<std::int64_t>(layout.columns * layout.column_bytes()));
    const std::size_t offset = offset_of(view);
    if (stride < layout.element_bytes()) view.complain("elements overlap: the stride is too small");
    if (!fits(bytes.size(), offset, out.count, stride, layout.element_bytes())) beyond(view);
    out.values.resize(out.count * out.components);
    for (std::size_t i = 0; i < out.count; ++i) {
      decode_element(bytes.data() + offset + i * stride, layout,
                     out.values.data() + i * out.components);
    }
  }
  if (const auto sparse = view.find("sparse")) decode_sparse(view, *sparse, out);
  for (std::size_t i = 0; i < out.values.size() && !allow_non_finite; ++i) {
    if (!std::isfinite(out.values[i])) {
      fail("gltf-nan",
           fmt::format("{}: element {} is not finite", view.pointer(), i / out.components),
           "repair it in the tool that wrote the file");
    }
  }
  return out;
}

void Document::decode_sparse(const JsonView& view, const JsonView& sparse, Accessor& out) const {
  const Layout layout = layout_of(view);
  const auto count =
      static_cast<std::size_t>(sparse.at("count").integer(1, static_cast<std::int64_t>(out.count)));
  const JsonView indices = sparse.at("indices");
  const JsonView values = sparse.at("values");
  Layout index_layout;
  index_layout.component_type = indices.at("componentType").integer(5121, 5125);
  index_layout.component_bytes = index_layout.component_type == 5121   ? 1
                                 : index_layout.component_type == 5123 ? 2
                                                                       : 4;
  if (index_layout.component_type == 5122 || index_layout.component_type == 5124) {
    indices.at("componentType").complain("sparse indices are unsigned");
  }
  const std::span<const std::byte> index_bytes =
      buffer_view(indices.at("bufferView").integer(0, kMaxCount));
  const std::span<const std::byte> value_bytes =
      buffer_view(values.at("bufferView").integer(0, kMaxCount));
  const std::size_t index_offset = offset_of(indices);
  const std::size_t value_offset = offset_of(values);
  const std::size_t element = layout.columns * layout.column_bytes();
  if (!fits(index_bytes.size(), index_offset, count, index_layout.component_bytes,
            index_layout.component_bytes)) {
    beyond(indices);
  }
  if (!fits(value_bytes.size(), value_offset, count, element, layout.element_bytes())) {
    beyond(values);
  }
  for (std::size_t k = 0; k < count; ++k) {
    const double i = component(index_bytes.data() + index_offset + k * index_layout.component_bytes,
                               index_layout);
    if (!(i < double(out.count))) indices.complain("an index is out of range");
    decode_element(value_bytes.data() + value_offset + k * element, layout,
                   out.values.data() + static_cast<std::size_t>(i) * out.components);
  }
}

}  // namespace limber::gltf
