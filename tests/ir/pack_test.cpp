#include "ir/package/pack.h"

#include <gtest/gtest.h>
#include <zlib.h>

#include <random>

#include "ir/package/package.h"

namespace shale {
namespace {

constexpr uint64_t kSeed = 11;

/// What kernels with weights in their code are made of: a product with one of many literals, added to one of 16 sums.
Spirv kernel_like(size_t products) {
  std::mt19937_64 random(kSeed);
  Spirv words{0x07230203, 0x00010500, 0x0008000b, 100000, 0};
  uint32_t id = 1000;
  std::array<uint32_t, 16> sums{};
  for (size_t i = 0; i < products; ++i) {
    const uint32_t product = id += 2;
    words.insert(words.end(), {5u << 16 | 133, 6, product, 900 + static_cast<uint32_t>(i / 16),
                               static_cast<uint32_t>(random() % 250)});
    words.insert(words.end(), {5u << 16 | 129, 6, id += 2, sums[i % 16], product});
    sums[i % 16] = id;
  }
  return words;
}

/// Instructions of any kind, length and operands.
Spirv anything(std::mt19937_64& random) {
  Spirv words{0x07230203, static_cast<uint32_t>(random()), 0, static_cast<uint32_t>(random()), 0};
  for (size_t left = random() % 400; left > 0; --left) {
    const uint32_t length = random() % 9 == 0 ? 40 : 1 + static_cast<uint32_t>(random() % 6);
    words.push_back(length << 16 | static_cast<uint32_t>(random() % 5));
    for (uint32_t i = 1; i < length; ++i)
      words.push_back(static_cast<uint32_t>(random() >> (random() % 64)));
  }
  return words;
}

std::string refusal(std::span<const uint8_t> packed, uint32_t words) {
  const auto unpacked = unpack_module(packed, words, "here");
  return unpacked ? "accepted" : unpacked.error().text();
}

/// A packed form of a body that nothing has looked at.
std::vector<uint8_t> with_body(const std::vector<uint8_t>& body) {
  EXPECT_LT(body.size(), 128u);
  std::vector<uint8_t> packed(1 + compressBound(body.size()));
  packed[0] = static_cast<uint8_t>(body.size());
  uLongf bytes = packed.size() - 1;
  EXPECT_EQ(compress(packed.data() + 1, &bytes, body.data(), body.size()), Z_OK);
  packed.resize(1 + bytes);
  return packed;
}

TEST(Pack, KernelsTakeATwentiethOfTheirWords) {
  const Spirv words = kernel_like(9216);
  const auto packed = pack_module(words);
  ASSERT_TRUE(packed);
  EXPECT_LT(packed->size() * 20, words.size() * 4);
  const auto back = unpack_module(*packed, static_cast<uint32_t>(words.size()), "");
  ASSERT_TRUE(back) << back.error().text();
  EXPECT_EQ(*back, words);
  EXPECT_EQ(pack_module(words), packed);
}

TEST(Pack, WhateverIsSplitIntoInstructionsComesBack) {
  std::mt19937_64 random(kSeed);
  size_t packed_ones = 0;
  for (int round = 0; round < 500; ++round) {
    const Spirv words = anything(random);
    const auto packed = pack_module(words);
    if (!packed) continue;
    ++packed_ones;
    const auto back = unpack_module(*packed, static_cast<uint32_t>(words.size()), "");
    ASSERT_TRUE(back) << back.error().text() << ", seed " << kSeed << " round " << round;
    ASSERT_EQ(*back, words) << "seed " << kSeed << " round " << round;
  }
  EXPECT_GT(packed_ones, 100u);
}

TEST(Pack, LeavesWhatIsNoInstructionsOrGainsNothing) {
  Spirv words = kernel_like(100);
  words.back() = 0;
  ASSERT_TRUE(pack_module(words));
  Spirv longer = words;
  longer.push_back(2u << 16 | 1);  // its operand is missing
  EXPECT_FALSE(pack_module(longer));
  longer.back() = 1;  // no length
  EXPECT_FALSE(pack_module(longer));
  EXPECT_FALSE(pack_module(Spirv{0x07230203, 0x00010500, 0, 8, 0}));
  EXPECT_FALSE(pack_module({}));
  words.resize(5);
  words.resize(100000, 1u << 16 | 1);  // a thousandth is left of it: more than a reader accepts
  EXPECT_FALSE(pack_module(words));
}

TEST(Pack, DamageIsRefusedOrGivesTheSameWords) {
  const Spirv words = kernel_like(40);
  const auto count = static_cast<uint32_t>(words.size());
  const auto packed = pack_module(words);
  ASSERT_TRUE(packed);
  for (size_t i = 0; i < packed->size(); ++i) {
    ASSERT_NE(refusal(std::span(*packed).first(i), count), "accepted")
        << "cut to " << i << " bytes";
    for (const int flip : {0x01, 0x80, 0xff}) {
      std::vector<uint8_t> damaged = *packed;
      damaged[i] = static_cast<uint8_t>(damaged[i] ^ flip);
      if (const auto back = unpack_module(damaged, count, "")) {
        ASSERT_EQ(*back, words) << "byte " << i;
      }
    }
  }
  std::vector<uint8_t> longer = *packed;
  longer.push_back(0);
  EXPECT_NE(refusal(longer, count), "accepted");
  for (const uint32_t other : {count - 1, count + 1})
    EXPECT_EQ(
        refusal(*packed, other),
        fmt::format("here: the packed module is damaged: its columns do not make {} words", other));
}

TEST(Pack, AsksForNoMoreMemoryThanItsBytesAllow) {
  const std::vector<uint8_t> packed = *pack_module(kernel_like(40));
  EXPECT_EQ(refusal(packed, UINT32_MAX),
            fmt::format("here: {} packed bytes cannot hold 4294967295 words: 5 to {} are expected",
                        packed.size(), packed.size() * kMaxPacking / sizeof(uint32_t)));
  EXPECT_EQ(refusal({}, 5), "here: 0 packed bytes cannot hold 5 words: 5 to 0 are expected");
  std::vector<uint8_t> stated = packed;
  stated.erase(stated.begin(), stated.begin() + 2);
  stated.insert(stated.begin(), {0xff, 0xff, 0xff, 0xff, 0x0f});
  EXPECT_EQ(refusal(stated, 405),
            "here: the packed module is damaged: its body has 4294967295 bytes, at most 1620 are "
            "expected");
  stated[4] = 0x1f;  // no number of 32 bits
  EXPECT_NE(refusal(stated, 405), "accepted");
}

TEST(Pack, BodiesAreJudged) {
  // One kind of two words, its operands as they are: 3 and 4.
  const std::vector<uint8_t> sound{1, 0x80, 0x80, 8, 0, 2, 1, 1, 1, 1, 1, 0, 0, 3, 4};
  ASSERT_EQ(refusal(with_body(sound), 9), "accepted");
  EXPECT_EQ(*unpack_module(with_body(sound), 9, ""),
            (Spirv{1, 1, 1, 1, 1, 2u << 16, 3, 2u << 16, 4}));
  const std::string damaged = "here: the packed module is damaged: its columns do not make 9 words";
  const auto changed = [&](size_t at, uint8_t value) {
    std::vector<uint8_t> body = sound;
    body[at] = value;
    return refusal(with_body(body), 9);
  };
  EXPECT_EQ(changed(0, 2), damaged);      // a kind too many
  EXPECT_EQ(changed(3, 0), damaged);      // an instruction without length
  EXPECT_EQ(changed(4, 3), damaged);      // no such prediction
  EXPECT_EQ(changed(5, 1), damaged);      // a word that no instruction takes is one of a third
  EXPECT_EQ(changed(5, 100), damaged);    // columns beyond the end
  EXPECT_EQ(changed(11, 1), damaged);     // no such kind
  EXPECT_EQ(changed(13, 0x83), damaged);  // a word less
  EXPECT_EQ(refusal(with_body({}), 9), damaged);
}

}  // namespace
}  // namespace shale
