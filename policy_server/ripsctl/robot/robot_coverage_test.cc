// `robot interest` and `robot coverage` against a server that plays OperatorService.
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

class ObservingOperator final : public v1::OperatorService::Service {
 public:
  grpc::Status failure;
  v1::GetInterestResponse interest;
  v1::GetCoverageResponse coverage;
  std::string asked;

  grpc::Status GetInterest(grpc::ServerContext*, const v1::GetInterestRequest* request,
                           v1::GetInterestResponse* response) override {
    asked = request->robot();
    *response = interest;
    return failure;
  }
  grpc::Status GetCoverage(grpc::ServerContext*, const v1::GetCoverageRequest* request,
                           v1::GetCoverageResponse* response) override {
    asked = request->robot();
    *response = coverage;
    return failure;
  }
};

class RobotCoverageTest : public testing::Test {
 protected:
  RobotCoverageTest() {
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(&fake_);
    server_ = builder.BuildAndStart();

    v1::SensorCoverage* base = fake_.coverage.add_sensors();
    base->set_host("base");
    base->set_primary(true);
    base->set_connected(true);
    base->set_settled(true);
    Endpoint(v1::Endpoint::PUBLISHER, "/chatter", "/talker", v1::WATCHED);
    Endpoint(v1::Endpoint::PUBLISHER, "/rosout", "/talker", v1::NOT_NEEDED);
    Endpoint(v1::Endpoint::SERVICE, "/talker/get_parameters", "/talker", v1::NOT_VISIBLE);
    Endpoint(v1::Endpoint::CLIENT, "/talker/get_parameters", "/listener", v1::NOT_VISIBLE);
    fake_.coverage.mutable_findings_now();
  }
  ~RobotCoverageTest() override { server_->Shutdown(); }

