#include "tools/shale/outputs.h"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "ir/base/file.h"
#include "tests/support/folder_test.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

class OutputsTest : public FolderTest {
 protected:
  std::string read(const std::string& name) const {
    const Result<std::string> text = read_text(path(name));
    return text ? *text : text.error().text();
  }

  /// A grey picture of this size.
  void picture(const std::string& name, int grey) const {
    std::string text = "P6 8 8 255\n";  // what stb reads, whatever its suffix
    text.append(8 * 8 * 3, static_cast<char>(grey));
    write(name, text);
  }
};

const std::string kSmall = SHALE_SOURCE_DIR "/tests/tools/small.tir";
const std::string kBilinear = SHALE_SOURCE_DIR "/models/baselines/bilinear";

TEST_F(OutputsTest, AFileHasOneOwner) {
  Outputs outputs;
  EXPECT_TRUE(outputs.claim("a", path("x")));
  EXPECT_TRUE(outputs.claim("b", path("y")));
  EXPECT_TRUE(outputs.claim("none", ""));
  const Result<void> twice = outputs.claim("c", path("./x"));
  ASSERT_FALSE(twice);
  EXPECT_EQ(twice.error().message, "is the file of a already, so c cannot go there");
  EXPECT_TRUE(outputs.claim("null", "/dev/null"));
  EXPECT_TRUE(outputs.claim("null again", "/dev/null"));
  outputs.keep({path("input")});
  EXPECT_FALSE(outputs.claim("d", path("input")));
  // Of a folder what it is made of, not what an earlier command left in it.
  fs::create_directory(path("model"));
  for (const char* name : {"model/frame.json", "model/page.html", "model/trade.json"})
    ASSERT_TRUE(write_text(path(name), "x"));
  outputs.keep({path("model")});
  EXPECT_FALSE(outputs.claim("e", path("model/frame.json")));
  EXPECT_TRUE(outputs.claim("f", path("model/page.html")));
  EXPECT_TRUE(outputs.claim("g", path("model/trade.json")));
}

TEST_F(OutputsTest, StandardOutputHasOneResult) {
  write("m.tir", read_text(kSmall).value());
  picture("a.png", 10);
  const auto code = [&](const std::string& arguments) {
    return shell(
        fmt::format("cd {} && {} {} > out 2> said", folder_.string(), SHALE_PROGRAM, arguments));
  };
  const std::string kRun = "run m.tir --random 1 --profile ";
  for (const std::string& command :
       {std::string("convert m.tir --to tir --json -o /dev/stdout"),
        std::string("compile m.tir --json -o ./out"),
        std::string("report m.tir --json --html /dev/stdout"),
        std::string("report m.tir --csv /dev/stdout --html /dev/stdout"),
        kRun + "--json --profile-to /dev/stdout", std::string("tune m.tir --json -o /dev/stdout"),
        "play " + kBilinear + " -i a.png --json -o /dev/stdout",
        std::string("diff a.png a.png --json --map /dev/stdout")}) {
    EXPECT_EQ(code(command), 1) << command;
    EXPECT_EQ(read("out"), "") << command;
    EXPECT_NE(read("said").find(" already, so "), std::string::npos) << read("said");
  }
  // Text makes way for a result.
  EXPECT_EQ(code("report m.tir --csv /dev/stdout"), 0) << read("said");
  EXPECT_TRUE(read("out").starts_with("file,name,")) << read("out");
  EXPECT_EQ(code("diff a.png a.png --map /dev/stdout"), 0) << read("said");
  EXPECT_TRUE(read("out").starts_with("\x89PNG") && read("out").ends_with("\xae"
                                                                          "B`\x82"));
  for (const std::string& command :
       {kRun + "--profile-to /dev/stdout", std::string("tune m.tir -o /dev/stdout"),
        std::string("compile m.tir -o m.shale --json --dump-after all"),
        std::string("dump m.tir --json -o /dev/stdout")}) {
    EXPECT_EQ(code(command), 0) << read("said");
    EXPECT_TRUE(nlohmann::json::accept(read("out"))) << command << read("out");
  }
  EXPECT_EQ(shell(fmt::format("cd {} && {} convert m.tir --to tir --json -o /dev/null > /dev/null",
                              folder_.string(), SHALE_PROGRAM)),
            0);
}

