#include "mode_actuator/steps/level_executor.h"

#include <deque>
#include <map>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/firewall/firewall_step.h"
#include "mode_actuator/steps/workers.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// A robot that does as it is told, except where the test says otherwise.
class FakeModes : public PartModes {
 public:
  ModeReading Enter(absl::string_view part, absl::string_view mode, absl::Duration timeout, int,
                    const CancelFlag& cancel) override {
    orders.push_back(absl::StrCat(part, "=", mode));
    if (hangs) {
      cancel.WaitFor(timeout);
      return {absl::DeadlineExceededError("hung"), "?"};
    }
    if (lies) return {absl::DeadlineExceededError("not reached"), "DEFAULT"};
    now[std::string(part)] = std::string(mode);
    return {absl::OkStatus(), std::string(mode)};
  }
  ModeReading Check(absl::string_view part, absl::string_view mode, const CancelFlag&) override {
    const std::string is = now[std::string(part)];
    return {is == mode ? absl::OkStatus() : absl::FailedPreconditionError("drifted"), is};
  }

  PartReading Read(absl::string_view part, absl::Duration at_most,
                   const CancelFlag& cancel) override {
    const auto is = now.find(std::string(part));
    if (is != now.end()) {
      return {.agreeing = {is->second}, .named = {}, .answers = 1, .complete = true};
    }
    if (hangs) {
      hanging.Cancel();
      cancel.WaitFor(at_most);
    }
    return {.complete = !hangs};
  }

  bool lies = false;
  bool hangs = false;
  CancelFlag hanging;  // set when a reading hangs
  std::vector<std::string> orders;
  std::map<std::string, std::string> now;
};

// Programs that end at once with what `results` says for their name; "hang" ends when cancelled.
class FakePrograms : public ProgramRunner {
 public:
  absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) override {
    MutexLock lock(&mu_);
    runs.push_back(request.name);
    if (busy > 0 && busy-- > 0) return absl::ResourceExhaustedError("busy");
    const uint64_t id = runs.size();
    if (request.name == "hang") {
      hanging_[id] = std::move(done);
    } else {
      done({.status = results[request.name]});
    }
    return id;
  }
  absl::Status Examine(absl::string_view) override { return absl::OkStatus(); }
  void Cancel(uint64_t run) override {
    MutexLock lock(&mu_);
    const auto hanging = hanging_.find(run);
    if (hanging == hanging_.end()) return;
    hanging->second({.status = absl::CancelledError("cancelled")});
    hanging_.erase(hanging);
  }

  int busy = 0;
  std::vector<std::string> runs;
  std::map<std::string, absl::Status> results;

 private:
  Mutex mu_;
  std::map<uint64_t, Done> hanging_;
};

// Alarms that do as they are told, except where the test says otherwise.
class FakeAlarms : public Alarms {
 public:
  absl::StatusOr<uint64_t> Begin(absl::string_view alarm, AlarmOrder order,
                                 const AlarmState& state) override {
    const std::string name(alarm);
    AlarmResult result;
    if (order == AlarmOrder::kSet) {
      told.push_back(absl::StrCat(alarm, "=", ToString(state)));
      if (!failures[name].empty()) {
        result.status = failures[name].front();
        failures[name].pop_front();
      } else if (!stuck) {
        now[name] = state;
      }
    }
    if (gone) result.status = absl::NotFoundError("not plugged in");
    if (result.status.ok() && now[name] != state) {
      result.status = absl::FailedPreconditionError("it is otherwise");
    }
    if (result.status.ok()) result.detail = "it is as told (read back)";
    result.observed = gone ? "?" : ToString(now[name]);
    results_[++orders_] = std::move(result);
    return orders_;
  }
  std::optional<AlarmResult> Poll(uint64_t order) override {
    if (silent) return std::nullopt;
    return results_.at(order);
  }
  void Drop(uint64_t order) override { results_.erase(order); }
  void Leave(uint64_t order) override { results_.erase(order); }

