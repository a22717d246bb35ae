// One payload that goes in chunks, ahead of the batch that names it:
//
//   chunks ──all are sent──► awaited ──all are written──► ready ──its batch is sent──► over
//     └──────────┬──────────────┘                           ▲
//                └─ not written in time: given up ──────────┘ (of the backlog; else over)
#ifndef RIPS_SENSOR_AGENT_OUTBOX_PAYLOAD_UPLOAD_H_
#define RIPS_SENSOR_AGENT_OUTBOX_PAYLOAD_UPLOAD_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>

#include "sensor_agent/outbox/backlog.h"
#include "sensor_agent/outbox/observation.h"
#include "sensor_agent/outbox/uplink_io.h"
#include "services/base/payload_limits.h"

namespace rips::sensor {

// Bytes that the server lets be sent, as totals of one stream.
struct StreamCredit {
  uint64_t granted = 0;
  uint64_t used = 0;
  // What the server lets be underway: the most there ever was at once.
  uint64_t window = 0;

  uint64_t left() const { return granted - used; }
  void Grant(uint64_t total) {
    granted = std::max(granted, total);
    window = std::max(window, left());
  }
};

struct PayloadUpload {
  enum class Stage { kChunks, kAwaited, kReady };

  Payload payload;
  // When it is given up, unless all of it is written.
  int64_t until_ns = 0;
  // Of the backlog: the batch, and the most bytes it takes without the payload.
  std::optional<BacklogBatch> backlog;
  uint64_t bytes_max = 0;
  Stage stage = Stage::kChunks;
  // 0 until its first chunk is sent, and when it is given up.
  uint64_t id = 0;
  // Bytes of it that have gone out.
  size_t offset = 0;
  // The line holds too much; LineFree is to come.
  bool blocked = false;

  SendChunk NextChunk() const {
    return {.payload = payload,
            .id = id,
            .offset = offset,
            .bytes = std::min(kPayloadChunkBytes, payload->size() - offset)};
  }
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_PAYLOAD_UPLOAD_H_
