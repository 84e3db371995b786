// .tir text of any content: refused with an error, or a graph whose text is stable.
#include <cstdlib>
#include <string_view>

#include "ir/text/text.h"
#include "ir/verify/verify.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const shale::Result<shale::Graph> graph =
      shale::parse_text({reinterpret_cast<const char*>(data), size});
  if (!graph) return 0;
  (void)shale::verify(*graph).has_value();
  const shale::Result<shale::Graph> again = shale::parse_text(shale::print_text(*graph));
  if (!again || shale::print_text(*again) != shale::print_text(*graph)) std::abort();
  return 0;
}
