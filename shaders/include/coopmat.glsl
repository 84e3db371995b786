// shaders/include/coopmat.glsl -- products of int8 matrices by VK_KHR_cooperative_matrix: 16 x 32 times 32 x 16,
// int32 sums, spread over a subgroup of 32 that is the whole workgroup. Not run on hardware.
//
// WEIGHTS is an array of uvec4 that the shader declares before. SHALE_PLAIN_MATRICES replaces the matrix instructions
// by loops with the same meaning, so that any device can run what surrounds them.
//
// Source: SPV_KHR_cooperative_matrix; 4456 to 4459 are OpTypeCooperativeMatrixKHR, Load, Store and MulAdd, 6022 is the
// capability. A type's first operand is the number of bits of a signed integer here: compiler/spirv puts the type there.
#extension GL_EXT_spirv_intrinsics : require

// Inputs of 16 pixels, two chunks of 8 words each in turn; then the sums of 16 pixels by 16 channels.
shared uint stage[256];

#ifndef SHALE_PLAIN_MATRICES

// The extension demands it.
#pragma use_vulkan_memory_model

const int kSubgroup = 3, kM = 16, kN = 16, kK = 32, kUseA = 0, kUseB = 1, kAccumulator = 2, kRowMajor = 0,
          kWorkgroup = 2;

#define MATRIX(bits, rows, columns, use)                                                                      \
  spirv_type(extensions = ["SPV_KHR_cooperative_matrix"], capabilities = [6022], id = 4456, bits, kSubgroup, rows, \
             columns, use)
#define MatrixA MATRIX(8, kM, kK, kUseA)
#define MatrixB MATRIX(8, kK, kN, kUseB)
#define MatrixC MATRIX(32, kM, kN, kAccumulator)

spirv_instruction(extensions = ["SPV_KHR_cooperative_matrix"], capabilities = [6022], id = 4457)
MatrixA load_a(spirv_by_reference uint from, int layout_, int stride, spirv_literal int memory, int scope);

spirv_instruction(extensions = ["SPV_KHR_cooperative_matrix"], capabilities = [6022], id = 4457)
MatrixB load_b(spirv_by_reference uvec4 from, int layout_, int stride);

spirv_instruction(extensions = ["SPV_KHR_cooperative_matrix"], capabilities = [6022], id = 4458)
void store_c(spirv_by_reference uint to, MatrixC c, int layout_, int stride, spirv_literal int memory, int scope);

// Operands: 15 says that A, B, C and the result are signed.
spirv_instruction(extensions = ["SPV_KHR_cooperative_matrix"], capabilities = [6022], id = 4459)
MatrixC multiply_add(MatrixA a, MatrixB b, MatrixC c, spirv_literal int operands);

// OpCompositeConstruct of a cooperative matrix gives all elements one value.
spirv_instruction(id = 80) MatrixC filled(int value);

// Strides are in elements of the array: rows of A have 8 words, rows of B one uvec4, rows of C 16 words.
// Memory operands as for other accesses to shared memory: 0x20 is NonPrivatePointer, 0x10 MakePointerVisible, 0x8
// MakePointerAvailable.
#define MATRIX_ZERO filled(0)
#define MATRIX_LOAD_A(at) load_a(stage[at], kRowMajor, 8, 0x30, kWorkgroup)
#define MATRIX_LOAD_B(at) load_b(WEIGHTS[at], kRowMajor, 1)
#define MATRIX_MULTIPLY_ADD(a, b, c) multiply_add(a, b, c, 15)
#define MATRIX_STORE_C(at, c) store_c(stage[at], c, kRowMajor, 16, 0x28, kWorkgroup)

#else

// A and B are places, read when they are multiplied; of C an invocation has eight elements of a row.
struct MatrixA { int at; };
struct MatrixB { int at; };
struct MatrixC { int part[8]; };

MatrixC plain_multiply_add(MatrixA a, MatrixB b, MatrixC c) {
  int lane = int(gl_LocalInvocationID.x);
  for (int i = 0; i < 8; ++i) {
    int m = lane / 2, n = lane % 2 * 8 + i;
    for (int k = 0; k < 32; ++k) {
      int x = bitfieldExtract(int(stage[a.at + m * 8 + k / 4]), k % 4 * 8, 8);
      int w = bitfieldExtract(int(WEIGHTS[b.at + k][n / 4]), n % 4 * 8, 8);
      c.part[i] += x * w;
    }
  }
  return c;
}

void plain_store(int at, MatrixC c) {
  int lane = int(gl_LocalInvocationID.x);
  for (int i = 0; i < 8; ++i) stage[at + lane / 2 * 16 + lane % 2 * 8 + i] = uint(c.part[i]);
}

#define MATRIX_ZERO MatrixC(int[8](0, 0, 0, 0, 0, 0, 0, 0))
#define MATRIX_LOAD_A(at) MatrixA(at)
#define MATRIX_LOAD_B(at) MatrixB(at)
#define MATRIX_MULTIPLY_ADD(a, b, c) plain_multiply_add(a, b, c)
#define MATRIX_STORE_C(at, c) plain_store(at, c)

#endif
