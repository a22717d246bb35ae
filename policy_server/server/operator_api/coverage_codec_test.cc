#include "policy_server/server/operator_api/coverage_codec.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/operator_api/answer_limits.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/robot/told_findings.h"

namespace rips::operator_api {
namespace {

using pipeline::FindingSeen;
using pipeline::Lane;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class CoverageCodecTest : public pipeline::RobotTest {
 protected:
  // Of a participant that the graph shows.
  static FindingSeen Reader(const std::string& topic) {
    return {.kind = "non_ros_reader",
            .guid = Participant(7),
            .topic = topic,
            .detail = "reads without a node"};
  }
  void Report(FindingSeen finding) { SendBatch(Lane::kControl, {{.what = std::move(finding)}}); }
  void ShowParticipant() {
    ros2::GraphDelta delta;
    delta.upsert_participants = {
        {.guid = Participant(7), .host = "lab-pc", .pid = 4'711, .address = "10.0.0.66"}};
    SendDelta(std::move(delta));
  }
  rips::v1::GetCoverageResponse Ask(const rips::v1::GetCoverageRequest& request) const {
    rips::v1::GetCoverageResponse response;
    EncodeCoverage(*robot_, request, response);
    return response;
  }
};

TEST_F(CoverageCodecTest, InBriefSaysWhatStandsOfWhomAndWhatIsNotKnown) {
  Start();
  rips::v1::GetCoverageRequest request;
  request.set_findings_only(true);
  EXPECT_THAT(Ask(request).findings_now().not_known(), ElementsAre("sensor base is not connected"));
  Arm();
  ShowParticipant();
  for (int i = 0; i < 40; ++i) Report(Reader(absl::StrCat("/t", i)));
  const rips::v1::GetCoverageResponse brief = Ask(request);
  EXPECT_EQ(brief.sensors_size() + brief.endpoints_size() + brief.findings_size(), 0);
  EXPECT_FALSE(brief.has_finding_state()) << "none was asked for";
  const rips::v1::FindingsNow& now = brief.findings_now();
  EXPECT_EQ(now.total(), 40u);
  ASSERT_EQ(now.kinds_size(), 1);
  EXPECT_EQ(now.kinds(0).kind(), "non_ros_reader");
  EXPECT_EQ(now.kinds(0).count(), 40u);
  ASSERT_EQ(now.newest_size(), 5);
  EXPECT_EQ(now.newest(0).finding().topic(), "/t39");
  EXPECT_EQ(now.newest(0).finding().detail(), "reads without a node");
  EXPECT_EQ(now.newest(0).since_unix_ns(), clock_.Now().unix_ns);
  ASSERT_EQ(now.newest(0).subjects_size(), 1);
  EXPECT_EQ(now.newest(0).subjects(0).host(), "lab-pc");
  EXPECT_EQ(now.newest(0).subjects(0).pid(), 4'711u);
  EXPECT_EQ(now.newest(0).subjects(0).address(), "10.0.0.66");
  EXPECT_THAT(now.not_known(), ElementsAre(HasSubstr("has not said yet which findings stand")));

  request.set_findings_only(false);
  const rips::v1::GetCoverageResponse all = Ask(request);
  EXPECT_EQ(all.findings_size(), 40);
  EXPECT_EQ(all.findings_now().total(), 40u);
  EXPECT_EQ(all.sensors_size(), 1);
}

TEST_F(CoverageCodecTest, SaysOfAFindingWhetherItStands) {
  Start();
  Arm();
  Report(Reader("/map"));
  rips::v1::GetCoverageRequest request;
  request.set_findings_only(true);
  rips::v1::Finding& asked = *request.mutable_finding();
  asked.set_kind("non_ros_reader");
  asked.set_guid(Participant(7).ToBytes());
  asked.set_topic("/map");
  asked.set_detail("is not part of its name");
  EXPECT_EQ(Ask(request).finding_state().state(), "stands");
  EXPECT_EQ(Ask(request).finding_state().since_unix_ns(), clock_.Now().unix_ns);
  for (const char* guid : {"", "no GUID"}) {
    asked.set_guid(guid);
    EXPECT_EQ(Ask(request).finding_state().state(), "not known") << "another one";
    EXPECT_EQ(Ask(request).finding_state().not_known_size(), 1);
  }
  asked.set_guid(Participant(7).ToBytes());
  const int64_t ended = clock_.Now().unix_ns;
  FindingSeen over = Reader("/map");
  over.over = true;
  Report(over);
  Pass(1'000);
  SendBatch(Lane::kControl, {{.what = ToldFindings(*robot_)}});
  EXPECT_EQ(Ask(request).finding_state().state(), "ended");
  EXPECT_EQ(Ask(request).finding_state().ended_unix_ns(), ended);
  EXPECT_EQ(Ask(request).finding_state().not_known_size(), 0);
}

// All that a sensor may report, each as long as the wire lets it be.
TEST_F(CoverageCodecTest, AFloodFitsIntoTheAnswer) {
  Start();
  Arm();
  for (int i = 0; i < 5'000; ++i) {
    FindingSeen finding = Reader(absl::StrCat(i, std::string(500, 't')));
    finding.kind = absl::StrCat("k", i);
    finding.node = std::string(512, 'n');
    finding.detail = std::string(1'024, 'd');
    Report(std::move(finding));
  }
  rips::v1::GetCoverageRequest request;
  EXPECT_LE(Ask(request).ByteSizeLong(), kAnswerBytesMax);
  request.set_findings_only(true);
  const rips::v1::GetCoverageResponse brief = Ask(request);
  EXPECT_LT(brief.ByteSizeLong(), 16'000u);
  EXPECT_EQ(brief.findings_now().total(), 4'096u);
  ASSERT_EQ(brief.findings_now().kinds_size(), 1) << "kinds that are made up are one";
  EXPECT_EQ(brief.findings_now().kinds(0).kind(), "other");
}

TEST_F(CoverageCodecTest, AListedRobotHasTheNumberOfItsFindings) {
  Start();
  EXPECT_TRUE(EncodeListed(*robot_).has_findings());
  EXPECT_TRUE(EncodeListed(*robot_).findings_not_known());
  Arm();
  Report(Reader("/a"));
  Report(Reader("/b"));
  SendBatch(Lane::kControl, {{.what = ToldFindings(*robot_)}});
  const rips::v1::RobotStatus status = EncodeListed(*robot_);
  EXPECT_EQ(status.robot(), "r1");
  EXPECT_EQ(status.findings(), 2u);
  EXPECT_FALSE(status.findings_not_known());
}

}  // namespace
}  // namespace rips::operator_api
