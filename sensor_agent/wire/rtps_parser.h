// The headers of an RTPS datagram (DDSI-RTPS 2.5 §8.3, §9.4): who wrote what to whom, and where the
// content of a sample stands. Contents and everything else are passed over unread.
#ifndef RIPS_SENSOR_AGENT_WIRE_RTPS_PARSER_H_
#define RIPS_SENSOR_AGENT_WIRE_RTPS_PARSER_H_

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/strings/string_view.h"
#include "services/ros2/guid.h"

namespace rips::wire {

struct RtpsSubmessage {
  enum class Kind { kData, kDataFrag, kHeartbeat, kGap };
  Kind kind = Kind::kData;
  // As INFO_SRC says, otherwise as the header of the datagram does.
  ros2::Guid writer;
  // It names one reader.
  bool directed = false;
  // Sequence number of DATA and DATA_FRAG, at least 1; the last one a HEARTBEAT says there is, 0 =
  // none yet; of GAP the same as `dropped`.
  uint64_t sequence = 0;
  // Of HEARTBEAT and GAP: numbers up to this one will not come (any more), at least 0.
  uint64_t dropped = 0;
  // Of DATA and DATA_FRAG: the serialized payload as far as it is at hand, of DATA_FRAG the first
  // fragment of the submessage; a view into what was parsed. Its true size, 0 = DATA without one.
  absl::string_view content;
  uint32_t content_size = 0;
  // Of DATA_FRAG, from 1; otherwise 0.
  uint32_t fragment = 0;
  // Inline QoS that could not be passed over: nothing is known of the content.
  bool content_unknown = false;

  friend bool operator==(const RtpsSubmessage&, const RtpsSubmessage&) = default;
};

struct RtpsDatagram {
  // Of the sender; the entity id is zero.
  ros2::Guid sender;
  // `0x0110` = Cyclone DDS.
  uint16_t vendor = 0;
  // Encrypted or signed, whole or in part (DDS Security 1.1 §7.3.6, or the marker RTPX).
  bool secured = false;
  // Broke off at a submessage that makes no sense; those before it count, as they do for receivers.
  bool malformed = false;
  // There are submessages beyond the bytes at hand.
  bool cut = false;
  // Those of the kinds above, in order.
  std::vector<RtpsSubmessage> submessages;

  friend bool operator==(const RtpsDatagram&, const RtpsDatagram&) = default;
};

// Bytes of the header.
inline constexpr size_t kRtpsHeaderBytes = 20;

// `bytes` are the first of a UDP payload that has `size` bytes in all, size >= bytes.size(). False
// if it is no RTPS of protocol version 2; `datagram` is then of no meaning. Otherwise `datagram` is
// overwritten; passing the same one again saves its memory.
bool ParseRtps(absl::string_view bytes, size_t size, RtpsDatagram& datagram);

// Entity kinds (DDSI-RTPS 2.5 §9.3.1.2).
enum class EntityClass { kUser, kVendor, kBuiltin };
EntityClass ClassOf(const ros2::Guid& entity);
// The writer with which every participant announces itself, entity id 000100c2.
bool IsParticipantWriter(const ros2::Guid& writer);
// A user's writer of a topic with keys (§9.3.1.2).
bool HasKeys(const ros2::Guid& writer);
// Entity id zero.
bool NamesNoEntity(const ros2::Guid& guid);

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_RTPS_PARSER_H_
