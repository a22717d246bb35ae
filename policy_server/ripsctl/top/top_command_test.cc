// `ripsctl top` on a real pseudo-terminal.
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server_builder.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/app.h"
#include "policy_server/ripsctl/offline_run.h"
#include "policy_server/ripsctl/samples.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/unique_fd.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr absl::Duration kPatience = absl::Seconds(20);
constexpr char kLeft[] = "\x1b[?1049l";

// Its watches deliver what the test pushes: a status, or how a watch ends.
class FleetOperator final : public v1::OperatorService::Service {
 public:
  struct Next {
    std::optional<v1::RobotStatus> status;
    grpc::Status end;
  };

  grpc::Status WatchRobots(grpc::ServerContext* context, const v1::WatchRobotsRequest*,
                           grpc::ServerWriter<v1::RobotStatus>* writer) override {
    while (!context->IsCancelled()) {
      const std::optional<Next> next = next_.Pop(absl::Milliseconds(20));
      if (!next.has_value()) continue;
      if (!next->status.has_value()) return next->end;
      writer->Write(*next->status);
    }
    return grpc::Status::CANCELLED;
  }
  grpc::Status GetLevel(grpc::ServerContext*, const v1::GetLevelRequest* request,
                        v1::GetLevelResponse* response) override {
    *response->mutable_status() = MakeStatus(request->robot(), "DEFAULT");
    for (const char* level : {"DEFAULT", "ALERT", "HALT"}) response->add_levels(level);
    return grpc::Status::OK;
  }

  void Push(const v1::RobotStatus& status) { next_.Push({status, grpc::Status::OK}); }
  void End(const grpc::Status& status) { next_.Push({std::nullopt, status}); }

 private:
  BoundedQueue<Next> next_{{.capacity = 100}};
};

class TopTest : public testing::Test {
 protected:
  TopTest() {
    int master = -1;
    int slave = -1;
    EXPECT_EQ(openpty(&master, &slave, nullptr, nullptr, nullptr), 0);
    master_ = UniqueFd(master);
    slave_ = UniqueFd(slave);
    Resize(80, 24);
    EXPECT_EQ(tcgetattr(slave_.get(), &before_), 0);
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(&fake_);
    server_ = builder.BuildAndStart();
  }
  ~TopTest() override {
    if (thread_.joinable()) {
      Type("q");
      thread_.join();
    }
    server_->Shutdown();
  }

  void Resize(uint16_t columns, uint16_t rows) const {
    const winsize size = {.ws_row = rows, .ws_col = columns, .ws_xpixel = 0, .ws_ypixel = 0};
    EXPECT_EQ(ioctl(slave_.get(), TIOCSWINSZ, &size), 0);
  }
  void Type(const std::string& keys) const {
    EXPECT_EQ(write(master_.get(), keys.data(), keys.size()), static_cast<ssize_t>(keys.size()));
  }
  Result Run(std::vector<std::string> args, TerminalFds terminal) const {
    std::ostringstream out;
    std::ostringstream err;
    args.insert(args.begin(), "top");
    const World world = {
        .out = out,
        .err = err,
        .get_env = [](const std::string&) { return std::optional<std::string>(); },
        .connect =
            [this](const RawSettings&) {
              return std::unique_ptr<v1::OperatorService::StubInterface>(
                  v1::OperatorService::NewStub(grpc::CreateChannel(
                      absl::StrCat("127.0.0.1:", port_), grpc::InsecureChannelCredentials())));
            },
        .terminal = terminal};
    const int code = RunRipsctl(args, world);
    return {code, out.str(), err.str()};
  }
  // On a thread, so that the test can be its terminal.
  void Start() {
    thread_ = std::thread([this] { result_ = Run({}, {slave_.get(), slave_.get()}); });
  }
  // What it came to; its last bytes are in shown_.
  Result Join() {
    ShownUntil(kLeft);
    thread_.join();
    return result_;
  }
  // Reads from the terminal until it has shown `text` since the last call. False if it does not.
  bool ShownUntil(const std::string& text) {
    const absl::Time deadline = absl::Now() + kPatience;
    shown_ = std::move(rest_);
    rest_.clear();
    while (shown_.find(text) == std::string::npos) {
      pollfd ready = {.fd = master_.get(), .events = POLLIN, .revents = 0};
      poll(&ready, 1, 100);
      char bytes[4096];
      const ssize_t count = ready.revents == 0 ? 0 : read(master_.get(), bytes, sizeof bytes);
      if (count > 0) shown_.append(bytes, static_cast<size_t>(count));
      if (absl::Now() > deadline) return false;
    }
    const size_t end = shown_.find(text) + text.size();
    rest_ = shown_.substr(end);
    shown_.resize(end);
    return true;
  }
  bool IsRestored() const {
    termios now{};
    EXPECT_EQ(tcgetattr(slave_.get(), &now), 0);
    return now.c_lflag == before_.c_lflag && now.c_iflag == before_.c_iflag;
  }

  FleetOperator fake_;
  std::unique_ptr<grpc::Server> server_;
  int port_ = 0;
  UniqueFd master_;
  UniqueFd slave_;
  termios before_{};
  std::thread thread_;
  Result result_;
  std::string shown_;
  std::string rest_;
};

