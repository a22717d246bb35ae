// `ripsctl robot interest` and `ripsctl robot coverage`: what the rules ask of a robot's sensors,
// and what the sensors see. `coverage` exits with 0 if the graph is complete, each of its endpoints
// is watched, not needed or of a service, and it is known that no finding stands; else with 1.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

std::string DepthName(v1::InterestRule::Depth depth) {
  return EnumText(v1::InterestRule::Depth_Name(depth), "", "unknown");
}

std::string InterestState(const v1::SensorInterest& sensor) {
  if (!sensor.connected()) return "not connected";
  if (sensor.in_use()) return "in use";
  return sensor.problem().empty() ? "not yet" : absl::StrCat("refused: ", sensor.problem());
}

// How much of an endpoint's traffic is seen, as one of four.
enum class Seen { kWatched, kNotNeeded, kNotVisible, kNeverRead };

// Requests to services are never read: one more reader would make clients wait for ever.
Seen SeenOf(const v1::Endpoint& endpoint) {
  if (endpoint.kind() == v1::Endpoint::SERVICE || endpoint.kind() == v1::Endpoint::CLIENT) {
    return Seen::kNeverRead;
  }
  if (endpoint.visibility() == v1::WATCHED) return Seen::kWatched;
  return endpoint.visibility() == v1::NOT_NEEDED ? Seen::kNotNeeded : Seen::kNotVisible;
}

constexpr const char* kSeenNames[] = {"watched", "not needed", "not visible", "never read"};

const char* SeenName(Seen seen) { return kSeenNames[static_cast<int>(seen)]; }

std::string SeenText(const v1::Endpoint& endpoint) {
  const std::string name = SeenName(SeenOf(endpoint));
  return endpoint.why().empty() ? name : absl::StrCat(name, ": ", endpoint.why());
}

struct Counts {
  int of[4] = {0, 0, 0, 0};
  int operator[](Seen seen) const { return of[static_cast<int>(seen)]; }
};

Counts Count(const v1::GetCoverageResponse& response) {
  Counts counts;
  for (const v1::Endpoint& endpoint : response.endpoints()) {
    ++counts.of[static_cast<int>(SeenOf(endpoint))];
  }
  return counts;
}

// Why others may stand than those that are shown, or some of these may have ended.
std::vector<std::string> NotKnown(const v1::GetCoverageResponse& response) {
  if (!response.has_findings_now()) return {"the policy server does not say; it is older"};
  const auto& reasons = response.findings_now().not_known();
  return {reasons.begin(), reasons.end()};
}

// Is everything seen that is there to be seen?
bool Complete(const v1::GetCoverageResponse& response) {
  bool graph = false;
  for (const v1::SensorCoverage& sensor : response.sensors()) {
    if (!sensor.connected()) return false;
    graph |= sensor.primary() && sensor.settled();
  }
  return graph && response.blind().empty() && !response.graph_truncated() &&
         response.findings().empty() && NotKnown(response).empty() && response.skipped().empty() &&
         response.cut_payloads().empty() && response.endpoints_left_out() == 0 &&
         Count(response)[Seen::kNotVisible] == 0;
}

const char* YesNo(bool value) { return value ? "yes" : "no"; }

std::string SkewText(const v1::SensorCoverage& sensor) {
  if (!sensor.has_clock_skew_ns()) return "";
  return absl::StrFormat("%+.3f s", static_cast<double>(sensor.clock_skew_ns()) / 1e9);
}

