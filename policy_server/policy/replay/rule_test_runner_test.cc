#include "policy_server/policy/replay/rule_test_runner.h"

#include <stdlib.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::replay {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr char kRules[] = R"(
levels: A; B soft; C;
vars: n int = 0; f float = 0.5; s string = ""; b bool = false; target int = B;
rules Graph:
  stranger: !nodesinclude("/known") ? alert("stranger", "high"), trigger(B);
rules Msg:
  count: topicin("/t") ? set(n, n + 1);
  flood: topicin("/t") && msgcount(1000, 6, 100) ? alert("flood");
  bad: topicin("/bad") && payload("bad.yar") ? alert("bad payload");
rules External:
  run: signal("SIGUSR1") ? {
    exec("p", "x", Robot) => alert("ran");
    trigger(C) !> alert("not reached");
  }
  fault: signal("SIGUSR2") && 1 / n == 0 ? set(s, s);
  calm: CurrLevel == B && Uptime >= 1 ? trigger(A);
  values: false ? set(f, f), set(b, b), trigger(target), set(target, B);
)";

class RuleTestRunnerTest : public testing::Test {
 protected:
  RuleTestRunnerTest() {
    std::string name = testing::TempDir() + "/rips-replay-XXXXXX";
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
    Write("a.rul", kRules);
    Write("bad.yar", "rule bad { strings: $a = \"EVIL\" condition: $a }\n");
  }
  ~RuleTestRunnerTest() override { std::filesystem::remove_all(folder_); }

  void Write(const std::string& name, const std::string& text) {
    std::ofstream(absl::StrCat(folder_, "/", name), std::ios::binary) << text;
  }
  absl::StatusOr<FileOutcome> Run(const std::string& tests) {
    const auto file = ParseRuleTestFile(folder_ + "/a_test.yaml", "rules: [a.rul]\n" + tests);
    if (!file.ok()) return file.status();
    const auto rules = LoadRuleSet(file->rules, file->options, &clock_);
    if (!rules.ok()) return rules.status();
    EXPECT_NE(rules->program, nullptr) << lang::RenderText(rules->files, rules->diagnostics);
    if (rules->program == nullptr) return absl::InternalError("refused");
    return RunRuleTests(*file, *rules);
  }
  // "LINE what: expected | got" of every failure.
  std::vector<std::string> Failures(const std::string& tests) {
    const auto outcome = Run(tests);
    EXPECT_THAT(outcome, IsOk());
    std::vector<std::string> out;
    if (!outcome.ok()) return out;
    for (const TestOutcome& test : outcome->tests) {
      for (const TestFailure& failure : test.failures) {
        out.push_back(absl::StrCat(failure.line, " ", failure.what, ": ",
                                   absl::StrJoin(failure.expected, "; "), " | ",
                                   absl::StrJoin(failure.got, "; ")));
      }
    }
    return out;
  }

  const RealClock clock_;
  std::string folder_;
};

TEST_F(RuleTestRunnerTest, PassesWhatIsAsExpected) {
  EXPECT_THAT(Failures(R"(
robot: r1
tests:
  - name: strangers
    events:
      - graph: {nodes: [/known]}
        expect: {alerts: [], fired: [], level: A, transitions: []}
      - graph: {nodes: [/known, /stranger]}
        expect:
          alerts: [{rule: stranger, text: stranger, severity: high}]
          transitions: [{rule: stranger, from: A, to: B, result: decided}]
          fired: [stranger]
          level: B
      - wait_ms: 2000
      - tick:
        expect: {level: A, fired: [calm]}
    expect: {alerts: [{rule: stranger}], transitions: [{to: B}, {to: A}], fired: [stranger, calm]}
  - name: a flood
    variables: {n: 10}
    events:
      - message: {topic: /t, repeat: 5}
        expect: {alerts: [], variables: {n: 15}}
      - message: {topic: /t, repeat: 2}
        expect: {alerts: [{text: flood}, {text: flood}]}
      - wait_ms: 2000
      - message: {topic: /t}
        expect: {alerts: []}
      - message: {topic: /t, repeat: 10, every_ms: 500}
        expect: {alerts: []}
  - name: programs and levels that fail
    exec_fail: [p]
    trigger_fail: [C]
    events:
      - signal: SIGUSR1
        expect:
          execs: [{rule: run, program: p, args: [x, r1], result: failed}]
          alerts: [{text: not reached}]
          level: C
  - name: programs that succeed
    start_level: B
    events:
      - signal: SIGUSR1
        expect: {execs: [{program: p, result: ok}], alerts: [{text: ran}]}
      - signal: SIGUSR2
        expect: {faults: [{rule: fault, text: integer division by zero}], fired: []}
  - name: payloads
    events:
      - message: {topic: /bad, payload_text: "so EVIL"}
        expect: {alerts: [{text: bad payload}]}
      - message: {topic: /bad, payload_text: "so good"}
        expect: {alerts: []}
      - message: {topic: /bad, size: 100}
        expect: {alerts: [{text: bad payload}]}
)"),
              IsEmpty());
}

