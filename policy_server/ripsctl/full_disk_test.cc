// Output that cannot be written is an error of every verb; a reader that closes it ends the verb
// without a word.
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/cli/reader_watch.h"
#include "policy_server/ripsctl/every_verb.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"
#include "services/runtime/output_stream.h"
#include "services/runtime/unique_fd.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::StartsWith;

constexpr char kFull[] =
    "error: cannot write to standard output: No space left on device; the output is not complete\n";

class FullDiskTest : public RipsctlTest {
 protected:
  FullDiskTest() {
    HandleSigpipe();
    fake_.pending.emplace_back().set_id("333333aa");
    fake_.explained["r1@3.17"] = MakeFindingExplained();
    fake_.rollout.mutable_rollout()->set_state("done");
  }
  // As main() of ripsctl; gives what stood on standard error.
  int RunInto(int fd, const Args& args, std::string* error) {
    OutputStream out(fd);
    std::ostringstream err;
    testing::internal::CaptureStderr();
    const int code = out.End(RunRipsctl(
        args, {.out = out,
               .err = err,
               .get_env = [this](const std::string& name) -> std::optional<std::string> {
                 if (name == "HOME") return home_;
                 return std::nullopt;
               },
               .connect = [this](const RawSettings& settings) { return Connect(settings); },
               .out_fd = fd}));
    *error = err.str() + testing::internal::GetCapturedStderr();
    return code;
  }
  std::vector<Args> AllVerbs() {
    std::vector<Args> all = ServerVerbs(directory_);
    for (const Args& args : OfflineVerbs(directory_)) all.push_back(args);
    return all;
  }
};

TEST_F(FullDiskTest, IsAnErrorOfEveryVerbAndPageOfHelp) {
  std::vector<Args> all = AllVerbs();
  const std::vector<Args> pages = HelpPages([this](const Args& args) { return Run(args); });
  ExpectEveryVerb(pages, all);
  for (Args page : pages) {
    page.push_back("--help");
    all.push_back(page);
  }
  all.push_back({"--version"});
  const UniqueFd full(open("/dev/full", O_WRONLY | O_CLOEXEC));
  ASSERT_GE(full.get(), 0);
  for (const Args& verb : all) {
    for (const bool json : {false, true}) {
      Args args = verb;
      if (json) args.insert(args.end(), {"--output", "json"});
      const std::string words = absl::StrJoin(args, " ");
      const Result good = Run(args);
      EXPECT_NE(good.out, "") << words << " prints something: " << good.err;
      std::string error;
      const int code = RunInto(full.get(), args, &error);
      EXPECT_EQ(code, good.code == 0 ? 1 : good.code) << words;
      EXPECT_THAT(error, HasSubstr(kFull)) << words;
    }
  }
}

TEST_F(FullDiskTest, AReaderThatIsGoneEndsEveryVerbWithoutAWord) {
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
  close(ends[0]);
  const UniqueFd out(ends[1]);
  for (const Args& args : AllVerbs()) {
    const Result good = Run(args);
    std::string error;
    const int code = RunInto(out.get(), args, &error);
    EXPECT_EQ(code, good.code == 0 ? kExitReaderGone : good.code) << absl::StrJoin(args, " ");
    EXPECT_EQ(error, good.err) << absl::StrJoin(args, " ");
  }
}

// One alert, and none after it.
class QuietOperator final : public v1::OperatorService::Service {
 public:
  grpc::Status WatchAlerts(grpc::ServerContext* context, const v1::WatchAlertsRequest*,
                           grpc::ServerWriter<v1::Alert>* writer) override {
    writer->Write(MakeAlert("x"));
    const absl::Time limit = absl::Now() + absl::Seconds(20);
    while (!context->IsCancelled() && absl::Now() < limit) absl::SleepFor(absl::Milliseconds(5));
    return grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "it watched until the limit");
  }
};

TEST_F(FullDiskTest, AQuietWatchEndsWhenItsReaderGoes) {
  server_->Shutdown();
  QuietOperator quiet;
  grpc::ServerBuilder builder;
  builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
  builder.RegisterService(&quiet);
  server_ = builder.BuildAndStart();
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
  const UniqueFd out(ends[1]);
  std::thread head([in = UniqueFd(ends[0])] {  // as `head -1` does
    char line[64];
    EXPECT_GT(read(in.get(), line, sizeof line), 0);
  });
  std::string error;
  EXPECT_EQ(RunInto(out.get(), {"alert", "watch"}, &error), kExitReaderGone);
  head.join();
  EXPECT_EQ(error, "");
}

