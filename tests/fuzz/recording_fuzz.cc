// Whatever bytes a recording holds: reading ends, with at most so many events as it has bytes
// unless they are packed, in ascending indices, twice the same; and what our own format takes of it
// reads back the same. As an event of our format, they decode to what encodes and decodes again to
// the same.
#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/recording/event_codec.h"
#include "policy_server/policy/recording/mcap_reader.h"
#include "policy_server/policy/recording/reader.h"
#include "policy_server/policy/recording/rips_writer.h"
#include "services/base/check.h"

namespace rips::recording {
namespace {

// No more events of a recording are read: a packed chunk of 100 bytes may hold millions.
constexpr size_t kEventsRead = 10'000;

// An empty file of this process, and where it lies.
struct TempFile {
  TempFile() { fd = mkstemp(path.data()); }
  ~TempFile() {
    close(fd);
    unlink(path.c_str());
  }
  void Empty() const {
    RIPS_CHECK(ftruncate(fd, 0) == 0 && lseek(fd, 0, SEEK_SET) == 0, path.c_str());
  }

  std::string path = absl::StrCat(access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp",
                                  "/rips-recording-fuzz-XXXXXX");
  int fd;
};

// Every event and the error, if any, as text; what the writer takes goes to `writer`, and its text
// to `taken`.
std::string Everything(const std::string& path, size_t events_max, RipsWriter* writer,
                       std::string* taken) {
  const auto reader = Open(path);
  if (!reader.ok()) return std::string(reader.status().message());
  std::string text;
  for (size_t count = 0;; ++count) {
    const auto event = (*reader)->Next();
    if (!event.ok()) return absl::StrCat(text, event.status().message());
    if (!*event || count == kEventsRead) return text;
    RIPS_CHECK(count < events_max, "more events than bytes");
    RIPS_CHECK((*event)->index == count, "an index is skipped");
    const std::string bytes = EncodeEvent(**event).SerializeAsString();
    absl::StrAppend(&text, bytes, "\n");
    if (writer != nullptr && writer->Append(**event).ok()) absl::StrAppend(taken, bytes, "\n");
  }
}

// Where two readings part, with what follows there in each.
std::string Difference(absl::string_view left, absl::string_view right) {
  constexpr size_t kShownBytes = 200;
  const auto length = static_cast<size_t>(
      std::mismatch(left.begin(), left.end(), right.begin(), right.end()).first - left.begin());
  return absl::StrCat("at byte ", length, ": `", absl::CHexEscape(left.substr(length, kShownBytes)),
                      "` or `", absl::CHexEscape(right.substr(length, kShownBytes)), "`");
}

// As one event of our own format, without its checksum.
void OneEvent(absl::string_view bytes) {
  rips::v1::RecordedEvent wire;
  if (!wire.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
  const auto event = DecodeEvent(wire);
  if (!event.ok()) return;
  const std::string encoded = EncodeEvent(*event).SerializeAsString();
  const auto again = DecodeEvent(EncodeEvent(*event));
  RIPS_CHECK(again.ok() && EncodeEvent(*again).SerializeAsString() == encoded,
             "an event changed on its way");
}

}  // namespace
}  // namespace rips::recording

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace rips::recording;  // One translation unit, nothing else in it.
  if (size > 100'000) return 0;     // Larger inputs find nothing new, slowly.
  const absl::string_view bytes(reinterpret_cast<const char*>(data), size);
  OneEvent(bytes);
  const bool may_be_packed = absl::StartsWith(bytes, kMcapMagic);
  const size_t events_max = may_be_packed ? kEventsRead : size;
  static const TempFile input;
  static const TempFile output;
  input.Empty();
  output.Empty();
  RIPS_CHECK(write(input.fd, data, size) == static_cast<ssize_t>(size), "no room for the input");
  auto writer = RipsWriter::Create(output.fd, {.robot = "fuzz"});
  RIPS_CHECK(writer.ok(), "no room for the output");
  std::string taken;
  const std::string first = Everything(input.path, events_max, &*writer, &taken);
  const std::string second = Everything(input.path, events_max, nullptr, nullptr);
  RIPS_CHECK(second == first,
             absl::StrCat("a second reading differs ", Difference(first, second)).c_str());
  const std::string copy = Everything(output.path, events_max, nullptr, nullptr);
  RIPS_CHECK(copy == taken, absl::StrCat("a copy differs ", Difference(taken, copy)).c_str());
  return 0;
}
