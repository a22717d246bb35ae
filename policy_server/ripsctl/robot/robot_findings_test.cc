// What `ripsctl robot list` and `robot show` say of findings.
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class RobotFindingsTest : public RipsctlTest {};

TEST_F(RobotFindingsTest, ListNamesRobotsOnWhichFindingsStandOrMay) {
  EXPECT_THAT(Run({"robot", "list"}).out, Not(HasSubstr("findings"))) << "an older server";
  fake_.change_list = [](v1::ListRobotsResponse& list) {
    list.mutable_robots(0)->set_findings(0);
    list.mutable_robots(1)->set_findings(0);
  };
  EXPECT_THAT(Run({"robot", "list"}).out, Not(HasSubstr("findings"))) << "none stands";
  fake_.change_list = [](v1::ListRobotsResponse& list) {
    list.mutable_robots(0)->set_findings(3);
    list.mutable_robots(1)->set_findings(0);
    list.mutable_robots(1)->set_findings_not_known(true);
  };
  EXPECT_THAT(Run({"robot", "list"}).out,
              HasSubstr("ripsctl explain ROBOT\n"
                        "findings stand on r1 (3): ripsctl robot coverage ROBOT\n"
                        "whether findings stand is not known of r2\n"));
  const nlohmann::json robots = RunJson({"robot", "list"})["robots"];
  EXPECT_EQ(robots[0]["findings"], 3);
  EXPECT_EQ(robots[0]["findings_not_known"], false);
  EXPECT_EQ(robots[1]["findings_not_known"], true);
}

TEST_F(RobotFindingsTest, ShowHasALineOfThem) {
  const auto show = [this](uint64_t findings, bool not_known) {
    fake_.change_list = [=](v1::ListRobotsResponse& list) {
      list.mutable_robots(0)->set_findings(findings);
      list.mutable_robots(0)->set_findings_not_known(not_known);
    };
    return Run({"robot", "show", "r1"}).out;
  };
  EXPECT_THAT(show(0, false), HasSubstr("none stands\n"));
  EXPECT_THAT(show(0, true), HasSubstr("not known; see `ripsctl explain r1`\n"));
  EXPECT_THAT(show(2, false), HasSubstr("2 stand; see `ripsctl robot coverage r1`\n"));
  EXPECT_THAT(show(2, true), HasSubstr("2 stood as reported last; see `ripsctl robot"));
  const nlohmann::json json = RunJson({"robot", "show", "r1"});
  EXPECT_EQ(json["findings"], 2);
  EXPECT_EQ(json["findings_not_known"], true);
}

TEST_F(RobotFindingsTest, ListNamesAFewOfMany) {
  fake_.change_list = [](v1::ListRobotsResponse& list) {
    list.clear_robots();
    for (int i = 0; i < 30; ++i) {
      v1::RobotStatus& status = *list.add_robots();
      status = MakeStatus(absl::StrCat("r", i), "DEFAULT");
      status.set_findings(i == 0 ? 4'096 : 1);
      status.set_findings_not_known(i == 0);
    }
  };
  EXPECT_THAT(Run({"robot", "list"}).out,
              HasSubstr("findings stand on r0 (4096 as reported last), r1 (1), r2 (1), r3 (1), "
                        "r4 (1), r5 (1), r6 (1), r7 (1) and 22 more: ripsctl robot coverage "
                        "ROBOT\n"));
}

}  // namespace
}  // namespace rips::ripsctl
