#include "services/rpc/connection_admission.h"

#include <arpa/inet.h>
#include <netinet/in.h>

#include <cstring>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

using ::testing::IsEmpty;
using Verdict = Admission::Verdict;

constexpr AdmissionLimits kLimits = {
    .total = 20, .reserve = 5, .per_network = 12, .per_address = 6, .burst = 8, .per_second = 2};

Source V4(const std::string& text, uint16_t port = 4711) {
  sockaddr_storage storage = {};
  sockaddr_in v4 = {};
  v4.sin_family = AF_INET;
  v4.sin_port = htons(port);
  inet_pton(AF_INET, text.c_str(), &v4.sin_addr);
  std::memcpy(&storage, &v4, sizeof(v4));
  return SourceOf(storage);
}

Source V6(const std::string& text, uint16_t port = 4711) {
  sockaddr_storage storage = {};
  sockaddr_in6 v6 = {};
  v6.sin6_family = AF_INET6;
  v6.sin6_port = htons(port);
  inet_pton(AF_INET6, text.c_str(), &v6.sin6_addr);
  std::memcpy(&storage, &v6, sizeof(v6));
  return SourceOf(storage);
}

class AdmissionTest : public ::testing::Test {
 protected:
  Verdict Ask(const Source& source) { return admission_.Ask(source, now_ns_); }
  // How many are taken until one is not.
  int Fill(const Source& source) {
    int taken = 0;
    while (Ask(source) == Verdict::kTake) ++taken;
    return taken;
  }
  void Seconds(int64_t seconds) { now_ns_ += seconds * kNanosPerSecond; }

  int64_t now_ns_ = 1'000 * kNanosPerSecond;
  Admission admission_{kLimits};
};

TEST(SourceTest, IsNamedAsGrpcNamesPeers) {
  EXPECT_EQ(V4("10.1.2.3").peer, "ipv4:10.1.2.3:4711");
  EXPECT_EQ(V6("fe80::1").peer, "ipv6:[fe80::1]:4711");
  EXPECT_EQ(V6("::ffff:10.1.2.3").peer, "ipv4:10.1.2.3:4711");
}

TEST(SourceTest, HasAnAddressAndANetwork) {
  EXPECT_EQ(V4("10.1.2.3").address, "10.1.2.3");
  EXPECT_EQ(V4("10.1.2.3").network, "10.1.2.0/24");
  EXPECT_EQ(V6("2001:db8:1:2:3:4:5:6").address, "2001:db8:1:2::/64");
  EXPECT_EQ(V6("2001:db8:1:2:3:4:5:6").network, "2001:db8:1::/48");
  EXPECT_EQ(V6("::ffff:10.1.2.3").address, "10.1.2.3");
  sockaddr_storage local = {};
  local.ss_family = AF_UNIX;
  EXPECT_THAT(SourceOf(local).peer, IsEmpty());
}

TEST_F(AdmissionTest, AnAddressHasSoManyConnections) {
  EXPECT_EQ(Fill(V4("10.0.0.1")), 6);
  EXPECT_EQ(Ask(V4("10.0.0.1")), Verdict::kAddress);
  EXPECT_EQ(Ask(V4("10.0.1.1")), Verdict::kTake) << "another one has its own";
  admission_.Left(V4("10.0.0.1"));
  EXPECT_EQ(Ask(V4("10.0.0.1")), Verdict::kTake);
}

TEST_F(AdmissionTest, ANetworkHasSoManyConnections) {
  EXPECT_EQ(Fill(V4("10.0.0.1")) + Fill(V4("10.0.0.2")), 12);
  EXPECT_EQ(Ask(V4("10.0.0.3")), Verdict::kNetwork);
  EXPECT_EQ(Ask(V4("10.0.1.3")), Verdict::kTake);
}