  bool gone = false;                                         // nothing is plugged in
  bool stuck = false;                                        // orders have no effect
  bool silent = false;                                       // orders do not end
  std::map<std::string, std::deque<absl::Status>> failures;  // of the next orders to set
  std::map<std::string, AlarmState> now;
  std::vector<std::string> told;

 private:
  uint64_t orders_ = 0;
  std::map<uint64_t, AlarmResult> results_;
};

Step Alarm(const std::string& device, AlarmPattern pattern, OnFailure on_failure = OnFailure::kFail,
           int retries = 0) {
  return {AlarmStep{device, {pattern, {}}}, absl::Seconds(1), retries, on_failure};
}

// A firewall that does as it is told, except where the test says otherwise.
class FakeFirewall : public FirewallControl {
 public:
  StepReading Enter(const Step& step, absl::Duration timeout, int retries,
                    const CancelFlag&) override {
    orders.push_back(MakeFirewallStep(step, this, nullptr)->Name());
    timeouts.push_back(timeout);
    tries.push_back(retries);
    return {status, "firewall=x", note};
  }
  StepReading Check(const Step&, const CancelFlag&) override { return {status, "firewall=x", ""}; }

  absl::Status status;
  std::string note;
  std::vector<std::string> orders;
  std::vector<absl::Duration> timeouts;
  std::vector<int> tries;
};

Step Wall(FirewallStep::Kind kind, OnFailure on_failure = OnFailure::kFail) {
  return {FirewallStep{.kind = kind, .file = "/a.nft", .targets = {"10.0.0.7"}}, absl::Seconds(3),
          1, on_failure};
}

Step Mode(const std::string& mode, OnFailure on_failure = OnFailure::kFail) {
  return {SystemModeStep{"/safety", mode}, absl::Seconds(5), 0, on_failure};
}
Step Program(const std::string& name, OnFailure on_failure = OnFailure::kFail, int retries = 0) {
  return {ProgramStep{name, {}}, absl::Seconds(5), retries, on_failure};
}

class LevelExecutorTest : public ::testing::Test {
 protected:
  LevelOutcome Run(const std::string& from, const std::string& to, bool raise,
                   JobKind kind = JobKind::kEnter) {
    LevelExecutor& procedures = Get();
    return procedures.Run({1, kind, from, to, raise}, cancel_);
  }
  LevelExecutor& Get() {
    if (!procedures_) {
      procedures_ = std::make_unique<LevelExecutor>(&levels_, StepPorts{.modes = &modes_,
                                                                        .programs = &programs_,
                                                                        .alarms = &alarms_,
                                                                        .firewall = &firewall_,
                                                                        .clock = &clock_});
    }
    return *procedures_;
  }

  std::vector<LevelSpec> levels_ = {
      {"DEFAULT", {Mode("__DEFAULT__")}, {}},
      {"ALERT", {Program("horn"), Mode("ALERT"), Program("light")}, {Program("quiet")}},
  };
  RealClock clock_;
  FakeModes modes_;
  FakePrograms programs_;
  FakeAlarms alarms_;
  FakeFirewall firewall_;
  CancelFlag cancel_;
  std::unique_ptr<LevelExecutor> procedures_;
};

std::vector<std::string> Names(const LevelOutcome& outcome) {
  std::vector<std::string> names;
  for (const StepResult& step : outcome.steps) names.push_back(step.step + (step.ok ? "" : " !"));
  return names;
}

TEST_F(LevelExecutorTest, EntersSystemModesFirstAndThenThePrograms) {
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_TRUE(outcome.reached) << outcome.detail;
  EXPECT_THAT(Names(outcome),
              ElementsAre("system_mode /safety=ALERT", "program horn", "program light"));
  EXPECT_EQ(outcome.observed, "/safety=ALERT");
}

TEST_F(LevelExecutorTest, ARaiseWhoseModeIsNotReachedStillRunsTheProgramsAndFails) {
  modes_.lies = true;
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_FALSE(outcome.reached);
  EXPECT_EQ(outcome.detail, "system_mode /safety=ALERT: not reached");
  EXPECT_THAT(programs_.runs, ElementsAre("horn", "light"));
}

