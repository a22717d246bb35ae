#include "services/ros2/discovery_info.h"

#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/ros2/cdr.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::ros2 {
namespace {

using ::testing::HasSubstr;

// Recorded from a ROS 2 Humble process with one node, "drive_base" (rmw_cyclonedds 1.3.4).
constexpr char kRecorded[] =
    "0001000001101c32cd47917ced305b7c000001c1000000000000000001000000020000002f0000000b000000"
    "64726976655f6261736500000800000001101c32cd47917ced305b7c00000804000000000000000001101c32"
    "cd47917ced305b7c00000a04000000000000000001101c32cd47917ced305b7c00000c040000000000000000"
    "01101c32cd47917ced305b7c00000e04000000000000000001101c32cd47917ced305b7c0000100400000000"
    "0000000001101c32cd47917ced305b7c00001204000000000000000001101c32cd47917ced305b7c00001404"
    "000000000000000001101c32cd47917ced305b7c0000170400000000000000000a00000001101c32cd47917c"
    "ed305b7c00000603000000000000000001101c32cd47917ced305b7c00000703000000000000000001101c32"
    "cd47917ced305b7c00000903000000000000000001101c32cd47917ced305b7c00000b030000000000000000"
    "01101c32cd47917ced305b7c00000d03000000000000000001101c32cd47917ced305b7c00000f0300000000"
    "0000000001101c32cd47917ced305b7c00001103000000000000000001101c32cd47917ced305b7c00001303"
    "000000000000000001101c32cd47917ced305b7c00001503000000000000000001101c32cd47917ced305b7c"
    "000016030000000000000000";
constexpr char kRecordedWriter[] = "01101c32.cd47917c.ed305b7c.00000403";

std::string Recorded() { return absl::HexStringToBytes(kRecorded); }

Guid G(uint8_t participant, uint8_t entity) {
  Guid guid;
  guid.bytes[0] = 0x01;
  guid.bytes[1] = 0x10;
  guid.bytes[11] = participant;
  guid.bytes[14] = entity;
  guid.bytes[15] = 0x03;
  return guid;
}

ParticipantEntities Sample(GidBytes gid_bytes) {
  return {.participant = G(1, 0).Participant(),
          .nodes = {{.node_namespace = "/",
                     .node_name = "talker",
                     .readers = {G(1, 1)},
                     .writers = {G(1, 2), G(1, 3)}},
                    {.node_namespace = "/ns", .node_name = "idle", .readers = {}, .writers = {}}},
          .gid_bytes = gid_bytes};
}

TEST(DiscoveryInfoTest, RecordedHumbleMessage) {
  const absl::StatusOr<ParticipantEntities> info = DecodeParticipantEntities(Recorded());
  ASSERT_THAT(info, IsOk());
  EXPECT_EQ(info->gid_bytes, GidBytes::k24);
  EXPECT_EQ(ToString(info->participant), "01101c32.cd47917c.ed305b7c.000001c1");
  ASSERT_EQ(info->nodes.size(), 1u);
  EXPECT_EQ(info->nodes[0].node_namespace, "/");
  EXPECT_EQ(info->nodes[0].node_name, "drive_base");
  ASSERT_EQ(info->nodes[0].readers.size(), 8u);
  EXPECT_EQ(ToString(info->nodes[0].readers[0]), "01101c32.cd47917c.ed305b7c.00000804");
  ASSERT_EQ(info->nodes[0].writers.size(), 10u);
  EXPECT_EQ(ToString(info->nodes[0].writers[9]), "01101c32.cd47917c.ed305b7c.00001603");
  EXPECT_THAT(CheckOrigin(*info, *ParseGuid(kRecordedWriter)), IsOk());
  // Byte for byte what rmw_cyclonedds wrote.
  EXPECT_EQ(absl::BytesToHexString(EncodeParticipantEntities(*info)), kRecorded);
}

TEST(DiscoveryInfoTest, RoundTripWithBothGidSizes) {
  for (GidBytes gid_bytes : {GidBytes::k16, GidBytes::k24}) {
    for (size_t nodes : {0, 1, 2}) {
      ParticipantEntities info = Sample(gid_bytes);
      info.nodes.resize(nodes);
      const absl::StatusOr<ParticipantEntities> decoded =
          DecodeParticipantEntities(EncodeParticipantEntities(info));
      ASSERT_THAT(decoded, IsOk());
      EXPECT_EQ(*decoded, info);
    }
  }
}

TEST(DiscoveryInfoTest, TruncationAtEveryByteFails) {
  for (const std::string& whole : {Recorded(), EncodeParticipantEntities(Sample(GidBytes::k16)),
                                   EncodeParticipantEntities(Sample(GidBytes::k24))}) {
    const bool gid_ends_in_zeros = whole.substr(kCdrHeaderBytes + 16, 8) == std::string(8, '\0');
    for (size_t size = 0; size < whole.size(); ++size) {
      // The zeros that end a 24-byte gid are also a participant with a 16-byte gid and no nodes.
      if (gid_ends_in_zeros && size >= 24 && size < 28) continue;
      const std::string cut = whole.substr(0, size);
      EXPECT_THAT(DecodeParticipantEntities(cut), StatusIs(absl::StatusCode::kDataLoss)) << size;
    }
    EXPECT_THAT(DecodeParticipantEntities(whole + std::string(4, '\0')),
                StatusIs(absl::StatusCode::kDataLoss));
  }
}

// Every gid in the message is of `gid_size` bytes.
std::string WithGidSize(size_t gid_size) {
  CdrWriter writer;
  writer.Octets(G(1, 0).Participant().ToBytes().substr(0, std::min<size_t>(gid_size, 16)));
  if (gid_size > 16) writer.Octets(std::string(gid_size - 16, '\0'));
  writer.U32(1);
  writer.String("/");
  writer.String("n");
  writer.U32(0);
  writer.U32(0);
  return std::move(writer).Finish();
}

TEST(DiscoveryInfoTest, OtherGidSizesFail) {
  for (size_t size = 4; size <= 40; size += 4) {
    EXPECT_EQ(DecodeParticipantEntities(WithGidSize(size)).ok(), size == 16 || size == 24) << size;
  }
}

TEST(DiscoveryInfoTest, A24ByteGidEndsInZeros) {
  for (size_t i = 16; i < 24; ++i) {
    std::string payload = EncodeParticipantEntities(Sample(GidBytes::k24));
    payload[kCdrHeaderBytes + i] = 1;
    EXPECT_THAT(DecodeParticipantEntities(payload), StatusIs(absl::StatusCode::kDataLoss)) << i;
  }
}

TEST(DiscoveryInfoTest, HostileLengthsAllocateNothing) {
  // Each of the message's lengths in turn: nodes, namespace, name, readers, writers.
  const std::string whole = WithGidSize(16);
  for (size_t at : {16, 20, 28, 36, 40}) {
    for (uint8_t high : {0x00, 0x01, 0x7f, 0xff}) {
      std::string payload = whole;
      payload[kCdrHeaderBytes + at + 2] = '\x40';
      payload[kCdrHeaderBytes + at + 3] = static_cast<char>(high);
      EXPECT_THAT(DecodeParticipantEntities(payload), StatusIs(absl::StatusCode::kDataLoss)) << at;
    }
  }
}

TEST(DiscoveryInfoTest, Limits) {
  const std::string payload = EncodeParticipantEntities(Sample(GidBytes::k24));
  EXPECT_THAT(DecodeParticipantEntities(payload, {.nodes = 2, .endpoints = 3}), IsOk());
  EXPECT_THAT(DecodeParticipantEntities(payload, {.nodes = 1, .endpoints = 3}),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("2 elements exceeds limit 1")));
  // One reader leaves room for one writer only.
  EXPECT_THAT(DecodeParticipantEntities(payload, {.nodes = 2, .endpoints = 2}),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("2 elements exceeds limit 1")));
}