  v1::Endpoint* Endpoint(v1::Endpoint::Kind kind, const std::string& name, const std::string& node,
                         v1::Visibility visibility) {
    v1::Endpoint* endpoint = fake_.coverage.add_endpoints();
    endpoint->set_guid(std::string(15, '\1') + "\3");
    endpoint->set_kind(kind);
    endpoint->set_name(name);
    endpoint->set_type("std_msgs/msg/String");
    endpoint->set_node(node);
    endpoint->set_visibility(visibility);
    endpoint->set_ros(true);
    return endpoint;
  }
  void Rule(const std::string& topic, v1::InterestRule::Depth depth, uint32_t bytes,
            const std::vector<std::string>& wanted_by) {
    v1::InterestRule* rule = fake_.interest.mutable_interest()->add_rules();
    rule->set_topic_regex(topic);
    rule->set_depth(depth);
    rule->set_payload_bytes_max(bytes);
    v1::InterestReason* reason = fake_.interest.add_reasons();
    for (const std::string& name : wanted_by) reason->add_wanted_by(name);
  }
  void Sensor(const std::string& host, bool connected, bool in_use, const std::string& problem) {
    v1::SensorInterest* sensor = fake_.interest.add_sensors();
    sensor->set_host(host);
    sensor->set_connected(connected);
    sensor->set_in_use(in_use);
    sensor->set_problem(problem);
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
  ObservingOperator fake_;
  std::unique_ptr<grpc::Server> server_;
  int port_ = 0;
};

TEST_F(RobotCoverageTest, ShowsWhatIsNeededAndWhoWatchesSo) {
  Rule("^\\/image$", v1::InterestRule::PAYLOAD, 65'536, {"blinded", "script\x1b[2J"});
  Rule("^\\/tf$", v1::InterestRule::NOTHING, 0, {});
  Rule("", v1::InterestRule::METADATA, 0, {"flood"});
  Sensor("arm", false, false, "");
  Sensor("base", true, true, "");
  Sensor("head", true, false, "");
  Sensor("tail", true, false, "rule 1: too large\n");
  const Result text = Run({"robot", "interest", "r1"});
  EXPECT_EQ(text.code, 0);
  EXPECT_EQ(fake_.asked, "r1");
  EXPECT_EQ(text.out,
            "DEPTH     BYTES  TOPIC          TYPE   WANTED BY\n"
            "payload   65536  ^\\/image$      (any)  blinded, script\\x1b[2J\n"
            "nothing   -      ^\\/tf$         (any)  -\n"
            "metadata  -      (every topic)  (any)  flood\n"
            "\n"
            "SENSOR  STATE\n"
            "arm     not connected\n"
            "base    in use\n"
            "head    not yet\n"
            "tail    refused: rule 1: too large\\x0a\n");

  const nlohmann::json json = RunJson({"robot", "interest", "r1"});
  EXPECT_EQ(json["robot"], "r1");
  ASSERT_THAT(json["rules"], SizeIs(3));
  EXPECT_EQ(json["rules"][0], nlohmann::json({{"depth", "payload"},
                                              {"bytes", 65'536},
                                              {"topic", "^\\/image$"},
                                              {"type", ""},
                                              {"wanted_by", {"blinded", "script\x1b[2J"}}}));
  EXPECT_EQ(json["sensors"][3], nlohmann::json({{"host", "tail"},
                                                {"connected", true},
                                                {"in_use", false},
                                                {"problem", "rule 1: too large\n"}}));
}

TEST_F(RobotCoverageTest, ReasonsThatAServerLeavesOutAreNone) {
  fake_.interest.mutable_interest()->add_rules();
  const Result text = Run({"robot", "interest", "r1"});
  EXPECT_THAT(text.out, HasSubstr("unknown  -      (every topic)  (any)  -\n"));
}

TEST_F(RobotCoverageTest, AllThatIsToBeSeenIsSeen) {
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 0) << "services are never read, by anybody";
  EXPECT_EQ(text.out,
            "SENSOR  PRIMARY  CONNECTED  SETTLED  OUTBOX  SPOOL  LOST IN 10 MIN  CLOCK SKEW  "
            "NOT VISIBLE\n"
            "base    yes      yes        yes      0 B     0 B    0               -           -\n"
            "\n"
            "ENDPOINTS    COUNT\n"
            "watched      1\n"
            "not needed   1\n"
            "not visible  0\n"
            "never read   2\n"
            "\n"
            "all is seen, and no finding stands\n");
  const nlohmann::json json = RunJson({"robot", "coverage", "r1"});
  EXPECT_EQ(json["complete"], true);
  EXPECT_EQ(json["sensors"][0]["clock_skew_ns"], nullptr);
  ASSERT_THAT(json["endpoints"], SizeIs(4));
  EXPECT_EQ(json["endpoints"][1]["state"], "not needed");
  EXPECT_EQ(json["endpoints"][2]["state"], "never read");
  EXPECT_EQ(json["endpoints"][2]["kind"], "service");
}

TEST_F(RobotCoverageTest, SensorsSayHowTheyFare) {
  v1::SensorCoverage* base = fake_.coverage.mutable_sensors(0);
  base->add_not_visible("unicast-only writers");
  base->add_not_visible("x\x1b[2J");
  base->mutable_state()->set_outbox_bytes(1'024);
  base->mutable_state()->set_spool_bytes(7);
  base->set_lost(12);
  base->set_clock_skew_ns(-1'500'000'000);
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 0) << "what a kind of sensor never sees is no fault of now";
  EXPECT_THAT(text.out,
              HasSubstr("1024 B  7 B    12              -1.500 s    unicast-only writers; "
                        "x\\x1b[2J\n"));
  const nlohmann::json json = RunJson({"robot", "coverage", "r1"})["sensors"][0];
  EXPECT_EQ(json["clock_skew_ns"], -1'500'000'000);
  EXPECT_EQ(json["lost"], 12);
  EXPECT_EQ(json["spool_bytes"], 7);
  EXPECT_EQ(json["not_visible"][0], "unicast-only writers");
}

TEST_F(RobotCoverageTest, WhatIsNotVisibleIsShownAndIsExitCodeOne) {
  Endpoint(v1::Endpoint::PUBLISHER, "/cmd_vel", "", v1::NOT_VISIBLE)->set_why("unicast\x1b[2J");
  Endpoint(v1::Endpoint::SUBSCRIBER, "/odom", "/nav", v1::VISIBILITY_UNSPECIFIED);
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 1);
  EXPECT_THAT(text.out, HasSubstr("not visible  2\n"));
  EXPECT_THAT(text.out, HasSubstr("\nNAME      KIND        NODE"));
  EXPECT_THAT(text.out, HasSubstr("not visible: unicast\\x1b[2J\n"));
  EXPECT_THAT(text.out, HasSubstr("/odom     subscriber  /nav"));
  EXPECT_THAT(text.out, Not(HasSubstr("/chatter")));
  EXPECT_THAT(Run({"robot", "coverage", "r1", "--all"}).out, HasSubstr("/chatter"));
  const nlohmann::json json = RunJson({"robot", "coverage", "r1"}, 1);
  EXPECT_EQ(json["complete"], false);
  EXPECT_EQ(json["endpoints"][4]["state"], "not visible");
  EXPECT_EQ(json["endpoints"][4]["why"], "unicast\x1b[2J");
}

TEST_F(RobotCoverageTest, WhatBlindsIsSaidFirstAndIsExitCodeOne) {
  fake_.coverage.add_blind(
      "sensor base sees no ROS node on domain 7; are dds.domain and dds.interface right?");
  fake_.coverage.add_blind("sensor base: ids log /l\x1b[2J: permission denied");
  fake_.coverage.mutable_sensors(0)->mutable_state()->add_blind("ids log /l: permission denied");
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 1);
  EXPECT_THAT(text.out,
              testing::StartsWith("BLIND: sensor base sees no ROS node on domain 7; are dds.domain "
                                  "and dds.interface right?\n"
                                  "BLIND: sensor base: ids log /l\\x1b[2J: permission denied\n"
                                  "\n"
                                  "SENSOR  PRIMARY"));
  const nlohmann::json json = RunJson({"robot", "coverage", "r1"}, 1);
  EXPECT_EQ(json["complete"], false);
  ASSERT_THAT(json["blind"], SizeIs(2));
  EXPECT_EQ(json["blind"][0],
            "sensor base sees no ROS node on domain 7; are dds.domain and dds.interface right?");
  EXPECT_EQ(json["sensors"][0]["blind"][0], "ids log /l: permission denied");
}

TEST_F(RobotCoverageTest, ASecondSensorThatIsAwayIsExitCodeOne) {
  v1::SensorCoverage* arm = fake_.coverage.add_sensors();
  arm->set_host("arm");
  EXPECT_EQ(Run({"robot", "coverage", "r1"}).code, 1);
  arm->set_connected(true);
  EXPECT_EQ(Run({"robot", "coverage", "r1"}).code, 0);
}

TEST_F(RobotCoverageTest, FindingsAreExitCodeOne) {
  v1::Finding* finding = fake_.coverage.add_findings();
  finding->set_kind("duplicate_node");
  finding->set_node("/talker");
  finding->set_detail("two of them\x1b[2J");
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 1);
  EXPECT_THAT(text.out, HasSubstr("FINDING         NODE     TOPIC  DETAIL\n"
                                  "duplicate_node  /talker  -      two of them\\x1b[2J\n"));
  EXPECT_EQ(RunJson({"robot", "coverage", "r1"}, 1)["findings"][0]["kind"], "duplicate_node");
}

TEST_F(RobotCoverageTest, AnOlderServerDoesNotSayThatAllFindingsAreKnown) {
  fake_.coverage.clear_findings_now();
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 1);
  EXPECT_THAT(text.out,
              HasSubstr("\nnot all findings are known: the policy server does not say; it "
                        "is older\n"));
}

