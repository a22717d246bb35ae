// Whether our reader gets what a writer sends to others: each sample that was on the wire, by its
// number, against those that reached us. Numbers are compared as sets and not by their highest,
// since a peer chooses them.
//
// Seconds in which there was something on the wire are looked at one by one, kLateNs after their
// end. A sample counts once, however often it is sent: history and retransmissions that we have had
// are heard. Where so many are lost that their numbers are not at hand any more, samples are
// counted instead. Less than half heard, in kSecondsMissed such seconds in a row and kSamplesMissed
// or more in all: samples go past us. That is over with the first second in which half of them
// come.
#ifndef RIPS_SENSOR_AGENT_WIRE_RECEPTION_H_
#define RIPS_SENSOR_AGENT_WIRE_RECEPTION_H_

#include <cstddef>
#include <cstdint>
#include <deque>

#include "sensor_agent/wire/number_set.h"
#include "sensor_agent/wire/traffic.h"
#include "services/base/clock.h"

namespace rips::wire {

// Of one writer that we read. Not thread-safe; times are CLOCK_BOOTTIME in nanoseconds and never go
// back.
class Reception {
 public:
  static constexpr int64_t kLateNs = kNanosPerSecond;
  static constexpr int kSecondsMissed = 2;
  static constexpr uint64_t kSamplesMissed = 10;
  // Runs of numbers remembered.
  static constexpr size_t kRunsHeard = 64;

  // What is on the wire before `from_ns` is not missed: the writer may not know our reader yet.
  explicit Reception(int64_t from_ns) : from_ns_(from_ns) {}

  void OnWire(const Traffic& traffic, int64_t now_ns);
  void Received(uint64_t number) {
    ++received_;
    heard_.Add(number);
  }
  // Samples that reached us were lost on their way to Received: begins anew.
  void Excuse();

  // Samples go past us.
  bool Missing(int64_t now_ns);
  // While they do: how many, of how many.
  uint64_t missed() const { return missed_; }
  uint64_t sent() const { return sent_; }

 private:
  struct Second {
    int64_t end_ns = 0;
    // At its beginning.
    uint64_t received = 0;
    uint64_t overflows = 0;
    NumberSet numbers{2 * kRunsMax};
  };

  void Judge(const Second& second);

  int64_t from_ns_;
  uint64_t received_ = 0;
  NumberSet heard_{kRunsHeard};
  NumberSet judged_{kRunsHeard};
  std::deque<Second> seconds_;
  // Last number by HEARTBEAT; 0 = none yet.
  uint64_t heartbeat_ = 0;
  // Of the seconds in a row in which less than half was heard.
  int seconds_missed_ = 0;
  uint64_t missed_ = 0;
  uint64_t sent_ = 0;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_RECEPTION_H_
