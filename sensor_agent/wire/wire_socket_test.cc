#include "sensor_agent/wire/wire_socket.h"

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/wire/report_codec.h"
#include "sensor_agent/wire/report_sender.h"
#include "sensor_agent/wire/rtps_bytes.h"
#include "sensor_agent/wire/socket_address.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"

namespace rips::wire {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr uid_t kNobody = 65'534;

class WireSocketTest : public testing::Test {
 protected:
  WireSocketTest() {
    std::string name = (std::filesystem::temp_directory_path() / "wire_socket.XXXXXX").string();
    dir_ = mkdtemp(name.data());
    path_ = absl::StrCat(dir_, "/wire.sock");
  }
  ~WireSocketTest() override {
    socket_.reset();
    std::filesystem::remove_all(dir_);
  }

  void Listen(size_t reports = 256) {
    auto socket =
        WireSocket::Listen({.path = path_, .domain = 42, .reports = reports}, [this] { ++woken_; });
    ASSERT_THAT(socket, IsOk());
    socket_ = *std::move(socket);
  }
  bool Eventually(const std::function<bool()>& condition) {
    const absl::Time deadline = absl::Now() + absl::Seconds(20);
    while (!condition()) {
      if (absl::Now() > deadline) return false;
      absl::SleepFor(absl::Milliseconds(2));
    }
    return true;
  }
  // Takes until there were so many reports; those, in order.
  std::vector<TapReport> TakeReports(size_t count) {
    std::vector<TapReport> reports;
    EXPECT_TRUE(Eventually([&] {
      for (Received& each : socket_->Take()) {
        if (each.connected) {
          ++connections_;
        } else {
          reports.push_back(std::move(each.report));
        }
      }
      return reports.size() >= count;
    }));
    return reports;
  }
  static TapReport Report(int64_t boottime_ns, size_t traffic = 1) {
    TapReport report{.domain = 42, .boottime_ns = boottime_ns};
    for (size_t i = 0; i < traffic; ++i) {
      report.traffic.push_back({.writer = TestGuid(1, static_cast<uint32_t>(i)), .packets = 1});
    }
    return report;
  }
  // Sends what a tap never would.
  void SendRaw(const std::string& bytes) {
    raw_ = *ConnectLocal(path_);
    ASSERT_TRUE(Eventually([&] { return socket_->connected(); }));
    const int buffer = 1 << 20;
    setsockopt(raw_.get(), SOL_SOCKET, SO_SNDBUF, &buffer, sizeof buffer);
    ASSERT_EQ(send(raw_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL),
              static_cast<ssize_t>(bytes.size()));
  }