TEST_F(LevelExecutorTest, OnDriftRunsItsStepsAndItsModeHoldsUntilALevelIsEntered) {
  levels_[1].on_drift = {Mode("HALT"), Program("siren")};
  ASSERT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true, JobKind::kOnDrift);
  EXPECT_TRUE(outcome.reached) << outcome.detail;
  EXPECT_THAT(Names(outcome), ElementsAre("system_mode /safety=HALT", "program siren"));

  const LevelOutcome check = Run("DEFAULT", "ALERT", true, JobKind::kCheck);
  EXPECT_TRUE(check.reached);
  EXPECT_EQ(check.observed, "/safety=HALT");
  ASSERT_TRUE(Run("DEFAULT", "ALERT", true, JobKind::kRetry).reached);
  EXPECT_EQ(modes_.now["/safety"], "HALT");
  ASSERT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_EQ(modes_.now["/safety"], "ALERT");
}

TEST_F(LevelExecutorTest, AFailedOnDriftStepIsToldAndItsModeIsNotWaitedFor) {
  levels_[1].on_drift = {Mode("HALT", OnFailure::kStop), Program("siren")};
  ASSERT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  modes_.lies = true;
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true, JobKind::kOnDrift);
  EXPECT_FALSE(outcome.reached);
  EXPECT_EQ(outcome.detail, "system_mode /safety=HALT: not reached");
  EXPECT_THAT(programs_.runs, ElementsAre("horn", "light"));
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true, JobKind::kCheck).reached);
  cancel_.Cancel();
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true, JobKind::kOnDrift).reached);
}

TEST_F(LevelExecutorTest, StopStopsARaise) {
  levels_[1].enter[1].on_failure = OnFailure::kStop;
  modes_.lies = true;
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_FALSE(outcome.reached);
  EXPECT_THAT(Names(outcome),
              ElementsAre("system_mode /safety=ALERT !", "program horn !", "program light !"));
  EXPECT_TRUE(programs_.runs.empty());
}

TEST_F(LevelExecutorTest, AProgramMayFailWhereTheFileSaysContinue) {
  programs_.results["horn"] = absl::AbortedError("exit code 1");
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  levels_[1].enter[0].on_failure = OnFailure::kContinue;
  procedures_.reset();
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_TRUE(outcome.reached);
  EXPECT_THAT(outcome.detail, HasSubstr("program horn: exit code 1"));
  // A system mode that was not read back is never reached.
  levels_[1].enter[1].on_failure = OnFailure::kContinue;
  procedures_.reset();
  modes_.lies = true;
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
}

TEST_F(LevelExecutorTest, ALoweringStopsAtAFailedLeaveStepAndItsRetryGoesOn) {
  programs_.results["quiet"] = absl::AbortedError("exit code 1");
  EXPECT_FALSE(Run("ALERT", "DEFAULT", false).reached);
  EXPECT_TRUE(modes_.orders.empty());
  programs_.results["quiet"] = absl::OkStatus();
  EXPECT_TRUE(Run("ALERT", "DEFAULT", false, JobKind::kRetry).reached);
  EXPECT_THAT(modes_.orders, ElementsAre("/safety=__DEFAULT__"));
}

TEST_F(LevelExecutorTest, ARetryDoesNotRunAgainWhatSucceeded) {
  programs_.results["light"] = absl::AbortedError("exit code 1");
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  programs_.results["light"] = absl::OkStatus();
  programs_.runs.clear();
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true, JobKind::kRetry).reached);
  EXPECT_THAT(programs_.runs, ElementsAre("light"));
  EXPECT_THAT(modes_.orders, ElementsAre("/safety=ALERT", "/safety=ALERT"));
}

TEST_F(LevelExecutorTest, LeavingCannotHoldUpARaise) {
  levels_.push_back({"HALT", {Mode("HALT")}, {}});
  levels_[1].leave = {Program("hang"), Program("quiet")};
  const int64_t began = clock_.Now().boottime_ns;

  const LevelOutcome outcome = Run("ALERT", "HALT", true);

  EXPECT_TRUE(outcome.reached);
  EXPECT_LT(clock_.Now().boottime_ns - began, 4 * kNanosPerSecond);
  EXPECT_THAT(Names(outcome),
              ElementsAre("program hang !", "program quiet !", "system_mode /safety=HALT"));
  EXPECT_THAT(outcome.steps[1].detail, HasSubstr("not run"));
}

