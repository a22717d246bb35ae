#include "mode_actuator/steps/drill.h"

#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/level_executor.h"
#include "mode_actuator/steps/workers.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr AlarmState kOn = {AlarmPattern::kOn, {}};
constexpr AlarmState kOff = {};

// Counts what changes the robot; a drill must leave it at nothing.
class FakeModes : public PartModes {
 public:
  ModeReading Enter(absl::string_view, absl::string_view, absl::Duration, int,
                    const CancelFlag&) override {
    ++orders;
    return {absl::OkStatus(), "x"};
  }
  ModeReading Check(absl::string_view, absl::string_view mode, const CancelFlag&) override {
    ++looks;
    if (check_hangs) {
      begun.Cancel();
      go_on.WaitFor(absl::Seconds(30));
    }
    return {absl::OkStatus(), std::string(mode)};
  }
  ModeReading Probe(absl::string_view, absl::string_view, const CancelFlag& cancel) override {
    if (hangs) {
      begun.Cancel();
      while (!cancel.WaitFor(absl::Seconds(1))) {
      }
      return {absl::CancelledError("cancelled"), "?"};
    }
    return {probe, "DEFAULT"};
  }

  int orders = 0;
  int looks = 0;
  absl::Status probe;
  bool hangs = false;
  bool check_hangs = false;
  CancelFlag begun;
  CancelFlag go_on;
};

// A mode that can only be ordered.
class OldModes : public FakeModes {
 public:
  ModeReading Probe(absl::string_view part, absl::string_view mode,
                    const CancelFlag& cancel) override {
    return PartModes::Probe(part, mode, cancel);
  }
};

class FakePrograms : public ProgramRunner {
 public:
  absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) override {
    runs.push_back(absl::StrCat(request.name, request.drill ? " as a drill" : ""));
    if (!start.ok()) return start;
    if (hangs) {
      hanging_ = std::move(done);
      began.Cancel();
      return 7;
    }
    ProgramResult result;
    result.status = end;
    result.begun = begun;
    result.output_tail = output;
    done(std::move(result));
    return 7;
  }
  void Cancel(uint64_t) override {
    ProgramResult result;
    result.status = absl::CancelledError("cancelled");
    if (hanging_) std::exchange(hanging_, nullptr)(std::move(result));
  }
  absl::Status Examine(absl::string_view name) override {
    examined.emplace_back(name);
    return examine;
  }

  absl::Status start, end, examine;
  std::string output;
  bool hangs = false;
  bool begun = true;
  CancelFlag began;
  std::vector<std::string> runs;
  std::vector<std::string> examined;

 private:
  Done hanging_;
};

class FakeAlarms : public Alarms {
 public:
  absl::StatusOr<uint64_t> Begin(absl::string_view alarm, AlarmOrder order,
                                 const AlarmState& state) override {
    AlarmResult result;
    if (order == AlarmOrder::kSet) {
      told.push_back(absl::StrCat(alarm, "=", ToString(state)));
      if (state == kOff && !stays_on.ok()) {
        result.status = stays_on;
      } else {
        now = state;
      }
      if (state != kOff && !fails.ok()) result.status = fails;
    } else if (!look.ok()) {
      result.status = look;
    } else if (now != state) {
      result.status = absl::FailedPreconditionError("it is otherwise");
    }
    result.observed = readable && look.ok() ? ToString(now) : "?";
    if (result.status.ok()) result.detail = "it is as told (read back)";
    results_[++orders_] = std::move(result);
    if (order == AlarmOrder::kSet && state != kOff) lit.Cancel();
    return orders_;
  }
  std::optional<AlarmResult> Poll(uint64_t order) override {
    if (silent_off && !told.empty() && told.back().ends_with("=off")) return std::nullopt;
    return results_.at(order);
  }
  void Drop(uint64_t) override {}
  void Leave(uint64_t) override { ++left; }

  AlarmState now = kOff;
  absl::Status look, fails, stays_on;
  bool readable = true;
  bool silent_off = false;  // orders to be off do not end
  CancelFlag lit;
  int left = 0;
  std::vector<std::string> told;

