// Random rules on random traffic: what they do is the same whether they are given every message or
// only what the plan of interest asks for.
#include <random>
#include <string>
#include <variant>
#include <vector>

#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/interest/interest.h"
#include "policy_server/policy/engine/test_rules.h"
#include "re2/re2.h"
#include "services/base/test_rounds.h"

namespace rips::engine {
namespace {

constexpr uint32_t kCounter = 0;
constexpr uint32_t kFlag = 1;
constexpr const char* kTopics[] = {"/a", "/b", "/cam/a", "/cam/b", "/other"};
constexpr size_t kInspections = 2;

class Generator {
 public:
  explicit Generator(uint32_t seed) : random_(seed) {}
  size_t Pick(size_t n) { return random_() % n; }

  TestRules Rules() {
    TestRules rules;
    rules.Inspections(kInspections);
    rules.IntVar("counter", 0);
    rules.Var("flag", ValueType::kBool, false);
    const size_t count = 1 + Pick(6);
    for (size_t i = 0; i < count; ++i) {
      const size_t section = Pick(6);
      const std::string name = absl::StrCat("r", i);
      if (section == 0) {
        rules.Graph(name, Anywhere(2), Chains(false));
      } else if (section == 1) {
        rules.Tick(name, Anywhere(2), Chains(false));
      } else {
        rules.Msg(name, Message(3), Chains(true));
      }
    }
    return rules;
  }

