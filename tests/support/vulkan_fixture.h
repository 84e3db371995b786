// tests/support/vulkan_fixture.h -- tests on a device; each demands that validation stays silent.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "runtime/vk/commands.h"
#include "runtime/vk/device.h"
#include "runtime/vk/instance.h"
#include "runtime/vk/memory.h"

namespace shale {

/// The value, or a test failure with the error's text and the end of the program.
template <typename T>
T must(Result<T> result) {
  if (!result) {
    ADD_FAILURE() << result.error().text();
    std::abort();
  }
  return *std::move(result);
}
inline void must(Result<void> result) { EXPECT_TRUE(result) << result.error().text(); }

/// The error's text, or "no error".
template <typename T>
std::string error_text(const Result<T>& result) {
  return result ? "no error" : result.error().text();
}

/// A device per test suite: the first, or the one whose name contains the environment variable
/// SHALE_DEVICE. Tests are skipped without a device, and not validated without the validation
/// layer. After each test the core and synchronization validation must not have said anything.
class VulkanTest : public testing::Test {
 protected:
  static void SetUpTestSuite();
  static void TearDownTestSuite();
  void SetUp() override;
  void TearDown() override;

  static const vk::Context& context() { return gpu_->device.context(); }
  /// What validation said since the last call.
  static std::vector<std::string> validation_messages();
  static bool validated() { return gpu_->validated; }

  /// The same device, as if the host could write none of its own memory. Only where that can be
  /// said of a single type of memory; skip the test otherwise.
  static std::optional<vk::Context> discrete_context();

  /// Submits and waits; what was written is visible to mapped buffers afterwards.
  static void run(const std::function<void(VkCommandBuffer)>& record);

  /// A mapped buffer for tensors that holds `bytes`.
  static vk::Buffer buffer_of(std::span<const uint8_t> bytes);
  static vk::Buffer buffer_of(const std::vector<int8_t>& values);
  static std::vector<int8_t> int8_values(const vk::Buffer& buffer, size_t count);

  /// An image in VK_IMAGE_LAYOUT_GENERAL that holds `texels`, or is undefined if those are empty.
  static vk::Image image_of(ImageFormat format, VkExtent2D extent, std::span<const uint8_t> texels);
  static std::vector<uint8_t> texels_of(const vk::Image& image, ImageFormat format);

 private:
  struct Gpu {
    vk::Instance instance;
    vk::Device device;
    bool validated;
  };
  static std::unique_ptr<Gpu> gpu_;
};

/// `count` values from a fixed seed.
std::vector<int8_t> random_int8(size_t count, uint64_t seed);
std::vector<uint8_t> random_bytes(size_t count, uint64_t seed);

}  // namespace shale
