#include "policy_server/server/plugin_jail.h"

#include <pwd.h>
#include <unistd.h>

#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"

namespace rips::server {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;

ServerConfig ConfigOf(const std::string& plugin_user) {
  ServerConfig config;
  config.store_path = absl::StrCat(::testing::TempDir(), "/plugin_jail", getpid(), "/state.db");
  config.plugin_user = plugin_user;
  return config;
}

TEST(PluginJailTest, PluginsOfRootRunAsTheUserThatIsNamed) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root";
  const auto jail = MakePluginJail(ConfigOf("54322"));
  ASSERT_THAT(jail, IsOk());
  ASSERT_TRUE(jail->containment.ids.has_value());
  EXPECT_EQ(jail->containment.ids->uid, 54'322u);
  EXPECT_EQ(jail->containment.ids->gid, 54'322u);
  EXPECT_THAT(jail->missing, Not(Contains(HasSubstr("plugins and scans run as"))));
}

TEST(PluginJailTest, WithoutANameTheirUserIsNotRootsAndOneOfOthersIsTold) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root";
  const auto jail = MakePluginJail(ConfigOf(""));
  ASSERT_THAT(jail, IsOk());
  ASSERT_TRUE(jail->containment.ids.has_value());
  EXPECT_NE(jail->containment.ids->uid, 0u);
  const auto told = Contains(HasSubstr("plugins and scans run as `nobody`"));
  if (getpwnam(kPluginUser) == nullptr) {
    EXPECT_THAT(jail->missing, told);
  } else {
    EXPECT_THAT(jail->missing, Not(told));
  }
}

TEST(PluginJailTest, RootAndUnknownUsersAreRefused) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root";
  for (const char* user : {"0", "root", "no-such-user"}) {
    EXPECT_THAT(MakePluginJail(ConfigOf(user)),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("plugins.user: ")))
        << user;
  }
}

TEST(PluginJailTest, OfAServerThatIsNotRootItIsToldThatTheyHaveNoUserOfTheirOwn) {
  if (geteuid() == 0) GTEST_SKIP() << "root has one for them";
  const auto jail = MakePluginJail(ConfigOf("54322"));
  ASSERT_THAT(jail, IsOk());
  EXPECT_FALSE(jail->containment.ids.has_value());
  EXPECT_THAT(jail->missing, Contains(HasSubstr("not root: ")));
}

TEST(PluginJailTest, WhereThereAreCgroupsTheyAreUsed) {
  if (geteuid() == 0 && !RootMay({CAP_SETGID, CAP_SETUID})) {
    GTEST_SKIP() << "becoming the user of plugins needs CAP_SETGID and CAP_SETUID";
  }
  const auto jail = MakePluginJail(ConfigOf(geteuid() == 0 ? "54322" : ""));
  ASSERT_THAT(jail, IsOk());
  EXPECT_EQ(jail->containment.cgroups, jail->cgroups.get());
  const auto told = Contains(HasSubstr("no cgroup"));
  if (jail->cgroups == nullptr) {
    EXPECT_THAT(jail->missing, told);
  } else {
    EXPECT_THAT(jail->missing, Not(told));
  }
}

}  // namespace
}  // namespace rips::server
