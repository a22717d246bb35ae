#include "policy_server/server/operator_api/record_codec.h"

#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"
#include "services/model_proto/decision_id_codec.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;

// 32 digits.
std::string Id(const std::string& begin) { return begin + std::string(32 - begin.size(), '0'); }

engine::Trace TraceOf(const std::string& rule, int64_t time_ns) {
  engine::Trace trace{.place = rule + ".rul:1", .condition = "true", .event_unix_ns = time_ns};
  trace.subjects.push_back({.name = "/evil", .role = "publishes /cmd_vel", .host = "h", .pid = 7});
  return trace;
}

class ExplainTest : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_THAT(store_.Acquire("r1"), IsOk());
    store::WriteBatch batch{.robot = "r1", .tenure = 1};
    batch.decisions.push_back({.id = Id("aa0001"),
                               .decision_id = {1, 2},
                               .from = "DEFAULT",
                               .to = "HALT",
                               .cause = "rule stop",
                               .trace = TraceOf("stop", 5)});
    batch.decisions.push_back({.id = Id("aa0002"),
                               .decision_id = {1, 3},
                               .from = "HALT",
                               .to = "DEFAULT",
                               .cause = "operator ann",
                               .reason = "checked"});
    batch.refusals.push_back({.id = Id("aa0003"),
                              .from = "HALT",
                              .to = "DEFAULT",
                              .cause = "rule stop",
                              .trace = TraceOf("stop", 5)});
    for (const int64_t time_ns : {5, 6}) {
      batch.alerts.push_back({.id = Id(time_ns == 5 ? "bb0005" : "bb0006"),
                              .robot = "r1",
                              .rule = "stop",
                              .text = "second driver",
                              .trace = TraceOf("stop", time_ns)});
    }
    ASSERT_THAT(store_.Commit(batch), IsOk());
    store::WriteBatch other{.robot = "r2"};
    other.alerts.push_back({.id = Id("cc0001"), .robot = "r2", .rule = "(rips)"});
    ASSERT_THAT(store_.Commit(other), IsOk());
  }
  absl::StatusOr<rips::v1::ExplainResponse> ById(const std::string& id) {
    rips::v1::ExplainRequest request;
    request.set_id(id);
    return Explain(request, store_);
  }
  absl::StatusOr<rips::v1::ExplainResponse> ByDecisionId(const std::string& robot,
                                                         const DecisionId& decision_id) {
    rips::v1::ExplainRequest request;
    request.set_robot(robot);
    model_proto::Encode(decision_id, *request.mutable_decision_id());
    return Explain(request, store_);
  }

  store::FakeStore store_;
};

TEST_F(ExplainTest, AnAlertHasItsEvidenceAndWhatElseCameOfTheSameFiring) {
  const auto explained = ById("bb0005");
  ASSERT_THAT(explained, IsOk());
  EXPECT_EQ(explained->alert().id(), Id("bb0005"));
  EXPECT_FALSE(explained->has_transition());
  EXPECT_EQ(explained->evidence().place(), "stop.rul:1");
  ASSERT_EQ(explained->alert().subjects_size(), 1);
  EXPECT_EQ(explained->alert().subjects(0).name(), "/evil");
  EXPECT_EQ(explained->alert().subjects(0).guid(), "");
  EXPECT_EQ(explained->alerts_size(), 0) << "the other alert is of another firing";
  ASSERT_EQ(explained->transitions_size(), 2);
  EXPECT_EQ(explained->transitions(0).id(), Id("aa0001"));
  EXPECT_TRUE(explained->transitions(1).refused());
}

TEST_F(ExplainTest, ADecisionIsFoundByItsDecisionIdAndByItsId) {
  for (const auto& explained : {ById(Id("aa0001")), ByDecisionId("r1", {1, 2})}) {
    ASSERT_THAT(explained, IsOk());
    EXPECT_EQ(explained->transition().to(), "HALT");
    EXPECT_FALSE(explained->has_alert());
    EXPECT_EQ(explained->evidence().event_unix_ns(), 5);
    ASSERT_EQ(explained->alerts_size(), 1);
    EXPECT_EQ(explained->alerts(0).id(), Id("bb0005"));
    EXPECT_EQ(explained->transitions_size(), 1);
  }
}

TEST_F(ExplainTest, WhatNoRuleDidHasNoEvidence) {
  const auto operators = ByDecisionId("r1", {1, 3});
  ASSERT_THAT(operators, IsOk());
  EXPECT_FALSE(operators->has_evidence());
  EXPECT_EQ(operators->transition().reason(), "checked");
  EXPECT_EQ(operators->alerts_size() + operators->transitions_size(), 0);
  const auto own = ById("cc0001");
  ASSERT_THAT(own, IsOk());
  EXPECT_FALSE(own->has_evidence());
}

