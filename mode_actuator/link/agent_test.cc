// The whole agent against a policy server in this process, over real mTLS. Without DDS: the levels
// here are made of programs.
#include "mode_actuator/link/agent.h"

#include <signal.h>
#include <spawn.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <functional>
#include <optional>
#include <sstream>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/decide/exec_journal.h"
#include "mode_actuator/link/fake_server.h"
#include "mode_actuator/steps/alarm/fake_lcus.h"
#include "rips/v1/actuator.grpc.pb.h"
#include "services/base/status_matchers.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/run_cgroups.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using v1::Receipt;

std::string Id(char c) { return std::string(16, c); }

std::string Slurp(const std::string& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

class AgentTest : public ::testing::Test {
 protected:
  AgentTest() {
    char name[] = "/tmp/rips-agent-XXXXXX";
    dir_ = mkdtemp(name);
  }
  ~AgentTest() override {
    agent_.reset();
    StopExec();
    [[maybe_unused]] const int ended = system(("rm -rf " + dir_).c_str());
  }

  std::string ConfigText(int port, const TlsFiles& tls) const {
    return absl::StrReplaceAll(
        R"(robot: r1
host: base
servers: ["127.0.0.1:PORT"]
tls: {ca: CA, cert: CERT, key: KEY}
state_dir: DIR/state
fail_safe: {level: ALERT, after: 0s}
timing: {floor_hold: 0ms, reconcile: 200ms}
exec: {socket: DIR/exec.sock, user: "UID"}
levels:
  - {name: DEFAULT}
  - {name: ALERT, enter: [{program: {name: note, args: ["-c", "echo alert >> DIR/log"]}}]}
  - {name: COMPROMISED, enter: [{program: {name: note, args: ["-c", "echo comp >> DIR/log; echo $RIPS_LEVEL_FROM to $RIPS_LEVEL_TO on $RIPS_ROBOT $RIPS_HOST"]}}]}
  - {name: HALT, enter: [{program: {name: bad}}]}
programs:
  - {name: note, path: /usr/bin/bash, concurrency: 2}
  - {name: bad, path: /usr/bin/false}
metrics: "127.0.0.1:0"
)",
        {{"PORT", absl::StrCat(port)},
         {"CA", tls.ca},
         {"CERT", tls.cert},
         {"KEY", tls.key},
         {"programs:\n", alarms_ + "programs:\n" + programs_},
         {"UID", absl::StrCat(geteuid())},
         {"DIR", dir_}});
  }
  std::string WriteConfig(int port, const TlsFiles& tls) const {
    const std::string path = dir_ + "/actuator.yaml";
    std::ofstream(path) << ConfigText(port, tls);
    return path;
  }
  // rips-exec, ready, with the configuration as it is.
  void StartExec() {
    unlink((dir_ + "/exec.ready").c_str());
    exec_ = SpawnDaemon("rips-exec", dir_ + "/actuator.yaml", dir_ + "/exec.ready");
    for (int i = 0; i < 2000 && Slurp(dir_ + "/exec.ready") != "ready\n"; ++i) usleep(10'000);
    EXPECT_EQ(Slurp(dir_ + "/exec.ready"), "ready\n");
  }
  void StopExec(int signal = SIGTERM) {
    if (exec_ == 0) return;
    kill(exec_, signal);
    waitpid(std::exchange(exec_, 0), nullptr, 0);
  }
  static pid_t SpawnDaemon(const std::string& name, const std::string& config,
                           const std::string& ready) {
    std::vector<std::string> words = {absl::StrCat(RIPS_BIN_DIR "/", name), "--config", config,
                                      "--ready-file", ready};
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    pid_t pid = 0;
    EXPECT_EQ(posix_spawn(&pid, argv[0], nullptr, nullptr, argv.data(), environ), 0);
    return pid;
  }
  absl::Status Start(int port, const TlsFiles& tls) {
    const auto loaded = LoadConfig(WriteConfig(port, tls));
    EXPECT_THAT(loaded, IsOk());
    if (exec_ == 0 && with_exec_) StartExec();
    const auto credentials = rpc::Credentials::Load(tls);
    EXPECT_THAT(credentials, IsOk());
    auto agent = Agent::Start(*loaded, *credentials, &clock_, &metrics_);
    if (agent.ok()) agent_ = *std::move(agent);
    return agent.status();
  }
  bool Verified(FakeServer& server, const std::string& level) {
    return server.Until([&] {
      return server.heartbeat_.effective_level() == level && server.heartbeat_.verified();
    });
  }

  rpc::TestPki& Pki() {
    static auto* pki = new rpc::TestPki;
    return *pki;
  }

  RealClock clock_;
  Metrics metrics_;
  std::string dir_;
  std::string alarms_;    // further lines of the configuration: levels and devices
  std::string programs_;  // and of programs
  bool with_exec_ = true;
  pid_t exec_ = 0;  // 0 = not running
  std::unique_ptr<Agent> agent_;
};

TEST_F(AgentTest, AFreshOneStartsAtTheFailSafeLevelAndSaysSo) {
  FakeServer server(Pki().Server());
  server.leases_ = false;  // before anyone is connected
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());

  ASSERT_TRUE(server.Until([&] { return !server.hellos_.empty(); }));
  const v1::ActuatorHello hello = server.Hello(0);
  EXPECT_THAT(hello.levels(), ElementsAre("DEFAULT", "ALERT", "COMPROMISED", "HALT"));
  EXPECT_EQ(hello.fail_safe_level(), "ALERT");
  EXPECT_THAT(hello.programs(), ElementsAre("note", "bad"));
  EXPECT_TRUE(hello.state_lost());
  EXPECT_FALSE(hello.has_decision_id());
  EXPECT_EQ(hello.effective_level(), "ALERT");
  EXPECT_EQ(hello.hello().host(), "base");
  EXPECT_EQ(hello.hello().protocol(), 1u);
  EXPECT_EQ(hello.hello().incarnation().size(), 16u);
  EXPECT_TRUE(Verified(server, "ALERT"));
  EXPECT_EQ(server.Heartbeat().floor_reason(), "state lost");
  EXPECT_THAT(agent_->Ready(), StatusIs(absl::StatusCode::kUnavailable, "no live lease"));
}

