// Logs in memory for tests, made as the server makes them.
#ifndef RIPS_POLICY_SERVER_AUDIT_LOG_SAMPLES_H_
#define RIPS_POLICY_SERVER_AUDIT_LOG_SAMPLES_H_

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "policy_server/audit/format.h"
#include "policy_server/audit/segments.h"
#include "policy_server/audit/signing_key.h"
#include "policy_server/audit/verify.h"
#include "services/model/audit_head.h"

namespace rips::audit {

// Files by name.
class SegmentsInMemory final : public Segments {
 public:
  std::map<std::string, std::string> files;

  absl::StatusOr<std::vector<std::string>> Names() const override {
    std::vector<std::string> names;
    for (const auto& [name, bytes] : files) names.push_back(name);
    return names;
  }
  absl::StatusOr<std::string> Read(absl::string_view name, uint64_t bytes_max) const override {
    return files.at(std::string(name)).substr(0, bytes_max);
  }
};

// Writes segments; each group is sealed.
class SampleLog {
 public:
  SegmentsInMemory segments;
  Head head;
  // The same with its proof.
  model::AuditHead proven;

  void BeginSegment() {
    const auto key = std::make_shared<const SigningKey>(*SigningKey::Generate());
    SegmentHeader header{.number = ++number_,
                         .first_sequence = head.sequence + 1,
                         .time_unix_ns = 1,
                         .previous_bytes = sealed_,
                         .previous_hash = hash_,
                         .public_key = key->public_key()};
    header.signature = *(key_ ? key_ : key)->Sign(HeaderToSign(header));
    key_ = key;
    const std::string bytes = EncodeHeader(header);
    segments.files[SegmentName(number_)] = bytes;
    hash_ = Sha256(bytes);
    sealed_ = bytes.size();
  }
  void Group(size_t records) {
    std::string& file = segments.files[SegmentName(number_)];
    for (size_t i = 0; i < records; ++i) {
      Piece piece{.sequence = head.sequence + 1,
                  .previous_hash = hash_,
                  .payload = absl::StrCat("record ", head.sequence + 1)};
      absl::StrAppend(&file, EncodePiece(piece));
      hash_ = piece.hash;
      head = {piece.sequence, piece.hash};
    }
    Piece seal{.kind = Piece::Kind::kSeal,
               .sequence = head.sequence,
               .previous_hash = hash_,
               .payload = *key_->Sign(SealToSign(number_, head.sequence, head.hash))};
    absl::StrAppend(&file, EncodePiece(seal));
    proven = {number_, key_->public_key(), head.sequence, head.hash, seal.payload};
    hash_ = seal.hash;
    sealed_ = file.size();
  }
  std::string& file(uint64_t number) { return segments.files[SegmentName(number)]; }

 private:
  uint64_t number_ = 0;
  std::string hash_ = std::string(kHashBytes, '\0');
  uint64_t sealed_ = 0;
  std::shared_ptr<const SigningKey> key_;
};

// Two segments of 3 and 2 records, in two groups each.
inline SampleLog TwoSegments() {
  SampleLog log;
  log.BeginSegment();
  log.Group(2);
  log.Group(1);
  log.BeginSegment();
  log.Group(1);
  log.Group(1);
  return log;
}

// Where the pieces of a segment begin, and its end.
inline std::vector<size_t> PieceStarts(absl::string_view file) {
  std::vector<size_t> starts;
  size_t at = kHeaderBytes;
  Piece piece;
  size_t size = 0;
  while (at < file.size() && ParsePiece(file.substr(at), &piece, &size) == Parsed::kPiece) {
    starts.push_back(at);
    at += size;
  }
  starts.push_back(at);
  return starts;
}

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_AUDIT_LOG_SAMPLES_H_
