#include "ir/package/pack.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <bit>
#include <unordered_map>

namespace shale {
namespace {

constexpr size_t kHeaderWords = 5;
constexpr size_t kColumns = 8;  ///< of a kind, at most
constexpr size_t kMaxVarint = 5;
constexpr size_t kMaxKinds =
    4096;  ///< more than there are opcodes of different lengths in any shader
/// A body that is longer than its words is no gain.
constexpr uint64_t kMaxBodyBytesPerWord = sizeof(uint32_t);

/// What a column's words are stored as.
enum class Prediction : uint8_t {
  kNone = 0,    ///< the word
  kColumn = 1,  ///< the difference to the column's word before it, at first to 0
  kAnchor = 2,  ///< the difference to the anchor
};
constexpr uint32_t kPredictionCount = 3;

/// Mostly the newest result: the third word of the instruction, or, for the words up to there, of the last one that had three.
struct Anchor {
  uint32_t before = 0, own = 0;
  void begin() { before = own; }
  void take(size_t place, uint32_t word) {
    if (place == 2) own = word;
  }
  uint32_t of(size_t place) const { return place <= 2 ? before : own; }
};

uint32_t zigzag(uint32_t difference) { return (difference << 1) ^ (0 - (difference >> 31)); }
uint32_t unzigzag(uint32_t code) { return (code >> 1) ^ (0 - (code & 1)); }

size_t columns_of(uint32_t first_word) {
  return std::min<size_t>((first_word >> 16) - 1, kColumns);
}
size_t column_at(size_t place) { return std::min(place, kColumns) - 1; }

void put(std::vector<uint8_t>& bytes, uint32_t value) {
  for (; value >= 0x80; value >>= 7) bytes.push_back(static_cast<uint8_t>(value | 0x80));
  bytes.push_back(static_cast<uint8_t>(value));
}

/// What an entropy coder would need for the bytes, in 1/256 bits; in integers, so that it is the same everywhere.
uint64_t estimated_bits(std::span<const uint8_t> bytes) {
  const auto log2 = [](uint64_t value) {
    const uint64_t whole = std::bit_width(value) - 1;
    return whole * 256 + (((value << 8) >> whole) - 256);
  };
  std::array<uint64_t, 256> counts{};
  for (const uint8_t byte : bytes) ++counts[byte];
  uint64_t bits = 0;
  for (const uint64_t count : counts)
    if (count) bits += count * (log2(bytes.size()) - log2(count));
  return bits;
}

/// One column while it is being packed.
struct Column {
  struct Word {
    uint32_t word, anchor;
  };
  std::vector<Word> words;

  std::vector<uint8_t> stored(Prediction prediction) const {
    std::vector<uint8_t> bytes;
    bytes.reserve(words.size() * 2);
    uint32_t last = 0;
    for (const Word& each : words) {
      switch (prediction) {
        case Prediction::kNone: put(bytes, each.word); break;
        case Prediction::kColumn: put(bytes, zigzag(each.word - last)); break;
        case Prediction::kAnchor: put(bytes, zigzag(each.word - each.anchor)); break;
      }
      last = each.word;
    }
    return bytes;
  }
};

/// Reads what nobody vouches for; behind a fault everything reads as 0.
class Reader {
 public:
  explicit Reader(std::span<const uint8_t> bytes) : bytes_(bytes) {}

  bool damaged() const { return damaged_; }
  bool at_end() const { return bytes_.empty(); }
  std::span<const uint8_t> rest() const { return bytes_; }

  uint8_t byte() {
    if (bytes_.empty()) damaged_ = true;
    if (damaged_) return 0;
    const uint8_t value = bytes_.front();
    bytes_ = bytes_.subspan(1);
    return value;
  }

  uint32_t varint() {
    if (!bytes_.empty() && bytes_.front() < 0x80) return byte();  // nearly all
    uint64_t value = 0;
    for (size_t i = 0; i < kMaxVarint; ++i) {
      const uint8_t next = byte();
      value |= uint64_t{next & 0x7fu} << (7 * i);
      if (next < 0x80) {
        damaged_ = damaged_ || value > UINT32_MAX;
        return damaged_ ? 0 : static_cast<uint32_t>(value);
      }
    }
    damaged_ = true;
    return 0;
  }

