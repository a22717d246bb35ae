#include "sensor_agent/ids/alert_parser.h"

#include <fstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

std::vector<std::string> LinesOf(const std::string& name) {
  std::ifstream file(absl::StrCat(RIPS_SOURCE_DIR, "/sensor_agent/ids/testdata/", name));
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  EXPECT_THAT(lines, testing::Not(IsEmpty())) << name;
  return lines;
}

std::vector<IdsAlert> AlertsOf(IdsFormat format, const std::string& name) {
  std::vector<IdsAlert> alerts;
  for (const std::string& line : LinesOf(name)) {
    IdsLine parsed = ParseIdsLine(format, line);
    EXPECT_NE(parsed.kind, IdsLineKind::kNotUnderstood) << line;
    if (parsed.kind == IdsLineKind::kAlert) alerts.push_back(std::move(parsed.alert));
  }
  return alerts;
}

// `GID:SID:REV MESSAGE PRIORITY SRC DST`
std::string Text(const IdsAlert& alert) {
  return absl::StrCat(alert.source, " ", alert.gid, ":", alert.sid, ":", alert.rev, " ",
                      alert.message, " p", alert.severity, " ", alert.src, " ", alert.dst);
}

std::string Text(IdsFormat format, absl::string_view line) {
  const IdsLine parsed = ParseIdsLine(format, line);
  switch (parsed.kind) {
    case IdsLineKind::kAlert:
      return Text(parsed.alert);
    case IdsLineKind::kOther:
      return "other";
    case IdsLineKind::kNotUnderstood:
      break;
  }
  return "not understood";
}

// --- What a real Suricata 7.0.10 wrote of one recording

TEST(AlertParserTest, BothFormatsOfSuricataSayTheSame) {
  const std::vector<IdsAlert> fast = AlertsOf(IdsFormat::kFast, "suricata7_fast.log");
  const std::vector<IdsAlert> eve = AlertsOf(IdsFormat::kEve, "suricata7_eve.json");
  ASSERT_THAT(fast, SizeIs(7));
  ASSERT_THAT(eve, SizeIs(7));
  for (size_t i = 0; i < fast.size(); ++i) {
    IdsAlert without_line = fast[i];
    without_line.line.clear();
    EXPECT_EQ(Text(without_line), Text(eve[i]));
  }
  EXPECT_EQ(Text(eve[0]),
            "suricata 1:1000002:1 RIPS SPDP announcement p3 10.99.0.12:57152 239.255.0.1:7400");
  EXPECT_EQ(Text(fast[3]), "suricata 1:1000003:1 RIPS port sweep p2 10.99.0.12:38418 10.99.0.1:80");
  EXPECT_EQ(fast[3].line, LinesOf("suricata7_fast.log")[3]);
  EXPECT_THAT(eve[3].line, IsEmpty());
}

TEST(AlertParserTest, OtherEventsOfEveAreNoAlerts) {
  int other = 0;
  for (const std::string& line : LinesOf("suricata7_eve.json")) {
    other += ParseIdsLine(IdsFormat::kEve, line).kind == IdsLineKind::kOther;
  }
  EXPECT_EQ(other, 17);
}

// --- fast

constexpr char kSnort2[] =
    "11/21-10:11:12.123456  [**] [1:2001:3] ET SCAN port sweep [**] [Classification: Attempted "
    "Information Leak] [Priority: 2] {TCP} 10.0.0.9:4444 -> 10.0.0.1:80";

TEST(FastAlertTest, EveryFieldOfSnort2) {
  const std::optional<IdsAlert> alert = ParseFastAlert(kSnort2);
  ASSERT_TRUE(alert.has_value());
  EXPECT_EQ(*alert, (IdsAlert{.source = "snort",
                              .gid = 1,
                              .sid = 2001,
                              .rev = 3,
                              .message = "ET SCAN port sweep",
                              .severity = 2,
                              .src = "10.0.0.9:4444",
                              .dst = "10.0.0.1:80",
                              .line = kSnort2}));
}

struct FastCase {
  const char* name;
  const char* line;
  const char* text;
};

class FastFormsTest : public testing::TestWithParam<FastCase> {};

