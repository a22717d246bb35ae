#include "sensor_agent/wire/packet_socket.h"

#include <arpa/inet.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <functional>
#include <thread>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/wire/privileges.h"
#include "sensor_agent/wire/rtps_bytes.h"
#include "sensor_agent/wire/rtps_parser.h"
#include "services/base/status_matchers.h"

namespace rips::wire {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr uint16_t kPort = 17'401;
constexpr PortRange kRange = {.first = 17'400, .last = 17'649};

// Runs on a thread in a network namespace of its own, where nobody else sends; that has nothing but
// a loopback interface, which is up.
void InNamespace(const std::function<void()>& body) {
  std::thread([&] {
    ASSERT_EQ(unshare(CLONE_NEWNET), 0);
    const UniqueFd fd(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    ifreq request = {};
    std::copy_n("lo", 3, request.ifr_name);
    ASSERT_EQ(ioctl(fd.get(), SIOCGIFFLAGS, &request), 0);
    request.ifr_flags |= IFF_UP;
    ASSERT_EQ(ioctl(fd.get(), SIOCSIFFLAGS, &request), 0);
    body();
  }).join();
}

void Send(const std::string& payload, uint16_t port = kPort) {
  const UniqueFd fd(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  sockaddr_in to = {};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  ASSERT_EQ(sendto(fd.get(), payload.data(), payload.size(), 0,
                   reinterpret_cast<const sockaddr*>(&to), sizeof to),
            static_cast<ssize_t>(payload.size()));
}

// Loopback delivers before sendto returns, so all that was sent is there.
std::vector<std::string> ReadAll(PacketSocket& socket) {
  std::vector<std::string> payloads;
  for (;;) {
    const auto count = socket.Read([&](const UdpDatagram& datagram) {
      payloads.emplace_back(datagram.bytes);
      EXPECT_EQ(ToString(datagram.to), absl::StrCat("127.0.0.1:", datagram.to.port));
    });
    EXPECT_THAT(count, IsOk());
    if (!count.ok() || *count == 0) return payloads;
  }
}

class PacketSocketTest : public testing::Test {
 protected:
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "needs root, for packet sockets";
  }
};

class PacketSocketTrafficTest : public PacketSocketTest {
 protected:
  void SetUp() override {
    PacketSocketTest::SetUp();
    if (IsSkipped()) return;
    int refused = 0;
    std::thread([&] { refused = unshare(CLONE_NEWNET) == 0 ? 0 : errno; }).join();
    if (refused == EPERM) GTEST_SKIP() << "network namespaces are not allowed here";
  }
};

TEST_F(PacketSocketTrafficTest, ReadsRtpsOfItsPortsOnce) {
  InNamespace([] {
    const auto socket = PacketSocket::Open("lo", {kRange});
    ASSERT_THAT(socket, IsOk());

    Send("RTPS1");
    Send("RTPS other port", 17'399);
    Send("other");
    Send("RTPX2", 17'649);

    EXPECT_THAT(ReadAll(**socket), ElementsAre("RTPS1", "RTPX2"));
    EXPECT_EQ((*socket)->TakeDrops(), 0);
    EXPECT_GT((*socket)->receive_buffer_bytes(), 0);
    EXPECT_THAT((*socket)->CheckInterface(), IsOk());
  });
}

TEST_F(PacketSocketTrafficTest, CapturesTheFirstBytesAndTellsTheSize) {
  InNamespace([] {
    const auto socket = PacketSocket::Open("", {kRange});
    ASSERT_THAT(socket, IsOk());
    const std::string datagram =
        RtpsBytes(TestGuid(1, 0)).Data(TestGuid(1, 0x103), 7, 0, std::string(30'000, 'p')).bytes();
    Send(datagram);

    size_t seen = 0;
    const auto count = (*socket)->Read([&](const UdpDatagram& udp) {
      RtpsDatagram rtps;
      ASSERT_TRUE(ParseRtps(udp.bytes, udp.size, rtps));
      EXPECT_EQ(udp.size, datagram.size());
      EXPECT_EQ(udp.bytes.size(), kSnapBytes - 28);
      EXPECT_FALSE(rtps.cut);
      seen = rtps.submessages.size();
    });
    ASSERT_THAT(count, IsOk());
    EXPECT_EQ(*count, 1);
    EXPECT_EQ(seen, 1);
  });
}

TEST_F(PacketSocketTrafficTest, CountsWhatTheKernelHadNoRoomFor) {
  InNamespace([] {
    const auto socket = PacketSocket::Open("lo", {kRange});
    ASSERT_THAT(socket, IsOk());
    const int small = 0;  // the kernel's minimum
    ASSERT_EQ(setsockopt((*socket)->fd(), SOL_SOCKET, SO_RCVBUF, &small, sizeof small), 0);
    constexpr size_t kSent = 200;
    for (size_t i = 0; i < kSent; ++i) Send("RTPS");

    const size_t read = ReadAll(**socket).size();

    EXPECT_LT(read, kSent);
    EXPECT_EQ((*socket)->TakeDrops(), kSent - read);
    EXPECT_EQ((*socket)->TakeDrops(), 0);
  });
}

TEST_F(PacketSocketTrafficTest, ReadsOnWithoutPrivilegesAndOpensNoOther) {
  InNamespace([] {
    const auto socket = PacketSocket::Open("lo", {kRange});
    ASSERT_THAT(socket, IsOk());

    ASSERT_THAT(DropPrivileges(), IsOk());

    Send("RTPS");
    EXPECT_THAT(ReadAll(**socket), ElementsAre("RTPS"));
    const absl::Status another = PacketSocket::Open("lo", {kRange}).status();
    EXPECT_EQ(another.code(), absl::StatusCode::kPermissionDenied);
    EXPECT_THAT(std::string(another.message()), HasSubstr("CAP_NET_RAW"));
    EXPECT_EQ(prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0), 1);
  });
}

TEST_F(PacketSocketTest, NeedsAnInterfaceThatIsThere) {
  const absl::Status missing = PacketSocket::Open("no\nsuch", {kRange}).status();
  EXPECT_EQ(missing.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(missing.message()), HasSubstr("`no\\x0asuch`"));
}

TEST(LocalAddressesTest, KnowsTheHost) {
  const uint8_t loopback[] = {127, 0, 0, 1};
  const std::vector<Address> addresses = LocalAddresses();
  EXPECT_THAT(addresses, Contains(FromV4(loopback)));
  EXPECT_TRUE(std::is_sorted(addresses.begin(), addresses.end()));
  EXPECT_GT(EphemeralPorts().first, 0);
  EXPECT_EQ(EphemeralPorts().last, 65'535);
}

}  // namespace
}  // namespace rips::wire
