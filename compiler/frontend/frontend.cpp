#include "compiler/frontend/frontend.h"

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "compiler/frontend/vgf/convert.h"
#include "compiler/frontend/vgf/vgf.h"
#include "ir/binary/tosa.h"
#include "ir/text/text.h"

namespace shale {
namespace {

/// The text form begins with the word graph, after spaces and comments.
bool is_text_graph(std::span<const uint8_t> bytes) {
  std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  for (;;) {
    const size_t start = text.find_first_not_of(" \t\r\n");
    if (start == std::string_view::npos) return false;
    text.remove_prefix(start);
    if (text[0] != '#') return text.starts_with("graph");
    const size_t end = text.find('\n');
    if (end == std::string_view::npos) return false;
    text.remove_prefix(end);
  }
}

/// TOSA and text files hold one graph with all its constants.
Result<void> refuse_options(const ImportOptions& options) {
  if (!options.entry_point.empty())
    return bad_input("--entry-point", "found \"{}\", the format has one unnamed entry point",
                     options.entry_point);
  if (!options.constants.empty())
    return bad_input("--constant", "the format holds its constants itself");
  return {};
}

Result<Graph> import_tosa(std::span<const uint8_t> bytes, const ImportOptions& options) {
  SHALE_TRY_VOID(refuse_options(options));
  return read_tosa(bytes);
}

Result<Graph> import_spirv(std::span<const uint8_t> bytes, const ImportOptions& options) {
  SpirvGraphOptions given;
  given.entry_point = options.entry_point;
  given.input_shapes = options.input_shapes;
  for (const auto& [id, constant] : options.constants) given.constants.push_back({id, constant});
  return read_spirv_graph(bytes, given);
}

Result<Graph> import_text(std::span<const uint8_t> bytes, const ImportOptions& options) {
  SHALE_TRY_VOID(refuse_options(options));
  return parse_text({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

struct Frontend {
  std::string_view name;
  bool (*recognizes)(std::span<const uint8_t>);
  Result<Graph> (*import)(std::span<const uint8_t>, const ImportOptions&);
};

constexpr Frontend kFrontends[] = {
#define SHALE_FRONTEND(name, recognizes, import) {name, recognizes, import},
#include "compiler/frontend/frontends.def"
};

}  // namespace

std::string_view model_format(std::span<const uint8_t> bytes) {
  for (const Frontend& frontend : kFrontends)
    if (frontend.recognizes(bytes)) return frontend.name;
  return {};
}

Result<Graph> import_model(std::span<const uint8_t> bytes, const ImportOptions& options) {
  for (const Frontend& frontend : kFrontends)
    if (frontend.recognizes(bytes)) return frontend.import(bytes, options);
  return bad_input("",
                   "is no model: found neither the TOSA identifier at offset 4 nor the magic of "
                   "VGF or SPIR-V nor "
                   "the text form ({} bytes)",
                   bytes.size());
}

}  // namespace shale
