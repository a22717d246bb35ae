#include "policy_server/policy/engine/interest/interest.h"

#include <algorithm>
#include <random>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/state/topic_verdicts.h"
#include "policy_server/policy/engine/test_rules.h"
#include "re2/re2.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr uint32_t kBytes = 4'096;

TypedExpr In(const std::vector<std::string>& topics) {
  return Call(Builtin::kTopicIn, Texts(topics));
}
TypedExpr Matches(const std::string& pattern) {
  return Call(Builtin::kTopicMatches, Texts({pattern}));
}
TypedExpr Elsewhere() { return Call(Builtin::kPublisherCount, {I(1), I(1)}); }

InterestPlan Plan(const TestRules& rules) {
  InterestPlan plan = PlanInterest(rules.rules, kBytes);
  EXPECT_FALSE(plan.empty());
  EXPECT_EQ(plan.back().topic_regex, "") << "the last one is about every topic";
  for (const TopicInterest& row : plan) {
    EXPECT_EQ(row.payload_bytes_max, row.depth == Depth::kPayload ? kBytes : 0);
  }
  return plan;
}

// "payload ^/cam: r1 r2"; without the topics that are asked for only if they are named.
std::vector<std::string> Rows(const TestRules& rules) {
  std::vector<std::string> rows;
  for (const TopicInterest& row : Plan(rules)) {
    if (row.topic_regex == "^\\/rosout$" || row.topic_regex == "^\\/parameter_events$") continue;
    const char* depth = row.depth == Depth::kNothing    ? "nothing"
                        : row.depth == Depth::kMetadata ? "metadata"
                                                        : "payload";
    rows.push_back(
        absl::StrCat(depth, " ", row.topic_regex, ": ", absl::StrJoin(row.wanted_by, " ")));
  }
  return rows;
}

// What is asked for of a topic.
Depth DepthOf(const InterestPlan& plan, const std::string& topic) {
  for (const TopicInterest& row : plan) {
    if (RE2::PartialMatch(topic, row.topic_regex)) return row.depth;
  }
  return Depth::kNothing;
}

// Of the payloads that are asked for.
std::vector<std::string> Regexes(const TestRules& rules) {
  std::vector<std::string> regexes;
  for (const TopicInterest& row : Plan(rules)) {
    if (row.depth == Depth::kPayload) regexes.push_back(row.topic_regex);
  }
  return regexes;
}

std::vector<std::string> Regexes(TypedExpr condition) {
  TestRules rules;
  rules.Inspections(1).Msg("r", std::move(condition), {{Alert("x")}});
  return Regexes(rules);
}

bool AnyMatches(const std::vector<std::string>& regexes, const std::string& topic) {
  return std::any_of(regexes.begin(), regexes.end(),
                     [&](const std::string& regex) { return RE2::PartialMatch(topic, regex); });
}

TEST(InterestTest, RulesThatDoNotInspectNeedNoPayload) {
  EXPECT_THAT(Regexes(In({"/a"})), IsEmpty());
  EXPECT_THAT(Regexes(TestRules()), IsEmpty());
}

TEST(InterestTest, WithoutMessageRulesNothingIsNeeded) {
  TestRules rules;
  EXPECT_THAT(Rows(rules), ElementsAre("nothing : "));
  rules.Graph("g", B(true), {{Alert("x")}}).Tick("t", B(true), {{Alert("x")}});
  rules.Msg("never", And(In({"/a"}), B(false)), {{Alert("x")}});
  EXPECT_THAT(Plan(rules), ElementsAre(TopicInterest{.depth = Depth::kNothing}));
}

