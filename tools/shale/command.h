// tools/shale/command.h -- what a subcommand is, and what all of them share.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "compiler/driver/compile.h"
#include "ir/base/result.h"
#include "tools/shale/terminal.h"

namespace shale {

/// Exit codes of every subcommand.
enum ExitCode : int { kDone = 0, kRefused = 1, kUsage = 2, kNoDevice = 3 };

/// Runs after the command line was parsed; returns the exit code.
using Action = std::function<Result<int>()>;

/// A row of commands.def: adds the subcommand's options to its App.
struct Command {
  const char* name;
  const char* help;
  Action (*add)(CLI::App& app);
};

#define SHALE_COMMAND(name, add, help) Action add(CLI::App& app);
#include "tools/shale/commands.def"

using Json = nlohmann::ordered_json;

/// The line of `shale --version`.
inline constexpr const char* kVersionText = "shale 0.2.0";

/// CLI::Range lets NaN pass.
CLI::Validator number_in(double low, double high);

/// A model on disk: the bytes, its name, and its sandwich where there is one.
struct ModelFiles {
  std::string path;  ///< of the model file, for messages
  std::string name;
  std::vector<uint8_t> bytes;
  std::optional<Frame> frame;
  std::string frame_folder;  ///< shader paths are relative to it
};

/// --precision: which of a model folder's networks is meant, int8 by default.
void add_precision_option(CLI::App& app, std::string& precision);

/// The file that a path means: itself, or of a folder model.tosa (int8) or model.PRECISION.tosa.
/// Errors: kBadInput if the folder has not got the precision, or a file is given with one.
Result<std::string> model_file(const std::string& path, const std::string& precision);

/// `path` is a model file, or a folder with networks (see model_file) and (optionally) frame.json; a
/// sandwich without a network has none. `frame_path` names a frame.json for a model file; empty is
/// none.
/// Errors: kIo, kBadInput; the file is named.
Result<ModelFiles> load_model(const std::string& path, const std::string& frame_path,
                              const std::string& precision);

/// The kinds of model files, for help texts.
inline constexpr const char* kModelKinds = ".tosa, .tir, .vgf, .spv";

/// Options that everything which reads models shares.
struct ImportArguments {
  std::vector<std::string> input_shapes, constants;
  std::string entry_point;

  void add_to(CLI::App& app);
  /// Reads the files of the constants.
  /// Errors: kIo; kBadInput for an option that cannot be understood.
  Result<ImportOptions> options() const;
};

/// A model's graph; where input shapes are given, every type follows from them.
/// Errors: those of import_model and infer_shapes.
Result<Graph> import_graph(std::span<const uint8_t> bytes, const ImportOptions& options);

struct DeviceArguments;

/// Options that everything which compiles shares.
struct CompileArguments {
  ImportArguments import;
  std::vector<std::string> targets;
  const DeviceArguments* device = nullptr;  ///< the device at hand, target "device"
  std::string default_target = "lavapipe";  ///< without a device at hand
  std::vector<std::string> kernels;
  std::string frame, render, output, choices, constants, needs, precision = "int8";
  std::string prefer = "balanced";
  double ratio = 0;
  std::optional<double> expected_runs;
  std::optional<uint32_t> tiles;
  std::vector<std::string> dump_after;
  bool no_passes = false, verify_each = false, require_proof = false, no_spirv_opt = false;

  /// With a device at hand, which has to outlive the arguments, that is the target by default.
  void add_to(CLI::App& app, const DeviceArguments* device_at_hand = nullptr);
  /// Errors: kBadInput for an option that cannot be understood; kDevice where the target is a device
  /// that is not there.
  Result<CompileOptions> options(const ModelFiles& model) const;
  /// What the options read, where that is files.
  std::vector<std::string> files() const;

 private:
  Result<void> add_targets(CompileOptions& options) const;
};

/// What `shale tune` writes: JSON of this schema.
inline constexpr const char* kChoicesSchema = "shale-choices/1";
/// The JSON that a file holds.
/// Errors: kIo, kBadInput naming the file.
Result<Json> read_json(const std::string& path);
/// Kernel family by layer, from a file of `shale tune`.
/// Errors: kIo, kBadInput naming the file and the field.
Result<std::map<std::string, std::string>> read_choices(const std::string& path);

/// Constants of the cost model by target, as `shale fit` writes them.
inline constexpr const char* kConstantsSchema = "shale-constants/1";
Json constants_json(const std::string& target, const MeasuredConstants& constants);
/// Errors: kIo, kBadInput naming the file and the field.
Result<std::map<std::string, MeasuredConstants>> read_constants(const std::string& path);

/// "960x540" to a size.
/// Errors: kBadInput naming the option.
Result<FrameExtent> parse_extent(const std::string& option, const std::string& text);

/// NAME=N,H,W,C to a named shape.
Result<std::pair<std::string, Shape>> parse_input_shape(const std::string& text);

/// What was chosen for each variant, and how long the driver will take for it: lines of text, and JSON.
std::vector<std::string> selection_lines(const Compiled& compiled);
Json selection_json(const Selection& selection);

/// Compiles with progress on a terminal; errors carry the model's path.
Result<Compiled> compile_model(const ModelFiles& model, const CompileOptions& options);

/// Indented, with a newline at the end. Names come from files: what is not UTF-8 is replaced.
std::string json_text(const Json& json);
void print_json(const Json& json);

}  // namespace shale
