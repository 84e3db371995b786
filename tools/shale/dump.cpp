// shale dump: a model as text, a package as a listing, its shaders as assembly.
#include "compiler/frontend/frontend.h"
#include "compiler/spirv/check.h"
#include "ir/base/file.h"
#include "ir/text/text.h"
#include "tools/shale/command.h"

namespace shale {
namespace {

struct Arguments {
  std::string file, output;
  std::string what = "text";
  uint32_t variant = 0;
  int32_t module = -1;
};

/// Offsets and lives of intermediate tensors, one line each, in order of offset.
std::string memory_plan(const Variant& variant) {
  std::string text = fmt::format("arena {} bytes\n  {:>12} {:>12}  first  last  tensor\n",
                                 variant.arena_bytes, "offset", "bytes");
  std::vector<const Resource*> tensors;
  for (const Resource& resource : variant.resources)
    if (resource.category == Category::kIntermediate) tensors.push_back(&resource);
  std::stable_sort(tensors.begin(), tensors.end(), [](const Resource* a, const Resource* b) {
    return a->offset_bytes < b->offset_bytes;
  });
  for (const Resource* tensor : tensors) {
    const size_t index = static_cast<size_t>(tensor - variant.resources.data());
    size_t number = 0, first = SIZE_MAX, last = 0;
    for (const Segment& segment : variant.segments)
      for (const Dispatch& dispatch : segment.dispatches) {
        for (const Binding& binding : dispatch.bindings)
          if (binding.resource == index) first = std::min(first, number), last = number;
        ++number;
      }
    text += fmt::format("  {:>12} {:>12}  {:>5} {:>5}  {}\n", tensor->offset_bytes,
                        tensor->size_bytes, first, last, tensor->name);
  }
  return text;
}

Result<std::string> dump_text(const Arguments& arguments) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(arguments.file));
  if (!is_package(bytes)) {
    if (arguments.what != "text")
      return bad_input("--what", "\"{}\" needs a package, the file is a model", arguments.what);
    SHALE_TRY(const Graph graph, import_model(bytes));
    return print_text(graph);
  }
  SHALE_TRY(const Package package, read_package(bytes));
  if (arguments.what == "text") return dump_package(package);
  if (arguments.variant >= package.variants.size())
    return bad_input("--variant", "found {}, the package has {}", arguments.variant,
                     package.variants.size());
  const Variant& variant = package.variants[arguments.variant];
  if (arguments.what == "memory") return memory_plan(variant);
  std::string text;
  for (size_t i = 0; i < variant.modules.size(); ++i) {
    if (arguments.module >= 0 && i != static_cast<size_t>(arguments.module)) continue;
    SHALE_TRY(const std::string assembly, disassemble_spirv(variant.modules[i]));
    text += fmt::format("; module {}\n{}", i, assembly);
  }
  if (text.empty())
    return bad_input("--module", "found {}, the variant has {}", arguments.module,
                     variant.modules.size());
  return text;
}

Result<int> dump(const Arguments& arguments) {
  Result<std::string> text = dump_text(arguments);
  if (!text) return in_file(arguments.file, text.error());
  if (arguments.output.empty()) {
    fmt::print("{}", *text);
    return kDone;
  }
  SHALE_TRY_VOID(write_text(arguments.output, *text));
  return kDone;
}

}  // namespace

Action add_dump(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("file", arguments->file, "model (.tosa, .tir) or package (.shale)")->required();
  app.add_option("-o,--output", arguments->output, "write to a file instead of the terminal");
  app.add_option("--what", arguments->what,
                 "text: the graph or the package; memory: the arena; spirv: the shaders")
      ->check(CLI::IsMember({"text", "memory", "spirv"}));
  app.add_option("--variant", arguments->variant, "variant of the package");
  app.add_option("--module", arguments->module, "only this shader module");
  app.footer("Example: shale dump srpo.shale --what memory");
  return [arguments] { return dump(*arguments); };
}

}  // namespace shale
