// From the bytes of a batch to the verdicts on its messages.
#include <cstring>
#include <vector>

#include "policy_server/server/ingest/observation_decoder.h"
#include "rips/v1/sensor.pb.h"
#include "services/base/check.h"
#include "services/ros2_proto/graph_codec.h"
#include "services/wire_limits/field_limits.h"
#include "tests/bench/world.h"

namespace rips::bench {
namespace {

constexpr int kPerBatch = 64;
constexpr size_t kBatches = 64;

rips::v1::ObservationBatch EmptyBatch() {
  rips::v1::ObservationBatch batch;
  batch.set_incarnation(std::string(16, 'i'));
  batch.set_first_sequence(1);
  batch.set_base_boottime_ns(static_cast<uint64_t>(Now().boottime_ns));
  batch.set_lane(rips::v1::MESSAGES);
  return batch;
}

// Interned ids of topic `index` and of its writer; type 1.
uint32_t TopicId(size_t index) { return static_cast<uint32_t>(2 + 2 * index); }
uint32_t WriterId(size_t index) { return static_cast<uint32_t>(3 + 2 * index); }

void AddMessage(size_t topic, uint64_t number, rips::v1::ObservationBatch& batch) {
  rips::v1::Observation* observation = batch.add_observations();
  observation->set_offset_ns(number * 1'000'000);
  rips::v1::MessageSeen* message = observation->mutable_message();
  message->set_topic_id(TopicId(topic));
  message->set_type_id(1);
  message->set_writer_id(WriterId(topic));
  message->set_size_bytes(1'024);
  message->set_writer_sequence(100'000 + number);
}

// Names all topics and writers.
rips::v1::ObservationBatch Introduction() {
  rips::v1::ObservationBatch batch = EmptyBatch();
  rips::v1::Intern* type = batch.add_interned();
  type->set_id(1);
  type->set_type(kType);
  const ros2::GraphDelta graph = GraphOfTopics();
  for (size_t i = 0; i < kTopics; ++i) {
    rips::v1::Intern* topic = batch.add_interned();
    topic->set_id(TopicId(i));
    topic->set_topic(graph.upsert_endpoints[i].name);
    rips::v1::Intern* writer = batch.add_interned();
    writer->set_id(WriterId(i));
    ros2_proto::EncodeEndpoint(graph.upsert_endpoints[i], *writer->mutable_writer());
  }
  AddMessage(0, 0, batch);
  return batch;
}

std::vector<std::string> Wire() {
  const std::vector<uint32_t> draws = ZipfDraws();
  std::vector<std::string> wire;
  size_t at = 0;
  for (size_t i = 0; i < kBatches; ++i) {
    rips::v1::ObservationBatch batch = EmptyBatch();
    for (uint64_t k = 0; k < kPerBatch; ++k) AddMessage(draws[at++ % draws.size()], k, batch);
    wire.push_back(batch.SerializeAsString());
  }
  return wire;
}

// Copies and parses the next batch, as a stream does: into the same memory each time.
class Receiver {
 public:
  bool Next(rips::v1::ObservationBatch& batch) {
    const std::string& bytes = wire_[at_];
    at_ = (at_ + 1) % wire_.size();
    buffer_.resize(bytes.size());
    std::memcpy(buffer_.data(), bytes.data(), bytes.size());
    return batch.ParseFromString(buffer_) && batch.observations_size() == kPerBatch;
  }

 private:
  std::vector<std::string> wire_ = Wire();
  size_t at_ = 0;
  std::string buffer_;
};

void Parse(benchmark::State& state) {
  Receiver receiver;
  rips::v1::ObservationBatch batch;
  for (auto _ : state) {
    if (!receiver.Next(batch)) {
      state.SkipWithError("a batch does not parse");
      break;
    }
  }
  SetEvents(state, kPerBatch);
}
BENCHMARK(Parse)->Name("P3/parse");

ingest::ObservationDecoder MakeDecoder() {
  ingest::ObservationDecoder decoder;
  ingest::DecodeLimits limits;
  const rips::v1::ObservationBatch introduction = Introduction();
  RIPS_CHECK(static_cast<size_t>(introduction.interned_size()) < limits.interned, "room for names");
  RIPS_CHECK(decoder.Decode(introduction).ok(), "names of a benchmark are right");
  return decoder;
}

void ParseAndDecode(benchmark::State& state) {
  Receiver receiver;
  ingest::ObservationDecoder decoder = MakeDecoder();
  rips::v1::ObservationBatch batch;
  for (auto _ : state) {
    if (!receiver.Next(batch) || decoder.Decode(batch)->observations.size() != kPerBatch) {
      state.SkipWithError("a batch does not decode");
      break;
    }
  }
  SetEvents(state, kPerBatch);
}
BENCHMARK(ParseAndDecode)->Name("P3/parse_and_decode");

// What checking the fields adds to it.
void ParseCheckAndDecode(benchmark::State& state) {
  Receiver receiver;
  ingest::ObservationDecoder decoder = MakeDecoder();
  rips::v1::SensorMessage message;
  for (auto _ : state) {
    if (!receiver.Next(*message.mutable_batch()) || wire_limits::Check(message).has_value() ||
        decoder.Decode(message.batch())->observations.size() != kPerBatch) {
      state.SkipWithError("a batch is past a limit or does not decode");
      break;
    }
  }
  SetEvents(state, kPerBatch);
}
BENCHMARK(ParseCheckAndDecode)->Name("P3/parse_check_and_decode");

// Number of rules that fired; all of them are false here.
uint32_t Judge(const pipeline::Batch& batch, engine::RobotState& robot) {
  uint32_t fired = 0;
  for (const pipeline::Observation& one : batch.observations) {
    const auto& seen = std::get<pipeline::MessageSeen>(one.what);
    engine::Event event{.time_unix_ns = Now().unix_ns + one.boottime_ns};
    event.what = engine::MessageEvent{.topic = seen.topic,
                                      .type = seen.type,
                                      .writer = seen.writer,
                                      .sender = seen.sender,
                                      .size_bytes = seen.size_bytes,
                                      .memo = seen.memo};
    if (!engine::NeededInspections(event, Now(), robot).empty()) ++fired;
    fired += engine::Evaluate(event, Now(), robot).fired;
  }
  return fired;
}

void WireToVerdict(benchmark::State& state) {
  engine::RobotState robot = MakeRobot(MakeProgram(TopicRules(static_cast<int>(state.range(0)))));
  if (engine::Evaluate(MessageOn(kGuardedTopic), Now(), robot).fired != 1) {
    state.SkipWithError("the rules do not work");
  }
  Receiver receiver;
  ingest::ObservationDecoder decoder = MakeDecoder();
  rips::v1::ObservationBatch batch;
  for (auto _ : state) {
    if (!receiver.Next(batch)) {
      state.SkipWithError("a batch does not parse");
      break;
    }
    const absl::StatusOr<pipeline::Batch> decoded = decoder.Decode(batch);
    if (!decoded.ok() || Judge(*decoded, robot) != 0) {
      state.SkipWithError("a rule fired that does not apply");
      break;
    }
  }
  SetEvents(state, kPerBatch);
}
BENCHMARK(WireToVerdict)->Name("P3/wire_to_verdict")->Arg(100)->Arg(1'000);

}  // namespace
}  // namespace rips::bench