TEST_F(OutputsTest, PicturesArePng) {
  Outputs outputs;
  EXPECT_TRUE(outputs.claim_picture("a", path("a.png")));
  EXPECT_TRUE(outputs.claim_picture("a", path("b.PNG")));
  EXPECT_TRUE(outputs.claim_picture("a", path("c")));
  for (const char* other : {"a.jpg", "a.exr", "a.npy", "a.png.bmp"})
    EXPECT_FALSE(outputs.claim_picture("a", path(other))) << other;
}

TEST_F(OutputsTest, NamesDiffer) {
  FileNames names;
  EXPECT_EQ(names.claim("a/b"), "a_b");
  EXPECT_EQ(names.claim("a_b"), "a_b-2");
  EXPECT_EQ(names.claim("a\\b"), "a_b-3");
  EXPECT_EQ(names.claim("c"), "c");
}

TEST_F(OutputsTest, ListsTellEqualNamesApart) {
  using Names = std::vector<std::string>;
  EXPECT_EQ(distinct_names({"x", "y"}, {"a/x.json", "b/y.json"}), (Names{"x", "y"}));
  EXPECT_EQ(distinct_names({"0000", "0000", "net"}, {"one/0000.json", "a/two/0000.json", "net/"}),
            (Names{"one/0000", "two/0000", "net"}));
  EXPECT_EQ(distinct_names({"x", "x", "x"}, {"/a/c/x", "/b/c/x", "/x/"}),
            (Names{"a/c/x", "b/c/x", "x"}));
  EXPECT_EQ(distinct_names({"x", "x", "x"}, {"a/x", "./a//x", "b/x"}),
            (Names{"a/x", "a/x-2", "b/x"}));
}

TEST_F(OutputsTest, EvalTellsEqualNamesApart) {
  const std::string render = " --render 32x18 --frames 1 ";
  for (const char* name : {"one", "two"}) {
    ASSERT_EQ(shale(fmt::format("scene {}/models/scenes/test/thin.json{}-o {}", SHALE_SOURCE_DIR,
                                render, name)),
              0)
        << read("said");
    fs::create_directories(folder_ / "pictures" / name);
    fs::copy(folder_ / name / "ground_truth", folder_ / "pictures" / name,
             fs::copy_options::recursive);
    fs::create_directories(folder_ / "methods" / name);
    ASSERT_EQ(shale("compile " + kBilinear + " --target device --render 32x18 -o methods/" + name +
                    "/net.shale"),
              0)
        << read("said");
  }
  ASSERT_EQ(shale("eval one two -m methods/one/net.shale -m methods/two/net.shale --pictures "
                  "other=pictures "
                  "--no-time --json --json-file report.json 2> /dev/null"),
            0)
      << read("said");
  const nlohmann::json json = nlohmann::json::parse(read("report.json"));
  EXPECT_EQ(json["scenes"][0]["name"], "one/0000");
  EXPECT_EQ(json["scenes"][1]["name"], "two/0000");
  EXPECT_NE(read("said").find("\"one/net\""), std::string::npos) << read("said");
  EXPECT_NE(read("said").find("\"two/net\""), std::string::npos) << read("said");
  EXPECT_EQ(shale("eval one -m methods/one/net.shale --pictures net=pictures/one"), 1);
  EXPECT_NE(read("said").find("is the name of another method"), std::string::npos) << read("said");
}

