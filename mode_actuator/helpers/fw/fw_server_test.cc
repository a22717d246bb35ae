#include "mode_actuator/helpers/fw/fw_server.h"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <thread>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/firewall/fw_client.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;
using Kind = FirewallStep::Kind;

constexpr absl::Duration kLong = absl::Seconds(60);
const FwRequest kStatus = {.verb = FwVerb::kStatus};

class FwServerTest : public ::testing::Test {
 protected:
  FwServerTest() {
    char name[] = "/tmp/rips-fw-XXXXXX";
    directory_ = mkdtemp(name);
    path_ = directory_ + "/fw.sock";
  }
  ~FwServerTest() override {
    StopServer();
    unlink(path_.c_str());
    rmdir(directory_.c_str());
  }

  void StartServer(uid_t user = geteuid()) {
    auto listener = ListenAt(path_, user);
    ASSERT_THAT(listener, IsOk());
    server_ =
        std::make_unique<FwServer>(*std::move(listener), user, [this](const FwRequest& request) {
          ++served_;
          return FwResponse{absl::OkStatus(), request.step.file, "note"};
        });
    thread_ = std::thread([this] { server_->Run(); });
  }
  void StopServer() {
    if (!thread_.joinable()) return;
    server_->Stop();
    thread_.join();
  }
  UniqueFd Connect() const {
    UniqueFd fd(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
    sockaddr_un address = {};
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path, path_.data(), path_.size());
    const auto* raw = reinterpret_cast<const sockaddr*>(&address);
    if (connect(fd.get(), raw, sizeof(address)) != 0) fd.Reset();
    return fd;
  }
  // Waits for one packet; empty when the other side has closed.
  static std::string Receive(int fd) {
    char answer[kFwPacketBytesMax];
    ssize_t got = recv(fd, answer, sizeof(answer), 0);
    // Closed with our packet unread: told first, and what it said before that comes then.
    if (got < 0 && errno == ECONNRESET) got = recv(fd, answer, sizeof(answer), 0);
    return got > 0 ? std::string(answer, static_cast<size_t>(got)) : "";
  }
  static std::string Ask(int fd, absl::string_view packet) {
    send(fd, packet.data(), packet.size(), MSG_NOSIGNAL);
    return Receive(fd);
  }
  // What it says itself, or why that is no answer.
  static absl::Status AskStatus(int fd) {
    const auto answer = DecodeFwResponse(Ask(fd, EncodeFwRequest(kStatus)));
    return answer.ok() ? answer->status : answer.status();
  }
  absl::StatusOr<FwResponse> Call(absl::Duration timeout = kLong) const {
    return FwClient(path_).Call(kStatus, timeout, CancelFlag());
  }

  std::string directory_, path_;
  std::atomic<int> served_ = 0;
  std::unique_ptr<FwServer> server_;
  std::thread thread_;
};

TEST_F(FwServerTest, AnImpostorIsAskedNothing) {
  if (!RootMay({CAP_CHOWN})) GTEST_SKIP() << "giving a file away needs CAP_CHOWN";
  StartServer();
  ASSERT_EQ(chown(path_.c_str(), 65533, 65533), 0);
  EXPECT_THAT(Call(),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("may pose as rips-fw")));
  EXPECT_EQ(served_, 0);
}

TEST_F(FwServerTest, AnswersStepsOfTheActuator) {
  StartServer();
  FwClient client(path_);
  const Step step = {.what = FirewallStep{.kind = Kind::kRules, .file = "/a.nft"}};
  const StepReading entered = client.Enter(step, kLong, 0, CancelFlag());
  EXPECT_THAT(entered.status, IsOk());
  EXPECT_EQ(entered.observed, "/a.nft");
  EXPECT_EQ(entered.note, "note");
  EXPECT_THAT(client.Check(step, CancelFlag()).status, IsOk());
  const StepReading tried = client.Drill(step, CancelFlag());
  EXPECT_THAT(tried.status, IsOk());
  EXPECT_EQ(tried.note, "note");
  EXPECT_EQ(served_, 3);
}

TEST_F(FwServerTest, AConnectionMayAskAgain) {
  StartServer();
  const UniqueFd fd = Connect();
  for (int i = 0; i < 3; ++i) {
    EXPECT_THAT(AskStatus(fd.get()), IsOk());
  }
}

