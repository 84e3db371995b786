#include "ir/package/package.h"

#include <algorithm>
#include <bit>
#include <limits>
#include <map>

#include "ir/package/pack.h"
#include "ir/schema/package_generated.h"

namespace shale {
namespace {

using flatbuffers::Offset;
using flatbuffers::Vector;

static_assert(std::endian::native == std::endian::little, "vectors are copied as they lie");
static_assert(static_cast<uint32_t>(fbs::Category::MAX) + 1 == kCategoryCount);
static_assert(static_cast<uint32_t>(fbs::ImageFormat::MAX) + 1 == kImageFormatCount);
static_assert(static_cast<uint32_t>(fbs::BindingType::MAX) + 1 == kBindingTypeCount);
static_assert(static_cast<uint32_t>(fbs::SegmentKind::MAX) ==
              static_cast<uint32_t>(SegmentKind::kTransfer));
static_assert(static_cast<uint32_t>(fbs::ParamSource::MAX) + 1 == kParamSourceCount);
static_assert(static_cast<uint32_t>(fbs::DeviceClass::MAX) + 1 == kDeviceClassCount);

/// Lengths of files are multiples of this, so that no cut goes unseen in the padding at the end.
constexpr size_t kFileAlignment = 8;

// Source of the last two columns: Vulkan 1.3, "Required format support" (linear filters: table 66
// and on) and shaderStorageImageExtendedFormats; rg32ui and r8i by the capability of SPIR-V.
constexpr std::array<ImageFormatInfo, kImageFormatCount> kImageFormats{{
    {ImageFormat::kNone, "none", "", 0, 0, false, false},
    {ImageFormat::kRgba8Unorm, "rgba8_unorm", "rgba8", 4, 4, true, false},
    {ImageFormat::kRgba16Float, "rgba16_float", "rgba16f", 8, 4, true, false},
    {ImageFormat::kRg16Float, "rg16_float", "rg16f", 4, 2, true, true},
    {ImageFormat::kR32Float, "r32_float", "r32f", 4, 1, false, false},
    {ImageFormat::kR8Unorm, "r8_unorm", "r8", 1, 1, true, true},
    {ImageFormat::kR32Uint, "r32_uint", "r32ui", 4, 1, false, false},
    {ImageFormat::kRgba32Float, "rgba32_float", "rgba32f", 16, 4, false, false},
    {ImageFormat::kR16Float, "r16_float", "r16f", 2, 1, true, true},
    {ImageFormat::kRgba8Sint, "rgba8_sint", "rgba8i", 4, 4, false, false},
    {ImageFormat::kR8Sint, "r8_sint", "r8i", 1, 1, false, true},
    {ImageFormat::kRg8Unorm, "rg8_unorm", "rg8", 2, 2, true, true},
    {ImageFormat::kRgba8Snorm, "rgba8_snorm", "rgba8_snorm", 4, 4, true, false},
    {ImageFormat::kRgba32Uint, "rgba32_uint", "rgba32ui", 16, 4, false, false},
    {ImageFormat::kRg32Uint, "rg32_uint", "rg32ui", 8, 2, false, true},
    {ImageFormat::kR16Uint, "r16_uint", "r16ui", 2, 1, false, true},
}};

// ---- Writing: plain data to tables, children first, always in the same order.

using Builder = flatbuffers::FlatBufferBuilder;

template <typename Table, typename T, typename Write>
auto write_all(Builder& builder, const std::vector<T>& values, Write write) {
  std::vector<Offset<Table>> offsets;
  offsets.reserve(values.size());
  for (const T& value : values) offsets.push_back(write(builder, value));
  return builder.CreateVector(offsets);
}

Offset<fbs::Resource> write_resource(Builder& builder, const Resource& r) {
  const auto name = builder.CreateString(r.name);
  const auto shape = builder.CreateVector(r.shape);
  const fbs::Quantization quantization =
      r.quantization ? fbs::Quantization(r.quantization->scale, r.quantization->zero_point)
                     : fbs::Quantization();
  return fbs::CreateResource(
      builder, name, static_cast<fbs::Category>(r.category), static_cast<uint32_t>(r.dtype), shape,
      r.quantization ? &quantization : nullptr, r.offset_bytes, r.size_bytes,
      static_cast<fbs::ImageFormat>(r.format), r.width, r.height, r.history_depth);
}

Offset<fbs::Binding> write_binding(Builder& builder, const Binding& b) {
  return fbs::CreateBinding(builder, b.binding, static_cast<fbs::BindingType>(b.type), b.resource,
                            static_cast<fbs::ImageFormat>(b.view_format), b.reads, b.writes,
                            b.frames_back);
}

Offset<fbs::Dispatch> write_dispatch(Builder& builder, const Dispatch& d) {
  const auto name = builder.CreateString(d.name);
  const auto kernel = builder.CreateString(d.kernel);
  const auto bindings = write_all<fbs::Binding>(builder, d.bindings, write_binding);
  const auto cost = fbs::CreateCost(builder, d.cost.macs, d.cost.ops, d.cost.bytes_read,
                                    d.cost.bytes_written, d.cost.time_us);
  const fbs::Grid grid(d.workgroups[0], d.workgroups[1], d.workgroups[2]);
  const fbs::IndirectGrid indirect =
      d.indirect ? fbs::IndirectGrid(d.indirect->resource, d.indirect->first) : fbs::IndirectGrid();
  return fbs::CreateDispatch(builder, name, kernel, d.module, &grid, bindings, cost,
                             d.indirect ? &indirect : nullptr);
}

Offset<fbs::StartForm> write_start_form(Builder& builder, const StartForm& s) {
  return fbs::CreateStartForm(builder, s.dispatch, write_dispatch(builder, s.form));
}

Offset<fbs::Segment> write_segment(Builder& builder, const Segment& s) {
  const auto name = builder.CreateString(s.name);
  const auto dispatches = write_all<fbs::Dispatch>(builder, s.dispatches, write_dispatch);
  const auto tiles =
      s.tiles ? fbs::CreateTiles(builder, s.tiles->changes, s.tiles->work, s.tiles->tolerance) : 0;
  const auto start_forms =
      s.start_forms.empty() ? 0
                            : write_all<fbs::StartForm>(builder, s.start_forms, write_start_form);
  return fbs::CreateSegment(builder, name, static_cast<fbs::SegmentKind>(s.kind), dispatches,
                            s.program, tiles, start_forms);
}

Offset<fbs::Module> write_module(Builder& builder, const Spirv& words) {
  const std::optional<std::vector<uint8_t>> packed = pack_module(words);
  if (!packed) return fbs::CreateModule(builder, builder.CreateVector(words));
  const auto no_words = builder.CreateVector(Spirv());
  return fbs::CreateModule(builder, no_words, builder.CreateVector(*packed),
                           static_cast<uint32_t>(words.size()));
}

Offset<fbs::RangeProof> write_proof(Builder& builder, const RangeProof& p) {
  const auto name = builder.CreateString(p.name);
  const auto min = builder.CreateVector(p.min);
  const auto max = builder.CreateVector(p.max);
  const auto magnitude = builder.CreateVector(p.magnitude);
  return fbs::CreateRangeProof(builder, name, min, max, magnitude);
}

Offset<fbs::Param> write_param(Builder& builder, const Param& p) {
  const auto name = builder.CreateString(p.name);
  const auto values = builder.CreateVector(p.default_values);
  return fbs::CreateParam(builder, name, p.is_integer, p.components, p.offset_bytes,
                          static_cast<fbs::ParamSource>(p.source), values);
}

Offset<fbs::View> write_view(Builder& builder, const View& v) {
  return fbs::CreateView(builder, builder.CreateString(v.title), v.resource, v.first_channel,
                         v.channels, v.low, v.high);
}

Offset<fbs::ValueBounds> write_bounds(Builder& builder, const ValueBounds& b) {
  const auto low = builder.CreateVector(b.low);
  return fbs::CreateValueBounds(builder, b.resource, low, builder.CreateVector(b.high));
}

Offset<fbs::Variant> write_variant(Builder& builder, const Variant& v) {
  const auto target = builder.CreateString(v.target);
  const Requirements& r = v.requirements;
  std::vector<fbs::MatrixProduct> products;
  for (const MatrixProduct& p : r.matrix_products) products.emplace_back(p.m, p.n, p.k);
  const auto matrix_products =
      products.empty() ? 0 : builder.CreateVectorOfStructs(products.data(), products.size());
  const auto requirements =
      fbs::CreateRequirements(builder, r.features.bits, r.workgroup_invocations, r.shared_bytes,
                              r.storage_range_bytes, r.texel_elements, r.storage_buffers,
                              r.texel_buffers, r.storage_images, r.subgroup_size, matrix_products);
  const auto resources = write_all<fbs::Resource>(builder, v.resources, write_resource);
  const auto segments = write_all<fbs::Segment>(builder, v.segments, write_segment);
  const auto modules = write_all<fbs::Module>(builder, v.modules, write_module);
  const auto proofs = write_all<fbs::RangeProof>(builder, v.proofs, write_proof);
  const auto params = write_all<fbs::Param>(builder, v.params, write_param);
  const auto views = write_all<fbs::View>(builder, v.views, write_view);
  const auto programs = builder.CreateVectorOfStrings(v.programs);
  const auto chosen_by = v.chosen_by.empty() ? 0 : builder.CreateString(v.chosen_by);
  const auto choices = v.choices.empty() ? 0 : builder.CreateVector(v.choices);
  const auto generator = v.generator ? fbs::CreateGenerator(builder, v.generator->program,
                                                            v.generator->after, v.generator->until)
                                     : 0;
  const auto bounds =
      v.bounds.empty() ? 0 : write_all<fbs::ValueBounds>(builder, v.bounds, write_bounds);
  const auto promise =
      v.promise
          ? fbs::CreatePromise(builder, builder.CreateString(v.promise->text), v.promise->broken)
          : 0;
  return fbs::CreateVariant(builder, target, requirements, v.arena_bytes, resources, segments,
                            modules, proofs, params, views, programs,
                            static_cast<fbs::DeviceClass>(v.device_class), chosen_by, choices,
                            generator, promise, bounds);
}

// ---- Reading: verified tables to plain data. check_package judges the enum values later.

/// Copies out of a verified buffer. The verifier lets many references lead to one vector, so a
/// small file could ask for any amount of memory: each copied part is paid for from the length of
/// the file.
class Copier {
 public:
  explicit Copier(size_t file_bytes) : left_(file_bytes) {}

