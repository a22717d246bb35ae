// The board with devices that do what the test says: stuck, absent, failing.
#include "mode_actuator/steps/alarm/alarm_board.h"

#include <deque>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/alarm/alarm_attempt.h"
#include "mode_actuator/steps/alarm/alarm_test_order.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"
#include "services/base/status_matchers.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using absl::StatusCode;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// What is plugged in, by serial; shared by the test and the board's threads.
class World {
 public:
  struct Plugged {
    bool present = true;
    bool readable = true;
    bool stuck = false;
    absl::Status next_set;  // of one Set, then OK again
    std::map<int, AlarmState> states;
    std::vector<std::string> sets;
    int opens = 0;
  };

  void With(const std::string& serial, const std::function<void(Plugged&)>& change) {
    MutexLock lock(&mu_);
    change(plugged_[serial]);
    changed_.NotifyAll();
  }
  // True as soon as `condition` holds; false after 20 s.
  bool Until(const std::string& serial, const std::function<bool(const Plugged&)>& condition) {
    MutexLock lock(&mu_);
    for (int i = 0; i < 200 && !condition(plugged_[serial]); ++i) {
      changed_.WaitFor(lock, absl::Milliseconds(100));
    }
    return condition(plugged_[serial]);
  }
  absl::Status Set(const std::string& serial, IoGate* gate, int channel, const AlarmState& state) {
    const IoGate::Exchange exchange(gate);
    RIPS_RETURN_IF_ERROR(exchange.status());
    MutexLock lock(&mu_);
    Plugged& device = plugged_[serial];
    device.sets.push_back(absl::StrCat(channel, "=", ToString(state)));
    changed_.NotifyAll();
    while (device.stuck) changed_.Wait(lock);
    if (!device.present) return absl::UnavailableError("No such device");
    if (!device.next_set.ok()) return std::exchange(device.next_set, absl::OkStatus());
    device.states[channel] = state;
    return absl::OkStatus();
  }
  absl::StatusOr<AlarmReading> Read(const std::string& serial, IoGate* gate, int channel,
                                    const AlarmState& wanted) {
    const IoGate::Exchange exchange(gate);
    RIPS_RETURN_IF_ERROR(exchange.status());
    MutexLock lock(&mu_);
    Plugged& device = plugged_[serial];
    if (!device.present) return absl::UnavailableError("No such device");
    if (!device.readable) return AlarmReading{};
    const AlarmState is = device.states[channel];
    return AlarmReading{
        is == wanted ? AlarmReading::Answer::kAsWanted : AlarmReading::Answer::kOther, "it",
        ToString(is)};
  }
  absl::Status Open(const std::string& serial) {
    MutexLock lock(&mu_);
    Plugged& device = plugged_[serial];
    if (!device.present) return absl::NotFoundError("not plugged in");
    ++device.opens;
    return absl::OkStatus();
  }

 private:
  Mutex mu_;
  CondVar changed_;
  std::map<std::string, Plugged> plugged_ ABSL_GUARDED_BY(mu_);
};

class FakeDevice final : public AlarmDevice {
 public:
  FakeDevice(std::shared_ptr<World> world, std::string serial, IoGate* gate)
      : world_(std::move(world)), serial_(std::move(serial)), gate_(gate) {}
  absl::Status Set(int channel, const AlarmState& state) override {
    return world_->Set(serial_, gate_, channel, state);
  }
  absl::StatusOr<AlarmReading> Read(int channel, const AlarmState& wanted) override {
    return world_->Read(serial_, gate_, channel, wanted);
  }

 private:
  const std::shared_ptr<World> world_;
  const std::string serial_;
  IoGate* const gate_;
};

class AlarmBoardTest : public ::testing::Test {
 protected:
  OpenAlarm Open() {
    return [world = world_](const AlarmSpec& spec,
                            IoGate* gate) -> absl::StatusOr<std::unique_ptr<AlarmDevice>> {
      RIPS_RETURN_IF_ERROR(world->Open(spec.serial));
      return std::make_unique<FakeDevice>(world, spec.serial, gate);
    };
  }
  void Start() { board_ = std::make_unique<AlarmBoard>(specs_, Open(), &clock_); }
  bool IsMissing(size_t count) {
    for (int i = 0; i < 4000 && board_->missing() != count; ++i) {
      absl::SleepFor(absl::Milliseconds(5));
    }
    return board_->missing() == count;
  }

  const std::vector<AlarmSpec> specs_ = {{"left", AlarmKind::kUsbRelay, "A", "", 1},
                                         {"right", AlarmKind::kUsbRelay, "A", "", 2},
                                         {"other", AlarmKind::kUsbRelay, "B", "", 1}};
  RealClock clock_;
  std::shared_ptr<World> world_ = std::make_shared<World>();
  std::unique_ptr<AlarmBoard> board_;
};