 private:
  uint64_t orders_ = 0;
  std::map<uint64_t, AlarmResult> results_;
};

class FakeFirewall : public FirewallControl {
 public:
  StepReading Enter(const Step&, absl::Duration, int, const CancelFlag&) override {
    ++entered;
    return {absl::OkStatus(), "", ""};
  }
  StepReading Check(const Step&, const CancelFlag&) override { return {absl::OkStatus(), "", ""}; }
  StepReading Drill(const Step&, const CancelFlag&) override { return {status, "", "dry run"}; }

  int entered = 0;
  absl::Status status;
};

Step Mode() { return {SystemModeStep{"/safety", "ALERT"}, absl::Seconds(1), 0}; }
Step Program(const std::string& name) { return {ProgramStep{name, {"-x"}}, absl::Seconds(5), 0}; }
Step Alarm(const AlarmState& state = kOn) {
  return {AlarmStep{"siren", state}, absl::Seconds(1), 0};
}
Step Wall() {
  return {FirewallStep{.kind = FirewallStep::Kind::kRules, .file = "/a.nft"}, absl::Seconds(1), 0};
}

class DrillTest : public ::testing::Test {
 protected:
  DrillOutcome Run(const std::string& level = "ALERT", const std::string& held = "DEFAULT") {
    return Make().Run({"id", level, held}, cancel_, between_);
  }
  StepPorts Ports() {
    return {.modes = modes_.get(),
            .programs = &programs_,
            .alarms = &alarms_,
            .firewall = &firewall_,
            .clock = &clock_,
            .allowed = &allowed_,
            .devices = &devices_};
  }
  Drill Make() { return Drill(levels_, Ports()); }
  StepResult Only(const Step& step, const std::string& held = "DEFAULT") {
    levels_[1].enter = {step};
    levels_[1].leave = {};
    const DrillOutcome outcome = Run("ALERT", held);
    EXPECT_THAT(outcome.steps, SizeIs(1));
    return outcome.steps.at(0);
  }
  // Nothing was ordered, loaded or left on.
  void ExpectUnchanged() const {
    EXPECT_EQ(modes_->orders, 0);
    EXPECT_EQ(firewall_.entered, 0);
    EXPECT_EQ(alarms_.now, kOff);
    for (const std::string& run : programs_.runs) EXPECT_THAT(run, HasSubstr("as a drill"));
  }

  std::vector<LevelSpec> levels_ = {
      {"DEFAULT", {Mode()}, {}},
      {"ALERT", {Mode(), Wall(), Program("horn"), Program("plain"), Alarm()}, {Program("horn")}},
      {"LOUD", {Alarm()}, {}},
  };
  std::vector<ProgramSpec> allowed_;
  std::vector<AlarmSpec> devices_ = {{.name = "siren", .flash_in_drills = true}};
  RealClock clock_;
  std::unique_ptr<FakeModes> modes_ = std::make_unique<FakeModes>();
  FakePrograms programs_;
  FakeAlarms alarms_;
  FakeFirewall firewall_;
  CancelFlag cancel_;
  std::function<void()> between_;

  void SetUp() override {
    ProgramSpec horn;
    horn.name = "horn";
    horn.drill = true;
    ProgramSpec plain;
    plain.name = "plain";
    allowed_ = {horn, plain};
  }
};

TEST_F(DrillTest, TriesEveryStepAndLeavesTheRobotAsItIs) {
  int calls = 0;
  between_ = [&] { ++calls; };
  const DrillOutcome outcome = Run();
  EXPECT_EQ(outcome.id, "id");
  EXPECT_FALSE(outcome.cancelled);
  std::vector<std::string> names;
  for (const StepResult& step : outcome.steps) {
    EXPECT_TRUE(step.ok) << step.step << ": " << step.detail;
    names.push_back(absl::StrCat(step.step, " ", static_cast<int>(step.drilled)));
  }
  EXPECT_THAT(names,
              ElementsAre("system_mode /safety=ALERT 2", "firewall /a.nft 2", "program horn 1",
                          "program plain 2", "alarm siren=on 1", "leave: program horn 1"));
  EXPECT_THAT(programs_.runs, ElementsAre("horn as a drill", "horn as a drill"));
  EXPECT_THAT(programs_.examined, ElementsAre("plain"));
  EXPECT_THAT(alarms_.told, ElementsAre("siren=on", "siren=off"));
  EXPECT_GE(calls, 6);
  ExpectUnchanged();
}