  bool overdrawn() const { return overdrawn_; }

  std::string text(const flatbuffers::String* string) {
    return string && pay(string->size()) ? string->str() : std::string();
  }

  /// Pays for what will be read in place.
  void pay_for(const Vector<uint8_t>* bytes) {
    if (bytes) pay(bytes->size());
  }

  template <typename T>
  std::vector<T> scalars(const Vector<T>* vector) {
    if (!vector || !pay(vector->size() * sizeof(T))) return {};
    return std::vector<T>(vector->data(), vector->data() + vector->size());
  }

  std::vector<MatrixProduct> products(const Vector<const fbs::MatrixProduct*>* vector) {
    std::vector<MatrixProduct> values;
    if (!vector || !pay(vector->size() * sizeof(fbs::MatrixProduct))) return values;
    for (const fbs::MatrixProduct* p : *vector) values.push_back({p->m(), p->n(), p->k()});
    return values;
  }

  std::vector<std::string> texts(const Vector<Offset<flatbuffers::String>>* vector) {
    std::vector<std::string> values;
    // A reference, and the least that a string takes.
    if (!vector || !pay(vector->size() * 8)) return values;
    for (const flatbuffers::String* string : *vector) values.push_back(text(string));
    return values;
  }

  template <typename Table, typename Read>
  auto tables(const Vector<Offset<Table>>* vector, Read read) {
    std::vector<decltype(read(*this, *vector->Get(0)))> values;
    // A reference and the least that a table takes.
    constexpr size_t kTableBytes = 8;
    if (!vector || !pay(vector->size() * kTableBytes)) return values;
    values.reserve(vector->size());
    for (const Table* table : *vector) {
      if (overdrawn_) break;
      values.push_back(read(*this, *table));
    }
    return values;
  }

