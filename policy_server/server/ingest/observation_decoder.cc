#include "policy_server/server/ingest/observation_decoder.h"

#include <algorithm>
#include <utility>
#include <variant>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/ingest/interest_codec.h"
#include "services/base/overloaded.h"
#include "services/base/status_macros.h"
#include "services/model_proto/observation_codec.h"
#include "services/ros2/ros_name.h"
#include "services/ros2_proto/graph_codec.h"
#include "services/wire_limits/field_limits.h"

namespace rips::ingest {
namespace {

using pipeline::Lane;

constexpr uint32_t kProtocol = 1;
constexpr size_t kIncarnationBytes = 16;
constexpr uint64_t kBoottimeMax = wire_limits::kTimeMax;

absl::StatusOr<Lane> DecodeLane(rips::v1::Lane lane) {
  switch (lane) {
    case rips::v1::CONTROL:
      return Lane::kControl;
    case rips::v1::MESSAGES:
      return Lane::kMessages;
    default:
      return absl::InvalidArgumentError(absl::StrCat("unknown lane ", static_cast<int>(lane)));
  }
}

absl::Status CheckIncarnation(const std::string& incarnation) {
  if (incarnation.size() == kIncarnationBytes) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("incarnation has ", incarnation.size(), " bytes, not ", kIncarnationBytes));
}

// `10.0.0.1`, `10.0.0.1:80`, `fe80::1`, `[fe80::1]:80` without the port.
std::string AddressOf(absl::string_view endpoint) {
  const size_t bracket = endpoint.find(']');
  if (absl::StartsWith(endpoint, "[") && bracket != absl::string_view::npos) {
    return std::string(endpoint.substr(1, bracket - 1));
  }
  const size_t colon = endpoint.find(':');
  const bool port = colon != absl::string_view::npos && colon == endpoint.rfind(':');
  return std::string(port ? endpoint.substr(0, colon) : endpoint);
}

const char* CauseName(rips::v1::Loss::Cause cause) {
  switch (cause) {
    case rips::v1::Loss::DDS_GAP:
      return "gap in a writer's sequence";
    case rips::v1::Loss::QUEUE_FULL:
      return "a queue of the sensor was full";
    case rips::v1::Loss::OUTBOX_SHED:
      return "the outbox was full";
    case rips::v1::Loss::SPOOL_LOST:
      return "the sensor ended abruptly, or its spool was damaged";
    case rips::v1::Loss::LIMIT:
      return "a limit of the sensor was hit";
    case rips::v1::Loss::UNDECODABLE:
      return "undecodable";
    default:
      return "unknown cause";
  }
}

absl::StatusOr<std::vector<model::GraphChange>> DecodeFormerGraph(
    const rips::v1::ObservationBatch& batch) {
  std::vector<model::GraphChange> steps;
  for (const rips::v1::Observation& wire : batch.graph()) {
    if (!wire.has_snapshot() && !wire.has_delta()) {
      return absl::InvalidArgumentError("a batch brings what is no step of a graph");
    }
    RIPS_ASSIGN_OR_RETURN(model_proto::Nameless step, model_proto::Decode(wire));
    steps.push_back(std::get<model::GraphChange>(std::move(step)));
  }
  if (!steps.empty() && batch.lane() != rips::v1::MESSAGES) {
    return absl::InvalidArgumentError("a batch of the control lane brings a graph of its time");
  }
  return steps;
}

// What this server makes of untrusted text before it keeps it.
absl::Status Sanitize(model::IdsAlert& alert) {
  alert.src = AddressOf(alert.src);
  alert.dst = AddressOf(alert.dst);
  return absl::OkStatus();
}

// It goes into alerts: nothing that a terminal or a log would obey.
absl::Status Sanitize(model::Finding& finding) {
  if (finding.kind.empty()) return absl::InvalidArgumentError("a finding of no kind");
  for (std::string* text : {&finding.kind, &finding.node, &finding.topic, &finding.detail}) {
    *text = ros2::Printable(*text);
  }
  return absl::OkStatus();
}

template <typename What>
absl::Status Sanitize(What&) {
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<pipeline::SensorHello> DecodeHello(const rips::v1::SensorHello& hello) {
  const rips::v1::Hello& base = hello.hello();
  if (base.protocol() == 0) return absl::InvalidArgumentError("hello has no protocol number");
  if (base.protocol() > kProtocol) {
    return absl::FailedPreconditionError(absl::StrCat("protocol ", base.protocol(),
                                                      " is newer than this server's ", kProtocol,
                                                      "; update the server first"));
  }
  RIPS_RETURN_IF_ERROR(CheckIncarnation(base.incarnation()));
  pipeline::SensorHello decoded{
      .incarnation = base.incarnation(),
      .clock = {.boottime_ns = static_cast<int64_t>(base.clock().boottime_ns()),
                .unix_ns = base.clock().unix_ns()},
      .domain = hello.domain(),
      .not_visible = {hello.not_visible().begin(), hello.not_visible().end()},
      .blind = {hello.blind().begin(), hello.blind().end()},
      .interest_in_use = hello.interest_in_use().size() == kInterestIdBytes
                             ? hello.interest_in_use()
                             : std::string()};
  if (!hello.participant_guid().empty()) {
    RIPS_ASSIGN_OR_RETURN(decoded.participant, ros2::GuidFromBytes(hello.participant_guid()));
  }
  const std::string& generation = hello.store().generation();
  if (!generation.empty() && generation.size() != store::kGenerationBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("generation of ", generation.size(), " bytes, not ", store::kGenerationBytes));
  }
  decoded.store = {.generation = generation, .commit = hello.store().commit()};
  for (const rips::v1::SpoolStream& range : hello.spooled()) {
    RIPS_RETURN_IF_ERROR(CheckIncarnation(range.incarnation()));
    RIPS_ASSIGN_OR_RETURN(const Lane lane, DecodeLane(range.lane()));
    if (range.first_sequence() == 0) {
      return absl::InvalidArgumentError("no range can start at sequence 0");
    }
    decoded.spooled.push_back({.incarnation = range.incarnation(),
                               .lane = lane,
                               .first_sequence = range.first_sequence(),
                               .last_sequence = range.last_sequence(),
                               .acknowledged = range.acknowledged_sequence()});
  }
  return decoded;
}

pipeline::SensorHeartbeat DecodeHeartbeat(const rips::v1::Heartbeat& heartbeat) {
  const auto boottime = [](uint64_t ns) {
    return ns > kBoottimeMax ? 0 : static_cast<int64_t>(ns);
  };
  return {.clock = {.boottime_ns = boottime(heartbeat.clock().boottime_ns()),
                    .unix_ns = heartbeat.clock().unix_ns()},
          .echo_boottime_ns = boottime(heartbeat.echo_boottime_ns())};
}

ObservationDecoder::ObservationDecoder(DecodeLimits limits)
    : limits_(limits), names_(std::make_shared<Names>()) {}

absl::StatusOr<pipeline::Batch> ObservationDecoder::Decode(
    const rips::v1::ObservationBatch& batch) {
  RIPS_RETURN_IF_ERROR(CheckIncarnation(batch.incarnation()));
  RIPS_ASSIGN_OR_RETURN(const Lane lane, DecodeLane(batch.lane()));
  if (batch.observations_size() == 0) return absl::InvalidArgumentError("empty batch");
  size_t payload_bytes = 0;
  for (const rips::v1::Observation& observation : batch.observations()) {
    payload_bytes += observation.message().payload().size();
  }
  if (payload_bytes > limits_.inline_payload_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat("batch with ", payload_bytes,
                                                     " bytes of payload exceeds the limit of ",
                                                     limits_.inline_payload_bytes));
  }
  RIPS_RETURN_IF_ERROR(TakeNames(batch));
  RIPS_ASSIGN_OR_RETURN(std::vector<model::GraphChange> graph, DecodeFormerGraph(batch));
  pipeline::Batch decoded{.incarnation = batch.incarnation(),
                          .lane = lane,
                          .first_sequence = batch.first_sequence(),
                          .graph = std::move(graph),
                          .bytes = batch.ByteSizeLong(),
                          .names = names_};
  decoded.observations.reserve(static_cast<size_t>(batch.observations_size()));
  for (const rips::v1::Observation& observation : batch.observations()) {
    pipeline::Observation& one = decoded.observations.emplace_back();
    // Each is kTimeMax at most. Later arithmetic adds other clocks: their sum must not be more.
    const uint64_t boottime_ns = batch.base_boottime_ns() + observation.offset_ns();
    if (boottime_ns > kBoottimeMax) {
      return absl::InvalidArgumentError("an observation at a time that no clock shows");
    }
    one.boottime_ns = static_cast<int64_t>(boottime_ns);
    RIPS_RETURN_IF_ERROR(DecodeOne(observation, lane, one));
    auto* message = std::get_if<pipeline::MessageSeen>(&one.what);
    if (message == nullptr) continue;
    const uint64_t version = observation.message().graph_version();
    message->graph_version = version != 0 ? version : batch.graph_version();
  }
  if (lane == Lane::kMessages) decoded.payload_bytes = payloads_.FinishBatch();
  return decoded;
}