TEST_F(DrillTest, EachFailureIsNamedAndHidesNoOther) {
  modes_->probe = absl::UnavailableError("no mode manager of `/safety` answers\n");
  firewall_.status = absl::InvalidArgumentError("line 3: no such chain");
  programs_.end = absl::AbortedError("exit code 1");
  programs_.examine = absl::NotFoundError("`/usr/bin/plain`: No such file");
  alarms_.look = absl::NotFoundError("not plugged in");
  const DrillOutcome outcome = Run();
  std::vector<std::string> details;
  for (const StepResult& step : outcome.steps) {
    EXPECT_FALSE(step.ok) << step.step;
    details.push_back(step.detail);
  }
  EXPECT_THAT(details,
              ElementsAre("no mode manager of `/safety` answers\\x0a", "line 3: no such chain",
                          "exit code 1", "`/usr/bin/plain`: No such file", "not plugged in",
                          "exit code 1"));
  EXPECT_THAT(alarms_.told, IsEmpty());
  ExpectUnchanged();
}

TEST_F(DrillTest, KeepsTheEndOfWhatAProgramPrints) {
  programs_.output = absl::StrCat(std::string(5000, 'a'), "the end");
  const StepResult horn = Only(Program("horn"));
  EXPECT_EQ(horn.output_tail.size(), kStepOutputBytesMax);
  EXPECT_TRUE(horn.output_tail.ends_with("the end"));
}

TEST_F(DrillTest, AProgramThatCannotBeStartedWasNotTried) {
  programs_.start = absl::ResourceExhaustedError("it runs already");
  const StepResult horn = Only(Program("horn"));
  EXPECT_FALSE(horn.ok);
  EXPECT_EQ(horn.drilled, Drilled::kNot);
  EXPECT_EQ(horn.detail, "it runs already");
  // A helper that says so only later.
  programs_.start = absl::OkStatus();
  programs_.end = absl::PermissionDeniedError("it can be written by others");
  programs_.begun = false;
  EXPECT_EQ(Only(Program("horn")).drilled, Drilled::kNot);
}

TEST_F(DrillTest, AStepThatCanOnlyBeCarriedOutWasNotTried) {
  modes_ = std::make_unique<OldModes>();
  const StepResult mode = Only(Mode());
  EXPECT_FALSE(mode.ok);
  EXPECT_EQ(mode.drilled, Drilled::kNot);
  EXPECT_EQ(mode.detail, "not tried: a mode can only be ordered");
}

TEST_F(DrillTest, AnAlarmIsOnlyLookedAtUnlessItsDeviceSaysFlash) {
  devices_[0].flash_in_drills = false;
  const StepResult siren = Only(Alarm());
  EXPECT_TRUE(siren.ok);
  EXPECT_EQ(siren.drilled, Drilled::kLooked);
  EXPECT_EQ(siren.detail, "it answers: off");
  EXPECT_THAT(alarms_.told, IsEmpty());
}

TEST_F(DrillTest, NoAlarmIsFlashedWhileOneOfTheLevelHeldIsOn) {
  const StepResult siren = Only(Alarm(), "LOUD");
  EXPECT_TRUE(siren.ok);
  EXPECT_EQ(siren.drilled, Drilled::kLooked);
  EXPECT_THAT(siren.detail, HasSubstr("not flashed: the level held has an alarm on"));
  EXPECT_THAT(Only(Alarm(), "a level nobody knows").detail, HasSubstr("not flashed"));
  EXPECT_THAT(alarms_.told, IsEmpty());
}

TEST_F(DrillTest, AnAlarmThatIsOnOrUnknownIsNotFlashed) {
  alarms_.now = kOn;
  const StepResult on = Only(Alarm());
  EXPECT_TRUE(on.ok);
  EXPECT_EQ(on.detail, "it answers: on; not flashed: it is not known to be off");
  alarms_.readable = false;
  EXPECT_EQ(Only(Alarm()).detail,
            "it is plugged in; it cannot be read back; not flashed: it is not known to be off");
  EXPECT_THAT(alarms_.told, IsEmpty());
  EXPECT_EQ(alarms_.now, kOn);
}

