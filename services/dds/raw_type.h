// A DDS type of which only the name is known: samples are the bytes that were on the wire. It
// carries no type information, so Cyclone matches endpoints by topic and type name alone
// (DDS-XTypes 1.3 §7.6.3.4.2, the case without TypeObjects).
//
// Written against the internal serdata interface of Cyclone DDS 0.10; raw_type.cc refuses to
// compile against another.
#ifndef RIPS_SERVICES_DDS_RAW_TYPE_H_
#define RIPS_SERVICES_DDS_RAW_TYPE_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/dds/dds_entity.h"
#include "services/dds/host_addresses.h"
#include "services/ros2/guid.h"

struct ddsi_serdata;
struct ddsi_sertype;

namespace rips::dds {

// Keep payloads whole.
inline constexpr uint32_t kWholePayload = UINT32_MAX;

// A limit on kept bytes that may be changed at any time, by any thread, for what is received from
// then on. Less than an encapsulation header counts as one.
using PayloadLimit = std::atomic<uint32_t>;

struct RawTopic {
  // Before `entity` in every order of destruction: writers and readers of it.
  DdsEntity entity;
  const ddsi_sertype* type = nullptr;  // lives as long as `entity`
};

// A topic with that name, type name and raw samples, of which at most the first
// `payload_bytes_max` bytes (>= 4) are kept on reception. Several in one participant may share
// the name. With `limit` that is what counts instead. InvalidArgument for a name DDS does not take.
absl::StatusOr<RawTopic> CreateRawTopic(EntityHandle participant, const std::string& topic,
                                        const std::string& type,
                                        uint32_t payload_bytes_max = kWholePayload,
                                        std::shared_ptr<const PayloadLimit> limit = nullptr);

// What the participant's domain sends from. FailedPrecondition if the domain has shared memory
// turned on. `topic` is one that the participant may use; no endpoint of it is made.
absl::StatusOr<InterfacesInUse> ExamineDomain(EntityHandle participant, const std::string& topic);

// What a received raw sample holds. Views live as long as the sample.
struct RawContent {
  absl::string_view payload;     // encapsulation header and body, possibly cut
  uint32_t size = 0;             // of the whole payload, in bytes
  uint64_t writer_sequence = 0;  // RTPS sequence number; 0 if written by this process
  // The sample that this one answers, if its writer says so beside the payload (Fast DDS).
  ros2::Guid related_writer;
  uint64_t related_sequence = 0;
};
// `sample` must have come from a raw topic and hold data.
RawContent ContentOf(const ddsi_serdata* sample);

// Writes `payload` (>= 4 bytes) to `writer`, which must be on a topic of `type`. `source_unix_ns`
// is the source timestamp; 0 = now.
absl::Status WriteRaw(EntityHandle writer, const ddsi_sertype* type, absl::string_view payload,
                      int64_t source_unix_ns);

// Samples that were refused on reception since the process started, because their fragments or
// sizes made no sense.
uint64_t RefusedSamples();

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_RAW_TYPE_H_
