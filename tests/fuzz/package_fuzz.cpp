// .shale files of any content: refused with an error, or a package that survives write and read.
#include <cstdlib>

#include "ir/package/package.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const shale::Result<shale::Package> package = shale::read_package({data, size});
  if (!package) return 0;
  (void)shale::dump_package(*package);
  const shale::Result<shale::Package> again = shale::read_package(shale::write_package(*package));
  if (!again) std::abort();
  return 0;
}
