#include "policy_server/server/audit/segment_writer.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/audit/segments.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/file_lock.h"

namespace rips::audit {
namespace {

constexpr char kKey[] = "key";
constexpr char kNextKey[] = "key.next";
constexpr char kLock[] = "lock";

absl::Status Errno(absl::string_view what, const std::string& path) {
  return absl::ErrnoToStatus(errno, absl::StrCat("cannot ", what, " `", path, "`"));
}

// nullopt: there is none, or it was overwritten.
std::optional<SigningKey> ReadKey(const std::string& path) {
  const absl::StatusOr<std::string> text = ReadFile(path, 4 * kPublicKeyBytes);
  if (!text.ok() || text->size() != 2 * kPublicKeyBytes) return std::nullopt;
  absl::StatusOr<SigningKey> key = SigningKey::FromPrivate(absl::HexStringToBytes(*text));
  if (!key.ok()) return std::nullopt;
  return *std::move(key);
}

// The old content of `to` is overwritten before its name is taken. A file system that copies on
// write, or a flash disk, may keep it (FORMAT.md).
absl::Status ReplaceKey(const std::string& from, const std::string& to) {
  if (const UniqueFd old(open(to.c_str(), O_WRONLY | O_CLOEXEC | O_NOFOLLOW)); old.get() >= 0) {
    const std::string zeros(2 * kPublicKeyBytes, '0');
    if (pwrite(old.get(), zeros.data(), zeros.size(), 0) < 0 || fsync(old.get()) != 0) {
      return Errno("overwrite", to);
    }
  }
  if (rename(from.c_str(), to.c_str()) != 0) return Errno("rename", from);
  return absl::OkStatus();
}

// What a segment proves by itself.
struct End {
  uint64_t bytes = kHeaderBytes;
  std::string hash;
  Head head;
};

absl::Status Altered(absl::string_view name, absl::string_view what) {
  return absl::DataLossError(
      absl::StrCat("the audit log was altered: ", name, ": ", what,
                   "; `ripsctl audit verify` says more. Keep its directory as evidence, and "
                   "configure an empty one to begin a new log"));
}

absl::StatusOr<End> EndOf(absl::string_view name, absl::string_view bytes,
                          const SegmentHeader& header) {
  End end{.hash = Sha256(bytes.substr(0, kHeaderBytes)),
          .head = {.sequence = header.first_sequence - 1, .hash = ""}};
  End open = end;
  std::string signature;
  while (open.bytes < bytes.size()) {
    Piece piece;
    size_t size = 0;
    if (ParsePiece(bytes.substr(open.bytes), &piece, &size) != Parsed::kPiece) break;
    const bool record = piece.kind == Piece::Kind::kRecord;
    if (piece.previous_hash != open.hash ||
        piece.sequence != open.head.sequence + (record ? 1 : 0)) {
      break;
    }
    open.bytes += size;
    open.hash = piece.hash;
    if (record) {
      open.head = {piece.sequence, piece.hash};
    } else {
      end = open;
      signature = piece.payload;
    }
  }
  // A crash leaves no seal behind what it cut.
  const auto is_seal = [](const Piece& piece) { return piece.kind == Piece::Kind::kSeal; };
  if (HasPiece(bytes.substr(open.bytes), is_seal)) {
    return Altered(name, absl::StrCat("at byte ", open.bytes));
  }
  if (!signature.empty() &&
      !IsSignedBy(header.public_key, SealToSign(header.number, end.head.sequence, end.head.hash),
                  signature)) {
    return Altered(name, "its last seal is not signed by its key");
  }
  return end;
}

}  // namespace

std::string SegmentWriter::PathOf(absl::string_view name) const {
  return absl::StrCat(directory_, "/", name);
}

absl::StatusOr<std::unique_ptr<SegmentWriter>> SegmentWriter::Open(const std::string& directory,
                                                                   uint64_t segment_bytes,
                                                                   int64_t unix_ns) {
  std::unique_ptr<SegmentWriter> writer(new SegmentWriter(directory, segment_bytes));
  if (mkdir(directory.c_str(), 0700) != 0 && errno != EEXIST) return Errno("create", directory);
  RIPS_RETURN_IF_ERROR(writer->Lock());
  RIPS_ASSIGN_OR_RETURN(const std::vector<std::string> names,
                        SegmentsInDirectory(directory).Names());
  if (names.empty()) {
    if (ReadKey(writer->PathOf(kKey))) {
      return absl::DataLossError(absl::StrCat(
          "the audit log's segments are gone from `", directory,
          "`, its key is there; restore them, or configure an empty directory to begin a new log"));
    }
  } else {
    RIPS_RETURN_IF_ERROR(writer->Continue(names.back()));
  }
  if (names.empty() || writer->torn_) RIPS_RETURN_IF_ERROR(writer->BeginSegment(unix_ns));
  return writer;
}

absl::Status SegmentWriter::Lock() {
  absl::StatusOr<UniqueFd> lock = LockFile(PathOf(kLock));
  if (absl::IsFailedPrecondition(lock.status())) {
    return absl::FailedPreconditionError(
        absl::StrCat("another process writes the audit log in `", directory_, "`"));
  }
  RIPS_RETURN_IF_ERROR(lock.status());
  lock_ = *std::move(lock);
  return absl::OkStatus();
}

absl::Status SegmentWriter::Continue(const std::string& name) {
  RIPS_ASSIGN_OR_RETURN(const std::string bytes,
                        SegmentsInDirectory(directory_).Read(name, Segments::kAll));
  const std::optional<SegmentHeader> header = DecodeHeader(bytes);
  if (!header || header->number != SegmentNumber(name)) return Altered(name, "its header");
  RIPS_ASSIGN_OR_RETURN(const End end, EndOf(name, bytes, *header));
  number_ = header->number;
  bytes_ = end.bytes;
  hash_ = end.hash;
  head_ = end.head;
  torn_ = end.bytes < bytes.size();
  RIPS_RETURN_IF_ERROR(FindKey(header->public_key));
  return OpenSegment();
}

absl::Status SegmentWriter::FindKey(const std::string& public_key) {
  const std::string next = PathOf(kNextKey);
  key_ = ReadKey(next);
  if (key_ && key_->public_key() == public_key) return ReplaceKey(next, PathOf(kKey));
  key_ = ReadKey(PathOf(kKey));
  if (key_ && key_->public_key() == public_key) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(
      "`", PathOf(kKey), "` is not the key of the audit log's last segment, ", SegmentName(number_),
      ": restore it; or keep the directory, and configure an empty one to begin a new log"));
}

