// The observations of one lane, oldest first: some have a number, some of these have gone out on
// this stream.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_LANE_QUEUE_H_
#define RIPS_SENSOR_AGENT_OUTBOX_LANE_QUEUE_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "services/base/check.h"

namespace rips::sensor {

struct BatchPolicy {
  size_t observations = 128;
  size_t bytes = 32 * 1024;
  int64_t linger_ns = 20'000'000;
};

// CostOf(const T&) gives the bytes that an observation takes.
template <typename T>
struct LaneQueue {
  std::deque<T> entries;
  // Sequence of entries[0].
  uint64_t first_sequence = 1;
  // Leading entries that have a number, and that have gone out on this stream; sent <= numbered.
  size_t numbered = 0;
  size_t sent = 0;
  size_t bytes = 0;
  // Something urgent is unsent.
  bool urgent = false;

  size_t unsent() const { return entries.size() - sent; }

  // The first `count` unsent ones have gone out.
  void MarkSent(size_t count) {
    RIPS_CHECK(count <= unsent(), "more was sent than there is");
    sent += count;
    numbered = std::max(numbered, sent);
    if (unsent() == 0) urgent = false;
  }

  // See Outbox::DueAt.
  std::optional<int64_t> DueAt(const BatchPolicy& policy, int64_t last_batch_ns,
                               int64_t now_ns) const {
    if (unsent() == 0) return std::nullopt;
    if (urgent || sent < numbered || unsent() >= policy.observations) return now_ns;
    return std::max(now_ns, last_batch_ns + policy.linger_ns);
  }

  // See Outbox::Acknowledge. `forget` is called with each entry that goes.
  template <typename Forget>
  absl::Status Acknowledge(uint64_t sequence, const Forget& forget) {
    if (sequence < first_sequence) return absl::OkStatus();
    const uint64_t count = sequence - first_sequence + 1;
    if (count > numbered) {
      return absl::InvalidArgumentError(absl::StrCat("acknowledgement of ", sequence,
                                                     ", but the last sequence sent is ",
                                                     first_sequence + numbered - 1));
    }
    for (uint64_t i = 0; i < count; ++i) {
      forget(entries.front());
      bytes -= CostOf(entries.front());
      entries.pop_front();
    }
    first_sequence += count;
    numbered -= count;
    sent -= std::min<uint64_t>(sent, count);
    return absl::OkStatus();
  }

  // See Outbox::DrainMessages. `together(first, next)`: both may stand in one batch.
  template <typename Together>
  std::vector<T> Drain(const BatchPolicy& policy, const Together& together) {
    RIPS_CHECK(sent == 0, "only after Rewind");
    std::vector<T> drained;
    size_t taken = 0;
    while (!entries.empty() && drained.size() < policy.observations &&
           (drained.empty() ||
            (taken <= policy.bytes && together(drained.front(), entries.front())))) {
      taken += CostOf(entries.front());
      drained.push_back(std::move(entries.front()));
      entries.pop_front();
    }
    bytes -= taken;
    first_sequence += drained.size();
    numbered -= std::min(numbered, drained.size());
    return drained;
  }
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_LANE_QUEUE_H_
