// One output: alerts from the store to one receiver, in the order of the store, each at least once.
//
// The store is the queue: nothing waits in memory, and nothing waits for a receiver but this
// output's own thread. The place moves on when the receiver has accepted what was sent
// (output_place.h).
//
// | a delivery                        | what follows                                            |
// |-----------------------------------|---------------------------------------------------------|
// | is accepted                       | the place moves on; the next page                       |
// | fails                             | the same again after 1 s, doubled to about 4 min,       |
// |                                   | +- 20 %; if it was not in time, in single alerts        |
// | of several alerts is refused      | the same alerts at once, one by one                     |
// | of one alert is refused           | twice again as after a failure; then it is skipped      |
// |                                   | (logged, counted), which ends no trouble                |
//
// What the store has forgotten meanwhile is sent as an event of its own (gap.h) before the alerts
// that follow; the same event until it is accepted, so that a receiver can tell it from another.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUT_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUT_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "policy_server/server/config/output_config.h"
#include "policy_server/server/outputs/delivery_health.h"
#include "policy_server/server/outputs/gap.h"
#include "policy_server/server/outputs/output_place.h"
#include "policy_server/server/outputs/receiver.h"
#include "policy_server/server/store/store.h"
#include "services/base/clock.h"
#include "services/rpc/backoff.h"
#include "services/runtime/mutex.h"

namespace rips::outputs {

// All are called on the output's thread, and must not block.
struct OutputReports {
  std::function<void(uint64_t)> sent;
  std::function<void(uint64_t)> skipped;
  std::function<void(uint64_t)> forgotten;
  std::function<void()> failed;
  // Sequences of the store from the place to the newest alert.
  std::function<void(uint64_t)> behind;
  std::function<void(bool)> healthy;
  DeliveryHealth::Alert alert;
};

class Output {
 public:
  static constexpr int kTriesMax = 3;
  static constexpr rpc::BackoffPolicy kBackoff = {
      .initial = absl::Milliseconds(1'250), .max = absl::Seconds(250), .jitter = 0.2};

  // Looks every `interval`, on a thread of its own; InfiniteDuration = only when asked. `store` and
  // `clock` are not owned and outlive this.
  Output(const server::OutputConfig& config, store::Store* store,
         std::unique_ptr<Receiver> receiver, OutputReports reports, const Clock* clock,
         rpc::Random random, absl::Duration interval = absl::Milliseconds(500));
  // As Stop.
  ~Output();

  // Delivers what there is, if it is time. One thread at a time; not beside the thread of its own.
  void Look() ABSL_LOCKS_EXCLUDED(mu_);
  // Ends a delivery that runs. Any thread; never blocks.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);
  // Cancels, waits for the thread, and writes the place down. Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // What is known of deliveries that were not accepted.
  struct Attempts {
    int64_t retry_at_ns = 0;
    // Up to this sequence alerts are sent one by one.
    uint64_t singly_up_to = 0;
    std::string refused_id;
    int refused = 0;
    // What was delivered last was skipped.
    bool skipped = false;
    // Forgotten alerts after the place that the receiver knows of.
    uint64_t forgotten_told = 0;
    // The gap that it is to know of next, and of how many alerts it is.
    std::optional<store::AlertRecord> gap;
    uint64_t gap_count = 0;
  };
  void Run();
  bool stopping() ABSL_LOCKS_EXCLUDED(mu_);
  // Delivers the next page. False: there is none, or it must be tried again later.
  bool Follow(const store::AlertRecord& newest);
  // Tells the receiver of a gap, the same until it is accepted; false as Follow.
  bool ReportGap(const Gap& gap);
  // Of the page that was read; false as Follow.
  bool ReportForgotten(const store::AlertPage& page, uint64_t forgotten);
  // True: accepted or skipped.
  bool Deliver(std::span<const store::AlertRecord> alerts, uint64_t up_to);
  void OnFailed(const absl::Status& status, std::span<const store::AlertRecord> alerts,
                uint64_t up_to);

  const server::OutputConfig config_;
  store::Store* store_;
  const std::unique_ptr<Receiver> receiver_;
  const OutputReports reports_;
  const Clock* clock_;
  const absl::Duration interval_;
  OutputPlace place_;
  DeliveryHealth health_;
  rpc::Backoff backoff_;
  Attempts attempts_;

  Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUT_H_
