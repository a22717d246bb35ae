#include "services/rpc/handshake_queue.h"

#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

Source From(const std::string& network, const std::string& address) {
  return {.peer = "", .address = absl::StrCat(network, ".", address), .network = network};
}

std::vector<int> TakeAll(HandshakeQueue<int>& queue, int64_t now_ns) {
  std::vector<int> out;
  while (const std::optional<int> next = queue.Next(now_ns)) out.push_back(*next);
  return out;
}

TEST(HandshakeQueueTest, TheFirstGoAtOnceTheOthersAtThePace) {
  HandshakeQueue<int> queue({.burst = 2, .per_second = 10});
  for (int i = 0; i < 5; ++i) queue.Add(From("n", "a"), i);
  EXPECT_THAT(TakeAll(queue, 0), ElementsAre(0, 1));
  EXPECT_THAT(TakeAll(queue, kNanosPerSecond / 20), IsEmpty());
  EXPECT_THAT(TakeAll(queue, kNanosPerSecond / 10), ElementsAre(2));
  EXPECT_THAT(TakeAll(queue, 10 * kNanosPerSecond), ElementsAre(3, 4));
  EXPECT_EQ(queue.size(), 0u);
}

TEST(HandshakeQueueTest, AClockThatStandsStillOrGoesBackGivesNothing) {
  HandshakeQueue<int> queue({.burst = 1, .per_second = 10});
  for (int i = 0; i < 3; ++i) queue.Add(From("n", "a"), i);
  EXPECT_THAT(TakeAll(queue, kNanosPerSecond), ElementsAre(0));
  EXPECT_THAT(TakeAll(queue, 0), IsEmpty());
  EXPECT_THAT(TakeAll(queue, 0), IsEmpty());
}

TEST(HandshakeQueueTest, AnAddressWithManyWaitsForThoseWithFew) {
  HandshakeQueue<int> queue({.burst = 100, .per_second = 1});
  for (int i = 0; i < 4; ++i) queue.Add(From("n", "flood"), i);
  queue.Add(From("n", "other"), 10);
  EXPECT_THAT(TakeAll(queue, 0), ElementsAre(0, 10, 1, 2, 3));
}

TEST(HandshakeQueueTest, ANetworkWithManyAddressesWaitsForOneWithFew) {
  HandshakeQueue<int> queue({.burst = 100, .per_second = 1});
  for (int i = 0; i < 4; ++i) queue.Add(From("flood", absl::StrCat(i)), i);
  queue.Add(From("other", "a"), 10);
  queue.Add(From("other", "a"), 11);
  EXPECT_THAT(TakeAll(queue, 0), ElementsAre(0, 10, 1, 11, 2, 3));
}

TEST(HandshakeQueueTest, AnAddressThatComesBackHasItsTurnAgain) {
  HandshakeQueue<int> queue({.burst = 100, .per_second = 1});
  queue.Add(From("n", "a"), 1);
  EXPECT_THAT(TakeAll(queue, 0), ElementsAre(1));
  queue.Add(From("n", "a"), 2);
  queue.Add(From("m", "b"), 3);
  EXPECT_THAT(TakeAll(queue, 0), ElementsAre(2, 3));
}

TEST(HandshakeQueueTest, WhatIsGoneTakesNoTurnAndTheOthersKeepTheirs) {
  HandshakeQueue<int> queue({.burst = 100, .per_second = 1});
  for (int i = 0; i < 6; ++i) queue.Add(From("flood", absl::StrCat(i / 2)), i);
  queue.Add(From("other", "a"), 10);
  queue.Add(From("third", "a"), 11);
  queue.EraseIf([](int i) { return i == 0 || i == 2 || i == 3 || i == 10; });
  EXPECT_EQ(queue.size(), 4u);
  EXPECT_THAT(TakeAll(queue, 0), ElementsAre(1, 11, 4, 5));
  queue.Add(From("other", "a"), 12);
  queue.EraseIf([](int) { return true; });
  EXPECT_EQ(queue.size(), 0u);
  EXPECT_THAT(TakeAll(queue, 0), IsEmpty());
  queue.Add(From("other", "a"), 13);
  EXPECT_THAT(TakeAll(queue, 0), ElementsAre(13));
}

TEST(HandshakeQueueTest, WhatIsGivenBackLetsAnotherGo) {
  HandshakeQueue<int> queue({.burst = 1, .per_second = 1});
  queue.Add(From("n", "a"), 1);
  queue.Add(From("n", "a"), 2);
  EXPECT_EQ(queue.Next(0), 1);
  queue.GiveBack();
  EXPECT_EQ(queue.Next(0), 2);
}

}  // namespace
}  // namespace rips::rpc