TEST_F(ExplainTest, OfAFindingTellsTheFirstRecordedEndAfterIt) {
  const model::Finding finding{.kind = "non_ros_reader", .guid = {{1, 2, 3}}, .topic = "/camera"};
  const auto alert = [&](const std::string& id, int64_t time_ns, bool over) {
    store::AlertRecord record{
        .id = Id(id), .time_unix_ns = time_ns, .robot = "r1", .rule = "(rips)"};
    record.trace.finding = finding;
    record.trace.finding.over = over;
    if (!over) record.trace.subjects = {{.name = "/camera", .guid = finding.guid, .host = "pc"}};
    return record;
  };
  store::WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.alerts = {alert("ee0001", 10, true), alert("ee0002", 20, false), alert("ee0003", 30, true),
                  alert("ee0004", 40, false), alert("ee0005", 50, true)};
  store::AlertRecord other = alert("ee0006", 60, false);
  other.trace.finding.topic = "/map";
  batch.alerts.push_back(other);
  batch.decisions.push_back({.id = Id("ee0007"),
                             .decision_id = {1, 4},
                             .from = "DEFAULT",
                             .to = "HALT",
                             .cause = "rule stop",
                             .time_unix_ns = 41,
                             .trace = TraceOf("stop", 7)});
  batch.decisions.back().trace.finding = finding;
  ASSERT_THAT(store_.Commit(batch), IsOk());

  const auto first = ById("ee0002");
  ASSERT_THAT(first, IsOk());
  EXPECT_FALSE(first->has_evidence()) << "no rule fired";
  EXPECT_EQ(first->alert().subjects(0).host(), "pc");
  EXPECT_EQ(first->finding().topic(), "/camera");
  EXPECT_EQ(first->finding().guid(), finding.guid.ToBytes());
  EXPECT_EQ(first->finding_ended_unix_ns(), 30);
  EXPECT_EQ(ById("ee0004")->finding_ended_unix_ns(), 50);
  EXPECT_EQ(ById("ee0005")->finding_ended_unix_ns(), 50) << "it is the end";
  EXPECT_EQ(ById("ee0006")->finding_ended_unix_ns(), 0) << "the ends are of another one";
  const auto decision = ByDecisionId("r1", {1, 4});
  ASSERT_THAT(decision, IsOk());
  EXPECT_TRUE(decision->has_evidence());
  EXPECT_EQ(decision->finding_ended_unix_ns(), 50);
  EXPECT_FALSE(ById("bb0005")->has_finding());
}

TEST_F(ExplainTest, SaysWhatIsNotThereOrNotOne) {
  using absl::StatusCode;
  EXPECT_THAT(ById("dd0001"), StatusIs(StatusCode::kNotFound, HasSubstr("dd0001")));
  EXPECT_THAT(ById("aa000"), StatusIs(StatusCode::kInvalidArgument, HasSubstr("6")));
  EXPECT_THAT(ById("AA0001"), StatusIs(StatusCode::kInvalidArgument));
  EXPECT_THAT(ById(Id("aa0001") + "0"), StatusIs(StatusCode::kInvalidArgument));
  EXPECT_THAT(ByDecisionId("r1", {1, 9}), StatusIs(StatusCode::kNotFound, HasSubstr("1.9")));
  EXPECT_THAT(ByDecisionId("r9", {1, 2}), StatusIs(StatusCode::kNotFound));
  EXPECT_THAT(ByDecisionId("", {1, 2}), StatusIs(StatusCode::kInvalidArgument));
  store::WriteBatch twin{.robot = "r1", .tenure = 1};
  twin.alerts.push_back({.id = "aa0001" + std::string(26, 'f'), .robot = "r1", .rule = "x"});
  ASSERT_THAT(store_.Commit(twin), IsOk());
  EXPECT_THAT(ById("aa0001"), StatusIs(StatusCode::kInvalidArgument, HasSubstr("more digits")));
  store_.FailReads(absl::UnavailableError("busy"));
  EXPECT_THAT(ById("bb0005"), StatusIs(StatusCode::kUnavailable));
}

TEST_F(ExplainTest, AnIdAndARobotAreTwoQuestions) {
  rips::v1::ExplainRequest request;
  EXPECT_THAT(Explain(request, store_), StatusIs(absl::StatusCode::kInvalidArgument));
  request.set_id("aa0001");
  request.set_robot("r1");
  EXPECT_THAT(Explain(request, store_), StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::operator_api