TEST(InterestTest, MetadataOfTheTopicsOnWhichARuleMayFire) {
  TestRules rules;
  rules.Msg("name", In({"/a", "/b"}), {{Alert("x")}});
  rules.Msg("pattern", And(Matches("^/cam"), Elsewhere()), {{Alert("x")}});
  EXPECT_THAT(Rows(rules), ElementsAre("metadata ^\\/a$: name", "metadata ^\\/b$: name",
                                       "metadata ^/cam: pattern", "nothing : "));
  rules.Msg("all", Elsewhere(), {{Alert("x")}});
  EXPECT_THAT(Rows(rules), ElementsAre("metadata : all name pattern"));
}

TEST(InterestTest, WhatDependsOnVariablesIsNeededOfAllTopics) {
  TestRules rules;
  const uint32_t flag = rules.Var("b", ValueType::kBool, false);
  rules.Msg("sets", In({"/a"}), {{Set(flag, B(true))}});
  rules.Msg("reads", And(In({"/b"}), V(flag)), {{Alert("x")}});
  EXPECT_THAT(Rows(rules),
              ElementsAre("metadata ^\\/a$: sets", "metadata ^\\/b$: reads", "nothing : "));
  rules.Msg("reads_anywhere", V(flag), {{Alert("x")}});
  EXPECT_THAT(Rows(rules), ElementsAre("metadata : reads reads_anywhere sets"));
}

// The order is what makes overlaps right: names, payloads, metadata, the rest.
TEST(InterestTest, WhereRulesOverlapTheDeepestWins) {
  TestRules rules;
  rules.Inspections(1);
  rules.Msg("count", Matches("^/"), {{Alert("x")}});
  rules.Msg("scan", And(Matches("^/cam"), Inspect(0)), {{Alert("x")}});
  rules.Msg("name", In({"/cam/a", "/b"}), {{Alert("x")}});
  const InterestPlan plan = Plan(rules);
  EXPECT_THAT(Rows(rules), ElementsAre("payload ^/cam: count name scan", "metadata ^/: count name",
                                       "nothing : "));
  EXPECT_EQ(DepthOf(plan, "/cam/a"), Depth::kPayload);
  EXPECT_EQ(DepthOf(plan, "/cam/b"), Depth::kPayload);
  EXPECT_EQ(DepthOf(plan, "/b"), Depth::kMetadata);
  EXPECT_EQ(DepthOf(plan, "/x"), Depth::kMetadata);
}

TEST(InterestTest, TopicsThatARuleLeavesOutAreNotNeeded) {
  TestRules rules;
  rules.Inspections(1);
  rules.Msg("flood", And(Not(In({"/tf", "/cam"})), Elsewhere()), {{Alert("x")}});
  EXPECT_THAT(Rows(rules),
              ElementsAre("nothing ^\\/cam$: ", "nothing ^\\/tf$: ", "metadata : flood"));
  rules.Msg("scan", And(And(Matches("^/cam"), Not(In({"/cam/info"}))), Inspect(0)), {{Alert("x")}});
  EXPECT_THAT(Rows(rules), ElementsAre("metadata ^\\/cam\\/info$: flood", "nothing ^\\/tf$: ",
                                       "payload ^/cam: scan", "metadata : flood"));
  EXPECT_EQ(DepthOf(Plan(rules), "/cam"), Depth::kPayload);
  EXPECT_EQ(DepthOf(Plan(rules), "/cam/info"), Depth::kMetadata);
}