TEST_F(LevelExecutorTest, WaitsForABusyProgramAndRetriesAFailedOne) {
  levels_[1].enter = {Program("horn")};
  programs_.busy = 2;
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_EQ(programs_.runs.size(), 3u);

  levels_[1].enter = {Program("horn", OnFailure::kFail, /*retries=*/2)};
  procedures_.reset();
  programs_.results["horn"] = absl::AbortedError("exit code 1");
  programs_.runs.clear();
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_EQ(programs_.runs.size(), 3u);
}

TEST_F(LevelExecutorTest, ACheckOnlyLooks) {
  EXPECT_FALSE(Run("", "ALERT", true, JobKind::kCheck).reached);
  modes_.now["/safety"] = "ALERT";
  EXPECT_TRUE(Run("", "ALERT", true, JobKind::kCheck).reached);
  EXPECT_TRUE(modes_.orders.empty());
  EXPECT_TRUE(programs_.runs.empty());
}

// --- alarms

TEST_F(LevelExecutorTest, AlarmsRunAfterTheSystemModesBesideThePrograms) {
  levels_[1].enter = {Alarm("relay", AlarmPattern::kOn), Program("horn"), Mode("ALERT")};
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_TRUE(outcome.reached) << outcome.detail;
  EXPECT_THAT(Names(outcome),
              ElementsAre("system_mode /safety=ALERT", "alarm relay=on", "program horn"));
  EXPECT_EQ(outcome.steps[1].detail, "it is as told (read back)");
  EXPECT_EQ(outcome.observed, "/safety=ALERT relay=on");
}

TEST_F(LevelExecutorTest, AStoppedRaiseDoesNotTellTheAlarms) {
  levels_[1].enter = {Alarm("relay", AlarmPattern::kOn), Mode("ALERT", OnFailure::kStop)};
  modes_.lies = true;
  EXPECT_THAT(Names(Run("DEFAULT", "ALERT", true)),
              ElementsAre("system_mode /safety=ALERT !", "alarm relay=on !"));
  EXPECT_TRUE(alarms_.told.empty());
}

TEST_F(LevelExecutorTest, AnAlarmIsTriedAgain) {
  levels_[1].enter = {Alarm("relay", AlarmPattern::kOn, OnFailure::kFail, /*retries=*/2)};
  alarms_.failures["relay"] = {absl::UnavailableError("EIO"), absl::NotFoundError("gone")};
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_EQ(alarms_.told.size(), 3u);
}

TEST_F(LevelExecutorTest, AnAlarmMayFailWhereTheFileSaysContinue) {
  levels_[1].enter = {Alarm("relay", AlarmPattern::kOn)};
  alarms_.gone = true;
  const LevelOutcome failed = Run("DEFAULT", "ALERT", true);
  EXPECT_FALSE(failed.reached);
  EXPECT_EQ(failed.detail, "alarm relay=on: not plugged in");
  EXPECT_EQ(failed.observed, "relay=?");
  levels_[1].enter[0].on_failure = OnFailure::kContinue;
  procedures_.reset();
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_TRUE(outcome.reached);
  EXPECT_EQ(outcome.detail, "alarm relay=on: not plugged in");
}

TEST_F(LevelExecutorTest, ALoweringStopsAtAnAlarmThatCannotBeSwitchedOff) {
  levels_[1].leave = {Alarm("relay", AlarmPattern::kOff)};
  alarms_.now["relay"] = {AlarmPattern::kOn, {}};
  alarms_.stuck = true;
  EXPECT_FALSE(Run("ALERT", "DEFAULT", false).reached);
  EXPECT_TRUE(modes_.orders.empty());
  alarms_.stuck = false;
  EXPECT_TRUE(Run("ALERT", "DEFAULT", false, JobKind::kRetry).reached);
}

