#include "policy_server/server/outputs/ocsf_format.h"

#include <nlohmann/json.hpp>
#include <utility>

#include "policy_server/server/config/output_config.h"
#include "services/base/clock.h"

namespace rips::outputs {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kClass = 2004;
constexpr int kCreate = 1;

Json Evidence(const engine::TracedSubject& subject) {
  Json evidence = {{"data",
                    {{"name", subject.name},
                     {"role", subject.role},
                     {"guid", subject.guid.none() ? "" : ToString(subject.guid)},
                     {"host", subject.host},
                     {"address", subject.address}}}};
  if (subject.pid != 0) evidence["process"] = {{"name", subject.name}, {"pid", subject.pid}};
  return evidence;
}

// As OCSF words it.
const char* Caption(int severity_id) {
  constexpr const char* kCaptions[] = {"Unknown", "Informational", "Low",
                                       "Medium",  "High",          "Critical"};
  return kCaptions[severity_id];
}

}  // namespace

std::string FormatOcsf(const store::AlertRecord& alert) {
  const int64_t time_ms = alert.time_unix_ns / kNanosPerMilli;
  // 0 = a word that is not known.
  const int severity_id = server::SeverityRank(alert.severity) + 1;
  Json evidences = Json::array();
  for (const engine::TracedSubject& subject : alert.trace.subjects) {
    evidences.push_back(Evidence(subject));
  }
  Json finding = {
      {"category_uid", 2},
      {"category_name", "Findings"},
      {"class_uid", kClass},
      {"class_name", "Detection Finding"},
      {"activity_id", kCreate},
      {"activity_name", "Create"},
      {"type_uid", kClass * 100 + kCreate},
      {"time", time_ms},
      {"severity_id", severity_id},
      {"severity", Caption(severity_id)},
      {"status_id", 1},
      {"status", "New"},
      {"message", alert.text},
      {"metadata",
       {{"version", "1.1.0"}, {"product", {{"name", "RIPS"}, {"vendor_name", "RIPS"}}}}},
      {"finding_info",
       {{"uid", alert.id},
        {"title", alert.rule},
        {"desc", alert.text},
        {"created_time", time_ms},
        {"analytic", {{"name", alert.rule}, {"type_id", 1}, {"type", "Rule"}}}}}};
  finding["resources"] =
      Json::array({Json{{"uid", alert.robot}, {"name", alert.robot}, {"type", "robot"}}});
  finding["evidences"] = std::move(evidences);
  finding["unmapped"] = {{"level", alert.level},
                         {"decision_id", ToString(alert.decision_id)},
                         {"event", alert.event},
                         {"maintenance", alert.maintenance}};
  return finding.dump(-1, ' ', /*ensure_ascii=*/true, Json::error_handler_t::replace);
}

}  // namespace rips::outputs
