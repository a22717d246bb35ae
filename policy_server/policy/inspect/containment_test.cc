// What a hostile plugin cannot do, for a server that is root and for one that is not, and where the
// kernel gives no namespaces. rips-test-hostile-plugin tries.
#include <fcntl.h>
#include <grp.h>
#include <linux/filter.h>
#include <linux/sched.h>
#include <linux/seccomp.h>
#include <netinet/in.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <memory>
#include <optional>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/inspect/plugin.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::inspect {
namespace {

using engine::Verdict;
using ::testing::Contains;
using ::testing::HasSubstr;

// Nobody's on this machine.
constexpr uid_t kServerUser = 54'321;
constexpr uid_t kPluginUser = 54'322;

// Processes of this name (15 bytes at most), zombies not counted.
int CountNamed(const std::string& name) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    std::ifstream file(entry.path() / "stat");
    std::string line;
    if (!std::getline(file, line)) continue;
    count += absl::StrContains(line, absl::StrCat("(", name, ") ")) &&
             !absl::StrContains(line, absl::StrCat("(", name, ") Z"));
  }
  return count;
}

// Killed processes need a moment.
int CountNamedLeft(const std::string& name) {
  for (int i = 0; i < 500 && CountNamed(name) > 0; ++i) usleep(10'000);
  return CountNamed(name);
}

UniqueFd ListenTcp(int* port) {
  UniqueFd listener(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t bytes = sizeof(address);
  EXPECT_EQ(bind(listener.get(), reinterpret_cast<sockaddr*>(&address), bytes), 0);
  EXPECT_EQ(listen(listener.get(), 8), 0);
  getsockname(listener.get(), reinterpret_cast<sockaddr*>(&address), &bytes);
  *port = ntohs(address.sin_port);
  return listener;
}

UniqueFd ListenUnix(const std::string& name) {
  UniqueFd listener(socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_un address = {};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, name.data(), name.size());
  const bool abstract = name[0] == '@';
  if (abstract) address.sun_path[0] = '\0';
  const size_t bytes = offsetof(sockaddr_un, sun_path) + name.size() + (abstract ? 0 : 1);
  EXPECT_EQ(bind(listener.get(), reinterpret_cast<sockaddr*>(&address), bytes), 0);
  EXPECT_EQ(listen(listener.get(), 8), 0);
  if (!abstract) chmod(name.c_str(), 0777);
  return listener;
}

// As a service manager with RestrictNamespaces=: clone with one of those flags is refused.
void RefuseNamespaces() {
  sock_filter code[] = {BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)),
                        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, __NR_clone, 0, 3),
                        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, args)),
                        BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, CLONE_NEWPID | CLONE_NEWUSER, 0, 1),
                        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | EPERM),
                        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW)};
  const sock_fprog program = {.len = std::size(code), .filter = code};
  ASSERT_EQ(prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), 0);
  ASSERT_EQ(prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program), 0);
}

// Whether a process of that user may make the namespaces that hold a plugin.
bool MayMakeNamespaces(uid_t uid) {
  const pid_t child = fork();
  if (child == 0) {
    if (uid != 0 && setresuid(uid, uid, uid) != 0) _exit(1);
    _exit(syscall(SYS_unshare, CLONE_NEWUSER | CLONE_NEWPID) == 0 ? 0 : 1);
  }
  int status = -1;
  return waitpid(child, &status, 0) == child && status == 0;
}

class ContainmentTest : public ::testing::Test {
 protected:
  ContainmentTest() {
    std::string name = ::testing::TempDir() + "/containXXXXXX";
    dir_ = mkdtemp(name.data());
    // What could be read and written by everybody, so that only the containment refuses it.
    chmod(dir_.c_str(), 0777);
    for (const char* each : {"/bundle", "/bundle/plugins", "/helpers", "/var"}) {
      std::filesystem::create_directory(dir_ + each);
      chmod((dir_ + each).c_str(), 0777);
    }
    for (const char* each : {"/bundle/table", "/var/key.pem", "/var/state.db"}) {
      std::ofstream(dir_ + each) << "secret";
      chmod((dir_ + each).c_str(), 0666);
    }
    std::filesystem::copy(RIPS_TEST_DIR "/rips-test-hostile-plugin", dir_ + "/bundle/plugins/p");
    // The build directory may be below one that others cannot enter.
    helpers_ = dir_ + "/helpers";
    std::filesystem::copy(RIPS_TEST_DIR "/rips-inspect", helpers_);
    tag_ = absl::StrCat("x", getpid() % 1'000'000);
  }
  ~ContainmentTest() override { std::filesystem::remove_all(dir_); }

