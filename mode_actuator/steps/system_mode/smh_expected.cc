// What a mode of a part asks of each node under it.
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/base/status_macros.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

std::string Absolute(absl::string_view name) {
  return name.empty() || name.front() != '/' ? absl::StrCat("/", name) : std::string(name);
}

// Adds what `part` in `target` asks of its nodes; merges by node.
absl::Status Collect(const Smh& smh, const std::string& part, const PartTarget& target,
                     absl::btree_map<std::string, ExpectedPart>& out) {
  if (const auto node = smh.nodes.find(part); node != smh.nodes.end()) {
    ExpectedPart expected{part, target.state, {}};
    if (target.state == PartState::kActive) {
      const auto mode = node->second.modes.find(target.mode);
      if (mode == node->second.modes.end()) {
        return absl::NotFoundError(
            absl::StrCat("node ", QuoteBytes(part), " has no mode ", QuoteBytes(target.mode)));
      }
      expected.parameters = mode->second;
    }
    const auto [at, inserted] = out.emplace(part, expected);
    if (!inserted &&
        (at->second.state != expected.state || at->second.parameters != expected.parameters)) {
      return absl::FailedPreconditionError(
          absl::StrCat("two systems want different things of node ", QuoteBytes(part)));
    }
    return absl::OkStatus();
  }
  const auto system = smh.systems.find(part);
  if (system == smh.systems.end()) {
    return absl::NotFoundError(absl::StrCat("no part ", QuoteBytes(part), " in the SMH file"));
  }
  const bool active = target.state == PartState::kActive;
  const auto mode = system->second.modes.find(active ? target.mode : std::string(kDefaultMode));
  if (mode == system->second.modes.end()) {
    return absl::NotFoundError(absl::StrCat(
        "system ", QuoteBytes(part), " has no mode ", QuoteBytes(target.mode), "; it has ",
        absl::StrJoin(system->second.modes, ", ", [](std::string* text, const auto& known) {
          absl::StrAppend(text, QuoteBytes(known.first));
        })));
  }
  for (const auto& [child, child_target] : mode->second) {
    const PartTarget wanted = active ? child_target : PartTarget{PartState::kInactive, ""};
    RIPS_RETURN_IF_ERROR(Collect(smh, child, wanted, out));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::vector<ExpectedPart>> Smh::Expected(absl::string_view part,
                                                        absl::string_view mode) const {
  absl::btree_map<std::string, ExpectedPart> merged;
  RIPS_RETURN_IF_ERROR(
      Collect(*this, Absolute(part), {PartState::kActive, std::string(mode)}, merged));
  std::vector<ExpectedPart> expected;
  expected.reserve(merged.size());
  for (auto& [unused, node] : merged) expected.push_back(std::move(node));
  return expected;
}

}  // namespace rips::actuator
