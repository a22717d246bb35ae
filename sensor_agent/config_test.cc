#include "sensor_agent/config.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr char kFull[] = R"(robot: r1
host: base
servers: ["policy.example:7443", "[::1]:7443"]
tls: {ca: /etc/rips/pki/ca.pem, cert: /etc/rips/pki/cert.pem, key: /etc/rips/pki/key.pem}
dds: {domain: 7, interface: lo, security: null}
observer: hidden
settle: 3s
attribution_grace: 250ms
unwatched: [/rosout]
state_dir: /tmp/sensor
outbox: {memory: 8MiB, disk: 32MiB, dir: /tmp/spool}
ids: [{format: eve, path: /var/log/suricata/eve.json}, {format: fast, path: /var/log/snort/alert}]
signals: false
wire: {enabled: true, socket: /run/rips/tap.sock}
metrics: "127.0.0.1:0"
graph_limits: {participants: 9, nodes: 8, endpoints: 7, nodes_per_participant: 6,
               endpoints_per_participant: 5}
raw_readers: [/scan]
server_may_set: [unwatched]
)";

constexpr char kMinimal[] = R"(robot: r1
host: base
servers: ["policy.example:7443"]
tls: {ca: /a, cert: /b, key: /c}
)";

TEST(SensorConfigTest, EveryKeyIsTaken) {
  const auto config = ParseSensorConfig("sensor.yaml", kFull);
  ASSERT_THAT(config, IsOk());
  EXPECT_EQ(config->robot, "r1");
  EXPECT_EQ(config->host, "base");
  EXPECT_THAT(config->servers, ElementsAre("policy.example:7443", "[::1]:7443"));
  EXPECT_EQ(config->tls.cert, "/etc/rips/pki/cert.pem");
  EXPECT_EQ(config->dds.domain, 7);
  EXPECT_EQ(config->dds.interface, "lo");
  EXPECT_TRUE(config->watch.observer_hidden);
  EXPECT_EQ(config->watch.settle, absl::Seconds(3));
  EXPECT_EQ(config->watch.attribution_grace, absl::Milliseconds(250));
  EXPECT_THAT(config->watch.unwatched, ElementsAre("/rosout"));
  EXPECT_THAT(config->watch.raw_readers, ElementsAre("/scan"));
  EXPECT_EQ(config->watch.graph_limits, (ros2::GraphLimits{.nodes = 8,
                                                           .endpoints = 7,
                                                           .participants = 9,
                                                           .endpoints_per_participant = 5,
                                                           .nodes_per_participant = 6}));
  EXPECT_EQ(config->watch.outbox_memory.bytes, 8 << 20);
  EXPECT_EQ(config->watch.outbox_disk.bytes, 32 << 20);
  EXPECT_THAT(config->server_may_set, ElementsAre("unwatched"));
  EXPECT_EQ(config->spool_dir, "/tmp/spool");
  EXPECT_THAT(config->ids, ElementsAre(IdsLog{IdsFormat::kEve, "/var/log/suricata/eve.json"},
                                       IdsLog{IdsFormat::kFast, "/var/log/snort/alert"}));
  EXPECT_FALSE(config->watch.signals);
  EXPECT_TRUE(config->wire);
  EXPECT_EQ(config->wire_socket, "/run/rips/tap.sock");
  EXPECT_EQ(config->metrics, "127.0.0.1:0");
  EXPECT_THAT(FormatSettings(config->settings),
              AllOf(HasSubstr("settle: 3s  # sensor.yaml:"),
                    HasSubstr("outbox.memory: 8MiB  # sensor.yaml:")));
}

TEST(SensorConfigTest, DefaultsAreThoseOfTheStruct) {
  const auto config = ParseSensorConfig("sensor.yaml", kMinimal);
  ASSERT_THAT(config, IsOk());
  SensorConfig expected;
  expected.robot = "r1";
  expected.host = "base";
  expected.servers = {"policy.example:7443"};
  expected.tls = {.ca = "/a", .cert = "/b", .key = "/c"};
  expected.spool_dir = "/var/lib/rips/sensor/spool";
  expected.settings = config->settings;
  EXPECT_EQ(*config, expected);
  EXPECT_THAT(config->watch.unwatched, ElementsAre("/rosout", "/parameter_events"));
}

constexpr char kLetting[] = "server_may_set: [settle, outbox.memory, graph_limits]\nsettle: 1s\n";

