#include "sensor_agent/outbox/sensor_status.h"

#include <algorithm>
#include <utility>

namespace rips::sensor {

std::optional<int64_t> OldestUnacked(const Outbox& outbox, const BacklogState& backlog) {
  const std::optional<int64_t> live_ns = outbox.OldestUnacked();
  if (!backlog.oldest_ns.has_value()) return live_ns;
  return std::min(live_ns.value_or(*backlog.oldest_ns), *backlog.oldest_ns);
}

void SensorStatus::SetKindVisible(const std::string& kind, bool visible) {
  const auto it = std::find(not_visible_.begin(), not_visible_.end(), kind);
  if (visible && it != not_visible_.end()) not_visible_.erase(it);
  if (!visible && it == not_visible_.end()) not_visible_.push_back(kind);
}

void SensorStatus::SetBlind(const std::string& input, std::vector<std::string> reasons) {
  if (reasons.empty()) {
    blind_.erase(input);
  } else {
    blind_[input] = std::move(reasons);
  }
}

std::vector<std::string> SensorStatus::blind() const {
  std::vector<std::string> all;
  for (const auto& [input, reasons] : blind_) {
    all.insert(all.end(), reasons.begin(), reasons.end());
  }
  return all;
}

void SensorStatus::OnHello() {
  MarkReported();
  findings_reported_.reset();
}

void SensorStatus::MarkReported() {
  not_visible_reported_ = not_visible_;
  blind_reported_ = blind();
}

std::optional<SensorState> SensorStatus::Poll(const Outbox& outbox, const Backlog& backlog,
                                              int64_t now_ns) {
  const uint64_t shed = outbox.shed_messages() + outbox.shed_payloads();
  const BacklogState kept = backlog.state();
  const bool overloaded = std::exchange(shed_, shed) != shed ||
                          (kept.disk_refuses && kept.observations > 0) ||
                          outbox.bytes() > outbox.limits().message_bytes / 2;
  const bool was_overloaded = std::exchange(overloaded_, overloaded);
  const bool had_backlog = std::exchange(had_backlog_, kept.observations > 0);
  SensorState state{.overloaded = overloaded,
                    .outbox_bytes = outbox.bytes() + kept.memory_bytes,
                    .oldest_unacked_ns = now_ns - OldestUnacked(outbox, kept).value_or(now_ns),
                    .spool_bytes = backlog.disk().bytes,
                    .not_visible = not_visible_,
                    .blind = blind(),
                    .findings_all_told = findings_ && findings_->all};
  if (findings_) state.findings_digest = findings_->digest;
  const bool news = overloaded || was_overloaded || had_backlog_ || had_backlog ||
                    not_visible_ != not_visible_reported_ || state.blind != blind_reported_ ||
                    findings_ != findings_reported_;
  if (!news) return std::nullopt;
  MarkReported();
  findings_reported_ = findings_;
  return state;
}

}  // namespace rips::sensor