  Reader part(uint32_t bytes) {
    damaged_ = damaged_ || bytes > bytes_.size();
    if (damaged_) return Reader({});
    const Reader part(bytes_.first(bytes));
    bytes_ = bytes_.subspan(bytes);
    return part;
  }

 private:
  std::span<const uint8_t> bytes_;
  bool damaged_ = false;
};

struct StoredColumn {
  Prediction prediction;
  uint32_t bytes;
  Reader reader{{}};
  uint32_t last = 0;

  uint32_t next(uint32_t anchor) {
    const uint32_t code = reader.varint();
    switch (prediction) {
      case Prediction::kNone: return last = code;
      case Prediction::kColumn: return last += unzigzag(code);
      case Prediction::kAnchor: return last = anchor + unzigzag(code);
    }
    check_failed("a prediction that exists", __FILE__, __LINE__);
  }
};

struct Kind {
  uint32_t first_word = 0;
  size_t first_column = 0;
};

/// Nothing where the body does not make exactly so many words.
std::optional<std::vector<uint32_t>> words_of(std::span<const uint8_t> body, uint32_t word_count) {
  Reader reader(body);
  std::vector<Kind> kinds;
  std::vector<StoredColumn> columns;
  const uint32_t kind_count = reader.varint();
  if (kind_count > kMaxKinds) return std::nullopt;
  for (uint32_t left = kind_count; left > 0 && !reader.damaged(); --left) {
    const Kind kind{reader.varint(), columns.size()};
    if (kind.first_word >> 16 == 0) return std::nullopt;
    for (size_t i = 0; i < columns_of(kind.first_word); ++i) {
      const uint8_t prediction = reader.byte();
      if (prediction >= kPredictionCount) return std::nullopt;
      columns.push_back({static_cast<Prediction>(prediction), reader.varint()});
    }
    kinds.push_back(kind);
  }
  std::vector<uint32_t> words;
  words.reserve(word_count);
  for (size_t i = 0; i < kHeaderWords; ++i) words.push_back(reader.varint());
  uint64_t column_bytes = 0;
  for (const StoredColumn& column : columns) column_bytes += column.bytes;
  if (reader.damaged() || column_bytes > reader.rest().size()) return std::nullopt;
  Reader numbers = reader.part(static_cast<uint32_t>(reader.rest().size() - column_bytes));
  for (StoredColumn& column : columns) column.reader = reader.part(column.bytes);
  Anchor anchor;
  while (!numbers.at_end()) {
    const uint32_t number = numbers.varint();
    if (numbers.damaged() || number >= kinds.size()) return std::nullopt;
    const Kind& kind = kinds[number];
    const size_t length = kind.first_word >> 16;
    if (length > word_count - std::min<size_t>(words.size(), word_count)) return std::nullopt;
    words.push_back(kind.first_word);
    anchor.begin();
    for (size_t place = 1; place < length; ++place) {
      words.push_back(columns[kind.first_column + column_at(place)].next(anchor.of(place)));
      anchor.take(place, words.back());
    }
  }
  for (const StoredColumn& column : columns)
    if (column.reader.damaged() || !column.reader.at_end()) return std::nullopt;
  if (words.size() != word_count) return std::nullopt;
  return words;
}

}  // namespace

std::optional<std::vector<uint8_t>> pack_module(std::span<const uint32_t> words) {
  if (words.size() < kHeaderWords || words.size() > UINT32_MAX / kMaxBodyBytesPerWord)
    return std::nullopt;
  std::vector<Kind> kinds;
  std::unordered_map<uint32_t, uint32_t> kind_of;  // of a first word; only looked up
  std::vector<Column> columns;
  std::vector<uint8_t> numbers;
  Anchor anchor;
  for (size_t at = kHeaderWords; at < words.size();) {
    const size_t length = words[at] >> 16;
    if (length == 0 || length > words.size() - at) return std::nullopt;
    const auto [found, is_new] =
        kind_of.try_emplace(words[at], static_cast<uint32_t>(kinds.size()));
    if (is_new) {
      kinds.push_back({words[at], columns.size()});
      columns.resize(columns.size() + columns_of(words[at]));
      if (kinds.size() > kMaxKinds) return std::nullopt;
    }
    put(numbers, found->second);
    anchor.begin();
    for (size_t place = 1; place < length; ++place) {
      columns[kinds[found->second].first_column + column_at(place)].words.push_back(
          {words[at + place], anchor.of(place)});
      anchor.take(place, words[at + place]);
    }
    at += length;
  }

  std::vector<uint8_t> body, stored;
  put(body, static_cast<uint32_t>(kinds.size()));
  for (const Kind& kind : kinds) {
    put(body, kind.first_word);
    for (size_t i = 0; i < columns_of(kind.first_word); ++i) {
      const Column& column = columns[kind.first_column + i];
      Prediction best = Prediction::kNone;
      std::vector<uint8_t> least = column.stored(best);
      uint64_t least_bits = estimated_bits(least);
      for (const Prediction prediction : {Prediction::kColumn, Prediction::kAnchor}) {
        std::vector<uint8_t> bytes = column.stored(prediction);
        const uint64_t bits = estimated_bits(bytes);
        if (bits >= least_bits) continue;
        best = prediction;
        least = std::move(bytes);
        least_bits = bits;
      }
      body.push_back(static_cast<uint8_t>(best));
      put(body, static_cast<uint32_t>(least.size()));
      stored.insert(stored.end(), least.begin(), least.end());
    }
  }
  for (size_t i = 0; i < kHeaderWords; ++i) put(body, words[i]);
  body.insert(body.end(), numbers.begin(), numbers.end());
  body.insert(body.end(), stored.begin(), stored.end());
  if (body.size() > kMaxBodyBytesPerWord * words.size()) return std::nullopt;

  std::vector<uint8_t> packed;
  put(packed, static_cast<uint32_t>(body.size()));
  const size_t prefix = packed.size();
  uLongf bytes = compressBound(static_cast<uLong>(body.size()));
  packed.resize(prefix + bytes);
  SHALE_CHECK(compress2(packed.data() + prefix, &bytes, body.data(),
                        static_cast<uLong>(body.size()), Z_BEST_COMPRESSION) == Z_OK);
  packed.resize(prefix + bytes);
  const uint64_t word_bytes = words.size() * sizeof(uint32_t);
  if (packed.size() >= word_bytes || word_bytes > kMaxPacking * packed.size()) return std::nullopt;
  return packed;
}

Result<std::vector<uint32_t>> unpack_module(std::span<const uint8_t> packed, uint32_t word_count,
                                            const std::string& where) {
  if (word_count < kHeaderWords ||
      uint64_t{word_count} * sizeof(uint32_t) > kMaxPacking * packed.size())
    return bad_input(where, "{} packed bytes cannot hold {} words: {} to {} are expected",
                     packed.size(), word_count, kHeaderWords,
                     kMaxPacking * packed.size() / sizeof(uint32_t));
  Reader reader(packed);
  const uint32_t body_bytes = reader.varint();
  if (reader.damaged() || body_bytes > kMaxBodyBytesPerWord * word_count)
    return bad_input(where,
                     "the packed module is damaged: its body has {} bytes, at most {} are expected",
                     body_bytes, kMaxBodyBytesPerWord * word_count);
  std::vector<uint8_t> body(body_bytes);
  uLongf made = body_bytes;
  uLong taken = static_cast<uLong>(reader.rest().size());
  const int status = uncompress2(body.data(), &made, reader.rest().data(), &taken);
  if (status != Z_OK || made != body_bytes || taken != reader.rest().size())
    return bad_input(where,
                     "the packed module is damaged: {} bytes of zlib make {} ({}), {} are expected",
                     taken, made, zError(status), body_bytes);
  std::optional<std::vector<uint32_t>> words = words_of(body, word_count);
  if (!words)
    return bad_input(where, "the packed module is damaged: its columns do not make {} words",
                     word_count);
  return std::move(*words);
}

}  // namespace shale
