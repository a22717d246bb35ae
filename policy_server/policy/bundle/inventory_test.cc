#include "policy_server/policy/bundle/inventory.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::bundle {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pair;
using ::testing::SizeIs;

TEST(InventoryTest, ReadsRobotsAndFindsThem) {
  const auto inventory = ParseInventory("robots.yaml", R"(robots:
  - {id: r2, bundle: warehouse, sensors: [{host: base, primary: true}]}
  - {id: r1, bundle: warehouse, sensors: [{host: base, primary: true}, {host: laptop}],
     actuators: [base, laptop]}
)");
  ASSERT_THAT(inventory, IsOk());
  ASSERT_THAT(inventory->robots, SizeIs(2));
  ASSERT_NE(inventory->Find("r1"), nullptr);
  EXPECT_EQ(*inventory->Find("r1"), (InventoryRobot{.id = "r1",
                                                    .bundle = "warehouse",
                                                    .sensors = {{"base", true}, {"laptop", false}},
                                                    .actuators = {"base", "laptop"}}));
  EXPECT_EQ(inventory->Find("r2")->actuators.size(), 0u);
  EXPECT_EQ(inventory->Find("r"), nullptr);
  EXPECT_EQ(inventory->Find("r3"), nullptr);
  EXPECT_EQ(inventory->Find(""), nullptr);
}

TEST(InventoryTest, MayBoundARobotsGraph) {
  const auto inventory = ParseInventory("robots.yaml", R"(robots:
  - {id: r1, bundle: b, sensors: [{host: base, primary: true}],
     graph_limits: {topics: 1, participants: 2, nodes: 3, endpoints: 4, nodes_per_participant: 5,
                    endpoints_per_participant: 6}}
  - {id: r2, bundle: b, sensors: [{host: base, primary: true}]}
)");
  ASSERT_THAT(inventory, IsOk());
  EXPECT_EQ(inventory->Find("r1")->graph_limits, (ros2::GraphLimits{.topics = 1,
                                                                    .nodes = 3,
                                                                    .endpoints = 4,
                                                                    .participants = 2,
                                                                    .endpoints_per_participant = 6,
                                                                    .nodes_per_participant = 5}));
  EXPECT_EQ(inventory->Find("r2")->graph_limits, ros2::GraphLimits());
}

TEST(InventoryTest, RobotsMayHaveLabels) {
  const auto inventory = ParseInventory("robots.yaml", R"(robots:
  - {id: r1, bundle: b, sensors: [{host: base, primary: true}],
     labels: {site: hall-1, ring: canary, floor: 2}}
  - {id: r2, bundle: b, sensors: [{host: base, primary: true}], labels: {}}
)");
  ASSERT_THAT(inventory, IsOk());
  const InventoryRobot& robot = *inventory->Find("r1");
  EXPECT_THAT(robot.labels,
              ElementsAre(Pair("floor", "2"), Pair("ring", "canary"), Pair("site", "hall-1")));
  EXPECT_TRUE(robot.HasLabel("ring=canary"));
  EXPECT_TRUE(robot.HasLabel("floor=2"));
  for (const char* label :
       {"", "=", "ring", "ring=", "ring=canar", "ring=canary ", "ring=hall-1", "site=canary",
        "=canary", "rin=canary", "ring==canary", "Ring=canary"}) {
    EXPECT_FALSE(robot.HasLabel(label)) << label;
  }
  EXPECT_THAT(inventory->Find("r2")->labels, SizeIs(0));
  EXPECT_FALSE(inventory->Find("r2")->HasLabel("ring=canary"));
}

TEST(InventoryTest, TellsOfEachRobotWhatIsInForceAndWhichLineSaysIt) {
  auto inventory = ParseInventory("robots.yaml", R"(bundles:
  - labels: {ring: canary}
    bundle: trial
robots:
  - id: r2
    labels: {ring: canary}
    sensors: [{host: base, primary: true}]
  - {id: r1, bundle: warehouse, sensors: [{host: base, primary: true}], graph_limits: {nodes: 8}}
)");
  ASSERT_THAT(inventory, IsOk());
  ASSERT_THAT(AssignByLabels(*inventory), IsOk());
  const auto of = [&](const std::string& robot, const std::string& path) {
    for (const ConfigSetting& each : inventory->settings[robot]) {
      if (each.path == path) return each;
    }
    return ConfigSetting();
  };
  EXPECT_EQ(of("r2", "id"), (ConfigSetting{"id", "\"r2\"", "robots.yaml:5"}));
  EXPECT_EQ(of("r2", "labels.ring"), (ConfigSetting{"labels.ring", "\"canary\"", "robots.yaml:6"}));
  EXPECT_EQ(of("r2", "sensors[0].primary"),
            (ConfigSetting{"sensors[0].primary", "true", "robots.yaml:7"}));
  EXPECT_EQ(of("r2", "bundle"), (ConfigSetting{"bundle", "\"trial\"", "robots.yaml:3"}))
      << "by its label";
  EXPECT_EQ(of("r1", "bundle"), (ConfigSetting{"bundle", "\"warehouse\"", "robots.yaml:8"}));
  EXPECT_EQ(of("r1", "graph_limits.nodes"),
            (ConfigSetting{"graph_limits.nodes", "8", "robots.yaml:8"}));
  EXPECT_EQ(of("r1", "graph_limits.topics").source, "") << "a default";
  EXPECT_NE(of("r1", "graph_limits.topics").value, "");
}