TEST_F(AgentTest, HeartbeatsGoAsOftenAsTheServerSays) {
  FakeServer server(Pki().Server());
  server.heartbeat_ms_ = 800;
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.SetLevel(Id('a'), "DEFAULT", {1, 1});
  ASSERT_TRUE(Verified(server, "DEFAULT"));

  // A change sends one between; afterwards nothing changes.
  const auto gap_ms = [&server] {
    const size_t size = server.sent_ms_.size();
    return size < 3 ? 0
                    : std::min(server.sent_ms_[size - 1] - server.sent_ms_[size - 2],
                               server.sent_ms_[size - 2] - server.sent_ms_[size - 3]);
  };
  EXPECT_TRUE(server.Until([&] { return gap_ms() >= 800; }));
}

TEST_F(AgentTest, RaisesLowersAndSurvivesARestart) {
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.SetLevel(Id('a'), "DEFAULT", {1, 1});
  ASSERT_TRUE(Verified(server, "DEFAULT"));  // the floor of a lost state lifts

  server.SetLevel(Id('b'), "COMPROMISED", {1, 2});
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::VERIFIED));
  EXPECT_EQ(server.Last(Id('b')).effective_level(), "COMPROMISED");
  EXPECT_EQ(server.Last(Id('b')).steps(0).step(), "program note");
  EXPECT_EQ(server.Last(Id('b')).steps(0).output_tail(), "DEFAULT to COMPROMISED on r1 base\n");
  server.SetLevel(Id('c'), "DEFAULT", {1, 3});
  ASSERT_TRUE(server.HasReceipt(Id('c'), Receipt::REFUSED));
  EXPECT_THAT(server.Last(Id('c')).detail(), HasSubstr("must be based on decision 1.2"));
  server.SetLevel(Id('d'), "HALT", {1, 3}, {}, /*term=*/0);
  ASSERT_TRUE(server.HasReceipt(Id('d'), Receipt::REFUSED_STALE));

  agent_.reset();
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  ASSERT_TRUE(server.Until([&] { return server.hellos_.size() == 2; }));
  EXPECT_EQ(server.Hello(1).decision_id().epoch(), 2u);
  EXPECT_EQ(server.Hello(1).decided_level(), "COMPROMISED");
  EXPECT_EQ(server.Hello(1).effective_level(), "COMPROMISED");
  EXPECT_FALSE(server.Hello(1).state_lost());
  ASSERT_TRUE(Verified(server, "COMPROMISED"));

  server.SetLevel(Id('e'), "DEFAULT", {1, 3}, DecisionId{1, 2});
  ASSERT_TRUE(server.HasReceipt(Id('e'), Receipt::VERIFIED));
  EXPECT_TRUE(Verified(server, "DEFAULT"));
  EXPECT_EQ(Slurp(dir_ + "/log"), "alert\ncomp\ncomp\n");
  EXPECT_TRUE(server.Until([&] { return server.overtook_ == 0; }))
      << "a level was verified while the robot was still shown at the one before";
}

