#include "sensor_agent/outbox/graph_trail.h"

#include <optional>
#include <utility>

#include "sensor_agent/outbox/outbox.h"

namespace rips::sensor {

void GraphTrail::Add(const GraphChange& change) {
  step_bytes_ += CostOf(change.delta);
  steps_.push_back(change);
  while (steps_.size() > kStepsMax || step_bytes_ > kStepBytesMax) {
    Advance(steps_.front().to_version);
  }
}

void GraphTrail::Advance(uint64_t version) {
  while (!steps_.empty() && steps_.front().to_version <= version) {
    base_.Apply(steps_.front());
    step_bytes_ -= CostOf(steps_.front().delta);
    steps_.pop_front();
  }
}

void GraphTrail::Clear() {
  base_.Forget();
  steps_.clear();
  step_bytes_ = 0;
  brought_ = std::numeric_limits<uint64_t>::max();
}

std::vector<GraphChange> GraphTrail::StepsBetween(uint64_t from, uint64_t to) const {
  std::vector<GraphChange> between;
  size_t bytes = 0;
  for (const GraphChange& step : steps_) {
    if (step.to_version <= from || step.to_version > to) continue;
    bytes += CostOf(step.delta);
    between.push_back(step);
  }
  const bool fits = !between.empty() && bytes <= kBroughtBytesMax &&
                    (between.front().whole() || between.front().from_version == from);
  return fits ? between : std::vector<GraphChange>();
}

std::vector<GraphChange> GraphTrail::Bring(uint64_t version, Brought& brought) {
  ++brought.batches;
  if (version == 0) return {};
  uint64_t known = base_.version();
  for (const GraphChange& step : steps_) {
    if (step.to_version <= version) known = step.to_version;
  }
  if (brought.version != 0 && brought.batches <= kBatchesMax) {
    if (known <= brought.version) return {};
    std::vector<GraphChange> steps = StepsBetween(brought.version, known);
    if (!steps.empty()) {
      brought.version = brought_ = known;
      return steps;
    }
  }
  GraphBase then = base_;
  for (const GraphChange& step : steps_) {
    if (step.to_version <= known) then.Apply(step);
  }
  std::optional<GraphChange> snapshot = then.Snapshot();
  if (!snapshot.has_value() || CostOf(snapshot->delta) > kBroughtBytesMax) return {};
  brought = {.version = then.version(), .batches = 1};
  brought_ = brought.version;
  std::vector<GraphChange> whole;
  whole.push_back(*std::move(snapshot));
  return whole;
}

}  // namespace rips::sensor