TEST_F(FwServerTest, HostileBytesAreRefusedAndOthersServed) {
  StartServer();
  const std::string kPackets[] = {
      std::string(kFwPacketBytesMax + 1, 'x'),
      std::string(100'000, '\n'),
      "rips-fw 1\nverb status\n",
      EncodeFwRequest(kStatus) + EncodeFwRequest(kStatus),
      EncodeFwRequest(kStatus) + "\x30\x01",  // with a field that does not exist
      "GET / HTTP/1.1\r\n\r\n",
      std::string("\0", 1),
      std::string("\xff\xfe\x00\n", 4),
  };
  for (const std::string& packet : kPackets) {
    const UniqueFd fd = Connect();
    const std::string answer = Ask(fd.get(), packet);
    const auto decoded = DecodeFwResponse(answer);
    ASSERT_THAT(decoded, IsOk()) << answer;
    EXPECT_THAT(decoded->status, StatusIs(absl::StatusCode::kInvalidArgument));
    EXPECT_EQ(Receive(fd.get()), "") << "not closed";
  }
  EXPECT_EQ(served_, 0);
  EXPECT_THAT(Call(), IsOk());
}

TEST_F(FwServerTest, SilentAndVanishingClientsHinderNobody) {
  StartServer();
  const UniqueFd silent = Connect();
  const std::string packet = EncodeFwRequest(kStatus);
  for (int i = 0; i < 50; ++i) {
    const UniqueFd gone = Connect();
    if (i % 2 == 0) send(gone.get(), packet.data(), packet.size(), MSG_NOSIGNAL);
  }
  EXPECT_THAT(Call(), IsOk());
  EXPECT_GE(silent.get(), 0);
}

TEST_F(FwServerTest, AClientThatDoesNotReadItsAnswersHindersNobody) {
  StartServer();
  const UniqueFd deaf = Connect();
  fcntl(deaf.get(), F_SETFL, O_NONBLOCK);
  const std::string packet = EncodeFwRequest(kStatus);
  for (int i = 0; i < 10'000; ++i) send(deaf.get(), packet.data(), packet.size(), MSG_NOSIGNAL);
  EXPECT_THAT(Call(), IsOk());
}

TEST_F(FwServerTest, HasALimitOfConnections) {
  StartServer();
  std::vector<UniqueFd> open;
  for (size_t i = 0; i < kFwConnectionsMax; ++i) {
    open.push_back(Connect());
    EXPECT_THAT(AskStatus(open.back().get()), IsOk());
  }
  const auto refused = Call();
  ASSERT_THAT(refused, IsOk());
  EXPECT_THAT(refused->status,
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("exceed limit 16")));
  open.clear();
  // The server sees them go one after the other.
  absl::Status status;
  do {
    const auto response = Call();
    status = response.ok() ? response->status : response.status();
  } while (absl::IsResourceExhausted(status));
  EXPECT_THAT(status, IsOk());
}

TEST_F(FwServerTest, OtherUsersAreRefusedByWhatTheKernelSaysOfThem) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "being another user needs all of root's rights";
  StartServer();
  // Even if the socket's mode lets them in.
  chmod(directory_.c_str(), 0755);
  chmod(path_.c_str(), 0666);
  const pid_t child = fork();
  if (child == 0) {
    if (setresuid(65534, 65534, 65534) != 0) _exit(1);
    const UniqueFd fd = Connect();
    if (fd.get() < 0) _exit(2);
    if (!absl::IsPermissionDenied(AskStatus(fd.get()))) _exit(3);
    _exit(0);
  }
  int code = -1;
  waitpid(child, &code, 0);
  EXPECT_EQ(code, 0);
  EXPECT_EQ(served_, 0);
  EXPECT_THAT(Call(), IsOk());
}

TEST_F(FwServerTest, TheConfiguredUserIsServed) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "being another user needs all of root's rights";
  StartServer(65534);
  chmod(directory_.c_str(), 0755);
  struct stat info;
  ASSERT_EQ(stat(path_.c_str(), &info), 0);
  EXPECT_EQ(info.st_uid, 65534u);
  EXPECT_EQ(info.st_mode & 0777, 0600u);
  const pid_t child = fork();
  if (child == 0) {
    if (setresuid(65534, 65534, 65534) != 0) _exit(1);
    const UniqueFd fd = Connect();
    _exit(AskStatus(fd.get()).ok() ? 0 : 2);
  }
  int code = -1;
  waitpid(child, &code, 0);
  EXPECT_EQ(code, 0);
}

