// Levels that one operator alone does not lower.
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/server/robot/decide/approvals.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// At COMPROMISED, verified; DEFAULT < ALERT (soft) < COMPROMISED < HALT.
class TwoPersonTest : public RobotTest {
 protected:
  void StartAt(const std::string& level, std::vector<std::string> two_person) {
    two_person_ = std::move(two_person);
    Start();
    Arm();
    Raise(level);
  }
  void Raise(const std::string& level) {
    robot_->Raise({.operator_name = "alice", .to = level, .reason = "drill"},
                  [](const LevelAnswer&) {});
    Drain();
    Obey();
  }
  LevelAnswer Ask(const std::string& to, const std::string& who = "alice",
                  const LevelOrder& like = {}) {
    LevelOrder order = like;
    order.operator_name = who;
    order.identity = "td/" + who;
    order.to = to;
    if (order.reason.empty()) order.reason = "aisle is clear";
    order.expected_level = Level();
    order.expected_decision_id = robot_->Status().decision_id;
    LevelAnswer answer{.status = absl::UnknownError("not answered")};
    robot_->DeEscalate(order, [&](const LevelAnswer& got) { answer = got; });
    Drain();
    return answer;
  }
  LevelAnswer Approve(const std::string& id, const std::string& who = "bob",
                      const ApprovalOrder& like = {}) {
    ApprovalOrder order = like;
    order.operator_name = who;
    order.identity = "td/" + who;
    order.id = id;
    if (order.reason.empty()) order.reason = "I see it, too";
    LevelAnswer answer{.status = absl::UnknownError("not answered")};
    robot_->Approve(order, [&](const LevelAnswer& got) { answer = got; });
    Drain();
    return answer;
  }
  std::vector<PendingApproval> PendingNow() { return robot_->Status().pending_approvals; }
};

TEST_F(TwoPersonTest, IsOverWhenARuleAsksForALevelAboveAgain) {
  two_person_ = {"COMPROMISED", "HALT"};
  Start();
  Arm();
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  SendMessage(9);
  Obey();
  ASSERT_EQ(Level(), "COMPROMISED");
  const DecisionId decided = robot_->Status().decision_id;
  const std::string id = Ask("ALERT").pending_approval_id;
  SendMessage(9);
  EXPECT_EQ(robot_->Status().decision_id, decided) << "the robot is there already";
  EXPECT_THAT(PendingNow(), IsEmpty());
  const LevelAnswer refused = Approve(id);
  EXPECT_THAT(refused.status, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(refused.status.message(), HasSubstr("rule rogue asked for COMPROMISED since"));
  EXPECT_EQ(Level(), "COMPROMISED");

  // To a level that the rule does not exceed.
  Raise("HALT");
  const std::string to_it = Ask("COMPROMISED").pending_approval_id;
  SendMessage(9);
  EXPECT_THAT(Approve(to_it).status, IsOk());
}

TEST_F(TwoPersonTest, ASecondOperatorLowersWhatTheFirstAskedFor) {
  StartAt("COMPROMISED", {"COMPROMISED", "HALT"});
  const DecisionId before = robot_->Status().decision_id;
  const LevelAnswer asked = Ask("DEFAULT");
  EXPECT_THAT(asked.status, IsOk());
  EXPECT_TRUE(asked.needs_approval);
  EXPECT_EQ(asked.decided_level, "COMPROMISED");
  EXPECT_EQ(asked.decision_id, before);
  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_EQ(actuator_->level()->to, "COMPROMISED");
  ASSERT_THAT(PendingNow(), SizeIs(1));
  EXPECT_EQ(PendingNow()[0].id, asked.pending_approval_id);
  EXPECT_EQ(PendingNow()[0].operator_name, "alice");
  EXPECT_EQ(audience_.Count("a second operator must approve"), 1);
  EXPECT_THAT(audience_.alerts,
              Contains(AllOf(Field(&store::AlertRecord::severity, "medium"),
                             Field(&store::AlertRecord::text,
                                   HasSubstr("which a second operator must approve")))));

  const LevelAnswer approved = Approve(asked.pending_approval_id);
  EXPECT_THAT(approved.status, IsOk());
  EXPECT_FALSE(approved.needs_approval);
  EXPECT_EQ(approved.decided_level, "DEFAULT");
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(actuator_->level()->to, "DEFAULT");
  EXPECT_EQ(recorder_.decisions.back().cause, "operator alice, approved by bob");
  EXPECT_EQ(recorder_.decisions.back().reason, "aisle is clear; approved: I see it, too");
  EXPECT_THAT(PendingNow(), IsEmpty());
  EXPECT_THAT(Approve(asked.pending_approval_id, "carol").status,
              StatusIs(absl::StatusCode::kNotFound))
      << "twice";
}

TEST_F(TwoPersonTest, BothReasonsMayBeAsLongAsAReasonMayBe) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string longest(kReasonBytesMax, 'x');
  const std::string id = Ask("ALERT", "alice", {.reason = longest}).pending_approval_id;
  EXPECT_THAT(Approve(id, "bob", {.reason = longest + "x"}).status,
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(Approve(id, "bob", {.reason = longest}).status, IsOk());
  EXPECT_EQ(recorder_.decisions.back().reason, longest + "; approved: " + longest);
}

TEST_F(TwoPersonTest, NoOneApprovesTheirOwn) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string id = Ask("ALERT").pending_approval_id;
  const size_t refused = recorder_.refusals.size();
  EXPECT_THAT(Approve(id, "alice").status, StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_THAT(PendingNow(), SizeIs(1)) << "a second operator still may";
  ASSERT_EQ(recorder_.refusals.size(), refused + 1) << "on record";
  EXPECT_EQ(recorder_.refusals.back().cause, "operator alice");
  EXPECT_THAT(Approve(id).status, IsOk());
}

TEST_F(TwoPersonTest, ALevelInBetweenCannotBeGoneRoundByRaisingFirst) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  Raise("HALT");
  EXPECT_TRUE(Ask("ALERT").needs_approval) << "from HALT over COMPROMISED";
  EXPECT_EQ(Level(), "HALT");
  const LevelAnswer to_it = Ask("COMPROMISED");
  EXPECT_FALSE(to_it.needs_approval);
  EXPECT_EQ(Level(), "COMPROMISED");
}

