// ActuatorService: streams of mode actuators into and out of the pipeline.
#ifndef RIPS_POLICY_SERVER_SERVER_DISPATCH_ACTUATOR_SERVICE_H_
#define RIPS_POLICY_SERVER_SERVER_DISPATCH_ACTUATOR_SERVICE_H_

#include <functional>
#include <string>
#include <utility>

#include "policy_server/server/shard/agent_contacts.h"
#include "policy_server/server/shard/pipeline.h"
#include "rips/v1/actuator.grpc.pb.h"
#include "services/model/audit_head.h"
#include "services/rpc/session_watch.h"
#include "services/runtime/metrics.h"
#include "services/wire_limits/limit_counters.h"

namespace rips::dispatch {

struct DispatchMetrics {
  // Hellos and receipts that were refused as malformed.
  Counter malformed;
  Counter streams;
  Counter commands;
  // Messages with a field past its limit.
  wire_limits::LimitCounters fields_refused = {};
  // In which a stream was not read, since what came on it was dear to read.
  Counter pauses = {};
};

// The audit log, as actuators carry its heads. Empty without one. Any thread; never block.
struct AuditHeads {
  // To grant leases with; called for as long as the pipeline lives.
  std::function<model::AuditHead()> newest;
  // An actuator came back with one.
  std::function<void(const std::string& robot, const std::string& host, model::AuditHead)> returned;
};

// Robot, host and role are taken from the certificate alone.
class ActuatorService final : public rips::v1::ActuatorService::WithRawCallbackMethod_Attach<
                                  rips::v1::ActuatorService::Service> {
 public:
  // Not owned; all outlive every call. `contacts` may be null.
  ActuatorService(pipeline::Pipeline* pipeline, rpc::SessionWatch* watch, DispatchMetrics metrics,
                  AuditHeads heads = {}, pipeline::AgentContacts* contacts = nullptr)
      : pipeline_(pipeline),
        watch_(watch),
        metrics_(metrics),
        heads_(std::move(heads)),
        contacts_(contacts) {}

  grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* Attach(
      grpc::CallbackServerContext* context) override;

 private:
  pipeline::Pipeline* pipeline_;
  rpc::SessionWatch* watch_;
  DispatchMetrics metrics_;
  const AuditHeads heads_;
  pipeline::AgentContacts* contacts_;
};

}  // namespace rips::dispatch

#endif  // RIPS_POLICY_SERVER_SERVER_DISPATCH_ACTUATOR_SERVICE_H_
