#include "policy_server/server/rollout/bundle_control.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "policy_server/policy/bundle/bundle_archive.h"
#include "policy_server/server/robot/fake_ports.h"
#include "policy_server/server/rollout/bundle_control_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::rollout {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class BundleControlTest : public BundleControlFixture {
 protected:
  // The id of a bundle that was pushed.
  std::string Push(const std::string& name, const std::string& mark,
                   const std::string& levels = "DEFAULT, ALERT, HALT") {
    const std::string source = dir_.File("pushed/" + mark);
    WriteBundle(source, name, absl::StrCat("# ", mark, "\n"), levels);
    const auto packed = bundle::PackBundle(source);
    EXPECT_THAT(packed, IsOk());
    const auto added = control_->Push(*packed);
    EXPECT_THAT(added, IsOk());
    return added.ok() ? added->bundle.id : "";
  }
  ActivateOrder Order(const std::string& bundle, std::vector<StageSelection> stages = {}) {
    return {.bundle = bundle,
            .robots = {.all = true},
            .stages = std::move(stages),
            .soak_ns = kSoakNs,
            .operator_name = "alice",
            .reason = "new rules"};
  }
  std::string InUse(const std::string& robot) {
    const auto status = control_->Status(robot);
    EXPECT_THAT(status, IsOk());
    return status->robots.at(0).bundle_in_use;
  }
  std::vector<std::string> InUse() {
    std::vector<std::string> ids;
    for (const char* robot : {"r1", "r2", "r3", "r4"}) ids.push_back(InUse(robot));
    return ids;
  }
  // Raises the robot to HALT.
  void Halt(const std::string& robot) {
    EXPECT_THAT(pipeline_->Post(robot, pipeline::Queue::kOrders,
                                [](pipeline::Robot& each) {
                                  each.Raise({.operator_name = "bob", .to = "HALT", .reason = "x"},
                                             [](const pipeline::LevelAnswer&) {});
                                }),
                IsOk());
  }
  void LookFor(int64_t ns) {
    for (int64_t passed = 0; passed < ns; passed += kNanosPerSecond) {
      clock_.Advance(kNanosPerSecond);
      Beat();
      control_->Look();
    }
  }
  RolloutState State() { return activations_->now().rollout->state; }
  std::vector<std::string> ServerAlertTexts() {
    Stop();
    std::vector<std::string> texts;
    const auto alerts = store_.ListAlerts(store::kServerRobot, 1'000);
    for (const store::AlertRecord& alert : *alerts) {
      texts.push_back(absl::StrCat(alert.severity, ": ", alert.text));
    }
    return texts;
  }

  static constexpr int64_t kSoakNs = 5 * kNanosPerSecond;
};

TEST_F(BundleControlTest, RollsOutStageByStageAndBack) {
  const std::string old = InUse("r1");
  const std::string fresh = Push("warehouse", "fresh");
  EXPECT_THAT(InUse(), ElementsAre(old, old, old, old));
  const auto answer =
      control_->Activate(Order(fresh.substr(7, 12), {{.label = "ring=canary"}, {.percent = 100}}));
  ASSERT_THAT(answer, IsOk());
  EXPECT_THAT(answer->changed, ElementsAre("r2"));
  EXPECT_THAT(InUse(), ElementsAre(old, fresh, old, old));
  LookFor(kSoakNs + 3 * kNanosPerSecond);
  EXPECT_THAT(InUse(), ElementsAre(fresh, fresh, fresh, fresh));
  EXPECT_EQ(State(), RolloutState::kRunning);
  LookFor(kSoakNs + 3 * kNanosPerSecond);
  EXPECT_EQ(State(), RolloutState::kDone);
  EXPECT_NE(InUse("d1"), fresh);

  const auto back = control_->RollBack(
      {.robots = {.labels = {"ring=main"}}, .operator_name = "bob", .reason = "false alarms"});
  ASSERT_THAT(back, IsOk());
  EXPECT_THAT(back->changed, ElementsAre("r1", "r3", "r4"));
  EXPECT_THAT(back->notes.at(0), HasSubstr(" -> what the directory holds"));
  EXPECT_THAT(activations_->now().rollout->rolled_back, "r1, r3, r4 by bob: false alarms");
  EXPECT_THAT(InUse(), ElementsAre(old, fresh, old, old));
  const auto again = control_->RollBack(
      {.robots = {.robots = {"r1", "d1"}}, .operator_name = "bob", .reason = "again"});
  ASSERT_THAT(again, IsOk());
  EXPECT_THAT(again->changed, IsEmpty());
  EXPECT_THAT(again->left_out,
              ElementsAre("d1: has nothing to go back to", "r1: has nothing to go back to"));
}

