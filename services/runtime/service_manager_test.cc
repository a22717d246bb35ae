#include "services/runtime/service_manager.h"

#include <stdlib.h>
#include <unistd.h>

#include <cstddef>
#include <cstring>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/clock.h"
#include "services/text/utf8.h"

namespace rips {
namespace {

using ::testing::ElementsAre;
using ::testing::EndsWith;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// A service manager's end: a datagram socket, whose address tests give to NOTIFY_SOCKET.
class ServiceManagerTest : public ::testing::Test {
 protected:
  ServiceManagerTest() {
    char name[] = "/tmp/rips-notify-XXXXXX";
    dir_ = mkdtemp(name);
    path_ = dir_ + "/notify";
  }
  ~ServiceManagerTest() override {
    unlink(path_.c_str());
    rmdir(dir_.c_str());
  }

  // `name` as in NOTIFY_SOCKET.
  void Listen(const std::string& name) {
    sockaddr_un address{.sun_family = AF_UNIX, .sun_path = {}};
    ASSERT_LE(name.size(), sizeof(address.sun_path));
    std::memcpy(address.sun_path, name.data(), name.size());
    if (name[0] == '@') address.sun_path[0] = '\0';
    const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + name.size());
    fd_ = UniqueFd(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(bind(fd_.get(), reinterpret_cast<sockaddr*>(&address), size), 0);
  }
  // All that has come.
  std::vector<std::string> Received() const {
    std::vector<std::string> messages;
    char buffer[4096];
    while (true) {
      const ssize_t size = recv(fd_.get(), buffer, sizeof(buffer), MSG_DONTWAIT);
      if (size < 0) return messages;
      messages.emplace_back(buffer, size);
    }
  }
  ServiceManager::Options Options(absl::Duration watchdog = absl::InfiniteDuration()) {
    return {.socket = path_, .watchdog = watchdog, .monotonic_ns = [this] { return now_ns_; }};
  }
  // Fills the queue of the listening socket; returns how many messages it took.
  int Fill() {
    const UniqueFd sender(socket(AF_UNIX, SOCK_DGRAM, 0));
    sockaddr_un address{.sun_family = AF_UNIX, .sun_path = {}};
    std::memcpy(address.sun_path, path_.data(), path_.size());
    int sent = 0;
    while (sendto(sender.get(), "X=1", 3, MSG_DONTWAIT, reinterpret_cast<sockaddr*>(&address),
                  sizeof(address)) == 3) {
      ++sent;
    }
    return sent;
  }

