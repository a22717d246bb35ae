#include "sensor_agent/wire/rtps_parser.h"

#include <algorithm>
#include <array>
#include <optional>

namespace rips::wire {

namespace {

constexpr size_t kPrefixBytes = 12;
constexpr size_t kEntityBytes = 4;
constexpr size_t kSubmessageHeaderBytes = 4;
constexpr uint8_t kProtocolMajor = 2;
constexpr std::array<uint8_t, kEntityBytes> kNoEntity = {0, 0, 0, 0};
constexpr std::array<uint8_t, kEntityBytes> kParticipantWriter = {0x00, 0x01, 0x00, 0xc2};

// Submessage kinds, §9.4.5.1.1 and DDS Security 1.1 §7.3.6.2.
enum : uint8_t {
  kPad = 0x01,
  kHeartbeat = 0x07,
  kGap = 0x08,
  kInfoTimestamp = 0x09,
  kInfoSource = 0x0c,
  kData = 0x15,
  kDataFrag = 0x16,
  kSecureBody = 0x30,
  kSecurePrefix = 0x31,
  kSecurePostfix = 0x32,
  kSecureRtpsPrefix = 0x33,
  kSecureRtpsPostfix = 0x34,
};

// Bytes of a submessage's fixed part, after its header.
constexpr size_t kDataBytes = 20;
constexpr size_t kDataFragBytes = 32;
constexpr size_t kHeartbeatBytes = 28;
constexpr size_t kGapBytes = 28;  // with the base of its list and the number of its bits
constexpr size_t kInfoSourceBytes = 20;
// Flags of DATA and DATA_FRAG.
constexpr uint8_t kInlineQos = 0x02;
constexpr uint8_t kDataPayload = 0x04;
// §9.4.2.11
constexpr size_t kParameterHeaderBytes = 4;
constexpr uint16_t kSentinel = 1;

// Reads of a submessage's body; the caller has checked its length.
class Body {
 public:
  Body(absl::string_view bytes, bool little_endian)
      : bytes_(bytes), little_endian_(little_endian) {}

  uint8_t Octet(size_t at) const { return static_cast<uint8_t>(bytes_[at]); }
  uint16_t U16(size_t at) const {
    const uint8_t low = Octet(little_endian_ ? at : at + 1);
    const uint8_t high = Octet(little_endian_ ? at + 1 : at);
    return static_cast<uint16_t>(high * 256 + low);
  }
  uint32_t U32(size_t at) const {
    uint32_t value = 0;
    for (size_t i = 0; i < 4; ++i) {
      const size_t from = little_endian_ ? at + 3 - i : at + i;
      value = (value << 8) | Octet(from);
    }
    return value;
  }
  // §9.4.2.5: a signed high half, then the low half; in either byte order.
  int64_t Sequence(size_t at) const {
    return static_cast<int64_t>((uint64_t{U32(at)} << 32) | U32(at + 4));
  }
  bool Zero(size_t at, size_t count) const {
    const absl::string_view part = bytes_.substr(at, count);
    return std::all_of(part.begin(), part.end(), [](char c) { return c == 0; });
  }
  // Entity ids and prefixes are octets, the same in both byte orders.
  size_t size() const { return bytes_.size(); }
  absl::string_view From(size_t at) const { return bytes_.substr(at); }
  template <typename To>
  void Copy(size_t at, size_t count, To to) const {
    std::copy(bytes_.begin() + static_cast<ptrdiff_t>(at),
              bytes_.begin() + static_cast<ptrdiff_t>(at + count), to);
  }

