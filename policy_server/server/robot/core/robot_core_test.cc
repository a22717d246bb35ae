// The core alone: inputs in, actions out, with no port, clock or thread.
#include "policy_server/server/robot/core/robot_core.h"

#include <algorithm>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/check/compile.h"
#include "services/base/overloaded.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::IsSupersetOf;
using ::testing::Not;
using ::testing::SizeIs;

constexpr char kRules[] = R"(
levels:
  DEFAULT;
  ALERT soft;
  HALT;
rules External:
  probe: signal("SIGUSR1") ? trigger(ALERT);
  stop: signal("SIGUSR2") ? trigger(HALT) => alert("stopped", "high");
)";
constexpr char kIncarnation[] = "0123456789abcdef";

std::shared_ptr<const engine::CompiledPolicy> Compile() {
  lang::CompileResult compiled = lang::Compile({{.path = "core.rul", .text = kRules}});
  return *engine::CompiledPolicy::Create(*std::move(compiled.rules));
}

// What the order contract is about; empty for the rest.
std::string Text(const Action& action) {
  return std::visit(
      Overloaded{[](const action::SendCommand& send) {
                   const auto* set = std::get_if<SetLevel>(&send.command.what);
                   return set == nullptr ? std::string("command") : absl::StrCat("level ", set->to);
                 },
                 [](const action::Record& record) {
                   std::string text = "record";
                   for (const store::DecisionRecord& each : record.batch->decisions) {
                     absl::StrAppend(&text, " ", each.from, ">", each.to);
                   }
                   return text;
                 },
                 [](const action::Acknowledge& acknowledge) {
                   return absl::StrCat("acknowledge ", acknowledge.sequence);
                 },
                 [](const action::AnswerOrder& answer) {
                   return absl::StrCat("answer ", answer.token, " ",
                                       absl::StatusCodeToString(answer.answer.status.code()));
                 },
                 [](const action::Close& close) { return absl::StrCat("close ", close.session); },
                 [](const action::RecordEvent&) { return std::string("event"); },
                 [](const action::PublishStatus&) { return std::string("status"); },
                 [](const action::ReportRetired&) { return std::string("retired"); },
                 [](const auto&) { return std::string(); }},
      action);
}

class RobotCoreTest : public ::testing::Test {
 protected:
  static constexpr SessionId kSensor = 1;
  static constexpr SessionId kActuator = 2;

  RobotCoreTest() {
    auto core = RobotCore::Create(
        {.config = {.id = "r1",
                    .sensor_hosts = {"base"},
                    .primary_sensor = "base",
                    .actuator_hosts = {"base"},
                    .graph_limits = {}},
         .policy = {.program = Compile(), .bundle_id = "sha256:0", .payload_limits = {}},
         .timing = {},
         .record = {},
         .store = {},
         .tenure = 1,
         .id_seed = "s",
         .moment = moment_});
    EXPECT_THAT(core, IsOk());
    core_ = *std::move(core);
    On(input::SensorHello{.host = "base",
                          .session = kSensor,
                          .hello = {.incarnation = kIncarnation, .clock = moment_.now},
                          .store = {}});
    Record();
    On(input::ActuatorHello{.host = "base",
                            .session = kActuator,
                            .hello = {.levels = {"DEFAULT", "ALERT", "HALT"},
                                      .effective_level = "DEFAULT",
                                      .clock = moment_.now}});
    Record();
  }

  std::vector<std::string> On(const Input& input) {
    Actions actions = core_->On(input, moment_);
    std::vector<std::string> texts;
    for (const Action& action : actions) {
      if (std::string text = Text(action); !text.empty()) texts.push_back(std::move(text));
      if (const auto* record = std::get_if<action::Record>(&action)) {
        batch_ = record->batch;
        ++recording_;
      }
      if (const auto* send = std::get_if<action::SendCommand>(&action)) command_ = send->command;
    }
    core_->Recycle(std::move(actions));
    return texts;
  }
  // The store answers for all that is handed to it.
  std::vector<std::string> Record(absl::Status status = absl::OkStatus()) {
    std::vector<std::string> texts;
    while (recording_ > 0) {
      --recording_;
      for (std::string& text : On(input::Recorded{.status = status, .store = {}})) {
        texts.push_back(std::move(text));
      }
      status = absl::OkStatus();
    }
    return texts;
  }
  std::vector<std::string> SendSignals(const std::vector<std::string>& names) {
    Batch batch{.incarnation = kIncarnation, .lane = Lane::kControl, .first_sequence = next_};
    for (const std::string& name : names) {
      batch.observations.push_back(
          {.boottime_ns = moment_.now.boottime_ns, .what = SignalSeen{.name = name}});
    }
    next_ += names.size();
    On(input::SensorBatch{.host = "base",
                          .session = kSensor,
                          .batch = std::make_shared<const Batch>(std::move(batch))});
    return On(input::Advance{});
  }
  // The first of them; no rule is about messages.
  void SendMessages(size_t count) {
    Batch batch{.incarnation = kIncarnation, .lane = Lane::kMessages, .first_sequence = 1};
    batch.observations.resize(
        count, {.boottime_ns = moment_.now.boottime_ns, .what = MessageSeen{.topic = "/a"}});
    On(input::SensorBatch{.host = "base",
                          .session = kSensor,
                          .batch = std::make_shared<const Batch>(std::move(batch))});
    On(input::Advance{});
  }
  LevelOrder Lowering(const std::string& to) {
    const RobotStatus status = core_->At(moment_).Status();
    return {.operator_name = "ann",
            .to = to,
            .reason = "seen",
            .expected_level = status.decided_level,
            .expected_decision_id = status.decision_id,
            .accept_blind = true};
  }

