#include "services/rpc/peer_address.h"

#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

TEST(DecodePeerTest, TakesPercentsOut) {
  EXPECT_EQ(DecodePeer("ipv6:%5B::1%5D:4711"), "ipv6:[::1]:4711");
  EXPECT_EQ(DecodePeer("ipv4:127.0.0.1:1"), "ipv4:127.0.0.1:1");
  EXPECT_EQ(DecodePeer("a%"), "a%");
  EXPECT_EQ(DecodePeer("a%zz"), "a%zz");
}

TEST(AddressOfPeerTest, IsTheAddressAlone) {
  EXPECT_EQ(AddressOfPeer("ipv4:10.0.0.7:4711"), "10.0.0.7");
  EXPECT_EQ(AddressOfPeer("ipv6:%5Bfd00::7%5D:4711"), "fd00::7");
  EXPECT_EQ(AddressOfPeer("ipv6:[fd00::7]:4711"), "fd00::7");
  EXPECT_EQ(AddressOfPeer("ipv6:[fe80::7%eth0]:4711"), "fe80::7");
}

TEST(AddressOfPeerTest, AnIpv4AddressIsOneHoweverItComes) {
  EXPECT_EQ(AddressOfPeer("ipv6:%5B::ffff:10.0.0.7%5D:4711"), "10.0.0.7");
  EXPECT_EQ(AddressOfPeer("ipv6:[::ffff:7]:4711"), "::ffff:7");
}

TEST(AddressOfPeerTest, IsEmptyForWhatHasNone) {
  for (const char* peer : {"", "unix:", "unix:/run/x", "ipv4", "ipv6:fd00", "ipv6:[fd00::7:4711",
                           "vsock:2:1", "inproc:0"}) {
    EXPECT_EQ(AddressOfPeer(peer), "") << peer;
  }
}

}  // namespace
}  // namespace rips::rpc
