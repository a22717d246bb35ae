// Watches the sequence numbers that the middleware holds of each writer, and has it forget those
// that no honest writer reaches: else one forged packet makes every reader of this process deaf to
// that writer, since lower numbers are dropped as old before anything else sees them.
//
// | what a look shows                                     | then                                  |
// |-------------------------------------------------------|---------------------------------------|
// | a first number above kFirstNumberMax (discovery and   | a jump, and the numbers are forgotten |
// | ros_discovery_info: 10 million; latched: 10 billion)  |                                       |
// | the highest number rose by more than RiseMax since it | the same                              |
// | last did; of latched writers 100,000 a second are     |                                       |
// | believed, of discovery 10,000                         |                                       |
// | samples are dropped, and nothing new is accepted      | the numbers are forgotten             |
// | what comes then is lower by more than kNumbersSlack   | a jump                                |
//
// Data, heartbeats and gaps alike move these numbers. What a writer sends again, once its numbers
// are forgotten, MessageFlow knows.
#ifndef RIPS_SENSOR_AGENT_MESSAGES_SEQUENCE_WATCH_H_
#define RIPS_SENSOR_AGENT_MESSAGES_SEQUENCE_WATCH_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "sensor_agent/messages/sequence_jump.h"
#include "services/ros2/guid.h"

namespace rips::sensor {

// Of one writer, as the middleware holds them.
struct HeldNumbers {
  uint64_t next = 0;       // the lowest that is not dropped as old
  uint64_t last = 0;       // the highest that the writer is known to have written
  uint64_t discarded = 0;  // bytes of samples that were dropped
};

enum class WriterKind {
  kUnread,     // not looked at; others may find that it jumped
  kMessages,   // what is not read at once is lost
  kLatched,    // keeps samples for late readers
  kDiscovery,  // SEDP, and ros_discovery_info
};

struct SequenceWatchOptions {
  int64_t look_interval_ns = 500'000'000;
  // Of one writer the numbers are forgotten no more often; doubled each time, until they have not
  // been forgotten for calm_ns.
  int64_t pause_ns = 500'000'000;
  int64_t pause_max_ns = 8'000'000'000;
  int64_t calm_ns = 60'000'000'000;
  // In one look, of all writers.
  size_t forgets = 256;
  // Followed; of those that are not read half as many. Beyond, readers have limits of their own.
  size_t writers = 131'072;
  // Writers that jumped before discovery showed them.
  size_t early = 1'024;
};

// Not thread-safe; no clock: times are CLOCK_BOOTTIME in nanoseconds and never go back.
class SequenceWatch {
 public:
  // nullopt = the middleware does not know the writer.
  using Numbers = std::function<std::optional<HeldNumbers>(const ros2::Guid&)>;
  using Forget = std::function<void(const ros2::Guid&)>;
  SequenceWatch(SequenceWatchOptions options, Numbers numbers, Forget forget);

  // Discovered, or not new.
  void ParticipantSeen(const ros2::Guid& participant);
  void WriterSeen(const ros2::Guid& writer, WriterKind kind);
  // A participant goes with all its writers.
  void ParticipantGone(const ros2::Guid& participant);
  void WriterGone(const ros2::Guid& writer);
  // Found elsewhere. Again for the same one: nothing.
  void Jumped(const SequenceJump& jump);

  // Each jump once, of writers that discovery shows.
  std::vector<SequenceJump> Poll(int64_t now_ns);
  int64_t NextDue() const { return jumps_.empty() ? next_look_ns_ : 0; }

 private:
  struct Writer {
    WriterKind kind = WriterKind::kUnread;
    bool jumped = false;
    bool looked = false;
    HeldNumbers held;
    int64_t next_ns = 0;  // when held.next last changed
    // The highest number that is believed, and when it last rose.
    uint64_t top = 0;
    int64_t top_ns = 0;
    // Looks that showed drops and nothing accepted.
    int stuck = 0;
    bool forget = false;  // wanted
    int64_t forgot_ns = 0;
    int64_t pause_ns = 0;
    // The highest number before they were forgotten because of drops; 0 = not so.
    uint64_t before = 0;
    int looks_since = 0;
  };

  void Look(const ros2::Guid& guid, Writer& writer, int64_t now_ns);
  void LookForDrops(Writer& writer, const HeldNumbers& held, int64_t now_ns) const;
  void Jump(const ros2::Guid& guid, Writer& writer, std::string detail);
  bool MayForget(Writer& writer, int64_t now_ns) const;

  const SequenceWatchOptions options_;
  const Numbers numbers_;
  const Forget forget_;
  absl::btree_map<ros2::Guid, Writer> writers_;
  absl::btree_map<ros2::Guid, std::string> early_;
  std::vector<SequenceJump> jumps_;  // not yet told
  int64_t next_look_ns_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_MESSAGES_SEQUENCE_WATCH_H_
