#include "policy_server/policy/recording/event_codec.h"

#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "services/base/overloaded.h"
#include "services/base/status_macros.h"
#include "services/model_proto/observation_codec.h"
#include "services/ros2_proto/graph_codec.h"

namespace rips::recording {
namespace {

absl::StatusOr<RecordedMessage> DecodeMessage(const rips::v1::RecordedMessage& wire) {
  RecordedMessage message{.topic = wire.topic(),
                          .type = wire.type(),
                          .sender = wire.sender(),
                          .payload = wire.payload(),
                          .size_bytes = wire.size_bytes(),
                          .truncated = wire.truncated()};
  RIPS_RETURN_IF_ERROR(CheckSize(message));
  if (!wire.writer_guid().empty()) {
    RIPS_ASSIGN_OR_RETURN(message.writer, ros2::GuidFromBytes(wire.writer_guid()));
  }
  return message;
}

absl::StatusOr<RecordedGraph> DecodeSnapshot(const rips::v1::GraphSnapshot& wire) {
  RecordedGraph graph{.whole = true, .settled = wire.settled()};
  RIPS_ASSIGN_OR_RETURN(graph.content, ros2_proto::DecodeGraph(wire));
  return graph;
}

absl::StatusOr<RecordedGraph> DecodeDelta(const rips::v1::GraphDelta& wire) {
  RecordedGraph graph{.whole = false, .settled = wire.settled()};
  RIPS_ASSIGN_OR_RETURN(graph.content, ros2_proto::DecodeGraph(wire));
  return graph;
}

void EncodeSnapshot(const RecordedGraph& graph, rips::v1::GraphSnapshot& wire) {
  wire.set_settled(graph.settled);
  ros2_proto::EncodeGraph(graph.content, wire);
}

// One overload for each kind of event.
struct Encoder {
  void operator()(const RecordedMessage& message) const {
    rips::v1::RecordedMessage* out = wire.mutable_message();
    out->set_topic(message.topic);
    out->set_type(message.type);
    out->set_sender(message.sender);
    if (!message.writer.none()) out->set_writer_guid(message.writer.ToBytes());
    out->set_size_bytes(message.size_bytes);
    out->set_payload(message.payload);
    out->set_truncated(message.truncated);
  }
  void operator()(const RecordedGraph& graph) const {
    if (graph.whole) return EncodeSnapshot(graph, *wire.mutable_snapshot());
    wire.mutable_delta()->set_settled(graph.settled);
    ros2_proto::EncodeGraph(graph.content, *wire.mutable_delta());
  }
  void operator()(const model::ExternalEvent& external) const {
    if (!model_proto::Encode(external, wire)) wire.mutable_tick();
  }
  void operator()(const RecordedLevel& level) const {
    wire.mutable_level()->set_to(level.to);
    wire.mutable_level()->set_cause(level.cause);
  }
  void operator()(const RecordedOther& other) const { wire.mutable_other()->set_what(other.what); }

  rips::v1::RecordedEvent& wire;
};

void EncodeVariable(const std::string& name, const lang::Value& value,
                    rips::v1::RecordedVariable* out) {
  out->set_name(name);
  std::visit(Overloaded{[&](int64_t integer) { out->set_integer(integer); },
                        [&](double real) { out->set_real(real); },
                        [&](bool boolean) { out->set_boolean(boolean); },
                        [&](const std::string& text) { out->set_text(text); }},
             value);
}

std::optional<lang::Value> DecodeVariable(const rips::v1::RecordedVariable& wire) {
  switch (wire.value_case()) {
    case rips::v1::RecordedVariable::kInteger:
      return wire.integer();
    case rips::v1::RecordedVariable::kReal:
      return wire.real();
    case rips::v1::RecordedVariable::kBoolean:
      return wire.boolean();
    case rips::v1::RecordedVariable::kText:
      return wire.text();
    case rips::v1::RecordedVariable::VALUE_NOT_SET:
      break;
  }
  return std::nullopt;
}

}  // namespace

absl::Status CheckSize(const RecordedMessage& message) {
  const size_t held = message.payload.size();
  const bool good = message.truncated ? held <= message.size_bytes : held == message.size_bytes;
  if (good) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("a message of ", message.size_bytes, " bytes, ",
                                                 message.truncated ? "" : "not ",
                                                 "truncated, holds ", held));
}