constexpr char kSensorSettings[] = R"(sensor_settings:
  - labels: {site: hall-1}
    set: {settle: 3s, outbox: {memory: 8MiB}}
  - labels: {site: hall-1, ring: canary}
    set: {settle: 4s, unwatched: [/rosout, /camera]}
  - set: {signals: false}
robots:
  - {id: r1, bundle: b, labels: {site: hall-1, ring: canary}, sensors: [{host: h, primary: true}]}
  - {id: r2, bundle: b, sensors: [{host: h, primary: true}]}
)";

TEST(InventoryTest, RobotsHaveTheSensorSettingsOfTheirLabels) {
  auto inventory = ParseInventory("robots.yaml", kSensorSettings);
  ASSERT_THAT(inventory, IsOk());
  ASSERT_THAT(AssignByLabels(*inventory), IsOk());
  EXPECT_THAT(inventory->Find("r1")->sensor_settings,
              ElementsAre(ConfigSetting{"settle", "3s", "robots.yaml:3"},
                          ConfigSetting{"outbox.memory", "8MiB", "robots.yaml:3"},
                          ConfigSetting{"unwatched", R"(["/rosout", "/camera"])", "robots.yaml:5"},
                          ConfigSetting{"signals", "false", "robots.yaml:6"}))
      << "of two that set `settle`, the first";
  EXPECT_THAT(inventory->Find("r2")->sensor_settings,
              ElementsAre(ConfigSetting{"signals", "false", "robots.yaml:6"}));
  EXPECT_THAT(inventory->settings["r2"], testing::Contains(ConfigSetting{
                                             "sensor_settings.signals", "false", "robots.yaml:6"}));
}

TEST(InventoryTest, SensorSettingsThatASensorWouldRefuseAreRefusedHere) {
  const std::pair<const char*, const char*> cases[] = {
      {"settle: 1h", "`settle` is 1h; it must be from 0s to 10s"},
      {"settel: 3s", "unknown key `settel`; did you mean `settle`"},
      {"servers: [a:1]", "unknown key `servers`"},
      {"outbox: {dir: /tmp}", "unknown key `dir`"},
      {"outbox: {disk: 1MiB}", "a spool needs at least 16MiB"},
      {"unwatched: [\"not a topic\"]", "not a topic"},
      {"graph_limits: {topics: 9}", "unknown key `topics`"},
      {"", "`set` is empty"}};
  for (const auto& [set, message] : cases) {
    EXPECT_THAT(
        ParseInventory("robots.yaml", absl::StrCat("sensor_settings: [{set: {", set, "}}]")),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(message)))
        << set;
  }
  EXPECT_THAT(ParseInventory("robots.yaml", "sensor_settings: [{labels: {a: b}}]"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("missing key")));
}

TEST(InventoryTest, SensorSettingsOfNoRobotAreAWarning) {
  auto inventory = ParseInventory(
      "robots.yaml",
      absl::StrReplaceAll(kSensorSettings, {{"canary}\n    set", "canari}\n    set"}}));
  ASSERT_THAT(inventory, IsOk());
  ASSERT_THAT(AssignByLabels(*inventory), IsOk());
  EXPECT_THAT(inventory->warnings,
              ElementsAre("robots.yaml:5: no robot has the labels of this entry of "
                          "`sensor_settings`"));
}

