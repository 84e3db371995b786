// tools/shale/npy.h -- NumPy arrays on disk, versions 1 to 3, little-endian, C order.
#pragma once

#include <string>

#include "ir/graph/tensor.h"
#include "tools/scene/frame_source.h"

namespace shale {

/// Reads an untrusted file as a tensor of `type`: the shape must be equal, and the element type
/// must be the one that golden/tosa/README.md gives for type.dtype (BOOL bool, INT4 and INT8 int8,
/// INT16 int16, INT32 int32, INT48 int64), FP16 float16, FP32 float32; of BF16 and FP8, which NumPy has
/// not, the bits as int16 and int8.
/// Errors: kIo, kBadInput; both name the file.
Result<Tensor> read_npy(const std::string& path, const TensorType& type);

/// Reads an untrusted file of float64, of this shape.
/// Errors: as read_npy.
Result<std::vector<double>> read_npy_doubles(const std::string& path, const Shape& shape);

/// The shape of the array in a file.
/// Errors: as read_npy.
Result<Shape> npy_shape(const std::string& path);

/// Errors: kIo.
Result<void> write_npy(const std::string& path, const Tensor& tensor);

/// As float64.
/// Errors: kIo.
Result<void> write_npy(const std::string& path, const Shape& shape, std::span<const double> values);

/// As float32 [height, width, channels].
/// Errors: kIo.
Result<void> write_npy(const std::string& path, const FloatImage& image);

}  // namespace shale
