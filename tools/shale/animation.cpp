#include "tools/shale/animation.h"

#include <zlib.h>

#include <cstring>

#include "ir/base/file.h"

namespace shale {
namespace {

constexpr size_t kSignatureBytes = 8;
constexpr size_t kChunkOverhead = 12;  // length, type, checksum

void put_32(std::vector<uint8_t>& to, uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) to.push_back(static_cast<uint8_t>(value >> shift));
}
void put_16(std::vector<uint8_t>& to, uint16_t value) {
  to.push_back(static_cast<uint8_t>(value >> 8));
  to.push_back(static_cast<uint8_t>(value));
}

uint32_t get_32(const uint8_t* from) {
  return uint32_t{from[0]} << 24 | uint32_t{from[1]} << 16 | uint32_t{from[2]} << 8 | from[3];
}

void put_chunk(std::vector<uint8_t>& to, const char* type, std::span<const uint8_t> data) {
  put_32(to, static_cast<uint32_t>(data.size()));
  const size_t start = to.size();
  to.insert(to.end(), type, type + 4);
  to.insert(to.end(), data.begin(), data.end());
  put_32(to,
         static_cast<uint32_t>(crc32(0, to.data() + start, static_cast<uInt>(to.size() - start))));
}

/// Calls `take` with type and data of each chunk of a PNG that our own encoder made.
template <typename Take>
void each_chunk(const std::vector<uint8_t>& png, const Take& take) {
  for (size_t at = kSignatureBytes; at + kChunkOverhead <= png.size();) {
    const size_t length = get_32(&png[at]);
    SHALE_CHECK(at + kChunkOverhead + length <= png.size());
    take(&png[at + 4], std::span(png).subspan(at + 8, length));
    at += kChunkOverhead + length;
  }
}

}  // namespace

Result<void> save_animation(const std::string& path, std::span<const PngPicture> frames,
                            uint16_t frames_per_second) {
  if (frames.empty()) return bad_input(path, "there is no frame to animate");
  const std::vector<uint8_t>& first = frames[0].bytes;
  std::vector<uint8_t> file(first.begin(), first.begin() + kSignatureBytes);
  uint32_t sequence = 0;
  for (const PngPicture& frame : frames) {
    if (frame.width != frames[0].width || frame.height != frames[0].height)
      return bad_input(path, "frames of {}x{} and {}x{} make no animation", frame.width,
                       frame.height, frames[0].width, frames[0].height);
    const bool is_first = &frame == frames.data();
    bool has_control = false;
    each_chunk(frame.bytes, [&](const uint8_t* type, std::span<const uint8_t> data) {
      const auto is = [&](const char* name) { return std::memcmp(type, name, 4) == 0; };
      if (is("IHDR") && is_first) {
        put_chunk(file, "IHDR", data);
        std::vector<uint8_t> control;
        put_32(control, static_cast<uint32_t>(frames.size()));
        put_32(control, 0);  // for ever
        put_chunk(file, "acTL", control);
      }
      if (!is("IDAT")) return;
      if (!has_control) {
        std::vector<uint8_t> control;
        put_32(control, sequence++);
        put_32(control, frame.width);
        put_32(control, frame.height);
        put_32(control, 0);
        put_32(control, 0);
        put_16(control, 1);
        put_16(control, frames_per_second);
        control.insert(control.end(), {0, 0});  // leave the frame, overwrite it
        put_chunk(file, "fcTL", control);
        has_control = true;
      }
      if (is_first) {
        put_chunk(file, "IDAT", data);
        return;
      }
      std::vector<uint8_t> numbered;
      put_32(numbered, sequence++);
      numbered.insert(numbered.end(), data.begin(), data.end());
      put_chunk(file, "fdAT", numbered);
    });
  }
  put_chunk(file, "IEND", {});
  return write_file(path, file);
}

}  // namespace shale