absl::StatusOr<Recorded> DecodeEvent(const rips::v1::RecordedEvent& wire) {
  using Wire = rips::v1::RecordedEvent;
  Recorded event;
  if (wire.has_time_unix_ns()) event.time_unix_ns = wire.time_unix_ns();
  if (wire.has_blind()) event.blind = wire.blind();
  if (wire.has_findings()) {
    event.findings.emplace(wire.findings().told_all());
    for (const std::string& kind : wire.findings().kinds()) event.findings->Add(kind);
  }
  event.late = wire.late();
  if (wire.has_context()) {
    RIPS_ASSIGN_OR_RETURN(event.context, DecodeSnapshot(wire.context()));
  }
  RIPS_ASSIGN_OR_RETURN(std::optional<model::ExternalEvent> external,
                        model_proto::DecodeExternal(wire));
  if (external.has_value()) {
    event.what = *std::move(external);
    return event;
  }
  switch (wire.what_case()) {
    case Wire::kMessage: {
      RIPS_ASSIGN_OR_RETURN(event.what, DecodeMessage(wire.message()));
      break;
    }
    case Wire::kSnapshot: {
      RIPS_ASSIGN_OR_RETURN(event.what, DecodeSnapshot(wire.snapshot()));
      break;
    }
    case Wire::kDelta: {
      RIPS_ASSIGN_OR_RETURN(event.what, DecodeDelta(wire.delta()));
      break;
    }
    case Wire::kLevel:
      event.what = RecordedLevel{.to = wire.level().to(), .cause = wire.level().cause()};
      break;
    case Wire::kTick:
      event.what = model::ExternalEvent(model::TickEvent{});
      break;
    case Wire::kOther:
      event.what = RecordedOther{.what = wire.other().what()};
      break;
    default:
      event.what = RecordedOther{.what = "unknown"};
      break;
  }
  return event;
}

RecordedOrigin DecodeHeader(const rips::v1::RecordingHeader& wire) {
  RecordedOrigin origin{.robot = wire.robot(),
                        .bundle_id = wire.bundle_id(),
                        .level = wire.level(),
                        .start_unix_ns = wire.start_unix_ns(),
                        .rips_version = wire.rips_version(),
                        .uptime_ns = wire.uptime_ns()};
  for (const rips::v1::RecordedAlert& each : wire.alerts()) {
    origin.alerts.push_back({.id = each.id(),
                             .rule = each.rule(),
                             .severity = each.severity(),
                             .text = each.text(),
                             .time_unix_ns = each.time_unix_ns()});
  }
  for (const rips::v1::RecordedVariable& each : wire.variables()) {
    if (std::optional<lang::Value> value = DecodeVariable(each)) {
      origin.variables.insert_or_assign(each.name(), *std::move(value));
    }
  }
  return origin;
}

rips::v1::RecordedEvent EncodeEvent(const Recorded& event) {
  rips::v1::RecordedEvent wire;
  if (event.time_unix_ns) wire.set_time_unix_ns(*event.time_unix_ns);
  if (event.context) EncodeSnapshot(*event.context, *wire.mutable_context());
  if (event.blind) wire.set_blind(*event.blind);
  if (event.findings) {
    wire.mutable_findings()->set_told_all(event.findings->told_all());
    for (const absl::string_view kind : event.findings->Kinds()) {
      wire.mutable_findings()->add_kinds(std::string(kind));
    }
  }
  wire.set_late(event.late);
  std::visit(Encoder{wire}, event.what);
  return wire;
}

rips::v1::RecordingHeader EncodeHeader(const RecordedOrigin& origin) {
  rips::v1::RecordingHeader wire;
  wire.set_robot(origin.robot);
  wire.set_bundle_id(origin.bundle_id);
  wire.set_level(origin.level);
  wire.set_start_unix_ns(origin.start_unix_ns);
  wire.set_rips_version(origin.rips_version);
  for (const auto& [name, value] : origin.variables) {
    EncodeVariable(name, value, wire.add_variables());
  }
  wire.set_uptime_ns(origin.uptime_ns);
  for (const RecordedAlert& each : origin.alerts) {
    rips::v1::RecordedAlert* alert = wire.add_alerts();
    alert->set_id(each.id);
    alert->set_rule(each.rule);
    alert->set_severity(each.severity);
    alert->set_text(each.text);
    alert->set_time_unix_ns(each.time_unix_ns);
  }
  return wire;
}

}  // namespace rips::recording