 private:
  bool pay(size_t bytes) {
    overdrawn_ = overdrawn_ || bytes > left_;
    if (!overdrawn_) left_ -= bytes;
    return !overdrawn_;
  }

  size_t left_;
  bool overdrawn_ = false;
};

Resource read_resource(Copier& copy, const fbs::Resource& r) {
  Resource resource;
  resource.name = copy.text(r.name());
  resource.category = static_cast<Category>(r.category());
  resource.dtype = static_cast<DType>(r.dtype());
  resource.shape = copy.scalars(r.shape());
  if (const fbs::Quantization* q = r.quantization())
    resource.quantization = Quantization{q->scale(), q->zero_point()};
  resource.offset_bytes = r.offset_bytes();
  resource.size_bytes = r.size_bytes();
  resource.format = static_cast<ImageFormat>(r.format());
  resource.width = r.width();
  resource.height = r.height();
  resource.history_depth = r.history_depth();
  return resource;
}

Binding read_binding(Copier&, const fbs::Binding& b) {
  return {.binding = b.binding(),
          .type = static_cast<BindingType>(b.type()),
          .resource = b.resource(),
          .view_format = static_cast<ImageFormat>(b.view_format()),
          .reads = b.reads(),
          .writes = b.writes(),
          .frames_back = b.frames_back()};
}

Dispatch read_dispatch(Copier& copy, const fbs::Dispatch& d) {
  Dispatch dispatch;
  dispatch.name = copy.text(d.name());
  dispatch.kernel = copy.text(d.kernel());
  dispatch.module = d.module_();
  dispatch.workgroups = {d.workgroups()->x(), d.workgroups()->y(), d.workgroups()->z()};
  dispatch.bindings = copy.tables(d.bindings(), read_binding);
  const fbs::Cost& cost = *d.cost();
  dispatch.cost = {cost.macs(), cost.ops(), cost.bytes_read(), cost.bytes_written(),
                   cost.time_us()};
  if (const fbs::IndirectGrid* g = d.indirect())
    dispatch.indirect = IndirectGrid{g->resource(), g->first()};
  return dispatch;
}

StartForm read_start_form(Copier& copy, const fbs::StartForm& s) {
  return {s.dispatch(), read_dispatch(copy, *s.form())};
}

Segment read_segment(Copier& copy, const fbs::Segment& s) {
  Segment segment;
  segment.name = copy.text(s.name());
  segment.kind = static_cast<SegmentKind>(s.kind());
  segment.dispatches = copy.tables(s.dispatches(), read_dispatch);
  segment.program = s.program();
  if (const fbs::Tiles* t = s.tiles())
    segment.tiles = Tiles{t->changes(), t->work(), t->tolerance()};
  segment.start_forms = copy.tables(s.start_forms(), read_start_form);
  return segment;
}

/// Packed words follow once all is paid for: unpack_modules.
Spirv read_module(Copier& copy, const fbs::Module& module) {
  copy.pay_for(module.packed());
  return copy.scalars(module.words());
}

RangeProof read_proof(Copier& copy, const fbs::RangeProof& p) {
  RangeProof proof;
  proof.name = copy.text(p.name());
  proof.min = copy.scalars(p.min());
  proof.max = copy.scalars(p.max());
  proof.magnitude = copy.scalars(p.magnitude());
  return proof;
}

Param read_param(Copier& copy, const fbs::Param& p) {
  return {.name = copy.text(p.name()),
          .is_integer = p.is_integer(),
          .components = p.components(),
          .offset_bytes = p.offset_bytes(),
          .source = static_cast<ParamSource>(p.source()),
          .default_values = copy.scalars(p.default_values())};
}

View read_view(Copier& copy, const fbs::View& v) {
  return {.title = copy.text(v.title()),
          .resource = v.resource(),
          .first_channel = v.first_channel(),
          .channels = v.channels(),
          .low = v.low(),
          .high = v.high()};
}

ValueBounds read_bounds(Copier& copy, const fbs::ValueBounds& b) {
  return {.resource = b.resource(), .low = copy.scalars(b.low()), .high = copy.scalars(b.high())};
}

Variant read_variant(Copier& copy, const fbs::Variant& v) {
  Variant variant;
  variant.target = copy.text(v.target());
  const fbs::Requirements& r = *v.requirements();
  variant.requirements = {.features = {r.features()},
                          .workgroup_invocations = r.workgroup_invocations(),
                          .shared_bytes = r.shared_bytes(),
                          .storage_range_bytes = r.storage_range_bytes(),
                          .texel_elements = r.texel_elements(),
                          .storage_buffers = r.storage_buffers(),
                          .texel_buffers = r.texel_buffers(),
                          .storage_images = r.storage_images(),
                          .subgroup_size = r.subgroup_size(),
                          .matrix_products = copy.products(r.matrix_products())};
  variant.arena_bytes = v.arena_bytes();
  variant.resources = copy.tables(v.resources(), read_resource);
  variant.segments = copy.tables(v.segments(), read_segment);
  variant.modules = copy.tables(v.modules(), read_module);
  variant.proofs = copy.tables(v.proofs(), read_proof);
  variant.params = copy.tables(v.params(), read_param);
  variant.views = copy.tables(v.views(), read_view);
  if (v.programs()) variant.programs = copy.texts(v.programs());
  variant.device_class = static_cast<DeviceClass>(v.device_class());
  if (v.chosen_by()) variant.chosen_by = copy.text(v.chosen_by());
  if (v.choices()) variant.choices = copy.scalars(v.choices());
  if (const fbs::Generator* g = v.generator())
    variant.generator = {g->program(), g->after(), g->until()};
  if (const fbs::Promise* promise = v.promise())
    variant.promise = {copy.text(promise->text()), promise->broken()};
  variant.bounds = copy.tables(v.bounds(), read_bounds);
  return variant;
}

/// `total`: bytes of what was unpacked before, and of this, too, afterwards.
Result<void> unpack_modules(const fbs::Variant& v, size_t index, Variant& variant,
                            uint64_t& total) {
  for (uint32_t i = 0; i < v.modules()->size(); ++i) {
    const fbs::Module& module = *v.modules()->Get(i);
    if (!module.packed()) continue;
    const std::string where = fmt::format("variant {}, module {}", index, i);
    if (module.words()->size() != 0)
      return bad_input(where, "has {} words beside packed ones, 0 are expected",
                       module.words()->size());
    total += uint64_t{module.word_count()} * sizeof(uint32_t);
    if (total > kMaxPackageBytes)
      return bad_input(where, "the package's modules have {} bytes, at most {} are expected", total,
                       kMaxPackageBytes);
    SHALE_TRY(variant.modules[i], unpack_module({module.packed()->data(), module.packed()->size()},
                                                module.word_count(), where));
  }
  return {};
}

/// Fills in what files before 1.4 leave unsaid. Nothing is checked yet.
void complete_old(Variant& variant) {
  const std::map<std::string_view, DeviceClass> classes{{"lavapipe", DeviceClass::kCpu},
                                                        {"dot8-gpu", DeviceClass::kDot8Gpu},
                                                        {"coopmat-gpu", DeviceClass::kMatrixGpu}};
  if (const auto found = classes.find(variant.target); found != classes.end())
    variant.device_class = found->second;
  if (variant.requirements.features.has(Feature::kCooperativeMatrix)) {
    variant.requirements.subgroup_size = 32;
    variant.requirements.matrix_products = {{16, 16, 32}};
  }
  for (const Segment& segment : variant.segments)
    for (const Dispatch& dispatch : segment.dispatches)
      for (const Binding& binding : dispatch.bindings) {
        if (binding.type != BindingType::kStorageImage ||
            binding.resource >= variant.resources.size())
          continue;
        const ImageFormat format = variant.resources[binding.resource].format;
        if (static_cast<uint32_t>(format) < kImageFormatCount && image_format_info(format).extended)
          variant.requirements.features.add(Feature::kStorageImageExtended);
      }
}

Result<Package> read_aligned(std::span<const uint8_t> bytes) {
  if (bytes.size() > kMaxPackageBytes)
    return bad_input("", "{} bytes are more than the {} that are accepted", bytes.size(),
                     kMaxPackageBytes);
  if (!is_package(bytes)) return bad_input("", "is no .shale package: the identifier is missing");
  const auto verifier = [&] { return flatbuffers::Verifier(bytes.data(), bytes.size()); };
  if (!verifier().VerifyBuffer<fbs::Version>(fbs::PackageIdentifier()))
    return bad_input("", "the package is damaged: its version cannot be read");
  const fbs::Version& version = *flatbuffers::GetRoot<fbs::Version>(bytes.data());
  if (version.major_version() > kPackageMajor)
    return unsupported("", "package version {}.{} is newer than {}.{}, which this build reads",
                       version.major_version(), version.minor_version(), kPackageMajor,
                       kPackageMinor);
  if (version.major_version() != kPackageMajor)
    return bad_input("", "package version {}.{} does not exist", version.major_version(),
                     version.minor_version());
  if (bytes.size() % kFileAlignment != 0)
    return bad_input("", "the package is damaged: {} bytes are no multiple of {}", bytes.size(),
                     kFileAlignment);
  if (!verifier().VerifyBuffer<fbs::Package>(fbs::PackageIdentifier()))
    return bad_input("", "the package is damaged: offsets or lengths leave its {} bytes",
                     bytes.size());
  const fbs::Package& root = *fbs::GetPackage(bytes.data());
  Copier copy(bytes.size());
  Package package;
  const fbs::Provenance& provenance = *root.provenance();
  package.provenance = {provenance.model_hash(), copy.text(provenance.model_name()),
                        copy.text(provenance.compiler()), copy.text(provenance.options())};
  package.weights = copy.scalars(root.weights());
  package.variants = copy.tables(root.variants(), read_variant);
  if (copy.overdrawn()) return bad_input("", "the package is damaged: parts of it overlap");
  uint64_t unpacked = 0;
  for (uint32_t i = 0; i < package.variants.size(); ++i)
    SHALE_TRY_VOID(unpack_modules(*root.variants()->Get(i), i, package.variants[i], unpacked));
  if (version.minor_version() < 4) std::ranges::for_each(package.variants, complete_old);
  SHALE_TRY_VOID(check_package(package));
  return package;
}

}  // namespace

const ImageFormatInfo& image_format_info(ImageFormat format) {
  return kImageFormats[static_cast<uint32_t>(format)];
}

std::optional<ImageFormat> image_format_from_name(std::string_view name) {
  for (const ImageFormatInfo& info : kImageFormats)
    if (info.format != ImageFormat::kNone && info.name == name) return info.format;
  return std::nullopt;
}

uint32_t linear_pitch(ImageFormat format, uint32_t width) {
  const uint32_t bytes = image_format_info(format).texel_bytes;
  return (width * bytes + kLinearRowAlignment - 1) / kLinearRowAlignment * kLinearRowAlignment /
         bytes;
}

std::span<const Segment> program_segments(const Variant& variant, uint32_t program) {
  // Not equal_range: clang 14 cannot compile the subrange of GCC 12's library.
  return {std::ranges::lower_bound(variant.segments, program, {}, &Segment::program),
          std::ranges::upper_bound(variant.segments, program, {}, &Segment::program)};
}

uint32_t chosen_program(const Variant& variant, std::span<const float> value) {
  uint32_t nearest = 0;
  double least = std::numeric_limits<double>::infinity();
  for (uint32_t i = 0; i < variant.choices.size() / std::max<size_t>(value.size(), 1); ++i) {
    double distance = 0;
    for (size_t c = 0; c < value.size(); ++c) {
      const double away = double{value[c]} - variant.choices[i * value.size() + c];
      distance += away * away;
    }
    if (distance >= least) continue;
    least = distance;
    nearest = i;
  }
  return nearest;
}

std::vector<IndirectGrid> indirect_grids(std::span<const Segment> segments) {
  std::vector<IndirectGrid> grids;
  for (const Segment& segment : segments)
    for (const Dispatch& dispatch : segment.dispatches)
      if (dispatch.indirect) grids.push_back(*dispatch.indirect);
  return grids;
}

double share_run(std::span<const Segment> segments, std::span<const uint32_t> words) {
  double run = 0, all = 0;
  size_t word = 0;
  for (const Segment& segment : segments)
    for (const Dispatch& dispatch : segment.dispatches) {
      double share = 1;
      if (dispatch.indirect)
        for (const uint32_t whole : dispatch.workgroups)
          share *= static_cast<double>(words[word++]) / static_cast<double>(whole);
      run += share * dispatch.cost.time_us;
      all += dispatch.cost.time_us;
    }
  return all > 0 ? run / all : 1;
}

uint32_t param_bytes(const Variant& variant) {
  uint32_t bytes = 0;
  for (const Param& param : variant.params)
    bytes = std::max(bytes, param.offset_bytes + 4 * param.components);
  return bytes;
}

std::vector<uint8_t> write_package(const Package& package) {
  Builder builder;
  builder.Align(kFileAlignment);  // of the finished buffer; nothing is padded here
  const Provenance& p = package.provenance;
  const auto model_name = builder.CreateString(p.model_name);
  const auto compiler = builder.CreateString(p.compiler);
  const auto options = builder.CreateString(p.options);
  const auto provenance =
      fbs::CreateProvenance(builder, p.model_hash, model_name, compiler, options);
  const auto variants = write_all<fbs::Variant>(builder, package.variants, write_variant);
  const auto weights = builder.CreateVector(package.weights);
  fbs::FinishPackageBuffer(builder, fbs::CreatePackage(builder, kPackageMajor, kPackageMinor,
                                                       provenance, variants, weights));
  return {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()};
}

Result<Package> read_package(std::span<const uint8_t> bytes) {
  if (reinterpret_cast<uintptr_t>(bytes.data()) % kFileAlignment == 0) return read_aligned(bytes);
  const std::vector<uint8_t> copy(bytes.begin(), bytes.end());  // 64-bit fields are read in place
  return read_aligned(copy);
}

bool is_package(std::span<const uint8_t> bytes) {
  // The root offset and the identifier.
  return bytes.size() >= 8 && fbs::PackageBufferHasIdentifier(bytes.data());
}

}  // namespace shale
