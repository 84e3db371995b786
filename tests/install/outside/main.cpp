// An outside program: reads a package with the installed library and prepares its sandwich on the
// first device.
#include <cstdio>

#include "ir/base/file.h"
#include "ir/package/package.h"
#include "runtime/frame/frame_loop.h"
#include "runtime/vk/device.h"
#include "runtime/vk/instance.h"

namespace {

shale::Result<uint64_t> prepare(const char* path) {
  SHALE_TRY(const std::vector<uint8_t> bytes, shale::read_file(path));
  SHALE_TRY(const shale::Package package, shale::read_package(bytes));
  SHALE_TRY(const shale::vk::Instance instance, shale::vk::Instance::create());
  SHALE_TRY(const VkPhysicalDevice physical, instance.find_device(""));
  SHALE_TRY(const shale::vk::Device device,
            shale::vk::Device::create(physical, instance.functions()));
  SHALE_TRY(const shale::FrameLoop loop, shale::FrameLoop::create(device.context(), package));
  return loop.variant().segments.size();
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  const shale::Result<uint64_t> segments = prepare(argv[1]);
  if (!segments) {
    std::fprintf(stderr, "error: %s\n", segments.error().text().c_str());
    return 1;
  }
  std::printf("%llu segments\n", static_cast<unsigned long long>(*segments));
  return *segments == 4 ? 0 : 1;
}
