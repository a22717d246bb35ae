// Finds floods of what limits refuse one by one, and their sources: addresses of connections that
// made no call, certificates whose calls are refused.
//
// | when                                                  | report                              |
// |-------------------------------------------------------|-------------------------------------|
// | one source reaches `of_source` within `window_ns`     | kSource: at once, then after        |
// |                                                       | `again_ns`                          |
// | those not reported by themselves reach `of_all` in it | kAll: the same                      |
// | a source reported before has `of_source` in a minute  | kSource: at once                    |
// | of a higher rank                                      |                                     |
// | a minute in which there was any of these has passed   | kMinute: how many, and from which   |
// |                                                       | sources the most                    |
// | the minute after it has passed without                | kOver                               |
//
// Only `named` sources are reported by themselves, and one more each minute, so that decoys cannot
// use up what is read. They cannot hide the others either: each minute's report names the loudest
// sources, whenever in the minute they came. A rate below `of_source` and `of_all` is not reported,
// however long it lasts. How many came within `window_ns` is estimated from two windows: nearly
// twice as many may pass once. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_FLOOD_WATCH_H_
#define RIPS_POLICY_SERVER_SERVER_FLOOD_WATCH_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "services/base/clock.h"

namespace rips {

// Not thread-safe; times are CLOCK_BOOTTIME.
class FloodWatch {
 public:
  static constexpr int64_t kMinuteNs = 60 * kNanosPerSecond;
  // Sources of a minute that are told apart. Beyond it the quietest are forgotten, and each count
  // may be too low by one for each time that this was needed.
  static constexpr size_t kSourcesMax = 8'192;
  static constexpr size_t kMostMax = 8;
  static constexpr int kRanks = 10;

  struct Limits {
    int of_source = 64;
    int of_all = 512;
    int named = 8;
    int64_t window_ns = 10 * kNanosPerSecond;
    int64_t again_ns = 600 * kNanosPerSecond;
    // Report the sources of the highest rank first, not the loudest.
    bool gravest_first = false;
  };
  // What is refused.
  struct Refused {
    std::string source;
    // How grave it is, below kRanks.
    int rank = 0;
    // The newest is reported.
    std::string detail;
  };
  struct Part {
    std::string source;
    std::string detail;
    uint64_t count = 0;
    std::array<uint64_t, kRanks> by_rank = {};
    // The highest of which there are `of_source`, else 0: one refusal says little of its source.
    int rank = 0;
  };
  struct Report {
    enum class Kind { kSource, kAll, kMinute, kOver };
    Kind kind = Kind::kSource;
    // kSource: that source. Otherwise the loudest of the minute, at most kMostMax, loudest first.
    std::vector<Part> most;
    // From so many sources, or more if they are not all `counted`.
    size_t sources = 1;
    bool counted = true;
    uint64_t count = 0;
    // In which they came, until now.
    int64_t within_ns = 0;
    // A limit was exceeded within the last `window_ns`.
    bool goes_on = true;
  };

  explicit FloodWatch(const Limits& limits) : limits_(limits), names_left_(limits.named) {}

  // The report that this one makes due.
  std::optional<Report> Count(const Refused& refused, int64_t now_ns);
  // The report of the minute that has passed. Call it every second or so.
  std::optional<Report> Poll(int64_t now_ns);

 private:
  // How many came in the last window: those of this one, and of the one before as much of it as
  // the last `window_ns` overlap.
  struct Window {
    int64_t begun_ns = 0;
    int count = 0;
    int before = 0;
  };
  struct Source {
    Window lately;
    // Of this minute.
    Part part;
    // How many of it are in `others_`, at most.
    int in_others = 0;
  };
  struct Reported {
    int64_t at_ns = 0;
    int rank = 0;
  };
  int Lately(Window& window, int64_t now_ns) const;
  // One more; how many there are with it.
  int Add(Window& window, int64_t now_ns) const;
  // Null: there is no room for another one.
  Source* Find(const std::string& source);
  // `source` is due to be reported by itself; takes a name if it needs one.
  bool TakeName(const Source& source, bool reached);
  std::optional<Report> ReportAll(int64_t now_ns);
  std::vector<Part> Most() const;

  const Limits limits_;
  absl::flat_hash_map<std::string, Source> sources_;
  // Some were forgotten in this minute.
  bool forgotten_ = false;
  uint64_t in_minute_ = 0;
  int64_t minute_ns_ = 0;
  // The newest count of this minute by which a limit was exceeded.
  std::optional<int64_t> exceeded_ns_;
  // It was in the last minute.
  bool began_ = false;
  // Of those that were not reported by themselves.
  Window others_;
  std::optional<int64_t> all_reported_ns_;
  // At most `named`, and one for each minute of `again_ns`.
  absl::flat_hash_map<std::string, Reported> reported_;
  int names_left_;
};

}  // namespace rips

#endif  // RIPS_POLICY_SERVER_SERVER_FLOOD_WATCH_H_
