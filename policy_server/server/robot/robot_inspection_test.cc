// The message lane while payloads are inspected, and robots whose rules have crashed.
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using engine::Verdict;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr char kInspecting[] = R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules Msg:
  seen: true ? alert("seen " + Topic);
  bad: topicin("/image") && payload("bad.yar") ? alert("bad " + Topic);
rules External:
  signal: signal("SIGUSR1") ? alert("signal");
  false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
)";

class RobotInspectionTest : public RobotTest {
 protected:
  void Begin(const std::string& rules = kInspecting) {
    Start(rules);
    ConnectSensor();
    SendSnapshot();
    audience_.alerts.clear();
  }
  static Observation On(absl::string_view topic, std::string payload = "xyz") {
    return {.what = MessageSeen{.topic = topic,
                                .type = "sensor_msgs/msg/Image",
                                .sender = "/camera",
                                .writer = Writer(1),
                                .size_bytes = 3,
                                .payload = std::move(payload)}};
  }
  void Answer(Verdict verdict) {
    inspector_->Answer(verdict);
    Drain();
  }
  std::vector<engine::TopicInterest> PayloadsAskedFor() const {
    std::vector<engine::TopicInterest> rows;
    for (const engine::TopicInterest& row : sensor_->interest) {
      if (row.depth == engine::Depth::kPayload) rows.push_back(row);
    }
    return rows;
  }
  std::vector<std::string> Texts() const {
    std::vector<std::string> out;
    for (const auto& alert : audience_.alerts) out.push_back(alert.text);
    return out;
  }
};

