#include "mode_actuator/steps/mode_survey.h"

#include <deque>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/fake_clock.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {
namespace {

using ::testing::AllOf;
using ::testing::Gt;
using ::testing::Le;

// Parts that say what the test says; the last reading of a part is repeated. Each takes `delay`.
class FakeParts : public PartModes {
 public:
  explicit FakeParts(FakeClock* clock) : clock_(clock) {}

  ModeReading Enter(absl::string_view, absl::string_view, absl::Duration, int,
                    const CancelFlag&) override {
    ADD_FAILURE() << "a survey orders nothing";
    return {};
  }
  ModeReading Check(absl::string_view, absl::string_view, const CancelFlag&) override {
    ADD_FAILURE() << "a check may order";
    return {};
  }
  PartReading Read(absl::string_view part, absl::Duration at_most, const CancelFlag&) override {
    EXPECT_THAT(at_most, AllOf(Gt(absl::ZeroDuration()), Le(kSurveyTime)));
    ++reads[std::string(part)];
    clock_->Advance(absl::ToInt64Nanoseconds(delay));
    if (cancels != nullptr) cancels->Cancel();
    std::deque<PartReading>& told = readings[std::string(part)];
    if (told.empty()) return {};
    PartReading reading = told.front();
    if (told.size() > 1) told.pop_front();
    return reading;
  }

  absl::Duration delay = absl::Milliseconds(800);
  CancelFlag* cancels = nullptr;  // by the first reading
  std::map<std::string, std::deque<PartReading>> readings;
  std::map<std::string, int> reads;

 private:
  FakeClock* const clock_;  // Not owned; outlives this.
};

PartReading Nodes(std::vector<std::string> agreeing, size_t answers = 4) {
  const bool complete = !agreeing.empty();
  return {.agreeing = std::move(agreeing), .named = {}, .answers = answers, .complete = complete};
}
PartReading Manager(std::string named) {
  return {.agreeing = {}, .named = std::move(named), .answers = 1, .complete = true};
}

Step Mode(const std::string& mode, const std::string& part = "/safety") {
  return {SystemModeStep{part, mode}, absl::Seconds(5)};
}

class ModeSurveyTest : public ::testing::Test {
 protected:
  ModeSurvey Survey() { return SurveyModes(levels_, parts_, clock_, cancel_); }
  // What /safety shows.
  std::string Level(PartReading reading) {
    parts_.readings["/safety"] = {std::move(reading)};
    return Survey().level;
  }

