#include "sensor_agent/outbox/uplink_core.h"

#include <deque>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/overloaded.h"

namespace rips::sensor {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::StartsWith;

const std::string kLive(16, 'l');
const std::string kAside(16, 'a');
const std::string kFresh(16, 'n');

// Performs actions as the shell does, and writes down what they say: "c1+2" = control observations
// from sequence 1, two of them; "m" messages; "b" of the backlog; "chunk"; "hello"; "heartbeat".
class UplinkCoreTest : public testing::Test {
 protected:
  void On(UplinkInput input) {
    std::deque<UplinkInput> inputs;
    inputs.push_back(std::move(input));
    while (!inputs.empty()) {
      UplinkActions actions = core_.On(std::move(inputs.front()), {.boottime_ns = now_ns_});
      inputs.pop_front();
      wake_ns_ = actions.wake_ns;
      for (UplinkAction& each : actions.list) {
        std::optional<UplinkInput> result = Perform(each);
        if (result.has_value()) inputs.push_back(*std::move(result));
      }
    }
  }
  // The sender's turns until the time has passed.
  std::vector<std::string> Run(int64_t millis) {
    done_.clear();
    const int64_t end_ns = now_ns_ + millis * kNanosPerMilli;
    for (; now_ns_ <= end_ns; now_ns_ += kNanosPerMilli) {
      for (int turns = 0; wake_ns_ <= now_ns_; ++turns) {
        On(Turn{});
        if (turns == 100) {
          ADD_FAILURE() << "turns without end";
          return done_;
        }
      }
    }
    return done_;
  }
  std::vector<std::string> Sent(int64_t millis = 100) {
    std::vector<std::string> sent = Run(millis);
    std::erase(sent, "heartbeat");
    return sent;
  }

  std::optional<UplinkInput> Perform(UplinkAction& action) {
    return std::visit(
        Overloaded{[&](SendBatch& each) -> std::optional<UplinkInput> {
                     if (line_full_) return BatchSent{.status = SendStatus::kLineFull};
                     const char lane = each.lane == Lane::kControl ? 'c' : 'm';
                     Note(absl::StrCat(std::string(1, lane), core_.outbox().NextSequence(each.lane),
                                       "+", each.count, each.chunked_id > 0 ? " named" : ""));
                     return BatchSent{.count = each.count, .bytes = 100 * each.count};
                   },
                   [&](SendChunk& each) -> std::optional<UplinkInput> {
                     Note(absl::StrCat("chunk ", each.id, " at ", each.offset));
                     unwritten_ += each.bytes;
                     return ChunkSent{};
                   },
                   [&](TakeChunksBack&) -> std::optional<UplinkInput> {
                     Note("take back");
                     return ChunksTakenBack{.bytes = std::exchange(unwritten_, 0)};
                   },
                   [&](AwaitLine&) -> std::optional<UplinkInput> {
                     if (unwritten_ == 0) return LineFree{};
                     return std::nullopt;
                   },
                   [&](OpenBacklog& each) -> std::optional<UplinkInput> {
                     opened_ = each.batch;
                     return BacklogOpened{.bytes_max = 100};
                   },
                   [&](SendBacklog&) -> std::optional<UplinkInput> {
                     Note(absl::StrCat("b", opened_.first_sequence, "+", opened_.count));
                     return BacklogSent{.count = opened_.count, .bytes = 100};
                   },
                   [&](EncodeForBacklog& each) -> std::optional<UplinkInput> {
                     const size_t count =
                         std::visit([](const auto& all) { return all.size(); }, each.observations);
                     return Encoded{.stream = each.stream,
                                    .first_sequence = each.first_sequence,
                                    .count = static_cast<uint32_t>(count),
                                    .oldest_ns = now_ns_,
                                    .bytes = std::string(100, 'b')};
                   },
                   [&](SpoolWrite& each) -> std::optional<UplinkInput> {
                     written_[each.stream.incarnation] += each.count;
                     return SpoolWritten{
                         .stream = each.stream,
                         .first_sequence = each.first_sequence,
                         .record = SpoolRecord{.stream = each.stream,
                                               .first_sequence = each.first_sequence,
                                               .count = each.count}};
                   },
                   [&](SendHello& each) -> std::optional<UplinkInput> {
                     hello_ = each;
                     return Only("hello");
                   },
                   [&](SendHeartbeat&) -> std::optional<UplinkInput> { return Only("heartbeat"); },
                   [&](StreamResumed&) -> std::optional<UplinkInput> { return Only("resumed"); },
                   [&](CloseStream& each) -> std::optional<UplinkInput> { return Only(each.why); },
                   [&](WantGraph&) -> std::optional<UplinkInput> { return Only("want graph"); },
                   [&](ServerForgot&) -> std::optional<UplinkInput> { return Only("forgot"); },
                   [&](BacklogLost&) -> std::optional<UplinkInput> { return Only("lost"); },
                   [&](SpoolRead&) -> std::optional<UplinkInput> { return std::nullopt; },
                   [&](SpoolRelease&) -> std::optional<UplinkInput> { return std::nullopt; }},
        action);
  }
  void Note(std::string what) { done_.push_back(std::move(what)); }
  std::optional<UplinkInput> Only(std::string what) {
    Note(std::move(what));
    return std::nullopt;
  }