  Moment moment_{.now = {.boottime_ns = 1'000 * kNanosPerSecond, .unix_ns = 0}};
  std::unique_ptr<RobotCore> core_;
  // The newest.
  std::shared_ptr<const store::WriteBatch> batch_;
  int recording_ = 0;
  Command command_;
  uint64_t next_ = 1;
};

TEST_F(RobotCoreTest, ARaiseIsCommandedBeforeItIsRecorded) {
  EXPECT_THAT(SendSignals({"SIGUSR2"}), ElementsAre("level HALT", "record DEFAULT>HALT"));
}

TEST_F(RobotCoreTest, ObservationsAreAcknowledgedWhenTheirEffectsAreDurable) {
  EXPECT_THAT(SendSignals({"SIGUSR2"}), Not(Contains("acknowledge 1")));
  EXPECT_THAT(Record(), Contains("acknowledge 1"));
}

TEST_F(RobotCoreTest, OnlyTheLaneThatAdvancedIsAcknowledgedAgain) {
  SendSignals({"SIGUSR1", "SIGUSR1"});
  EXPECT_THAT(Record(), Contains("acknowledge 2"));
  SendMessages(3);
  moment_.now.boottime_ns += 2 * kNanosPerSecond;  // a checkpoint is due
  On(input::Time{});
  ASSERT_NE(batch_, nullptr);
  EXPECT_THAT(batch_->checkpoint.high_water, SizeIs(1)) << "nor is the other one written";
  EXPECT_THAT(Record(), AllOf(Contains("acknowledge 3"), Not(Contains("acknowledge 2"))));
}

TEST_F(RobotCoreTest, WhatIsRecordedWithoutNewsIsAcknowledgedForItsCommit) {
  SendSignals({"SIGUSR1"});
  Record();
  SendMessages(2);
  moment_.now.boottime_ns += 2 * kNanosPerSecond;
  On(input::Time{});
  Record();
  On(input::DeEscalate{.order = Lowering("DEFAULT"), .token = 7});
  EXPECT_THAT(Record(), AnyOf(AllOf(Contains("acknowledge 1"), Not(Contains("acknowledge 2"))),
                              AllOf(Contains("acknowledge 2"), Not(Contains("acknowledge 1")))))
      << "one of the two";
}

TEST_F(RobotCoreTest, WhatWasNotRecordedIsWrittenAndAcknowledgedWithTheNext) {
  SendSignals({"SIGUSR1"});
  EXPECT_THAT(Record(absl::UnavailableError("disk")), Not(Contains("acknowledge 1")));
  SendMessages(2);
  std::vector<std::string> texts;
  for (int i = 0; i < 3; ++i) {
    moment_.now.boottime_ns += 2 * kNanosPerSecond;
    On(input::Time{});
    for (std::string& text : Record()) texts.push_back(std::move(text));
  }
  EXPECT_THAT(texts, IsSupersetOf({"acknowledge 1", "acknowledge 2"}));
}

TEST_F(RobotCoreTest, WhatCannotBeRecordedIsAcknowledgedNever) {
  SendSignals({"SIGUSR2"});
  EXPECT_THAT(Record(absl::UnavailableError("disk")), Not(Contains("acknowledge 1")));
}

TEST_F(RobotCoreTest, OneBatchIsRecordedAtATime) {
  SendSignals({"SIGUSR1"});
  EXPECT_THAT(SendSignals({"SIGUSR2"}), ElementsAre("level HALT"));
  EXPECT_THAT(On(input::Recorded{.status = absl::OkStatus(), .store = {}}),
              IsSupersetOf({"acknowledge 1", "record ALERT>HALT"}));
}

TEST_F(RobotCoreTest, ALoweringIsCommandedAndAnsweredWhenItIsDurable) {
  SendSignals({"SIGUSR2"});
  Record();
  EXPECT_THAT(On(input::DeEscalate{.order = Lowering("ALERT"), .token = 7}),
              ElementsAre("record HALT>ALERT", "status"));
  EXPECT_THAT(Record(), IsSupersetOf({"level ALERT", "answer 7 OK"}));
}

TEST_F(RobotCoreTest, ALoweringThatCannotBeRecordedIsTakenBackByANewDecision) {
  SendSignals({"SIGUSR2"});
  Record();
  const DecisionId before = core_->Status().decision_id;
  On(input::DeEscalate{.order = Lowering("ALERT"), .token = 7});
  const std::vector<std::string> actions = Record(absl::UnavailableError("disk"));
  EXPECT_THAT(actions, Contains("answer 7 FAILED_PRECONDITION"));
  EXPECT_THAT(actions, Not(Contains("level ALERT")));
  EXPECT_EQ(core_->Status().decided_level, "HALT");
  EXPECT_GT(core_->Status().decision_id, before);
}

TEST_F(RobotCoreTest, ARaiseAboveALoweringThatWaitsIsCommandedAtOnce) {
  SendSignals({"SIGUSR1"});
  Record();
  On(input::DeEscalate{.order = Lowering("DEFAULT"), .token = 7});
  EXPECT_THAT(SendSignals({"SIGUSR2"}), ElementsAre("level HALT"));
  EXPECT_THAT(Record(), Not(Contains("level DEFAULT")));
}

TEST_F(RobotCoreTest, EachAdvanceJudgesOnePiece) {
  const std::vector<std::string> signals(40, "SIGUSR1");
  moment_.recorded = true;
  const std::vector<std::string> first = SendSignals(signals);
  EXPECT_EQ(std::count(first.begin(), first.end(), "event"), 32);
  EXPECT_TRUE(core_->has_control());
  const std::vector<std::string> second = On(input::Advance{});
  EXPECT_EQ(std::count(second.begin(), second.end(), "event"), 8);
  EXPECT_FALSE(core_->has_control());
  EXPECT_THAT(On(input::Advance{}), IsEmpty());
}

TEST_F(RobotCoreTest, NothingIsSentToASessionThatItHasClosed) {
  EXPECT_THAT(
      On(input::SensorHello{
          .host = "base", .session = 3, .hello = {.incarnation = kIncarnation}, .store = {}}),
      ElementsAre("close 3"))
      << "there is a live one";
  EXPECT_THAT(On(input::SensorHeartbeat{.host = "base", .session = 3, .heartbeat = {}}), IsEmpty());
}

TEST_F(RobotCoreTest, ABatchNamesRobotAndTenure) {
  On(input::Raise{.order = {.operator_name = "ann", .to = "HALT", .reason = "seen"}, .token = 7});
  EXPECT_EQ(batch_->robot, "r1");
  EXPECT_EQ(batch_->tenure, 1u);
}

TEST_F(RobotCoreTest, ARobotOfAnotherOwnerRetiresAndCommandsNothing) {
  SendSignals({"SIGUSR2"});
  Record();
  On(input::DeEscalate{.order = Lowering("ALERT"), .token = 7});
  EXPECT_THAT(Record(absl::AbortedError("tenure 1 is over")),
              ElementsAre("retired", "close 1", "close 2", "answer 7 ABORTED"));
  EXPECT_TRUE(core_->gone());
  EXPECT_FALSE(core_->outbox().CanSeal());

  // What its shard had for it already.
  EXPECT_THAT(On(input::ActuatorHello{.host = "base",
                                      .session = 3,
                                      .hello = {.levels = {"DEFAULT", "ALERT", "HALT"},
                                                .effective_level = "DEFAULT",
                                                .clock = moment_.now}}),
              ElementsAre("close 3"));
  EXPECT_THAT(On(input::Raise{.order = {.operator_name = "ann", .to = "HALT", .reason = "seen"},
                              .token = 8}),
              ElementsAre("answer 8 ABORTED"));
  EXPECT_THAT(On(input::Retire{absl::FailedPreconditionError("held")}), IsEmpty());
  moment_.now.boottime_ns += 10 * kNanosPerSecond;
  EXPECT_THAT(On(input::Time{}), IsEmpty());
}

TEST_F(RobotCoreTest, ATermThatAFormerOwnerAsksForRetiresItsRobot) {
  On(input::ActuatorGone{.host = "base", .session = kActuator});
  Record();
  EXPECT_THAT(On(input::ActuatorHello{.host = "base",
                                      .session = 3,
                                      .hello = {.levels = {"DEFAULT", "ALERT", "HALT"},
                                                .decision_id = {.term = 9, .epoch = 1},
                                                .decided_level = "DEFAULT",
                                                .effective_level = "DEFAULT",
                                                .highest_term = 9,
                                                .clock = moment_.now}}),
              Not(Contains("close 3")));
  EXPECT_THAT(On(input::TermDrawn{.question = 1, .term = absl::AbortedError("tenure 1 is over")}),
              ElementsAre("retired", "close 1", "close 3"));
}

TEST_F(RobotCoreTest, ARepeatedInputIsJudgedOnce) {
  SendSignals({"SIGUSR2"});
  Record();
  next_ = 1;
  EXPECT_THAT(SendSignals({"SIGUSR2"}), Not(Contains(HasSubstr("level"))));
}

}  // namespace
}  // namespace rips::pipeline
