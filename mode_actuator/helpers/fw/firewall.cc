#include "mode_actuator/helpers/fw/firewall.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <tuple>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "mode_actuator/steps/firewall/firewall_config.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {
namespace {

using Kind = FirewallStep::Kind;

// Of the table, with what the kernel says of their hook.
constexpr std::pair<absl::string_view, absl::string_view> kTableChains[] = {
    {"input", "filter input -150 accept"},
    {"output", "filter output -150 accept"},
    {"forward", "filter forward -150 accept"},
    {"count_and_drop", ""}};
constexpr std::array<absl::string_view, 3> kLevelChains = {"level_in", "level_out",
                                                           "level_forward"};
constexpr std::array<TargetKind, 4> kTargetKinds = {TargetKind::kIpv4, TargetKind::kIpv6,
                                                    TargetKind::kMac, TargetKind::kParticipant};
// Names in one sentence.
constexpr size_t kNamedMax = 10;

size_t CountRules(absl::string_view script, absl::string_view chain) {
  const std::string begin = absl::StrCat("add rule inet rips ", chain, " ");
  size_t count = 0;
  for (const absl::string_view line : absl::StrSplit(script, '\n')) {
    if (line.substr(0, begin.size()) == begin) ++count;
  }
  return count;
}

const SetElement* FindElement(const Ruleset& now, absl::string_view set, const std::string& value) {
  const auto elements = now.sets.find(set);
  if (elements == now.sets.end()) return nullptr;
  for (const SetElement& element : elements->second) {
    if (element.value == value) return &element;
  }
  return nullptr;
}

std::string BaseName(absl::string_view path) {
  return ros2::Printable(path.substr(path.rfind('/') + 1));
}

std::string Named(const std::vector<std::string>& names) {
  if (names.size() <= kNamedMax) return absl::StrJoin(names, ", ");
  return absl::StrCat(absl::StrJoin(names.begin(), names.begin() + kNamedMax, ", "), " and ",
                      names.size() - kNamedMax, " more");
}

// A warning about the nodes that are released.
std::string ReleaseNote(const std::vector<std::string>& now_out,
                        const std::vector<std::string>& later_out) {
  if (now_out.empty() && later_out.empty()) return "";
  std::string note;
  if (!now_out.empty()) absl::StrAppend(&note, "no longer isolated: ", Named(now_out), "; ");
  if (!later_out.empty()) {
    absl::StrAppend(&note, "isolated until their leases have ended: ", Named(later_out), "; ");
  }
  return absl::StrCat(note, "what their reliable writers have kept for us comes at once then");
}

absl::Status Left(absl::string_view why) { return absl::FailedPreconditionError(why); }

// Of a step that was read back.
std::string Observed(const FirewallStep& step) {
  if (step.kind == Kind::kRules) return absl::StrCat("firewall=", BaseName(step.file));
  if (step.kind == Kind::kRelease) return "firewall=released";
  std::vector<std::string> names;
  for (const std::string& target : step.targets) names.push_back(ros2::Printable(target));
  if (names.size() > kNamedMax) return absl::StrCat("firewall=", names.size(), "isolated");
  return absl::StrCat("firewall=isolated:", absl::StrJoin(names, ","));
}

// What a step that gave `observed`, or an error, answers.
FwResponse ToResponse(const absl::StatusOr<std::string>& observed) {
  if (!observed.ok()) return {.status = observed.status()};
  return {.status = absl::OkStatus(), .observed = *observed};
}

// Of the counter, and of the sets of sources.
std::optional<DropCount> DropsOf(const Ruleset& now) {
  if (!now.dropped.has_value()) return std::nullopt;
  DropCount count = {.packets = *now.dropped};
  const int64_t kept_s = absl::ToInt64Seconds(kCountedSourceKept);
  for (const absl::string_view set : {"dropped4", "dropped6"}) {
    const auto found = now.sets.find(set);
    if (found == now.sets.end()) continue;
    for (const SetElement& element : found->second) {
      if (element.value.size() > model::kDropAddressBytesMax) continue;
      const int64_t quiet_s = kept_s - std::min(element.expires_s, kept_s);
      count.sources.push_back({element.value, element.packets, static_cast<uint32_t>(quiet_s)});
    }
  }
  std::sort(count.sources.begin(), count.sources.end(),
            [](const model::DropSource& a, const model::DropSource& b) {
              return std::tie(a.quiet_s, b.packets, a.address) <
                     std::tie(b.quiet_s, a.packets, b.address);
            });
  if (count.sources.size() > model::kDropSourcesMax) {
    count.more_sources = static_cast<uint32_t>(count.sources.size() - model::kDropSourcesMax);
    count.sources.resize(model::kDropSourcesMax);
  }
  return count;
}

// Of all that is in force.
std::string Summary(const Ruleset& now, const std::string& file) {
  size_t isolated = 0;
  for (const TargetKind kind : kTargetKinds) {
    const auto set = now.sets.find(SetOf(kind));
    if (set != now.sets.end()) isolated += set->second.size();
  }
  const bool held = FindElement(now, "level_hold", "ipv4") != nullptr;
  return absl::StrCat("firewall=", held ? (file.empty() ? "?" : BaseName(file)) : "open", "+",
                      isolated, "isolated");
}

}  // namespace

