#include "compiler/plan/accessors.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <set>

namespace shale {
namespace {

constexpr std::array<VerbInfo, kVerbCount> kVerbs{{
    {"fetch", true, false},
    {"fetch2", true, false},
    {"fetch4", true, false},
    {"sample", true, false},
    {"store", true, true},
    {"store2", true, true},
    {"max", true, true},
    {"codes", false, false},
    {"word", false, false},
    {"words4", false, false},
    {"element", false, false},
    {"store_word", false, true},
    {"store_words2", false, true},
    {"store_element", false, true},
}};

/// How texels of a format appear in a shader. "{0}" stands for a texel, or for the word or pair of words that holds one.
struct TexelType {
  ImageFormat format;
  const char* fetched;     ///< type of a fetched texel
  const char* stored;      ///< type of a stored one
  const char* from_image;  ///< the fetched texel of what an image gives
  const char* to_image;    ///< what imageStore takes of a stored texel
  const char* from_words;  ///< the fetched texel of words; null without a buffer form
  const char* to_words;    ///< the words of a stored texel
};

constexpr std::array<TexelType, 10> kTexelTypes{{
    {ImageFormat::kRgba16Float, "HALF4", "HALF4", "half4_of_image({0})", "image_of_half4({0})",
     "{0}", "pair({0}.x, {0}.y)"},
    {ImageFormat::kRg16Float, "HALF2", "HALF2", "half2_of_image({0}.rg)", "image_of_half2({0})",
     "{0}", "{0}"},
    {ImageFormat::kR32Float, "float", "float", "{0}.r", "vec4({0})", "uintBitsToFloat({0})",
     "floatBitsToUint({0})"},
    {ImageFormat::kR32Uint, "uint", "uint", "{0}.r", "uvec4({0})", "{0}", "{0}"},
    {ImageFormat::kRgba8Snorm, "SNORM4", "uint", "snorm4_of_image({0})",
     "vec4(max(signed_bytes({0}), -127)) * (1.0 / 127.0)", "{0}", "{0}"},
    {ImageFormat::kRgba8Unorm, "vec4", "vec4", "{0}", "{0}", "unpackUnorm4x8({0})",
     "packUnorm4x8({0})"},
    {ImageFormat::kRg8Unorm, "vec2", "vec2", "{0}.rg",
     "vec4(vec2(unorm_codes({0})) * (1.0 / 255.0), 0.0, 0.0)",
     "vec2({0} & 255u, {0} >> 8 & 255u) * (1.0 / 255.0)", nullptr},
    {ImageFormat::kR8Unorm, "float", "float", "{0}.r", "vec4({0})", nullptr, nullptr},
    {ImageFormat::kR16Float, "float", "float", "{0}.r", "vec4({0})", nullptr, nullptr},
    // In place of rgba16_float where a frame is made wide (SHALE_WIDE).
    {ImageFormat::kRgba32Float, "HALF4", "HALF4", "half4_of_image({0})", "image_of_half4({0})",
     nullptr, nullptr},
}};

std::string of(const char* form, const std::string& texel) {
  return fmt::format(fmt::runtime(form), texel);
}

const TexelType* texel_type(ImageFormat format) {
  for (const TexelType& type : kTexelTypes)
    if (type.format == format) return &type;
  return nullptr;
}

/// Formats that every device filters linearly.
bool is_filterable(ImageFormat format) {
  return format != ImageFormat::kR32Float && format != ImageFormat::kR32Uint &&
         format != ImageFormat::kRgba32Float;
}

/// Writes the text and the bindings of one resource.
class Writer {
 public:
  Writer(const AccessedResource& accessed, std::vector<Binding>& bindings)
      : a_(accessed), bindings_(bindings) {}

  Result<std::string> write(const std::string& where) {
    for (const Verb verb : a_.verbs) {
      if (verb_info(verb).of_image != is_image(a_.resource->category) ||
          (is_image(a_.resource->category) && !type()) ||
          (verb == Verb::kMax && a_.resource->format != ImageFormat::kR32Uint) ||
          (!verb_info(verb).of_image && a_.resource->dtype != DType::kInt8))
        return bad_input(where, "{}_{}: {} \"{}\" has no such accessor", verb_info(verb).name,
                         a_.handle, is_image(a_.resource->category) ? "image" : "tensor",
                         a_.resource->name);
      if (!verb_info(verb).of_image)
        tensor(verb);
      else if (a_.form == AccessForm::kBuffer)
        buffer(verb);
      else
        image(verb);
    }
    return text_;
  }

