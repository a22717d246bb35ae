#include "policy_server/server/audit/returned_heads.h"

#include <atomic>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/audit/log_samples.h"
#include "services/runtime/mutex.h"

namespace rips::audit {
namespace {

using model::AuditHead;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;
using testing::UnorderedElementsAre;

// Counts reads of whole segments, of which the first fail.
class CountedSegments final : public Segments {
 public:
  CountedSegments(const SegmentsInMemory& segments, std::atomic<int>* reads, int failing)
      : segments_(segments), reads_(reads), failing_(failing) {}
  absl::StatusOr<std::vector<std::string>> Names() const override { return segments_.Names(); }
  absl::StatusOr<std::string> Read(absl::string_view name, uint64_t bytes_max) const override {
    if (bytes_max == kAll && ++*reads_ <= failing_) return absl::UnavailableError("cannot read");
    return segments_.Read(name, bytes_max);
  }

 private:
  const SegmentsInMemory segments_;
  std::atomic<int>* reads_;
  const int failing_;
};

class ReturnedHeadsTest : public testing::Test {
 protected:
  void Start(const SegmentsInMemory& segments, absl::Duration pause = absl::ZeroDuration(),
             int failing_reads = 0) {
    heads_ = std::make_unique<ReturnedHeads>(
        std::make_unique<CountedSegments>(segments, &reads_, failing_reads),
        [this](const HeadSource& source, const AuditHead&, HeadVerdict verdict) {
          MutexLock lock(&mu_);
          told_[source.robot] = verdict;
          ++counts_[source.robot];
          changed_.NotifyAll();
          while (held_) changed_.Wait(lock);
        },
        pause);
  }
  void AwaitTold(size_t robots) {
    MutexLock lock(&mu_);
    while (told_.size() < robots) changed_.Wait(lock);
  }
  // The next report blocks its pass until Release.
  void Hold() {
    MutexLock lock(&mu_);
    held_ = true;
  }
  void Release() {
    MutexLock lock(&mu_);
    held_ = false;
    changed_.NotifyAll();
  }
  // Reports about an actuator.
  int Count(const std::string& robot) {
    MutexLock lock(&mu_);
    return counts_[robot];
  }
  void AwaitCount(const std::string& robot, int count) {
    MutexLock lock(&mu_);
    while (counts_[robot] < count) changed_.Wait(lock);
  }
  std::map<std::string, HeadVerdict> told() {
    MutexLock lock(&mu_);
    return told_;
  }