TEST_F(OutputsTest, CommandsWriteThroughAndKeepLinks) {
  write("m.tir", read_text(kSmall).value());
  write("real.tir", "old");
  fs::create_symlink("real.tir", folder_ / "link.tir");
  EXPECT_EQ(shale("convert m.tir -o link.tir"), 0) << read("said");
  EXPECT_TRUE(fs::is_symlink(folder_ / "link.tir"));
  EXPECT_TRUE(read("real.tir").starts_with("graph "));
  ASSERT_EQ(mkfifo(path("fifo").c_str(), 0600), 0);
  EXPECT_EQ(shale("compile m.tir -o direct.shale"), 0);
  EXPECT_EQ(
      std::system(fmt::format("cd {} && (timeout 20 cat fifo > got & {} compile m.tir -o fifo > "
                              "said 2>&1; wait)",
                              folder_.string(), SHALE_PROGRAM)
                      .c_str()),
      0);
  EXPECT_EQ(read("got"), read("direct.shale"));
  // Standard output has the package alone, also behind what was there before.
  EXPECT_EQ(
      std::system(fmt::format("cd {} && echo first > out && {} compile m.tir -o /dev/stdout >> out "
                              "2> said",
                              folder_.string(), SHALE_PROGRAM)
                      .c_str()),
      0);
  EXPECT_EQ(read("out"), "first\n" + read("direct.shale"));
  EXPECT_NE(read("said").find("wrote /dev/stdout"), std::string::npos);
  EXPECT_EQ(shale("compile m.tir -o /dev/full"), 1);
  EXPECT_NE(read("said").find("/dev/full: error: cannot write: No space left on device"),
            std::string::npos);
}

TEST_F(OutputsTest, WhatCannotBeWrittenIsRefusedFirst) {
  // The model would be refused too: the output comes before it.
  EXPECT_EQ(shale("compile absent.tir -o missing/x.shale"), 1);
  EXPECT_NE(read("said").find("missing/x.shale: error: cannot create"), std::string::npos);
  EXPECT_EQ(shale("eval absent.json -m absent --page x --json-file ./x"), 1);
  EXPECT_NE(read("said").find("x: error: is the file of --json-file already"), std::string::npos)
      << read("said");
}

TEST_F(OutputsTest, OneThatCannotBeWrittenKeepsNoOtherBack) {
  write("m.tir", read_text(kSmall).value());
  picture("a.png", 10);
  const std::string kThin = SHALE_SOURCE_DIR "/models/scenes/test/thin.json";
  const struct {
    std::string command, text, file;
  } kCases[]{
      {"report m.tir --csv /dev/full --html page.html", "m.tir", "page.html"},
      {"run m.tir --random 1 --profile-to /dev/full -o out", "ran on", "out/y.npy"},
      {"tune m.tir -o /dev/full", "fastest", ""},
      {"diff a.png a.png --map /dev/full", "PSNR dB", ""},
      {"scene " + kThin + " --needs /dev/full --frames 1 --render 32x18", "needs", ""},
      {"eval " + kThin + " -m " + kBilinear +
           " --frames 1 --render 32x18 --json-file /dev/full --page eval.html",
       "PSNR dB", "eval.html"},
      {"stress " + kBilinear + " --only cut --recover 1 --json-file /dev/full --page stress.html",
       "verdicts", "stress.html"},
      {"play " + kBilinear + " -i a.png -o b.png --animation /dev/full", "a.png -> b.png",
       "b.png"}};
  for (const auto& each : kCases) {
    EXPECT_EQ(shale(each.command), 1) << each.command;
    EXPECT_NE(read("said").find("/dev/full: error: cannot write: No space left on device"),
              std::string::npos)
        << read("said");
    EXPECT_NE(read("said").find(each.text), std::string::npos) << each.command << read("said");
    EXPECT_TRUE(fs::exists(path(each.file))) << each.command;
  }
}

TEST_F(OutputsTest, ACacheThatCannotBeWrittenIsAWarning) {
  for (const std::string& cache : {std::string("missing/cache"), std::string("/dev/full"),
                                   std::string("."), std::string("own.txt")}) {
    write("own.txt", "not a cache");
    fs::remove_all(folder_ / "out");
    EXPECT_EQ(shale(fmt::format("run {} --random 1 -o out --cache {}", kSmall, cache)), 0)
        << read("said");
    EXPECT_TRUE(fs::exists(folder_ / "out/y.npy")) << cache;
    EXPECT_NE(read("said").find(cache + ": warning: the cache is "), std::string::npos)
        << read("said");
    EXPECT_EQ(read("own.txt"), "not a cache");
  }
  EXPECT_EQ(shale(fmt::format("run {} --random 1 --cache good", kSmall)), 0);
  EXPECT_EQ(read("said").find("warning"), std::string::npos) << read("said");
  EXPECT_TRUE(read("good").starts_with("SHALEPC1"));
}

