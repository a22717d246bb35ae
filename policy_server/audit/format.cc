#include "policy_server/audit/format.h"

#include <openssl/sha.h>

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace rips::audit {
namespace {

constexpr absl::string_view kSegmentMagic = "RIPSAUD1";
constexpr absl::string_view kRecordMagic = "RIPr";
constexpr absl::string_view kSealMagic = "RIPs";
constexpr size_t kHeaderSignedBytes = 144;
constexpr size_t kHeaderHashedBytes = 112;
// Magic, length and sequence of a piece; the first bytes of their hash follow.
constexpr size_t kCheckedBytes = 16;
constexpr size_t kCheckBytes = 8;

void PutNumber(uint64_t value, size_t bytes, std::string& out) {
  for (size_t i = 0; i < bytes; ++i) out.push_back(static_cast<char>(value >> (8 * i)));
}

uint64_t NumberAt(absl::string_view bytes, size_t at, size_t size) {
  uint64_t value = 0;
  for (size_t i = 0; i < size; ++i) {
    value |= uint64_t{static_cast<uint8_t>(bytes[at + i])} << (8 * i);
  }
  return value;
}

std::string Check(absl::string_view checked) { return Sha256(checked).substr(0, kCheckBytes); }

}  // namespace

std::string Sha256(absl::string_view bytes) {
  std::string hash(kHashBytes, '\0');
  SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(),
         reinterpret_cast<unsigned char*>(hash.data()));
  return hash;
}

std::string HeaderToSign(const SegmentHeader& header) {
  std::string out(kSegmentMagic);
  PutNumber(kHeaderBytes, 8, out);
  PutNumber(header.number, 8, out);
  PutNumber(header.first_sequence, 8, out);
  PutNumber(static_cast<uint64_t>(header.time_unix_ns), 8, out);
  PutNumber(header.previous_bytes, 8, out);
  absl::StrAppend(&out, header.previous_hash, header.public_key);
  absl::StrAppend(&out, Sha256(out));
  return out;
}

std::string EncodeHeader(const SegmentHeader& header) {
  return absl::StrCat(HeaderToSign(header), header.signature);
}

std::optional<SegmentHeader> DecodeHeader(absl::string_view bytes) {
  if (bytes.size() < kHeaderBytes) return std::nullopt;
  SegmentHeader header{
      .number = NumberAt(bytes, 16, 8),
      .first_sequence = NumberAt(bytes, 24, 8),
      .time_unix_ns = static_cast<int64_t>(NumberAt(bytes, 32, 8)),
      .previous_bytes = NumberAt(bytes, 40, 8),
      .previous_hash = std::string(bytes.substr(48, kHashBytes)),
      .public_key = std::string(bytes.substr(80, kPublicKeyBytes)),
      .signature = std::string(bytes.substr(kHeaderSignedBytes, kSignatureBytes)),
  };
  static_assert(80 + kPublicKeyBytes == kHeaderHashedBytes);
  if (HeaderToSign(header) != bytes.substr(0, kHeaderSignedBytes)) return std::nullopt;
  return header;
}

std::string EncodePiece(Piece& piece) {
  std::string out(piece.kind == Piece::Kind::kRecord ? kRecordMagic : kSealMagic);
  PutNumber(piece.payload.size(), 4, out);
  PutNumber(piece.sequence, 8, out);
  absl::StrAppend(&out, Check(out));
  absl::StrAppend(&out, piece.previous_hash, piece.payload);
  piece.hash = Sha256(out);
  absl::StrAppend(&out, piece.hash);
  return out;
}

Parsed ParsePiece(absl::string_view bytes, Piece* piece, size_t* size) {
  if (bytes.size() < kCheckedBytes + kCheckBytes) return Parsed::kCut;
  const absl::string_view magic = bytes.substr(0, kRecordMagic.size());
  const uint64_t length = NumberAt(bytes, 4, 4);
  if ((magic != kRecordMagic && magic != kSealMagic) || length > kPayloadBytesMax ||
      Check(bytes.substr(0, kCheckedBytes)) != bytes.substr(kCheckedBytes, kCheckBytes)) {
    return Parsed::kAltered;
  }
  *size = kPieceFrameBytes + length;
  if (bytes.size() < *size) return Parsed::kCut;
  const absl::string_view hashed = bytes.substr(0, *size - kHashBytes);
  piece->kind = magic == kRecordMagic ? Piece::Kind::kRecord : Piece::Kind::kSeal;
  piece->sequence = NumberAt(bytes, 8, 8);
  piece->previous_hash = std::string(hashed.substr(kCheckedBytes + kCheckBytes, kHashBytes));
  piece->payload = std::string(hashed.substr(kPieceHeadBytes));
  piece->hash = Sha256(hashed);
  if (piece->hash != bytes.substr(hashed.size(), kHashBytes)) return Parsed::kAltered;
  if (piece->kind == Piece::Kind::kSeal && length != kSignatureBytes) return Parsed::kAltered;
  return Parsed::kPiece;
}

bool HasPiece(absl::string_view bytes, absl::FunctionRef<bool(const Piece&)> wanted) {
  const auto next = [&](size_t from) {
    return std::min(bytes.find(kRecordMagic, from), bytes.find(kSealMagic, from));
  };
  for (size_t at = next(0); at != absl::string_view::npos; at = next(at + 1)) {
    Piece piece;
    size_t size = 0;
    if (ParsePiece(bytes.substr(at), &piece, &size) == Parsed::kPiece && wanted(piece)) return true;
  }
  return false;
}

std::string SealToSign(uint64_t segment, uint64_t sequence, absl::string_view hash) {
  std::string out = "RIPS audit seal 1";
  PutNumber(segment, 8, out);
  PutNumber(sequence, 8, out);
  absl::StrAppend(&out, hash);
  return out;
}

}  // namespace rips::audit
