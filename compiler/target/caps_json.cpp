#include "compiler/target/caps_json.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>

#include "ir/base/json.h"

namespace shale {
namespace {

using Json = nlohmann::ordered_json;

constexpr uint32_t kVersionShifts[] = {22, 12, 0};
constexpr uint32_t kVersionMasks[] = {0x7f, 0x3ff, 0xfff};
constexpr size_t kMostProducts = 1024;  ///< no device has so many

std::string version_text(uint32_t version) {
  std::string text;
  for (const size_t i : {0u, 1u, 2u})
    text += fmt::format("{}{}", i > 0 ? "." : "", version >> kVersionShifts[i] & kVersionMasks[i]);
  return text;
}

/// Members of an object, read one by one; the first error stays.
class Reader {
 public:
  explicit Reader(const Json& json) : json_(json) {}

  const Result<void>& result() const { return result_; }

  template <typename Integer>
  void number(const char* name, Integer& value) {
    const Json* member = find(name);
    if (member) number_of(*member, name, value);
  }

  void text(const char* name, std::string& value) {
    const Json* member = find(name);
    if (!member) return;
    if (!member->is_string()) return fail(name, "expected a text");
    value = member->get<std::string>();
  }

  void version(const char* name, uint32_t& value) {
    std::string digits;
    text(name, digits);
    const char* at = digits.data();
    const char* const end = at + digits.size();
    for (const size_t i : {0u, 1u, 2u}) {
      uint32_t part = 0;
      const auto [next, status] = std::from_chars(at, end, part);
      const bool is_last = i == 2;
      if (status != std::errc() || part > kVersionMasks[i] ||
          (is_last ? next != end : next == end || *next != '.'))
        return fail(name, "expected a version such as 1.3.246");
      value |= part << kVersionShifts[i];
      at = next + 1;
    }
  }

  void three(const char* name, uint32_t (&values)[3]) {
    const Json* member = find(name);
    if (!member) return;
    if (!member->is_array() || member->size() != 3) return fail(name, "expected three numbers");
    for (const size_t i : {0u, 1u, 2u}) number_of((*member)[i], name, values[i]);
  }

  void features(const char* name, FeatureSet& features) {
    const Json* member = find(name);
    if (!member) return;
    if (!member->is_object()) return fail(name, "expected an object of true and false");
    for (const auto& [key, value] : member->items()) {
      if (!value.is_boolean())
        return fail(fmt::format("{}.{}", name, key), "expected true or false");
      for (uint32_t i = 0; i < kFeatureCount; ++i)
        if (const auto feature = static_cast<Feature>(i);
            key == feature_name(feature) && value.get<bool>())
          features.add(feature);
    }
  }

  void processor(const char* name, Processor& processor) {
    std::string found;
    text(name, found);
    for (uint32_t i = 0; i < kProcessorCount; ++i)
      if (processor = static_cast<Processor>(i); found == processor_name(processor)) return;
    fail(name, "expected unknown, sse, avx2, avx512 or neon");
  }

  void products(const char* name, std::vector<MatrixProduct>& products) {
    const Json* member = find(name);
    if (!member) return;
    if (!member->is_array() || member->size() > kMostProducts)
      return fail(name, "expected a list of at most 1024 products");
    for (const Json& row : *member) {
      if (!row.is_array() || row.size() != 3) return fail(name, "expected lists of m, n and k");
      MatrixProduct product;
      number_of(row[0], name, product.m);
      number_of(row[1], name, product.n);
      number_of(row[2], name, product.k);
      products.push_back(product);
    }
    std::sort(products.begin(), products.end());
    products.erase(std::unique(products.begin(), products.end()), products.end());
  }

  void fail(const std::string& name, std::string_view expected) {
    if (result_) result_ = bad_input(name, "{}", expected);
  }

 private:
  const Json* find(const char* name) {
    const auto found = json_.find(name);
    if (found == json_.end()) {
      fail(name, "is missing");
      return nullptr;
    }
    return &*found;
  }