  // In a process of its own, as that user, perhaps without namespaces.
  void RunAs(uid_t uid, bool namespaces, const std::function<void()>& what) {
    const pid_t child = fork();
    if (child == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      if (uid != 0) {
        EXPECT_EQ(setgroups(0, nullptr), 0);
        EXPECT_EQ(setresgid(uid, uid, uid), 0);
        EXPECT_EQ(setresuid(uid, uid, uid), 0);
        prctl(PR_SET_DUMPABLE, 1);
      }
      if (!namespaces) RefuseNamespaces();
      what();
      _exit(HasFailure() ? 1 : 0);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_EQ(status, 0);
  }

  std::unique_ptr<Plugin> Start(const PluginOptions& options) {
    auto plugin = std::make_unique<Plugin>(
        PluginSpec{"p", dir_ + "/bundle/plugins/p", PluginProtocol::kFramed, dir_ + "/bundle"},
        options, &clock_);
    EXPECT_EQ(plugin->Ask(With("read " + dir_ + "/bundle/table")), Verdict::kYes)
        << "what it may do works";
    return plugin;
  }
  static Message With(const std::string& payload) {
    return {.robot = "r1", .payload = payload, .size_bytes = 1, .available = true};
  }
  PluginOptions Options(std::optional<JailIds> ids, RunCgroups* cgroups = nullptr) const {
    return {.answer_time = absl::Seconds(60),
            .greeting_time = absl::Seconds(60),
            .contain = {.helpers = helpers_, .ids = ids, .cgroups = cgroups}};
  }
  void ExpectContained(const PluginOptions& options, bool limits_tasks) {
    int port = 0;
    const UniqueFd tcp = ListenTcp(&port);
    const UniqueFd path = ListenUnix(absl::StrCat(dir_, "/bundle/s", getpid()));
    const UniqueFd abstract = ListenUnix(absl::StrCat("@", tag_, getpid()));
    const std::string orders[] = {"read " + dir_ + "/var/key.pem",
                                  "read /etc/passwd",
                                  "write " + dir_ + "/var/state.db",
                                  "write " + dir_ + "/bundle/table",
                                  "remove " + dir_ + "/bundle/table",
                                  "make " + dir_ + "/bundle/new",
                                  "make /tmp/" + tag_,
                                  "make /dev/shm/" + tag_,
                                  "read /proc/self/environ",
                                  absl::StrCat("read /proc/", getpid(), "/environ"),
                                  absl::StrCat("memory-of ", getpid()),
                                  absl::StrCat("kill ", getpid()),
                                  absl::StrCat("limit ", getpid()),
                                  absl::StrCat("tcp ", port),
                                  absl::StrCat("unix ", dir_, "/bundle/s", getpid()),
                                  absl::StrCat("unix @", tag_, getpid()),
                                  "take 1500"};
    const std::unique_ptr<Plugin> plugin = Start(options);
    for (const std::string& order : orders) {
      EXPECT_EQ(plugin->Ask(With(order)), Verdict::kNo) << order;
    }
    EXPECT_EQ(plugin->Ask(With("take 100")), Verdict::kYes);
    if (options.contain.ids) {
      EXPECT_EQ(plugin->Ask(With(absl::StrCat("as ", options.contain.ids->uid))), Verdict::kYes);
    }
    if (limits_tasks) {
      EXPECT_EQ(plugin->Ask(With("bomb b" + tag_)), Verdict::kNo);
      EXPECT_GT(CountNamed("b" + tag_), 10);
    }
    EXPECT_EQ(plugin->failures(), 0u);
  }
  // Whatever left its session and lost its parent ends with its process, however that ends.
  void ExpectNothingEscapes(const PluginOptions& options) {
    std::unique_ptr<Plugin> plugin = Start(options);
    EXPECT_EQ(plugin->Ask(With("escape e" + tag_)), Verdict::kYes);
    for (int i = 0; i < 500 && CountNamed("e" + tag_) == 0; ++i) usleep(10'000);
    EXPECT_EQ(CountNamed("e" + tag_), 1);
    plugin.reset();
    EXPECT_EQ(CountNamedLeft("e" + tag_), 0) << "killed with its plugin";

    plugin = Start(options);
    EXPECT_EQ(plugin->Ask(With("escape f" + tag_)), Verdict::kYes);
    for (int i = 0; i < 500 && CountNamed("f" + tag_) == 0; ++i) usleep(10'000);
    EXPECT_EQ(CountNamed("f" + tag_), 1);
    // As if the server had died. Of a plugin that does not run the pid is 0: our process group.
    ASSERT_GT(plugin->pid(), 0);
    kill(plugin->pid(), SIGTERM);
    EXPECT_EQ(CountNamedLeft("f" + tag_), 0) << "killed with whoever watched it";
    EXPECT_EQ(CountNamedLeft("b" + tag_), 0);
  }

  RealClock clock_;
  std::string dir_, helpers_;
  std::string tag_;
};

constexpr JailIds kPluginIds = {.uid = kPluginUser, .gid = kPluginUser};

TEST_F(ContainmentTest, OfAServerThatIsRoot) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "becoming another user needs all of root's rights";
  if (!MayMakeNamespaces(0)) GTEST_SKIP() << "user namespaces are not allowed here";
  ExpectContained(Options(kPluginIds), /*limits_tasks=*/true);
  ExpectNothingEscapes(Options(kPluginIds));
}

TEST_F(ContainmentTest, OfAServerThatIsNotRoot) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "becoming another user needs all of root's rights";
  if (!MayMakeNamespaces(kServerUser)) GTEST_SKIP() << "user namespaces are not allowed here";
  RunAs(kServerUser, /*namespaces=*/true, [this] {
    ExpectContained(Options({}), /*limits_tasks=*/true);
    ExpectNothingEscapes(Options({}));
  });
}

TEST_F(ContainmentTest, OfRootWithoutAUserForPlugins) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "becoming another user needs all of root's rights";
  ExpectContained(Options({}), /*limits_tasks=*/false);
  ExpectNothingEscapes(Options({}));
}

