#include "policy_server/engine/interest.h"

#include <random>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/engine/test_rules.h"
#include "policy_server/engine/topic_verdicts.h"
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

std::vector<std::string> Regexes(const TestRules& rules) {
  std::vector<std::string> regexes;
  for (const TopicInterest& each : PayloadInterest(rules.rules, kBytes)) {
    EXPECT_EQ(each.payload_bytes_max, kBytes);
    regexes.push_back(each.topic_regex);
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

TEST(InterestTest, RulesThatDoNotInspectNeedNothing) {
  EXPECT_THAT(Regexes(In({"/a"})), IsEmpty());
  EXPECT_THAT(Regexes(TestRules()), IsEmpty());
}

TEST(InterestTest, ConditionsNarrowTheTopics) {
  EXPECT_THAT(Regexes(Inspect(0)), ElementsAre(""));
  EXPECT_THAT(Regexes(And(In({"/a"}), Inspect(0))), ElementsAre("^\\/a$"));
  EXPECT_THAT(Regexes(And(Inspect(0), In({"/b", "/a", "/b"}))), ElementsAre("^\\/a$", "^\\/b$"));
  EXPECT_THAT(Regexes(And(Matches("^/cam"), Inspect(0))), ElementsAre("^/cam"));
  EXPECT_THAT(Regexes(And(And(Matches("x"), In({"/a", "/b"})), Inspect(0))),
              ElementsAre("^\\/a$", "^\\/b$"))
      << "names before patterns";
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

TEST(InterestTest, PastTheLimitsAllTopicsAreNeeded) {
  std::vector<std::string> names;
  for (size_t i = 0; i < kInterestsMax; ++i) names.push_back(absl::StrCat("/", i));
  EXPECT_THAT(Regexes(And(In(names), Inspect(0))), testing::SizeIs(kInterestsMax));
  names.push_back("/one_more");
  EXPECT_THAT(Regexes(And(In(names), Inspect(0))), ElementsAre(""));

  TestRules rules;
  rules.Inspections(1);
  for (int i = 0; i < 30; ++i) {
    rules.Msg("r", And(Matches(absl::StrCat("(abcd|efgh){900}", i)), Inspect(0)), {{Alert("x")}});
  }
  EXPECT_THAT(Regexes(rules), ElementsAre("")) << "few patterns, but large ones";
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

TEST(InterestTest, NoTopicOfARuleThatInspectsIsMissing) {
  size_t narrowed = 0;
  for (uint32_t seed = 1; seed <= 3'000; ++seed) {
    Conditions conditions(seed);
    TestRules rules;
    rules.Inspections(1);
    const size_t count = 1 + conditions.Pick(3);
    for (size_t i = 0; i < count; ++i) rules.Msg("r", conditions.Next(4), {{Alert("x")}});
    const std::vector<std::string> regexes = Regexes(rules);
    const std::shared_ptr<const Program> program = rules.Build();
    TopicVerdicts verdicts;
    const ros2::RosGraph graph;
    for (const std::string topic : {"/a", "/b", "/ab", "/c", "/", "/other"}) {
      const TopicVerdict& verdict = verdicts.For(*program, {.graph = graph, .topic = topic});
      if (verdict.inspecting.empty()) continue;
      EXPECT_TRUE(AnyMatches(regexes, topic)) << "seed " << seed << ", topic " << topic;
    }
    if (HasFailure()) return;
    narrowed += !regexes.empty() && regexes[0] != "";
  }
  EXPECT_GT(narrowed, 100u) << "the conditions do narrow";
}

}  // namespace
}  // namespace rips::engine
