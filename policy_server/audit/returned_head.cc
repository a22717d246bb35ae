#include "policy_server/audit/returned_head.h"

#include <algorithm>
#include <map>
#include <optional>
#include <string>

#include "policy_server/audit/format.h"
#include "policy_server/audit/signing_key.h"
#include "services/base/status_macros.h"

namespace rips::audit {
namespace {

// Hashes of the records of `wanted` sequences that a segment holds. What is behind a piece that is
// altered is not held.
std::map<uint64_t, std::string> HashesIn(absl::string_view bytes,
                                         const std::map<uint64_t, std::string>& wanted) {
  std::map<uint64_t, std::string> found;
  size_t at = kHeaderBytes;
  Piece piece;
  size_t size = 0;
  while (at < bytes.size() && ParsePiece(bytes.substr(at), &piece, &size) == Parsed::kPiece) {
    at += size;
    if (piece.kind == Piece::Kind::kRecord && wanted.contains(piece.sequence)) {
      found[piece.sequence] = piece.hash;
    }
  }
  return found;
}

}  // namespace

const char* ToString(HeadVerdict verdict) {
  switch (verdict) {
    case HeadVerdict::kHeld:
      return "held";
    case HeadVerdict::kContradicted:
      return "contradicted";
    case HeadVerdict::kUnknownSegment:
      return "unknown_segment";
    case HeadVerdict::kOlder:
      return "older";
    case HeadVerdict::kForged:
      return "forged";
  }
  return "?";
}

absl::StatusOr<std::vector<HeadVerdict>> CompareHeads(const Segments& segments, uint64_t segment,
                                                      absl::Span<const model::AuditHead> heads) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<std::string> names, segments.Names());
  const std::string name = SegmentName(segment);
  if (std::find(names.begin(), names.end(), name) == names.end()) {
    const bool older = !names.empty() && segment < SegmentNumber(names.front());
    return std::vector<HeadVerdict>(heads.size(),
                                    older ? HeadVerdict::kOlder : HeadVerdict::kUnknownSegment);
  }
  RIPS_ASSIGN_OR_RETURN(const std::string start, segments.Read(name, kHeaderBytes));
  const std::optional<SegmentHeader> header = DecodeHeader(start);
  std::vector<HeadVerdict> verdicts(heads.size(), HeadVerdict::kUnknownSegment);
  if (!header || header->number != segment) return verdicts;
  std::map<uint64_t, std::string> wanted;
  for (size_t i = 0; i < heads.size(); ++i) {
    const model::AuditHead& head = heads[i];
    if (head.public_key != header->public_key) continue;
    const bool is_signed =
        IsSignedBy(head.public_key, SealToSign(segment, head.sequence, head.hash), head.signature);
    verdicts[i] = is_signed ? HeadVerdict::kContradicted : HeadVerdict::kForged;
    if (is_signed) wanted[head.sequence];
  }
  if (wanted.empty()) return verdicts;
  RIPS_ASSIGN_OR_RETURN(const std::string bytes, segments.Read(name, Segments::kAll));
  const std::map<uint64_t, std::string> found = HashesIn(bytes, wanted);
  for (size_t i = 0; i < heads.size(); ++i) {
    if (verdicts[i] != HeadVerdict::kContradicted) continue;
    const auto record = found.find(heads[i].sequence);
    if (record != found.end() && record->second == heads[i].hash) verdicts[i] = HeadVerdict::kHeld;
  }
  return verdicts;
}

}  // namespace rips::audit