TEST_F(TwoPersonTest, RaisesAndOtherLevelsNeedOnePerson) {
  StartAt("ALERT", {"COMPROMISED"});
  EXPECT_FALSE(Ask("DEFAULT").needs_approval);
  EXPECT_EQ(Level(), "DEFAULT");
  Raise("HALT");
  EXPECT_EQ(Level(), "HALT");
}

TEST_F(TwoPersonTest, ADryRunSaysItAndAsksNobody) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const LevelAnswer dry = Ask("ALERT", "alice", {.dry_run = true});
  EXPECT_THAT(dry.status, IsOk());
  EXPECT_TRUE(dry.needs_approval);
  EXPECT_EQ(dry.pending_approval_id, "");
  EXPECT_THAT(PendingNow(), IsEmpty());
}

TEST_F(TwoPersonTest, IsOverWhenTheRobotIsAnotherOne) {
  StartAt("COMPROMISED", {"COMPROMISED", "HALT"});
  const std::string of_rule = Ask("DEFAULT").pending_approval_id;
  IntruderAppears();
  const LevelAnswer rule = Approve(of_rule);
  EXPECT_THAT(rule.status, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(rule.status.message(), HasSubstr("rule unknown_node asked for ALERT since"));
  EXPECT_THAT(PendingNow(), IsEmpty());
  IntruderLeaves();

  const std::string of_level = Ask("ALERT").pending_approval_id;
  Raise("HALT");
  EXPECT_THAT(Approve(of_level).status.message(), HasSubstr("the level was decided anew"));
  EXPECT_EQ(Level(), "HALT");

  const std::string of_time = Ask("ALERT").pending_approval_id;
  clock_.Advance(Approvals::kApprovalNs - kNanosPerSecond);
  robot_->OnTime();
  EXPECT_THAT(PendingNow(), SizeIs(1));
  clock_.Advance(kNanosPerSecond);
  robot_->OnTime();
  Drain();
  EXPECT_THAT(PendingNow(), IsEmpty());
  EXPECT_THAT(Approve(of_time).status, StatusIs(absl::StatusCode::kNotFound));
  EXPECT_EQ(Level(), "HALT");
  EXPECT_EQ(audience_.Count("cannot be approved any more: it was not approved within 10"), 1);
}

TEST_F(TwoPersonTest, IsOverOnAGraphOnWhichARuleWouldRaiseItAgain) {
  two_person_ = {"COMPROMISED", "HALT"};
  Start(R"(
levels: DEFAULT; ALERT; COMPROMISED; HALT;
rules Graph:
  stranger: !nodesinclude("/camera", "/navigator", "/rips") && CurrLevel < COMPROMISED ?
    trigger(COMPROMISED);
  alert: false ? trigger(ALERT);
  halt: false ? trigger(HALT);
)");
  Arm();
  Raise("HALT");
  const std::string id = Ask("ALERT").pending_approval_id;
  IntruderAppears();
  EXPECT_THAT(Approve(id, "bob", {.accept_changes = true}).status,
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("graph has changed, and rule stranger would raise it again: node "
                                 "/intruder came")));
  // Who asks now sees that.
  const std::string seen = Ask("ALERT").pending_approval_id;
  EXPECT_THAT(Approve(seen).status, IsOk());
}