TEST_P(FastFormsTest, AreRead) {
  EXPECT_EQ(Text(IdsFormat::kFast, GetParam().line), GetParam().text);
}

INSTANTIATE_TEST_SUITE_P(
    All, FastFormsTest,
    testing::Values(
        FastCase{
            "Snort3Quotes",
            "11/21-10:11:12.123456 [**] [1:7:2] \"a \"quoted\" word\" [**] [Classification: x] "
            "[Priority: 1] {UDP} 10.0.0.9:5 -> 10.0.0.1:6",
            "snort 1:7:2 a \"quoted\" word p1 10.0.0.9:5 10.0.0.1:6"},
        FastCase{"Snort3InterfaceAppIdAndVerdict",
                 "11/21-10:11:12.123456 <eth0> [block] [**] [116:408:1] \"(ipv4) bad\" [**] "
                 "[Priority: 3] [AppID: HTTP] {TCP} 10.0.0.9:5 -> 10.0.0.1:6",
                 "snort 116:408:1 (ipv4) bad p3 10.0.0.9:5 10.0.0.1:6"},
        FastCase{"SnortWithYear",
                 "11/21/26-10:11:12.123456  [**] [1:7:2] m [**] [Priority: 1] {UDP} 10.0.0.9:5 -> "
                 "10.0.0.1:6",
                 "snort 1:7:2 m p1 10.0.0.9:5 10.0.0.1:6"},
        FastCase{"SuricataDrop",
                 "11/21/2026-10:11:12.123456  [Drop] [**] [1:7:2] m [**] [Classification: (null)] "
                 "[Priority: 3] {TCP} 10.0.0.9:5 -> 10.0.0.1:6",
                 "suricata 1:7:2 m p3 10.0.0.9:5 10.0.0.1:6"},
        FastCase{"IcmpOfSnortHasNoPorts",
                 "11/21-10:11:12.123456  [**] [1:7:2] m [**] [Priority: 1] {ICMP} 10.0.0.9 -> "
                 "10.0.0.1",
                 "snort 1:7:2 m p1 10.0.0.9 10.0.0.1"},
        FastCase{"IcmpOfSuricataHasTypeAndCode",
                 "11/21/2026-10:11:12.123456  [**] [1:7:2] m [**] [Classification: (null)] "
                 "[Priority: 3] {ICMP} 10.0.0.9:8 -> 10.0.0.1:0",
                 "suricata 1:7:2 m p3 10.0.0.9:8 10.0.0.1"},
        FastCase{"Icmp6WithoutPorts",
                 "11/21-10:11:12.123456  [**] [1:7:2] m [**] [Priority: 1] {IPV6-ICMP} fe80::1 -> "
                 "ff02::1",
                 "snort 1:7:2 m p1 fe80::1 ff02::1"},
        FastCase{"Icmp6OfSuricata",
                 "11/21/2026-10:11:12.123456  [**] [1:7:2] m [**] [Classification: (null)] "
                 "[Priority: 3] {IPv6-ICMP} fe80:0000:0000:0000:0000:0000:0000:0001:128 -> "
                 "ff02:0000:0000:0000:0000:0000:0000:0001:0",
                 "suricata 1:7:2 m p3 [fe80:0000:0000:0000:0000:0000:0000:0001]:128 "
                 "ff02:0000:0000:0000:0000:0000:0000:0001"},
        FastCase{"Ipv6SplitsAtTheLastColon",
                 "11/21-10:11:12.123456  [**] [1:7:2] m [**] [Priority: 1] {UDP} fe80::1:7400 -> "
                 "ff02::1:80",
                 "snort 1:7:2 m p1 [fe80::1]:7400 [ff02::1]:80"},
        FastCase{
            "MarksInTheMessage",
            "11/21-10:11:12.123456  [**] [1:7:2] a [**] [1:8:9] b {TCP} 1 -> 2 [**] [Priority: "
            "1] {UDP} 10.0.0.9:5 -> 10.0.0.1:6",
            "snort 1:7:2 a [**] [1:8:9] b {TCP} 1 -> 2 p1 10.0.0.9:5 10.0.0.1:6"},
        FastCase{"NoAddresses", "11/21-10:11:12.123456  [**] [1:7:2] m [**] [Priority: 4]",
                 "snort 1:7:2 m p4  "},
        FastCase{"NothingBehindTheMessage", "11/21-10:11:12.123456  [**] [1:7:2] m [**]",
                 "snort 1:7:2 m p0  "},
        FastCase{"AddressesThatAreNone",
                 "11/21-10:11:12.123456  [**] [1:7:2] m [**] [Priority: 1] {TCP} \x1b[31m:5 -> "
                 "10.0.0.1:66000",
                 "snort 1:7:2 m p1  "},
        FastCase{"NotUtf8InTheMessage", "11/21-10:11:12.1  [**] [1:7:2] \xFFm\xC3\xA4 [**]",
                 "snort 1:7:2 \xEF\xBF\xBDm\xC3\xA4 p0  "}),
    [](const auto& param) { return param.param.name; });

