#include "mode_actuator/decide/audit_head_keeper.h"

#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "mode_actuator/decide/actuator_state.h"

namespace rips::actuator {
namespace {

constexpr absl::string_view kMagic = "rips-actuator-audit-head 1";
constexpr absl::string_view kKeys[] = {"segment ", "key ", "sequence ", "hash ", "signature "};
constexpr size_t kValues = 5;

absl::Status Corrupt(absl::string_view why) {
  return absl::DataLossError(absl::StrCat("the audit head is corrupt: ", why));
}

bool IsHex(absl::string_view text) {
  return text.size() % 2 == 0 && text.find_first_not_of("0123456789abcdef") == text.npos;
}

// As `ripsctl audit verify --head` takes it.
std::string HeadText(const model::AuditHead& head) {
  return absl::StrCat(head.sequence, ":", absl::BytesToHexString(head.hash));
}

}  // namespace

std::string EncodeAuditHead(const model::AuditHead& head) {
  const std::string body = absl::StrCat(
      kMagic, "\n", kKeys[0], head.segment, "\n", kKeys[1], absl::BytesToHexString(head.public_key),
      "\n", kKeys[2], head.sequence, "\n", kKeys[3], absl::BytesToHexString(head.hash), "\n",
      kKeys[4], absl::BytesToHexString(head.signature), "\n");
  return absl::StrCat(body, absl::StrFormat("crc %08x\n", Crc32(body)));
}

absl::StatusOr<model::AuditHead> DecodeAuditHead(absl::string_view bytes) {
  if (bytes.size() > kAuditHeadBytesMax) return Corrupt("too long");
  const std::vector<absl::string_view> lines = absl::StrSplit(bytes, '\n');
  if (lines.size() != kValues + 3 || lines[0] != kMagic) return Corrupt("unknown format");
  absl::string_view values[kValues];
  for (size_t i = 0; i < kValues; ++i) {
    values[i] = lines[i + 1];
    if (!absl::ConsumePrefix(&values[i], kKeys[i])) {
      return Corrupt(absl::StrCat("no `", absl::StripTrailingAsciiWhitespace(kKeys[i]), "`"));
    }
  }
  model::AuditHead head;
  if (!absl::SimpleAtoi(values[0], &head.segment) || !absl::SimpleAtoi(values[2], &head.sequence) ||
      !IsHex(values[1]) || !IsHex(values[3]) || !IsHex(values[4])) {
    return Corrupt("not numbers and hexadecimal digits");
  }
  head.public_key = absl::HexStringToBytes(values[1]);
  head.hash = absl::HexStringToBytes(values[3]);
  head.signature = absl::HexStringToBytes(values[4]);
  if (!head.whole()) return Corrupt("a part is missing or out of range");
  // Written again it must be the same bytes: that covers the checksum and every other spelling.
  if (EncodeAuditHead(head) != bytes) return Corrupt("wrong checksum");
  return head;
}

std::string AuditHeadKeeper::OnLease(const model::AuditHead& head) {
  if (head.none() || head == head_) return "";
  const model::AuditHead before = std::exchange(head_, head);
  changed_ = true;
  const bool other_key = head.segment == before.segment && head.public_key != before.public_key;
  if (before.none() ||
      (!other_key && head.segment >= before.segment && head.sequence > before.sequence)) {
    return "";
  }
  return absl::StrCat("the server's audit log ended at ", HeadText(before), " in segment ",
                      before.segment, " and now ends at ", HeadText(head), " in segment ",
                      head.segment, ": it was put back or replaced");
}

std::optional<std::string> AuditHeadKeeper::TakeWrite(int64_t boottime_ns) {
  if (!changed_ || (written_ns_ && boottime_ns - *written_ns_ < kWriteNs)) return std::nullopt;
  changed_ = false;
  written_ns_ = boottime_ns;
  return EncodeAuditHead(head_);
}

}  // namespace rips::actuator
