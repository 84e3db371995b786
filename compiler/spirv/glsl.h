// compiler/spirv/glsl.h -- GLSL compute shaders to SPIR-V words, through glslang.
#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "ir/package/package.h"

namespace shale {

/// NAME and value of a preprocessor definition.
using Defines = std::vector<std::pair<std::string, std::string>>;

/// Text of an included file by the name that stands in `#include`.
using IncludeLoader = std::function<Result<std::string>(const std::string& name)>;

/// Compiles a compute shader with entry point main for Vulkan 1.2 and above. `#include "x.glsl"`
/// finds the files of shaders/include, then what `load` answers, if it is given. `where` names the
/// shader in messages.
/// Errors: kBadInput with the first line of glslang's log.
Result<Spirv> compile_glsl(std::string_view source, const Defines& defines,
                           const std::string& where, const IncludeLoader& load = {});

/// The source with includes and macros expanded and without comments.
/// Errors: as compile_glsl.
Result<std::string> preprocess_glsl(std::string_view source, const Defines& defines,
                                    const std::string& where, const IncludeLoader& load = {});

}  // namespace shale
