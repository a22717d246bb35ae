// Verifies an audit log offline: no secret is needed, and nothing is changed.
//
// A log is whole when each segment begins where the one before was sealed, each record and seal is
// as it was written and names the one before it, and the last seal of each segment is signed by
// that segment's key. FORMAT.md says what this proves, and what only `expected` heads do.
#ifndef RIPS_POLICY_SERVER_AUDIT_VERIFY_H_
#define RIPS_POLICY_SERVER_AUDIT_VERIFY_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "policy_server/audit/segments.h"

namespace rips::audit {

// The newest sealed record of a log at some time; 0 = it had none. Whoever keeps one can later
// prove that the log they see still has what it had then.
struct Head {
  uint64_t sequence = 0;
  // That record's.
  std::string hash;

  friend bool operator==(const Head&, const Head&) = default;
};
// `812:5f0c...`, hash in hex; and back, InvalidArgument for another form.
std::string FormatHead(const Head& head);
absl::StatusOr<Head> ParseHead(absl::string_view text);

struct Fault {
  enum class Kind {
    // Bytes are not as they were written.
    kAltered,
    // Records or segments are not there, and others follow them.
    kMissing,
    // Records or segments are there in another order, or twice.
    kReordered,
    // The end of a segment is not there: cut off, or never written.
    kTruncated,
    // An expected head is not in the log: it was put back to an older state, or replaced.
    kRolledBack,
  };
  Kind kind = Kind::kAltered;
  // The segment; empty if it is about the whole log.
  std::string file;
  // Where in it.
  uint64_t offset = 0;
  // Of the first record that is in doubt.
  uint64_t sequence = 0;
  // What was found, for people.
  std::string text;
};
// `altered`, `missing`, `reordered`, `truncated` or `rolled back`.
absl::string_view KindName(Fault::Kind kind);

// Bytes behind the last seal of a segment that another one follows: being written at a crash, never
// part of the log.
struct Torn {
  std::string file;
  uint64_t offset = 0;
  uint64_t bytes = 0;
};

struct Report {
  // The first that was found; nullopt = the log is whole.
  std::optional<Fault> fault;
  uint64_t segments = 0;
  // Proven by a seal.
  uint64_t records = 0;
  Head head;
  // SHA-256 of the first segment's public key: which log this is. Empty if it has none.
  std::string identity;
  std::vector<Torn> torn;
};

// The record `sequence`: an encoded AuditRecord. It is as it was written and in its place; that a
// seal proves it is known only from the report.
using Visit = absl::FunctionRef<void(uint64_t sequence, absl::string_view payload)>;

// Reads one segment at a time; stops at the first fault. An error is one of reading the files.
absl::StatusOr<Report> Verify(const Segments& segments, absl::Span<const Head> expected,
                              Visit visit);
absl::StatusOr<Report> Verify(const Segments& segments, absl::Span<const Head> expected = {});

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_AUDIT_VERIFY_H_
