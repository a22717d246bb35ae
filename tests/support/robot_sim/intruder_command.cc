#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/robot_sim/events.h"
#include "tests/support/robot_sim/ros_messages.h"
#include "tests/support/robot_sim/ros_process.h"

namespace rips::robot_sim {
namespace {

constexpr absl::string_view kCameraTopic = "/camera/image_raw";
constexpr absl::string_view kCommandTopic = "/cmd_vel";
constexpr absl::Duration kRoguePeriod = absl::Milliseconds(50);
constexpr absl::Duration kIdle = absl::Milliseconds(20);
// Turning on the spot: what no honest navigator of this robot asks for.
constexpr Twist kRogueTwist = {.linear_x = 0.0, .angular_z = 1.5};

void PrintFirstSample(absl::string_view topic, int64_t unix_ns) {
  PrintEvent({{"event", "first_sample"}, {"topic", std::string(topic)}, {"unix_ns", unix_ns}});
}

absl::Status PublishUntilStopped(dds::RawWriter& writer, StopFlag& stop) {
  const RealClock clock;
  bool first = true;
  do {
    const int64_t unix_ns = clock.Now().unix_ns;
    RIPS_RETURN_IF_ERROR(writer.Write(EncodeTwist(kRogueTwist), unix_ns));
    if (first) {
      PrintFirstSample(kCommandTopic, unix_ns);
      first = false;
    }
  } while (!stop.WaitFor(kRoguePeriod));
  return absl::OkStatus();
}

// Their node, if there is one, does not claim them: the list would be too long to decode.
absl::Status Flood(const dds::Participant& participant, const IntruderCommand& command,
                   StopFlag& stop) {
  std::vector<std::unique_ptr<dds::RawWriter>> writers;
  for (int64_t i = 0; i < command.writers && !stop.WaitFor(absl::ZeroDuration()); ++i) {
    const std::string topic =
        command.replies ? absl::StrCat("rr/flood_", i, "Reply") : absl::StrCat("rt/flood_", i);
    RIPS_ASSIGN_OR_RETURN(
        writers.emplace_back(),
        dds::RawWriter::Create(participant,
                               {.topic = topic, .type = "std_msgs::msg::dds_::String_"}));
  }
  PrintEvent(
      {{"event", "flooded"}, {"writers", writers.size()}, {"unix_ns", RealClock().Now().unix_ns}});
  while (!stop.WaitFor(kIdle)) {
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status RunIntruder(const IntruderCommand& command, StopFlag& stop) {
  const RealClock clock;
  std::atomic<int64_t> first_received_unix_ns{0};
  RIPS_ASSIGN_OR_RETURN(const dds::ParticipantOptions identity, Identity(command.security));
  RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const dds::Domain> domain,
                        dds::Domain::Create(command.domain));
  std::unique_ptr<RosProcess> process;
  std::unique_ptr<dds::Participant> participant;
  std::unique_ptr<RosNode> bare;
  RosNode* node = nullptr;
  if (command.anonymous) {
    RIPS_ASSIGN_OR_RETURN(participant, dds::Participant::Create(domain, identity));
    RIPS_ASSIGN_OR_RETURN(bare, RosNode::CreateBare(*participant, command.node));
    node = bare.get();
  } else {
    RIPS_ASSIGN_OR_RETURN(process, RosProcess::Create(domain, command.gid_bytes, identity));
    RIPS_ASSIGN_OR_RETURN(node, process->AddNode(command.node));
  }
  dds::RawWriter* rogue = nullptr;
  if (command.kind == IntruderKind::kRogueCmdVel) {
    RIPS_ASSIGN_OR_RETURN(rogue,
                          node->Publish(kCommandTopic, "geometry_msgs/msg/Twist", DefaultQos()));
  } else if (command.kind == IntruderKind::kUnknownNode) {
    RIPS_RETURN_IF_ERROR(node->Subscribe(kCameraTopic, "sensor_msgs/msg/Image", SensorDataQos(),
                                         [&first_received_unix_ns](const dds::RawSample& sample) {
                                           int64_t none = 0;
                                           first_received_unix_ns.compare_exchange_strong(
                                               none, sample.received.unix_ns);
                                         }));
  }
  if (!command.anonymous) {
    const int64_t unix_ns = clock.Now().unix_ns;
    RIPS_RETURN_IF_ERROR(process->Announce());
    PrintEvent({{"event", "announced"}, {"node", command.node}, {"unix_ns", unix_ns}});
  }
  LogInfo("intruder is in the domain", {{"node", command.anonymous ? "" : command.node}});
  if (command.kind == IntruderKind::kFlood) {
    return Flood(command.anonymous ? *participant : process->participant(), command, stop);
  }
  if (rogue != nullptr) {
    return PublishUntilStopped(*rogue, stop);
  }
  bool told = false;
  while (!stop.WaitFor(kIdle)) {
    const int64_t received = first_received_unix_ns.load();
    if (!told && received != 0) {
      PrintFirstSample(kCameraTopic, received);
      told = true;
    }
  }
  return absl::OkStatus();
}

}  // namespace rips::robot_sim
