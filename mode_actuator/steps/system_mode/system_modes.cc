#include "mode_actuator/steps/system_mode/system_modes.h"

#include <algorithm>
#include <optional>
#include <set>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/cancel_flag.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

// Is what is seen there to stay? True once it was seen for `needed` without a break.
class Settled {
 public:
  explicit Settled(absl::Duration needed) : needed_ns_(absl::ToInt64Nanoseconds(needed)) {}
  void Reset() { since_ns_ = kNever; }
  bool Saw(bool good, int64_t now_ns) {
    if (!good) since_ns_ = kNever;
    if (good && since_ns_ == kNever) since_ns_ = now_ns;
    return good && now_ns - since_ns_ >= needed_ns_;
  }

 private:
  static constexpr int64_t kNever = -1;
  const int64_t needed_ns_;
  int64_t since_ns_ = kNever;
};

bool IsOver(const absl::Status& status) { return status.ok() || absl::IsCancelled(status); }

}  // namespace

// One order, while it is carried out.
struct SystemModes::Task {
  Part& part;
  const std::string mode;
  const std::vector<ExpectedPart>& expected;
  const CancelFlag& cancel;
  const int64_t end_ns;
  // The manager that was ordered to the mode.
  std::optional<ros2::Guid> told;
};

// What one look at the robot gave.
struct SystemModes::View {
  ManagerView manager;
  std::vector<std::string> wrong_parts;
};

// What came of asking the manager once.
struct SystemModes::Attempt {
  ModeReading reading;
  bool hopeless = false;  // to ask it again would not help
};

absl::Status SystemModes::Add(const Smh& smh, const std::string& part, const std::string& mode) {
  Part& known = parts_.try_emplace(part, part).first->second;
  if (known.manager == nullptr && options_.backend == Backend::kManager) {
    RIPS_ASSIGN_OR_RETURN(known.manager, ManagerClient::Create(*participant_, part));
  }
  RIPS_ASSIGN_OR_RETURN(std::vector<ExpectedPart> expected, smh.Expected(part, mode));
  for (const ExpectedPart& node : expected) {
    if (options_.verify != Verify::kParts || nodes_.contains(node.node)) continue;
    RIPS_ASSIGN_OR_RETURN(nodes_[node.node], NodeClient::Create(*participant_, node.node));
  }
  known.modes.push_back(mode);
  targets_[{part, mode}] = std::move(expected);
  return absl::OkStatus();
}

SystemModes::View SystemModes::Poll(Part& part, absl::string_view mode,
                                    const std::vector<ExpectedPart>& expected,
                                    const CancelFlag& cancel) {
  View view;
  if (part.manager != nullptr) view.manager = part.manager->Poll(mode);
  if (options_.verify == Verify::kManager) return view;
  for (const ExpectedPart& node : expected) {
    std::string wrong = cancel.cancelled() ? "not asked" : nodes_.at(node.node)->Poll(node).wrong;
    if (!wrong.empty()) view.wrong_parts.push_back(std::move(wrong));
  }
  return view;
}

absl::Status SystemModes::Verdict(const View& view, bool silence_allowed,
                                  bool held_by_parts) const {
  if (!view.wrong_parts.empty()) {
    return absl::FailedPreconditionError(JoinParts(view.wrong_parts));
  }
  if (held_by_parts || view.manager.agrees) return absl::OkStatus();
  if (options_.verify == Verify::kParts && view.manager.silent && silence_allowed) {
    return absl::OkStatus();
  }
  return absl::FailedPreconditionError(view.manager.says);
}

bool SystemModes::OrderManager(Task& task, int64_t end_ns, Attempt& attempt) {
  ManagerClient& manager = *task.part.manager;
  const absl::StatusOr<bool> order = manager.Order(task.mode, absl::Nanoseconds(end_ns - NowNs()));
  if (order.ok() && *order) {
    task.told = manager.server();
    return true;
  }
  if (order.ok()) {
    task.told = manager.server();
    attempt.hopeless = true;
    attempt.reading.status =
        absl::InvalidArgumentError(absl::StrCat("the mode manager refuses ", QuoteBytes(task.mode),
                                                "; does it run with the same SMH file?"));
  } else {
    attempt.hopeless = may_go_direct();
    attempt.reading.status =
        absl::UnavailableError(absl::StrCat("the order failed: ", order.status().message()));
    // All have it: not again at once.
    if (absl::IsFailedPrecondition(order.status()) && !attempt.hopeless) {
      task.cancel.WaitFor(kReorderAfter);
    }
  }
  return false;
}