  std::string dir_;
  std::string path_;
  UniqueFd fd_;
  int64_t now_ns_ = 7 * kNanosPerSecond;
};

TEST_F(ServiceManagerTest, ReportsWhatTheDaemonDoes) {
  Listen(path_);
  ServiceManager manager(Options());
  manager.Reloading();  // it is not ready: no effect
  manager.SetStatus("reading rules");
  manager.Ready();
  manager.SetStatus("reading rules");  // as before
  manager.SetStatus("serving");
  manager.Reloading();
  manager.Ready();
  manager.Ping();  // not watched
  manager.Stopping();
  manager.Ready();  // of a reload that has ended meanwhile
  manager.SetStatus("ending");
  EXPECT_THAT(Received(), ElementsAre("STATUS=reading rules", "READY=1", "STATUS=serving",
                                      "RELOADING=1\nMONOTONIC_USEC=7000000", "READY=1",
                                      "STOPPING=1", "STATUS=ending"));
}

TEST_F(ServiceManagerTest, SpeaksWithAnAbstractSocket) {
  const std::string name = absl::StrCat("@rips-notify-test-", getpid());
  Listen(name);
  ServiceManager manager({.socket = name});
  manager.Ready();
  EXPECT_THAT(Received(), ElementsAre("READY=1"));
}

TEST_F(ServiceManagerTest, WithoutAServiceManagerNothingHappens) {
  for (const std::string& name :
       {std::string(), std::string("@"), std::string("/"), std::string("relative"),
        std::string("vsock:2:1"), "/" + std::string(107, 'x'), "@" + std::string(108, 'x'),
        dir_ + "/nothing-listens-here"}) {
    SCOPED_TRACE(name);
    ServiceManager manager({.socket = name, .watchdog = absl::Seconds(1)});
    manager.Ready();
    manager.SetStatus("serving");
    manager.Ping();
    manager.Reloading();
    manager.Stopping();
  }
}

TEST_F(ServiceManagerTest, TheLongestAddressesAreUsed) {
  const std::string name = absl::StrCat("@rips-", getpid(), "-");
  const std::string longest = name + std::string(108 - name.size(), 'x');
  Listen(longest);
  ServiceManager manager({.socket = longest});
  manager.Ready();
  EXPECT_THAT(Received(), ElementsAre("READY=1"));
}

TEST_F(ServiceManagerTest, AStatusIsOneShortLineThatATerminalCanShow) {
  Listen(path_);
  ServiceManager manager(Options());
  manager.SetStatus("peer says\nREADY=1\x1b[2J \xff");
  std::string text;
  for (int i = 0; i < 400; ++i) text += "ä";
  manager.SetStatus(text);
  const std::vector<std::string> seen = Received();
  ASSERT_THAT(seen, SizeIs(2));
  EXPECT_EQ(seen[0], "STATUS=peer says\\x0aREADY=1\\x1b[2J \\xff");
  EXPECT_LE(seen[1].size(), ServiceManager::kStatusBytesMax + strlen("STATUS="));
  EXPECT_GE(seen[1].size(), ServiceManager::kStatusBytesMax);
  EXPECT_THAT(seen[1], EndsWith("ä..."));
  EXPECT_FALSE(FindInvalidUtf8(seen[1]).has_value());
}

TEST_F(ServiceManagerTest, AFullSocketDelaysTheNewestStateAndBlocksNothing) {
  Listen(path_);
  ServiceManager manager(Options(absl::Seconds(8)));
  const int waiting = Fill();
  ASSERT_GT(waiting, 0);
  manager.Ready();
  manager.SetStatus("serving 1");
  manager.Reloading();
  manager.Ready();
  manager.SetStatus("serving 2");
  manager.Ping();
  EXPECT_THAT(Received(), SizeIs(waiting));
  manager.Ping();  // at once: the last one was not sent
  EXPECT_THAT(Received(), ElementsAre("READY=1", "STATUS=serving 2", "WATCHDOG=1"));
}

TEST_F(ServiceManagerTest, AServiceManagerThatStartsAnewHearsTheNextMessage) {
  Listen(path_);
  ServiceManager manager(Options());
  manager.Ready();
  unlink(path_.c_str());
  manager.SetStatus("serving");
  Listen(path_);
  manager.SetStatus("serving");
  EXPECT_THAT(Received(), ElementsAre("STATUS=serving"));
}

TEST_F(ServiceManagerTest, PingsAQuarterOfThePeriodApart) {
  Listen(path_);
  ServiceManager manager(Options(absl::Seconds(8)));
  int sent = 0;
  for (int ms = 0; ms < 8'000; ms += 50) {
    manager.Ping();
    now_ns_ += 50 * kNanosPerMilli;
    sent += static_cast<int>(Received().size());
  }
  EXPECT_EQ(sent, ServiceManager::kPings);
}

TEST_F(ServiceManagerTest, ReadsAndRemovesItsVariables) {
  struct Case {
    const char* period;
    std::string process;
    absl::Duration expected;
  };
  const std::string own = absl::StrCat(getpid());
  const absl::Duration none = absl::InfiniteDuration();
  for (const Case& each :
       {Case{"60000000", own, absl::Seconds(60)}, Case{"60000000", "", absl::Seconds(60)},
        Case{"60000000", "1", none}, Case{"60000000", "me", none}, Case{"0", own, none},
        Case{"-5", own, none}, Case{"1m", own, none}, Case{"", own, none},
        Case{"99999999999999999999", own, none}}) {
    SCOPED_TRACE(absl::StrCat(each.period, " ", each.process));
    setenv("NOTIFY_SOCKET", path_.c_str(), 1);
    setenv("WATCHDOG_USEC", each.period, 1);
    setenv("WATCHDOG_PID", each.process.c_str(), 1);
    const ServiceManager::Options options = ServiceManager::FromEnvironment();
    EXPECT_EQ(options.socket, path_);
    EXPECT_EQ(options.watchdog, each.expected);
    for (const char* name : {"NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"}) {
      EXPECT_EQ(getenv(name), nullptr) << name;
    }
  }
  EXPECT_THAT(ServiceManager::FromEnvironment().socket, IsEmpty());
}

}  // namespace
}  // namespace rips
