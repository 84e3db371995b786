#include "tools/shale/npy.h"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <string_view>

#include "ir/base/file.h"

namespace shale {
namespace {

constexpr std::string_view kMagic = "\x93NUMPY";

std::string_view descr_of(DType dtype) {
  switch (dtype) {
    case DType::kBool: return "|b1";
    case DType::kInt4:
    case DType::kFp8E4M3:
    case DType::kFp8E5M2:
    case DType::kInt8: return "|i1";
    case DType::kBf16:
    case DType::kInt16: return "<i2";
    case DType::kInt32: return "<i4";
    case DType::kFp16: return "<f2";
    case DType::kFp32: return "<f4";
    default: return "<i8";
  }
}

/// The text after `'key':` in a header that NumPy writes as a Python dictionary.
std::string_view field(std::string_view header, std::string_view key) {
  const size_t at = header.find(fmt::format("'{}':", key));
  if (at == std::string_view::npos) return {};
  std::string_view rest = header.substr(at + key.size() + 3);
  rest.remove_prefix(std::min(rest.find_first_not_of(' '), rest.size()));
  return rest;
}

Result<Shape> parse_shape(const std::string& path, std::string_view text) {
  Shape shape;
  if (text.empty() || text[0] != '(') return bad_input(path, "the npy header has no shape");
  text.remove_prefix(1);
  for (;;) {
    text.remove_prefix(std::min(text.find_first_not_of(" ,"), text.size()));
    if (!text.empty() && text[0] == ')') return shape;
    int64_t dim = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), dim);
    if (error != std::errc()) return bad_input(path, "the npy header's shape is broken");
    shape.push_back(dim);
    text.remove_prefix(static_cast<size_t>(end - text.data()));
  }
}

struct Header {
  std::string_view text;
  Shape shape;
  size_t data_at;
};

/// Of the file at `path`, whose bytes these are; borrows them.
Result<Header> parse_header(const std::string& path, const std::vector<uint8_t>& bytes) {
  if (bytes.size() < 12 ||
      !std::equal(kMagic.begin(), kMagic.end(), bytes.begin(),
                  [](char a, uint8_t b) { return static_cast<uint8_t>(a) == b; }))
    return bad_input(path, "is no npy file");
  const bool long_header = bytes[6] >= 2;
  size_t header_size = bytes[8] | (bytes[9] << 8);
  if (long_header)
    header_size |= (static_cast<size_t>(bytes[10]) << 16) | (static_cast<size_t>(bytes[11]) << 24);
  const size_t header_at = long_header ? 12 : 10;
  if (bytes.size() - header_at < header_size)
    return bad_input(path, "the npy header of {} bytes is cut off", header_size);
  const std::string_view header(reinterpret_cast<const char*>(bytes.data()) + header_at,
                                header_size);
  SHALE_TRY(Shape shape, parse_shape(path, field(header, "shape")));
  return Header{header, std::move(shape), header_at + header_size};
}

/// The bytes of the elements, which must be of type `descr` and have this shape, `element_bytes` each.
/// `meant` goes into the message.
Result<std::vector<uint8_t>> read_array(const std::string& path, std::string_view descr,
                                        const Shape& wanted_shape, int64_t element_bytes,
                                        std::string_view meant) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
  SHALE_TRY(const Header parsed, parse_header(path, bytes));
  const auto& [header, shape, data_at] = parsed;
  const std::string_view found = field(header, "descr");
  const std::string wanted = fmt::format("'{}'", descr);
  if (!found.starts_with(wanted))
    return bad_input(path, "found element type {}, expected {} for {}",
                     found.substr(0, found.find(',')), wanted, meant);
  if (!field(header, "fortran_order").starts_with("False"))
    return bad_input(path, "is in Fortran order, expected C order");
  if (shape != wanted_shape)
    return bad_input(path, "found shape {}, expected {}", shape_text(shape),
                     shape_text(wanted_shape));
  const std::optional<int64_t> count = element_count(shape);
  if (!count) return bad_input(path, "shape {} is not supported", shape_text(shape));
  const size_t size = static_cast<size_t>(*count * element_bytes);
  if (bytes.size() - data_at < size)
    return bad_input(path, "found {} bytes of data, expected {}", bytes.size() - data_at, size);
  const auto data = bytes.begin() + static_cast<std::ptrdiff_t>(data_at);
  return std::vector<uint8_t>(data, data + static_cast<std::ptrdiff_t>(size));
}

}  // namespace

Result<Shape> npy_shape(const std::string& path) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
  SHALE_TRY(Header header, parse_header(path, bytes));
  return std::move(header.shape);
}

Result<Tensor> read_npy(const std::string& path, const TensorType& type) {
  const DTypeInfo& info = dtype_info(type.dtype);
  Tensor tensor{type, {}};
  SHALE_TRY(tensor.bytes,
            read_array(path, descr_of(type.dtype), type.shape, info.host_bytes, info.wire));
  return tensor;
}

Result<std::vector<double>> read_npy_doubles(const std::string& path, const Shape& shape) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_array(path, "<f8", shape, 8, "float64"));
  std::vector<double> values(bytes.size() / 8);
  std::memcpy(values.data(), bytes.data(), bytes.size());
  return values;
}

namespace {

Result<void> write_array(const std::string& path, std::string_view descr, const Shape& shape,
                         std::span<const uint8_t> bytes) {
  std::string dims = fmt::format("{}", fmt::join(shape, ", "));
  if (shape.size() == 1) dims += ",";
  std::string header =
      fmt::format("{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}", descr, dims);
  header.append(63 - (10 + header.size()) % 64, ' ');
  header += '\n';
  std::string file(kMagic);
  file += {'\x01', '\x00', static_cast<char>(header.size() & 255),
           static_cast<char>(header.size() >> 8)};
  file += header;
  file.append(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  return write_text(path, file);
}

}  // namespace

Result<void> write_npy(const std::string& path, const Tensor& tensor) {
  return write_array(path, descr_of(tensor.type.dtype), tensor.type.shape, tensor.bytes);
}

Result<void> write_npy(const std::string& path, const Shape& shape,
                       std::span<const double> values) {
  return write_array(path, "<f8", shape,
                     {reinterpret_cast<const uint8_t*>(values.data()), values.size_bytes()});
}

Result<void> write_npy(const std::string& path, const FloatImage& image) {
  return write_array(
      path, "<f4", {image.height, image.width, image.channels},
      {reinterpret_cast<const uint8_t*>(image.values.data()), image.values.size() * sizeof(float)});
}

}  // namespace shale
