// shaders/include/coopmat.glsl -- products of int8 matrices by VK_KHR_cooperative_matrix: M x K times K x N, int32 sums,
// spread over a subgroup that is the whole workgroup.
//
// The shader defines before: SUBGROUP; MATRIX_M, MATRIX_N, MATRIX_K; STAGE_WORDS, and A_STRIDE, the words from one row
// of A to the next there; WEIGHTS, an array of uvec4; B_LAYOUT, 0 where a row of B (N bytes) starts every B_STRIDE
// uvec4, 1 where a column (K bytes) does. SHALE_PLAIN_MATRICES replaces the matrix instructions by loops with the same
// meaning, so that any device can run what surrounds them.
//
// Source: SPV_KHR_cooperative_matrix; 4456 to 4459 are OpTypeCooperativeMatrixKHR, Load, Store and MulAdd, 6022 is the
// capability. A type's first operand is the number of bits of a signed integer here: compiler/spirv puts the type there.
#extension GL_EXT_spirv_intrinsics : require

// Inputs of the pixels, two chunks of them in turn; then the sums of M pixels by N channels.
shared uint stage[STAGE_WORDS];

#ifndef SHALE_PLAIN_MATRICES

// The extension demands it.
#pragma use_vulkan_memory_model

const int kSubgroup = 3, kM = MATRIX_M, kN = MATRIX_N, kK = MATRIX_K, kUseA = 0, kUseB = 1, kAccumulator = 2,
          kRowMajor = 0, kWorkgroup = 2;

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

// Strides are in elements of the array that the pointer points into.
// Memory operands as for other accesses to shared memory: 0x20 is NonPrivatePointer, 0x10 MakePointerVisible, 0x8
// MakePointerAvailable.
#define MATRIX_ZERO filled(0)
#define MATRIX_LOAD_A(at) load_a(stage[at], kRowMajor, A_STRIDE, 0x30, kWorkgroup)
#define MATRIX_LOAD_B(at) load_b(WEIGHTS[at], B_LAYOUT, B_STRIDE)
#define MATRIX_MULTIPLY_ADD(a, b, c) multiply_add(a, b, c, 15)
#define MATRIX_STORE_C(at, c) store_c(stage[at], c, kRowMajor, MATRIX_N, 0x28, kWorkgroup)

#else

// A and B are places, read when they are multiplied; of C an invocation has every SUBGROUP-th element.
#define PARTS ((MATRIX_M * MATRIX_N + SUBGROUP - 1) / SUBGROUP)
struct MatrixA { int at; };
struct MatrixB { int at; };
struct MatrixC { int part[PARTS]; };

MatrixC zero_matrix() {
  MatrixC c;
  for (int i = 0; i < PARTS; ++i) c.part[i] = 0;
  return c;
}

MatrixC plain_multiply_add(MatrixA a, MatrixB b, MatrixC c) {
  for (int i = 0; i < PARTS; ++i) {
    int element = i * SUBGROUP + int(gl_LocalInvocationID.x);
    if (element >= MATRIX_M * MATRIX_N) break;
    int m = element / MATRIX_N, n = element % MATRIX_N;
    for (int k = 0; k < MATRIX_K; ++k) {
      int line = B_LAYOUT == 0 ? k : n, byte = B_LAYOUT == 0 ? n : k;
      int x = bitfieldExtract(int(stage[a.at + m * A_STRIDE + k / 4]), k % 4 * 8, 8);
      int w = bitfieldExtract(int(WEIGHTS[b.at + line * B_STRIDE + byte / 16][byte % 16 / 4]), byte % 4 * 8, 8);
      c.part[i] += x * w;
    }
  }
  return c;
}

void plain_store(int at, MatrixC c) {
  for (int i = 0; i < PARTS; ++i) {
    int element = i * SUBGROUP + int(gl_LocalInvocationID.x);
    if (element < MATRIX_M * MATRIX_N) stage[at + element] = uint(c.part[i]);
  }
}

#define MATRIX_ZERO zero_matrix()
#define MATRIX_LOAD_A(at) MatrixA(at)
#define MATRIX_LOAD_B(at) MatrixB(at)
#define MATRIX_MULTIPLY_ADD(a, b, c) plain_multiply_add(a, b, c)
#define MATRIX_STORE_C(at, c) plain_store(at, c)

#endif
