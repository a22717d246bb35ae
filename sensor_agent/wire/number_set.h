// Sequence numbers as runs without a gap: those of one writer come one after the other, so that few
// runs hold many.
#ifndef RIPS_SENSOR_AGENT_WIRE_NUMBER_SET_H_
#define RIPS_SENSOR_AGENT_WIRE_NUMBER_SET_H_

#include <cstddef>
#include <cstdint>
#include <vector>

namespace rips::wire {

// Inclusive.
struct NumberRun {
  uint64_t first = 0;
  uint64_t last = 0;

  friend bool operator==(const NumberRun&, const NumberRun&) = default;
};

// Not thread-safe.
class NumberSet {
 public:
  // `runs_max` at least 1. Beyond, the run that was added to least recently is forgotten, or, with
  // `keep`, the new number is left out.
  explicit NumberSet(size_t runs_max, bool keep = false) : runs_max_(runs_max), keep_(keep) {}

  // False if there was no room for it.
  bool Add(uint64_t number) { return Add(NumberRun{.first = number, .last = number}); }
  // No effect and true if run.last < run.first. Numbers are below 2^63.
  bool Add(NumberRun run);
  void Clear() { runs_.clear(); }

  bool empty() const { return runs_.empty(); }
  uint64_t count() const;
  // How many of `run` are in this set.
  uint64_t CountIn(const NumberRun& run) const;
  // The parts of `run` that are not in this set, in order.
  std::vector<NumberRun> Without(const NumberRun& run) const;
  // How often a run was forgotten or a number left out.
  uint64_t overflows() const { return overflows_; }
  // Least recently added to first.
  const std::vector<NumberRun>& runs() const { return runs_; }

  friend bool operator==(const NumberSet&, const NumberSet&) = default;

 private:
  size_t runs_max_;
  bool keep_;
  uint64_t overflows_ = 0;
  // Apart from each other by at least one number.
  std::vector<NumberRun> runs_;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_NUMBER_SET_H_
