#include "policy_server/ingest/observation_decoder.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2_proto/graph_codec.h"

namespace rips::ingest {
namespace {

using pipeline::Lane;

constexpr uint32_t kProtocol = 1;
constexpr size_t kIncarnationBytes = 16;
constexpr int kSpooledRangesMax = 64;
constexpr uint64_t kSequenceMax = uint64_t{1} << 62;

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
      return "the spool was lost";
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
  if (hello.spooled_size() > kSpooledRangesMax) {
    return absl::ResourceExhaustedError(absl::StrCat("hello announces ", hello.spooled_size(),
                                                     " ranges; at most ", kSpooledRangesMax));
  }
  pipeline::SensorHello decoded{
      .incarnation = base.incarnation(),
      .clock = {.boottime_ns = static_cast<int64_t>(base.clock().boottime_ns()),
                .unix_ns = base.clock().unix_ns()},
      .not_visible = {hello.not_visible().begin(), hello.not_visible().end()}};
  for (const rips::v1::SpoolStream& range : hello.spooled()) {
    RIPS_RETURN_IF_ERROR(CheckIncarnation(range.incarnation()));
    RIPS_ASSIGN_OR_RETURN(const Lane lane, DecodeLane(range.lane()));
    if (range.first_sequence() == 0 || range.first_sequence() > kSequenceMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("no range can start at sequence ", range.first_sequence()));
    }
    decoded.spooled.push_back({.incarnation = range.incarnation(),
                               .lane = lane,
                               .first_sequence = range.first_sequence(),
                               .last_sequence = range.last_sequence()});
  }
  return decoded;
}

ObservationDecoder::ObservationDecoder(DecodeLimits limits)
    : limits_(limits), names_(std::make_shared<Names>()) {}

absl::StatusOr<pipeline::Batch> ObservationDecoder::Decode(
    const rips::v1::ObservationBatch& batch) {
  RIPS_RETURN_IF_ERROR(CheckIncarnation(batch.incarnation()));
  RIPS_ASSIGN_OR_RETURN(const Lane lane, DecodeLane(batch.lane()));
  if (batch.observations_size() == 0) return absl::InvalidArgumentError("empty batch");
  if (batch.observations_size() > limits_.batch_observations) {
    return absl::ResourceExhaustedError(absl::StrCat("batch of ", batch.observations_size(),
                                                     " observations exceeds the limit of ",
                                                     limits_.batch_observations));
  }
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
    one.boottime_ns = static_cast<int64_t>(batch.base_boottime_ns() + observation.offset_ns());
    RIPS_RETURN_IF_ERROR(DecodeOne(observation, lane, one));
  }
  return decoded;
}

absl::Status ObservationDecoder::TakeNames(const rips::v1::ObservationBatch& batch) {
  for (const rips::v1::Intern& intern : batch.interned()) {
    const uint32_t id = intern.id();
    const size_t held = names_->topics.size() + names_->types.size() + names_->writers.size();
    if (held >= limits_.interned) {
      return absl::ResourceExhaustedError(
          absl::StrCat("more than ", limits_.interned, " names interned in one stream"));
    }
    const bool taken =
        names_->topics.contains(id) || names_->types.contains(id) || names_->writers.contains(id);
    if (id == 0 || taken) {
      return absl::InvalidArgumentError(
          absl::StrCat("intern id ", id, id == 0 ? " is not allowed" : " is used twice"));
    }
    const std::string& text = intern.has_topic() ? intern.topic() : intern.type();
    if (text.size() > limits_.name_bytes) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "name of ", text.size(), " bytes exceeds the limit of ", limits_.name_bytes));
    }
    if (intern.has_topic()) {
      names_->topics[id] = std::make_unique<const std::string>(intern.topic());
    } else if (intern.has_type()) {
      names_->types[id] = std::make_unique<const std::string>(intern.type());
    } else if (intern.has_writer()) {
      RIPS_ASSIGN_OR_RETURN(ros2::Endpoint endpoint, ros2_proto::DecodeEndpoint(intern.writer()));
      names_->writers[id] =
          std::make_unique<const Writer>(Writer{.guid = endpoint.guid,
                                                .node = std::move(endpoint.node),
                                                .reliable = endpoint.qos.reliable});
    } else {
      return absl::InvalidArgumentError(absl::StrCat("intern id ", id, " names nothing"));
    }
  }
  return absl::OkStatus();
}