// A participant that comes and goes needs no key.
TEST_F(TwoPersonTest, VisitorsWhomNothingIsJudgedByDoNotEndIt) {
  StartAt("COMPROMISED", {"COMPROMISED", "HALT"});
  const std::string id = Ask("ALERT").pending_approval_id;
  for (uint8_t i = 20; i < 40; ++i) {
    ros2::GraphDelta came;
    came.upsert_participants.push_back({.guid = Participant(i)});
    SendDelta(std::move(came));
    Pass(500);
    EXPECT_THAT(PendingNow(), SizeIs(1));
    if (i + 1 == 40) break;
    ros2::GraphDelta left;
    left.gone_guids = {Participant(i)};
    SendDelta(std::move(left));
    Pass(500);
  }
  EXPECT_THAT(PendingNow()[0].changes, IsEmpty()) << "nobody can judge it";
  EXPECT_THAT(Approve(id).status, IsOk()) << "while one is there";
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(TwoPersonTest, TheSecondOperatorAcceptsWhatElseHasChanged) {
  StartAt("COMPROMISED", {"COMPROMISED", "HALT"});
  const std::string id = Ask("ALERT").pending_approval_id;
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/visitor", "/chatter");
  SendDelta(std::move(delta));
  Pass(100);
  ASSERT_THAT(PendingNow(), SizeIs(1));
  EXPECT_THAT(PendingNow()[0].changes,
              testing::ElementsAre("node /visitor came", "topic /chatter: /visitor publishes",
                                   "topic /chatter: geometry_msgs/msg/Twist is a further type"));
  const LevelAnswer refused = Approve(id);
  EXPECT_THAT(refused.status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                       AllOf(HasSubstr("since it was asked for: node /visitor"),
                                             HasSubstr("--accept-changes"))));
  EXPECT_EQ(Level(), "COMPROMISED");
  ASSERT_THAT(PendingNow(), SizeIs(1)) << "it goes on waiting";
  EXPECT_THAT(Approve(id, "bob", {.accept_changes = true}).status, IsOk());
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_THAT(recorder_.decisions.back().reason,
              HasSubstr("; accepted: node /visitor came, topic"));
}

TEST_F(TwoPersonTest, ASecondDriverEndsItWhoeverAcceptsChanges) {
  StartAt("COMPROMISED", {"COMPROMISED", "HALT"});
  const std::string id = Ask("ALERT").pending_approval_id;
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  EXPECT_THAT(Approve(id, "bob", {.accept_changes = true}).status,
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("has changed: topic /cmd_vel: /intruder publishes")));
  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_THAT(PendingNow(), IsEmpty());
}

