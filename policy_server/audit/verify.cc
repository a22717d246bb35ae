#include "policy_server/audit/verify.h"

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "policy_server/audit/format.h"
#include "policy_server/audit/signing_key.h"
#include "services/base/status_macros.h"

namespace rips::audit {
namespace {

// Up to where the chain was followed.
struct Place {
  uint64_t bytes = 0;
  // Of the last record.
  uint64_t sequence = 0;
  // Of the last piece, which the next one names.
  std::string hash;
  // Of the last record, which a seal signs.
  std::string record_hash;
};

struct Seal {
  // Of the seal itself.
  uint64_t offset = 0;
  std::string signature;
  // Behind it.
  Place place;
};

bool IsSeal(const Piece& piece) { return piece.kind == Piece::Kind::kSeal; }

class Verifier {
 public:
  Verifier(const Segments& segments, absl::Span<const Head> expected, Visit visit)
      : segments_(segments), expected_(expected.begin(), expected.end()), visit_(visit) {}

  absl::StatusOr<Report> Run() {
    RIPS_ASSIGN_OR_RETURN(names_, segments_.Names());
    for (size_t i = 0; i < names_.size() && !report_.fault; ++i) {
      RIPS_ASSIGN_OR_RETURN(const std::string bytes, segments_.Read(names_[i], Segments::kAll));
      RIPS_RETURN_IF_ERROR(CheckSegment(i, bytes));
    }
    if (!report_.fault) CheckExpected();
    return std::move(report_);
  }

 private:
  void Found(Fault::Kind kind, uint64_t offset, uint64_t sequence, std::string text) {
    if (report_.fault) return;
    report_.fault = {kind, file_, offset, sequence, std::move(text)};
  }

  absl::StatusOr<std::optional<SegmentHeader>> HeaderOf(size_t index) const {
    if (index >= names_.size()) return std::optional<SegmentHeader>();
    RIPS_ASSIGN_OR_RETURN(const std::string bytes, segments_.Read(names_[index], kHeaderBytes));
    return DecodeHeader(bytes);
  }

  absl::Status CheckSegment(size_t index, absl::string_view bytes) {
    file_ = names_[index];
    const std::optional<SegmentHeader> header = DecodeHeader(bytes);
    if (!CheckHeader(header, bytes)) return absl::OkStatus();
    ++report_.segments;
    Place place{.bytes = kHeaderBytes,
                .sequence = place_.sequence,
                .hash = Sha256(bytes.substr(0, kHeaderBytes))};
    // How much of it belongs to the log, as the next segment says.
    RIPS_ASSIGN_OR_RETURN(const std::optional<SegmentHeader> next, HeaderOf(index + 1));
    const bool last = index + 1 == names_.size();
    const bool continued = next && next->number == header->number + 1;
    const uint64_t counted =
        continued ? std::max<uint64_t>(next->previous_bytes, kHeaderBytes) : bytes.size();
    end_known_ = last || continued;
    seals_.clear();
    RIPS_RETURN_IF_ERROR(Follow(index, bytes.substr(0, counted), place));
    if (report_.fault) return absl::OkStatus();
    place_ = seals_.empty()
                 ? Place{kHeaderBytes, place_.sequence, Sha256(bytes.substr(0, kHeaderBytes)), ""}
                 : seals_.back().place;
    key_ = header->public_key;
    if (!CheckSeals(header->number, place.sequence)) return absl::OkStatus();
    report_.records = place_.sequence;
    if (!seals_.empty()) report_.head = {place_.sequence, place_.record_hash};
    if (bytes.size() < counted || (last && place_.bytes < bytes.size())) {
      Found(Fault::Kind::kTruncated, place_.bytes, place_.sequence + 1,
            last ? absl::StrCat("the last ", bytes.size() - place_.bytes,
                                " bytes are not sealed: being written now, lost in a crash, or "
                                "cut off")
                 : absl::StrCat("the segment has ", bytes.size(), " of its ", counted, " bytes"));
    } else if (continued && place_.bytes < counted) {
      Found(Fault::Kind::kAltered, place_.bytes, place_.sequence + 1,
            "the next segment counts bytes that no seal covers");
    } else if (bytes.size() > counted) {
      report_.torn.push_back({file_, counted, bytes.size() - counted});
    }
    return absl::OkStatus();
  }

