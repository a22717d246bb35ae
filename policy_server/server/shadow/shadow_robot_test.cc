// A robot with and without a shadow: what the policy in force does is the same, what sensors are
// asked for serves both, and the shadow comes to what the robot comes to.
#include <map>
#include <string>
#include <vector>

#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/shadow/shadow_test_data.h"
#include "policy_server/server/shadow/shadows.h"

namespace rips::shadow {
namespace {

using engine::Depth;
using pipeline::Lane;
using pipeline::Observation;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr char kLive[] = R"(levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
vars: seen int = 0; zero int = 0;
rules Msg:
  all: topicmatches("^/cmd|^/cam|^/ros") ? set(seen, seen + 1) => alert(string(seen) + " on " + Topic);
  bad: topicin("/cam") && payload("bad.yar") ? alert("bad") => trigger(ALERT);
  fault: topicin("/cmd") && 1 / zero > 0 ? alert("never");
rules Graph:
  intruder: hasnodes("/intruder") ? alert("intruder") => trigger(COMPROMISED) => exec("stop", "1");
rules External:
  lost: lostevents(1) ? alert("lost");
  down: signal("SIGUSR1") ? trigger(DEFAULT);
  hatch: false ? set(zero, zero), trigger(DEFAULT), trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
)";
// Asks for more messages, more of a payload, and fires on all of it.
constexpr char kWider[] = R"(
rules Msg:
  rosout: topicin("/rosout", "/extra") ? alert("extra " + Topic) => trigger(HALT);
  cam: topicin("/cam") && payload("other.yar") ? alert("other");
  rest: true ? alert("on " + Topic);
)";