absl::Status Firewall::CheckFiles() {
  for (const std::string& file : options_.files) {
    RIPS_ASSIGN_OR_RETURN(const std::vector<FragmentRule> rules, ReadFragment(file));
    const absl::Status status = nft_->Load(
        absl::StrCat(TableScript({}), LevelScript(rules, absl::Minutes(1))), NftMode::kDryRun);
    if (!status.ok()) {
      return absl::Status(status.code(), absl::StrCat("`", file, "`: ", status.message()));
    }
  }
  return absl::OkStatus();
}

FwResponse Firewall::Handle(const FwRequest& request) {
  switch (request.verb) {
    case FwVerb::kEnter:
      return Enter(request.step);
    case FwVerb::kCheck: {
      absl::StatusOr<FwResponse> response = Check(request.step);
      if (response.ok()) return *std::move(response);
      return {.status = response.status(), .observed = "firewall=?"};
    }
    case FwVerb::kTry: {
      const absl::StatusOr<std::string> script = ScriptOf(request.step);
      const absl::Status status =
          script.ok() ? nft_->Load(*script, NftMode::kDryRun) : script.status();
      if (!status.ok()) return {.status = status};
      return {.status = status, .note = "nft and the kernel would take it (dry run)"};
    }
    case FwVerb::kStatus:
      return Status();
  }
  return {.status = absl::InternalError("no such verb")};
}

FwResponse Firewall::Enter(const FirewallStep& step) {
  switch (step.kind) {
    case Kind::kRules:
      return ToResponse(EnterRules(step));
    case Kind::kIsolateHosts:
    case Kind::kIsolateParticipants:
      return ToResponse(EnterIsolation(step));
    case Kind::kRelease:
      return EnterRelease();
  }
  return {.status = absl::InternalError("no such step")};
}

absl::StatusOr<Ruleset> Firewall::List() {
  const absl::StatusOr<std::string> json = nft_->ListTable();
  if (absl::IsNotFound(json.status())) return Ruleset{};
  RIPS_RETURN_IF_ERROR(json.status());
  return ParseRuleset(*json);
}

absl::StatusOr<Ruleset> Firewall::ListOrMend(const std::string& table_script) {
  absl::StatusOr<Ruleset> now = List();
  if (absl::IsDataLoss(now.status()) || (now.ok() && now->dormant)) return Load(table_script);
  return now;
}

absl::StatusOr<Ruleset> Firewall::Load(const std::string& script) {
  RIPS_RETURN_IF_ERROR(nft_->Load(script, NftMode::kDryRun));
  RIPS_RETURN_IF_ERROR(nft_->Load(script, NftMode::kCommit));
  RIPS_ASSIGN_OR_RETURN(Ruleset now, List());
  RIPS_RETURN_IF_ERROR(Learn(script, now));
  return now;
}