 private:
  absl::string_view bytes_;
  bool little_endian_;
};

bool IsSecure(uint8_t kind) { return kind >= kSecureBody && kind <= kSecureRtpsPostfix; }

// A GAP that is shorter, or makes no sense, is passed over: some receivers go on behind it.
size_t FixedBytes(uint8_t kind, size_t length) {
  switch (kind) {
    case kData:
      return kDataBytes;
    case kDataFrag:
      return kDataFragBytes;
    case kHeartbeat:
      return kHeartbeatBytes;
    case kGap:
      return length < kGapBytes ? 0 : kGapBytes;
    case kInfoSource:
      return kInfoSourceBytes;
    default:
      return 0;
  }
}

// Where the list of parameters that begins at `at` ends; nullopt if it does not end in what is at
// hand.
std::optional<size_t> EndOfParameters(const Body& body, size_t at) {
  while (at + kParameterHeaderBytes <= body.size()) {
    const bool last = body.U16(at) == kSentinel;
    at += kParameterHeaderBytes;
    if (last) return at;
    at += body.U16(at - 2);
  }
  return std::nullopt;
}

// Of DATA and DATA_FRAG: sets what `submessage` says of its content. `body` is what is at hand of
// `length` bytes.
void FindContent(uint8_t kind, uint8_t flags, const Body& body, size_t length,
                 RtpsSubmessage& submessage) {
  // Of DATA without this flag nothing but a key follows. DATA_FRAG has no such flag.
  if (kind == kData && (flags & kDataPayload) == 0) return;
  // The offset counts from behind itself.
  std::optional<size_t> at = 4 + size_t{body.U16(2)};
  if ((flags & kInlineQos) != 0) at = EndOfParameters(body, *at);
  if (!at.has_value() || *at > length || *at > body.size()) {
    submessage.content_unknown = true;
    return;
  }
  submessage.content = body.From(*at);
  size_t size = length - *at;
  if (kind == kDataFrag) {
    submessage.fragment = body.U32(20);
    size = std::min<size_t>(size, body.U16(26));
  }
  submessage.content = submessage.content.substr(0, size);
  submessage.content_size = static_cast<uint32_t>(size);
}

// Sets kind and numbers of `submessage`. False if they make no sense.
bool TakeNumbers(uint8_t kind, const Body& body, RtpsSubmessage& submessage) {
  switch (kind) {
    case kHeartbeat: {
      submessage.kind = RtpsSubmessage::Kind::kHeartbeat;
      const int64_t first = body.Sequence(8);
      const int64_t last = body.Sequence(16);
      if (last < 0) return false;
      submessage.sequence = static_cast<uint64_t>(last);
      submessage.dropped = static_cast<uint64_t>(std::max<int64_t>(first, 1) - 1);
      return true;
    }
    case kGap: {
      submessage.kind = RtpsSubmessage::Kind::kGap;
      // The first of the list ends what is certainly left out.
      const int64_t base = body.Sequence(16);
      if (body.Sequence(8) < 1 || base < 1) return false;
      submessage.sequence = submessage.dropped = static_cast<uint64_t>(base - 1);
      return true;
    }
    default: {
      submessage.kind =
          kind == kData ? RtpsSubmessage::Kind::kData : RtpsSubmessage::Kind::kDataFrag;
      const int64_t sequence = body.Sequence(12);
      if (sequence < 1) return false;
      submessage.sequence = static_cast<uint64_t>(sequence);
      return true;
    }
  }
}

// False if it makes no sense. `source` is the prefix in force; `body` is what is at hand of
// `length` bytes, at least the fixed part.
bool TakeSubmessage(uint8_t kind, uint8_t flags, const Body& body, size_t length,
                    ros2::Guid& source, RtpsDatagram& datagram) {
  if (kind == kInfoSource) {
    body.Copy(8, kPrefixBytes, source.bytes.begin());
    return true;
  }
  RtpsSubmessage submessage;
  submessage.writer = source;
  // DATA and DATA_FRAG have flags and an offset before the reader.
  const bool data = kind == kData || kind == kDataFrag;
  const size_t entities_at = data ? 4 : 0;
  submessage.directed = !body.Zero(entities_at, kEntityBytes);
  body.Copy(entities_at + kEntityBytes, kEntityBytes,
            submessage.writer.bytes.begin() + kPrefixBytes);
  if (!TakeNumbers(kind, body, submessage)) return kind == kGap;
  if (data) FindContent(kind, flags, body, length, submessage);
  datagram.submessages.push_back(submessage);
  return true;
}

// Walks the submessages from kRtpsHeaderBytes on.
void TakeSubmessages(absl::string_view bytes, size_t size, RtpsDatagram& datagram) {
  ros2::Guid source = datagram.sender;
  size_t at = kRtpsHeaderBytes;
  while (at < size) {
    if (at + kSubmessageHeaderBytes > bytes.size()) {
      // Its header is not at hand, or there is no room for one.
      datagram.cut = bytes.size() < size;
      datagram.malformed = at + kSubmessageHeaderBytes > size;
      return;
    }
    const auto kind = static_cast<uint8_t>(bytes[at]);
    const auto flags = static_cast<uint8_t>(bytes[at + 1]);
    const bool little_endian = (flags & 1) != 0;
    const auto low = static_cast<uint8_t>(bytes[at + (little_endian ? 2 : 3)]);
    const auto high = static_cast<uint8_t>(bytes[at + (little_endian ? 3 : 2)]);
    at += kSubmessageHeaderBytes;
    size_t length = size_t{high} * 256 + low;
    // §9.4.5.1.3: zero = to the end of the datagram, but for the two kinds that may be empty.
    if (length == 0 && kind != kPad && kind != kInfoTimestamp) length = size - at;
    const size_t fixed = FixedBytes(kind, length);
    if (length > size - at || length < fixed) {
      datagram.malformed = true;
      return;
    }
    if (IsSecure(kind)) datagram.secured = true;
    if (fixed > 0) {
      if (fixed > bytes.size() - at) {
        datagram.cut = true;
        return;
      }
      const Body body(bytes.substr(at, length), little_endian);
      if (!TakeSubmessage(kind, flags, body, length, source, datagram)) {
        datagram.malformed = true;
        return;
      }
    }
    at += length;
  }
}

}  // namespace

bool ParseRtps(absl::string_view bytes, size_t size, RtpsDatagram& datagram) {
  datagram.submessages.clear();
  datagram.secured = datagram.malformed = datagram.cut = false;
  if (bytes.size() < kRtpsHeaderBytes || size < bytes.size()) return false;
  const absl::string_view marker = bytes.substr(0, 4);
  if (marker != "RTPS" && marker != "RTPX") return false;
  if (static_cast<uint8_t>(bytes[4]) != kProtocolMajor) return false;
  datagram.vendor =
      static_cast<uint16_t>(static_cast<uint8_t>(bytes[6]) * 256 + static_cast<uint8_t>(bytes[7]));
  datagram.sender = ros2::Guid{};
  std::copy(bytes.begin() + 8, bytes.begin() + kRtpsHeaderBytes, datagram.sender.bytes.begin());
  if (marker == "RTPX") {
    datagram.secured = true;
  } else {
    TakeSubmessages(bytes, size, datagram);
  }
  return true;
}

EntityClass ClassOf(const ros2::Guid& entity) {
  switch (entity.bytes.back() & 0xc0) {
    case 0x00:
      return EntityClass::kUser;
    case 0xc0:
      return EntityClass::kBuiltin;
    default:
      return EntityClass::kVendor;
  }
}

bool IsParticipantWriter(const ros2::Guid& writer) {
  return std::equal(kParticipantWriter.begin(), kParticipantWriter.end(),
                    writer.bytes.begin() + kPrefixBytes);
}

bool HasKeys(const ros2::Guid& writer) { return writer.bytes.back() == 0x02; }

bool NamesNoEntity(const ros2::Guid& guid) {
  return std::equal(kNoEntity.begin(), kNoEntity.end(), guid.bytes.begin() + kPrefixBytes);
}

}  // namespace rips::wire
