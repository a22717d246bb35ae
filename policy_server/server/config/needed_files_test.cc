#include "policy_server/server/config/needed_files.h"

#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "services/base/status_matchers.h"

namespace rips::server {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class NeededFilesTest : public ::testing::Test {
 protected:
  // All of it below `root`.
  static ServerConfig Below(const std::string& root) {
    ServerConfig config;
    config.bundles_source = root;
    config.bundles_dir = "/no/such/bundles";  // made by the server, with all above it
    config.store_path = absl::StrCat(root, "/state.db");
    config.alerts.path = absl::StrCat(root, "/alerts.jsonl");
    config.audit_dir = absl::StrCat(root, "/audit");
    config.recordings_dir = absl::StrCat(root, "/recordings");
    return config;
  }
};

TEST_F(NeededFilesTest, AreDirectoriesThatTheServerDoesNotMake) {
  EXPECT_THAT(CheckNeededDirectories("ps.yaml", Below(::testing::TempDir())), IsOk());
}

TEST_F(NeededFilesTest, EachMissingDirectoryIsNamedWithItsKey) {
  EXPECT_THAT(
      CheckNeededDirectories("ps.yaml", Below("/no/such")),
      StatusIs(absl::StatusCode::kInvalidArgument,
               AllOf(HasSubstr("ps.yaml: `bundles.source` needs the directory `/no/such`"),
                     HasSubstr("`store.path` needs the directory `/no/such`, which does not exist"),
                     HasSubstr("`alerts.file`"), HasSubstr("`audit.dir`"),
                     HasSubstr("`recordings.dir`"))));
}

TEST_F(NeededFilesTest, WhatIsNotKeptNeedsNoDirectory) {
  ServerConfig config = Below("/no/such");
  config.audit_dir.clear();
  config.recordings_bytes = 0;
  EXPECT_THAT(CheckNeededDirectories("ps.yaml", config),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(Not(HasSubstr("audit.dir")), Not(HasSubstr("recordings.dir")))));
}

TEST_F(NeededFilesTest, AnAlertFileThatIsRotatedIsNoLink) {
  ServerConfig config = Below(::testing::TempDir());
  config.alerts.path = absl::StrCat(::testing::TempDir(), "/rips-needed-link.jsonl");
  std::filesystem::remove(config.alerts.path);
  std::filesystem::create_symlink("/dev/null", config.alerts.path);
  EXPECT_THAT(CheckNeededDirectories("ps.yaml", config), IsOk());
  config.alerts.rotate_bytes = 1 << 20;
  EXPECT_THAT(CheckNeededDirectories("ps.yaml", config),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("symbolic link")));
  std::filesystem::remove(config.alerts.path);
}

}  // namespace
}  // namespace rips::server
