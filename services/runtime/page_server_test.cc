#include "services/runtime/page_server.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <atomic>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::StartsWith;

constexpr absl::Duration kTestLimit = absl::Seconds(30);

UniqueFd Connect(uint16_t port) {
  UniqueFd fd(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  EXPECT_EQ(connect(fd.get(), reinterpret_cast<sockaddr*>(&to), sizeof(to)), 0);
  return fd;
}

void Send(const UniqueFd& fd, const std::string& text) {
  EXPECT_EQ(send(fd.get(), text.data(), text.size(), MSG_NOSIGNAL),
            static_cast<ssize_t>(text.size()));
}

// What comes until the server closes; "(open)" at the end if it does not in time.
std::string Rest(const UniqueFd& fd, absl::Duration limit = kTestLimit) {
  const int64_t deadline_ns = BoottimeAfter(limit);
  std::string all;
  char piece[4096];
  while (true) {
    const int64_t left_ms = (deadline_ns - BoottimeNow()) / kNanosPerMilli;
    pollfd poll_fd = {fd.get(), POLLIN, 0};
    if (left_ms <= 0 || poll(&poll_fd, 1, static_cast<int>(left_ms)) == 0) return all + "(open)";
    const ssize_t got = recv(fd.get(), piece, sizeof(piece), 0);
    if (got <= 0) return all;
    all.append(piece, static_cast<size_t>(got));
  }
}

class PageServerTest : public testing::Test {
 protected:
  void Start(PageLimits limits = {}) {
    auto server = PageServer::Start(
        {.host = "127.0.0.1", .port = 0, .loopback = true},
        {.quick =
             [this](absl::string_view path, PageAnswer& answer) {
               answer.body = absl::StrCat("page ", path, body_);
               return path != "/slow";
             },
         .slow =
             [this] {
               const int round = ++rounds_;
               while (hold_) std::this_thread::yield();
               return PageAnswer{.body = absl::StrCat("round ", round)};
             },
         .dropped = [this](PageServer::Dropped why) { ++dropped_[static_cast<int>(why)]; }},
        limits);
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  std::string Get(const std::string& path) {
    const UniqueFd fd = Connect(server_->port());
    Send(fd, absl::StrCat("GET ", path, " HTTP/1.1\r\nHost: x\r\n\r\n"));
    return Rest(fd);
  }
  int dropped(PageServer::Dropped why) { return dropped_[static_cast<int>(why)]; }

  std::string body_;
  std::atomic<bool> hold_ = false;
  std::atomic<int> rounds_ = 0;
  std::atomic<int> dropped_[3] = {};
  std::unique_ptr<PageServer> server_;
};

TEST_F(PageServerTest, AnswersOnceAndCloses) {
  Start();
  const std::string answer = Get("/metrics?x=1");
  EXPECT_THAT(answer, StartsWith("HTTP/1.1 200 OK\r\n"));
  EXPECT_THAT(answer, HasSubstr("\r\nContent-Length: 13\r\n"));
  EXPECT_THAT(answer, HasSubstr("\r\n\r\npage /metrics"));
}

TEST_F(PageServerTest, RefusesWhatIsNoRequest) {
  Start();
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"GET / HTTP/2\r\n\r\n", "400 Bad Request"},
      {"GET  / HTTP/1.1\r\n\r\n", "400 Bad Request"},
      {"GET metrics HTTP/1.1\r\n\r\n", "400 Bad Request"},
      {"\r\n\r\n", "400 Bad Request"},
      {std::string("\x16\x03\x01\x00\r\n\r\n", 8), "400 Bad Request"},
      {"POST / HTTP/1.1\r\n\r\n", "405 Method Not Allowed"}};
  for (const auto& [request, want] : cases) {
    const UniqueFd fd = Connect(server_->port());
    Send(fd, request);
    EXPECT_THAT(Rest(fd), StartsWith("HTTP/1.1 " + want)) << request;
  }
}

TEST_F(PageServerTest, ARequestMayComeInPieces) {
  Start();
  const UniqueFd fd = Connect(server_->port());
  for (const char each : std::string("GET /a HTTP/1.1\r\nHost: x\r\n\r\n")) Send(fd, {each});
  EXPECT_THAT(Rest(fd), HasSubstr("page /a"));
}