TEST(InterestTest, BusyTopicsAreWatchedOnlyIfARuleNamesThem) {
  TestRules rules;
  rules.Msg("all", Elsewhere(), {{Alert("x")}});
  rules.Msg("pattern", Matches("^/ros"), {{Alert("x")}});
  EXPECT_EQ(DepthOf(Plan(rules), "/rosout"), Depth::kNothing);
  EXPECT_EQ(DepthOf(Plan(rules), "/parameter_events"), Depth::kNothing);
  EXPECT_EQ(DepthOf(Plan(rules), "/rosout2"), Depth::kMetadata);

  TestRules naming = rules;
  naming.Msg("names", In({"/rosout"}), {{Alert("x")}});
  EXPECT_EQ(DepthOf(Plan(naming), "/rosout"), Depth::kMetadata);
  EXPECT_EQ(DepthOf(Plan(naming), "/parameter_events"), Depth::kNothing);

  TestRules never = rules;
  never.Msg("never", And(B(false), In({"/rosout"})), {{Alert("x")}});
  EXPECT_EQ(DepthOf(Plan(never), "/rosout"), Depth::kNothing);

  TestRules argument = rules;
  const uint32_t flag = argument.Var("b", ValueType::kBool, false);
  argument.Msg("sets", Elsewhere(), {{Set(flag, In({"/rosout"}))}});
  EXPECT_EQ(DepthOf(Plan(argument), "/rosout"), Depth::kMetadata);
}