class ShowInterest final : public RobotCommand {
 public:
  ShowInterest()
      : RobotCommand(
            {"robot", "interest",
             "Show which data the rules need from each topic, and which sensors deliver it"}) {}
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::GetInterestRequest request;
    request.set_robot(robot_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::GetInterest, request));
    if (env.json()) return PrintJson(env, InterestJson(response));
    PrintText(response, env.out);
    return ExitCode::kDone;
  }

 private:
  static google::protobuf::RepeatedPtrField<std::string> WantedBy(
      const v1::GetInterestResponse& response, int row) {
    return row < response.reasons_size() ? response.reasons(row).wanted_by()
                                         : v1::InterestReason().wanted_by();
  }
  Json InterestJson(const v1::GetInterestResponse& response) const {
    Json rules = Json::array();
    for (int i = 0; i < response.interest().rules_size(); ++i) {
      const v1::InterestRule& rule = response.interest().rules(i);
      rules.push_back({{"depth", DepthName(rule.depth())},
                       {"bytes", rule.payload_bytes_max()},
                       {"topic", rule.topic_regex()},
                       {"type", rule.type()},
                       {"wanted_by", JsonList(WantedBy(response, i))}});
    }
    const auto sensor_json = [](const v1::SensorInterest& sensor) -> Json {
      return {{"host", sensor.host()},
              {"connected", sensor.connected()},
              {"in_use", sensor.in_use()},
              {"problem", sensor.problem()}};
    };
    const auto limit_json = [](const v1::PayloadLimit& limit) -> Json {
      return {{"topic", limit.topic_regex()}, {"bytes", limit.bytes()}};
    };
    return {{"robot", robot_},
            {"rules", std::move(rules)},
            {"payload_limits", JsonList(response.interest().payload_limits(), limit_json)},
            {"sensors", JsonList(response.sensors(), sensor_json)}};
  }
  static void PrintText(const v1::GetInterestResponse& response, TextStream out) {
    Table rules({"DEPTH", "BYTES", "TOPIC", "TYPE", "WANTED BY"});
    for (int i = 0; i < response.interest().rules_size(); ++i) {
      const v1::InterestRule& rule = response.interest().rules(i);
      rules.Add({DepthName(rule.depth()),
                 rule.payload_bytes_max() == 0 ? "" : absl::StrCat(rule.payload_bytes_max()),
                 rule.topic_regex().empty() ? "(every topic)" : rule.topic_regex(),
                 rule.type().empty() ? "(any)" : rule.type(),
                 absl::StrJoin(WantedBy(response, i), ", ")});
    }
    rules.Print(out);
    out << "\n";
    if (!response.interest().payload_limits().empty()) {
      Table limits({"PAYLOAD LIMIT", "TOPIC"});
      for (const v1::PayloadLimit& limit : response.interest().payload_limits()) {
        limits.Add({absl::StrCat(limit.bytes()), limit.topic_regex()});
      }
      limits.Print(out);
      out << "\n";
    }
    Table sensors({"SENSOR", "STATE"});
    for (const v1::SensorInterest& sensor : response.sensors()) {
      sensors.Add({sensor.host(), InterestState(sensor)});
    }
    sensors.Print(out);
  }
};

class ShowCoverage final : public RobotCommand {
 public:
  ShowCoverage()
      : RobotCommand({"robot", "coverage",
                      "Show which of a robot's endpoints the sensors see; exit with 1 if any is "
                      "not visible, or a finding stands or may stand"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_flag("--all", all_, "Show every endpoint, not only those that are not visible");
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::GetCoverageRequest request;
    request.set_robot(robot_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::GetCoverage, request));
    if (env.json()) {
      PrintJson(CoverageJson(response), env.out);
    } else {
      PrintText(response, env.out);
    }
    return Complete(response) ? ExitCode::kDone : ExitCode::kRefused;
  }

 private:
  static Json SensorJson(const v1::SensorCoverage& sensor) {
    return {{"host", sensor.host()},
            {"primary", sensor.primary()},
            {"connected", sensor.connected()},
            {"settled", sensor.settled()},
            {"not_visible", JsonList(sensor.not_visible())},
            {"blind", JsonList(sensor.state().blind())},
            {"overloaded", sensor.state().overloaded()},
            {"outbox_bytes", sensor.state().outbox_bytes()},
            {"oldest_unacked_ns", sensor.state().oldest_unacked_ns()},
            {"spool_bytes", sensor.state().spool_bytes()},
            {"lost", sensor.lost()},
            {"clock_skew_ns",
             sensor.has_clock_skew_ns() ? Json(sensor.clock_skew_ns()) : Json(nullptr)}};
  }
  static Json EndpointJson(const v1::Endpoint& endpoint) {
    return {{"guid", GuidText(endpoint.guid())},
            {"kind", KindName(endpoint.kind())},
            {"name", endpoint.name()},
            {"type", endpoint.type()},
            {"node", endpoint.node()},
            {"ros", endpoint.ros()},
            {"state", SeenName(SeenOf(endpoint))},
            {"why", endpoint.why()}};
  }
  static Json FindingJson(const v1::Finding& finding) {
    return {{"kind", finding.kind()},
            {"guid", finding.guid().empty() ? "" : GuidText(finding.guid())},
            {"node", finding.node()},
            {"topic", finding.topic()},
            {"detail", finding.detail()}};
  }
  static Json SkippedJson(const v1::SkippedInspections& each) {
    return {{"reason", each.reason()}, {"count", each.count()}};
  }
  static Json CutJson(const v1::CutPayloads& each) {
    return {{"topic", each.topic()},
            {"limit_bytes", each.limit_bytes()},
            {"longest_bytes", each.longest_bytes()},
            {"count", each.count()}};
  }
  Json CoverageJson(const v1::GetCoverageResponse& response) const {
    return {{"robot", robot_},
            {"complete", Complete(response)},
            {"blind", JsonList(response.blind())},
            {"cut_payloads", JsonList(response.cut_payloads(), CutJson)},
            {"graph_truncated", response.graph_truncated()},
            {"endpoints_left_out", response.endpoints_left_out()},
            {"findings_left_out", response.findings_left_out()},
            {"skipped_inspections", JsonList(response.skipped(), SkippedJson)},
            {"sensors", JsonList(response.sensors(), SensorJson)},
            {"endpoints", JsonList(response.endpoints(), EndpointJson)},
            {"findings", JsonList(response.findings(), FindingJson)},
            {"findings_not_known_because", NotKnown(response)}};
  }