TEST_F(AgentTest, AfterAReconnectTheServerGetsTheReceiptAgainAndNothingIsEnteredTwice) {
  auto server = std::make_unique<FakeServer>(Pki().Server());
  const int port = server->port();
  ASSERT_THAT(Start(port, Pki().Actuator()), IsOk());
  ASSERT_TRUE(Verified(*server, "ALERT"));
  server->SetLevel(Id('a'), "COMPROMISED", {1, 1});
  ASSERT_TRUE(server->HasReceipt(Id('a'), Receipt::VERIFIED));

  server.reset();
  server = std::make_unique<FakeServer>(Pki().Server(), port);

  ASSERT_TRUE(server->HasReceipt(Id('a'), Receipt::VERIFIED));
  server->SetLevel(Id('b'), "COMPROMISED", {1, 1});  // the same decision, a new command
  ASSERT_TRUE(server->HasReceipt(Id('b'), Receipt::VERIFIED));
  EXPECT_EQ(Slurp(dir_ + "/log"), "alert\ncomp\n");
}

TEST_F(AgentTest, AStepThatFailsIsTold) {
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.SetLevel(Id('a'), "HALT", {1, 1});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::FAILED));
  EXPECT_EQ(server.Last(Id('a')).detail(), "program bad: exit code 1");
  EXPECT_TRUE(server.Until([&] { return server.heartbeat_.effective_level() == "HALT"; }));
  EXPECT_FALSE(server.Heartbeat().verified());
}

TEST_F(AgentTest, AnAlarmIsReadBackAndToldAgainWhenItWasSwitchedOff) {
  const std::string link = dir_ + "/siren";
  alarms_ = absl::StrCat(
      "  - {name: SIREN, enter: [{alarm: {device: siren, state: \"on\"}}],\n"
      "     leave: [{alarm: {device: siren, state: \"off\"}}]}\n"
      "devices: [{name: siren, kind: lcus_serial, path: ",
      link, "}]\n");
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  // Not plugged in: that is degraded, not fatal.
  server.SetLevel(Id('a'), "SIREN", {1, 1});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::FAILED));
  EXPECT_THAT(server.Last(Id('a')).detail(), HasSubstr("is the device plugged in?"));

  FakeLcus board(FakeLcus::Answer::kText);
  ASSERT_EQ(symlink(board.path().c_str(), link.c_str()), 0);
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::VERIFIED));
  EXPECT_EQ(server.Last(Id('a')).steps(0).step(), "alarm siren=on");
  EXPECT_EQ(server.Last(Id('a')).steps(0).detail(), "relay 1 is on (read back)");
  ASSERT_TRUE(Verified(server, "SIREN"));
  EXPECT_EQ(server.Heartbeat().observed(), "siren=on");

  board.Force(1, false);
  ASSERT_TRUE(server.Until([&] { return server.heartbeat_.verified() && board.is_on(1); }));

  server.SetLevel(Id('b'), "DEFAULT", {1, 2}, DecisionId{1, 1});
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::VERIFIED));
  EXPECT_FALSE(board.is_on(1));
}