TEST(InterestTest, ReasonsAreSortedAndCut) {
  TestRules rules;
  for (size_t i = 0; i <= kWantedByMax; ++i) {
    rules.Msg(absl::StrCat("r", 2'000 - i), Elsewhere(), {{Alert("x")}});
  }
  const InterestPlan plan = Plan(rules);
  EXPECT_THAT(plan.back().wanted_by, testing::SizeIs(kWantedByMax));
  EXPECT_EQ(plan.back().wanted_by.front(), absl::StrCat("r", 2'000 - kWantedByMax));
}

TEST(InterestTest, ConditionsNarrowTheTopics) {
  EXPECT_THAT(Regexes(Inspect(0)), ElementsAre(""));
  EXPECT_THAT(Regexes(And(In({"/a"}), Inspect(0))), ElementsAre("^\\/a$"));
  EXPECT_THAT(Regexes(And(Inspect(0), In({"/b", "/a", "/b"}))), ElementsAre("^\\/a$", "^\\/b$"));
  EXPECT_THAT(Regexes(And(Matches("^/cam"), Inspect(0))), ElementsAre("^/cam"));
  EXPECT_THAT(Regexes(And(And(Matches("b"), In({"/a", "/b"})), Inspect(0))), ElementsAre("^\\/b$"))
      << "names before patterns, and none that the pattern leaves out";
  EXPECT_THAT(Regexes(And(And(In({"/a", "/b"}), In({"/a"})), Inspect(0))), ElementsAre("^\\/a$"));
  EXPECT_THAT(Regexes(Or(And(In({"/a"}), Inspect(0)), Matches("b$"))), ElementsAre("^\\/a$", "b$"));
  EXPECT_THAT(Regexes(And(Elsewhere(), And(Not(Inspect(0)), In({"/a"})))), ElementsAre("^\\/a$"));
}

TEST(InterestTest, WhatCannotBeNarrowedNeedsAllTopics) {
  EXPECT_THAT(Regexes(And(Elsewhere(), Inspect(0))), ElementsAre(""));
  EXPECT_THAT(Regexes(And(Not(In({"/a"})), Inspect(0))), ElementsAre(""));
  EXPECT_THAT(Regexes(Or(In({"/a"}), Inspect(0))), ElementsAre(""));
  EXPECT_THAT(Regexes(And(Call(Builtin::kMsgTypeIn, Texts({"std_msgs"})), Inspect(0))),
              ElementsAre(""));
  EXPECT_THAT(Regexes(And(Op(In({"/a"}), BinaryOp::kEq, B(true)), Inspect(0))), ElementsAre(""));
  EXPECT_THAT(Regexes(And(Call(Builtin::kTopicIn, {S("/a"), V(0)}), Inspect(0))), ElementsAre(""));
}

// Where the topic is false, what stands before it is evaluated and may fault, with the payload.
TEST(InterestTest, ATopicBehindWhatMayFaultDoesNotNarrow) {
  EXPECT_THAT(Regexes(And(And(Inspect(0), Faulty()), In({"/a"}))), ElementsAre(""));
  EXPECT_THAT(Regexes(And(In({"/a"}), And(Inspect(0), Faulty()))), ElementsAre("^\\/a$"));
}

TEST(InterestTest, ArgumentsOfActionsNeedTheTopicsOfTheirRule) {
  TestRules rules;
  const uint32_t flag = rules.Var("b", ValueType::kBool, false);
  rules.Inspections(1).Msg("r", In({"/a"}), {{Alert("x")}, {Set(flag, Inspect(0))}});
  EXPECT_THAT(Regexes(rules), ElementsAre("^\\/a$"));
}

TEST(InterestTest, RulesThatNeverFireNeedNothing) {
  EXPECT_THAT(Regexes(And(B(false), Inspect(0))), IsEmpty());
  EXPECT_THAT(Regexes(And(Inspect(0), In({}))), IsEmpty());
  TestRules rules;
  rules.Inspections(1).Graph("g", Inspect(0), {{Alert("x")}});
  EXPECT_THAT(Regexes(rules), IsEmpty()) << "no message rule";
}

TEST(InterestTest, RulesShareInterests) {
  TestRules rules;
  rules.Inspections(2);
  for (uint32_t i = 0; i < 2; ++i) rules.Msg("r", And(In({"/a"}), Inspect(i)), {{Alert("x")}});
  EXPECT_THAT(Regexes(rules), ElementsAre("^\\/a$"));
  rules.Msg("all", Inspect(0), {{Alert("x")}});
  EXPECT_THAT(Regexes(rules), ElementsAre("")) << "one that holds all others";
}

TEST(InterestTest, NamesAreTakenLiterally) {
  const std::vector<std::string> names = {"/a.b",    "/a+",       "/[a-z]*",
                                          "^/a$|.*", "/a\nb",     "\\E.*\\Q",
                                          "(?i)/a",  "/\xc3\xa9", std::string("/\0x", 3)};
  for (const std::string& name : names) {
    const std::vector<std::string> regexes = Regexes(And(In({name}), Inspect(0)));
    ASSERT_THAT(regexes, testing::SizeIs(1));
    EXPECT_NE(regexes[0], "");
    EXPECT_TRUE(AnyMatches(regexes, name)) << name;
    for (const std::string& other : {name + "x", "x" + name, name + "\n", std::string("/axb")}) {
      EXPECT_FALSE(AnyMatches(regexes, other)) << name << " " << other;
    }
  }
}

TEST(InterestTest, WhatIsNoPatternNeedsAllTopics) {
  EXPECT_THAT(Regexes(And(In({"/\xff"}), Inspect(0))), ElementsAre("")) << "no UTF-8";
  EXPECT_THAT(Regexes(And(Matches("("), Inspect(0))), ElementsAre(""));
}

// The last one.
constexpr size_t kOtherRows = 1;

TEST(InterestTest, PastTheLimitsMoreIsAskedForNotLess) {
  std::vector<std::string> names;
  while (names.size() + kOtherRows < kInterestsMax) {
    names.push_back(absl::StrCat("/", names.size()));
  }
  EXPECT_THAT(Regexes(And(In(names), Inspect(0))), testing::SizeIs(names.size()));
  names.push_back("/one_more");
  EXPECT_THAT(Regexes(And(In(names), Inspect(0))), ElementsAre(""));

  TestRules rules;
  rules.Inspections(1);
  for (int i = 0; i < 30; ++i) {
    rules.Msg("r", And(Matches(absl::StrCat("(abcd|efgh){900}", i)), Inspect(0)), {{Alert("x")}});
  }
  EXPECT_THAT(Regexes(rules), ElementsAre("")) << "few patterns, but large ones";
  EXPECT_EQ(DepthOf(Plan(rules), "/rosout"), Depth::kNothing) << "still";
}

TEST(InterestTest, PastTheLimitsPayloadsAreStillToldApart) {
  std::vector<std::string> names;
  while (names.size() <= kInterestsMax) names.push_back(absl::StrCat("/", names.size()));
  TestRules rules;
  rules.Inspections(1);
  rules.Msg("names", In(names), {{Alert("x")}});
  rules.Msg("scan", And(Or(In({"/a"}), Matches("^/cam")), Inspect(0)), {{Alert("x")}});
  EXPECT_THAT(Rows(rules),
              ElementsAre("payload ^\\/a$: scan", "payload ^/cam: scan", "metadata : names"));
}

TEST(InterestTest, TooManyRulesForTooManyNamesAreNotLookedAtOneByOne) {
  TestRules rules;
  std::vector<std::string> names;
  while (names.size() < 200) names.push_back(absl::StrCat("/", names.size()));
  for (size_t i = 0; i <= kInterestForecastsMax / names.size(); ++i) {
    rules.Msg("r", In(i == 0 ? names : std::vector<std::string>{"/0"}), {{Alert("x")}});
  }
  EXPECT_THAT(Rows(rules), ElementsAre("metadata : r"));
}

// A condition of topics, inspections, faults, and what is known only when the message is there.
class Conditions {
 public:
  explicit Conditions(uint32_t seed) : random_(seed) {}

  size_t Pick(size_t n) { return random_() % n; }
  TypedExpr Next(int depth) {
    switch (depth <= 0 ? Pick(7) : Pick(13)) {
      case 0:
        return B(Pick(2) == 0);
      case 1:
        return In({Topic(), Topic()});
      case 2:
        return In({Topic()});
      case 3:
        return Matches(std::vector<std::string>{"^/a", "b", "b$", "x"}[Pick(4)]);
      case 4:
        return Elsewhere();
      case 5:
        return Pick(4) == 0 ? Faulty() : Inspect(0);
      case 6:
        return Inspect(0);
      case 7:
        return Not(Next(depth - 1));
      case 8:
        return Op(Next(depth - 1), BinaryOp::kEq, Next(depth - 1));
      case 9:
      case 10:
        return Or(Next(depth - 1), Next(depth - 1));
      default:
        return And(Next(depth - 1), Next(depth - 1));
    }
  }
  std::string Topic() { return std::vector<std::string>{"/a", "/b", "/ab", "/c", "/"}[Pick(5)]; }

 private:
  std::mt19937 random_;
};

TEST(InterestTest, NothingThatARuleMayLookAtIsMissing) {
  size_t narrowed = 0;
  size_t nothing = 0;
  for (uint32_t seed = 1; seed <= 3'000; ++seed) {
    Conditions conditions(seed);
    TestRules rules;
    rules.Inspections(1);
    const size_t count = 1 + conditions.Pick(3);
    for (size_t i = 0; i < count; ++i) rules.Msg("r", conditions.Next(4), {{Alert("x")}});
    const InterestPlan plan = Plan(rules);
    const std::shared_ptr<const CompiledPolicy> program = rules.Build();
    TopicVerdicts verdicts;
    const ros2::RosGraph graph;
    for (const std::string topic : {"/a", "/b", "/ab", "/c", "/", "/other"}) {
      const TopicVerdict& verdict = verdicts.For(*program, {.graph = graph, .topic = topic});
      const Depth needed = !verdict.inspecting.empty() ? Depth::kPayload
                           : !verdict.rules.empty()    ? Depth::kMetadata
                                                       : Depth::kNothing;
      EXPECT_GE(DepthOf(plan, topic), needed) << "seed " << seed << ", topic " << topic;
      nothing += DepthOf(plan, topic) == Depth::kNothing;
    }
    if (HasFailure()) return;
    narrowed += plan.back().depth != Depth::kPayload && plan.size() > 1;
  }
  EXPECT_GT(narrowed, 100u) << "the conditions do narrow";
  EXPECT_GT(nothing, 1'000u);
}

}  // namespace
}  // namespace rips::engine
