#include "policy_server/ripsctl/rules/rollout_text.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "services/runtime/config_reader.h"

namespace rips::ripsctl {
namespace {

constexpr absl::string_view kIdPrefix = "sha256:";
constexpr char kCertificate[] = " (spiffe://";
constexpr size_t kIdDigitsMin = 8;
constexpr size_t kIdDigits = 64;

bool Running(const v1::Rollout& rollout) { return rollout.state() == "running"; }

absl::Duration Soak(const v1::Rollout& rollout) {
  return absl::Milliseconds(
      static_cast<int64_t>(std::min<uint64_t>(rollout.soak_ms(), uint64_t{1} << 40)));
}

// Of the stage that runs or ran last, from 0; the number of stages if all are done.
int StageOf(const v1::Rollout& rollout) {
  int stage = 0;
  while (stage < rollout.stages_size() && rollout.stages(stage).state() == "done") ++stage;
  return stage;
}

// `stage 1 of 2 (r2)`.
std::string StageText(const v1::Rollout& rollout) {
  const int stage = StageOf(rollout);
  if (stage == rollout.stages_size()) return absl::StrCat(stage, " stages");
  return absl::StrCat("stage ", stage + 1, " of ", rollout.stages_size(), " (",
                      NamedRobots(rollout.stages(stage).robots()), ")");
}

// `3 of 10 min`, in a unit in which the whole is no long number.
std::string PartOf(absl::Duration part, absl::Duration whole) {
  part = std::clamp(part, absl::ZeroDuration(), whole);
  const bool hours = whole >= absl::Hours(3);
  const bool minutes = whole >= absl::Minutes(3);
  const absl::Duration unit = hours     ? absl::Hours(1)
                              : minutes ? absl::Minutes(1)
                                        : absl::Seconds(1);
  return absl::StrCat(part / unit, " of ", absl::FDivDuration(whole, unit),
                      hours     ? " h"
                      : minutes ? " min"
                                : " s");
}

// `stage 1 of 2 (r2) is not healthy: r2: sensor base is silent`.
std::string NotHealthy(const v1::Rollout& rollout) {
  const std::string& why = rollout.not_healthy_because();
  return absl::StrCat(StageText(rollout),
                      why.empty() ? " is not healthy yet" : " is not healthy: ", why);
}

// Of a roll-out that is over.
std::string OverText(const v1::Rollout& rollout) {
  if (rollout.state() == "done") {
    return absl::StrCat("done: ", rollout.stages_size(),
                        rollout.stages_size() == 1 ? " stage" : " stages");
  }
  return absl::StrCat(rollout.state(), " in ", StageText(rollout), ": ",
                      WithoutCertificates(rollout.why()));
}

Json TimeOrNull(int64_t unix_ns) { return unix_ns == 0 ? Json(nullptr) : Json(FullTime(unix_ns)); }

}  // namespace

absl::Status CheckBundleId(absl::string_view bundle) {
  const absl::string_view digits = absl::StripPrefix(bundle, kIdPrefix);
  const bool hex = digits.find_first_not_of("0123456789abcdef") == absl::string_view::npos;
  if (hex && digits.size() >= kIdDigitsMin && digits.size() <= kIdDigits) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("`", bundle, "` is no bundle; give its id or at least the first ", kIdDigitsMin,
                   " digits of it, as `ripsctl rules list` shows them"));
}

std::string ShortBundleOrDirectory(absl::string_view id) {
  return id.empty() ? std::string(kDirectoryBundle) : ShortBundle(id);
}

std::vector<std::string> ShortBundles(const std::vector<std::string>& ids) {
  std::vector<std::string> out;
  for (const std::string& id : ids) {
    size_t length = ShortBundle(id).size();
    const auto ambiguous = [&](const std::string& other) {
      return other != id && absl::StartsWith(other, id.substr(0, length));
    };
    while (length < id.size() && std::any_of(ids.begin(), ids.end(), ambiguous)) ++length;
    out.push_back(id.substr(0, length));
  }
  return out;
}

std::string NamedRobots(const google::protobuf::RepeatedPtrField<std::string>& robots,
                        size_t most) {
  const size_t size = static_cast<size_t>(robots.size());
  if (size <= most) return absl::StrJoin(robots, ", ");
  return absl::StrCat(absl::StrJoin(robots.begin(), robots.begin() + static_cast<int>(most), ", "),
                      " and ", size - most, " more");
}