TEST(InventoryTest, SensorSettingsFitIntoWhatASensorIsSent) {
  std::string topics;
  for (int i = 0; i < 200; ++i) absl::StrAppend(&topics, "/topic_", i, ", ");
  EXPECT_THAT(ParseInventory("robots.yaml",
                             absl::StrCat("sensor_settings: [{set: {unwatched: [", topics, "]}}]")),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("`unwatched` has 2690 bytes; at most 1024")));

  auto inventory = ParseInventory(std::string(5'000, 'f'), kSensorSettings);
  ASSERT_THAT(inventory, IsOk());
  EXPECT_THAT(AssignByLabels(*inventory),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("`sensor_settings` of robot `r1` have")));
}

TEST(InventoryTest, ALabelIsKeyAndValue) {
  const auto label = ParseLabel("ring=canary");
  ASSERT_THAT(label, IsOk());
  EXPECT_THAT(*label, Pair("ring", "canary"));
  const std::pair<std::string, std::string> cases[] = {
      {"", "`` is not a label; write KEY=VALUE, for example `ring=canary`"},
      {"ring", "`ring` is not a label"},
      {"ring:canary", "`ring:canary` is not a label"},
      {"\x1b[2J", "`\\x1b[2J` is not a label"},
      {"=", "`` is not a valid label"},
      {"=canary", "`` is not a valid label"},
      {"ring=", "`` is not a valid value of a label"},
      {"Ring=canary", "`Ring` is not a valid label"},
      {"ring=a=b", "`a=b` is not a valid value of a label"},
      {"ring= canary", "` canary` is not a valid value of a label"},
      {"ring=-canary", "`-canary` is not a valid value"},
      {absl::StrCat("ring=", std::string(64, 'x')), "is not a valid value of a label; use 1 to 63"},
      {absl::StrCat(std::string(64, 'x'), "=canary"), "is not a valid label"},
  };
  for (const auto& [text, message] : cases) {
    EXPECT_THAT(ParseLabel(text), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(message)))
        << text;
  }
  const std::string longest(63, 'x');
  EXPECT_THAT(ParseLabel(absl::StrCat(longest, "=", longest)), IsOk());
}

TEST(InventoryTest, HasALimitOfLabels) {
  std::string labels = "a: b";
  for (size_t i = 1; i < kLabelsMax; ++i) absl::StrAppend(&labels, ", l", i, ": v");
  const auto with = [](const std::string& text) {
    return ParseInventory("robots.yaml",
                          absl::StrCat("robots: [{id: r1, bundle: b, sensors: [{host: h, primary: "
                                       "true}], labels: {",
                                       text, "}}]\n"));
  };
  EXPECT_THAT(with(labels), IsOk());
  EXPECT_THAT(with(absl::StrCat(labels, ", more: v")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("17 labels exceed limit 16")));
}

// What `labels` of a robot may not be, and the message.
TEST(InventoryTest, RefusesBadLabels) {
  const std::pair<std::string, std::string> cases[] = {
      {"{Ring: canary}", "`Ring` is not a valid label"},
      {"{ring_1: canary}", "`ring_1` is not a valid label"},
      {"{-ring: canary}", "`-ring` is not a valid label"},
      {"{\"\": canary}", "`` is not a valid label"},
      {"{a=b: canary}", "`a=b` is not a valid label"},
      {absl::StrCat("{", std::string(64, 'x'), ": canary}"), "is not a valid label"},
      {"{ring: Canary}", "`Canary` is not a valid value of a label"},
      {"{ring: a=b}", "`a=b` is not a valid value of a label"},
      {"{ring: \"\"}", "`ring` must not be empty"},
      {"{ring: }", "`ring` is empty"},
      {"{ring: [a, b]}", "`ring` is a list; write a text"},
      {"{ring: {a: b}}", "`ring` is a mapping; write a text"},
      {"{ring: a, ring: b}", "ring"},
      {"{ring: \"a\\u001b\"}", "contains a control character"},
      {"{ring: \"a\\u00e9\"}", "is not a valid value of a label"},
      {"[ring]", "write a mapping"},
      {"ring=canary", "write a mapping"},
  };
  for (const auto& [labels, message] : cases) {
    EXPECT_THAT(
        ParseInventory("robots.yaml",
                       absl::StrCat("robots:\n  - {id: r1, bundle: b, sensors: [{host: h, primary: "
                                    "true}],\n     labels: ",
                                    labels, "}\n")),
        StatusIs(absl::StatusCode::kInvalidArgument,
                 AllOf(HasSubstr("robots.yaml:3:"), HasSubstr(message))))
        << labels;
  }
}

TEST(InventoryTest, MayBeEmpty) {
  const auto inventory = ParseInventory("robots.yaml", "robots: []\n");
  ASSERT_THAT(inventory, IsOk());
  EXPECT_THAT(inventory->robots, SizeIs(0));
}

