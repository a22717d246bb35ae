#include "services/model_proto/observation_codec.h"

#include <algorithm>
#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"
#include "services/base/overloaded.h"
#include "services/base/status_macros.h"
#include "services/ros2_proto/graph_codec.h"
#include "services/wire_limits/field_limits.h"

namespace rips::model_proto {
namespace {

void Fill(const model::SignalSeen& signal, rips::v1::SignalSeen& wire) {
  wire.set_name(signal.name);
  wire.set_count(signal.count);
}

model::SignalSeen From(const rips::v1::SignalSeen& wire) {
  return {.name = wire.name(), .count = wire.count()};
}

void Fill(const model::SensorState& state, rips::v1::SensorState& wire) {
  wire.set_overloaded(state.overloaded);
  wire.set_outbox_bytes(state.outbox_bytes);
  wire.set_oldest_unacked_ns(static_cast<uint64_t>(std::max<int64_t>(state.oldest_unacked_ns, 0)));
  for (const std::string& kind : state.not_visible) wire.add_not_visible(kind);
  for (const std::string& reason : state.blind) wire.add_blind(reason);
  wire.set_spool_bytes(state.spool_bytes);
  if (state.findings_digest) wire.set_findings_digest(*state.findings_digest);
  wire.set_findings_all_told(state.findings_all_told);
}

model::SensorState From(const rips::v1::SensorState& wire) {
  std::optional<uint64_t> digest;
  if (wire.has_findings_digest()) digest = wire.findings_digest();
  return {.overloaded = wire.overloaded(),
          .outbox_bytes = wire.outbox_bytes(),
          .oldest_unacked_ns =
              static_cast<int64_t>(std::min(wire.oldest_unacked_ns(), wire_limits::kTimeMax)),
          .spool_bytes = wire.spool_bytes(),
          .not_visible = {wire.not_visible().begin(), wire.not_visible().end()},
          .blind = {wire.blind().begin(), wire.blind().end()},
          .findings_digest = digest,
          .findings_all_told = wire.findings_all_told()};
}

void Fill(const model::IdsAlert& alert, rips::v1::IdsAlert& wire) {
  wire.set_source(alert.source);
  wire.set_gid(alert.gid);
  wire.set_sid(alert.sid);
  wire.set_rev(alert.rev);
  wire.set_message(alert.message);
  wire.set_severity(alert.severity);
  wire.set_src(alert.src);
  wire.set_dst(alert.dst);
  wire.set_line(alert.line);
}

model::IdsAlert From(const rips::v1::IdsAlert& wire) {
  return {.source = wire.source(),
          .gid = wire.gid(),
          .sid = wire.sid(),
          .rev = wire.rev(),
          .message = wire.message(),
          .severity = wire.severity(),
          .src = wire.src(),
          .dst = wire.dst(),
          .line = wire.line()};
}

void Fill(const model::Finding& finding, rips::v1::Finding& wire) {
  wire.set_kind(finding.kind);
  if (!finding.guid.none()) wire.set_guid(finding.guid.ToBytes());
  wire.set_node(finding.node);
  wire.set_topic(finding.topic);
  wire.set_detail(finding.detail);
  wire.set_over(finding.over);
}

absl::StatusOr<model::Finding> From(const rips::v1::Finding& wire) {
  model::Finding finding{.kind = wire.kind(),
                         .node = wire.node(),
                         .topic = wire.topic(),
                         .detail = wire.detail(),
                         .over = wire.over()};
  if (!wire.guid().empty()) {
    RIPS_ASSIGN_OR_RETURN(finding.guid, ros2::GuidFromBytes(wire.guid()));
  }
  return finding;
}

void Fill(const model::Loss& loss, rips::v1::RecordedLoss& wire) {
  wire.set_count(loss.count);
  wire.set_topic(loss.topic);
  wire.set_type(loss.type);
  if (!loss.writer.none()) wire.set_writer_guid(loss.writer.ToBytes());
  wire.set_first_unix_ns(loss.first_ns);
  wire.set_last_unix_ns(loss.last_ns);
  wire.set_cause(loss.cause);
}

absl::StatusOr<model::Loss> From(const rips::v1::RecordedLoss& wire) {
  model::Loss loss{.count = wire.count(),
                   .topic = wire.topic(),
                   .type = wire.type(),
                   .first_ns = wire.first_unix_ns(),
                   .last_ns = wire.last_unix_ns(),
                   .cause = wire.cause()};
  if (!wire.writer_guid().empty()) {
    RIPS_ASSIGN_OR_RETURN(loss.writer, ros2::GuidFromBytes(wire.writer_guid()));
  }
  return loss;
}

absl::StatusOr<model::GraphChange> From(const rips::v1::GraphSnapshot& wire) {
  if (wire.graph_version() == 0) {
    return absl::InvalidArgumentError("graph versions count from 1");
  }
  model::GraphChange change{.to_version = wire.graph_version(), .settled = wire.settled()};
  RIPS_ASSIGN_OR_RETURN(change.delta, ros2_proto::DecodeGraph(wire));
  return change;
}

absl::StatusOr<model::GraphChange> From(const rips::v1::GraphDelta& wire) {
  if (wire.from_version() == 0 || wire.to_version() <= wire.from_version()) {
    return absl::InvalidArgumentError(
        absl::StrCat("graph delta from version ", wire.from_version(), " to ", wire.to_version()));
  }
  model::GraphChange change{.from_version = wire.from_version(),
                            .to_version = wire.to_version(),
                            .settled = wire.settled()};
  RIPS_ASSIGN_OR_RETURN(change.delta, ros2_proto::DecodeGraph(wire));
  return change;
}

}  // namespace

void Encode(const model::GraphChange& change, rips::v1::Observation& wire) {
  if (change.whole()) {
    wire.mutable_snapshot()->set_graph_version(change.to_version);
    wire.mutable_snapshot()->set_settled(change.settled);
    ros2_proto::EncodeGraph(change.delta, *wire.mutable_snapshot());
  } else {
    wire.mutable_delta()->set_from_version(change.from_version);
    wire.mutable_delta()->set_to_version(change.to_version);
    wire.mutable_delta()->set_settled(change.settled);
    ros2_proto::EncodeGraph(change.delta, *wire.mutable_delta());
  }
}

void Encode(const model::SignalSeen& signal, rips::v1::Observation& wire) {
  Fill(signal, *wire.mutable_signal());
}

void Encode(const model::SensorState& state, rips::v1::Observation& wire) {
  Fill(state, *wire.mutable_state());
}

void Encode(const model::IdsAlert& alert, rips::v1::Observation& wire) {
  Fill(alert, *wire.mutable_ids());
}

void Encode(const model::Finding& finding, rips::v1::Observation& wire) {
  Fill(finding, *wire.mutable_finding());
}

absl::StatusOr<Nameless> Decode(const rips::v1::Observation& wire) {
  switch (wire.kind_case()) {
    case rips::v1::Observation::kSnapshot:
      return From(wire.snapshot());
    case rips::v1::Observation::kDelta:
      return From(wire.delta());
    case rips::v1::Observation::kIds:
      return From(wire.ids());
    case rips::v1::Observation::kSignal:
      return From(wire.signal());
    case rips::v1::Observation::kState:
      return From(wire.state());
    case rips::v1::Observation::kFinding:
      return From(wire.finding());
    case rips::v1::Observation::kMessage:
    case rips::v1::Observation::kLoss:
    case rips::v1::Observation::KIND_NOT_SET:
      break;
  }
  return std::monostate();
}

bool Encode(const model::ExternalEvent& event, rips::v1::RecordedEvent& wire) {
  std::visit(Overloaded{[&](const model::IdsAlert& alert) { Fill(alert, *wire.mutable_ids()); },
                        [&](const model::SignalSeen& seen) { Fill(seen, *wire.mutable_signal()); },
                        [&](const model::AgentEvent& agent) {
                          wire.mutable_agent()->set_agent(agent.agent);
                          wire.mutable_agent()->set_state(agent.state);
                        },
                        [&](const model::Finding& seen) { Fill(seen, *wire.mutable_finding()); },
                        [&](const model::Loss& loss) { Fill(loss, *wire.mutable_loss()); },
                        [](const model::TickEvent&) {}},
             event);
  return !std::holds_alternative<model::TickEvent>(event);
}

absl::StatusOr<std::optional<model::ExternalEvent>> DecodeExternal(
    const rips::v1::RecordedEvent& wire) {
  switch (wire.what_case()) {
    case rips::v1::RecordedEvent::kIds:
      return From(wire.ids());
    case rips::v1::RecordedEvent::kSignal:
      return From(wire.signal());
    case rips::v1::RecordedEvent::kAgent:
      return model::AgentEvent{.agent = wire.agent().agent(), .state = wire.agent().state()};
    case rips::v1::RecordedEvent::kFinding:
      return From(wire.finding());
    case rips::v1::RecordedEvent::kLoss:
      return From(wire.loss());
    case rips::v1::RecordedEvent::kMessage:
    case rips::v1::RecordedEvent::kSnapshot:
    case rips::v1::RecordedEvent::kDelta:
    case rips::v1::RecordedEvent::kLevel:
    case rips::v1::RecordedEvent::kTick:
    case rips::v1::RecordedEvent::kOther:
    case rips::v1::RecordedEvent::WHAT_NOT_SET:
      break;
  }
  return std::nullopt;
}

}  // namespace rips::model_proto
