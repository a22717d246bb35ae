#include "services/dds/address_watch.h"

#include <algorithm>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::dds {
namespace {

using ::testing::IsEmpty;

InterfaceAddress Of(const std::string& interface, uint32_t index, const std::string& address) {
  return {.interface = interface,
          .index = index,
          .address = address,
          .ipv6 = address.find(':') != std::string::npos,
          .loopback = interface == "lo",
          .link_local = address.rfind("fe80:", 0) == 0,
          .multicast = interface != "lo"};
}

const InterfaceAddress kLo = Of("lo", 1, "127.0.0.1");
const InterfaceAddress kEth = Of("eth0", 2, "10.0.0.2");
const InterfaceAddress kEthMoved = Of("eth0", 2, "10.0.0.3");
const InterfaceAddress kEthAgain = Of("eth0", 9, "10.0.0.2");
const InterfaceAddress kWlan = Of("wlan0", 3, "10.1.0.4");
const InterfaceAddress kDocker = Of("docker0", 4, "172.17.0.1");

using Host = std::vector<InterfaceAddress>;

class AddressWatchTest : public testing::Test {
 protected:
  // A look a second until it is over, or begins again. Seconds until then, or -1.
  int Seconds(const Host& host, int seconds = 120) {
    for (int i = 1; i <= seconds; ++i) {
      if (Look(host)) return i;
    }
    return -1;
  }
  bool Look(const Host& host) {
    now_ns_ += AddressWatch::kLookNs;
    return watch_.Look(in_use_, host, now_ns_);
  }
  bool MayBegin(const Host& host) {
    now_ns_ += AddressWatch::kLookNs;
    return watch_.MayBegin(host, now_ns_);
  }
  // A domain begins on what the host has.
  void Begin(const InterfaceAddress& address) {
    in_use_.addresses = {address};
    watch_.SeenAgain();
  }

