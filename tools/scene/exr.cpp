#include "tools/scene/exr.h"

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfIO.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfOutputFile.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "ir/base/file.h"

namespace shale {
namespace {

constexpr int kMaxSide = 65536;

/// A file that grows in memory, so that writing it to disk is ours.
class MemoryOut : public Imf::OStream {
 public:
  MemoryOut() : OStream("memory") {}
  void write(const char bytes[], int count) override {
    const size_t end = at_ + static_cast<size_t>(count);
    if (end > bytes_.size()) bytes_.resize(end);
    std::memcpy(bytes_.data() + at_, bytes, static_cast<size_t>(count));
    at_ = end;
  }
  uint64_t tellp() override { return at_; }
  void seekp(uint64_t position) override { at_ = position; }
  const std::vector<uint8_t>& bytes() const { return bytes_; }

 private:
  std::vector<uint8_t> bytes_;
  size_t at_ = 0;
};

class MemoryIn : public Imf::IStream {
 public:
  explicit MemoryIn(const std::vector<uint8_t>& bytes) : IStream("memory"), bytes_(bytes) {}
  bool read(char to[], int count) override {
    const size_t wanted = static_cast<size_t>(std::max(count, 0));
    if (wanted > bytes_.size() - at_) throw std::runtime_error("the file ends too early");
    std::memcpy(to, bytes_.data() + at_, wanted);
    at_ += wanted;
    return at_ < bytes_.size();
  }
  uint64_t tellg() override { return at_; }
  void seekg(uint64_t position) override {
    if (position > bytes_.size()) throw std::runtime_error("an offset lies behind the file's end");
    at_ = position;
  }

 private:
  const std::vector<uint8_t>& bytes_;
  size_t at_ = 0;
};

/// Names of a channel, best first, "|" between them.
std::vector<const char*> channel_names(uint32_t channels) {
  if (channels == 1) return {"R|Z|Y|V"};
  if (channels == 2) return {"R|X|U", "G|Y|V"};
  return {"R", "G", "B"};
}

std::string find_channel(const Imf::ChannelList& list, const std::string& names) {
  for (size_t at = 0; at < names.size();) {
    const size_t end = std::min(names.find('|', at), names.size());
    const std::string name = names.substr(at, end - at);
    if (list.findChannel(name)) return name;
    at = end + 1;
  }
  return {};
}

float clamped_half(float value) {
  constexpr float kMost = 65504;
  return std::isfinite(value) ? std::clamp(value, -kMost, kMost) : value;
}

Result<Extent> size_in(const std::string& path, const Imf::Header& header) {
  const Imath::Box2i window = header.dataWindow();
  const int64_t width = int64_t{window.max.x} - window.min.x + 1;
  const int64_t height = int64_t{window.max.y} - window.min.y + 1;
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide ||
      static_cast<uint64_t>(width * height) > kMaxExrPixels)
    return bad_input(path, "has {}x{} pixels, expected 1 to {}", width, height, kMaxExrPixels);
  return Extent{static_cast<uint32_t>(width), static_cast<uint32_t>(height)};
}

Result<FloatImage> read_from(const std::string& path, const std::vector<uint8_t>& bytes,
                             uint32_t channels, std::optional<Extent> size) {
  MemoryIn stream(bytes);
  Imf::InputFile file(stream, 0);
  const Imath::Box2i window = file.header().dataWindow();
  SHALE_TRY(const Extent found_size, size_in(path, file.header()));
  const auto [width, height] = found_size;
  if (size && (width != size->width || height != size->height))
    return bad_input(path, "has {}x{} pixels, expected {}x{}", width, height, size->width,
                     size->height);
  const Imf::ChannelList& list = file.header().channels();
  std::string found;
  size_t count = 0;
  for (auto it = list.begin(); it != list.end(); ++it, ++count)
    found += fmt::format("{}{}", found.empty() ? "" : ", ", it.name());
  FloatImage image{width, height, channels, {}};
  std::vector<std::string> names;
  for (const char* wanted : channel_names(channels)) {
    std::string name = find_channel(list, wanted);
    if (name.empty() && channels == 1 && count == 1) name = list.begin().name();
    if (name.empty()) return bad_input(path, "lacks channel {}, found {}", wanted, found);
    const Imf::Channel& channel = list[name.c_str()];
    if (channel.type != Imf::HALF && channel.type != Imf::FLOAT)
      return bad_input(path, "channel {} holds integers, expected half or float", name);
    if (channel.xSampling != 1 || channel.ySampling != 1)
      return bad_input(path, "channel {} is sub-sampled", name);
    names.push_back(std::move(name));
  }
  image.values.resize(size_t{width} * height * channels);
  Imf::FrameBuffer buffer;
  const size_t pixel = channels * sizeof(float), row = pixel * width;
  for (size_t c = 0; c < names.size(); ++c)
    buffer.insert(names[c],
                  Imf::Slice::Make(Imf::FLOAT, image.values.data() + c, window, pixel, row));
  file.setFrameBuffer(buffer);
  file.readPixels(window.min.y, window.max.y);
  return image;
}

/// What `use` makes of the file's bytes; the library's exceptions end here.
template <typename Use>
auto decoded(const std::string& path, const Use& use) -> decltype(use(std::vector<uint8_t>())) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
  // Or a few bytes could ask the library for tables of many gigabytes.
  Imf::Header::setMaxImageSize(kMaxSide, kMaxSide);
  try {
    return use(bytes);
  } catch (const std::exception& error) {
    return bad_input(path, "is no readable OpenEXR picture: {}", error.what());
  }
}