TEST_F(RuleTestRunnerTest, TellsWhatIsNotAndGoesOn) {
  EXPECT_THAT(
      Failures(R"(tests:
  - name: one
    events:
      - graph: {nodes: [/stranger]}
        expect:
          alerts: []
          level: A
          fired: [stranger, calm]
      - message: {topic: /t}
        expect: {variables: {n: 2}}
      - signal: SIGUSR1
        expect: {execs: [{program: p, args: []}]}
    expect:
      alerts: [{rule: run}, {severity: high}]
  - name: two
    events:
      - lost: 1
        expect: {transitions: [{to: B}]}
)"),
      ElementsAre("9 fired: rule: stranger; rule: calm | rule: stranger",
                  "7 alerts: (none) | rule: stranger, severity: high, text: stranger",
                  "8 level: A | B", "11 variable `n`: 2 | 1",
                  "13 execs: program: p, args: [] | program: p, result: ok, rule: run, args: [x, ]",
                  "15 alerts at the end: rule: run; severity: high | rule: stranger, severity: "
                  "high, text: stranger; rule: run, severity: medium, text: ran",
                  "19 transitions: to: B | (none)"));
}

TEST_F(RuleTestRunnerTest, TestsDoNotSeeEachOther) {
  EXPECT_THAT(Failures(R"(tests:
  - name: one
    events: [{message: {topic: /t}}]
  - name: two
    events: [{message: {topic: /t}}]
    expect: {variables: {n: 1}, level: A}
)"),
              IsEmpty());
}

TEST_F(RuleTestRunnerTest, ListsRulesThatNeverFired) {
  const auto outcome = Run("tests: [{name: t, events: [{message: {topic: /t}}]}]");
  ASSERT_THAT(outcome, IsOk());
  // `values` never fires, and says so.
  EXPECT_THAT(outcome->not_exercised,
              ElementsAre("stranger", "flood", "bad", "run", "fault", "calm"));
}

TEST_F(RuleTestRunnerTest, TimeStartsLongAfterZero) {
  Write("a.rul", R"(levels: A; B;
vars: never int = 0; now int = 0; up int = 7;
rules External:
  long_ago: Time - never > 10000000000 ? set(now, Time), set(up, Uptime), trigger(B);
  use: now == 0 && up == 0 || false ? set(never, never);
)");
  EXPECT_THAT(Failures(R"(tests:
  - name: t
    events:
      - tick: {}
        expect: {fired: [long_ago], variables: {now: 1767225600000000000, up: 0}}
  - name: more than there are years
    events:
      - {tick: {repeat: 100000, every_ms: 86400000}, expect: {level: B}}
  - name: at that time nothing happens
    events: [{wait_ms: 86400000}, {operator: {raise: B}, expect: {level: B}}]
)"),
              ElementsAre("9 the event itself: it can be judged | it would happen after the year "
                          "2115"));
}

TEST_F(RuleTestRunnerTest, WhatWasUnscannedIsSaid) {
  const std::string tests = R"(tests:
  - name: not meant
    events:
      - message: {topic: /bad, size: 100}
        expect: {alerts: [], level: B, unscanned: []}
      - message: {topic: /t}
        expect: {alerts: [{}]}
  - name: meant
    events:
      - message: {topic: /bad, size: 100}
        expect: {fired: [bad], unscanned: [bad]}
      - message: {topic: /bad, payload_text: good}
        expect: {fired: [], unscanned: []}
  - name: meant in all
    events: [{message: {topic: /bad, size: 100}}]
    expect: {unscanned: [bad]}
  - name: passes and is not meant
    events: [{message: {topic: /bad, size: 100, repeat: 3}}]
)";
  const auto outcome = Run(tests);
  ASSERT_THAT(outcome, IsOk());
  const TestOutcome& first = outcome->tests[0];
  ASSERT_EQ(first.failures.size(), 4u);
  const std::string note = "an inspection could not tell, so these rules fired: bad";
  EXPECT_EQ(first.failures[0].what, "alerts");
  EXPECT_EQ(first.failures[0].note, note);
  EXPECT_EQ(first.failures[1].what, "unscanned");
  EXPECT_EQ(first.failures[1].note, "");
  EXPECT_EQ(first.failures[2].what, "level");
  EXPECT_EQ(first.failures[2].note, note);
  // Nothing was asked on that event.
  EXPECT_EQ(first.failures[3].what, "alerts");
  EXPECT_EQ(first.failures[3].note, "");
  EXPECT_THAT(first.unscanned, IsEmpty());
  for (size_t i : {1, 2}) {
    EXPECT_TRUE(outcome->tests[i].passed());
    EXPECT_THAT(outcome->tests[i].unscanned, IsEmpty());
  }
  EXPECT_TRUE(outcome->tests[3].passed());
  EXPECT_THAT(outcome->tests[3].unscanned, ElementsAre("bad"));

  const auto ignored = Run("on_inspection_error: ignore\n" + tests);
  ASSERT_THAT(ignored, IsOk());
  EXPECT_EQ(ignored->tests[1].failures[0].what, "fired");
  EXPECT_EQ(ignored->tests[1].failures[0].note,
            "an inspection could not tell, so these rules did not fire: bad");
}

