// The plugin `blinding`: yes when a camera's picture shows that it is dazzled or covered.
//
// Asked with the framed protocol about sensor_msgs/msg/Image. Answers `1` for blinded, `0` for not,
// and `?` for what it cannot decode, which counts as unscanned: whoever sends rubbish on a camera's
// topic is not to be taken for a picture. Ends with a status that means unscanned in the one-shot
// protocol, too.
#include <cstdint>
#include <cstdio>
#include <optional>
#include <vector>

#include "rules/camera_guard/plugins/image.h"
#include "rules/camera_guard/plugins/question.h"

int main() {
  constexpr int kExitUnscanned = 200;
  std::fputs("rips-plugin 1\n", stdout);
  std::fflush(stdout);
  while (const std::optional<std::vector<uint8_t>> payload =
             rips::camera_guard::ReadPayload(stdin)) {
    const std::optional<rips::camera_guard::Image> image =
        rips::camera_guard::DecodeImage(*payload);
    if (!image) {
      std::fputs("?\n", stdout);
    } else {
      const bool blinded = rips::camera_guard::IsBlinded(rips::camera_guard::Measure(*image));
      std::fputs(blinded ? "1\n" : "0\n", stdout);
    }
    std::fflush(stdout);
  }
  return kExitUnscanned;
}
