// Losses, signals and the sensor's state, merged until they are sent.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_MERGED_REPORTS_H_
#define RIPS_SENSOR_AGENT_OUTBOX_MERGED_REPORTS_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sensor_agent/outbox/observation.h"

namespace rips::sensor {

// Not thread-safe. Times are CLOCK_BOOTTIME in nanoseconds.
class MergedReports {
 public:
  // Losses of more sources than `loss_records` become one record "several" for each cause.
  MergedReports(size_t loss_records, int64_t merge_ns)
      : loss_records_(loss_records), merge_ns_(merge_ns) {}

  // Losses of one cause, topic and source become one record; likewise signals of one name. The
  // newest state replaces the one before, but stays overloaded if that was.
  void Add(Loss loss);
  void AddSignal(const std::string& name, int64_t now_ns);
  void AddState(const SensorState& state, int64_t now_ns);

  bool empty() const { return losses_.empty() && signals_.empty() && !state_.has_value(); }
  // When Flush gives what there is, at the earliest.
  int64_t DueAt(int64_t now_ns) const { return std::max(now_ns, last_flush_ns_ + merge_ns_); }
  // All of it, if `merge_ns` has passed since it last did.
  std::vector<ControlObservation> Flush(int64_t now_ns);

 private:
  using LossKey = std::pair<LossCause, std::pair<std::string, const MessageSource*>>;

  size_t loss_records_;
  int64_t merge_ns_;
  std::map<LossKey, Loss> losses_;
  std::map<std::string, std::pair<uint32_t, int64_t>> signals_;
  std::optional<std::pair<SensorState, int64_t>> state_;
  int64_t last_flush_ns_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_MERGED_REPORTS_H_
