#include <algorithm>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/robot_sim/events.h"
#include "tests/support/robot_sim/ros_process.h"

namespace rips::robot_sim {
namespace {

// Messages leave in handfuls of this many milliseconds.
constexpr int64_t kPeriodMs = 5;
// Whether enough of them read.
constexpr absl::Duration kLook = absl::Milliseconds(20);
// A best-effort reader drops what comes before it knows the writer, who may know it earlier.
constexpr absl::Duration kMatchPause = absl::Seconds(1);
// The last message comes alone: it shows whether those before it arrived.
constexpr absl::Duration kLastPause = absl::Milliseconds(500);

absl::Status PublishMessages(const PublishCommand& command, dds::RawWriter& writer,
                             StopFlag& stop) {
  const RealClock clock;
  while (std::cmp_less(writer.MatchedReaders(), command.readers)) {
    if (stop.WaitFor(kLook)) return absl::OkStatus();
  }
  if (command.readers > 0 && stop.WaitFor(kMatchPause)) return absl::OkStatus();
  const std::string payload = absl::StrCat(std::string("\0\1\0\0", 4),
                                           std::string(static_cast<size_t>(command.bytes), 'x'));
  PrintEvent({{"event", "publishing"}, {"topic", command.topic}, {"unix_ns", clock.Now().unix_ns}});
  const int64_t start_ns = clock.Now().boottime_ns;
  int64_t sent = 0;
  bool stopped = false;
  while (!stopped && (command.count == 0 || sent < command.count - 1)) {
    stopped = stop.WaitFor(absl::Milliseconds(kPeriodMs));
    const int64_t passed_ns = clock.Now().boottime_ns - start_ns;
    int64_t due = passed_ns / kNanosPerMilli * command.rate / 1'000;
    if (command.count != 0) due = std::min(due, command.count - 1);
    for (; !stopped && sent < due; ++sent) RIPS_RETURN_IF_ERROR(writer.Write(payload));
  }
  absl::SleepFor(kLastPause);
  RIPS_RETURN_IF_ERROR(writer.Write(payload));
  ++sent;
  PrintEvent({{"event", "published"}, {"sent", sent}, {"unix_ns", clock.Now().unix_ns}});
  // Readers may still want something again.
  if (stopped) absl::SleepFor(kLastPause);
  while (!stopped) stopped = stop.WaitFor(absl::Seconds(1));
  return absl::OkStatus();
}

}  // namespace

absl::Status RunPublish(const PublishCommand& command, StopFlag& stop) {
  RIPS_RETURN_IF_ERROR(ros2::ValidateTopicName(command.topic));
  RIPS_ASSIGN_OR_RETURN(const dds::ParticipantOptions identity, Identity(command.security));
  RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const dds::Domain> domain,
                        dds::Domain::Create(command.domain));
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<RosProcess> process,
                        RosProcess::Create(domain, ros2::GidBytes::k24, identity));
  RIPS_ASSIGN_OR_RETURN(RosNode * node, process->AddNode(command.node));
  RIPS_ASSIGN_OR_RETURN(dds::RawWriter * writer,
                        node->Publish(command.topic, command.type, DefaultQos(1'000)));
  RIPS_RETURN_IF_ERROR(process->Announce());
  return PublishMessages(command, *writer, stop);
}

}  // namespace rips::robot_sim