TEST(SensorConfigTest, FollowsWhatItLetsTheServerSet) {
  const auto config = ParseSensorConfig("sensor.yaml", absl::StrCat(kMinimal, kLetting),
                                        {{"settle", "3s", "policy server, robots.yaml:4"},
                                         {"outbox.memory", "8MiB", "policy server, robots.yaml:5"},
                                         {"graph_limits.nodes", "7", "policy server, x:1"}});
  ASSERT_THAT(config, IsOk());
  EXPECT_EQ(config->watch.settle, absl::Seconds(3)) << "in place of the file's";
  EXPECT_EQ(config->watch.outbox_memory.bytes, 8 << 20);
  EXPECT_EQ(config->watch.graph_limits.nodes, 7u);
  EXPECT_THAT(config->refused, IsEmpty());
  EXPECT_THAT(FormatSettings(config->settings),
              AllOf(HasSubstr("settle: 3s  # policy server, robots.yaml:4\n"),
                    HasSubstr("outbox.memory: 8MiB  # policy server, robots.yaml:5\n"),
                    HasSubstr("outbox.disk: 256MiB  # default\n"),
                    HasSubstr("host: \"base\"  # sensor.yaml:2\n")));
}

TEST(SensorConfigTest, WhatItDoesNotLetTheServerSetIsRefusedAndSaysSo) {
  const std::pair<const char*, const char*> others[] = {
      {"signals", "false"},   {"servers", "[\"evil:1\"]"}, {"outbox", "{memory: 8MiB}"},
      {"outbox.disk", "0B"},  {"outbox.dir", "/tmp"},      {"server_may_set", "[servers]"},
      {"settle.more", "1s"},  {"tls.ca", "/evil"},         {"", "1"},
      {"graph_limitsx", "{}"}};
  for (const auto& [path, value] : others) {
    const auto own = ParseSensorConfig("sensor.yaml", absl::StrCat(kMinimal, kLetting));
    auto config = ParseSensorConfig("sensor.yaml", absl::StrCat(kMinimal, kLetting),
                                    {{path, value, "policy server, robots.yaml:4"}});
    ASSERT_THAT(config, IsOk());
    ASSERT_THAT(config->refused, testing::SizeIs(1)) << path;
    EXPECT_THAT(config->refused[0], HasSubstr(absl::StrCat("`", path)));
    config->refused.clear();
    EXPECT_EQ(*config, *own) << path;
  }
  const auto none = ParseSensorConfig("sensor.yaml", kMinimal, {{"settle", "3s", "policy server"}});
  ASSERT_THAT(none, IsOk());
  EXPECT_EQ(none->watch.settle, absl::Seconds(2)) << "nothing is allowed by default";
  EXPECT_THAT(none->refused, ElementsAre("`settle: 3s` (policy server): `server_may_set` of "
                                         "sensor.yaml does not list it"));
}

TEST(SensorConfigTest, OneWrongSettingOfTheServerLeavesAllOfThemOut) {
  const char* wrong[] = {"1h", "3", "[3s]", "3s\nsignals: false", "{", "'3s", "&a 3s", ""};
  for (const char* value : wrong) {
    const auto config =
        ParseSensorConfig("sensor.yaml", absl::StrCat(kMinimal, kLetting),
                          {{"outbox.memory", "8MiB", "policy server, robots.yaml:4"},
                           {"settle", value, "policy server, robots.yaml:5"}});
    ASSERT_THAT(config, IsOk()) << "its own file is good";
    EXPECT_EQ(config->watch.settle, absl::Seconds(1)) << value;
    EXPECT_EQ(config->watch.outbox_memory.bytes, 64 << 20) << value;
    EXPECT_TRUE(config->watch.signals) << value;
    ASSERT_THAT(config->refused, testing::SizeIs(1)) << value;
    EXPECT_THAT(config->refused[0], HasSubstr("`outbox.memory`, `settle`: not all")) << value;
    EXPECT_THAT(config->refused[0], HasSubstr("policy server, robots.yaml:5: `settle`")) << value;
  }
}

TEST(SensorConfigTest, SaysNoEndlessThingsOfWhatItRefuses) {
  std::vector<ConfigSetting> many(5'000, {std::string(300, 'p'), std::string(900, 'v'), "s"});
  const auto config = ParseSensorConfig("sensor.yaml", absl::StrCat(kMinimal, kLetting), many);
  ASSERT_THAT(config, IsOk());
  EXPECT_THAT(config->refused, testing::SizeIs(32));
  EXPECT_EQ(config->refused.back(), "and 4969 more");
  EXPECT_THAT(config->refused.front(), testing::SizeIs(testing::Le(512u)));
}

TEST(SensorConfigTest, NamesWhatTheServerMayBeLetSet) {
  const auto config = ParseSensorConfig(
      "sensor.yaml", absl::StrCat(kMinimal, "server_may_set: [settle, servers, tls, outbox]\n"));
  EXPECT_THAT(config, StatusIs(absl::StatusCode::kInvalidArgument,
                               AllOf(HasSubstr("`servers` is not the server's to set"),
                                     HasSubstr("`tls` is not"), HasSubstr("`outbox` is not"),
                                     HasSubstr("`outbox.memory`"))));
}

TEST(SensorConfigTest, UnwatchedMayBeEmpty) {
  const auto config = ParseSensorConfig("sensor.yaml", absl::StrCat(kMinimal, "unwatched: []\n"));
  ASSERT_THAT(config, IsOk());
  EXPECT_THAT(config->watch.unwatched, IsEmpty());
}

TEST(SensorConfigTest, OnlySoManyLogsOfAnIds) {
  std::string ids = "ids:\n";
  for (size_t i = 0; i <= kIdsLogsMax; ++i) {
    absl::StrAppend(&ids, "  - {format: fast, path: /log/", i, "}\n");
  }
  EXPECT_THAT(
      ParseSensorConfig("s", absl::StrCat(kMinimal, ids)),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("17 logs exceed the limit of 16")));
}

