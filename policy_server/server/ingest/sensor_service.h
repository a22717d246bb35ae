// SensorService: streams of sensors into the pipeline.
#ifndef RIPS_POLICY_SERVER_SERVER_INGEST_SENSOR_SERVICE_H_
#define RIPS_POLICY_SERVER_SERVER_INGEST_SENSOR_SERVICE_H_

#include "policy_server/server/shard/agent_contacts.h"
#include "policy_server/server/shard/pipeline.h"
#include "rips/v1/sensor.grpc.pb.h"
#include "services/rpc/session_watch.h"
#include "services/runtime/metrics.h"
#include "services/wire_limits/limit_counters.h"

namespace rips::ingest {

struct IngestMetrics {
  // Batches and hellos that were refused as malformed.
  Counter malformed;
  Counter streams;
  // Interests that a sensor could not apply.
  Counter interests_refused;
  // Messages with a field past its limit.
  wire_limits::LimitCounters fields_refused = {};
  // In which a stream was not read, since what came on it was dear to read.
  Counter pauses = {};
};

// Robot, host and role are taken from the certificate alone.
class SensorService final : public rips::v1::SensorService::WithRawCallbackMethod_Observe<
                                rips::v1::SensorService::Service> {
 public:
  // Not owned; all outlive every call. `contacts` may be null.
  SensorService(pipeline::Pipeline* pipeline, rpc::SessionWatch* watch, IngestMetrics metrics,
                pipeline::AgentContacts* contacts = nullptr)
      : pipeline_(pipeline), watch_(watch), metrics_(metrics), contacts_(contacts) {}

  grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* Observe(
      grpc::CallbackServerContext* context) override;

 private:
  pipeline::Pipeline* pipeline_;
  rpc::SessionWatch* watch_;
  IngestMetrics metrics_;
  pipeline::AgentContacts* contacts_;
};

}  // namespace rips::ingest

#endif  // RIPS_POLICY_SERVER_SERVER_INGEST_SENSOR_SERVICE_H_