TEST_F(AgentTest, ADrillTriesALevelAndLeavesTheRobotWhereItIs) {
  const std::string link = dir_ + "/siren";
  alarms_ = absl::StrCat(
      "  - {name: SIREN, enter: [{alarm: {device: siren, state: \"on\"}},\n"
      "     {program: {name: drilled, args: [\"-c\", \"echo drill=$RIPS_DRILL\"]}}],\n"
      "     leave: [{alarm: {device: siren, state: \"off\"}}]}\n"
      "devices: [{name: siren, kind: lcus_serial, drill: flash, path: ",
      link, "}]\n");
  programs_ = "  - {name: drilled, path: /usr/bin/bash, drill: true}\n";
  FakeLcus board(FakeLcus::Answer::kText);
  ASSERT_EQ(symlink(board.path().c_str(), link.c_str()), 0);
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.SetLevel(Id('a'), "DEFAULT", {1, 1});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::VERIFIED));
  ASSERT_TRUE(Verified(server, "DEFAULT"));
  ASSERT_TRUE(server.Until(
      [&] { return absl::StrContains(Slurp(dir_ + "/state/state"), "effective DEFAULT"); }));
  const std::string log = Slurp(dir_ + "/log");
  const std::string state = Slurp(dir_ + "/state/state");

  server.Drill(Id('b'), "SIREN");
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::VERIFIED)) << server.Last(Id('b')).DebugString();
  const Receipt drilled = server.Last(Id('b'));
  EXPECT_EQ(drilled.effective_level(), "DEFAULT");
  ASSERT_EQ(drilled.steps_size(), 3);
  EXPECT_EQ(drilled.steps(0).drilled(), v1::StepResult::DRILLED_DONE);
  EXPECT_THAT(drilled.steps(0).detail(), HasSubstr("flashed on, then off again"));
  EXPECT_EQ(drilled.steps(1).drilled(), v1::StepResult::DRILLED_DONE);
  EXPECT_EQ(drilled.steps(1).output_tail(), "drill=1\n");
  EXPECT_EQ(drilled.steps(2).step(), "leave: alarm siren=off");
  EXPECT_EQ(drilled.steps(2).drilled(), v1::StepResult::DRILLED_LOOKED);
  EXPECT_FALSE(board.is_on(1));

  // Another level: its programs have no drill, so they are looked at and do not run.
  server.Drill(Id('c'), "COMPROMISED");
  ASSERT_TRUE(server.HasReceipt(Id('c'), Receipt::VERIFIED));
  EXPECT_EQ(server.Last(Id('c')).steps(0).drilled(), v1::StepResult::DRILLED_LOOKED);
  EXPECT_EQ(Slurp(dir_ + "/log"), log);
  EXPECT_EQ(Slurp(dir_ + "/state/state"), state);
  EXPECT_TRUE(Verified(server, "DEFAULT"));

  // Repeated, of no level of ours, of a stale term.
  server.Drill(Id('b'), "SIREN");
  server.Drill(Id('d'), "PANIC");
  server.Drill(Id('e'), "SIREN", 0);
  ASSERT_TRUE(server.HasReceipt(Id('e'), Receipt::REFUSED_STALE));
  EXPECT_EQ(server.Last(Id('d')).stage(), Receipt::REFUSED);
  EXPECT_EQ(server.Last(Id('b')).stage(), Receipt::VERIFIED);
}