TEST_F(DrillTest, AStepThatSwitchesOffIsLookedAt) {
  EXPECT_EQ(Only(Alarm(kOff)).drilled, Drilled::kLooked);
  EXPECT_THAT(alarms_.told, IsEmpty());
}

TEST_F(DrillTest, AnAlarmThatFailsIsToldToBeOffAllTheSame) {
  alarms_.fails = absl::DataLossError("garbage");
  const StepResult siren = Only(Alarm());
  EXPECT_FALSE(siren.ok);
  EXPECT_EQ(siren.detail, "garbage");
  EXPECT_THAT(alarms_.told, ElementsAre("siren=on", "siren=off"));
  ExpectUnchanged();
}

TEST_F(DrillTest, AnAlarmThatStaysOnIsTriedAgainAndTold) {
  alarms_.stays_on = absl::UnavailableError("unplugged");
  const StepResult siren = Only(Alarm());
  EXPECT_FALSE(siren.ok);
  EXPECT_THAT(siren.detail, HasSubstr("IT MAY STILL BE ON"));
  EXPECT_THAT(siren.detail, HasSubstr("unplugged"));
  EXPECT_THAT(alarms_.told,
              ElementsAre("siren=on", "siren=off", "siren=off", "siren=off", "siren=off"));
  EXPECT_EQ(alarms_.left, 1);
}

TEST_F(DrillTest, AFlashThatIsCancelledStillEnds) {
  levels_[1].enter = {Alarm(), Mode()};
  levels_[1].leave = {};
  alarms_.silent_off = true;
  std::thread raise([&] {
    alarms_.lit.WaitFor(absl::Seconds(30));
    cancel_.Cancel();
  });
  const DrillOutcome outcome = Run();
  raise.join();
  EXPECT_TRUE(outcome.cancelled);
  EXPECT_THAT(alarms_.told, ElementsAre("siren=on", "siren=off"));
  // The order to be off is carried out although nobody waits for it.
  EXPECT_EQ(alarms_.left, 1);
  EXPECT_EQ(alarms_.now, kOff);
  EXPECT_FALSE(outcome.steps[0].ok);
  EXPECT_EQ(outcome.steps[1].drilled, Drilled::kNot);
}

TEST_F(DrillTest, ACancelledProgramEnds) {
  levels_[1].enter = {Program("horn"), Mode()};
  levels_[1].leave = {Program("plain")};
  programs_.hangs = true;
  std::thread raise([&] {
    programs_.began.WaitFor(absl::Seconds(30));
    cancel_.Cancel();
  });
  const DrillOutcome outcome = Run();
  raise.join();
  EXPECT_TRUE(outcome.cancelled);
  ASSERT_THAT(outcome.steps, SizeIs(3));
  EXPECT_EQ(outcome.steps[0].detail, "cancelled");
  for (size_t i : {1, 2}) {
    EXPECT_FALSE(outcome.steps[i].ok);
    EXPECT_EQ(outcome.steps[i].detail, "not tried: a level had to be applied");
  }
  EXPECT_THAT(programs_.examined, IsEmpty());
}

// Time passes between two steps.
class JumpingClock final : public Clock {
 public:
  Instant Now() const override {
    Instant now = real_.Now();
    now.boottime_ns += ahead_ns;
    return now;
  }
  int64_t ahead_ns = 0;

 private:
  RealClock real_;
};

TEST_F(DrillTest, WhatThereIsNoTimeForWasNotTried) {
  JumpingClock clock;
  int calls = 0;
  StepPorts ports = Ports();
  ports.clock = &clock;
  Drill drill(levels_, ports);
  const DrillOutcome outcome = drill.Run({"id", "ALERT", "DEFAULT"}, cancel_, [&] {
    if (++calls == 3) clock.ahead_ns = absl::ToInt64Nanoseconds(kDrillTime);
  });
  ASSERT_THAT(outcome.steps, SizeIs(6));
  EXPECT_FALSE(outcome.cancelled);
  EXPECT_TRUE(outcome.steps[1].ok);
  for (size_t i = 2; i < 6; ++i) {
    EXPECT_EQ(outcome.steps[i].detail, "not tried: the time for a drill, 15s, was over");
    EXPECT_EQ(outcome.steps[i].drilled, Drilled::kNot);
  }
  EXPECT_THAT(programs_.runs, IsEmpty());
}

