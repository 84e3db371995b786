// .vgf files of any content: refused with an error, or data that survives write and read. Their
// graphs are refused or read.
#include <cstdlib>

#include "compiler/frontend/vgf/convert.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  shale::VgfLayout layout;
  shale::Result<shale::Vgf> vgf = shale::read_vgf({data, size}, &layout);
  if (!vgf) return 0;
  (void)shale::dump_vgf(*vgf, &layout);
  const auto written = shale::write_vgf(*vgf);
  if (!written) std::abort();
  const shale::Result<shale::Vgf> again = shale::read_vgf(*written);
  vgf->version = {0, 4, 3};
  if (!again || !(*again == *vgf)) std::abort();
  for (const shale::VgfSegment& segment : vgf->segments)
    (void)shale::import_vgf({data, size},
                            {.entry_point = segment.name, .input_shapes = {}, .constants = {}})
        .has_value();
  return 0;
}
