// What the sensor says of itself: how loaded it is, and what it cannot see. In the hello of each
// stream, and in a SensorState whenever it has changed, or while it is loaded.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_SENSOR_STATUS_H_
#define RIPS_SENSOR_AGENT_OUTBOX_SENSOR_STATUS_H_

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sensor_agent/outbox/backlog.h"
#include "sensor_agent/outbox/outbox.h"

namespace rips::sensor {

// Kinds of traffic that may not be visible: those of kSeenByTap without a tap; the next two never;
// the last without DDS Security.
inline constexpr char kUnicastOnlyWriters[] = "unicast-only writers";
inline constexpr char kTwoContents[] = "messages with two contents under one number";
inline constexpr char kSentPastSensor[] = "data of a known writer that is not sent to the sensor";
inline constexpr char kForgedPackets[] = "forged packets, such as one that ends a participant";
inline constexpr const char* kSeenByTap[] = {kUnicastOnlyWriters, kTwoContents, kSentPastSensor,
                                             kForgedPackets};
inline constexpr char kServiceRequests[] = "service requests";
inline constexpr char kSharedMemory[] = "participants that speak shared memory alone";
inline constexpr char kSecuredParticipants[] = "participants with DDS Security";

// Reception time of the oldest observation kept.
std::optional<int64_t> OldestUnacked(const Outbox& outbox, const BacklogState& backlog);

// Not thread-safe.
class SensorStatus {
 public:
  void SetKindVisible(const std::string& kind, bool visible);
  // No `reasons`: what `input` stands for is seen.
  void SetBlind(const std::string& input, std::vector<std::string> reasons);

  void SetFindings(FindingsTold told) { findings_ = told; }

  const std::vector<std::string>& not_visible() const { return not_visible_; }
  // All reasons.
  std::vector<std::string> blind() const;
  // One says the first two. The rest is news to each stream.
  void OnHello();

  // What is to be reported now; nullopt = no news.
  std::optional<SensorState> Poll(const Outbox& outbox, const Backlog& backlog, int64_t now_ns);

 private:
  void MarkReported();

  std::vector<std::string> not_visible_ = {kUnicastOnlyWriters, kTwoContents,     kSentPastSensor,
                                           kForgedPackets,      kServiceRequests, kSharedMemory};
  std::vector<std::string> not_visible_reported_;
  // By input; none is without a reason.
  std::map<std::string, std::vector<std::string>> blind_;
  std::vector<std::string> blind_reported_;
  std::optional<FindingsTold> findings_;
  std::optional<FindingsTold> findings_reported_;
  bool had_backlog_ = false;
  bool overloaded_ = false;
  // Messages and payloads.
  uint64_t shed_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_SENSOR_STATUS_H_
