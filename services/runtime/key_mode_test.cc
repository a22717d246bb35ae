#include "services/runtime/key_mode.h"

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr uid_t kDaemon = 10'443;
constexpr gid_t kOtherGroup = 100;
constexpr char kKey[] = "/etc/rips/pki/sensor/key.pem";

struct Judged {
  absl::Status status;
  std::string warning;
};

Judged Judge(mode_t mode, uid_t owner, gid_t group, const std::string& path = kKey,
             const KeyUser& user = {.user = kDaemon, .groups = {7, kDaemon}}) {
  struct stat info = {};
  info.st_mode = S_IFREG | mode;
  info.st_uid = owner;
  info.st_gid = group;
  Judged judged;
  judged.status = JudgeKeyMode(path, info, user, &judged.warning);
  return judged;
}

auto Refuses(const std::string& part) {
  return StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr(part));
}

TEST(KeyModeTest, ADaemonAndItsGroupsMayReadIt) {
  for (const mode_t mode : {0400, 0600, 0640, 0440, 0660}) {
    EXPECT_THAT(Judge(mode, kDaemon, kDaemon).status, IsOk()) << mode;
    EXPECT_THAT(Judge(mode, 0, 7).status, IsOk()) << mode << ", fsGroup of Kubernetes";
  }
}

TEST(KeyModeTest, OtherUsersMayNot) {
  for (const mode_t mode : {0644, 0604, 0602, 0601, 0444, 0777, 04'644}) {
    EXPECT_THAT(Judge(mode, kDaemon, kDaemon).status,
                Refuses("`chmod o-rwx /etc/rips/pki/sensor/key.pem`"))
        << mode;
  }
  EXPECT_THAT(Judge(0644, kDaemon, kDaemon).status,
              Refuses("private key `/etc/rips/pki/sensor/key.pem` is open to other users (mode "
                      "0644)"));
}

TEST(KeyModeTest, AnotherGroupMayNot) {
  for (const mode_t mode : {0640, 0440, 0620, 0610}) {
    EXPECT_THAT(Judge(mode, kDaemon, kOtherGroup).status, Refuses("`chmod go-rwx ")) << mode;
  }
  EXPECT_THAT(Judge(0600, kDaemon, kOtherGroup).status, IsOk());
  EXPECT_THAT(Judge(0640, 0, kOtherGroup).status, IsOk())
      << "it cannot be read, which is told then";
}

TEST(KeyModeTest, TheRemedyLeavesTheDaemonItsKey) {
  EXPECT_THAT(Judge(0644, 0, kDaemon).status, Refuses("`chmod o-rwx ")) << "read by its group";
  const KeyUser root = {.user = 0, .groups = {0}};
  EXPECT_THAT(Judge(0644, 0, kDaemon, kKey, root).status, Refuses("`chmod o-rwx "));
  EXPECT_THAT(Judge(0644, 0, 0, kKey, root).status, Refuses("`chmod o-rwx "));
  EXPECT_THAT(Judge(0644, 0, kOtherGroup).status,
              Refuses(absl::StrCat("`chown ", kDaemon, " ", kKey, "; chmod 600 ", kKey, "`")))
      << "read by all alone";
}

TEST(KeyModeTest, RootChecksForADaemonOfAnotherGroup) {
  EXPECT_THAT(Judge(0640, 0, kDaemon, kKey, {.user = 0, .groups = {0}}).status, IsOk());
}

TEST(KeyModeTest, ASecretOfAContainerIsAWarning) {
  for (const char* path : {"/run/secrets/key.pem", "/var/run/secrets/rips/key.pem"}) {
    const Judged judged = Judge(0444, 0, 0, path);
    EXPECT_THAT(judged.status, IsOk()) << path;
    EXPECT_THAT(judged.warning, AllOf(HasSubstr(path), HasSubstr("(mode 0444)")));
  }
  EXPECT_THAT(Judge(0400, kDaemon, 0, "/run/secrets/key.pem").warning, IsEmpty());
  for (const char* path : {"/run/secrets/../key.pem", "/run/secretsmore/key.pem",
                           "/tmp/run/secrets/key.pem", "/run/secrets"}) {
    EXPECT_THAT(Judge(0444, 0, 0, path).status, Refuses(path)) << path;
  }
}

TEST(KeyModeTest, LooksAtTheFileThatALinkNames) {
  const std::filesystem::path directory =
      std::filesystem::temp_directory_path() / ("key-mode-" + std::to_string(getpid()));
  ASSERT_TRUE(std::filesystem::create_directory(directory));
  const std::string key = directory / "key.pem";
  const std::string link = directory / "link.pem";
  std::ofstream(key) << "key";
  ASSERT_EQ(chmod(key.c_str(), 0600), 0);
  ASSERT_EQ(symlink(key.c_str(), link.c_str()), 0);
  std::string warning;
  EXPECT_THAT(CheckKeyMode(link, &warning), IsOk());
  ASSERT_EQ(chmod(key.c_str(), 0644), 0);
  EXPECT_THAT(CheckKeyMode(link, &warning), Refuses(link));
  EXPECT_THAT(CheckKeyMode(directory, &warning), IsOk()) << "no file; reading it says so";
  EXPECT_THAT(CheckKeyMode(directory / "none", &warning), IsOk());
  EXPECT_THAT(warning, IsEmpty());
  std::filesystem::remove_all(directory);
}

}  // namespace
}  // namespace rips