absl::Status Firewall::Learn(const std::string& script, const Ruleset& now) {
  if (!now.present) return Left("nft reported success but the table is not there");
  // A table that was switched off would be loaded without effect.
  if (now.dormant) return Left("the table is switched off (dormant); delete it by hand");
  absl::btree_map<std::string, ChainView> table;
  for (const auto& [chain, base] : kTableChains) {
    const auto found = now.chains.find(chain);
    if (found == now.chains.end() || found->second.base != base ||
        found->second.rules.size() != CountRules(script, chain)) {
      return Left(absl::StrCat("chain `", chain, "` was not loaded as it should be"));
    }
    table[found->first] = found->second;
  }
  const bool with_level = absl::StrContains(script, "flush chain inet rips level_in\n");
  absl::btree_map<std::string, ChainView> level;
  for (const absl::string_view chain : kLevelChains) {
    const auto found = now.chains.find(chain);
    if (found == now.chains.end()) {
      return Left(absl::StrCat("chain `", chain, "` was not loaded as it should be"));
    }
    const ChainView& view = found->second;
    const bool ours = std::none_of(view.comments.begin(), view.comments.end(),
                                   [](const std::string& comment) { return comment.empty(); });
    if (with_level && (view.rules.size() != CountRules(script, chain) || !ours)) {
      return Left(absl::StrCat("chain `", chain, "` was not loaded as it should be"));
    }
    level[found->first] = view;
  }
  table_ = std::move(table);
  if (with_level) level_ = std::move(level);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<Target>> Firewall::Targets(const FirewallStep& step) {
  std::vector<Target> targets;
  for (const std::string& text : step.targets) {
    RIPS_ASSIGN_OR_RETURN(Target target, step.kind == Kind::kIsolateHosts
                                             ? ParseHostTarget(text)
                                             : ParseParticipantTarget(text));
    if (std::find(targets.begin(), targets.end(), target) == targets.end()) {
      targets.push_back(std::move(target));
    }
  }
  return targets;
}

absl::StatusOr<std::vector<Target>> Firewall::AllowedTargets(const FirewallStep& step) {
  RIPS_ASSIGN_OR_RETURN(std::vector<Target> targets, Targets(step));
  RIPS_ASSIGN_OR_RETURN(const KeptOpen kept, host_->Kept());
  for (const Target& target : targets) RIPS_RETURN_IF_ERROR(CheckMayBeIsolated(target, kept));
  return targets;
}

absl::StatusOr<std::string> Firewall::RulesScript(const FirewallStep& step) {
  if (std::find(options_.files.begin(), options_.files.end(), step.file) == options_.files.end()) {
    return absl::PermissionDeniedError(
        absl::StrCat("`", ros2::Printable(step.file), "` is in no step of the configuration"));
  }
  RIPS_ASSIGN_OR_RETURN(const std::vector<FragmentRule> rules, ReadFragment(step.file));
  RIPS_ASSIGN_OR_RETURN(const std::vector<ControlAddress> control, host_->Control());
  return absl::StrCat(TableScript(control), LevelScript(rules, step.hold_for));
}

absl::StatusOr<std::string> Firewall::EnterRules(const FirewallStep& step) {
  RIPS_ASSIGN_OR_RETURN(const std::string script, RulesScript(step));
  // Until it is there for certain, nothing is known of the level's rules.
  file_.clear();
  level_.clear();
  RIPS_ASSIGN_OR_RETURN(const Ruleset now, Load(script));
  file_ = step.file;
  RIPS_RETURN_IF_ERROR(CompareTable(now));
  RIPS_RETURN_IF_ERROR(CompareRules(step, now));
  return Observed(step);
}

absl::StatusOr<std::string> Firewall::IsolationScript(const FirewallStep& step,
                                                      const std::vector<Target>& targets,
                                                      const Ruleset& before) {
  const int64_t now_s = clock_->Now().boottime_ns / kNanosPerSecond;
  std::vector<Isolation> isolations;
  absl::btree_map<std::string, size_t> sizes;
  for (const Target& target : targets) {
    const std::string set(SetOf(target.kind));
    const auto elements = before.sets.find(set);
    const size_t there = elements == before.sets.end() ? 0 : elements->second.size();
    const SetElement* old = FindElement(before, set, target.text);
    Isolation isolation = {target, std::max(step.hold_for, options_.hold), now_s};
    if (old != nullptr) {
      if (old->since_s > 0 && old->since_s <= now_s) isolation.since_s = old->since_s;
      isolation.hold_for = std::max(isolation.hold_for, absl::Seconds(old->expires_s));
    } else if (there + ++sizes[set] > kIsolatedMax) {
      return absl::ResourceExhaustedError(
          absl::StrCat("isolated in `", set, "` exceed limit ", kIsolatedMax));
    }
    isolations.push_back(std::move(isolation));
  }
  return IsolateScript(isolations);
}

absl::StatusOr<std::string> Firewall::EnterIsolation(const FirewallStep& step) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<Target> targets, AllowedTargets(step));
  RIPS_ASSIGN_OR_RETURN(const std::vector<ControlAddress> control, host_->Control());
  RIPS_ASSIGN_OR_RETURN(const Ruleset before, ListOrMend(TableScript(control)));
  RIPS_ASSIGN_OR_RETURN(const std::string script, IsolationScript(step, targets, before));
  RIPS_ASSIGN_OR_RETURN(const Ruleset now, Load(absl::StrCat(TableScript(control), script)));
  RIPS_RETURN_IF_ERROR(CompareTable(now));
  RIPS_RETURN_IF_ERROR(CompareTargets(targets, now));
  return Observed(step);
}