TEST_F(AgentTest, ALevelThatComesDuringADrillIsEnteredAtOnce) {
  programs_ = "  - {name: slow, path: /usr/bin/bash, drill: true}\n";
  alarms_ = absl::StrCat("  - {name: SLOW, enter: [{program: {name: slow, args: [\"-c\", ",
                         "\"touch ", dir_, "/begun; exec sleep 60\"]}}]}\n");
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.SetLevel(Id('a'), "DEFAULT", {1, 1});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::VERIFIED));
  ASSERT_TRUE(Verified(server, "DEFAULT"));
  server.Drill(Id('b'), "SLOW");
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::ACKNOWLEDGED));
  ASSERT_TRUE(server.Until([&] { return access((dir_ + "/begun").c_str(), F_OK) == 0; }));
  server.Drill(Id('c'), "ALERT");
  ASSERT_TRUE(server.HasReceipt(Id('c'), Receipt::REFUSED));
  EXPECT_EQ(server.Last(Id('c')).detail(), "another drill runs");

  server.SetLevel(Id('d'), "ALERT", {1, 2});
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::SUPERSEDED));
  ASSERT_TRUE(server.HasReceipt(Id('d'), Receipt::VERIFIED));
  EXPECT_TRUE(Verified(server, "ALERT"));
}

TEST_F(AgentTest, ALevelThatIsLeftAgainAndAgainIsToldAndRunsItsOnDriftSteps) {
  FakeLcus board(FakeLcus::Answer::kText);
  const std::string link = dir_ + "/siren";
  ASSERT_EQ(symlink(board.path().c_str(), link.c_str()), 0);
  alarms_ = absl::StrCat(
      "  - {name: SIREN, enter: [{alarm: {device: siren, state: \"on\"}}],\n"
      "     on_drift: [{program: {name: note, args: [\"-c\", \"echo drift >> ",
      dir_,
      "/log\"]}}]}\n"
      "devices: [{name: siren, kind: lcus_serial, path: ",
      link, "}]\n");
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.SetLevel(Id('a'), "SIREN", {1, 1});
  ASSERT_TRUE(Verified(server, "SIREN"));
  EXPECT_EQ(server.Heartbeat().drifts(), 0u);
  EXPECT_EQ(server.Heartbeat().degraded_size(), 0);
  for (uint64_t drift = 1; drift <= 3; ++drift) {
    board.Force(1, false);
    ASSERT_TRUE(server.Until([&] {
      return server.heartbeat_.drifts() == drift && server.heartbeat_.verified() && board.is_on(1);
    })) << drift;
  }
  ASSERT_TRUE(server.Until([&] {
    return server.heartbeat_.degraded_size() == 1 &&
           server.heartbeat_.degraded(0) ==
               "SIREN was left again and again: 3 times in 60 s; its "
               "on_drift steps were run";
  }));
  EXPECT_THAT(Slurp(dir_ + "/log"), HasSubstr("drift\n"));
}

TEST_F(AgentTest, RunsAProgramAtMostOnce) {
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  const std::vector<std::string> args = {"-c", "echo ran >> " + dir_ + "/ran; echo out; exit 3"};
  server.Run(Id('a'), "note", args);
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::FAILED));
  EXPECT_EQ(server.Last(Id('a')).exit_code(), 3);
  EXPECT_EQ(server.Last(Id('a')).output_tail(), "out\n");

  server.Run(Id('a'), "note", args);
  agent_.reset();
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.Run(Id('a'), "note", args);
  server.Run(Id('b'), "note", {"-c", "true"});
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::VERIFIED));
  EXPECT_EQ(Slurp(dir_ + "/ran"), "ran\n");

  server.Run(Id('c'), "/usr/bin/id", {});
  ASSERT_TRUE(server.HasReceipt(Id('c'), Receipt::REFUSED));
  EXPECT_EQ(server.Last(Id('c')).detail(), "program `/usr/bin/id` is not in the allow-list");
}

