// The tap as the sensor's observer thread sees it: takes its reports, judges them by what discovery
// shows, and hands over findings.
#ifndef RIPS_SENSOR_AGENT_WIRE_WIRE_INPUT_H_
#define RIPS_SENSOR_AGENT_WIRE_WIRE_INPUT_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "sensor_agent/dds/domain_watch.h"
#include "sensor_agent/dds/topic_watcher.h"
#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/outbox/observation.h"
#include "sensor_agent/wire/wire_socket.h"
#include "sensor_agent/wire/wire_watch.h"
#include "services/base/clock.h"
#include "services/runtime/metrics.h"

namespace rips::wire {

struct WireInputOptions {
  std::string socket;
  uint32_t domain = 0;
  // This sensor uses DDS Security.
  bool secured = false;
};

// One thread, but for `wake`.
class WireInput {
 public:
  // The errors of WireSocket::Listen. `metrics` is not owned and outlives this; `wake` is called
  // from another thread when there is something to poll for.
  static absl::StatusOr<std::unique_ptr<WireInput>> Create(const WireInputOptions& options,
                                                           std::function<void()> wake,
                                                           Metrics* metrics);

  // Everything that is discovered, in order; `now_ns` is CLOCK_BOOTTIME.
  void OnDiscovered(const sensor::Discovered& discovered, int64_t now_ns);
  // We have a reader for this writer.
  void OnRead(const ros2::Guid& writer, int64_t now_ns) { watch_.WriterRead(writer, now_ns); }
  // Perhaps we have readers for others than before; `reads` tells of which writers.
  void OnReaders(const std::function<bool(const ros2::Guid&)>& reads, int64_t now_ns) {
    watch_.SetReaders(reads, now_ns);
  }
  // Our readers got this sample; they got some of any writer that were lost afterwards.
  void OnSample(const ros2::Guid& writer, uint64_t number) { watch_.Received(writer, number); }
  void OnSamplesLost() { watch_.ReceivedAndLost(); }
  // Discovery is told anew: what is not seen again is gone.
  void OnRediscovery(int64_t now_ns) { watch_.Rediscover(now_ns); }

  // Findings that begin or are over, logged too; `graph` names the nodes.
  std::vector<sensor::ControlObservation> Poll(const sensor::GraphBuilder& graph, int64_t now_ns);
  // What the last Polls found besides, since the last call: writers whose sequence numbers jumped;
  // writers whose messages do not come, or come again; and messages that others were sent in place
  // of those that we got, of which no payload is held: they cannot be inspected.
  std::vector<Jump> TakeJumps() { return watch_.TakeJumps(); }
  std::vector<sensor::Coverage> TakeCoverage() { return std::exchange(coverage_, {}); }
  // Why messages of this writer do not come as the tap sees them; empty = they do.
  std::string NotVisible(const ros2::Guid& writer) const;
  std::vector<sensor::MessageSeen> TakeUnseen(const sensor::GraphBuilder& graph, int64_t now_ns);
  // The tap cannot use what discovery has shown, and could if it were told again.
  bool WantsRediscovery() const { return watch_.CanSeeAgain(); }
  // Those that stand: for a server that has forgotten them.
  std::vector<sensor::ControlObservation> Standing(int64_t now_ns) const;
  // No others may stand: there was room for them, and the tap has been there for long enough.
  static constexpr int64_t kTapSettleNs = 20 * kNanosPerSecond;
  bool ToldAll(int64_t now_ns) const;
  // A tap reports.
  bool visible(int64_t now_ns) const;
  // Why traffic is not seen, human-readable; empty = it is, or the tap has been away for less than
  // kAwayNs. Call it after each Poll: the first starts the clock.
  static constexpr int64_t kAwayNs = 10 * kNanosPerSecond;
  std::vector<std::string> Blind(int64_t now_ns);

 private:
  WireInput(const WireInputOptions& options, Metrics* metrics);

  void TakeReport(const TapReport& report, int64_t now_ns);
  void NoteCoverage(const sensor::Finding& finding);
  // The node that it was told with, which is part of what makes it the same one.
  void SetNode(const sensor::GraphBuilder& graph, sensor::Finding& finding);
  void CountLimits();

  Counter packets_;
  Counter malformed_;
  Counter cut_;
  Counter dropped_;
  Gauge connected_;
  Gauge standing_;
  WireWatch watch_;
  // Of the last report; the tap counts from its start.
  TapCounters tap_counted_;
  uint64_t dropped_counted_ = 0;
  int64_t last_report_ns_ = 0;  // 0 = none of this tap yet
  int64_t tap_changed_ns_ = 0;  // 0 = there was none
  // Of those that stand, by kind and GUID.
  absl::btree_map<std::pair<std::string, ros2::Guid>, std::string> nodes_;
  const std::string socket_path_;
  // No tap reports since then; 0 = one does, or nobody has asked yet.
  int64_t away_since_ns_ = 0;
  bool blind_logged_ = false;
  std::vector<sensor::Coverage> coverage_;
  // Last: it goes first.
  std::unique_ptr<WireSocket> socket_;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_WIRE_INPUT_H_
