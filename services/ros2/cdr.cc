#include "services/ros2/cdr.h"

#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/check.h"

namespace rips::ros2 {
namespace {

// DDS-XTypes 1.3 §7.6.3.1.2: representation identifiers of plain CDR, version 1.
constexpr char kCdrBigEndian = 0x00;
constexpr char kCdrLittleEndian = 0x01;

}  // namespace

CdrReader::CdrReader(absl::string_view payload, CdrLimits limits) : limits_(limits) {
  if (payload.size() < kCdrHeaderBytes) {
    Fail(absl::StrCat("payload of ", payload.size(), " bytes has no encapsulation header"));
    return;
  }
  if (payload[0] != 0 || (payload[1] != kCdrBigEndian && payload[1] != kCdrLittleEndian)) {
    Fail(absl::StrCat(
        "encapsulation 0x", absl::Hex(static_cast<uint8_t>(payload[0]), absl::kZeroPad2),
        absl::Hex(static_cast<uint8_t>(payload[1]), absl::kZeroPad2), " is not plain CDR"));
    return;
  }
  little_endian_ = payload[1] == kCdrLittleEndian;
  body_ = payload.substr(kCdrHeaderBytes);
}

void CdrReader::Fail(absl::string_view why) {
  if (!status_.ok()) return;
  status_ = absl::DataLossError(why);
}

bool CdrReader::Consume(size_t size, size_t align, absl::string_view& bytes) {
  if (!status_.ok()) return false;
  // `at_` never passes the body's size, so neither sum can wrap.
  const size_t start = (at_ + align - 1) / align * align;
  if (start > body_.size() || body_.size() - start < size) {
    Fail(absl::StrCat("truncated: ", size, " bytes at offset ", start, " of a body of ",
                      body_.size()));
    return false;
  }
  bytes = body_.substr(start, size);
  at_ = start + size;
  return true;
}

uint64_t CdrReader::Number(size_t size) {
  absl::string_view bytes;
  if (!Consume(size, size, bytes)) return 0;
  uint64_t value = 0;
  for (size_t i = 0; i < size; ++i) {
    const size_t significant_first = little_endian_ ? size - 1 - i : i;
    value = value << 8 | static_cast<uint8_t>(bytes[significant_first]);
  }
  return value;
}

bool CdrReader::Bool() {
  const uint8_t value = U8();
  if (value > 1) Fail(absl::StrCat("a bool holds ", value));
  return status_.ok() && value == 1;
}

uint8_t CdrReader::U8() { return static_cast<uint8_t>(Number(1)); }
uint16_t CdrReader::U16() { return static_cast<uint16_t>(Number(2)); }
uint32_t CdrReader::U32() { return static_cast<uint32_t>(Number(4)); }
uint64_t CdrReader::U64() { return Number(8); }
int64_t CdrReader::I64() { return static_cast<int64_t>(Number(8)); }

double CdrReader::F64() {
  const uint64_t bits = Number(8);
  double value = 0;
  static_assert(sizeof(value) == sizeof(bits));
  std::memcpy(&value, &bits, sizeof(value));
  return value;
}

absl::string_view CdrReader::String() {
  const uint32_t length = U32();
  if (!status_.ok() || length == 0) return {};
  if (length - 1 > limits_.string_bytes) {
    Fail(absl::StrCat("string of ", length - 1, " bytes exceeds limit ", limits_.string_bytes));
    return {};
  }
  absl::string_view bytes;
  if (!Consume(length, 1, bytes)) return {};
  if (bytes.find('\0') != length - 1) {
    Fail(absl::StrCat("string of length ", length, " does not end at its first NUL"));
    return {};
  }
  return bytes.substr(0, length - 1);
}

absl::string_view CdrReader::Octets(size_t size) {
  absl::string_view bytes;
  if (!Consume(size, 1, bytes)) return {};
  return bytes;
}

uint32_t CdrReader::Count(size_t element_bytes_min, size_t limit) {
  RIPS_CHECK(element_bytes_min >= 1, "an element has at least one byte");
  const uint32_t count = U32();
  if (!status_.ok()) return 0;
  if (count > limit) {
    Fail(absl::StrCat("sequence of ", count, " elements exceeds limit ", limit));
    return 0;
  }
  if (count > remaining() / element_bytes_min) {
    Fail(absl::StrCat("truncated: ", count, " elements in ", remaining(), " bytes"));
    return 0;
  }
  return count;
}

absl::Status CdrReader::Finish() const {
  if (!status_.ok()) return status_;
  if (remaining() > kCdrPaddingBytesMax) {
    return absl::DataLossError(absl::StrCat(remaining(), " bytes follow the last member"));
  }
  return absl::OkStatus();
}

CdrWriter::CdrWriter(ByteOrder order) : order_(order), payload_(kCdrHeaderBytes, '\0') {
  payload_[1] = order == ByteOrder::kLittle ? kCdrLittleEndian : kCdrBigEndian;
}

void CdrWriter::Number(uint64_t value, size_t size) {
  // The header is 4 bytes and alignment counts from behind it.
  while ((payload_.size() - kCdrHeaderBytes) % size != 0) payload_.push_back('\0');
  for (size_t i = 0; i < size; ++i) {
    const size_t significance = order_ == ByteOrder::kLittle ? i : size - 1 - i;
    payload_.push_back(static_cast<char>(value >> (8 * significance) & 0xff));
  }
}

void CdrWriter::U8(uint8_t value) { Number(value, 1); }
void CdrWriter::U16(uint16_t value) { Number(value, 2); }
void CdrWriter::U32(uint32_t value) { Number(value, 4); }
void CdrWriter::U64(uint64_t value) { Number(value, 8); }

void CdrWriter::F64(double value) {
  uint64_t bits = 0;
  std::memcpy(&bits, &value, sizeof(bits));
  Number(bits, 8);
}

void CdrWriter::String(absl::string_view value) {
  RIPS_CHECK(value.size() < UINT32_MAX, "a CDR string is shorter than 4 GiB");
  RIPS_CHECK(value.find('\0') == absl::string_view::npos, "a CDR string holds no NUL");
  U32(static_cast<uint32_t>(value.size() + 1));
  Octets(value);
  payload_.push_back('\0');
}

void CdrWriter::Octets(absl::string_view value) { absl::StrAppend(&payload_, value); }

std::string CdrWriter::Finish() && {
  while (payload_.size() % 4 != 0) payload_.push_back('\0');
  return std::move(payload_);
}

}  // namespace rips::ros2
