#include "compiler/spirv/glsl.h"

#include <glslang/Public/ShaderLang.h>
#include <glslang/SPIRV/GlslangToSpv.h>

#include <deque>
#include <memory>

#include "compiler/spirv/cooperative_matrix.h"
#include "compiler/spirv/include_embedded.h"

namespace shale {
namespace {

/// glslang keeps tables for the whole process.
struct GlslangProcess {
  GlslangProcess() { glslang::InitializeProcess(); }
  ~GlslangProcess() { glslang::FinalizeProcess(); }
  static const GlslangProcess& started() {
    static const GlslangProcess process;
    return process;
  }
};

class Includer : public glslang::TShader::Includer {
 public:
  explicit Includer(const IncludeLoader& load) : load_(load) {}

  IncludeResult* includeLocal(const char* header, const char*, size_t depth) override {
    if (depth > 8) return nullptr;
    for (const embedded_include::EmbeddedFile& file : embedded_include::kEmbeddedFiles)
      if (file.name == header)
        return new IncludeResult(std::string(file.name), file.text.data(), file.text.size(),
                                 nullptr);
    Result<std::string> text = load_ ? load_(header) : Result<std::string>(std::string());
    if (!load_ || !text) return nullptr;
    const std::string& kept = texts_.emplace_back(*std::move(text));
    return new IncludeResult(header, kept.data(), kept.size(), nullptr);
  }
  void releaseInclude(IncludeResult* result) override { delete result; }

 private:
  const IncludeLoader& load_;
  std::deque<std::string> texts_;  // a deque: results point into it
};

/// Limits of the compiler's own checks; the device's are checked by the runtime.
TBuiltInResource resource_limits() {
  TBuiltInResource limits = {};
  limits.maxComputeWorkGroupCountX = limits.maxComputeWorkGroupCountY =
      limits.maxComputeWorkGroupCountZ = 65535;
  limits.maxComputeWorkGroupSizeX = limits.maxComputeWorkGroupSizeY =
      limits.maxComputeWorkGroupSizeZ = 1024;
  limits.maxImageUnits = 64;
  limits.maxComputeImageUniforms = 64;
  limits.maxComputeTextureImageUnits = 64;
  limits.maxCombinedTextureImageUnits = 64;
  limits.limits.nonInductiveForLoops = true;
  limits.limits.whileLoops = true;
  limits.limits.doWhileLoops = true;
  limits.limits.generalUniformIndexing = true;
  limits.limits.generalAttributeMatrixVectorIndexing = true;
  limits.limits.generalVaryingIndexing = true;
  limits.limits.generalSamplerIndexing = true;
  limits.limits.generalVariableIndexing = true;
  limits.limits.generalConstantMatrixVectorIndexing = true;
  return limits;
}

std::string first_error(const char* log) {
  const std::string text(log);
  const size_t at = text.find("ERROR:");
  const size_t start = at == std::string::npos ? 0 : at;
  return text.substr(start, text.find('\n', start) - start);
}

/// A shader as glslang takes it; the texts outlive it.
class Shader {
 public:
  Shader(std::string_view source, const Defines& defines)
      : text_(source.data()), length_(static_cast<int>(source.size())) {
    for (const auto& [name, value] : defines) preamble_ += "#define " + name + " " + value + "\n";
    shader_.setStringsWithLengthsAndNames(&text_, &length_, &name_, 1);
    shader_.setPreamble(preamble_.c_str());
    shader_.setEnvInput(glslang::EShSourceGlsl, EShLangCompute, glslang::EShClientVulkan, 100);
    // SPIR-V 1.6 would state the workgroup by LocalSizeId, which asks the host to enable
    // maintenance4.
    shader_.setEnvClient(glslang::EShClientVulkan, glslang::EShTargetVulkan_1_2);
    // From 1.6 on glslang writes the local size as ids, which a device may run only with the feature
    // maintenance4 enabled; and spirv_needs reads the literal form.
    shader_.setEnvTarget(glslang::EShTargetSpv, glslang::EShTargetSpv_1_5);
  }
  glslang::TShader& operator*() { return shader_; }
  glslang::TShader* operator->() { return &shader_; }

 private:
  const GlslangProcess& process_ = GlslangProcess::started();  // before any shader
  const char* text_;
  int length_;
  // glslang writes the name into lines of source: not that of a file or a layer, which may hold anything.
  const char* name_ = "shader";
  std::string preamble_ = "#extension GL_GOOGLE_include_directive : require\n";
  glslang::TShader shader_{EShLangCompute};
};

constexpr EShMessages kMessages =
    static_cast<EShMessages>(int{EShMsgSpvRules} | int{EShMsgVulkanRules});

}  // namespace

Result<Spirv> compile_glsl(std::string_view source, const Defines& defines,
                           const std::string& where, const IncludeLoader& load) {
  Shader shader(source, defines);
  const TBuiltInResource limits = resource_limits();
  Includer includer(load);
  if (!shader->parse(&limits, 450, ENoProfile, false, false, kMessages, includer))
    return bad_input(where, "the shader does not compile: {}", first_error(shader->getInfoLog()));
  glslang::TProgram program;
  program.addShader(&*shader);
  if (!program.link(kMessages))
    return bad_input(where, "the shader does not link: {}", first_error(program.getInfoLog()));
  Spirv words;
  glslang::SpvOptions options;
  options.generateDebugInfo = false;
  // Where there are matrices, glslang would only complain about what it does not know.
  options.stripDebugInfo = source.find("coopmat.glsl") == std::string_view::npos;
  options.disableOptimizer = true;
  glslang::GlslangToSpv(*program.getIntermediate(EShLangCompute), words, &options);
  SHALE_TRY_VOID(complete_cooperative_matrices(words, where));
  return words;
}

Result<std::string> preprocess_glsl(std::string_view source, const Defines& defines,
                                    const std::string& where, const IncludeLoader& load) {
  Shader shader(source, defines);
  const TBuiltInResource limits = resource_limits();
  Includer includer(load);
  std::string text;
  if (!shader->preprocess(&limits, 450, ENoProfile, false, false, kMessages, &text, includer))
    return bad_input(where, "the shader does not compile: {}", first_error(shader->getInfoLog()));
  return text;
}

}  // namespace shale