TEST_F(FwServerTest, ListensOnlyWhereNobodyElseDoes) {
  StartServer();
  EXPECT_THAT(ListenAt(path_, geteuid()),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr("another process listens at")));
  StopServer();
  server_.reset();
  EXPECT_THAT(ListenAt(path_, geteuid()), IsOk()) << "what a dead one has left";
  unlink(path_.c_str());
  ASSERT_THAT(WriteFileAtomically(path_, "x"), IsOk());
  EXPECT_THAT(ListenAt(path_, geteuid()), StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(ListenAt(std::string(200, 'x'), geteuid()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("limit 107")));
  EXPECT_THAT(ListenAt(directory_ + "/no/fw", geteuid()), StatusIs(absl::StatusCode::kUnavailable));
}

TEST_F(FwServerTest, InheritsNothingThatIsNotMeantForIt) {
  unsetenv("LISTEN_PID");
  setenv("LISTEN_FDS", "1", 1);
  const auto none = InheritedListener();
  ASSERT_THAT(none, IsOk());
  EXPECT_LT(none->get(), 0);
  setenv("LISTEN_PID", "1", 1);
  EXPECT_LT(InheritedListener()->get(), 0) << "meant for another process";
  setenv("LISTEN_PID", absl::StrCat(getpid()).c_str(), 1);
  setenv("LISTEN_FDS", "2", 1);
  EXPECT_THAT(InheritedListener(), StatusIs(absl::StatusCode::kInvalidArgument));
  unsetenv("LISTEN_PID");
  unsetenv("LISTEN_FDS");
}

TEST_F(FwServerTest, ACallSaysWhyItFailed) {
  FwClient client(path_);
  EXPECT_THAT(Call(),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot reach rips-fw at")));
  const Step step = {.what = FirewallStep{.kind = Kind::kRelease}};
  EXPECT_THAT(client.Enter(step, kLong, 2, CancelFlag()).status,
              StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_THAT(client.Check(step, CancelFlag()).status, StatusIs(absl::StatusCode::kUnavailable));

  // One that listens and does not answer.
  const auto listener = ListenAt(path_, geteuid());
  ASSERT_THAT(listener, IsOk());
  EXPECT_THAT(Call(absl::Milliseconds(50)), StatusIs(absl::StatusCode::kDeadlineExceeded,
                                                     HasSubstr("did not answer within 50ms")));
  CancelFlag cancelled;
  cancelled.Cancel();
  EXPECT_THAT(client.Call(kStatus, kLong, cancelled), StatusIs(absl::StatusCode::kCancelled));
}

// One that does `conduct` with its next client.
void ActOnce(int listener, const std::function<void(int)>& conduct) {
  int fd = -1;
  while (fd < 0) fd = accept4(listener, nullptr, nullptr, SOCK_CLOEXEC);
  char packet[kFwPacketBytesMax];
  [[maybe_unused]] const ssize_t got = recv(fd, packet, sizeof(packet), 0);
  conduct(fd);
  close(fd);
}

TEST_F(FwServerTest, ARipsFwThatDiesOrLiesIsTold) {
  auto listener = ListenAt(path_, geteuid());
  ASSERT_THAT(listener, IsOk());
  fcntl(listener->get(), F_SETFL, 0);
  absl::StatusOr<FwResponse> response;
  std::thread dies([&] { ActOnce(listener->get(), [](int) {}); });
  response = Call();
  dies.join();
  EXPECT_THAT(response,
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("went away before it answered")));
  std::thread lies(
      [&] { ActOnce(listener->get(), [](int fd) { send(fd, "all is well", 11, MSG_NOSIGNAL); }); });
  response = Call();
  lies.join();
  EXPECT_THAT(response, StatusIs(absl::StatusCode::kDataLoss));
}

TEST_F(FwServerTest, ARetryFindsTheRipsFwThatCameLater) {
  const Step step = {.what = FirewallStep{.kind = Kind::kRelease}};
  StepReading reading;
  std::thread asks([&] { reading = FwClient(path_).Enter(step, kLong, 600, CancelFlag()); });
  StartServer();
  asks.join();
  EXPECT_THAT(reading.status, IsOk());
}

}  // namespace
}  // namespace rips::actuator
