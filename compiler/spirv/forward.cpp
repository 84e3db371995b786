#include "compiler/spirv/forward.h"

#include <algorithm>
#include <array>
#include <map>
#include <span>
#include <spirv/unified1/spirv.hpp>
#include <vector>

namespace shale {
namespace {

constexpr size_t kHeaderWords = 5;
constexpr uint32_t kNone = UINT32_MAX;
constexpr uint32_t kExtends =
    uint32_t{spv::ImageOperandsSignExtendMask} | uint32_t{spv::ImageOperandsZeroExtendMask};

/// Where the operands that are ids lie in an instruction, in words from its first one.
struct IdRange {
  size_t begin = 0, end = 0;
};

/// Ids that an instruction in a function uses; nothing for one that is not known.
bool used_ids(std::span<const uint32_t> words, std::vector<IdRange>& ranges) {
  const auto op = static_cast<spv::Op>(words[0] & 0xffffu);
  const size_t count = words.size();
  ranges.clear();
  const auto ids = [&](size_t begin, size_t end) {
    if (begin < std::min(end, count)) ranges.push_back({begin, std::min(end, count)});
    return true;
  };
  switch (op) {
    case spv::OpFunction:
    case spv::OpFunctionParameter:
    case spv::OpFunctionEnd:
    case spv::OpLabel:
    case spv::OpReturn:
    case spv::OpUnreachable:
    case spv::OpKill:
    case spv::OpUndef:
    case spv::OpNop: return true;
    case spv::OpVariable: return ids(4, count);
    case spv::OpLoad: return ids(3, 4);
    case spv::OpStore: return ids(1, 3);
    case spv::OpBranch:
    case spv::OpReturnValue: return ids(1, 2);
    case spv::OpBranchConditional: return ids(1, 4);
    case spv::OpSelectionMerge: return ids(1, 2);
    case spv::OpLoopMerge: return ids(1, 3);
    case spv::OpCompositeExtract: return ids(3, 4);
    case spv::OpCompositeInsert:
    case spv::OpVectorShuffle: return ids(3, 5);
    case spv::OpExtInst: ids(3, 4); return ids(5, count);
    case spv::OpImageFetch:
      // Of the image operands, those without an id of their own.
      return ids(3, 5) && (count == 5 || (count == 6 && (words[5] & ~kExtends) == 0));
    case spv::OpFunctionCall:
    case spv::OpAccessChain:
    case spv::OpInBoundsAccessChain:
    case spv::OpCompositeConstruct:
    case spv::OpCopyObject:
    case spv::OpImage:
    case spv::OpPhi:
    case spv::OpSelect: return ids(3, count);
    default:
      // Conversions, arithmetic, comparisons and bit operations: result type, result, operands.
      if (op >= spv::OpConvertFToU && op <= spv::OpBitCount) return ids(3, count);
      return false;
  }
}

/// An OpAccessChain to one component of a variable, by the id of the pointer.
struct Component {
  uint32_t variable = kNone;
  uint32_t index = 0;
  uint32_t loads = 0;  ///< all its uses, if it is eligible
  uint32_t taken = 0;  ///< loads that became extractions
};

struct Variable {
  bool eligible = false;
  uint32_t block = kNone;  ///< the one block that uses it
  bool one_block = true;
  uint32_t value = kNone;  ///< known value in the current block
  size_t last_store = 0;   ///< offset of the store whose value nobody has seen yet; 0 if none
  uint32_t stores = 0;
  size_t store = 0;  ///< offset of the only one
  uint32_t store_block = kNone;
  bool settled = false;  ///< stored once, before every load: one value in all blocks
};

/// Blocks of all functions in the order of the module, in which a block follows those that dominate it.
class Dominators {
 public:
  /// Begins a block; `entry` if it is the first of a function.
  void add(uint32_t label, bool entry) {
    index_[label] = idom_.size();
    idom_.push_back(entry ? idom_.size() : kUnknown);
    before_.emplace_back();
  }
  void add_edge(uint32_t from, uint32_t to) { edges_.push_back({from, to}); }

  void solve() {
    for (const auto& [from, to] : edges_)
      if (index_.contains(from) && index_.contains(to)) before_[index_[to]].push_back(index_[from]);
    for (bool changed = true; changed;) {
      changed = false;
      for (size_t i = 0; i < idom_.size(); ++i) {
        if (idom_[i] == i) continue;
        size_t common = kUnknown;
        for (const size_t from : before_[i])
          if (idom_[from] != kUnknown) common = common == kUnknown ? from : meet(from, common);
        if (common != kUnknown && common >= i) common = kUnknown;  // not reached from the entry
        changed = changed || common != idom_[i];
        idom_[i] = common;
      }
    }
  }