 private:
  const TexelType* type() const { return texel_type(a_.resource->format); }
  bool uses(Verb verb) const {
    return std::find(a_.verbs.begin(), a_.verbs.end(), verb) != a_.verbs.end();
  }

  uint32_t bind(BindingType binding, uint32_t resource, ImageFormat view, bool reads, bool writes) {
    const uint32_t number = static_cast<uint32_t>(bindings_.size());
    bindings_.push_back(
        {number, binding, resource, view, reads, writes, writes ? 0 : a_.frames_back});
    return number;
  }

  /// The variable of a texel buffer of this view, declared once.
  std::string texels(ImageFormat view) {
    const std::string name = fmt::format("{}_as_{}", a_.handle, image_format_info(view).name);
    if (text_.find(" " + name + ";") != std::string::npos) return name;
    const bool is_signed = view == ImageFormat::kRgba8Sint || view == ImageFormat::kR8Sint;
    const uint32_t number = bind(BindingType::kUniformTexelBuffer, a_.index, view, true, false);
    text_ += fmt::format("layout(set = 0, binding = {}) uniform {}textureBuffer {};\n", number,
                         is_signed ? "i" : "u", name);
    return name;
  }

  /// The array of a storage buffer with such elements, declared once.
  std::string elements(const char* element, bool reads, bool writes) {
    const std::string name = fmt::format("{}_{}{}", a_.handle, element, writes ? "_out" : "_in");
    if (text_.find(" " + name + ";") == std::string::npos) {
      const uint32_t number =
          bind(BindingType::kStorageBuffer, a_.index, ImageFormat::kNone, reads, writes);
      text_ += fmt::format(
          "layout(set = 0, binding = {0}, std430) {3}buffer Block{0} {{ {1} data[]; }} {2};\n",
          number, element, name, reads && writes ? "" : (writes ? "writeonly " : "readonly "));
    }
    return name + ".data";
  }

  void function(const std::string& signature, const std::string& body) {
    text_ += fmt::format("{} {{ {} }}\n", signature, body);
  }

  /// Bilinear from four fetches.
  void sample_by_fetches() {
    const std::string size = fmt::format("ivec2({}, {})", a_.resource->width, a_.resource->height);
    const bool is_half4 = a_.resource->format == ImageFormat::kRgba16Float ||
                          a_.resource->format == ImageFormat::kRgba32Float;
    if (is_half4 && a_.is_linear) {  // weighed when the numbers are asked for
      function(
          fmt::format("SAMPLED_HALF4 sample_{}(vec2 uv)", a_.handle),
          fmt::format("const Bilinear b = bilinear_at(uv, {0}); SAMPLED_HALF4 s; s.part = b.part; "
                      "[[unroll]] for (int i = 0; i < 4; ++i) s.texels[i] = "
                      "fetch_{1}(bilinear_texel(b, i, {0})); return s;",
                      size, a_.handle));
      return;
    }
    function(
        fmt::format("{} sample_{}(vec2 uv)", is_half4 ? "SAMPLED_HALF4" : type()->fetched,
                    a_.handle),
        fmt::format("const Bilinear b = bilinear_at(uv, {0}); {2} sum = {2}(0); "
                    "[[unroll]] for (int i = 0; i < 4; ++i) sum += bilinear_weight(b.part, i) * "
                    "fetch_{1}(bilinear_texel(b, i, {0})); return {3};",
                    size, a_.handle, type()->fetched, is_half4 ? "SAMPLED_HALF4(sum)" : "sum"));
  }

  // --- images in buffers

