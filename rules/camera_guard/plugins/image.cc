#include "rules/camera_guard/plugins/image.h"

#include <array>
#include <cstring>
#include <string>

namespace rips::camera_guard {
namespace {

constexpr size_t kCdrHeaderBytes = 4;
// A message may be padded to a multiple of 4.
constexpr size_t kPaddingBytesMax = 3;

// Members in order. After the first failure all are zero or empty.
class Reader {
 public:
  explicit Reader(Bytes message) {
    ok_ = message.size() >= kCdrHeaderBytes && message[0] == 0 && message[1] <= 1;
    if (!ok_) return;
    little_endian_ = message[1] == 1;
    body_ = message.subspan(kCdrHeaderBytes);
  }
  uint8_t U8() {
    const Bytes bytes = Take(1, 1);
    return bytes.empty() ? 0 : bytes[0];
  }
  uint32_t U32() {
    const Bytes bytes = Take(4, 4);
    uint32_t value = 0;
    for (size_t i = 0; i < bytes.size(); ++i) {
      value |= uint32_t{bytes[i]} << 8 * (little_endian_ ? i : 3 - i);
    }
    return value;
  }
  // Without its terminator.
  std::string Text() {
    const uint32_t length = U32();
    if (length > kTextBytesMax + 1) ok_ = false;
    const Bytes bytes = Take(length, 1);
    if (bytes.empty()) return {};
    if (bytes.back() != 0) ok_ = false;
    return {bytes.begin(), bytes.end() - 1};
  }
  Bytes Sequence() { return Take(U32(), 1); }
  bool AtEnd() const { return ok_ && body_.size() - at_ <= kPaddingBytesMax; }

 private:
  Bytes Take(size_t size, size_t align) {
    const size_t start = (at_ + align - 1) / align * align;
    ok_ = ok_ && start <= body_.size() && body_.size() - start >= size;
    if (!ok_) return {};
    at_ = start + size;
    return body_.subspan(start, size);
  }

  Bytes body_;
  size_t at_ = 0;
  bool little_endian_ = true;
  bool ok_ = true;
};

struct Encoding {
  const char* name;
  uint32_t channels;
  uint32_t red;
  uint32_t green;
  uint32_t blue;
};
constexpr std::array<Encoding, 5> kEncodings = {{{"mono8", 1, 0, 0, 0},
                                                 {"rgb8", 3, 0, 1, 2},
                                                 {"bgr8", 3, 2, 1, 0},
                                                 {"rgba8", 4, 0, 1, 2},
                                                 {"bgra8", 4, 2, 1, 0}}};

}  // namespace

std::optional<Image> DecodeImage(Bytes message) {
  Reader reader(message);
  reader.U32();   // stamp: seconds
  reader.U32();   // nanoseconds
  reader.Text();  // frame id
  Image image;
  image.height = reader.U32();
  image.width = reader.U32();
  const std::string name = reader.Text();
  reader.U8();  // byte order of pixels, which have one byte a channel here
  image.step = reader.U32();
  image.pixels = reader.Sequence();
  if (!reader.AtEnd()) return std::nullopt;

  for (const Encoding& encoding : kEncodings) {
    if (name != encoding.name) continue;
    image.channels = encoding.channels;
    image.red = encoding.red;
    image.green = encoding.green;
    image.blue = encoding.blue;
    const bool rows_fit = image.height > 0 && image.width > 0 &&
                          uint64_t{image.width} * image.channels <= image.step &&
                          uint64_t{image.height} * image.step == image.pixels.size();
    return rows_fit ? std::optional(image) : std::nullopt;
  }
  return std::nullopt;
}

Brightness Measure(const Image& image) {
  uint64_t sum = 0;
  uint64_t sum_of_squares = 0;
  uint64_t saturated = 0;
  for (uint32_t row = 0; row < image.height; ++row) {
    const uint8_t* pixel = image.pixels.data() + size_t{row} * image.step;
    for (uint32_t column = 0; column < image.width; ++column, pixel += image.channels) {
      const uint32_t luminance =
          (299 * pixel[image.red] + 587 * pixel[image.green] + 114 * pixel[image.blue] + 500) /
          1000;
      sum += luminance;
      sum_of_squares += luminance * luminance;
      saturated += luminance >= kSaturated ? 1 : 0;
    }
  }
  const double count = static_cast<double>(image.height) * image.width;
  const double mean = static_cast<double>(sum) / count;
  return {.mean = mean,
          .variance = static_cast<double>(sum_of_squares) / count - mean * mean,
          .saturated = static_cast<double>(saturated) / count};
}

bool IsBlinded(const Brightness& brightness) {
  if (brightness.saturated >= kSaturatedShareMin) return true;
  return brightness.variance <= kUniformVarianceMax &&
         (brightness.mean >= kBrightMeanMin || brightness.mean <= kDarkMeanMax);
}

}  // namespace rips::camera_guard
