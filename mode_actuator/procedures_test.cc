#include "mode_actuator/procedures.h"

#include <map>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/workers.h"
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

  bool lies = false;
  bool hangs = false;
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

Step Mode(const std::string& mode, OnFailure on_failure = OnFailure::kFail) {
  return {SystemModeStep{"/safety", mode}, absl::Seconds(5), 0, on_failure};
}
Step Program(const std::string& name, OnFailure on_failure = OnFailure::kFail, int retries = 0) {
  return {ProgramStep{name, {}}, absl::Seconds(5), retries, on_failure};
}

class ProceduresTest : public ::testing::Test {
 protected:
  LevelOutcome Run(const std::string& from, const std::string& to, bool raise,
                   JobKind kind = JobKind::kEnter) {
    Procedures& procedures = Get();
    return procedures.Run({1, kind, from, to, raise}, cancel_);
  }
  Procedures& Get() {
    if (!procedures_) {
      procedures_ = std::make_unique<Procedures>(&levels_, &modes_, &programs_, &clock_);
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
  CancelFlag cancel_;
  std::unique_ptr<Procedures> procedures_;
};

std::vector<std::string> Names(const LevelOutcome& outcome) {
  std::vector<std::string> names;
  for (const StepResult& step : outcome.steps) names.push_back(step.step + (step.ok ? "" : " !"));
  return names;
}

TEST_F(ProceduresTest, EntersSystemModesFirstAndThenThePrograms) {
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_TRUE(outcome.reached) << outcome.detail;
  EXPECT_THAT(Names(outcome),
              ElementsAre("system_mode /safety=ALERT", "program horn", "program light"));
  EXPECT_EQ(outcome.observed, "/safety=ALERT");
}

TEST_F(ProceduresTest, ARaiseWhoseModeIsNotReachedStillRunsTheProgramsAndFails) {
  modes_.lies = true;
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_FALSE(outcome.reached);
  EXPECT_EQ(outcome.detail, "system_mode /safety=ALERT: not reached");
  EXPECT_THAT(programs_.runs, ElementsAre("horn", "light"));
}

TEST_F(ProceduresTest, StopStopsARaise) {
  levels_[1].enter[1].on_failure = OnFailure::kStop;
  modes_.lies = true;
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_FALSE(outcome.reached);
  EXPECT_THAT(Names(outcome),
              ElementsAre("system_mode /safety=ALERT !", "program horn !", "program light !"));
  EXPECT_TRUE(programs_.runs.empty());
}

TEST_F(ProceduresTest, AProgramMayFailWhereTheFileSaysContinue) {
  programs_.results["horn"] = absl::AbortedError("exit code 1");
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  levels_[1].enter[0].on_failure = OnFailure::kContinue;
  const LevelOutcome outcome = Run("DEFAULT", "ALERT", true);
  EXPECT_TRUE(outcome.reached);
  EXPECT_THAT(outcome.detail, HasSubstr("program horn: exit code 1"));
  // A system mode that was not read back is never reached.
  levels_[1].enter[1].on_failure = OnFailure::kContinue;
  modes_.lies = true;
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
}

TEST_F(ProceduresTest, ALoweringStopsAtAFailedLeaveStepAndItsRetryGoesOn) {
  programs_.results["quiet"] = absl::AbortedError("exit code 1");
  EXPECT_FALSE(Run("ALERT", "DEFAULT", false).reached);
  EXPECT_TRUE(modes_.orders.empty());
  programs_.results["quiet"] = absl::OkStatus();
  EXPECT_TRUE(Run("ALERT", "DEFAULT", false, JobKind::kRetry).reached);
  EXPECT_THAT(modes_.orders, ElementsAre("/safety=__DEFAULT__"));
}

TEST_F(ProceduresTest, ARetryDoesNotRunAgainWhatSucceeded) {
  programs_.results["light"] = absl::AbortedError("exit code 1");
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  programs_.results["light"] = absl::OkStatus();
  programs_.runs.clear();
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true, JobKind::kRetry).reached);
  EXPECT_THAT(programs_.runs, ElementsAre("light"));
  EXPECT_THAT(modes_.orders, ElementsAre("/safety=ALERT", "/safety=ALERT"));
}

TEST_F(ProceduresTest, LeavingCannotHoldUpARaise) {
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

TEST_F(ProceduresTest, WaitsForABusyProgramAndRetriesAFailedOne) {
  levels_[1].enter = {Program("horn")};
  programs_.busy = 2;
  EXPECT_TRUE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_EQ(programs_.runs.size(), 3u);

  levels_[1].enter = {Program("horn", OnFailure::kFail, /*retries=*/2)};
  programs_.results["horn"] = absl::AbortedError("exit code 1");
  programs_.runs.clear();
  EXPECT_FALSE(Run("DEFAULT", "ALERT", true).reached);
  EXPECT_EQ(programs_.runs.size(), 3u);
}

TEST_F(ProceduresTest, ACheckOnlyLooks) {
  EXPECT_FALSE(Run("", "ALERT", true, JobKind::kCheck).reached);
  modes_.now["/safety"] = "ALERT";
  EXPECT_TRUE(Run("", "ALERT", true, JobKind::kCheck).reached);
  EXPECT_TRUE(modes_.orders.empty());
  EXPECT_TRUE(programs_.runs.empty());
}

TEST_F(ProceduresTest, ANewJobEndsTheRunningOne) {
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

}  // namespace
}  // namespace rips::actuator