TEST_F(AgentTest, WithoutRipsExecStepsFailUntilItComes) {
  with_exec_ = false;
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.SetLevel(Id('a'), "COMPROMISED", {1, 1});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::FAILED));
  EXPECT_THAT(server.Last(Id('a')).detail(), HasSubstr("cannot reach rips-exec at `"));
  server.Run(Id('b'), "note", {"-c", "true"});
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::FAILED));
  EXPECT_THAT(server.Last(Id('b')).detail(), HasSubstr("cannot reach rips-exec at `"));

  StartExec();
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::VERIFIED));
  ASSERT_TRUE(Verified(server, "COMPROMISED"));
}

TEST_F(AgentTest, WithoutAJournalNothingRuns) {
  // In place of the file, as if the disk took nothing.
  mkdir((dir_ + "/state").c_str(), 0700);
  mkdir((dir_ + "/state/journal").c_str(), 0700);
  std::ofstream(dir_ + "/state/journal/x") << "x";
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.Run(Id('a'), "note", {"-c", "echo ran >> " + dir_ + "/ran"});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::REFUSED));
  EXPECT_THAT(server.Last(Id('a')).detail(), HasSubstr("cannot be recorded: "));
  EXPECT_EQ(Slurp(dir_ + "/ran"), "");
}

TEST_F(AgentTest, WhatAProgramLeavesBehindIsTold) {
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.Run(Id('a'), "note", {"-c", "setsid sleep 60 & exit 0"});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::VERIFIED));
  int left_behind = 0;
  const auto cgroups =
      RunCgroups::Open("", absl::StrCat("rips-agent-test-", getpid()), &left_behind);
  if (!cgroups.ok()) GTEST_SKIP() << "no cgroup v2 can be made here: " << cgroups.status();
  EXPECT_EQ(server.Last(Id('a')).detail(), "left 1 process behind, killed");
}

TEST_F(AgentTest, AProgramWhoseRipsExecDiedIsUnknownAndTheNextOneRuns) {
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.Run(Id('a'), "note", {"-c", "echo ran >> " + dir_ + "/ran; sleep 60"});
  ASSERT_TRUE(server.Until([&] { return Slurp(dir_ + "/ran") == "ran\n"; }));
  StopExec(SIGKILL);
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::UNKNOWN));
  EXPECT_EQ(server.Last(Id('a')).detail(), "rips-exec ended while it ran");

  StartExec();
  server.Run(Id('a'), "note", {"-c", "echo ran >> " + dir_ + "/ran"});
  server.Run(Id('b'), "note", {"-c", "true"});
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::VERIFIED));
  EXPECT_EQ(Slurp(dir_ + "/ran"), "ran\n");
}

TEST_F(AgentTest, AProgramFoundUnfinishedIsUnknownAndNotRunAgain) {
  ExecJournal ledger;
  ASSERT_THAT(ledger.Begin(absl::BytesToHexString(Id('a'))), IsOk());
  mkdir((dir_ + "/state").c_str(), 0700);
  std::ofstream(dir_ + "/state/journal") << ledger.Encode();
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());

  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::UNKNOWN));
  server.Run(Id('a'), "note", {"-c", "echo ran >> " + dir_ + "/ran"});
  server.Run(Id('b'), "note", {"-c", "true"});
  ASSERT_TRUE(server.HasReceipt(Id('b'), Receipt::VERIFIED));
  EXPECT_EQ(Slurp(dir_ + "/ran"), "");
}

TEST_F(AgentTest, ASecondOneOnTheStateDirectoryIsRefused) {
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  const std::unique_ptr<Agent> first = std::move(agent_);
  EXPECT_THAT(Start(server.port(), Pki().Actuator()),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("another actuator uses the state directory")));
}

