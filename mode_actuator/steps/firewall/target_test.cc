#include "mode_actuator/steps/firewall/target.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/firewall/real_host.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(TargetTest, ReadsAddressesAsNftPrintsThem) {
  const struct {
    absl::string_view text;
    Target target;
  } kCases[] = {
      {"10.0.0.7", {TargetKind::kIpv4, "10.0.0.7"}},
      {"FD00:0::07", {TargetKind::kIpv6, "fd00::7"}},
      {"fe80::1", {TargetKind::kIpv6, "fe80::1"}},
      {"02:00:5E:00:53:01", {TargetKind::kMac, "02:00:5e:00:53:01"}},
  };
  for (const auto& test : kCases) {
    const auto target = ParseHostTarget(test.text);
    ASSERT_THAT(target, IsOk()) << test.text;
    EXPECT_EQ(*target, test.target) << test.text;
  }
}

TEST(TargetTest, RefusesWhatIsNoSingleHost) {
  const struct {
    std::string text;
    absl::string_view message;
  } kCases[] = {
      {"", "is no IPv4, IPv6 or MAC address"},
      {"base", "names are not looked up"},
      {"10.0.0.0/24", "is no IPv4"},
      {"10.0.0", "is no IPv4"},
      {"10.0.0.7 ", "is no IPv4"},
      {std::string("10.0.0.7\0x", 10), "is no IPv4"},
      {"10.0.0.7 timeout 1s }; flush ruleset", "is no IPv4"},
      {"fe80::1%eth0", "is no IPv4"},
      {"0.0.0.0", "unspecified"},
      {"127.1.2.3", "a loopback address"},
      {"224.0.0.1", "a multicast address"},
      {"255.255.255.255", "the broadcast address"},
      {"::", "unspecified"},
      {"::1", "a loopback address"},
      {"ff02::1", "a multicast address"},
      {"::ffff:10.0.0.1", "an IPv4 address written as IPv6"},
      {"00:00:00:00:00:00", "unspecified"},
      {"ff:ff:ff:ff:ff:ff", "a multicast address"},
      {"01:00:5e:00:00:01", "a multicast address"},
      {"02-00-5e-00-53-01", "is no IPv4"},
      {"02:00:5e:00:53:0g", "is no IPv4"},
  };
  for (const auto& test : kCases) {
    EXPECT_THAT(ParseHostTarget(test.text),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << test.text;
  }
}

TEST(TargetTest, ReadsGuidPrefixes) {
  const auto target = ParseParticipantTarget("01104A3b00000000DEADbeef");
  ASSERT_THAT(target, IsOk());
  EXPECT_EQ(*target, (Target{TargetKind::kParticipant, "01104a3b00000000deadbeef"}));
  for (const absl::string_view text :
       {"", "01104a3b00000000deadbee", "01104a3b00000000deadbeef0", "01104a3b00000000deadbeeg",
        "01104a3b.0000000.deadbee", "000000000000000000000000"}) {
    EXPECT_THAT(ParseParticipantTarget(text), StatusIs(absl::StatusCode::kInvalidArgument)) << text;
  }
}

TEST(TargetTest, ServersOwnAddressesAndGatewaysAreNeverIsolated) {
  const KeptOpen kept = {
      .servers = {"10.0.0.1"}, .own = {"10.0.0.2", "02:00:00:00:00:02"}, .gateways = {"fe80::1"}};
  const auto check = [&](absl::string_view text) {
    return CheckMayBeIsolated(*ParseHostTarget(text), kept);
  };
  EXPECT_THAT(check("10.0.0.1"), StatusIs(absl::StatusCode::kInvalidArgument,
                                          HasSubstr("`10.0.0.1` is a policy server, which is "
                                                    "never isolated")));
  EXPECT_THAT(check("10.0.0.2"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is this host itself")));
  EXPECT_THAT(check("02:00:00:00:00:02"), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(check("FE80:0:0:0::1"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is the gateway")));
  EXPECT_THAT(check("10.0.0.3"), IsOk());
}

TEST(RealHostTest, ReadsDefaultRoutes) {
  constexpr absl::string_view kRoute =
      "Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT\n"
      "eth0\t00000000\t0102A8C0\t0003\t0\t0\t0\t00000000\t0\t0\t0\n"
      "eth0\t0002A8C0\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n"
      "ppp0\t00000000\t00000000\t0001\t0\t0\t0\t00000000\t0\t0\t0\n";
  constexpr absl::string_view kIpv6Route =
      "00000000000000000000000000000000 00 00000000000000000000000000000000 00 "
      "fe800000000000000000000000000001 00000400 00000001 00000000 00000003     eth0\n"
      "fd000000000000000000000000000000 40 00000000000000000000000000000000 00 "
      "fe800000000000000000000000000009 00000400 00000001 00000000 00000003     eth0\n"
      "00000000000000000000000000000000 00 00000000000000000000000000000000 00 "
      "00000000000000000000000000000000 ffffffff 00000001 00000000 00200200       lo\n";
  EXPECT_THAT(DefaultGateways(kRoute, kIpv6Route), ElementsAre("192.168.2.1", "fe80::1"));
  EXPECT_THAT(DefaultGateways("", "x\n\n"), IsEmpty());
}

TEST(RealHostTest, ReadsNumericServers) {
  const auto v4 = ParseNumericServer("10.0.0.1:7443");
  ASSERT_THAT(v4, IsOk());
  EXPECT_EQ(*v4, (ControlAddress{TargetKind::kIpv4, "10.0.0.1", 7443}));
  const auto v6 = ParseNumericServer("[FD00::01]:1");
  ASSERT_THAT(v6, IsOk());
  EXPECT_EQ(*v6, (ControlAddress{TargetKind::kIpv6, "fd00::1", 1}));
  EXPECT_THAT(ParseNumericServer("policy.example:7443"), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(ParseNumericServer("10.0.0.1"), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(RealHostTest, KnowsItselfAndItsServers) {
  RealHost host({"10.0.0.1:7443"});
  const auto kept = host.Kept();
  ASSERT_THAT(kept, IsOk());
  EXPECT_THAT(kept->servers, ElementsAre("10.0.0.1"));
  EXPECT_THAT(kept->own, Contains("127.0.0.1"));
}

TEST(RealHostTest, SaysWhichNameItDoesNotKnow) {
  RealHost host({"10.0.0.1:7443", "no-such-host.invalid:7443"});
  EXPECT_THAT(host.Control(), StatusIs(absl::StatusCode::kUnavailable,
                                       HasSubstr("`no-such-host.invalid:7443` is not known")));
}

}  // namespace
}  // namespace rips::actuator
