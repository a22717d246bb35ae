// What is read back from the store.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_FOUND_RECORDS_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_FOUND_RECORDS_H_

#include <cstdint>
#include <string>
#include <vector>

#include "policy_server/policy/engine/state/trace.h"
#include "policy_server/server/store/records.h"
#include "services/base/decision_id.h"

namespace rips::store {

// A run of alerts, in the order of writing.
struct AlertPage {
  // With their sequences.
  std::vector<AlertRecord> alerts;
  // Alerts between the one asked for and the first of these were forgotten by the limit.
  bool forgotten = false;

  friend bool operator==(const AlertPage&, const AlertPage&) = default;
};

// A decision or a refusal, as read back.
struct TransitionRecord {
  std::string id;
  std::string robot;
  int64_t time_unix_ns = 0;
  std::string from;
  std::string to;
  std::string cause;
  std::string reason;
  // None when refused.
  DecisionId decision_id;
  DecisionId based_on;
  bool refused = false;
  // How often this refusal was seen; 1 for a decision.
  uint64_t count = 1;
  // `requested` until the actuators report; empty when refused.
  std::string stage;
  std::string detail;
  engine::Trace trace;

  friend bool operator==(const TransitionRecord&, const TransitionRecord&) = default;
};

// What was written under ids that begin alike; at most two of each.
struct FoundRecords {
  std::vector<AlertRecord> alerts;
  std::vector<TransitionRecord> transitions;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_FOUND_RECORDS_H_
