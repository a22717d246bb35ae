#include "policy_server/server/ingest/observation_decoder.h"

#include <algorithm>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/ingest/interest_codec.h"
#include "services/base/status_macros.h"
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

absl::StatusOr<pipeline::GraphSnapshotSeen> DecodeSnapshot(
    const rips::v1::GraphSnapshot& snapshot) {
  if (snapshot.graph_version() == 0) {
    return absl::InvalidArgumentError("graph versions count from 1");
  }
  pipeline::GraphSnapshotSeen seen{.version = snapshot.graph_version(),
                                   .settled = snapshot.settled()};
  RIPS_ASSIGN_OR_RETURN(seen.content, ros2_proto::DecodeGraph(snapshot));
  return seen;
}

absl::StatusOr<pipeline::GraphDeltaSeen> DecodeDelta(const rips::v1::GraphDelta& delta) {
  if (delta.to_version() <= delta.from_version()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "graph delta from version ", delta.from_version(), " to ", delta.to_version()));
  }
  pipeline::GraphDeltaSeen seen{.from_version = delta.from_version(),
                                .to_version = delta.to_version(),
                                .settled = delta.settled()};
  RIPS_ASSIGN_OR_RETURN(seen.delta, ros2_proto::DecodeGraph(delta));
  return seen;
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
  pipeline::Batch decoded{.incarnation = batch.incarnation(),
                          .lane = lane,
                          .first_sequence = batch.first_sequence(),
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

absl::StatusOr<pipeline::LossSeen> ObservationDecoder::DecodeLoss(
    const rips::v1::Loss& loss) const {
  if (loss.count() == 0) return absl::InvalidArgumentError("a loss of nothing");
  pipeline::LossSeen seen{.count = loss.count(),
                          .cause = CauseName(loss.cause()),
                          .first_boottime_ns = static_cast<int64_t>(loss.first_boottime_ns()),
                          .last_boottime_ns = static_cast<int64_t>(loss.last_boottime_ns())};
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

absl::StatusOr<pipeline::SensorStateSeen> ObservationDecoder::DecodeState(
    const rips::v1::SensorState& state) const {
  return pipeline::SensorStateSeen{
      .overloaded = state.overloaded(),
      .outbox_bytes = state.outbox_bytes(),
      .oldest_unacked_ns =
          static_cast<int64_t>(std::min<uint64_t>(state.oldest_unacked_ns(), kBoottimeMax)),
      .spool_bytes = state.spool_bytes(),
      .not_visible = {state.not_visible().begin(), state.not_visible().end()},
      .blind = {state.blind().begin(), state.blind().end()}};
}

absl::StatusOr<pipeline::IdsAlertSeen> ObservationDecoder::DecodeIds(
    const rips::v1::IdsAlert& ids) const {
  return pipeline::IdsAlertSeen{.message = ids.message(),
                                .gid = ids.gid(),
                                .sid = ids.sid(),
                                .line = ids.line(),
                                .source = AddressOf(ids.src()),
                                .target = AddressOf(ids.dst())};
}

absl::StatusOr<pipeline::FindingSeen> ObservationDecoder::DecodeFinding(
    const rips::v1::Finding& finding) const {
  if (finding.kind().empty()) return absl::InvalidArgumentError("a finding of no kind");
  // A stranger's words, and they go into alerts: nothing that a terminal or a log would obey.
  pipeline::FindingSeen seen{.kind = ros2::Printable(finding.kind()),
                             .node = ros2::Printable(finding.node()),
                             .topic = ros2::Printable(finding.topic()),
                             .detail = ros2::Printable(finding.detail()),
                             .over = finding.over()};
  if (!finding.guid().empty()) {
    RIPS_ASSIGN_OR_RETURN(seen.guid, ros2::GuidFromBytes(finding.guid()));
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
    case rips::v1::Observation::kSnapshot: {
      RIPS_ASSIGN_OR_RETURN(one.what, DecodeSnapshot(observation.snapshot()));
      break;
    }
    case rips::v1::Observation::kDelta: {
      RIPS_ASSIGN_OR_RETURN(one.what, DecodeDelta(observation.delta()));
      break;
    }
    case rips::v1::Observation::kIds: {
      RIPS_ASSIGN_OR_RETURN(one.what, DecodeIds(observation.ids()));
      break;
    }
    case rips::v1::Observation::kSignal:
      one.what = pipeline::SignalSeen{.name = observation.signal().name()};
      break;
    case rips::v1::Observation::kLoss: {
      RIPS_ASSIGN_OR_RETURN(one.what, DecodeLoss(observation.loss()));
      break;
    }
    case rips::v1::Observation::kState: {
      RIPS_ASSIGN_OR_RETURN(one.what, DecodeState(observation.state()));
      break;
    }
    case rips::v1::Observation::kFinding: {
      RIPS_ASSIGN_OR_RETURN(one.what, DecodeFinding(observation.finding()));
      break;
    }
    case rips::v1::Observation::KIND_NOT_SET:
      // A newer sensor's kind: not judged, so counted as lost.
      one.what = pipeline::LossSeen{.count = 1, .cause = "an observation of an unknown kind"};
      break;
  }
  return absl::OkStatus();
}

}  // namespace rips::ingest