TEST_F(BundleControlTest, ARestartGoesOnWithWhatWasActivated) {
  const std::string old = InUse("r1");
  const std::string fresh = Push("warehouse", "fresh");
  ASSERT_THAT(control_->Activate(Order(fresh, {{.percent = 50}, {.percent = 100}})), IsOk());
  Restart();
  EXPECT_THAT(InUse(), ElementsAre(fresh, fresh, old, old));
  EXPECT_EQ(State(), RolloutState::kRunning);
  LookFor(kRestartGraceNs - 2 * kNanosPerSecond);
  EXPECT_THAT(InUse(), ElementsAre(fresh, fresh, old, old));
  LookFor(kSoakNs + 5 * kNanosPerSecond);
  EXPECT_THAT(InUse(), ElementsAre(fresh, fresh, fresh, fresh));
}

TEST_F(BundleControlTest, TheDirectoryDoesNotJudgeWhatAnotherBundleWasActivatedFor) {
  const std::string fresh = Push("warehouse", "fresh");
  ActivateOrder order = Order(fresh);
  order.robots = {.robots = {"r1"}};
  ASSERT_THAT(control_->Activate(order), IsOk());
  WriteBundle(dir_.File("source/warehouse"), "warehouse", "# edited\n");
  fleet_->Reload();
  EXPECT_EQ(InUse("r1"), fresh);
  const std::string edited = InUse("r2");
  EXPECT_NE(edited, fresh);
  LookFor(kSoakNs + 3 * kNanosPerSecond);
  order.bundle = std::string(kDirectory);
  const auto answer = control_->Activate(order);
  ASSERT_THAT(answer, IsOk());
  EXPECT_EQ(InUse("r1"), edited);
}

TEST_F(BundleControlTest, StopsByItselfWhenARobotDoesNotTakeTheBundleAndSaysHowToGoOn) {
  // At a level that the bundle does not have.
  Halt("r3");
  const std::string old = InUse("r3");
  const std::string fresh = Push("warehouse", "fresh", "DEFAULT, ALERT");
  ASSERT_THAT(control_->Activate(Order(fresh, {{.percent = 75}, {.percent = 100}})), IsOk());
  LookFor(kTakeNs + 5 * kNanosPerSecond);
  EXPECT_EQ(State(), RolloutState::kStopped);
  EXPECT_THAT(InUse(), ElementsAre(fresh, fresh, old, old));
  EXPECT_THAT(control_->Status("r3")->robots.at(0).problem,
              HasSubstr("has not taken what was activated: bundle sha256:"));
  const auto texts = ServerAlertTexts();
  EXPECT_THAT(texts,
              ::testing::Contains(::testing::AllOf(HasSubstr("high: roll-out of `warehouse`"),
                                                   HasSubstr("stopped at stage 1 of 2: r3: "),
                                                   HasSubstr("ripsctl rules rollback"))));
}

TEST_F(BundleControlTest, GoesBackByItselfWhenTheOrderWantsIt) {
  const std::string old = InUse("r1");
  const std::string fresh = Push("warehouse", "fresh");
  ActivateOrder order = Order(fresh, {{.percent = 50}, {.percent = 100}});
  order.roll_back_when_stopped = true;
  ASSERT_THAT(control_->Activate(order), IsOk());
  EXPECT_THAT(InUse(), ElementsAre(fresh, fresh, old, old));
  Halt("r1");
  LookFor(2 * kNanosPerSecond);
  EXPECT_EQ(State(), RolloutState::kStopped);
  EXPECT_THAT(InUse(), ElementsAre(old, old, old, old));
}