 private:
  // Of any event.
  TypedExpr Anywhere(int depth) {
    switch (depth <= 0 ? Pick(3) : Pick(6)) {
      case 0:
        return V(kFlag);
      case 1:
        return Op(V(kCounter), BinaryOp::kLt, I(static_cast<int64_t>(Pick(6))));
      case 2:
        return Op(Name(Predefined::kCurrLevel), BinaryOp::kEq, L(static_cast<int64_t>(Pick(4))));
      case 3:
        return Not(Anywhere(depth - 1));
      case 4:
        return And(Anywhere(depth - 1), Anywhere(depth - 1));
      default:
        return Or(Anywhere(depth - 1), Anywhere(depth - 1));
    }
  }
  TypedExpr Message(int depth) {
    if (depth > 0 && Pick(3) > 0) {
      switch (Pick(8)) {
        case 0:
          return Not(Message(depth - 1));
        case 1:
        case 2:
          return Or(Message(depth - 1), Message(depth - 1));
        default:
          return And(Message(depth - 1), Message(depth - 1));
      }
    }
    switch (Pick(12)) {
      case 0:
        return Inspect(static_cast<uint32_t>(Pick(kInspections)));
      case 1:
        return Call(Builtin::kMsgCount, Window());
      case 2:
        return Call(Builtin::kSenderCount, Window());
      case 3:
        return Anywhere(1);
      case 4:
        // Faults while the counter is 0.
        return Op(Op(I(1), BinaryOp::kDiv, V(kCounter)), BinaryOp::kGe, I(0));
      case 5:
        return Call(Builtin::kMsgTypeIn, Texts({"std_msgs"}));
      case 6:
      case 7:
        return Call(Builtin::kTopicMatches, Texts({Pattern()}));
      default:
        return Call(Builtin::kTopicIn, Texts({kTopics[Pick(5)], kTopics[Pick(5)]}));
    }
  }
  Exprs Window() {
    return {I(1'000), I(static_cast<int64_t>(1 + Pick(4))), I(static_cast<int64_t>(2 + Pick(9)))};
  }
  std::string Pattern() { return std::vector<std::string>{"^/cam", "a$", "b", "^/x"}[Pick(4)]; }

  std::vector<TypedChain> Chains(bool message) {
    std::vector<TypedChain> chains;
    for (size_t i = 0; i <= Pick(2); ++i) {
      TypedChain chain;
      const size_t size = 1 + Pick(2);
      for (size_t j = 0; j < size; ++j) {
        chain.push_back(Action(message) >> (j + 1 == size ? Connector::kEnd : kAnyway));
      }
      chains.push_back(std::move(chain));
    }
    return chains;
  }
  TypedAction Action(bool message) {
    switch (Pick(5)) {
      case 0:
        return Alert(Text(V(kCounter)));
      case 1:
        return Set(kCounter, Op(Op(V(kCounter), BinaryOp::kAdd, I(1)), BinaryOp::kMod, I(7)));
      case 2:
        return Set(kFlag, message ? Message(1) : Anywhere(1));
      case 3:
        return message ? Alert(Concat(Name(Predefined::kTopic), Name(Predefined::kSender)))
                       : Alert("x");
      default:
        return Trigger(static_cast<int64_t>(Pick(4)));
    }
  }

  std::mt19937 random_;
};

Depth DepthOf(const InterestPlan& plan, const std::string& topic) {
  for (const TopicInterest& row : plan) {
    if (RE2::PartialMatch(topic, row.topic_regex)) return row.depth;
  }
  return Depth::kNothing;
}

struct Played {
  std::vector<std::string> log;
  absl::btree_map<std::string, lang::Value> variables;
  size_t left_out = 0;
  size_t without_payload = 0;
};

// One message. Its payload, what inspections say of it, is drawn in any case.
Outcome Judge(Generator& generator, Depth depth, const std::string& topic, TestRobot& robot) {
  std::vector<Verdict> verdicts;
  for (size_t i = 0; i < kInspections; ++i) {
    verdicts.push_back(generator.Pick(3) == 0 ? Verdict::kYes : Verdict::kNo);
  }
  const size_t writer = 1 + generator.Pick(3);
  if (depth == Depth::kNothing) return {};
  ros2::Guid guid;
  guid.bytes[0] = static_cast<uint8_t>(writer);
  MessageEvent message{.topic = topic,
                       .type = "std_msgs/msg/String",
                       .writer = guid,
                       .sender = writer == 1 ? "/one" : "/two"};
  if (depth == Depth::kPayload) message.inspections = verdicts;
  return robot.Judge(message);
}

Played Play(uint32_t seed, bool push_down) {
  Generator generator(seed);
  const TestRules rules = generator.Rules();
  const InterestPlan plan = PlanInterest(rules.rules, 100);
  TestRobot robot(rules);
  Played played;
  for (int step = 0; step < 150; ++step) {
    robot.Advance(static_cast<int64_t>(generator.Pick(300)) * kNanosPerMilli);
    Outcome outcome;
    const size_t what = generator.Pick(10);
    if (what == 0) {
      outcome = robot.Tick();
    } else if (what == 1) {
      outcome = robot.Graph();
    } else if (what == 2) {
      robot.state.actuation = static_cast<Actuation>(generator.Pick(4));
      outcome = OnActuation(robot.now, robot.state);
    } else {
      const std::string topic = kTopics[generator.Pick(5)];
      const Depth wanted = DepthOf(plan, topic);
      played.left_out += wanted == Depth::kNothing;
      played.without_payload += wanted == Depth::kMetadata;
      outcome = Judge(generator, push_down ? wanted : Depth::kPayload, topic, robot);
    }
    played.log.push_back(absl::StrCat(step, " ", robot.state.level.level(), " ", outcome.fired, " ",
                                      outcome.faults, " ", outcome.unscanned, " ",
                                      absl::StrJoin(Lines(outcome, robot.state), "; ")));
  }
  played.variables = robot.state.Variables();
  return played;
}

TEST(PushdownTest, RulesDoTheSameWithAndWithoutIt) {
  size_t left_out = 0;
  size_t without_payload = 0;
  size_t alerts = 0;
  for (uint32_t seed = 1; seed <= Rounds(1'000u); ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const Played all = Play(seed, false);
    const Played wanted = Play(seed, true);
    ASSERT_EQ(wanted.log, all.log);
    ASSERT_EQ(wanted.variables, all.variables);
    left_out += wanted.left_out;
    without_payload += wanted.without_payload;
    for (const std::string& line : all.log) alerts += line.find("alert") != std::string::npos;
  }
  EXPECT_GT(left_out, Rounds(3'000u)) << "messages are left out";
  EXPECT_GT(without_payload, Rounds(3'000u));
  EXPECT_GT(alerts, Rounds(3'000u)) << "the rules do something";
}

}  // namespace
}  // namespace rips::engine
