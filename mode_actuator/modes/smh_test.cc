#include "mode_actuator/modes/smh.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ros2::ParameterValue;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::Pair;

constexpr absl::string_view kRobot = R"(safety:
  ros__parameters:
    type: system
    parts: camera motors
    modes:
      __DEFAULT__:
        camera: active
        ns/motors: active
      ALERT:
        camera: inactive
        ns/motors: active.SLOW
      HALT: {camera: inactive, ns/motors: inactive.SLOW}
camera:
  ros__parameters:
    type: node
    modes:
      __DEFAULT__: {ros__parameters: {use_sim_time: false}}
ns:
  motors:
    ros__parameters:
      type: node
      modes:
        __DEFAULT__: {ros__parameters: {limits: {speed: 1.0, gear: 2}, name: "1", on: yes}}
        SLOW: {ros__parameters: {limits: {speed: 0.2}}}
)";

std::string Edited(absl::string_view from, absl::string_view to) {
  const std::string text = absl::StrReplaceAll(kRobot, {{from, to}});
  EXPECT_NE(text, kRobot) << "nothing to replace: " << from;
  return text;
}

TEST(SmhTest, ReadsSystemsNodesAndInheritance) {
  const absl::StatusOr<Smh> smh = ParseSmh(kRobot);
  ASSERT_THAT(smh, IsOk());

  EXPECT_THAT(smh->systems.at("/safety").parts, ElementsAre("/camera", "/ns/motors"));
  EXPECT_EQ(smh->systems.at("/safety").modes.at("ALERT").at("/ns/motors"),
            (PartTarget{PartState::kActive, "SLOW"}));
  EXPECT_THAT(smh->nodes.at("/ns/motors").modes.at("SLOW"),
              ElementsAre(Pair("limits.gear", ParameterValue(int64_t{2})),
                          Pair("limits.speed", ParameterValue(0.2)),
                          Pair("name", ParameterValue(std::string("1"))),
                          Pair("on", ParameterValue(true))));
  EXPECT_TRUE(smh->warnings.empty());
}

TEST(SmhTest, ExpectsOfEachNodeAStateAndItsParameters) {
  const absl::StatusOr<Smh> smh = ParseSmh(kRobot);
  ASSERT_THAT(smh, IsOk());

  const auto alert = smh->Expected("/safety", "ALERT");

  ASSERT_THAT(alert, IsOk());
  ASSERT_EQ(alert->size(), 2u);
  EXPECT_EQ((*alert)[0].node, "/camera");
  EXPECT_EQ((*alert)[0].state, PartState::kInactive);
  EXPECT_TRUE((*alert)[0].parameters.empty());
  EXPECT_EQ((*alert)[1].node, "/ns/motors");
  EXPECT_EQ((*alert)[1].state, PartState::kActive);
  EXPECT_EQ((*alert)[1].parameters.at("limits.speed"), ParameterValue(0.2));
  EXPECT_EQ(smh->Expected("safety", "__DEFAULT__")->at(0).state, PartState::kActive);
  EXPECT_THAT(smh->Expected("/safety", "alert"), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(smh->Expected("/nothing", "ALERT"), StatusIs(absl::StatusCode::kNotFound));
}

TEST(SmhTest, APartLeftOutInheritsTheDefault) {
  const auto smh = ParseSmh(Edited("        camera: inactive\n", ""));
  ASSERT_THAT(smh, IsOk());
  EXPECT_EQ(smh->systems.at("/safety").modes.at("ALERT").at("/camera").state, PartState::kActive);
}

TEST(SmhTest, SystemsNest) {
  const std::string text = absl::StrCat(kRobot, R"(top:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {safety: active}
      QUIET: {safety: active.HALT}
      OFF: {safety: inactive}
)");
  const auto smh = ParseSmh(text);
  ASSERT_THAT(smh, IsOk());
  for (const char* mode : {"QUIET", "OFF"}) {
    const auto expected = smh->Expected("/top", mode);
    ASSERT_THAT(expected, IsOk());
    ASSERT_EQ(expected->size(), 2u);
    for (const ExpectedPart& part : *expected) EXPECT_EQ(part.state, PartState::kInactive) << mode;
  }
}

// The shape of the listing in the RIPS paper's section on System Modes: names under `parts:`, four
// modes, and no block for any part.
TEST(SmhTest, DiagnosesAListingWithoutBlocksForItsParts) {
  constexpr absl::string_view kListing = R"(safety:
  ros__parameters:
    type: system
    parts:
      image_bridge
      twist_bridge
    modes:
      __DEFAULT__:
        image_bridge: active
        twist_bridge: active
        planner: active
      ALERT:
        image_bridge: inactive
        twist_bridge: active
        planner: active
      HALT:
        image_bridge: inactive
        twist_bridge: inactive
        planner: active
)";
  EXPECT_THAT(ParseSmh(kListing, "smh.yaml"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "smh.yaml:9:23: part `/image_bridge` (mode `__DEFAULT__` of `/safety`) has "
                       "no block; the mode manager crashes at the first order, add one\n"
                       "smh.yaml:11:18: part `/planner` (mode `__DEFAULT__` of `/safety`) has no "
                       "block; the mode manager crashes at the first order, add one\n"
                       "smh.yaml:10:23: part `/twist_bridge` (mode `__DEFAULT__` of `/safety`) has "
                       "no block; the mode manager crashes at the first order, add one"));
}

