#include "mode_actuator/helpers/exec/exec_server.h"

#include <stdlib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <functional>
#include <map>
#include <optional>
#include <thread>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/helpers/exec/posix_runner.h"
#include "mode_actuator/steps/program/exec_client.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"
#include "services/local_socket/helper_socket.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;

// Waits for one result, which may come after it is gone.
class Waiter {
 public:
  ProgramRunner::Done Callback() {
    return [slot = slot_](ProgramResult result) {
      MutexLock lock(&slot->mu);
      EXPECT_FALSE(slot->result.has_value()) << "told twice";
      slot->result = std::move(result);
      slot->changed.NotifyAll();
    };
  }
  ProgramResult Wait() {
    MutexLock lock(&slot_->mu);
    for (int i = 0; i < 600 && !slot_->result.has_value(); ++i) {
      slot_->changed.WaitFor(lock, absl::Milliseconds(100));
    }
    EXPECT_TRUE(slot_->result.has_value()) << "no result within 60 s";
    return slot_->result.value_or(ProgramResult{.status = absl::InternalError("none")});
  }
  bool told() {
    MutexLock lock(&slot_->mu);
    return slot_->result.has_value();
  }

 private:
  struct Slot {
    Mutex mu;
    CondVar changed;
    std::optional<ProgramResult> result;
  };
  const std::shared_ptr<Slot> slot_ = std::make_shared<Slot>();
};

bool Soon(const std::function<bool()>& condition) {
  for (int i = 0; i < 3000; ++i) {
    if (condition()) return true;
    usleep(10'000);
  }
  return false;
}

// Programs run until they are told to end: by Cancel, or by the test.
class HeldPrograms final : public ProgramRunner {
 public:
  absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) override {
    MutexLock lock(&mu_);
    if (request.name == "refused") return absl::ResourceExhaustedError("busy");
    running_[++last_] = std::move(done);
    request_ = request;
    return last_;
  }
  void Cancel(uint64_t run) override { End(run, {.status = absl::CancelledError("cancelled")}); }
  absl::Status Examine(absl::string_view name) override {
    return name == "fine" ? absl::OkStatus() : absl::NotFoundError(name);
  }

  void End(uint64_t run, ProgramResult result) {
    Done done;
    {
      MutexLock lock(&mu_);
      const auto found = running_.find(run);
      if (found == running_.end()) return;
      done = std::move(found->second);
      running_.erase(found);
    }
    done(std::move(result));
  }
  uint64_t last() {
    MutexLock lock(&mu_);
    return last_;
  }
  size_t running() {
    MutexLock lock(&mu_);
    return running_.size();
  }
  ProgramRequest request() {
    MutexLock lock(&mu_);
    return request_;
  }

 private:
  Mutex mu_;
  uint64_t last_ = 0;
  std::map<uint64_t, Done> running_;
  ProgramRequest request_;
};

class ExecServerTest : public ::testing::Test {
 protected:
  ExecServerTest() {
    char name[] = "/tmp/rips-exec-XXXXXX";
    directory_ = mkdtemp(name);
    path_ = directory_ + "/exec.sock";
    MakeClient(absl::Seconds(30), absl::Seconds(30));
  }
  ~ExecServerTest() override {
    client_.reset();
    StopServer();
    unlink(path_.c_str());
    rmdir(directory_.c_str());
  }