TEST(FastAlertTest, LinesThatAreNoneAreNotUnderstood) {
  for (const char* line :
       {"[**] [1:7:2] m [**]", "Nov 21 10:11:12 host snort[1]: [1:7:2] m", "11/21-10:11:12.123456",
        "11/21-10:11:12.1  [**] [1:7] m [**]", "11/21-10:11:12.1  [**] [1:7:-2] m [**]",
        "11/21-10:11:12.1  [**] [1: 7:2] m [**]", "11/21-10:11:12.1  [**] [1:7:2] m",
        "11/21-10:11:12.1  [**] [1:99999999999:2] m [**]", "11-10:11:12.1  [**] [1:7:2] m [**]",
        "a/b-10:11:12.1  [**] [1:7:2] m [**]", "/-: [**] [1:7:2] m [**]", "\xFF\xFE", "{}"}) {
    EXPECT_EQ(Text(IdsFormat::kFast, line), "not understood") << line;
  }
  EXPECT_EQ(Text(IdsFormat::kFast, ""), "other");
  EXPECT_EQ(Text(IdsFormat::kFast, " \t"), "other");
}

TEST(FastAlertTest, CutAnywhereItIsNoOtherAlert) {
  const std::string line = kSnort2;
  for (size_t cut = 0; cut < line.size(); ++cut) {
    const std::optional<IdsAlert> alert = ParseFastAlert(line.substr(0, cut));
    if (!alert.has_value()) continue;
    EXPECT_EQ(alert->sid, 2001) << cut;
    EXPECT_EQ(alert->message, "ET SCAN port sweep") << cut;
  }
}

TEST(FastAlertTest, NothingHidesBehindANul) {
  std::string line = "11/21-10:11:12.1  [**] [1:7:2] m [**] {ICMP} fe80::1 -> ff02::1";
  line.append(200, '\0');
  EXPECT_EQ(Text(IdsFormat::kFast, line), "snort 1:7:2 m p0 fe80::1 ");
}

TEST(FastAlertTest, LongTextIsCut) {
  const std::string message(kIdsMessageBytesMax + 1, 'm');
  const std::string line =
      absl::StrCat("11/21-10:11:12.1  [**] [1:7:2] ", message, std::string(kIdsLineBytesMax, ' '),
                   "[**] [Priority: 1] {UDP} 10.0.0.9:5 -> 10.0.0.1:6");
  const std::optional<IdsAlert> alert = ParseFastAlert(line);
  ASSERT_TRUE(alert.has_value());
  EXPECT_EQ(alert->message, message.substr(1));
  EXPECT_EQ(alert->line, line.substr(0, kIdsLineBytesMax));
  EXPECT_EQ(alert->dst, "10.0.0.1:6");
}

// --- EVE

constexpr char kEve[] =
    R"({"timestamp":"2026-11-20T16:33:49.657943+0000","event_type":"alert","src_ip":"10.0.0.9",)"
    R"("src_port":4444,"dest_ip":"fe80::1","dest_port":80,"proto":"TCP","alert":{"action":)"
    R"("allowed","gid":1,"signature_id":2001,"rev":3,"signature":"a \"b\" \u00e4","category":"",)"
    R"("severity":2,"metadata":{"gid":["x"],"sid":[1]}},"http":{"hostname":"h"}})";