TEST_F(BundleControlTest, OneRollOutAtATimeWhichAnOperatorEndsOrRollsBack) {
  const std::string fresh = Push("warehouse", "fresh");
  EXPECT_THAT(control_->StopRollout("bob", "none"), StatusIs(absl::StatusCode::kNotFound));
  ASSERT_THAT(control_->Activate(Order(fresh, {{.percent = 50}, {.percent = 100}})), IsOk());
  EXPECT_THAT(control_->Activate(Order(fresh)),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("by alice runs")));
  ASSERT_THAT(control_->StopRollout("bob", "lunch"), IsOk());
  EXPECT_EQ(activations_->now().rollout->why, "bob: lunch");
  LookFor(10 * kNanosPerSecond);
  EXPECT_THAT(InUse("r1"), fresh);
  const auto rest = control_->Activate(Order(fresh));
  ASSERT_THAT(rest, IsOk());
  EXPECT_THAT(rest->changed, ElementsAre("r3", "r4"));
  EXPECT_THAT(rest->left_out, SizeIs(2));
  ASSERT_THAT(
      control_->RollBack({.robots = {.robots = {"r4"}}, .operator_name = "bob", .reason = "x"}),
      IsOk());
  EXPECT_EQ(State(), RolloutState::kStopped);
  EXPECT_THAT(activations_->now().rollout->why, HasSubstr("bob rolled back r4"));
}

TEST_F(BundleControlTest, SaysBeforehandWhatSpeaksAgainstABundle) {
  sensors_.at("r2").off = true;
  clock_.Advance(3 * kNanosPerSecond);
  Beat();
  Halt("r3");
  ActivateOrder order = Order(Push("warehouse", "fresh", "DEFAULT, ALERT"));
  order.dry_run = true;
  const auto answer = control_->Activate(order);
  ASSERT_THAT(answer, IsOk());
  EXPECT_THAT(answer->notes,
              ElementsAre("r2: sends nothing now, so it cannot show what the bundle does",
                          "r3: will not take it: it is at HALT, which the bundle does not have"));
  const auto shadow = control_->Shadow(
      {.bundle = Push("warehouse", "muted"), .robots = {.robots = {"r1", "r2"}}, .reason = "x"});
  ASSERT_THAT(shadow, IsOk());
  EXPECT_THAT(shadow->notes, ElementsAre("r2: sends nothing now, so its shadow shows nothing"));
}

TEST_F(BundleControlTest, ARobotThatLeavesTheInventoryStopsNothing) {
  const std::string fresh = Push("warehouse", "fresh");
  ASSERT_THAT(control_->Activate(Order(fresh, {{.percent = 50}, {.percent = 100}})), IsOk());
  std::ofstream(dir_.File("robots.yaml"))
      << "robots:\n  - {id: r1, bundle: warehouse, sensors: [{host: base, primary: true}]}\n";
  fleet_->Reload();
  LookFor(2 * kSoakNs + 8 * kNanosPerSecond);
  EXPECT_EQ(State(), RolloutState::kDone);
  EXPECT_EQ(InUse("r1"), fresh);
}

TEST_F(BundleControlTest, TheSameCommandGoesOnWhereARollOutStopped) {
  const std::string fresh = Push("warehouse", "fresh");
  const std::vector<StageSelection> stages = {{.label = "ring=canary"}, {.percent = 100}};
  ASSERT_THAT(control_->Activate(Order(fresh, stages)), IsOk());
  ASSERT_THAT(control_->StopRollout("bob", "lunch"), IsOk());
  const auto again = control_->Activate(Order(fresh, stages));
  ASSERT_THAT(again, IsOk());
  EXPECT_THAT(again->changed, ElementsAre("r1", "r3", "r4"));
  EXPECT_THAT(again->left_out, ElementsAre("r2: is to be judged by it already"));
}

TEST_F(BundleControlTest, ADryRunChangesNothing) {
  const std::string old = InUse("r1");
  const std::string fresh = Push("warehouse", "fresh");
  ActivateOrder order = Order(fresh, {{.percent = 25}, {.percent = 100}});
  order.dry_run = true;
  const auto answer = control_->Activate(order);
  ASSERT_THAT(answer, IsOk());
  EXPECT_THAT(answer->changed, ElementsAre("r1"));
  EXPECT_THAT(answer->rollout->plan.stages, SizeIs(2));
  EXPECT_FALSE(activations_->now().rollout.has_value());
  EXPECT_EQ(InUse("r1"), old);
}

