// ir/package/pack.h -- how a module lies in a `.shale` file: its words sorted by what they mean, then zlib.
//
// Kernels with weights in their code are the same few instructions, thousands of times. zlib alone sees 52 bytes for each product; here
// every operand of every instruction is a column of its own, and most columns turn out constant. Nothing depends on what the
// instructions mean, so whatever is split into instructions comes back word for word.
//
//   packed   varint: bytes of the body; zlib stream of the body
//   body     varint: kinds; for each kind its first word (varint, opcode and length of the instruction) and, for each of its columns,
//            a byte with the Prediction and the column's length (varint)
//            5 varints: the header's words
//            for each instruction the number of its kind (varint); then the columns' words one after another
//
// A column holds the operand of one place of one kind; from kColumns on all places share the last one. Words are stored as varints, 7
// bits a byte, the lowest first: as they are, or as what is left of them behind a prediction, zigzag.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "ir/base/result.h"

namespace shale {

/// At most so many bytes of words come from one packed byte, so that a small file asks for little memory.
inline constexpr uint64_t kMaxPacking = 64;

/// The packed form of a module; nothing where the words are no instructions, or are of too many kinds, or where it would not be
/// smaller or would be smaller by more than kMaxPacking. Same words, same bytes, with the same release of zlib.
std::optional<std::vector<uint8_t>> pack_module(std::span<const uint32_t> words);

/// The `word_count` words that were packed. Memory is bounded by twice kMaxPacking times the length of `packed` and a
/// megabyte, whatever its bytes are.
/// Errors: kBadInput at `where` if the bytes are damaged or make another number of words.
Result<std::vector<uint32_t>> unpack_module(std::span<const uint8_t> packed, uint32_t word_count,
                                            const std::string& where);

}  // namespace shale