TEST(SmhTest, DiagnosesAPartWithATypeAndNothingElse) {
  EXPECT_THAT(
      ParseSmh(Edited("    modes:\n      __DEFAULT__: {ros__parameters: {use_sim_time: "
                      "false}}\n",
                      "")),
      StatusIs(absl::StatusCode::kInvalidArgument,
               AllOf(HasSubstr("smh.yaml:13:1: `/camera` has no modes"), Not(HasSubstr("\n")))));
}

TEST(SmhTest, DiagnosesEachMistakeWhereItIs) {
  const struct {
    const char* from;
    const char* to;
    const char* message;
  } kCases[] = {
      {"camera: inactive\n", "camera: INACTIVE\n", "10:17: state of `camera` must be"},
      {"camera: inactive\n", "camera: active.\n", "10:17: state of `camera` must be"},
      {"active.SLOW", "active.FAST", "11:20: part `/ns/motors` has no mode `FAST`"},
      {"        camera: inactive\n", "        lidar: inactive\n", "10:16: part `/lidar` (mode"},
      {"{use_sim_time: false}", "{}", "17:7: mode `__DEFAULT__` of node `/camera` has no param"},
      {"{limits: {speed: 0.2}}", "{limit: 0.2}", "parameter `limit` of mode `SLOW` is not in"},
      {"      ALERT:", "      __DEFAULT__:", "9:7: duplicate key `__DEFAULT__`"},
      {"    type: node", "    type: Node", "15:11: `type` of `/camera` must be"},
      {"    type: node\n", "", "13:1: `type` of `/camera` must be"},
      {"camera: active\n", "safety: active\n", "system `/safety` contains itself: /safety"},
      {"use_sim_time: false", "use_sim_time: [1, 2]", "parameter `use_sim_time` must be"},
      {"safety:\n", "safety: [\n", "smh.yaml:3:9: end of sequence"},
      {"\nns:\n", "\ncamera/:\n  ros__parameters: {}\nns:\n", "part `/camera` has two blocks"},
  };
  for (const auto& test : kCases) {
    EXPECT_THAT(ParseSmh(Edited(test.from, test.to)),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << test.to;
  }
}

TEST(SmhTest, DefaultMustComeFirst) {
  EXPECT_THAT(ParseSmh(Edited("      __DEFAULT__:\n        camera: active",
                              "      NORMAL:\n        camera: active")),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("6:7: the first mode of `/safety` must be `__DEFAULT__`")));
}

TEST(SmhTest, ChecksRulesAndWarnsOfThem) {
  const auto with_rules = [](absl::string_view rules) {
    return Edited("\ncamera:\n  ros", absl::StrCat("\n    rules:\n", rules, "camera:\n  ros"));
  };
  const auto legal = ParseSmh(with_rules(
      "      weak: {if_target: active.ALERT, if_part: [camera, inactive], new_target: active}\n"));
  ASSERT_THAT(legal, IsOk());
  EXPECT_THAT(legal->warnings, ElementsAre(HasSubstr("14:7: rule `weak` of `/safety`")));

  for (const char* rule : {
           "      weak: {if_target: active.ALERT, if_part: [camera, inactive]}\n",
           "      weak: {if_target: active.GONE, if_part: [camera, inactive], new_target: "
           "active}\n",
           "      weak: {if_target: active, if_part: [lidar, inactive], new_target: active}\n",
           "      weak: {if_target: active, if_part: [camera, active.X], new_target: active}\n",
           "      weak: {if_target: active, if_part: camera, new_target: active}\n",
           "      weak: 3\n",
       }) {
    EXPECT_THAT(ParseSmh(with_rules(rule)), StatusIs(absl::StatusCode::kInvalidArgument)) << rule;
  }
}

TEST(SmhTest, EveryPrefixIsReadOrRefusedWithoutHarm) {
  for (size_t length = 0; length < kRobot.size(); ++length) {
    const auto smh = ParseSmh(kRobot.substr(0, length));
    if (smh.ok()) {
      // A cut between two values can leave a smaller file that is whole.
      EXPECT_THAT(smh->Expected("/safety", "__DEFAULT__"), IsOk()) << length;
    }
  }
}

TEST(SmhTest, HasLimits) {
  EXPECT_THAT(ParseSmh(std::string(kSmhBytesMax + 1, ' ')),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("limit 1048576")));

  std::string bomb = "a0: &a0 {k: 1}\n";
  for (int i = 1; i < 12; ++i) {
    absl::StrAppend(&bomb, "a", i, ": &a", i, " {");
    for (int k = 0; k < 10; ++k) absl::StrAppend(&bomb, "k", k, ": *a", i - 1, ", ");
    absl::StrAppend(&bomb, "}\n");
  }
  EXPECT_THAT(ParseSmh(bomb), StatusIs(absl::StatusCode::kInvalidArgument));

  std::string many;
  for (size_t i = 0; i < 2 * kSmhProblemsMax; ++i) absl::StrAppend(&many, "part", i, ": 3\n");
  EXPECT_THAT(ParseSmh(many),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("more problems not shown")));

  EXPECT_THAT(ParseSmh(std::string(5'000, '[')), StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::actuator
