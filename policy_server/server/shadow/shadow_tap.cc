#include "policy_server/server/shadow/shadow_tap.h"

#include <memory>
#include <utility>

#include "policy_server/server/flight/flight_ring.h"

namespace rips::shadow {
namespace {

size_t TextBytes(const engine::Event& event) {
  const auto* external = std::get_if<engine::ExternalEvent>(&event.what);
  return external == nullptr ? 0 : sizeof(*external) + flight::BytesOf(*external);
}

// What the copy may keep: views of what its batch and its graph keep alive.
pipeline::JudgedEvent CopyOf(const pipeline::JudgedEvent& event,
                             const std::shared_ptr<const pipeline::Batch>& batch) {
  pipeline::JudgedEvent copy = event;
  if (copy.message != nullptr) copy.batch = batch;
  if (auto* message = std::get_if<engine::MessageEvent>(&copy.event.what)) {
    message->memo = nullptr;
    message->inspections = {};
  }
  return copy;
}

}  // namespace

bool ShadowTap::Push(Waiting waiting) {
  charges_.Add(waiting.bytes);
  ++events_;
  queue_.push_back(std::move(waiting));
  return queue_.size() == 1;
}

void ShadowTap::OnBegin(pipeline::RulesState state) {
  bool wake = false;
  {
    MutexLock lock(&mu_);
    if (closed_) return;
    live_.level = state.level;
    ChargePtr graph = charges_.OfGraph(state.graph.get());
    wake = Push({.item = std::move(state),
                 .bytes = sizeof(Waiting),
                 .batch = nullptr,
                 .graph = std::move(graph)});
  }
  if (wake) on_item_();
}

bool ShadowTap::OnEvent(const pipeline::JudgedEvent& event) {
  bool wake = false;
  if (event.batch != nullptr) batch_ = event.batch;
  {
    MutexLock lock(&mu_);
    if (closed_) return false;
    if (events_ >= kEventsMax || (events_ > 0 && bytes() >= kBytesMax)) {
      ++live_.missed;
      return true;
    }
    pipeline::JudgedEvent copy = CopyOf(event, batch_);
    ChargePtr batch = charges_.OfBatch(copy.batch.get());
    wake = Push({.item = std::move(copy),
                 .bytes = sizeof(Waiting) + TextBytes(event.event),
                 .batch = std::move(batch),
                 .graph = charges_.OfGraph(event.graph.get())});
  }
  if (wake) on_item_();
  return true;
}

bool ShadowTap::OnLevel(const pipeline::LevelChange& level) {
  bool wake = false;
  {
    MutexLock lock(&mu_);
    if (closed_) return false;
    live_.level = level.to;
    if (events_ >= kEventsMax + kLevelsMore) {
      ++live_.missed;
      return true;
    }
    wake = Push({.item = level,
                 .bytes = sizeof(Waiting) + level.to.size() + level.cause.size(),
                 .batch = nullptr,
                 .graph = nullptr});
  }
  if (wake) on_item_();
  return true;
}

bool ShadowTap::OnOutcome(const pipeline::RuleOutcome& outcome) {
  MutexLock lock(&mu_);
  if (closed_) return false;
  live_.level = outcome.level;
  live_.counts.alerts += outcome.counts.alerts;
  live_.counts.raises += outcome.counts.raises;
  live_.counts.lowerings += outcome.counts.lowerings;
  live_.counts.refusals += outcome.counts.refusals;
  live_.counts.programs += outcome.counts.programs;
  live_.counts.faults += outcome.counts.faults;
  return true;
}

void ShadowTap::OnRetired() {
  {
    MutexLock lock(&mu_);
    if (closed_) return;
    retired_ = true;
  }
  on_item_();
}

std::optional<ShadowTap::Item> ShadowTap::Pop() {
  if (closed_) Drop(taken_);
  if (taken_.empty()) {
    MutexLock lock(&mu_);
    taken_.swap(queue_);
  }
  if (taken_.empty()) return std::nullopt;
  Waiting oldest = std::move(taken_.front());
  taken_.pop_front();
  charges_.Subtract(oldest.bytes);
  --events_;
  return std::move(oldest.item);
}

void ShadowTap::Close() {
  std::deque<Waiting> dropped;
  {
    MutexLock lock(&mu_);
    closed_ = true;
    dropped.swap(queue_);
  }
  Drop(dropped);
}

void ShadowTap::Drop(std::deque<Waiting>& dropped) {
  events_ -= dropped.size();
  for (const Waiting& each : dropped) charges_.Subtract(each.bytes);
  dropped.clear();
}

bool ShadowTap::retired_and_empty() const {
  MutexLock lock(&mu_);
  return retired_ && queue_.empty() && taken_.empty();
}

ShadowTap::Live ShadowTap::live() const {
  MutexLock lock(&mu_);
  return live_;
}

}  // namespace rips::shadow
