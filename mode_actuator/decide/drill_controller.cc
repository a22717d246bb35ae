#include "mode_actuator/decide/drill_controller.h"

#include <algorithm>
#include <variant>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace rips::actuator {
namespace {

std::string FailedSteps(const std::vector<StepResult>& steps) {
  std::string text;
  for (const StepResult& step : steps) {
    if (step.ok) continue;
    absl::StrAppend(&text, text.empty() ? "" : "; ", step.step, ": ", step.detail);
  }
  if (text.size() > kDrillDetailBytesMax) {
    text.resize(kDrillDetailBytesMax);
    text.append("...");
  }
  return text;
}

}  // namespace

Receipt DrillController::OnCommand(const model::Command& command, bool admitted,
                                   const std::string& held,
                                   const std::function<bool(const DrillJob&)>& begin) {
  const std::string& level = std::get<model::Drill>(command.what).level;
  Receipt receipt;
  receipt.command_id = command.id;
  receipt.effective_level = held;
  receipt.stage = Receipt::Stage::kRefused;
  const auto known = std::find_if(receipts_.begin(), receipts_.end(), [&](const Receipt& each) {
    return each.command_id == command.id;
  });
  if (!admitted) {
    receipt.stage = Receipt::Stage::kRefusedStale;
    receipt.detail = absl::StrCat("term ", command.term, " is stale");
    return receipt;
  }
  if (known != receipts_.end()) return *known;
  if (std::find(levels_.begin(), levels_.end(), level) == levels_.end()) {
    receipt.detail = absl::StrCat("no level `", absl::CHexEscape(level.substr(0, 100)),
                                  "`; there are ", absl::StrJoin(levels_, ", "));
  } else if (!running_.empty()) {
    receipt.detail = "another drill runs";
  } else if (!begin({.id = command.id, .level = level, .held = held})) {
    receipt.detail = "a level is being applied";
  } else {
    running_ = command.id;
    receipt.stage = Receipt::Stage::kAcknowledged;
  }
  return Keep(std::move(receipt));
}

Receipt DrillController::OnOutcome(DrillOutcome outcome) {
  if (running_ == outcome.id) running_.clear();
  Receipt receipt;
  receipt.command_id = outcome.id;
  const auto known = std::find_if(receipts_.begin(), receipts_.end(), [&](const Receipt& each) {
    return each.command_id == outcome.id;
  });
  if (known != receipts_.end()) receipt.effective_level = known->effective_level;
  receipt.detail = FailedSteps(outcome.steps);
  if (outcome.cancelled) {
    receipt.stage = Receipt::Stage::kSuperseded;
    receipt.detail = "a level had to be applied";
  } else {
    const bool ok = std::all_of(outcome.steps.begin(), outcome.steps.end(),
                                [](const StepResult& step) { return step.ok; });
    receipt.stage = ok ? Receipt::Stage::kVerified : Receipt::Stage::kFailed;
  }
  receipt.steps = std::move(outcome.steps);
  return Keep(std::move(receipt));
}

Receipt DrillController::Keep(Receipt receipt) {
  std::erase_if(receipts_,
                [&](const Receipt& each) { return each.command_id == receipt.command_id; });
  receipts_.push_back(receipt);
  if (receipts_.size() > kDrillReceiptsMax) {
    // The drill that runs has still to be reported.
    const bool runs = receipts_.front().command_id == running_;
    receipts_.erase(receipts_.begin() + (runs ? 1 : 0));
  }
  return receipt;
}

}  // namespace rips::actuator
