// A sensor_msgs/msg/Image as it is on the wire, and whether its camera is blinded. Standard library
// only: this is the example to start one's own plugin from.
#ifndef RIPS_RULES_CAMERA_GUARD_PLUGINS_IMAGE_H_
#define RIPS_RULES_CAMERA_GUARD_PLUGINS_IMAGE_H_

#include <cstdint>
#include <optional>
#include <span>

namespace rips::camera_guard {

using Bytes = std::span<const uint8_t>;

struct Image {
  uint32_t height = 0;
  uint32_t width = 0;
  // Bytes of a pixel, and where in it red, green and blue are; all 0 for a grey image.
  uint32_t channels = 1;
  uint32_t red = 0;
  uint32_t green = 0;
  uint32_t blue = 0;
  // Bytes of a row, at least width * channels.
  uint32_t step = 0;
  // height * step bytes; a view of the message.
  Bytes pixels;
};

// The longest frame id and encoding name accepted, in bytes.
inline constexpr uint32_t kTextBytesMax = 1024;

// `message` is plain CDR behind its 4-byte encapsulation header, of either byte order. Encodings:
// mono8, rgb8, bgr8, rgba8, bgra8. nullopt for anything that is not exactly such an image: another
// encoding, no pixels, rows shorter than the width, more or less data than the rows need, a message
// of which only the beginning is there.
std::optional<Image> DecodeImage(Bytes message);

// Of luminance, 0 to 255 (0.299 red + 0.587 green + 0.114 blue).
struct Brightness {
  double mean = 0;
  double variance = 0;
  // Share of pixels at kSaturated or above, 0 to 1.
  double saturated = 0;
};

Brightness Measure(const Image& image);

// A pixel this bright carries no picture.
inline constexpr uint32_t kSaturated = 250;
// This share of saturated pixels is a dazzled camera.
inline constexpr double kSaturatedShareMin = 0.95;
// Below this variance a picture is uniform: a wall at rest shows some tens from sensor noise and
// vignetting, a covered or dazzled lens less.
inline constexpr double kUniformVarianceMax = 25;
// A uniform picture this bright is dazzled, this dark is covered. In between it may be a wall.
inline constexpr double kBrightMeanMin = 230;
inline constexpr double kDarkMeanMax = 10;

bool IsBlinded(const Brightness& brightness);

}  // namespace rips::camera_guard

#endif  // RIPS_RULES_CAMERA_GUARD_PLUGINS_IMAGE_H_
