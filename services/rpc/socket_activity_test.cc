#include "services/rpc/socket_activity.h"

#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;

struct SocketPair {
  SocketPair() {
    std::array<int, 2> ends = {};
    EXPECT_EQ(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, ends.data()), 0);
    ours = UniqueFd(ends[0]);
    theirs = UniqueFd(ends[1]);
  }
  void Say() const { EXPECT_EQ(write(theirs.get(), "x", 1), 1); }
  UniqueFd ours;
  UniqueFd theirs;
};

TEST(SocketActivityTest, TellsEachOnceOfWhatCame) {
  SocketActivity activity;
  SocketPair one;
  SocketPair other;
  ASSERT_TRUE(activity.Add(one.ours.get()));
  ASSERT_TRUE(activity.Add(other.ours.get()));
  activity.Look();  // both are new
  one.Say();
  EXPECT_THAT(activity.Look(), UnorderedElementsAre(one.ours.get()));
  EXPECT_THAT(activity.Look(), IsEmpty()) << "though it is unread";
  one.Say();
  other.Say();
  EXPECT_THAT(activity.Look(), UnorderedElementsAre(one.ours.get(), other.ours.get()));
}

TEST(SocketActivityTest, TellsOfWhatAnotherHasRead) {
  SocketActivity activity;
  SocketPair pair;
  const UniqueFd reader(dup(pair.ours.get()));
  ASSERT_TRUE(activity.Add(pair.ours.get()));
  activity.Look();
  pair.Say();
  char byte = 0;
  ASSERT_EQ(read(reader.get(), &byte, 1), 1);
  EXPECT_THAT(activity.Look(), UnorderedElementsAre(pair.ours.get()));
}

TEST(SocketActivityTest, TellsThatAPeerHasLeft) {
  SocketActivity activity;
  SocketPair pair;
  ASSERT_TRUE(activity.Add(pair.ours.get()));
  activity.Look();
  pair.theirs.Reset();
  EXPECT_THAT(activity.Look(), UnorderedElementsAre(pair.ours.get()));
}

TEST(SocketActivityTest, ForgetsWhatIsRemovedThoughADuplicateLives) {
  SocketActivity activity;
  SocketPair pair;
  const UniqueFd duplicate(dup(pair.ours.get()));
  ASSERT_TRUE(activity.Add(pair.ours.get()));
  activity.Remove(pair.ours.get());
  pair.ours.Reset();
  pair.Say();
  EXPECT_THAT(activity.Look(), IsEmpty());
}

TEST(SocketActivityTest, TellsOfMoreThanOneCallReturns) {
  SocketActivity activity;
  std::vector<SocketPair> pairs(600);
  for (const SocketPair& pair : pairs) ASSERT_TRUE(activity.Add(pair.ours.get()));
  EXPECT_EQ(activity.Look().size(), pairs.size()) << "all are new";
  for (const SocketPair& pair : pairs) pair.Say();
  EXPECT_EQ(activity.Look().size(), pairs.size());
}

TEST(SocketActivityTest, SaysThatOneIsNotWatched) {
  SocketActivity activity;
  EXPECT_FALSE(activity.Add(-1));
}

}  // namespace
}  // namespace rips::rpc
