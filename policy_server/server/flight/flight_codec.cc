#include "policy_server/server/flight/flight_codec.h"

#include <cstddef>
#include <optional>
#include <utility>
#include <variant>

#include "policy_server/policy/recording/rips_writer.h"
#include "policy_server/server/flight/recorded_event.h"
#include "services/base/overloaded.h"
#include "services/base/status_macros.h"
#include "services/runtime/daemon_flags.h"

namespace rips::flight {
namespace {

// The events of a piece, in their order.
class Events {
 public:
  explicit Events(const FlightPiece& piece)
      : piece_(piece), other_(piece.others.begin()), context_(piece.contexts.begin()) {}

  bool done() const { return next_ == piece_.events.size(); }
  // Not done().
  recording::Recorded Next() {
    const size_t index = next_++;
    const FlightEvent& event = piece_.events[index];
    recording::Recorded out{.time_unix_ns = event.time_unix_ns,
                            .blind = event.blind,
                            .findings = event.findings,
                            .late = event.late};
    if (context_ != piece_.contexts.end() && context_->event == index) {
      out.context = WholeGraph(*context_++->graph);
    }
    if (event.sender != nullptr) {
      out.what = MessageOf(*event.seen, *event.sender, event.payload_bytes_max);
    } else {
      SetOther(*other_++, out);
    }
    return out;
  }

 private:
  static void SetOther(const FlightOther& other, recording::Recorded& out) {
    std::visit(Overloaded{[&](const std::shared_ptr<const ros2::GraphDelta>& delta) {
                            out.what = recording::RecordedGraph{.content = *delta, .settled = true};
                          },
                          [&](const model::ExternalEvent& external) { out.what = external; },
                          [&](const pipeline::LevelChange& level) {
                            out.findings.reset();
                            out.what = LevelOf(level);
                          }},
               other.what);
  }

  const FlightPiece& piece_;
  size_t next_ = 0;
  std::vector<FlightOther>::const_iterator other_;
  std::vector<FlightContext>::const_iterator context_;
};

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
  std::optional<engine::StandingFindings> findings;
  for (const std::shared_ptr<const FlightPiece>& piece : flight) {
    for (Events events(*piece); !events.done();) {
      recording::Recorded recorded = events.Next();
      if (std::exchange(first, false) && start.settled && !recorded.context) {
        recorded.context = WholeGraph(*start.graph);
      }
      if (recorded.findings == findings) {
        recorded.findings.reset();
      } else if (recorded.findings) {
        findings = recorded.findings;
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