struct BadCase {
  std::string name;
  std::string text;
  std::string message;
};

class BadInventoryTest : public testing::TestWithParam<BadCase> {};

TEST_P(BadInventoryTest, IsRefused) {
  EXPECT_THAT(ParseInventory("robots.yaml", GetParam().text),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(GetParam().message)));
}

INSTANTIATE_TEST_SUITE_P(
    All, BadInventoryTest,
    testing::Values(
        BadCase{"Empty", "", "robots.yaml"},
        BadCase{"NoRobots", "robot: []\n", "unknown key `robot`; did you mean `robots`"},
        BadCase{"NoRoom",
                "robots: [{id: r1, bundle: b, sensors: [{host: h, primary: true}], "
                "graph_limits: {nodes: 0}}]\n",
                "nodes"},
        BadCase{"TooMuchRoom",
                "robots: [{id: r1, bundle: b, sensors: [{host: h, primary: true}], "
                "graph_limits: {endpoints: 65537}}]\n",
                "endpoints"},
        BadCase{"NotAList", "robots: {id: r1}\n", "write a list of mappings"},
        BadCase{"BadId", "robots: [{id: R1, bundle: b, sensors: [{host: h, primary: true}]}]\n",
                "`R1` is not a valid robot id"},
        BadCase{"BadBundle",
                "robots: [{id: r1, bundle: ../b, sensors: [{host: h, primary: true}]}]\n",
                "is not a valid bundle name"},
        BadCase{"NoSensors", "robots: [{id: r1, bundle: b}]\n", "0 sensors are `primary`"},
        BadCase{"NoPrimary", "robots: [{id: r1, bundle: b, sensors: [{host: h}]}]\n",
                "0 sensors are `primary`; exactly one must be"},
        BadCase{"TwoPrimaries",
                "robots: [{id: r1, bundle: b, sensors: [{host: h, primary: true}, {host: i, "
                "primary: true}]}]\n",
                "2 sensors are `primary`"},
        BadCase{"SensorTwice",
                "robots: [{id: r1, bundle: b, sensors: [{host: h, primary: true}, {host: h}]}]\n",
                "sensor host `h` is listed twice"},
        BadCase{"ActuatorTwice",
                "robots: [{id: r1, bundle: b, sensors: [{host: h, primary: true}], actuators: [a, "
                "a]}]\n",
                "actuator host `a` is listed twice"},
        BadCase{"BadActuator",
                "robots: [{id: r1, bundle: b, sensors: [{host: h, primary: true}], actuators: "
                "[A]}]\n",
                "`A` is not a valid host"},
        BadCase{"UnknownKey",
                "robots: [{id: r1, bundle: b, sensor: [], sensors: [{host: h, primary: true}]}]\n",
                "unknown key `sensor`"},
        BadCase{"RobotTwice",
                "robots:\n  - {id: r1, bundle: b, sensors: [{host: h, primary: true}]}\n"
                "  - {id: r1, bundle: b, sensors: [{host: h, primary: true}]}\n",
                "robots.yaml:3:10: robot `r1` is listed twice"}),
    [](const testing::TestParamInfo<BadCase>& param) { return param.param.name; });

TEST(InventoryTest, HasALimitOfRobots) {
  std::string text = "robots:\n";
  for (size_t i = 0; i < kRobotsMax; ++i) {
    absl::StrAppend(&text, "  - {id: r", i, ", bundle: b, sensors: [{host: h, primary: true}]}\n");
  }
  EXPECT_THAT(ParseInventory("robots.yaml", text), IsOk());
  absl::StrAppend(&text, "  - {id: rx, bundle: b, sensors: [{host: h, primary: true}]}\n");
  EXPECT_THAT(
      ParseInventory("robots.yaml", text),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("2001 robots exceed limit 2000")));
}

TEST(InventoryTest, HasALimitOfHosts) {
  std::string sensors = "{host: h, primary: true}";
  std::string actuators = "h";
  for (size_t i = 0; i < kHostsMax; ++i) {
    absl::StrAppend(&sensors, ", {host: h", i, "}");
    absl::StrAppend(&actuators, ", h", i);
  }
  EXPECT_THAT(
      ParseInventory("robots.yaml", absl::StrCat("robots: [{id: r1, bundle: b, sensors: [", sensors,
                                                 "], actuators: [", actuators, "]}]\n")),
      StatusIs(absl::StatusCode::kInvalidArgument,
               AllOf(HasSubstr("17 sensors exceed limit 16"),
                     HasSubstr("17 actuators exceed limit 16"))));
}

}  // namespace
}  // namespace rips::bundle