std::string WithoutCertificates(absl::string_view text) {
  std::string out(text);
  for (size_t at = 0; (at = out.find(kCertificate, at)) != out.npos;) {
    const size_t end = out.find(')', at);
    if (end == out.npos) break;
    out.erase(at, end + 1 - at);
  }
  return out;
}

std::string RolloutState(const v1::Rollout& rollout, int64_t now_unix_ns) {
  if (!Running(rollout)) {
    return absl::StrCat(OverText(rollout), "; at ", ShortTime(rollout.ended_unix_ns()));
  }
  if (rollout.healthy_since_unix_ns() == 0) {
    return absl::StrCat("running: ", NotHealthy(rollout));
  }
  const absl::Duration healthy = absl::Nanoseconds(now_unix_ns - rollout.healthy_since_unix_ns());
  return absl::StrCat("running: ", StageText(rollout), " has been healthy for ",
                      PartOf(healthy, Soak(rollout)));
}

std::string RolloutProgress(const v1::Rollout& rollout) {
  if (!Running(rollout)) return OverText(rollout);
  if (rollout.healthy_since_unix_ns() == 0) {
    return NotHealthy(rollout);
  }
  const absl::Time end = absl::FromUnixNanos(rollout.healthy_since_unix_ns()) + Soak(rollout);
  return absl::StrCat(StageText(rollout), " is healthy; it is done at ",
                      ShortTime(absl::ToUnixNanos(end)), " if it stays so");
}

std::string RolloutLimits(const v1::Rollout& rollout) {
  return absl::StrCat(
      "each stage is healthy for ", FormatConfigDuration(Soak(rollout)),
      "; it stops if a level rises, a robot is not healthy for 10 s (or has not taken "
      "the bundle for 30 s), or one has more than ",
      rollout.alerts_per_minute_max(), " alerts within a minute",
      rollout.roll_back_when_stopped() ? "; then its robots go back" : "");
}

void PrintStages(const v1::Rollout& rollout, TextStream out) {
  Table stages({"STAGE", "STATE", "ROBOTS"});
  for (int i = 0; i < rollout.stages_size(); ++i) {
    stages.Add(
        {absl::StrCat(i + 1), rollout.stages(i).state(), NamedRobots(rollout.stages(i).robots())});
  }
  stages.Print(out);
}

void PrintRollout(const v1::Rollout& rollout, int64_t now_unix_ns, TextStream out) {
  if (rollout.id().empty()) {
    out << "no bundle was rolled out yet\n";
    return;
  }
  Table table({"roll-out", EscapeText(absl::StrCat(
                               ShortBundle(rollout.bundle_id()), " `", rollout.name(), "`",
                               rollout.from_directory() ? ", from the server's directory" : ""))});
  table.Add({"state", RolloutState(rollout, now_unix_ns)});
  table.Add({"by", absl::StrCat(WithoutCertificates(rollout.operator_()), ", ",
                                ShortTime(rollout.began_unix_ns()))});
  table.Add({"reason", rollout.reason()});
  table.Add({"limits", RolloutLimits(rollout)});
  if (!rollout.rolled_back().empty()) {
    table.Add({"rolled back", WithoutCertificates(rollout.rolled_back())});
  }
  table.Print(out);
  PrintStages(rollout, out);
}

Json ToJson(const v1::Rollout& rollout) {
  if (rollout.id().empty()) return nullptr;
  const auto stage_json = [](const v1::RolloutStageStatus& stage) -> Json {
    return {{"state", stage.state()}, {"robots", JsonList(stage.robots())}};
  };
  return {{"id", rollout.id()},
          {"bundle", rollout.bundle_id()},
          {"name", rollout.name()},
          {"from_directory", rollout.from_directory()},
          {"state", rollout.state()},
          {"why", rollout.why()},
          {"operator", rollout.operator_()},
          {"reason", rollout.reason()},
          {"began", TimeOrNull(rollout.began_unix_ns())},
          {"ended", TimeOrNull(rollout.ended_unix_ns())},
          {"stages", JsonList(rollout.stages(), stage_json)},
          {"not_healthy_because", rollout.not_healthy_because()},
          {"rolled_back", rollout.rolled_back()},
          {"healthy_since", TimeOrNull(rollout.healthy_since_unix_ns())},
          {"soak_ms", rollout.soak_ms()},
          {"alerts_per_minute_max", rollout.alerts_per_minute_max()},
          {"roll_back_when_stopped", rollout.roll_back_when_stopped()}};
}

}  // namespace rips::ripsctl
