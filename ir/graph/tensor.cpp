#include "ir/graph/tensor.h"

#include "ir/base/float_format.h"
#include "ir/base/half.h"

namespace shale {

std::string shape_text(const Shape& shape) {
  std::string text = "[";
  for (size_t i = 0; i < shape.size(); ++i) {
    if (i > 0) text += ',';
    text += shape[i] == kDynamic ? "?" : std::to_string(shape[i]);
  }
  return text + "]";
}

std::string type_text(const TensorType& type) {
  return std::string(dtype_info(type.dtype).name) + shape_text(type.shape);
}

Tensor Tensor::zeros(TensorType type) {
  const std::optional<int64_t> count = element_count(type.shape);
  SHALE_CHECK(count.has_value());
  Tensor tensor{std::move(type), {}};
  tensor.bytes.resize(static_cast<size_t>(*count * tensor.host_bytes()));
  return tensor;
}

Tensor Tensor::from_ints(TensorType type, std::span<const int64_t> values) {
  Tensor tensor{std::move(type), {}};
  tensor.bytes.resize(values.size() * static_cast<size_t>(tensor.host_bytes()));
  for (size_t i = 0; i < values.size(); ++i) tensor.set(static_cast<int64_t>(i), values[i]);
  return tensor;
}

int64_t Tensor::get(int64_t index) const {
  const uint8_t* at = bytes.data() + index * host_bytes();
  switch (host_bytes()) {
    case 1: return static_cast<int8_t>(*at);
    case 2: {
      int16_t v;
      std::memcpy(&v, at, 2);
      return v;
    }
    case 4: {
      int32_t v;
      std::memcpy(&v, at, 4);
      return v;
    }
    default: {
      int64_t v;
      std::memcpy(&v, at, 8);
      return v;
    }
  }
}

void Tensor::set(int64_t index, int64_t value) {
  std::memcpy(bytes.data() + index * host_bytes(), &value, static_cast<size_t>(host_bytes()));
}

std::vector<int64_t> Tensor::ints() const {
  std::vector<int64_t> values(static_cast<size_t>(count()));
  for (size_t i = 0; i < values.size(); ++i) values[i] = get(static_cast<int64_t>(i));
  return values;
}

int64_t element_bits(DType dtype, uint32_t bits) {
  switch (dtype_info(dtype).host_bytes) {
    case 1: return static_cast<int8_t>(bits);
    case 2: return static_cast<int16_t>(bits);
    default: return static_cast<int32_t>(bits);
  }
}

int64_t real_bits(DType dtype, double value) {
  if (dtype == DType::kFp32) return std::bit_cast<int32_t>(static_cast<float>(value));
  return element_bits(dtype, encode_float(float_format(dtype), value));
}

float bits_real(DType dtype, int64_t bits) {
  const uint32_t low = static_cast<uint32_t>(bits);
  if (dtype == DType::kFp32) return std::bit_cast<float>(low);
  if (dtype == DType::kFp16) return half_to_float(static_cast<uint16_t>(low));
  return static_cast<float>(decode_float(float_format(dtype), low));
}

float Tensor::real(int64_t index) const { return bits_real(type.dtype, get(index)); }

void Tensor::set_real(int64_t index, double value) { set(index, real_bits(type.dtype, value)); }

Tensor Tensor::from_reals(TensorType type, std::span<const float> values) {
  Tensor tensor{std::move(type), {}};
  tensor.bytes.resize(values.size() * static_cast<size_t>(tensor.host_bytes()));
  for (size_t i = 0; i < values.size(); ++i) tensor.set_real(static_cast<int64_t>(i), values[i]);
  return tensor;
}

std::vector<float> Tensor::reals() const {
  std::vector<float> values(static_cast<size_t>(count()));
  for (size_t i = 0; i < values.size(); ++i) values[i] = real(static_cast<int64_t>(i));
  return values;
}

Result<Tensor> decode_constant(const TensorType& type, std::span<const uint8_t> wire) {
  int64_t count = 0;
  if (type.dtype == DType::kShape) {
    count = type.shape.empty() ? 0 : type.shape[0];  // a shape value may have no element
  } else {
    const std::optional<int64_t> elements = element_count(type.shape);
    if (!elements) return bad_input("", "has no valid element count for {}", type_text(type));
    count = *elements;
  }
  const int64_t wire_bits = type.dtype == DType::kInt4    ? 4
                            : type.dtype == DType::kInt48 ? 48
                                                          : 8 * dtype_info(type.dtype).host_bytes;
  const int64_t needed = (count * wire_bits + 7) / 8;
  if (static_cast<int64_t>(wire.size()) < needed)
    return bad_input("", "data has {} bytes, {} needs {}", wire.size(), type_text(type), needed);
  Tensor tensor{type, {}};
  tensor.bytes.resize(static_cast<size_t>(count * tensor.host_bytes()));
  for (int64_t i = 0; i < count; ++i) {
    if (type.dtype == DType::kInt4) {
      const int nibble = (wire[static_cast<size_t>(i / 2)] >> (i % 2 * 4)) & 15;
      const int value = nibble < 8 ? nibble : nibble - 16;
      if (value == -8) return bad_input("", "element {} is -8, INT4 is -7..7", i);
      tensor.set(i, value);
    } else if (type.dtype == DType::kInt48) {
      int64_t value = 0;
      std::memcpy(&value, wire.data() + i * 6, 6);
      tensor.set(i, static_cast<int64_t>(static_cast<uint64_t>(value) << 16) >> 16);
    } else {
      std::memcpy(tensor.bytes.data() + i * tensor.host_bytes(),
                  wire.data() + i * tensor.host_bytes(), static_cast<size_t>(tensor.host_bytes()));
      if (type.dtype == DType::kBool && tensor.bytes[static_cast<size_t>(i)] > 1)
        return bad_input("", "element {} is {}, BOOL is 0 or 1", i,
                         tensor.bytes[static_cast<size_t>(i)]);
    }
  }
  return tensor;
}

std::vector<uint8_t> encode_constant(const Tensor& tensor) {
  if (tensor.type.dtype == DType::kInt4) {
    std::vector<uint8_t> wire((tensor.bytes.size() + 1) / 2);
    for (size_t i = 0; i < tensor.bytes.size(); ++i)
      wire[i / 2] = static_cast<uint8_t>(wire[i / 2] | ((tensor.bytes[i] & 15) << (i % 2 * 4)));
    return wire;
  }
  if (tensor.type.dtype == DType::kInt48) {
    std::vector<uint8_t> wire;
    for (size_t i = 0; i < tensor.bytes.size(); i += 8)
      wire.insert(wire.end(), tensor.bytes.begin() + static_cast<std::ptrdiff_t>(i),
                  tensor.bytes.begin() + static_cast<std::ptrdiff_t>(i + 6));
    return wire;
  }
  return tensor.bytes;
}

}  // namespace shale
