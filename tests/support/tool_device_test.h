// tests/support/tool_device_test.h -- tests with one device of the tools, under validation where the layer is installed.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "tools/shale/device_run.h"

namespace shale {

/// Base is testing::Test or testing::TestWithParam. A device for each suite; tests are skipped without one, and after each the
/// validation must not have said anything.
template <typename Base>
class ToolDeviceTest : public Base {
 protected:
  static void SetUpTestSuite() {
    Result<ToolDevice> device = ToolDevice::open({.name = "", .cache = "", .validation = true});
    if (!device) device = ToolDevice::open({});
    if (device) device_ = std::make_unique<ToolDevice>(*std::move(device));
  }
  static void TearDownTestSuite() { device_.reset(); }
  void SetUp() override {
    if (!device_) GTEST_SKIP() << "no Vulkan device";
  }
  void TearDown() override {
    if (!device_) return;
    EXPECT_EQ(device_->take_validation_messages(), std::vector<std::string>{});
  }

  inline static std::unique_ptr<ToolDevice> device_;
};

}  // namespace shale