  void PrintText(const v1::GetCoverageResponse& response, TextStream out) const {
    for (const std::string& reason : response.blind()) {
      out << "BLIND: " << EscapeText(reason) << "\n";
    }
    if (!response.blind().empty()) out << "\n";
    Table sensors({"SENSOR", "PRIMARY", "CONNECTED", "SETTLED", "OUTBOX", "SPOOL", "LOST IN 10 MIN",
                   "CLOCK SKEW", "NOT VISIBLE"});
    for (const v1::SensorCoverage& sensor : response.sensors()) {
      sensors.Add({sensor.host(), YesNo(sensor.primary()), YesNo(sensor.connected()),
                   YesNo(sensor.settled()), absl::StrCat(sensor.state().outbox_bytes(), " B"),
                   absl::StrCat(sensor.state().spool_bytes(), " B"), absl::StrCat(sensor.lost()),
                   SkewText(sensor), absl::StrJoin(sensor.not_visible(), "; ")});
    }
    sensors.Print(out);
    out << "\n";
    PrintEndpoints(response, out);
    if (response.graph_truncated()) {
      out << "\ngraph truncated: it exceeds the limits, and a part of it is missing here\n";
    }
    if (response.endpoints_left_out() > 0 || response.findings_left_out() > 0) {
      out << "\n"
          << response.endpoints_left_out() << " more endpoints and " << response.findings_left_out()
          << " more findings do not fit into one response\n";
    }
    if (!response.skipped().empty()) {
      out << "\n";
      Table skipped({"SKIPPED INSPECTIONS", "IN 10 MIN"});
      for (const v1::SkippedInspections& each : response.skipped()) {
        skipped.Add({each.reason(), absl::StrCat(each.count())});
      }
      skipped.Print(out);
    }
    if (!response.cut_payloads().empty()) {
      out << "\n";
      Table cut({"PAYLOADS CUT", "LIMIT", "LONGEST", "MESSAGES"});
      for (const v1::CutPayloads& each : response.cut_payloads()) {
        cut.Add({each.topic(), absl::StrCat(each.limit_bytes(), " B"),
                 absl::StrCat(each.longest_bytes(), " B"), absl::StrCat(each.count())});
      }
      cut.Print(out);
    }
    const std::vector<std::string> not_known = NotKnown(response);
    if (!not_known.empty()) out << "\n";
    for (const std::string& reason : not_known) {
      out << "not all findings are known: " << EscapeText(reason) << "\n";
    }
    if (!response.findings().empty()) {
      out << "\n";
      Table findings({"FINDING", "NODE", "TOPIC", "DETAIL"});
      for (const v1::Finding& finding : response.findings()) {
        findings.Add({finding.kind(), finding.node(), finding.topic(), finding.detail()});
      }
      findings.Print(out);
    }
    out << (Complete(response)
                ? "\nall is seen, and no finding stands\n"
                : "\nNOT all is seen, or a finding stands or may stand: see above\n");
  }
  void PrintEndpoints(const v1::GetCoverageResponse& response, TextStream out) const {
    const Counts counts = Count(response);
    Table summary({"ENDPOINTS", "COUNT"});
    for (const Seen seen :
         {Seen::kWatched, Seen::kNotNeeded, Seen::kNotVisible, Seen::kNeverRead}) {
      summary.Add({SeenName(seen), absl::StrCat(counts[seen])});
    }
    summary.Print(out);
    if (!all_ && counts[Seen::kNotVisible] == 0) return;
    out << "\n";
    Table table({"NAME", "KIND", "NODE", "STATE"});
    for (const v1::Endpoint& endpoint : response.endpoints()) {
      if (!all_ && SeenOf(endpoint) != Seen::kNotVisible) continue;
      table.Add({endpoint.name(), KindName(endpoint.kind()),
                 endpoint.node().empty() ? GuidText(endpoint.guid()) : endpoint.node(),
                 SeenText(endpoint)});
    }
    table.Print(out);
  }

  bool all_ = false;
};

}  // namespace

Commands CoverageCommands() { return MakeCommands<ShowInterest, ShowCoverage>(); }

}  // namespace rips::ripsctl
