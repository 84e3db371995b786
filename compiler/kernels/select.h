// compiler/kernels/select.h -- which kernel family each group of a network gets.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "compiler/kernels/kernel.h"

namespace shale {

/// Runs over which the driver's compile time is spread where nothing else is said: of a command that
/// runs a network once, of a package with a network alone, and of one with the passes of a frame,
/// minutes to hours of frames.
inline constexpr double kRunsOfOne = 1, kRunsOfNetwork = 1000, kRunsOfFrame = 100000;

/// Networks whose kernels keep the driver busy for longer than this, in microseconds of one thread, get start forms.
inline constexpr double kStartUs = 1e6;

struct SelectOptions {
  double expected_runs = kRunsOfNetwork;  ///< of the whole network; at least 1
  /// Families to choose from; empty is all. The generic kernel serves where none of them can.
  std::vector<std::string> allowed = {};
  std::string prefer = {};  ///< family of every group that it supports and `choices` leaves
  /// Family by the name of a group's result, where the profile can run it.
  std::map<std::string, std::string> choices = {};
  double start_us = kStartUs;  ///< in place of kStartUs
};

struct Selection {
  std::vector<const KernelFamily*> families;  ///< of each group
  /// Of each group, the family that serves until the driver has compiled its own (StartForm); null where that is soon.
  std::vector<const KernelFamily*> start_families;
  /// By the group's name, why its choice was not followed: the profile cannot run that family.
  std::map<std::string, std::string> refused;
  int64_t products = 0;  ///< with a weight in the code, of all groups
  double run_us = 0;     ///< predicted for one run of the network
  double driver_us = 0;  ///< predicted for the driver's compilation, all of it on one thread
  double start_us = 0;   ///< the same until the first run, by the start forms

  /// Joins what another network of the package gets.
  void add(const Selection& other);
};

/// The families of least driver time + expected runs x run time, for the network as a whole: its
/// code stays within the profile's `most_products`, at the least loss of time; table order breaks ties.
/// Errors: kBadInput for a choice that is no family.
Result<Selection> select_kernels(std::span<const GroupProblem> problems,
                                 const DeviceProfile& profile, const SelectOptions& options);

}  // namespace shale
