#include "sensor_agent/wire/reception.h"

#include <algorithm>

#include "sensor_agent/wire/writer_numbers.h"

namespace rips::wire {

void Reception::OnWire(const Traffic& traffic, int64_t now_ns) {
  // What a HEARTBEAT says there is went to somebody, even where it does not pass this host. What it
  // says has gone may never have been sent.
  NumberRun said = {.first = std::max(heartbeat_, traffic.dropped_last) + 1,
                    .last = traffic.heartbeat_last};
  const bool usable = heartbeat_ != 0 && said.last - said.first < WriterNumbers::kJump;
  if (!usable) said.last = 0;
  heartbeat_ = std::max(heartbeat_, traffic.heartbeat_last);
  if (now_ns < from_ns_) return;
  if (traffic.numbers.empty() && said.last < said.first) return;
  if (seconds_.empty() || now_ns >= seconds_.back().end_ns) {
    seconds_.push_back({.end_ns = now_ns + kNanosPerSecond,
                        .received = received_,
                        .overflows = heard_.overflows()});
  }
  NumberSet& numbers = seconds_.back().numbers;
  const auto add = [&](const NumberRun& run) {
    for (const NumberRun& part : judged_.Without(run)) numbers.Add(part);
  };
  for (const NumberRun& run : traffic.numbers.runs()) add(run);
  if (said.first <= said.last) add(said);
}

void Reception::Excuse() {
  seconds_.clear();
  seconds_missed_ = 0;
  missed_ = sent_ = 0;
}

bool Reception::Missing(int64_t now_ns) {
  while (!seconds_.empty() && now_ns >= seconds_.front().end_ns + kLateNs) {
    Judge(seconds_.front());
    seconds_.pop_front();
  }
  return seconds_missed_ >= kSecondsMissed && missed_ >= kSamplesMissed;
}

void Reception::Judge(const Second& second) {
  uint64_t sent = 0;
  uint64_t heard = 0;
  for (const NumberRun& run : second.numbers.runs()) {
    for (const NumberRun& part : judged_.Without(run)) {
      sent += part.last - part.first + 1;
      heard += heard_.CountIn(part);
    }
  }
  for (const NumberRun& run : second.numbers.runs()) judged_.Add(run);
  if (heard_.overflows() != second.overflows) {
    heard = std::max(heard, std::min(sent, received_ - second.received));
  }
  if (sent == 0) return;
  if (heard * 2 >= sent) {
    seconds_missed_ = 0;
    missed_ = sent_ = 0;
    return;
  }
  ++seconds_missed_;
  missed_ += sent - heard;
  sent_ += sent;
}

}  // namespace rips::wire