TEST_F(AgentTest, ACorruptStateIsLostAndNeverTheFirstLevel) {
  mkdir((dir_ + "/state").c_str(), 0700);
  std::ofstream(dir_ + "/state/state") << "rips-actuator-state 1\nmark 1.1\ndecided DEFAULT\n";
  std::ofstream(dir_ + "/state/journal") << "garbage";
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  ASSERT_TRUE(server.Until([&] { return !server.hellos_.empty(); }));
  EXPECT_TRUE(server.Hello(0).state_lost());
  EXPECT_EQ(server.Hello(0).effective_level(), "ALERT");
}

TEST_F(AgentTest, MalformedCommandsDoNothing) {
  FakeServer server(Pki().Server());
  ASSERT_THAT(Start(server.port(), Pki().Actuator()), IsOk());
  server.SetLevel("short", "HALT", {1, 1});
  server.Push({});
  v1::ActuatorReply empty;
  empty.mutable_command()->set_id(Id('x'));
  server.Push(empty);
  server.Run(Id('y'), "", {});
  server.Drill(Id('z'), "");
  server.SetLevel(Id('a'), "ALERT", {1, 1});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::VERIFIED));
  for (const Receipt& receipt : server.Receipts()) EXPECT_EQ(receipt.command_id(), Id('a'));
}

TEST_F(AgentTest, ARobotsCertificateCannotPlayTheServer) {
  FakeServer impostor(Pki().Actuator("r1", "laptop"));
  ASSERT_THAT(Start(impostor.port(), Pki().Actuator()), IsOk());
  CondVar never;
  Mutex mu;
  {
    MutexLock lock(&mu);
    never.WaitFor(lock, absl::Seconds(1));  // several attempts fit into this
  }
  EXPECT_FALSE(impostor.Hello(0).has_hello());
  EXPECT_THAT(agent_->Ready(),
              StatusIs(absl::StatusCode::kUnavailable, "not connected to a policy server"));
}

TEST_F(AgentTest, TheCertificateMustBeOfThisRobotAndHost) {
  for (const TlsFiles& tls : {Pki().Actuator("r2", "base"), Pki().Actuator("r1", "laptop"),
                              Pki().Sensor("r1", "base"), Pki().Server()}) {
    EXPECT_THAT(Start(1, tls), StatusIs(absl::StatusCode::kPermissionDenied,
                                        HasSubstr("but the configuration says robot `r1`")));
  }
}

// --- the binary

