// Program steps of levels: what they are told, and what is kept of what they say.
#include <unistd.h>

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/level_executor.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;

// Ends each run at once with the next of `results`; the last one again and again.
class ScriptedPrograms final : public ProgramRunner {
 public:
  absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) override {
    requests.push_back(request);
    ++started;
    if (request.name == "hang") return requests.size();
    done(results.front());
    if (results.size() > 1) results.erase(results.begin());
    return requests.size();
  }
  // As one that hangs.
  void Cancel(uint64_t) override { ++cancelled; }
  absl::Status Examine(absl::string_view) override { return absl::OkStatus(); }

  std::atomic<int> started = 0;
  std::atomic<int> cancelled = 0;
  std::vector<ProgramRequest> requests;
  std::vector<ProgramResult> results = {ProgramResult{}};
};

class ProgramStepTest : public ::testing::Test {
 protected:
  ProgramStepTest() {
    levels_.resize(2);
    levels_[0].name = "DEFAULT";
    levels_[1].name = "ALERT";
    levels_[1].enter = {Program({.name = "horn", .args = {"on"}})};
  }
  static Step Program(ProgramStep program, int retries = 0) {
    Step step;
    step.what = std::move(program);
    step.timeout = absl::Seconds(5);
    step.retries = retries;
    return step;
  }
  LevelOutcome Run(const std::string& from, const std::string& to, bool raise = true) {
    LevelExecutor procedures(&levels_, {.programs = &programs_, .clock = &clock_});
    return procedures.Run({1, JobKind::kEnter, from, to, raise}, cancel_);
  }

  std::vector<LevelSpec> levels_;
  RealClock clock_;
  ScriptedPrograms programs_;
  CancelFlag cancel_;
};

TEST_F(ProgramStepTest, ProgramsAreToldTheirLevels) {
  EXPECT_TRUE(Run("DEFAULT", "ALERT").reached);
  ASSERT_EQ(programs_.requests.size(), 1u);
  EXPECT_EQ(programs_.requests[0].level_from, "DEFAULT");
  EXPECT_EQ(programs_.requests[0].level_to, "ALERT");
  EXPECT_THAT(programs_.requests[0].args, ElementsAre("on"));
  EXPECT_FALSE(programs_.requests[0].drill);
}

TEST_F(ProgramStepTest, ScriptsGetTheLevelGoneToAndTheLevelComeFrom) {
  levels_[0].leave = {Program({.name = "DEFAULT.from", .level_args = true})};
  levels_[1].enter = {Program({.name = "ALERT.to", .level_args = true})};
  EXPECT_TRUE(Run("DEFAULT", "ALERT").reached);
  EXPECT_TRUE(Run("", "ALERT").reached);
  ASSERT_EQ(programs_.requests.size(), 3u);
  EXPECT_EQ(programs_.requests[0].name, "DEFAULT.from");
  EXPECT_THAT(programs_.requests[0].args, ElementsAre("ALERT", "DEFAULT"));
  EXPECT_EQ(programs_.requests[1].name, "ALERT.to");
  EXPECT_THAT(programs_.requests[1].args, ElementsAre("ALERT", "DEFAULT"));
  EXPECT_THAT(programs_.requests[2].args, ElementsAre("ALERT", "")) << "after a start";
}

TEST_F(ProgramStepTest, TheEndOfItsOutputIsKept) {
  programs_.results[0].output_tail = std::string(kStepOutputBytesMax, 'a') + "end\xff";
  programs_.results[0].note = "left 1 process behind, killed";
  const LevelOutcome outcome = Run("DEFAULT", "ALERT");
  ASSERT_EQ(outcome.steps.size(), 1u);
  EXPECT_TRUE(outcome.steps[0].ok);
  EXPECT_EQ(outcome.steps[0].output_tail, std::string(kStepOutputBytesMax - 4, 'a') + "end\xff");
  EXPECT_EQ(outcome.steps[0].detail, "left 1 process behind, killed");
}

TEST_F(ProgramStepTest, AFailureKeepsItsOutputToo) {
  programs_.results[0].status = absl::AbortedError("exit code 7");
  programs_.results[0].output_tail = "no horn";
  programs_.results[0].note = "left 2 processes behind, killed";
  const LevelOutcome outcome = Run("DEFAULT", "ALERT");
  EXPECT_FALSE(outcome.reached);
  EXPECT_EQ(outcome.steps[0].output_tail, "no horn");
  EXPECT_EQ(outcome.steps[0].detail, "exit code 7; left 2 processes behind, killed");
}

TEST_F(ProgramStepTest, ALateRefusalForTheLimitIsAskedForAgainAndIsNoAttempt) {
  ProgramResult busy;
  busy.begun = false;
  busy.status = absl::ResourceExhaustedError("busy");
  programs_.results = {busy, busy, ProgramResult{}};
  const LevelOutcome outcome = Run("DEFAULT", "ALERT");
  EXPECT_TRUE(outcome.reached) << outcome.detail;
  EXPECT_EQ(programs_.requests.size(), 3u);
}

TEST_F(ProgramStepTest, WhoDoesNotCancelIsNotWaitedFor) {
  levels_[1].enter = {Program({.name = "hang"})};
  levels_[1].enter[0].timeout = absl::Hours(1);
  std::thread canceller([this] {
    while (programs_.started == 0) usleep(1'000);
    cancel_.Cancel();
  });
  const LevelOutcome outcome = Run("DEFAULT", "ALERT");
  canceller.join();
  EXPECT_FALSE(outcome.reached);
  EXPECT_EQ(programs_.cancelled, 1);
  ASSERT_EQ(outcome.steps.size(), 1u);
  EXPECT_EQ(outcome.steps[0].detail, "the program runner did not return a result");
}

TEST_F(ProgramStepTest, WhatNobodyKnowsTheEndOfIsAFailureAndTriedAgain) {
  levels_[1].enter = {Program({.name = "horn"}, /*retries=*/1)};
  ProgramResult unknown;
  unknown.status = absl::UnknownError("rips-exec ended while it ran");
  programs_.results = {unknown, ProgramResult{}};
  EXPECT_TRUE(Run("DEFAULT", "ALERT").reached);
  programs_.results = {unknown};
  const LevelOutcome outcome = Run("DEFAULT", "ALERT");
  EXPECT_FALSE(outcome.reached);
  EXPECT_EQ(outcome.detail, "program horn: rips-exec ended while it ran");
}

}  // namespace
}  // namespace rips::actuator
