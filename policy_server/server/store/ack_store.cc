#include "policy_server/server/store/ack_store.h"

#include <algorithm>

namespace rips::store {

bool Matches(const AlertQuery& query, const AlertRecord& alert) {
  const std::vector<std::string>& severities = query.severities;
  const bool grave = severities.empty() || std::find(severities.begin(), severities.end(),
                                                     alert.severity) != severities.end();
  return grave && (query.rule.empty() || query.rule == alert.rule) &&
         (query.since_unix_ns == 0 || alert.time_unix_ns >= query.since_unix_ns);
}

}  // namespace rips::store
