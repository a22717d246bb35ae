// Tells of lost observations once when it begins, each minute while it goes on, and when it is
// over: never an alert for each. Pure; times are the server's boottime.
//
//   state    a loss                     a minute since last told       a minute without loss
//   calm     "are lost" at once         -                              -
//   losing   counted                    "are still being lost"         "no longer", calm again
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_LOSS_ALARM_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_LOSS_ALARM_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/container/btree_map.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/state/effect.h"
#include "services/base/clock.h"

namespace rips::pipeline {

class LossAlarm {
 public:
  static constexpr int64_t kEveryNs = 60 * kNanosPerSecond;
  // Causes told apart; the rest are `other causes`.
  static constexpr size_t kCausesMax = 8;

  struct News {
    engine::Severity severity = engine::Severity::kInfo;
    std::string text;
  };

  // Counts stop at the largest number.
  void Add(absl::string_view cause, uint64_t count, int64_t now_ns);
  // What is to be said now; call at least each second.
  std::optional<News> Due(int64_t now_ns);

 private:
  std::string Causes() const;

  bool losing_ = false;
  int64_t last_loss_ns_ = 0;
  int64_t told_ns_ = 0;
  uint64_t total_ = 0;
  // Since it was told last, by cause.
  absl::btree_map<std::string, uint64_t> fresh_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_LOSS_ALARM_H_