TEST_F(BundleControlTest, RefusesWhatCannotBeActivated) {
  const std::string crane = Push("crane", "crane");
  EXPECT_THAT(control_->Activate(Order(crane)), StatusIs(absl::StatusCode::kNotFound));
  ActivateOrder order = Order(crane);
  order.robots = {.robots = {"r1"}};
  EXPECT_THAT(control_->Activate(order), StatusIs(absl::StatusCode::kFailedPrecondition,
                                                  HasSubstr("policy `warehouse` for robot `r1`")));
  EXPECT_THAT(control_->Activate(Order("sha256:0000000000")),
              StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(control_->Activate(Order(std::string(kDirectory))),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("robots of one policy")));
  // Its copy was changed on the disk.
  const std::string fresh = Push("warehouse", "fresh");
  std::ofstream(dir_.File("kept/") + fresh.substr(7) + "/r.rul", std::ios::app) << "# more\n";
  EXPECT_THAT(control_->Activate(Order(fresh)),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("changed")));
}

TEST_F(BundleControlTest, NothingHappensWhatCannotBeMadeDurable) {
  const std::string old = InUse("r1");
  const std::string fresh = Push("warehouse", "fresh");
  // A directory stands where the file is to be.
  std::filesystem::create_directories(dir_.File("kept/activated.json/x"));
  EXPECT_FALSE(control_->Activate(Order(fresh)).ok());
  EXPECT_EQ(InUse("r1"), old);
  EXPECT_FALSE(activations_->now().rollout.has_value());
}

TEST_F(BundleControlTest, AStopThatCannotBeMadeDurableIsSaidOnceAndTriedAgain) {
  const std::string fresh = Push("warehouse", "fresh");
  ASSERT_THAT(control_->Activate(Order(fresh)), IsOk());
  LookFor(2 * kNanosPerSecond);
  std::filesystem::remove(dir_.File("kept/activated.json"));
  std::filesystem::create_directories(dir_.File("kept/activated.json/x"));
  Halt("r1");
  LookFor(5 * kNanosPerSecond);
  EXPECT_EQ(State(), RolloutState::kRunning);
  EXPECT_THAT(control_->Status("")->not_healthy_because,
              ::testing::AllOf(HasSubstr("cannot be recorded"), HasSubstr("its level rose to HALT"),
                               HasSubstr("activated.json")));
  std::filesystem::remove_all(dir_.File("kept/activated.json"));
  LookFor(2 * kNanosPerSecond);
  EXPECT_EQ(State(), RolloutState::kStopped);
  EXPECT_THAT(control_->Status("")->not_healthy_because, IsEmpty());
  const auto texts = ServerAlertTexts();
  EXPECT_EQ(std::count_if(texts.begin(), texts.end(),
                          [](const std::string& text) {
                            return absl::StartsWith(text, "high: ") &&
                                   absl::StrContains(text, "cannot be recorded");
                          }),
            1);
}

TEST_F(BundleControlTest, ARollBackOfRobotsOfNoRollOutLeavesItAlone) {
  ActivateOrder dock = Order(Push("dock", "other"));
  dock.robots = {.robots = {"d1"}};
  ASSERT_THAT(control_->Activate(dock), IsOk());
  LookFor(kSoakNs + 3 * kNanosPerSecond);
  const std::string fresh = Push("warehouse", "fresh");
  ASSERT_THAT(control_->Activate(Order(fresh, {{.percent = 50}, {.percent = 100}})), IsOk());
  LookFor(kSoakNs - kNanosPerSecond);
  const auto healthy_since = control_->Status("")->healthy_since_unix_ns;
  ASSERT_TRUE(healthy_since.has_value());
  ASSERT_THAT(
      control_->RollBack({.robots = {.robots = {"d1"}}, .operator_name = "bob", .reason = "x"}),
      IsOk());
  EXPECT_EQ(State(), RolloutState::kRunning);
  EXPECT_EQ(activations_->now().rollout->rolled_back, "");
  EXPECT_EQ(control_->Status("")->healthy_since_unix_ns, healthy_since);
}

