#include "policy_server/policy/replay/replayer.h"

#include <limits>

#include "policy_server/policy/replay/replay_test_data.h"
#include "policy_server/policy/replay/result_json.h"
#include "services/base/fake_clock.h"

namespace rips::replay {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// ------------------------------------------------------------------------------------ answers

TEST(ReplayerTest, ProgramsAndLevelsHaveTheirAnswerBeforeTheNextChain) {
  const auto program = MakeProgram(R"(
    rules External: r: CurrLevel == A ? {
      exec("good", "1") => alert("ran") !> alert("did not");
      exec("bad") !> alert("failed");
      alert("middle");
      trigger(B) => alert("at " + Level);
      trigger(C) !> alert("not reached"), alert("last");
    }
  )");

  const Result result =
      Replayed(program, {Signal()}, {.failing_programs = {"bad"}, .failing_levels = {2}});

  EXPECT_THAT(Alerts(result), ElementsAre("0 r ran", "0 r failed", "0 r middle", "0 r at B",
                                          "0 r not reached", "0 r last"));
  EXPECT_THAT(Execs(result), ElementsAre("0 r good(1) ok", "0 r bad() failed"));
  EXPECT_THAT(Transitions(result), ElementsAre("0 r A->B", "0 r B->C"));
  EXPECT_EQ(result.level, "C");
}

TEST(ReplayerTest, GoesOnFromWhereTheRecordingSays) {
  const auto program = MakeProgram(R"(
    vars: n int = 0; fresh int = 3;
    rules Graph: never: false ? set(n, n), set(fresh, fresh);
    rules External: r: Uptime > 60000000000 ?
      alert("n " + string(n) + ", fresh " + string(fresh) + " at " + Level);
  )");
  FakeReader reader({Signal()});
  reader.robot = {
      .robot = "r1", .variables = {{"n", int64_t{7}}}, .uptime_ns = 61 * kNanosPerSecond};

  const auto result = Replay(reader, program, {.start_level = 2}, nullptr);

  ASSERT_THAT(result, IsOk());
  EXPECT_THAT(Alerts(*result), ElementsAre("0 r n 7, fresh 3 at C"));
}

TEST(ReplayerTest, WhatWasBlindOrLateLowersNothing) {
  const auto program = MakeProgram("rules External: down: CurrLevel == C ? trigger(B);");
  std::vector<Recorded> events(4, Signal());
  events[0].blind = true;
  events[1].blind = false;
  events[1].late = true;

  const Result result = Replayed(program, events, {.start_level = 2});

  EXPECT_THAT(Transitions(result), ElementsAre("0 down C->B refused: blind",
                                               "1 down C->B refused: late", "2 down C->B"));
}

TEST(ReplayerTest, FollowsWhatOthersThanRulesMadeOfTheLevel) {
  const auto program = MakeProgram("rules External: r: CurrLevel == D ? alert(\"at D\");");

  const Result result =
      Replayed(program, {Event(recording::RecordedLevel{"D", "operator alice"}), Signal(),
                         Event(recording::RecordedLevel{"B", "operator bob"}), Signal(),
                         Event(recording::RecordedLevel{"B", "adopted"}),
                         Event(recording::RecordedLevel{"GONE", "operator bob"})});

  EXPECT_THAT(Transitions(result), ElementsAre("0 operator A->D", "2 operator D->B"));
  EXPECT_THAT(Alerts(result), ElementsAre("1 r at D"));
  ASSERT_THAT(result.faults, SizeIs(1));
  EXPECT_EQ(result.faults[0].text, "set the level `GONE`, which the rules do not have");
}

TEST(ReplayerTest, EvidenceIsCompleteAndEachRefusalIsRecorded) {
  const auto program = MakeProgram(R"(
    rules External: down: CurrLevel > A ? trigger(A);
  )");

  EXPECT_THAT(Transitions(Replayed(program, {Signal(), Signal()}, {.start_level = 1})),
              ElementsAre("0 down B->A"));
  EXPECT_THAT(Transitions(Replayed(program, {Signal(), Signal(), Signal()}, {.start_level = 3})),
              ElementsAre("0 down D->A refused: needs an operator",
                          "1 down D->A refused: needs an operator",
                          "2 down D->A refused: needs an operator"));
}

TEST(ReplayerTest, TheBudgetOfSoftLoweringsHoldsInRecordedTime) {
  const auto program = MakeProgram(R"(
    rules External:
      down: CurrLevel == B ? trigger(A) !> alert("refused");
      up: CurrLevel == A ? trigger(B);
  )");
  // The first raises; each after it lowers and would raise again.
  std::vector<Recorded> events;
  for (int i = 0; i < 5; ++i) events.push_back(Signal(i * 1'000));
  events.push_back(Signal(601'000 + 4'000));

  const Result result = Replayed(program, events);

  EXPECT_THAT(Alerts(result), ElementsAre("4 down refused", "5 down refused"));
}

TEST(ReplayerTest, CrashEndsTheRulesAndNotTheCounting) {
  const auto program = MakeProgram(R"(
    vars: n int = 0;
    rules External:
      before: true ? set(n, n + 1);
      stop: n == 2 ? alert("a"), crash("enough"), alert("never");
      after: true ? alert("after");
    rules Graph: g: true ? alert("graph");
  )");

  const Result result =
      Replayed(program, {Signal(), Signal(), Signal(), Event(Graph({})), Message("/t")});

  EXPECT_THAT(Alerts(result), ElementsAre("0 after after", "1 stop a", "1 stop crash: enough"));
  EXPECT_THAT(Transitions(result), ElementsAre("1 stop A->D"));
  EXPECT_EQ(result.crashed, (Moment{1, kNanosPerMilli}));
  EXPECT_EQ(
      result.events,
      (EventCounts{
          .message = 1, .graph = 1, .external = 3, .unattributed = 1, .unattributed_writer = 1}));
  EXPECT_EQ(result.level, "D");
  EXPECT_EQ(result.rules[0].evaluated, 2u);
  EXPECT_EQ(result.rules[1].evaluated, 2u);
  EXPECT_EQ(result.rules[1].fired, 1u);
  EXPECT_EQ(result.rules[2].evaluated, 1u);
  EXPECT_EQ(result.rules[3].evaluated, 0u);
}

TEST(ReplayerTest, AnOperatorRaisesAndLowersTheLevel) {
  const auto program = MakeProgram("rules External: r: true ? alert(Level);");
  Replayer replayer(program, {}, nullptr);

  replayer.Order(0, 0, true, 3);
  replayer.JudgeTick(1, 1);
  replayer.Order(2, 2, false, 1);
  replayer.JudgeTick(3, 3);
  replayer.Order(4, 4, false, 2);
  replayer.Order(5, 5, true, 1);

  const Result result = replayer.Finish();
  EXPECT_THAT(Transitions(result), ElementsAre("0 operator A->D", "2 operator D->B",
                                               "4 operator B->C refused: not lower",
                                               "5 operator B->B refused: not higher"));
  EXPECT_THAT(Alerts(result), ElementsAre("1 r D", "3 r B"));
}

TEST(ReplayerTest, WithoutEvidenceSoftLoweringsAreBlind) {
  const auto program = MakeProgram("rules External: down: CurrLevel == B ? trigger(A);");
  Replayer replayer(program, {.start_level = 1}, nullptr);

  replayer.SetEvidence(false);
  replayer.JudgeTick(0, 0);
  replayer.SetEvidence(true);
  replayer.JudgeTick(1, 1);

  EXPECT_THAT(Transitions(replayer.Finish()),
              ElementsAre("0 down B->A refused: blind", "1 down B->A"));
}

// --------------------------------------------------------------------------------------- time

constexpr char kTimes[] = R"(
  rules External: t: true ? alert(string(Time) + " " + string(Uptime));
)";

TEST(ReplayerTest, WithoutTimesEventNHappensNIntervalsAfterTheStart) {
  const std::vector<Recorded> events = {Signal(), Event(recording::RecordedOther{"?"}), Signal()};
  const auto program = MakeProgram(kTimes);

  const Result result = Replayed(program, events);

  ASSERT_THAT(result.alerts, SizeIs(2));
  EXPECT_EQ(result.alerts[0].at, (Moment{0, 0}));
  EXPECT_EQ(result.alerts[1].at, (Moment{2, 2 * kNanosPerMilli}));
  EXPECT_FALSE(result.timed);
  EXPECT_EQ(Replayed(program, events, {.event_interval_ns = 7}).alerts[1].at, (Moment{2, 14}));
  EXPECT_EQ(Replayed(program, events, {.event_interval_ns = 0}).alerts[1].at, (Moment{2, 0}));
}

TEST(ReplayerTest, TimeIsRecordedAndUptimeCountsFromTheFirstEvent) {
  const auto program = MakeProgram(kTimes);

  const Result result =
      Replayed(program, {Signal(5'000), Signal(7'500), Signal(6'000), Signal(8'000)});

  EXPECT_TRUE(result.timed);
  ASSERT_THAT(result.alerts, SizeIs(4));
  const auto text = [&](size_t i) { return result.alerts[i].text; };
  EXPECT_THAT(text(0), HasSubstr(" 0"));
  // It never goes back.
  EXPECT_EQ(text(2), text(1));
  EXPECT_NE(text(3), text(1));
}

TEST(ReplayerTest, RefusesTimesThatAreNone) {
  const auto program = MakeProgram(kTimes);
  for (const int64_t time_ns : {int64_t{-1}, kTimeNsMax + 1, std::numeric_limits<int64_t>::min(),
                                std::numeric_limits<int64_t>::max()}) {
    Recorded event = Signal();
    event.time_unix_ns = time_ns;
    FakeReader reader({Signal(1), event});
    EXPECT_THAT(Replay(reader, program, {}, nullptr),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("event 1: time ")));
  }
  Recorded last = Signal();
  last.time_unix_ns = kTimeNsMax;
  EXPECT_THAT(Replayed(program, {last}).alerts, SizeIs(1));
  FakeReader reader({last, Signal()});
  EXPECT_THAT(Replay(reader, program, {}, nullptr), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(ReplayerTest, VirtualTicksComeBetweenEvents) {
  const auto program = MakeProgram(R"(
    rules External: e: true ? alert(string(signal("SIGUSR1")));
  )");
  const std::vector<Recorded> events = {Signal(1'000), Message("/t", "", 1'250), Signal(1'400)};

  const Result none = Replayed(program, events);
  const Result result = Replayed(program, events, {.tick_ns = 200 * kNanosPerMilli});

  EXPECT_THAT(Alerts(none), ElementsAre("0 e true", "2 e true"));
  EXPECT_THAT(Alerts(result), ElementsAre("0 e true", "0 e false", "1 e false", "2 e true"));
  EXPECT_EQ(result.alerts[1].at.time_ns, 1'200 * kNanosPerMilli);
  EXPECT_EQ(result.alerts[2].at.time_ns, 1'400 * kNanosPerMilli);
  EXPECT_EQ(result.events.external, 4u);
  EXPECT_EQ(result.rules[0].evaluated, 4u);
}

TEST(ReplayerTest, TooManyTicksAreAnError) {
  const auto program = MakeProgram("rules External: never: Uptime < 0 ? alert(\"\");");
  FakeReader most({Signal(0), Signal(kTicksBetweenEventsMax)});
  const auto result = Replay(most, program, {.tick_ns = kNanosPerMilli}, nullptr);
  ASSERT_THAT(result, IsOk());
  EXPECT_EQ(result->events.external, 2u + kTicksBetweenEventsMax);
  FakeReader reader({Signal(0), Signal(kTicksBetweenEventsMax + 1)});
  EXPECT_THAT(Replay(reader, program, {.tick_ns = kNanosPerMilli}, nullptr),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("event 1: it comes 1000 s after the event before it")));
}

// -------------------------------------------------------------------------------------- graph

constexpr char kStranger[] = R"(
  rules Graph: g: true ? alert("graph " + string(nodecount(2, 9)));
  rules Msg: m: !nodesinclude("/known") ? alert("stranger");
)";

TEST(ReplayerTest, TheGraphIsThatOfTheRecording) {
  const Result result =
      Replayed(MakeProgram(kStranger),
               {Event(Graph({"/known"})), Message("/t"), Event(Graph({"/x"}, false, true, 2)),
                Message("/t"), Event(Graph({"/y"})), Message("/t")});

  EXPECT_THAT(Alerts(result), ElementsAre("0 g graph false", "2 g graph true", "3 m stranger",
                                          "4 g graph false", "5 m stranger"));
  EXPECT_EQ(result.events.graph, 3u);
  EXPECT_EQ(result.events.undecidable, 0u);
}

TEST(ReplayerTest, WhatIsLeftOutOfTheGraphIsThatOfTheRecording) {
  const auto program = MakeProgram(R"(
    rules Graph:
      many: nodecount(3, 9) ? alert("many");
      known: hasnodes("/x") ? True();
    )");
  RecordedGraph cut = Graph({"/x"});
  cut.content.truncation = ros2::Truncation{.left_out = 2};
  RecordedGraph whole = Graph({}, false);
  whole.content.truncation = ros2::Truncation{};
  const Result result = Replayed(program, {Event(Graph({"/x"})), Event(cut), Event(whole)});
  EXPECT_THAT(result.alerts, SizeIs(1));
  EXPECT_EQ(result.rules[0].fired, 1u);
  EXPECT_EQ(result.rules[0].unscanned, 1u);
  EXPECT_EQ(result.rules[0].graph_truncated, 1u);
  EXPECT_EQ(result.rules[1].fired, 3u);
  EXPECT_EQ(result.rules[1].unscanned, 0u);
  EXPECT_THAT(result.faults, IsEmpty());
}

TEST(ReplayerTest, AContextChangesTheGraphAndIsNoEvent) {
  Recorded message = Message("/t");
  message.context = Graph({"/stranger"});

  const Result result = Replayed(MakeProgram(kStranger), {message, Message("/t")});

  EXPECT_THAT(Alerts(result), ElementsAre("0 m stranger", "1 m stranger"));
  EXPECT_EQ(result.events.graph, 0u);
}

TEST(ReplayerTest, AGraphIsJudgedOnceItIsSettled) {
  const Result result =
      Replayed(MakeProgram(kStranger), {Event(Graph({"/x"}, true, false)), Message("/t"),
                                        Event(Graph({"/y"}, false, true, 2)), Message("/t")});

  EXPECT_THAT(Alerts(result), ElementsAre("2 g graph true", "3 m stranger"));
  EXPECT_EQ(result.events.graph, 1u);
}

TEST(ReplayerTest, AChangeThatDoesNotFitIsAnError) {
  RecordedGraph broken = Graph({"/x"}, false);
  broken.content.upsert_participants.clear();
  FakeReader reader({Signal(), Event(broken)});

  EXPECT_THAT(Replay(reader, MakeProgram(kStranger), {}, nullptr),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("event 1: ")));
}

TEST(ReplayerTest, WithoutAGraphQuestionsAboutItAreUndecidable) {
  const auto program = MakeProgram(R"(
    rules Msg:
      a: nodesinclude("/x") ? alert("a");
      b: !nodesinclude("/x") ? alert("b");
      c: topicin("/u") && publishers("/x") ? alert("c");
      d: topicin("/u") || publishers("/x") ? alert("d");
  )");

  const Result result = Replayed(program, {Message("/t"), Message("/u"), Signal()}, {}, false);

  // Each event once, however many rules.
  EXPECT_EQ(result.events.undecidable, 2u);
  EXPECT_EQ(result.rules[0].undecidable, 2u);
  EXPECT_EQ(result.rules[2].undecidable, 1u);
  EXPECT_EQ(result.rules[3].undecidable, 1u);
  EXPECT_EQ(ToJson(result)["rules"][0]["undecidable"], 2);
  EXPECT_THAT(Alerts(result), ElementsAre("1 d d"));
  EXPECT_THAT(result.faults, IsEmpty());
}

TEST(ReplayerTest, SendersAreRecordedOrFoundInTheGraph) {
  const auto program = MakeProgram(R"(
    rules Msg:
      who: true ? alert(Sender);
      in: senderin("/x") ? alert("x");
      often: sendercount(1000, 2, 9) ? alert("often");
  )");
  Recorded by_guid = Message("/t");
  std::get<RecordedMessage>(by_guid.what).writer = WriterGuid(1);
  Recorded both = Message("/t", "/y");
  std::get<RecordedMessage>(both.what).writer = WriterGuid(1);

  const Result result =
      Replayed(program, {Event(Graph({"/x"})), by_guid, both, Message("/t"), Message("/t")});

  EXPECT_THAT(Alerts(result),
              ElementsAre("1 who /x", "1 in x", "2 who /y", "2 often often", "3 who ", "4 who "));
  EXPECT_EQ(result.events.unattributed, 2u);
  EXPECT_EQ(result.events.unattributed_writer, 2u);
}

TEST(ReplayerTest, MessagesWithoutASenderAreCounted) {
  Recorded unclaimed = Message("/t");
  std::get<RecordedMessage>(unclaimed.what).writer = WriterGuid(9);

  const Result result = Replayed(MakeProgram("rules Msg: m: senderin(\"/x\") ? alert(\"x\");"),
                                 {unclaimed, Message("/t"), Message("/t", "/x")});

  EXPECT_EQ(result.events.unattributed, 2u);
  EXPECT_EQ(result.events.unattributed_writer, 1u);
  EXPECT_EQ(ToJson(result)["events"].dump(),
            R"({"message":3,"graph":0,"external":0,"undecidable":0,"unattributed":2})");
}

// ------------------------------------------------------------------------------------- faults

TEST(ReplayerTest, FaultsAreAllListedAndAlertedOncePerSecondOfEventTime) {
  const auto program = MakeProgram(R"(
    vars: zero int = 0;
    rules External:
      f: 1 / zero == 1 ? set(zero, zero);
      chain: true ? { alert(string(1 / zero)), alert("second"); alert("third"); }
  )");
  std::vector<Recorded> events;
  for (const int64_t ms : {0, 500, 999, 1'000}) events.push_back(Signal(ms));

  const Result result = Replayed(program, events);

  ASSERT_THAT(result.faults, SizeIs(8));
  EXPECT_EQ(result.faults[0].rule, "f");
  EXPECT_THAT(result.faults[0].text, HasSubstr("zero"));
  EXPECT_EQ(result.faults[1].rule, "chain");
  EXPECT_EQ(result.faults[7].at.event, 3u);
  int of_f = 0;
  int third = 0;
  for (const Alerted& alert : result.alerts) {
    of_f += alert.rule == "f";
    third += alert.text == "third";
  }
  EXPECT_EQ(of_f, 2);
  EXPECT_EQ(third, 0);
  EXPECT_EQ(result.rules[0].fired, 0u);
  EXPECT_EQ(result.rules[1].fired, 4u);
}

// -------------------------------------------------------------------------------- inspections

class FakeSession final : public inspect::Session {
 public:
  engine::Verdict Inspect(uint32_t index, const inspect::Message& message) override {
    asked.push_back(absl::StrCat(index, message.topic, " ", message.payload.size(), " ",
                                 message.available ? "" : "not there"));
    return index == 0 ? engine::Verdict::kYes : engine::Verdict::kUnscanned;
  }
  std::vector<std::string> asked;
};

constexpr char kInspecting[] = R"(
  rules Msg:
    yes: topicin("/t") && payload("a.yar") ? alert("yes");
    unknown: topicin("/u") && payload("b.yar") ? alert("unknown");
)";

TEST(ReplayerTest, PayloadsAreInspectedWhereRulesAsk) {
  FakeSession session;
  Recorded missing = Event(RecordedMessage{.topic = "/u", .truncated = true});

  const Result result = Replayed(MakeProgram(kInspecting),
                                 {Message("/t"), Message("/other"), missing}, {}, true, &session);

  EXPECT_THAT(session.asked, ElementsAre("0/t 4 ", "1/u 0 not there"));
  EXPECT_THAT(Alerts(result), ElementsAre("0 yes yes", "2 unknown unknown"));
  EXPECT_EQ(result.rules[0].unscanned, 0u);
  EXPECT_EQ(result.rules[1].unscanned, 1u);
  EXPECT_EQ(result.rules[1].fired, 1u);
  const nlohmann::ordered_json rules = ToJson(result)["rules"];
  EXPECT_FALSE(rules[0].contains("unscanned"));
  EXPECT_EQ(rules[1]["unscanned"], 1);
}

TEST(ReplayerTest, WhatIsUnscannedIsUpToTheProgram) {
  using engine::OnInspectionError;
  const std::vector<Recorded> events = {Message("/u")};
  EXPECT_THAT(Alerts(Replayed(MakeProgram(kInspecting), events)), ElementsAre("0 unknown unknown"));
  EXPECT_THAT(Alerts(Replayed(MakeProgram(kInspecting, {OnInspectionError::kIgnore}), events)),
              IsEmpty());
  const Result alert = Replayed(MakeProgram(kInspecting, {OnInspectionError::kAlert}), events);
  EXPECT_THAT(Alerts(alert), ElementsAre(HasSubstr("could not be inspected")));
  EXPECT_THAT(alert.faults, IsEmpty());
  EXPECT_EQ(alert.rules[1].unscanned, 1u);
  EXPECT_EQ(alert.rules[1].fired, 0u);
}

// --------------------------------------------------------------------------------- the result

TEST(ReplayerTest, ExternalEventsAreAsRecorded) {
  const auto program = MakeProgram(R"(
    rules External:
      i: idsalert("scan") ? alert(IdsSource + " " + IdsTarget);
      a: agent("sensor", "lost") ? alert("lost");
      f: finding("impostor") ? alert("impostor");
      l: lostevents(12) ? alert("loss");
  )");

  const Result result = Replayed(
      program, {Event(model::IdsAlert{.message = "a scan", .src = "1", .dst = "2"}),
                Event(model::AgentEvent{"sensor", "lost"}), Event(model::Finding{"impostor"}),
                Event(model::Loss{12}), Event(recording::RecordedOther{"x"})});

  EXPECT_THAT(Alerts(result), ElementsAre("0 i 1 2", "1 a lost", "2 f impostor", "3 l loss"));
  EXPECT_EQ(result.events, (EventCounts{.external = 4}));
}

TEST(ReplayerTest, FindingsStandAsRecordedAndElseThatIsNotKnown) {
  const auto program = MakeProgram(R"(
    rules External:
      yes: findingstands("impostor") ? alert("stands");
      no: !findingstands("impostor") ? alert("does not");
  )");
  std::vector<Recorded> events(4, Event(model::SignalSeen{"SIGUSR1"}));
  events[1].findings.emplace(/*told_all=*/true);
  events[3].findings.emplace().Add("impostor");

  const Result result = Replayed(program, events);

  EXPECT_THAT(Alerts(result), ElementsAre("1 no does not", "2 no does not", "3 yes stands"));
  EXPECT_EQ(result.events.undecidable, 1u);
}

TEST(ReplayerTest, LossesCountInTheWindowsAsTheyDidOnTheRobot) {
  const auto program = MakeProgram(R"(
    rules Msg:
      flood: msgcount(1000, 5, 1000) ? alert("flood");
  )");
  constexpr int64_t kStart = 1'700'000'000 * kNanosPerSecond;
  const auto loss = [&](int64_t last_ns) {
    Recorded event = Event(model::Loss{
        .count = 4, .topic = "/t", .type = "p/msg/T", .first_ns = last_ns, .last_ns = last_ns});
    event.time_unix_ns = kStart;
    return event;
  };
  Recorded here = Message("/t");
  here.time_unix_ns = kStart + 1;
  EXPECT_THAT(Alerts(Replayed(program, {loss(kStart), here})), ElementsAre("1 flood flood"));
  EXPECT_THAT(Alerts(Replayed(program, {loss(kStart - kNanosPerSecond), here})), IsEmpty());
}

TEST(ReplayerTest, CountsTheEventsOfARulesClass) {
  const auto program = MakeProgram(R"(
    rules Msg: m: topicin("/t") ? alert("m");
    rules Graph: g: false ? alert("g");
  )");

  const Result result =
      Replayed(program, {Message("/t"), Message("/u"), Signal(), Event(Graph({}))});

  EXPECT_EQ(result.rules[0], (RuleHits{"m", lang::EventClass::kMsg, 2, 1, 0}));
  EXPECT_EQ(result.rules[1], (RuleHits{"g", lang::EventClass::kGraph, 1, 0, 0}));
}

TEST(ReplayerTest, TheRobotIsThatOfTheRecordingUnlessNamed) {
  const auto program = MakeProgram("rules External: r: true ? alert(Robot);");
  for (const char* named : {"", "r2"}) {
    FakeReader reader({Signal()});
    reader.robot.robot = "r1";
    const auto result = Replay(reader, program, {.robot = named}, nullptr);
    ASSERT_THAT(result, IsOk());
    EXPECT_EQ(result->alerts[0].text, *named == '\0' ? "r1" : "r2");
  }
}

TEST(ReplayerTest, ABrokenRecordingIsItsReadersError) {
  FakeReader reader({Signal()}, true, absl::InvalidArgumentError("x.rips: no event at 17"));
  EXPECT_THAT(Replay(reader, MakeProgram(kTimes), {}, nullptr),
              StatusIs(absl::StatusCode::kInvalidArgument, "x.rips: no event at 17"));
}

TEST(ReplayerTest, ARecordingThatIsCutIsReplayedAsFarAsItGoes) {
  const auto program = MakeProgram("rules Msg: m: topicin(\"/t\") ? alert(\"hi\");");
  std::vector<Recorded> events = {Message("/t"), Message("/t"), Message("/t")};
  for (size_t i = 0; i < events.size(); ++i) {
    events[i].time_unix_ns = kNanosPerSecond * static_cast<int64_t>(5 + 2 * i);
  }
  events[0].missing_before = "the first file";
  events[2].missing_before = "the second file";
  FakeReader reader(events, true, absl::DataLossError("`f`: byte 7: the file is cut"));

  const auto result = Replay(reader, program, {}, nullptr);

  ASSERT_THAT(result, IsOk());
  EXPECT_THAT(result->alerts, SizeIs(3));
  EXPECT_THAT(result->missing,
              ElementsAre(Missing{.text = "the first file"},
                          Missing{.after = Moment{.event = 1, .time_ns = 7 * kNanosPerSecond},
                                  .after_ns = 2 * kNanosPerSecond,
                                  .text = "the second file"},
                          Missing{.after = Moment{.event = 2, .time_ns = 9 * kNanosPerSecond},
                                  .after_ns = 4 * kNanosPerSecond,
                                  .end = true,
                                  .text = "`f`: byte 7: the file is cut"}));
  EXPECT_EQ(ToJson(*result)["missing"][2].dump(),
            R"({"after":2,"seconds":4.0,"end":true,"text":"`f`: byte 7: the file is cut"})");
  EXPECT_EQ(ToJson(*result)["missing"][0]["after"], nullptr);
  // Nothing of it is there.
  FakeReader empty({}, true, absl::DataLossError("cut"));
  EXPECT_THAT(Replay(empty, program, {}, nullptr), StatusIs(absl::StatusCode::kDataLoss));
}

TEST(ReplayerTest, TheSameRecordingGivesTheSameResult) {
  const auto program = MakeProgram(kTimes);
  const std::vector<Recorded> events = {Signal(3), Signal(4), Message("/t"), Event(Graph({"/x"}))};
  EXPECT_EQ(Replayed(program, events), Replayed(program, events));
}

TEST(ReplayerTest, MeasuresOnlyWhenAsked) {
  class Ticking final : public Clock {
   public:
    Instant Now() const override { return {.boottime_ns = now_ += 10}; }

   private:
    mutable int64_t now_ = 0;
  };
  const Ticking clock;
  const auto program = MakeProgram(kTimes);

  EXPECT_EQ(Replayed(program, {Signal(), Signal()}).rules[0].total_ns, 0);
  const Result result = Replayed(program, {Signal(), Signal()}, {.profile_clock = &clock});

  EXPECT_EQ(result.rules[0].total_ns, 20);
  EXPECT_EQ(result.rules[0].mean_ns(), 10);
}

TEST(ReplayerTest, ListsHaveALimit) {
  const auto program = MakeProgram("rules External: r: true ? alert(\"a\"), exec(\"p\");");

  const Result result = Replayed(program, {Signal(), Signal(), Signal()}, {.records_max = 3});

  EXPECT_EQ(result.alerts.size() + result.execs.size(), 3u);
  EXPECT_EQ(result.left_out, 3u);
  EXPECT_EQ(Replayed(program, {Signal(), Signal(), Signal()}, {.records_max = 6}).left_out, 0u);
}

TEST(ReplayerTest, TakenRecordsMakeRoomAndCountsGoOn) {
  Replayer replayer(MakeProgram(R"(
    rules Msg: seen: true ? alert("hi") => exec("p") => trigger(B) => True("x", 1);
    rules External: bad: false ? trigger(B);)"),
                    {.records_max = 4}, nullptr);
  for (uint64_t i = 0; i < 10; ++i) {
    Recorded message = Message("/t");
    message.index = i;
    ASSERT_THAT(replayer.Judge(message), IsOk());
    const Records records = replayer.TakeRecords();
    ASSERT_THAT(records.alerts, SizeIs(1));
    EXPECT_EQ(records.alerts[0].at.event, i);
    EXPECT_THAT(records.execs, SizeIs(1));
    EXPECT_THAT(records.transitions, SizeIs(i == 0 ? 1 : 0));
    EXPECT_THAT(replayer.so_far().alerts, IsEmpty());
  }
  EXPECT_EQ(replayer.so_far().left_out, 0u);
  EXPECT_EQ(replayer.so_far().rules[0].fired, 10u);
  EXPECT_EQ(replayer.crashed_rule(), "");
}

TEST(ReplayerTest, AfterAGraphThatDoesNotFitAWholeOneGoesOn) {
  Replayer replayer(MakeProgram(R"(rules Graph: one: nodes("/a") ? alert("one");)"), {}, nullptr);
  RecordedGraph bad = Graph({"/b"}, /*whole=*/false);
  bad.content.upsert_endpoints[0].node = "/nowhere";
  bad.content.upsert_endpoints[0].guid = WriterGuid(7);
  EXPECT_THAT(replayer.Judge(Event(bad)), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(replayer.Judge(Event(Graph({"/a"}))), IsOk());
  EXPECT_THAT(Alerts(replayer.so_far()), ElementsAre("0 one one"));
}

TEST(ResultJsonTest, IsTheContract) {
  const auto program = MakeProgram(R"(
    vars: n int = 1; big int = 9007199254740993; f float = 0.0; s string = "x"; b bool = true;
    rules MsgGraph: m: topicin("/t") ?
      alert("hi", "high"), exec("p", "a"), trigger(B), trigger(A), set(n, n + 1), True("v", n);
    rules External: e: false ? set(big, big), set(f, f), set(s, s), set(b, b);
    rules External: z: 1 / (n - 2) == 0 ? set(f, -1.0 / f);
  )");
  const Result result = Replayed(program, {Message("/t"), Signal()}, {.failing_programs = {"p"}});

  EXPECT_EQ(
      ToJson(result).dump(),
      R"({"events":{"message":1,"graph":0,"external":1,"undecidable":0,"unattributed":1},)"
      R"("level":"B",)"
      R"("transitions":[{"event":0,"rule":"m","from":"A","to":"B","result":"decided"},)"
      R"({"event":0,"rule":"m","from":"B","to":"A","result":"refused"}],)"
      R"("alerts":[{"event":0,"rule":"m","text":"hi","severity":"high"},)"
      R"({"event":1,"rule":"z","text":"fault in rule `z`: integer division by zero; it did not fire",)"
      R"("severity":"high"}],)"
      R"("execs":[{"event":0,"rule":"m","program":"p","args":["a"],"result":"failed"}],)"
      R"("variables":{"b":true,"big":"9007199254740993","f":0.0,"n":2,"s":"x"},)"
      R"("faults":[{"event":1,"rule":"z","text":"integer division by zero"}],)"
      R"("rules":[{"name":"m","section":"Msg","evaluated":1,"fired":1,"ns_mean":0},)"
      R"({"name":"e","section":"External","evaluated":1,"fired":0,"ns_mean":0},)"
      R"({"name":"z","section":"External","evaluated":1,"fired":0,"ns_mean":0},)"
      R"({"name":"hatch","section":"External","evaluated":1,"fired":0,"ns_mean":0}],)"
      R"("logs":[{"event":0,"rule":"m","text":"v 2"}]})");
}

TEST(ResultJsonTest, WhatJsonCannotHoldIsAString) {
  EXPECT_EQ(ToJson(lang::Value(std::numeric_limits<double>::quiet_NaN())), "NaN");
  EXPECT_EQ(ToJson(lang::Value(std::numeric_limits<double>::infinity())), "+Inf");
  EXPECT_EQ(ToJson(lang::Value(-std::numeric_limits<double>::infinity())), "-Inf");
  EXPECT_EQ(ToJson(lang::Value(int64_t{1} << 53)), int64_t{1} << 53);
  EXPECT_EQ(ToJson(lang::Value((int64_t{1} << 53) + 1)), "9007199254740993");
  EXPECT_EQ(ToJson(lang::Value(std::numeric_limits<int64_t>::min())), "-9223372036854775808");
}

}  // namespace
}  // namespace rips::replay
