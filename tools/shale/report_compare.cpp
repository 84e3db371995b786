// The part of shale report that compares two versions of a model or of a package.
#include <optional>

#include "ir/base/file.h"
#include "ir/text/text.h"
#include "tools/shale/report.h"

namespace shale {
namespace {

/// The first thing in which two versions differ.
struct Difference {
  std::string where, what, before, after;
};

template <typename Value>
std::optional<Difference> differ(const std::string& where, const char* what, const Value& before,
                                 const Value& after) {
  if (before == after) return std::nullopt;
  return Difference{where, what, fmt::format("{}", before), fmt::format("{}", after)};
}

std::optional<Difference> first_change(const Variant& before, const Variant& after) {
  if (auto change = differ("variant", "target", before.target, after.target)) return change;
  for (size_t s = 0; s < std::min(before.segments.size(), after.segments.size()); ++s) {
    const Segment &a = before.segments[s], &b = after.segments[s];
    if (auto change = differ(fmt::format("segment {}", s), "name", a.name, b.name)) return change;
    for (size_t d = 0; d < std::min(a.dispatches.size(), b.dispatches.size()); ++d) {
      const Dispatch &x = a.dispatches[d], &y = b.dispatches[d];
      const std::string where = fmt::format("{}, dispatch {} \"{}\"", a.name, d, x.name);
      if (auto change = differ(where, "name", x.name, y.name)) return change;
      if (auto change = differ(where, "kernel", x.kernel, y.kernel)) return change;
      if (auto change = differ(where, "MACs", x.cost.macs, y.cost.macs)) return change;
      if (auto change = differ(where, "workgroups", fmt::format("{}", fmt::join(x.workgroups, "x")),
                               fmt::format("{}", fmt::join(y.workgroups, "x"))))
        return change;
      if (before.modules[x.module] != after.modules[y.module])
        return Difference{where, "code", fmt::format("{} words", before.modules[x.module].size()),
                          fmt::format("{} words", after.modules[y.module].size())};
      if (auto change = differ(where, "predicted time, us", x.cost.time_us, y.cost.time_us))
        return change;
    }
    if (auto change = differ(a.name, "dispatches", a.dispatches.size(), b.dispatches.size()))
      return change;
  }
  if (auto change = differ("variant", "segments", before.segments.size(), after.segments.size()))
    return change;
  if (before == after) return std::nullopt;
  return Difference{"variant", "resources or parameters", "", ""};
}

std::optional<Difference> first_change(const Package& before, const Package& after) {
  if (before == after) return std::nullopt;
  for (size_t v = 0; v < std::min(before.variants.size(), after.variants.size()); ++v)
    if (auto change = first_change(before.variants[v], after.variants[v])) return change;
  if (auto change = differ("package", "variants", before.variants.size(), after.variants.size()))
    return change;
  if (before.weights != after.weights)
    return Difference{"package", "weights", fmt::format("{} bytes", before.weights.size()),
                      fmt::format("{} bytes", after.weights.size())};
  return Difference{"package", "provenance", before.provenance.options, after.provenance.options};
}

/// A line of a model's text form is a graph, an input, a constant or a node, in graph order.
std::optional<Difference> first_change(const std::string& before, const std::string& after) {
  const auto line_at = [](const std::string& text, size_t at) {
    return text.substr(at, text.find('\n', at) - at);
  };
  size_t at = 0;  // of a line in both
  for (int line = 1; at < before.size() || at < after.size(); ++line) {
    const std::string a = at < before.size() ? line_at(before, at) : "",
                      b = at < after.size() ? line_at(after, at) : "";
    if (a != b) {
      // Constants make long lines: the part around the difference says enough.
      constexpr size_t kShown = 100;
      size_t from = 0;
      while (from < a.size() && from < b.size() && a[from] == b[from]) ++from;
      const size_t start = from > kShown / 4 ? from - kShown / 4 : 0;
      const auto cut = [&](const std::string& text) {
        if (text.size() <= kShown) return text;
        return (start > 0 ? "..." : "") + text.substr(std::min(start, text.size()), kShown) + "...";
      };
      const std::string name = a.substr(0, std::min(a.find(" = "), std::min(a.find(':'), kShown)));
      return Difference{fmt::format("line {} of the text form", line), name, cut(a), cut(b)};
    }
    at += a.size() + 1;
  }
  return std::nullopt;
}

}  // namespace

Result<Json> compare_files(const std::string& before, const std::string& after,
                           const ReportArguments& arguments, const Json& reports) {
  std::optional<Difference> change;
  const bool packaged = reports[0]["kind"] == "package";
  if (packaged) {
    SHALE_TRY(const std::vector<uint8_t> a, read_file(before));
    SHALE_TRY(const std::vector<uint8_t> b, read_file(after));
    SHALE_TRY(const Package x, read_package(a));
    SHALE_TRY(const Package y, read_package(b));
    change = first_change(x, y);
  } else {
    std::string text[2];
    for (size_t i = 0; i < 2; ++i) {
      SHALE_TRY(const ModelFiles model, load_model(i == 0 ? before : after, arguments.compile.frame,
                                                   arguments.compile.precision));
      if (model.bytes.empty()) continue;
      SHALE_TRY(const CompileOptions options, arguments.compile.options(model));
      SHALE_TRY(const Graph graph, shaped_graph(model.bytes, options));
      text[i] = print_text(graph);
    }
    change = first_change(text[0], text[1]);
  }
  Json json{{"before", before}, {"after", after}, {"first_change", nullptr}};
  if (change)
    json["first_change"] = {{"where", change->where},
                            {"what", change->what},
                            {"before", change->before},
                            {"after", change->after}};
  const Json* const sides[2] = {&reports[0], &reports[1]};
  const auto total = [&](const char* name, const Json::json_pointer& at) {
    if (!sides[0]->contains(at) || !sides[1]->contains(at)) return;
    const Json &a = sides[0]->at(at), &b = sides[1]->at(at);
    if (!a.is_number() || !b.is_number()) return;
    json["totals"][name] = {{"before", a}, {"after", b}};
    if (a.get<double>() != 0)
      json["totals"][name]["change"] = b.get<double>() / a.get<double>() - 1;
  };
  using Pointer = Json::json_pointer;
  total("parameters", Pointer("/parameters"));
  total("macs", Pointer("/macs"));
  total("bytes_read", Pointer("/bytes_read"));
  total("bytes_written", Pointer("/bytes_written"));
  total("arena_bytes", Pointer(packaged ? "/arena_bytes" : "/modelled/arena_bytes"));
  total(packaged ? "predicted_us" : "modelled_ms",
        Pointer(packaged ? "/time_us" : "/modelled/time_ms"));
  if (packaged) total("measured_us", Pointer("/measured_us"));
  if (!arguments.quiet) {
    fmt::print("\n{} against {}\n", after, before);
    if (!change) {
      fmt::print("  nothing changed\n");
    } else {
      fmt::print("  first change: {}: {}\n    was {}\n    is  {}\n", change->where, change->what,
                 change->before, change->after);
    }
    const Json totals = json.value("totals", Json::object());
    for (const auto& [name, values] : totals.items())
      fmt::print("  {:<16}{:>18.6g}{:>18.6g}{:>10}\n", name, values["before"].get<double>(),
                 values["after"].get<double>(),
                 values.contains("change")
                     ? fmt::format("{:+.1f} %", 100 * values["change"].get<double>())
                     : "-");
  }
  return json;
}

}  // namespace shale
