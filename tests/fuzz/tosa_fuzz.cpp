// .tosa files of any content: refused with an error, or a graph that survives print, parse, write
// and read.
#include <cstdlib>

#include "ir/binary/tosa.h"
#include "ir/text/text.h"
#include "ir/verify/verify.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const shale::Result<shale::Graph> graph = shale::read_tosa({data, size});
  if (!graph || !shale::verify(*graph)) return 0;
  const shale::Result<shale::Graph> parsed = shale::parse_text(shale::print_text(*graph));
  if (!parsed || !(*parsed == *graph)) std::abort();
  const shale::Result<shale::Graph> reread = shale::read_tosa(shale::write_tosa(*graph));
  if (!reread || !(*reread == *graph)) std::abort();
  return 0;
}
