// tools/shale/main.cpp -- the one program: parses the command line and runs a subcommand.
#include <csignal>
#include <iterator>

#include "tools/shale/command.h"

namespace shale {
namespace {

constexpr Command kCommands[] = {
#define SHALE_COMMAND(name, add, help) {name, help, add},
#include "tools/shale/commands.def"
};

int exit_code(const Error& error) {
  return error.code == ErrorCode::kDevice ? kNoDevice : kRefused;
}

int main_with(int argc, char** argv) {
  CLI::App app{"Shale: trained INT8 networks, given as TOSA graphs, on any Vulkan 1.3 device"};
  app.set_version_flag("--version", kVersionText);
  app.require_subcommand(1);
  app.footer(
      "Example: shale compile models/srpo_x2 --render 960x540 -o srpo.shale\n"
      "Exit codes: 0 done, 1 refused input or failed check, 2 usage, 3 no usable device");
  std::vector<Action> actions;
  for (const Command& command : kCommands)
    actions.push_back(command.add(*app.add_subcommand(command.name, command.help)));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kUsage;
  }
  for (size_t i = 0; i < actions.size(); ++i) {
    if (!app.got_subcommand(kCommands[i].name)) continue;
    const Result<int> result = actions[i]();
    if (result) return *result;
    fmt::print(stderr, "error: {}\n", result.error().text());
    return exit_code(result.error());
  }
  return kUsage;
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) { return shale::main_with(argc, argv); }
