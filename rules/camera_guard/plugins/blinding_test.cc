#include <cstdint>
#include <cstdio>
#include <functional>
#include <string>
#include <vector>

#include "gtest/gtest.h"
#include "rules/camera_guard/plugins/image.h"
#include "rules/camera_guard/plugins/question.h"

namespace rips::camera_guard {
namespace {

using Data = std::vector<uint8_t>;

enum class Order { kLittle, kBig };

// An image message, member by member, each of which a test may spoil.
struct Made {
  Order order = Order::kLittle;
  std::string frame_id = "camera";
  uint32_t height = 4;
  uint32_t width = 6;
  std::string encoding = "mono8";
  uint32_t step = 6;
  Data pixels = Data(24, 100);

  Data Cdr() const {
    Data cdr = {0, static_cast<uint8_t>(order == Order::kLittle ? 1 : 0), 0, 0};
    const auto u32 = [&](uint32_t value) {
      while (cdr.size() % 4 != 0) cdr.push_back(0);
      for (int i = 0; i < 4; ++i) {
        cdr.push_back(static_cast<uint8_t>(value >> 8 * (order == Order::kLittle ? i : 3 - i)));
      }
    };
    const auto text = [&](const std::string& value) {
      u32(static_cast<uint32_t>(value.size() + 1));
      cdr.insert(cdr.end(), value.begin(), value.end());
      cdr.push_back(0);
    };
    u32(1);
    u32(2);
    text(frame_id);
    u32(height);
    u32(width);
    text(encoding);
    cdr.push_back(0);
    u32(step);
    u32(static_cast<uint32_t>(pixels.size()));
    cdr.insert(cdr.end(), pixels.begin(), pixels.end());
    return cdr;
  }
};

Made Coloured(const std::string& encoding, const Data& pixel) {
  Made made;
  made.encoding = encoding;
  made.step = static_cast<uint32_t>(6 * pixel.size() + 2);  // rows may be padded
  made.pixels.clear();
  for (uint32_t row = 0; row < made.height; ++row) {
    for (uint32_t column = 0; column < made.width; ++column) {
      made.pixels.insert(made.pixels.end(), pixel.begin(), pixel.end());
    }
    made.pixels.insert(made.pixels.end(), {7, 7});
  }
  return made;
}

double MeanOf(const Made& made) {
  const Data cdr = made.Cdr();
  const auto image = DecodeImage(cdr);
  return image ? Measure(*image).mean : -1;
}

bool Blinded(const Data& pixels) {
  Made made;
  made.height = 10;
  made.width = made.step = static_cast<uint32_t>(pixels.size() / 10);
  made.pixels = pixels;
  const Data cdr = made.Cdr();
  const auto image = DecodeImage(cdr);
  EXPECT_TRUE(image.has_value());
  return image && IsBlinded(Measure(*image));
}

TEST(DecodeImageTest, ReadsBothByteOrders) {
  for (const Order order : {Order::kLittle, Order::kBig}) {
    Made made;
    made.order = order;
    const Data cdr = made.Cdr();
    const auto image = DecodeImage(cdr);
    ASSERT_TRUE(image.has_value());
    EXPECT_EQ(image->height, 4u);
    EXPECT_EQ(image->width, 6u);
    EXPECT_EQ(image->step, 6u);
    EXPECT_EQ(image->pixels.size(), 24u);
  }
}

TEST(DecodeImageTest, KnowsWhereTheColoursAre) {
  EXPECT_EQ(MeanOf(Coloured("mono8", {200})), 200);
  // Red 100, green 200, blue 50 is 153; with red and blue exchanged it would be 144.
  EXPECT_EQ(MeanOf(Coloured("rgb8", {100, 200, 50})), 153);
  EXPECT_EQ(MeanOf(Coloured("bgr8", {50, 200, 100})), 153);
  EXPECT_EQ(MeanOf(Coloured("rgba8", {100, 200, 50, 255})), 153);
  EXPECT_EQ(MeanOf(Coloured("bgra8", {50, 200, 100, 0})), 153);
  EXPECT_EQ(MeanOf(Coloured("rgb8", {255, 255, 255})), 255);
}

TEST(DecodeImageTest, RefusesWhatIsNoImage) {
  const std::vector<std::pair<const char*, std::function<void(Made&)>>> spoilt = {
      {"another encoding", [](Made& made) { made.encoding = "16UC1"; }},
      {"no encoding", [](Made& made) { made.encoding = ""; }},
      {"no rows", [](Made& made) { made.height = 0; }},
      {"no columns", [](Made& made) { made.width = 0; }},
      {"rows shorter than the width", [](Made& made) { made.width = 7; }},
      {"less data than rows", [](Made& made) { made.height = 5; }},
      {"more data than rows", [](Made& made) { made.height = 3; }},
      {"sizes whose product overflows",
       [](Made& made) {
         made.height = 0x80000000;
         made.width = made.step = 2;
         made.pixels.clear();
       }},
      {"width times channels overflows",
       [](Made& made) {
         made.encoding = "rgba8";
         made.width = 0x40000001;
         made.step = 4;
         made.pixels.resize(16);
       }},
      {"a long frame id", [](Made& made) { made.frame_id.assign(kTextBytesMax + 1, 'x'); }},
  };
  for (const auto& [what, spoil] : spoilt) {
    Made made;
    spoil(made);
    const Data cdr = made.Cdr();
    EXPECT_FALSE(DecodeImage(cdr).has_value()) << what;
  }
  Made longest;
  longest.frame_id.assign(kTextBytesMax, 'x');
  const Data cdr = longest.Cdr();
  EXPECT_TRUE(DecodeImage(cdr).has_value());
}

TEST(DecodeImageTest, RefusesTheBeginningOfAnImageAndMoreThanOne) {
  Data cdr = Made().Cdr();
  for (size_t size = 0; size < cdr.size(); ++size) {
    EXPECT_FALSE(DecodeImage(Bytes(cdr).first(size)).has_value()) << size;
  }
  for (int padding = 0; padding < 4; ++padding, cdr.push_back(0)) {
    EXPECT_TRUE(DecodeImage(cdr).has_value()) << padding;
  }
  EXPECT_FALSE(DecodeImage(cdr).has_value());
}

TEST(DecodeImageTest, RefusesOtherEncapsulations) {
  for (const uint8_t kind : {2, 3, 7, 255}) {
    Data cdr = Made().Cdr();
    cdr[1] = kind;
    EXPECT_FALSE(DecodeImage(cdr).has_value()) << int{kind};
  }
}

TEST(DecodeImageTest, SurvivesAnyByteChanged) {
  const Data good = Made().Cdr();
  for (size_t at = 0; at < good.size(); ++at) {
    for (const int value : {0, 1, 127, 128, 255}) {
      Data cdr = good;
      cdr[at] = static_cast<uint8_t>(value);
      const auto image = DecodeImage(cdr);
      if (image) Measure(*image);
    }
  }
}

TEST(BlindedTest, DazzledAndCoveredCamerasAreBlinded) {
  EXPECT_TRUE(Blinded(Data(1000, 255)));
  EXPECT_TRUE(Blinded(Data(1000, 250)));
  EXPECT_TRUE(Blinded(Data(1000, 235)));
  EXPECT_TRUE(Blinded(Data(1000, 0)));
  EXPECT_TRUE(Blinded(Data(1000, 10)));
}

TEST(BlindedTest, PicturesAndGreyWallsAreNot) {
  EXPECT_FALSE(Blinded(Data(1000, 128)));
  EXPECT_FALSE(Blinded(Data(1000, 229)));
  EXPECT_FALSE(Blinded(Data(1000, 11)));
  Data gradient(1000);
  for (size_t i = 0; i < gradient.size(); ++i) gradient[i] = static_cast<uint8_t>(i % 256);
  EXPECT_FALSE(Blinded(gradient));
}

TEST(BlindedTest, ThresholdsAreWhereTheHeaderPutsThem) {
  Data mostly(1000, 255);
  for (size_t i = 0; i < 50; ++i) mostly[i] = 0;
  EXPECT_TRUE(Blinded(mostly)) << "95 % saturated";
  mostly[50] = 0;
  EXPECT_FALSE(Blinded(mostly));

  // Half the pixels 5 away on either side of the mean: variance 25.
  Data noisy(1000);
  for (size_t i = 0; i < noisy.size(); ++i) noisy[i] = i % 2 == 0 ? 0 : 10;
  EXPECT_TRUE(Blinded(noisy));
  for (size_t i = 0; i < noisy.size(); ++i) noisy[i] = i % 2 == 0 ? 0 : 12;
  EXPECT_FALSE(Blinded(noisy));
}

TEST(QuestionTest, FindsTheSizeOfThePayload) {
  EXPECT_EQ(PayloadBytes(R"({"topic":"/a","payload_bytes":12,"size_bytes":99})"), 12u);
  EXPECT_EQ(PayloadBytes(R"({"payload_bytes": 0})"), 0u);
  EXPECT_EQ(PayloadBytes(R"({"topic":"\"payload_bytes\":7,","payload_bytes":12})"), 12u);
  EXPECT_EQ(PayloadBytes(R"({"payload_bytes":67108864})"), kPayloadBytesMax);
  EXPECT_FALSE(PayloadBytes(R"({"payload_bytes":67108865})").has_value());
  EXPECT_FALSE(PayloadBytes(R"({"payload_bytes":4294967296})").has_value());
  EXPECT_FALSE(PayloadBytes(R"({"payload_bytes":-1})").has_value());
  EXPECT_FALSE(PayloadBytes(R"({"payload_bytes":1.5})").has_value());
  EXPECT_FALSE(PayloadBytes(R"({"payload_bytes":12)").has_value());
  EXPECT_FALSE(PayloadBytes(R"({"payload_bytes":)").has_value());
  EXPECT_FALSE(PayloadBytes("").has_value());
}

// What ReadPayload makes of `input`: the sizes of the payloads up to its end.
std::vector<size_t> Sizes(const std::string& input) {
  std::FILE* file = std::tmpfile();
  std::fwrite(input.data(), 1, input.size(), file);
  std::rewind(file);
  std::vector<size_t> sizes;
  while (const auto payload = ReadPayload(file)) sizes.push_back(payload->size());
  std::fclose(file);
  return sizes;
}

TEST(QuestionTest, ReadsQuestionsUntilTheInputEnds) {
  const std::string header = R"({"payload_bytes":3})";
  const std::string question = std::string{static_cast<char>(header.size()), 0, 0, 0} + header;
  const std::string whole = question + "abc" + question + "def";

  EXPECT_EQ(Sizes(whole), (std::vector<size_t>{3, 3}));
  for (size_t size = 0; size < whole.size(); ++size) {
    EXPECT_EQ(Sizes(whole.substr(0, size)).size(), size < whole.size() / 2 ? 0u : 1u) << size;
  }
  EXPECT_TRUE(Sizes(std::string("\0\0\0\0", 4)).empty()) << "no header";
  EXPECT_TRUE(Sizes(std::string("\1\0\1\0", 4) + std::string(100'000, 'x')).empty()) << "too long";
}

}  // namespace
}  // namespace rips::camera_guard
