// tools/shale/main.cpp -- the one program: parses the command line and runs a subcommand.
#include <cerrno>
#include <charconv>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <new>
#include <sstream>
#include <system_error>

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

/// Whole numbers are decimal digits alone: the parser's library takes a sign for a large number, a leading
/// zero for octal, and what is too large for the largest there is.
void take_digits_alone(CLI::App& command) {
  const CLI::Validator whole(
      [](std::string& text) {
        uint64_t value = 0;
        const char* const end = text.data() + text.size();
        const auto [at, error] = std::from_chars(text.data(), end, value);
        if (error != std::errc() || at != end)
          return fmt::format("\"{}\" is no whole number from 0 to {}", text, UINT64_MAX);
        text = std::to_string(value);
        return std::string();
      },
      "");
  for (CLI::Option* option : command.get_options())
    if (option->get_type_name().starts_with("UINT")) option->transform(whole);
}

/// What the parser has to say: help on standard output, else one line and the usage's exit code.
int parse_exit(const CLI::App& app, const CLI::ParseError& error) {
  std::ostringstream out, ignored;
  if (app.exit(error, out, ignored) == 0) {
    fmt::print("{}", out.str());
    return kDone;
  }
  const std::vector<CLI::App*> chosen = app.get_subcommands();
  const std::string name = chosen.empty() ? "shale" : "shale " + chosen.front()->get_name();
  print_error(bad_input(name, "{} ({} --help tells more)", error.what(), name));
  return kUsage;
}

int run(int argc, char** argv) {
  CLI::App app{"Shale: trained INT8 networks, given as TOSA graphs, on any Vulkan 1.3 device"};
  app.set_version_flag("--version", kVersionText);
  app.require_subcommand(1);
  app.footer(
      "Example: shale compile models/srpo_x2 --render 960x540 -o srpo.shale\n"
      "Exit codes: 0 done, 1 refused input or failed check, 2 usage, 3 no usable device, "
      "130 interrupted");
  std::vector<Action> actions;
  for (const Command& command : kCommands) {
    CLI::App& own = *app.add_subcommand(command.name, command.help);
    actions.push_back(command.add(own));
    take_digits_alone(own);
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return parse_exit(app, error);
  }
  for (size_t i = 0; i < actions.size(); ++i) {
    if (!app.got_subcommand(kCommands[i].name)) continue;
    const Result<int> result = actions[i]();
    if (result) return *result;
    print_error(result.error());
    return exit_code(result.error());
  }
  return kUsage;
}

/// What the libraries below throw: a failed write of results, and memory that there is not.
int run_caught(int argc, char** argv) {
  try {
    const int code = run(argc, argv);
    if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return code;
    print_error(io_error("standard output", "cannot write: {}", std::strerror(errno)));
  } catch (const std::filesystem::filesystem_error& error) {
    print_error(io_error(error.path1().string(), "{}", error.code().message()));
  } catch (const std::system_error& error) {
    print_error(io_error("standard output", "cannot write: {}", error.code().message()));
  } catch (const std::bad_alloc&) {
    print_error(io_error("shale", "there is not enough memory for this"));
  } catch (const std::length_error&) {
    print_error(io_error("shale", "there is not enough memory for this"));
  } catch (const std::exception& error) {
    print_error(io_error("shale", "internal error: {}", error.what()));
  }
  return kRefused;
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) {
  shale::prepare_process();
  const int code = shale::run_caught(argc, argv);
  return shale::interrupted() ? shale::kInterrupted : code;
}