std::vector<uint8_t> encoded(const FloatImage& image, ExrPrecision precision) {
  const bool half = precision == ExrPrecision::kHalf;
  const Imf::PixelType type = half ? Imf::HALF : Imf::FLOAT;
  Imf::Header header(static_cast<int>(image.width), static_cast<int>(image.height));
  header.compression() = Imf::ZIP_COMPRESSION;
  std::vector<Imath::half> halves;
  if (half)
    for (const float value : image.values) halves.emplace_back(clamped_half(value));
  const size_t bytes = half ? sizeof(Imath::half) : sizeof(float);
  const char* base = half ? reinterpret_cast<const char*>(halves.data())
                          : reinterpret_cast<const char*>(image.values.data());
  Imf::FrameBuffer buffer;
  size_t c = 0;
  for (const char* names : channel_names(image.channels)) {
    const std::string name(names, 1);
    header.channels().insert(name, Imf::Channel(type));
    buffer.insert(name,
                  Imf::Slice::Make(type, base + bytes * c++, header.dataWindow(),
                                   bytes * image.channels, bytes * image.channels * image.width));
  }
  MemoryOut stream;
  {
    Imf::OutputFile file(stream, header, 0);
    file.setFrameBuffer(buffer);
    file.writePixels(static_cast<int>(image.height));
  }
  return stream.bytes();
}

}  // namespace

Result<void> write_exr(const std::string& path, const FloatImage& image, ExrPrecision precision) {
  SHALE_CHECK(image.channels >= 1 && image.channels <= 3 && !image.empty());
  try {
    return write_file(path, encoded(image, precision));
  } catch (const std::exception& error) {
    return io_error(path, "cannot be encoded: {}", error.what());
  }
}

Result<FloatImage> read_exr(const std::string& path, uint32_t channels,
                            std::optional<Extent> size) {
  SHALE_CHECK(channels >= 1 && channels <= 3);
  return decoded(path, [&](const std::vector<uint8_t>& bytes) {
    return read_from(path, bytes, channels, size);
  });
}

Result<Extent> exr_size(const std::string& path) {
  return decoded(path, [&](const std::vector<uint8_t>& bytes) {
    MemoryIn stream(bytes);
    const Imf::InputFile file(stream, 0);
    return size_in(path, file.header());
  });
}

}  // namespace shale
