#include <atomic>
#include <memory>

#include "absl/status/statusor.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/dds/raw_reader.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/robot_sim/events.h"
#include "tests/support/robot_sim/ros_process.h"

namespace rips::robot_sim {
namespace {

// What the reader's callback counts.
struct Seen {
  std::atomic<int64_t> samples{0};
  std::atomic<int64_t> last_unix_ns{0};
};

absl::Status MeasureUntilStopped(const ProbeCommand& command, Seen& seen, StopFlag& stop) {
  const RealClock clock;
  PrintEvent({{"event", "ready"}, {"topic", command.topic}, {"unix_ns", clock.Now().unix_ns}});
  int64_t start_ns = clock.Now().boottime_ns;
  int64_t before = seen.samples.load();
  for (int64_t i = 0; command.count == 0 || i < command.count; ++i) {
    if (stop.WaitFor(command.window)) {
      break;
    }
    const Instant now = clock.Now();
    const int64_t total = seen.samples.load();
    const int64_t window_ns = now.boottime_ns - start_ns;
    const double hz = static_cast<double>(total - before) * static_cast<double>(kNanosPerSecond) /
                      static_cast<double>(window_ns);
    PrintEvent({{"event", "rate"},
                {"topic", command.topic},
                {"hz", hz},
                {"samples", total - before},
                {"window_ms", window_ns / kNanosPerMilli},
                {"last_sample_unix_ns", seen.last_unix_ns.load()},
                {"unix_ns", now.unix_ns}});
    start_ns = now.boottime_ns;
    before = total;
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status RunProbe(const ProbeCommand& command, StopFlag& stop) {
  RIPS_RETURN_IF_ERROR(ros2::ValidateTopicName(command.topic));
  Seen seen;
  const dds::RawCallback callback = [&seen](const dds::RawSample& sample) {
    seen.samples.fetch_add(1);
    seen.last_unix_ns.store(sample.received.unix_ns);
  };
  RIPS_ASSIGN_OR_RETURN(const dds::ParticipantOptions identity, Identity(command.security));
  RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const dds::Domain> domain,
                        dds::Domain::Create(command.domain));
  if (!command.node.empty()) {
    RIPS_ASSIGN_OR_RETURN(std::unique_ptr<RosProcess> process,
                          RosProcess::Create(domain, ros2::GidBytes::k24, identity));
    RIPS_ASSIGN_OR_RETURN(RosNode * node, process->AddNode(command.node));
    RIPS_RETURN_IF_ERROR(node->Subscribe(command.topic, command.type, SensorDataQos(), callback));
    RIPS_RETURN_IF_ERROR(process->Announce());
    return MeasureUntilStopped(command, seen, stop);
  }
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<dds::Participant> participant,
                        dds::Participant::Create(domain, identity));
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<dds::RawReader> reader,
                        dds::RawReader::Create(*participant,
                                               {.topic = ros2::MangleTopic(command.topic),
                                                .type = ros2::MangleType(command.type)},
                                               callback));
  return MeasureUntilStopped(command, seen, stop);
}

}  // namespace rips::robot_sim
