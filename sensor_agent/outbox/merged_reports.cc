#include "sensor_agent/outbox/merged_reports.h"

#include "services/base/saturating.h"

namespace rips::sensor {

namespace {

void MergeLoss(Loss& into, const Loss& loss) {
  into.count = SaturatingAdd(into.count, loss.count);
  into.first_boottime_ns = std::min(into.first_boottime_ns, loss.first_boottime_ns);
  into.last_boottime_ns = std::max(into.last_boottime_ns, loss.last_boottime_ns);
}

}  // namespace

void MergedReports::Add(Loss loss) {
  LossKey key{loss.cause, {loss.topic, loss.source.get()}};
  auto it = losses_.find(key);
  if (it == losses_.end() && losses_.size() >= loss_records_) {
    key.second = {"", nullptr};
    loss.topic.clear();
    loss.source = nullptr;
    it = losses_.find(key);
  }
  if (it == losses_.end()) {
    losses_.emplace(std::move(key), std::move(loss));
  } else {
    MergeLoss(it->second, loss);
  }
}

void MergedReports::AddSignal(const std::string& name, int64_t now_ns) {
  auto& [count, first_ns] = signals_.try_emplace(name, 0, now_ns).first->second;
  ++count;
}

void MergedReports::AddState(const SensorState& state, int64_t now_ns) {
  const bool was_overloaded = state_.has_value() && state_->first.overloaded;
  state_.emplace(state, now_ns);
  state_->first.overloaded |= was_overloaded;
}

std::vector<ControlObservation> MergedReports::Flush(int64_t now_ns) {
  std::vector<ControlObservation> flushed;
  if (empty() || now_ns < last_flush_ns_ + merge_ns_) return flushed;
  last_flush_ns_ = now_ns;
  for (auto& [key, loss] : losses_) {
    const int64_t at_ns = loss.last_boottime_ns;
    flushed.push_back({.boottime_ns = at_ns, .what = std::move(loss)});
  }
  losses_.clear();
  for (const auto& [name, seen] : signals_) {
    flushed.push_back(
        {.boottime_ns = seen.second, .what = SignalSeen{.name = name, .count = seen.first}});
  }
  signals_.clear();
  if (state_.has_value()) flushed.push_back({.boottime_ns = state_->second, .what = state_->first});
  state_.reset();
  return flushed;
}

}  // namespace rips::sensor
