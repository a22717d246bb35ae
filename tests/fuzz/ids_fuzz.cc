// Whatever bytes stand in a log of an IDS: each format gives text that is UTF-8 and within its
// limits, a line that it takes it takes again as it hands it on, and reading the log in two pieces
// gives the lines that reading it at once gives. As an offsets file, what is taken reads back as it
// was written.
#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "sensor_agent/ids/alert_parser.h"
#include "sensor_agent/ids/log_position.h"
#include "sensor_agent/ids/log_tail.h"
#include "services/base/check.h"

namespace rips::sensor {
namespace {

constexpr LogTailLimits kLimits = {.line_bytes = 2'000, .turn_bytes = 700, .events = false};

void CheckText(const std::string& text, size_t bytes_max) {
  RIPS_CHECK(text.size() <= bytes_max, "a text exceeds its limit");
  RIPS_CHECK(Utf8Only(text, bytes_max) == text, "a text is no UTF-8");
}

void ParseLine(absl::string_view line) {
  for (const IdsFormat format : {IdsFormat::kEve, IdsFormat::kFast, IdsFormat::kSnort3Json}) {
    const IdsLine parsed = ParseIdsLine(format, line);
    if (parsed.kind != IdsLineKind::kAlert) continue;
    const IdsAlert& alert = parsed.alert;
    CheckText(alert.message, kIdsMessageBytesMax);
    CheckText(alert.line, kIdsLineBytesMax);
    CheckText(alert.src, 64);
    CheckText(alert.dst, 64);
    const bool cut =
        alert.line.size() + 4 > kIdsLineBytesMax || alert.message.size() + 4 > kIdsMessageBytesMax;
    if (format != IdsFormat::kFast || cut) continue;
    const IdsLine again = ParseIdsLine(format, alert.line);
    RIPS_CHECK(again.kind == IdsLineKind::kAlert && again.alert == alert,
               "the line handed on is another alert");
  }
}

// A directory of this process, and a log in it.
struct Log {
  Log() { RIPS_CHECK(mkdtemp(directory.data()) != nullptr, directory.c_str()); }
  ~Log() {
    unlink(path().c_str());
    rmdir(directory.c_str());
  }
  std::string path() const { return directory + "/log"; }
  void Write(absl::string_view bytes, int flags) const {
    const int fd = open(path().c_str(), O_WRONLY | O_CREAT | flags, 0600);
    RIPS_CHECK(write(fd, bytes.data(), bytes.size()) == static_cast<ssize_t>(bytes.size()),
               "no room for the input");
    close(fd);
  }

  std::string directory =
      absl::StrCat(access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp", "/rips-ids-fuzz-XXXXXX");
};

void ReadAll(LogTail& tail, std::vector<std::string>& lines) {
  while (tail.Read(0, [&](absl::string_view line) { lines.emplace_back(line); })) {
  }
}

void Tail(absl::string_view bytes) {
  static const Log log;
  log.Write(bytes, O_TRUNC);
  LogTail whole(log.path(), LogPosition(), kLimits);
  std::vector<std::string> expected;
  ReadAll(whole, expected);
  for (const std::string& line : expected) ParseLine(line);

  const size_t half = bytes.size() / 2;
  log.Write(bytes.substr(0, half), O_TRUNC);
  LogTail first(log.path(), LogPosition(), kLimits);
  std::vector<std::string> lines;
  ReadAll(first, lines);
  log.Write(bytes.substr(half), O_APPEND);
  LogTail second(log.path(), first.position(), kLimits);
  ReadAll(second, lines);
  RIPS_CHECK(second.counters().gaps == 0, "the place was not found again");
  // A hole that ends where reading stops looks like the middle of a line afterwards.
  if (bytes.find('\0') != absl::string_view::npos) return;
  RIPS_CHECK(lines == expected, "lines differ when reading goes on in another process");
}

}  // namespace
}  // namespace rips::sensor

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace rips::sensor;  // One translation unit, nothing else in it.
  if (size > 100'000) return 0;  // Larger inputs find nothing new, slowly.
  const absl::string_view bytes(reinterpret_cast<const char*>(data), size);
  const auto offsets = DecodeLogOffsets(bytes);
  if (offsets.ok()) {
    const auto again = DecodeLogOffsets(EncodeLogOffsets(*offsets));
    RIPS_CHECK(again.ok() && *again == *offsets, "positions changed on their way");
  }
  ParseLine(bytes);
  Tail(bytes);
  return 0;
}