TEST(ReaderWatchTest, SeesTheReaderGoAndNothingOfAFile) {
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
  const UniqueFd out(ends[1]);
  UniqueFd in(ends[0]);
  {
    const ReaderWatch none(-1, [] { ADD_FAILURE(); });
    const ReaderWatch there(out.get(), [] { ADD_FAILURE(); });
    const UniqueFd full(open("/dev/full", O_WRONLY | O_CLOEXEC));
    const ReaderWatch file(full.get(), [] { ADD_FAILURE(); });
  }
  const WakeFd gone;
  const ReaderWatch watch(out.get(), [&] { gone.Wake(); });
  in.Reset();
  pollfd wake = {.fd = gone.get(), .events = POLLIN, .revents = 0};
  EXPECT_EQ(poll(&wake, 1, 10'000), 1);
  EXPECT_TRUE(watch.gone());
}

// While it lives no file of this process may grow, as on a full disk.
class NoRoom {
 public:
  NoRoom() {
    getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit none = {.rlim_cur = 0, .rlim_max = before_.rlim_max};
    setrlimit(RLIMIT_FSIZE, &none);
  }
  ~NoRoom() { setrlimit(RLIMIT_FSIZE, &before_); }
  NoRoom(const NoRoom&) = delete;
  NoRoom& operator=(const NoRoom&) = delete;

 private:
  rlimit before_{};
};

TEST_F(FullDiskTest, AFileIsWholeOrAsBefore) {
  signal(SIGXFSZ, SIG_IGN);
  OfflineVerbs(directory_);  // for its files
  const std::string kept = File("kept.rips", "kept");
  const std::string ugly = File("ugly.rul", "levels:A;");
  const std::string settings = home_ + "/.config/rips/ripsctl.yaml";
  const auto text_of = [](const std::string& path) {
    std::ifstream file(path);
    return std::string(std::istreambuf_iterator<char>(file), {});
  };
  const std::string settings_before = text_of(settings);
  const std::vector<Args> all = {
      {"enrol", "create-token", "r1", "base", "--out", home_ + "/token"},
      {"alert", "recording", "1", "--out", home_ + "/new.rips"},
      {"alert", "recording", "1", "--out", kept, "--force"},
      {"record", "r1", "--out", home_ + "/record.rips"},
      {"rules", "sign", home_ + "/signed", "--key", home_ + "/a.key"},
      {"rules", "fmt", "--write", ugly},
      {"context", "use", "lab"},
  };
  for (const Args& args : all) {
    const Result result = [&] {
      const NoRoom no_room;
      return Run(args);
    }();
    EXPECT_EQ(result.code, 1) << absl::StrJoin(args, " ") << result.err;
    EXPECT_THAT(result.err, AllOf(StartsWith("error: cannot write "), HasSubstr("File too large")));
    EXPECT_EQ(result.out, "");
  }
  EXPECT_EQ(text_of(kept), "kept");
  EXPECT_EQ(text_of(ugly), "levels:A;");
  EXPECT_EQ(text_of(settings), settings_before);
  for (const char* name : {"token", "token.tmp", "new.rips", "new.rips.part", "kept.rips.part",
                           "record.rips", "signed/signature", "signed/signature.tmp"}) {
    EXPECT_FALSE(std::filesystem::exists(home_ + "/" + name)) << name;
  }
  for (const Args& args : all) EXPECT_EQ(Run(args).code, 0) << absl::StrJoin(args, " ");
}

TEST_F(FullDiskTest, AFileThatCannotBeWrittenIsNoFaultOfTheServer) {
  const Result token =
      Run({"enrol", "create-token", "r1", "base", "--out", "/proc/no-such-place/token"});
  EXPECT_EQ(token.code, 1);
  EXPECT_THAT(token.err, HasSubstr("error: cannot make `/proc/no-such-place/token`"));
  EXPECT_THAT(fake_.calls(), IsEmpty());
  const Result full = Run({"record", "r1", "--out", "/dev/full", "--force"});
  EXPECT_EQ(full.code, 1);
  EXPECT_THAT(full.err, HasSubstr("No space left on device"));
  EXPECT_TRUE(std::filesystem::exists("/dev/full"));
  const Result device = Run({"alert", "recording", "1", "--out", "/dev/full", "--force"});
  EXPECT_EQ(device.code, 1);
  EXPECT_EQ(device.err, "error: `/dev/full` is not a regular file\n");
}

}  // namespace
}  // namespace rips::ripsctl
