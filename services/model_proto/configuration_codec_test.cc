#include "services/model_proto/configuration_codec.h"

#include <limits>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::model_proto {
namespace {

using testing::EndsWith;
using testing::SizeIs;
using Settings = std::vector<ConfigSetting>;

size_t TextBytes(const rips::v1::Configuration& configuration) {
  size_t bytes = 0;
  for (const rips::v1::Setting& each : configuration.settings()) {
    bytes += each.path().size() + each.value().size() + each.source().size();
  }
  return bytes;
}

TEST(ConfigurationCodecTest, KeepsOrderValuesAndSources) {
  const rips::v1::Configuration out =
      Encode(Settings{{"robot", "\"r1\"", "/etc/rips/sensor.yaml:1"}, {"settle", "2s", ""}});
  ASSERT_THAT(out.settings(), SizeIs(2));
  EXPECT_EQ(out.settings(0).path(), "robot");
  EXPECT_EQ(out.settings(0).value(), "\"r1\"");
  EXPECT_EQ(out.settings(0).source(), "/etc/rips/sensor.yaml:1");
  EXPECT_EQ(out.settings(1).source(), "");
  EXPECT_EQ(out.left_out(), 0u);
}

TEST(ConfigurationCodecTest, IsBoundedInNumberInBytesAndEachText) {
  const rips::v1::Configuration many = Encode(Settings(kSettingsMax + 5));
  EXPECT_THAT(many.settings(), SizeIs(kSettingsMax));
  EXPECT_EQ(many.left_out(), 5u);

  const ConfigSetting large{std::string(5'000, 'p'), std::string(5'000, 'v'),
                            std::string(5'000, 's')};
  Settings settings(20, large);
  settings.push_back({"small", "1", ""});
  const rips::v1::Configuration out = Encode(settings);
  EXPECT_THAT(out.settings(0).path(), SizeIs(kSettingPathBytesMax));
  EXPECT_THAT(out.settings(0).value(), SizeIs(kSettingTextBytesMax));
  EXPECT_THAT(out.settings(0).source(), EndsWith("..."));
  EXPECT_LE(TextBytes(out), kConfigurationBytesMax);
  EXPECT_EQ(out.settings_size() + static_cast<int>(out.left_out()), 21);
  EXPECT_NE(out.settings(out.settings_size() - 1).path(), "small") << "no gaps in what stands";
}

TEST(ConfigurationCodecTest, WhatIsRefusedIsBoundedToo) {
  const std::vector<std::string> many(kRefusedMax + 5, "x");
  EXPECT_THAT(Encode({}, many).refused(), SizeIs(kRefusedMax));
  const std::vector<std::string> large(kRefusedMax, std::string(5'000, 'x'));
  const rips::v1::Configuration out = Encode({{"settle", "2s", ""}}, large);
  EXPECT_THAT(out.refused(), SizeIs(kConfigurationBytesMax / kSettingTextBytesMax));
  EXPECT_THAT(out.refused(0), SizeIs(kSettingTextBytesMax));
  EXPECT_EQ(out.left_out(), 1u) << "no room is left for a setting";

  rips::v1::Configuration hostile;
  for (size_t i = 0; i < kRefusedMax; ++i) hostile.add_refused(std::string(5'000, 'x'));
  EXPECT_LE(Bounded(hostile).ByteSizeLong(), 2 * kConfigurationBytesMax);
}

TEST(ConfigurationCodecTest, ComesBackAsItWas) {
  const Settings settings = {{"settle", "2s", "robots.yaml:4"}, {"unwatched", "[\"/a\"]", ""}};
  EXPECT_EQ(Decode(Encode(settings)), settings);
}

TEST(ConfigurationCodecTest, BytesThatAreNotUtf8AreEscaped) {
  const rips::v1::Configuration out = Encode(Settings{{"scripts", "\"/caf\xe9\"", "/caf\xe9:3"}});
  EXPECT_EQ(out.settings(0).value(), "\"/caf\\xe9\"");
  EXPECT_EQ(out.settings(0).source(), "/caf\\xe9:3");
  rips::v1::Configuration read;
  EXPECT_TRUE(read.ParseFromString(out.SerializeAsString()));
}

TEST(ConfigurationCodecTest, WhatAPeerSentIsBoundedLikewise) {
  rips::v1::Configuration sent;
  for (int i = 0; i < 600; ++i) sent.add_settings()->set_path(std::string(300, 'p'));
  sent.set_left_out(std::numeric_limits<uint32_t>::max() - 3);
  const rips::v1::Configuration out = Bounded(sent);
  EXPECT_LE(TextBytes(out), kConfigurationBytesMax);
  EXPECT_EQ(out.left_out(), std::numeric_limits<uint32_t>::max());
  EXPECT_EQ(Bounded(out).SerializeAsString(), out.SerializeAsString());
  EXPECT_EQ(Bounded({}).settings_size(), 0);
}

}  // namespace
}  // namespace rips::model_proto
