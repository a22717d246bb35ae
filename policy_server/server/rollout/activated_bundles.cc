#include "policy_server/server/rollout/activated_bundles.h"

#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "google/protobuf/util/json_util.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "rips/v1/rollout.pb.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"

namespace rips::rollout {
namespace {

// 2,000 robots with reasons of 1,000 bytes, and more baselines than are likely.
constexpr size_t kFileBytesMax = size_t{64} << 20;
// Of the store: SHA-256 of the file that was there and of the one that was written last, since a
// crash may come between; of no file, that of nothing.
constexpr char kNote[] = "activated bundles";

std::string HashOf(const std::string& text) { return bundle::Sha256Hex(text); }

void Encode(const RolloutRecord& record, v1::StoredRollout& out) {
  const RolloutPlan& plan = record.plan;
  out.set_id(plan.id);
  out.set_bundle_id(plan.bundle_id);
  out.set_from_directory(plan.from_directory);
  out.set_name(plan.name);
  out.set_operator_(plan.operator_name);
  out.set_reason(plan.reason);
  for (const std::vector<std::string>& stage : plan.stages) {
    v1::StoredStage& stored = *out.add_stages();
    for (const std::string& robot : stage) stored.add_robots(robot);
  }
  out.set_soak_ns(plan.soak_ns);
  out.set_alerts_per_minute_max(plan.alerts_per_minute_max);
  out.set_roll_back_when_stopped(plan.roll_back_when_stopped);
  out.set_state(std::string(ToString(record.state)));
  out.set_why(record.why);
  out.set_rolled_back(record.rolled_back);
  out.set_stage(static_cast<uint32_t>(record.stage));
  out.set_began_unix_ns(record.began_unix_ns);
  out.set_ended_unix_ns(record.ended_unix_ns);
  for (const auto& [robot, baseline] : record.before) {
    v1::StoredBaseline& stored = (*out.mutable_before())[robot];
    for (const std::string& each : baseline.degraded) stored.add_degraded(each);
    stored.set_level(baseline.level);
    stored.set_bundle_id(baseline.bundle_id);
  }
}

absl::StatusOr<RolloutState> DecodeState(const std::string& text) {
  for (const RolloutState state :
       {RolloutState::kRunning, RolloutState::kDone, RolloutState::kStopped}) {
    if (text == ToString(state)) return state;
  }
  return absl::DataLossError("a roll-out of no known state");
}

absl::StatusOr<RolloutRecord> Decode(const v1::StoredRollout& in) {
  RolloutRecord record{.plan = {.id = in.id(),
                                .bundle_id = in.bundle_id(),
                                .from_directory = in.from_directory(),
                                .name = in.name(),
                                .operator_name = in.operator_(),
                                .reason = in.reason(),
                                .soak_ns = in.soak_ns(),
                                .alerts_per_minute_max = in.alerts_per_minute_max(),
                                .roll_back_when_stopped = in.roll_back_when_stopped()},
                       .why = in.why(),
                       .rolled_back = in.rolled_back(),
                       .stage = in.stage(),
                       .began_unix_ns = in.began_unix_ns(),
                       .ended_unix_ns = in.ended_unix_ns()};
  RIPS_ASSIGN_OR_RETURN(record.state, DecodeState(in.state()));
  for (const v1::StoredStage& stage : in.stages()) {
    record.plan.stages.emplace_back(stage.robots().begin(), stage.robots().end());
  }
  if (record.stage >= record.plan.stages.size()) {
    return absl::DataLossError("a roll-out at a stage that it does not have");
  }
  for (const auto& [robot, stored] : in.before()) {
    Baseline& baseline = record.before[robot];
    baseline.degraded.insert(stored.degraded().begin(), stored.degraded().end());
    baseline.level = stored.level();
    baseline.bundle_id = stored.bundle_id();
  }
  return record;
}

}  // namespace

std::set<std::string> ActivatedBundles::bundles() const {
  std::set<std::string> ids;
  for (const auto& [robot, activation] : robots) {
    ids.insert(activation.bundle_id);
    if (activation.before) ids.insert(*activation.before);
  }
  for (const auto& [robot, shadow] : shadows) ids.insert(shadow.bundle_id);
  if (rollout) ids.insert(rollout->plan.bundle_id);
  ids.erase("");
  return ids;
}

Activations::Activations(std::string path, store::Store* store)
    : path_(std::move(path)), store_(store) {
  const absl::StatusOr<std::string> known = store_->Note(kNote);
  const absl::StatusOr<std::string> text = ReadFile(path_, kFileBytesMax);
  absl::StatusOr<ActivatedBundles> read = ActivatedBundles();
  if (text.ok()) {
    read = ParseActivatedBundles(*text);
  } else if (!absl::IsNotFound(text.status())) {
    read = text.status();
  }
  if (!known.ok() && !text.ok()) read = known.status();  // whether there was one is not known
  if (read.ok() && known.ok() && !known->empty() &&
      !absl::StrContains(*known, HashOf(text.ok() ? *text : ""))) {
    read = absl::DataLossError(
        absl::StrCat("it is ", text.ok() ? "not the one that was written last" : "gone"));
  }
  if (read.ok()) {
    now_ = *std::move(read);
    return;
  }
  problem_ =
      absl::Status(read.status().code(), absl::StrCat("`", path_, "`: ", read.status().message()));
  // It stays in its place until another one is written, which a full disk may prevent.
  if (text.ok()) WriteFileAtomically(absl::StrCat(path_, ".damaged"), *text, 0640).IgnoreError();
}

absl::Status Activations::Announce(const std::string& text) {
  const absl::StatusOr<std::string> old = ReadFile(path_, kFileBytesMax);
  return store_->SetNote(kNote, absl::StrCat(HashOf(old.ok() ? *old : ""), " ", HashOf(text)));
}

absl::Status Activations::Set(ActivatedBundles next) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, FormatActivatedBundles(next));
  // It could not be read again.
  if (text.size() > kFileBytesMax) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "`", path_, "` would have ", text.size(), " bytes, which exceeds limit ", kFileBytesMax));
  }
  RIPS_RETURN_IF_ERROR(Announce(text));
  RIPS_RETURN_IF_ERROR(WriteFileAtomically(path_, text, 0640));
  now_ = std::move(next);
  return absl::OkStatus();
}