TEST(DiscoveryInfoTest, ANameThatNoNodeCanHaveHidesNoOtherNode) {
  const std::string longest(1'000, 'n');
  const std::pair<std::string, std::string> cases[] = {
      {"", "n"},         {"ns", "n"},          {"/ns/", "n"}, {"//", "n"},      {"/", ""},
      {"/", "a/b"},      {"/", "a\nb"},        {"/", "1n"},   {"/a b", "node"}, {"/", "/n"},
      {"/", "\xff\xfe"}, {"/", "\x1b[2Jnode"}, {"/", longest}};
  for (const auto& [node_namespace, node_name] : cases) {
    for (const size_t at : {0, 1}) {
      ParticipantEntities info = Sample(GidBytes::k24);
      info.nodes[at].node_namespace = node_namespace;
      info.nodes[at].node_name = node_name;
      size_t misnamed = 0;
      const auto found = DecodeParticipantEntities(EncodeParticipantEntities(info), {}, &misnamed);
      ASSERT_THAT(found, IsOk()) << node_namespace << " " << node_name;
      EXPECT_EQ(misnamed, 1u);
      ASSERT_EQ(found->nodes.size(), info.nodes.size() - 1);
      EXPECT_EQ(found->nodes[0], info.nodes[1 - at]);
    }
  }
  size_t misnamed = 7;
  EXPECT_THAT(
      DecodeParticipantEntities(EncodeParticipantEntities(Sample(GidBytes::k24)), {}, &misnamed),
      IsOk());
  EXPECT_EQ(misnamed, 0u);
}

TEST(CheckOriginTest, AnotherParticipantIsRefused) {
  const ParticipantEntities info = Sample(GidBytes::k24);
  EXPECT_THAT(CheckOrigin(info, G(1, 9)), IsOk());
  EXPECT_THAT(CheckOrigin(info, G(2, 9)),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("speaks for participant")));
  ParticipantEntities claims = info;
  claims.nodes[0].writers[1] = G(2, 3);
  EXPECT_THAT(CheckOrigin(claims, G(1, 9)),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("claims endpoint")));
  claims = info;
  claims.nodes[0].readers[0] = G(2, 1);
  EXPECT_THAT(CheckOrigin(claims, G(1, 9)), StatusIs(absl::StatusCode::kPermissionDenied));
}

}  // namespace
}  // namespace rips::ros2
