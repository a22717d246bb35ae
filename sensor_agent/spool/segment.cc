#include "sensor_agent/spool/segment.h"

#include <array>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_format.h"
#include "services/base/check.h"

namespace rips::sensor {

namespace {

constexpr absl::string_view kSegmentMagic("RIPSSPL\x01", 8);
constexpr absl::string_view kFrameMagic("RSPF", 4);
constexpr absl::string_view kNameEnd = ".seg";
constexpr size_t kNameBytes = 16 + 1 + 2 * kIncarnationBytes + 1 + 1 + 1 + 16 + kNameEnd.size();

void AppendNumber(uint64_t number, size_t bytes, std::string* out) {
  for (size_t i = 0; i < bytes; ++i) out->push_back(static_cast<char>(number >> (8 * i)));
}

uint64_t NumberAt(absl::string_view bytes, size_t at, size_t count) {
  uint64_t number = 0;
  for (size_t i = count; i > 0; --i) {
    number = number << 8 | static_cast<uint8_t>(bytes[at + i - 1]);
  }
  return number;
}

std::optional<uint64_t> ParseHex(absl::string_view text) {
  uint64_t number = 0;
  for (const char c : text) {
    const bool digit = c >= '0' && c <= '9';
    if (!digit && (c < 'a' || c > 'f')) return std::nullopt;
    number = number << 4 | static_cast<uint64_t>(digit ? c - '0' : c - 'a' + 10);
  }
  return number;
}

}  // namespace

uint32_t Crc32c(uint32_t crc, absl::string_view bytes) {
  static constexpr std::array<uint32_t, 256> kTable = [] {
    std::array<uint32_t, 256> table{};
    for (uint32_t i = 0; i < 256; ++i) {
      uint32_t value = i;
      for (int bit = 0; bit < 8; ++bit) value = (value >> 1) ^ ((value & 1) ? 0x82F63B78u : 0);
      table[i] = value;
    }
    return table;
  }();
  crc = ~crc;
  for (const char c : bytes) crc = (crc >> 8) ^ kTable[(crc ^ static_cast<uint8_t>(c)) & 0xFF];
  return ~crc;
}

// --- Header: magic 8, index 8, first sequence 8, incarnation 16, lane 4, boot id 16, clock 8,
// reserved 4, checksum 4.

std::string EncodeSegmentHeader(const SegmentHeader& header) {
  RIPS_CHECK(header.stream.incarnation.size() == kIncarnationBytes, "incarnation");
  RIPS_CHECK(header.boot_id.size() == kBootIdBytes, "boot id");
  std::string bytes(kSegmentMagic);
  AppendNumber(header.index, 8, &bytes);
  AppendNumber(header.first_sequence, 8, &bytes);
  bytes += header.stream.incarnation;
  AppendNumber(header.stream.lane == Lane::kControl ? 1 : 2, 4, &bytes);
  bytes += header.boot_id;
  AppendNumber(static_cast<uint64_t>(header.unix_minus_boottime_ns), 8, &bytes);
  AppendNumber(0, 4, &bytes);
  AppendNumber(Crc32c(0, bytes), 4, &bytes);
  return bytes;
}

absl::StatusOr<SegmentHeader> DecodeSegmentHeader(absl::string_view bytes) {
  if (bytes.size() < kSegmentHeaderBytes) return absl::DataLossError("the header is cut");
  bytes = bytes.substr(0, kSegmentHeaderBytes);
  if (NumberAt(bytes, kSegmentHeaderBytes - 4, 4) !=
      Crc32c(0, bytes.substr(0, kSegmentHeaderBytes - 4))) {
    return absl::DataLossError("the header's checksum is wrong");
  }
  const uint64_t lane = NumberAt(bytes, 40, 4);
  if (bytes.substr(0, 8) != kSegmentMagic || lane < 1 || lane > 2) {
    return absl::DataLossError("a header of another version");
  }
  return SegmentHeader{
      .stream = {.incarnation = std::string(bytes.substr(24, kIncarnationBytes)),
                 .lane = lane == 1 ? Lane::kControl : Lane::kMessages},
      .index = NumberAt(bytes, 8, 8),
      .first_sequence = NumberAt(bytes, 16, 8),
      .boot_id = std::string(bytes.substr(44, kBootIdBytes)),
      .unix_minus_boottime_ns = static_cast<int64_t>(NumberAt(bytes, 60, 8)),
  };
}

std::string SegmentName(const SegmentHeader& header) {
  return absl::StrFormat(
      "%016x-%s-%c-%016x%s", header.index, absl::BytesToHexString(header.stream.incarnation),
      header.stream.lane == Lane::kControl ? 'c' : 'm', header.first_sequence, kNameEnd);
}

std::optional<SegmentHeader> ParseSegmentName(absl::string_view name) {
  if (name.size() != kNameBytes || name.substr(kNameBytes - kNameEnd.size()) != kNameEnd) {
    return std::nullopt;
  }
  if (name[16] != '-' || name[49] != '-' || name[51] != '-') return std::nullopt;
  const absl::string_view incarnation = name.substr(17, 2 * kIncarnationBytes);
  const std::optional<uint64_t> index = ParseHex(name.substr(0, 16));
  const std::optional<uint64_t> first = ParseHex(name.substr(52, 16));
  if (!index.has_value() || !first.has_value() || !ParseHex(incarnation).has_value()) {
    return std::nullopt;
  }
  if (name[50] != 'c' && name[50] != 'm') return std::nullopt;
  if (*first == 0 || *first > kSequenceMax) return std::nullopt;
  return SegmentHeader{.stream = {.incarnation = absl::HexStringToBytes(incarnation),
                                  .lane = name[50] == 'c' ? Lane::kControl : Lane::kMessages},
                       .index = *index,
                       .first_sequence = *first};
}

uint32_t FrameSeed(const SegmentHeader& header) {
  std::string bytes = header.stream.incarnation;
  AppendNumber(header.stream.lane == Lane::kControl ? 1 : 2, 4, &bytes);
  AppendNumber(header.index, 8, &bytes);
  return Crc32c(0, bytes);
}

// --- Frame: magic 4, length 4, first sequence 8, oldest 8, count 4, payload's checksum 4, checksum
// of all that 4, payload.

void AppendFrame(uint32_t seed, const Frame& frame, std::string* out) {
  RIPS_CHECK(frame.payload.size() <= kFrameBytesMax, "frame too long");
  RIPS_CHECK(frame.count <= kFrameObservationsMax, "too many observations in a frame");
  const size_t begin = out->size();
  out->append(kFrameMagic.data(), kFrameMagic.size());
  AppendNumber(frame.payload.size(), 4, out);
  AppendNumber(frame.first_sequence, 8, out);
  AppendNumber(static_cast<uint64_t>(frame.oldest_ns), 8, out);
  AppendNumber(frame.count, 4, out);
  AppendNumber(Crc32c(seed, frame.payload), 4, out);
  AppendNumber(Crc32c(seed, absl::string_view(*out).substr(begin)), 4, out);
  out->append(frame.payload.data(), frame.payload.size());
}

absl::StatusOr<Frame> DecodeFrame(uint32_t seed, absl::string_view bytes) {
  if (bytes.size() < kFrameHeaderBytes || bytes.substr(0, 4) != kFrameMagic) {
    return absl::DataLossError("no frame");
  }
  if (NumberAt(bytes, kFrameHeaderBytes - 4, 4) !=
      Crc32c(seed, bytes.substr(0, kFrameHeaderBytes - 4))) {
    return absl::DataLossError("the checksum of a frame's header is wrong");
  }
  const size_t length = NumberAt(bytes, 4, 4);
  const Frame frame{.first_sequence = NumberAt(bytes, 8, 8),
                    .count = static_cast<uint32_t>(NumberAt(bytes, 24, 4)),
                    .oldest_ns = static_cast<int64_t>(NumberAt(bytes, 16, 8)),
                    .payload = bytes.substr(kFrameHeaderBytes, length)};
  if (length > kFrameBytesMax || frame.count > kFrameObservationsMax || frame.first_sequence == 0 ||
      frame.first_sequence > kSequenceMax) {
    return absl::DataLossError("a frame past its limits");
  }
  if (frame.payload.size() < length) return absl::DataLossError("a frame is cut");
  if (Crc32c(seed, frame.payload) != NumberAt(bytes, 28, 4)) {
    return absl::DataLossError("the checksum of a frame is wrong");
  }
  return frame;
}

FrameScanner::FrameScanner(uint32_t seed, absl::string_view file)
    : seed_(seed), file_(file), at_(kSegmentHeaderBytes) {}

std::optional<Frame> FrameScanner::Next() {
  while (at_ < file_.size()) {
    absl::StatusOr<Frame> frame = DecodeFrame(seed_, file_.substr(at_));
    if (frame.ok()) {
      frame->offset = at_;
      at_ += kFrameHeaderBytes + frame->payload.size();
      return *frame;
    }
    const size_t next = std::min(file_.find(kFrameMagic, at_ + 1), file_.size());
    skipped_ += next - at_;
    at_ = next;
  }
  return std::nullopt;
}

}  // namespace rips::sensor