SystemModes::Attempt SystemModes::AskManager(Task& task, int64_t end_ns) {
  Attempt attempt;
  attempt.reading.status = absl::DeadlineExceededError("no time left");
  const bool flips = !task.part.unfinished.empty() && task.part.unfinished != task.mode;
  Settled settled(flips ? kFlipTime : absl::ZeroDuration());
  Settled lost(kReorderAfter);
  bool ordered = false;
  int64_t taken_ns = 0;
  while (NowNs() < end_ns) {
    if (task.cancel.cancelled()) {
      attempt.reading.status = absl::CancelledError("cancelled");
      return attempt;
    }
    if (!ordered) {
      ordered = OrderManager(task, end_ns, attempt);
      if (attempt.hopeless || absl::IsInvalidArgument(attempt.reading.status)) return attempt;
      taken_ns = NowNs();
    }
    if (ordered) {
      task.part.unfinished = task.mode;
      const View view = Poll(task.part, task.mode, task.expected, task.cancel);
      if (!view.manager.observed.empty()) attempt.reading.observed = view.manager.observed;
      const bool silence_allowed = NowNs() - taken_ns >= absl::ToInt64Nanoseconds(kManagerSilence);
      const absl::Status verdict = Verdict(view, silence_allowed, /*held_by_parts=*/false);
      if (settled.Saw(verdict.ok(), NowNs())) {
        task.part.unfinished.clear();
        attempt.reading.status = verdict;
        if (view.manager.observed.empty()) attempt.reading.observed = absl::CHexEscape(task.mode);
        return attempt;
      }
      attempt.reading.status = absl::DeadlineExceededError(absl::StrCat(
          "ordered, but not reached: ", verdict.ok() ? "not for long enough" : verdict.message()));
      // Resting elsewhere, or not the manager that was ordered.
      const std::optional<ros2::Guid> server = task.part.manager->server();
      if (lost.Saw(view.manager.elsewhere, NowNs()) ||
          (server.has_value() && server != task.told)) {
        ordered = false;
        lost.Reset();
      }
    }
    task.cancel.WaitFor(kReadPeriod);
  }
  return attempt;
}

ModeReading SystemModes::ThroughManager(Task& task, absl::Duration timeout, int attempts) {
  // What is left for orders to the nodes: the last attempt, or half of the only one.
  int64_t end_ns = task.end_ns;
  if (may_go_direct()) {
    end_ns -= absl::ToInt64Nanoseconds(attempts > 1 ? timeout : timeout / 2);
  }
  Attempt attempt;
  for (int i = 0; i < attempts && (i == 0 || NowNs() < end_ns); ++i) {
    attempt = AskManager(task, std::min(end_ns, NowNs() + absl::ToInt64Nanoseconds(timeout)));
    if (IsOver(attempt.reading.status) || attempt.hopeless) break;
  }
  return attempt.reading;
}

ModeReading SystemModes::Direct(Task& task, std::string why) {
  ModeReading reading;
  reading.status = OrderNodes(nodes_, task.expected, task.end_ns, *clock_, task.cancel);
  if (reading.status.ok()) {
    reading.observed = absl::CHexEscape(task.mode);
    if (!why.empty()) reading.note = absl::StrCat("held without the mode manager: ", why);
    task.part.hold.Reached(task.mode, std::move(why), task.told);
  } else if (absl::IsDeadlineExceeded(reading.status)) {
    reading.status = absl::DeadlineExceededError(
        absl::StrCat(why, why.empty() ? "" : "; ",
                     "ordered from the nodes, but not reached: ", reading.status.message()));
  }
  return reading;
}

ModeReading SystemModes::Enter(absl::string_view part_name, absl::string_view mode,
                               absl::Duration timeout, int retries, const CancelFlag& cancel) {
  ModeReading reading;
  const auto target = targets_.find({std::string(part_name), std::string(mode)});
  if (target == targets_.end()) {
    reading.status = absl::InvalidArgumentError("no target of any level");
    return reading;
  }
  Part& part = parts_.at(target->first.first);
  Task task{part,
            std::string(mode),
            target->second,
            cancel,
            NowNs() + absl::ToInt64Nanoseconds(timeout * (1 + retries)),
            std::nullopt};
  if (part.manager == nullptr) return Direct(task, "");
  if (may_go_direct()) {
    if (std::string why = part.hold.WhyNotManager(mode, NowNs()); !why.empty()) {
      task.told = part.manager->server();
      return Direct(task, std::move(why));
    }
    if (part.hold.direct()) {
      // It failed: whether it takes the order now, too, is seen by later checks.
      if (part.manager->OrderIfThere(mode).ok()) task.told = part.manager->server();
      return Direct(task, part.hold.without());
    }
  }
  reading = ThroughManager(task, timeout, 1 + retries);
  if (reading.status.ok()) part.hold.Reached(mode, "", task.told);
  if (IsOver(reading.status) || !may_go_direct()) return reading;
  return Direct(task, std::string(reading.status.message()));
}

