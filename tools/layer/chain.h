// tools/layer/chain.h -- pNext chains, handed on without what only the layer knows.
#pragma once

#include <vulkan/vulkan.h>

#include <cstddef>
#include <cstring>
#include <functional>
#include <initializer_list>
#include <memory>
#include <span>
#include <vector>

namespace shale::layer {

/// The structure of a type in a chain that nobody changes, or null.
template <typename T>
const T* find_in_chain(const void* next, VkStructureType type) {
  for (auto* each = static_cast<const VkBaseInStructure*>(next); each; each = each->pNext)
    if (each->sType == type) return reinterpret_cast<const T*>(each);
  return nullptr;
}
/// The same in a chain of results.
template <typename T>
T* find_in_chain(void* next, VkStructureType type) {
  return const_cast<T*>(find_in_chain<T>(static_cast<const void*>(next), type));
}

/// True for the structures of the layer's extensions; with `maintenance5` for those of the extension that it lends, too.
bool is_layers(VkStructureType type, bool maintenance5 = false);

/// A chain of the application's, copied without the layer's own structures, so that it may be changed
/// and handed on. The order of a chain means nothing. What is not known by its size cannot be copied:
/// it stays where nothing to be left out or copied follows it, and is left out otherwise.
class ChainCopy {
 public:
  explicit ChainCopy(const void* next, bool maintenance5 = false);
  const void* next() const { return links_.empty() ? tail_ : links_.front().get(); }

  /// A structure of the copy, or null.
  template <typename T>
  T* find(VkStructureType type) {
    for (const auto& link : links_)
      if (as_base(link)->sType == type) return reinterpret_cast<T*>(link.get());
    return nullptr;
  }
  /// Leaves out what is there of a type.
  void remove(VkStructureType type);
  /// Adds a structure of zeros.
  template <typename T>
  T& add(VkStructureType type) {
    return *reinterpret_cast<T*>(append(T{}, type));
  }

 private:
  using Link = std::unique_ptr<std::byte[]>;
  static VkBaseOutStructure* as_base(const Link& link) {
    return reinterpret_cast<VkBaseOutStructure*>(link.get());
  }
  template <typename T>
  std::byte* append(const T& value, VkStructureType type) {
    std::byte* copy = append_bytes(&value, sizeof(T));
    as_base(links_.back())->sType = type;
    return copy;
  }
  std::byte* append_bytes(const void* from, size_t size);

  std::vector<Link> links_;
  const void* tail_ = nullptr;
};

/// While it lives, a chain of results has none of the layer's structures, for the call down.
class WithoutLayers {
 public:
  /// `head` is the first structure, which stays.
  explicit WithoutLayers(void* head, bool maintenance5 = false);
  ~WithoutLayers();
  WithoutLayers(const WithoutLayers&) = delete;
  WithoutLayers& operator=(const WithoutLayers&) = delete;

 private:
  struct Undo {
    VkBaseOutStructure* before;
    VkBaseOutStructure* taken;
  };
  std::vector<Undo> undo_;
};

}  // namespace shale::layer
