// The bytes of the audit log, as FORMAT.md draws them: segment headers and pieces (records, seals).
// No file is touched here. All functions may be called from any thread.
#ifndef RIPS_POLICY_SERVER_AUDIT_FORMAT_H_
#define RIPS_POLICY_SERVER_AUDIT_FORMAT_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "absl/functional/function_ref.h"
#include "absl/strings/string_view.h"

namespace rips::audit {

inline constexpr size_t kHashBytes = 32;
inline constexpr size_t kPublicKeyBytes = 32;
inline constexpr size_t kSignatureBytes = 64;
inline constexpr size_t kHeaderBytes = 208;
// Of a piece, before its payload; and around it, the hash behind it too.
inline constexpr size_t kPieceHeadBytes = 56;
inline constexpr size_t kPieceFrameBytes = kPieceHeadBytes + kHashBytes;
// Of one payload.
inline constexpr size_t kPayloadBytesMax = 64 * 1024;

// 32 bytes.
std::string Sha256(absl::string_view bytes);

// How a segment begins.
struct SegmentHeader {
  // From 1.
  uint64_t number = 0;
  // Of the first record in it.
  uint64_t first_sequence = 0;
  int64_t time_unix_ns = 0;
  // Bytes of the segment before that belong to the log, 0 in the first. What stands behind them was
  // being written at a crash.
  uint64_t previous_bytes = 0;
  // Of the last seal of the segment before, of its header if it has none; zeros in the first.
  std::string previous_hash = std::string(kHashBytes, '\0');
  std::string public_key;
  // Of the bytes before it, by the key of the segment before; by its own in the first.
  std::string signature;
};

// What `signature` signs.
std::string HeaderToSign(const SegmentHeader& header);
// kHeaderBytes.
std::string EncodeHeader(const SegmentHeader& header);
// nullopt: fewer bytes than a header, or not one as it was written. The signature is not checked.
std::optional<SegmentHeader> DecodeHeader(absl::string_view bytes);

// A record, or the seal behind a group of them.
struct Piece {
  enum class Kind { kRecord, kSeal } kind = Kind::kRecord;
  // A record's own, from 1; a seal's is that of the record before it.
  uint64_t sequence = 0;
  // Of the piece before, or of the segment's header.
  std::string previous_hash;
  // A record's AuditRecord; a seal's signature of SealToSign.
  std::string payload;
  // Over all of the above; chains the next.
  std::string hash;
};

// Also sets piece.hash.
std::string EncodePiece(Piece& piece);

enum class Parsed {
  kPiece,
  // `bytes` ends within the piece.
  kCut,
  // A bit is not as it was written.
  kAltered,
};
// The piece at the start of `bytes`; `size` is how many it takes. Its place in the chain is not
// checked.
Parsed ParsePiece(absl::string_view bytes, Piece* piece, size_t* size);

// Whether a piece that is as it was written, and that `wanted` is true of, begins anywhere in
// `bytes`.
bool HasPiece(absl::string_view bytes, absl::FunctionRef<bool(const Piece&)> wanted);

// What the seal behind the record `sequence` signs; `hash` is that record's.
std::string SealToSign(uint64_t segment, uint64_t sequence, absl::string_view hash);

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_AUDIT_FORMAT_H_