// One that names itself like a known node, and one that no node claims.
TEST_F(TwoPersonTest, NeitherAKnownNameNorNoneHidesADriver) {
  StartAt("COMPROMISED", {"COMPROMISED", "HALT"});
  for (const char* node : {"/navigator", ""}) {
    const std::string id = Ask("ALERT").pending_approval_id;
    ros2::GraphDelta delta;
    AddNode(&delta, 9, "/navigator", "/cmd_vel");
    delta.upsert_endpoints[0].node = node;
    SendDelta(std::move(delta));
    EXPECT_THAT(Approve(id, "bob", {.accept_changes = true}).status.message(),
                HasSubstr("has changed: topic /cmd_vel: "));
    IntruderLeaves();
  }
}

TEST_F(TwoPersonTest, ManyChangesAreCounted) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  Ask("ALERT");
  ros2::GraphDelta delta;
  for (uint8_t i = 20; i < 60; ++i) AddNode(&delta, i, absl::StrCat("/visitor", i));
  SendDelta(std::move(delta));
  ASSERT_THAT(PendingNow(), SizeIs(1));
  EXPECT_THAT(PendingNow()[0].changes, SizeIs(16));
  EXPECT_EQ(PendingNow()[0].changes.back(), "and 25 more");
}

TEST_F(TwoPersonTest, AWallClockThatJumpsDoesNotMakeItLast) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  Ask("ALERT");
  clock_.JumpUnix(-86'400 * kNanosPerSecond);
  clock_.Advance(Approvals::kApprovalNs);
  robot_->OnTime();
  EXPECT_THAT(PendingNow(), IsEmpty());
}

TEST_F(TwoPersonTest, EitherMayRejectIt) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string first = Ask("ALERT").pending_approval_id;
  EXPECT_THAT(Approve(first, "alice", {.reject = true}).status, IsOk()) << "who asked";
  EXPECT_THAT(Approve(first).status, StatusIs(absl::StatusCode::kNotFound));
  const std::string second = Ask("ALERT").pending_approval_id;
  EXPECT_THAT(Approve(second, "bob", {.reject = true}).status, IsOk());
  EXPECT_THAT(Approve(second, "carol").status, StatusIs(absl::StatusCode::kNotFound));
  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_EQ(audience_.Count("operator bob rejects"), 1);
}

TEST_F(TwoPersonTest, BothMustAcceptThatTheServerIsBlind) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  robot_->OnSensorGone("base", sensor_.get());
  Drain();
  EXPECT_THAT(Ask("ALERT").status, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(PendingNow(), IsEmpty());
  const std::string id = Ask("ALERT", "alice", {.accept_blind = true}).pending_approval_id;
  ASSERT_NE(id, "");
  const LevelAnswer refused = Approve(id);
  EXPECT_THAT(refused.status.message(), HasSubstr("--accept-blind"));
  EXPECT_THAT(PendingNow(), SizeIs(1)) << "the second operator may say so";
  EXPECT_THAT(Approve(id, "bob", {.accept_blind = true}).status, IsOk());
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(TwoPersonTest, AnApprovalThatOnlyTheSecondCallsBlindIsRefused) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string id = Ask("ALERT").pending_approval_id;
  robot_->OnSensorGone("base", sensor_.get());
  Drain();
  EXPECT_THAT(Approve(id, "bob", {.accept_blind = true}).status,
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("it was asked for without --accept-blind")));
  EXPECT_EQ(Level(), "COMPROMISED");
}