TEST_F(RobotCoverageTest, SaysWhyNotAllFindingsAreKnown) {
  EXPECT_THAT(Run({"robot", "coverage", "r1"}).out, Not(HasSubstr("findings")));
  fake_.coverage.mutable_findings_now()->add_not_known("sensor base has \x1b connected");
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 1) << "one may stand";
  EXPECT_THAT(text.out,
              HasSubstr("\nNOT all is seen, or a finding stands or may stand: see above\n"));
  EXPECT_THAT(text.out,
              HasSubstr("\nnot all findings are known: sensor base has \\x1b connected\n"));
  EXPECT_THAT(RunJson({"robot", "coverage", "r1"}, 1)["findings_not_known_because"], SizeIs(1));
}

TEST_F(RobotCoverageTest, PayloadsThatAreCutAreExitCodeOne) {
  v1::CutPayloads* cut = fake_.coverage.add_cut_payloads();
  cut->set_topic("/camera\x1b[2J");
  cut->set_limit_bytes(1 << 20);
  cut->set_longest_bytes(2'764'860);
  cut->set_count(17);
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 1);
  EXPECT_THAT(text.out, HasSubstr("PAYLOADS CUT    LIMIT      LONGEST    MESSAGES\n"
                                  "/camera\\x1b[2J  1048576 B  2764860 B  17\n"));
  const nlohmann::json json = RunJson({"robot", "coverage", "r1"}, 1);
  EXPECT_EQ(json["complete"], false);
  EXPECT_EQ(json["cut_payloads"][0], nlohmann::json({{"topic", "/camera\x1b[2J"},
                                                     {"limit_bytes", 1 << 20},
                                                     {"longest_bytes", 2'764'860},
                                                     {"count", 17}}));
}

