// What operators read of bundles and roll-outs, against a server that plays OperatorService.
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"
#include "policy_server/ripsctl/rules/rollout_text.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::Not;
using ::testing::StartsWith;

const std::string kOld = "sha256:" + std::string(64, 'a');
const std::string kFresh = "sha256:" + std::string(64, 'b');

// Two stages; the first, r2, runs.
v1::Rollout MakeRollout() {
  v1::Rollout rollout;
  rollout.set_id(std::string(32, '7'));
  rollout.set_bundle_id(kFresh);
  rollout.set_name("warehouse");
  rollout.set_state("running");
  rollout.set_operator_("alice");
  rollout.set_reason("new \x1b[2Jrules");
  rollout.set_began_unix_ns(kNewYear);
  rollout.set_soak_ms(600'000);
  rollout.set_alerts_per_minute_max(10);
  v1::RolloutStageStatus* stage = rollout.add_stages();
  stage->set_state("running");
  stage->add_robots("r2");
  stage = rollout.add_stages();
  stage->set_state("waiting");
  for (const char* robot : {"r1", "r3"}) stage->add_robots(robot);
  return rollout;
}

v1::RobotRules MakeRules(const std::string& robot) {
  v1::RobotRules rules;
  rules.set_robot(robot);
  rules.set_name("warehouse");
  rules.set_bundle_in_use(kOld);
  return rules;
}

v1::ShadowReport MakeShadow() {
  v1::ShadowReport shadow;
  shadow.set_bundle_id(kFresh);
  shadow.set_name("warehouse");
  shadow.set_operator_("bob");
  shadow.set_reason("try");
  shadow.set_began_unix_ns(kNewYear);
  shadow.set_events(1'200);
  shadow.set_missed(3);
  shadow.set_level("ALERT");
  shadow.set_live_level("DEFAULT");
  shadow.mutable_would()->set_alerts(12);
  shadow.mutable_would()->set_raises(1);
  shadow.mutable_live()->set_alerts(2);
  v1::ShadowRule* rule = shadow.add_rules();
  rule->set_rule("spy");
  rule->set_fired(12);
  rule->set_undecidable(4);
  v1::ShadowExample* example = shadow.add_examples();
  example->set_time_unix_ns(kNewYear);
  example->set_rule("spy");
  example->set_kind("alert");
  example->set_text("who \x1b[2J reads?");
  return shadow;
}

class RulesStatusTest : public RipsctlTest {
 protected:
  // r1 is as before, r2 has the bundle of the roll-out, r3 is held.
  v1::GetRulesStatusResponse& Show() {
    v1::GetRulesStatusResponse& status = fake_.rules_states.emplace_back();
    *status.mutable_rollout() = MakeRollout();
    *status.add_robots() = MakeRules("r1");
    v1::RobotRules* fresh = status.add_robots();
    *fresh = MakeRules("r2");
    fresh->set_bundle_in_use(kFresh);
    fresh->set_activated(kFresh);
    fresh->set_operator_("alice");
    fresh->set_activated_unix_ns(kNewYear);
    fresh->set_reason("new rules");
    fresh->set_can_roll_back(true);
    v1::RobotRules* held = status.add_robots();
    *held = MakeRules("r3");
    held->clear_bundle_in_use();
    held->set_problem("no policy: \x1b[2Jgone");
    return status;
  }
  std::vector<std::string> Activate(const std::vector<std::string>& more = {}) {
    std::vector<std::string> args = {"rules", "activate", "bbbbbbbb", "--all", "--reason", "x"};
    args.insert(args.end(), more.begin(), more.end());
    return args;
  }
  // `states` are what GetRulesStatus gives; the roll-out begins as MakeRollout.
  Result Follow(const std::vector<v1::Rollout>& states) {
    *fake_.rollout.mutable_rollout() = MakeRollout();
    fake_.rollout.add_changed("r2");
    fake_.rules_states.clear();
    for (const v1::Rollout& each : states) {
      *fake_.rules_states.emplace_back().mutable_rollout() = each;
    }
    return Run(Activate({"--wait"}));
  }
};

TEST_F(RulesStatusTest, ShowsTheRollOutAndRobotsWithProblemsFirst) {
  Show();
  const Result result = Run({"rules", "status"});
  EXPECT_EQ(result.code, 1) << "r3 is not judged";
  EXPECT_EQ(
      result.out,
      "roll-out  sha256:bbbbbbbbbbbb `warehouse`\n"
      "state     running: stage 1 of 2 (r2) is not healthy yet\n"
      "by        alice, 2026-01-01T00:00:00.000Z\n"
      "reason    new \\x1b[2Jrules\n"
      "limits    each stage is healthy for 10min; it stops if a level rises, a robot is not "
      "healthy for 10 s (or has not taken the bundle for 30 s), or one has more than 10 alerts "
      "within a minute\n"
      "STAGE  STATE    ROBOTS\n"
      "1      running  r2\n"
      "2      waiting  r1, r3\n"
      "\n"
      "ROBOT  POLICY     IN USE               ACTIVATED            BY     SINCE\n"
      "r3     warehouse  -                    directory            -      -\n"
      "  no policy: \\x1b[2Jgone\n"
      "r1     warehouse  sha256:aaaaaaaaaaaa  directory            -      -\n"
      "r2     warehouse  sha256:bbbbbbbbbbbb  sha256:bbbbbbbbbbbb  alice  "
      "2026-01-01T00:00:00.000Z\n");
}

TEST_F(RulesStatusTest, SaysHowLongAStageHasBeenHealthy) {
  const int64_t now = kNewYear;
  v1::Rollout rollout = MakeRollout();
  const auto since = [&](absl::Duration healthy, absl::Duration soak) {
    rollout.set_healthy_since_unix_ns(now - absl::ToInt64Nanoseconds(healthy));
    rollout.set_soak_ms(static_cast<uint64_t>(absl::ToInt64Milliseconds(soak)));
    return RolloutState(rollout, now);
  };
  const std::string stage = "running: stage 1 of 2 (r2) has been healthy for ";
  EXPECT_EQ(since(absl::Seconds(219), absl::Minutes(10)), stage + "3 of 10 min");
  EXPECT_EQ(since(absl::Seconds(3), absl::Seconds(90)), stage + "3 of 90 s");
  EXPECT_EQ(since(absl::Hours(5), absl::Hours(24)), stage + "5 of 24 h");
  EXPECT_EQ(since(absl::Seconds(1), absl::Milliseconds(1'500)), stage + "1 of 1.5 s");
  // The operator's clock is another one than the server's.
  EXPECT_EQ(since(-absl::Hours(1), absl::Minutes(10)), stage + "0 of 10 min");
  EXPECT_EQ(since(absl::Hours(1), absl::Minutes(10)), stage + "10 of 10 min");
}

TEST_F(RulesStatusTest, ShowsAllOfOneRobotAndItsShadow) {
  v1::GetRulesStatusResponse& status = Show();
  status.clear_rollout();
  status.mutable_robots()->DeleteSubrange(2, 1);
  status.mutable_robots()->DeleteSubrange(0, 1);
  *status.mutable_robots(0)->mutable_shadow() = MakeShadow();
  const Result result = Run({"rules", "status", "r2"});
  EXPECT_EQ(result.code, 0);
  EXPECT_THAT(fake_.calls(), ElementsAre("GetRulesStatus r2"));
  EXPECT_EQ(result.out,
            absl::StrCat("no bundle was rolled out yet\n"
                         "\n"
                         "robot         r2\n"
                         "policy        warehouse\n"
                         "in use        ",
                         kFresh,
                         "\n"
                         "activated     ",
                         kFresh,
                         "\n"
                         "by            alice, 2026-01-01T00:00:00.000Z\n"
                         "reason        new rules\n"
                         "goes back to  directory\n"
                         "\n"
                         "shadow        ",
                         kFresh,
                         " `warehouse`\n"
                         "by            bob\n"
                         "reason        try\n"
                         "counts since  2026-01-01T00:00:00.000Z (the server's start at the "
                         "earliest)\n"
                         "events        1200\n"
                         "missed        3: it is too slow; its counts are too low\n"
                         "           WOULD  LIVE\n"
                         "level      ALERT  DEFAULT\n"
                         "alerts     12     2\n"
                         "raises     1      0\n"
                         "lowerings  0      0\n"
                         "refusals   0      0\n"
                         "programs   0      0\n"
                         "faults     0      0\n"
                         "RULE  FIRED  UNSCANNED  UNDECIDABLE\n"
                         "spy   12     0          4\n"
                         "TIME                      KIND   RULE  THE FIRST AND THE NEWEST "
                         "THINGS IT WOULD HAVE DONE\n"
                         "2026-01-01T00:00:00.000Z  alert  spy   who \\x1b[2J reads?\n"));
  // In the table of all, in one line.
  EXPECT_THAT(Run({"rules", "status"}).out,
              HasSubstr("  shadow sha256:bbbbbbbbbbbb: would have raised 1 times and alerted 12, "
                        "the live one 0 and 2\n"));
}

TEST_F(RulesStatusTest, RobotsWithoutAnAnswerAndThoseLeftOutAreNamed) {
  v1::GetRulesStatusResponse& status = Show();
  status.mutable_robots()->DeleteSubrange(2, 1);
  status.add_no_answer("r1");
  status.set_cut(true);
  const Result result = Run({"rules", "status"});
  EXPECT_EQ(result.code, 1);
  EXPECT_THAT(result.out, AllOf(HasSubstr("\n  no response in time: the server is overloaded\n"),
                                HasSubstr("more robots than fit into one answer")));
}

TEST_F(RulesStatusTest, ItsJsonIsStable) {
  v1::GetRulesStatusResponse& status = Show();
  *status.mutable_robots(1)->mutable_shadow() = MakeShadow();
  const nlohmann::json json = RunJson({"rules", "status"}, 1);
  EXPECT_EQ(json["rollout"], nlohmann::json({{"id", std::string(32, '7')},
                                             {"bundle", kFresh},
                                             {"name", "warehouse"},
                                             {"from_directory", false},
                                             {"state", "running"},
                                             {"why", ""},
                                             {"operator", "alice"},
                                             {"reason", "new \x1b[2Jrules"},
                                             {"began", "2026-01-01T00:00:00.000000000Z"},
                                             {"ended", nullptr},
                                             {"stages",
                                              {{{"state", "running"}, {"robots", {"r2"}}},
                                               {{"state", "waiting"}, {"robots", {"r1", "r3"}}}}},
                                             {"not_healthy_because", ""},
                                             {"rolled_back", ""},
                                             {"healthy_since", nullptr},
                                             {"soak_ms", 600'000},
                                             {"alerts_per_minute_max", 10},
                                             {"roll_back_when_stopped", false}}));
  EXPECT_EQ(json["robots"][0], nlohmann::json({{"robot", "r1"},
                                               {"policy", "warehouse"},
                                               {"bundle_in_use", kOld},
                                               {"activated", "directory"},
                                               {"operator", nullptr},
                                               {"since", nullptr},
                                               {"reason", nullptr},
                                               {"before", nullptr},
                                               {"problem", ""},
                                               {"shadow", nullptr}}));
  const nlohmann::json& shadow = json["robots"][1]["shadow"];
  EXPECT_EQ(json["robots"][1]["before"], "directory");
  EXPECT_EQ(shadow["would"], nlohmann::json({{"alerts", 12},
                                             {"raises", 1},
                                             {"lowerings", 0},
                                             {"refusals", 0},
                                             {"programs", 0},
                                             {"faults", 0}}));
  EXPECT_EQ(shadow["rules"][0],
            nlohmann::json({{"rule", "spy"}, {"fired", 12}, {"unscanned", 0}, {"undecidable", 4}}));
  EXPECT_EQ(shadow["examples"][0]["text"], "who \x1b[2J reads?");
  EXPECT_TRUE(json["robots"][2]["bundle_in_use"].is_null());
  EXPECT_EQ(json["no_answer"], nlohmann::json::array());
  EXPECT_EQ(json["cut"], false);
  fake_.rules_states = {v1::GetRulesStatusResponse()};
  EXPECT_TRUE(RunJson({"rules", "status"})["rollout"].is_null());
}

TEST_F(RulesStatusTest, IdsInTheListAreAsLongAsItTakes) {
  const std::string twins[] = {"sha256:" + std::string(14, 'a') + std::string(50, '1'),
                               "sha256:" + std::string(14, 'a') + std::string(50, '2')};
  for (const std::string& id : {twins[0], twins[1], kFresh}) {
    v1::StoredBundle* bundle = fake_.bundles.add_bundles();
    bundle->set_id(id);
    bundle->set_name("warehouse");
    bundle->set_stored_unix_ns(kNewYear);
  }
  fake_.bundles.mutable_bundles(0)->set_signed_by("alice");
  for (const char* robot : {"r1", "r2", "r3", "r4"}) {
    fake_.bundles.mutable_bundles(1)->add_robots(robot);
  }
  fake_.bundles.mutable_bundles(2)->set_problem("it is not signed\x1b[2J");
  const Result result = Run({"rules", "list"});
  EXPECT_EQ(result.code, 0);
  EXPECT_EQ(result.out,
            "ID                      NAME       SIGNED BY  STORED                    ROBOTS\n"
            "sha256:aaaaaaaaaaaaaa1  warehouse  alice      2026-01-01T00:00:00.000Z  -\n"
            "sha256:aaaaaaaaaaaaaa2  warehouse  -          2026-01-01T00:00:00.000Z  4: r1, r2, r3 "
            "and 1 more\n"
            "sha256:bbbbbbbbbbbb     warehouse  -          2026-01-01T00:00:00.000Z  -\n"
            "sha256:bbbbbbbbbbbb cannot be activated: it is not signed\\x1b[2J\n");
  EXPECT_EQ(RunJson({"rules", "list"})["bundles"][1],
            nlohmann::json({{"id", twins[1]},
                            {"name", "warehouse"},
                            {"signed_by", ""},
                            {"stored", "2026-01-01T00:00:00.000000000Z"},
                            {"robots", {"r1", "r2", "r3", "r4"}},
                            {"problem", ""}}));
  fake_.bundles.Clear();
  EXPECT_EQ(Run({"rules", "list"}).out,
            "the server keeps no bundle; `ripsctl rules push DIR` brings one\n");
}

TEST_F(RulesStatusTest, AWaitPrintsALinePerChangeAndEndsWithTheRollOut) {
  v1::Rollout healthy = MakeRollout();
  healthy.set_healthy_since_unix_ns(kNewYear);
  v1::Rollout second = MakeRollout();
  second.mutable_stages(0)->set_state("done");
  second.mutable_stages(1)->set_state("running");
  v1::Rollout done = second;
  done.mutable_stages(1)->set_state("done");
  done.set_state("done");
  const Result result = Follow({MakeRollout(), MakeRollout(), healthy, healthy, second, done});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(sleeps_, 5);
  const std::string time = "20[0-9-]+T[0-9:.]+Z  ";
  const size_t begins = result.out.find("go back");
  ASSERT_NE(begins, std::string::npos);
  EXPECT_THAT(
      result.out.substr(begins),
      MatchesRegex(absl::StrCat(
          "go back    ripsctl rules rollback --all --reason TEXT\n", time,
          "stage 1 of 2 \\(r2\\) is not healthy yet\n", time,
          "stage 1 of 2 \\(r2\\) is healthy; it is done at 2026-01-01T00:10:00.000Z if it stays "
          "so\n",
          time, "stage 2 of 2 \\(r1, r3\\) is not healthy yet\n", time, "done: 2 stages\n")));

  v1::Rollout stopped = healthy;
  stopped.set_state("stopped");
  stopped.mutable_stages(0)->set_state("stopped");
  stopped.set_why("r2: its level rose to HALT\x1b");
  const Result bad = Follow({stopped});
  EXPECT_EQ(bad.code, 1);
  EXPECT_THAT(bad.out, HasSubstr("  stopped in stage 1 of 2 (r2): r2: its level rose to HALT\\x1b\n"
                                 "go back    ripsctl rules rollback --all --reason TEXT\n"));
  *fake_.rules_states.front().mutable_rollout() = stopped;
  EXPECT_EQ(RunJson(Activate({"--wait"}), 1)["rollout"]["state"], "stopped");
}

TEST_F(RulesStatusTest, AWaitEndsWhenAnotherRollOutHasBegunAndWhenNoServerAnswers) {
  v1::Rollout other = MakeRollout();
  other.set_id(std::string(32, '8'));
  const Result overtaken = Follow({MakeRollout(), other});
  EXPECT_EQ(overtaken.code, 1);
  EXPECT_THAT(overtaken.err, HasSubstr("another roll-out has begun since"));

  // A server that is gone once the roll-out has begun.
  class Gone final : public FakeRulesOperator {
   public:
    grpc::Status GetRulesStatus(grpc::ServerContext*, const v1::GetRulesStatusRequest*,
                                v1::GetRulesStatusResponse* response) override {
      *response->mutable_rollout() = MakeRollout();
      response->mutable_rollout()->set_state("done");
      if (++asked <= lost) return {grpc::StatusCode::UNAVAILABLE, "draining"};
      if (refuse) return {grpc::StatusCode::PERMISSION_DENIED, "banned"};
      return grpc::Status::OK;
    }
    int asked = 0;
    int lost = 0;
    bool refuse = false;
  };
  server_->Shutdown();
  Gone gone;
  *gone.rollout.mutable_rollout() = MakeRollout();
  gone.rollout.add_changed("r2");
  grpc::ServerBuilder builder;
  builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
  builder.RegisterService(&gone);
  server_ = builder.BuildAndStart();
  gone.lost = 20;
  const Result back = Run(Activate({"--wait"}));
  EXPECT_EQ(back.code, 0);
  EXPECT_THAT(back.err, HasSubstr("  the server does not answer (draining); the roll-out is its "
                                  "own, trying again\n"));
  EXPECT_THAT(back.err, testing::EndsWith("  the server answers again\n"));
  gone.asked = 0;
  gone.refuse = true;
  EXPECT_EQ(Run(Activate({"--wait"})).code, 1) << "a refusal is for good";
  gone.asked = 0;
  gone.lost = 1'000'000;
  const Result away = Run(Activate({"--wait"}));
  EXPECT_EQ(away.code, 3);
  EXPECT_THAT(away.err, HasSubstr("error: cannot reach the policy server: draining"));
  EXPECT_LE(gone.asked, 302);
  EXPECT_GE(gone.asked, 200);
  server_->Shutdown();
}

TEST_F(RulesStatusTest, ShadowsBeginAndEnd) {
  fake_.shadowed.add_changed("r2");
  fake_.shadowed.add_left_out("r7: is not \x1b there");
  const Result began =
      Run({"rules", "shadow", kFresh, "--label", "ring=canary", "--reason", "try"});
  EXPECT_EQ(began.code, 0);
  EXPECT_EQ(began.out,
            "runs muted on: r2\n"
            "left out  r7: is not \\x1b there\n"
            "what it would do  ripsctl rules status r2\n"
            "end it            ripsctl rules shadow --end --label ring=canary --reason TEXT\n");
  EXPECT_EQ(fake_.calls().back(),
            absl::StrCat("ShadowBundle bundle_id: \"", kFresh,
                         "\" robots { labels: \"ring=canary\" } reason: \"try\""));
  EXPECT_EQ(RunJson({"rules", "shadow", "--end", "--robot", "r2", "r7", "--reason", "try"}),
            nlohmann::json({{"bundle", nullptr},
                            {"changed", {"r2"}},
                            {"left_out", {"r7: is not \x1b there"}},
                            {"notes", nlohmann::json::array()}}));
  EXPECT_EQ(fake_.calls().back(),
            "ShadowBundle robots { robots: \"r2\" robots: \"r7\" } reason: \"try\"");
  fake_.shadowed.clear_changed();
  EXPECT_EQ(Run({"rules", "shadow", "--end", "--all", "--reason", "x"}).code, 0);
  const Result none = Run({"rules", "shadow", kFresh, "--all", "--reason", "x"});
  EXPECT_EQ(none.code, 1);
  EXPECT_THAT(none.out, StartsWith("nothing changes\n"));
}

TEST_F(RulesStatusTest, SendsWhatTheFlagsSay) {
  fake_.rollout.add_changed("r2");
  *fake_.rollout.mutable_rollout() = MakeRollout();
  EXPECT_EQ(Run(Activate()).code, 0);
  EXPECT_EQ(fake_.calls().back(),
            "ActivateBundle bundle_id: \"bbbbbbbb\" robots { all: true } soak_ms: 600000 "
            "alerts_per_minute_max: 10 reason: \"x\"");
  const Result result = Run(Activate({"--stage", "ring=canary", "--stage", "100%", "--soak", "10m",
                                      "--alerts-max", "3", "--rollback", "--dry-run"}));
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(fake_.calls().back(),
            "ActivateBundle bundle_id: \"bbbbbbbb\" robots { all: true } stages { label: "
            "\"ring=canary\" } stages { percent: 100 } soak_ms: 600000 alerts_per_minute_max: 3 "
            "roll_back_when_stopped: true reason: \"x\" dry_run: true");
  EXPECT_THAT(result.out,
              AllOf(StartsWith("nothing was changed; it would be: sha256:bbbbbbbbbbbb `warehouse` "
                               "would first judge r2\n"),
                    Not(HasSubstr("rules stop"))));
}

TEST_F(RulesStatusTest, WrongFlagsAreUsageErrorsAndCallNoServer) {
  const struct {
    std::vector<std::string> args;
    const char* why;
  } cases[] = {
      {{"rules", "rollback", "--reason", "x"},
       "which robots? give --robot ROBOT..., --label KEY=VALUE..., or --all"},
      {{"rules", "rollback", "--all", "--robot", "r1", "--reason", "x"},
       "robots are chosen in one way only; give --robot"},
      {{"rules", "rollback", "--label", "a=b", "--robot", "r1", "--reason", "x"}, "one way only"},
      {{"rules", "rollback", "--robot", "R\x1b", "--reason", "x"}, "robot id"},
      {{"rules", "rollback", "--robot", "", "--reason", "x"}, "robot id"},
      {{"rules", "rollback", "--label", "canary", "--reason", "x"}, "is not a label; write KEY"},
      {{"rules", "rollback", "--all"}, "--reason is required"},
      {{"rules", "rollback", "--all", "--reason", " "}, "--reason is empty"},
      {{"rules", "stop"}, "--reason is required"},
      {{"rules", "status", "R_1"}, "robot id"},
      {{"rules", "push"}, "DIR is required"},
      {{"rules", "activate", "warehouse", "--all", "--reason", "x"}, "`warehouse` is no bundle"},
      {{"rules", "activate", "sha256:abc", "--all", "--reason", "x"}, "the first 8 digits"},
      {{"rules", "activate", std::string(65, 'a'), "--all", "--reason", "x"}, "is no bundle"},
      {{"rules", "activate", "--robot", "r1", "sha256:aaaaaaaa", "--reason", "x"},
       "BUNDLE is required"},
      {Activate({"--stage", "0%"}), "a percentage is from 1% to 100%"},
      {Activate({"--stage", "101%"}), "a percentage is from 1% to 100%"},
      {Activate({"--stage", "-1%"}), "from 1% to 100%"},
      {Activate({"--stage", "10"}), "write KEY=VALUE for the robots with that label"},
      {Activate({"--stage", "=x"}), "write KEY=VALUE"},
      {Activate({"--soak", "0s"}), "write a time from 1s to 7d"},
      {Activate({"--soak", "8d"}), "write a time from 1s to 7d"},
      {Activate({"--soak", "soon"}), "write a time from 1s to 7d"},
      {Activate({"--alerts-max", "0"}), "--alerts-max"},
      {Activate({"--alerts-max", "1001"}), "--alerts-max"},
      {Activate({"--wait", "--dry-run"}), "--dry-run begins nothing"},
      {{"rules", "shadow", "--all", "--reason", "x"}, "give either a BUNDLE"},
      {{"rules", "shadow", kFresh, "--end", "--all", "--reason", "x"}, "give either a BUNDLE"},
      {{"rules", "shadow", "directory", "--all", "--reason", "x"}, "`directory` is no bundle"},
      {{"rules", "shadow", "nonsense", "--all", "--reason", "x"}, "is no bundle"},
  };
  for (const auto& each : cases) {
    const Result result = Run(each.args);
    EXPECT_EQ(result.code, 2) << each.why;
    EXPECT_THAT(result.err, HasSubstr(each.why));
    EXPECT_EQ(result.err.find('\x1b'), std::string::npos);
  }
  std::vector<std::string> many = Activate();
  for (int i = 0; i < 33; ++i) many.insert(many.end(), {"--stage", "1%"});
  EXPECT_THAT(Run(many).err, HasSubstr("there are more than 32 stages"));
  EXPECT_THAT(fake_.calls(), testing::IsEmpty());
}

}  // namespace
}  // namespace rips::ripsctl
