#include "sensor_agent/uplink/wire_encoder.h"

#include <algorithm>
#include <limits>
#include <variant>

#include "services/base/overloaded.h"
#include "services/model_proto/observation_codec.h"
#include "services/ros2_proto/graph_codec.h"
#include "services/wire_limits/field_limits.h"

namespace rips::sensor {

namespace {

using rips::v1::ObservationBatch;

rips::v1::Loss::Cause ToWire(LossCause cause) {
  switch (cause) {
    case LossCause::kDdsGap:
      return rips::v1::Loss::DDS_GAP;
    case LossCause::kQueueFull:
      return rips::v1::Loss::QUEUE_FULL;
    case LossCause::kOutboxShed:
      return rips::v1::Loss::OUTBOX_SHED;
    case LossCause::kSpoolLost:
      return rips::v1::Loss::SPOOL_LOST;
    case LossCause::kLimit:
      return rips::v1::Loss::LIMIT;
    case LossCause::kUndecodable:
      return rips::v1::Loss::UNDECODABLE;
  }
  return rips::v1::Loss::CAUSE_UNSPECIFIED;
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

// Every id in `batch` becomes change(id).
template <typename Change>
void ForEachId(ObservationBatch& batch, const Change& change) {
  for (rips::v1::Observation& each : *batch.mutable_observations()) {
    if (each.has_message()) {
      rips::v1::MessageSeen* message = each.mutable_message();
      message->set_topic_id(change(message->topic_id()));
      message->set_type_id(change(message->type_id()));
      message->set_writer_id(change(message->writer_id()));
    } else if (each.has_loss()) {
      rips::v1::Loss* loss = each.mutable_loss();
      loss->set_topic_id(change(loss->topic_id()));
      loss->set_writer_id(change(loss->writer_id()));
    }
  }
}

}  // namespace

ObservationBatch WireEncoder::Encode(const Outbox& outbox, Lane lane, size_t count,
                                     uint64_t chunked_id) {
  ObservationBatch batch;
  for (size_t i = 0; i < count && !full(); ++i) {
    if (lane == Lane::kMessages) {
      Add(outbox.UnsentMessage(i), batch, i + 1 == count ? chunked_id : 0);
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

template <typename Seen>
ObservationBatch WireEncoder::EncodeAlone(const std::vector<Seen>& observations) {
  ObservationBatch batch;
  WireEncoder encoder("");
  for (const Seen& each : observations) encoder.Add(each, batch);
  SetBase(batch);
  return batch;
}

template ObservationBatch WireEncoder::EncodeAlone(const std::vector<MessageSeen>&);
template ObservationBatch WireEncoder::EncodeAlone(const std::vector<ControlObservation>&);

void WireEncoder::AddGraph(const std::vector<GraphChange>& steps, ObservationBatch& batch) {
  for (const GraphChange& step : steps) {
    rips::v1::Observation* wire = batch.add_graph();
    model_proto::Encode(step, *wire);
    wire_limits::CutToLimits(*wire);
  }
}

absl::Status WireEncoder::Rename(ObservationBatch& batch) {
  if (next_id_ + static_cast<size_t>(batch.interned_size()) > limits_.names + 1) {
    return absl::ResourceExhaustedError("this stream has no numbers left for new names");
  }
  absl::flat_hash_map<uint32_t, uint32_t> here = {{0, 0}};
  for (const rips::v1::Intern& intern : batch.interned()) here[intern.id()] = 0;
  bool known = true;
  ForEachId(batch, [&](uint32_t id) {
    known = known && here.contains(id);
    return id;
  });
  if (!known) return absl::DataLossError("a batch that uses names it does not bring");
  ObservationBatch named;
  for (const rips::v1::Intern& intern : batch.interned()) {
    here[intern.id()] = IdOf(intern, named);
  }
  batch.mutable_interned()->Swap(named.mutable_interned());
  ForEachId(batch, [&](uint32_t id) { return here[id]; });
  // An earlier version may have written it.
  wire_limits::CutToLimits(batch);
  return absl::OkStatus();
}

uint32_t WireEncoder::IdOf(const rips::v1::Intern& intern, ObservationBatch& batch) {
  std::string key = intern.writer().SerializeAsString();
  auto* names = &writers_;
  if (!intern.has_writer()) {
    names = intern.has_topic() ? &topics_ : &types_;
    key = intern.has_topic() ? intern.topic() : intern.type();
  }
  const auto [it, is_new] = names->try_emplace(std::move(key), next_id_);
  if (!is_new) return it->second;
  rips::v1::Intern* own = batch.add_interned();
  *own = intern;
  own->set_id(next_id_++);
  return it->second;
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
  wire_limits::CutToLimits(*intern);
  return ids;
}

void WireEncoder::Add(const MessageSeen& message, ObservationBatch& batch, uint64_t chunked_id) {
  const SourceIds& ids = IdsOf(message.source, batch);
  rips::v1::Observation* wire = batch.add_observations();
  SetTime(message.boottime_ns, *wire);
  rips::v1::MessageSeen* seen = wire->mutable_message();
  seen->set_topic_id(ids.topic);
  seen->set_type_id(ids.type);
  seen->set_writer_id(ids.writer);
  seen->set_size_bytes(message.size_bytes);
  seen->set_writer_sequence(message.writer_sequence);
  if (chunked_id != 0) {
    seen->set_chunked_payload_id(chunked_id);
  } else if (message.payload != nullptr) {
    seen->set_payload(*message.payload);
  }
  seen->set_truncated(PayloadBytes(message) < message.size_bytes);
  seen->set_source_unix_ns(message.source_unix_ns);
  if (batch.graph_version() == 0) batch.set_graph_version(message.graph_version);
  if (message.graph_version != batch.graph_version()) {
    seen->set_graph_version(message.graph_version);
  }
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
  std::visit(Overloaded{[&](const Loss& loss) { AddLoss(loss, *wire->mutable_loss(), batch); },
                        [&](const auto& other) { model_proto::Encode(other, *wire); }},
             observation.what);
  wire_limits::CutToLimits(*wire);
}

}  // namespace rips::sensor