TEST_F(BundleControlTest, GoingBackByItselfLeavesAnActivationOfAnotherRollOutAlone) {
  const std::string old = InUse("r1");
  const std::string first = Push("warehouse", "first");
  ActivateOrder order = Order(first);
  order.robots = {.robots = {"r2"}};
  ASSERT_THAT(control_->Activate(order), IsOk());
  LookFor(kSoakNs + 3 * kNanosPerSecond);
  order = Order(Push("warehouse", "second"), {{.percent = 25}, {.percent = 100}});
  order.robots = {.robots = {"r1", "r2"}};
  order.roll_back_when_stopped = true;
  ASSERT_THAT(control_->Activate(order), IsOk());
  // r2 leaves before its stage begins.
  std::ofstream(dir_.File("robots.yaml"))
      << "robots:\n  - {id: r1, bundle: warehouse, sensors: [{host: base, primary: true}]}\n";
  fleet_->Reload();
  LookFor(kSoakNs + 3 * kNanosPerSecond);
  ASSERT_EQ(activations_->now().rollout->stage, 1u);
  Halt("r1");
  LookFor(2 * kNanosPerSecond);
  EXPECT_EQ(State(), RolloutState::kStopped);
  EXPECT_EQ(InUse("r1"), old);
  EXPECT_EQ(activations_->now().robots.at("r2").bundle_id, first);
  EXPECT_EQ(activations_->now().rollout->rolled_back, "r1 at once");
}

TEST_F(BundleControlTest, ARollOutOfTheDirectoryGoesBackToWhatItHeldBefore) {
  const std::string old = InUse("r1");
  WriteBundle(dir_.File("source/warehouse"), "warehouse", "# edited\n");
  ActivateOrder order = Order(std::string(kDirectory));
  order.robots = {.robots = {"r1", "r2", "r3", "r4"}};
  order.roll_back_when_stopped = true;
  ASSERT_THAT(control_->Activate(order), IsOk());
  const std::string edited = InUse("r1");
  EXPECT_NE(edited, old);
  LookFor(2 * kNanosPerSecond);
  Halt("r1");
  LookFor(2 * kNanosPerSecond);
  EXPECT_EQ(State(), RolloutState::kStopped);
  EXPECT_THAT(InUse(), ElementsAre(old, old, old, old));
  Restart();
  EXPECT_THAT(InUse(), ElementsAre(old, old, old, old));
}

TEST_F(BundleControlTest, AnUnusedBundleIsForgottenBeforeOneThatARollBackNeeds) {
  const std::string first = Push("warehouse", "first");
  ASSERT_THAT(control_->Activate(Order(first)), IsOk());
  LookFor(kSoakNs + 3 * kNanosPerSecond);
  const std::string second = Push("warehouse", "second");
  ASSERT_THAT(control_->Activate(Order(second)), IsOk());
  for (int i = 0; i < 20; ++i) Push("warehouse", absl::StrCat("unused", i));
  fleet_->ForgetUnused();
  EXPECT_THAT(library_->Find(first), IsOk());
  EXPECT_THAT(library_->Find(second), IsOk());
  ASSERT_THAT(control_->RollBack({.robots = {.all = true}, .operator_name = "bob", .reason = "x"}),
              IsOk());
  EXPECT_EQ(InUse("r1"), first);
}

TEST_F(BundleControlTest, ABundleOfManyRobotsIsLoadedOnce) {
  const std::string fresh = Push("warehouse", "fresh");
  const int before = loads_;
  ASSERT_THAT(control_->Activate(Order(fresh, {{.percent = 25}, {.percent = 100}})), IsOk());
  LookFor(kSoakNs + 3 * kNanosPerSecond);
  EXPECT_THAT(InUse("r4"), fresh);
  EXPECT_EQ(loads_, before + 1);
}

