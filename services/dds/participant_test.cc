#include "services/dds/participant.h"

#include <sched.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "tests/support/ros2/test_world.h"

namespace rips::dds {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

TEST(DomainXmlTest, PinsTheInterface) {
  const auto lo = DomainXml({.interface = "lo"}, 4 << 20);
  ASSERT_THAT(lo, IsOk());
  EXPECT_THAT(*lo, HasSubstr("<NetworkInterface name=\"lo\" multicast=\"true\"/>"));
  EXPECT_THAT(*lo, HasSubstr("<ParticipantIndex>none</ParticipantIndex>"));
  EXPECT_THAT(*DomainXml({.interface = "eth0.7"}, 0), HasSubstr("multicast=\"default\""));
  EXPECT_THAT(*DomainXml({}, 0), Not(HasSubstr("NetworkInterface")));
}

TEST(DomainXmlTest, DataByUnicastIsAChoice) {
  EXPECT_THAT(*DomainXml({}, 0), Not(HasSubstr("AllowMulticast")));
  EXPECT_THAT(*DomainXml({.interface = "lo", .unicast_data = true}, 0),
              HasSubstr("</Interfaces><AllowMulticast>spdp</AllowMulticast></General>"));
}

TEST(DomainXmlTest, AsksForNoMoreBufferThanTheKernelGrants) {
  EXPECT_THAT(*DomainXml({}, 212'992), HasSubstr("min=\"212992B\""));
  EXPECT_THAT(*DomainXml({}, 64 << 20), HasSubstr("min=\"4194304B\""));
  EXPECT_THAT(*DomainXml({}, 0), Not(HasSubstr("SocketReceiveBufferSize")));
}

TEST(DomainXmlTest, RefusesWhatIsNoInterface) {
  for (const char* name : {"lo\"/>", "a b", "sixteen-letters-", "<x>"}) {
    EXPECT_THAT(DomainXml({.interface = name}, 0),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("network interface")));
  }
}

TEST(DomainTest, WhatTheMiddlewareLogsIsALineOfOurs) {
  const char* before = std::getenv("CYCLONEDDS_URI");
  const std::string own = before == nullptr ? "" : before;
  setenv("CYCLONEDDS_URI", "<CycloneDDS><Domain><Nonsense/></Domain></CycloneDDS>", 1);
  ::testing::internal::CaptureStderr();
  const auto refused = Domain::Create({.id = RandomDomain()});
  const std::string log = ::testing::internal::GetCapturedStderr();
  setenv("CYCLONEDDS_URI", own.c_str(), 1);

  EXPECT_FALSE(refused.ok());
  EXPECT_THAT(log, HasSubstr("Z error dds text=\"config: //CycloneDDS/Domain: Nonsense: unknown"));
}

TEST(ParticipantTest, OnTheLoopbackInterface) {
  const auto first = Participant::Create({.id = RandomDomain(), .interface = "lo"});
  ASSERT_THAT(first, IsOk());
  EXPECT_EQ((*first)->domain_id(), RandomDomain());
  EXPECT_EQ((*first)->guid(), (*first)->guid().Participant());
  ASSERT_EQ((*first)->interfaces().addresses.size(), 1U);
  EXPECT_EQ((*first)->interfaces().addresses[0].address, "127.0.0.1");
  EXPECT_FALSE((*first)->interfaces().automatic);
  EXPECT_THAT(Participant::Create({.id = RandomDomain(), .interface = "lo"}),
              StatusIs(absl::StatusCode::kAlreadyExists));
  const auto second = Participant::Create((*first)->domain());
  ASSERT_THAT(second, IsOk());
  EXPECT_NE((*first)->guid(), (*second)->guid());
}

// In a process and a network of its own.
[[noreturn]] void EndsAfterTheAddressHasChanged() {
  alarm(20);
  const auto run = [](const char* command) {
    if (std::system(command) != 0) _exit(2);
  };
  if (unshare(CLONE_NEWNET) != 0) _exit(3);
  run("ip link set lo up && ip link add eth0 type veth peer name eth1 && ip link set eth1 up && "
      "ip addr add 10.9.8.7/24 dev eth0 && ip link set eth0 up multicast on");
  auto participant = Participant::Create({.id = RandomDomain(), .interface = "eth0"});
  if (!participant.ok()) _exit(4);
  run("ip addr del 10.9.8.7/24 dev eth0 && ip addr add 10.9.8.6/24 dev eth0");
  participant->reset();
  _exit(0);
}

TEST(ParticipantTest, EndsAfterTheAddressOfItsInterfaceHasChanged) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root: it makes a network of its own";
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(EndsAfterTheAddressHasChanged(), testing::ExitedWithCode(0), "");
}

// As above; over IPv6 alone.
[[noreturn]] void EndsAfterTheIPv6AddressHasChanged() {
  alarm(20);
  const auto run = [](const char* command) {
    if (std::system(command) != 0) _exit(2);
  };
  if (unshare(CLONE_NEWNET) != 0) _exit(3);
  run("ip link set lo up && ip link add eth0 type veth peer name eth1 && ip link set eth1 up && "
      "ip link set eth0 up multicast on && ip addr add 2001:db8::7/64 dev eth0 nodad");
  const ScopedCycloneUri uri(
      "<CycloneDDS><Domain><General><Transport>udp6</Transport><Interfaces><NetworkInterface "
      "address=\"2001:db8::7\"/></Interfaces></General></Domain></CycloneDDS>");
  auto participant = Participant::Create({.id = RandomDomain()});
  if (!participant.ok()) _exit(4);
  const InterfacesInUse& in_use = (*participant)->interfaces();
  if (in_use.addresses.size() != 1 || in_use.addresses[0].address != "2001:db8::7") _exit(5);
  run("ip link set eth0 down && ip link set eth0 up && ip addr add 2001:db8::6/64 dev eth0 nodad");
  participant->reset();
  _exit(0);
}

TEST(ParticipantTest, EndsAfterTheIPv6AddressOfItsInterfaceHasChanged) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root: it makes a network of its own";
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(EndsAfterTheIPv6AddressHasChanged(), testing::ExitedWithCode(0), "");
}

