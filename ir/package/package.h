// ir/package/package.h -- the contract of compiler and runtime: a compiled network as plain data.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "ir/base/dtype.h"
#include "ir/base/result.h"
#include "ir/package/caps.h"

namespace shale {

/// A reader refuses another major version; a minor version only adds fields with defaults.
inline constexpr uint32_t kPackageMajor = 1;
inline constexpr uint32_t kPackageMinor = 9;

/// Offsets of tensors in the arena and in the weight blob are multiples of this: the largest value
/// that Vulkan allows a device to ask for storage and texel buffer offsets.
inline constexpr uint64_t kBufferAlignment = 256;

/// Vulkan guarantees grids up to this per axis, so no device has to be asked.
inline constexpr uint32_t kMaxWorkgroups = 65535;

/// Largest `.shale` file: FlatBuffers offsets end at 2 GiB.
inline constexpr uint64_t kMaxPackageBytes = (uint64_t{1} << 31) - 8;

/// Bounds that keep the arithmetic of readers free of overflow; no real network comes near them.
inline constexpr uint64_t kMaxTensorBytes = uint64_t{1} << 40;
inline constexpr uint32_t kMaxImageExtent = 16384;
inline constexpr uint32_t kMaxHistoryDepth = 16;
inline constexpr uint32_t kMaxBindings = 64;     ///< binding numbers of a dispatch are below this
inline constexpr uint32_t kMaxSamplers = 16;     ///< of a dispatch; what every Vulkan device has
inline constexpr uint32_t kMaxParamBytes = 128;  ///< push constants that every Vulkan device has

/// How a resource comes into being and who owns its memory.
enum class Category : uint8_t {
  kInput = 0,          ///< tensor bound by the caller (by the frame loop when a pass writes it)
  kOutput = 1,         ///< tensor bound by the caller (by the frame loop when a pass reads it)
  kIntermediate = 2,   ///< tensor in the arena
  kWeights = 3,        ///< tensor in the weight blob
  kImageInput = 4,     ///< image given by the host each frame
  kImageOutput = 5,    ///< image given by the host each frame
  kImageInternal = 6,  ///< image of the frame loop, lives within a frame
  kImageHistory = 7,   ///< ring of images of the frame loop, `history_depth` long; of one: kept
};
inline constexpr uint32_t kCategoryCount = 8;

inline constexpr bool is_image(Category category) { return category >= Category::kImageInput; }

enum class ImageFormat : uint8_t {
  kNone = 0,
  kRgba8Unorm = 1,
  kRgba16Float = 2,
  kRg16Float = 3,
  kR32Float = 4,
  kR8Unorm = 5,
  kR32Uint = 6,
  kRgba32Float = 7,
  kR16Float = 8,
  kRgba8Sint = 9,  ///< texel buffers of int8 tensors, four channels a texel
  kR8Sint = 10,    ///< texel buffers of int8 tensors, one channel a texel
  kRg8Unorm = 11,
  kRgba8Snorm = 12,
  kRgba32Uint = 13,  ///< texel buffers of int8 tensors, 16 channels a texel; of linear images
  kRg32Uint = 14,    ///< texel buffers of linear images
  kR16Uint = 15,     ///< texel buffers of tensors of 16 bits, one channel a texel
};
inline constexpr uint32_t kImageFormatCount = 16;

/// Names as in frame.json ("rgba8_unorm") and in GLSL layouts ("rgba8"), bytes and channels of a
/// texel.
struct ImageFormatInfo {
  ImageFormat format;
  const char* name;
  const char* glsl;
  uint32_t texel_bytes;
  uint32_t channels;
  bool filtered;  ///< every Vulkan device samples it with linear filters; see kSampler
  bool extended;  ///< as a storage image it needs Feature::kStorageImageExtended
};
const ImageFormatInfo& image_format_info(ImageFormat format);
std::optional<ImageFormat> image_format_from_name(std::string_view name);

/// real = scale * (stored - zero_point).
struct Quantization {
  float scale = 1.0f;
  int32_t zero_point = 0;
  bool operator==(const Quantization&) const = default;
};

struct Resource {
  std::string name;  ///< unique among the resources of a variant
  Category category = Category::kIntermediate;
  // Tensors:
  DType dtype = DType::kUnknown;
  std::vector<int64_t> shape;                ///< NHWC for activations; row-major, dense
  std::optional<Quantization> quantization;  ///< known only where frame.json states it
  uint64_t offset_bytes = 0;  ///< in the arena (kIntermediate) or the weight blob (kWeights)
  uint64_t size_bytes = 0;    ///< of a tensor or a linear image
  // Images:
  ImageFormat format = ImageFormat::kNone;
  uint32_t width = 0, height = 0;
  /// kImageHistory: number of images in the ring; of one image, what a frame leaves is what the next one
  /// finds and may update. kInput, kOutput: the same of tensors, at least 2, or 0 for a single one.
  uint32_t history_depth = 0;
  bool operator==(const Resource&) const = default;
};

/// A linear image is one of the frame loop's own whose texels lie in a buffer, row after row: for
/// drivers that read and write images much slower than buffers. It has a size in bytes.
inline bool is_linear(const Resource& resource) {
  return is_image(resource.category) && resource.size_bytes != 0;
}

/// Rows of linear images start at multiples of this, so that texel buffers of any format see whole
/// texels.
inline constexpr uint32_t kLinearRowAlignment = 64;

/// From one row of a linear image to the next, in texels: a whole number, since the alignment is a
/// multiple of every texel's bytes.
uint32_t linear_pitch(ImageFormat format, uint32_t width);

/// Bytes that a buffer descriptor of a tensor spans: its size, rounded up to whole 32-bit words, so
/// that kernels may address int8 tensors by words. What the last word holds beyond the tensor means
/// nothing.
inline constexpr uint64_t bound_bytes(const Resource& tensor) {
  return (tensor.size_bytes + 3) / 4 * 4;
}

enum class BindingType : uint8_t {
  kStorageBuffer = 0,
  kUniformTexelBuffer = 1,  ///< `view_format` tells how elements are read
  kSampledImage = 2,        ///< read by texelFetch, no sampler
  kStorageImage = 3,
  kTransfer = 4,  ///< no descriptor: what a transfer reads or writes
  /// An image with a sampler (VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER) of linear filters that
  /// clamps to the edge, in normalized coordinates, made by the runtime; only for formats that are
  /// `filtered`.
  kSampler = 5,
};
inline constexpr uint32_t kBindingTypeCount = 6;

/// True for what reads an image by VK_IMAGE_USAGE_SAMPLED_BIT.
inline constexpr bool is_sampled(BindingType type) {
  return type == BindingType::kSampledImage || type == BindingType::kSampler;
}

/// One descriptor of set 0, or an end of a transfer: the whole of a resource.
struct Binding {
  uint32_t binding = 0;
  BindingType type = BindingType::kStorageBuffer;
  uint32_t resource = 0;  ///< index into Variant::resources
  ImageFormat view_format = ImageFormat::kNone;
  bool reads = false;
  bool writes = false;
  uint32_t frames_back = 0;  ///< of histories: see Resource and Segment
  bool operator==(const Binding&) const = default;
};

/// Predicted by compiler/cost; times in microseconds.
struct Cost {
  uint64_t macs = 0;
  uint64_t ops = 0;  ///< integer operations that are no MAC
  uint64_t bytes_read = 0;
  uint64_t bytes_written = 0;
  double time_us = 0;
  bool operator==(const Cost&) const = default;
};

/// A grid that an earlier dispatch of the program writes: three words from word `first` on of a linear
/// r32_uint image of the frame loop's own, or of Tiles::work of the dispatch's segment.
struct IndirectGrid {
  uint32_t resource = 0;  ///< index into Variant::resources
  uint32_t first = 0;
  bool operator==(const IndirectGrid&) const = default;
};

struct Dispatch {
  std::string name;     ///< unique in a variant: joins predicted with measured times
  std::string kernel;   ///< family name, such as "conv2d_s8_f32exact"
  uint32_t module = 0;  ///< index into Variant::modules
  std::array<uint32_t, 3> workgroups{1, 1,
                                     1};  ///< with `indirect` the largest that is written there
  std::vector<Binding> bindings;
  Cost cost;
  std::optional<IndirectGrid> indirect{};  ///< nothing: all of the grid always runs
  bool operator==(const Dispatch&) const = default;
};

/// Who gives a parameter its value.
enum class ParamSource : uint8_t {
  kHost = 0,   ///< the host, by name; until then the default
  kReset = 1,  ///< the frame loop: 1 in a frame whose histories hold nothing, else 0
  kTime = 2,   ///< the frame loop: that of the picture which a Generator makes, else 1
  /// The frame loop: how many frames were rendered since the histories were empty, the newest one,
  /// which may be the record itself, included; at most 2^24. Only beside a Generator.
  kFrames = 3,
};
inline constexpr uint32_t kParamSourceCount = 4;

/// A value that may change from frame to frame, for the passes of the kCompute segments: part of
/// their push constants. Vectors are aligned as in std430: two components to 8 bytes, three and
/// four to 16.
struct Param {
  std::string name;  ///< unique among the parameters of a variant
  bool is_integer = false;
  uint32_t components = 1;  ///< 1 to 4 values of 32 bits
  uint32_t offset_bytes = 0;
  ParamSource source = ParamSource::kHost;
  std::vector<float> default_values;  ///< one per component; whole numbers for integers
  bool operator==(const Param&) const = default;
};

/// How a person may look at one to three channels of a resource: `low` shows black, `high` white.
/// For debug views; nothing depends on it.
struct View {
  std::string title;
  uint32_t resource = 0;
  uint32_t first_channel = 0, channels = 1;
  float low = 0, high = 1;
  bool operator==(const View&) const = default;
};

enum class SegmentKind : uint8_t { kCompute = 0, kGraph = 1, kTransfer = 2 };

/// What the dispatches of a kTransfer segment do, by their kernel; they have no module. A copy
/// reads binding 0 and writes binding 1, images of one format and extent of which one is linear and
/// the other is not. A clear writes zeros to binding 0, an image.
inline constexpr std::string_view kCopyKernel = "copy", kClearKernel = "clear";

/// How a kGraph segment finds out what has to run again. Its first dispatches compare its inputs with what
/// they were when it last ran, tile by tile, and write the commands and lists of cells by which the
/// others run; the intermediate tensors and outputs keep their values from run to run, so that what is
/// not made again is what it would be. Both resources are kIntermediate of int32.
///
/// Before the first dispatch the runtime fills `work` with zeros, and `changes`, a bit a tile, with
/// zeros; or with ones where all has to run: in a segment's first run, behind a reset of the histories,
/// and where something else may have written what the segment left.
struct Tiles {
  uint32_t changes = 0;  ///< index into Variant::resources
  uint32_t work = 0;     ///< the same
  /// Codes by which an int8 input may differ from what its tile was last made from; 0 is exact.
  uint32_t tolerance = 0;
  bool operator==(const Tiles&) const = default;
};
inline constexpr uint32_t kMaxTileTolerance = 255;

/// Another kernel for what a dispatch of a kGraph segment without Tiles does, one that drivers compile at once: it serves
/// until they have compiled the dispatch's own, and gives the same bits.
struct StartForm {
  uint32_t dispatch = 0;  ///< index into Segment::dispatches
  /// Under the dispatch's name. Of the tensors that are no weights it binds the same, for the same accesses.
  Dispatch form;
  bool operator==(const StartForm&) const = default;
};

/// Dispatches in order. A pre or post pass is a kCompute or kTransfer segment around the kGraph
/// segments; a program without a kGraph segment is a sandwich without a network.
struct Segment {
  std::string name;
  SegmentKind kind = SegmentKind::kGraph;
  std::vector<Dispatch> dispatches;
  uint32_t program = 0;  ///< index into Variant::programs
  std::optional<Tiles> tiles = std::nullopt;
  std::vector<StartForm> start_forms = {};  ///< in the order of the dispatches that have one
  bool operator==(const Segment&) const = default;
};

/// Static bounds of a convolution's accumulators, from the actual weights; per output channel.
struct RangeProof {
  std::string name;                ///< the convolution's result value
  std::vector<int64_t> min, max;   ///< of the final accumulator, bias included
  std::vector<int64_t> magnitude;  ///< of any partial sum of w * (q + 128), bias left out
  bool operator==(const RangeProof&) const = default;
};

/// A program that makes pictures between rendered frames, or beyond them. The variant's other program
/// renders: it leaves in histories what this one reads, and nothing that this one writes gets there.
/// Times are in rendered frames: the newest one is at 1, the one before at 0.
struct Generator {
  uint32_t program = 0;
  float after = 0, until = 1;  ///< takes times above the one, up to the other; 0 to kMaxTime
  /// True if pictures lie before the newest rendered frame, which is then shown behind them: one
  /// frame later than without.
  bool waits() const { return after < 1; }
  bool operator==(const Generator&) const = default;
};
inline constexpr float kMaxTime = 2;

/// The time of picture `index` (from 1) of `count` that a generator makes for each rendered frame.
inline float generated_time(const Generator& generator, uint32_t index, uint32_t count) {
  return (generator.waits() ? 0.0f : 1.0f) +
         static_cast<float>(index) / static_cast<float>(count + 1);
}

/// What the values of a history, or of a graph's input or output, lie in after any number of frames, whatever the host
/// gives: int8 codes as they are stored, texels as shaders read them. From the contracts of the passes and the weights.
struct ValueBounds {
  uint32_t resource = 0;
  std::vector<float> low, high;  ///< one for all channels, or one for each; low <= high
  bool operator==(const ValueBounds&) const = default;
};

/// What the host promised of its frames when the package was compiled, such as that nothing moves. Passes
/// that follow from it stand beside the full ones; a dispatch in front of both finds out whether the frame
/// keeps it, and their grids say which of them run: what a frame shows never depends on the promise.
struct Promise {
  std::string text;     ///< for people
  uint32_t broken = 0;  ///< an r32_uint image, 1x1: 0 after a frame that kept it
  bool operator==(const Promise&) const = default;
};

/// A module's words; entry point "main", local size fixed in the words.
using Spirv = std::vector<uint32_t>;

/// The programs of a variant are what a host records, one at a time and each as often as it likes;
/// their segments lie together, in the order of the programs. They share weights, arena, tensors,
/// images and parameters. What they hand on lies in histories and in tensors that the caller may
/// bind; internal images mean nothing between records, and the arena only to segments with Tiles.
///
/// A history, of images or tensors, moves on by one slot after each record of a program that writes
/// it. A binding of it with `frames_back` k means, in a program that writes it, the slot that is
/// being written (k = 0) or was written k records ago; in a program that only reads it, the newest
/// slot written (k = 0) or the k-th before that. Slots start out as zeros.
struct Variant {
  std::string target;  ///< name of the DeviceProfile it was made for
  Requirements requirements;
  uint64_t arena_bytes = 0;
  std::vector<Resource> resources;
  std::vector<Segment> segments;
  std::vector<Spirv> modules;
  std::vector<RangeProof> proofs;
  std::vector<Param> params;
  std::vector<View> views;
  std::vector<std::string> programs{"frame"};  ///< unique identifiers, at least one
  /// The programs may be forms of one frame, of which a parameter of the host chooses: `chosen_by`
  /// is its name, and `choices` has for each program as many values as it has components. Then a
  /// record is the first one after a reset for all programs. Empty: the host names programs.
  std::string chosen_by;
  std::vector<float> choices;
  std::optional<Generator> generator;  ///< then there are two programs, and the host names none
  std::optional<Promise> promise;
  std::vector<ValueBounds> bounds;  ///< of what they are known, in the order of the resources
  DeviceClass device_class = DeviceClass::kAny;
  bool operator==(const Variant&) const = default;
};

/// The segments of a program, in order. The variant must pass check_package.
std::span<const Segment> program_segments(const Variant& variant, uint32_t program);

/// Where the dispatches with `indirect` find their grids, in order.
std::vector<IndirectGrid> indirect_grids(std::span<const Segment> segments);
/// The share of the segments' predicted time that a run took, from 0 to 1: by the three words that each of
/// the indirect_grids held. What has none counts whole.
double share_run(std::span<const Segment> segments, std::span<const uint32_t> words);

/// The program whose values in Variant::choices lie nearest to the parameter's, the first of equal
/// ones; 0 where no parameter chooses. The variant must pass check_package.
uint32_t chosen_program(const Variant& variant, std::span<const float> value);

/// How a package came about; no paths, no times.
struct Provenance {
  uint64_t model_hash = 0;  ///< stable_hash of the model file
  std::string model_name;
  std::string compiler;  ///< "shale 0.2.0"
  std::string options;   ///< canonical text of the options that shape the result
  bool operator==(const Provenance&) const = default;
};

struct Package {
  Provenance provenance;
  std::vector<Variant> variants;  ///< the runtime takes the best that the device meets: rank.h
  std::vector<uint8_t> weights;   ///< shared by the variants
  bool operator==(const Package&) const = default;
};

/// The part of a variant's requirements that follows from its bindings: storage_range_bytes,
/// texel_elements, storage_buffers, texel_buffers, storage_images and of the features
/// kStorageImageExtended; the others keep their defaults. Of maxPerStageResources every device has
/// more than kMaxBindings. The variant's indices must be sound (check_package).
Requirements binding_requirements(const Variant& variant);

/// Everything that the runtime relies on, on plain data: enum values, indices, ranges inside the
/// arena and the weight blob, sizes that follow from shapes, alignments, unique names without
/// control characters, programs that are identifiers with segments each, binding rules, SPIR-V
/// magic and length, grids in 1..kMaxWorkgroups, history rules, parameters inside their block,
/// requirements that cover the bindings. The body of the SPIR-V is not judged: a driver gets it as
/// it gets any application's shader.
/// Errors: kBadInput, naming what and where ('variant 0, dispatch "conv1", binding 2: ...').
Result<void> check_package(const Package& package);

/// Bytes of the push constants of a variant's passes; 0 if it has no parameters.
uint32_t param_bytes(const Variant& variant);

/// Same package, same bytes. `package` must pass check_package; the result then passes
/// read_package.
std::vector<uint8_t> write_package(const Package& package);

/// Reads a `.shale` file that nobody vouches for: FlatBuffers structure, major version, enum
/// values, packed modules, then check_package. Memory and time are bounded by the length of the file (pack.h). What files
/// before 1.4 do not say is filled in: the device class from the target's name, the program "frame",
/// matrices of 16x16x32 in subgroups of 32 for Feature::kCooperativeMatrix,
/// Feature::kStorageImageExtended where storage images need it.
/// Errors: kBadInput (or kUnsupported for a newer major version), naming what and where.
Result<Package> read_package(std::span<const uint8_t> bytes);

/// True if the bytes carry the `.shale` file identifier.
bool is_package(std::span<const uint8_t> bytes);

/// For people: provenance, requirements, resources, segments, dispatches, proofs. `package` must
/// pass check_package.
std::string dump_package(const Package& package);

}  // namespace shale