TEST_F(LevelExecutorTest, ARetryTellsAlarmsAgain) {
  levels_[1].enter = {Alarm("relay", AlarmPattern::kOn), Program("horn")};
  programs_.results["horn"] = absl::AbortedError("exit code 1");
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  programs_.results["horn"] = absl::OkStatus();
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true, JobKind::kRetry).reached);
  EXPECT_THAT(alarms_.told, ElementsAre("relay=on", "relay=on"));
}

TEST_F(LevelExecutorTest, ASilentAlarmHoldsUpNeitherARaiseNorItsEnd) {
  levels_.push_back({"HALT", {Mode("HALT")}, {}});
  levels_[1].leave = {Alarm("relay", AlarmPattern::kOff, OnFailure::kFail, /*retries=*/20)};
  alarms_.silent = true;
  const LevelOutcome outcome = Run("ALERT", "HALT", true);
  EXPECT_TRUE(outcome.reached);
  EXPECT_THAT(Names(outcome), ElementsAre("alarm relay=off !", "system_mode /safety=HALT"));
}

TEST_F(LevelExecutorTest, ACheckLooksAtAlarms) {
  levels_[1].enter = {Alarm("relay", AlarmPattern::kOn)};
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  alarms_.told.clear();
  const LevelOutcome held = Run("", "ALERT", true, JobKind::kCheck);
  EXPECT_TRUE(held.reached);
  EXPECT_EQ(held.observed, "relay=on");
  alarms_.now["relay"] = {AlarmPattern::kOff, {}};
  const LevelOutcome left = Run("", "ALERT", true, JobKind::kCheck);
  EXPECT_FALSE(left.reached);
  EXPECT_EQ(left.detail, "alarm relay=on: it is otherwise");
  EXPECT_EQ(left.observed, "relay=off");
  EXPECT_TRUE(alarms_.told.empty()) << "a check only looks";
  alarms_.silent = true;
  EXPECT_FALSE(Run("", "ALERT", true, JobKind::kCheck).reached);
}

TEST_F(LevelExecutorTest, WhatACheckMakesOfAnAlarmWithContinue) {
  levels_[1].enter = {Alarm("relay", AlarmPattern::kOn, OnFailure::kContinue)};
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  // Not there: held, there is nothing to do. Back again and off: left, it is told again.
  alarms_.gone = true;
  EXPECT_TRUE(Run("", "ALERT", true, JobKind::kCheck).reached);
  alarms_.gone = false;
  alarms_.now["relay"] = {AlarmPattern::kOff, {}};
  EXPECT_FALSE(Run("", "ALERT", true, JobKind::kCheck).reached);
  // It does not do as told: held, telling it for ever does not help.
  alarms_.stuck = true;
  EXPECT_TRUE(Run("", "ALERT", true, JobKind::kRetry).reached);
  EXPECT_TRUE(Run("", "ALERT", true, JobKind::kCheck).reached);
  // It was once as told, by whoever, and then is not: left.
  alarms_.now["relay"] = {AlarmPattern::kOn, {}};
  EXPECT_TRUE(Run("", "ALERT", true, JobKind::kCheck).reached);
  alarms_.now["relay"] = {AlarmPattern::kOff, {}};
  EXPECT_FALSE(Run("", "ALERT", true, JobKind::kCheck).reached);
}

TEST_F(LevelExecutorTest, ANewJobEndsTheRunningOne) {
  levels_[1].enter = {Mode("ALERT"), Program("hang")};
  levels_.push_back({"HALT", {Mode("HALT")}, {}});
  Mutex mu;
  CondVar changed;
  std::vector<LevelOutcome> outcomes;
  LevelWorker worker(&Get(), {.done = [&](LevelOutcome outcome) {
    MutexLock lock(&mu);
    outcomes.push_back(std::move(outcome));
    changed.NotifyAll();
  }});

  worker.Submit({1, JobKind::kEnter, "DEFAULT", "ALERT", true});
  worker.Submit({2, JobKind::kEnter, "ALERT", "HALT", true});

  MutexLock lock(&mu);
  for (int i = 0; i < 100 && (outcomes.empty() || outcomes.back().attempt != 2); ++i) {
    changed.WaitFor(lock, absl::Milliseconds(100));
  }
  ASSERT_FALSE(outcomes.empty());
  EXPECT_EQ(outcomes.back().attempt, 2u);
  EXPECT_TRUE(outcomes.back().reached);
  if (outcomes.size() == 2) {
    EXPECT_FALSE(outcomes.front().reached);
  }
}