std::string Activations::For(const bundle::InventoryRobot& robot) {
  const auto found = now_.robots.find(robot.id);
  if (found != now_.robots.end()) {
    return found->second.name == robot.bundle ? found->second.bundle_id : "";
  }
  if (problem_.ok()) return "";
  const absl::StatusOr<store::RobotRecord> record = store_->Load(robot.id);
  if (!record.ok()) {
    LogError("which bundle judged a robot last cannot be read; the directory's does",
             {{"robot", robot.id}, {"reason", record.status().message()}});
  }
  if (!record.ok() || record->bundle.empty()) return "";
  now_.robots[robot.id] = {.bundle_id = record->bundle,
                           .name = robot.bundle,
                           .operator_name = std::string(pipeline::kOwnRule),
                           .reason = "what was activated is not known; it was in force last"};
  return record->bundle;
}

absl::StatusOr<ActivatedBundles> ParseActivatedBundles(const std::string& text) {
  v1::ActivatedBundles in;
  // Of a later version, maybe; what it knows and this one does not is no reason to lose the rest.
  google::protobuf::util::JsonParseOptions options;
  options.ignore_unknown_fields = true;
  if (!google::protobuf::util::JsonStringToMessage(text, &in, options).ok()) {
    return absl::DataLossError("it is damaged");
  }
  ActivatedBundles out;
  for (const auto& [robot, stored] : in.robots()) {
    Activation& activation = out.robots[robot];
    activation = {.bundle_id = stored.bundle_id(),
                  .name = stored.name(),
                  .operator_name = stored.operator_(),
                  .reason = stored.reason(),
                  .time_unix_ns = stored.time_unix_ns()};
    if (stored.can_roll_back()) activation.before = stored.before();
  }
  for (const auto& [robot, stored] : in.shadows()) {
    out.shadows[robot] = {.bundle_id = stored.bundle_id(),
                          .operator_name = stored.operator_(),
                          .reason = stored.reason()};
  }
  if (in.has_rollout()) {
    absl::StatusOr<RolloutRecord> record = Decode(in.rollout());
    if (!record.ok()) {
      return absl::DataLossError(absl::StrCat("it is damaged: ", record.status().message()));
    }
    out.rollout = *std::move(record);
  }
  return out;
}

absl::StatusOr<std::string> FormatActivatedBundles(const ActivatedBundles& activated) {
  v1::ActivatedBundles out;
  for (const auto& [robot, activation] : activated.robots) {
    v1::Activation& stored = (*out.mutable_robots())[robot];
    stored.set_bundle_id(activation.bundle_id);
    stored.set_name(activation.name);
    stored.set_operator_(activation.operator_name);
    stored.set_reason(activation.reason);
    stored.set_time_unix_ns(activation.time_unix_ns);
    stored.set_before(activation.before.value_or(""));
    stored.set_can_roll_back(activation.before.has_value());
  }
  for (const auto& [robot, shadow] : activated.shadows) {
    v1::ShadowOrder& stored = (*out.mutable_shadows())[robot];
    stored.set_bundle_id(shadow.bundle_id);
    stored.set_operator_(shadow.operator_name);
    stored.set_reason(shadow.reason);
  }
  if (activated.rollout) Encode(*activated.rollout, *out.mutable_rollout());
  google::protobuf::util::JsonPrintOptions options;
  options.add_whitespace = true;
  std::string text;
  if (!google::protobuf::util::MessageToJsonString(out, &text, options).ok()) {
    return absl::InternalError("which bundles are activated cannot be written as JSON");
  }
  return text;
}

}  // namespace rips::rollout
