// RTPS datagrams for tests, built by hand. Test code only.
#ifndef RIPS_SENSOR_AGENT_WIRE_RTPS_BYTES_H_
#define RIPS_SENSOR_AGENT_WIRE_RTPS_BYTES_H_

#include <cstddef>
#include <cstdint>
#include <string>

#include "services/ros2/guid.h"

namespace rips::wire {

enum class ByteOrder { kBig, kLittle };

class RtpsBytes {
 public:
  explicit RtpsBytes(const ros2::Guid& sender, ByteOrder order = ByteOrder::kLittle)
      : order_(order) {
    bytes_ = std::string("RTPS\x02\x01\x01\x10", 8) + sender.ToBytes().substr(0, 12);
  }

  // `body` as it is; a length of -1 = that of the body. `flags` but for the byte order.
  RtpsBytes& Submessage(uint8_t kind, const std::string& body, int length = -1, int flags = 0) {
    bytes_ += static_cast<char>(kind);
    bytes_ += static_cast<char>(flags | (order_ == ByteOrder::kLittle ? 1 : 0));
    bytes_ += U16(static_cast<uint16_t>(length < 0 ? body.size() : static_cast<size_t>(length)));
    bytes_ += body;
    return *this;
  }
  RtpsBytes& Data(const ros2::Guid& writer, int64_t sequence, uint32_t reader = 0,
                  const std::string& payload = "data") {
    return Submessage(
        0x15, U16(0) + U16(16) + Entity(reader) + EntityOf(writer) + Sequence(sequence) + payload);
  }
  // DATA with a payload, behind `qos` if that is not empty (Parameter).
  RtpsBytes& Sample(const ros2::Guid& writer, int64_t sequence, const std::string& payload,
                    const std::string& qos = "") {
    return Submessage(
        0x15, U16(0) + U16(16) + Entity(0) + EntityOf(writer) + Sequence(sequence) + qos + payload,
        -1, qos.empty() ? 4 : 6);
  }
  // One of inline QoS; id 1 ends it.
  std::string Parameter(uint16_t id, const std::string& value) const {
    return U16(id) + U16(static_cast<uint16_t>(value.size())) + value;
  }
  RtpsBytes& DataFrag(const ros2::Guid& writer, int64_t sequence, uint32_t reader = 0,
                      const std::string& fragment = "fragment", uint32_t number = 1,
                      uint16_t size = 1344) {
    return Submessage(0x16, U16(0) + U16(28) + Entity(reader) + EntityOf(writer) +
                                Sequence(sequence) + U32(number) + U16(1) + U16(size) + U32(4000) +
                                fragment);
  }
  // `start` to `base` - 1 and what the list of `bits` bits names will not come.
  RtpsBytes& Gap(const ros2::Guid& writer, int64_t start, int64_t base, uint32_t bits = 0) {
    return Submessage(0x08, Entity(0) + EntityOf(writer) + Sequence(start) + Sequence(base) +
                                U32(bits) + std::string(bits / 8, '\xff'));
  }
  RtpsBytes& Heartbeat(const ros2::Guid& writer, int64_t first, int64_t last, uint32_t reader = 0) {
    return Submessage(
        0x07, Entity(reader) + EntityOf(writer) + Sequence(first) + Sequence(last) + U32(1));
  }
  RtpsBytes& InfoTimestamp() { return Submessage(0x09, std::string(8, '\x42')); }
  RtpsBytes& InfoSource(const ros2::Guid& source) {
    return Submessage(0x0c,
                      U32(0) + std::string("\x02\x01\x01\x0f", 4) + source.ToBytes().substr(0, 12));
  }
  RtpsBytes& Raw(const std::string& bytes) {
    bytes_ += bytes;
    return *this;
  }

  const std::string& bytes() const { return bytes_; }

 private:
  std::string U16(uint16_t value) const {
    return Ordered(std::string{static_cast<char>(value >> 8), static_cast<char>(value)});
  }
  std::string U32(uint32_t value) const {
    std::string big;
    for (int shift = 24; shift >= 0; shift -= 8) big += static_cast<char>(value >> shift);
    return Ordered(std::move(big));
  }
  std::string Sequence(int64_t value) const {
    const auto bits = static_cast<uint64_t>(value);
    return U32(static_cast<uint32_t>(bits >> 32)) + U32(static_cast<uint32_t>(bits));
  }
  std::string Ordered(std::string big) const {
    return order_ == ByteOrder::kBig ? big : std::string(big.rbegin(), big.rend());
  }
  // Octets, the same in both orders.
  static std::string Entity(uint32_t id) {
    std::string octets;
    for (int shift = 24; shift >= 0; shift -= 8) octets += static_cast<char>(id >> shift);
    return octets;
  }
  static std::string EntityOf(const ros2::Guid& guid) { return guid.ToBytes().substr(12); }

  ByteOrder order_;
  std::string bytes_;
};

// "01100000.00000000.000000PP.EEEEEEEE"
inline ros2::Guid TestGuid(uint8_t participant, uint32_t entity) {
  ros2::Guid guid;
  guid.bytes = {0x01, 0x10};
  guid.bytes[11] = participant;
  for (int i = 0; i < 4; ++i) guid.bytes[12 + i] = static_cast<uint8_t>(entity >> (24 - 8 * i));
  return guid;
}

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_RTPS_BYTES_H_
