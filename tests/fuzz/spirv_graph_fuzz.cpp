// SPIR-V graph modules of any content: refused with an error, or a graph that survives write and
// read, with its constants inline and outside.
#include <cstdlib>

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "ir/verify/verify.h"

namespace {

std::span<const uint8_t> bytes_of(const std::vector<uint32_t>& words) {
  return {reinterpret_cast<const uint8_t*>(words.data()), words.size() * 4};
}

/// The first entry point, with bytes for its external constants.
void check(std::span<const uint8_t> module, const shale::SpirvEntryPoint& entry) {
  std::vector<std::vector<uint8_t>> data;
  int64_t total = 0;
  for (const shale::TensorType& type : entry.constant_types) {
    total += *shale::element_count(type.shape) * shale::dtype_info(type.dtype).host_bytes;
    if (total > 1 << 20) return;
    data.push_back(shale::Tensor::zeros(type).bytes);
    for (size_t i = 0; i < data.back().size(); i += 3) data.back()[i] = 1;
  }
  shale::SpirvGraphOptions options;
  options.entry_point = entry.name;
  for (size_t i = 0; i < data.size(); ++i)
    options.constants.push_back({entry.constant_ids[i], data[i]});
  for (const shale::SpirvEntryPoint::Slot& slot : entry.inputs) {
    shale::Shape shape = slot.ranked ? slot.type.shape : shale::Shape(4);
    for (int64_t& size : shape) size = 4;
    if (slot.type.shape.empty() || slot.type.shape[0] == shale::kDynamic)
      options.interface.push_back({slot.set, slot.binding, {slot.type.dtype, shape}, ""});
  }
  const shale::Result<shale::Graph> graph = shale::read_spirv_graph(module, options);
  if (!graph || !shale::verify(*graph)) return;
  for (const bool external : {false, true}) {
    const auto written = shale::write_spirv_graph(*graph, {.external_constants = external});
    if (!written) {
      if (written.error().code != shale::ErrorCode::kUnsupported) std::abort();
      continue;
    }
    shale::SpirvGraphOptions again_options;
    for (uint32_t i = 0; i < written->constants.size(); ++i)
      again_options.constants.push_back({i, written->constants[i].bytes});
    const shale::Result<shale::Graph> again =
        shale::read_spirv_graph(bytes_of(written->words), again_options);
    if (!again || !(*again == *graph)) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const auto entries = shale::list_spirv_entry_points({data, size});
  if (entries) check({data, size}, entries->front());
  return 0;
}