TEST_F(RobotInspectionTest, MessagesWaitInOrderAndControlDoesNot) {
  Begin();
  SendBatch(Lane::kMessages, {On("/a"), On("/image"), On("/b")});
  SendBatch(Lane::kMessages, {On("/c")});
  EXPECT_THAT(Texts(), IsEmpty());
  ASSERT_THAT(inspector_->questions, SizeIs(1));
  EXPECT_EQ(inspector_->questions[0].topic, "/image");
  EXPECT_EQ(inspector_->questions[0].payload, "xyz");
  EXPECT_EQ(sensor_->acknowledged[1], 0u);

  SendBatch(Lane::kControl, {{.what = SignalSeen{"SIGUSR1"}}});
  EXPECT_THAT(Texts(), ElementsAre("signal"));

  Answer(Verdict::kYes);
  EXPECT_THAT(Texts(),
              ElementsAre("signal", "seen /a", "seen /image", "bad /image", "seen /b", "seen /c"));
  Pass(1'000);
  EXPECT_EQ(sensor_->acknowledged[1], 4u);
}

TEST_F(RobotInspectionTest, ThePayloadsThatRulesNeedAreAskedFor) {
  Begin();
  const std::vector<engine::TopicInterest> payloads = PayloadsAskedFor();
  ASSERT_THAT(payloads, SizeIs(1));
  EXPECT_EQ(payloads[0].topic_regex, R"(^\/image$)");
  EXPECT_EQ(payloads[0].payload_bytes_max, 1u << 20);
  EXPECT_THAT(sensor_->payload_limits, IsEmpty());

  // A policy with the same rules and other limits is another thing to ask for.
  const int before = sensor_->interests;
  Policy policy{.program = *engine::CompiledPolicy::Create(
                    *lang::Compile({{.path = "test.rul", .text = kInspecting}}).rules),
                .bundle_id = "sha256:1",
                .inspector = inspector_,
                .payload_limits = {{.topic_regex = "^/image$", .bytes = 4 << 20}}};
  ASSERT_TRUE(robot_->SwapPolicy(std::move(policy)).ok());
  EXPECT_EQ(sensor_->interests, before + 1);
  ASSERT_THAT(sensor_->payload_limits, SizeIs(1));
  EXPECT_EQ(sensor_->payload_limits[0].bytes, 4u << 20);
}

TEST_F(RobotInspectionTest, PayloadCreditComesBackWhenItsMessagesAreJudged) {
  Begin();
  constexpr uint64_t kWindow = 8 << 20;
  EXPECT_EQ(sensor_->payload_granted, kWindow);
  SendBatch(Lane::kMessages, {On("/image")}, /*payload_bytes=*/3 << 20);
  SendBatch(Lane::kMessages, {On("/image")}, 2 << 20);
  Answer(Verdict::kNo);
  EXPECT_EQ(sensor_->payload_granted, kWindow) << "less than half of it";
  Answer(Verdict::kNo);
  EXPECT_EQ(sensor_->payload_granted, kWindow + (5 << 20));
}

TEST_F(RobotInspectionTest, CoverageNamesTheTopicsWhosePayloadsWereCut) {
  uint64_t counted = 0;
  counts_.payloads_cut = [&](uint64_t by) { counted += by; };
  Begin();
  const auto cut = [](absl::string_view topic, size_t came, uint32_t size) {
    Observation one = On(topic, std::string(came, 'x'));
    std::get<MessageSeen>(one.what).size_bytes = size;
    std::get<MessageSeen>(one.what).truncated = came < size;
    return one;
  };
  SendBatch(Lane::kMessages, {cut("/image", 100, 250), cut("/image", 100, 300), cut("/a", 7, 7),
                              cut("/shed", 0, 9), cut("/b", 50, 60)});
  for (int i = 0; i < 2; ++i) Answer(Verdict::kNo);
  EXPECT_EQ(counted, 3u);
  const std::vector<CutPayloads::Topic> topics = robot_->core().sight().CutTopics();
  ASSERT_THAT(topics, SizeIs(2));
  EXPECT_EQ(topics[0].topic, "/b");
  EXPECT_EQ(topics[1].topic, "/image");
  EXPECT_EQ(topics[1].limit_bytes, 100u);
  EXPECT_EQ(topics[1].longest_bytes, 300u);
  EXPECT_EQ(topics[1].count, 2u);
}

TEST_F(RobotInspectionTest, ANoAndAnUnscanned) {
  Begin();
  SendBatch(Lane::kMessages, {On("/image")});
  Answer(Verdict::kNo);
  EXPECT_THAT(Texts(), ElementsAre("seen /image"));
  SendBatch(Lane::kMessages, {On("/image", "")});
  Answer(Verdict::kUnscanned);
  EXPECT_THAT(Texts(), ElementsAre("seen /image", "seen /image", "bad /image"));
}

TEST_F(RobotInspectionTest, WithoutAnInspectorRulesAreNotTold) {
  inspector_ = nullptr;
  Begin();
  SendBatch(Lane::kMessages, {On("/image")});
  EXPECT_THAT(Texts(), ElementsAre("seen /image", "bad /image"));
}

TEST_F(RobotInspectionTest, AsksFewAtATime) {
  Begin();
  std::vector<Observation> many;
  for (int i = 0; i < 100; ++i) many.push_back(On("/image"));
  SendBatch(Lane::kMessages, std::move(many));
  size_t most = 0;
  for (int i = 0; i < 100; ++i) {
    ASSERT_FALSE(inspector_->questions.empty()) << i;
    most = std::max(most, inspector_->questions.size());
    Answer(Verdict::kNo);
  }
  EXPECT_EQ(most, 32u);
  EXPECT_THAT(inspector_->questions, IsEmpty());
  EXPECT_EQ(Texts().size(), 100u);
}

TEST_F(RobotInspectionTest, AStreamThatEndsTakesItsMessagesAlong) {
  Begin();
  SendBatch(Lane::kMessages, {On("/image")});
  robot_->OnSensorGone("base", sensor_.get());
  ConnectSensor();
  next_sequence_[1] = 1;
  SendBatch(Lane::kMessages, {On("/image")});
  EXPECT_EQ(inspector_->asked, 2u);
  Answer(Verdict::kYes);
  EXPECT_THAT(Texts(), IsEmpty()) << "the answer is to the message of the old stream";
  Answer(Verdict::kNo);
  EXPECT_THAT(Texts(), ElementsAre("seen /image"));
}

TEST_F(RobotInspectionTest, OtherRulesAskAnew) {
  Begin();
  SendBatch(Lane::kMessages, {On("/image")});
  const std::vector<lang::SourceFile> files = {{.path = "new.rul", .text = R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules Msg:
  a: topicin("/x") && payload("a.yar") ? alert("a");
  b: topicin("/image") && payload("b.yar") ? alert("b");
  false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
)"}};
  ASSERT_TRUE(
      robot_
          ->SwapPolicy({.program = *engine::CompiledPolicy::Create(*lang::Compile(files).rules),
                        .bundle_id = "sha256:1",
                        .inspector = inspector_})
          .ok());
  EXPECT_THAT(PayloadsAskedFor(), SizeIs(2));
  ASSERT_THAT(inspector_->questions, SizeIs(2));
  EXPECT_THAT(inspector_->questions[1].inspections, ElementsAre(1));
  Answer(Verdict::kYes);
  EXPECT_EQ(audience_.Count("bad"), 0) << "what the old rules asked is not told to the new";
  Answer(Verdict::kYes);
  EXPECT_EQ(audience_.Count("b"), audience_.Count("bundle") + 1);
}

constexpr char kCrashing[] = R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules External:
  shows: signal("SIGUSR2") ? True("level", CurrLevel);
  crashes: signal("SIGUSR1") ? crash("cannot go on");
  false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
)";

TEST_F(RobotInspectionTest, ACrashStopsTheRulesUntilAnOperatorResumesThem) {
  Begin(kCrashing);
  SendBatch(Lane::kControl, {{.what = SignalSeen{"SIGUSR2"}}});
  EXPECT_THAT(audience_.rule_logs, ElementsAre("shows: level 0"));
  SendBatch(Lane::kControl, {{.what = SignalSeen{"SIGUSR1"}}});
  EXPECT_EQ(robot_->Status().decided_level, "HALT");
  EXPECT_EQ(audience_.Count("crash: cannot go on"), 1);
  EXPECT_THAT(
      robot_->SendSignal({.operator_name = "bob", .signal = "SIGUSR2", .reason = "why not"}).status,
      StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("no rule runs")));
  EXPECT_TRUE(recorder_.rules_halted);
  EXPECT_EQ(recorder_.decisions.back().cause, "crash in rule crashes");
  EXPECT_THAT(robot_->Status().degraded, ::testing::Contains(::testing::HasSubstr("`crash`")));
  SendBatch(Lane::kControl, {{.what = SignalSeen{"SIGUSR2"}}});
  EXPECT_THAT(audience_.rule_logs, SizeIs(1));

  // A restart changes nothing.
  store::RobotRecord record{.level = "HALT", .decision_id = {1, 2}, .rules_halted = true};
  Start(kCrashing, record, 2);
  ConnectSensor();
  next_sequence_[0] = 1;
  SendSnapshot();
  SendBatch(Lane::kControl, {{.what = SignalSeen{"SIGUSR2"}}});
  EXPECT_THAT(audience_.rule_logs, SizeIs(1));
  ASSERT_TRUE(robot_->ResumeRules("alice", "seen to it").ok());
  Drain();
  EXPECT_FALSE(recorder_.rules_halted);
  EXPECT_EQ(robot_->Status().decided_level, "HALT") << "the level is the operator's to lower";
  SendBatch(Lane::kControl, {{.what = SignalSeen{"SIGUSR2"}}});
  EXPECT_THAT(audience_.rule_logs, ElementsAre("shows: level 0", "shows: level 3"));
}

}  // namespace
}  // namespace rips::pipeline