TEST(EveTest, EveryField) {
  EXPECT_EQ(Text(IdsFormat::kEve, kEve),
            "suricata 1:2001:3 a \"b\" \xC3\xA4 p2 10.0.0.9:4444 [fe80::1]:80");
}

TEST(EveTest, OnlyTheTypeOfTheEventItself) {
  EXPECT_EQ(
      Text(IdsFormat::kEve,
           R"({"event_type":"http","http":{"event_type":"alert"},"alert":{"signature_id":1}})"),
      "other");
  EXPECT_EQ(
      Text(IdsFormat::kEve, R"({"http":{"url":"\"event_type\":\"alert\""},"event_type":"x"})"),
      "other");
  EXPECT_EQ(Text(IdsFormat::kEve, R"({"event_type" : "alert", "alert": {"signature_id": 5}})"),
            "suricata 0:5:0  p0  ");
}

TEST(EveTest, WhatIsBrokenIsNotUnderstood) {
  const std::string line = kEve;
  for (size_t cut = 0; cut < line.size(); ++cut) {
    EXPECT_EQ(ParseIdsLine(IdsFormat::kEve, line.substr(0, cut)).kind,
              cut <= line.find("\"alert\"") + 6 ? IdsLineKind::kOther : IdsLineKind::kNotUnderstood)
        << cut;
  }
  for (const auto& [from, to] :
       std::vector<std::pair<std::string, std::string>>{{"2001", "-2001"},
                                                        {"2001", "2001e3"},
                                                        {"2001", "4294967296"},
                                                        {"2001", "[2001]"},
                                                        {"2001", "\"x\""},
                                                        {"signature_id", "id"},
                                                        {"\"gid\":1,", "\"gid\":1,,"},
                                                        {"}}", "}}}"},
                                                        {"{\"time", "[\"time"}}) {
    EXPECT_EQ(Text(IdsFormat::kEve, absl::StrReplaceAll(line, {{from, to}})), "not understood")
        << from << " -> " << to;
  }
  EXPECT_EQ(Text(IdsFormat::kEve, "11/21-10:11:12.1 [**] [1:7:2] m [**]"), "not understood");
}