  template <typename Integer>
  void number_of(const Json& json, const char* name, Integer& value) {
    if (!json.is_number_unsigned() || json.get<uint64_t>() > std::numeric_limits<Integer>::max())
      return fail(name, "expected a whole number that is not negative");
    value = json.get<Integer>();
  }

  const Json& json_;
  Result<void> result_;
};

}  // namespace

std::string caps_json(const DeviceCaps& caps) {
  Json features = Json::object();
  for (uint32_t i = 0; i < kFeatureCount; ++i)
    features[feature_name(static_cast<Feature>(i))] = caps.features.has(static_cast<Feature>(i));
  Json products = Json::array();
  for (const MatrixProduct& p : caps.matrix_products)
    products.push_back(Json::array({p.m, p.n, p.k}));
  const Json json{{"schema", kCapsSchema},
                  {"name", caps.name},
                  {"driver", caps.driver},
                  {"vulkan", version_text(caps.api_version)},
                  {"kind", caps.cpu ? "CPU" : "GPU"},
                  {"processor", processor_name(caps.processor)},
                  {"features", features},
                  {"subgroup_size", caps.subgroup_size},
                  {"matrix_products", products},
                  {"max_workgroup_invocations", caps.max_workgroup_invocations},
                  {"max_workgroup_size", caps.max_workgroup_size},
                  {"max_workgroup_count", caps.max_workgroup_count},
                  {"shared_bytes", caps.max_shared_bytes},
                  {"storage_range_bytes", caps.max_storage_range_bytes},
                  {"texel_elements", caps.max_texel_elements},
                  {"storage_buffers", caps.max_storage_buffers},
                  {"texel_buffers", caps.max_texel_buffers},
                  {"storage_images", caps.max_storage_images}};
  return json.dump(2, ' ', false, Json::error_handler_t::replace);
}

Result<DeviceCaps> parse_caps(const std::string& text) {
  SHALE_TRY(Json json, parse_json<Json>(text));
  if (json.is_object() && json.contains("devices") && json["devices"].is_array()) {
    if (json["devices"].empty()) return bad_input("devices", "there is none");
    json = Json(json["devices"][0]);
  }
  if (!json.is_object() || json.value("schema", Json()) != Json(kCapsSchema))
    return bad_input("", "is no description of a device, expected schema {}", kCapsSchema);
  Reader reader(json);
  DeviceCaps caps;
  std::string kind;
  reader.text("name", caps.name);
  reader.text("driver", caps.driver);
  reader.version("vulkan", caps.api_version);
  reader.text("kind", kind);
  if (json.contains("processor")) reader.processor("processor", caps.processor);
  reader.features("features", caps.features);
  reader.number("subgroup_size", caps.subgroup_size);
  reader.products("matrix_products", caps.matrix_products);
  reader.number("max_workgroup_invocations", caps.max_workgroup_invocations);
  reader.three("max_workgroup_size", caps.max_workgroup_size);
  reader.three("max_workgroup_count", caps.max_workgroup_count);
  reader.number("shared_bytes", caps.max_shared_bytes);
  reader.number("storage_range_bytes", caps.max_storage_range_bytes);
  reader.number("texel_elements", caps.max_texel_elements);
  reader.number("storage_buffers", caps.max_storage_buffers);
  reader.number("texel_buffers", caps.max_texel_buffers);
  reader.number("storage_images", caps.max_storage_images);
  caps.cpu = kind == "CPU";
  if (kind != "CPU" && kind != "GPU") reader.fail("kind", "expected CPU or GPU");
  if (!caps.matrix_products.empty() != caps.features.has(Feature::kCooperativeMatrix))
    reader.fail("matrix_products", "there are some where, and only where, features names them");
  SHALE_TRY_VOID(reader.result());
  return caps;
}

}  // namespace shale