  bool dominates(uint32_t label, uint32_t other) const {
    const size_t target = index_.at(label);
    size_t at = index_.at(other);
    while (at > target && idom_[at] != kUnknown) at = idom_[at];
    return at == target;
  }

 private:
  static constexpr size_t kUnknown = SIZE_MAX;

  size_t meet(size_t a, size_t b) const {
    while (a != b) (a > b ? a : b) = idom_[std::max(a, b)];
    return a;
  }

  std::map<uint32_t, size_t> index_;
  std::vector<size_t> idom_;  ///< its own of an entry
  std::vector<std::vector<size_t>> before_;
  std::vector<std::array<uint32_t, 2>> edges_;
};

}  // namespace

Spirv forward_locals(const Spirv& words) {
  if (words.size() < kHeaderWords) return words;
  const uint32_t bound = words[3];
  std::vector<Variable> variables(bound);
  std::vector<Component> components(bound);
  std::vector<uint32_t> constants(bound, kNone);  // literal of an OpConstant of one word
  std::vector<IdRange> ranges;
  const auto length = [&](size_t at) -> size_t { return words[at] >> 16; };
  const auto op_at = [&](size_t at) { return static_cast<spv::Op>(words[at] & 0xffffu); };

  // Which variables are only loaded and stored whole, and in which blocks.
  uint32_t block = kNone;
  bool in_function = false, at_entry = false;
  Dominators dominators;
  for (size_t at = kHeaderWords; at < words.size(); at += length(at)) {
    if (length(at) == 0 || at + length(at) > words.size()) return words;
    const std::span<const uint32_t> one(&words[at], length(at));
    if (op_at(at) == spv::OpFunction) in_function = at_entry = true;
    if (op_at(at) == spv::OpConstant && one.size() == 4 && one[2] < bound)
      constants[one[2]] = one[3];
    if (!in_function) continue;
    if (!used_ids(one, ranges)) return words;
    const size_t least =
        op_at(at) == spv::OpLoad || op_at(at) == spv::OpVariable || op_at(at) == spv::OpAccessChain
            ? 4
        : op_at(at) == spv::OpStore ? 3
        : op_at(at) == spv::OpLabel ? 2
                                    : 1;
    if (one.size() < least) return words;
    for (size_t i = 1; i < least; ++i)
      if (one[i] >= bound && !(op_at(at) == spv::OpVariable && i == 3)) return words;
    for (const IdRange& range : ranges)
      for (size_t i = range.begin; i < range.end; ++i)
        if (one[i] >= bound) return words;
    if (op_at(at) == spv::OpLabel) {
      block = one[1];
      dominators.add(block, at_entry);
      at_entry = false;
    }
    if (op_at(at) == spv::OpBranch) dominators.add_edge(block, one[1]);
    if (op_at(at) == spv::OpBranchConditional && one.size() >= 4) {
      dominators.add_edge(block, one[2]);
      dominators.add_edge(block, one[3]);
    }
    if (op_at(at) == spv::OpVariable && one[3] == spv::StorageClassFunction) {
      variables[one[2]].eligible = one.size() == 4;
      continue;
    }
    const bool loads = op_at(at) == spv::OpLoad && one.size() == 4;
    const bool plain = loads || (op_at(at) == spv::OpStore && one.size() == 3);
    const bool selects = op_at(at) == spv::OpAccessChain && one.size() == 5 && one[2] < bound &&
                         variables[one[3]].eligible && constants[one[4]] != kNone;
    if (selects) components[one[2]] = {.variable = one[3], .index = constants[one[4]]};
    for (const IdRange& range : ranges)
      for (size_t i = range.begin; i < range.end; ++i) {
        // What is done to a component is done to its variable.
        Component& component = components[one[i]];
        const bool is_component = component.variable != kNone;
        Variable& variable = variables[is_component ? component.variable : one[i]];
        const bool is_pointer = (plain && i == (loads ? 3u : 1u)) || (selects && i == 3);
        if (!is_pointer || (is_component && !loads)) variable.eligible = false;
        if (is_component) ++component.loads;
        if (is_pointer && !loads && !selects) {
          ++variable.stores;
          variable.store = at;
          variable.store_block = block;
        }
        if (variable.block == kNone) variable.block = block;
        if (variable.block != block) variable.one_block = false;
      }
  }

  // Stored once, and seen by nobody who may come before that.
  dominators.solve();
  for (Variable& variable : variables)
    variable.settled = variable.eligible && !variable.one_block && variable.stores == 1;
  for (size_t at = kHeaderWords; at < words.size(); at += length(at)) {
    if (op_at(at) == spv::OpLabel) block = words[at + 1];
    if (op_at(at) != spv::OpLoad) continue;
    const Component& component = components[words[at + 3]];
    Variable& variable =
        variables[component.variable != kNone ? component.variable : words[at + 3]];
    if (!variable.settled) continue;
    variable.settled = block == variable.store_block
                           ? variable.store < at
                           : dominators.dominates(variable.store_block, block);
  }

  // Values forwarded; stores that nothing sees are marked.
  std::vector<uint32_t> replaced(bound, kNone);
  std::vector<size_t> dropped;
  std::vector<std::pair<size_t, uint32_t>> extracted;  // offset of a load, and the whole value
  std::vector<uint32_t> active;  // variables with a known value or a pending store
  const auto value_of = [&](uint32_t id) { return replaced[id] == kNone ? id : replaced[id]; };
  const auto end_block = [&] {
    for (const uint32_t id : active) {
      Variable& variable = variables[id];
      if ((variable.one_block || variable.settled) && variable.last_store != 0)
        dropped.push_back(variable.last_store);
      if (!variable.settled) variable.value = kNone;
      variable.last_store = 0;
    }
    active.clear();
  };
  in_function = false;
  for (size_t at = kHeaderWords; at < words.size(); at += length(at)) {
    if (op_at(at) == spv::OpFunction) in_function = true;
    if (!in_function) continue;
    if (op_at(at) == spv::OpLabel || op_at(at) == spv::OpFunctionEnd) end_block();
    const Component* component = op_at(at) == spv::OpLoad ? &components[words[at + 3]] : nullptr;
    if (component && component->variable != kNone) {
      const Variable& variable = variables[component->variable];
      if (!variable.eligible || variable.value == kNone) continue;
      ++components[words[at + 3]].taken;
      extracted.emplace_back(at, variable.value);
    } else if (op_at(at) == spv::OpLoad && variables[words[at + 3]].eligible) {
      Variable& variable = variables[words[at + 3]];
      if (variable.value != kNone) {
        replaced[words[at + 2]] = variable.value;
        dropped.push_back(at);
      } else {
        // From before the block: the load stays, and is the value from here on.
        active.push_back(words[at + 3]);
        variable.value = words[at + 2];
      }
    } else if (op_at(at) == spv::OpStore && variables[words[at + 1]].eligible) {
      Variable& variable = variables[words[at + 1]];
      if (variable.last_store != 0) dropped.push_back(variable.last_store);
      active.push_back(words[at + 1]);
      variable.value = value_of(words[at + 2]);
      variable.last_store = at;
    }
  }
  for (size_t at = kHeaderWords; at < words.size(); at += length(at))
    if (op_at(at) == spv::OpAccessChain && components[words[at + 2]].taken > 0 &&
        components[words[at + 2]].taken == components[words[at + 2]].loads)
      dropped.push_back(at);
  std::sort(dropped.begin(), dropped.end());

  Spirv result(words.begin(), words.begin() + kHeaderWords);
  result.reserve(words.size());
  auto next = dropped.begin();
  auto extract = extracted.begin();
  in_function = false;
  for (size_t at = kHeaderWords; at < words.size(); at += length(at)) {
    if (next != dropped.end() && *next == at) {
      ++next;
      continue;
    }
    const std::span<const uint32_t> one(&words[at], length(at));
    if (extract != extracted.end() && extract->first == at) {
      result.insert(result.end(), {(5u << 16) | spv::OpCompositeExtract, one[1], one[2],
                                   value_of(extract->second), components[one[3]].index});
      ++extract;
      continue;
    }
    const size_t begin = result.size();
    result.insert(result.end(), one.begin(), one.end());
    if (op_at(at) == spv::OpFunction) in_function = true;
    if (!in_function) continue;
    used_ids(one, ranges);
    for (const IdRange& range : ranges)
      for (size_t i = range.begin; i < range.end; ++i) result[begin + i] = value_of(one[i]);
  }
  return result;
}

}  // namespace shale