  void buffer(Verb verb) {
    const uint32_t bytes = image_format_info(a_.resource->format).texel_bytes;
    const uint32_t pitch = linear_pitch(a_.resource->format, a_.resource->width);
    const std::string at = fmt::format("at.y * {} + at.x", pitch);
    switch (verb) {
      case Verb::kFetch: {
        if (text_.find(fmt::format(" fetch_{}(", a_.handle)) != std::string::npos) return;
        std::string words;
        if (a_.resource->format == ImageFormat::kRgba8Snorm)
          words = fmt::format("texelFetch({}, {})", texels(ImageFormat::kRgba8Sint), at);
        else if (bytes == 8)
          words = fmt::format("texelFetch({}, {}).rg", texels(ImageFormat::kRg32Uint), at);
        else if (bytes == 4)
          words = fmt::format("texelFetch({}, {}).r", texels(ImageFormat::kR32Uint), at);
        else  // two texels a word
          words = fmt::format("texelFetch({}, at.y * {} + (at.x >> 1)).r >> 16 * (at.x & 1)",
                              texels(ImageFormat::kR32Uint), pitch / 2);
        const char* kind = a_.resource->format == ImageFormat::kRgba8Snorm ? "ivec4"
                           : bytes == 8                                    ? "uvec2"
                                                                           : "uint";
        function(
            fmt::format("{} fetch_{}(ivec2 at)", type()->fetched, a_.handle),
            fmt::format("const {} w = {}; return {};", kind, words, of(type()->from_words, "w")));
        return;
      }
      case Verb::kFetch2:
      case Verb::kFetch4: {
        const uint32_t count = verb == Verb::kFetch2 ? 2 : 4;
        const uint32_t fetches = std::max(1u, bytes * count / 16), per_fetch = count / fetches;
        const std::string view =
            texels(bytes * count >= 16 ? ImageFormat::kRgba32Uint : ImageFormat::kRg32Uint);
        std::string body;
        for (uint32_t i = 0; i < fetches; ++i) {
          body += fmt::format("const uvec4 f{0} = texelFetch({1}, at.y * {2} + {3}at.x + {0}); ", i,
                              view, pitch / per_fetch,
                              fetches == 1 ? "" : fmt::format("{} * ", fetches));
          for (uint32_t k = 0; k < per_fetch; ++k)
            body += fmt::format(
                "t[{}] = {}; ", i * per_fetch + k,
                of(type()->from_words, bytes == 8 ? fmt::format("f{}.{}", i, k == 0 ? "xy" : "zw")
                                                  : fmt::format("f{}[{}]", i, k)));
        }
        function(fmt::format("void fetch{0}_{1}(ivec2 at, out {2} t[{0}])", count, a_.handle,
                             type()->fetched),
                 body);
        return;
      }
      case Verb::kSample:
        buffer(Verb::kFetch);
        sample_by_fetches();
        return;
      case Verb::kStore: {
        const std::string data = elements(bytes == 8 ? "PAIR" : "uint", false, true);
        function(fmt::format("void store_{}(ivec2 at, {} t)", a_.handle, type()->stored),
                 fmt::format("{}[{}] = {};", data, at, of(type()->to_words, "t")));
        return;
      }
      case Verb::kStore2: store_two(bytes, pitch); return;
      case Verb::kMax:
        function(fmt::format("void max_{}(ivec2 at, uint t)", a_.handle),
                 fmt::format("atomicMax({}[{}], t);", elements("uint", true, true), at));
        return;
      case Verb::kCodes:
      case Verb::kWord:
      case Verb::kWords4:
      case Verb::kElement:
      case Verb::kStoreWord:
      case Verb::kStoreWords2:
      case Verb::kStoreElement: return;  // of tensors
    }
  }

  void store_two(uint32_t bytes, uint32_t pitch) {
    const std::string stored = type()->stored;
    const std::string signature =
        fmt::format("void store2_{0}(ivec2 at, {1} a, {1} b)", a_.handle, stored);
    if (bytes == 8) {
      const std::string data = elements("PAIR", false, true);
      function(signature,
               fmt::format("const int i = at.y * {0} + at.x; {1}[i] = pair(a.x, a.y); {1}[i + 1] = "
                           "pair(b.x, b.y);",
                           pitch, data));
      return;
    }
    const std::string at = fmt::format("at.y * {} + (at.x >> 1)", pitch / 2);
    if (bytes == 2) {  // rg8: both in a word
      function(signature,
               fmt::format(
                   "const uvec2 p = unorm_codes(a), q = unorm_codes(b); {}[{}] = whole(p.x | p.y "
                   "<< 8 | q.x << 16 | q.y << 24);",
                   elements("uint", false, true), at));
      return;
    }
    function(signature, fmt::format("{}[{}] = pair({}, {});", elements("PAIR", false, true), at,
                                    of(type()->to_words, "a"), of(type()->to_words, "b")));
  }

  // --- images as images

  /// The variable that reads the image, declared once.
  std::string read_image() {
    const std::string name = a_.handle + "_image";
    if (text_.find(" " + name + ";") != std::string::npos) return name;
    const bool samples =
        uses(Verb::kSample) && is_filterable(a_.resource->format) && !a_.loads && !a_.is_linear;
    const char* sign = a_.resource->format == ImageFormat::kR32Uint ? "u" : "";
    if (a_.loads) {
      text_ +=
          fmt::format("layout(set = 0, binding = {}, {}) readonly uniform {}image2D {};\n",
                      bind(BindingType::kStorageImage, a_.index, ImageFormat::kNone, true, false),
                      image_format_info(a_.resource->format).glsl, sign, name);
    } else {
      text_ += fmt::format("layout(set = 0, binding = {}) uniform {}{}2D {};\n",
                           bind(samples ? BindingType::kSampler : BindingType::kSampledImage,
                                a_.index, ImageFormat::kNone, true, false),
                           sign, samples ? "sampler" : "texture", name);
    }
    return name;
  }

