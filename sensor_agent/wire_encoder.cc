#include "sensor_agent/wire_encoder.h"

#include <algorithm>
#include <limits>

#include "services/ros2_proto/graph_codec.h"

namespace rips::sensor {

namespace {

using rips::v1::ObservationBatch;

// A MessageSeen but for its payload, with its Observation and tags, never takes more than this.
constexpr size_t kMessageWireBytesMax = 80;
// Incarnation, sequence, time and lane of a batch.
constexpr size_t kBatchWireBytesMax = 64;

rips::v1::Loss::Cause ToWire(LossCause cause) {
  switch (cause) {
    case LossCause::kDdsGap:
      return rips::v1::Loss::DDS_GAP;
    case LossCause::kQueueFull:
      return rips::v1::Loss::QUEUE_FULL;
    case LossCause::kOutboxShed:
      return rips::v1::Loss::OUTBOX_SHED;
    case LossCause::kLimit:
      return rips::v1::Loss::LIMIT;
    case LossCause::kUndecodable:
      return rips::v1::Loss::UNDECODABLE;
  }
  return rips::v1::Loss::CAUSE_UNSPECIFIED;
}

void FillSnapshot(const GraphChange& change, rips::v1::GraphSnapshot& wire) {
  wire.set_graph_version(change.to_version);
  wire.set_settled(change.settled);
  ros2_proto::EncodeGraph(change.delta, wire);
}

void FillDelta(const GraphChange& change, rips::v1::GraphDelta& wire) {
  wire.set_from_version(change.from_version);
  wire.set_to_version(change.to_version);
  wire.set_settled(change.settled);
  ros2_proto::EncodeGraph(change.delta, wire);
}

// Before the observation times are subtracted from it.
void SetTime(int64_t boottime_ns, rips::v1::Observation& wire) {
  wire.set_offset_ns(static_cast<uint64_t>(std::max<int64_t>(boottime_ns, 0)));
}

// Until here offset_ns holds absolute times.
void SetBase(ObservationBatch& batch) {
  uint64_t base = std::numeric_limits<uint64_t>::max();
  for (const auto& each : batch.observations()) base = std::min(base, each.offset_ns());
  batch.set_base_boottime_ns(base);
  for (auto& each : *batch.mutable_observations()) each.set_offset_ns(each.offset_ns() - base);
}

// Upper bound of what introducing `source` adds to a batch.
size_t IntroductionBytes(const MessageSource& source) {
  return 3 * 16 + source.topic.size() + source.type.size() + 64 + CostOf(source.writer);
}

void FillIdsAlert(const IdsAlert& alert, rips::v1::IdsAlert& wire) {
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

void FillFinding(const Finding& finding, rips::v1::Finding& wire) {
  wire.set_kind(finding.kind);
  if (!finding.guid.none()) wire.set_guid(finding.guid.ToBytes());
  wire.set_node(finding.node);
  wire.set_topic(finding.topic);
  wire.set_detail(finding.detail);
  wire.set_over(finding.over);
}

}  // namespace

ObservationBatch WireEncoder::Encode(const Outbox& outbox, Lane lane, const BatchPolicy& policy,
                                     uint64_t credit_bytes) {
  ObservationBatch batch;
  const size_t count = std::min(outbox.unsent(lane), policy.observations);
  // Upper bounds for messages, about the size for control observations.
  size_t bytes = kBatchWireBytesMax;
  size_t payload_bytes = 0;
  for (size_t i = 0; i < count && !full(); ++i) {
    size_t more = 0;
    if (lane == Lane::kMessages) {
      const MessageSeen& message = outbox.UnsentMessage(i);
      more = kMessageWireBytesMax + PayloadBytes(message);
      payload_bytes += PayloadBytes(message);
      if (!sources_.contains(message.source.get())) more += IntroductionBytes(*message.source);
      if (bytes + more > credit_bytes) break;
    } else {
      more = CostOf(outbox.UnsentControl(i));
    }
    if (i > 0 && (bytes + more > policy.bytes || payload_bytes > kBatchPayloadBytesMax)) break;
    bytes += more;
    if (lane == Lane::kMessages) {
      Add(outbox.UnsentMessage(i), batch);
    } else {
      Add(outbox.UnsentControl(i), batch);
    }
  }
  if (batch.observations_size() == 0) return batch;
  batch.set_incarnation(incarnation_);
  batch.set_first_sequence(outbox.NextSequence(lane));
  batch.set_lane(lane == Lane::kControl ? rips::v1::CONTROL : rips::v1::MESSAGES);
  SetBase(batch);
  return batch;
}

uint32_t WireEncoder::TopicId(const std::string& topic, ObservationBatch& batch) {
  const auto [it, is_new] = topics_.try_emplace(topic, next_id_);
  if (is_new) {
    rips::v1::Intern* intern = batch.add_interned();
    intern->set_id(next_id_++);
    intern->set_topic(topic);
  }
  return it->second;
}

const WireEncoder::SourceIds& WireEncoder::IdsOf(const std::shared_ptr<const MessageSource>& source,
                                                 ObservationBatch& batch) {
  const auto [it, is_new] = sources_.try_emplace(source.get());
  SourceIds& ids = it->second;
  if (!is_new) return ids;
  ids.source = source;
  ids.topic = TopicId(source->topic, batch);
  const auto [type, new_type] = types_.try_emplace(source->type, next_id_);
  ids.type = type->second;
  if (new_type) {
    rips::v1::Intern* intern = batch.add_interned();
    intern->set_id(next_id_++);
    intern->set_type(source->type);
  }
  ids.writer = next_id_++;
  rips::v1::Intern* intern = batch.add_interned();
  intern->set_id(ids.writer);
  ros2_proto::EncodeEndpoint(source->writer, *intern->mutable_writer());
  return ids;
}

void WireEncoder::Add(const MessageSeen& message, ObservationBatch& batch) {
  const SourceIds& ids = IdsOf(message.source, batch);
  rips::v1::Observation* wire = batch.add_observations();
  SetTime(message.boottime_ns, *wire);
  rips::v1::MessageSeen* seen = wire->mutable_message();
  seen->set_topic_id(ids.topic);
  seen->set_type_id(ids.type);
  seen->set_writer_id(ids.writer);
  seen->set_size_bytes(message.size_bytes);
  seen->set_writer_sequence(message.writer_sequence);
  if (message.payload != nullptr) seen->set_payload(*message.payload);
  seen->set_truncated(PayloadBytes(message) < message.size_bytes);
  seen->set_source_unix_ns(message.source_unix_ns);
}

void WireEncoder::AddLoss(const Loss& loss, rips::v1::Loss& wire, ObservationBatch& batch) {
  wire.set_cause(ToWire(loss.cause));
  wire.set_count(loss.count);
  wire.set_first_boottime_ns(static_cast<uint64_t>(loss.first_boottime_ns));
  wire.set_last_boottime_ns(static_cast<uint64_t>(loss.last_boottime_ns));
  if (loss.source != nullptr) {
    const SourceIds& ids = IdsOf(loss.source, batch);
    wire.set_topic_id(ids.topic);
    wire.set_writer_id(ids.writer);
  } else if (!loss.topic.empty()) {
    wire.set_topic_id(TopicId(loss.topic, batch));
  }
}

void WireEncoder::Add(const ControlObservation& observation, ObservationBatch& batch) {
  rips::v1::Observation* wire = batch.add_observations();
  SetTime(observation.boottime_ns, *wire);
  if (const auto* change = std::get_if<GraphChange>(&observation.what)) {
    if (change->from_version == 0) {
      FillSnapshot(*change, *wire->mutable_snapshot());
    } else {
      FillDelta(*change, *wire->mutable_delta());
    }
  } else if (const auto* loss = std::get_if<Loss>(&observation.what)) {
    AddLoss(*loss, *wire->mutable_loss(), batch);
  } else if (const auto* signal = std::get_if<SignalSeen>(&observation.what)) {
    wire->mutable_signal()->set_name(signal->name);
    wire->mutable_signal()->set_count(signal->count);
  } else if (const auto* alert = std::get_if<IdsAlert>(&observation.what)) {
    FillIdsAlert(*alert, *wire->mutable_ids());
  } else if (const auto* finding = std::get_if<Finding>(&observation.what)) {
    FillFinding(*finding, *wire->mutable_finding());
  } else {
    const SensorState& state = std::get<SensorState>(observation.what);
    wire->mutable_state()->set_overloaded(state.overloaded);
    wire->mutable_state()->set_outbox_bytes(state.outbox_bytes);
    wire->mutable_state()->set_oldest_unacked_ns(
        static_cast<uint64_t>(std::max<int64_t>(state.oldest_unacked_ns, 0)));
    for (const std::string& kind : state.not_visible) wire->mutable_state()->add_not_visible(kind);
  }
}

}  // namespace rips::sensor
