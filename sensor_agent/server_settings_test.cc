#include "sensor_agent/server_settings.h"

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/ids.h"

namespace rips::sensor {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

class ServerSettingsTest : public testing::Test {
 protected:
  ServerSettingsTest() { std::filesystem::create_directories(dir_); }
  ~ServerSettingsTest() override { std::filesystem::remove_all(dir_); }

  const std::filesystem::path dir_ =
      std::filesystem::temp_directory_path() / absl::StrCat("rips-server-settings-", NewId());
  const std::string file_ = ServerSettingsFile(dir_.string());
};

TEST_F(ServerSettingsTest, AreKeptForTheNextProcess) {
  ServerSettings settings(file_);
  EXPECT_THAT(settings.Get(), IsEmpty());
  settings.Offer({{"settle", "3s", "robots.yaml:4"}, {"unwatched", "[\"/a\"]", "robots.yaml:5"}});
  const std::vector<ConfigSetting> expected = {
      {"settle", "3s", "policy server, robots.yaml:4"},
      {"unwatched", "[\"/a\"]", "policy server, robots.yaml:5"}};
  EXPECT_EQ(settings.Get(), expected);
  EXPECT_EQ(ServerSettings(file_).Get(), expected);

  settings.Offer({});
  EXPECT_THAT(ServerSettings(file_).Get(), IsEmpty()) << "the server sets nothing any more";
}

TEST_F(ServerSettingsTest, DifferInWhatTheySetAndNotInWhereItStands) {
  ServerSettings settings(file_);
  const std::vector<ConfigSetting> none = settings.Get();
  settings.Offer({{"settle", "3s", "robots.yaml:4"}});
  EXPECT_TRUE(settings.Differ(none));
  const std::vector<ConfigSetting> followed = settings.Get();
  settings.Offer({{"settle", "3s", "robots.yaml:9"}});
  EXPECT_FALSE(settings.Differ(followed));
  EXPECT_THAT(ServerSettings(file_).Get(),
              ElementsAre(ConfigSetting{"settle", "3s", "policy server, robots.yaml:9"}));
  settings.Offer({{"settle", "4s", "robots.yaml:9"}});
  EXPECT_TRUE(settings.Differ(followed));
}

TEST_F(ServerSettingsTest, AFileThatCannotBeUsedCountsAsNone) {
  for (const std::string& bytes : {std::string("\xff\xff not ours"), std::string(1 << 20, 'x')}) {
    std::ofstream(file_) << bytes;
    EXPECT_THAT(ServerSettings(file_).Get(), IsEmpty());
  }
  std::filesystem::remove(file_);
  std::filesystem::create_directory(file_);
  ServerSettings settings(file_);
  settings.Offer({{"settle", "3s", "robots.yaml:4"}});
  EXPECT_EQ(settings.Get().size(), 1u) << "followed by this process all the same";
}

}  // namespace
}  // namespace rips::sensor