TEST_F(PageServerTest, ARequestWithoutEndIsRefused) {
  Start({.request_bytes_max = 1'000});
  const UniqueFd fd = Connect(server_->port());
  Send(fd, "GET / HTTP/1.1\r\nX: " + std::string(2'000, 'x'));
  EXPECT_THAT(Rest(fd), StartsWith("HTTP/1.1 431 "));
  EXPECT_EQ(dropped(PageServer::Dropped::kLong), 1);
}

TEST_F(PageServerTest, SlowClientsAreClosedAndBlockNoOther) {
  Start({.patience = absl::Milliseconds(300)});
  std::vector<UniqueFd> slow;
  for (int i = 0; i < 60; ++i) {
    slow.push_back(Connect(server_->port()));
    Send(slow.back(), "GET /metrics HT");
  }

  const int64_t began_ns = BoottimeNow();
  EXPECT_THAT(Get("/metrics"), HasSubstr("page /metrics"));
  EXPECT_THAT(Get("/slow"), HasSubstr("round 1"));
  EXPECT_LT(BoottimeNow() - began_ns, 2 * kNanosPerSecond);

  for (const UniqueFd& each : slow) EXPECT_THAT(Rest(each), IsEmpty());
  EXPECT_EQ(dropped(PageServer::Dropped::kSlow), 60);
}

TEST_F(PageServerTest, OneTooManyTakesThePlaceOfTheOldestThatHasNotAsked) {
  Start({.connections_max = 4, .patience = kTestLimit});
  std::vector<UniqueFd> idle;
  for (int i = 0; i < 4; ++i) idle.push_back(Connect(server_->port()));

  for (int i = 0; i < 3; ++i) EXPECT_THAT(Get("/a"), HasSubstr("page /a"));

  EXPECT_THAT(Rest(idle[0]), IsEmpty()) << "the oldest made room";
  EXPECT_EQ(dropped(PageServer::Dropped::kCrowded), 1) << "those who were answered made room, too";
  Send(idle[3], "GET /b HTTP/1.1\r\n\r\n");
  EXPECT_THAT(Rest(idle[3]), HasSubstr("page /b"));
}

TEST_F(PageServerTest, AClientThatDoesNotReadIsClosed) {
  body_ = std::string(16 << 20, 'x');  // more than the kernel holds
  Start({.patience = absl::Milliseconds(300)});
  const UniqueFd fd = Connect(server_->port());
  Send(fd, "GET /a HTTP/1.1\r\n\r\n");
  const int64_t deadline_ns = BoottimeAfter(kTestLimit);
  while (dropped(PageServer::Dropped::kSlow) == 0 && BoottimeNow() < deadline_ns) {
    std::this_thread::yield();
  }
  EXPECT_EQ(dropped(PageServer::Dropped::kSlow), 1);
}

TEST_F(PageServerTest, UnreadAnswersAreBoundedInBytes) {
  body_ = std::string(16 << 20, 'x');
  Start({.patience = kTestLimit, .answers_bytes_max = size_t{40} << 20});
  std::vector<UniqueFd> unread;
  for (int i = 0; i < 6; ++i) {
    unread.push_back(Connect(server_->port()));
    Send(unread.back(), "GET /a HTTP/1.1\r\n\r\n");
  }
  const int64_t deadline_ns = BoottimeAfter(kTestLimit);
  while (dropped(PageServer::Dropped::kCrowded) < 4 && BoottimeNow() < deadline_ns) {
    std::this_thread::yield();
  }
  EXPECT_EQ(dropped(PageServer::Dropped::kCrowded), 4);
}

TEST_F(PageServerTest, ASlowPageIsMadeOnceForAllWhoWaitAndStopsNoOther) {
  Start();
  hold_ = true;
  const UniqueFd first = Connect(server_->port());
  Send(first, "GET /slow HTTP/1.1\r\n\r\n");
  while (rounds_ == 0) std::this_thread::yield();
  std::vector<UniqueFd> others;
  for (int i = 0; i < 10; ++i) {
    others.push_back(Connect(server_->port()));
    Send(others.back(), "GET /slow HTTP/1.1\r\n\r\n");
  }
  EXPECT_THAT(Get("/a"), HasSubstr("page /a")) << "while the slow page is made";

  hold_ = false;
  EXPECT_THAT(Rest(first), HasSubstr("round "));
  for (const UniqueFd& each : others) EXPECT_THAT(Rest(each), HasSubstr("round 2"));
  EXPECT_EQ(rounds_, 2);
}

TEST(PageAddressTest, KnowsAddressesAndWhichAreOfThisMachineOnly) {
  for (const char* text : {"127.0.0.1:1", "127.3.2.1:0", "[::1]:80", "[::ffff:127.0.0.1]:80"}) {
    const auto address = ParsePageAddress(text);
    ASSERT_THAT(address, IsOk()) << text;
    EXPECT_TRUE(address->loopback) << text;
  }
  for (const char* text : {"0.0.0.0:1", "10.0.0.1:65535", "[::]:80", "[fe80::1]:80"}) {
    const auto address = ParsePageAddress(text);
    ASSERT_THAT(address, IsOk()) << text;
    EXPECT_FALSE(address->loopback) << text;
  }
  for (const char* text :
       {"", ":", ":1", "1", "127.0.0.1:", "127.0.0.1:+1", "127.0.0.1: 1", "::1:1", "[]:1", "[:1",
        "[::1]", "[127.0.0.1]:1", "127.0.0.1:65536", "host:1"}) {
    EXPECT_THAT(ParsePageAddress(text), StatusIs(absl::StatusCode::kInvalidArgument)) << text;
  }
}

}  // namespace
}  // namespace rips
