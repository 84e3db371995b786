// The program as its users meet it: exit codes, messages, files.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <set>
#include <string>

namespace {

namespace fs = std::filesystem;

struct Outcome {
  int exit = -1;
  std::string
      text;  ///< standard output and error; without the latter of JSON, since a busy machine has progress told there
};

Outcome shale(const std::string& arguments, const std::string& environment = "") {
  Outcome outcome;
  const bool json = arguments.find("--json") != std::string::npos;
  const std::string command = environment + " " SHALE_PROGRAM " " + arguments;
  std::FILE* pipe = popen((command + (json ? " 2>/dev/null" : " 2>&1")).c_str(), "r");
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
  for (const char* command :
       {"compile", "run", "play", "report", "fit", "trade", "compare", "dump", "convert", "verify",
        "conform", "doctor", "diff", "scene", "eval", "bench", "tune", "stress"}) {
    EXPECT_NE(top.text.find(command), std::string::npos) << command;
    const Outcome help = shale(std::string(command) + " --help");
    EXPECT_EQ(help.exit, 0) << command;
    EXPECT_NE(help.text.find("Example: shale " + std::string(command)), std::string::npos)
        << help.text;
  }
}

TEST_F(Cli, ABudgetLetsCheaperSandwichesStepIn) {
  write(file("load.txt"), "1\n");
  const std::string play = "play " + kModels + "/baselines/lanczos -i " + kModels +
                           "/scenes/test/motion.json --render 64x36 --ratio 2 --frames 4 -o " +
                           file("frames");
  // No frame takes a nanosecond: after two of them the cheapest is all that is left.
  const std::string cheaper = " --or " + kModels + "/baselines/nearest";
  const Outcome tight =
      shale(play + " --budget 0.001 --load " + file("load.txt") + cheaper + " --json");
  ASSERT_EQ(tight.exit, 0) << tight.text;
  const auto json = nlohmann::json::parse(tight.text);
  EXPECT_EQ(json["budget"]["switches"], 1);
  EXPECT_EQ(json["budget"]["within"], 0);
  for (size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(json["frames"][i]["model"],
              kModels + (i < 2 ? "/baselines/lanczos" : "/baselines/nearest"));
    EXPECT_GT(json["frames"][i]["frame_ms"], 0);
  }
  const auto ample =
      nlohmann::json::parse(shale(play + " --budget 100000" + cheaper + " --json").text);
  EXPECT_EQ(ample["budget"]["switches"], 0);
  EXPECT_EQ(ample["budget"]["within"], 1);

  write(file("bad.txt"), "1\n2\nquick\n");
  const Outcome bad = shale(play + " --budget 10 --load " + file("bad.txt") + cheaper);
  EXPECT_EQ(bad.exit, 1);
  EXPECT_NE(bad.text.find("line 3 is \"quick\""), std::string::npos) << bad.text;
  EXPECT_EQ(shale(play + " --or x").exit, 2);
  EXPECT_EQ(shale(play + " --budget 10 --profile").exit, 2);
  const Outcome other = shale(play + " --budget 10 --or " + kModels + "/srpo_x2");
  EXPECT_EQ(other.exit, 1);
  EXPECT_NE(other.text.find("other pictures"), std::string::npos) << other.text;
}

TEST_F(Cli, StressSaysOfEachExtremeWhetherItHolds) {
  const std::string lanczos = kModels + "/baselines/lanczos --render 32x18 --frames 1";
  const Outcome all = shale("stress " + lanczos + " --json --page " + file("page.html"));
  const auto json = nlohmann::json::parse(all.text);
  // Colours through a filter with negative lobes, and no past: nothing lasts, nothing drifts.
  std::set<std::string> groups;
  for (const auto& row : json["faults"]) {
    groups.insert(row["group"]);
    EXPECT_EQ(row["not_finite"], 0) << row["fault"];
    EXPECT_EQ(row["lasts_frames"], 0) << row["fault"];
  }
  EXPECT_EQ(groups, (std::set<std::string>{"colour", "exposure", "cut"}));
  EXPECT_EQ(json["courses"].size(), 6u);
  for (const auto& row : json["courses"]) EXPECT_EQ(row["drift_largest_codes"], 0) << row["course"];
  // Only NSS v1 has a model in double precision.
  EXPECT_NE(json["reference"].get<std::string>().find("no reference"), std::string::npos);
  EXPECT_TRUE(json["faults"][0]["reference_mean_codes"].is_null());
  EXPECT_EQ(all.exit, json["hold"] == json["verdicts"] ? 0 : 1);
  EXPECT_NE(read(file("page.html")).find("At the extremes"), std::string::npos);

  // A light beside the dark is no brighter than it was, though the filter overshoots.
  const auto colours =
      nlohmann::json::parse(shale("stress " + lanczos + " --only colour --json").text);
  EXPECT_EQ(colours["hold"], colours["verdicts"]);
  EXPECT_TRUE(colours["courses"].empty());

  // Rounding to half floats is what parts it from the same pass on 32 bits: 2^-11 of a colour, less than a code.
  const auto wide = nlohmann::json::parse(
      shale("stress " + lanczos + " --only colour --reference wide --json").text);
  bool departs = false;
  for (const auto& row : wide["faults"]) {
    EXPECT_LT(row["reference_largest_codes"], 1.5) << row["fault"];  // of two pictures in codes
    departs |= row["reference_mean_codes"] > 0;
  }
  EXPECT_TRUE(departs);

  EXPECT_EQ(shale("stress " + lanczos + " --only lights").exit, 2);
  // Before the work, not after it.
  const Outcome refused = shale("stress " + lanczos + " --page " + folder_.string());
  EXPECT_EQ(refused.exit, 1);
  EXPECT_EQ(refused.text.find("MB more"), std::string::npos) << refused.text;
  EXPECT_NE(refused.text.find("is a folder"), std::string::npos) << refused.text;
  const Outcome network = shale("stress " + file("small.tir"));
  EXPECT_EQ(network.exit, 1);
  EXPECT_NE(network.text.find("has no sandwich"), std::string::npos) << network.text;
}

TEST_F(Cli, ExitCodesTellUsageFromRefusalFromMissingDevice) {
  EXPECT_EQ(shale("").exit, 2);
  EXPECT_EQ(shale("nonsense").exit, 2);
  EXPECT_EQ(shale("compile").exit, 2);
  for (const char* unused : {" --html x", " --csv x", " --render 8x8"})
    EXPECT_EQ(shale("report --cost-table " + file("absent.json") + unused).exit, 2) << unused;
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
  const std::string golden = SHALE_BINARY_DIR "/golden/tosa/add/00/graph.tosa";
  ASSERT_TRUE(fs::exists(golden)) << golden;
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

TEST_F(Cli, WhatIsOfAnotherTypeOrOutOfRangeIsRefused) {
  const std::string small = file("small.tir"), render = " --render 48x32";
  for (const char* option : {"--frame-ms", "--passes-ms", "--tops", "--memory-gbps"})
    EXPECT_EQ(shale("report " + kModels + "/srpo_x2 " + option + " nan").exit, 2) << option;
  EXPECT_EQ(shale("compile " + small + " -o " + file("s") + " --expected-runs nan").exit, 2);
  const auto refused = [](const std::string& arguments, const std::string& expected) {
    const Outcome outcome = shale(arguments);
    EXPECT_EQ(outcome.exit, 1) << arguments;
    EXPECT_NE(outcome.text.find(expected), std::string::npos) << outcome.text;
    EXPECT_EQ(std::count(outcome.text.begin(), outcome.text.end(), '\n'), 1) << outcome.text;
  };
  // An output never goes over what it is made of.
  refused("compile " + small + " -o " + small, "is the file of the input already");
  refused("convert " + small + " -o " + small, "is the file of the input already");
  EXPECT_EQ(read(small), kSmallGraph);
  ASSERT_EQ(shale("run " + small + " --random 1 -o " + file("made")).exit, 0);
  const std::string made = read(file("made/y.npy"));
  const Outcome over_input =
      shale("run " + small + " --input x=" + file("made/y.npy") + " -o " + file("made"));
  EXPECT_EQ(over_input.exit, 1);
  EXPECT_NE(over_input.text.find("y.npy: error: is the file of the input"), std::string::npos)
      << over_input.text;
  EXPECT_EQ(read(file("made/y.npy")), made);
  const std::string scene = file("scene.json");
  fs::copy(kModels + "/scenes/test/still.json", scene);
  refused("scene " + scene + " --needs " + scene + " --frames 1" + render,
          "is the file of the input");
  fs::create_directory(file("own"));
  fs::copy(scene, file("own/0001.json"));
  refused("scene " + scene + " " + file("own/0001.json") + " -o " + file("own") + " --frames 1" +
              render,
          "0001.json: error: is the file of the input");
  EXPECT_EQ(read(file("own/0001.json")), read(scene));
  write(file("load"), "1\n");
  refused("play " + kModels + "/baselines/bilinear -i " + scene + " -o " + file("out") +
              " --frames 1 --budget 90 --or " + kModels + "/baselines/nearest --load " +
              file("load") + " --animation " + file("load") + render,
          "is the file of the input");
  fs::create_directories(file("shown/scene"));
  write(file("shown/scene/0.png"), "a picture");
  refused(
      "eval " + scene + " --pictures x=" + file("shown") + " --page " + file("shown/scene/0.png"),
      "is the file of the input");
  refused(
      "scene " + scene + " " + scene + " -o " + file("ds") + " --number 9999 --frames 1" + render,
      "2 sequences from 9999 on do not end at 9999");
  EXPECT_EQ(shale("scene " + scene + " -o " + file("ds") + " --frames 0").exit, 2);
  for (const char* crop :
       {"4294967296,0,8,8", "-1,0,8,8", "0,0,8", "0,0,8,8,8", "0,0,8,8x", "0, 0,8,8"})
    refused("scene " + scene + " -o " + file("ds") + render + " --crop '" + crop + "'",
            "is not of the form X,Y,WIDTH,HEIGHT");
  // Whole numbers have neither a sign nor another base, nor more than they can hold.
  for (const char* number : {"-1", "0x10", "1x", " 1", "18446744073709551616"}) {
    const std::string quoted = std::string("'") + number + "'";
    for (const std::string& arguments :
         {"run " + small + " --random " + quoted, "run " + small + " --random 1 --repeat " + quoted,
          "compare " + small + " " + small + " --random " + quoted,
          "scene " + scene + " -o " + file("ds") + " --seed " + quoted,
          "play x -i y -o z --crop " + quoted + ",0,8,8"})
      EXPECT_EQ(shale(arguments).exit, 2) << arguments;
  }
  EXPECT_EQ(shale("dump " + small + " --variant 4294967296").exit, 2);
  EXPECT_EQ(shale("compare " + small + " " + small + " --random 010").exit, 0);
  EXPECT_FALSE(fs::exists(file("ds")));
  const std::string play = "play " + kModels + "/baselines/bilinear -i " + scene + " -o " +
                           file("out") + " --frames 1" + render;
  fs::create_directory(file("dumped"));
  write(file("dumped/0000.color.npy"), "a picture");
  refused(play + " --reference " + file("dumped/0000.color.npy") + " --dump " + file("dumped"),
          "is the file of the input");
  refused(play + " --crop 90,0,8,8", "8x8 pixels at 90,0 do not lie in the result of 96x64");
  refused(play + " --crop 0,0,2048,8 --zoom 16", "a side of 2048 is outside 1..512");
  // One folder of a suite that is wrong is one failure.
  fs::create_directory(file("case"));
  fs::copy(kModels + "/srpo_x2/model.tosa", file("case/graph.tosa"));
  for (const char* text : {R"({"expect": 3})", R"({"tosa_file": []})", R"({"inputs": 3})",
                           R"({"inputs": [{"name": 3}]})", R"([])"}) {
    write(file("case/desc.json"), text);
    const Outcome outcome = shale("conform " + file("case"));
    EXPECT_EQ(outcome.exit, 1) << text;
    EXPECT_NE(outcome.text.find("desc.json: "), std::string::npos) << outcome.text;
  }
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
  write(file("wrong.tir"),
        "graph main {\n  input %x : i8[4]\n  %y = bitwise_not %x : i8[5]\n  return %y\n}\n");
  const std::pair<std::string, std::string> refused[] = {
      {"wrong.tir -o " + file("out.tosa"), "the result is declared as i8[5], expected i8[4]"},
      {"wrong.tir -o " + file("out.tir"), "the result is declared as i8[5], expected i8[4]"},
      {"small.tir -o " + file("out.bin"),
       "--to: error: \"bin\" is no format to write, expected one of: tosa, tir, vgf, spv"},
      {"small.tir -o " + file("out"), "--to: error: \"\" is no format to write"},
      {"p.shale -o " + file("out.tosa"), "a package becomes vgf only, found tosa"},
      {"p.shale -o " + file("out.vgf"), "--weights-as-inputs"},
      {"p.shale --weights-as-inputs --variant 9 -o " + file("out.vgf"),
       "--variant: found 9, the package has 5"},
      {"small.tir --weights-as-inputs -o " + file("out.vgf"), "the file is a model, not a package"},
      {"small.tir --entry-point main -o " + file("out.vgf"), "--entry-point: found \"main\""},
      {"s.vgf --entry-point other -o " + file("out.tosa"),
       "--entry-point: found \"other\", which is the name of 0 graph segments"},
      {"small.tir --constant 1 -o " + file("out.vgf"),
       "--constant: \"1\" is not of the form ID=FILE"},
      {"s.vgf --constant 1=" + file("small.tir") + " -o " + file("out.tosa"),
       "--constant: the format holds its constants itself"},
      {"absent.vgf -o " + file("out.tosa"), "absent.vgf: error: cannot open"}};
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
  const fs::path golden = SHALE_SOURCE_DIR "/tests/golden/vgf";
  ASSERT_TRUE(fs::exists(golden)) << golden;
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

TEST_F(Cli, ConstantsOfABareModuleComeFromFiles) {
  ASSERT_EQ(shale("convert " + file("small.tir") + " -o " + file("s.vgf")).exit, 0);
  const std::string container = read(file("s.vgf"));
  const nlohmann::json json =
      nlohmann::json::parse(shale("dump " + file("s.vgf") + " --json").text);
  const size_t words = json["modules"][0]["words"];
  write(file("s.spv"), container.substr(container.find("\x03\x02\x23\x07"), 4 * words));
  const size_t section = json["sections"]["constants"]["offset"];
  const size_t payload = section + 16 + 24 * json["constants"].size();
  std::string options;
  for (size_t i = 0; i < json["constants"].size(); ++i) {
    const nlohmann::json& constant = json["constants"][i];
    const std::string name = file("constant" + std::to_string(i));
    write(name, container.substr(payload + constant["payload_offset"].get<size_t>(),
                                 constant["size"].get<size_t>()));
    options += " --constant " + std::to_string(i) + "=" + name;
  }
  ASSERT_NE(options, "");
  EXPECT_EQ(shale("dump --what graph " + file("s.spv") + options).text,
            shale("dump --what graph " + file("s.vgf")).text);
  EXPECT_EQ(shale("run " + file("s.spv") + options + " --random 3 --check").exit, 0);
  EXPECT_EQ(shale("verify " + file("s.spv")).exit, 1) << "the constants are missing";
  const Outcome listed = shale("dump " + file("s.spv"));
  EXPECT_EQ(listed.exit, 0);
  EXPECT_NE(listed.text.find("#   constants: 0 i8[1,3,3,1]"), std::string::npos) << listed.text;
  const Outcome twice = shale("verify " + file("s.spv") + options + options);
  EXPECT_EQ(twice.exit, 1);
  EXPECT_NE(twice.text.find("--constant: error: constant 0 has two files"), std::string::npos)
      << twice.text;
}

TEST_F(Cli, ReportCountsTheSrpoParameters) {
  const Outcome outcome = shale("report " + kModels + "/srpo_x2");
  EXPECT_EQ(outcome.exit, 0);
  EXPECT_TRUE(outcome.text.find("8,434") != std::string::npos ||
              outcome.text.find("8434") != std::string::npos)
      << outcome.text;
}

TEST_F(Cli, ReportReproducesThePublishedBudget) {
  const nlohmann::json json = nlohmann::json::parse(
      shale("report " + kModels + "/nss_v0_1 --render 960x540 --passes-ms 1.4 --json").text);
  const nlohmann::json& v0_1 = json["files"][0];
  EXPECT_NEAR(v0_1["gop"].get<double>(), 13.09, 0.005);
  EXPECT_DOUBLE_EQ(v0_1["budget"]["available_gop"], 26.0) << "(4.0 - 1.4) ms x 10 TOP/s";
  EXPECT_NEAR(v0_1["budget"]["required_efficiency"].get<double>(), 0.50, 0.005);
}

/// The text between two marks.
std::string between(const std::string& text, const std::string& before, const std::string& after) {
  const size_t at = text.find(before), start = at + before.size();
  return at == std::string::npos ? "" : text.substr(start, text.find(after, start) - start);
}

TEST_F(Cli, ReportWritesAPageOfTheSameNumbersAndATable) {
  const std::string models =
      kModels + "/srpo_x2 " + kModels + "/nss_v1_low " + kModels + "/baselines/bilinear";
  const Outcome outcome = shale("report " + models + " --html " + file("r.html") + " --csv " +
                                file("r.csv") + " --json");
  ASSERT_EQ(outcome.exit, 0) << outcome.text;
  const nlohmann::json json = nlohmann::json::parse(outcome.text);
  const std::string page = read(file("r.html"));
  EXPECT_EQ(nlohmann::json::parse(between(page, "id=\"data\">", "</script>")), json);
  for (const char* outside : {"src=\"http", "href=\"http", "@import"})
    EXPECT_EQ(page.find(outside), std::string::npos) << "the page needs nothing from outside";
  const nlohmann::json& low = json["files"][1];
  EXPECT_EQ(low["modelled"]["dispatches"].size(), 14u);
  EXPECT_TRUE(low["frame"]["fits"]);
  EXPECT_DOUBLE_EQ(low["frame"]["total_ms"], low["frame"]["passes_ms"].get<double>() +
                                                 low["modelled"]["time_ms"].get<double>());
  EXPECT_GT(low["fits"]["largest_output"][0], 1920) << "a quarter of HIGH's work";
  EXPECT_LE(low["fits"]["least_ratio"], 2);
  double sum = 0;
  for (const auto& row : low["modelled"]["dispatches"]) sum += row["time_us"].get<double>();
  EXPECT_NEAR(1e-3 * sum, low["modelled"]["time_ms"].get<double>(), 1e-9);
  const std::string table = read(file("r.csv"));
  EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 1 + 3 + 14) << table;
}

TEST_F(Cli, ReportSaysWhatWouldHaveToChange) {
  const nlohmann::json json = nlohmann::json::parse(
      shale("report " + kModels + "/nss_v1_high --efficiency 0.3 --json").text);
  const nlohmann::json& frame = json["files"][0]["frame"];
  ASSERT_FALSE(frame["fits"]);
  const auto fits_with = [&](const std::string& options) {
    const nlohmann::json again = nlohmann::json::parse(
        shale("report " + kModels + "/nss_v1_high --efficiency 0.3 --json " + options).text);
    return again["files"][0]["frame"]["fits"].get<bool>();
  };
  const double tops = frame["needs"]["tops"], passes = frame["needs"]["frame_ms"];
  EXPECT_TRUE(fits_with("--tops " + std::to_string(tops * 1.0001)));
  EXPECT_FALSE(fits_with("--tops " + std::to_string(tops * 0.9999)));
  EXPECT_TRUE(fits_with("--frame-ms " + std::to_string(passes * 1.0001)));
  EXPECT_FALSE(fits_with("--frame-ms " + std::to_string(passes * 0.9999)));
  EXPECT_NE(shale("report " + kModels + "/srpo_x2 --device moon").text.find("moon"),
            std::string::npos);
}

TEST_F(Cli, ReportNamesTheFirstChangeBetweenTwoVersions) {
  ASSERT_EQ(shale("compile " + file("small.tir") + " -o " + file("a.shale")).exit, 0);
  ASSERT_EQ(
      shale("compile " + file("small.tir") + " --kernels conv2d_s8_f32exact -o " + file("b.shale"))
          .exit,
      0);
  const nlohmann::json packages = nlohmann::json::parse(
      shale("report " + file("a.shale") + " " + file("b.shale") + " --json").text);
  const nlohmann::json& change = packages["comparison"]["first_change"];
  EXPECT_EQ(change["what"], "kernel") << packages["comparison"];
  EXPECT_EQ(change["before"], "runs");
  EXPECT_EQ(change["after"], "conv2d_s8_f32exact");
  EXPECT_NE(packages["comparison"]["totals"]["predicted_us"]["change"], 0);
  const nlohmann::json same = nlohmann::json::parse(
      shale("report " + file("small.tir") + " " + file("small.tir") + " --json").text);
  EXPECT_TRUE(same["comparison"]["first_change"].is_null());
}

TEST_F(Cli, FitWritesConstantsThatBenchTakes) {
  const Outcome measured = shale("bench " + file("small.tir") + " --repeat 3 --json");
  ASSERT_EQ(measured.exit, 0);
  write(file("bench.json"), measured.text);
  ASSERT_EQ(shale("fit " + file("bench.json") + " -o " + file("constants.json")).exit, 0);
  const nlohmann::json constants = nlohmann::json::parse(read(file("constants.json")));
  EXPECT_EQ(constants["schema"], "shale-constants/1");
  EXPECT_GT(constants["roof_gops"], 0);
  const Outcome again = shale("bench " + file("small.tir") + " --repeat 3 --json --constants " +
                              file("constants.json"));
  ASSERT_EQ(again.exit, 0) << again.text;
  // One dispatch was fitted, so what was measured then is predicted now, at the roof of now.
  const nlohmann::json before = nlohmann::json::parse(measured.text)["models"][0],
                       after = nlohmann::json::parse(again.text)["models"][0];
  EXPECT_NEAR(after["total"]["predicted_ms"].get<double>() * after["roof_gop_per_s"].get<double>(),
              before["total"]["layers_ms"].get<double>() * before["roof_gop_per_s"].get<double>(),
              1e-6 * before["roof_gop_per_s"].get<double>());
  for (const auto& [text, message] :
       {std::pair<std::string, std::string>{"{}", "shale bench"},
        {R"({"models": [{"roof_gop_per_s": 1, "dispatches": [{"time_ms": 0}]}]})", "time_ms"},
        {R"({"models": [{"roof_gop_per_s": 1, "dispatches": [{"time_ms": 1}]}]})", "work"}}) {
    write(file("broken.json"), text);
    const Outcome refused = shale("fit " + file("broken.json"));
    EXPECT_EQ(refused.exit, 1) << text;
    EXPECT_NE(refused.text.find(message), std::string::npos) << refused.text;
  }
}

TEST_F(Cli, EvalKnowsWhatComesInAtTheBorderFromAMargin) {
  const std::string command =
      "eval " SHALE_SOURCE_DIR
      "/models/scenes/test/motion.json --generate 1 --render 96x54 --first 4 --frames 3 "
      "--no-time -m " +
      kModels + "/baselines/generation/repeat -m " + kModels +
      "/baselines/mob_fgsr_extrapolation --json";
  const auto pictures = [&](const std::string& more) {
    const Outcome made = shale(command + more);
    EXPECT_EQ(made.exit, 0) << made.text;
    std::vector<nlohmann::json> generated;
    const nlohmann::json report = nlohmann::json::parse(made.text);
    for (const auto& method : report["scenes"][0]["methods"])
      generated.push_back(method["means"]["generated"]);
    return generated;
  };
  const std::vector<nlohmann::json> plain = pictures(""), with = pictures(" --margin 6");
  ASSERT_EQ(plain.size(), with.size());
  // The picture is the same: who repeats it gains nothing, but for cameras in 32 bits.
  EXPECT_NEAR(plain[0]["psnr_db"], with[0]["psnr_db"].get<double>(), 0.02);
  EXPECT_GT(with[1]["pixels"]["border"]["psnr_db"].get<double>(),
            plain[1]["pixels"]["border"]["psnr_db"].get<double>() + 1);
  const std::string scene = "eval " SHALE_SOURCE_DIR
                            "/models/scenes/test/motion.json --margin 6 --frames 2 -m " +
                            kModels;
  EXPECT_NE(shale(scene + "/baselines/generation/repeat").text.find("give --generate or --at"),
            std::string::npos);
  EXPECT_NE(shale(scene + "/baselines/mob_fgsr_sr_extrapolation --generate 1")
                .text.find("do not upscale"),
            std::string::npos);
}

// lavapipe binds 128 MB at most, and MNSS's 32 channels of floats at this size have a little more.
TEST_F(Cli, TradeLeavesOutWhatTheDeviceCannotRun) {
  const Outcome made =
      shale("trade " SHALE_SOURCE_DIR "/models/scenes/test/thin.json -o " + file("left_out") +
            " -m " + kModels + "/mnss_x2," + kModels +
            "/baselines/nearest --precisions fp32 --output-size 1040x1024 --frames 2 --json");
  ASSERT_EQ(made.exit, 0) << made.text;
  const nlohmann::json json = nlohmann::json::parse(made.text);
  const bool binds_more = json["left_out"].empty();  // another driver
  ASSERT_EQ(json["scenes"][0]["methods"].size(), binds_more ? 2u : 1u);
  if (binds_more) GTEST_SKIP() << "the device runs it";
  EXPECT_EQ(json["left_out"][0]["name"], "mnss_x2 fp32");
  EXPECT_NE(json["left_out"][0]["why"].get<std::string>().find(
                "maxStorageBufferRange is 134217728, needs 136314880"),
            std::string::npos)
      << json["left_out"];
}

// The truth of a pattern of samples is taken from the frames of the other one.
TEST_F(Cli, TradeGivesAModelFramesOfItsPattern) {
  const std::string scene = SHALE_SOURCE_DIR "/models/scenes/test/thin.json";
  const std::string command = "trade " + scene + " -o " + file("patterns") + " -m " + kModels +
                              "/mnss_x2 --output-size 96x64 --frames 3";
  ASSERT_EQ(shale(command).exit, 0);
  ASSERT_EQ(shale("scene " + scene + " -o " + file("direct") +
                  " --pattern mnss --render 48x32 --output-size 96x64 --frames 3")
                .exit,
            0);
  std::map<std::string, std::string> wanted;
  for (const auto& entry : fs::recursive_directory_iterator(file("direct")))
    if (entry.is_regular_file())
      wanted[fs::relative(entry.path(), file("direct")).string()] = read(entry.path());
  ASSERT_GT(wanted.size(), 15u);
  size_t folders = 0, equal = 0;
  for (const auto& folder : fs::directory_iterator(file("patterns/frames"))) {
    ++folders;
    equal += std::all_of(wanted.begin(), wanted.end(), [&](const auto& one) {
      return read(folder.path() / one.first) == one.second;
    });
  }
  EXPECT_EQ(folders, 2u);
  EXPECT_EQ(equal, 1u);
  // What cannot be written is refused before the work.
  fs::create_directories(file("taken/trade.json"));
  const Outcome refused = shale("trade " + scene + " -o " + file("taken") + " -m " + kModels +
                                "/mnss_x2 --output-size 96x64 --frames 3");
  EXPECT_EQ(refused.exit, 1);
  EXPECT_NE(refused.text.find("trade.json"), std::string::npos) << refused.text;
  EXPECT_FALSE(fs::exists(file("taken/frames")));
}

TEST_F(Cli, TradeKnowsMeshesAndIncludedShadersByTheirContent) {
  write(file("tri.obj"), "v -1 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n");
  write(file("s.json"), R"({"schema": "shale-scene/1", "frames": 2, "sun": {"direction": [0, 1, 1]},
    "camera": {"fov_y": 50, "near": 0.1, "far": 50, "path": [{"frame": 0, "eye": [0, 1, 4], "target": [0, 0, 0]}]},
    "models": {"m": {"file": "tri.obj"}}, "objects": [{"shape": "mesh", "model": "m"}]})");
  const fs::copy_options all = fs::copy_options::recursive;
  for (const char* folder : {"models/baselines", "shaders/frame"})
    fs::create_directories(file(folder));
  fs::copy(kModels + "/baselines/tss", file("models/baselines/tss"), all);
  fs::copy(SHALE_SOURCE_DIR "/shaders/frame", file("shaders/frame"), all);
  const auto cells = [&] {
    const Outcome outcome = shale("trade " + file("s.json") + " -o " + file("trade") + " -m " +
                                  file("models/baselines/tss") + " --output-size 48x32 --frames 2");
    EXPECT_EQ(outcome.exit, 0) << outcome.text;
    const fs::directory_iterator files(file("trade/cells"));
    return std::count_if(begin(files), end(files), [](const fs::directory_entry& entry) {
      return entry.path().extension() == ".json";
    });
  };
  const auto first = cells();  // what the scene needs, and the method
  EXPECT_EQ(first, 2);
  EXPECT_EQ(cells(), first);
  write(file("tri.obj"), "v -1 0 0\nv 1 0 0\nv 0 0.2 0\nf 1 2 3\n");
  EXPECT_EQ(cells(), first + 2);
  // Included by a shader of another folder.
  const std::string shader = file("shaders/frame/nss/catmull_rom.glsl");
  write(shader, read(shader) + "\n");
  EXPECT_EQ(cells(), first + 3);
}

TEST_F(Cli, TradeMeasuresCellsOnceAndNamesWhatIsEnough) {
  const std::string scene = SHALE_SOURCE_DIR "/models/scenes/test/thin.json";
  const std::string command =
      "trade " + scene + " -o " + file("trade") + " -m " + kModels + "/srpo_x2," + kModels +
      "/baselines/bilinear," + kModels +
      "/baselines/nearest --output-size 96x64 --model-at 1920x1080 --frames 2";
  const Outcome first = shale(command + " --json");
  ASSERT_EQ(first.exit, 0) << first.text;
  const nlohmann::json json = nlohmann::json::parse(first.text);
  const nlohmann::json& rows = json["scenes"][0]["methods"];
  ASSERT_EQ(rows.size(), 3u);
  for (const auto& row : rows) {
    EXPECT_GT(row["psnr_db"], 5) << row;
    EXPECT_GT(row["modelled"]["total_ms"], 0) << row;
    EXPECT_EQ(row["baseline"], row["precision"] == "") << row;
    EXPECT_EQ(row["modelled"]["gop"] == 0.0, row["baseline"]) << row;
  }
  // The choice agrees with the rows.
  const nlohmann::json& choice = json["scenes"][0]["choice"];
  double best = 0;
  for (const auto& row : rows)
    if (row["modelled"]["total_ms"] <= 4) best = std::max(best, row["psnr_db"].get<double>());
  EXPECT_DOUBLE_EQ(choice["best_psnr_db"], best);
  ASSERT_EQ(choice["within"].size(), 2u);
  for (const auto& within : choice["within"]) {
    EXPECT_GE(within["psnr_db"].get<double>(), best - within["slack_db"].get<double>());
    EXPECT_LE(within["ms"], choice["best_ms"]);
    const auto chosen = std::find_if(rows.begin(), rows.end(), [&](const nlohmann::json& row) {
      return row["name"] == within["name"];
    });
    ASSERT_NE(chosen, rows.end()) << within;
    EXPECT_NE(within["needs_network"], (*chosen)["baseline"]) << within;
    // The scene has thin features, and objects move: reasons for a network, none against it.
    EXPECT_EQ(within["why"].empty(), (*chosen)["baseline"].get<bool>()) << within;
  }
  EXPECT_EQ(json["scenes"][0]["needs"]["thin_features"], true);
  EXPECT_EQ(nlohmann::json::parse(read(file("trade/trade.json"))), json);
  EXPECT_EQ(
      nlohmann::json::parse(between(read(file("trade/trade.html")), "id=\"data\">", "</script>")),
      json);
  // Again: nothing is measured, so that the measured times are those of before.
  EXPECT_EQ(nlohmann::json::parse(shale(command + " --json").text), json);
  // A cell that was cut short is measured again.
  for (const auto& cell : fs::directory_iterator(file("trade/cells"))) write(cell.path(), "{");
  const nlohmann::json again = nlohmann::json::parse(shale(command + " --json").text);
  EXPECT_EQ(again["scenes"][0]["methods"][0]["psnr_db"], rows[0]["psnr_db"]);
  // So is one that holds what no cell does.
  for (const auto& cell : fs::directory_iterator(file("trade/cells"))) {
    nlohmann::json held = nlohmann::json::parse(read(cell.path()), nullptr, false);
    if (!held.is_object() || !held.contains("result")) continue;
    held["result"]["name"] = 5;
    write(cell.path(), held.dump());
  }
  const nlohmann::json mended = nlohmann::json::parse(shale(command + " --json").text);
  EXPECT_EQ(mended["scenes"][0]["methods"][0]["name"], rows[0]["name"]);
  for (const char* wrong :
       {" --precisions int9", " --scales 0.5", " --output-size 96", " --scales 7"})
    EXPECT_NE(shale(command + wrong).exit, 0) << wrong;
  EXPECT_NE(shale("trade " + scene + " -o " + file("t") + " -m " + kModels + "/scenes").exit, 0);
}

TEST_F(Cli, CompareNamesTheLayerWithAWrongMultiplier) {
  const std::string model = kModels + "/srpo_x2";
  ASSERT_EQ(shale("convert " + model + " -o " + file("a.tir")).exit, 0);
  std::string text = read(file("a.tir"));
  const std::string before = "%conv2/rescale/multiplier : i32[16] = [";
  const size_t at = text.find(before);
  ASSERT_NE(at, std::string::npos);
  const size_t start = at + before.size(), end = text.find(',', start);
  const long long multiplier = std::stoll(text.substr(start, end - start));
  // Half as much again, or a third less where that leaves the range.
  const long long wrong = multiplier < 1'400'000'000 ? multiplier * 3 / 2 : multiplier * 2 / 3;
  text.replace(start, end - start, std::to_string(wrong));
  write(file("b.tir"), text);

  const Outcome same = shale("compare " + file("a.tir") + " " + file("a.tir"));
  EXPECT_EQ(same.exit, 0) << same.text;
  const Outcome int8 = shale("compare " + file("a.tir") + " " + file("b.tir"));
  EXPECT_EQ(int8.exit, 1) << int8.text;
  EXPECT_NE(int8.text.find("the first layer that departs: conv2/rescale, channel 0"),
            std::string::npos)
      << int8.text;

  // Against the float network: real numbers, by the scales that the model's folder records.
  fs::create_directories(file("folder"));
  for (const char* name : {"model.fp32.tosa", "quantization.json", "model.tosa"})
    fs::copy_file(model + "/" + name, file("folder") + "/" + name);
  const std::string command =
      "compare " + file("folder") + " " + file("folder") + " --precision-a fp32";
  const Outcome right = shale(command);
  EXPECT_EQ(right.exit, 0) << right.text;
  fs::remove(file("folder/model.tosa"));
  ASSERT_EQ(shale("convert " + file("b.tir") + " -o " + file("folder/model.tosa")).exit, 0);
  const Outcome departed = shale(command);
  EXPECT_EQ(departed.exit, 1) << departed.text;
  EXPECT_NE(departed.text.find("the first layer that departs: relu2, channel 0"), std::string::npos)
      << departed.text;
  EXPECT_TRUE(nlohmann::json::accept(shale(command + " --json").text));
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
  EXPECT_EQ(shale("tune " + file("small.tir") + " -o " + file("x.json") + " --without nope").exit,
            1);
  nlohmann::json choices = nlohmann::json::parse(read(file("c.json")));
  EXPECT_EQ(choices["schema"], "shale-choices/1");
  ASSERT_TRUE(choices["choices"].contains("y")) << choices;
  // Those of one device serve the other targets of a package as far as these can follow.
  const Outcome all = shale("compile " + file("small.tir") + " -o " + file("all.shale") +
                            " --choices " + file("c.json"));
  EXPECT_EQ(all.exit, 0) << all.text;
  EXPECT_NE(all.text.find("target generic-gpu: 1 of the choices are left to selection"),
            std::string::npos)
      << all.text;
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
      {"nonsense", "c.json: error: is not valid JSON at byte 2"}};
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
