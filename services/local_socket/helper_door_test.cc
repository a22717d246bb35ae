#include "services/local_socket/helper_door.h"

#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"
#include "services/local_socket/helper_socket.h"

namespace rips::actuator {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr uid_t kNobody = 65534;
constexpr uid_t kOther = 65533;
constexpr auto kDenied = absl::StatusCode::kPermissionDenied;

// A process of user `uid` that listens at `path` until it is deleted, and answers nothing.
class Impostor {
 public:
  Impostor(const std::string& path, uid_t uid) {
    int ready[2];
    EXPECT_EQ(pipe(ready), 0);
    child_ = fork();
    if (child_ == 0) Listen(path, uid, ready[1]);
    close(ready[1]);
    char byte = 0;
    EXPECT_EQ(read(ready[0], &byte, 1), 1) << "the impostor does not listen";
    close(ready[0]);
  }
  ~Impostor() {
    kill(child_, SIGKILL);
    waitpid(child_, nullptr, 0);
  }

 private:
  [[noreturn]] static void Listen(const std::string& path, uid_t uid, int ready) {
    sockaddr_un address = {};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
    const int fd = socket(AF_UNIX, SOCK_SEQPACKET, 0);
    if (setresuid(uid, uid, uid) != 0 ||
        bind(fd, reinterpret_cast<sockaddr*>(&address), sizeof(address)) != 0 ||
        chmod(path.c_str(), 0777) != 0 || listen(fd, 8) != 0 || write(ready, "x", 1) != 1) {
      _exit(1);
    }
    while (true) pause();
  }

  pid_t child_ = -1;
};

class HelperDoorTest : public testing::Test {
 protected:
  HelperDoorTest() {
    std::string pattern = "/tmp/rips_door_XXXXXX";
    directory_ = mkdtemp(pattern.data());
    path_ = directory_ + "/exec.sock";
  }
  ~HelperDoorTest() override { std::filesystem::remove_all(directory_); }
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "only root can play another user";
  }
  HelperDoor Door(std::optional<uid_t> run_as = std::nullopt) {
    return HelperDoor(path_, "rips-exec", run_as);
  }

  std::string directory_;
  std::string path_;
};

TEST_F(HelperDoorTest, NothingThereIsNoDanger) {
  EXPECT_THAT(Door().Check(), IsOk());
  EXPECT_THAT(Door().Connect(), StatusIs(absl::StatusCode::kUnavailable));
}

TEST_F(HelperDoorTest, OursAndRootsAreTrusted) {
  const auto listener = ListenAt(path_, geteuid());
  ASSERT_THAT(listener, IsOk());
  const HelperDoor door = Door();
  EXPECT_THAT(door.Connect(), IsOk());
  EXPECT_THAT(door.Check(), IsOk());
}

TEST_F(HelperDoorTest, AnotherUsersSocketIsRefusedBeforeItIsAsked) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "playing another user needs all of root's rights";
  ASSERT_EQ(chmod(directory_.c_str(), 01777), 0);
  const Impostor impostor(path_, kOther);
  for (const std::optional<uid_t> run_as : {std::optional<uid_t>(), std::optional(kNobody)}) {
    const HelperDoor door = Door(run_as);
    EXPECT_THAT(door.Check(), StatusIs(kDenied, AllOf(HasSubstr("rips-exec: `" + path_),
                                                      HasSubstr("it belongs to user 65533"))));
    EXPECT_THAT(door.Connect(), StatusIs(kDenied, HasSubstr("it belongs to user 65533")));
  }
}

TEST_F(HelperDoorTest, TheUserWhomTheHelperRunsAsIsTrusted) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "playing another user needs all of root's rights";
  ASSERT_EQ(chmod(directory_.c_str(), 01777), 0);
  const Impostor helper(path_, kNobody);
  EXPECT_THAT(Door(kNobody).Connect(), IsOk());
  EXPECT_THAT(Door(kNobody).Check(), IsOk());
}

// Its file was given away: only the kernel knows who listens.
TEST_F(HelperDoorTest, WhoListensCountsWhateverTheFileSays) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "playing another user needs all of root's rights";
  ASSERT_EQ(chmod(directory_.c_str(), 01777), 0);
  const HelperDoor door = Door();
  {
    const Impostor impostor(path_, kOther);
    ASSERT_EQ(chown(path_.c_str(), 0, 0), 0);
    EXPECT_THAT(door.Check(), IsOk()) << "the files say nothing against it";
    EXPECT_THAT(door.Connect(), StatusIs(kDenied, HasSubstr("user 65533 listens there")));
    EXPECT_THAT(door.Check(), StatusIs(kDenied)) << "and it is remembered";
  }
  ASSERT_EQ(unlink(path_.c_str()), 0);
  const auto listener = ListenAt(path_, geteuid());
  ASSERT_THAT(listener, IsOk());
  EXPECT_THAT(door.Connect(), IsOk());
  EXPECT_THAT(door.Check(), IsOk()) << "until the right one is there";
}

TEST_F(HelperDoorTest, ALinkIsNotFollowed) {
  const std::string real = directory_ + "/real.sock";
  const auto listener = ListenAt(real, geteuid());
  ASSERT_THAT(listener, IsOk());
  ASSERT_EQ(symlink(real.c_str(), path_.c_str()), 0);
  EXPECT_THAT(Door().Connect(), StatusIs(kDenied, HasSubstr("it is no socket")));
}

TEST_F(HelperDoorTest, ADirectoryInWhichOthersReplaceFilesIsRefused) {
  if (!RootMayActForOthers()) GTEST_SKIP() << "playing another user needs all of root's rights";
  const auto listener = ListenAt(path_, geteuid());
  ASSERT_THAT(listener, IsOk());
  for (const mode_t mode : {0777, 0775, 0757}) {
    ASSERT_EQ(chmod(directory_.c_str(), mode), 0);
    EXPECT_THAT(Door().Connect(), StatusIs(kDenied, HasSubstr("which is not sticky")));
  }
  ASSERT_EQ(chmod(directory_.c_str(), 01775), 0);
  EXPECT_THAT(Door().Connect(), IsOk());
  ASSERT_EQ(chown(directory_.c_str(), kOther, kOther), 0);
  EXPECT_THAT(Door().Connect(), StatusIs(kDenied, HasSubstr("belongs to user 65533")));
}

TEST(HelperUserTest, AConfiguredUserMustExist) {
  EXPECT_THAT(FindHelperUser("no-such-user", "root", "exec.run_as"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("exec.run_as: no user")));
  EXPECT_EQ(*FindHelperUser("4711", "root", "exec.run_as"), std::optional<uid_t>(4711));
  EXPECT_EQ(*FindHelperUser("", "root", "exec.run_as"), std::optional<uid_t>(0));
  EXPECT_EQ(*FindHelperUser("", "no-such-user", "exec.run_as"), std::nullopt);
}

}  // namespace
}  // namespace rips::actuator