TEST_F(LevelExecutorTest, ASurveyTellsTheLevelThatTheRobotShowsAndDoesNothing) {
  modes_.now["/safety"] = "ALERT";
  const LevelOutcome outcome = Run("", "", true, JobKind::kSurvey);
  EXPECT_EQ(outcome.kind, JobKind::kSurvey);
  EXPECT_TRUE(outcome.reached);
  EXPECT_EQ(outcome.shown, "ALERT");
  EXPECT_EQ(outcome.observed, "/safety=ALERT");
  EXPECT_TRUE(outcome.steps.empty());
  EXPECT_TRUE(modes_.orders.empty());
  EXPECT_TRUE(programs_.runs.empty());

  modes_.now["/safety"] = "DANCE";
  EXPECT_FALSE(Run("", "", true, JobKind::kSurvey).reached);
  levels_ = {{"DEFAULT", {Program("horn")}, {}}};
  EXPECT_EQ(Run("", "", true, JobKind::kSurvey).shown, "");
}

TEST_F(LevelExecutorTest, ARaiseEndsASurveyWhichTellsWhatItHasRead) {
  levels_.push_back({"HALT", {Mode("HALT")}, {}});
  levels_.back().enter.push_back({SystemModeStep{"/arm", "PARKED"}, absl::Seconds(5)});
  modes_.now["/arm"] = "PARKED";
  modes_.hangs = true;  // /safety, which is asked after /arm
  Mutex mu;
  CondVar changed;
  std::vector<LevelOutcome> outcomes;
  std::vector<std::string> order;
  LevelWorker worker(&Get(), {
                                 .done =
                                     [&](LevelOutcome outcome) {
                                       MutexLock lock(&mu);
                                       outcomes.push_back(std::move(outcome));
                                       order.push_back("done");
                                       changed.NotifyAll();
                                     },
                                 .idle_check =
                                     [&] {
                                       MutexLock lock(&mu);
                                       order.push_back("idle check");
                                       changed.NotifyAll();
                                       return absl::OkStatus();
                                     },
                                 .idle_checked = [](const absl::Status&) {},
                             });

  worker.Submit({1, JobKind::kSurvey, "", "", true});
  modes_.hanging.WaitFor(absl::Seconds(10));  // until /safety is being read
  worker.Submit({2, JobKind::kCheck, "", "ALERT", true});

  MutexLock lock(&mu);
  for (int i = 0; i < 100 && order.size() < 3; ++i) {
    changed.WaitFor(lock, absl::Milliseconds(100));
  }
  ASSERT_EQ(outcomes.size(), 2u);
  EXPECT_EQ(outcomes[0].attempt, 1u);
  EXPECT_EQ(outcomes[0].shown, "HALT");
  EXPECT_EQ(outcomes[1].attempt, 2u);
  // What people are told can wait until a level was entered.
  EXPECT_THAT(order, ElementsAre("done", "done", "idle check"));
}

using Kind = FirewallStep::Kind;

TEST_F(LevelExecutorTest, FirewallStepsComeInOrderWithTheModesAndBeforePrograms) {
  levels_[1].enter = {Program("horn"), Wall(Kind::kRules), Mode("ALERT"),
                      Wall(Kind::kIsolateHosts)};
  firewall_.note = "all is well";
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_TRUE(outcome.reached) << outcome.detail;
  EXPECT_THAT(Names(outcome), ElementsAre("firewall /a.nft", "system_mode /safety=ALERT",
                                          "firewall isolate_host 10.0.0.7", "program horn"));
  EXPECT_EQ(outcome.observed, "firewall=x /safety=ALERT firewall=x");
  EXPECT_EQ(outcome.steps[0].detail, "all is well");
  EXPECT_THAT(firewall_.tries, ElementsAre(1, 1));
}

