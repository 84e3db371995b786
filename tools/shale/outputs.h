// tools/shale/outputs.h -- the files that a command will write, known before the work begins.
#pragma once

#include <cstdio>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "ir/base/result.h"

namespace shale {

/// Claims paths, so that what cannot be written is refused before there is anything to write, and two
/// results of one command never share a file. Standard output has one result too, and nothing else then.
class Outputs {
 public:
  /// With --json a command's JSON is the result that standard output has.
  explicit Outputs(bool prints_json = false);
  /// Inputs that no result may replace; of a folder, the files that make a model or a data set.
  void keep(const std::vector<std::string>& paths);
  /// The same of the paths in texts NAME=PATH; of a folder everything in it, which pictures are.
  void keep_named(const std::vector<std::string>& texts);
  /// `what` is the option or the result that goes to `path`; an empty path is none.
  /// Errors: as write_file; kBadInput if another result or an input has the file.
  Result<void> claim(const std::string& what, const std::string& path);
  /// As claim, for a picture that is written as PNG: any suffix but .png (or none) is refused, since a
  /// file's content is what its suffix says.
  Result<void> claim_picture(const std::string& what, const std::string& path);
  /// Takes what came of writing a result at the end of the work: an error is told, and keeps nothing else
  /// that the command has to say or to write from coming. True if there is none.
  bool note(const Result<void>& written);
  bool all_written() const { return all_written_; }
  /// True if a result goes to standard output, so that no text may.
  bool has_standard_output() const;
  /// Where a command sums up what it wrote: standard error if a result has standard output.
  std::FILE* summary() const;

 private:
  void keep_file(const std::string& path);

  std::map<std::string, std::string> owners_;  ///< by output_identity
  bool all_written_ = true;
};

/// File names for names that come from models: safe, and different for different names.
class FileNames {
 public:
  std::string claim(const std::string& name);

 private:
  std::set<std::string> taken_;
};

/// What lists call `names`, each that of the file or folder at the path: where two are equal, with as many of
/// the folders above them as it takes to tell them apart; the same path twice gets a number.
std::vector<std::string> distinct_names(std::vector<std::string> names,
                                        const std::vector<std::string>& paths);

}  // namespace shale
