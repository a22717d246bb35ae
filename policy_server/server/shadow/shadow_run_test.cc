#include "policy_server/server/shadow/shadow_run.h"

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "policy_server/server/shadow/shadow_test_data.h"

namespace rips::shadow {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class ShadowRunTest : public ::testing::Test {
 protected:
  void Begin(const ShadowPolicy& policy, const RulesState& state,
             inspect::Session* session = nullptr) {
    run_ = std::make_unique<ShadowRun>(policy, "r1", state, session);
  }
  void Begin(const std::string& rules, const std::string& level = "DEFAULT") {
    Begin(PolicyFrom(rules), StateOf(graph_, level));
  }
  void Message(const std::string& topic, int64_t time_ns = 1'000) {
    run_->Judge(MessageOn(topic, graph_, time_ns));
  }
  ShadowReport Report() const {
    ShadowReport report;
    run_->Report(report);
    return report;
  }
  // "kind rule text" of each example.
  std::vector<std::string> Examples() const {
    std::vector<std::string> out;
    for (const ShadowExample& each : Report().examples) {
      out.push_back(absl::StrCat(each.kind, " ", each.rule, " ", each.text));
    }
    return out;
  }

  const std::shared_ptr<const ros2::RosGraph> graph_ = GraphOf({"/camera"});
  std::unique_ptr<ShadowRun> run_;
};

TEST_F(ShadowRunTest, CountsWhatTheRulesWouldHaveDone) {
  Begin(R"(vars: n int = 0;
    rules Msg:
      seen: topicin("/cmd") ? alert("on " + Topic) => trigger(COMPROMISED) => exec("stop", Topic);
      bad: topicin("/bad") && 1 / n > 0 ? alert("never") => set(n, n);
    rules Graph:
      new_node: nodes("/camera", "/intruder") ? alert("new");
    rules External:
      down: signal("SIGUSR1") ? alert("never");)");
  Message("/cmd", 5'000);
  Message("/bad");
  run_->Judge(GraphEventOf(GraphOf({"/camera", "/intruder"})));
  run_->Judge(TickAt(graph_));
  const ShadowReport report = Report();
  EXPECT_EQ(report.events, 4u);
  EXPECT_EQ(report.would.alerts, 3u) << "a fault is an alert, too";
  EXPECT_EQ(report.would.raises, 1u);
  EXPECT_EQ(report.would.programs, 1u);
  EXPECT_EQ(report.would.faults, 1u);
  EXPECT_EQ(report.level, "COMPROMISED");
  EXPECT_EQ(report.problem, "");
  EXPECT_EQ(report.bundle_id, "sha256:1");
  EXPECT_EQ(report.name, "candidate");
  EXPECT_THAT(report.rules, SizeIs(2));
  EXPECT_EQ(report.examples[0].time_unix_ns, 5'000);
  EXPECT_THAT(Examples(),
              ::testing::IsSupersetOf({"alert seen on /cmd", "raise seen DEFAULT -> COMPROMISED",
                                       "program seen stop /cmd", "alert new_node new"}));
}

TEST_F(ShadowRunTest, BeginsWithTheRobotsLevelAndVariablesWhereItHasThem) {
  RulesState state = StateOf(graph_, "ALERT");
  state.variables = {{"seen", true}, {"count", std::string("not a number")}, {"other", true}};
  Begin(
      PolicyFrom("vars: seen bool = false; count int = 3; rules Msg: show: seen ? alert(\"yes\"); "
                 "rules External: keep: false ? set(seen, count > 0), set(count, count);"),
      state);
  Message("/a");
  EXPECT_EQ(Report().level, "ALERT");
  EXPECT_THAT(Examples(), ElementsAre("alert show yes"));

  ShadowPolicy other = PolicyFrom(
      "rules Msg: up: topicin(\"/a\") ? trigger(HIGH); never: false ? "
      "trigger(LOW);",
      {}, "levels: LOW; HIGH;\n");
  Begin(other, state);
  EXPECT_EQ(Report().level, "LOW");
  run_->Judge(pipeline::LevelChange{.to = "COMPROMISED", .cause = "operator alice"});
  EXPECT_EQ(Report().level, "LOW") << "it has no such level";
  Message("/a");
  EXPECT_EQ(Report().level, "HIGH");
  EXPECT_EQ(Report().would.faults, 0u);
  EXPECT_EQ(Report().problem, "");
}

TEST_F(ShadowRunTest, AnOperatorsOrderHappensToItAndIsNotCounted) {
  Begin("rules Msg: up: topicin(\"/a\") ? trigger(COMPROMISED);");
  Message("/a");
  ASSERT_EQ(Report().level, "COMPROMISED");
  run_->Judge(
      pipeline::LevelChange{.to = "DEFAULT", .cause = "operator alice", .time_unix_ns = 2'000});
  EXPECT_EQ(Report().level, "DEFAULT");
  run_->Judge(pipeline::LevelChange{.to = "HALT", .cause = "operator alice"});
  EXPECT_EQ(Report().level, "HALT");
  EXPECT_EQ(Report().would, (ShadowCounts{.raises = 1}));
  EXPECT_THAT(Report().examples, SizeIs(1));
}

TEST_F(ShadowRunTest, SoftLoweringsNeedTheEvidenceThatTheRobotHas) {
  Begin("rules Msg: down: topicin(\"/a\") ? trigger(DEFAULT);", "ALERT");
  JudgedEvent blind = MessageOn("/a", graph_);
  blind.blind = true;
  run_->Judge(blind);
  run_->Judge(blind);
  EXPECT_EQ(Report().would.refusals, 2u);
  Message("/a");
  EXPECT_EQ(Report().would.lowerings, 1u);
  EXPECT_EQ(Report().level, "DEFAULT");
}

TEST_F(ShadowRunTest, FindingsStandAsForTheRulesInForce) {
  Begin("rules Msg: found: findingstands(\"impostor\") ? alert(\"x\");");
  JudgedEvent found = MessageOn("/a", graph_);
  run_->Judge(found);
  EXPECT_EQ(Report().would.alerts, 0u);
  found.findings.Add("impostor");
  run_->Judge(found);
  EXPECT_EQ(Report().would.alerts, 1u);
  run_->Judge(MessageOn("/a", graph_));
  EXPECT_EQ(Report().would.alerts, 1u);
}

TEST_F(ShadowRunTest, CountsAreExactForEverAndExamplesAreFew) {
  Begin("vars: n int = 0; rules Msg: all: true ? set(n, n + 1) => alert(string(n));");
  constexpr uint64_t kMany = 100'000;
  for (uint64_t i = 0; i < kMany; ++i) Message("/a", static_cast<int64_t>(i));
  const ShadowReport report = Report();
  EXPECT_EQ(report.events, kMany);
  EXPECT_EQ(report.would.alerts, kMany);
  EXPECT_THAT(report.rules, ElementsAre(ShadowRule{.rule = "all", .fired = kMany}));
  ASSERT_THAT(report.examples, SizeIs(kFirstExamples + kNewestExamples));
  EXPECT_EQ(report.examples[7].text, "8");
  EXPECT_EQ(report.examples[8].text, "99993");
  EXPECT_EQ(report.examples[15].text, "100000");
}

TEST_F(ShadowRunTest, EveryFaultIsCounted) {
  Begin(
      "vars: zero int = 0; rules Msg: bad: 1 / zero > 0 ? alert(\"x\"); "
      "rules External: keep: false ? set(zero, zero);");
  for (int i = 0; i < 1'000; ++i) Message("/a");
  EXPECT_EQ(Report().would.faults, 1'000u);
  EXPECT_LT(Report().would.alerts, 1'000u) << "alerts of faults are limited by the engine";
  EXPECT_EQ(Report().problem, "");
}

TEST_F(ShadowRunTest, StopsWhenARuleCallsCrash) {
  Begin("rules Msg: boom: topicin(\"/a\") ? crash(\"no\"); all: true ? alert(\"seen\");");
  Message("/b");
  Message("/a");
  ASSERT_TRUE(run_->stopped());
  EXPECT_THAT(Report().problem, HasSubstr("rule boom has called `crash`"));
  const ShadowCounts would = Report().would;
  Message("/b");
  run_->Judge(pipeline::LevelChange{.to = "DEFAULT"});
  EXPECT_EQ(Report().would, would);
  EXPECT_EQ(Report().events, 2u);
}

TEST_F(ShadowRunTest, HostileTextsAndTimesAreHarmless) {
  Begin("rules Msg: all: true ? alert(Topic + Sender + Topic);");
  const std::string bytes("/\xff\xc3\0\n\x1b[2J", 10);
  run_->Judge(MessageOn(bytes + std::string(5'000, 'x'), graph_,
                        std::numeric_limits<int64_t>::min(), "", std::string(5'000, '\xe2')));
  run_->Judge(MessageOn("/b", graph_, std::numeric_limits<int64_t>::max()));
  run_->Judge(MessageOn("", graph_, -1, "", ""));
  const ShadowReport report = Report();
  EXPECT_EQ(report.would.alerts, 3u);
  for (const ShadowExample& example : report.examples) {
    EXPECT_LE(example.text.size(), kTextBytesMax);
    EXPECT_GE(example.time_unix_ns, 0);
  }
  EXPECT_EQ(report.problem, "");
}

TEST_F(ShadowRunTest, JudgesMessagesUnderTheirGraphAlsoAfterMissedEvents) {
  Begin(R"(rules Msg: two: nodes("/camera", "/b") ? alert("two"); one: nodes("/camera") ?
        alert("one"); rules Graph: more: hasnodes("/c") ? alert("c");)");
  const auto later = GraphOf({"/camera", "/b"});
  run_->Judge(GraphEventOf(later));
  run_->Judge(MessageOn("/a", graph_));
  run_->Judge(MessageOn("/a", later));
  EXPECT_THAT(Examples(), ElementsAre("alert one one", "alert two two"));
  // Two graphs were missed.
  run_->Judge(GraphEventOf(GraphOf({"/x", "/y", "/c"})));
  EXPECT_EQ(Examples().back(), "alert more c");
  run_->Judge(MessageOn("/a", graph_));
  EXPECT_EQ(Examples().back(), "alert one one");
  EXPECT_EQ(Report().problem, "");
}

TEST_F(ShadowRunTest, IsGivenWhatItsSensorsWouldSend) {
  Begin(
      "rules Msg: all: true ? alert(Topic); rules External: lost: lostevents(1) ? "
      "alert(\"lost\");");
  Message("/rosout");
  Message("/a");
  EXPECT_THAT(Examples(), ElementsAre("alert all /a"));
  EXPECT_EQ(Report().events, 1u);

  Begin(
      "rules Msg: one: topicin(\"/a\") ? alert(Topic); rules External: lost: lostevents(1) ? "
      "alert(\"lost\");");
  run_->Judge(EventOf(engine::ExternalEvent(model::Loss{.count = 1, .topic = "/b"}), graph_));
  EXPECT_THAT(Examples(), IsEmpty());
  run_->Judge(EventOf(engine::ExternalEvent(model::Loss{.count = 1, .topic = "/a"}), graph_));
  run_->Judge(EventOf(engine::ExternalEvent(model::Loss{.count = 1}), graph_));
  EXPECT_THAT(Examples(), ElementsAre("alert lost lost", "alert lost lost"));
}

TEST_F(ShadowRunTest, InspectsAsManyBytesAsItsPolicyAsksFor) {
  std::vector<std::string> seen;
  const FakeInspections inspections([&](const inspect::Message& message) {
    seen.push_back(absl::StrCat(message.topic, " ", message.payload, " ", message.size_bytes));
    return engine::Verdict::kYes;
  });
  const auto session = inspections.NewSession();
  Begin(PolicyFrom("rules Msg: bad: topicin(\"/a\", \"/b\") && payload(\"a.yar\") ? alert(\"x\");",
                   {{"^/b$", 3}}),
        StateOf(graph_), session.get());
  run_->Judge(MessageOn("/a", graph_, 1, "abcdef"));
  run_->Judge(MessageOn("/b", graph_, 1, "abcdef"));
  run_->Judge(MessageOn("/c", graph_, 1, "abcdef"));
  EXPECT_THAT(seen, ElementsAre("/a abcdef 6", "/b abc 6"));
  EXPECT_EQ(Report().would.alerts, 2u);
}

TEST_F(ShadowRunTest, ReportsTheRulesThatFiredMost) {
  std::string rules = "rules Msg:\n";
  for (int i = 0; i < 150; ++i) {
    absl::StrAppend(&rules, "r", 100 + i, ": topicmatches(\"^/a\") ? alert(\"x\");\n");
  }
  absl::StrAppend(&rules, "most: true ? alert(\"x\"); never: topicin(\"/n\") ? alert(\"x\");");
  Begin(rules);
  Message("/b");
  Message("/a");
  const ShadowReport report = Report();
  ASSERT_THAT(report.rules, SizeIs(kRulesMax));
  EXPECT_EQ(report.rules[0], (ShadowRule{.rule = "most", .fired = 2}));
  EXPECT_EQ(report.rules[1].rule, "r100");
  EXPECT_EQ(report.rules.back().rule, "r198");
}

}  // namespace
}  // namespace rips::shadow
