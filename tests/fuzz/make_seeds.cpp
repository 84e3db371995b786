// make_seeds FOLDER FILE.tosa...: a corpus for every fuzz target, from real models.
#include <filesystem>

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "compiler/frontend/vgf/convert.h"
#include "ir/base/file.h"
#include "ir/binary/tosa.h"
#include "ir/package/package.h"
#include "ir/text/text.h"
#include "runtime/vk/pipeline_cache.h"

namespace shale {
namespace {

/// A small package that uses every table of the schema.
Package small_package() {
  Package package;
  package.provenance = {1, "seed", "shale", "none"};
  package.weights = {1, 2, 3, 4};
  Variant variant;
  variant.target = "lavapipe";
  variant.requirements.storage_buffers = 3;
  variant.requirements.storage_range_bytes = 16;
  variant.arena_bytes = 256;
  const auto tensor = [](const char* name, Category category) {
    Resource resource;
    resource.name = name;
    resource.category = category;
    resource.dtype = DType::kInt8;
    resource.shape = {1, 2, 2, category == Category::kWeights ? 1 : 4};
    resource.size_bytes = category == Category::kWeights ? 4 : 16;
    return resource;
  };
  variant.resources = {tensor("x", Category::kInput), tensor("y", Category::kOutput),
                       tensor("w", Category::kWeights), tensor("t", Category::kIntermediate)};
  variant.resources[0].quantization = Quantization{0.5f, 3};
  variant.modules = {{0x07230203, 0x00010600, 0, 8, 0}};
  Dispatch dispatch;
  dispatch.name = "y";
  dispatch.kernel = "generic";
  for (uint32_t i = 0; i < 3; ++i)
    dispatch.bindings.push_back(
        {i, BindingType::kStorageBuffer, i == 1 ? 1u : i, ImageFormat::kNone, i != 1, i == 1, 0});
  variant.segments = {{"graph", SegmentKind::kGraph, {dispatch}}};
  variant.proofs = {{"y", {-1, -2}, {1, 2}, {5, 6}}};
  package.variants = {variant};
  return package;
}

Result<void> make_seeds(const std::string& folder, std::span<char*> models) {
  namespace fs = std::filesystem;
  std::error_code error;
  for (const char* target : {"tosa_fuzz", "tir_fuzz", "spirv_graph_fuzz", "vgf_fuzz",
                             "package_fuzz", "pack_fuzz", "pipeline_cache_fuzz"})
    fs::create_directories(fs::path(folder) / target, error);
  if (error) return io_error(folder, "cannot create: {}", error.message());
  const auto path = [&](const char* target, const std::string& name) {
    return (fs::path(folder) / target / name).string();
  };
  for (size_t i = 0; i < models.size(); ++i) {
    SHALE_TRY(const std::vector<uint8_t> bytes, read_file(models[i]));
    SHALE_TRY_VOID(write_file(path("tosa_fuzz", fmt::format("{}", i)), bytes));
    const Result<Graph> graph = read_tosa(bytes);
    if (!graph) continue;
    SHALE_TRY_VOID(write_text(path("tir_fuzz", fmt::format("{}", i)), print_text(*graph)));
    if (const Result<Vgf> vgf = graph_to_vgf(*graph)) {
      SHALE_TRY(const std::vector<uint8_t> file, write_vgf(*vgf));
      SHALE_TRY_VOID(write_file(path("vgf_fuzz", fmt::format("{}", i)), file));
    }
    for (const bool external : {false, true}) {
      const auto module = write_spirv_graph(*graph, {.external_constants = external});
      if (!module) continue;  // not a legal graph
      const auto* words = reinterpret_cast<const uint8_t*>(module->words.data());
      SHALE_TRY_VOID(
          write_file(path("spirv_graph_fuzz", fmt::format("{}{}", i, external ? "e" : "")),
                     {words, module->words.size() * 4}));
      SHALE_TRY_VOID(write_file(path("pack_fuzz", fmt::format("{}{}", i, external ? "e" : "")),
                                {words, module->words.size() * 4}));
    }
  }
  SHALE_TRY_VOID(write_file(path("package_fuzz", "small"), write_package(small_package())));
  SHALE_TRY(const Vgf passes, package_to_vgf(small_package(), {.weights_as_inputs = true}));
  SHALE_TRY(const std::vector<uint8_t> compute, write_vgf(passes));
  SHALE_TRY_VOID(write_file(path("vgf_fuzz", "compute"), compute));
  vk::CacheIdentity identity;
  identity.vendor_id = 0x10005;
  return write_file(path("pipeline_cache_fuzz", "small"),
                    vk::write_cache_blob(std::vector<uint8_t>(64, 1), identity));
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) {
  if (argc < 2) {
    fmt::print(stderr, "usage: make_seeds FOLDER FILE.tosa...\n");
    return 2;
  }
  const shale::Result<void> result =
      shale::make_seeds(argv[1], {argv + 2, static_cast<size_t>(argc - 2)});
  if (!result) fmt::print(stderr, "error: {}\n", result.error().text());
  return result ? 0 : 1;
}