struct BadCase {
  const char* name;
  // Replaced in kFull.
  const char* from;
  const char* to;
  const char* place;
  const char* says;
};

class BadSensorConfigTest : public testing::TestWithParam<BadCase> {};

TEST_P(BadSensorConfigTest, IsRefusedWithItsPlace) {
  const BadCase& bad = GetParam();
  const std::string text = absl::StrReplaceAll(kFull, {{bad.from, bad.to}});
  ASSERT_NE(text, kFull) << "the case changes nothing";
  EXPECT_THAT(
      ParseSensorConfig("sensor.yaml", text),
      StatusIs(absl::StatusCode::kInvalidArgument,
               AllOf(HasSubstr(absl::StrCat("sensor.yaml:", bad.place)), HasSubstr(bad.says))));
}

INSTANTIATE_TEST_SUITE_P(
    All, BadSensorConfigTest,
    testing::Values(
        BadCase{"UnknownKey", "settle: 3s", "setle: 3s", "7:1", "did you mean `settle`"},
        BadCase{"MissingRobot", "robot: r1\n", "", "", "robot"},
        BadCase{"BadHost", "host: base", "host: Base_1", "2:", "host id"},
        BadCase{"NoServers", R"(["policy.example:7443", "[::1]:7443"])", "[]", "3:", "servers"},
        BadCase{"ServerWithoutPort", "policy.example:7443", "policy.example",
                "3:", "`policy.example` is not HOST:PORT"},
        BadCase{"BareNumber", "settle: 3s", "settle: 3", "7:9", "settle"},
        BadCase{"TopicOfARawReader", "raw_readers: [/scan]", "raw_readers: [\"/a b\"]",
                "18:", "/a b"},
        BadCase{"SettleTooLong", "settle: 3s", "settle: 11s", "7:9", "settle"},
        BadCase{"BadObserver", "observer: hidden", "observer: secret", "6:", "counted"},
        BadCase{"RelativeKey", "/etc/rips/pki/key.pem", "key.pem", "4:", "absolute path"},
        BadCase{"DomainTooHigh", "domain: 7", "domain: 400", "5:", "domain"},
        BadCase{"BadTopic", "[/rosout]", "[rosout]", "9:", "rosout"},
        BadCase{"OutboxTooSmall", "memory: 8MiB", "memory: 1KiB", "11:", "memory"},
        BadCase{"IdsFormat", "format: eve", "format: evil", "12:16", "snort3_json"},
        BadCase{"IdsPath", "/var/log/snort/alert", "alert", "12:", "absolute path"},
        BadCase{"IdsTwice", "/var/log/snort/alert", "/var/log/suricata/eve.json",
                "12:", "is read already"},
        BadCase{"IdsKey", "format: fast, path", "format: fast, paths",
                "12:", "did you mean `path`"},
        BadCase{"WireSocketRelative", "/run/rips/tap.sock", "tap.sock", "14:31", "absolute"},
        BadCase{"WireUnknownKey", "socket: /run", "sockets: /run", "14:23", "`socket`"},
        BadCase{"DiskTooSmall", "disk: 32MiB", "disk: 1MiB", "11:30", "at least 16MiB"},
        BadCase{"DiskTooLarge", "disk: 32MiB", "disk: 1000GiB", "11:30", "disk"},
        BadCase{"RelativeSpool", "dir: /tmp/spool", "dir: spool", "11:", "absolute path"},
        BadCase{"Keystore", "security: null", "security: {keystore: k, enclave: /rips/sensor}",
                "5:", "write an absolute path"},
        BadCase{"Enclave", "security: null", "security: {keystore: /k, enclave: rips}",
                "5:", "`enclave` must begin with `/`"}),
    [](const auto& param) { return param.param.name; });

TEST(SensorConfigTest, SecurityNamesKeystoreAndEnclave) {
  const std::string text = absl::StrReplaceAll(
      kFull, {{"security: null", "security: {keystore: /k, enclave: /rips/sensor}"}});
  const auto config = ParseSensorConfig("sensor.yaml", text);
  ASSERT_THAT(config, IsOk());
  EXPECT_EQ(config->dds.keystore, "/k");
  EXPECT_EQ(config->dds.enclave, "/rips/sensor");
}

TEST(SensorConfigTest, EveryProblemIsToldAtOnce) {
  EXPECT_THAT(
      ParseSensorConfig("s", "robot: R\nhots: base\n"),
      StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("robot id"), HasSubstr("`hots`"),
                                                         HasSubstr("servers"), HasSubstr("tls"))));
}

}  // namespace
}  // namespace rips::sensor
