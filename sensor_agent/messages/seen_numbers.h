// Which sequence numbers of one writer have come, in bounded memory: a few ranges.
//
// Of more ranges than kRanges two are joined that less than kSmallGap lies between, or else the
// lowest is forgotten: then its numbers would count as new. So whoever chooses the numbers cannot
// have others taken for seen, but for a few beside his own.
#ifndef RIPS_SENSOR_AGENT_MESSAGES_SEEN_NUMBERS_H_
#define RIPS_SENSOR_AGENT_MESSAGES_SEEN_NUMBERS_H_

#include <cstddef>
#include <cstdint>
#include <vector>

namespace rips::sensor {

class SeenNumbers {
 public:
  static constexpr size_t kRanges = 16;
  static constexpr uint64_t kSmallGap = 1'024;

  // False if it was there.
  bool Add(uint64_t number);
  bool Has(uint64_t number) const;
  // 0 = nothing has come.
  uint64_t highest() const { return ranges_.empty() ? 0 : ranges_.back().last; }

 private:
  struct Range {
    uint64_t first = 0;
    uint64_t last = 0;
  };

  // Ascending, with at least one number between.
  std::vector<Range> ranges_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_MESSAGES_SEEN_NUMBERS_H_
