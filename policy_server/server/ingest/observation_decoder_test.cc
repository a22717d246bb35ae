#include "policy_server/server/ingest/observation_decoder.h"

#include <random>
#include <string>

#include "gmock/gmock.h"
#include "services/base/status_matchers.h"
#include "services/wire_limits/field_limits.h"

namespace rips::ingest {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;

const std::string kIncarnation(16, 'i');
const std::string kGuid(16, 'g');

rips::v1::ObservationBatch Batch(rips::v1::Lane lane) {
  rips::v1::ObservationBatch batch;
  batch.set_incarnation(kIncarnation);
  batch.set_first_sequence(1);
  batch.set_lane(lane);
  batch.set_base_boottime_ns(1'000);
  return batch;
}

// Topic 1, type 2, writer 3 and one message of them.
rips::v1::ObservationBatch MessageBatch() {
  rips::v1::ObservationBatch batch = Batch(rips::v1::MESSAGES);
  auto* topic = batch.add_interned();
  topic->set_id(1);
  topic->set_topic("/cmd_vel");
  auto* type = batch.add_interned();
  type->set_id(2);
  type->set_type("geometry_msgs/msg/Twist");
  auto* writer = batch.add_interned();
  writer->set_id(3);
  writer->mutable_writer()->set_guid(kGuid);
  writer->mutable_writer()->set_kind(rips::v1::Endpoint::PUBLISHER);
  writer->mutable_writer()->set_node("/navigator");
  auto* observation = batch.add_observations();
  observation->set_offset_ns(5);
  observation->mutable_message()->set_topic_id(1);
  observation->mutable_message()->set_type_id(2);
  observation->mutable_message()->set_writer_id(3);
  observation->mutable_message()->set_size_bytes(52);
  return batch;
}

TEST(ObservationDecoderTest, ResolvesInternedNamesAlsoInLaterBatches) {
  ObservationDecoder decoder;
  const rips::v1::ObservationBatch first = MessageBatch();
  ASSERT_THAT(decoder.Decode(first), IsOk());
  rips::v1::ObservationBatch second = first;
  second.clear_interned();

  const auto batch = decoder.Decode(second);

  ASSERT_THAT(batch, IsOk());
  ASSERT_THAT(batch->observations, SizeIs(1));
  EXPECT_EQ(batch->observations[0].boottime_ns, 1'005);
  EXPECT_EQ(batch->bytes, second.ByteSizeLong());
  const auto& message = std::get<pipeline::MessageSeen>(batch->observations[0].what);
  EXPECT_EQ(message.topic, "/cmd_vel");
  EXPECT_EQ(message.type, "geometry_msgs/msg/Twist");
  EXPECT_EQ(message.sender, "/navigator");
  EXPECT_EQ(message.size_bytes, 52u);
}

TEST(ObservationDecoderTest, AMessageWithoutAGraphVersionHasThatOfItsBatch) {
  rips::v1::ObservationBatch batch = MessageBatch();
  batch.set_graph_version(7);
  *batch.add_observations() = batch.observations(0);
  batch.mutable_observations(1)->mutable_message()->set_graph_version(8);
  const auto decoded = ObservationDecoder().Decode(batch);
  ASSERT_THAT(decoded, IsOk());
  const auto version = [&](size_t index) {
    return std::get<pipeline::MessageSeen>(decoded->observations[index].what).graph_version;
  };
  EXPECT_EQ(version(0), 7u);
  EXPECT_EQ(version(1), 8u);
}

TEST(ObservationDecoderTest, MessagesMayBringStepsOfTheGraphAndNothingElse) {
  rips::v1::ObservationBatch batch = MessageBatch();
  auto* snapshot = batch.add_graph()->mutable_snapshot();
  snapshot->set_graph_version(7);
  snapshot->add_participants()->set_guid(kGuid);
  auto* delta = batch.add_graph()->mutable_delta();
  delta->set_from_version(7);
  delta->set_to_version(8);
  const auto decoded = ObservationDecoder().Decode(batch);
  ASSERT_THAT(decoded, IsOk());
  ASSERT_THAT(decoded->graph, SizeIs(2));
  EXPECT_TRUE(decoded->graph[0].whole());
  EXPECT_THAT(decoded->graph[0].delta.upsert_participants, SizeIs(1));
  EXPECT_EQ(decoded->graph[1].from_version, 7u);
  EXPECT_THAT(decoded->observations, SizeIs(1)) << "they are none of the sequence";

  rips::v1::ObservationBatch control = Batch(rips::v1::CONTROL);
  control.add_observations()->mutable_signal()->set_name("SIGUSR1");
  *control.add_graph() = batch.graph(0);
  EXPECT_THAT(ObservationDecoder().Decode(control),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("control lane")));
  for (auto* step : {batch.mutable_graph(0), batch.mutable_graph(1)}) {
    const rips::v1::Observation good = *step;
    step->mutable_signal()->set_name("SIGUSR1");
    EXPECT_THAT(ObservationDecoder().Decode(batch),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("no step of a graph")));
    step->Clear();
    EXPECT_THAT(ObservationDecoder().Decode(batch),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("no step of a graph")));
    *step = good;
  }
  batch.mutable_graph(1)->mutable_delta()->set_to_version(7);
  EXPECT_THAT(ObservationDecoder().Decode(batch), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(ObservationDecoderTest, PayloadsComeAlongAndAreCounted) {
  rips::v1::ObservationBatch batch = MessageBatch();
  for (const size_t bytes : {size_t{0}, size_t{51}, size_t{52}}) {
    auto* message = batch.mutable_observations(0)->mutable_message();
    message->set_payload(std::string(bytes, '\0'));
    for (const bool claimed : {false, true}) {
      message->set_truncated(claimed);
      const auto decoded = ObservationDecoder().Decode(batch);
      ASSERT_THAT(decoded, IsOk());
      const auto& seen = std::get<pipeline::MessageSeen>(decoded->observations[0].what);
      EXPECT_EQ(seen.payload, std::string(bytes, '\0'));
      EXPECT_EQ(seen.truncated, bytes < 52) << "whatever the sensor claims";
      EXPECT_EQ(decoded->bytes, batch.ByteSizeLong());
    }
  }
}

TEST(ObservationDecoderTest, PayloadsOfABatchAreBoundedTogether) {
  rips::v1::ObservationBatch batch = MessageBatch();
  batch.mutable_observations(0)->mutable_message()->set_size_bytes(64 * 1024);
  batch.mutable_observations(0)->mutable_message()->set_payload(std::string(64 * 1024, 'x'));
  for (int i = 1; i < 16; ++i) *batch.add_observations() = batch.observations(0);
  EXPECT_THAT(ObservationDecoder().Decode(batch), IsOk());
  auto* more = batch.add_observations();
  *more = batch.observations(0);
  more->mutable_message()->set_payload("x");
  EXPECT_THAT(
      ObservationDecoder().Decode(batch),
      StatusIs(absl::StatusCode::kResourceExhausted,
               HasSubstr("batch with 1048577 bytes of payload exceeds the limit of 1048576")));
}

rips::v1::PayloadChunk Chunk(uint64_t id, const std::string& data) {
  rips::v1::PayloadChunk chunk;
  chunk.set_chunked_payload_id(id);
  chunk.set_data(data);
  return chunk;
}

TEST(ObservationDecoderTest, PayloadsThatComeInChunksBelongToTheNextBatchOfMessages) {
  ObservationDecoder decoder;
  for (const uint64_t id : {1, 2, 3}) {
    rips::v1::PayloadChunk chunk = Chunk(id, std::string(10 * id, static_cast<char>('0' + id)));
    ASSERT_THAT(decoder.TakeChunk(chunk), IsOk());
  }
  // A control batch in between takes none of them.
  rips::v1::ObservationBatch control = Batch(rips::v1::CONTROL);
  control.add_observations()->mutable_signal()->set_name("SIGUSR1");
  const auto signal = decoder.Decode(control);
  ASSERT_THAT(signal, IsOk());
  EXPECT_EQ(signal->payload_bytes, 0u);

  rips::v1::ObservationBatch batch = MessageBatch();
  *batch.add_observations() = batch.observations(0);
  batch.mutable_observations(0)->mutable_message()->set_chunked_payload_id(1);
  batch.mutable_observations(1)->mutable_message()->set_chunked_payload_id(3);
  const auto decoded = decoder.Decode(batch);
  ASSERT_THAT(decoded, IsOk());
  const auto seen = [&](size_t i) {
    return std::get<pipeline::MessageSeen>(decoded->observations[i].what);
  };
  EXPECT_EQ(seen(0).payload, std::string(10, '1'));
  EXPECT_EQ(seen(1).payload, std::string(30, '3'));
  EXPECT_TRUE(seen(1).truncated) << "30 bytes of 52";
  EXPECT_EQ(decoded->payload_bytes, 60u) << "the one that was not named counts, too";
  EXPECT_EQ(decoded->bytes, batch.ByteSizeLong());

  batch.clear_interned();
  EXPECT_THAT(decoder.Decode(batch), StatusIs(absl::StatusCode::kInvalidArgument,
                                              HasSubstr("payload 1, which did not come")));
}

TEST(ObservationDecoderTest, AMessageHasOnePayloadAndNoMoreThanItsSize) {
  rips::v1::ObservationBatch batch = MessageBatch();
  auto* message = batch.mutable_observations(0)->mutable_message();
  message->set_chunked_payload_id(1);
  {
    ObservationDecoder decoder;
    rips::v1::PayloadChunk chunk = Chunk(1, std::string(53, 'x'));
    ASSERT_THAT(decoder.TakeChunk(chunk), IsOk());
    EXPECT_THAT(decoder.Decode(batch),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         HasSubstr("a payload of 53 bytes in a message of 52")));
  }
  message->set_payload("x");
  ObservationDecoder decoder;
  rips::v1::PayloadChunk chunk = Chunk(1, "y");
  ASSERT_THAT(decoder.TakeChunk(chunk), IsOk());
  EXPECT_THAT(decoder.Decode(batch), StatusIs(absl::StatusCode::kInvalidArgument,
                                              HasSubstr("with a payload names payload 1")));
}

TEST(ObservationDecoderTest, NamesOutliveTheDecoder) {
  absl::StatusOr<pipeline::Batch> batch;
  {
    ObservationDecoder decoder;
    batch = decoder.Decode(MessageBatch());
  }
  ASSERT_THAT(batch, IsOk());
  EXPECT_EQ(std::get<pipeline::MessageSeen>(batch->observations[0].what).topic, "/cmd_vel");
}

struct Malformed {
  const char* name;
  void (*spoil)(rips::v1::ObservationBatch&);
  absl::StatusCode code;
  const char* text;
};

TEST(ObservationDecoderTest, RefusesWhatIsMalformedWithAReason) {
  const auto invalid = absl::StatusCode::kInvalidArgument;
  const auto exhausted = absl::StatusCode::kResourceExhausted;
  const Malformed cases[] = {
      {"incarnation", [](auto& b) { b.set_incarnation("short"); }, invalid, "5 bytes"},
      {"lane", [](auto& b) { b.set_lane(static_cast<rips::v1::Lane>(9)); }, invalid,
       "unknown lane 9"},
      {"wrong lane", [](auto& b) { b.set_lane(rips::v1::CONTROL); }, invalid,
       "a message in the control lane"},
      {"empty", [](auto& b) { b.clear_observations(); }, invalid, "empty batch"},
      {"id 0", [](auto& b) { b.mutable_interned(0)->set_id(0); }, invalid, "not allowed"},
      {"id twice", [](auto& b) { b.mutable_interned(1)->set_id(1); }, invalid, "used twice"},
      {"nothing named", [](auto& b) { b.mutable_interned(0)->clear_topic(); }, invalid,
       "names nothing"},
      {"writer guid", [](auto& b) { b.mutable_interned(2)->mutable_writer()->set_guid("short"); },
       invalid, ""},
      {"writer kind",
       [](auto& b) {
         b.mutable_interned(2)->mutable_writer()->set_kind(rips::v1::Endpoint::KIND_UNSPECIFIED);
       },
       invalid, "kind 0"},
      {"unknown topic",
       [](auto& b) { b.mutable_observations(0)->mutable_message()->set_topic_id(8); }, invalid,
       "not interned"},
      {"topic as type",
       [](auto& b) { b.mutable_observations(0)->mutable_message()->set_type_id(1); }, invalid,
       "not interned"},
      {"payload",
       [](auto& b) {
         b.mutable_observations(0)->mutable_message()->set_payload(std::string((1 << 20) + 1, 'x'));
       },
       exhausted, "payload"},
      {"payload longer than the message",
       [](auto& b) {
         b.mutable_observations(0)->mutable_message()->set_payload(std::string(53, 'x'));
       },
       invalid, "a payload of 53 bytes in a message of 52"},
      {"control kind in message lane",
       [](auto& b) { b.mutable_observations(0)->mutable_signal()->set_name("SIGUSR1"); }, invalid,
       "in the message lane"},
  };
  for (const Malformed& each : cases) {
    rips::v1::ObservationBatch batch = MessageBatch();
    each.spoil(batch);
    EXPECT_THAT(ObservationDecoder().Decode(batch), StatusIs(each.code, HasSubstr(each.text)))
        << each.name;
  }
}

TEST(ObservationDecoderTest, RefusesMoreNamesThanItsLimit) {
  ObservationDecoder decoder({.interned = 3});
  ASSERT_THAT(decoder.Decode(MessageBatch()), IsOk());
  rips::v1::ObservationBatch batch = MessageBatch();
  batch.clear_interned();
  auto* more = batch.add_interned();
  more->set_id(4);
  more->set_topic("/one_more");

  EXPECT_THAT(decoder.Decode(batch), StatusIs(absl::StatusCode::kResourceExhausted));
}

TEST(ObservationDecoderTest, AnUnknownKindIsALossOfOne) {
  rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
  batch.add_observations();

  const auto decoded = ObservationDecoder().Decode(batch);

  ASSERT_THAT(decoded, IsOk());
  EXPECT_EQ(std::get<model::Loss>(decoded->observations[0].what).count, 1u);
}

TEST(ObservationDecoderTest, AlertsOfAnIdsHaveAddressesWithoutPorts) {
  rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
  rips::v1::IdsAlert* ids = batch.add_observations()->mutable_ids();
  ids->set_message("scan");
  ids->set_gid(1);
  ids->set_sid(7);
  ids->set_line("11/21 scan");
  for (const auto& [wire, address] :
       std::vector<std::pair<std::string, std::string>>{{"10.0.0.1:80", "10.0.0.1"},
                                                        {"10.0.0.1", "10.0.0.1"},
                                                        {"fe80::1", "fe80::1"},
                                                        {"[fe80::1]:80", "fe80::1"},
                                                        {"[fe80::1", "[fe80::1"},
                                                        {"", ""}}) {
    ids->set_src(wire);
    ids->set_dst(wire);
    const auto decoded = ObservationDecoder().Decode(batch);
    ASSERT_THAT(decoded, IsOk());
    const auto& seen = std::get<model::IdsAlert>(decoded->observations[0].what);
    EXPECT_EQ(seen.src, address);
    EXPECT_EQ(seen.dst, address);
    EXPECT_EQ(seen.message, "scan");
    EXPECT_EQ(seen.sid, 7u);
    EXPECT_EQ(seen.line, "11/21 scan");
  }
}

TEST(ObservationDecoderTest, OnlyGapsOfBestEffortWritersAreTolerable) {
  for (const bool reliable : {false, true}) {
    rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
    auto* writer = batch.add_interned();
    writer->set_id(1);
    writer->mutable_writer()->set_guid(kGuid);
    writer->mutable_writer()->set_kind(rips::v1::Endpoint::PUBLISHER);
    writer->mutable_writer()->mutable_qos()->set_reliable(reliable);
    auto* loss = batch.add_observations()->mutable_loss();
    loss->set_cause(rips::v1::Loss::DDS_GAP);
    loss->set_writer_id(1);
    loss->set_count(2);

    const auto decoded = ObservationDecoder().Decode(batch);

    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(std::get<model::Loss>(decoded->observations[0].what).tolerable, !reliable);
  }
}

rips::v1::Loss* AddLoss(rips::v1::ObservationBatch& batch) {
  auto* topic = batch.add_interned();
  topic->set_id(1);
  topic->set_topic("/a");
  auto* writer = batch.add_interned();
  writer->set_id(2);
  writer->mutable_writer()->set_guid(kGuid);
  writer->mutable_writer()->set_kind(rips::v1::Endpoint::PUBLISHER);
  writer->mutable_writer()->set_name("/a");
  writer->mutable_writer()->set_type("a/msg/A");
  writer->mutable_writer()->set_ros(true);
  auto* loss = batch.add_observations()->mutable_loss();
  loss->set_cause(rips::v1::Loss::QUEUE_FULL);
  loss->set_count(2);
  loss->set_first_boottime_ns(5);
  loss->set_last_boottime_ns(9);
  return loss;
}

TEST(ObservationDecoderTest, ALossSaysOfWhat) {
  const auto decode = [](uint32_t topic_id, uint32_t writer_id) {
    rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
    rips::v1::Loss* loss = AddLoss(batch);
    loss->set_topic_id(topic_id);
    loss->set_writer_id(writer_id);
    const auto decoded = ObservationDecoder().Decode(batch);
    EXPECT_THAT(decoded, IsOk());
    return std::get<model::Loss>(decoded->observations[0].what);
  };
  const model::Loss several = decode(0, 0);
  EXPECT_EQ(several.topic, "");
  EXPECT_TRUE(several.writer.none());
  EXPECT_EQ(several.first_ns, 5);
  EXPECT_EQ(several.last_ns, 9);
  EXPECT_EQ(decode(1, 0).topic, "/a");
  EXPECT_EQ(decode(1, 0).type, "") << "a topic may have several";
  for (const uint32_t topic_id : {0, 1}) {
    const model::Loss one = decode(topic_id, 2);
    EXPECT_EQ(one.topic, "/a");
    EXPECT_EQ(one.type, "a/msg/A");
    EXPECT_EQ(one.writer.ToBytes(), kGuid);
    EXPECT_FALSE(one.tolerable);
  }
}

TEST(ObservationDecoderTest, ALossOfWhatWasNotInternedIsRefused) {
  for (const auto& [topic_id, writer_id] :
       {std::pair<uint32_t, uint32_t>{3, 0}, {2, 0}, {0, 3}, {0, 1}, {UINT32_MAX, 0}}) {
    rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
    rips::v1::Loss* loss = AddLoss(batch);
    loss->set_topic_id(topic_id);
    loss->set_writer_id(writer_id);
    EXPECT_THAT(ObservationDecoder().Decode(batch),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("not interned")));
  }
}