absl::Status ObservationDecoder::DecodeMessage(const rips::v1::MessageSeen& message,
                                               pipeline::MessageSeen& seen) const {
  const auto topic = names_->topics.find(message.topic_id());
  const auto type = names_->types.find(message.type_id());
  const auto writer = names_->writers.find(message.writer_id());
  if (topic == names_->topics.end() || type == names_->types.end() ||
      writer == names_->writers.end()) {
    return absl::InvalidArgumentError(
        absl::StrCat("message names ids that were not interned: ", message.topic_id(), ", ",
                     message.type_id(), ", ", message.writer_id()));
  }
  if (message.payload().size() > message.size_bytes()) {
    return absl::InvalidArgumentError(absl::StrCat("a payload of ", message.payload().size(),
                                                   " bytes in a message of ",
                                                   message.size_bytes()));
  }
  seen.topic = *topic->second;
  seen.type = *type->second;
  seen.sender = writer->second->node;
  seen.writer = writer->second->guid;
  seen.size_bytes = message.size_bytes();
  seen.payload = message.payload();
  // Counted, not believed.
  seen.truncated = message.payload().size() < message.size_bytes();
  return absl::OkStatus();
}

absl::StatusOr<pipeline::LossSeen> ObservationDecoder::DecodeLoss(
    const rips::v1::Loss& loss) const {
  if (loss.count() == 0) return absl::InvalidArgumentError("a loss of nothing");
  pipeline::LossSeen seen{.count = loss.count(), .cause = CauseName(loss.cause())};
  if (loss.writer_id() != 0) {
    const auto writer = names_->writers.find(loss.writer_id());
    if (writer == names_->writers.end()) {
      return absl::InvalidArgumentError(
          absl::StrCat("loss names writer ", loss.writer_id(), ", which was not interned"));
    }
    seen.tolerable = loss.cause() == rips::v1::Loss::DDS_GAP && !writer->second->reliable;
  }
  return seen;
}

absl::Status ObservationDecoder::DecodeOne(const rips::v1::Observation& observation, Lane lane,
                                           pipeline::Observation& one) const {
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
      const rips::v1::IdsAlert& ids = observation.ids();
      if (ids.line().size() > limits_.line_bytes || ids.message().size() > limits_.line_bytes) {
        return absl::ResourceExhaustedError(
            absl::StrCat("an alert line exceeds the limit of ", limits_.line_bytes, " bytes"));
      }
      one.what = pipeline::IdsAlertSeen{.message = ids.message(),
                                        .gid = ids.gid(),
                                        .sid = ids.sid(),
                                        .line = ids.line(),
                                        .source = ids.src(),
                                        .target = ids.dst()};
      break;
    }
    case rips::v1::Observation::kSignal:
      one.what = pipeline::SignalSeen{.name = observation.signal().name()};
      break;
    case rips::v1::Observation::kLoss: {
      RIPS_ASSIGN_OR_RETURN(one.what, DecodeLoss(observation.loss()));
      break;
    }
    case rips::v1::Observation::kState:
      one.what = pipeline::SensorStateSeen{.overloaded = observation.state().overloaded()};
      break;
    case rips::v1::Observation::KIND_NOT_SET:
      // A newer sensor's kind: not judged, so counted as lost.
      one.what = pipeline::LossSeen{.count = 1, .cause = "an observation of an unknown kind"};
      break;
  }
  return absl::OkStatus();
}

}  // namespace rips::ingest