class ShadowRobotTest : public pipeline::RobotTest {
 protected:
  void StartLive() {
    live_ = ProgramOf(kLive);
    Start(kLive);
    Arm();
    const pipeline::Policy limited{.program = live_,
                                   .bundle_id = "sha256:limited",
                                   .inspector = inspector_,
                                   .payload_limits = limits_};
    ASSERT_THAT(robot_->SwapPolicy(limited), IsOk());
    AnswerInterest();
  }
  absl::Status Begin(ShadowPolicy policy) {
    return shadows_.Begin("r1", {.policy = std::move(policy)}, [&](auto tap, auto also) {
      robot_->SetShadow(std::move(tap), std::move(also));
      Drain();
      AnswerInterest();
      return absl::OkStatus();
    });
  }
  static Observation On(absl::string_view topic, const std::string& payload = "") {
    return {.what = pipeline::MessageSeen{.topic = topic,
                                          .type = "geometry_msgs/msg/Twist",
                                          .writer = Writer(2),
                                          .size_bytes = 100,
                                          .payload = payload,
                                          .truncated = payload.size() < 100}};
  }
  static Observation Signal() { return {.what = model::SignalSeen{.name = "SIGUSR1"}}; }
  static Observation Lost(const std::string& topic) {
    return {.what = model::Loss{.count = 3, .topic = topic, .cause = "queue full"}};
  }
  // Sends what a sensor would send that is asked for all of it, or only what its interest says.
  void Send(Lane lane, std::vector<Observation> observations) {
    engine::InterestReader asked({.plan = sensor_->interest, .limits = sensor_->payload_limits});
    std::vector<Observation> sent;
    for (Observation& each : observations) {
      if (auto* message = std::get_if<pipeline::MessageSeen>(&each.what)) {
        const engine::Need need = asked.Of(message->topic);
        if (need.depth == Depth::kNothing) continue;
        if (message->payload.size() > need.payload_bytes) {
          message->payload.resize(need.payload_bytes);
          message->truncated = true;
        }
      } else if (const auto* loss = std::get_if<model::Loss>(&each.what)) {
        if (asked.Of(loss->topic).depth == Depth::kNothing) continue;
      }
      sent.push_back(std::move(each));
    }
    if (!sent.empty()) SendBatch(lane, std::move(sent));
  }
  void Answer(engine::Verdict verdict) {
    while (!inspector_->questions.empty()) {
      asked_.push_back(absl::StrCat(inspector_->questions.front().topic, " ",
                                    inspector_->questions.front().payload.size()));
      inspector_->Answer(verdict);
      Drain();
    }
  }
  // A day of a robot.
  void Story() {
    Send(Lane::kMessages, {On("/cmd"), On("/extra"), On("/rosout"), On("/other")});
    Send(Lane::kMessages, {On("/cam", std::string(90, 'x')), On("/cmd")});
    Answer(engine::Verdict::kYes);
    Send(Lane::kControl, {Lost("/extra"), Lost("/cmd")});
    Pass(6'000);
    Send(Lane::kMessages, {On("/cam", "short"), On("/rosout"), On("/extra")});
    Send(Lane::kControl, {Lost("/extra")});
    Answer(engine::Verdict::kNo);
    Send(Lane::kControl, {Signal()});
    Pass(100);
    IntruderAppears();
    Obey();
    Send(Lane::kMessages, {On("/cmd")});
    Pass(200);
  }
  // Of the rules in force, all that anyone sees.
  std::vector<std::string> Verdicts() const {
    std::vector<std::string> out = asked_;
    for (const store::AlertRecord& alert : audience_.alerts) {
      if (alert.rule == pipeline::kOwnRule) continue;
      out.push_back(absl::StrCat(alert.rule, " ", alert.severity, " ", alert.text, " at ",
                                 alert.level, " ", alert.event));
    }
    for (const store::DecisionRecord& decision : recorder_.decisions) {
      out.push_back(absl::StrCat(decision.from, "->", decision.to, " ", decision.cause));
    }
    for (const store::RefusalRecord& refusal : recorder_.refusals) {
      out.push_back(absl::StrCat(refusal.from, "->", refusal.to, " ", refusal.reason));
    }
    return out;
  }
  void Reset() {
    robot_.reset();
    sensor_.reset();
    actuator_.reset();
    audience_ = {};
    recorder_.decisions.clear();
    recorder_.refusals.clear();
    asked_.clear();
    next_sequence_[0] = next_sequence_[1] = 1;
  }
  ShadowReport Report(uint64_t events) {
    EXPECT_TRUE(Eventually([&] {
      const auto report = shadows_.Report("r1", true);
      return report.has_value() && report->events >= events;
    }));
    return *shadows_.Report("r1", true);
  }

  // Of the policy in force.
  const engine::PayloadLimits limits_ = {{"^/cam$", 50}};
  std::shared_ptr<const engine::CompiledPolicy> live_;
  std::vector<std::string> asked_;
  Shadows shadows_;
};

TEST_F(ShadowRobotTest, VerdictsOfThePolicyInForceAreTheSameWithAndWithoutAShadow) {
  StartLive();
  Pass(10'000);
  Story();
  const std::vector<std::string> without = Verdicts();
  const std::vector<pipeline::CutPayloads::Topic> cut = robot_->core().sight().CutTopics();
  ASSERT_THAT(without, Contains(HasSubstr("intruder")));
  ASSERT_THAT(without, Contains("/cam 50"));
  ASSERT_EQ(cut.size(), 1u);
  Reset();

  StartLive();
  ASSERT_THAT(Begin(PolicyFrom(kWider, {{"", 80}})), IsOk());
  Pass(10'000);
  Story();
  EXPECT_EQ(Verdicts(), without);
  EXPECT_THAT(Verdicts(), Not(Contains(HasSubstr("/rosout"))));
  const std::vector<pipeline::CutPayloads::Topic> cut_now = robot_->core().sight().CutTopics();
  ASSERT_EQ(cut_now.size(), 1u);
  EXPECT_EQ(cut_now[0].limit_bytes, cut[0].limit_bytes);
  EXPECT_EQ(cut_now[0].count, cut[0].count);
  EXPECT_TRUE(Eventually([&] { return shadows_.Report("r1", false)->would.alerts >= 13; }));
  EXPECT_EQ(shadows_.Report("r1", false)->level, "HALT");
  EXPECT_EQ(shadows_.Report("r1", false)->missed, 0u);
}

TEST_F(ShadowRobotTest, TheSameRulesDoTheSameAsAShadow) {
  StartLive();
  engine::InterestPlan alone = sensor_->interest;
  for (engine::TopicInterest& row : alone) row.wanted_by.clear();
  ShadowPolicy same{.bundle_id = "sha256:1", .name = "same", .program = live_};
  same.watched = MakeWatched(*live_, limits_);
  const bool yes[] = {true, false};
  auto next = std::make_shared<std::atomic<size_t>>(0);
  same.inspections = std::make_shared<FakeInspections>([next, yes](const inspect::Message&) {
    return yes[(*next)++] ? engine::Verdict::kYes : engine::Verdict::kNo;
  });
  ASSERT_THAT(Begin(same), IsOk());
  engine::InterestPlan asked = sensor_->interest;
  for (engine::TopicInterest& row : asked) row.wanted_by.clear();
  EXPECT_EQ(asked, alone) << "nothing more is asked for";
  Pass(10'000);
  Story();
  const ShadowCounts live = shadows_.Report("r1", false)->live;
  EXPECT_GT(live.alerts, 0u);
  EXPECT_EQ(live.programs, 1u);
  EXPECT_EQ(live.faults, 3u);
  EXPECT_EQ(live.raises, 2u);
  ASSERT_TRUE(Eventually([&] { return shadows_.Report("r1", false)->would == live; }))
      << shadows_.Report("r1", false)->would.alerts << " of " << live.alerts;
  EXPECT_EQ(shadows_.Report("r1", false)->level, Level());
  EXPECT_EQ(shadows_.Report("r1", false)->live_level, Level());
}

TEST_F(ShadowRobotTest, SensorsAreAskedForWhatBothNeedAcrossSessionsAndBundlesUntilItEnds) {
  StartLive();
  const engine::InterestPlan alone = sensor_->interest;
  const auto need = [&](const std::string& topic) {
    return engine::InterestReader({.plan = sensor_->interest, .limits = sensor_->payload_limits})
        .Of(topic);
  };
  ASSERT_EQ(need("/extra").depth, Depth::kNothing);
  ASSERT_THAT(Begin(PolicyFrom(
                  "rules Msg: extra: topicin(\"/extra\") && payload(\"a.yar\") ? alert(\"x\"); "
                  "rules Graph: g: topicpublishers(\"/kept\", \"/a\") ? alert(\"x\");",
                  {{"^/extra$", 77}})),
              IsOk());
  const auto asks_for_both = [&] {
    return need("/extra") == engine::Need{Depth::kPayload, 77} &&
           need("/cmd").depth == Depth::kMetadata && need("/cam").depth == Depth::kPayload &&
           sensor_->kept_topics.contains("/kept");
  };
  EXPECT_TRUE(asks_for_both());
  EXPECT_THAT(*robot_->core().watch().plan(robot_->core().policy()),
              Contains(Field(&engine::TopicInterest::wanted_by, ElementsAre("extra (shadow)"))));
  EXPECT_EQ(*robot_->core().policy().interest, alone);

  robot_->OnSensorGone("base", sensor_.get());
  ConnectSensor();
  EXPECT_TRUE(asks_for_both());

  pipeline::Policy next{.program = ProgramOf(absl::StrCat(
                            kLevels, "rules Msg: new: topicin(\"/new\") ? alert(\"x\");", kHatch)),
                        .bundle_id = "sha256:2"};
  ASSERT_THAT(robot_->SwapPolicy(next), IsOk());
  EXPECT_EQ(need("/extra"), (engine::Need{Depth::kPayload, 77}));
  EXPECT_EQ(need("/new").depth, Depth::kMetadata);
  EXPECT_EQ(need("/cmd").depth, Depth::kNothing);

  EXPECT_TRUE(shadows_.End("r1"));
  Pass(2'000);
  EXPECT_EQ(need("/extra").depth, Depth::kNothing) << "a tick has told the robot";
  EXPECT_EQ(need("/new").depth, Depth::kMetadata);
  EXPECT_FALSE(robot_->core().watch().also());
}

TEST_F(ShadowRobotTest, EvidenceIsDisturbedOnlyIfSensorsAreAskedForSomethingElse) {
  StartLive();
  Pass(10'000);
  ASSERT_THAT(Begin(PolicyFrom("rules Msg: x: topicin(\"/cmd\") ? alert(\"x\");")), IsOk());
  const int before = sensor_->interests;
  EXPECT_TRUE(shadows_.End("r1"));
  Pass(2'000);
  ASSERT_THAT(Begin(PolicyFrom(kWider)), IsOk());
  EXPECT_GT(sensor_->interests, before);
  EXPECT_THAT(robot_->Status().degraded, Not(Contains(HasSubstr("does not watch"))));
}

TEST_F(ShadowRobotTest, MessagesThatAreOnTheirWayWhenItEndsAreNotJudged) {
  StartLive();
  ASSERT_THAT(Begin(PolicyFrom(kWider)), IsOk());
  shadows_.End("r1");
  Pass(2'000);
  audience_.alerts.clear();
  SendBatch(Lane::kMessages, {On("/rosout"), On("/cmd")});
  EXPECT_THAT(audience_.alerts, Contains(Field(&store::AlertRecord::text, HasSubstr(" on /cmd"))));
  EXPECT_THAT(audience_.alerts,
              Not(Contains(Field(&store::AlertRecord::text, HasSubstr("/rosout")))));
}

TEST_F(ShadowRobotTest, RecordingsHoldOnlyWhatTheRulesInForceWereGiven) {
  class Recorder final : public pipeline::EventRecorder {
   public:
    bool OnEvent(const JudgedEvent& event) override {
      if (event.message != nullptr) topics.emplace_back(event.message->topic);
      return true;
    }
    bool OnLevel(const pipeline::LevelChange&) override { return true; }
    std::vector<std::string> topics;
  };
  StartLive();
  auto recorder = std::make_shared<Recorder>();
  ASSERT_THAT(robot_->AddTap(recorder), IsOk());
  ASSERT_THAT(Begin(PolicyFrom(kWider)), IsOk());
  SendBatch(Lane::kMessages, {On("/rosout"), On("/cmd"), On("/extra")});
  EXPECT_THAT(recorder->topics, ElementsAre("/cmd"));
  EXPECT_EQ(Report(3).would.raises, 1u);
}

TEST_F(ShadowRobotTest, AnOperatorsLoweringReachesIt) {
  StartLive();
  ASSERT_THAT(Begin(PolicyFrom("rules Msg: up: topicin(\"/cmd\") ? trigger(COMPROMISED);")),
              IsOk());
  SendBatch(Lane::kMessages, {On("/cmd")});
  ASSERT_EQ(Report(1).level, "COMPROMISED");
  EXPECT_EQ(Level(), "DEFAULT");
  robot_->Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"}, [](const auto&) {});
  Drain();
  ASSERT_EQ(Level(), "HALT");
  EXPECT_TRUE(Eventually([&] { return shadows_.Report("r1", false)->level == "HALT"; }));
  EXPECT_EQ(shadows_.Report("r1", false)->live_level, "HALT");
  EXPECT_EQ(shadows_.Report("r1", false)->would.raises, 1u);
}

TEST_F(ShadowRobotTest, ItStopsWhenTheRobotRetires) {
  StartLive();
  ASSERT_THAT(Begin(PolicyFrom(kWider)), IsOk());
  robot_->Retire(absl::NotFoundError("not listed"));
  EXPECT_TRUE(Eventually([&] { return !shadows_.Report("r1", false)->problem.empty(); }));
}

}  // namespace
}  // namespace rips::shadow