// Each is within its limit: an offset, too, may be as long as a boottime.
TEST(ObservationDecoderTest, TimesThatAreTooLateTogetherAreRefused) {
  rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
  batch.add_observations()->mutable_signal()->set_name("SIGUSR1");
  batch.set_base_boottime_ns(wire_limits::kTimeMax);
  EXPECT_THAT(ObservationDecoder().Decode(batch), IsOk());
  batch.mutable_observations(0)->set_offset_ns(2);
  EXPECT_THAT(ObservationDecoder().Decode(batch),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("no clock shows")));
  batch.mutable_observations(0)->set_offset_ns(wire_limits::kTimeMax);
  EXPECT_THAT(ObservationDecoder().Decode(batch), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(ObservationDecoderTest, SensorsSayHowTheyFareAndWhatTheyDoNotSee) {
  rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
  rips::v1::SensorState* state = batch.add_observations()->mutable_state();
  state->set_overloaded(true);
  state->set_outbox_bytes(1);
  state->set_oldest_unacked_ns(UINT64_MAX);
  state->set_spool_bytes(3);
  state->add_not_visible("x");
  state->add_blind("y");
  const auto decoded = ObservationDecoder().Decode(batch);
  ASSERT_THAT(decoded, IsOk());
  const auto& seen = std::get<pipeline::SensorStateSeen>(decoded->observations[0].what);
  EXPECT_TRUE(seen.overloaded);
  EXPECT_EQ(seen.outbox_bytes, 1u);
  EXPECT_GT(seen.oldest_unacked_ns, 0);
  EXPECT_EQ(seen.spool_bytes, 3u);
  EXPECT_THAT(seen.not_visible, testing::ElementsAre("x"));
  EXPECT_THAT(seen.blind, testing::ElementsAre("y"));
}

TEST(ObservationDecoderTest, AHeartbeatHasClocksAndAnEcho) {
  rips::v1::Heartbeat heartbeat;
  heartbeat.mutable_clock()->set_boottime_ns(3);
  heartbeat.mutable_clock()->set_unix_ns(-4);
  heartbeat.set_echo_boottime_ns(5);
  pipeline::SensorHeartbeat decoded = DecodeHeartbeat(heartbeat);
  EXPECT_EQ(decoded.clock, (Instant{.boottime_ns = 3, .unix_ns = -4}));
  EXPECT_EQ(decoded.echo_boottime_ns, 5);
  heartbeat.set_echo_boottime_ns(UINT64_MAX);
  EXPECT_EQ(DecodeHeartbeat(heartbeat).echo_boottime_ns, 0);
}

TEST(ObservationDecoderTest, AnyCutOrFlippedBatchIsDecodedOrRefused) {
  const std::string good = MessageBatch().SerializeAsString();
  std::mt19937 random(7);
  for (size_t cut = 0; cut < good.size(); ++cut) {
    rips::v1::ObservationBatch batch;
    if (!batch.ParseFromString(good.substr(0, cut))) continue;
    (void)ObservationDecoder().Decode(batch).ok();
  }
  for (int i = 0; i < 5'000; ++i) {
    std::string bytes = good;
    bytes[random() % bytes.size()] = static_cast<char>(random());
    rips::v1::ObservationBatch batch;
    if (!batch.ParseFromString(bytes)) continue;
    const auto decoded = ObservationDecoder().Decode(batch);
    if (decoded.ok()) {
      EXPECT_EQ(decoded->observations.size(), static_cast<size_t>(batch.observations_size()));
    }
  }
}

TEST(ObservationDecoderTest, GraphVersionsMustAdvance) {
  rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
  auto* delta = batch.add_observations()->mutable_delta();
  delta->set_from_version(3);
  delta->set_to_version(3);
  EXPECT_THAT(ObservationDecoder().Decode(batch),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("from version 3 to 3")));
  delta->set_to_version(4);
  EXPECT_THAT(ObservationDecoder().Decode(batch), IsOk());

  batch.mutable_observations(0)->mutable_snapshot();
  EXPECT_THAT(ObservationDecoder().Decode(batch),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("count from 1")));
  batch.mutable_observations(0)->mutable_snapshot()->set_graph_version(1);
  EXPECT_THAT(ObservationDecoder().Decode(batch), IsOk());
}

