#include "mode_actuator/steps/system_mode/smh.h"

#include <fstream>
#include <iterator>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ros2::ParameterValue;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::Pair;

constexpr absl::string_view kRobot = R"(safety:
  ros__parameters:
    type: system
    parts: camera ns/motors
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

std::string PaperListing() {
  const std::ifstream file(RIPS_SOURCE_DIR
                           "/mode_actuator/steps/system_mode/testdata/paper_smh.yaml");
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

constexpr const char* kPaperParts[] = {"image_1_to_2",
                                       "imu_1_to_2",
                                       "odom_1_to_2",
                                       "pc2_1_to_2",
                                       "scan_1_to_2",
                                       "tf_1_to_2",
                                       "tf_static_1_to_2",
                                       "twist_2_to_1",
                                       "planner_server",
                                       "filter_mask_server",
                                       "costmap_filter_info_server",
                                       "filter_mask_server_clean",
                                       "costmap_filter_clean"};

TEST(SmhTest, DiagnosesThePapersListing) {
  const absl::Status status = ParseSmh(PaperListing(), "smh.yaml").status();
  EXPECT_TRUE(absl::IsInvalidArgument(status));
  const std::vector<std::string> lines = absl::StrSplit(status.message(), '\n');
  ASSERT_EQ(lines.size(), std::size(kPaperParts) + 1) << status;
  for (const char* part : kPaperParts) {
    EXPECT_THAT(lines, Contains(HasSubstr(absl::StrCat(
                           ": part `/", part,
                           "` (mode `__DEFAULT__` of `/safety`) has no block; the mode manager "
                           "crashes at the first order, add one"))));
  }
  EXPECT_THAT(lines, Contains(HasSubstr("smh.yaml:25:25: part `/planner_server`")));
  EXPECT_EQ(lines.back(),
            "smh.yaml:7:7: `parts` of `/safety` names 8, its `__DEFAULT__` 13, which is what "
            "counts; in one of them only: `/costmap_filter_clean`, `/costmap_filter_info_server`, "
            "`/filter_mask_server`, `/filter_mask_server_clean`, `/planner_server`");
}

// What the mode manager needs beyond the listing.
TEST(SmhTest, ThePapersListingWithBlocksIsReadButForABlockWithoutModes) {
  std::string text = PaperListing();
  for (const char* part : kPaperParts) {
    absl::StrAppend(&text, part, ":\n  ros__parameters:\n    type: node\n");
  }
  EXPECT_THAT(ParseSmh(text, "smh.yaml"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("smh.yaml:72:1: `/image_1_to_2` has no modes; the mode manager "
                                 "crashes at the first order, give it `__DEFAULT__` with a "
                                 "parameter (`use_sim_time: false` if it has none of its own)")));
  const std::string whole = absl::StrReplaceAll(
      text, {{"type: node\n",
              "type: node\n    modes: {__DEFAULT__: {ros__parameters: {use_sim_time: false}}}\n"}});
  const auto smh = ParseSmh(whole, "smh.yaml");
  ASSERT_THAT(smh, IsOk());
  EXPECT_THAT(smh->warnings, ElementsAre(HasSubstr("`parts` of `/safety` names 8")));
  // The level is called otherwise than the mode.
  EXPECT_THAT(
      smh->Expected("/safety", "DEFAULT"),
      StatusIs(absl::StatusCode::kNotFound,
               "system `/safety` has no mode `DEFAULT`; it has `ALERT`, `COMPROMISED`, `HALT`, "
               "`__DEFAULT__`"));
  EXPECT_EQ(smh->systems.at("/safety").places.at("HALT"), "smh.yaml:58:7");
}

TEST(SmhTest, PartsThatAreThoseOfTheModesAreNoWarning) {
  EXPECT_TRUE(
      ParseSmh(Edited("parts: camera ns/motors", "parts: [camera, ns/motors]"))->warnings.empty());
  EXPECT_THAT(ParseSmh(Edited("camera ns/motors", "camera motors"))->warnings,
              ElementsAre(HasSubstr("in one of them only: `/motors`, "
                                    "`/ns/motors`")));
  EXPECT_TRUE(ParseSmh(Edited("    parts: camera ns/motors\n", ""))->warnings.empty());
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
