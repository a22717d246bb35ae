#include "policy_server/server/outputs/output.h"

#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "policy_server/server/outputs/fake_peer_for_test.h"
#include "policy_server/server/outputs/outputs.h"
#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/sqlite_store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"
#include "services/runtime/metrics.h"
#include "services/runtime/real_clock.h"

namespace rips::outputs {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// Keeps the texts that it accepts; what it does with them is the test's.
struct FakeReceiver {
  std::function<absl::Status(std::span<const store::AlertRecord>)> judge;
  std::vector<std::string> accepted;
  std::vector<std::string> ids;
  std::vector<size_t> sizes;
  int calls = 0;
  bool cancelled = false;

  class Port final : public Receiver {
   public:
    explicit Port(FakeReceiver* fake) : fake_(fake) {}
    absl::Status Send(std::span<const store::AlertRecord> alerts) override {
      ++fake_->calls;
      fake_->sizes.push_back(alerts.size());
      if (fake_->judge) {
        if (absl::Status status = fake_->judge(alerts); !status.ok()) return status;
      }
      for (const store::AlertRecord& alert : alerts) {
        fake_->accepted.push_back(alert.event == "gap" ? "gap: " + alert.text : alert.text);
        fake_->ids.push_back(alert.id);
      }
      return absl::OkStatus();
    }
    size_t batch_max() const override { return 4; }
    void Cancel() override { fake_->cancelled = true; }

   private:
    FakeReceiver* fake_;
  };
};

absl::Status Away(std::span<const store::AlertRecord>) {
  return absl::UnavailableError("it is away");
}

class OutputTest : public ::testing::Test {
 protected:
  void Raise(const std::string& text, const std::string& robot = "r1",
             const std::string& severity = "high") {
    store::WriteBatch batch{.robot = robot};
    batch.alerts.push_back(store::MakeAlert(robot, text));
    batch.alerts.back().severity = severity;
    ASSERT_THAT(store()->Commit(batch), IsOk());
  }
  store::Store* store() { return other_ != nullptr ? other_ : &store_; }
  std::unique_ptr<Output> Open() {
    return std::make_unique<Output>(
        config_, store(), std::make_unique<FakeReceiver::Port>(&receiver_),
        OutputReports{.sent = [this](uint64_t by) { sent_ += by; },
                      .skipped = [this](uint64_t by) { skipped_ += by; },
                      .forgotten = [this](uint64_t by) { forgotten_ += by; },
                      .failed = [this] { ++failed_; },
                      .behind = [this](uint64_t by) { behind_ = by; },
                      .healthy = [this](bool ok) { healthy_ = ok; },
                      .alert =
                          [this](engine::Severity severity, const std::string& text) {
                            alerts_.push_back(absl::StrCat(engine::ToString(severity), ": ", text));
                          }},
        &clock_, [] { return 0.5; }, absl::InfiniteDuration());
  }
  // Looks again and again, a second apart.
  void LookFor(Output& output, int seconds) {
    for (int i = 0; i < seconds; ++i) {
      clock_.Advance(kNanosPerSecond);
      output.Look();
    }
  }
  void UseSqlite(int64_t alerts_per_robot_max) {
    sqlite_ = *store::SqliteStore::Open(dir_.File("state.db"),
                                        {.alerts_per_robot_max = alerts_per_robot_max});
    other_ = sqlite_.get();
  }

