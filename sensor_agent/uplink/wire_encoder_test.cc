#include "sensor_agent/uplink/wire_encoder.h"

#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "rips/v1/sensor.pb.h"
#include "sensor_agent/outbox/batch_planner.h"
#include "services/base/status_matchers.h"
#include "services/wire_limits/field_limits.h"

namespace rips::sensor {
namespace {

using rips::v1::ObservationBatch;
using ::testing::HasSubstr;
using ::testing::SizeIs;

constexpr uint64_t kPlenty = 1 << 30;
const char kIncarnation[] = "0123456789abcdef";

std::shared_ptr<const MessageSource> Source(const std::string& topic, uint8_t writer,
                                            const std::string& node = "/talker") {
  ros2::Endpoint endpoint{.name = topic,
                          .type = "std_msgs/msg/String",
                          .node = node,
                          .qos = {.reliable = true, .depth = 7, .partitions = {"p"}},
                          .visibility = ros2::Visibility::kWatched};
  endpoint.guid.bytes[15] = writer;
  return std::make_shared<const MessageSource>(
      MessageSource{.topic = topic, .type = "std_msgs/msg/String", .writer = endpoint});
}

// The encoder of a stream, given what its planner says.
class PlannedEncoder {
 public:
  explicit PlannedEncoder(const std::string& incarnation, EncoderLimits limits = {})
      : encoder_(incarnation, limits) {}

  // `uploaded` went in chunks as 7.
  ObservationBatch Encode(const Outbox& outbox, Lane lane, const BatchPolicy& policy,
                          uint64_t credit, const Payload& uploaded = nullptr) {
    const size_t count = planner_.Plan(outbox, lane, policy, credit, uploaded);
    const bool named =
        uploaded != nullptr && count > 0 && outbox.UnsentMessage(count - 1).payload == uploaded;
    return encoder_.Encode(outbox, lane, count, named ? 7 : 0);
  }
  void Sent(size_t count) { planner_.Sent(count); }
  absl::Status Rename(ObservationBatch& batch) { return encoder_.Rename(batch); }
  bool full() const { return encoder_.full(); }

 private:
  WireEncoder encoder_;
  BatchPlanner planner_;
};

class WireEncoderTest : public testing::Test {
 protected:
  void Add(const std::shared_ptr<const MessageSource>& source, int64_t at_ns) {
    outbox_.AddMessage({.boottime_ns = at_ns,
                        .source = source,
                        .writer_sequence = 5,
                        .source_unix_ns = -7,
                        .size_bytes = 24});
  }
  void AddPayload(const std::shared_ptr<const MessageSource>& source, uint32_t size, size_t bytes) {
    outbox_.AddMessage({.boottime_ns = 1,
                        .source = source,
                        .size_bytes = size,
                        .payload = std::make_shared<const std::string>(bytes, 'x')});
  }
  ObservationBatch Send(PlannedEncoder& encoder, Lane lane = Lane::kMessages,
                        const BatchPolicy& policy = {}, uint64_t credit = kPlenty) {
    ObservationBatch batch = encoder.Encode(outbox_, lane, policy, credit);
    const auto count = static_cast<size_t>(batch.observations_size());
    encoder.Sent(count);
    outbox_.MarkSent(lane, count);
    return batch;
  }

