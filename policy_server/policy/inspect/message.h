// What an inspection is told of one message.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_MESSAGE_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_MESSAGE_H_

#include <cstdint>
#include <memory>
#include <string>

#include "absl/strings/string_view.h"

namespace rips::inspect {

// Views: valid during the call they are passed to.
struct Message {
  // Whose message it is. Blamed when a plugin fails on it; not told to plugins.
  absl::string_view robot;
  // As ROS users write them: `/camera/image`, `sensor_msgs/msg/Image`, `/ns/node` (empty if the
  // writer is not attributed to a node).
  absl::string_view topic;
  absl::string_view type;
  absl::string_view sender;
  // The writer's GUID, 32 hex digits.
  absl::string_view writer_hex;
  int64_t time_unix_ns = 0;
  // As received: 4-byte CDR header first. May be only the beginning.
  absl::string_view payload;
  // Of the whole payload on the robot.
  uint32_t size_bytes = 0;
  // False if the payload was not sent: every inspection is then unscanned.
  bool available = false;
};

// The same, owning its texts and keeping its payload alive: what waits in a queue.
struct OwnedMessage {
  std::string robot;
  std::string topic;
  std::string type;
  std::string sender;
  std::string writer_hex;
  int64_t time_unix_ns = 0;
  // Lives as long as `owner`, which may be null for one that lives longer than this: payloads are
  // not copied, so what waits costs no memory but its sender's.
  absl::string_view payload;
  std::shared_ptr<const void> owner;
  uint32_t size_bytes = 0;
  bool available = false;

  // Valid as long as this is neither changed nor moved.
  Message View() const {
    return {.robot = robot,
            .topic = topic,
            .type = type,
            .sender = sender,
            .writer_hex = writer_hex,
            .time_unix_ns = time_unix_ns,
            .payload = payload,
            .size_bytes = size_bytes,
            .available = available};
  }
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_MESSAGE_H_