absl::Status ObservationDecoder::TakeNames(const rips::v1::ObservationBatch& batch) {
  for (const rips::v1::Intern& intern : batch.interned()) {
    const uint32_t id = intern.id();
    if (id > limits_.interned) {
      return absl::ResourceExhaustedError(
          absl::StrCat("intern id ", id, " exceeds the limit of ", limits_.interned));
    }
    if (id >= names_->size()) names_->resize(id + 1);
    if (id == 0 || (*names_)[id] != nullptr) {
      return absl::InvalidArgumentError(
          absl::StrCat("intern id ", id, id == 0 ? " is not allowed" : " is used twice"));
    }
    RIPS_ASSIGN_OR_RETURN((*names_)[id], TakeName(intern));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<const ObservationDecoder::Name>> ObservationDecoder::TakeName(
    const rips::v1::Intern& intern) const {
  auto name = std::make_unique<Name>();
  if (intern.has_topic() || intern.has_type()) {
    name->kind = intern.has_topic() ? Name::Kind::kTopic : Name::Kind::kType;
    name->text = intern.has_topic() ? intern.topic() : intern.type();
  } else if (intern.has_writer()) {
    RIPS_ASSIGN_OR_RETURN(ros2::Endpoint endpoint, ros2_proto::DecodeEndpoint(intern.writer()));
    name->kind = Name::Kind::kWriter;
    name->text = std::move(endpoint.node);
    name->guid = endpoint.guid;
    name->reliable = endpoint.qos.reliable;
    if (endpoint.ros) {
      name->writes_topic = std::move(endpoint.name);
      name->writes_type = std::move(endpoint.type);
    }
  } else {
    return absl::InvalidArgumentError(absl::StrCat("intern id ", intern.id(), " names nothing"));
  }
  return name;
}

absl::Status ObservationDecoder::DecodeMessage(const rips::v1::MessageSeen& message,
                                               pipeline::MessageSeen& seen) {
  const Name* topic = Find(message.topic_id(), Name::Kind::kTopic);
  const Name* type = Find(message.type_id(), Name::Kind::kType);
  const Name* writer = Find(message.writer_id(), Name::Kind::kWriter);
  if (topic == nullptr || type == nullptr || writer == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat("message names ids that were not interned: ", message.topic_id(), ", ",
                     message.type_id(), ", ", message.writer_id()));
  }
  if (message.chunked_payload_id() == 0) {
    seen.payload = message.payload();
  } else {
    if (!message.payload().empty()) {
      return absl::InvalidArgumentError(
          absl::StrCat("a message with a payload names payload ", message.chunked_payload_id()));
    }
    RIPS_ASSIGN_OR_RETURN(seen.payload, payloads_.Claim(message.chunked_payload_id()));
  }
  if (seen.payload.size() > message.size_bytes()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "a payload of ", seen.payload.size(), " bytes in a message of ", message.size_bytes()));
  }
  seen.topic = topic->text;
  seen.memo = &topic->memo;
  seen.type = type->text;
  seen.sender = writer->text;
  seen.writer = writer->guid;
  seen.size_bytes = message.size_bytes();
  // Counted, not believed.
  seen.truncated = seen.payload.size() < message.size_bytes();
  return absl::OkStatus();
}

