// `robot config` against a server that plays OperatorService.
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

void Add(const std::string& path, const std::string& value, const std::string& source,
         v1::Configuration& configuration) {
  v1::Setting& setting = *configuration.add_settings();
  setting.set_path(path);
  setting.set_value(value);
  setting.set_source(source);
}

class ConfigCommandTest : public RipsctlTest {
 protected:
  ConfigCommandTest() {
    v1::GetConfigurationResponse& said = fake_.configuration;
    Add("labels.ring", "\"canary\"", "/etc/rips/robots.yaml:7", *said.mutable_server());
    v1::AgentConfiguration& sensor = *said.add_agents();
    sensor.set_role("sensor");
    sensor.set_host("base");
    Add("settle", "3s", "/etc/rips/sensor.yaml:4", *sensor.mutable_configuration());
    Add("outbox.memory", "64MiB", "", *sensor.mutable_configuration());
    sensor.mutable_configuration()->set_left_out(2);
    sensor.set_said_unix_ns(kNewYear);
    v1::AgentConfiguration& actuator = *said.add_agents();
    actuator.set_role("actuator");
    actuator.set_host("base");
  }
};

TEST_F(ConfigCommandTest, ShowsWhatIsInForceAndWhatSaysIt) {
  const Result result = Run({"robot", "config", "r1"});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(result.out,
            "inventory of the policy server\n"
            "  SETTING      VALUE     FROM\n"
            "  labels.ring  \"canary\"  /etc/rips/robots.yaml:7\n"
            "\n"
            "sensor base, as it said when it connected, at 2026-01-01T00:00:00.000Z\n"
            "  SETTING        VALUE  FROM\n"
            "  settle         3s     /etc/rips/sensor.yaml:4\n"
            "  outbox.memory  64MiB  default\n"
            "  and 2 more, for which there was no room; `--check-config` of the program shows all\n"
            "\n"
            "actuator base\n"
            "  not known: it has not connected since the policy server started, or is of an older "
            "version\n"
            "\n"
            "what an agent says of itself proves nothing: one whose key was stolen may lie\n");
  EXPECT_EQ(fake_.calls().back(), "GetConfiguration r1");
  EXPECT_EQ(RunJson({"robot", "config", "r1"}), nlohmann::json::parse(R"({
    "robot": "r1",
    "server": {"settings": [{"path": "labels.ring", "value": "\"canary\"",
                             "source": "/etc/rips/robots.yaml:7"}], "refused": [],
               "defaults_left_out": 0, "left_out": 0},
    "agents": [
      {"role": "sensor", "host": "base", "said": "2026-01-01T00:00:00.000000000Z", "configuration": {
        "settings": [{"path": "settle", "value": "3s", "source": "/etc/rips/sensor.yaml:4"},
                     {"path": "outbox.memory", "value": "64MiB", "source": null}],
        "refused": [], "defaults_left_out": 0, "left_out": 2}},
      {"role": "actuator", "host": "base", "said": null, "configuration": null}]
  })"));
}

TEST_F(ConfigCommandTest, LeavesDefaultsOutAndCountsThem) {
  const Result result = Run({"robot", "config", "r1", "--no-defaults"});
  EXPECT_THAT(result.out, Not(HasSubstr("outbox.memory")));
  EXPECT_THAT(result.out, HasSubstr("  and 1 default\n  and 2 more"));
  const nlohmann::json sensor =
      RunJson({"robot", "config", "r1", "--no-defaults"})["agents"][0]["configuration"];
  EXPECT_EQ(sensor["settings"].size(), 1u);
  EXPECT_EQ(sensor["defaults_left_out"], 1);
}

TEST_F(ConfigCommandTest, AsksForTheServersOwnOnlyWhenToldTo) {
  fake_.configuration.clear_agents();
  EXPECT_THAT(Run({"robot", "config", "--policy-server"}).out,
              testing::StartsWith("policy server\n"));
  EXPECT_EQ(fake_.calls().back(), "GetConfiguration ");
  EXPECT_TRUE(RunJson({"robot", "config", "--policy-server"})["robot"].is_null());
  const size_t calls = fake_.calls().size();
  EXPECT_EQ(Run({"robot", "config"}).code, 2);
  EXPECT_EQ(Run({"robot", "config", ""}).code, 2) << "a variable of the shell that is not set";
  EXPECT_EQ(Run({"robot", "config", "no robot"}).code, 2);
  EXPECT_EQ(Run({"robot", "config", "r1", "--policy-server"}).code, 2);
  EXPECT_EQ(fake_.calls().size(), calls);
}

TEST_F(ConfigCommandTest, SaysWhatAnAgentDoesNotFollow) {
  v1::Configuration& said = *fake_.configuration.mutable_agents(0)->mutable_configuration();
  said.add_refused("`settle: 3s` (policy server, robots.yaml:4): not\nlisted");
  EXPECT_THAT(Run({"robot", "config", "r1"}).out,
              HasSubstr("  not followed: `settle: 3s` (policy server, robots.yaml:4): "
                        "not\\x0alisted\n"));
  EXPECT_EQ(RunJson({"robot", "config", "r1"})["agents"][0]["configuration"]["refused"].size(), 1u);
}

TEST_F(ConfigCommandTest, WhatAnAgentSaysIsEscaped) {
  Add("evil\n", "\x1b[2J", "\x1b]0;x\x07",
      *fake_.configuration.mutable_agents(0)->mutable_configuration());
  const std::string text = Run({"robot", "config", "r1"}).out;
  EXPECT_THAT(text, Not(HasSubstr("\x1b")));
  EXPECT_THAT(text, HasSubstr("evil\\x0a"));

  fake_.configuration.mutable_agents(0)->mutable_configuration()->add_refused(
      absl::StrCat("x", std::string(60, ' '), "sensor r9, as it said"));
  EXPECT_THAT(Run({"robot", "config", "r1"}).out,
              AllOf(HasSubstr("x \\x20\\x20"), HasSubstr("\\x20sensor r9")))
      << "wrapped, it would look like the head of another agent";
}

}  // namespace
}  // namespace rips::ripsctl