absl::Status SegmentWriter::OpenSegment() {
  const std::string path = PathOf(SegmentName(number_));
  file_ = UniqueFd(open(path.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC | O_NOFOLLOW));
  return file_.get() < 0 ? Errno("open", path) : absl::OkStatus();
}

absl::Status SegmentWriter::BeginSegment(int64_t unix_ns) {
  RIPS_ASSIGN_OR_RETURN(SigningKey key, SigningKey::Generate());
  SegmentHeader header{.number = number_ + 1,
                       .first_sequence = head_.sequence + 1,
                       .time_unix_ns = unix_ns,
                       .previous_bytes = bytes_,
                       .previous_hash = hash_,
                       .public_key = key.public_key()};
  RIPS_ASSIGN_OR_RETURN(header.signature, (key_ ? *key_ : key).Sign(HeaderToSign(header)));
  const std::string bytes = EncodeHeader(header);
  RIPS_ASSIGN_OR_RETURN(const std::string secret, key.private_bytes());
  // In this order: a crash leaves a segment without key, or a key without segment, never neither.
  RIPS_RETURN_IF_ERROR(WriteFileAtomically(PathOf(kNextKey), absl::BytesToHexString(secret)));
  RIPS_RETURN_IF_ERROR(WriteFileAtomically(PathOf(SegmentName(header.number)), bytes));
  key_ = std::move(key);
  number_ = header.number;
  bytes_ = bytes.size();
  hash_ = Sha256(bytes);
  torn_ = false;
  RIPS_RETURN_IF_ERROR(OpenSegment());
  return ReplaceKey(PathOf(kNextKey), PathOf(kKey));
}

absl::Status SegmentWriter::Write(absl::string_view bytes) {
  const std::string path = PathOf(SegmentName(number_));
  torn_ = true;
  while (!bytes.empty()) {
    const ssize_t written = write(file_.get(), bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) {
      const absl::Status status = Errno("write", path);
      // Not durable, never sealed: a full disk gets its space back.
      if (ftruncate(file_.get(), static_cast<off_t>(bytes_)) == 0) torn_ = false;
      return status;
    }
    bytes.remove_prefix(static_cast<size_t>(written));
  }
  if (fdatasync(file_.get()) != 0) return Errno("sync", path);
  torn_ = false;
  return absl::OkStatus();
}

absl::Status SegmentWriter::Append(absl::Span<const std::string> payloads, int64_t unix_ns) {
  const bool full = bytes_ >= segment_bytes_ && bytes_ > kHeaderBytes;
  if (torn_ || full || file_.get() < 0) RIPS_RETURN_IF_ERROR(BeginSegment(unix_ns));
  std::string out;
  std::string hash = hash_;
  Head head = head_;
  for (const std::string& payload : payloads) {
    Piece record{.sequence = head.sequence + 1, .previous_hash = hash, .payload = payload};
    absl::StrAppend(&out, EncodePiece(record));
    hash = record.hash;
    head = {record.sequence, record.hash};
  }
  Piece seal{.kind = Piece::Kind::kSeal, .sequence = head.sequence, .previous_hash = hash};
  RIPS_ASSIGN_OR_RETURN(seal.payload, key_->Sign(SealToSign(number_, head.sequence, head.hash)));
  absl::StrAppend(&out, EncodePiece(seal));
  RIPS_RETURN_IF_ERROR(Write(out));
  bytes_ += out.size();
  hash_ = seal.hash;
  sealed_ = {.segment = number_,
             .public_key = key_->public_key(),
             .sequence = head.sequence,
             .hash = head.hash,
             .signature = std::move(seal.payload)};
  head_ = std::move(head);
  return absl::OkStatus();
}

}  // namespace rips::audit