void SystemModes::Follow(Part& part, absl::string_view mode, const View& view,
                         ModeReading& reading) {
  if (part.manager == nullptr || !part.hold.holds(mode)) return;
  if (!reading.status.ok()) {
    // It was asked before the parts; they may have moved in between.
    const std::string other = part.manager->Poll(mode).observed;
    if (!other.empty() && other != mode) {
      part.hold.Left(mode, other, NowNs());
      reading.status = absl::FailedPreconditionError(
          absl::StrCat(reading.status.message(), "; the mode manager left ", absl::CHexEscape(mode),
                       " for ", other));
    }
    return;
  }
  if (view.manager.agrees) part.hold.Agreed();
  const std::optional<ros2::Guid> server = part.manager->server();
  if (!server.has_value() || !view.manager.answers || !part.hold.IsNews(*server)) return;
  // Another manager than the one ordered, or one that did not get the order: its own target may be
  // any mode. Ordered once, whatever it answers.
  part.hold.Notified(*server);
  if (part.hold.WhyNotManager(mode, NowNs()).empty()) {
    part.manager->OrderIfThere(mode).status().IgnoreError();
  }
}

ModeReading SystemModes::Check(absl::string_view part_name, absl::string_view mode,
                               const CancelFlag& cancel) {
  ModeReading reading;
  const auto target = targets_.find({std::string(part_name), std::string(mode)});
  if (target == targets_.end()) {
    reading.status = absl::InvalidArgumentError("no target of any level");
    return reading;
  }
  Part& part = parts_.at(target->first.first);
  const View view = Poll(part, mode, target->second, cancel);
  const bool by_parts = part.manager == nullptr || (part.hold.direct() && part.hold.holds(mode));
  reading.status = Verdict(view, /*silence_allowed=*/true, by_parts);
  if (!view.manager.observed.empty()) reading.observed = view.manager.observed;
  if (reading.status.ok() && (by_parts || view.manager.observed.empty())) {
    reading.observed = absl::CHexEscape(mode);
  }
  if (!cancel.cancelled()) Follow(part, mode, view, reading);
  return reading;
}

absl::Status SystemModes::CheckManager(const std::string& name, Part& part,
                                       const std::vector<std::string>& modes) const {
  const absl::StatusOr<std::vector<std::string>> available = part.manager->AvailableModes();
  if (absl::IsDataLoss(available.status()) || absl::IsFailedPrecondition(available.status())) {
    return available.status();
  }
  if (!available.ok()) {
    return absl::UnavailableError(
        absl::StrCat("no mode manager of ", QuoteBytes(name), " answers"));
  }
  for (const std::string& mode : modes) {
    if (std::find(available->begin(), available->end(), mode) != available->end()) continue;
    return absl::FailedPreconditionError(absl::StrCat("the mode manager of ", QuoteBytes(name),
                                                      " has no mode ", QuoteBytes(mode),
                                                      "; it runs with another SMH file"));
  }
  return absl::OkStatus();
}

absl::Status SystemModes::CheckNode(const std::string& name, NodeClient& node) {
  const absl::StatusOr<uint8_t> state = node.State();
  if (absl::IsFailedPrecondition(state.status())) return state.status();
  if (!state.ok()) return absl::UnavailableError(absl::StrCat(name, " does not answer"));
  if (*state == kStateUnconfigured) {
    return absl::FailedPreconditionError(
        absl::StrCat(name, " is unconfigured: the mode manager will never configure it"));
  }
  if (*state == kStateFinalized) {
    return absl::FailedPreconditionError(
        absl::StrCat(name, " is finalized: its process must be started again"));
  }
  return absl::OkStatus();
}

absl::Status SystemModes::CheckAvailable() {
  absl::Status worst;
  unavailable_.clear();
  const auto found = [&](const absl::Status& status) {
    if (status.ok()) return;
    unavailable_.emplace_back(status.message());
    // What answers and is wrong says more than what is silent.
    if (worst.ok() || (absl::IsUnavailable(worst) && !absl::IsUnavailable(status))) worst = status;
  };
  for (auto& [name, part] : parts_) {
    if (part.manager != nullptr) found(CheckManager(name, part, part.modes));
  }
  for (auto& [name, node] : nodes_) found(CheckNode(name, *node));
  return worst;
}