TEST_F(ContainmentTest, OfRootWithoutNamespaces) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "becoming another user needs all of root's rights";
  RunAs(0, /*namespaces=*/false, [this] {
    ExpectContained(Options(kPluginIds), /*limits_tasks=*/false);
    ExpectNothingEscapes(Options(kPluginIds));
  });
}

TEST_F(ContainmentTest, OfAServerThatIsNotRootWithoutNamespaces) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "becoming another user needs all of root's rights";
  RunAs(kServerUser, /*namespaces=*/false, [this] {
    ExpectContained(Options({}), /*limits_tasks=*/false);
    ExpectNothingEscapes(Options({}));
  });
}

TEST_F(ContainmentTest, ByACgroup) {
  int left_behind = 0;
  const std::string name = absl::StrCat("rips-inspect-test-", getpid());
  const auto cgroups = RunCgroups::Open("", name, &left_behind);
  if (!cgroups.ok()) GTEST_SKIP() << cgroups.status();
  RunAs(geteuid(), /*namespaces=*/false,
        [&] { ExpectNothingEscapes(Options({}, cgroups->get())); });
  for (const auto& entry : std::filesystem::directory_iterator((*cgroups)->path())) {
    EXPECT_FALSE(entry.is_directory()) << entry.path() << " was left behind";
  }
}

TEST_F(ContainmentTest, WhatCannotBeEnforcedIsTold) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "becoming another user needs all of root's rights";
  const Containment contain = {.helpers = helpers_, .ids = kPluginIds};
  RunAs(0, /*namespaces=*/false, [&] {
    const auto without = ProbeContainment(contain);
    ASSERT_THAT(without, IsOk());
    EXPECT_THAT(*without, Contains(HasSubstr("no PID namespace")));
  });
  RunAs(kServerUser, /*namespaces=*/true, [&] {
    EXPECT_THAT(ProbeContainment(contain),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("cannot become user")));
  });
  if (!MayMakeNamespaces(0)) GTEST_SKIP() << "user namespaces are not allowed here";
  const auto missing = ProbeContainment(contain);
  ASSERT_THAT(missing, IsOk());
  EXPECT_THAT(*missing, ::testing::ElementsAre(HasSubstr("no cgroup")));
}

TEST_F(ContainmentTest, WithoutRipsInspectNothingRuns) {
  EXPECT_THAT(ProbeContainment({.helpers = dir_}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("/rips-inspect`: No such file or directory")));
}

TEST_F(ContainmentTest, AProgramThatItsUserCannotReadIsNamed) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "becoming another user needs all of root's rights";
  chmod((dir_ + "/bundle").c_str(), 0700);
  EXPECT_THAT(ChildProcess::StartPlugin(dir_ + "/bundle/plugins/p", dir_ + "/bundle", {},
                                        {.helpers = helpers_, .ids = kPluginIds}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("user 54322, whom plugins run as, must be able to read it")));
}

}  // namespace
}  // namespace rips::inspect
