// Random walks through everything that can happen to an LevelController, with its invariants
// checked after every step.
#include <memory>
#include <random>

#include "gtest/gtest.h"
#include "mode_actuator/decide/level_controller.h"
#include "mode_actuator/decide/level_controller_test_rig.h"

namespace rips::actuator {
namespace {

const std::vector<std::string>& Levels() {
  static const auto* levels = new std::vector<std::string>(ExecutorRig::Options().levels);
  return *levels;
}

int Index(const std::string& level) {
  for (size_t i = 0; i < Levels().size(); ++i) {
    if (Levels()[i] == level) return static_cast<int>(i);
  }
  return -1;
}

class Walk {
 public:
  explicit Walk(unsigned seed)
      : random_(seed),
        rig_(std::make_unique<ExecutorRig>(ExecutorRig::At("DEFAULT"), ExecutorRig::WithSurvey())) {
    rig_->term = 2;  // so that there is a lower one
  }

  void Step() {
    const int decided_before = Index(rig_->report().decided);
    lowering_allowed_ = false;
    rig_->auto_finish = Chance(70);
    rig_->robot_reaches = Chance(70);
    rig_->auto_persist = Chance(80);
    rig_->disk_works = Chance(90);
    rig_->evidence = Chance(80);
    switch (random_() % 8) {
      case 0:
      case 1:
        Command();
        break;
      case 2:
        rig_->lease = Chance(60);
        rig_->Advance(static_cast<int64_t>(random_() % 20'000));
        break;
      case 3:
        if (rig_->job().has_value()) rig_->Finish(Chance(60));
        if (rig_->survey().has_value()) rig_->FinishSurvey(rig_->robot);
        break;
      case 4:
        while (!rig_->writes().empty()) {
          rig_->FinishWrite(Chance(80) ? absl::OkStatus() : absl::UnavailableError("disk"));
        }
        break;
      case 5:
        if (Chance(20)) rig_->term += 1;
        rig_->Grant(static_cast<int64_t>(random_() % 3'000));
        break;
      case 6:
        if (Chance(30)) Restart();
        if (Chance(15)) RestartWithoutState();
        break;
      default:
        rig_->Advance(500);
    }
    Check(decided_before);
  }

 private:
  bool Chance(unsigned percent) { return random_() % 100 < percent; }

  void Command() {
    const ExecutorReport report = rig_->report();
    DecisionId decision_id{rig_->term, next_epoch_++};
    if (Chance(10)) decision_id.epoch = random_() % next_epoch_;
    DecisionId based_on;
    if (Chance(60)) based_on = report.decision_id;
    const std::string to = Levels()[random_() % Levels().size()];
    const uint64_t term = Chance(10) ? rig_->term - 1 : rig_->term;
    lowering_allowed_ = true;  // by this command only, if it is a legal one
    rig_->Level(to, decision_id, based_on,
                absl::StrCat("c", random_() % 50, "-", decision_id.epoch), term);
    if (based_on.none() && Index(to) < Index(report.decided)) lowering_allowed_ = false;
    if (term < report.highest_term || decision_id < report.decision_id) lowering_allowed_ = false;
  }

  void Restart() {
    const ExecutorReport before = rig_->report();
    const bool recorded = rig_->writes().empty();
    const uint64_t term = rig_->term;
    const std::string robot = rig_->robot;
    rig_ = std::make_unique<ExecutorRig>(rig_->Restarted());
    if (rig_->robot.empty()) rig_->robot = robot;
    rig_->term = term;
    // What was effective on the disk is held again: never below what was recorded.
    const ExecutorReport after = rig_->report();
    if (recorded && rig_->disk().has_value()) {
      EXPECT_GE(Index(after.effective), Index(rig_->disk()->decided));
    }
    lowering_allowed_ = true;  // the record may be older; the decision ids tell the server
  }

  // The robot stays where it is, and is read back or silent.
  void RestartWithoutState() {
    const std::string robot = rig_->robot;
    const uint64_t term = rig_->term;
    rig_ = std::make_unique<ExecutorRig>(absl::DataLossError("corrupt"), ExecutorRig::WithSurvey());
    rig_->term = term;
    rig_->robot = robot;
    EXPECT_EQ(rig_->PopJobs(), "");
    lowering_allowed_ = true;  // nothing is decided any more
    if (Chance(20)) return;    // a survey that is answered after its time, or not at all
    if (Chance(50)) Command();
    lowering_allowed_ = true;
    // Nothing but a command above the floor may be applied before the answer, and nothing below
    // what the robot shows after it.
    rig_->FinishSurvey(robot);
    EXPECT_GE(Index(rig_->report().effective), Index(robot));
    EXPECT_GE(Index(rig_->report().floor), Index(robot));
    rig_->Advance(1'000);
    EXPECT_GE(Index(rig_->report().effective), Index(robot));
  }

  void Check(int decided_before) {
    const ExecutorReport report = rig_->report();
    const int effective = Index(report.effective);
    EXPECT_GE(effective, Index(report.decided));
    EXPECT_GE(effective, Index(report.floor));
    if (!lowering_allowed_ && rig_->writes().empty() && !had_pending_) {
      EXPECT_GE(Index(report.decided), decided_before);
    }
    had_pending_ = !rig_->writes().empty();
    if (!report.verified) return;
    // Verified means: the last job on this level ended with the level read back.
    EXPECT_EQ(report.observed, "/safety=" + report.effective);
  }

  std::mt19937 random_;
  std::unique_ptr<ExecutorRig> rig_;
  uint64_t next_epoch_ = 2;
  bool lowering_allowed_ = false;
  bool had_pending_ = false;
};

TEST(LevelControllerWalkTest, NeverHoldsLessThanWhatIsDecidedAndNeverLowersUncommanded) {
  for (unsigned seed = 1; seed <= 60; ++seed) {
    SCOPED_TRACE(seed);
    Walk walk(seed);
    for (int i = 0; i < 300 && !::testing::Test::HasFailure(); ++i) walk.Step();
  }
}

}  // namespace
}  // namespace rips::actuator