FwResponse Firewall::EnterRelease() {
  // An unknown address of a server must not prevent a release.
  const absl::StatusOr<std::vector<ControlAddress>> control = host_->Control();
  const std::string table = TableScript(control.ok() ? *control : std::vector<ControlAddress>());
  const absl::StatusOr<Ruleset> before = ListOrMend(table);
  if (!before.ok()) return {.status = before.status()};
  file_.clear();
  level_.clear();
  if (!before->present) {
    return {.status = absl::OkStatus(), .observed = "firewall=released"};
  }
  const int64_t now_s = clock_->Now().boottime_ns / kNanosPerSecond;
  const int64_t hold_s = absl::ToInt64Seconds(absl::Ceil(options_.hold, absl::Seconds(1)));
  std::vector<Isolation> kept;
  std::vector<std::string> now_out, later_out;
  for (const TargetKind kind : kTargetKinds) {
    const auto set = before->sets.find(SetOf(kind));
    if (set == before->sets.end()) continue;
    for (const SetElement& element : set->second) {
      const bool known = element.since_s > 0 && element.since_s <= now_s;
      const int64_t since_s = known ? element.since_s : now_s;
      int64_t left_s = since_s + hold_s - now_s;
      if (element.expires_s > 0) left_s = std::min(left_s, element.expires_s);
      if (left_s <= 0) {
        now_out.push_back(ros2::Printable(element.value));
        continue;
      }
      kept.push_back({{kind, element.value}, absl::Seconds(left_s), since_s});
      later_out.push_back(absl::StrCat(ros2::Printable(element.value), " in ", left_s, "s"));
    }
  }
  const absl::StatusOr<Ruleset> now = Load(absl::StrCat(table, ReleaseScript(kept)));
  if (!now.ok()) return {.status = now.status()};
  return {.status = absl::OkStatus(),
          .observed = "firewall=released",
          .note = ReleaseNote(now_out, later_out)};
}

absl::Status Firewall::CompareTable(const Ruleset& now) {
  if (!now.present) return Left("table `inet rips` was deleted");
  if (now.dormant) return Left("table `inet rips` was switched off (dormant)");
  if (table_.empty()) return Left("rips-fw has started anew and has loaded nothing yet");
  for (const auto& [name, view] : table_) {
    const auto found = now.chains.find(name);
    if (found == now.chains.end() || found->second != view) {
      return Left(absl::StrCat("chain `", name, "` was changed"));
    }
  }
  RIPS_ASSIGN_OR_RETURN(const std::vector<ControlAddress> control, host_->Control());
  size_t there = 0;
  for (const char* set : {"control4", "control6"}) {
    const auto found = now.sets.find(set);
    if (found == now.sets.end()) return Left(absl::StrCat("set `", set, "` was deleted"));
    there += found->second.size();
  }
  for (const ControlAddress& server : control) {
    const char* set = server.kind == TargetKind::kIpv4 ? "control4" : "control6";
    const std::string value = absl::StrCat(server.address, " . ", server.port);
    if (FindElement(now, set, value) == nullptr) {
      return Left(absl::StrCat("server ", value, " is not in `", set, "`"));
    }
  }
  if (there != control.size()) return Left("the sets of servers have other addresses");
  return absl::OkStatus();
}

