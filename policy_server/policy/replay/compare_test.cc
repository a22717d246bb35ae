#include "policy_server/policy/replay/compare.h"

#include <limits>

#include "policy_server/policy/replay/replay_test_data.h"
#include "policy_server/policy/replay/result_json.h"

namespace rips::replay {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

TEST(CompareTest, TheSameRulesDoTheSame) {
  const auto program = MakeProgram("rules External: r: true ? alert(\"a\"), exec(\"p\");");
  const std::vector<Recorded> events = {Signal(), Signal()};

  const Difference difference = Compare(Replayed(program, events), Replayed(program, events));

  EXPECT_TRUE(difference.none());
  EXPECT_FALSE(difference.first.has_value());
  EXPECT_EQ(ToJson(difference)["same"], true);
  EXPECT_EQ(ToJson(difference)["first_difference"], nullptr);
}

TEST(CompareTest, NamesAndOrderOfRulesAreNoDifference) {
  const std::vector<Recorded> events = {Signal(), Signal()};
  const Result a = Replayed(
      MakeProgram("rules External: x: true ? alert(\"1\"); y: true ? alert(\"2\");"), events);
  const Result b = Replayed(
      MakeProgram("rules External: v: true ? alert(\"2\"); w: true ? alert(\"1\");"), events);

  EXPECT_TRUE(Compare(a, b).none());
}

TEST(CompareTest, ShowsWhatOnlyOneDoes) {
  const std::vector<Recorded> events = {Message("/t"), Signal(), Signal()};
  const Result before = Replayed(MakeProgram(R"(
    rules Msg: m: true ? alert("seen"), exec("p", "x");
    rules External: e: CurrLevel < C ? trigger(C);
  )"),
                                 events);
  const Result after = Replayed(MakeProgram(R"(
    rules Msg: m: true ? alert("seen"), alert("seen"), exec("p", "y");
    rules External: e: CurrLevel < B ? trigger(B);
  )"),
                                events);

  const Difference difference = Compare(before, after);

  ASSERT_TRUE(difference.first.has_value());
  EXPECT_EQ(difference.first->event, 0u);
  EXPECT_THAT(difference.alerts.before, IsEmpty());
  EXPECT_EQ(difference.alerts.after.size(), 1u);
  EXPECT_EQ(difference.execs.before[0].args, std::vector<std::string>{"x"});
  EXPECT_EQ(difference.execs.after[0].args, std::vector<std::string>{"y"});
  EXPECT_EQ(difference.transitions.before[0].to, "C");
  EXPECT_EQ(difference.transitions.after[0].to, "B");
  EXPECT_EQ(difference.level_before, "C");
  EXPECT_EQ(difference.level_after, "B");
  EXPECT_EQ(ToJson(difference)["alerts"].dump(),
            R"({"before":[],"after":[{"event":0,"rule":"m","text":"seen","severity":"medium"}]})");
}

TEST(CompareTest, TheFirstDifferenceIsTheEarliestOfAnyKind) {
  Result before;
  before.alerts = {{.at = {.event = 7}, .text = "late"}};
  before.execs = {{.at = {.event = 5}, .program = "p"}};
  Result after;
  after.transitions = {{.at = {.event = 6}, .from = "A", .to = "B"}};

  EXPECT_EQ(Compare(before, after).first->event, 5u);
  EXPECT_EQ(Compare(after, before).first->event, 5u);
}

TEST(CompareTest, VariablesAtTheEndAreCompared) {
  Result before;
  before.variables = {{"same", int64_t{1}},
                      {"other", int64_t{1}},
                      {"gone", true},
                      {"nan", std::numeric_limits<double>::quiet_NaN()},
                      {"type", int64_t{1}}};
  Result after = before;
  EXPECT_TRUE(Compare(before, after).none());

  after.variables.erase("gone");
  after.variables["other"] = int64_t{2};
  after.variables["new"] = std::string("x");
  after.variables["type"] = std::string("1");
  const Difference difference = Compare(before, after);

  EXPECT_FALSE(difference.none());
  EXPECT_FALSE(difference.first.has_value());
  EXPECT_EQ(ToJson(difference)["variables"].dump(), R"({"before":{"gone":true,"other":1,"type":1},)"
                                                    R"("after":{"new":"x","other":2,"type":"1"}})");
  EXPECT_EQ(ToJson(difference)["same"], false);
}

TEST(CompareTest, SaysThatListsWereCut) {
  Result cut;
  cut.left_out = 1;
  EXPECT_EQ(ToJson(Compare(Result(), cut))["left_out"], true);
  EXPECT_EQ(ToJson(Compare(cut, Result()))["left_out"], true);
  EXPECT_FALSE(ToJson(Compare(Result(), Result())).contains("left_out"));
}

TEST(CompareTest, TheLevelAtTheEndAloneIsADifference) {
  Result before;
  before.level = "A";
  Result after;
  after.level = "B";
  EXPECT_FALSE(Compare(before, after).none());
}

}  // namespace
}  // namespace rips::replay