TEST_F(TopTest, ShowsTheFleetUntilQ) {
  Start();
  fake_.Push(MakeStatus("calm", "DEFAULT"));
  fake_.Push(MakeStatus("halted", "HALT"));
  ASSERT_TRUE(ShownUntil("  calm")) << shown_;
  EXPECT_THAT(shown_, testing::StartsWith("\x1b[?1049h\x1b[?25l"));
  EXPECT_FALSE(IsRestored()) << "without echo";
  v1::RobotStatus hostile = MakeStatus("calm", "DEFAULT");
  hostile.add_degraded("\x1b]0;owned\x07");
  fake_.Push(hostile);
  ASSERT_TRUE(ShownUntil("\\x1b]0;owned\\x07")) << shown_;
  EXPECT_LT(shown_.rfind("halted"), shown_.rfind("calm"));
  Type("xyz\x1b[A");
  Type("q");
  const Result result = Join();
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(result.err, "");
  EXPECT_EQ(result.out, "");
  EXPECT_TRUE(IsRestored());
}

// With a signal; 0 is Ctrl-C.
class TopEndTest : public TopTest, public testing::WithParamInterface<int> {};

TEST_P(TopEndTest, RestoresTheTerminalAndTheHandlers) {
  struct sigaction before {};
  sigaction(SIGTERM, nullptr, &before);
  Start();
  fake_.Push(MakeStatus("r1", "ALERT"));
  ASSERT_TRUE(ShownUntil("1 ALERT")) << shown_;
  if (GetParam() == 0) Type("\x03");
  if (GetParam() != 0) kill(getpid(), GetParam());
  EXPECT_EQ(Join().code, 0);
  EXPECT_TRUE(IsRestored());
  struct sigaction after {};
  sigaction(SIGTERM, nullptr, &after);
  EXPECT_EQ(after.sa_handler, before.sa_handler);
}

INSTANTIATE_TEST_SUITE_P(Signals, TopEndTest, testing::Values(0, SIGTERM, SIGINT, SIGHUP, SIGQUIT));

TEST_F(TopTest, FollowsTheSizeOfTheTerminal) {
  Start();
  for (int i = 10; i < 60; ++i) fake_.Push(MakeStatus(absl::StrCat("r", i), "ALERT"));
  ASSERT_TRUE(ShownUntil("30 more robots")) << shown_;
  Resize(80, 10);
  kill(getpid(), SIGWINCH);
  ASSERT_TRUE(ShownUntil("44 more robots")) << shown_;
  Resize(12, 10);
  kill(getpid(), SIGWINCH);
  ASSERT_TRUE(ShownUntil("44 more rob>")) << shown_;
}

TEST_F(TopTest, ALostConnectionMakesAllStaleUntilItIsThereAgain) {
  Start();
  fake_.Push(MakeStatus("r1", "ALERT"));
  ASSERT_TRUE(ShownUntil("1 ALERT")) << shown_;
  fake_.End(grpc::Status(grpc::StatusCode::UNAVAILABLE, "draining"));
  ASSERT_TRUE(ShownUntil("? r1")) << shown_;
  EXPECT_THAT(shown_, AllOf(HasSubstr("\x1b[7mNOT CURRENT since "), HasSubstr("\x1b[2m? r1")));
  fake_.Push(MakeStatus("r1", "HALT"));
  ASSERT_TRUE(ShownUntil("1 HALT")) << shown_;
  ASSERT_TRUE(ShownUntil("  r1")) << shown_;
}

TEST_F(TopTest, ARefusalEndsItAndIsPrintedOnTheRestoredTerminal) {
  Start();
  fake_.Push(MakeStatus("r1", "ALERT"));
  ASSERT_TRUE(ShownUntil("1 ALERT")) << shown_;
  fake_.End(grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "banned"));
  const Result result = Join();
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.err, "error: refused: banned\n");
  EXPECT_TRUE(IsRestored());
}

TEST_F(TopTest, AnAbsentServerIsExitCodeThree) {
  server_->Shutdown();
  Start();
  const Result result = Join();
  EXPECT_EQ(result.code, 3);
  EXPECT_THAT(result.err, HasSubstr("cannot reach the policy server"));
  EXPECT_TRUE(IsRestored());
}

TEST_F(TopTest, ATerminalThatGoesAwayEndsIt) {
  Start();
  fake_.Push(MakeStatus("r1", "ALERT"));
  ASSERT_TRUE(ShownUntil("1 ALERT")) << shown_;
  master_.Reset();
  thread_.join();
  EXPECT_THAT(result_.code, testing::AnyOf(0, 1)) << result_.err;
  EXPECT_THAT(result_.err, testing::Not(HasSubstr("policy server")));
}

TEST_F(TopTest, NeedsATerminal) {
  const UniqueFd null(open("/dev/null", O_RDWR | O_CLOEXEC));
  const TerminalFds terminals[] = {
      {}, {slave_.get(), -1}, {-1, slave_.get()}, {slave_.get(), null.get()}};
  for (const TerminalFds& fds : terminals) {
    const Result result = Run({}, fds);
    EXPECT_EQ(result.code, 2);
    EXPECT_EQ(result.err,
              "error: standard input and output must be a terminal; `ripsctl robot watch` prints "
              "each change as a line\n");
  }
  EXPECT_EQ(Run({"--output", "json"}, {slave_.get(), slave_.get()}).code, 2);
  EXPECT_EQ(Run({"../r1"}, {slave_.get(), slave_.get()}).code, 2);
  EXPECT_TRUE(IsRestored());
}

}  // namespace
}  // namespace rips::ripsctl