absl::Status Firewall::CompareRules(const FirewallStep& step, const Ruleset& now) const {
  if (file_ != step.file) {
    return Left(absl::StrCat("the rules in force are those of ",
                             file_.empty() ? "no file" : BaseName(file_)));
  }
  for (const auto& [name, view] : level_) {
    const auto found = now.chains.find(name);
    if (found == now.chains.end() || found->second != view) {
      return Left(absl::StrCat("chain `", name, "` was changed"));
    }
  }
  for (const char* family : {"ipv4", "ipv6"}) {
    if (FindElement(now, "level_hold", family) == nullptr) {
      return Left(absl::StrCat("the time of the level's rules is over for ", family));
    }
  }
  return absl::OkStatus();
}

absl::Status Firewall::CompareTargets(const std::vector<Target>& targets,
                                      const Ruleset& now) const {
  std::vector<std::string> missing;
  for (const Target& target : targets) {
    if (FindElement(now, SetOf(target.kind), target.text) == nullptr) {
      missing.push_back(target.text);
    }
  }
  if (missing.empty()) return absl::OkStatus();
  return Left(absl::StrCat("no longer isolated: ", Named(missing)));
}

absl::StatusOr<FwResponse> Firewall::Check(const FirewallStep& step) {
  if (step.kind == Kind::kRelease) return FwResponse();
  RIPS_ASSIGN_OR_RETURN(const std::vector<Target> targets, Targets(step));
  RIPS_ASSIGN_OR_RETURN(const Ruleset now, List());
  RIPS_RETURN_IF_ERROR(CompareTable(now));
  std::string renew;
  const int64_t half_s = absl::ToInt64Seconds(step.hold_for / 2);
  if (step.kind == Kind::kRules) {
    RIPS_RETURN_IF_ERROR(CompareRules(step, now));
    const SetElement* held = FindElement(now, "level_hold", "ipv4");
    if (held->expires_s < half_s) renew = HoldScript(step.hold_for);
  }
  RIPS_RETURN_IF_ERROR(CompareTargets(targets, now));
  std::vector<Isolation> isolations;
  for (const Target& target : targets) {
    const SetElement* element = FindElement(now, SetOf(target.kind), target.text);
    if (element->expires_s < half_s) {
      isolations.push_back({target, step.hold_for, element->since_s});
    }
  }
  absl::StrAppend(&renew, IsolateScript(isolations));
  if (!renew.empty()) RIPS_RETURN_IF_ERROR(nft_->Load(renew, NftMode::kCommit));
  FwResponse response;
  response.observed = Observed(step);
  response.dropped = DropsOf(now);
  return response;
}

absl::StatusOr<std::string> Firewall::ScriptOf(const FirewallStep& step) {
  if (step.kind == Kind::kRules) return RulesScript(step);
  std::vector<Target> targets;
  if (step.kind != Kind::kRelease) {
    RIPS_ASSIGN_OR_RETURN(targets, AllowedTargets(step));
  }
  // A dry run reports a table that is switched off; it does not switch it on.
  RIPS_ASSIGN_OR_RETURN(const Ruleset now, List());
  if (now.dormant) return Left("table `inet rips` was switched off (dormant)");
  const absl::StatusOr<std::vector<ControlAddress>> control = host_->Control();
  if (step.kind == Kind::kRelease) {
    return absl::StrCat(TableScript(control.value_or(std::vector<ControlAddress>())),
                        ReleaseScript({}));
  }
  RIPS_RETURN_IF_ERROR(control.status());
  RIPS_ASSIGN_OR_RETURN(const std::string script, IsolationScript(step, targets, now));
  return absl::StrCat(TableScript(*control), script);
}

FwResponse Firewall::Status() {
  const absl::StatusOr<Ruleset> now = List();
  if (!now.ok()) return {.status = now.status()};
  if (!now->present) return {.status = absl::OkStatus(), .observed = "firewall=none"};
  FwResponse response = {.status = absl::OkStatus(), .observed = Summary(*now, file_)};
  if (const absl::Status same = CompareTable(*now); !same.ok()) {
    response.note = std::string(same.message());
    return response;
  }
  std::vector<std::string> names;
  for (const TargetKind kind : kTargetKinds) {
    const auto set = now->sets.find(SetOf(kind));
    if (set == now->sets.end()) continue;
    for (const SetElement& element : set->second) {
      names.push_back(
          absl::StrCat(ros2::Printable(element.value), " for ", element.expires_s, "s"));
    }
  }
  response.note = Named(names);
  return response;
}

}  // namespace rips::actuator
