// tests/layer/tensor_shaders.h -- compute shaders of SPV_ARM_tensors, as text for assemble_spirv.
#pragma once

namespace shale {

/// b[y, x] = a[y, x + 1] + the width of a; outside of a is 42.
inline constexpr const char* kShift = R"(
OpCapability Shader
OpCapability Int8
OpCapability TensorsARM
OpExtension "SPV_ARM_tensors"
OpMemoryModel 0 1
OpEntryPoint 5 %main "main" %id %a %b
OpExecutionMode %main 17 1 1 1
OpName %a "a"
OpName %ta "loaded"
OpDecorate %id 11 28
OpDecorate %a DescriptorSet 0
OpDecorate %a Binding 0
OpDecorate %b DescriptorSet 0
OpDecorate %b Binding 1
%void = OpTypeVoid
%fn = OpTypeFunction %void
%uint = OpTypeInt 32 0
%i8 = OpTypeInt 8 1
%v3 = OpTypeVector %uint 3
%pin = OpTypePointer 1 %v3
%id = OpVariable %pin 1
%c1 = OpConstant %uint 1
%c2 = OpConstant %uint 2
%coords = OpTypeArray %uint %c2
%t = OpTypeTensorARM %i8 %c2
%pt = OpTypePointer UniformConstant %t
%a = OpVariable %pt UniformConstant
%b = OpVariable %pt UniformConstant
%other = OpConstant %i8 42
%main = OpFunction %void 0 %fn
%l = OpLabel
%gid = OpLoad %v3 %id
%x = OpCompositeExtract %uint %gid 0
%y = OpCompositeExtract %uint %gid 1
%x1 = OpIAdd %uint %x %c1
%here = OpCompositeConstruct %coords %y %x
%right = OpCompositeConstruct %coords %y %x1
%ta = OpLoad %t %a
%tb = OpLoad %t %b
%value = OpTensorReadARM %i8 %ta %right 2 %other
%width = OpTensorQuerySizeARM %uint %ta %c1
%narrow = OpSConvert %i8 %width
%sum = OpIAdd %i8 %value %narrow
OpTensorWriteARM %tb %here %sum
OpReturn
OpFunctionEnd
)";

/// For tensors of int16 in an array, by a dynamic index: three elements from 64-bit coordinates, moved by one.
inline constexpr const char* kArrays = R"(
OpCapability Shader
OpCapability Int16
OpCapability Int64
OpCapability TensorsARM
OpCapability 4175
OpExtension "SPV_ARM_tensors"
OpMemoryModel 0 1
OpEntryPoint 5 %main "main" %id %a
OpExecutionMode %main 17 1 1 1
OpDecorate %id 11 28
OpDecorate %a DescriptorSet 0
OpDecorate %a Binding 0
%void = OpTypeVoid
%fn = OpTypeFunction %void
%uint = OpTypeInt 32 0
%long = OpTypeInt 64 1
%i16 = OpTypeInt 16 1
%v3 = OpTypeVector %uint 3
%pin = OpTypePointer 1 %v3
%id = OpVariable %pin 1
%c1 = OpConstant %uint 1
%c2 = OpConstant %uint 2
%c3 = OpConstant %uint 3
%l1 = OpConstant %long 1 0
%coords = OpTypeArray %long %c1
%three = OpTypeArray %i16 %c3
%t = OpTypeTensorARM %i16 %c1
%ts = OpTypeArray %t %c2
%pts = OpTypePointer UniformConstant %ts
%pt = OpTypePointer UniformConstant %t
%a = OpVariable %pts UniformConstant
%main = OpFunction %void 0 %fn
%l = OpLabel
%gid = OpLoad %v3 %id
%x = OpCompositeExtract %uint %gid 0
%z = OpCompositeExtract %uint %gid 2
%lx = OpSConvert %long %x
%lx1 = OpIAdd %long %lx %l1
%here = OpCompositeConstruct %coords %lx
%next = OpCompositeConstruct %coords %lx1
%p = OpAccessChain %pt %a %z
%ta = OpLoad %t %p
%value = OpTensorReadARM %three %ta %next
OpTensorWriteARM %ta %here %value
OpReturn
OpFunctionEnd
)";

}  // namespace shale
