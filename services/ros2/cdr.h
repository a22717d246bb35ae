// Plain CDR as ROS 2 uses it: XCDR version 1, PLAIN_CDR (DDS-XTypes 1.3 §7.4.2), behind the 4-byte
// encapsulation header of DDSI-RTPS 2.5 §10.2. A "payload" is header and body together, as it is
// on the wire. No thread rules: plain values.
#ifndef RIPS_SERVICES_ROS2_CDR_H_
#define RIPS_SERVICES_ROS2_CDR_H_

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips::ros2 {

inline constexpr size_t kCdrHeaderBytes = 4;
// A body is padded to a multiple of 4, so up to 3 bytes may follow the last member.
inline constexpr size_t kCdrPaddingBytesMax = 3;
// The shortest string on the wire: its length alone.
inline constexpr size_t kCdrStringBytesMin = 4;

struct CdrLimits {
  // Longest string or octet sequence accepted, in bytes without the terminator.
  size_t string_bytes = 1 << 20;
};

// Reads members in order. The first failure sticks: from then on every read returns zero or
// empty and status() says what was wrong, so a decoder may read on and ask once at the end.
// Nothing is allocated for a length that the payload cannot hold.
class CdrReader {
 public:
  // `payload` must outlive the reader and the views it returns. A payload that is too short or
  // that is not CDR_BE or CDR_LE fails at once.
  explicit CdrReader(absl::string_view payload, CdrLimits limits = {});

  bool Bool();  // one octet; anything but 0 and 1 fails
  uint8_t U8();
  uint16_t U16();
  uint32_t U32();
  int64_t I64();
  uint64_t U64();
  double F64();
  // Length (with terminator), then bytes; the view ends before the terminator. A length of 0 is
  // read as the empty string, as some writers send it. A NUL within the text fails.
  absl::string_view String();
  // `size` raw octets, not aligned.
  absl::string_view Octets(size_t size);
  // A sequence length. Fails if it exceeds `limit`, or if that many elements of at least
  // `element_bytes_min` (>= 1) cannot be left in the payload.
  uint32_t Count(size_t element_bytes_min, size_t limit);

  // Records a failure of the caller's own (a value that makes no sense). The first one stays.
  void Fail(absl::string_view why);

  bool ok() const { return status_.ok(); }
  const absl::Status& status() const { return status_; }
  // Bytes not yet read.
  size_t remaining() const { return body_.size() - at_; }
  // DataLoss if a read failed or more than padding is left; else OK.
  absl::Status Finish() const;

 private:
  bool Consume(size_t size, size_t align, absl::string_view& bytes);
  uint64_t Number(size_t size);

  absl::string_view body_;
  size_t at_ = 0;
  bool little_endian_ = true;
  CdrLimits limits_;
  absl::Status status_;
};

enum class ByteOrder { kLittle, kBig };

// Writes members in order; never fails.
class CdrWriter {
 public:
  explicit CdrWriter(ByteOrder order = ByteOrder::kLittle);

  void Bool(bool value) { U8(value ? 1 : 0); }
  void U8(uint8_t value);
  void U16(uint16_t value);
  void U32(uint32_t value);
  void I64(int64_t value) { U64(static_cast<uint64_t>(value)); }
  void U64(uint64_t value);
  void F64(double value);
  // Must hold no NUL and be shorter than 4 GiB.
  void String(absl::string_view value);
  void Octets(absl::string_view value);

  // Pads to a multiple of 4 with zeros and gives the payload away; the writer is then used up.
  // The padding count in the header stays 0, as rmw_cyclonedds leaves it.
  std::string Finish() &&;

 private:
  void Number(uint64_t value, size_t size);

  ByteOrder order_;
  std::string payload_;
};

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_CDR_H_