TEST_F(TwoPersonTest, NothingIsLoweredWhileTheStoreFails) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string id = Ask("ALERT").pending_approval_id;
  recorder_.fail = absl::UnavailableError("disk full");
  Pass(2'000);
  EXPECT_THAT(Approve(id).status, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_EQ(Level(), "COMPROMISED");
}

TEST_F(TwoPersonTest, OneRequestOfEachOperatorWaitsAndARepeatedOneIsTheSame) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string first = Ask("ALERT", "alice", {.request_id = "q1"}).pending_approval_id;
  EXPECT_EQ(Ask("ALERT", "alice", {.request_id = "q1"}).pending_approval_id, first);
  EXPECT_EQ(Ask("ALERT", "alice").pending_approval_id, first) << "a script that asks on and on";
  EXPECT_EQ(audience_.Count("asks to lower"), 1);
  const std::string newer = Ask("DEFAULT", "alice", {.request_id = "q2"}).pending_approval_id;
  EXPECT_NE(newer, first);
  EXPECT_EQ(audience_.Count("the same operator asks for another one"), 1);
  EXPECT_THAT(Approve(first).status, StatusIs(absl::StatusCode::kNotFound));
  const std::string bobs = Ask("ALERT", "bob").pending_approval_id;
  EXPECT_THAT(PendingNow(), SizeIs(2));
  // Both ask for the same: one approves the other's, and that ends both.
  EXPECT_THAT(Approve(newer, "bob").status, IsOk());
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_THAT(Approve(bobs, "alice").status.code(), testing::Ne(absl::StatusCode::kOk));
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(TwoPersonTest, ARepeatedApprovalRepeatsItsAnswer) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string id = Ask("ALERT").pending_approval_id;
  const LevelAnswer first = Approve(id, "bob", {.request_id = "a1"});
  const LevelAnswer again = Approve(id, "bob", {.request_id = "a1"});
  EXPECT_THAT(again.status, IsOk());
  EXPECT_EQ(again.decision_id, first.decision_id);
}

TEST_F(TwoPersonTest, HasALimitThatOneOperatorDoesNotFill) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  for (int i = 0; i < 100; ++i) Ask("ALERT", "alice");
  EXPECT_THAT(PendingNow(), SizeIs(1));
  for (size_t i = 1; i < Approvals::kPendingMax; ++i) Ask("ALERT", absl::StrCat("thief", i));
  const LevelAnswer over = Ask("ALERT", "dora");
  EXPECT_THAT(over.status, StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_EQ(over.pending_approval_id, "");
  EXPECT_THAT(PendingNow(), SizeIs(Approvals::kPendingMax));
}

TEST_F(TwoPersonTest, OneOperatorHidesNoRequestOfAnother) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  for (int i = 0; i < 200; ++i) Ask(i % 2 == 0 ? "ALERT" : "DEFAULT", "mallory");
  EXPECT_LT(audience_.Count("operator mallory asks to lower"), 100);
  for (int i = 0; i < 200; ++i) {
    const std::string id = Ask("ALERT", "mallory").pending_approval_id;
    EXPECT_THAT(Approve(id, "mallory", {.reject = true}).status, IsOk());
  }
  EXPECT_LT(audience_.Count("operator mallory rejects"), 100);
  const std::string id = Ask("ALERT", "alice").pending_approval_id;
  EXPECT_EQ(audience_.Count("operator alice asks to lower"), 1);
  EXPECT_THAT(Approve(id, "bob", {.reject = true}).status, IsOk());
  EXPECT_EQ(audience_.Count("operator bob rejects"), 1);
}

TEST_F(TwoPersonTest, ABanOfWhoAskedEndsIt) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string of_thief = Ask("ALERT", "alice").pending_approval_id;
  const std::string of_other = Ask("ALERT", "dora").pending_approval_id;
  robot_->OnOperatorBanned("td/alice");
  Drain();
  EXPECT_THAT(Approve(of_thief).status, StatusIs(absl::StatusCode::kNotFound));
  EXPECT_EQ(audience_.Count("a certificate of who asked is banned"), 1);
  EXPECT_THAT(Approve(of_other).status, IsOk());
}

TEST_F(TwoPersonTest, AnotherBundleEndsIt) {
  StartAt("COMPROMISED", {"COMPROMISED"});
  const std::string id = Ask("ALERT").pending_approval_id;
  Policy other = robot_->core().policy();
  other.bundle_id = "sha256:1";
  other.two_person = {};
  EXPECT_THAT(robot_->SwapPolicy(other), IsOk());
  Drain();
  EXPECT_THAT(Approve(id).status.message(), HasSubstr("another bundle is in force"));
  EXPECT_FALSE(Ask("ALERT").needs_approval);
  EXPECT_EQ(Level(), "ALERT");
}

}  // namespace
}  // namespace rips::pipeline