TEST_F(AlarmBoardTest, SaysWhatWasReadBack) {
  Start();
  const AlarmResult on = SetAlarm(*board_, "left", kTestOn);
  EXPECT_THAT(on.status, IsOk());
  EXPECT_EQ(on.detail, "it is on (read back)");
  EXPECT_EQ(on.observed, "on");
  EXPECT_THAT(ReadAlarm(*board_, "left", kTestOn).status, IsOk());
  EXPECT_THAT(
      ReadAlarm(*board_, "right", kTestOn).status,
      StatusIs(StatusCode::kFailedPrecondition, HasSubstr("it is off (read back), not on")));
}

TEST_F(AlarmBoardTest, ChannelsOfOneBoardShareOneConnection) {
  Start();
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOn).status, IsOk());
  EXPECT_THAT(SetAlarm(*board_, "right", kTestOn).status, IsOk());
  world_->With("A", [](World::Plugged& device) {
    EXPECT_EQ(device.opens, 1);
    EXPECT_THAT(device.sets, ElementsAre("1=on", "2=on"));
  });
}

TEST_F(AlarmBoardTest, AStuckDeviceHoldsUpNobodyElse) {
  world_->With("A", [](World::Plugged& device) { device.stuck = true; });
  Start();
  const auto left = board_->Begin("left", AlarmOrder::kSet, kTestOn);
  ASSERT_THAT(left, IsOk());
  ASSERT_TRUE(
      world_->Until("A", [](const World::Plugged& device) { return !device.sets.empty(); }));
  const auto right = board_->Begin("right", AlarmOrder::kSet, kTestOn);
  ASSERT_THAT(right, IsOk());

  EXPECT_THAT(SetAlarm(*board_, "other", kTestOn).status, IsOk());
  EXPECT_THAT(Await(*board_, *left).status,
              StatusIs(StatusCode::kDeadlineExceeded, HasSubstr("within 500ms")));
  EXPECT_THAT(Await(*board_, *right).status, StatusIs(StatusCode::kDeadlineExceeded));
  // As long as the kernel does not come back, every order fails.
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOff).status, StatusIs(StatusCode::kDeadlineExceeded));
  EXPECT_EQ(board_->missing(), 1u);

  world_->With("A", [](World::Plugged& device) { device.stuck = false; });
  AlarmResult result;
  for (int i = 0; i < 4000 && result.observed != "off"; ++i) {
    result = SetAlarm(*board_, "left", kTestOff);
    absl::SleepFor(absl::Milliseconds(5));
  }
  EXPECT_THAT(result.status, IsOk());
  EXPECT_EQ(board_->missing(), 0u);
  world_->With("A", [](World::Plugged& device) {
    // What waited behind the stuck write was never sent.
    for (const std::string& set : device.sets) EXPECT_NE(set, "2=on");
    EXPECT_EQ(device.sets.front(), "1=on");
    EXPECT_EQ(device.sets.back(), "1=off");
  });
}

TEST_F(AlarmBoardTest, EndsAlthoughADeviceIsStuck) {
  world_->With("A", [](World::Plugged& device) { device.stuck = true; });
  Start();
  ASSERT_THAT(board_->Begin("left", AlarmOrder::kSet, kTestOn), IsOk());
  ASSERT_TRUE(
      world_->Until("A", [](const World::Plugged& device) { return !device.sets.empty(); }));
  board_.reset();
  const std::weak_ptr<World> world = world_;
  world_->With("A", [](World::Plugged& device) { device.stuck = false; });
  world_.reset();
  // The thread that was left behind ends and lets go of everything.
  for (int i = 0; i < 4000 && !world.expired(); ++i) absl::SleepFor(absl::Milliseconds(5));
  EXPECT_TRUE(world.expired());
}

TEST_F(AlarmBoardTest, AnAbsentDeviceIsFoundWhenItComes) {
  world_->With("B", [](World::Plugged& device) { device.present = false; });
  Start();
  EXPECT_TRUE(IsMissing(1));
  EXPECT_THAT(SetAlarm(*board_, "other", kTestOn).status, StatusIs(StatusCode::kNotFound));
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOn).status, IsOk());
  world_->With("B", [](World::Plugged& device) { device.present = true; });
  EXPECT_THAT(SetAlarm(*board_, "other", kTestOn).status, IsOk());
  EXPECT_EQ(board_->missing(), 0u);
}

