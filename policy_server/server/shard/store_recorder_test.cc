#include "policy_server/server/shard/store_recorder.h"

#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"
#include "services/runtime/bounded_queue.h"

namespace rips::pipeline {
namespace {

constexpr absl::Duration kPatience = absl::Seconds(30);

class StoreRecorderTest : public ::testing::Test {
 protected:
  // Before what uses them on its thread.
  BoundedQueue<int> asked_{{.capacity = 10'000}};
  BoundedQueue<int> go_on_{{.capacity = 1}};
  store::FakeStore store_;
  store::Committer committer_{&store_};
  BoundedQueue<absl::StatusOr<uint64_t>> terms_{{.capacity = 10'000}};
  BoundedQueue<FoundDecision> found_{{.capacity = 10}};
  StoreRecorder recorder_{&store_, &committer_};
};

TEST_F(StoreRecorderTest, AHangingDiskDoesNotBlockTheCaller) {
  ASSERT_THAT(store_.Acquire("r1"), IsOk());
  store_.OnQuestion([&] {
    asked_.Push(1);
    go_on_.Pop(kPatience);
  });
  recorder_.NextTerm("r1", 1, 7, [&](const auto& term) { terms_.Push(term); });
  recorder_.FindDecision("r1", {3, 1}, [&](const auto& found) { found_.Push(found); });
  // Both calls have returned, and the store still works on the first.
  ASSERT_TRUE(asked_.Pop(kPatience).has_value());
  EXPECT_FALSE(terms_.Pop(absl::ZeroDuration()).has_value());
  store_.OnQuestion(nullptr);
  go_on_.Push(1);
  const auto term = terms_.Pop(kPatience);
  ASSERT_TRUE(term.has_value());
  ASSERT_THAT(*term, IsOk());
  EXPECT_EQ(**term, 8u);
  const auto found = found_.Pop(kPatience);
  ASSERT_TRUE(found.has_value());
  ASSERT_THAT(*found, IsOk());
  EXPECT_FALSE((*found)->has_value());
}

TEST_F(StoreRecorderTest, TooManyQuestionsAreRefusedAtOnce) {
  store_.OnQuestion([&] { go_on_.Pop(kPatience); });
  for (int i = 0; i < 5'000; ++i) {
    recorder_.NextTerm("r1", 1, 0, [&](const auto& term) { terms_.Push(term); });
  }
  const auto refused = terms_.Pop(kPatience);
  ASSERT_TRUE(refused.has_value());
  EXPECT_THAT(refused->status(), StatusIs(absl::StatusCode::kUnavailable));
  store_.OnQuestion(nullptr);
  go_on_.Push(1);
}

}  // namespace
}  // namespace rips::pipeline
