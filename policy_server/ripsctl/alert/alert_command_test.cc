// `ripsctl alert list`, `ripsctl alert watch` and `ripsctl alert ack`.
#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

using ::testing::HasSubstr;

TEST_F(RipsctlTest, ListsAlertsWithHostileTextEscaped) {
  fake_.alert_text = "node \xe2\x80\xae\x1b[2J";
  const Result text = Run({"alert", "list"});
  EXPECT_EQ(text.code, 0);
  EXPECT_EQ(text.out,
            "TIME                      ROBOT  SEVERITY  LEVEL  RULE          ID        TEXT\n"
            "2026-01-01T00:00:00.000Z  r1     high      ALERT  unknown_node  22222222  node "
            "\\u202e\\x1b[2J\n");
  const Result raw = Run({"alert", "list", "r1", "--limit", "5", "--output", "json"});
  EXPECT_EQ(raw.out.find('\x1b'), std::string::npos);
  EXPECT_EQ(nlohmann::json::parse(raw.out)["alerts"][0],
            nlohmann::json({{"id", std::string(32, '2')},
                            {"time", "2026-01-01T00:00:00.000000000Z"},
                            {"robot", "r1"},
                            {"rule", "unknown_node"},
                            {"severity", "high"},
                            {"text", fake_.alert_text},
                            {"level", "ALERT"},
                            {"event", "graph change"},
                            {"decision_id", "3.16"},
                            {"maintenance", ""},
                            {"subjects", nlohmann::json::array()},
                            {"acknowledged", nullptr}}));
  EXPECT_THAT(fake_.calls(), testing::ElementsAre("ListAlerts  100", "ListAlerts r1 5"));
}

TEST_F(RipsctlTest, ListsTheAlertsOfTheServerByTheNameThatItShows) {
  Run({"alert", "list", "(server)"});
  EXPECT_THAT(fake_.calls(), testing::ElementsAre("ListAlerts (server) 100"));
  EXPECT_EQ(Run({"alert", "list", "(other)"}).code, 2);
}

TEST_F(RipsctlTest, WatchesAlerts) {
  EXPECT_EQ(Run({"alert", "watch"}).out,
            "2026-01-01T00:00:00.000Z  r1  high  ALERT  unknown_node: unknown node /intruder\n");
  EXPECT_EQ(RunJson({"alert", "watch", "r1"})["text"], "unknown node /intruder");
}

TEST_F(RipsctlTest, AWatchGoesOnAfterALostConnectionWithoutGapOrDuplicate) {
  const auto position = [](const std::string& cursor) {
    v1::Alert alert;
    alert.set_cursor(cursor);
    return alert;
  };
  const auto numbered = [](int n) {
    v1::Alert alert = MakeAlert(absl::StrCat("alert ", n));
    alert.set_cursor(absl::StrCat(n, "-abc"));
    return alert;
  };
  v1::Alert gap;
  gap.set_gap("forgotten \x1b[2J");
  const grpc::Status lost(grpc::StatusCode::UNAVAILABLE, "the server is stopping");
  fake_.alert_watches = {{{position("0"), numbered(1), numbered(2)}, lost},
                         {{}, lost},
                         {{position("2-abc")}, lost},
                         {{position("2-abc"), gap, numbered(9)}, grpc::Status::OK}};
  const Result watch = Run({"alert", "watch", "--after", "0"});
  EXPECT_EQ(watch.code, 0) << watch.err;
  EXPECT_THAT(watch.out,
              AllOf(HasSubstr("alert 1\n"), HasSubstr("alert 2\n"), HasSubstr("alert 9\n")));
  EXPECT_EQ(std::count(watch.out.begin(), watch.out.end(), '\n'), 3);
  EXPECT_THAT(watch.err, AllOf(HasSubstr("the connection is lost (the server is stopping)"),
                               HasSubstr("note: forgotten \\x1b[2J")));
  EXPECT_THAT(fake_.calls(),
              testing::ElementsAre("WatchAlerts after 0", "WatchAlerts after 2-abc",
                                   "WatchAlerts after 2-abc", "WatchAlerts after 2-abc"));
}

TEST_F(RipsctlTest, AWatchThatIsRefusedEnds) {
  fake_.alert_watches = {
      {{}, grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "`x` is not a cursor")}};
  const Result watch = Run({"alert", "watch", "--after", "x"});
  EXPECT_EQ(watch.code, 1);
  EXPECT_EQ(watch.err, "error: `x` is not a cursor\n");
  fake_.alert_watches = {{{}, grpc::Status(grpc::StatusCode::UNAVAILABLE, "nobody there")}};
  EXPECT_EQ(Run({"alert", "watch"}).code, 3) << "never connected";
}

v1::Acknowledgement MakeAck(const std::string& note) {
  v1::Acknowledgement ack;
  ack.set_by("spiffe://td/operator/operator/bob serial 0a");
  ack.set_time_unix_ns(kNewYear);
  ack.set_note(note);
  return ack;
}

