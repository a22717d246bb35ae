// What the uplink knows of one stream to the policy server, and forgets with it.
#ifndef RIPS_SENSOR_AGENT_UPLINK_UPLINK_STREAM_H_
#define RIPS_SENSOR_AGENT_UPLINK_UPLINK_STREAM_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "rips/v1/sensor.pb.h"
#include "sensor_agent/spool/backlog.h"
#include "sensor_agent/uplink/wire_encoder.h"

namespace rips::sensor {

// A payload that goes in chunks.
struct PayloadUpload {
  SentPayload sent;
  // Bytes of it that have gone out.
  size_t offset = 0;
  // When it is given up, unless all of it is written.
  int64_t until_ns = 0;
  bool written = false;
  // If it is of the backlog: where in it, and the parsed batch, of which observation `index` is
  // its message.
  std::optional<BacklogBatch> backlog;
  rips::v1::ObservationBatch batch;
  int index = 0;

  bool complete() const { return offset == sent.payload->size(); }
};

// What one stream knows; made anew for each.
struct UplinkStream {
  UplinkStream(const std::string& incarnation, EncoderLimits limits)
      : encoder(incarnation, limits) {}
  WireEncoder encoder;
  // When batches began to flow.
  int64_t began_ns = 0;
  std::optional<PayloadUpload> upload;
  uint64_t last_payload_id = 0;
  uint64_t payload_granted = 0;
  uint64_t payload_used = 0;
  uint64_t payload_window = 0;
  // The grant of messages with which the backlog's next batch could not be sent.
  std::optional<uint64_t> backlog_blocked_at;
  bool has_config = false;
  bool has_credit = false;
  bool has_ack[2] = {false, false};
  bool wants_snapshot = false;
  uint64_t credit_granted = 0;
  uint64_t credit_used = 0;
  // What the server lets be underway: the most credit there ever was at once.
  uint64_t credit_window = 0;
  // The grant with which nothing more could be sent.
  std::optional<uint64_t> exhausted_at;
  // Encoded, but the client's queue was full.
  std::optional<rips::v1::SensorMessage> stalled;
  // To interests, not yet sent.
  std::vector<rips::v1::InterestApplied> answers;
  int64_t last_batch_ns[2] = {0, 0};
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_UPLINK_STREAM_H_