TEST_F(AdmissionTest, TheReserveIsForThoseThatAreKnown) {
  const Source known = V4("10.9.0.1");
  admission_.Identified(known, "alice", now_ns_);
  int taken = 0;
  for (int i = 0; i < 10; ++i) taken += Fill(V4(absl::StrCat("10.", i, ".0.7")));
  EXPECT_EQ(taken, 15);
  EXPECT_EQ(Ask(V4("10.200.0.1")), Verdict::kTotal);
  EXPECT_EQ(Ask(known), Verdict::kTake);
  Seconds(3'601);
  EXPECT_EQ(Ask(known), Verdict::kTotal) << "not for ever";
}

TEST_F(AdmissionTest, AStolenCertificateMakesFewAddressesKnown) {
  admission_.Identified(V4("10.9.0.1"), "robot", now_ns_);
  for (int i = 0; i < 250; ++i) {
    admission_.Identified(V4(absl::StrCat("10.8.0.", i)), "robot", now_ns_);
  }
  int known = 0;
  for (int i = 0; i < 250; ++i) {
    known += admission_.Known(V4(absl::StrCat("10.8.0.", i)), now_ns_) ? 1 : 0;
  }
  EXPECT_EQ(known, 3);
  EXPECT_TRUE(admission_.Known(V4("10.9.0.1"), now_ns_)) << "its owner's stays";
  admission_.Identified(V4("10.8.0.200"), "another", now_ns_);
  EXPECT_TRUE(admission_.Known(V4("10.8.0.200"), now_ns_)) << "by another's word";
  Seconds(3'601);
  admission_.Identified(V4("10.8.0.100"), "robot", now_ns_);
  EXPECT_TRUE(admission_.Known(V4("10.8.0.100"), now_ns_)) << "what is over counts no more";
}

TEST_F(AdmissionTest, AnAddressOpensSoManyASecond) {
  const Source source = V4("10.0.0.1");
  for (int i = 0; i < 8; ++i) {
    ASSERT_EQ(Ask(source), Verdict::kTake);
    admission_.Left(source);
  }
  EXPECT_EQ(Ask(source), Verdict::kRate);
  Seconds(1);
  EXPECT_EQ(Ask(source), Verdict::kTake);
  EXPECT_EQ(Ask(source), Verdict::kTake);
  EXPECT_EQ(Ask(source), Verdict::kRate);
}

TEST_F(AdmissionTest, ABanIsLongerEachTime) {
  const Source source = V4("10.0.0.1");
  EXPECT_EQ(admission_.Ban(source, now_ns_), 10 * kNanosPerSecond);
  EXPECT_EQ(Ask(source), Verdict::kBanned);
  EXPECT_EQ(Ask(V4("10.0.0.2")), Verdict::kTake) << "its neighbours are not";
  Seconds(4);
  EXPECT_EQ(admission_.Ban(source, now_ns_), 6 * kNanosPerSecond)
      << "a second connection of the same attack";
  Seconds(7);
  EXPECT_EQ(Ask(source), Verdict::kTake);
  EXPECT_EQ(admission_.Ban(source, now_ns_), 20 * kNanosPerSecond);
  for (int i = 0; i < 20; ++i) {
    Seconds(700);
    EXPECT_LE(admission_.Ban(source, now_ns_), 600 * kNanosPerSecond);
  }
  Seconds(5'000);
  EXPECT_EQ(admission_.Ban(source, now_ns_), 10 * kNanosPerSecond);
}

TEST_F(AdmissionTest, ABannedAddressThatIsKnownIsOnlySlowedDown) {
  const Source source = V4("10.0.0.1");
  admission_.Identified(source, "alice", now_ns_);
  admission_.Ban(source, now_ns_);
  EXPECT_EQ(Ask(source), Verdict::kTake) << "an agent of ours may be behind it";
  EXPECT_EQ(Ask(source), Verdict::kRate);
  Seconds(1);
  EXPECT_EQ(Ask(source), Verdict::kTake);
  EXPECT_EQ(Ask(source), Verdict::kRate);
}

TEST_F(AdmissionTest, RemembersNoMoreThanSoManyAddresses) {
  const Source holder = V4("10.0.0.1");
  ASSERT_EQ(Ask(holder), Verdict::kTake);
  for (int i = 0; i < 20'000; ++i) {
    const Source source = V4(absl::StrCat("11.", i / 250, ".", i % 250, ".1"));
    ASSERT_EQ(Ask(source), Verdict::kTake);
    admission_.Left(source);
    ++now_ns_;
  }
  EXPECT_EQ(admission_.total(), 1);
  EXPECT_EQ(Fill(holder), 5) << "what has connections is not forgotten";
}

}  // namespace
}  // namespace rips::rpc