class BinaryTest : public AgentTest {
 protected:
  struct Ended {
    int code = -1;
    std::string output;
  };
  pid_t Spawn(const std::string& config) const {
    return SpawnDaemon("rips-actuator", config, dir_ + "/ready");
  }
  static int WaitFor(pid_t pid) {
    int status = 0;
    waitpid(pid, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  Ended RunBinary(const std::string& args, const std::string& name = "rips-actuator") const {
    const std::string out = dir_ + "/out";
    const int status =
        system((RIPS_BIN_DIR "/" + name + " " + args + " > " + out + " 2>&1").c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, Slurp(out)};
  }
};

TEST_F(BinaryTest, ChecksItsConfiguration) {
  const std::string path = WriteConfig(7443, Pki().Actuator());
  const Ended good = RunBinary("--check-config --config " + path);
  EXPECT_EQ(good.code, 0) << good.output;
  EXPECT_THAT(good.output, HasSubstr("fail_safe.level: \"ALERT\""));

  std::string elsewhere = absl::StrReplaceAll(
      Slurp(path), {{absl::StrCat("state_dir: ", dir_), "state_dir: /no/such"}});
  std::ofstream(dir_ + "/elsewhere.yaml") << elsewhere;
  const Ended gone = RunBinary("--check-config --config " + dir_ + "/elsewhere.yaml");
  EXPECT_EQ(gone.code, 2);
  EXPECT_THAT(gone.output, HasSubstr("`state_dir` needs the directory `/no/such`, which does not"));

  std::ofstream(path, std::ios::app) << "colour: red\n";
  const Ended bad = RunBinary("--check-config --config " + path);
  EXPECT_EQ(bad.code, 2);
  EXPECT_THAT(bad.output, HasSubstr("actuator.yaml:18:1: unknown key `colour`"));
  EXPECT_EQ(RunBinary("--config " + dir_ + "/nothing.yaml").code, 2);
  EXPECT_EQ(RunBinary("--colour").code, 2);
}

TEST_F(BinaryTest, AlarmsAreTriedByHand) {
  FakeLcus board(FakeLcus::Answer::kText);
  const std::string link = dir_ + "/siren";
  alarms_ = absl::StrCat("devices:\n  - {name: siren, kind: lcus_serial, path: ", link,
                         ", channel: 2}\n");
  const std::string config = "--config " + WriteConfig(7443, Pki().Actuator());
  const auto alarm = [&](const std::string& args) {
    board.EndExclusiveUse();
    return RunBinary(config + " " + args, "rips-alarm");
  };

  const Ended absent = alarm("");
  EXPECT_EQ(absent.code, 1);
  EXPECT_EQ(absent.output, "siren: no `" + link + "`; is the device plugged in?\n");
  ASSERT_EQ(symlink(board.path().c_str(), link.c_str()), 0);
  EXPECT_EQ(alarm("siren").output, "siren: off\n");
  const Ended on = alarm("siren on");
  EXPECT_EQ(on.code, 0);
  EXPECT_EQ(on.output, "siren: relay 2 is on (read back)\n");
  EXPECT_TRUE(board.is_on(2));
  EXPECT_EQ(alarm("").output, "siren: on\n");

  const Ended unknown = alarm("siren steady");
  EXPECT_EQ(unknown.code, 2);
  EXPECT_THAT(unknown.output, HasSubstr("`steady` is no state of a lcus_serial; did you mean"));
  EXPECT_THAT(alarm("bell on").output, HasSubstr("no device `bell` in `devices`"));
  EXPECT_EQ(alarm("siren on more").code, 2);
  EXPECT_EQ(RunBinary("--config " + dir_ + "/nothing.yaml", "rips-alarm").code, 1);
}

TEST_F(BinaryTest, HoldsItsLevelAcrossAKillAndEndsOnSigterm) {
  FakeServer server(Pki().Server());
  const std::string config = WriteConfig(server.port(), Pki().Actuator());
  StartExec();
  const pid_t first = Spawn(config);
  server.SetLevel(Id('a'), "COMPROMISED", {1, 1});
  ASSERT_TRUE(server.HasReceipt(Id('a'), Receipt::VERIFIED));
  EXPECT_EQ(Slurp(dir_ + "/ready"), "ready\n");
  // A raise is carried out while it is being recorded.
  for (int i = 0; i < 2000 && Slurp(dir_ + "/state/state").find("COMPROMISED") == std::string::npos;
       ++i) {
    usleep(10'000);
  }
  kill(first, SIGKILL);
  EXPECT_EQ(WaitFor(first), 128 + SIGKILL);

  const pid_t second = Spawn(config);
  ASSERT_TRUE(server.Until([&] { return server.hellos_.size() == 2; }));
  EXPECT_EQ(server.Hello(1).effective_level(), "COMPROMISED");
  EXPECT_EQ(server.Hello(1).decision_id().epoch(), 1u);
  kill(second, SIGTERM);
  EXPECT_EQ(WaitFor(second), 0);
}

TEST_F(BinaryTest, EndsWith2IfTheCertificateIsAnothers) {
  const Ended ended = RunBinary("--config " + WriteConfig(7443, Pki().Actuator("r2", "base")));
  EXPECT_EQ(ended.code, 2);
  EXPECT_THAT(ended.output, HasSubstr("spiffe://fleet.example/robot/r2/actuator/base"));
}

}  // namespace
}  // namespace rips::actuator
