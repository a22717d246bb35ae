#include "sensor_agent/ids/log_position.h"

#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"

namespace rips::sensor {

namespace {

constexpr absl::string_view kHeader = "rips ids-offsets 1";
constexpr absl::string_view kUnacknowledged = "unacknowledged ";
constexpr absl::string_view kSum = "sum ";

std::string Hex(uint64_t value) { return absl::StrCat(absl::Hex(value, absl::kZeroPad16)); }

// Only as Hex writes it.
bool FromHex(absl::string_view text, uint64_t& out) {
  return absl::SimpleHexAtoi(text, &out) && Hex(out) == text;
}

absl::Status Corrupt(absl::string_view why) {
  return absl::DataLossError(absl::StrCat("not a file of log positions: ", why));
}

// `log DEVICE INODE OFFSET FINGERPRINT PATH`
bool TakeLog(absl::string_view line, LogOffsets& offsets) {
  const std::vector<absl::string_view> parts = absl::StrSplit(line, absl::MaxSplits(' ', 5));
  LogPosition position;
  std::string path;
  if (parts.size() != 6 || parts[0] != "log") return false;
  if (!absl::SimpleAtoi(parts[1], &position.device) ||
      !absl::SimpleAtoi(parts[2], &position.inode) ||
      !absl::SimpleAtoi(parts[3], &position.offset) || !FromHex(parts[4], position.fingerprint)) {
    return false;
  }
  if (!absl::CUnescape(parts[5], &path)) return false;
  return offsets.logs.emplace(std::move(path), position).second;
}

}  // namespace

uint64_t Fingerprint(absl::string_view bytes) {
  uint64_t hash = 0xcbf29ce484222325;
  for (const char byte : bytes) {
    hash ^= static_cast<uint8_t>(byte);
    hash *= 0x100000001b3;
  }
  return hash;
}

std::string EncodeLogOffsets(const LogOffsets& offsets) {
  std::string text = absl::StrCat(kHeader, "\n", kUnacknowledged, offsets.unacknowledged, "\n");
  for (const auto& [path, position] : offsets.logs) {
    absl::StrAppend(&text, "log ", position.device, " ", position.inode, " ", position.offset, " ",
                    Hex(position.fingerprint), " ", absl::CEscape(path), "\n");
  }
  return absl::StrCat(text, kSum, Hex(Fingerprint(text)), "\n");
}

absl::StatusOr<LogOffsets> DecodeLogOffsets(absl::string_view text) {
  const size_t sum = text.rfind(kSum);
  uint64_t checksum = 0;
  if (sum == absl::string_view::npos) return Corrupt("no checksum");
  absl::string_view last = text.substr(sum + kSum.size());
  if (!absl::ConsumeSuffix(&last, "\n") || !FromHex(last, checksum) ||
      checksum != Fingerprint(text.substr(0, sum))) {
    return Corrupt("the checksum is wrong");
  }
  std::vector<absl::string_view> lines = absl::StrSplit(text.substr(0, sum), '\n');
  if (lines.size() < 3 || lines[0] != kHeader || !lines.back().empty()) {
    return Corrupt(absl::StrCat("the first line is not `", kHeader, "`"));
  }
  lines.pop_back();
  LogOffsets offsets;
  if (!absl::ConsumePrefix(&lines[1], kUnacknowledged) ||
      !absl::SimpleAtoi(lines[1], &offsets.unacknowledged)) {
    return Corrupt("no number of unacknowledged alerts");
  }
  for (size_t i = 2; i < lines.size(); ++i) {
    if (!TakeLog(lines[i], offsets)) return Corrupt(absl::StrCat("line ", i + 1));
  }
  return offsets;
}

}  // namespace rips::sensor
