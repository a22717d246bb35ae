#include "policy_server/server/flight/flight_codec.h"

#include <utility>
#include <variant>

#include "policy_server/policy/recording/rips_writer.h"
#include "policy_server/server/flight/recorded_event.h"
#include "services/base/overloaded.h"
#include "services/base/status_macros.h"
#include "services/runtime/daemon_flags.h"

namespace rips::flight {
namespace {

recording::Recorded RecordedOf(const FlightEvent& event) {
  recording::Recorded out{
      .time_unix_ns = event.time_unix_ns, .blind = event.blind, .late = event.late};
  if (event.context != nullptr) out.context = WholeGraph(*event.context);
  std::visit(Overloaded{[&](const FlightMessage& message) {
                          out.what =
                              MessageOf(*message.seen, *message.sender, message.payload_bytes_max);
                        },
                        [&](const std::unique_ptr<const ros2::GraphDelta>& delta) {
                          out.what = recording::RecordedGraph{.content = *delta, .settled = true};
                        },
                        [&](const std::unique_ptr<const model::ExternalEvent>& external) {
                          out.what = *external;
                        },
                        [&](const std::unique_ptr<const pipeline::LevelChange>& level) {
                          out.what = LevelOf(*level);
                        }},
             event.what);
  return out;
}

}  // namespace

recording::RecordedOrigin OriginOf(const std::string& robot, const Flight& flight,
                                   std::vector<recording::RecordedAlert> alerts) {
  const pipeline::RulesState& start = flight.front()->state;
  return {.robot = robot,
          .bundle_id = start.bundle_id,
          .level = start.level,
          .start_unix_ns = start.time_unix_ns,
          .rips_version = std::string(RipsVersion()),
          .variables = start.variables,
          .uptime_ns = start.uptime_ns,
          .alerts = std::move(alerts)};
}

absl::StatusOr<std::string> EncodeFlight(const recording::RecordedOrigin& origin,
                                         const Flight& flight) {
  RIPS_ASSIGN_OR_RETURN(std::string bytes, recording::EncodeStart(origin));
  const pipeline::RulesState& start = flight.front()->state;
  bool first = true;
  for (const std::shared_ptr<const FlightPiece>& piece : flight) {
    for (const FlightEvent& event : piece->events) {
      recording::Recorded recorded = RecordedOf(event);
      if (std::exchange(first, false) && start.settled && !recorded.context) {
        recorded.context = WholeGraph(*start.graph);
      }
      absl::StatusOr<std::string> frame = recording::EncodeFrame(recorded);
      if (!frame.ok()) {
        recorded.what = recording::RecordedOther{.what = "an event that cannot be recorded"};
        recorded.context.reset();
        frame = recording::EncodeFrame(recorded);
      }
      RIPS_RETURN_IF_ERROR(frame.status());
      bytes += *frame;
    }
  }
  return bytes;
}

}  // namespace rips::flight