  void MakeClient(absl::Duration answer, absl::Duration end) {
    client_ = std::make_unique<ExecClient>(
        ExecClient::Options{.socket = path_, .answer_timeout = answer, .end_slack = end});
  }
  void StartServer(absl::Duration peer_timeout = absl::Seconds(30)) {
    auto listener = ListenAt(path_, geteuid());
    ASSERT_THAT(listener, IsOk());
    server_ = std::make_unique<ExecServer>(
        *std::move(listener),
        ExecServer::Options{
            .user = geteuid(),
            .peer_timeout = peer_timeout,
            .allowed = {{.name = "short", .path = "/x", .timeout = absl::Milliseconds(1)}}},
        &programs_);
    thread_ = std::thread([this] { server_->Run(); });
  }
  // As when rips-exec dies: all connections close, what runs is no longer its business.
  void StopServer() {
    if (!thread_.joinable()) return;
    server_->Stop();
    thread_.join();
    for (uint64_t run = 1; run <= programs_.last(); ++run) programs_.End(run, {});
    server_.reset();
  }
  uint64_t Start(const std::string& name, Waiter& waiter, ExecClient* client = nullptr) {
    const auto run = (client == nullptr ? client_.get() : client)
                         ->Start({name, {"a"}, absl::Seconds(60)}, waiter.Callback());
    EXPECT_THAT(run, IsOk());
    return run.value_or(0);
  }
  UniqueFd Connect() const {
    auto fd = ConnectToHelper(path_, "rips-exec");
    EXPECT_THAT(fd, IsOk());
    return fd.ok() ? *std::move(fd) : UniqueFd();
  }
  static std::string StartMessage() {
    ExecCall call;
    call.verb = ExecVerb::kStart;
    call.program.name = "held";
    return EncodeExecCall(call);
  }
  // The next answer; waits for it.
  static absl::StatusOr<ExecAnswer> Receive(ExecChannel& channel) {
    for (int i = 0; i < 3000; ++i) {
      auto message = channel.Receive();
      if (absl::IsAborted(message.status())) continue;
      if (!message.ok()) return message.status();
      if (message->has_value()) return DecodeExecAnswer(**message);
      usleep(10'000);
    }
    return absl::DeadlineExceededError("no answer within 30 s");
  }

  std::string directory_, path_;
  HeldPrograms programs_;
  std::unique_ptr<ExecServer> server_;
  std::thread thread_;
  std::unique_ptr<ExecClient> client_;
};

TEST_F(ExecServerTest, ARunIsToldFromBeginToEnd) {
  StartServer();
  Waiter waiter;
  Start("held", waiter);
  ASSERT_TRUE(Soon([&] { return programs_.running() == 1; }));
  EXPECT_EQ(programs_.request().name, "held");
  EXPECT_EQ(programs_.request().timeout, absl::Seconds(60));
  ProgramResult ended = {.status = absl::AbortedError("exit code 3"), .exit_code = 3};
  ended.output_tail = std::string(kOutputBytesMax, '\xff');
  ended.output_bytes = 1 << 20;
  ended.note = "note";
  programs_.End(1, ended);
  const ProgramResult result = waiter.Wait();
  EXPECT_EQ(result.status, ended.status);
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_EQ(result.output_tail, ended.output_tail);
  EXPECT_EQ(result.note, "note");
  EXPECT_TRUE(result.begun);
}

TEST_F(ExecServerTest, TheLargestRequestArrives) {
  StartServer();
  Waiter waiter;
  ProgramRequest request = {.name = "held", .timeout = absl::InfiniteDuration()};
  request.args.assign(kArgsMax, std::string(kArgBytesMax, 'x'));
  ASSERT_THAT(client_->Start(request, waiter.Callback()), IsOk());
  ASSERT_TRUE(Soon([&] { return programs_.running() == 1; }));
  EXPECT_EQ(programs_.request().args, request.args);
  EXPECT_EQ(programs_.request().timeout, absl::InfiniteDuration());
}

TEST_F(ExecServerTest, RefusalsAreToldAsNotBegun) {
  StartServer();
  Waiter waiter;
  Start("refused", waiter);
  const ProgramResult result = waiter.Wait();
  EXPECT_THAT(result.status, StatusIs(absl::StatusCode::kResourceExhausted, "busy"));
  EXPECT_FALSE(result.begun);

  const auto start = [&](std::string name, std::vector<std::string> args) {
    return client_->Start({std::move(name), std::move(args), absl::Seconds(1)},
                          [](ProgramResult) { ADD_FAILURE() << "asked"; });
  };
  EXPECT_THAT(start(std::string("a\0b", 3), {}),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("`a\\x00\\x62` is not in")));
  EXPECT_THAT(start(std::string(257, 'n'), {}), StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(start("x", std::vector<std::string>(65)),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(start("x", {std::string("a\0b", 3)}), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST_F(ExecServerTest, ExaminesAndSaysWhatIsWrong) {
  EXPECT_THAT(client_->Examine("fine"),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot reach rips-exec")));
  StartServer();
  EXPECT_THAT(client_->Examine("fine"), IsOk());
  EXPECT_THAT(client_->Examine("other"), StatusIs(absl::StatusCode::kNotFound, "other"));
  EXPECT_EQ(programs_.last(), 0u);
}

TEST_F(ExecServerTest, CancelReachesTheProgram) {
  StartServer();
  Waiter waiter;
  const uint64_t run = Start("held", waiter);
  client_->Cancel(run);
  EXPECT_THAT(waiter.Wait().status, StatusIs(absl::StatusCode::kCancelled));
  client_->Cancel(run);
  client_->Cancel(12'345);
}

TEST_F(ExecServerTest, AbsentIsUnavailableAndItComesBack) {
  Waiter none;
  EXPECT_THAT(client_->Start({"held", {}, absl::Seconds(1)}, none.Callback()),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot reach rips-exec")));
  EXPECT_FALSE(none.told());
  for (int i = 0; i < 3; ++i) {
    StartServer();
    Waiter waiter;
    Start("held", waiter);
    ASSERT_TRUE(Soon([&] { return programs_.running() == 1; }));
    programs_.End(programs_.last(), {});
    EXPECT_THAT(waiter.Wait().status, IsOk());
    StopServer();
  }
}

TEST_F(ExecServerTest, ItsEndDuringARunIsUnknown) {
  StartServer();
  Waiter waiter;
  Start("held", waiter);
  ASSERT_TRUE(Soon([&] { return programs_.running() == 1; }));
  StopServer();
  const ProgramResult result = waiter.Wait();
  EXPECT_THAT(result.status, StatusIs(absl::StatusCode::kUnknown, "rips-exec ended while it ran"));
  EXPECT_TRUE(result.begun);
}

// Somebody listens and does what the test does.
class ExecClientTest : public ExecServerTest {
 protected:
  ExecClientTest() { listener_ = *ListenAt(path_, geteuid()); }
  UniqueFd Accept() {
    Accepted accepted;
    Soon([&] {
      accepted = AcceptFrom(listener_.get(), geteuid());
      return accepted.fd.get() >= 0;
    });
    return std::move(accepted.fd);
  }

  UniqueFd listener_;
};

TEST_F(ExecClientTest, AnImpostorIsAskedNothing) {
  if (!RootMay({CAP_CHOWN})) GTEST_SKIP() << "giving a socket away needs CAP_CHOWN";
  ASSERT_EQ(chown(path_.c_str(), 65533, 65533), 0);
  const ProgramRequest request = {.name = "fine"};
  EXPECT_THAT(client_->Start(request, [](const ProgramResult&) { FAIL(); }),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("may pose as rips-exec")));
  EXPECT_THAT(client_->Examine("fine"), StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(client_->CheckSocket(), StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_LT(AcceptFrom(listener_.get(), geteuid()).fd.get(), 0) << "it was asked";
}

TEST_F(ExecClientTest, AHangBeforeItsAnswerIsUnknown) {
  MakeClient(absl::Milliseconds(100), absl::Seconds(30));
  Waiter waiter;
  Start("held", waiter);
  EXPECT_THAT(waiter.Wait().status,
              StatusIs(absl::StatusCode::kUnknown, "rips-exec did not answer within 100ms"));
  EXPECT_THAT(client_->Examine("fine"), StatusIs(absl::StatusCode::kUnknown));
}

TEST_F(ExecClientTest, AHangDuringARunIsUnknown) {
  MakeClient(absl::Seconds(30), absl::Milliseconds(10));
  Waiter waiter;
  Start("held", waiter);
  ExecChannel channel(Accept());
  ExecAnswer begun;
  begun.kind = ExecAnswer::Kind::kBegun;
  begun.timeout = absl::Milliseconds(50);
  channel.Send(EncodeExecAnswer(begun));
  EXPECT_THAT(channel.Flush(), IsOk());
  EXPECT_THAT(waiter.Wait().status, StatusIs(absl::StatusCode::kUnknown,
                                             HasSubstr("did not report its end within 50ms")));
}

TEST_F(ExecClientTest, AnEndBeforeTheRequestWasReadIsNotBegun) {
  Waiter waiter;
  Start("held", waiter);
  UniqueFd fd = Accept();
  char first;
  ASSERT_TRUE(Soon([&] { return recv(fd.get(), &first, 1, MSG_PEEK) == 1; }));
  fd.Reset();
  const ProgramResult result = waiter.Wait();
  EXPECT_THAT(result.status, StatusIs(absl::StatusCode::kUnavailable,
                                      "rips-exec went away before it had read the request"));
  EXPECT_FALSE(result.begun);
}

TEST_F(ExecClientTest, AnEndAfterTheRequestWasReadIsUnknown) {
  Waiter waiter;
  Start("held", waiter);
  UniqueFd fd = Accept();
  ASSERT_TRUE(Soon([&] { return ReceivePacket(fd.get(), kExecPacketBytesMax).ok(); }));
  fd.Reset();
  EXPECT_THAT(waiter.Wait().status, StatusIs(absl::StatusCode::kUnknown,
                                             "rips-exec ended before it said whether it began"));
}

TEST_F(ExecClientTest, AnswersThatAreNoneAreUnknown) {
  ExecAnswer examined;
  examined.kind = ExecAnswer::Kind::kExamined;
  ExecAnswer begun;
  begun.kind = ExecAnswer::Kind::kBegun;
  begun.timeout = absl::Hours(1);
  const std::vector<std::string> kPackets[] = {
      {"x"},
      {".garbage"},
      {"." + EncodeExecAnswer(examined)},
      {"." + EncodeExecAnswer(begun), "." + EncodeExecAnswer(begun)},
      {std::string(kExecPacketBytesMax + 1, '+')}};
  for (const auto& packets : kPackets) {
    Waiter waiter;
    Start("held", waiter);
    const UniqueFd fd = Accept();
    for (const std::string& packet : packets) EXPECT_THAT(SendPacket(fd.get(), packet), IsOk());
    EXPECT_THAT(waiter.Wait().status, StatusIs(absl::StatusCode::kUnknown)) << packets[0];
  }
}

TEST_F(ExecServerTest, WhoHasGivenUpGetsNoProgram) {
  auto listener = ListenAt(path_, geteuid());
  ASSERT_THAT(listener, IsOk());
  {
    // Asked and closed before rips-exec looks.
    ExecChannel channel(Connect());
    channel.Send(StartMessage());
    EXPECT_THAT(channel.Flush(), IsOk());
  }
  server_ = std::make_unique<ExecServer>(*std::move(listener),
                                         ExecServer::Options{.user = geteuid()}, &programs_);
  thread_ = std::thread([this] { server_->Run(); });
  EXPECT_THAT(client_->Examine("fine"), IsOk());  // connected later, so served later
  EXPECT_EQ(programs_.last(), 0u);
}

TEST_F(ExecServerTest, WhoClosesLaterLeavesItRunning) {
  StartServer();
  {
    ExecChannel channel(Connect());
    channel.Send(StartMessage());
    EXPECT_THAT(channel.Flush(), IsOk());
    EXPECT_EQ(Receive(channel)->kind, ExecAnswer::Kind::kBegun);
  }
  EXPECT_THAT(client_->Examine("fine"), IsOk());
  EXPECT_EQ(programs_.running(), 1u);
  programs_.End(1, {});
  EXPECT_THAT(client_->Examine("fine"), IsOk());
}

TEST_F(ExecServerTest, TheClientsEndCancelsWhatRunsAndTellsIt) {
  StartServer();
  Waiter waiter;
  Start("held", waiter);
  ASSERT_TRUE(Soon([&] { return programs_.running() == 1; }));
  client_.reset();
  EXPECT_THAT(waiter.Wait().status, StatusIs(absl::StatusCode::kCancelled));
  EXPECT_TRUE(Soon([&] { return programs_.running() == 0; }));
}

TEST_F(ExecServerTest, TwoActuatorsDoNotMeet) {
  StartServer();
  const auto other = std::make_unique<ExecClient>(ExecClient::Options{.socket = path_});
  Waiter mine, theirs;
  Start("held", mine);
  ASSERT_TRUE(Soon([&] { return programs_.running() == 1; }));
  const uint64_t run = Start("held", theirs, other.get());
  ASSERT_TRUE(Soon([&] { return programs_.running() == 2; }));
  other->Cancel(run);
  EXPECT_THAT(theirs.Wait().status, StatusIs(absl::StatusCode::kCancelled));
  EXPECT_FALSE(mine.told());
}

TEST_F(ExecServerTest, HostilePacketsAreRefusedAndOthersServed) {
  StartServer();
  const std::string kPackets[] = {
      std::string(kExecPacketBytesMax + 1, '.'),
      std::string(100'000, '+'),
      ".",
      "+",
      "GET / HTTP/1.1\r\n\r\n",
      std::string("\0", 1),
      ".rips-exec 1\nverb 6\ncancel\n",
      ".\x08\x01",                        // a start of nothing
      "." + StartMessage() + "\x50\x01",  // with a field that does not exist
      "." + StartMessage() + StartMessage(),
  };
  for (const std::string& packet : kPackets) {
    ExecChannel channel(Connect());
    EXPECT_THAT(SendPacket(channel.fd(), packet), IsOk());
    const auto answer = Receive(channel);
    ASSERT_THAT(answer, IsOk()) << packet.substr(0, 40);
    EXPECT_THAT(answer->result.status, StatusIs(absl::StatusCode::kInvalidArgument));
    EXPECT_FALSE(answer->result.begun);
    EXPECT_THAT(Receive(channel), StatusIs(absl::StatusCode::kOutOfRange)) << "not closed";
  }
  EXPECT_EQ(programs_.last(), 0u);
  EXPECT_THAT(client_->Examine("fine"), IsOk());
}

TEST_F(ExecServerTest, AMessageWithoutAnEndIsRefused) {
  StartServer();
  ExecChannel channel(Connect());
  const std::string packet = "+" + std::string(kExecPacketBytesMax - 1, 'x');
  absl::Status sent;
  for (int i = 0; i < 1000 && !absl::IsAborted(sent); ++i) {
    sent = SendPacket(channel.fd(), packet);
    if (absl::IsUnavailable(sent)) usleep(1'000);
  }
  EXPECT_THAT(sent, StatusIs(absl::StatusCode::kAborted));
  EXPECT_THAT(Receive(channel)->result.status,
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a message exceeds limit")));
}

TEST_F(ExecServerTest, AConnectionAsksOnce) {
  StartServer();
  ExecChannel channel(Connect());
  channel.Send(StartMessage());
  channel.Send(StartMessage());
  EXPECT_THAT(channel.Flush(), IsOk());
  EXPECT_EQ(Receive(channel)->kind, ExecAnswer::Kind::kBegun);
  EXPECT_THAT(Receive(channel)->result.status,
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a second request")));
  EXPECT_EQ(programs_.last(), 1u);
}

TEST_F(ExecServerTest, WhoSaysNothingIsClosedAndWhoDoesNotReadHoldsNobodyUp) {
  StartServer(absl::Seconds(3));
  const UniqueFd silent = Connect();
  EXPECT_TRUE(Soon([&] { return absl::IsOutOfRange(ReceivePacket(silent.get(), 100).status()); }));

  // Who does not read holds nobody up, and finds its answer when it does.
  ExecChannel deaf(Connect());
  deaf.Send(StartMessage());
  EXPECT_THAT(deaf.Flush(), IsOk());
  ASSERT_TRUE(Soon([&] { return programs_.running() == 1; }));
  ProgramResult ended;
  ended.output_tail = std::string(kOutputBytesMax, 'x');
  programs_.End(1, ended);
  for (int i = 0; i < 3; ++i) EXPECT_THAT(client_->Examine("fine"), IsOk());
  EXPECT_EQ(Receive(deaf)->kind, ExecAnswer::Kind::kBegun);
  EXPECT_EQ(Receive(deaf)->result.output_tail, ended.output_tail);
  EXPECT_THAT(Receive(deaf), StatusIs(absl::StatusCode::kOutOfRange));
}

TEST_F(ExecServerTest, ConnectionsHaveALimit) {
  StartServer();
  std::vector<UniqueFd> silent;
  for (size_t i = 0; i < kExecConnectionsMax; ++i) silent.push_back(Connect());
  const absl::Status refused = client_->Examine("fine");
  EXPECT_THAT(refused,
              StatusIs(absl::StatusCode::kResourceExhausted, "connections exceed limit 48"));
  silent.clear();
  EXPECT_TRUE(Soon([&] { return client_->Examine("fine").ok(); }));
}

TEST_F(ExecServerTest, OthersAreRefused) {
  if (!RootMay({CAP_SETUID})) GTEST_SKIP() << "being another user needs CAP_SETUID";
  StartServer();
  chmod(directory_.c_str(), 0755);
  chmod(path_.c_str(), 0666);
  const pid_t child = fork();
  if (child == 0) {
    if (setuid(12'345) != 0) _exit(2);
    auto fd = ConnectToHelper(path_, "rips-exec");
    if (!fd.ok()) _exit(3);
    ExecChannel channel(*std::move(fd));
    const auto answer = Receive(channel);
    const bool denied = answer.ok() && absl::IsPermissionDenied(answer->result.status);
    _exit(denied ? 0 : 4);
  }
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

// --- with real programs

TEST_F(ExecServerTest, RunsRealProgramsAndBringsTheirWholeOutput) {
  RealClock clock;
  const std::vector<ProgramSpec> allowed = {{.name = "bash", .path = "/usr/bin/bash"}};
  auto runner = std::make_unique<PosixRunner>(
      PosixRunnerOptions{.allowed = allowed, .enter = RIPS_BIN_DIR "/rips-exec"}, &clock);
  auto listener = ListenAt(path_, geteuid());
  ASSERT_THAT(listener, IsOk());
  server_ = std::make_unique<ExecServer>(*std::move(listener),
                                         ExecServer::Options{.user = geteuid(), .allowed = allowed},
                                         runner.get());
  thread_ = std::thread([this] { server_->Run(); });
  Waiter waiter, gone;
  ASSERT_THAT(
      client_->Start(
          {"bash", {"-c", "head -c 100000 /dev/zero | tr '\\0' x; exit 5"}, absl::Seconds(30)},
          waiter.Callback()),
      IsOk());
  const ProgramResult result = waiter.Wait();
  EXPECT_EQ(result.exit_code, 5);
  EXPECT_EQ(result.output_tail, std::string(kOutputBytesMax, 'x'));
  EXPECT_EQ(result.output_bytes, 100'000u);
  ASSERT_THAT(client_->Start({"rm", {}, absl::Seconds(1)}, gone.Callback()), IsOk());
  EXPECT_THAT(gone.Wait().status, StatusIs(absl::StatusCode::kPermissionDenied,
                                           "program `rm` is not in the allow-list"));
  server_->Stop();
  thread_.join();
  runner.reset();
}

}  // namespace
}  // namespace rips::actuator
