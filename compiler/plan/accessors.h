// compiler/plan/accessors.h -- what a pass calls to read and write, written for one target.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "ir/package/package.h"

namespace shale {

/// Kinds of access, by the names that accessors have in shaders: "fetch2" of fetch2_color. The meaning stands in
/// shaders/include/access.glsl.
enum class Verb : uint8_t {
  kFetch,
  kFetch2,
  kFetch4,
  kSample,
  kStore,
  kStore2,
  kMax,
  kCodes,
  kWord,
  kWords4,
  kElement,
  kStoreWord,
  kStoreWords2,
  kStoreElement,
};
inline constexpr size_t kVerbCount = 14;

struct VerbInfo {
  std::string_view name;
  bool of_image, writes;
};
const VerbInfo& verb_info(Verb verb);

/// Where the texels or elements of a resource are reached on a target.
enum class AccessForm : uint8_t {
  kImage,   ///< sampled or storage image; a tensor's storage buffer
  kBuffer,  ///< texel buffers to read, storage buffers to write
};

/// The type of a fetched texel in a shader. The format is one that images of passes have.
const char* fetched_type(ImageFormat format);

/// A use that a shader makes of a binding.
struct Use {
  Verb verb;
  std::string handle;
  bool operator==(const Use&) const = default;
};

/// The uses in preprocessed GLSL, in the order of handles' names, then of verbs; each once.
std::vector<Use> uses_in(std::string_view glsl, std::span<const std::string> handles);

/// True if a linear image of this format can be used so.
bool has_buffer_form(ImageFormat format, Verb verb);

/// One resource of a pass under one handle.
struct AccessedResource {
  std::string handle;
  uint32_t index = 0;  ///< of the resource in the variant
  const Resource* resource = nullptr;
  std::vector<Verb> verbs;
  uint32_t frames_back = 0;
  AccessForm form = AccessForm::kImage;
  bool is_linear =
      false;           ///< texels of the frame lie in buffers (SHALE_LINEAR), if not of this image
  bool loads = false;  ///< in image form: read as a storage image, without a sampler
  std::optional<uint32_t>
      mirror;  ///< in image form: the output of this format that gets what is stored
};

/// Declarations and functions; the bindings that they declare go behind `bindings`, numbered on.
/// Errors: kBadInput for a verb that the resource does not have.
Result<std::string> accessor_text(const AccessedResource& accessed, std::vector<Binding>& bindings,
                                  const std::string& where);

}  // namespace shale
