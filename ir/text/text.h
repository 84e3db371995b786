// ir/text/text.h -- the text form of a graph (.tir): what people read, tests compare and tools
// accept.
//
//   graph main {
//     input %input : i8[1,64,64,3]
//     const %w : i8[16,5,5,3] = hex "00ff..."       host bytes, or a list: [1,-2,3]
//     const %scale : f32[1] = [0.1]                 shortest decimals; inf, -inf; a NaN as 0x7fc00000
//     const %size : shape[2] = [2,2]
//     %acc = conv2d %input, %w, %b, %zp, %wzp {pad=[2,2,2,2], stride=[1,1], ...} : i32[1,64,64,16]
//     @1 return %acc
//   }
//
// '#' starts a comment. A name of other characters than [A-Za-z0-9_.$/-] is quoted: %"a b". '?' is
// an open dimension. '@n' puts a node into group n. Attributes that an operator has and a line
// leaves out read as 0 or empty.
#pragma once

#include <string>
#include <string_view>

#include "ir/graph/graph.h"

namespace shale {

/// Constants up to this many elements print as a list, larger ones as hex.
inline constexpr int64_t kMaxListedElements = 64;

/// parse_text(print_text(g)) == g.
std::string print_text(const Graph& graph);

/// Reads untrusted text. The result is well formed (names unique, operands defined before use), not
/// checked by the operators' rules.
/// Errors: kBadInput with "line L, column C" in `where`.
Result<Graph> parse_text(std::string_view text);

}  // namespace shale
