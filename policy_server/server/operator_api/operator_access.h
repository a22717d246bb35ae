// What OperatorService reads and changes, besides the robots.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OPERATOR_ACCESS_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OPERATOR_ACCESS_H_

#include <functional>
#include <memory>
#include <string>

#include "policy_server/server/audit/order_audit.h"
#include "policy_server/server/enrol/enrolment.h"
#include "policy_server/server/flight/flight_files.h"
#include "policy_server/server/operator_api/ban_list.h"
#include "policy_server/server/operator_api/caller_quota.h"
#include "policy_server/server/rollout/bundle_control.h"
#include "policy_server/server/shard/agent_contacts.h"
#include "policy_server/server/shard/listed_settings.h"
#include "policy_server/server/shard/robot_labels.h"
#include "policy_server/server/store/ack_store.h"
#include "policy_server/server/store/committer.h"
#include "services/rpc/certificate_monitor.h"
#include "services/rpc/peer.h"
#include "services/rpc/session_watch.h"
#include "services/wire_limits/limit_counters.h"

namespace rips::operator_api {

// Nothing is owned but what is shared; all outlives the service.
struct OperatorAccess {
  rpc::SessionWatch* watch = nullptr;
  // Null: Ban, Unban and ListAgents are UNIMPLEMENTED.
  BanList* bans = nullptr;
  rpc::CertificateMonitor* certificates = nullptr;
  // Requests with a field past its limit, which are refused; told who sent it, from where, and
  // field, size and limit. May be empty.
  wire_limits::LimitCounters fields_refused = {};
  std::function<void(const rpc::Peer&, const std::string& address, const std::string& what)>
      on_refused_field = {};
  // Null: no limits of one identity.
  std::shared_ptr<CallerQuota> quota;
  // Calls that change something or record a robot, admitted or refused. Null: not recorded.
  audit::OrderAudit* audit = nullptr;
  // False while the store takes nothing; ListAlerts then shows what robots hold in memory. May be
  // empty: it always does.
  std::function<bool()> store_writable = {};
  // Null: none are kept.
  const flight::FlightFiles* recordings = nullptr;
  // Null: calls about bundles, and about acknowledgements, are UNIMPLEMENTED.
  rollout::BundleControl* bundles = nullptr;
  store::AckStore* acks = nullptr;
  store::Committer* committer = nullptr;
  // Null: no certificates are issued, and calls about that are UNIMPLEMENTED.
  enrol::Enrolment* enrolment = nullptr;
  // Null: no robot has agents.
  const pipeline::AgentContacts* contacts = nullptr;
  // Null: no robot has labels.
  const pipeline::RobotLabels* labels = nullptr;
  // Null: nothing is known of settings; with `contacts`.
  const pipeline::ListedSettings* settings = nullptr;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OPERATOR_ACCESS_H_