TEST_F(OutputsTest, PicturesOfOneStemAndInputsAreNotOverwritten) {
  fs::create_directories(folder_ / "in");
  picture("in/a.png", 10);
  picture("in/a.bmp", 200);
  EXPECT_EQ(shale("play " + kBilinear + " -i in -o out"), 1);
  EXPECT_NE(
      read("said").find("out/a.png: error: is the file of in/a.bmp already, so in/a.png cannot go"),
      std::string::npos)
      << read("said");
  fs::remove(folder_ / "in/a.bmp");
  EXPECT_EQ(shale("play " + kBilinear + " -i in -o in"), 1);
  EXPECT_NE(read("said").find("in/a.png: error: is the file of the input already"),
            std::string::npos)
      << read("said");
  EXPECT_EQ(shale("play " + kBilinear + " -i in/a.png -o out.jpg"), 1);
  EXPECT_NE(read("said").find("expected the suffix .png"), std::string::npos) << read("said");
  EXPECT_EQ(shale("play " + kBilinear + " -i in/a.png -o out.png --compare ./out.png"), 1);
  EXPECT_EQ(shale("play " + kBilinear + " -i in/a.png -o out.png"), 0) << read("said");
  EXPECT_EQ(shale("diff in out --map in"), 1) << read("said");
}

TEST_F(OutputsTest, NamesOfValuesBreakNothing) {
  write(
      "m.tir",
      "graph main {\n  input %x : i8[4]\n"
      "  %\"../say \\\"hi\\\" \\\\ <b>'#line\" = bitwise_not %x : i8[4]\n"
      "  %\"_._say \\\"hi\\\" \\\\ <b>'#line\" = bitwise_not %\"../say \\\"hi\\\" \\\\ <b>'#line\" "
      ": "
      "i8[4]\n"
      "  return %\"../say \\\"hi\\\" \\\\ <b>'#line\", %\"_._say \\\"hi\\\" \\\\ <b>'#line\"\n}\n");
  EXPECT_EQ(shale("run m.tir --random 1 --check -o out --json"), 0) << read("said");
  const nlohmann::json json = nlohmann::json::parse(read("said"), nullptr, false);
  ASSERT_TRUE(json.is_object()) << read("said");
  EXPECT_EQ(json["outputs"].size(), 2u);
  std::set<std::string> files;
  for (const auto& [name, file] : json["outputs"].items()) {
    EXPECT_TRUE(file.get<std::string>().starts_with("out/")) << file;
    files.insert(file.get<std::string>());
    EXPECT_TRUE(fs::exists(folder_ / file.get<std::string>())) << file;
  }
  EXPECT_EQ(files.size(), 2u);
  for (const char* command :
       {"dump m.tir", "dump m.tir --json", "report m.tir --html page.html",
        "convert m.tir -o m.vgf", "dump m.vgf", "run m.vgf --random 1 --check",
        "compile m.tir -o m.shale", "dump m.shale", "dump m.shale --json"})
    EXPECT_EQ(shale(command), 0) << command << ": " << read("said");
  // A line break would end a line of every listing, so it is refused, at once.
  write("break.tir",
        "graph main {\n  input %x : i8[4]\n  %\"a\\x0ab\" = bitwise_not %x : i8[4]\n"
        "  return %\"a\\x0ab\"\n}\n");
  for (const char* command : {"verify break.tir", "run break.tir --random 1"}) {
    EXPECT_EQ(shale(command), 1) << command;
    EXPECT_NE(read("said").find("break.tir: error: value %1 \"a\\nb\": has a name with control"),
              std::string::npos)
        << read("said");
  }
}

}  // namespace
}  // namespace shale