TEST_F(RipsctlTest, AcknowledgesAlerts) {
  const Result first = Run({"alert", "ack", "22222222", "33333333", "--note", "it was me"});
  EXPECT_EQ(first.code, 0) << first.err;
  EXPECT_EQ(first.out,
            "22222222 (r1, unknown_node) is acknowledged\n"
            "33333333 (r1, unknown_node) is acknowledged\n");

  fake_.alert_ack = MakeAck("seen \x1b[2J");
  const Result second = Run({"alert", "ack", std::string(32, '2')});
  EXPECT_EQ(second.code, 0) << second.err;
  EXPECT_EQ(second.out,
            "22222222 (r1, unknown_node) was acknowledged before, which stays: at "
            "2026-01-01T00:00:00.000Z by spiffe://td/operator/operator/bob serial 0a: seen "
            "\\x1b[2J\n");
  EXPECT_EQ(RunJson({"alert", "ack", "222222"})["alerts"][0],
            nlohmann::json({{"id", "222222"},
                            {"robot", "r1"},
                            {"rule", "unknown_node"},
                            {"already", true},
                            {"acknowledged",
                             {{"by", "spiffe://td/operator/operator/bob serial 0a"},
                              {"time", "2026-01-01T00:00:00.000000000Z"},
                              {"note", "seen \x1b[2J"}}}}));
  EXPECT_THAT(fake_.calls(),
              testing::ElementsAre("AckAlerts 22222222 33333333 it was me",
                                   absl::StrCat("AckAlerts ", std::string(32, '2'), " "),
                                   "AckAlerts 222222 "));
  std::vector<std::string> many(101, "22222222");
  many.insert(many.begin(), {"alert", "ack"});
  EXPECT_EQ(Run(many).code, 2);
}

TEST_F(RipsctlTest, AnIdThatIsNoneIsRefusedBeforeTheServerHearsOfIt) {
  for (const std::string& id : {std::string("12345"), std::string(33, 'a'), std::string("22222g"),
                                std::string("../../etc")}) {
    const Result result = Run({"alert", "ack", id});
    EXPECT_EQ(result.code, 2) << id;
    EXPECT_THAT(result.err, HasSubstr("is no ID of an alert")) << id;
  }
  EXPECT_THAT(fake_.calls(), testing::IsEmpty());
  EXPECT_EQ(Run({"alert", "ack", "ABCDEF"}).code, 0) << "as some print it";
  EXPECT_THAT(fake_.calls(), testing::ElementsAre("AckAlerts abcdef "));
}

TEST_F(RipsctlTest, AnAcknowledgementOfAnUnknownAlertSaysSo) {
  fake_.failure = grpc::Status(grpc::StatusCode::NOT_FOUND, "no alert with the id 333333 is kept");
  const Result result = Run({"alert", "ack", "222222", "333333"});
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.out, "");
  EXPECT_EQ(result.err, "error: no alert with the id 333333 is kept\n");
}

TEST_F(RipsctlTest, ListsWhoAcknowledgedAlerts) {
  fake_.alert_ack = MakeAck("seen \x1b[2J");
  EXPECT_EQ(Run({"alert", "list"}).out,
            "TIME                      ROBOT  SEVERITY  LEVEL  RULE          ID        "
            "ACKNOWLEDGED       TEXT\n"
            "2026-01-01T00:00:00.000Z  r1     high      ALERT  unknown_node  22222222  "
            "bob: seen \\x1b[2J  unknown node /intruder\n");
  EXPECT_EQ(RunJson({"alert", "list"})["alerts"][0]["acknowledged"],
            nlohmann::json({{"by", "spiffe://td/operator/operator/bob serial 0a"},
                            {"time", "2026-01-01T00:00:00.000000000Z"},
                            {"note", "seen \x1b[2J"}}));
  fake_.alert_ack = MakeAck(std::string(1'000, 'x'));
  const std::string cut = Run({"alert", "list"}).out;
  EXPECT_THAT(cut, HasSubstr(absl::StrCat("bob: ", std::string(40, 'x'), "...  unknown node")));
  fake_.alert_ack = MakeAck("");
  EXPECT_THAT(Run({"alert", "list"}).out, HasSubstr("  bob           unknown node"));
}

TEST_F(RipsctlTest, ListsAlertsBySeverityRuleAndTime) {
  Run({"alert", "list", "--open"});
  Run({"alert", "list", "r1", "--severity", "high", "--rule", "(rips)", "--since", "2h"});
  EXPECT_THAT(fake_.calls(),
              testing::ElementsAre("ListAlerts  100 open",
                                   "ListAlerts r1 100 severity high rule (rips) within 7200000"));
  EXPECT_THAT(Run({"alert", "list", "--rule", "old"}).out,
              HasSubstr("older alerts were not searched: "));
  EXPECT_EQ(RunJson({"alert", "list", "--rule", "old"})["older_not_searched"], true);
  EXPECT_EQ(RunJson({"alert", "list"})["older_not_searched"], false);
  EXPECT_EQ(RunJson({"alert", "list"})["limited"], false);
  EXPECT_EQ(RunJson({"alert", "list", "--limit", "1"})["limited"], true);
  EXPECT_THAT(Run({"alert", "list", "--limit", "1"}).out,
              HasSubstr("only the newest 1 are shown; --limit shows more"));
}

TEST_F(RipsctlTest, ListsAlertsThatTheStoreHasNotTaken) {
  fake_.unrecorded_alert = "rogue driver";
  const Result result = Run({"alert", "list"});
  EXPECT_EQ(result.code, 0);
  EXPECT_THAT(result.out, HasSubstr("rogue driver"));
  EXPECT_THAT(result.out, HasSubstr("the first 1 are in the server's memory only: its store "
                                    "cannot be written\n"));
  EXPECT_EQ(RunJson({"alert", "list"})["unrecorded"][0]["text"], "rogue driver");
}

}  // namespace
}  // namespace rips::ripsctl