TEST_F(DrillTest, AnUnknownLevelHasOneFailedStep) {
  const DrillOutcome outcome = Run("\x1b[2J");
  ASSERT_THAT(outcome.steps, SizeIs(1));
  EXPECT_FALSE(outcome.steps[0].ok);
  EXPECT_EQ(outcome.steps[0].step, "level \\x1b[2J");
}

// A worker whose drills are real, and whose levels are looked at.
class DrillWorkerTest : public DrillTest {
 protected:
  void SetUp() override {
    DrillTest::SetUp();
    levels_[1].enter = {Mode(), Mode()};
    levels_[1].leave = {};
    Begin();
  }
  // With `levels_` as they are now.
  void Begin() {
    worker_.reset();
    procedures_ = std::make_unique<LevelExecutor>(&levels_, Ports());
    worker_ = std::make_unique<LevelWorker>(
        procedures_.get(), LevelWorker::Callbacks{.done = [this](LevelOutcome outcome) {
          MutexLock lock(&mu_);
          outcomes_.push_back(std::move(outcome));
          changed_.NotifyAll();
        }});
  }
  bool Submit() { return worker_->SubmitDrill(Drill()); }
  LevelWorker::DrillTask Drill() {
    return [this](const CancelFlag& cancel, const std::function<void()>& gap) {
      return [this, outcome = Make().Run({"id", "ALERT", "DEFAULT"}, cancel, gap)] {
        if (const auto next = std::exchange(when_over_, nullptr)) next();
        MutexLock lock(&mu_);
        drilled_.push_back(outcome);
        changed_.NotifyAll();
      };
    };
  }
  bool Until(size_t drills, size_t levels) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    for (int i = 0; i < 300 && (drilled_.size() < drills || outcomes_.size() < levels); ++i) {
      changed_.WaitFor(lock, absl::Milliseconds(100));
    }
    return drilled_.size() == drills && outcomes_.size() == levels;
  }

  std::function<void()> when_over_;  // called once, on the worker's thread, when a drill is over
  Mutex mu_;
  CondVar changed_;
  std::vector<DrillOutcome> drilled_ ABSL_GUARDED_BY(mu_);
  std::vector<LevelOutcome> outcomes_ ABSL_GUARDED_BY(mu_);
  std::unique_ptr<LevelExecutor> procedures_;
  std::unique_ptr<LevelWorker> worker_;
};

TEST_F(DrillWorkerTest, ALevelThatIsEnteredEndsTheDrillAtOnce) {
  modes_->hangs = true;
  ASSERT_TRUE(Submit());
  EXPECT_FALSE(Submit()) << "one at a time";
  ASSERT_TRUE(modes_->begun.WaitFor(absl::Seconds(30)));
  worker_->Submit({1, JobKind::kEnter, "DEFAULT", "ALERT", true});
  ASSERT_TRUE(Until(1, 1));
  MutexLock lock(&mu_);
  EXPECT_TRUE(drilled_[0].cancelled);
  EXPECT_TRUE(outcomes_[0].reached);
}

TEST_F(DrillWorkerTest, ALookAtTheLevelNeitherEndsItNorWaitsForItsEnd) {
  levels_[1].enter = {Program("horn"), Mode()};
  programs_.hangs = true;
  ASSERT_TRUE(Submit());
  ASSERT_TRUE(programs_.began.WaitFor(absl::Seconds(30)));
  worker_->Submit({1, JobKind::kCheck, "", "DEFAULT", true});
  ASSERT_TRUE(Until(0, 1)) << "it waits for a slow program";
  programs_.Cancel(7);
  ASSERT_TRUE(Until(1, 1));
  MutexLock lock(&mu_);
  EXPECT_FALSE(drilled_[0].cancelled);
  EXPECT_TRUE(outcomes_[0].reached);
  EXPECT_EQ(modes_->looks, 1);
}