TEST_F(LevelExecutorTest, AllKindsOfStepsInOneLevel) {
  levels_[1].enter = {Alarm("relay", AlarmPattern::kOn), Wall(Kind::kRules), Program("horn"),
                      Mode("ALERT")};
  const LevelOutcome entered = Run("DEFAULT", "ALERT", true);
  EXPECT_TRUE(entered.reached) << entered.detail;
  EXPECT_THAT(Names(entered), ElementsAre("firewall /a.nft", "system_mode /safety=ALERT",
                                          "alarm relay=on", "program horn"));
  EXPECT_EQ(entered.observed, "firewall=x /safety=ALERT relay=on");
  const LevelOutcome held = Run("", "ALERT", true, JobKind::kCheck);
  EXPECT_TRUE(held.reached) << held.detail;
  EXPECT_EQ(held.observed, "firewall=x /safety=ALERT relay=on");
}

TEST_F(LevelExecutorTest, AFirewallThatFailsDoesNotSilenceTheAlarmsUnlessItStops) {
  levels_[1].enter = {Wall(Kind::kRules), Alarm("relay", AlarmPattern::kOn)};
  firewall_.status = absl::UnavailableError("nobody there");
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_THAT(alarms_.told, ElementsAre("relay=on"));
  levels_[1].enter[0].on_failure = OnFailure::kStop;
  procedures_.reset();
  alarms_.told.clear();
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_TRUE(alarms_.told.empty());
}

TEST_F(LevelExecutorTest, AFirewallThatFailsFailsTheLevelWithItsReason) {
  levels_[1].enter = {Wall(Kind::kRules, OnFailure::kContinue), Mode("ALERT")};
  firewall_.status = absl::UnavailableError("nobody there");
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_FALSE(outcome.reached);
  EXPECT_EQ(outcome.detail, "firewall /a.nft: nobody there");
  EXPECT_THAT(Names(outcome), ElementsAre("firewall /a.nft !", "system_mode /safety=ALERT"));
}

TEST_F(LevelExecutorTest, AFirewallThatFailsCanStop) {
  levels_[1].enter = {Wall(Kind::kRules, OnFailure::kStop), Mode("ALERT"), Program("horn")};
  firewall_.status = absl::UnavailableError("nobody there");
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_FALSE(outcome.reached);
  EXPECT_TRUE(modes_.orders.empty());
  EXPECT_TRUE(programs_.runs.empty());
}

TEST_F(LevelExecutorTest, AFirewallThatWasChangedIsADrift) {
  levels_[1].enter = {Wall(Kind::kRules)};
  ASSERT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_TRUE(Run("", "ALERT", true, JobKind::kCheck).reached);
  firewall_.status = absl::FailedPreconditionError("table deleted");
  const LevelOutcome outcome = Run("", "ALERT", true, JobKind::kCheck);
  EXPECT_FALSE(outcome.reached);
  EXPECT_EQ(outcome.detail, "firewall /a.nft: table deleted");
}

TEST_F(LevelExecutorTest, ARaiseDoesNotReleaseAndALoweringDoes) {
  levels_[1].enter = {Wall(Kind::kRules)};
  levels_[1].leave = {Wall(Kind::kRelease)};
  levels_.push_back({"HALT", {}, {}});
  const LevelOutcome raise = Run("ALERT", "HALT", true);
  EXPECT_TRUE(raise.reached);
  EXPECT_THAT(Names(raise), ElementsAre("firewall release"));
  EXPECT_THAT(raise.steps[0].detail, HasSubstr("a raise opens nothing"));
  EXPECT_TRUE(firewall_.orders.empty());

  const LevelOutcome lowering = Run("ALERT", "DEFAULT", false);
  EXPECT_TRUE(lowering.reached);
  EXPECT_THAT(firewall_.orders, ElementsAre("firewall release"));
}

}  // namespace
}  // namespace rips::actuator