TEST_F(AlarmBoardTest, AnUnpluggedDeviceFailsOnceAndIsOpenedAnew) {
  Start();
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOn).status, IsOk());
  world_->With("A", [](World::Plugged& device) { device.present = false; });
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOn).status, StatusIs(StatusCode::kUnavailable));
  EXPECT_EQ(board_->missing(), 1u);
  EXPECT_THAT(ReadAlarm(*board_, "left", kTestOn).status, StatusIs(StatusCode::kNotFound));
  world_->With("A", [](World::Plugged& device) {
    device.present = true;
    device.states.clear();
  });
  EXPECT_THAT(ReadAlarm(*board_, "left", kTestOn).status,
              StatusIs(StatusCode::kFailedPrecondition));
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOn).status, IsOk());
  world_->With("A", [](World::Plugged& device) { EXPECT_EQ(device.opens, 2); });
}

TEST_F(AlarmBoardTest, WhatCannotBeReadBackIsNotedAsTold) {
  world_->With("A", [](World::Plugged& device) { device.readable = false; });
  Start();
  EXPECT_THAT(ReadAlarm(*board_, "left", kTestOn).status,
              StatusIs(StatusCode::kFailedPrecondition, HasSubstr("not set to on")));
  const AlarmResult on = SetAlarm(*board_, "left", kTestOn);
  EXPECT_THAT(on.status, IsOk());
  EXPECT_EQ(on.detail, "sent; this device cannot be read back");
  EXPECT_EQ(on.observed, "?");
  EXPECT_THAT(ReadAlarm(*board_, "left", kTestOn).status, IsOk());
  EXPECT_THAT(ReadAlarm(*board_, "left", kTestOff).status,
              StatusIs(StatusCode::kFailedPrecondition));
  EXPECT_THAT(ReadAlarm(*board_, "right", kTestOn).status,
              StatusIs(StatusCode::kFailedPrecondition));
  // A failed write may have been half taken.
  world_->With("A", [](World::Plugged& device) { device.next_set = absl::OutOfRangeError("no"); });
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOff).status, StatusIs(StatusCode::kOutOfRange));
  EXPECT_THAT(ReadAlarm(*board_, "left", kTestOn).status,
              StatusIs(StatusCode::kFailedPrecondition));
}

TEST_F(AlarmBoardTest, WhatNobodyWaitsForIsCarriedOutAllTheSame) {
  world_->With("A", [](World::Plugged& device) { device.stuck = true; });
  Start();
  const auto first = board_->Begin("left", AlarmOrder::kSet, kTestOn);
  const auto second = board_->Begin("left", AlarmOrder::kSet, kTestOff);
  ASSERT_THAT(first, IsOk());
  ASSERT_THAT(second, IsOk());
  board_->Leave(*first);
  board_->Leave(*second);
  EXPECT_THAT(board_->Poll(*second)->status, StatusIs(StatusCode::kInternal));
  board_->Leave(*second);  // not known any more
  world_->With("A", [](World::Plugged& device) { device.stuck = false; });
  EXPECT_TRUE(world_->Until("A", [](const World::Plugged& device) {
    return device.sets == std::vector<std::string>{"1=on", "1=off"};
  }));
  // Their results take nobody's place.
  for (size_t i = 0; i < kAlarmOrdersMax; ++i) {
    EXPECT_THAT(SetAlarm(*board_, "left", kTestOff).status, IsOk());
    const auto order = board_->Begin("left", AlarmOrder::kSet, kTestOff);
    ASSERT_THAT(order, IsOk());
    board_->Leave(*order);
  }
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOff).status, IsOk());
}

TEST_F(AlarmBoardTest, OrdersOfADeviceHaveALimit) {
  world_->With("A", [](World::Plugged& device) { device.stuck = true; });
  Start();
  std::vector<uint64_t> orders;
  for (size_t i = 0; i < kAlarmOrdersMax; ++i) {
    const auto order = board_->Begin(i % 2 == 0 ? "left" : "right", AlarmOrder::kSet, kTestOn);
    ASSERT_THAT(order, IsOk());
    orders.push_back(*order);
  }
  EXPECT_THAT(board_->Begin("left", AlarmOrder::kSet, kTestOn),
              StatusIs(StatusCode::kResourceExhausted, HasSubstr("exceed limit 8")));
  EXPECT_THAT(board_->Begin("other", AlarmOrder::kSet, kTestOn), IsOk());
  for (const uint64_t order : orders) board_->Drop(order);
  world_->With("A", [](World::Plugged& device) { device.stuck = false; });
  EXPECT_THAT(SetAlarm(*board_, "left", kTestOff).status, IsOk());
}

TEST_F(AlarmBoardTest, KnowsNoOtherAlarmsAndOrders) {
  Start();
  EXPECT_THAT(board_->Begin("bell", AlarmOrder::kSet, kTestOn), StatusIs(StatusCode::kNotFound));
  EXPECT_THAT(board_->Poll(77)->status, StatusIs(StatusCode::kInternal));
  board_->Drop(77);
  const auto order = board_->Begin("left", AlarmOrder::kSet, kTestOn);
  ASSERT_THAT(order, IsOk());
  EXPECT_THAT(Await(*board_, *order).status, IsOk());
  EXPECT_THAT(board_->Poll(*order)->status, StatusIs(StatusCode::kInternal)) << "once only";
}