absl::StatusOr<model::Loss> ObservationDecoder::DecodeLoss(const rips::v1::Loss& loss) const {
  if (loss.count() == 0) return absl::InvalidArgumentError("a loss of nothing");
  model::Loss seen{.count = loss.count(),
                   .first_ns = static_cast<int64_t>(loss.first_boottime_ns()),
                   .last_ns = static_cast<int64_t>(loss.last_boottime_ns()),
                   .cause = CauseName(loss.cause())};
  if (loss.topic_id() != 0) {
    const Name* topic = Find(loss.topic_id(), Name::Kind::kTopic);
    if (topic == nullptr) {
      return absl::InvalidArgumentError(
          absl::StrCat("loss names topic ", loss.topic_id(), ", which was not interned"));
    }
    seen.topic = topic->text;
  }
  if (loss.writer_id() != 0) {
    const Name* writer = Find(loss.writer_id(), Name::Kind::kWriter);
    if (writer == nullptr) {
      return absl::InvalidArgumentError(
          absl::StrCat("loss names writer ", loss.writer_id(), ", which was not interned"));
    }
    seen.tolerable = loss.cause() == rips::v1::Loss::DDS_GAP && !writer->reliable;
    if (seen.topic.empty()) seen.topic = writer->writes_topic;
    if (seen.topic == writer->writes_topic) seen.type = writer->writes_type;
    seen.writer = writer->guid;
  }
  return seen;
}