  std::string dir_;
  std::string path_;
  std::atomic<int> woken_ = 0;
  int connections_ = 0;
  UniqueFd raw_;
  std::unique_ptr<WireSocket> socket_;
};

TEST_F(WireSocketTest, ReportsArriveInOrder) {
  Listen();
  ReportSender sender(path_);
  EXPECT_FALSE(socket_->connected());
  ASSERT_TRUE(sender.Ready(1));
  sender.Send(Report(1), 1);
  sender.Send(Report(2, 2 * kReportTrafficMax), 1);

  const std::vector<TapReport> reports = TakeReports(3);
  ASSERT_THAT(reports, SizeIs(3));
  EXPECT_EQ(reports[0], Report(1));
  EXPECT_EQ(reports[1].boottime_ns, 2);
  EXPECT_THAT(reports[2].traffic, SizeIs(kReportTrafficMax));
  EXPECT_EQ(connections_, 1);
  EXPECT_TRUE(socket_->connected());
  EXPECT_GE(woken_, 4);
}

TEST_F(WireSocketTest, IsOfTheUserAndGroupOnly) {
  Listen();
  struct stat status = {};
  ASSERT_EQ(stat(path_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 07777, 0660);
  socket_.reset();
  EXPECT_NE(stat(path_.c_str(), &status), 0);
}

TEST_F(WireSocketTest, SeesTheTapGoAndComeBack) {
  Listen();
  for (int64_t i = 1; i <= 3; ++i) {
    ReportSender sender(path_);
    ASSERT_TRUE(Eventually([&] { return sender.Ready(i * ReportSender::kRetryNs); }));
    sender.Send(Report(i), i);
    EXPECT_EQ(TakeReports(1).at(0).boottime_ns, i);
    EXPECT_EQ(connections_, i);
    EXPECT_TRUE(socket_->connected());
    { const ReportSender gone = std::move(sender); }
    EXPECT_TRUE(Eventually([&] { return !socket_->connected(); }));
  }
}

TEST_F(WireSocketTest, TheSenderWaitsBeforeItTriesAgain) {
  ReportSender sender(path_);
  EXPECT_FALSE(sender.Ready(1));
  EXPECT_EQ(sender.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(sender.status().message()), HasSubstr(path_));
  Listen();
  EXPECT_FALSE(sender.Ready(ReportSender::kRetryNs));
  EXPECT_TRUE(sender.Ready(1 + ReportSender::kRetryNs));
  EXPECT_THAT(sender.status(), IsOk());
}

TEST_F(WireSocketTest, ASlowSensorHoldsTheSenderBackAndGetsEverything) {
  // Somebody who listens and does not read.
  const auto address = LocalAddress(path_);
  ASSERT_THAT(address, IsOk());
  const UniqueFd listener(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  ASSERT_EQ(bind(listener.get(), reinterpret_cast<const sockaddr*>(&*address), sizeof *address), 0);
  ASSERT_EQ(listen(listener.get(), 1), 0);
  ReportSender sender(path_);
  int64_t sent = 0;
  while (sender.Ready(1)) {
    ASSERT_LT(sent, 100'000) << "a socket without end";
    sender.Send(Report(++sent, kReportTrafficMax), 1);
  }
  ASSERT_TRUE(sender.connected());

  const UniqueFd reader(accept(listener.get(), nullptr, nullptr));
  std::string buffer(kReportBytesMax, '\0');
  for (int64_t i = 1; i <= sent; ++i) {
    const ssize_t bytes = recv(reader.get(), buffer.data(), buffer.size(), 0);
    ASSERT_GT(bytes, 0);
    const auto report = DecodeReport({buffer.data(), static_cast<size_t>(bytes)});
    ASSERT_THAT(report, IsOk());
    EXPECT_EQ(report->boottime_ns, i);
    sender.Ready(1);
  }
  EXPECT_TRUE(sender.Ready(1));
}

TEST_F(WireSocketTest, ReportsNotTakenInTimeAreCounted) {
  Listen(/*reports=*/4);
  ReportSender sender(path_);
  ASSERT_TRUE(sender.Ready(1));
  for (int64_t i = 1; i <= 10; ++i) sender.Send(Report(i), 1);
  // With the connection 11 events, of which 4 are kept.
  EXPECT_TRUE(Eventually([&] { return socket_->dropped() == 7; }));

  const std::vector<TapReport> reports = TakeReports(4);
  EXPECT_EQ(reports.front().boottime_ns, 7);
}

TEST_F(WireSocketTest, WhoSendsNonsenseIsCutOff) {
  std::string of_another_domain;
  {
    TapReport report = Report(1);
    report.domain = 43;
    of_another_domain = EncodeReports(report)[0];
  }
  Listen();
  for (const std::string& bytes :
       {std::string("nonsense"), of_another_domain, std::string(kReportBytesMax + 1, '\0'),
        std::string(2 * kReportBytesMax, '\0')}) {
    SendRaw(bytes);
    EXPECT_TRUE(Eventually([&] { return !socket_->connected(); })) << bytes.size();
    char end = 0;
    EXPECT_TRUE(Eventually([&] { return recv(raw_.get(), &end, 1, 0) == 0; }));
  }
  for (const Received& each : socket_->Take()) EXPECT_TRUE(each.connected);
  // Another one is welcome.
  ReportSender sender(path_);
  ASSERT_TRUE(sender.Ready(1));
  sender.Send(Report(1), 1);
  EXPECT_THAT(TakeReports(1), SizeIs(1));
}

TEST_F(WireSocketTest, TakesOneTapAtATime) {
  Listen();
  ReportSender first(path_);
  ASSERT_TRUE(first.Ready(1));
  ASSERT_TRUE(Eventually([&] { return socket_->connected(); }));
  const auto second = ConnectLocal(path_);
  ASSERT_THAT(second, IsOk());
  char end = 0;
  EXPECT_TRUE(Eventually([&] { return recv(second->get(), &end, 1, 0) == 0; }));

  first.Send(Report(1), 1);
  EXPECT_THAT(TakeReports(1), SizeIs(1));
}

TEST_F(WireSocketTest, RefusesATapOfAnotherUser) {
  if (!RootMay({CAP_SETUID})) GTEST_SKIP() << "becoming another user needs CAP_SETUID";
  Listen();
  // Not the path keeps it out.
  ASSERT_EQ(chmod(dir_.c_str(), 0755), 0);
  ASSERT_EQ(chmod(path_.c_str(), 0666), 0);
  const sockaddr_un address = *LocalAddress(path_);
  const pid_t child = fork();
  if (child == 0) {
    // Only what is safe after a fork.
    const int fd = socket(AF_UNIX, SOCK_SEQPACKET, 0);
    if (setuid(kNobody) != 0) _exit(3);
    if (connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) _exit(4);
    char end = 0;
    _exit(recv(fd, &end, 1, 0) == 0 ? 0 : 5);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(WEXITSTATUS(status), 0);
  EXPECT_FALSE(socket_->connected());
  EXPECT_THAT(socket_->Take(), IsEmpty());
}

TEST_F(WireSocketTest, ReplacesWhatADeadSensorLeft) {
  const sockaddr_un address = *LocalAddress(path_);
  {
    const UniqueFd dead(socket(AF_UNIX, SOCK_SEQPACKET, 0));
    ASSERT_EQ(bind(dead.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  }
  ASSERT_TRUE(std::filesystem::exists(path_));

  Listen();

  EXPECT_TRUE(ReportSender(path_).Ready(1));
}

TEST_F(WireSocketTest, TellsWhyItCannotListen) {
  const auto error = [](const std::string& path) {
    return WireSocket::Listen({.path = path}, [] {}).status();
  };
  EXPECT_EQ(error("").code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(error("relative.sock").code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(error(absl::StrCat("/", std::string(107, 'p'))).message()),
              HasSubstr("at most 107 bytes"));
  EXPECT_EQ(error(absl::StrCat(dir_, "/none/wire.sock")).code(), absl::StatusCode::kNotFound);
  std::ofstream(absl::StrCat(dir_, "/file")) << "kept";
  EXPECT_THAT(std::string(error(absl::StrCat(dir_, "/file")).message()), HasSubstr("is no socket"));
  EXPECT_TRUE(std::filesystem::exists(absl::StrCat(dir_, "/file")));
  Listen();
  EXPECT_EQ(error(path_).code(), absl::StatusCode::kAlreadyExists);
  EXPECT_TRUE(ReportSender(path_).Ready(1));  // and the first one listens on
}

}  // namespace
}  // namespace rips::wire