std::vector<std::string> SystemModes::Degraded() const {
  std::vector<std::string> degraded;
  for (const auto& [name, part] : parts_) {
    std::string text = part.hold.Degraded(NowNs());
    if (!text.empty()) degraded.push_back(std::move(text));
  }
  degraded.insert(degraded.end(), unavailable_.begin(), unavailable_.end());
  return degraded;
}

ModeReading SystemModes::Probe(absl::string_view part_name, absl::string_view mode,
                               const CancelFlag& cancel) {
  ModeReading reading;
  const auto target = targets_.find({std::string(part_name), std::string(mode)});
  if (target == targets_.end()) {
    reading.status = absl::InvalidArgumentError("no target of any level");
    return reading;
  }
  Part& part = parts_.at(target->first.first);
  const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(kProbeTime);
  absl::StatusCode code = absl::StatusCode::kUnavailable;
  std::vector<std::string> wrong;
  const auto found = [&](const absl::Status& status) {
    if (status.ok()) return;
    if (!absl::IsUnavailable(status)) code = status.code();
    wrong.emplace_back(status.message());
  };
  if (part.manager != nullptr) {
    found(CheckManager(target->first.first, part, {target->first.second}));
    const ManagerView view = part.manager->Poll(mode);
    if (!view.observed.empty()) reading.observed = view.observed;
  }
  for (const ExpectedPart& expected : target->second) {
    const auto node = nodes_.find(expected.node);
    if (node == nodes_.end() || cancel.cancelled()) continue;
    if (NowNs() >= end_ns) {
      wrong.push_back(absl::StrCat(expected.node, " was not asked for want of time"));
      continue;
    }
    found(CheckNode(node->first, *node->second));
  }
  if (cancel.cancelled()) {
    reading.status = absl::CancelledError("cancelled");
  } else if (!wrong.empty()) {
    reading.status = absl::Status(code, JoinParts(wrong));
  }
  return reading;
}

const ExpectedPart* SystemModes::Expected(const std::string& part, const std::string& mode,
                                          const std::string& node) const {
  for (const ExpectedPart& expected : targets_.at({part, mode})) {
    if (expected.node == node) return &expected;
  }
  return nullptr;
}

bool SystemModes::KeepAgreeing(const std::string& part, const std::string& node,
                               std::vector<std::string>& modes) {
  std::vector<std::string> agreeing;
  for (const std::string& mode : modes) {
    const ExpectedPart* expected = Expected(part, mode, node);
    if (expected != nullptr) {
      const NodeView view = nodes_.at(node)->Poll(*expected, kSurveyReadTimeout);
      if (!view.complete) return false;
      if (!view.wrong.empty()) continue;
    }
    agreeing.push_back(mode);
  }
  modes = std::move(agreeing);
  return true;
}

PartReading SystemModes::Read(absl::string_view part_name, absl::Duration at_most,
                              const CancelFlag& cancel) {
  const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(at_most);
  const auto found = parts_.find(std::string(part_name));
  if (found == parts_.end()) return {.complete = true};  // no level sets a mode of it
  const auto& [name, part] = *found;
  PartReading reading;
  if (part.manager != nullptr) {
    ManagerView view = part.manager->Poll("", kSurveyReadTimeout);
    if (view.answers) ++reading.answers;
    reading.named = std::move(view.named);
  }
  if (options_.verify == Verify::kManager) {
    reading.complete = !reading.named.empty();
    return reading;
  }
  std::set<std::string> nodes;
  for (const std::string& mode : part.modes) {
    for (const ExpectedPart& expected : targets_.at({name, mode})) nodes.insert(expected.node);
  }
  std::vector<std::string> agreeing = part.modes;
  size_t answered = 0;
  for (const std::string& node : nodes) {
    if (cancel.cancelled() || NowNs() >= end_ns) break;
    if (KeepAgreeing(name, node, agreeing)) ++answered;
  }
  reading.answers += answered;
  if (answered > 0) reading.agreeing = std::move(agreeing);
  // Nodes that agree with no mode may be on their way to one.
  reading.complete = answered == nodes.size() && !reading.agreeing.empty();
  return reading;
}

absl::StatusOr<std::unique_ptr<SystemModes>> SystemModes::Create(
    const dds::Participant* participant, const Smh& smh, const ModesOptions& options,
    const Targets& targets, const Clock* clock) {
  const bool direct = options.backend == Backend::kDirect || options.fallback == Fallback::kDirect;
  if (direct && options.verify != Verify::kParts) {
    return absl::InvalidArgumentError("orders to the nodes need their state read back");
  }
  std::unique_ptr<SystemModes> modes(new SystemModes(participant, options, clock));
  for (const auto& [part, mode] : targets) RIPS_RETURN_IF_ERROR(modes->Add(smh, part, mode));
  return modes;
}

}  // namespace rips::actuator