// --- AlarmAttempt

// Gives the results that the test has prepared; none = the order does not end.
class FakeAlarms final : public Alarms {
 public:
  absl::StatusOr<uint64_t> Begin(absl::string_view, AlarmOrder, const AlarmState&) override {
    RIPS_RETURN_IF_ERROR(begin);
    return ++orders;
  }
  std::optional<AlarmResult> Poll(uint64_t) override {
    if (results.empty()) return std::nullopt;
    AlarmResult result = results.front();
    results.pop_front();
    return result;
  }
  void Drop(uint64_t order) override { dropped.push_back(order); }
  void Leave(uint64_t) override {}

  absl::Status begin;
  uint64_t orders = 0;
  std::deque<AlarmResult> results;
  std::vector<uint64_t> dropped;
};

class AlarmAttemptTest : public ::testing::Test {
 protected:
  AlarmAttempt Make(int retries) {
    return AlarmAttempt({"left", kTestOn}, "alarm left=on", &alarms_,
                        {.timeout = absl::Seconds(1), .retries = retries}, 0);
  }
  // Polls for `seconds` in steps of 20 ms; true when it is over.
  static bool PollFor(AlarmAttempt& attempt, double seconds) {
    const auto end = static_cast<int64_t>(seconds * kNanosPerSecond);
    for (int64_t now = 0; now < end; now += 20 * kNanosPerMilli) {
      if (attempt.Poll(now)) return true;
    }
    return false;
  }
  FakeAlarms alarms_;
};

TEST_F(AlarmAttemptTest, TriesAgainWhatFailed) {
  alarms_.results = {{.status = absl::UnavailableError("EIO")},
                     {.status = absl::NotFoundError("gone")},
                     {.detail = "relay 1 is on (read back)", .observed = "on"}};
  AlarmAttempt attempt = Make(2);
  EXPECT_TRUE(PollFor(attempt, 2));
  EXPECT_TRUE(attempt.result.ok);
  EXPECT_EQ(attempt.result.step, "alarm left=on");
  EXPECT_EQ(attempt.result.detail, "relay 1 is on (read back)");
  EXPECT_EQ(attempt.seen(), "on");
  EXPECT_EQ(attempt.observed, "left=on");
  EXPECT_EQ(alarms_.orders, 3u);
  EXPECT_GE(attempt.result.took_ms, 2 * absl::ToInt64Milliseconds(kAlarmRetryPause));
}

TEST_F(AlarmAttemptTest, GivesUpAfterItsRetries) {
  alarms_.results = {{.status = absl::UnavailableError("EIO")},
                     {.status = absl::DataLossError("garbage")}};
  AlarmAttempt attempt = Make(1);
  EXPECT_TRUE(PollFor(attempt, 2));
  EXPECT_FALSE(attempt.result.ok);
  EXPECT_EQ(attempt.result.detail, "garbage");
}

TEST_F(AlarmAttemptTest, DoesNotRetryWhatCannotWork) {
  alarms_.results = {{.status = absl::OutOfRangeError("the board has no relay 3: it has 2")}};
  AlarmAttempt attempt = Make(5);
  EXPECT_TRUE(PollFor(attempt, 2));
  EXPECT_EQ(alarms_.orders, 1u);
}

TEST_F(AlarmAttemptTest, DropsAnOrderThatDoesNotEnd) {
  AlarmAttempt attempt = Make(1);
  EXPECT_FALSE(PollFor(attempt, 1.9));
  EXPECT_TRUE(PollFor(attempt, 3));
  EXPECT_EQ(attempt.result.detail, "not over in 1s");
  EXPECT_THAT(alarms_.dropped, ElementsAre(1, 2));
}

TEST_F(AlarmAttemptTest, IsOverWhenCancelled) {
  AlarmAttempt attempt = Make(5);
  EXPECT_FALSE(PollFor(attempt, 0.1));
  attempt.Cancel();
  EXPECT_TRUE(attempt.Poll(kNanosPerSecond));
  EXPECT_EQ(attempt.result.detail, "cancelled");
  EXPECT_THAT(alarms_.dropped, ElementsAre(1));
}

TEST_F(AlarmAttemptTest, ATooFullDeviceIsAskedAgain) {
  alarms_.begin = absl::ResourceExhaustedError("full");
  AlarmAttempt attempt = Make(1);
  EXPECT_TRUE(PollFor(attempt, 2));
  EXPECT_EQ(attempt.result.detail, "full");
  EXPECT_THAT(alarms_.dropped, IsEmpty());
}

}  // namespace
}  // namespace rips::actuator
