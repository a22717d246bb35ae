// `ripsctl robot maintenance`, and where a maintenance shows.
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class MaintenanceCommandTest : public RipsctlTest {
 protected:
  static std::vector<std::string> With(const std::vector<std::string>& flags) {
    std::vector<std::string> args = {"robot", "maintenance", "r1"};
    args.insert(args.end(), flags.begin(), flags.end());
    return args;
  }
  static v1::RobotStatus InMaintenance() {
    v1::RobotStatus status = MakeStatus("r1", "COMPROMISED");
    *status.mutable_maintenance() = MakeMaintenance();
    return status;
  }
};

TEST_F(MaintenanceCommandTest, BeginsAndEnds) {
  const Result begun = Run(With({"--for", "90min", "--reason", "kernel"}));
  EXPECT_EQ(begun.code, 0) << begun.err;
  EXPECT_EQ(begun.out,
            "r1 is in maintenance until 2026-01-01T18:20:00.000Z; its level, rules and fail-safe "
            "work as before\n");
  const Result ended = Run(With({"--end", "--reason", "it is back"}));
  EXPECT_EQ(ended.out, "r1 is no longer in maintenance\n");
  EXPECT_THAT(fake_.calls(), ElementsAre("GetLevel", "SetMaintenance r1 5400000 kernel", "GetLevel",
                                         "SetMaintenance r1 0 it is back"));
}

TEST_F(MaintenanceCommandTest, PrintsJson) {
  const nlohmann::json json = RunJson(With({"--for", "1h", "--reason", "kernel"}));
  EXPECT_EQ(json["robot"], "r1");
  EXPECT_EQ(json["maintenance"], nlohmann::json({{"began", "2026-01-01T00:00:00.000000000Z"},
                                                 {"until", "2026-01-01T18:20:00.000000000Z"},
                                                 {"operator", MakeMaintenance().operator_()},
                                                 {"reason", "kernel \x1b[2J"}}));
  EXPECT_EQ(RunJson(With({"--end", "--reason", "x"})),
            nlohmann::json({{"robot", "r1"}, {"maintenance", nullptr}}));
}

TEST_F(MaintenanceCommandTest, RefusesWhatTheServerWouldRefuse) {
  const std::pair<std::vector<std::string>, const char*> bad[] = {
      {{"--reason", "x"}, "write either --for DURATION or --end"},
      {{"--reason", "x", "--end", "--for", "1h"}, "write either --for DURATION or --end"},
      {{"--reason", "x", "--for", "59s"}, "--for is `59s`; a maintenance takes 1min to 24h"},
      {{"--reason", "x", "--for", "25h"}, "--for is `25h`; a maintenance takes 1min to 24h"},
      {{"--reason", "x", "--for", "soon"}, "--for: "},
      {{"--reason", "x", "--for", "-1h"}, "--for"},
      {{"--reason", "", "--for", "1h"}, "reason"},
      {{"--reason", std::string(1'001, 'x'), "--for", "1h"}, "reason"},
      {{"--for", "1h"}, "--reason is required"},
  };
  for (const auto& [flags, why] : bad) {
    const Result result = Run(With(flags));
    EXPECT_EQ(result.code, 2) << why;
    EXPECT_THAT(result.err, HasSubstr(why));
  }
  EXPECT_THAT(fake_.calls(), IsEmpty());
}

TEST_F(MaintenanceCommandTest, ARefusedCallSaysWhy) {
  fake_.failure = {grpc::StatusCode::PERMISSION_DENIED, "this needs the role `operator`"};
  const Result result = Run(With({"--for", "1h", "--reason", "x"}));
  EXPECT_NE(result.code, 0);
  EXPECT_THAT(result.err, HasSubstr("this needs the role `operator`"));
}

TEST_F(MaintenanceCommandTest, ShowsInTheStatusOfARobot) {
  fake_.maintenance = MakeMaintenance();
  const Result list = Run({"robot", "list"});
  EXPECT_THAT(list.out, HasSubstr("  maintenance until 18:20 UTC (carol)\n"));
  EXPECT_EQ(RunJson({"robot", "list"})["robots"][0]["maintenance"]["until"],
            "2026-01-01T18:20:00.000000000Z");
  EXPECT_EQ(RunJson({"robot", "list"})["robots"][1]["maintenance"], nullptr);
  EXPECT_THAT(Run({"robot", "show", "r1"}).out, HasSubstr("maintenance until 18:20 UTC (carol): "));

  fake_.level_states = {InMaintenance()};
  const Result level = Run({"level", "show", "r1"});
  EXPECT_THAT(level.out, HasSubstr("maintenance until 18:20 UTC (carol): kernel "));
  EXPECT_THAT(level.out, Not(HasSubstr("\x1b")));
  EXPECT_EQ(RunJson({"level", "show", "r1"})["status"]["maintenance"]["reason"], "kernel \x1b[2J");
  fake_.level_states = {MakeStatus("r1", "DEFAULT")};
  EXPECT_THAT(Run({"level", "show", "r1"}).out, Not(HasSubstr("maintenance")));
}

TEST_F(MaintenanceCommandTest, ShowsWithAlerts) {
  v1::Alert alert = MakeAlert("who drives?");
  alert.set_maintenance("in maintenance until noon (asked by carol: \x1b[2J)");
  v1::Alert absence = MakeAlert("sensor base is lost; " + alert.maintenance());
  absence.set_maintenance(alert.maintenance());
  fake_.alert_watches = {{.alerts = {alert, absence}, .end = grpc::Status::OK}};
  const Result watch = Run({"alert", "watch"});
  EXPECT_THAT(watch.out, HasSubstr("who drives? [in maintenance until noon (asked by carol: "));
  EXPECT_THAT(watch.out, HasSubstr("is lost; in maintenance until noon"));
  EXPECT_THAT(watch.out, Not(HasSubstr("is lost; in maintenance until noon (asked by carol: "
                                       "\\x1b[2J) [in")));
  EXPECT_THAT(watch.out, Not(HasSubstr("\x1b")));
  fake_.alert_watches = {{.alerts = {alert}, .end = grpc::Status::OK}};
  EXPECT_EQ(RunJson({"alert", "watch"})["maintenance"], alert.maintenance());
}

}  // namespace
}  // namespace rips::ripsctl
