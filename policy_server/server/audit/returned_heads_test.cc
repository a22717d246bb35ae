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

// Counts reads of whole segments.
class CountedSegments final : public Segments {
 public:
  CountedSegments(const SegmentsInMemory& segments, std::atomic<int>* reads)
      : segments_(segments), reads_(reads) {}
  absl::StatusOr<std::vector<std::string>> Names() const override { return segments_.Names(); }
  absl::StatusOr<std::string> Read(absl::string_view name, uint64_t bytes_max) const override {
    if (bytes_max == kAll) ++*reads_;
    return segments_.Read(name, bytes_max);
  }

 private:
  const SegmentsInMemory segments_;
  std::atomic<int>* reads_;
};

class ReturnedHeadsTest : public testing::Test {
 protected:
  void Start(const SegmentsInMemory& segments, absl::Duration pause = absl::Milliseconds(1)) {
    heads_ = std::make_unique<ReturnedHeads>(
        std::make_unique<CountedSegments>(segments, &reads_),
        [this](const HeadBringer& bringer, const AuditHead&, HeadVerdict verdict) {
          MutexLock lock(&mu_);
          told_[bringer.robot] = verdict;
          ++count_;
          changed_.NotifyAll();
        },
        pause);
  }
  void AwaitTold(size_t robots) {
    MutexLock lock(&mu_);
    while (told_.size() < robots) changed_.Wait(lock);
  }
  std::map<std::string, HeadVerdict> told() {
    MutexLock lock(&mu_);
    return told_;
  }

  std::atomic<int> reads_ = 0;
  Mutex mu_;
  CondVar changed_;
  std::map<std::string, HeadVerdict> told_ ABSL_GUARDED_BY(mu_);
  int count_ ABSL_GUARDED_BY(mu_) = 0;
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
  Start(log.segments, absl::Milliseconds(200));
  heads_->Compare({"first", "h"}, log.proven);
  AwaitTold(1);
  for (int i = 0; i < 1000; ++i) heads_->Compare({absl::StrCat("r", i % 10), "h"}, log.proven);
  AwaitTold(11);
  EXPECT_LE(reads_, 3);
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
  Start(before, absl::Milliseconds(200));
  heads_->Compare({"first", "h"}, held);
  AwaitTold(1);
  heads_->Compare({"r1", "h"}, log.proven);
  heads_->Compare({"r1", "h"}, held);
  AwaitTold(2);
  EXPECT_EQ(told()["r1"], HeadVerdict::kContradicted);
}

TEST_F(ReturnedHeadsTest, TheSameTroubleOfOneActuatorIsToldOnce) {
  const SampleLog log = TwoSegments();
  Start(log.segments);
  AuditHead forged = log.proven;
  for (int i = 0; i < 5; ++i) {
    forged.signature[0] = static_cast<char>(forged.signature[0] + 1);
    heads_->Compare({"r1", "h"}, forged);
    // Behind it in a pass of its own or in the same one.
    heads_->Compare({absl::StrCat("z", i), "h"}, log.proven);
    AwaitTold(static_cast<size_t>(i) + 2);
  }
  MutexLock lock(&mu_);
  EXPECT_EQ(count_, 1 + 5);
}

TEST_F(ReturnedHeadsTest, EndsWithinAPause) {
  const SampleLog log = TwoSegments();
  Start(log.segments, absl::Hours(1));
  heads_->Compare({"r1", "h"}, log.proven);
  AwaitTold(1);
  heads_.reset();
}

TEST(HeadAlertTest, SaysWhatIsProvenAndHowToCheckIt) {
  const AuditHead head{.segment = 3, .sequence = 812, .hash = std::string(32, '\xab')};
  const HeadBringer bringer{"r1", "base"};
  EXPECT_THAT(AlertOf(bringer, head, HeadVerdict::kHeld).text, IsEmpty());
  const HeadAlert contradicted = AlertOf(bringer, head, HeadVerdict::kContradicted);
  EXPECT_EQ(contradicted.severity, engine::Severity::kCritical);
  EXPECT_THAT(contradicted.text, AllOf(HasSubstr("the actuator on base was shown record 812"),
                                       HasSubstr("put back to an older state, or rewritten"),
                                       HasSubstr("ripsctl audit verify --head 812:abab")));
  EXPECT_EQ(AlertOf(bringer, head, HeadVerdict::kUnknownSegment).severity, engine::Severity::kHigh);
  EXPECT_EQ(AlertOf(bringer, head, HeadVerdict::kForged).severity, engine::Severity::kHigh);
  EXPECT_THAT(AlertOf(bringer, head, HeadVerdict::kForged).text,
              testing::Not(HasSubstr("put back")));
  EXPECT_EQ(AlertOf(bringer, head, HeadVerdict::kOlder).severity, engine::Severity::kMedium);
}

}  // namespace
}  // namespace rips::audit