TEST_F(RobotCoverageTest, PayloadLimitsAreShownWithTheInterest) {
  Rule("", v1::InterestRule::PAYLOAD, 1 << 20, {"blinded"});
  v1::PayloadLimit* limit = fake_.interest.mutable_interest()->add_payload_limits();
  limit->set_topic_regex("^/camera/");
  limit->set_bytes(2 << 20);
  EXPECT_THAT(Run({"robot", "interest", "r1"}).out, HasSubstr("PAYLOAD LIMIT  TOPIC\n"
                                                              "2097152        ^/camera/\n"));
  const nlohmann::json json = RunJson({"robot", "interest", "r1"});
  EXPECT_EQ(json["payload_limits"][0],
            nlohmann::json({{"topic", "^/camera/"}, {"bytes", 2 << 20}}));
}

TEST_F(RobotCoverageTest, AGraphThatIsNotWholeIsExitCodeOne) {
  fake_.coverage.set_graph_truncated(true);
  const Result text = Run({"robot", "coverage", "r1"});
  EXPECT_EQ(text.code, 1);
  EXPECT_THAT(text.out, HasSubstr("a part of it is missing"));
  fake_.coverage.set_graph_truncated(false);
  EXPECT_EQ(Run({"robot", "coverage", "r1"}).code, 0);
  fake_.coverage.mutable_sensors(0)->set_settled(false);
  EXPECT_EQ(Run({"robot", "coverage", "r1"}).code, 1);
  fake_.coverage.mutable_sensors(0)->set_settled(true);
  fake_.coverage.mutable_sensors(0)->set_connected(false);
  EXPECT_EQ(Run({"robot", "coverage", "r1"}).code, 1);
  fake_.coverage.clear_sensors();
  EXPECT_EQ(Run({"robot", "coverage", "r1"}).code, 1);
}

TEST_F(RobotCoverageTest, RefusalsAndWrongFlags) {
  fake_.failure = grpc::Status(grpc::StatusCode::NOT_FOUND, "no such robot");
  for (const char* verb : {"interest", "coverage"}) {
    const Result result = Run({"robot", verb, "r1"});
    EXPECT_EQ(result.code, 1);
    EXPECT_EQ(result.err, "error: no such robot\n");
    EXPECT_EQ(Run({"robot", verb}).code, 2);
    EXPECT_EQ(Run({"robot", verb, "R_1"}).code, 2);
  }
  EXPECT_EQ(Run({"robot", "interest", "r1", "--all"}).code, 2);
}

}  // namespace
}  // namespace rips::ripsctl