  bool CheckHeader(const std::optional<SegmentHeader>& header, absl::string_view bytes) {
    const uint64_t next = place_.sequence + 1;
    const uint64_t named = SegmentNumber(file_);
    if (!header) {
      const bool cut = bytes.size() < kHeaderBytes;
      Found(cut ? Fault::Kind::kTruncated : Fault::Kind::kAltered, 0, next,
            cut ? "the segment ends within its header" : "the segment's header was altered");
      return false;
    }
    if (header->number != named) {
      Found(Fault::Kind::kReordered, 0, next,
            absl::StrCat("the file holds segment ", header->number));
      return false;
    }
    if (named != report_.segments + 1) {
      Found(
          Fault::Kind::kMissing, 0, next,
          named == report_.segments + 2
              ? absl::StrCat("segment ", report_.segments + 1, " is missing")
              : absl::StrCat("segments ", report_.segments + 1, " to ", named - 1, " are missing"));
      return false;
    }
    const bool first = named == 1;
    if (first) report_.identity = Sha256(header->public_key);
    const std::string previous = first ? std::string(kHashBytes, '\0') : place_.hash;
    if (!IsSignedBy(first ? header->public_key : key_, HeaderToSign(*header), header->signature)) {
      Found(Fault::Kind::kAltered, 0, next,
            first ? "the header is not signed by its own key"
                  : "the header is not signed by the key of the segment before");
      return false;
    }
    if (header->previous_hash != previous || header->first_sequence != next ||
        header->previous_bytes != place_.bytes) {
      Found(Fault::Kind::kAltered, 0, next,
            "the header does not continue the segment before, which was altered");
      return false;
    }
    return true;
  }

  // Along the chain in `bytes`, from behind the header.
  absl::Status Follow(size_t index, absl::string_view bytes, Place place) {
    while (place.bytes < bytes.size()) {
      Piece piece;
      size_t size = 0;
      const Parsed parsed = ParsePiece(bytes.substr(place.bytes), &piece, &size);
      if (parsed == Parsed::kCut) return absl::OkStatus();
      if (parsed == Parsed::kAltered) {
        // A disk that lost power may leave zeros where the file was being extended.
        const bool zeros = bytes.find_first_not_of('\0', place.bytes) == absl::string_view::npos;
        if (!zeros && (end_known_ || HasPiece(bytes.substr(place.bytes), IsSeal))) {
          Found(Fault::Kind::kAltered, place.bytes, place.sequence + 1, "altered bytes");
        }
        return absl::OkStatus();
      }
      const bool record = piece.kind == Piece::Kind::kRecord;
      const uint64_t sequence = place.sequence + (record ? 1 : 0);
      if (piece.previous_hash != place.hash || piece.sequence != sequence ||
          (!record && place.record_hash.empty())) {
        return Misplaced(index, bytes.substr(place.bytes), place, piece);
      }
      const uint64_t offset = place.bytes;
      place.bytes += size;
      place.sequence = sequence;
      place.hash = piece.hash;
      if (record) {
        place.record_hash = piece.hash;
        Meet({sequence, piece.hash});
        visit_(sequence, piece.payload);
      } else {
        seals_.push_back({offset, piece.payload, place});
      }
    }
    return absl::OkStatus();
  }

  // A piece that is whole and not the next: is the next one somewhere behind it?
  absl::Status Misplaced(size_t index, absl::string_view rest, const Place& place,
                         const Piece& piece) {
    const auto next = [&](const Piece& each) { return each.previous_hash == place.hash; };
    bool elsewhere = HasPiece(rest, next);
    for (size_t i = index + 1; i < names_.size() && !elsewhere; ++i) {
      RIPS_ASSIGN_OR_RETURN(const std::string bytes, segments_.Read(names_[i], Segments::kAll));
      elsewhere = HasPiece(bytes, next);
    }
    const bool record = piece.kind == Piece::Kind::kRecord;
    const std::string here =
        absl::StrCat(record ? "record " : "the seal of record ", piece.sequence, " stands here");
    if (elsewhere || (record && piece.sequence <= place.sequence)) {
      Found(Fault::Kind::kReordered, place.bytes, place.sequence + 1,
            absl::StrCat(here, "; what belongs here ",
                         elsewhere ? "comes later" : "was before it already"));
    } else if (piece.sequence > place.sequence + (record ? 1 : 0)) {
      Found(Fault::Kind::kMissing, place.bytes, place.sequence + 1,
            absl::StrCat(here, "; records from ", place.sequence + 1, " on are missing"));
    } else {
      // The sequence fits, what it names as the one before is not there: a seal was taken out.
      Found(Fault::Kind::kMissing, place.bytes, place.sequence + 1,
            absl::StrCat(here, "; what stood before it is missing"));
    }
    return absl::OkStatus();
  }

