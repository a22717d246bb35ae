// `robot receipts` and `robot drill` against a server that plays OperatorService.

#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server_builder.h"
#include "policy_server/ripsctl/app.h"
#include "policy_server/ripsctl/offline_run.h"

namespace rips::ripsctl {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;

constexpr int64_t kAnsweredNs = 1'767'225'600'000'000'000;

class AnsweringOperator final : public v1::OperatorService::Service {
 public:
  grpc::Status failure;
  v1::ListReceiptsResponse receipts;
  v1::DrillRobotResponse drills;
  std::string asked;
  absl::Duration patience;

  grpc::Status ListReceipts(grpc::ServerContext*, const v1::ListReceiptsRequest* request,
                            v1::ListReceiptsResponse* response) override {
    asked = absl::StrCat(request->robot(), " ", request->limit());
    *response = receipts;
    return failure;
  }
  grpc::Status DrillRobot(grpc::ServerContext* context, const v1::DrillRobotRequest* request,
                          v1::DrillRobotResponse* response) override {
    asked = absl::StrCat(request->robot(), " ", request->level());
    patience = absl::FromChrono(context->deadline()) - absl::Now();
    *response = drills;
    return failure;
  }
};

class RobotActuatorsTest : public testing::Test {
 protected:
  RobotActuatorsTest() {
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(&fake_);
    server_ = builder.BuildAndStart();
  }
  ~RobotActuatorsTest() override { server_->Shutdown(); }

  static v1::StepResult Step(const std::string& name, bool ok, v1::StepResult::Drilled drilled,
                             const std::string& detail, const std::string& output = "") {
    v1::StepResult step;
    step.set_step(name);
    step.set_ok(ok);
    step.set_took_ms(12);
    step.set_drilled(drilled);
    step.set_detail(detail);
    step.set_output_tail(output);
    return step;
  }
  v1::ActuatorDrill* Drill(const std::string& level, const std::string& host,
                           v1::Receipt::Stage stage, const std::string& detail = "") {
    v1::ActuatorDrill* drill = fake_.drills.add_drills();
    drill->set_level(level);
    drill->set_host(host);
    drill->set_stage(stage);
    drill->set_detail(detail);
    return drill;
  }
  // Two levels that work.
  void Healthy() {
    *Drill("DEFAULT", "base", v1::Receipt::VERIFIED)->add_steps() =
        Step("system_mode /safety=__DEFAULT__", true, v1::StepResult::DRILLED_LOOKED, "answers");
    v1::ActuatorDrill* alert = Drill("ALERT", "base", v1::Receipt::VERIFIED);
    *alert->add_steps() = Step("program horn", true, v1::StepResult::DRILLED_DONE, "exited");
  }

  Result Run(const std::vector<std::string>& args) {
    std::ostringstream out;
    std::ostringstream err;
    const int code = RunRipsctl(
        args, {.out = out,
               .err = err,
               .get_env = [this](const std::string& name) -> std::optional<std::string> {
                 if (name == "HOME") return directory_.path();
                 return std::nullopt;
               },
               .connect = [this](const RawSettings&)
                   -> absl::StatusOr<std::unique_ptr<v1::OperatorService::StubInterface>> {
                 return std::unique_ptr<v1::OperatorService::StubInterface>(
                     v1::OperatorService::NewStub(grpc::CreateChannel(
                         absl::StrCat("127.0.0.1:", port_), grpc::InsecureChannelCredentials())));
               }});
    return Saved(args, {code, out.str(), err.str()});
  }
  nlohmann::json RunJson(std::vector<std::string> args, int expected_code = 0) {
    args.insert(args.end(), {"--output", "json"});
    const Result result = Run(args);
    EXPECT_EQ(result.code, expected_code) << result.err;
    return nlohmann::json::parse(result.out, nullptr, false);
  }

