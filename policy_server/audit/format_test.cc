#include "policy_server/audit/format.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/audit/signing_key.h"

namespace rips::audit {
namespace {

TEST(AuditFormatTest, AHeaderIsReadAsItWasWritten) {
  const SigningKey key = *SigningKey::Generate();
  SegmentHeader header{.number = 7,
                       .first_sequence = 812,
                       .time_unix_ns = -3,
                       .previous_bytes = 4'096,
                       .previous_hash = Sha256("before"),
                       .public_key = key.public_key()};
  header.signature = *key.Sign(HeaderToSign(header));
  const std::string bytes = EncodeHeader(header);
  ASSERT_EQ(bytes.size(), kHeaderBytes);
  const auto read = DecodeHeader(bytes + "more");
  ASSERT_TRUE(read.has_value());
  EXPECT_EQ(EncodeHeader(*read), bytes);
  EXPECT_EQ(read->time_unix_ns, -3);
  EXPECT_FALSE(DecodeHeader(bytes.substr(0, kHeaderBytes - 1)).has_value());
}

TEST(AuditFormatTest, APieceIsReadAsItWasWritten) {
  Piece piece{.sequence = uint64_t{1} << 40, .previous_hash = Sha256("x"), .payload = "what"};
  const std::string bytes = EncodePiece(piece);
  EXPECT_EQ(bytes.size(), kPieceFrameBytes + 4);
  Piece read;
  size_t size = 0;
  ASSERT_EQ(ParsePiece(bytes + "RIPr", &read, &size), Parsed::kPiece);
  EXPECT_EQ(size, bytes.size());
  EXPECT_EQ(read.sequence, piece.sequence);
  EXPECT_EQ(read.payload, "what");
  EXPECT_EQ(read.hash, piece.hash);
}

TEST(AuditFormatTest, EachCutIsACutAndEachFlippedBitAnAlteration) {
  Piece piece{.sequence = 3, .previous_hash = Sha256("x"), .payload = "what"};
  const std::string bytes = EncodePiece(piece);
  Piece read;
  size_t size = 0;
  for (size_t cut = 0; cut < bytes.size(); ++cut) {
    EXPECT_EQ(ParsePiece(bytes.substr(0, cut), &read, &size), Parsed::kCut) << cut;
  }
  for (size_t bit = 0; bit < 8 * bytes.size(); ++bit) {
    std::string flipped = bytes;
    flipped[bit / 8] = static_cast<char>(flipped[bit / 8] ^ (1 << (bit % 8)));
    EXPECT_EQ(ParsePiece(flipped, &read, &size), Parsed::kAltered) << bit;
  }
}

TEST(AuditFormatTest, OnlyTheKeyOfTheSegmentSigns) {
  const SigningKey key = *SigningKey::Generate();
  const SigningKey copy = *SigningKey::FromPrivate(*key.private_bytes());
  EXPECT_EQ(copy.public_key(), key.public_key());
  const std::string signature = *copy.Sign("text");
  EXPECT_TRUE(IsSignedBy(key.public_key(), "text", signature));
  EXPECT_FALSE(IsSignedBy(key.public_key(), "text.", signature));
  EXPECT_FALSE(IsSignedBy(SigningKey::Generate()->public_key(), "text", signature));
  EXPECT_FALSE(IsSignedBy("short", "text", signature));
  EXPECT_FALSE(IsSignedBy(key.public_key(), "text", "short"));
  EXPECT_FALSE(SigningKey::FromPrivate("short").ok());
}

}  // namespace
}  // namespace rips::audit