TEST(EveTest, HostileDepthSizeAndBytesDoNoHarm) {
  const std::string deep(500'000, '[');
  EXPECT_EQ(Text(IdsFormat::kEve, absl::StrCat(R"({"event_type":"alert","x":)", deep)),
            "not understood");
  std::string objects;
  for (int i = 0; i < 100'000; ++i) absl::StrAppend(&objects, R"({"alert":)");
  EXPECT_EQ(Text(IdsFormat::kEve, absl::StrCat(R"({"event_type":"alert","x":)", objects, "1",
                                               std::string(100'000, '}'), "}")),
            "not understood");
  // JSON allows no other bytes; the alert counts all the same.
  EXPECT_EQ(Text(IdsFormat::kEve, absl::StrReplaceAll(kEve, {{"\\u00e4", "\xFF\xC0\x80"}})),
            "suricata 1:2001:3 a \"b\" \xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD p2 10.0.0.9:4444 "
            "[fe80::1]:80");
}

// --- Snort 3 JSON

constexpr char kSnort3Json[] =
    R"({ "timestamp" : "11/21-10:11:12.123456", "msg" : "port sweep", "priority" : 2, "proto" : )"
    R"("TCP", "gid" : 1, "sid" : 2001, "rev" : 3, "src_addr" : "10.0.0.9", "src_port" : 4444, )"
    R"("dst_addr" : "fe80::1", "dst_port" : 80 })";

TEST(Snort3JsonTest, EveryField) {
  EXPECT_EQ(Text(IdsFormat::kSnort3Json, kSnort3Json),
            "snort 1:2001:3 port sweep p2 10.0.0.9:4444 [fe80::1]:80");
  EXPECT_FALSE(ParseSnort3JsonLine(kSnort3Json).lacks_fields);
}

TEST(Snort3JsonTest, TheDefaultFieldsLackTheMessage) {
  const IdsLine line = ParseSnort3JsonLine(
      R"({ "timestamp" : "11/21-10:11:12.123456", "pkt_num" : 7, "proto" : "UDP", "pkt_gen" : )"
      R"("raw", "pkt_len" : 60, "dir" : "C2S", "src_ap" : "fe80::1:4444", "dst_ap" : )"
      R"("10.0.0.1:0", "rule" : "1:2001:3", "action" : "allow" })");
  EXPECT_TRUE(line.lacks_fields);
  ASSERT_EQ(line.kind, IdsLineKind::kAlert);
  EXPECT_EQ(Text(line.alert), "snort 1:2001:3  p0 [fe80::1]:4444 10.0.0.1");
}

TEST(Snort3JsonTest, WithoutMessageAndSignatureItIsNone) {
  const IdsLine line = ParseSnort3JsonLine(R"({ "timestamp" : "11/21", "action" : "allow" })");
  EXPECT_EQ(line.kind, IdsLineKind::kNotUnderstood);
  EXPECT_TRUE(line.lacks_fields);
  const IdsLine only_message = ParseSnort3JsonLine(R"({"msg":"m"})");
  EXPECT_EQ(only_message.kind, IdsLineKind::kAlert);
  EXPECT_TRUE(only_message.lacks_fields);
}

TEST(Snort3JsonTest, CutAnywhereItIsNotUnderstood) {
  const std::string line = kSnort3Json;
  for (size_t cut = 1; cut < line.size(); ++cut) {
    EXPECT_EQ(ParseIdsLine(IdsFormat::kSnort3Json, line.substr(0, cut)).kind,
              IdsLineKind::kNotUnderstood)
        << cut;
  }
}

// --- Parts

TEST(Utf8OnlyTest, KeepsCharactersAndReplacesTheRest) {
  EXPECT_EQ(Utf8Only("a\xC3\xA4\xE2\x82\xAC\xF0\x9F\xA4\x96", 100),
            "a\xC3\xA4\xE2\x82\xAC\xF0\x9F\xA4\x96");
  for (const char* bad : {"\x80", "\xC0", "\xC3", "\xC1\x81", "\xE0\x80\x80", "\xED\xA0\x80",
                          "\xF0\x80\x80\x80", "\xF4\x90\x80\x80", "\xF5\x80\x80\x80", "\xE2\x82"}) {
    std::string expected;
    for (size_t i = 0; i < std::string(bad).size(); ++i) expected += "\xEF\xBF\xBD";
    EXPECT_EQ(Utf8Only(bad, 100), expected) << testing::PrintToString(std::string(bad));
  }
}

TEST(Utf8OnlyTest, CutsBetweenCharacters) {
  EXPECT_EQ(Utf8Only("a\xC3\xA4", 3), "a\xC3\xA4");
  EXPECT_EQ(Utf8Only("a\xC3\xA4", 2), "a");
  EXPECT_EQ(Utf8Only("a\xFF", 3), "a");
  EXPECT_EQ(Utf8Only("abc", 0), "");
}

TEST(IdsEndpointTest, Forms) {
  EXPECT_EQ(IdsEndpoint("10.0.0.1", ""), "10.0.0.1");
  EXPECT_EQ(IdsEndpoint("10.0.0.1", "0"), "10.0.0.1");
  EXPECT_EQ(IdsEndpoint("10.0.0.1", "65535"), "10.0.0.1:65535");
  EXPECT_EQ(IdsEndpoint("10.0.0.1", "65536"), "");
  EXPECT_EQ(IdsEndpoint("10.0.0.1", "x"), "");
  EXPECT_EQ(IdsEndpoint("::1", "5"), "[::1]:5");
  EXPECT_EQ(IdsEndpoint("host", "5"), "");
  EXPECT_EQ(IdsEndpoint("", ""), "");
  EXPECT_EQ(IdsEndpoint(absl::string_view("::1\0x", 5), ""), "");
  EXPECT_EQ(IdsEndpoint(std::string(1'000, '1'), ""), "");
}

}  // namespace
}  // namespace rips::sensor