  void Ack(Lane lane, uint64_t sequence, const std::string& incarnation = kLive) {
    On(AckReceived{.stream = {.incarnation = incarnation, .lane = lane}, .sequence = sequence});
  }
  // All that the server says at the start of a stream.
  void Stream(uint64_t control = 0, uint64_t messages = 0) {
    On(StreamBegan{.incarnation = kFresh});
    On(ConfigReceived{});
    On(CreditReceived{.message_bytes = 1 << 20, .payload_bytes = 1 << 20});
    Ack(Lane::kControl, control);
    Ack(Lane::kMessages, messages);
  }
  void Settle() {
    On(Observations{.graph = {{.to_version = 1, .settled = true}}, .settled = true});
  }
  void See(int count, size_t payload_bytes = 0) {
    Observations seen;
    for (int i = 0; i < count; ++i) {
      seen.messages.push_back({.boottime_ns = now_ns_, .source = source_});
      if (payload_bytes == 0) continue;
      seen.messages.back().payload = std::make_shared<const std::string>(payload_bytes, 'p');
    }
    On(std::move(seen));
  }

  int64_t now_ns_ = 1'000 * kNanosPerSecond;
  int64_t wake_ns_ = 0;
  UplinkCore core_{{}, kLive, kAside};
  const std::shared_ptr<const MessageSource> source_ = std::make_shared<MessageSource>();
  std::vector<std::string> done_;
  SendHello hello_;
  BacklogBatch opened_;
  bool line_full_ = false;
  uint64_t unwritten_ = 0;
  std::map<std::string, uint64_t> written_;
};

TEST_F(UplinkCoreTest, NothingButHeartbeatsGoesUntilTheServerHasSaidAll) {
  Settle();
  See(2);
  EXPECT_THAT(Run(600), IsEmpty()) << "no stream";
  On(StreamBegan{});
  EXPECT_THAT(hello_.ranges.size(), 2u);
  On(ConfigReceived{});
  On(CreditReceived{.message_bytes = 10'000});
  Ack(Lane::kControl, 0);
  EXPECT_THAT(Run(600), ElementsAre("heartbeat"));
  Ack(Lane::kMessages, 0);
  EXPECT_EQ(core_.phase(), UplinkCore::Phase::kStreaming);
  EXPECT_THAT(Sent(), ElementsAre("c1+1", "m1+2"));
}

TEST_F(UplinkCoreTest, WhatIsLeftOfControlGoesBeforeWhatIsLiveIfItIsReadSoon) {
  const StreamKey left{.incarnation = "of another life!", .lane = Lane::kControl};
  On(Recovered{.records = {{.stream = left, .count = 2, .bytes = 10}}});
  Settle();
  Stream();
  EXPECT_THAT(Sent(100), IsEmpty()) << "the server has not said that it awaits it";
  Ack(Lane::kControl, 0, left.incarnation);
  EXPECT_THAT(Sent(100), IsEmpty());
  On(SpoolReadBack{.stream = left, .first_sequence = 1, .bytes = "b"});
  EXPECT_THAT(Sent(100), ElementsAre("b1+2", StartsWith("c1+")));
}

TEST_F(UplinkCoreTest, ADiskThatTakesItsTimeDoesNotHoldBackWhatIsLive) {
  const StreamKey left{.incarnation = "of another life!", .lane = Lane::kControl};
  On(Recovered{.records = {{.stream = left, .count = 2, .bytes = 10}}});
  Settle();
  Stream();
  Ack(Lane::kControl, 0, left.incarnation);
  EXPECT_THAT(Sent(450), IsEmpty());
  EXPECT_THAT(Sent(100), ElementsAre(StartsWith("c1+")));
}

TEST_F(UplinkCoreTest, HeartbeatsGoAsOftenAsTheServerOfThisStreamSays) {
  Settle();
  const auto heartbeats = [&](uint32_t heartbeat_ms, int64_t millis) {
    On(StreamBegan{});
    On(ConfigReceived{.heartbeat_ms = heartbeat_ms});
    const std::vector<std::string> sent = Run(millis);
    On(StreamEnded{});
    return std::count(sent.begin(), sent.end(), "heartbeat");
  };
  EXPECT_EQ(heartbeats(2'000, 6'100), 3);
  EXPECT_EQ(heartbeats(0, 6'100), 12) << "a server that sets none, whatever the last one set";
  EXPECT_EQ(heartbeats(100, 1'050), 10);
  EXPECT_EQ(heartbeats(1, 1'020), 20) << "not more often than each 50 ms";
  EXPECT_EQ(heartbeats(3'600'000, 21'000), 2) << "not more seldom than each 10 s";
}

TEST_F(UplinkCoreTest, LossesAreLookedForWhateverTheHeartbeat) {
  Settle();
  On(StreamBegan{});
  On(ConfigReceived{.heartbeat_ms = 10'000});
  Run(600);
  EXPECT_LE(wake_ns_ - now_ns_, 500 * kNanosPerMilli);
}

TEST_F(UplinkCoreTest, AStreamThatComesBackSendsWhatIsNotAcknowledgedUnderItsNumbers) {
  Settle();
  Stream();
  See(3);
  EXPECT_THAT(Sent(), ElementsAre("c1+1", "m1+3"));
  Ack(Lane::kMessages, 1);
  On(StreamEnded{.status = absl::UnavailableError("gone")});
  Stream(1, 2);
  EXPECT_EQ(hello_.ranges[1].range.first_sequence, 2u);
  EXPECT_EQ(hello_.ranges[1].acknowledged, 1u);
  EXPECT_THAT(Sent(), ElementsAre("m3+1"));
}

TEST_F(UplinkCoreTest, AServerThatForgotIsToldAnew) {
  Settle();
  Stream();
  Sent();
  Ack(Lane::kControl, 1);
  On(StreamEnded{.status = absl::UnavailableError("gone")});
  done_.clear();
  Stream(0, 0);
  EXPECT_THAT(done_, ElementsAre("hello", "resumed", "forgot"));
  EXPECT_THAT(Sent(), ElementsAre("c2+1")) << "a snapshot of what it had acknowledged";
}

TEST_F(UplinkCoreTest, FindingsAreToldAgainWhenAConfigAsksForThem) {
  Settle();
  On(StreamBegan{});
  On(ConfigReceived{.primary = false, .want_findings = true});
  On(CreditReceived{.message_bytes = 10'000});
  Ack(Lane::kControl, 0);
  Ack(Lane::kMessages, 0);
  EXPECT_THAT(done_, ElementsAre("hello", "forgot", "resumed"));
  done_.clear();
  On(ConfigReceived{.primary = false});
  EXPECT_THAT(done_, Not(Contains("forgot"))) << "it was asked once";
}

TEST_F(UplinkCoreTest, EachStreamIsToldWhichFindingsStand) {
  const auto states = [this] {  // the graph is one observation more
    Run(600);
    return core_.outbox().NextSequence(Lane::kControl) - 2;
  };
  Settle();
  Stream();
  EXPECT_EQ(states(), 0u);
  On(Observations{.findings_told = FindingsTold{.digest = 0, .all = false}});
  EXPECT_EQ(states(), 1u) << "none stands";
  EXPECT_EQ(states(), 1u) << "no news";
  On(Observations{.findings_told = FindingsTold{.digest = 0, .all = true}});
  EXPECT_EQ(states(), 2u);
  Ack(Lane::kControl, 3);
  On(StreamEnded{.status = absl::UnavailableError("gone")});
  Stream(3, 0);
  EXPECT_EQ(states(), 3u) << "the server may have been started anew";
}

TEST_F(UplinkCoreTest, AnIncarnationRefusedTwiceIsGivenUp) {
  Settle();
  for (int i = 0; i < 2; ++i) {
    Stream();
    On(StreamEnded{.status = absl::InvalidArgumentError("nonsense")});
  }
  On(StreamBegan{.incarnation = kFresh});
  EXPECT_TRUE(hello_.incarnation_is_new);
  EXPECT_EQ(core_.incarnation(), kFresh);
}

TEST_F(UplinkCoreTest, AnAcknowledgementOfWhatWasNotSentEndsTheStream) {
  Settle();
  Stream();
  Ack(Lane::kControl, 7);
  EXPECT_THAT(done_, Contains(HasSubstr("acknowledgement of 7")));
  EXPECT_EQ(core_.phase(), UplinkCore::Phase::kDown);
}

TEST_F(UplinkCoreTest, AFullLineIsTriedAgainAndLosesNothing) {
  Settle();
  Stream();
  line_full_ = true;
  EXPECT_THAT(Sent(), Not(Contains("c1+1")));
  line_full_ = false;
  EXPECT_THAT(Sent(10), ElementsAre("c1+1"));
}

TEST_F(UplinkCoreTest, WithoutCreditMessagesWaitAndControlGoes) {
  Settle();
  On(StreamBegan{});
  On(ConfigReceived{});
  On(CreditReceived{.message_bytes = 400});
  Ack(Lane::kControl, 0);
  Ack(Lane::kMessages, 0);
  See(5);
  EXPECT_THAT(Sent(), ElementsAre("c1+1", "m1+1", "m2+2")) << "a message may take 96 bytes";
  On(CreditReceived{.message_bytes = 10'000});
  EXPECT_THAT(Sent(), ElementsAre("m4+2"));
}

TEST_F(UplinkCoreTest, WhatIsNotLiveGoesToTheBacklogAndFollowsWhatIs) {
  Settle();
  See(3);
  Run(3'000);
  EXPECT_EQ(core_.backlog().state().observations, 3u);
  See(1);
  Stream();
  EXPECT_THAT(Sent(), ElementsAre("c1+1", "m1+1"));
  Ack(Lane::kMessages, 0, kAside);
  EXPECT_THAT(Sent(), ElementsAre("b1+3"));
  Ack(Lane::kMessages, 3, kAside);
  EXPECT_EQ(core_.backlog().state().observations, 0u);
}

TEST_F(UplinkCoreTest, ALongPayloadGoesInChunksAheadOfItsBatch) {
  Settle();
  Stream();
  Sent();
  See(1, 100'000);
  EXPECT_THAT(Sent(), ElementsAre("chunk 1 at 0", "chunk 1 at 65536"));
  unwritten_ = 0;
  On(LineFree{});
  EXPECT_THAT(Sent(), ElementsAre("m1+1 named"));
}

TEST_F(UplinkCoreTest, APayloadThatIsNotWrittenInTimeIsLeftOut) {
  Settle();
  Stream();
  Sent();
  See(1, 100'000);
  EXPECT_THAT(Sent(1'500),
              ElementsAre("chunk 1 at 0", "chunk 1 at 65536", "take back", "m1+1", "c2+1"));
  EXPECT_EQ(core_.outbox().shed_payloads(), 1u);
}

TEST_F(UplinkCoreTest, AStopWritesAllThatIsNotAcknowledged) {
  core_.SetDisk({.bytes_max = 1 << 20});
  Settle();
  Stream();
  Sent();
  See(3);
  On(Stopping{});
  EXPECT_TRUE(core_.drained());
  EXPECT_EQ(core_.backlog().Unwritten(), 0u);
  EXPECT_EQ(written_[kLive], 4u) << "the graph, and three messages";
}

}  // namespace
}  // namespace rips::sensor