  Outbox outbox_;
};

TEST_F(WireEncoderTest, NamesAreInternedOncePerStreamAndNeverReused) {
  const auto a = Source("/a", 1);
  const auto b = Source("/b", 2);
  const auto a2 = Source("/a", 1, "/known_now");
  PlannedEncoder encoder(kIncarnation);
  Add(a, 100);
  Add(a, 90);
  Add(b, 110);
  const ObservationBatch first = Send(encoder);
  ASSERT_THAT(first.interned(), SizeIs(5)) << "two topics, one type, two writers";
  EXPECT_EQ(first.interned(0).id(), 1);
  EXPECT_EQ(first.interned(0).topic(), "/a");
  EXPECT_EQ(first.interned(1).type(), "std_msgs/msg/String");
  EXPECT_EQ(first.interned(2).writer().node(), "/talker");
  EXPECT_EQ(first.interned(2).writer().qos().partitions(0), "p");
  EXPECT_EQ(first.interned(3).topic(), "/b");
  EXPECT_EQ(first.interned(4).id(), 5);
  EXPECT_EQ(first.observations(2).message().type_id(), 2);
  EXPECT_EQ(first.incarnation(), kIncarnation);
  EXPECT_EQ(first.first_sequence(), 1);
  EXPECT_EQ(first.base_boottime_ns(), 90);
  EXPECT_EQ(first.observations(0).offset_ns(), 10);
  EXPECT_EQ(first.observations(1).offset_ns(), 0);
  EXPECT_EQ(first.observations(0).message().source_unix_ns(), -7);
  EXPECT_EQ(first.observations(0).message().writer_sequence(), 5);
  EXPECT_TRUE(first.observations(0).message().truncated());

  Add(b, 120);
  Add(a2, 130);
  const ObservationBatch second = Send(encoder);
  ASSERT_THAT(second.interned(), SizeIs(1)) << "only the writer that has changed";
  EXPECT_EQ(second.interned(0).id(), 6);
  EXPECT_EQ(second.interned(0).writer().node(), "/known_now");
  EXPECT_EQ(second.first_sequence(), 4);

  // Another stream knows nothing yet.
  outbox_.Rewind();
  PlannedEncoder next(kIncarnation);
  const ObservationBatch again = Send(next);
  EXPECT_THAT(again.interned(), SizeIs(6));
  EXPECT_EQ(again.first_sequence(), 1);
  EXPECT_THAT(again.observations(), SizeIs(5));
}

TEST_F(WireEncoderTest, BatchEndsAtItsLimits) {
  const auto source = Source("/a", 1);
  for (int i = 0; i < 1'000; ++i) Add(source, i);
  PlannedEncoder encoder(kIncarnation);
  EXPECT_THAT(Send(encoder, Lane::kMessages, {.observations = 128}).observations(), SizeIs(128));
  const ObservationBatch small =
      Send(encoder, Lane::kMessages, {.observations = 256, .bytes = 2'000});
  EXPECT_LT(small.observations_size(), 256);
  EXPECT_GT(small.observations_size(), 10);
  EXPECT_LE(small.ByteSizeLong(), 2'000u);
}

TEST_F(WireEncoderTest, CreditIsNeverExceeded) {
  for (int i = 0; i < 50; ++i) {
    Add(Source(absl::StrCat("/topic_with_a_name_", i), static_cast<uint8_t>(i)), i);
  }
  for (uint64_t credit = 0; credit < 3'000; credit += 37) {
    PlannedEncoder encoder(kIncarnation);
    const ObservationBatch batch = encoder.Encode(outbox_, Lane::kMessages, {}, credit);
    EXPECT_LE(batch.ByteSizeLong(), credit);
    if (credit < 100) {
      EXPECT_EQ(batch.observations_size(), 0) << credit;
    }
    if (credit >= 500) {
      EXPECT_GT(batch.observations_size(), 0) << credit;
    }
    if (credit >= 500) credit += 400;
  }
}

TEST_F(WireEncoderTest, PayloadsComeAlongAndAreCalledTruncatedWhenShorter) {
  const auto source = Source("/a", 1);
  AddPayload(source, 24, 24);
  AddPayload(source, 25, 24);
  AddPayload(source, 24, 0);
  AddPayload(source, 0, 0);
  Add(source, 1);
  PlannedEncoder encoder(kIncarnation);
  const ObservationBatch batch = Send(encoder);
  ASSERT_THAT(batch.observations(), SizeIs(5));
  EXPECT_EQ(batch.observations(0).message().payload(), std::string(24, 'x'));
  EXPECT_FALSE(batch.observations(0).message().truncated());
  EXPECT_EQ(batch.observations(1).message().payload(), std::string(24, 'x'));
  EXPECT_TRUE(batch.observations(1).message().truncated());
  EXPECT_TRUE(batch.observations(2).message().truncated());
  EXPECT_FALSE(batch.observations(3).message().truncated());
  EXPECT_EQ(batch.observations(4).message().payload(), "");
  EXPECT_TRUE(batch.observations(4).message().truncated());
}

TEST_F(WireEncoderTest, PayloadsKeepTheLimitsOfABatchAndTheCredit) {
  const auto source = Source("/a", 1);
  for (int i = 0; i < 40; ++i) AddPayload(source, 100'000, 64 * 1024);
  PlannedEncoder encoder(kIncarnation);
  // One goes, whatever it takes.
  EXPECT_THAT(Send(encoder).observations(), SizeIs(1));
  EXPECT_THAT(Send(encoder, Lane::kMessages, {.bytes = 150'000}).observations(), SizeIs(2));
  EXPECT_THAT(Send(encoder, Lane::kMessages, {.bytes = size_t{4} << 20}).observations(), SizeIs(16))
      << "1 MiB of payload";
  EXPECT_THAT(Send(encoder, Lane::kMessages, {}, 64 * 1024).observations(), SizeIs(0));
  for (uint64_t credit = 64 * 1024; credit < 64 * 1024 + 200; ++credit) {
    const ObservationBatch batch = encoder.Encode(outbox_, Lane::kMessages, {}, credit);
    EXPECT_LE(batch.ByteSizeLong(), credit);
  }
  EXPECT_THAT(Send(encoder, Lane::kMessages, {}, 64 * 1024 + 200).observations(), SizeIs(1));
}

TEST_F(WireEncoderTest, TheGraphVersionIsSaidOncePerBatchUnlessItDiffers) {
  const auto source = Source("/a", 1);
  for (const uint64_t version : {7, 7, 8}) {
    outbox_.AddMessage({.boottime_ns = 1, .source = source, .graph_version = version});
  }
  PlannedEncoder encoder(kIncarnation);
  const ObservationBatch batch = Send(encoder);
  EXPECT_EQ(batch.graph_version(), 7u);
  EXPECT_EQ(batch.observations(0).message().graph_version(), 0u);
  EXPECT_EQ(batch.observations(1).message().graph_version(), 0u);
  EXPECT_EQ(batch.observations(2).message().graph_version(), 8u);
}

TEST_F(WireEncoderTest, ALongPayloadIsNamedAndEndsItsBatch) {
  const auto source = Source("/a", 1);
  AddPayload(source, 10, 10);
  AddPayload(source, 70'000, 65'537);
  AddPayload(source, 11, 11);
  AddPayload(source, 70'001, 65'536);
  PlannedEncoder encoder(kIncarnation);
  const Payload next = outbox_.UnsentMessage(1).payload;

  // While it was not sent, what is before it goes.
  EXPECT_THAT(encoder.Encode(outbox_, Lane::kMessages, {}, kPlenty).observations(), SizeIs(1));
  const Payload other = std::make_shared<const std::string>(65'537, 'x');
  EXPECT_THAT(encoder.Encode(outbox_, Lane::kMessages, {}, kPlenty, other).observations(),
              SizeIs(1));

  const ObservationBatch batch =
      encoder.Encode(outbox_, Lane::kMessages, {.bytes = 1'024}, 1'024, next);
  ASSERT_THAT(batch.observations(), SizeIs(2));
  EXPECT_EQ(batch.observations(0).message().chunked_payload_id(), 0);
  EXPECT_EQ(batch.observations(1).message().chunked_payload_id(), 7);
  EXPECT_EQ(batch.observations(1).message().payload(), "");
  EXPECT_TRUE(batch.observations(1).message().truncated());
  EXPECT_LT(batch.ByteSizeLong(), 1'024u);
  outbox_.MarkSent(Lane::kMessages, 2);

  const ObservationBatch rest = Send(encoder);
  ASSERT_THAT(rest.observations(), SizeIs(1)) << "32 KiB";
  EXPECT_EQ(Send(encoder).observations(0).message().payload().size(), 65'536u) << "inline";

  // On disk everything is inline.
  outbox_.Rewind();
  const ObservationBatch whole = WireEncoder(kIncarnation).Encode(outbox_, Lane::kMessages, 4);
  ASSERT_THAT(whole.observations(), SizeIs(4));
  EXPECT_EQ(whole.observations(1).message().payload().size(), 65'537u);
}

TEST_F(WireEncoderTest, LargestNumbersStayWithinTheEstimate) {
  const auto source = Source("/a", 1);
  outbox_.AddMessage({.boottime_ns = 0, .source = source});
  for (int i = 0; i < 100; ++i) {
    outbox_.AddMessage({.boottime_ns = INT64_MAX,
                        .source = source,
                        .writer_sequence = UINT64_MAX,
                        .source_unix_ns = -1,
                        .size_bytes = UINT32_MAX,
                        .payload = std::make_shared<const std::string>(300, 'x')});
  }
  for (uint64_t credit = 1'000; credit < 40'000; credit += 333) {
    PlannedEncoder encoder(kIncarnation);
    const BatchPolicy policy{.observations = 256, .bytes = size_t{1} << 20};
    EXPECT_LE(encoder.Encode(outbox_, Lane::kMessages, policy, credit).ByteSizeLong(), credit);
  }
}

TEST_F(WireEncoderTest, LargeControlObservationGoesAlone) {
  GraphChange change{.from_version = 0, .to_version = 1, .settled = true};
  for (uint8_t i = 0; i < 200; ++i) {
    ros2::Endpoint endpoint{.name = std::string(200, 'x'), .type = "t"};
    endpoint.guid.bytes[15] = i;
    change.delta.upsert_endpoints.push_back(endpoint);
  }
  outbox_.AddGraph(change, 10);
  outbox_.AddGraph({.from_version = 1, .to_version = 2, .settled = true}, 20);
  PlannedEncoder encoder(kIncarnation);
  const ObservationBatch first = Send(encoder, Lane::kControl);
  ASSERT_THAT(first.observations(), SizeIs(1));
  EXPECT_TRUE(first.observations(0).snapshot().settled());
  EXPECT_THAT(first.observations(0).snapshot().endpoints(), SizeIs(200));
  const ObservationBatch second = Send(encoder, Lane::kControl);
  EXPECT_EQ(second.observations(0).delta().from_version(), 1);
  EXPECT_EQ(second.lane(), rips::v1::CONTROL);
}

TEST_F(WireEncoderTest, ControlObservationsCarryWhatTheySay) {
  const auto source = Source("/a", 1);
  ros2::GraphDelta delta;
  ros2::Guid guid;
  guid.bytes[0] = 9;
  delta.upsert_participants = {
      {.guid = guid, .host = "h", .enclave = "/e", .pid = 4, .vendor = "0110", .address = "::1"}};
  delta.upsert_nodes = {{"/n", guid}};
  delta.gone_guids = {guid};
  delta.gone_nodes = {"/gone"};
  outbox_.AddGraph({.from_version = 3, .to_version = 4, .delta = delta}, 10);
  outbox_.AddLoss({.cause = LossCause::kDdsGap,
                   .topic = "/a",
                   .source = source,
                   .count = 3,
                   .first_boottime_ns = 5,
                   .last_boottime_ns = 6});
  outbox_.AddLoss({.cause = LossCause::kQueueFull, .topic = "/b", .count = 4});
  outbox_.AddLoss({.cause = LossCause::kLimit, .count = 5});
  outbox_.AddSignal("SIGUSR1", 1'000'000'000);
  outbox_.AddState(
      {.overloaded = true, .outbox_bytes = 8, .oldest_unacked_ns = 9, .blind = {"no log"}}, 11);
  outbox_.FlushMerged(1'000'000'000);
  PlannedEncoder encoder(kIncarnation);
  const ObservationBatch batch = Send(encoder, Lane::kControl);
  ASSERT_THAT(batch.observations(), SizeIs(6));
  const auto& graph = batch.observations(0).delta();
  EXPECT_EQ(graph.upsert_participants(0).vendor(), "0110");
  EXPECT_EQ(graph.upsert_nodes(0).full_name(), "/n");
  EXPECT_EQ(graph.gone_guids(0), guid.ToBytes());
  EXPECT_EQ(graph.gone_nodes(0), "/gone");
  const auto& gap = batch.observations(1).loss();
  EXPECT_EQ(gap.cause(), rips::v1::Loss::DDS_GAP);
  EXPECT_EQ(gap.count(), 3);
  EXPECT_EQ(gap.topic_id(), 1);
  EXPECT_EQ(gap.writer_id(), 3);
  EXPECT_EQ(batch.observations(2).loss().cause(), rips::v1::Loss::QUEUE_FULL);
  EXPECT_EQ(batch.observations(2).loss().topic_id(), 4);
  EXPECT_EQ(batch.observations(2).loss().writer_id(), 0);
  EXPECT_EQ(batch.observations(3).loss().cause(), rips::v1::Loss::LIMIT);
  EXPECT_EQ(batch.observations(4).signal().name(), "SIGUSR1");
  EXPECT_TRUE(batch.observations(5).state().overloaded());
  EXPECT_EQ(batch.observations(5).state().blind(0), "no log");
}

// A hostile node chooses partitions and gaps in its sequence; neither may end the sensor's stream.
TEST_F(WireEncoderTest, WhatIsTooLongForTheServerIsCutAndSent) {
  auto loud = std::make_shared<MessageSource>(*Source("/a", 1));
  loud->writer.qos.partitions.assign(40, std::string(512, 'p'));
  loud->writer.why = std::string(2'000, 'w');
  Add(loud, 100);
  outbox_.AddLoss({.cause = LossCause::kDdsGap, .source = loud, .count = UINT64_MAX});
  outbox_.AddState({.blind = std::vector<std::string>(100, std::string(2'000, 'b'))}, 11);
  outbox_.FlushMerged(1'000'000'000);
  PlannedEncoder encoder(kIncarnation);
  rips::v1::SensorMessage messages;
  *messages.mutable_batch() = Send(encoder);
  EXPECT_EQ(wire_limits::Check(messages), std::nullopt);
  EXPECT_EQ(messages.batch().interned(2).writer().qos().partitions_size(), 16);
  rips::v1::SensorMessage control;
  *control.mutable_batch() = Send(encoder, Lane::kControl);
  EXPECT_EQ(wire_limits::Check(control), std::nullopt);
  ASSERT_THAT(control.batch().observations(), SizeIs(2));
  EXPECT_EQ(control.batch().observations(0).loss().count(), wire_limits::kLossCountMax);
  EXPECT_EQ(control.batch().observations(1).state().blind_size(), 32);

  // What an earlier version has left on the disk.
  ObservationBatch old;
  auto* finding = old.add_observations()->mutable_finding();
  finding->set_kind("impostor");
  finding->set_detail(std::string(5'000, 'd'));
  ASSERT_THAT(encoder.Rename(old), IsOk());
  EXPECT_EQ(old.observations(0).finding().detail().size(), 1'024u);
}

TEST_F(WireEncoderTest, StreamThatRunsOutOfNumbersSaysSo) {
  PlannedEncoder encoder(kIncarnation, {.names = 7});
  for (uint8_t i = 0; i < 5; ++i) Add(Source(absl::StrCat("/t", i), i), i);
  const ObservationBatch batch = Send(encoder);
  EXPECT_LT(batch.observations_size(), 5);
  EXPECT_GT(batch.observations_size(), 0);
  EXPECT_TRUE(encoder.full());
  EXPECT_THAT(Send(encoder).observations(), SizeIs(0));
  for (const auto& intern : batch.interned()) EXPECT_LE(intern.id(), 7);
}

TEST_F(WireEncoderTest, ABatchAloneTakesTheNamesOfTheStreamThatSendsIt) {
  const auto a = Source("/a", 1);
  const auto b = Source("/b", 2);
  const std::vector<MessageSeen> seen = {{.boottime_ns = 300, .source = b, .size_bytes = 1},
                                         {.boottime_ns = 200, .source = a, .size_bytes = 2}};
  ObservationBatch first = WireEncoder::EncodeAlone(seen);
  ObservationBatch second = WireEncoder::EncodeAlone(seen);
  EXPECT_EQ(first.base_boottime_ns(), 200u);
  EXPECT_THAT(first.interned(), SizeIs(5)) << "two topics, one type, two writers";
  PlannedEncoder encoder(kIncarnation);
  Add(a, 100);
  const ObservationBatch live = Send(encoder);  // takes 1 to 3

  ASSERT_THAT(encoder.Rename(first), IsOk());
  ASSERT_THAT(encoder.Rename(second), IsOk());

  std::map<uint32_t, std::string> names;
  for (const ObservationBatch* batch : {&live, &std::as_const(first), &std::as_const(second)}) {
    for (const rips::v1::Intern& each : batch->interned()) {
      const std::string name =
          each.has_writer() ? each.writer().name() : each.topic() + each.type();
      EXPECT_TRUE(names.emplace(each.id(), name).second) << "number " << each.id() << " twice";
    }
    for (const rips::v1::Observation& each : batch->observations()) {
      const std::string& topic = names[each.message().topic_id()];
      EXPECT_EQ(topic, each.message().size_bytes() == 1 ? "/b" : "/a");
      EXPECT_EQ(names[each.message().writer_id()], topic);
      EXPECT_EQ(names[each.message().type_id()], "std_msgs/msg/String");
    }
  }
  EXPECT_THAT(second.interned(), SizeIs(0));
}

TEST_F(WireEncoderTest, LossesAloneKeepTheirNamesToo) {
  const auto a = Source("/a", 1);
  ObservationBatch batch = WireEncoder::EncodeAlone(std::vector<ControlObservation>{
      {.boottime_ns = 5, .what = Loss{.topic = "/a", .source = a, .count = 3}},
      {.boottime_ns = 6, .what = IdsAlert{.message = "scan"}}});
  PlannedEncoder encoder(kIncarnation);
  Add(Source("/z", 9), 1);
  Send(encoder);
  ASSERT_THAT(encoder.Rename(batch), IsOk());
  EXPECT_EQ(batch.observations(0).loss().topic_id(), batch.interned(0).id());
  EXPECT_GT(batch.observations(0).loss().topic_id(), 3u);
  EXPECT_EQ(batch.observations(1).ids().message(), "scan");
}

TEST_F(WireEncoderTest, ABatchThatUsesUnknownNamesIsRefusedAndNothingHasChanged) {
  ObservationBatch batch =
      WireEncoder::EncodeAlone(std::vector<MessageSeen>{{.source = Source("/a", 1)}});
  batch.mutable_observations(0)->mutable_message()->set_topic_id(99);
  PlannedEncoder encoder(kIncarnation);
  EXPECT_TRUE(absl::IsDataLoss(encoder.Rename(batch)));
  Add(Source("/a", 1), 1);
  EXPECT_EQ(Send(encoder).interned(0).id(), 1u);
}

TEST_F(WireEncoderTest, ABatchWithMoreNamesThanAreLeftNeedsAnotherStream) {
  ObservationBatch batch =
      WireEncoder::EncodeAlone(std::vector<MessageSeen>{{.source = Source("/a", 1)}});
  PlannedEncoder encoder(kIncarnation, {.names = 2});
  EXPECT_TRUE(absl::IsResourceExhausted(encoder.Rename(batch)));
  EXPECT_THAT(batch.interned(), SizeIs(3));
}

}  // namespace
}  // namespace rips::sensor
