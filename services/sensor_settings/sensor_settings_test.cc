#include "services/sensor_settings/sensor_settings.h"

#include <algorithm>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips {
namespace {

TEST(SensorSettingsTest, EveryOneThatIsReadCanBeGivenToTheServer) {
  ConfigReader reader("sensor.yaml", "");
  SensorSettings settings;
  ReadSensorSettings(reader.root(), settings);
  ASSERT_THAT(reader.Finish(), IsOk());
  EXPECT_EQ(settings, SensorSettings()) << "defaults are those of the struct";
  for (const ConfigSetting& each : reader.Settings()) {
    EXPECT_TRUE(std::any_of(SettableNames().begin(), SettableNames().end(), [&](const auto& name) {
      return IsSettingOf(each.path, name);
    })) << each.path;
  }
  for (const std::string& name : SettableNames()) {
    EXPECT_TRUE(std::any_of(reader.Settings().begin(), reader.Settings().end(),
                            [&](const auto& each) { return IsSettingOf(each.path, name); }))
        << name;
  }
}

TEST(SensorSettingsTest, ANameCoversItselfAndWhatIsBelowIt) {
  EXPECT_TRUE(IsSettingOf("settle", "settle"));
  EXPECT_TRUE(IsSettingOf("graph_limits.nodes", "graph_limits"));
  EXPECT_FALSE(IsSettingOf("graph_limits", "graph_limits.nodes"));
  EXPECT_FALSE(IsSettingOf("settles", "settle"));
  EXPECT_FALSE(IsSettingOf("", "settle"));
}

}  // namespace
}  // namespace rips
