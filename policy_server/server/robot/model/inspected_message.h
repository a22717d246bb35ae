// A message whose payload is inspected.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_INSPECTED_MESSAGE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_INSPECTED_MESSAGE_H_

#include <cstdint>
#include <memory>

#include "absl/strings/string_view.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

struct InspectedMessage {
  absl::string_view topic;
  absl::string_view type;
  absl::string_view sender;
  ros2::Guid writer;
  int64_t time_unix_ns = 0;
  // Empty: it was not sent.
  absl::string_view payload;
  uint32_t size_bytes = 0;
  // Keeps what it views alive, but for `sender`.
  std::shared_ptr<const void> owner;
};

// Why an inspection was not made: no payload came, it was cut at a limit, or no answer came in
// time.
inline constexpr const char* kSkipReasons[] = {"no payload", "cut payload", "not answered"};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_INSPECTED_MESSAGE_H_
