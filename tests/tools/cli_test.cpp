// The program as its users meet it: exit codes, messages, files.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

namespace {

namespace fs = std::filesystem;

struct Outcome {
  int exit = -1;
  std::string text;  ///< standard output and error
};

Outcome shale(const std::string& arguments, const std::string& environment = "") {
  Outcome outcome;
  std::FILE* pipe = popen((environment + " " SHALE_PROGRAM " " + arguments + " 2>&1").c_str(), "r");
  char buffer[4096];
  for (size_t count; (count = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;)
    outcome.text.append(buffer, count);
  const int status = pclose(pipe);
  outcome.exit = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return outcome;
}

std::string read(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

void write(const fs::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

const std::string kModels = SHALE_SOURCE_DIR "/models";

/// A graph of two operators in text form.
const std::string kSmallGraph = read(SHALE_SOURCE_DIR "/tests/tools/small.tir");

class Cli : public testing::Test {
 protected:
  void SetUp() override {
    folder_ =
        fs::temp_directory_path() /
        ("shale_cli_" + std::string(testing::UnitTest::GetInstance()->current_test_info()->name()));
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    write(file("small.tir"), kSmallGraph);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string file(const std::string& name) const { return (folder_ / name).string(); }

  fs::path folder_;
};

TEST_F(Cli, EveryCommandHasHelpWithAnExample) {
  const Outcome top = shale("--help");
  EXPECT_EQ(top.exit, 0);
  for (const char* command : {"compile", "run", "play", "report", "dump", "verify", "conform",
                              "doctor", "diff", "scene", "eval", "bench", "tune", "convert"}) {
    EXPECT_NE(top.text.find(command), std::string::npos) << command;
    const Outcome help = shale(std::string(command) + " --help");
    EXPECT_EQ(help.exit, 0) << command;
    EXPECT_NE(help.text.find("Example: shale " + std::string(command)), std::string::npos)
        << help.text;
  }
}

TEST_F(Cli, ExitCodesTellUsageFromRefusalFromMissingDevice) {
  EXPECT_EQ(shale("").exit, 2);
  EXPECT_EQ(shale("nonsense").exit, 2);
  EXPECT_EQ(shale("compile").exit, 2);
  EXPECT_EQ(shale("verify " + file("absent.tosa")).exit, 1);
  EXPECT_EQ(shale("verify " + file("small.tir")).exit, 0);
  EXPECT_EQ(shale("doctor", "VK_ICD_FILENAMES=/nonexistent VK_DRIVER_FILES=/nonexistent").exit, 3);
  EXPECT_EQ(shale("run " + file("small.tir") + " --random 1",
                  "VK_ICD_FILENAMES=/nonexistent VK_DRIVER_FILES=/nonexistent")
                .exit,
            3);
  EXPECT_EQ(shale("run " + file("small.tir") + " --random 1 --device NoSuchDevice").exit, 3);
}

TEST_F(Cli, TheSamePackageTwice) {
  ASSERT_EQ(shale("compile " + file("small.tir") + " -o " + file("a.shale")).exit, 0);
  ASSERT_EQ(shale("compile " + file("small.tir") + " -o " + file("b.shale")).exit, 0);
  EXPECT_EQ(read(file("a.shale")), read(file("b.shale")));
}

TEST_F(Cli, ARefusedModelLeavesNoFile) {
  write(file("bad.tir"), kSmallGraph.substr(0, 200));
  const Outcome outcome = shale("compile " + file("bad.tir") + " -o " + file("out.shale"));
  EXPECT_EQ(outcome.exit, 1);
  EXPECT_NE(outcome.text.find("error: "), std::string::npos);
  EXPECT_NE(outcome.text.find("line "), std::string::npos) << outcome.text;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder_))
    EXPECT_NE(entry.path().filename().string().substr(0, 3), "out") << entry.path();
}

TEST_F(Cli, TruncationAtEveryByteIsAnErrorWithExitCodeOne) {
  ASSERT_EQ(shale("compile " + file("small.tir") + " -o " + file("whole.shale")).exit, 0);
  const std::string golden = SHALE_SHARED_DIR "/golden/tosa/add/00/graph.tosa";
  if (!fs::exists(golden)) GTEST_SKIP() << golden << " is not there";
  const std::string bytes = read(golden);
  ASSERT_GT(bytes.size(), 100u);
  for (size_t size = 0; size < bytes.size(); ++size) {
    write(file("cut.tosa"), bytes.substr(0, size));
    const Outcome outcome = shale("verify " + file("cut.tosa"));
    ASSERT_EQ(outcome.exit, 1) << size << " of " << bytes.size() << " bytes: " << outcome.text;
    ASSERT_NE(outcome.text.find("cut.tosa"), std::string::npos) << outcome.text;
  }
  const std::string package = read(file("whole.shale"));
  for (size_t size = 0; size < package.size(); size += 97) {
    write(file("cut.shale"), package.substr(0, size));
    ASSERT_EQ(shale("verify " + file("cut.shale")).exit, 1)
        << size << " of " << package.size() << " bytes";
  }
}

TEST_F(Cli, RunChecksAgainstTheInterpreterUnderValidation) {
  const Outcome outcome =
      shale("run " + file("small.tir") + " --random 7 --check --validation --profile");
  EXPECT_EQ(outcome.exit, 0) << outcome.text;
  EXPECT_NE(outcome.text.find("output \"y\": equal to the interpreter"), std::string::npos)
      << outcome.text;
  EXPECT_NE(outcome.text.find("us total"), std::string::npos);
}

TEST_F(Cli, RunOfAPackageNeedsItsModelToCheck) {
  ASSERT_EQ(shale("compile " + file("small.tir") + " -o " + file("s.shale")).exit, 0);
  EXPECT_EQ(shale("run " + file("s.shale") + " --random 1 --check").exit, 1);
  EXPECT_EQ(
      shale("run " + file("s.shale") + " --random 1 --check --model " + file("small.tir")).exit, 0);
  EXPECT_EQ(shale("run " + file("s.shale")).exit, 1) << "inputs are missing";
}

TEST_F(Cli, TrainedModelsGiveTheirGoldenOffsets) {
  for (const char* name : {"srpo_x2", "srpo_x3"}) {
    const std::string model = kModels + "/" + name;
    const Outcome outcome = shale("run " + model + "/model.tosa --input input=" + model +
                                  "/golden/input.npy -o " + file(name) + " --check --validation");
    EXPECT_EQ(outcome.exit, 0) << outcome.text;
    EXPECT_EQ(read(file(name) + "/offsets.npy"), read(model + "/golden/offsets.npy")) << name;
  }
}

TEST_F(Cli, PlayRunsTheSandwichOnAPictureAndAFolder) {
  const std::string picture = kModels + "/pictures/raster_lr.png";
  const Outcome one = shale("play " + kModels + "/srpo_x2 -i " + picture + " -o " +
                            file("one.png") + " --compare " + file("panels.png") + " --reference " +
                            kModels + "/pictures/raster_x2.png --profile --validation --json");
  ASSERT_EQ(one.exit, 0) << one.text;
  const nlohmann::json json = nlohmann::json::parse(one.text);
  EXPECT_EQ(json["frames"][0]["width"], 960);
  EXPECT_EQ(json["frames"][0]["height"], 540);
  EXPECT_GT(json["frames"][0]["psnr_db"]["result"].get<double>(), 15.0);
  EXPECT_GE(json["dispatches"].size(), 5u);
  EXPECT_TRUE(fs::exists(file("panels.png")));

  fs::create_directories(folder_ / "in");
  fs::copy_file(picture, folder_ / "in" / "a.png");
  fs::copy_file(picture, folder_ / "in" / "b.png");
  ASSERT_EQ(shale("play " + kModels + "/srpo_x2 -i " + file("in") + " -o " + file("out")).exit, 0);
  EXPECT_EQ(read(file("out/a.png")), read(file("one.png")));
  EXPECT_EQ(read(file("out/b.png")), read(file("one.png")));
}

TEST_F(Cli, PlayRefusesPicturesOfAnotherSizeAndPackagesWithoutSandwich) {
  ASSERT_EQ(shale("compile " + kModels + "/srpo_x2 --render 16x16 -o " + file("p.shale")).exit, 0);
  const std::string play = " -i " + kModels + "/pictures/raster_lr.png -o " + file("o.png");
  const Outcome size = shale("play " + file("p.shale") + play);
  EXPECT_EQ(size.exit, 1);
  EXPECT_NE(size.text.find("480x270"), std::string::npos) << size.text;
  ASSERT_EQ(shale("compile " + file("small.tir") + " -o " + file("s.shale")).exit, 0);
  EXPECT_EQ(shale("play " + file("s.shale") + play).exit, 1);
  EXPECT_EQ(
      shale("play " + kModels + "/srpo_x2 -i " + file("small.tir") + " -o " + file("o.png")).exit,
      1);
  EXPECT_FALSE(fs::exists(file("o.png")));
}

TEST_F(Cli, DumpShowsGraphPackageMemoryAndShaders) {
  EXPECT_EQ(shale("dump " + file("small.tir")).text, shale("dump " + file("small.tir")).text);
  ASSERT_EQ(shale("compile " + file("small.tir") + " --kernels generic -o " + file("s.shale")).exit,
            0);
  EXPECT_NE(shale("dump " + file("s.shale")).text.find("generic"), std::string::npos);
  EXPECT_NE(shale("dump " + file("s.shale") + " --what memory").text.find("arena"),
            std::string::npos);
  EXPECT_NE(shale("dump " + file("s.shale") + " --what spirv").text.find("OpEntryPoint"),
            std::string::npos);
  EXPECT_EQ(shale("dump " + file("small.tir") + " --what memory").exit, 1);
}

TEST_F(Cli, CompileOptionsAreChecked) {
  const std::string compile = "compile " + file("small.tir") + " -o " + file("s.shale");
  for (const char* option :
       {"--input-shape x=1,4", "--input-shape y=1,4,4,1", "--input-shape x",
        "--input-shape x=0,4,4,1", "--kernels none", "--target moon", "--dump-after nothing"}) {
    const Outcome outcome = shale(compile + " " + option);
    EXPECT_EQ(outcome.exit, 1) << option << ": " << outcome.text;
    EXPECT_EQ(std::count(outcome.text.begin(), outcome.text.end(), '\n'), 1)
        << option << ": " << outcome.text;
  }
  const Outcome dumped = shale(compile + " --dump-after fold-zero-point --verify-each");
  EXPECT_EQ(dumped.exit, 0) << dumped.text;
  EXPECT_NE(dumped.text.find("# after fold-zero-point"), std::string::npos);
  EXPECT_NE(dumped.text.find("pad "), std::string::npos) << "the zero point's pad is explicit";
}

TEST_F(Cli, JsonIsJson) {
  ASSERT_EQ(shale("compile " + file("small.tir") + " -o " + file("s.shale")).exit, 0);
  for (const std::string& command :
       {"compile " + file("small.tir") + " -o " + file("t.shale") + " --json",
        "verify " + file("small.tir") + " --json",
        "run " + file("small.tir") + " --random 1 --json",
        "report " + file("small.tir") + " --json", "dump " + file("small.tir") + " --json",
        "dump " + file("s.shale") + " --json", "dump " + file("s.shale") + " --what memory --json",
        std::string("doctor --json")}) {
    const Outcome outcome = shale(command);
    EXPECT_EQ(outcome.exit, 0) << command;
    EXPECT_TRUE(nlohmann::json::accept(outcome.text)) << command << "\n" << outcome.text;
  }
}

TEST_F(Cli, ConvertWritesEveryFormatAndTheGraphStaysTheSame) {
  // SPIR-V lists constants in the order of their use; from then on nothing moves.
  ASSERT_EQ(shale("convert " + file("small.tir") + " -o " + file("first.spv")).exit, 0);
  const std::string first = shale("dump " + file("first.spv") + " --what graph").text;
  ASSERT_EQ(first.substr(0, 6), "graph ") << first;
  std::string from = "first.spv";
  for (const std::string to : {"a.tosa", "b.spv", "c.vgf", "d.tir", "e.vgf", "f.spv", "g.tosa"}) {
    const Outcome outcome = shale("convert " + file(from) + " -o " + file(to));
    ASSERT_EQ(outcome.exit, 0) << outcome.text;
    EXPECT_EQ(shale("dump " + file(to) + " --what graph").text, first) << from << " to " << to;
    EXPECT_EQ(shale("verify " + file(to)).exit, 0);
    EXPECT_EQ(shale("report " + file(to)).exit, 0);
    from = to;
  }
  // --to goes before the suffix, and the content before the name.
  ASSERT_EQ(shale("convert " + file("c.vgf") + " --to tosa -o " + file("odd.vgf")).exit, 0);
  EXPECT_EQ(read(file("odd.vgf")), read(file("g.tosa")));
  const Outcome json = shale("convert " + file("odd.vgf") + " -o " + file("h.spv") + " --json");
  const nlohmann::json summary = nlohmann::json::parse(json.text);
  EXPECT_EQ(summary["from"], "tosa");
  EXPECT_EQ(summary["to"], "spv");
  EXPECT_EQ(summary["bytes"], read(file("h.spv")).size());
  EXPECT_EQ(read(file("h.spv")), read(file("f.spv")));
}

TEST_F(Cli, ModelsInVgfAndSpirvRun) {
  for (const std::string name : {"s.vgf", "s.spv"}) {
    ASSERT_EQ(shale("convert " + file("small.tir") + " -o " + file(name)).exit, 0);
    const Outcome outcome = shale("run " + file(name) + " --random 7 --check");
    EXPECT_EQ(outcome.exit, 0) << outcome.text;
    EXPECT_NE(outcome.text.find("output \"y\": equal to the interpreter"), std::string::npos);
    EXPECT_EQ(shale("compile " + file(name) + " -o " + file("s.shale")).exit, 0);
  }
}

TEST_F(Cli, ConvertNamesWhatItCannotDo) {
  ASSERT_EQ(shale("compile " + file("small.tir") + " --kernels generic -o " + file("p.shale")).exit,
            0);
  ASSERT_EQ(shale("convert " + file("small.tir") + " -o " + file("s.vgf")).exit, 0);
  const std::pair<std::string, std::string> refused[] = {
      {"small.tir -o " + file("out.bin"),
       "--to: \"bin\" is no format to write, expected one of: tosa, tir, vgf, spv"},
      {"small.tir -o " + file("out"), "--to: \"\" is no format to write"},
      {"p.shale -o " + file("out.tosa"), "a package becomes vgf only, found tosa"},
      {"p.shale -o " + file("out.vgf"), "--weights-as-inputs"},
      {"p.shale --weights-as-inputs --variant 1 -o " + file("out.vgf"),
       "--variant: found 1, the package has 1"},
      {"small.tir --weights-as-inputs -o " + file("out.vgf"), "the file is a model, not a package"},
      {"small.tir --entry-point main -o " + file("out.vgf"), "--entry-point: found \"main\""},
      {"s.vgf --entry-point other -o " + file("out.tosa"),
       "--entry-point: found \"other\", which is the name of 0 graph segments"},
      {"small.tir --constant 1 -o " + file("out.vgf"),
       "--constant: \"1\" is not of the form ID=FILE"},
      {"s.vgf --constant 1=" + file("small.tir") + " -o " + file("out.tosa"),
       "--constant: the format holds its constants itself"},
      {"absent.vgf -o " + file("out.tosa"), "absent.vgf: cannot open"}};
  for (const auto& [arguments, expected] : refused) {
    const Outcome outcome = shale("convert " + file(arguments));
    EXPECT_EQ(outcome.exit, 1) << arguments << ": " << outcome.text;
    EXPECT_NE(outcome.text.find(expected), std::string::npos) << arguments << ": " << outcome.text;
  }
  for (const fs::directory_entry& entry : fs::directory_iterator(folder_))
    EXPECT_NE(entry.path().filename().string().substr(0, 3), "out") << entry.path();
  const Outcome package =
      shale("convert " + file("p.shale") + " --weights-as-inputs -o " + file("p.vgf"));
  EXPECT_EQ(package.exit, 0) << package.text;
  EXPECT_EQ(shale("dump " + file("p.vgf")).exit, 0);
  EXPECT_NE(shale("verify " + file("p.vgf")).text.find("has no graph segment"), std::string::npos);
}

TEST_F(Cli, DumpOfAVgfFileSaysWhatItsDescriptionSays) {
  const fs::path golden = SHALE_SHARED_DIR "/golden/vgf";
  if (!fs::exists(golden)) GTEST_SKIP() << golden << " is not there";
  // Every field of the description that both have must be equal; lists must be as long.
  const std::function<void(const nlohmann::json&, const nlohmann::json&, const std::string&)>
      compare =
          [&](const nlohmann::json& want, const nlohmann::json& found, const std::string& at) {
            if (want.is_object()) {
              for (const auto& [key, value] : want.items())
                if (found.contains(key)) compare(value, found[key], at + "." + key);
            } else if (want.is_array() && !want.empty() && want[0].is_object()) {
              ASSERT_EQ(want.size(), found.size()) << at;
              for (size_t i = 0; i < want.size(); ++i)
                compare(want[i], found[i], at + "[" + std::to_string(i) + "]");
            } else {
              EXPECT_EQ(want, found) << at;
            }
          };
  size_t files = 0;
  for (const fs::directory_entry& entry : fs::directory_iterator(golden)) {
    if (entry.path().extension() != ".vgf") continue;
    const Outcome outcome = shale("dump " + entry.path().string() + " --json");
    ASSERT_EQ(outcome.exit, 0) << outcome.text;
    const nlohmann::json found = nlohmann::json::parse(outcome.text);
    fs::path description = entry.path();
    const nlohmann::json want = nlohmann::json::parse(read(description.replace_extension(".json")));
    for (const char* key : {"header", "sections", "constants_tag", "modules", "resources",
                            "constants", "segments", "model"})
      EXPECT_TRUE(found.contains(key)) << key;
    compare(want, found, entry.path().filename().string());
    ++files;
  }
  EXPECT_GE(files, 3u);
}

TEST_F(Cli, DumpOfASpirvModuleListsItsEntryPoints) {
  ASSERT_EQ(shale("convert " + file("small.tir") + " -o " + file("s.spv")).exit, 0);
  const Outcome text = shale("dump " + file("s.spv"));
  EXPECT_EQ(text.exit, 0);
  EXPECT_EQ(text.text.substr(0, 14), "# entry point ") << text.text;
  EXPECT_NE(text.text.find("#   inputs: set 0 binding 0 i8[1,4,4,1] \"x\""), std::string::npos)
      << text.text;
  write(file("again.tir"), text.text);
  EXPECT_EQ(shale("dump " + file("again.tir")).text,
            shale("dump " + file("s.spv") + " --what graph").text);
  const nlohmann::json json =
      nlohmann::json::parse(shale("dump " + file("s.spv") + " --json").text);
  EXPECT_EQ(json["entry_points"][0]["outputs"][0]["name"], "y");
  EXPECT_EQ(json["inputs"][0], "x");
}

TEST_F(Cli, ReportCountsTheSrpoParameters) {
  const Outcome outcome = shale("report " + kModels + "/srpo_x2");
  EXPECT_EQ(outcome.exit, 0);
  EXPECT_TRUE(outcome.text.find("8,434") != std::string::npos ||
              outcome.text.find("8434") != std::string::npos)
      << outcome.text;
}

TEST_F(Cli, BenchComparesWithTheRoofAndTheNaiveKernel) {
  const Outcome outcome =
      shale("bench " + file("small.tir") + " --naive --start --repeat 3 --json");
  ASSERT_EQ(outcome.exit, 0) << outcome.text;
  const nlohmann::json json = nlohmann::json::parse(outcome.text);
  EXPECT_GE(json["roofs"].size(), 5u);
  for (const auto& roof : json["roofs"]) EXPECT_GT(roof["rate"], 0) << roof;
  const nlohmann::json& model = json["models"][0];
  ASSERT_EQ(model["dispatches"].size(), 1u);
  const nlohmann::json& total = model["total"];
  EXPECT_DOUBLE_EQ(total["gop"], 2e-9 * 16 * 9);
  EXPECT_NEAR(total["gop_per_s"].get<double>(),
              1e3 * total["gop"].get<double>() / total["time_ms"].get<double>(), 1e-6);
  EXPECT_GT(total["times_naive"], 0);
  EXPECT_GT(model["first_start"]["first_run_ms"], 0);
  EXPECT_GT(model["second_start"]["create_ms"], 0);
  const Outcome table = shale("bench " + file("small.tir") + " --repeat 3");
  EXPECT_NE(table.text.find("f32 mul+add"), std::string::npos) << table.text;
}

TEST_F(Cli, TuneWritesChoicesThatCompileObeys) {
  const Outcome tuned = shale("tune " + file("small.tir") + " -o " + file("c.json") +
                              " --repeat 3 --without generic");
  ASSERT_EQ(tuned.exit, 0) << tuned.text;
  nlohmann::json choices = nlohmann::json::parse(read(file("c.json")));
  EXPECT_EQ(choices["schema"], "shale-choices/1");
  ASSERT_TRUE(choices["choices"].contains("y")) << choices;
  // The choice is obeyed, whatever selection would take.
  for (const char* kernel : {"conv2d_s8_i32", "generic"}) {
    choices["choices"]["y"] = kernel;
    write(file("c.json"), choices.dump());
    const Outcome run = shale("run " + file("small.tir") +
                              " --random 1 --check --profile --choices " + file("c.json"));
    EXPECT_EQ(run.exit, 0) << run.text;
    EXPECT_NE(run.text.find(kernel), std::string::npos) << run.text;
  }
  const std::pair<const char*, const char*> refused[] = {
      {R"({"schema":"shale-choices/1","choices":{"y":"nonsense"}})", "choices.y"},
      {R"({"schema":"shale-choices/1","choices":{"y":"conv2d_s8_phase"}})", "conv2d_s8_phase"},
      {R"({"schema":"shale-choices/1"})", "shale-choices/1"},
      {R"({"schema":"other","choices":{}})", "shale-choices/1"},
      {"nonsense", "shale-choices/1"}};
  for (const auto& [text, expected] : refused) {
    write(file("c.json"), text);
    const Outcome outcome = shale("compile " + file("small.tir") + " -o " + file("s.shale") +
                                  " --choices " + file("c.json"));
    EXPECT_EQ(outcome.exit, 1) << text;
    EXPECT_NE(outcome.text.find(expected), std::string::npos) << outcome.text;
    EXPECT_FALSE(fs::exists(file("s.shale")));
  }
}

}  // namespace
