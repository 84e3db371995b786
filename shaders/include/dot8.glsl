// shaders/include/dot8.glsl -- sum of four products of signed bytes: OpSDotKHR on packed words.
//
// Source: SPV_KHR_integer_dot_product; 4450 is the opcode, 6018 and 6019 are the capabilities
// DotProductInput4x8BitPacked and DotProduct. No sum leaves int: |a * b| <= 2^14.
#extension GL_EXT_spirv_intrinsics : require

spirv_instruction(extensions = ["SPV_KHR_integer_dot_product"], capabilities = [6018, 6019], id = 4450)
int packed_dot(uint a, uint b, spirv_literal int format);

int dot_s8(uint a, uint b) { return packed_dot(a, b, 0); }

// The same with four words of weights at once.
ivec4 dot4_s8(uint a, uvec4 b) { return ivec4(dot_s8(a, b.x), dot_s8(a, b.y), dot_s8(a, b.z), dot_s8(a, b.w)); }
