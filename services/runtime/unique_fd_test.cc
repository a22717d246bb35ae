#include "services/runtime/unique_fd.h"

#include <fcntl.h>

#include <utility>

#include "gtest/gtest.h"

namespace rips {
namespace {

bool IsOpen(int fd) { return fcntl(fd, F_GETFD) >= 0; }
int Open() { return open("/dev/null", O_RDONLY | O_CLOEXEC); }

TEST(UniqueFdTest, ClosesOnceWhoeverHasIt) {
  int first = -1;
  int second = -1;
  {
    UniqueFd a(first = Open());
    UniqueFd b(second = Open());
    EXPECT_TRUE(IsOpen(first) && IsOpen(second));
    a = std::move(b);
    EXPECT_FALSE(IsOpen(first)) << "what it had is closed at once";
    EXPECT_EQ(a.get(), second);
    UniqueFd c(std::move(a));
    EXPECT_TRUE(IsOpen(second));
  }
  EXPECT_FALSE(IsOpen(second));
}

TEST(UniqueFdTest, WhatIsReleasedStaysOpen) {
  int fd = -1;
  {
    UniqueFd owner(Open());
    fd = owner.Release();
    EXPECT_LT(owner.get(), 0);
  }
  EXPECT_TRUE(IsOpen(fd));
  UniqueFd again(fd);
  again.Reset();
  EXPECT_FALSE(IsOpen(fd));
}

}  // namespace
}  // namespace rips