  int64_t now_ns_ = 1'000 * kNanosPerSecond;
  AddressWatch watch_{"eth0"};
  InterfacesInUse in_use_{.addresses = {kEth}};
};

TEST_F(AddressWatchTest, NothingHappensWhileTheAddressIsThere) {
  EXPECT_EQ(Seconds({kLo, kEth}), -1);
  EXPECT_EQ(Seconds({kLo, Of("eth0", 2, "10.0.0.1"), kEth, kWlan}), -1) << "a second address";
  EXPECT_THAT(watch_.problem(), IsEmpty());
}

TEST_F(AddressWatchTest, AnotherAddressIsAProblemAtOnceAndFollowedWhenItStays) {
  EXPECT_FALSE(Look({kLo, kEthMoved}));
  EXPECT_EQ(watch_.problem(), "eth0 had 10.0.0.2 and has 10.0.0.3");
  EXPECT_TRUE(Look({kLo, kEthMoved}));
  EXPECT_EQ(watch_.change(), "eth0 had 10.0.0.2 and has 10.0.0.3");
  in_use_.addresses = {kEthMoved};
  EXPECT_FALSE(Look({kLo, kEthMoved}));
  EXPECT_EQ(watch_.problem(), "eth0 had 10.0.0.2 and has 10.0.0.3") << "until the robot is seen";
  watch_.SeenAgain();
  EXPECT_THAT(watch_.problem(), IsEmpty());
  EXPECT_EQ(Seconds({kLo, kEthMoved}), -1);
}

TEST_F(AddressWatchTest, AnInterfaceThatIsMadeAgainHasLostItsGroups) {
  EXPECT_EQ(Seconds({kLo, kEthAgain}), 2);
  EXPECT_EQ(watch_.change(), "eth0 with 10.0.0.2 was made again");
}

TEST_F(AddressWatchTest, AnAddressMayComeBackUnharmed) {
  for (int i = 0; i < 50; ++i) {
    EXPECT_FALSE(Look({kLo}));
    EXPECT_FALSE(Look({kLo, kWlan})) << "of another interface: it is not the one that is used";
    EXPECT_EQ(watch_.problem(), "eth0 lost 10.0.0.2 and has no other address");
    EXPECT_FALSE(Look({kLo, kEth}));
    EXPECT_THAT(watch_.problem(), IsEmpty());
  }
}

TEST_F(AddressWatchTest, WithoutAnAddressItEndsAndBeginsWhenThereIsOne) {
  EXPECT_EQ(Seconds({kLo}), 4);
  for (int i = 0; i < 100; ++i) EXPECT_FALSE(MayBegin({kLo, kWlan}));
  EXPECT_TRUE(MayBegin({kLo, kWlan, kEth}));
  EXPECT_EQ(watch_.problem(), "eth0 lost 10.0.0.2 and has no other address");
  Begin(kEth);
  EXPECT_THAT(watch_.problem(), IsEmpty());
}

TEST_F(AddressWatchTest, AnAttemptThatFailsIsRepeatedSlowlyAndSoonerIfAnAddressComes) {
  EXPECT_TRUE(MayBegin({kEth}));
  int attempts = 0;
  for (int i = 0; i < 60; ++i) attempts += MayBegin({kEth, i % 2 == 0 ? kWlan : kDocker}) ? 1 : 0;
  EXPECT_EQ(attempts, 2) << "what other interfaces have is no matter";
  for (int i = 0; i < 29; ++i) MayBegin({kEth});
  while (!MayBegin({kEth})) {
  }
  EXPECT_FALSE(MayBegin({kEthMoved}));
  EXPECT_TRUE(MayBegin({kEthMoved}));
}

TEST_F(AddressWatchTest, AnyAddressIsWorthAnAttemptWhereTheInterfaceIsNotKnown) {
  AddressWatch any("");
  EXPECT_TRUE(any.MayBegin({kLo}, now_ns_));
  EXPECT_FALSE(any.MayBegin({kLo, kWlan}, now_ns_ + kNanosPerSecond)) << "not every second";
  EXPECT_TRUE(any.MayBegin({kLo, kWlan}, now_ns_ + 2 * kNanosPerSecond));
  EXPECT_FALSE(any.MayBegin({}, now_ns_ + 60 * kNanosPerSecond));
}

TEST_F(AddressWatchTest, AnInterfaceThatFlapsCostsABoundedNumberOfBeginnings) {
  int begun = 0;
  for (int second = 0; second < 600; ++second) {
    const InterfaceAddress& has = second / 3 % 2 == 0 ? kEthMoved : kEth;
    if (!Look({kLo, has})) continue;
    ++begun;
    in_use_.addresses = {has};
  }
  EXPECT_GE(begun, 25);
  EXPECT_LE(begun, 600 / 20 + AddressWatch::kBurst);
}

TEST_F(AddressWatchTest, TurnsComeBack) {
  for (int round = 0; round < 5; ++round) {
    for (int i = 0; i < AddressWatch::kBurst; ++i) {
      const InterfaceAddress next = Of("eth0", 2, "10.0.1." + std::to_string(i));
      EXPECT_EQ(Seconds({next}), 2) << round << " " << i;
      in_use_.addresses = {next};
    }
    EXPECT_EQ(Seconds({in_use_.addresses.front()}, 60), -1);
  }
}

TEST_F(AddressWatchTest, WhatCycloneChoseIsFollowedWhenItWouldChooseAnother) {
  in_use_ = {.addresses = {kLo}, .automatic = true};
  EXPECT_EQ(Seconds({kLo, kWlan}), 4) << "before the first interface had an address";
  in_use_.addresses = {kWlan};
  watch_.SeenAgain();
  EXPECT_EQ(Seconds({kLo, kWlan, kDocker}), -1) << "ranks no higher and comes later";
  EXPECT_EQ(Seconds({kLo, kEth, kWlan, kDocker}), 4) << "as new ROS nodes do";
  EXPECT_EQ(watch_.problem(), "eth0 came with 10.0.0.2; wlan0 with 10.1.0.4 was used");
}

TEST_F(AddressWatchTest, ContainersThatComeAndGoEverySecondDisturbNothing) {
  in_use_ = {.addresses = {kEth}, .automatic = true};
  for (uint32_t i = 0; i < 600; ++i) {
    Host host = {kLo, kEth, kDocker};
    if (i % 2 == 0) host.push_back(Of("veth" + std::to_string(i), 10 + i, "fe80::1"));
    if (i % 3 == 0) host.push_back(Of("br-" + std::to_string(i), 10 + i, "172.18.0.1"));
    EXPECT_FALSE(Look(host));
  }
  EXPECT_THAT(watch_.problem(), IsEmpty());
}

TEST_F(AddressWatchTest, WhatCycloneChoseLosesItsAddressForAMomentAndMovesNowhere) {
  in_use_ = {.addresses = {kEth}, .automatic = true};
  EXPECT_EQ(Seconds({kLo, kDocker}, 2), -1);
  EXPECT_EQ(watch_.problem(), "eth0 lost 10.0.0.2; docker0 has 172.17.0.1");
  EXPECT_EQ(Seconds({kLo, kEthMoved, kDocker}), 2);
  EXPECT_EQ(watch_.change(), "eth0 had 10.0.0.2 and has 10.0.0.3");
}

TEST_F(AddressWatchTest, IPv6IsJudgedByItself) {
  const InterfaceAddress global = Of("eth0", 2, "2001:db8::2");
  const InterfaceAddress local = Of("eth0", 2, "fe80::2");
  in_use_ = {.addresses = {global}, .automatic = true};
  EXPECT_EQ(Seconds({kLo, kEthMoved, global}), -1) << "IPv4 is no matter";
  EXPECT_EQ(Seconds({kLo, local, Of("eth0", 2, "2001:db8::3")}), 2);
  EXPECT_EQ(watch_.change(), "eth0 had 2001:db8::2 and has 2001:db8::3");
  in_use_ = {.addresses = {local}};
  watch_.SeenAgain();
  EXPECT_EQ(Seconds({kLo, Of("eth0", 2, "fe80::3")}), 2) << "the MAC address has changed";
}

TEST_F(AddressWatchTest, OfSeveralInterfacesEachMustStay) {
  in_use_ = {.addresses = {kEth, kWlan}};
  EXPECT_EQ(Seconds({kLo, kEth, kWlan}), -1);
  EXPECT_FALSE(Look({kLo, kEthMoved}));
  EXPECT_EQ(watch_.problem(),
            "eth0 had 10.0.0.2 and has 10.0.0.3, wlan0 lost 10.1.0.4 and has no other address");
  EXPECT_EQ(Seconds({kLo, kEthMoved, Of("wlan0", 3, "10.1.0.5")}), 2);
}

TEST(CycloneChoiceTest, RanksAsCycloneDoes) {
  const auto choice = [](Host host, bool ipv6 = false) {
    const InterfaceAddress* found = CycloneChoice(host, ipv6);
    return found == nullptr ? "" : found->address;
  };
  InterfaceAddress ppp = Of("ppp0", 5, "10.9.0.1");
  ppp.multicast = false;
  ppp.point_to_point = true;
  EXPECT_EQ(choice({}), "");
  EXPECT_EQ(choice({kLo}), "127.0.0.1");
  EXPECT_EQ(choice({kLo, ppp}), "10.9.0.1");
  EXPECT_EQ(choice({kLo, ppp, kDocker, kEth}), "172.17.0.1") << "the first of the best";
  EXPECT_EQ(choice({kLo, kEth}, true), "");
  EXPECT_EQ(choice({Of("lo", 1, "::1"), Of("eth0", 2, "fe80::2")}, true), "fe80::2");
  EXPECT_EQ(choice({Of("eth0", 2, "fe80::2"), Of("wlan0", 3, "2001:db8::1")}, true), "2001:db8::1");
}

TEST(HostAddressesTest, HasLoopback) {
  const auto host = HostAddresses();
  ASSERT_TRUE(host.ok()) << host.status();
  const auto lo = std::find_if(host->begin(), host->end(), [](const InterfaceAddress& each) {
    return each.address == "127.0.0.1";
  });
  ASSERT_NE(lo, host->end());
  EXPECT_TRUE(lo->loopback);
  EXPECT_EQ(lo->interface, "lo");
  EXPECT_GT(lo->index, 0U);
}

}  // namespace
}  // namespace rips::dds
