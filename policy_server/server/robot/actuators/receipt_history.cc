#include "policy_server/server/robot/actuators/receipt_history.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace rips::pipeline {
namespace {

int Rank(Receipt::Stage stage) {
  switch (stage) {
    case Receipt::Stage::kAcknowledged:
      return 0;
    case Receipt::Stage::kUnknown:
      return 1;
    case Receipt::Stage::kRefused:
    case Receipt::Stage::kRefusedStale:
      return 2;
    case Receipt::Stage::kFailed:
      return 3;
    case Receipt::Stage::kSuperseded:
      return 4;
    case Receipt::Stage::kVerified:
      return 5;
  }
  return 0;
}

// Moves what fits from `text` to `out`, and counts it.
void Take(absl::string_view text, size_t bytes_max, size_t& left, std::string& out) {
  out = Harmless(text, std::min(bytes_max, left));
  left -= std::min(left, out.size());
}

void TakeEnd(const std::string& bytes, size_t& left, std::string& out) {
  const size_t kept = std::min({bytes.size(), kOutputBytesKept, left});
  out = bytes.substr(bytes.size() - kept);
  left -= kept;
}

// Removes the oldest entry for which `is_one` holds, if more than `limit` are.
template <typename Predicate>
void Limit(std::deque<LoggedReceipt>& receipts, size_t limit, const Predicate& is_one) {
  const auto count = std::count_if(receipts.begin(), receipts.end(), is_one);
  if (static_cast<size_t>(count) <= limit) return;
  receipts.erase(std::find_if(receipts.begin(), receipts.end(), is_one));
}

}  // namespace

std::string Harmless(absl::string_view text, size_t bytes_max) {
  constexpr absl::string_view kCut = "...";
  const size_t room = bytes_max - std::min(bytes_max, kCut.size());
  size_t fits = 0;  // of `out`, with kCut behind it
  std::string out;
  for (const char c : text) {
    if (c >= 0x20 && c < 0x7f) {
      out.push_back(c);
    } else {
      absl::StrAppendFormat(&out, "\\x%02x", static_cast<unsigned char>(c));
    }
    if (out.size() <= room) fits = out.size();
    if (out.size() <= bytes_max) continue;
    out.resize(fits);
    if (bytes_max >= kCut.size()) absl::StrAppend(&out, kCut);
    break;
  }
  return out;
}

std::string CommandText(const Command& command) {
  if (const auto* set = std::get_if<SetLevel>(&command.what)) {
    return absl::StrCat("level ", set->to);
  }
  if (const auto* drill = std::get_if<Drill>(&command.what)) {
    return absl::StrCat("drill ", drill->level);
  }
  return absl::StrCat("exec ", std::get<RunProgram>(command.what).program);
}

Receipt Trimmed(const Receipt& receipt, size_t bytes_max) {
  size_t left = bytes_max;
  Receipt kept = receipt;
  const size_t steps = std::min(receipt.steps.size(), kReceiptStepsKept);
  kept.steps.resize(steps);
  Take(receipt.command_id, kStepNameBytesKept, left, kept.command_id);
  Take(receipt.effective_level, kStepNameBytesKept, left, kept.effective_level);
  Take(receipt.detail, kDetailBytesKept, left, kept.detail);
  for (size_t i = 0; i < steps; ++i) {
    Take(receipt.steps[i].step, kStepNameBytesKept, left, kept.steps[i].step);
  }
  TakeEnd(receipt.output_tail, left, kept.output_tail);
  for (const bool ok : {false, true}) {
    for (size_t i = 0; i < steps; ++i) {
      if (receipt.steps[i].ok != ok) continue;
      Take(receipt.steps[i].detail, kDetailBytesKept, left, kept.steps[i].detail);
    }
    for (size_t i = 0; i < steps; ++i) {
      if (receipt.steps[i].ok != ok) continue;
      TakeEnd(receipt.steps[i].output_tail, left, kept.steps[i].output_tail);
    }
  }
  return kept;
}

std::string FailureText(const Receipt& receipt) {
  std::string text;
  for (const StepResult& step : receipt.steps) {
    if (step.ok) continue;
    absl::StrAppend(&text, text.empty() ? "" : "; ", step.step, step.detail.empty() ? "" : ": ",
                    step.detail);
    if (text.size() > kDetailBytesKept) break;
  }
  return Harmless(text.empty() ? receipt.detail : text, kDetailBytesKept);
}

void ReceiptHistory::Sent(const std::string& host, const Command& command) {
  const bool known = std::any_of(commands_.begin(), commands_.end(), [&](const Known& each) {
    return each.host == host && each.id == command.id;
  });
  if (known) return;
  commands_.push_back({host, command.id, CommandText(command)});
  if (commands_.size() > kCommandsKnown) commands_.pop_front();
}

const LoggedReceipt* ReceiptHistory::Received(const std::string& host, const Receipt& receipt,
                                              int64_t unix_ns) {
  LoggedReceipt added{.unix_ns = unix_ns, .host = host, .receipt = Trimmed(receipt)};
  const auto old = std::find_if(receipts_.begin(), receipts_.end(), [&](const LoggedReceipt& each) {
    return each.host == host && each.receipt.command_id == added.receipt.command_id;
  });
  bool moves_up = true;
  if (old != receipts_.end()) {
    moves_up = Rank(receipt.stage) > Rank(old->receipt.stage);
    if (Rank(receipt.stage) < Rank(old->receipt.stage) || added.receipt == old->receipt) {
      return nullptr;
    }
    added.command = std::move(old->command);
    receipts_.erase(old);
  } else {
    const auto command = std::find_if(commands_.begin(), commands_.end(), [&](const Known& each) {
      return each.host == host && each.id == receipt.command_id;
    });
    added.command = command == commands_.end() ? std::string(kUnknownCommand) : command->text;
  }
  receipts_.push_back(std::move(added));
  MakeRoom(receipts_.back());
  const LoggedReceipt& logged = receipts_.back();
  return moves_up && logged.command != kUnknownCommand ? &logged : nullptr;
}

void ReceiptHistory::MakeRoom(const LoggedReceipt& added) {
  if (added.command == kUnknownCommand) {
    Limit(receipts_, kStrangeReceiptsKept,
          [](const LoggedReceipt& each) { return each.command == kUnknownCommand; });
  } else if (!added.receipt.decision_id.none()) {
    Limit(receipts_, kAttemptsKept,
          [host = added.host, decision_id = added.receipt.decision_id](const LoggedReceipt& each) {
            return each.host == host && each.receipt.decision_id == decision_id &&
                   each.command != kUnknownCommand;
          });
  }
  if (receipts_.size() > kReceiptsKept) receipts_.pop_front();
}

std::vector<LoggedReceipt> ReceiptHistory::Newest(size_t limit) const {
  const size_t count = limit == 0 ? receipts_.size() : std::min(limit, receipts_.size());
  return {receipts_.rbegin(), receipts_.rbegin() + static_cast<std::ptrdiff_t>(count)};
}

}  // namespace rips::pipeline
