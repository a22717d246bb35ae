// `ripsctl explain`.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/explain/explain_text.h"
#include "policy_server/ripsctl/explain/findings_view.h"
#include "services/base/decision_id.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/model_proto/decision_id_codec.h"

namespace rips::ripsctl {
namespace {

constexpr size_t kIdDigitsMin = 6;
constexpr size_t kIdDigitsMax = 32;

bool IsHex(absl::string_view text) {
  return std::all_of(text.begin(), text.end(), [](char c) {
    return absl::ascii_isdigit(static_cast<unsigned char>(c)) || (c >= 'a' && c <= 'f');
  });
}

// What WHAT may mean; `robot` is empty if it cannot be one.
struct Target {
  bool id = false;  // tried first
  std::string robot;
  std::optional<DecisionId> decision_id;
};

absl::StatusOr<Target> ParseTarget(const std::string& what) {
  const size_t at = what.rfind('@');
  const std::string robot = what.substr(0, at);
  const absl::Status wrong = absl::InvalidArgumentError(
      absl::StrCat("WHAT is `", what, "`; write an id of ", kIdDigitsMin, " to ", kIdDigitsMax,
                   " digits 0-9a-f, a robot, or ROBOT@TERM.EPOCH, for example r1@3.17"));
  if (!CheckRobot(robot).ok()) return wrong;
  if (at == std::string::npos) {
    return Target{.id = what.size() >= kIdDigitsMin && what.size() <= kIdDigitsMax && IsHex(what),
                  .robot = robot};
  }
  const absl::StatusOr<DecisionId> decision_id =
      ParseDecisionId(absl::string_view(what).substr(at + 1));
  // As it is printed, and nothing else.
  if (!decision_id.ok() || decision_id->none() ||
      absl::StrCat(robot, "@", ToString(*decision_id)) != what)
    return wrong;
  return Target{.robot = robot, .decision_id = *decision_id};
}

// What would raise the robot again from the lowest level; none if it is there.
std::optional<Lowering> TryLowering(Env& env, const v1::GetLevelResponse& now) {
  const v1::RobotStatus& status = now.status();
  const auto at = std::find(now.levels().begin(), now.levels().end(), status.decided_level());
  if (at == now.levels().end() || at == now.levels().begin()) return std::nullopt;
  v1::LevelRequest request;
  request.set_robot(status.robot());
  request.set_to(now.levels(0));
  request.set_reason("ripsctl explain");
  request.set_expected_level(status.decided_level());
  *request.mutable_expected_decision_id() = status.decision_id();
  request.set_dry_run(true);
  request.set_request_id(absl::HexStringToBytes(NewId()));
  return Lowering{.to = request.to(), .found = Call(env, &Stub::DeEscalate, request)};
}

// What had raised the robot to the level that `change` left, or above it, by the newest changes on
// record; none if that was the lowest. `between`: the change before `change`, if that is another.
std::optional<v1::Transition> FindRaise(Env& env, const v1::Transition& change,
                                        const v1::GetLevelResponse& now,
                                        std::optional<v1::Transition>& between) {
  const auto height = [&](const std::string& level) {
    return std::find(now.levels().begin(), now.levels().end(), level) - now.levels().begin();
  };
  if (change.refused() || height(change.from()) == 0) return std::nullopt;
  v1::ListTransitionsRequest request;
  request.set_robot(change.robot());
  const auto history = Call(env, &Stub::ListTransitions, request);
  if (!history.ok()) return std::nullopt;
  bool before = false;
  for (const v1::Transition& each : history->transitions()) {  // newest first
    if (before && !each.refused() && height(each.to()) >= height(change.from()) &&
        height(each.to()) > height(each.from())) {
      return each;
    }
    if (before && !each.refused() && !between.has_value()) between = each;
    before = before || each.id() == change.id();
  }
  return std::nullopt;
}

Json LoweringJson(const Lowering& lowering) {
  if (!lowering.found.ok()) {
    return {{"to", lowering.to}, {"not_known_because", NoDryRunText(lowering.found.status())}};
  }
  return {{"to", lowering.to},
          {"would_raise_again", JsonList(lowering.found->would_raise_again())},
          {"not_tried", NotTried()},
          {"needs_approval", lowering.found->needs_approval()},
          {"blind_because", JsonList(lowering.found->blind_because())}};
}

// Of each subject, in its order: true or false, null if it is not known.
Json SubjectsNow(const Explanation& explanation) {
  Json now = Json::array();
  for (const v1::Subject& each : SubjectsOf(explanation.recorded)) {
    const Presence presence = PresenceOf(each, explanation);
    const bool known = presence == Presence::kThere || presence == Presence::kGone;
    now.push_back(known ? Json(presence == Presence::kThere) : Json(nullptr));
  }
  return now;
}

Json ExplanationJson(const Explanation& explanation) {
  Json json = ToJson(explanation.recorded);
  json["subjects_there_now"] = SubjectsNow(explanation);
  const bool decided = explanation.recorded.has_alert() || explanation.recorded.has_transition();
  if (decided && !explanation.recorded.has_evidence()) {
    json["no_evidence_because"] = NoEvidenceText(explanation.recorded);
  }
  const bool known = explanation.now.has_value() && explanation.now->ok();
  json["now"] = known ? ToJson(**explanation.now) : Json(nullptr);
  if (explanation.now.has_value() && !known) {
    json["now_not_known_because"] = std::string(explanation.now->status().message());
  }
  json["raised_before_by"] =
      explanation.raised.has_value() ? ToJson(explanation.raised->transition()) : Json(nullptr);
  Json raisers = Json::array();
  if (explanation.raised.has_value()) {
    for (const v1::Subject& each : SubjectsOf(*explanation.raised)) raisers.push_back(ToJson(each));
  }
  json["raised_before_subjects"] = std::move(raisers);
  json["lowering"] =
      explanation.lowering.has_value() ? LoweringJson(*explanation.lowering) : Json(nullptr);
  json["finding"] = FindingJson(explanation);
  json["findings"] =
      explanation.findings.has_value() ? FindingsJson(*explanation.findings) : Json(nullptr);
  return json;
}

class Explain final : public Command {
 public:
  Explain() : Command({"explain", "", "Explain an alert, or why a robot is at its level"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option(
           "WHAT", what_,
           "Robot id, ROBOT@TERM.EPOCH, or 6 or more digits of the id of an alert or level change")
        ->required();
  }
  absl::Status Check() override {
    RIPS_ASSIGN_OR_RETURN(target_, ParseTarget(what_));
    return absl::OkStatus();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    absl::StatusOr<Explanation> explanation = Find(env);
    if (absl::IsUnimplemented(explanation.status())) {
      return absl::FailedPreconditionError(
          "the policy server cannot explain: it is older than this ripsctl; `ripsctl level history "
          "ROBOT` and `ripsctl alert list ROBOT` show what it recorded");
    }
    RIPS_RETURN_IF_ERROR(explanation.status());
    AddNow(env, *explanation);
    if (env.json()) return PrintJson(env, ExplanationJson(*explanation));
    PrintExplanation(*explanation, env.out);
    return ExitCode::kDone;
  }

 private:
  absl::StatusOr<Explanation> Find(Env& env) const {
    v1::ExplainRequest request;
    if (target_.id) {
      request.set_id(what_);
      absl::StatusOr<Explanation> found = Ask(env, request);
      if (!absl::IsNotFound(found.status())) return found;
      found = OfRobot(env, target_.robot);
      if (!absl::IsNotFound(found.status())) return found;
      return absl::NotFoundError(absl::StrCat(
          "no alert or level change that is kept, and no robot is `", what_,
          "`; see `ripsctl alert list`, `ripsctl level history ROBOT` and `ripsctl robot list`"));
    }
    if (!target_.decision_id.has_value()) return OfRobot(env, target_.robot);
    request.set_robot(target_.robot);
    model_proto::Encode(*target_.decision_id, *request.mutable_decision_id());
    return Ask(env, request);
  }

  // The decision that the robot is at.
  static absl::StatusOr<Explanation> OfRobot(Env& env, const std::string& robot) {
    RIPS_ASSIGN_OR_RETURN(v1::GetLevelResponse now, ReadLevel(env, robot, /*lowering_rules=*/true));
    const DecisionId decision_id = model_proto::Decode(now.status().decision_id());
    Explanation explanation;
    if (!decision_id.none()) {
      v1::ExplainRequest request;
      request.set_robot(robot);
      model_proto::Encode(decision_id, *request.mutable_decision_id());
      absl::StatusOr<Explanation> asked = Ask(env, request);
      if (absl::IsNotFound(asked.status())) {
        return absl::FailedPreconditionError(absl::StrCat(
            robot, " is at ", now.status().decided_level(), " by decision ", ToString(decision_id),
            ", and the server has no record of that: ", asked.status().message()));
      }
      RIPS_RETURN_IF_ERROR(asked.status());
      explanation = *std::move(asked);
    }
    explanation.now = std::move(now);
    return explanation;
  }

  static absl::StatusOr<Explanation> Ask(Env& env, const v1::ExplainRequest& request) {
    Explanation explanation;
    RIPS_ASSIGN_OR_RETURN(explanation.recorded, Call(env, &Stub::Explain, request));
    if (!explanation.recorded.has_alert() && !explanation.recorded.has_transition()) {
      return absl::InternalError("the policy server sent nothing that could be explained");
    }
    return explanation;
  }

  static void AddNow(Env& env, Explanation& explanation) {
    const v1::ExplainResponse& recorded = explanation.recorded;
    const std::string& robot =
        recorded.has_transition() ? recorded.transition().robot() : recorded.alert().robot();
    // Of the server's own alerts there is no robot.
    if (!explanation.now.has_value() && CheckRobot(robot).ok()) {
      explanation.now = ReadLevel(env, robot, /*lowering_rules=*/true);
    }
    if (!explanation.now.has_value() || !explanation.now->ok()) return;
    AddFindings(env, (*explanation.now)->status().robot(), explanation);
    if (recorded.has_transition()) {
      std::optional<v1::Transition> between;
      if (auto raise = FindRaise(env, recorded.transition(), **explanation.now, between)) {
        explanation.between = std::move(between);
        v1::ExplainRequest request;
        request.set_id(raise->id());
        const absl::StatusOr<Explanation> asked = Ask(env, request);
        explanation.raised.emplace();
        if (asked.ok()) *explanation.raised = asked->recorded;
        *explanation.raised->mutable_transition() = *std::move(raise);
      }
    }
    const auto& subjects = SubjectsOf(recorded);
    if (std::any_of(subjects.begin(), subjects.end(),
                    [](const v1::Subject& each) { return !each.guid().empty(); })) {
      v1::GetGraphRequest request;
      request.set_robot((*explanation.now)->status().robot());
      explanation.graph = Call(env, &Stub::GetGraph, request);
    }
    explanation.lowering = TryLowering(env, **explanation.now);
  }

  static void AddFindings(Env& env, const std::string& robot, Explanation& explanation) {
    v1::GetCoverageRequest request;
    request.set_robot(robot);
    request.set_findings_only(true);
    if (explanation.recorded.has_finding()) {
      *request.mutable_finding() = explanation.recorded.finding();
    }
    explanation.findings = Call(env, &Stub::GetCoverage, request);
  }

  std::string what_;
  Target target_;
};

}  // namespace

Commands ExplainCommands() { return MakeCommands<Explain>(); }

}  // namespace rips::ripsctl