TEST(ObservationDecoderTest, FindingsAreTakenAndTheirTextMadeHarmless) {
  rips::v1::ObservationBatch batch = Batch(rips::v1::CONTROL);
  rips::v1::Finding* finding = batch.add_observations()->mutable_finding();
  finding->set_kind("of_a_later_version");
  finding->set_guid(std::string(16, '\1'));
  finding->set_node("/n");
  finding->set_topic("/t");
  finding->set_detail("a\x1b[2Jb\n");
  finding->set_over(true);
  const auto decoded = ObservationDecoder().Decode(batch);
  ASSERT_THAT(decoded, IsOk());
  const auto& seen = std::get<pipeline::FindingSeen>(decoded->observations[0].what);
  EXPECT_EQ(seen.kind, "of_a_later_version");
  EXPECT_EQ(seen.guid.ToBytes(), std::string(16, '\1'));
  EXPECT_EQ(seen.node, "/n");
  EXPECT_EQ(seen.topic, "/t");
  EXPECT_EQ(seen.detail, "a\\x1b[2Jb\\x0a");
  EXPECT_TRUE(seen.over);
}

TEST(ObservationDecoderTest, FindingsThatMakeNoSenseAreRefused) {
  rips::v1::ObservationBatch good = Batch(rips::v1::CONTROL);
  good.add_observations()->mutable_finding()->set_kind("impostor");
  ASSERT_THAT(ObservationDecoder().Decode(good), IsOk());

  rips::v1::ObservationBatch batch = good;
  batch.mutable_observations(0)->mutable_finding()->set_kind("");
  EXPECT_THAT(ObservationDecoder().Decode(batch), StatusIs(absl::StatusCode::kInvalidArgument));
  batch = good;
  batch.mutable_observations(0)->mutable_finding()->set_guid("short");
  EXPECT_THAT(ObservationDecoder().Decode(batch), StatusIs(absl::StatusCode::kInvalidArgument));
  batch = good;
  batch.set_lane(rips::v1::MESSAGES);
  EXPECT_THAT(ObservationDecoder().Decode(batch), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(HelloTest, RefusesWhatIsMalformed) {
  rips::v1::SensorHello good;
  good.mutable_hello()->set_protocol(1);
  good.mutable_hello()->set_incarnation(kIncarnation);
  ASSERT_THAT(DecodeHello(good), IsOk());

  rips::v1::SensorHello hello = good;
  hello.mutable_hello()->set_protocol(0);
  EXPECT_THAT(DecodeHello(hello), StatusIs(absl::StatusCode::kInvalidArgument));
  hello.mutable_hello()->set_protocol(2);
  EXPECT_THAT(DecodeHello(hello), StatusIs(absl::StatusCode::kFailedPrecondition));
  hello = good;
  hello.set_participant_guid("short");
  EXPECT_THAT(DecodeHello(hello), StatusIs(absl::StatusCode::kInvalidArgument));
  hello.set_participant_guid(std::string(16, '\x01'));
  ASSERT_THAT(DecodeHello(hello), IsOk());
  EXPECT_EQ(DecodeHello(hello)->participant.ToBytes(), std::string(16, '\x01'));
  hello = good;
  EXPECT_TRUE(DecodeHello(hello)->participant.none());
  auto* range = hello.add_spooled();
  range->set_incarnation(kIncarnation);
  range->set_lane(rips::v1::CONTROL);
  EXPECT_THAT(DecodeHello(hello), StatusIs(absl::StatusCode::kInvalidArgument)) << "sequence 0";
  range->set_first_sequence(391);
  range->set_acknowledged_sequence(390);
  const auto decoded = DecodeHello(hello);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_EQ(decoded->spooled[0].acknowledged, 390u);
  EXPECT_EQ(decoded->store, store::StorePoint());
  for (const size_t bytes : {1, 15, 17, 1 << 20}) {
    hello.mutable_store()->set_generation(std::string(bytes, 'g'));
    EXPECT_THAT(DecodeHello(hello), StatusIs(absl::StatusCode::kInvalidArgument)) << bytes;
  }
  hello.mutable_store()->set_generation(std::string(16, 'g'));
  hello.mutable_store()->set_commit(UINT64_MAX);
  ASSERT_THAT(DecodeHello(hello), IsOk());
  EXPECT_EQ(DecodeHello(hello)->store,
            (store::StorePoint{.generation = std::string(16, 'g'), .commit = UINT64_MAX}));
}

}  // namespace
}  // namespace rips::ingest