  std::string write_image(uint32_t resource, ImageFormat format, const char* suffix, bool reads) {
    const std::string name = a_.handle + suffix;
    if (text_.find(" " + name + ";") != std::string::npos) return name;
    text_ +=
        fmt::format("layout(set = 0, binding = {}, {}) {}uniform {}image2D {};\n",
                    bind(BindingType::kStorageImage, resource, ImageFormat::kNone, reads, true),
                    image_format_info(format).glsl, reads ? "" : "writeonly ",
                    format == ImageFormat::kR32Uint ? "u" : "", name);
    return name;
  }

  /// Statements that store a texel, in the image that shows it too.
  std::string stores(const char* at, const char* texel) {
    const std::string value = of(type()->to_image, texel);
    std::string body =
        fmt::format("imageStore({}, {}, {});",
                    write_image(a_.index, a_.resource->format, "_out", false), at, value);
    if (a_.mirror)
      body += fmt::format(" imageStore({}, {}, {});",
                          write_image(*a_.mirror, a_.resource->format, "_shown", false), at, value);
    return body;
  }

  void image(Verb verb) {
    const auto fetched = [&](const std::string& at) {
      return of(type()->from_image, a_.loads
                                        ? fmt::format("imageLoad({}, {})", read_image(), at)
                                        : fmt::format("texelFetch({}, {}, 0)", read_image(), at));
    };
    switch (verb) {
      case Verb::kFetch:
        if (text_.find(fmt::format(" fetch_{}(", a_.handle)) != std::string::npos) return;
        function(fmt::format("{} fetch_{}(ivec2 at)", type()->fetched, a_.handle),
                 fmt::format("return {};", fetched("at")));
        return;
      case Verb::kFetch2:
      case Verb::kFetch4: {
        const uint32_t count = verb == Verb::kFetch2 ? 2 : 4;
        std::string body;
        for (uint32_t i = 0; i < count; ++i)
          body += fmt::format("t[{}] = {}; ", i,
                              fetched(fmt::format("ivec2(min({} * at.x + {}, {}), at.y)", count, i,
                                                  a_.resource->width - 1)));
        function(fmt::format("void fetch{0}_{1}(ivec2 at, out {2} t[{0}])", count, a_.handle,
                             type()->fetched),
                 body);
        return;
      }
      case Verb::kSample: {
        if (a_.loads || !is_filterable(a_.resource->format) || a_.is_linear) {
          image(Verb::kFetch);
          sample_by_fetches();
          return;
        }
        const std::string value = fmt::format("textureLod({}, uv, 0.0)", read_image());
        if (a_.resource->format == ImageFormat::kRgba16Float)
          function(fmt::format("SAMPLED_HALF4 sample_{}(vec2 uv)", a_.handle),
                   fmt::format("return SAMPLED_HALF4({});", value));
        else
          function(fmt::format("{} sample_{}(vec2 uv)", type()->fetched, a_.handle),
                   fmt::format("return {};", of(type()->from_image, value)));
        return;
      }
      case Verb::kStore: {
        const std::string body = stores("at", "t");
        function(fmt::format("void store_{}(ivec2 at, {} t)", a_.handle, type()->stored), body);
        return;
      }
      case Verb::kStore2: {
        const std::string left = stores("at", "a"), right = stores("at + ivec2(1, 0)", "b");
        function(fmt::format("void store2_{0}(ivec2 at, {1} a, {1} b)", a_.handle, type()->stored),
                 fmt::format("{} if (at.x + 1 < {}) {{ {} }}", left, a_.resource->width, right));
        return;
      }
      case Verb::kMax:
        function(fmt::format("void max_{}(ivec2 at, uint t)", a_.handle),
                 fmt::format("imageAtomicMax({}, at, t);",
                             write_image(a_.index, a_.resource->format, "_out", true)));
        return;
      case Verb::kCodes:
      case Verb::kWord:
      case Verb::kWords4:
      case Verb::kElement:
      case Verb::kStoreWord:
      case Verb::kStoreWords2:
      case Verb::kStoreElement: return;  // of tensors
    }
  }

