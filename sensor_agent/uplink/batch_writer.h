// Puts what UplinkCore wants sent on one stream: encodes it and hands it to the client's queue.
#ifndef RIPS_SENSOR_AGENT_UPLINK_BATCH_WRITER_H_
#define RIPS_SENSOR_AGENT_UPLINK_BATCH_WRITER_H_

#include <cstdint>
#include <string>

#include "rips/v1/sensor.pb.h"
#include "sensor_agent/outbox/uplink_io.h"
#include "sensor_agent/uplink/wire_encoder.h"
#include "services/rpc/bidi_client.h"

namespace rips::sensor {

using UplinkClient = rpc::BidiClient<rips::v1::SensorMessage, rips::v1::SensorReply>;

// For the backlog; on no stream.
Encoded EncodeAlone(const EncodeForBacklog& action);

// Made anew for each stream. Not thread-safe. A client that is not connected has a full line.
class BatchWriter {
 public:
  BatchWriter(const std::string& incarnation, EncoderLimits limits)
      : encoder_(incarnation, limits) {}

  BatchSent Send(const SendBatch& action, const Outbox& outbox, UplinkClient& client);
  // The caller has checked that the line does not hold too many.
  ChunkSent Send(const SendChunk& action, UplinkClient& client);
  // `now_ns` is the time of losses.
  BacklogOpened Open(const OpenBacklog& action, int64_t now_ns);
  BacklogSent Send(const SendBacklog& action, UplinkClient& client);

 private:
  // Moves the payload that must go in chunks out of `opened_`; null = there is none. A batch has
  // one at most; others are cut.
  Payload DetachChunkedPayload();

  WireEncoder encoder_;
  BacklogBatch origin_;
  rips::v1::ObservationBatch opened_;
  // Of the observation whose payload was moved out; -1 = none was.
  int chunked_index_ = -1;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_BATCH_WRITER_H_