TEST_F(BundleControlTest, AShadowJudgesNothingAndLastsOverARestart) {
  const std::string old = InUse("r1");
  const std::string fresh = Push("warehouse", "fresh");
  const auto begun = control_->Shadow({.bundle = fresh,
                                       .robots = {.labels = {"ring=canary"}},
                                       .operator_name = "alice",
                                       .reason = "to see"});
  ASSERT_THAT(begun, IsOk());
  EXPECT_THAT(begun->changed, ElementsAre("r2"));
  EXPECT_EQ(InUse("r2"), old);
  EXPECT_EQ(control_->Status("r2")->robots.at(0).shadow->bundle_id, fresh);
  EXPECT_FALSE(control_->Status("r1")->robots.at(0).shadow.has_value());
  Restart();
  const auto report = control_->Status("r2")->robots.at(0).shadow;
  ASSERT_TRUE(report.has_value());
  EXPECT_EQ(report->operator_name, "alice");
  // Another one takes its place.
  const std::string other = Push("warehouse", "other");
  ASSERT_THAT(control_->Shadow({.bundle = other, .robots = {.robots = {"r2"}}, .reason = "x"}),
              IsOk());
  EXPECT_EQ(control_->Status("r2")->robots.at(0).shadow->bundle_id, other);
  const auto ended = control_->Shadow({.robots = {.robots = {"r1", "r2"}}, .reason = "seen"});
  ASSERT_THAT(ended, IsOk());
  EXPECT_THAT(ended->changed, ElementsAre("r2"));
  EXPECT_THAT(ended->left_out, ElementsAre("r1: has no shadow"));
  Restart();
  EXPECT_FALSE(control_->Status("r2")->robots.at(0).shadow.has_value());
}

TEST_F(BundleControlTest, RefusesAShadowOfAnotherPolicy) {
  const std::string crane = Push("crane", "crane");
  EXPECT_THAT(control_->Shadow({.bundle = crane, .robots = {.robots = {"r1"}}, .reason = "x"}),
              StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(control_->Shadow({.bundle = "0123456789", .robots = {.all = true}, .reason = "x"}),
              StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(activations_->now().shadows, IsEmpty());
}

TEST(OrderThreadTest, RunsWhatIsPostedInOrderLooksAroundAndEndsWithIt) {
  FakeClock clock;
  OrderThread thread(&clock);
  std::atomic<int> looked = 0;
  thread.Start([&looked] { ++looked; });
  std::vector<int> ran;
  for (int i = 0; i < 5; ++i) {
    EXPECT_TRUE(thread.Post([&ran, i] { ran.push_back(i); }));
  }
  EXPECT_TRUE(thread.Await([&ran] { ran.push_back(5); }));
  EXPECT_THAT(ran, ElementsAre(0, 1, 2, 3, 4, 5));
  EXPECT_EQ(looked, 0);
  clock.Advance(2 * kNanosPerSecond);
  EXPECT_TRUE(thread.Await([] {}));
  EXPECT_TRUE(thread.Await([] {})) << "after that it has looked";
  EXPECT_EQ(looked, 1);
  thread.Stop();
  EXPECT_FALSE(thread.Await([] {}));
  EXPECT_FALSE(thread.Post([] {}));
}

TEST(OrderThreadTest, RefusesMoreOrdersThanMayWait) {
  FakeClock clock;
  OrderThread thread(&clock);
  int ran = 0;
  for (size_t i = 0; i < OrderThread::kOrdersMax; ++i) {
    EXPECT_TRUE(thread.Post([&ran] { ++ran; }));
  }
  EXPECT_FALSE(thread.Post([] {}));
  EXPECT_FALSE(thread.Await([] {}));
  thread.Start([] {});
  thread.Stop();
  EXPECT_EQ(ran, static_cast<int>(OrderThread::kOrdersMax));
}

TEST_F(BundleControlTest, AReloadShowsInTheStatusWhenItReturns) {
  control_->Start();
  WriteBundle(dir_.File("source/warehouse"), "warehouse", "# edited\n");
  bool before = false;
  EXPECT_TRUE(control_->Reload([&before] { before = true; }));
  EXPECT_TRUE(before);
  EXPECT_EQ(control_->Status("r1")->robots.size(), 1u);
}

}  // namespace
}  // namespace rips::rollout
