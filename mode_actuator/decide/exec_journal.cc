#include "mode_actuator/decide/exec_journal.h"

#include <algorithm>

#include "absl/status/status.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "mode_actuator/decide/actuator_state.h"
#include "services/model/command.h"

namespace rips::actuator {
namespace {

constexpr absl::string_view kMagic = "rips-actuator-journal 1";

absl::Status Corrupt() { return absl::DataLossError("the journal of programs is corrupt"); }

}  // namespace

std::string ExecJournal::Encode() const {
  std::string text = absl::StrCat(kMagic, "\n");
  for (const Entry& entry : entries_) {
    absl::StrAppend(&text, entry.id, " ", static_cast<int>(entry.stage), " ", entry.exit_code,
                    "\n");
  }
  return absl::StrCat(text, absl::StrFormat("crc %08x\n", Crc32(text)));
}

absl::StatusOr<ExecJournal> ExecJournal::Decode(absl::string_view bytes) {
  if (bytes.size() > kJournalBytesMax) return Corrupt();
  const std::vector<absl::string_view> lines = absl::StrSplit(bytes, '\n');
  if (lines.size() < 3 || lines.size() - 3 > kExecIdsMax || lines[0] != kMagic) return Corrupt();
  ExecJournal decoded;
  for (size_t i = 1; i + 2 < lines.size(); ++i) {
    const std::vector<absl::string_view> words = absl::StrSplit(lines[i], ' ');
    Entry entry;
    int stage = 0;
    if (words.size() != 3 || words[0].size() != model::kCommandIdHexDigits ||
        words[0].find_first_not_of("0123456789abcdef") != absl::string_view::npos ||
        !absl::SimpleAtoi(words[1], &stage) || stage < 1 || stage > 7 ||
        !absl::SimpleAtoi(words[2], &entry.exit_code)) {
      return Corrupt();
    }
    entry.id = std::string(words[0]);
    entry.stage = static_cast<Receipt::Stage>(stage);
    decoded.entries_.push_back(std::move(entry));
  }
  // Written again it must be the same bytes: that covers the checksum too.
  if (decoded.Encode() != bytes) return Corrupt();
  return decoded;
}

Receipt ExecJournal::ToReceipt(const Entry& entry) {
  Receipt receipt;
  receipt.command_id = entry.id;
  receipt.stage = entry.stage;
  receipt.exit_code = entry.exit_code;
  return receipt;
}

std::optional<Receipt> ExecJournal::Find(absl::string_view id) const {
  for (const Entry& entry : entries_) {
    if (entry.id == id) return ToReceipt(entry);
  }
  return std::nullopt;
}

absl::Status ExecJournal::Begin(absl::string_view id) {
  if (entries_.size() >= kExecIdsMax) {
    const auto oldest = std::find_if(entries_.begin(), entries_.end(), [](const Entry& entry) {
      return entry.stage != Receipt::Stage::kAcknowledged;
    });
    if (oldest == entries_.end()) {
      return absl::ResourceExhaustedError(
          absl::StrCat("programs under way exceed limit ", kExecIdsMax));
    }
    entries_.erase(oldest);
  }
  entries_.push_back({.id = std::string(id)});
  return absl::OkStatus();
}

void ExecJournal::Finish(absl::string_view id, Receipt::Stage stage, int exit_code) {
  for (Entry& entry : entries_) {
    if (entry.id != id) continue;
    entry.stage = stage;
    entry.exit_code = exit_code;
  }
}

void ExecJournal::Forget(absl::string_view id) {
  std::erase_if(entries_, [&](const Entry& entry) { return entry.id == id; });
}

std::vector<Receipt> ExecJournal::CloseUnfinished() {
  std::vector<Receipt> unknown;
  for (Entry& entry : entries_) {
    if (entry.stage != Receipt::Stage::kAcknowledged) continue;
    entry.stage = Receipt::Stage::kUnknown;
    Receipt receipt = ToReceipt(entry);
    receipt.detail = "the actuator ended while the program ran";
    unknown.push_back(std::move(receipt));
  }
  return unknown;
}

}  // namespace rips::actuator