TEST_F(RuleTestRunnerTest, OperatorsAndEvidence) {
  EXPECT_THAT(Failures(R"(tests:
  - name: a person lowers what the rules may not
    start_level: C
    events:
      - operator: {lower: A}
        expect: {level: A, transitions: [{rule: operator, from: C, to: A, result: decided}]}
      - operator: {raise: B}
        expect: {level: B, fired: []}
      - wait_ms: 5
      - tick: {}
        expect: {fired: [calm], level: A}
      - operator: {lower: B}
        expect: {transitions: [{rule: operator, result: refused, reason: not lower}], level: A}
  - name: nobody lowers what is not seen
    start_level: B
    evidence: incomplete
    events:
      - signal: SIGUSR2
      - tick: {}
        expect: {transitions: [{rule: calm, to: A, result: refused, reason: blind}], level: B}
      - evidence: complete
      - tick: {}
        expect: {level: A}
      - evidence: incomplete
      - operator: {raise: B}
      - tick: {}
        expect: {transitions: [{reason: blind}]}
)"),
              IsEmpty());
}

TEST_F(RuleTestRunnerTest, KnowsTheNamesOfTheRules) {
  EXPECT_THAT(
      Run(R"(start_level: AA
tests:
  - name: t
    start_level: X
    trigger_fail: [Y]
    exec_fail: [usb]
    variables: {m: 1, n: 0.5, f: x, b: 1}
    events:
      - lost: 1
        expect:
          level: Z
          alerts: [{rule: stragner, severity: urgent}]
          execs: [{program: q, result: perhaps}]
          transitions: [{from: V, to: W, reason: tired}]
          fired: [r]
          unscanned: [s]
          variables: {n: one}
      - operator: {lower: O}
)"),
      StatusIs(absl::StatusCode::kInvalidArgument,
               AllOf(HasSubstr("a_test.yaml:2: the rules have no level `AA`"),
                     HasSubstr("a_test.yaml:5: the rules have no level `X`"),
                     HasSubstr("a_test.yaml:6: the rules have no level `Y`"),
                     HasSubstr("a_test.yaml:7: the rules have no program `usb`"),
                     HasSubstr("a_test.yaml:8: the rules have no variable `m`"),
                     HasSubstr("`tired` is no reason; write `needs an operator` or `blind`"),
                     HasSubstr("no rule `s`"), HasSubstr("no level `O`"),
                     HasSubstr("`0.5` is no int, which the variable `n` is"),
                     HasSubstr("`x` is no float"), HasSubstr("`1` is no bool"),
                     HasSubstr(":12: the rules have no level `Z`"),
                     HasSubstr("no rule `stragner`; did you mean `stranger`?"),
                     HasSubstr("`urgent` is no severity; write `info` or"),
                     HasSubstr("no program `q`"), HasSubstr("`perhaps` is no result"),
                     HasSubstr("no level `V`"), HasSubstr("no level `W`"), HasSubstr("no rule `r`"),
                     HasSubstr("`one` is no int"))));
}

TEST_F(RuleTestRunnerTest, AValueThatAVariableCannotTakeIsAFailure) {
  EXPECT_THAT(Failures("tests: [{name: t, variables: {target: C}, expect: {variables: "
                       "{target: 2}}}]"),
              IsEmpty());
  EXPECT_THAT(Failures("tests: [{name: t, variables: {target: 3}}]"),
              ElementsAre(HasSubstr("initial value of `target`: 3 |")));
}

TEST_F(RuleTestRunnerTest, RulesThatCannotBeReadOrAreRefused) {
  EXPECT_THAT(LoadRuleSet({folder_ + "/none.rul"}, {}, &clock_),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("none.rul")));
  Write("broken.rul", "levels: A\n");
  const auto broken = LoadRuleSet({folder_ + "/broken.rul"}, {}, &clock_);
  ASSERT_THAT(broken, IsOk());
  EXPECT_EQ(broken->program, nullptr);
  EXPECT_FALSE(broken->diagnostics.empty());
  Write("bad.yar", "rule bad { condition: nonsense }\n");
  const auto yara = LoadRuleSet({folder_ + "/a.rul"}, {}, &clock_);
  ASSERT_THAT(yara, IsOk());
  EXPECT_EQ(yara->program, nullptr);
  EXPECT_THAT(lang::RenderText(yara->files, yara->diagnostics), HasSubstr("bad.yar"));
}

}  // namespace
}  // namespace rips::replay