  const TestDirectory directory_;
  AnsweringOperator fake_;
  std::unique_ptr<grpc::Server> server_;
  int port_ = 0;
};

TEST_F(RobotActuatorsTest, ADrillThatWorksSaysWhatWasOnlyLookedAt) {
  Healthy();
  const Result result = Run({"robot", "drill", "r1"});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(fake_.asked, "r1 ");
  EXPECT_EQ(result.out,
            "LEVEL    HOST  STEP                             DONE     RESULT  DETAIL\n"
            "DEFAULT  base  system_mode /safety=__DEFAULT__  looked   ok      answers\n"
            "ALERT    base  program horn                     drilled  ok      exited\n"
            "\n"
            "1 step was only looked at: what it needs is there, but it was not carried out\n"
            "2 of 2 steps work\n");
}

TEST_F(RobotActuatorsTest, WhatDoesNotWorkIsNamedLast) {
  Healthy();
  v1::ActuatorDrill* halt = Drill("HALT", "base", v1::Receipt::FAILED, "program horn: exit code 1");
  *halt->add_steps() = Step("program horn", false, v1::StepResult::DRILLED_DONE, "exit code 1",
                            "no\x1b[2Jpe\nend\n");
  *halt->add_steps() = Step("program light", false, v1::StepResult::DRILLED_NOT, "not tried");
  Drill("HALT", "arm", v1::Receipt::REFUSED, "a level is being applied");
  Drill("HALT", "leg", v1::Receipt::STAGE_UNSPECIFIED, "no answer in time");
  const Result result = Run({"robot", "drill", "r1", "--level", "HALT"});
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(fake_.asked, "r1 HALT");
  EXPECT_THAT(result.out, HasSubstr("HALT     base  program horn                     drilled    "
                                    "FAILED       exit code 1\n"));
  EXPECT_THAT(result.out, HasSubstr("program light                    not tried  FAILED"));
  EXPECT_THAT(result.out, HasSubstr("HALT     arm   (all)                            not tried  "
                                    "refused      a level is being applied\n"));
  EXPECT_THAT(result.out, HasSubstr("NO RESPONSE  no answer in time\n"));
  EXPECT_THAT(result.out, HasSubstr("program horn on base (HALT) printed:\n"
                                    "  | no\\x1b[2Jpe\n"
                                    "  | end\n"));
  EXPECT_TRUE(result.out.ends_with(
      "2 of 4 steps work; 2 do not: program horn on base (HALT), program light on base (HALT); "
      "not all were tried: arm (HALT): refused: a level is being applied, leg (HALT): no answer in "
      "time\n"))
      << result.out;
}

TEST_F(RobotActuatorsTest, AnActuatorThatFailsWithoutStepsDoesNotWork) {
  Drill("HALT", "base", v1::Receipt::FAILED, "something");
  EXPECT_EQ(Run({"robot", "drill", "r1"}).code, 1);
  fake_.drills.Clear();
  *Drill("HALT", "base", v1::Receipt::SUPERSEDED, "a level had to be applied")->add_steps() =
      Step("x", true, v1::StepResult::DRILLED_DONE, "");
  EXPECT_EQ(Run({"robot", "drill", "r1"}).code, 1);
}

TEST_F(RobotActuatorsTest, ALevelWithoutStepsIsNoFailure) {
  Drill("DEFAULT", "base", v1::Receipt::VERIFIED);
  const Result result = Run({"robot", "drill", "r1"});
  EXPECT_EQ(result.code, 0);
  EXPECT_THAT(result.out, HasSubstr("(no steps)"));
}

TEST_F(RobotActuatorsTest, ADrillIsWaitedForWhateverTheTimeout) {
  Healthy();
  EXPECT_EQ(Run({"robot", "drill", "r1", "--timeout", "1s"}).code, 0);
  EXPECT_GT(fake_.patience, absl::Seconds(20));
}

TEST_F(RobotActuatorsTest, DrillsAsJson) {
  Healthy();
  *Drill("HALT", "base", v1::Receipt::FAILED, "x")->add_steps() =
      Step("program horn", false, v1::StepResult::DRILLED_DONE, "exit code 1", "\xff\x1b");
  const nlohmann::json json = RunJson({"robot", "drill", "r1"}, 1);
  EXPECT_EQ(json["robot"], "r1");
  EXPECT_EQ(json["works"], false);
  EXPECT_EQ(json["steps"], 3);
  EXPECT_EQ(json["steps_work"], 2);
  EXPECT_EQ(json["only_looked"], 1);
  ASSERT_THAT(json["drills"], SizeIs(3));
  EXPECT_EQ(json["drills"][2]["stage"], "failed");
  EXPECT_EQ(json["drills"][2]["steps"][0], nlohmann::json({{"step", "program horn"},
                                                           {"ok", false},
                                                           {"drilled", "drilled"},
                                                           {"took_ms", 12},
                                                           {"detail", "exit code 1"},
                                                           {"output", "\xef\xbf\xbd\x1b"}}));
}

TEST_F(RobotActuatorsTest, RefusalsAndUsage) {
  fake_.failure = grpc::Status(grpc::StatusCode::FAILED_PRECONDITION, "a drill is under way\x1b");
  const Result refused = Run({"robot", "drill", "r1"});
  EXPECT_EQ(refused.code, 1);
  EXPECT_EQ(refused.err, "error: a drill is under way\\x1b\n");
  EXPECT_EQ(Run({"robot", "drill"}).code, 2);
  EXPECT_EQ(Run({"robot", "drill", "r1", "--level", ""}).code, 2);
  EXPECT_EQ(Run({"robot", "drill", "r1", "--level", "\xff"}).code, 2);
  EXPECT_EQ(Run({"robot", "drill", "R 1"}).code, 2);
  EXPECT_EQ(Run({"robot", "receipts", "r1", "--limit", "65"}).code, 2);
  EXPECT_EQ(Run({"robot", "receipts", "r1", "--limit", "0"}).code, 2);
  EXPECT_EQ(Run({"robot", "receipts", "r1"}).code, 1);
}

TEST_F(RobotActuatorsTest, ShowsReceiptsFailedStepsFirst) {
  v1::ReceivedReceipt* level = fake_.receipts.add_receipts();
  level->set_unix_ns(kAnsweredNs);
  level->set_host("base");
  level->set_command("level ALERT");
  level->mutable_receipt()->set_stage(v1::Receipt::FAILED);
  level->mutable_receipt()->mutable_decision_id()->set_term(3);
  level->mutable_receipt()->mutable_decision_id()->set_epoch(17);
  level->mutable_receipt()->set_effective_level("ALERT");
  level->mutable_receipt()->set_detail("program horn: exit code 1");
  *level->mutable_receipt()->add_steps() =
      Step("system_mode /safety=ALERT", true, v1::StepResult::DRILLED_UNSPECIFIED, "");
  std::string output;
  for (int i = 1; i <= 12; ++i) absl::StrAppend(&output, "line ", i, "\x1b\n");
  *level->mutable_receipt()->add_steps() =
      Step("program horn", false, v1::StepResult::DRILLED_UNSPECIFIED, "exit code 1", output);
  v1::ReceivedReceipt* exec = fake_.receipts.add_receipts();
  exec->set_unix_ns(kAnsweredNs);
  exec->set_host("base");
  exec->set_command("exec usb_alarm");
  exec->mutable_receipt()->set_stage(v1::Receipt::FAILED);
  exec->mutable_receipt()->set_exit_code(3);
  exec->mutable_receipt()->set_detail("exit code 3");
  exec->mutable_receipt()->set_output_tail("no device");

  const Result result = Run({"robot", "receipts", "r1", "--limit", "2"});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(fake_.asked, "r1 2");
  EXPECT_THAT(result.out, Not(HasSubstr("\x1b")));
  EXPECT_THAT(
      result.out,
      HasSubstr("2026-01-01T00:00:00.000Z  base  level ALERT  failed  decision 3.17  held at "
                "ALERT\n"
                "  FAILED   program horn                  12 ms  exit code 1\n"
                "           | (2 more above)\n"
                "           | line 3\\x1b\n"));
  EXPECT_THAT(result.out, HasSubstr("           | line 12\\x1b\n"
                                    "  ok       system_mode /safety=ALERT     12 ms\n"
                                    "\n"
                                    "2026-01-01T00:00:00.000Z  base  exec usb_alarm  failed  exit "
                                    "code 3\n"
                                    "  exit code 3\n"
                                    "  | no device\n"));
}

TEST_F(RobotActuatorsTest, ReceiptsAsJson) {
  v1::ReceivedReceipt* exec = fake_.receipts.add_receipts();
  exec->set_unix_ns(kAnsweredNs);
  exec->set_host("base");
  exec->set_command("exec usb_alarm");
  exec->mutable_receipt()->set_command_id(std::string(16, '\xab'));
  exec->mutable_receipt()->set_stage(v1::Receipt::VERIFIED);
  const nlohmann::json json = RunJson({"robot", "receipts", "r1"});
  EXPECT_EQ(fake_.asked, "r1 20");
  ASSERT_THAT(json["receipts"], SizeIs(1));
  const nlohmann::json& receipt = json["receipts"][0];
  EXPECT_EQ(receipt["time"], "2026-01-01T00:00:00.000000000Z");
  EXPECT_EQ(receipt["command"], "exec usb_alarm");
  EXPECT_EQ(receipt["command_id"], "abababababababababababababababab");
  EXPECT_EQ(receipt["stage"], "verified");
  EXPECT_EQ(receipt["decision_id"], nullptr);
  EXPECT_THAT(receipt["steps"], SizeIs(0));
}

TEST_F(RobotActuatorsTest, SaysThatNothingWasAnswered) {
  const Result result = Run({"robot", "receipts", "r1"});
  EXPECT_EQ(result.code, 0);
  EXPECT_EQ(result.out, "no actuator of r1 has sent a receipt\n");
}

}  // namespace
}  // namespace rips::ripsctl
