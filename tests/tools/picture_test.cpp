#include "tools/shale/picture.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "ir/base/file.h"

namespace shale {
namespace {

Picture pattern(uint32_t width, uint32_t height) {
  Picture picture = Picture::filled(width, height, 0);
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x)
      for (uint32_t c = 0; c < 3; ++c)
        picture.at(x, y)[c] = static_cast<uint8_t>(37 * x + 91 * y + 17 * c);
  return picture;
}

TEST(Picture, PngRoundTripsExactly) {
  const std::string path =
      (std::filesystem::temp_directory_path() / "shale_picture_test.png").string();
  const Picture picture = pattern(13, 7);
  ASSERT_TRUE(save_png(path, picture));
  const Result<Picture> read = load_picture(path);
  std::filesystem::remove(path);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->width, 13u);
  EXPECT_EQ(read->rgba, picture.rgba);
}

TEST(Picture, FilesThatAreNoPictureAreNamed) {
  const Result<Picture> read = load_picture(SHALE_SOURCE_DIR "/CMakeLists.txt");
  ASSERT_FALSE(read);
  EXPECT_NE(read.error().text().find("CMakeLists.txt"), std::string::npos);
}

TEST(Picture, NearestRepeatsPixelsAndLanczosKeepsConstants) {
  const Picture picture = pattern(5, 4);
  const Picture nearest = upscale_nearest(picture, 10, 8);
  for (uint32_t y = 0; y < 8; ++y)
    for (uint32_t x = 0; x < 10; ++x) EXPECT_EQ(nearest.at(x, y)[1], picture.at(x / 2, y / 2)[1]);
  const Picture flat = Picture::filled(6, 6, 77);
  EXPECT_EQ(upscale_lanczos(flat, 17, 13).rgba, Picture::filled(17, 13, 77).rgba);
  EXPECT_EQ(upscale_lanczos(picture, 5, 4).rgba, picture.rgba) << "no change of size is no change";
}

TEST(Picture, PsnrFollowsItsFormula) {
  const Picture a = Picture::filled(8, 8, 100);
  EXPECT_TRUE(std::isinf(psnr_db(a, a)));
  EXPECT_NEAR(psnr_db(a, Picture::filled(8, 8, 110)), 10 * std::log10(255.0 * 255.0 / 100.0), 1e-9);
}

TEST(Picture, PanelsHoldTheirPictures) {
  const Picture panels =
      side_by_side({{"a", Picture::filled(20, 10, 200)}, {"b", Picture::filled(20, 10, 10)}}, 2);
  EXPECT_EQ(panels.at(8 + 10, 28 + 5)[0], 200);
  EXPECT_EQ(panels.at(8 + 28 + 10, 28 + 5)[0], 10);
}

}  // namespace
}  // namespace shale