  // The last seal proves all before it; if it does not, the first that does not is looked for.
  bool CheckSeals(uint64_t number, uint64_t before) {
    const auto good = [&](const Seal& seal) {
      return IsSignedBy(key_, SealToSign(number, seal.place.sequence, seal.place.record_hash),
                        seal.signature);
    };
    if (seals_.empty() || good(seals_.back())) return true;
    const auto bad = std::partition_point(seals_.begin(), seals_.end(), good);
    const uint64_t proven = bad == seals_.begin() ? before : std::prev(bad)->place.sequence;
    Found(Fault::Kind::kAltered, bad->offset, proven + 1,
          absl::StrCat("the seal behind record ", bad->place.sequence,
                       " is not signed by the segment's key: records were rewritten"));
    return false;
  }

  void Meet(const Head& head) {
    for (Head& expected : expected_) {
      if (expected.sequence != head.sequence) continue;
      if (expected.hash != head.hash) {
        file_.clear();
        Found(Fault::Kind::kRolledBack, 0, head.sequence,
              absl::StrCat("record ", head.sequence, " is another than it was: expected ",
                           FormatHead(expected), ", found ", FormatHead(head)));
      }
      expected.sequence = 0;
    }
  }

  void CheckExpected() {
    file_.clear();
    for (const Head& expected : expected_) {
      if (expected.sequence <= report_.records) continue;
      Found(Fault::Kind::kRolledBack, 0, report_.records + 1,
            absl::StrCat("the log ends with record ", report_.records, " and had ",
                         expected.sequence, " once"));
    }
  }

  const Segments& segments_;
  // Those met have sequence 0.
  std::vector<Head> expected_;
  Visit visit_;
  std::vector<std::string> names_;
  // Of the segment that is looked at.
  std::string file_;
  std::vector<Seal> seals_;
  // The next segment says how much of it belongs to the log, or there is none.
  bool end_known_ = true;
  // Of the segments before it.
  Place place_;
  std::string key_;
  Report report_;
};

}  // namespace

std::string FormatHead(const Head& head) {
  return absl::StrCat(head.sequence, ":", absl::BytesToHexString(head.hash));
}

absl::StatusOr<Head> ParseHead(absl::string_view text) {
  const std::pair<absl::string_view, absl::string_view> parts = absl::StrSplit(text, ':');
  Head head;
  const bool hex = parts.second.size() == 2 * kHashBytes &&
                   std::all_of(parts.second.begin(), parts.second.end(), absl::ascii_isxdigit);
  if (!hex || !absl::SimpleAtoi(parts.first, &head.sequence) || head.sequence == 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "`", text, "` is no head; write SEQUENCE:HASH as `ripsctl audit verify` prints it"));
  }
  head.hash = absl::HexStringToBytes(parts.second);
  return head;
}

absl::string_view KindName(Fault::Kind kind) {
  switch (kind) {
    case Fault::Kind::kAltered:
      return "altered";
    case Fault::Kind::kMissing:
      return "missing";
    case Fault::Kind::kReordered:
      return "reordered";
    case Fault::Kind::kTruncated:
      return "truncated";
    case Fault::Kind::kRolledBack:
      return "rolled back";
  }
  return "";
}

absl::StatusOr<Report> Verify(const Segments& segments, absl::Span<const Head> expected,
                              Visit visit) {
  return Verifier(segments, expected, visit).Run();
}

absl::StatusOr<Report> Verify(const Segments& segments, absl::Span<const Head> expected) {
  return Verify(segments, expected, [](uint64_t, absl::string_view) {});
}

}  // namespace rips::audit