  std::atomic<int> reads_ = 0;
  Mutex mu_;
  CondVar changed_;
  std::map<std::string, HeadVerdict> told_ ABSL_GUARDED_BY(mu_);
  std::map<std::string, int> counts_ ABSL_GUARDED_BY(mu_);
  bool held_ ABSL_GUARDED_BY(mu_) = false;
  std::unique_ptr<ReturnedHeads> heads_;
};

TEST_F(ReturnedHeadsTest, TellsTheVerdictOfEachActuator) {
  SampleLog log = TwoSegments();
  const AuditHead held = log.proven;
  const SegmentsInMemory before = log.segments;
  log.Group(1);
  Start(before);
  heads_->Compare({"r1", "h"}, held);
  heads_->Compare({"r2", "h"}, log.proven);
  AwaitTold(2);
  EXPECT_THAT(told(), UnorderedElementsAre(Pair("r1", HeadVerdict::kHeld),
                                           Pair("r2", HeadVerdict::kContradicted)));
}

TEST_F(ReturnedHeadsTest, NothingIsReadForAnActuatorWithoutAHead) {
  Start(TwoSegments().segments);
  heads_->Compare({"r1", "h"}, {});
  heads_->Compare({"r2", "h"}, TwoSegments().proven);
  AwaitTold(1);
  EXPECT_EQ(told().begin()->first, "r2");
}

TEST_F(ReturnedHeadsTest, ManyHeadsBetweenTwoPassesAreOneRead) {
  const SampleLog log = TwoSegments();
  Start(log.segments);
  Hold();
  heads_->Compare({"first", "h"}, log.proven);
  AwaitTold(1);
  for (int i = 0; i < 1000; ++i) heads_->Compare({absl::StrCat("r", i % 10), "h"}, log.proven);
  Release();
  AwaitTold(11);
  EXPECT_EQ(reads_, 2);
}

TEST_F(ReturnedHeadsTest, AForgedHeadReadsNoSegment) {
  const SampleLog log = TwoSegments();
  Start(log.segments);
  AuditHead forged = log.proven;
  forged.signature[0] ^= 1;
  heads_->Compare({"r1", "h"}, forged);
  AwaitTold(1);
  EXPECT_EQ(told().begin()->second, HeadVerdict::kForged);
  EXPECT_EQ(reads_, 0);
}

TEST_F(ReturnedHeadsTest, TheFirstOfSeveralHeadsIsCompared) {
  SampleLog log = TwoSegments();
  const AuditHead held = log.proven;
  const SegmentsInMemory before = log.segments;
  log.Group(1);
  Start(before);
  Hold();
  heads_->Compare({"first", "h"}, held);
  AwaitTold(1);
  heads_->Compare({"r1", "h"}, log.proven);
  heads_->Compare({"r1", "h"}, held);
  Release();
  AwaitTold(2);
  EXPECT_EQ(told()["r1"], HeadVerdict::kContradicted);
}

TEST_F(ReturnedHeadsTest, FindingsOfOneKindAboutAnActuatorAreReportedOnceInManyPasses) {
  const SampleLog log = TwoSegments();
  Start(log.segments);
  AuditHead forged = log.proven;
  forged.signature[0] ^= 1;
  AuditHead unknown = log.proven;
  unknown.public_key[0] ^= 1;
  // Two passes: "a" blocks the first until the others have come; "z" is reported behind "r1".
  int calls = 0;
  const auto reported = [&](const AuditHead& head) {
    ++calls;
    Hold();
    heads_->Compare({"a", "h"}, log.proven);
    AwaitCount("a", calls);
    const int before = Count("r1");
    heads_->Compare({"r1", "h"}, head);
    heads_->Compare({"z", "h"}, log.proven);
    Release();
    AwaitCount("z", calls);
    return Count("r1") - before;
  };
  EXPECT_EQ(reported(forged), 1);
  EXPECT_EQ(reported(unknown), 1);
  for (uint64_t i = 2; i < ReturnedHeads::kAgainPasses / 2; ++i) {
    ASSERT_EQ(reported(i % 2 == 0 ? forged : unknown), 0) << i;
  }
  EXPECT_EQ(reported(forged), 1) << "it is still so";
}

TEST_F(ReturnedHeadsTest, MoreActuatorsThanTheLimitWaitForNothing) {
  const SampleLog log = TwoSegments();
  AuditHead forged = log.proven;
  forged.signature[0] ^= 1;
  Start(log.segments);
  Hold();
  heads_->Compare({"first", "h"}, log.proven);
  AwaitTold(1);
  testing::internal::CaptureStderr();
  for (size_t i = 0; i <= ReturnedHeads::kWaitingMax; ++i) {
    heads_->Compare({absl::StrCat("r", i), "h"}, forged);
  }
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr(absl::StrCat("robot=r", ReturnedHeads::kWaitingMax)));
  Release();
  AwaitTold(1 + ReturnedHeads::kWaitingMax);
  heads_.reset();
  EXPECT_EQ(told().size(), 1 + ReturnedHeads::kWaitingMax);
}

TEST_F(ReturnedHeadsTest, WhatCouldNotBeReadIsComparedAgain) {
  const SampleLog log = TwoSegments();
  Start(log.segments, absl::ZeroDuration(), /*failing_reads=*/2);
  heads_->Compare({"r1", "h"}, log.proven);
  AwaitTold(1);
  EXPECT_THAT(told(), UnorderedElementsAre(Pair("r1", HeadVerdict::kHeld)));
  EXPECT_EQ(reads_, 3);
}

TEST_F(ReturnedHeadsTest, EndsAlthoughSegmentsCannotBeRead) {
  const SampleLog log = TwoSegments();
  Start(log.segments, absl::InfiniteDuration(), /*failing_reads=*/1'000'000);
  heads_->Compare({"r1", "h"}, log.proven);
  heads_.reset();
  EXPECT_THAT(told(), IsEmpty());
}

TEST_F(ReturnedHeadsTest, EndsWithinAPauseAndComparesWhatWaits) {
  const SampleLog log = TwoSegments();
  Start(log.segments, absl::Hours(1));
  heads_->Compare({"r1", "h"}, log.proven);
  AwaitTold(1);
  heads_->Compare({"r2", "h"}, log.proven);
  heads_.reset();
  EXPECT_EQ(told().size(), 2u);
}

TEST(HeadAlertTest, SaysWhatIsProvenAndHowToCheckIt) {
  const AuditHead head{.segment = 3, .sequence = 812, .hash = std::string(32, '\xab')};
  const HeadSource source{"r1", "base"};
  EXPECT_THAT(AlertOf(source, head, HeadVerdict::kHeld).text, IsEmpty());
  const HeadAlert contradicted = AlertOf(source, head, HeadVerdict::kContradicted);
  EXPECT_EQ(contradicted.severity, engine::Severity::kCritical);
  EXPECT_THAT(contradicted.text, AllOf(HasSubstr("the actuator on base was shown record 812"),
                                       HasSubstr("put back to an older state, or rewritten"),
                                       HasSubstr("ripsctl audit verify DIR --head 812:abab")));
  EXPECT_EQ(AlertOf(source, head, HeadVerdict::kUnknownSegment).severity, engine::Severity::kHigh);
  EXPECT_EQ(AlertOf(source, head, HeadVerdict::kForged).severity, engine::Severity::kHigh);
  EXPECT_THAT(AlertOf(source, head, HeadVerdict::kForged).text,
              testing::Not(HasSubstr("put back")));
  EXPECT_EQ(AlertOf(source, head, HeadVerdict::kOlder).severity, engine::Severity::kMedium);
}

}  // namespace
}  // namespace rips::audit
