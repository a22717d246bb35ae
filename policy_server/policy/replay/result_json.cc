#include "policy_server/policy/replay/result_json.h"

#include <cmath>

#include "policy_server/policy/lang/check/type.h"
#include "policy_server/policy/lang/value_text.h"

namespace rips::replay {
namespace {

using Json = nlohmann::ordered_json;

constexpr int64_t kExactInJson = int64_t{1} << 53;

Json One(const Changed& change) {
  return {{"event", change.at.event},
          {"rule", change.rule},
          {"from", change.from},
          {"to", change.to},
          {"result", change.refused ? "refused" : "decided"}};
}

Json One(const Alerted& alert) {
  return {{"event", alert.at.event},
          {"rule", alert.rule},
          {"text", alert.text},
          {"severity", std::string(engine::ToString(alert.severity))}};
}

Json One(const Executed& exec) {
  return {{"event", exec.at.event},
          {"rule", exec.rule},
          {"program", exec.program},
          {"args", exec.args},
          {"result", exec.ok ? "ok" : "failed"}};
}

Json One(const Noted& note) {
  return {{"event", note.at.event}, {"rule", note.rule}, {"text", note.text}};
}

Json One(const Missing& missing) {
  Json after;
  if (missing.after.has_value()) after = missing.after->event;
  return {{"after", std::move(after)},
          {"seconds", static_cast<double>(missing.after_ns) / 1e9},
          {"end", missing.end},
          {"text", missing.text}};
}

Json One(const RuleHits& rule) {
  Json out = {{"name", rule.name},
              {"section", std::string(lang::Name(rule.section))},
              {"evaluated", rule.evaluated},
              {"fired", rule.fired},
              {"ns_mean", rule.mean_ns()}};
  if (rule.undecidable > 0) out["undecidable"] = rule.undecidable;
  if (rule.unscanned > 0) out["unscanned"] = rule.unscanned;
  if (rule.graph_truncated > 0) out["graph_truncated"] = rule.graph_truncated;
  return out;
}

Json Map(const absl::btree_map<std::string, lang::Value>& values) {
  Json out = Json::object();
  for (const auto& [name, value] : values) out[name] = ToJson(value);
  return out;
}

template <typename Record>
Json List(const std::vector<Record>& records) {
  Json out = Json::array();
  for (const Record& record : records) out.push_back(One(record));
  return out;
}

template <typename Record>
Json Both(const OnlyOne<Record>& only) {
  return {{"before", List(only.before)}, {"after", List(only.after)}};
}

}  // namespace

Json ToJson(const lang::Value& value) {
  if (const auto* integer = std::get_if<int64_t>(&value)) {
    if (*integer > kExactInJson || *integer < -kExactInJson) return lang::ToText(value);
    return *integer;
  }
  if (const auto* number = std::get_if<double>(&value)) {
    if (!std::isfinite(*number)) return lang::ToText(value);
    return *number;
  }
  if (const auto* truth = std::get_if<bool>(&value)) return *truth;
  return std::get<std::string>(value);
}

Json ToJson(const Result& result) {
  Json out = {{"events",
               {{"message", result.events.message},
                {"graph", result.events.graph},
                {"external", result.events.external},
                {"undecidable", result.events.undecidable}}},
              {"level", result.level},
              {"transitions", List(result.transitions)},
              {"alerts", List(result.alerts)},
              {"execs", List(result.execs)},
              {"variables", Map(result.variables)},
              {"faults", List(result.faults)},
              {"rules", List(result.rules)}};
  if (result.events.unattributed > 0) out["events"]["unattributed"] = result.events.unattributed;
  if (!result.logs.empty()) out["logs"] = List(result.logs);
  if (!result.missing.empty()) out["missing"] = List(result.missing);
  if (result.crashed.has_value()) out["crashed"] = result.crashed->event;
  if (result.left_out > 0) out["left_out"] = result.left_out;
  return out;
}

Json ToJson(const Difference& difference) {
  Json first;
  if (difference.first.has_value()) first = difference.first->event;
  Json out = {
      {"same", difference.none()},
      {"first_difference", std::move(first)},
      {"level", {{"before", difference.level_before}, {"after", difference.level_after}}},
      {"transitions", Both(difference.transitions)},
      {"alerts", Both(difference.alerts)},
      {"execs", Both(difference.execs)},
      {"variables",
       {{"before", Map(difference.variables_before)}, {"after", Map(difference.variables_after)}}}};
  if (difference.left_out) out["left_out"] = true;
  return out;
}

}  // namespace rips::replay
