// Locals to values: what remains computes the same, so it must stay valid and keep what matters.
#include "compiler/spirv/forward.h"

#include <gtest/gtest.h>

#include "compiler/spirv/check.h"
#include "compiler/spirv/glsl.h"
#include "tests/compiler/graph_support.h"

namespace shale {
namespace {

std::string shader(const std::string& body) {
  return "#version 450\nlayout(local_size_x = 8) in;\n"
         "layout(set = 0, binding = 0, std430) buffer B { float d[]; } b;\n"
         "layout(set = 0, binding = 1) uniform usamplerBuffer t;\n"
         "float twice(float x) { x *= 2.0; return x; }\n"
         "void main() {\n  int id = int(gl_GlobalInvocationID.x);\n" +
         body + "}\n";
}

size_t count(const Spirv& words, const std::string& instruction) {
  const std::string text = must(disassemble_spirv(words));
  size_t found = 0;
  for (size_t at = 0; (at = text.find(instruction + " ", at)) != std::string::npos; ++at) ++found;
  return found;
}

Spirv forwarded(const std::string& body) {
  const Spirv words = must(compile_glsl(shader(body), {}, "test"));
  const Spirv result = forward_locals(words);
  EXPECT_TRUE(validate_spirv(result, "test")) << error_text(validate_spirv(result, "test"));
  EXPECT_EQ(forward_locals(result), result) << "a second pass finds more";
  return result;
}

TEST(ForwardLocals, StraightLineCodeKeepsNoVariableTraffic) {
  std::string body = "  float v = b.d[id], a = 0.0, c = 1.0;\n";
  for (int i = 1; i <= 100; ++i) body += "  a += v * " + std::to_string(i) + ".0;\n  c -= a;\n";
  const Spirv words = must(compile_glsl(shader(body + "  b.d[id] = a + c;\n"), {}, "test"));
  const Spirv result = forwarded(body + "  b.d[id] = a + c;\n");
  EXPECT_GT(count(words, "OpStore"), 200u);
  EXPECT_LE(count(result, "OpStore"), 3u);  // the buffer, and the function's parameter
  EXPECT_EQ(count(result, "OpFMul"), count(words, "OpFMul"));
  EXPECT_EQ(count(result, "OpFAdd"), count(words, "OpFAdd"));
}

TEST(ForwardLocals, KeepsWhatOtherBlocksRead) {
  // `a` is carried around the loop, `c` out of the branch; their last stores must stay.
  const Spirv result = forwarded(
      "  float a = 0.0, c = 3.0;\n"
      "  for (int i = 0; i < 5; ++i) { a += 1.0; a *= b.d[id]; if (a > 9.0) { c = a; c += 1.0; } "
      "}\n"
      "  b.d[id] = a + c;\n");
  const std::string text = must(disassemble_spirv(result));
  EXPECT_GE(count(result, "OpStore"), 6u)
      << text;  // a, c, i before the loop; a, i, c in it; buffer
  EXPECT_GE(count(result, "OpLoad"), 4u) << text;
}

TEST(ForwardLocals, CarriesWhatIsStoredOnceIntoLaterBlocks) {
  const Spirv result = forwarded(
      "  float v = b.d[id], s;\n  uvec4 q = texelFetch(t, id);\n"
      "  for (;;) { float a = v; a += float(q.y); s = a * 2.0; if (id >= 0) break; }\n"
      "  b.d[id] = s + v + float(q.z);\n");
  EXPECT_LE(count(result, "OpStore"), 2u);  // the buffer, the function's parameter
  EXPECT_EQ(count(result, "OpCompositeExtract"), 2u);
}

TEST(ForwardLocals, KeepsAStoreThatDoesNotComeBeforeEveryLoad) {
  const auto stores = [](const std::string& body) { return count(forwarded(body), "OpStore"); };
  const size_t with_branch = stores("  float c;\n  if (b.d[0] > 3.0) c = 1.0;\n  b.d[id] = c;\n"),
               without = stores("  float c = 1.0;\n  b.d[id] = c;\n");
  EXPECT_EQ(with_branch, without + 1);
  // Seen in the next round of the loop: p, the buffer, i before the loop and in it.
  EXPECT_EQ(
      stores("  float p;\n  for (int i = 0; i < 4; ++i) {\n    if (i > 0) b.d[i] = p;\n    p = "
             "b.d[i + 8];\n  }\n"),
      4u);
}

TEST(ForwardLocals, TakesComponentsOfKnownVectors) {
  const Spirv result = forwarded(
      "  uvec4 q = texelFetch(t, id);\n  float a = float(q.x & 255u);\n"
      "  q = texelFetch(t, id + 1);\n  a += float(q.w >> 8) * float(q.x);\n  b.d[id] = a;\n");
  EXPECT_EQ(count(result, "OpCompositeExtract"), 3u);
  EXPECT_LE(count(result, "OpAccessChain"), 2u);  // the invocation's id, the buffer
}

TEST(ForwardLocals, LeavesVariablesAloneThatAreAddressed) {
  const std::string body =
      "  float a[4] = float[4](1.0, 2.0, 3.0, 4.0);\n  vec4 v = vec4(b.d[id]);\n  v.y = 2.0;\n"
      "  float x = v.x;\n  b.d[id] = a[id & 3] + v.y + twice(x) + x;\n";
  const Spirv words = must(compile_glsl(shader(body), {}, "test"));
  const Spirv result = forwarded(body);
  EXPECT_EQ(count(result, "OpAccessChain"), count(words, "OpAccessChain"));
  EXPECT_EQ(count(result, "OpFunctionCall"), 1u);
}

TEST(ForwardLocals, ReturnsWhatItDoesNotKnow) {
  Spirv words = must(compile_glsl(shader("  b.d[id] = 1.0;\n"), {}, "test"));
  EXPECT_EQ(forward_locals({}), Spirv{});
  EXPECT_EQ(forward_locals({1, 2, 3}), (Spirv{1, 2, 3}));
  for (size_t cut = 5; cut < words.size(); ++cut) {
    const Spirv part(words.begin(), words.begin() + static_cast<std::ptrdiff_t>(cut));
    forward_locals(part);  // whatever it answers, it reads nothing beyond the words
  }
  // An instruction in the function that is not in its table: OpEmitVertex.
  const size_t end = words.size() - 1;
  words.insert(words.begin() + static_cast<std::ptrdiff_t>(end), (1u << 16) | 218u);
  EXPECT_EQ(forward_locals(words), words);
}

}  // namespace
}  // namespace shale
