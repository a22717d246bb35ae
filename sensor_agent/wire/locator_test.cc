#include "sensor_agent/wire/locator.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::wire {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

Locator Parsed(absl::string_view text) {
  const std::vector<Locator> locators = ParseLocators(absl::StrCat("udp/", text));
  EXPECT_EQ(locators.size(), 1) << text;
  return locators.empty() ? Locator{} : locators.front();
}

std::vector<std::string> Texts(absl::string_view text) {
  std::vector<std::string> texts;
  for (const Locator& each : ParseLocators(text)) texts.push_back(ToString(each));
  return texts;
}

TEST(LocatorTest, TheFirstAddressIsOneThatOthersReach) {
  EXPECT_EQ(FirstAddress("udp/239.255.0.1:7401@1,udp/127.0.0.1:7@1,udp/10.0.0.2:41234@1"),
            "10.0.0.2");
  EXPECT_EQ(FirstAddress("udp6/[fd00::7]:7411@2,udp/10.0.0.2:7"), "fd00::7");
  EXPECT_EQ(FirstAddress("udp/239.255.0.1:7401@1,udp/127.0.0.1:7@1"), "127.0.0.1");
  EXPECT_EQ(FirstAddress("udp/239.255.0.1:7401@1"), "");
  EXPECT_EQ(FirstAddress("tcp/10.0.0.2:7,\x1b[2J"), "");
}

TEST(LocatorTest, ReadsWhatTheMiddlewarePrints) {
  EXPECT_THAT(Texts("udp/239.255.0.1:7401@1,udp/10.0.0.2:41234@1"),
              ElementsAre("239.255.0.1:7401", "10.0.0.2:41234"));
  EXPECT_THAT(Texts("udp6/[fe80::1%eth0]:7411@2,udp/[::ffff:10.0.0.2]:7"),
              ElementsAre("[fe80::1]:7411", "10.0.0.2:7"));
  EXPECT_THAT(Texts("localprocess"), IsEmpty());
  EXPECT_THAT(Texts(""), IsEmpty());
}

TEST(LocatorTest, LeavesOutWhatIsNoLocator) {
  for (const char* text :
       {"udp/", "udp/10.0.0.2", "udp/10.0.0.2:", "udp/10.0.0.2:65536", "udp/10.0.0.2:-1",
        "udp/10.0.0.256:1", "udp/[10.0.0.2:1", "udp/host:1", "tcp/10.0.0.2:7400", "shm/1", ",,,"}) {
    EXPECT_THAT(Texts(text), IsEmpty()) << text;
  }
  EXPECT_THAT(Texts("tcp/1.2.3.4:1,udp/10.0.0.2:65535"), ElementsAre("10.0.0.2:65535"));
}

TEST(LocatorTest, KeepsTheFirstLocatorsOnly) {
  std::string text;
  for (size_t i = 0; i < kAdvertisedMax + 1; ++i) absl::StrAppend(&text, "udp/10.0.0.2:", i, ",");

  EXPECT_EQ(ParseLocators(text).size(), kAdvertisedMax);
}

TEST(LocatorTest, KnowsKindsOfAddresses) {
  EXPECT_TRUE(Parsed("239.255.0.1:1").address.multicast());
  EXPECT_TRUE(Parsed("[ff02::1]:1").address.multicast());
  EXPECT_FALSE(Parsed("240.0.0.1:1").address.multicast());
  EXPECT_FALSE(Parsed("[fe80::1]:1").address.multicast());
  EXPECT_TRUE(Parsed("127.0.0.2:1").address.loopback());
  EXPECT_TRUE(Parsed("[::1]:1").address.loopback());
  EXPECT_FALSE(Parsed("10.0.0.1:1").address.loopback());
  EXPECT_FALSE(Parsed("[fe80::1]:1").address.loopback());
  EXPECT_TRUE(Parsed("10.0.0.1:1").address.v4());
  EXPECT_FALSE(Parsed("[fe80::1]:1").address.v4());
}

}  // namespace
}  // namespace rips::wire