  store::TempDir dir_;
  store::FakeStore store_;
  std::unique_ptr<store::SqliteStore> sqlite_;
  store::Store* other_ = nullptr;
  FakeClock clock_;
  FakeReceiver receiver_;
  server::OutputConfig config_{.name = "pager", .kind = server::OutputConfig::Kind::kWebhook};
  uint64_t sent_ = 0;
  uint64_t skipped_ = 0;
  uint64_t forgotten_ = 0;
  uint64_t failed_ = 0;
  uint64_t behind_ = 0;
  bool healthy_ = false;
  std::vector<std::string> alerts_;
};

TEST_F(OutputTest, ANewOneBeginsNowAndSendsAllInOrder) {
  Raise("before");
  const auto output = Open();
  for (int i = 0; i < 9; ++i) Raise(absl::StrCat(i));
  output->Look();
  EXPECT_THAT(receiver_.accepted, ElementsAre("0", "1", "2", "3", "4", "5", "6", "7", "8"));
  EXPECT_THAT(receiver_.sizes, ElementsAre(4, 4, 1));
  EXPECT_EQ(sent_, 9u);
  EXPECT_EQ(behind_, 0u);
  EXPECT_TRUE(healthy_);
}

TEST_F(OutputTest, ARestartGoesOnWhereItWas) {
  Open()->Look();
  Raise("one");
  Open()->Look();
  Raise("two");
  const auto output = Open();
  output->Look();
  EXPECT_THAT(receiver_.accepted, ElementsAre("one", "two"));
}

TEST_F(OutputTest, ACrashSendsAgainWhatWasNotNoted) {
  const auto crashed = Open();
  Raise("one");
  clock_.Advance(2 * kNanosPerSecond);
  crashed->Look();
  Raise("two");
  crashed->Look();  // within the same two seconds
  const auto output = Open();
  output->Look();
  EXPECT_THAT(receiver_.accepted, ElementsAre("one", "two", "two"));
}

TEST_F(OutputTest, AFailureIsTriedAgainLaterAndLater) {
  const auto output = Open();
  Raise("one");
  receiver_.judge = Away;
  output->Look();
  EXPECT_FALSE(healthy_);
  EXPECT_EQ(behind_, 1u);
  std::vector<int> calls;
  for (int i = 0; i < 6; ++i) {
    LookFor(*output, 2 << i);
    calls.push_back(receiver_.calls);
  }
  EXPECT_THAT(calls, ElementsAre(2, 3, 4, 5, 6, 7));
  LookFor(*output, 3'000);
  EXPECT_LT(receiver_.calls, 25);
  EXPECT_EQ(failed_, static_cast<uint64_t>(receiver_.calls));
  receiver_.judge = nullptr;
  LookFor(*output, 300);
  EXPECT_THAT(receiver_.accepted, ElementsAre("one"));
  EXPECT_TRUE(healthy_);
  EXPECT_EQ(skipped_, 0u) << "whatever fails for whatever time";
}

TEST_F(OutputTest, OneBadAlertIsSkippedAfterThreeTriesAndNoOther) {
  const auto output = Open();
  for (const char* text : {"one", "two", "bad", "three", "four"}) Raise(text);
  int tries = 0;
  receiver_.judge = [&](std::span<const store::AlertRecord> alerts) {
    for (const store::AlertRecord& alert : alerts) {
      if (alert.text != "bad") continue;
      if (alerts.size() == 1) ++tries;
      return absl::InvalidArgumentError("400");
    }
    return absl::OkStatus();
  };
  output->Look();
  EXPECT_THAT(receiver_.accepted, ElementsAre("one", "two")) << "the rest waits for the tries";
  LookFor(*output, 10);
  EXPECT_THAT(receiver_.accepted, ElementsAre("one", "two", "three", "four"));
  EXPECT_EQ(tries, Output::kTriesMax);
  EXPECT_EQ(skipped_, 1u);
  EXPECT_EQ(sent_, 4u);
  for (int i = 0; i < 4; ++i) Raise("later");
  output->Look();
  EXPECT_EQ(receiver_.sizes.back(), 4u) << "together again";
}

TEST_F(OutputTest, OneThatRefusesEverythingLosesFewAndIsTrouble) {
  const auto output = Open();
  for (int i = 0; i < 100; ++i) Raise(absl::StrCat(i));
  receiver_.judge = [](std::span<const store::AlertRecord>) {
    return absl::InvalidArgumentError("403");
  };
  LookFor(*output, 600);
  EXPECT_LE(skipped_, 4u) << "as after failures, it is asked less and less often";
  ASSERT_THAT(alerts_, SizeIs(1));
  EXPECT_THAT(alerts_[0], HasSubstr("403"));
}

TEST_F(OutputTest, WhatWasNotInTimeIsSentInSmallerPieces) {
  const auto output = Open();
  for (int i = 0; i < 4; ++i) Raise(absl::StrCat(i));
  receiver_.judge = [](std::span<const store::AlertRecord> alerts) {
    return alerts.size() > 1 ? absl::DeadlineExceededError("slow") : absl::OkStatus();
  };
  output->Look();
  EXPECT_THAT(receiver_.accepted, IsEmpty());
  LookFor(*output, 3);
  EXPECT_THAT(receiver_.accepted, ElementsAre("0", "1", "2", "3"));
}

TEST_F(OutputTest, SendsWhatIsSevereEnoughOfItsRobots) {
  config_.severity = "medium";
  config_.robots = {"r1", "r3"};
  const auto output = Open();
  Raise("info", "r1", "info");
  Raise("medium", "r1", "medium");
  Raise("other", "r2", "critical");
  Raise("critical", "r3", "critical");
  Raise("odd", "r1", "odd");
  output->Look();
  EXPECT_THAT(receiver_.accepted, ElementsAre("medium", "critical"));
  EXPECT_EQ(behind_, 0u);
  EXPECT_EQ(sent_, 2u);
}

TEST_F(OutputTest, WhatTheStoreForgotIsAnEventWithItsNumber) {
  UseSqlite(3);
  const auto output = Open();
  Raise("0");
  Raise("other", "r2");
  output->Look();
  receiver_.judge = Away;
  for (int i = 1; i < 9; ++i) Raise(absl::StrCat(i));
  output->Look();
  receiver_.judge = nullptr;
  LookFor(*output, 3);
  ASSERT_THAT(receiver_.accepted, SizeIs(6));
  EXPECT_THAT(receiver_.accepted[2], HasSubstr("gap: 5 alerts are missing here"));
  EXPECT_EQ(receiver_.accepted[3], "6");
  EXPECT_EQ(forgotten_, 5u);
  Raise("9");
  output->Look();
  EXPECT_EQ(receiver_.accepted.back(), "9");
  EXPECT_EQ(forgotten_, 5u);
}

TEST_F(OutputTest, AGapIsNotToldAgainForAPageThatFails) {
  UseSqlite(3);
  const auto output = Open();
  for (int i = 0; i < 9; ++i) Raise(absl::StrCat(i));
  // Accepts the gap, refuses the page, and then each of its alerts for a while.
  receiver_.judge = [](std::span<const store::AlertRecord> alerts) {
    return alerts.front().event == "gap" ? absl::OkStatus() : absl::InvalidArgumentError("400");
  };
  output->Look();
  LookFor(*output, 2);
  receiver_.judge = nullptr;
  LookFor(*output, 10);
  EXPECT_THAT(receiver_.accepted,
              ElementsAre(HasSubstr("gap: 6 alerts are missing"), "6", "7", "8"));
  EXPECT_EQ(forgotten_, 6u);
}

TEST_F(OutputTest, AGapThatGrowsWhileItIsRefusedIsSkippedToo) {
  UseSqlite(3);
  const auto output = Open();
  for (int i = 0; i < 9; ++i) Raise(absl::StrCat(i));
  receiver_.judge = [](std::span<const store::AlertRecord> alerts) {
    return alerts.front().event == "gap" ? absl::InvalidArgumentError("400") : absl::OkStatus();
  };
  for (int i = 9; i < 20; ++i) {
    output->Look();
    Raise(absl::StrCat(i));
    clock_.Advance(10 * kNanosPerSecond);
  }
  EXPECT_GE(skipped_, 1u);
  EXPECT_THAT(receiver_.accepted, testing::Not(IsEmpty()));
}

TEST_F(OutputTest, AGapIsTheSameEventUntilItIsAccepted) {
  UseSqlite(3);
  const auto output = Open();
  for (int i = 0; i < 9; ++i) Raise(absl::StrCat(i));
  std::vector<std::string> ids;
  receiver_.judge = [&](std::span<const store::AlertRecord> alerts) {
    if (alerts.front().event == "gap") ids.push_back(alerts.front().id);
    return absl::UnavailableError("it is away");
  };
  output->Look();
  for (int i = 9; i < 12; ++i) {
    Raise(absl::StrCat(i));
    LookFor(*output, 20);
  }
  ASSERT_THAT(ids, SizeIs(testing::Gt(2)));
  EXPECT_THAT(ids, testing::Each(ids[0]));
  receiver_.judge = nullptr;
  LookFor(*output, 300);
  EXPECT_THAT(receiver_.accepted,
              ElementsAre(HasSubstr("gap: 6 alerts are missing"),
                          HasSubstr("gap: 3 alerts are missing"), "9", "10", "11"));
  EXPECT_EQ(receiver_.ids[0], ids[0]);
  EXPECT_NE(receiver_.ids[1], ids[0]);
  EXPECT_EQ(forgotten_, 9u);
}

TEST_F(OutputTest, APlaceThatTheStoreDoesNotKnowIsAGapOfUnknownSize) {
  for (const char* note : {"77-deadbeef", "rubbish", "1-"}) {
    receiver_ = FakeReceiver();
    ASSERT_THAT(store_.SetNote("output/pager", note), IsOk());
    Raise("before");
    receiver_.judge = Away;
    Open()->Look();  // a crash before the gap is sent
    receiver_.judge = nullptr;
    const auto output = Open();
    output->Look();
    Raise("after");
    output->Look();
    EXPECT_THAT(receiver_.accepted, ElementsAre(HasSubstr("gap: alerts may be missing"), "after"))
        << note;
  }
}

TEST_F(OutputTest, TroubleIsOneAlertAndItsEndAnother) {
  const auto output = Open();
  Raise("one");
  receiver_.judge = Away;
  output->Look();
  LookFor(*output, 299);
  EXPECT_THAT(alerts_, IsEmpty());
  LookFor(*output, 3'000);
  ASSERT_THAT(alerts_, SizeIs(1));
  EXPECT_THAT(alerts_[0],
              HasSubstr("high: output `pager` (webhook) has delivered no alert for 300 s: it is "
                        "away; 1 alerts of any robot and severity are behind it"));
  receiver_.judge = nullptr;
  LookFor(*output, 600);
  ASSERT_THAT(alerts_, SizeIs(2));
  EXPECT_THAT(alerts_[1], HasSubstr("info: output `pager` (webhook) delivers alerts again"));
}

TEST_F(OutputTest, ItsOwnAlertsCauseNoOthers) {
  const auto output = Open();
  Raise("one");
  // Each alert that it causes is raised, and is refused for ever; others are accepted.
  receiver_.judge = Away;
  size_t raised = 0;
  for (int i = 0; i < 3'600; ++i) {
    LookFor(*output, 1);
    if (i == 700) {
      receiver_.judge = [](std::span<const store::AlertRecord> alerts) {
        for (const store::AlertRecord& alert : alerts) {
          if (absl::StrContains(alert.text, "output `pager`")) {
            return absl::InvalidArgumentError("400");
          }
        }
        return absl::OkStatus();
      };
    }
    for (; raised < alerts_.size(); ++raised) Raise(alerts_[raised], "(server)");
  }
  EXPECT_THAT(alerts_, SizeIs(testing::Le(4))) << "not one alert after another";
}

TEST_F(OutputTest, AStoreThatFailsIsNoTroubleOfTheOutput) {
  const auto output = Open();
  Raise("one");
  store_.FailReads(absl::UnavailableError("disk"));
  LookFor(*output, 1'000);
  store_.FailReads(absl::OkStatus());
  store_.FailWrites(absl::UnavailableError("disk"));
  output->Look();
  EXPECT_THAT(receiver_.accepted, ElementsAre("one"));
  EXPECT_THAT(alerts_, IsEmpty());
  EXPECT_EQ(failed_, 0u);
}

TEST_F(OutputTest, ItsThreadDeliversAndStops) {
  RealClock clock;
  Metrics metrics;
  server::OutputConfig second = config_;
  second.name = "siem";
  second.kind = server::OutputConfig::Kind::kSyslog;
  // Away: a port that is closed.
  second.endpoint = {.host = "127.0.0.1", .port = 1, .tls = false};
  FakePeer peer([](Taken& taken) {
    taken.ReadRequest();
    taken.Write("HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n");
  });
  config_.endpoint = {.host = "127.0.0.1", .port = peer.port(), .tls = false};
  Outputs outputs({config_, second}, &store_, &metrics, &clock,
                  [](engine::Severity, const std::string&) {});
  Raise("one");
  // Of this output, but for 0; tries go on while the others are awaited.
  const std::string failed = "rips_output_failures_total{output=\"siem\"} ";
  const std::string sent = "rips_output_alerts_total{output=\"pager\",result=\"sent\"} 1";
  for (int i = 0; i < 6'000; ++i) {
    const std::string text = metrics.Text();
    if (!absl::StrContains(text, failed + "0\n") && absl::StrContains(text, sent)) break;
    absl::SleepFor(absl::Milliseconds(10));
  }
  outputs.Stop();
  outputs.Stop();
  EXPECT_THAT(metrics.Text(), testing::Not(HasSubstr(failed + "0\n")));
  for (const std::string& line :
       {sent, failed, std::string("rips_output_alerts_total{output=\"siem\",result=\"skipped\"} 0"),
        std::string("rips_output_alerts_total{output=\"siem\",result=\"forgotten\"} 0"),
        std::string("rips_output_healthy{output=\"siem\"} 0")}) {
    EXPECT_THAT(metrics.Text(), HasSubstr(line));
  }
}

}  // namespace
}  // namespace rips::outputs