absl::Status ObservationDecoder::DecodeOne(const rips::v1::Observation& observation, Lane lane,
                                           pipeline::Observation& one) {
  const bool is_message = observation.has_message();
  if (observation.kind_case() != rips::v1::Observation::KIND_NOT_SET &&
      is_message != (lane == Lane::kMessages)) {
    return absl::InvalidArgumentError(is_message ? "a message in the control lane"
                                                 : "a control observation in the message lane");
  }
  switch (observation.kind_case()) {
    case rips::v1::Observation::kMessage:
      return DecodeMessage(observation.message(), one.what.emplace<pipeline::MessageSeen>());
    case rips::v1::Observation::kLoss: {
      RIPS_ASSIGN_OR_RETURN(one.what, DecodeLoss(observation.loss()));
      return absl::OkStatus();
    }
    case rips::v1::Observation::KIND_NOT_SET:
      // A newer sensor's kind: not judged, so counted as lost.
      one.what = model::Loss{.count = 1, .cause = "an observation of an unknown kind"};
      return absl::OkStatus();
    default:
      break;
  }
  RIPS_ASSIGN_OR_RETURN(model_proto::Nameless decoded, model_proto::Decode(observation));
  return std::visit(
      Overloaded{[](std::monostate) { return absl::InternalError("a kind that is not decoded"); },
                 [&](auto& what) -> absl::Status {
                   RIPS_RETURN_IF_ERROR(Sanitize(what));
                   one.what = std::move(what);
                   return absl::OkStatus();
                 }},
      decoded);
}

}  // namespace rips::ingest