  // --- int8 tensors

  void tensor(Verb verb) {
    const bool as_texels = a_.form == AccessForm::kBuffer;
    const std::string& h = a_.handle;
    const auto word = [&](const std::string& i) {
      return fmt::format("{}[{}]", elements("uint", true, false), i);
    };
    switch (verb) {
      case Verb::kCodes:
        function(fmt::format("ivec4 codes_{}(int i)", h),
                 as_texels
                     ? fmt::format("return texelFetch({}, i);", texels(ImageFormat::kRgba8Sint))
                     : fmt::format("return signed_bytes({});", word("i")));
        return;
      case Verb::kWord:
        function(fmt::format("uint word_{}(int i)", h),
                 as_texels ? fmt::format("return texelFetch({}, i / 4)[i % 4];",
                                         texels(ImageFormat::kRgba32Uint))
                           : fmt::format("return {};", word("i")));
        return;
      case Verb::kWords4:
        function(fmt::format("uvec4 words4_{}(int i)", h),
                 as_texels
                     ? fmt::format("return texelFetch({}, i);", texels(ImageFormat::kRgba32Uint))
                     : fmt::format("return uvec4({}, {}, {}, {});", word("4 * i"),
                                   word("4 * i + 1"), word("4 * i + 2"), word("4 * i + 3")));
        return;
      case Verb::kElement:
        function(fmt::format("int element_{}(int i)", h),
                 as_texels
                     ? fmt::format("return texelFetch({}, i).r;", texels(ImageFormat::kR8Sint))
                     : fmt::format("return int({}) << 24 - 8 * (i & 3) >> 24;", word("i >> 2")));
        return;
      case Verb::kStoreWord:
        function(fmt::format("void store_word_{}(int i, uint w)", h),
                 fmt::format("{}[i] = w;", elements("uint", false, true)));
        return;
      case Verb::kStoreWords2:
        function(fmt::format("void store_words2_{}(int i, uint a, uint b)", h),
                 fmt::format("{}[i] = pair(a, b);", elements("PAIR", false, true)));
        return;
      case Verb::kStoreElement:
        function(fmt::format("void store_element_{}(int i, int v)", h),
                 fmt::format("{}[i] = int8_t(v);", elements("int8_t", false, true)));
        return;
      case Verb::kFetch:
      case Verb::kFetch2:
      case Verb::kFetch4:
      case Verb::kSample:
      case Verb::kStore:
      case Verb::kStore2:
      case Verb::kMax: return;  // of images
    }
  }

  const AccessedResource& a_;
  std::vector<Binding>& bindings_;
  std::string text_;
};

}  // namespace

const VerbInfo& verb_info(Verb verb) { return kVerbs[static_cast<size_t>(verb)]; }

const char* fetched_type(ImageFormat format) { return texel_type(format)->fetched; }

bool has_buffer_form(ImageFormat format, Verb verb) {
  if (!verb_info(verb).of_image) return false;
  if (format == ImageFormat::kRg8Unorm) return verb == Verb::kFetch || verb == Verb::kStore2;
  const TexelType* type = texel_type(format);
  if (!type || !type->to_words) return false;
  // Codes of snorm come one texel a fetch.
  return format != ImageFormat::kRgba8Snorm || (verb != Verb::kFetch2 && verb != Verb::kFetch4);
}

std::vector<Use> uses_in(std::string_view glsl, std::span<const std::string> handles) {
  const auto is_name = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_';
  };
  std::vector<std::string_view> names;
  for (size_t at = 0; at < glsl.size();) {
    if (!is_name(glsl[at])) {
      ++at;
      continue;
    }
    size_t end = at;
    while (end < glsl.size() && is_name(glsl[end])) ++end;
    names.push_back(glsl.substr(at, end - at));
    at = end;
  }
  std::sort(names.begin(), names.end());
  std::vector<Use> uses;
  const std::set<std::string_view> once(handles.begin(), handles.end());
  for (const std::string_view handle : once)
    for (size_t v = 0; v < kVerbCount; ++v)
      if (std::binary_search(names.begin(), names.end(),
                             fmt::format("{}_{}", kVerbs[v].name, handle)))
        uses.push_back({static_cast<Verb>(v), std::string(handle)});
  return uses;
}

Result<std::string> accessor_text(const AccessedResource& accessed, std::vector<Binding>& bindings,
                                  const std::string& where) {
  return Writer(accessed, bindings).write(where);
}

}  // namespace shale