TEST_F(DrillWorkerTest, NoneBeginsWhileALevelIsEntered) {
  levels_[1].enter = {Program("horn")};
  Begin();
  programs_.hangs = true;
  worker_->Submit({1, JobKind::kEnter, "DEFAULT", "ALERT", true});
  EXPECT_FALSE(Submit());
  ASSERT_TRUE(programs_.began.WaitFor(absl::Seconds(30)));
  EXPECT_FALSE(Submit());
  programs_.Cancel(7);
  ASSERT_TRUE(Until(0, 1));
  programs_.hangs = false;
  EXPECT_TRUE(Submit());
  EXPECT_TRUE(Until(1, 1));
}

TEST_F(DrillWorkerTest, AProgramThatIsDrilledEndsBeforeTheLevelIsEntered) {
  levels_[1].enter = {Program("horn")};
  programs_.hangs = true;
  ASSERT_TRUE(Submit());
  ASSERT_TRUE(programs_.began.WaitFor(absl::Seconds(30)));
  worker_->Submit({2, JobKind::kEnter, "", "DEFAULT", true});
  ASSERT_TRUE(Until(1, 1));
  MutexLock lock(&mu_);
  EXPECT_TRUE(drilled_[0].cancelled);
  EXPECT_EQ(outcomes_[0].attempt, 2u);
}

TEST_F(DrillWorkerTest, OneThatHasNotBegunIsEndedBeforeTheLevelIsEntered) {
  modes_->check_hangs = true;
  worker_->Submit({1, JobKind::kCheck, "", "DEFAULT", true});
  ASSERT_TRUE(modes_->begun.WaitFor(absl::Seconds(30)));
  ASSERT_TRUE(Submit()) << "a look at the level does not stand in its way";
  worker_->Submit({2, JobKind::kEnter, "", "DEFAULT", true});
  modes_->go_on.Cancel();
  ASSERT_TRUE(Until(1, 2));
  MutexLock lock(&mu_);
  EXPECT_TRUE(drilled_[0].cancelled);
  for (const StepResult& step : drilled_[0].steps) EXPECT_EQ(step.drilled, Drilled::kNot);
  EXPECT_EQ(outcomes_[1].attempt, 2u);
}

TEST_F(DrillWorkerTest, TheNextOneBeginsAsSoonAsOneIsToldToBeOver) {
  bool taken = false;
  when_over_ = [&] { taken = Submit(); };
  ASSERT_TRUE(Submit());
  ASSERT_TRUE(Until(2, 0));
  EXPECT_TRUE(taken);
}

TEST_F(DrillWorkerTest, EndsWithTheWorker) {
  modes_->hangs = true;
  ASSERT_TRUE(Submit());
  ASSERT_TRUE(modes_->begun.WaitFor(absl::Seconds(30)));
  worker_.reset();
  MutexLock lock(&mu_);
  ASSERT_THAT(drilled_, SizeIs(1));
  EXPECT_TRUE(drilled_[0].cancelled);
}

// What a retry skips and what a check tolerates is as before the drill.
TEST_F(DrillTest, ProceduresKeepWhatTheyKnow) {
  levels_[1].enter = {Program("horn"), Program("plain")};
  levels_[1].leave = {};
  LevelExecutor procedures(&levels_, Ports());
  programs_.end = absl::OkStatus();
  EXPECT_TRUE(procedures.Run({1, JobKind::kEnter, "DEFAULT", "ALERT", true}, cancel_).reached);
  programs_.runs.clear();
  programs_.end = absl::AbortedError("exit code 1");
  Run();
  EXPECT_THAT(programs_.runs, ElementsAre("horn as a drill"));
  programs_.runs.clear();
  EXPECT_TRUE(procedures.Run({2, JobKind::kRetry, "DEFAULT", "ALERT", true}, cancel_).reached);
  EXPECT_THAT(programs_.runs, IsEmpty());
}

}  // namespace
}  // namespace rips::actuator
