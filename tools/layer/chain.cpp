#include "tools/layer/chain.h"

#include <vulkan/vk_layer.h>

#include <algorithm>

#include "tools/layer/arm_vulkan.h"

namespace shale::layer {
namespace {

struct Known {
  VkStructureType type;
  size_t size;
};
constexpr Known kKnown[] = {
#define SHALE_CHAIN_STRUCT(type, structure) {type, sizeof(structure)},
#include "tools/layer/chain_structs.def"
};

/// 0 for a type that is not known.
size_t struct_size(VkStructureType type) {
  for (const Known& known : kKnown)
    if (known.type == type) return known.size;
  return 0;
}

}  // namespace

bool is_layers(VkStructureType type, bool maintenance5) {
  // Registry numbers 461, 508, 509 and 632: those of the four extensions.
  const int block = static_cast<int>(type) / 1000;
  return block == 1000460 || block == 1000507 || block == 1000508 || block == 1000631 ||
         (maintenance5 && block == 1000470);
}

ChainCopy::ChainCopy(const void* next, bool maintenance5) {
  for (auto* each = static_cast<const VkBaseInStructure*>(next); each; each = each->pNext) {
    if (is_layers(each->sType, maintenance5)) continue;
    if (const size_t size = struct_size(each->sType)) {
      append_bytes(each, size);
      continue;
    }
    bool all_unknown = true;
    for (auto* after = each->pNext; after; after = after->pNext)
      all_unknown =
          all_unknown && !is_layers(after->sType, maintenance5) && struct_size(after->sType) == 0;
    if (!all_unknown) continue;
    tail_ = each;
    if (!links_.empty())
      as_base(links_.back())->pNext =
          const_cast<VkBaseOutStructure*>(static_cast<const VkBaseOutStructure*>(tail_));
    return;
  }
}

void ChainCopy::remove(VkStructureType type) {
  std::erase_if(links_, [&](const Link& link) { return as_base(link)->sType == type; });
  for (size_t i = 0; i < links_.size(); ++i)
    as_base(links_[i])->pNext =
        i + 1 < links_.size()
            ? as_base(links_[i + 1])
            : const_cast<VkBaseOutStructure*>(static_cast<const VkBaseOutStructure*>(tail_));
}

std::byte* ChainCopy::append_bytes(const void* from, size_t size) {
  Link copy = std::make_unique<std::byte[]>(size);
  std::memcpy(copy.get(), from, size);
  as_base(copy)->pNext =
      const_cast<VkBaseOutStructure*>(static_cast<const VkBaseOutStructure*>(tail_));
  if (!links_.empty()) as_base(links_.back())->pNext = as_base(copy);
  links_.push_back(std::move(copy));
  return links_.back().get();
}

WithoutLayers::WithoutLayers(void* head, bool maintenance5) {
  auto* before = static_cast<VkBaseOutStructure*>(head);
  while (VkBaseOutStructure* each = before->pNext) {
    if (is_layers(each->sType, maintenance5)) {
      undo_.push_back({before, each});
      before->pNext = each->pNext;
    } else {
      before = each;
    }
  }
}

WithoutLayers::~WithoutLayers() {
  for (auto undo = undo_.rbegin(); undo != undo_.rend(); ++undo) undo->before->pNext = undo->taken;
}

}  // namespace shale::layer