// An interface without an address, and then with one.
[[noreturn]] void WaitsForAnAddress() {
  const auto run = [](const char* command) {
    if (std::system(command) != 0) _exit(2);
  };
  if (unshare(CLONE_NEWNET) != 0) _exit(3);
  run("ip link set lo up && ip link add eth0 type veth peer name eth1 && ip link set eth1 up");
  const absl::Status down = FindInterface("eth0");
  if (!absl::IsUnavailable(down)) _exit(4);
  const DomainOptions options{.id = RandomDomain(), .interface = "eth0"};
  if (!MayComeWithAnInterface(TryDomain(options))) _exit(5);
  run("ip addr add 10.9.8.7/24 dev eth0 && ip link set eth0 up multicast on");
  if (!TryDomain(options).ok()) _exit(6);
  const auto participant = Participant::Create(options);
  if (!participant.ok()) _exit(7);
  const InterfacesInUse& in_use = (*participant)->interfaces();
  if (in_use.automatic || in_use.addresses.size() != 1) _exit(8);
  if (in_use.addresses[0].interface != "eth0" || in_use.addresses[0].index == 0) _exit(9);
  _exit(in_use.addresses[0].address == "10.9.8.7" ? 0 : 10);
}

TEST(ParticipantTest, AnInterfaceWithoutAnAddressMayGetOne) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root: it makes a network of its own";
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(WaitsForAnAddress(), testing::ExitedWithCode(0), "");
}

TEST(ParticipantTest, TheDomainEndsWithItsLastParticipant) {
  for (int round = 0; round < 2; ++round) {
    EXPECT_THAT(Participant::Create({.id = RandomDomain(), .interface = "lo"}), IsOk()) << round;
  }
}

TEST(ParticipantTest, BadDomainOrInterface) {
  EXPECT_THAT(Participant::Create({.id = 233}),
              StatusIs(absl::StatusCode::kInvalidArgument, "domain 233 exceeds limit 232"));
  EXPECT_THAT(Participant::Create({.id = RandomDomain(), .interface = "nosuch0"}),
              StatusIs(absl::StatusCode::kNotFound,
                       AllOf(HasSubstr("no network interface `nosuch0`"), HasSubstr("lo"))));
}

TEST(ParticipantTest, TheEnvironmentWins) {
  const ScopedCycloneUri uri(
      "<CycloneDDS><Domain><General><Interfaces><NetworkInterface "
      "name=\"nosuch0\"/></Interfaces></General></Domain></CycloneDDS>");
  EXPECT_FALSE(Participant::Create({.id = RandomDomain(), .interface = "lo"}).ok());
}

}  // namespace
}  // namespace rips::dds
