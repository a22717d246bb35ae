// Whatever bytes a segment of the spool holds: reading it ends; its frames lie in order, within it
// and beside one another, with what is skipped they cover it; each reads back alone; and written
// anew they read the same, with nothing skipped.
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "sensor_agent/spool/segment.h"
#include "services/base/check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace rips::sensor;  // One translation unit, nothing else in it.
  if (size > 100'000) return 0;  // Larger inputs find nothing new, slowly.
  const std::string file(reinterpret_cast<const char*>(data), size);
  ParseSegmentName(file).has_value();
  const absl::StatusOr<SegmentHeader> header = DecodeSegmentHeader(file);
  if (header.ok()) {
    RIPS_CHECK(EncodeSegmentHeader(*header).size() == kSegmentHeaderBytes, "another header");
  }
  // The inputs are made with this one, so that frames can be found in them.
  const uint32_t seed = 0;
  FrameScanner scanner(seed, file);
  std::string again(kSegmentHeaderBytes, '\0');
  std::vector<Frame> frames;
  size_t end = kSegmentHeaderBytes;
  size_t covered = 0;
  while (const std::optional<Frame> frame = scanner.Next()) {
    RIPS_CHECK(frame->offset >= end, "frames lie in one another");
    end = frame->offset + kFrameHeaderBytes + frame->payload.size();
    RIPS_CHECK(end <= file.size(), "a frame ends behind the file");
    covered += kFrameHeaderBytes + frame->payload.size();
    const auto alone = DecodeFrame(seed, absl::string_view(file).substr(frame->offset));
    RIPS_CHECK(alone.ok() && alone->payload == frame->payload, "a frame that cannot be read alone");
    AppendFrame(seed, *frame, &again);
    frames.push_back(*frame);
  }
  if (file.size() > kSegmentHeaderBytes) {
    RIPS_CHECK(covered + scanner.skipped() == file.size() - kSegmentHeaderBytes,
               "bytes are missing");
  }
  FrameScanner second(seed, again);
  for (const Frame& frame : frames) {
    const std::optional<Frame> copy = second.Next();
    RIPS_CHECK(copy.has_value() && copy->payload == frame.payload && copy->count == frame.count &&
                   copy->first_sequence == frame.first_sequence &&
                   copy->oldest_ns == frame.oldest_ns,
               "a frame changed on its way");
  }
  RIPS_CHECK(!second.Next().has_value() && second.skipped() == 0, "more than was written");
  return 0;
}
