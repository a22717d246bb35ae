#include "services/enrol/key_folder.h"

#include <stdlib.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"
#include "services/runtime/atomic_file.h"

namespace rips::enrol {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

std::string Content(const std::string& path) { return ReadFile(path, 1 << 20).value_or(""); }

class KeyFolderTest : public ::testing::Test {
 protected:
  KeyFolderTest() {
    char name[] = "/tmp/rips-keys-XXXXXX";
    EXPECT_NE(mkdtemp(name), nullptr);
    root_ = name;
    folder_.emplace(root_ + "/sensor");
  }
  ~KeyFolderTest() override { fs::remove_all(root_); }
  KeyFiles Files(const std::string& mark) {
    return {.ca_pem = "ca " + mark,
            .certificates_pem = "cert " + mark,
            .key_pem = "key " + mark,
            .server = "policy.example:7443\n"};
  }
  size_t Versions() {
    size_t count = 0;
    for (const auto& each : fs::directory_iterator(folder_->path() + "/versions")) {
      count += each.is_directory() ? 1 : 0;
    }
    return count;
  }

  std::string root_;
  std::optional<KeyFolder> folder_;
};

TEST_F(KeyFolderTest, AllThreeFilesChangeWithOneLink) {
  ASSERT_THAT(folder_->Lock(), IsOk());
  ASSERT_THAT(folder_->Install(Files("1")), IsOk());
  const TlsFiles tls = folder_->tls();
  EXPECT_EQ(Content(tls.ca), "ca 1");
  EXPECT_EQ(Content(tls.cert), "cert 1");
  EXPECT_EQ(Content(tls.key), "key 1");
  EXPECT_EQ(folder_->Server(), "policy.example:7443");
  for (const std::string& path : {tls.ca, tls.cert, tls.key}) {
    EXPECT_EQ(fs::read_symlink(path).parent_path(), "current") << path;
  }
  struct stat info {};
  ASSERT_EQ(stat(tls.key.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 07777, 0640u);

  for (const char* mark : {"2", "3", "4"}) ASSERT_THAT(folder_->Install(Files(mark)), IsOk());
  EXPECT_EQ(Content(tls.key), "key 4");
  EXPECT_EQ(Versions(), 2u) << "the one before is kept";
}

TEST_F(KeyFolderTest, TakesThePlaceOfFilesThatWereMadeByHand) {
  ASSERT_THAT(folder_->Lock(), IsOk());
  std::ofstream(folder_->tls().cert) << "by hand";
  ASSERT_THAT(folder_->Install(Files("1")), IsOk());
  EXPECT_EQ(Content(folder_->tls().cert), "cert 1");
}

TEST_F(KeyFolderTest, TheGroupOfTheFolderMayReadTheKey) {
  if (!RootMay({CAP_CHOWN})) GTEST_SKIP() << "giving files away needs CAP_CHOWN";
  ASSERT_THAT(folder_->Lock(), IsOk());
  ASSERT_EQ(chown(folder_->path().c_str(), 0, 12'345), 0);
  ASSERT_THAT(folder_->Install(Files("1")), IsOk());
  struct stat info {};
  ASSERT_EQ(stat(folder_->tls().key.c_str(), &info), 0);
  EXPECT_EQ(info.st_gid, 12'345u);
}

TEST_F(KeyFolderTest, TheAgentGetsThroughWhateverTheUmaskIs) {
  const mode_t before = umask(0077);
  ASSERT_THAT(folder_->Lock(), IsOk());
  ASSERT_THAT(folder_->Install(Files("1")), IsOk());
  umask(before);
  const std::string version = fs::canonical(folder_->path() + "/current");
  for (const std::string& path : {folder_->path(), folder_->path() + "/versions", version}) {
    struct stat info {};
    ASSERT_EQ(stat(path.c_str(), &info), 0);
    EXPECT_EQ(info.st_mode & 07777, 0750u) << path;
  }
}

TEST_F(KeyFolderTest, RemovesWhatAKilledProcessLeftAndNothingElse) {
  ASSERT_THAT(folder_->Lock(), IsOk());
  fs::create_directory(folder_->path() + "/.token-Ab12");
  std::ofstream(folder_->path() + "/.token-Ab12/key.pem") << "secret";
  std::ofstream(folder_->path() + "/mine") << "x";
  ASSERT_THAT(folder_->Lock(), IsOk());
  EXPECT_FALSE(fs::exists(folder_->path() + "/.token-Ab12"));
  EXPECT_TRUE(fs::exists(folder_->path() + "/mine"));
}

TEST_F(KeyFolderTest, ALinkThatLeadsNowhereIsNoMissingCertificate) {
  ASSERT_THAT(folder_->Lock(), IsOk());
  EXPECT_FALSE(folder_->HasCertificate());
  ASSERT_THAT(folder_->Install(Files("1")), IsOk());
  fs::remove_all(folder_->path() + "/versions");
  EXPECT_TRUE(folder_->HasCertificate());
  EXPECT_EQ(folder_->Holder(), "");
}

TEST_F(KeyFolderTest, AKeyStaysPendingUntilItsCertificateIsInstalled) {
  ASSERT_THAT(folder_->Lock(), IsOk());
  const auto key = folder_->PendingKey();
  ASSERT_THAT(key, IsOk());
  EXPECT_EQ(*folder_->PendingKey(), *key);
  std::ofstream(folder_->path() + "/pending.pem") << key->substr(0, 40);
  const auto other = folder_->PendingKey();
  ASSERT_THAT(other, IsOk()) << "one that was cut is replaced";
  EXPECT_NE(*other, *key);
  ASSERT_THAT(folder_->Install(Files("1")), IsOk());
  EXPECT_NE(*folder_->PendingKey(), *other);
}

TEST_F(KeyFolderTest, IsLockedAndNeverSharedWithOthers) {
  const auto lock = folder_->Lock();
  ASSERT_THAT(lock, IsOk());
  EXPECT_THAT(folder_->Lock(),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("another process")));
  const KeyFolder open(root_ + "/open");
  ASSERT_THAT(open.Lock(), IsOk());
  ASSERT_EQ(chmod(open.path().c_str(), 0777), 0);
  EXPECT_THAT(open.Lock(), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("others")));
  ASSERT_EQ(chmod(open.path().c_str(), 0770), 0);
  EXPECT_THAT(open.Lock(), StatusIs(absl::StatusCode::kFailedPrecondition)) << "by its group";
  ASSERT_EQ(chmod(open.path().c_str(), 0750), 0);
  EXPECT_THAT(open.Lock(), IsOk());
  if (RootMay({CAP_CHOWN})) {
    ASSERT_EQ(chown(open.path().c_str(), 4'242, 4'242), 0);
    EXPECT_THAT(open.Lock(),
                StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("belongs to user 4242")));
  }
  std::ofstream(root_ + "/file") << "x";
  EXPECT_FALSE(KeyFolder(root_ + "/file").Lock().ok());
  EXPECT_FALSE(KeyFolder(root_ + "/none/sensor").Lock().ok());
}

TEST_F(KeyFolderTest, WithoutFilesThereIsNoServer) { EXPECT_EQ(folder_->Server(), ""); }

}  // namespace
}  // namespace rips::enrol
