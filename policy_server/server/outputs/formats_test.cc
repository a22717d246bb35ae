#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/outputs/gap.h"
#include "policy_server/server/outputs/ocsf_format.h"
#include "policy_server/server/outputs/syslog_format.h"
#include "policy_server/server/store/alert_log.h"
#include "services/text/utf8.h"

namespace rips::outputs {
namespace {

using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::StartsWith;

store::AlertRecord Sample() {
  return {.id = std::string(32, 'a'),
          .time_unix_ns = 1'767'225'600'123'456'789,
          .robot = "r1",
          .rule = "camera_guard",
          .severity = "high",
          .text = "a text",
          .level = "ALERT",
          .event = "graph change",
          .decision_id = {3, 17}};
}

// What no line of ours may hold.
bool HasControls(absl::string_view text) {
  for (size_t at = 0; at < text.size();) {
    const CodePoint point = DecodeCodePoint(text, at);
    if (!point.valid || IsControl(point.value)) return true;
    at += point.length;
  }
  return false;
}

TEST(SyslogFormatTest, IsAsTheRfcSays) {
  EXPECT_EQ(FormatSyslog(Sample(), "ps1.example", ""),
            "<83>1 2026-01-01T00:00:00.123456Z ps1.example rips - camera_guard "
            "[rips@32473 id=\"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa\" robot=\"r1\" "
            "rule=\"camera_guard\" severity=\"high\" level=\"ALERT\" decision=\"3.17\"] "
            "\xEF\xBB\xBFr1: high: a text (graph change)");
  EXPECT_THAT(FormatSyslog(Sample(), "", R"({"id":"a"})"),
              EndsWith("] \xEF\xBB\xBF{\"id\":\"a\"}"));
  store::AlertRecord marked = Sample();
  marked.maintenance = "in maintenance \"]";
  EXPECT_THAT(FormatSyslog(marked, "", ""),
              HasSubstr("decision=\"3.17\" maintenance=\"in maintenance \\\"\\]\"] "));
  EXPECT_EQ(FrameSyslog("\xEF\xBB\xBF"), "3 \xEF\xBB\xBF");
}

TEST(SyslogFormatTest, SeveritiesAreMapped) {
  const std::pair<const char*, const char*> expected[] = {{"critical", "<82>"}, {"high", "<83>"},
                                                          {"medium", "<84>"},   {"low", "<85>"},
                                                          {"info", "<86>"},     {"odd", "<86>"}};
  for (const auto& [severity, priority] : expected) {
    store::AlertRecord alert = Sample();
    alert.severity = severity;
    EXPECT_THAT(FormatSyslog(alert, "h", ""), StartsWith(priority));
  }
}

TEST(SyslogFormatTest, FieldsOfTheHeaderArePrintable) {
  store::AlertRecord alert = Sample();
  alert.rule = absl::StrCat("a b\n\xFF", std::string(100, 'x'));
  const std::string message = FormatSyslog(alert, "a host\x01", "");
  EXPECT_THAT(message, HasSubstr(absl::StrCat(" a_host_ rips - a_b__", std::string(27, 'x'),
                                              " [rips@32473 ")));
  alert.rule = "";
  EXPECT_THAT(FormatSyslog(alert, "", ""), HasSubstr("Z - rips - - [rips@"));
}

TEST(SyslogFormatTest, EveryByteIsHarmless) {
  for (int byte = 0; byte < 256; ++byte) {
    store::AlertRecord alert = Sample();
    const std::string odd = absl::StrCat("x", std::string(1, static_cast<char>(byte)), "y");
    alert.robot = alert.rule = alert.text = alert.level = alert.event = alert.severity = odd;
    const std::string message = FormatSyslog(alert, odd, "");
    EXPECT_FALSE(HasControls(message)) << byte;
    EXPECT_FALSE(HasControls(FormatSyslog(alert, odd, store::FormatAlertLine(alert)))) << byte;
  }
}

TEST(SyslogFormatTest, TextCannotEndAValueOrPoseAsAnEscape) {
  store::AlertRecord alert = Sample();
  alert.level = "\"] \\u000A \n";
  alert.text = "a\nb\\u000A\xE2\x80\xAE\xFF";
  const std::string message = FormatSyslog(alert, "h", "");
  EXPECT_THAT(message, HasSubstr(R"(level="\"\] \\\\u000A \\u000A" decision)"));
  EXPECT_THAT(message, HasSubstr("a\\u000Ab\\\\u000A\\u202E\xEF\xBF\xBD"));
}

TEST(SyslogFormatTest, LongTextsAreWhole) {
  store::AlertRecord alert = Sample();
  alert.text = std::string(size_t{16} << 10, '\x01');
  const std::string message = FormatSyslog(alert, "h", "");
  EXPECT_GT(message.size(), size_t{6 * 16} << 10);
  EXPECT_THAT(FrameSyslog(message), StartsWith(absl::StrCat(message.size(), " <83>1 ")));
}

TEST(OcsfFormatTest, IsADetectionFinding) {
  store::AlertRecord alert = Sample();
  alert.trace.subjects.push_back({.name = "/camera",
                                  .role = "sent the message",
                                  .guid = {},
                                  .host = "base",
                                  .pid = 7,
                                  .address = "10.0.0.66"});
  alert.trace.subjects.push_back({.name = "/odd", .role = "is not there", .guid = {}, .host = ""});
  const auto finding = nlohmann::json::parse(FormatOcsf(alert));
  EXPECT_EQ(finding["class_uid"], 2004);
  EXPECT_EQ(finding["type_uid"], 200401);
  EXPECT_EQ(finding["category_uid"], 2);
  EXPECT_EQ(finding["severity_id"], 4);
  EXPECT_EQ(finding["severity"], "High");
  EXPECT_EQ(finding["time"], 1'767'225'600'123);
  EXPECT_EQ(finding["metadata"]["version"], "1.1.0");
  EXPECT_EQ(finding["metadata"]["product"]["name"], "RIPS");
  EXPECT_EQ(finding["finding_info"]["uid"], alert.id);
  EXPECT_EQ(finding["finding_info"]["title"], "camera_guard");
  EXPECT_EQ(finding["finding_info"]["desc"], "a text");
  EXPECT_EQ(finding["resources"][0]["uid"], "r1");
  EXPECT_EQ(finding["evidences"][0]["process"]["pid"], 7);
  EXPECT_FALSE(finding["evidences"][1].contains("process"));
  EXPECT_EQ(finding["evidences"][0]["data"]["address"], "10.0.0.66");
  EXPECT_EQ(finding["unmapped"]["decision_id"], "3.17");
}

TEST(OcsfFormatTest, EverySeverityHasItsNumber) {
  const std::pair<const char*, int> expected[] = {{"info", 1}, {"low", 2},      {"medium", 3},
                                                  {"high", 4}, {"critical", 5}, {"odd", 0}};
  for (const auto& [severity, id] : expected) {
    store::AlertRecord alert = Sample();
    alert.severity = severity;
    EXPECT_EQ(nlohmann::json::parse(FormatOcsf(alert))["severity_id"], id);
  }
}

TEST(OcsfFormatTest, EveryByteGivesAsciiThatParses) {
  store::AlertRecord alert = Sample();
  for (int byte = 0; byte < 256; ++byte) {
    const std::string odd(1, static_cast<char>(byte));
    alert.robot = alert.rule = alert.level = alert.event = odd;
    alert.text += odd;
  }
  alert.text += std::string(size_t{16} << 10, '\xFF');
  const std::string text = FormatOcsf(alert);
  EXPECT_TRUE(nlohmann::json::parse(text, nullptr, false).is_object());
  for (const char c : text) ASSERT_TRUE(c >= 0x20 && c < 0x7F);
}

TEST(GapTest, TheSameGapHasTheSameId) {
  const Gap gap{.after = 4, .up_to = 40, .count = 12};
  const store::AlertRecord event = MakeGapEvent("siem", gap, 5);
  EXPECT_EQ(event.id.size(), 32u);
  EXPECT_EQ(event.id, MakeGapEvent("siem", gap, 6).id);
  EXPECT_NE(event.id, MakeGapEvent("pager", gap, 5).id);
  EXPECT_NE(event.id, MakeGapEvent("siem", {.after = 4, .up_to = 40, .count = 13}, 5).id);
  EXPECT_EQ(event.event, "gap");
  EXPECT_THAT(event.text, HasSubstr("12 alerts are missing here, of any robot and severity"));
  EXPECT_THAT(MakeGapEvent("siem", {.count = 1}, 5).text, HasSubstr("1 alert is missing"));
  EXPECT_THAT(MakeGapEvent("siem", {}, 5).text,
              HasSubstr("does not know the alert that was sent last"));
}

}  // namespace
}  // namespace rips::outputs