  std::vector<LevelSpec> levels_ = {{"DEFAULT", {Mode("__DEFAULT__")}, {}},
                                    {"ALERT", {Mode("ALERT")}, {}},
                                    {"COMPROMISED", {Mode("ALERT")}, {}},
                                    {"HALT", {Mode("HALT")}, {}}};
  FakeClock clock_;
  CancelFlag cancel_;
  FakeParts parts_{&clock_};
};

TEST_F(ModeSurveyTest, APartShowsTheLowestLevelThatSetsItsMode) {
  EXPECT_EQ(Level(Nodes({"HALT"})), "HALT");
  EXPECT_EQ(Level(Nodes({"ALERT"})), "ALERT");
  EXPECT_EQ(Level(Nodes({"__DEFAULT__"})), "DEFAULT");
  EXPECT_EQ(Level(Manager("HALT")), "HALT");
  EXPECT_EQ(Survey().observed, "/safety=HALT");
}

TEST_F(ModeSurveyTest, AnUnknownModeShowsNoLevel) {
  parts_.readings["/safety"] = {Manager("DANCE\n")};
  const ModeSurvey survey = Survey();
  EXPECT_EQ(survey.level, "");
  EXPECT_EQ(survey.observed, "/safety=DANCE\\n");
  EXPECT_EQ(Level(Nodes({})), "");
}

TEST_F(ModeSurveyTest, NodesThatFitSeveralModesShowTheLowestUnlessTheManagerNamesAHigherOne) {
  EXPECT_EQ(Level(Nodes({"HALT", "ALERT"})), "ALERT");
  PartReading both = Nodes({"__DEFAULT__"});
  both.named = "HALT";
  EXPECT_EQ(Level(both), "HALT");
  both.agreeing = {"HALT"};
  both.named = "__DEFAULT__";
  EXPECT_EQ(Level(both), "HALT");
}

TEST_F(ModeSurveyTest, ASilentPartContributesNothingAndEndsInTime) {
  levels_[3].enter.push_back(Mode("PARKED", "/base"));
  levels_[1].enter.push_back(Mode("SLOW", "/arm"));
  parts_.readings["/arm"] = {Nodes({"SLOW"})};
  const int64_t began_ns = clock_.Now().boottime_ns;

  const ModeSurvey survey = Survey();

  EXPECT_EQ(survey.level, "ALERT");
  EXPECT_EQ(survey.observed, "/arm=SLOW /base=? /safety=?");
  EXPECT_LE(absl::Nanoseconds(clock_.Now().boottime_ns - began_ns), kSurveyTime + parts_.delay);
  EXPECT_EQ(parts_.reads["/arm"], 1);  // what is known is not asked again
}

TEST_F(ModeSurveyTest, TheMostRestrictivePartCounts) {
  levels_[1].enter.push_back(Mode("SLOW", "/base"));
  levels_[3].enter.push_back(Mode("PARKED", "/base"));
  parts_.readings["/base"] = {Nodes({"PARKED"})};
  EXPECT_EQ(Level(Nodes({"__DEFAULT__"})), "HALT");
}

TEST_F(ModeSurveyTest, APartIsReadAgainUntilItsModeIsKnown) {
  parts_.delay = absl::Milliseconds(100);
  parts_.readings["/safety"] = {Nodes({}, 0), Nodes({}, 4), Nodes({"HALT"})};
  EXPECT_EQ(Survey().level, "HALT");
  EXPECT_EQ(parts_.reads["/safety"], 3);
}

TEST_F(ModeSurveyTest, AReadingThatWasCutShortDoesNotReplaceABetterOne) {
  PartReading most = Nodes({"HALT"}, 3);
  most.complete = false;  // one node is silent
  PartReading cut = Nodes({"HALT", "ALERT"}, 1);
  cut.complete = false;
  parts_.readings["/safety"] = {most, cut};
  EXPECT_EQ(Survey().level, "HALT");
}

TEST_F(ModeSurveyTest, ModesOfOnDriftAndLeaveSteps) {
  levels_[1].on_drift = {Mode("LOCKED"), Mode("HALT")};
  levels_[2].on_drift = {Mode("LOCKED")};
  levels_[2].leave = {Mode("PARKING")};
  EXPECT_EQ(Level(Nodes({"HALT"})), "HALT");  // enter steps go first
  EXPECT_EQ(Level(Nodes({"PARKING"})), "");
  levels_[1].on_drift = {Mode("LOCKED")};
  EXPECT_EQ(Level(Nodes({"LOCKED"})), "ALERT");
}

TEST_F(ModeSurveyTest, TheLastStepOfALevelSaysItsMode) {
  levels_[1].enter = {Mode("HALT"), Mode("ALERT")};
  EXPECT_EQ(Level(Nodes({"HALT"})), "HALT");
}

TEST_F(ModeSurveyTest, WhatEndsItGetsWhatWasRead) {
  levels_[3].enter.push_back(Mode("PARKED", "/base"));
  parts_.readings["/base"] = {Nodes({"PARKED"})};
  parts_.cancels = &cancel_;
  const ModeSurvey survey = Survey();
  EXPECT_EQ(survey.level, "HALT");
  EXPECT_EQ(survey.observed, "/base=PARKED");
  EXPECT_EQ(parts_.reads["/safety"], 0);
}

}  // namespace
}  // namespace rips::actuator
