// Reads the logs of the host's IDS and hands each alert on once.
//
// When the process ends, the offsets file says where to go on:
//
//   read ──► queue ──[offsets saved, the server's stream up]──► outbox ──► acknowledged
//
// | the process ends while an alert is | then the next one                                   |
// |------------------------------------|-----------------------------------------------------|
// | not read, or in the queue          | reads it (again) from the log                       |
// | in the outbox, not acknowledged    | does not know whether it was judged: does not send  |
// |                                    | it again, and tells a loss of one                   |
// | acknowledged                       | does not send it again                              |
//
// So no alert is judged twice, and none is lost in silence. An acknowledgement is noted a moment
// after it came, so after a crash a loss may be told that was none. Two exceptions: while the
// offsets file cannot be written (metric, error log) a new process begins where the last one that
// could write it was; and after a first start, or without a usable offsets file, reading begins at
// the end of each log, because what stands there may be days old.
//
// A log that cannot be read, or none of whose lines makes sense, is told to the sink as long as
// that lasts:
//
// | what is wrong                                               | told          | over when    |
// |-------------------------------------------------------------|---------------|--------------|
// | it cannot be opened and never could: missing, no permission | at once       | it is open   |
// | it was open and is not any more                             | 10 s later: a | it is open   |
// |                                                             | rotation      |              |
// | kNonsenseLines lines in a row make no sense in its format   | at once       | a line does  |
//
// A wake-up costs one read; saving costs an fsync, at most ten times a second.
#ifndef RIPS_SENSOR_AGENT_IDS_IDS_FEED_H_
#define RIPS_SENSOR_AGENT_IDS_IDS_FEED_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "sensor_agent/ids/alert_parser.h"
#include "sensor_agent/ids/log_tail.h"
#include "sensor_agent/outbox/observation.h"
#include "services/base/clock.h"
#include "services/runtime/metrics.h"
#include "services/runtime/unique_fd.h"

namespace rips::sensor {

inline constexpr size_t kIdsLogsMax = 16;
// So many lines in a row that make no sense: it is the wrong format, not a damaged line.
inline constexpr uint64_t kNonsenseLines = 3;

// One entry of `ids` in sensor.yaml.
struct IdsLog {
  IdsFormat format = IdsFormat::kEve;
  std::string path;

  friend bool operator==(const IdsLog&, const IdsLog&) = default;
};

struct IdsFeedLimits {
  // Alerts read that wait for a stream; beyond, new ones become a Loss LIMIT.
  size_t queued = 4'096;
  size_t queued_bytes = size_t{8} << 20;
  // Handed over and not acknowledged; beyond, alerts wait in the queue.
  size_t in_flight = 1'024;
  // Alerts that come close together are handed over together, this far apart.
  int64_t save_interval_ns = 100'000'000;
  LogTailLimits tail;
};

struct IdsFeedOptions {
  std::vector<IdsLog> logs;
  std::string offsets_file;
  // The outbox keeps what is not acknowledged over a clean stop: it is not in doubt afterwards.
  bool outbox_survives_stop = false;
  IdsFeedLimits limits;
};

// Where alerts go. Called on the feed's thread, without locks held.
struct IdsSink {
  // The server takes what is seen, now.
  std::function<bool()> ready;
  std::function<void(std::vector<ControlObservation> alerts, std::vector<Loss>)> take;
  // How many of the alerts taken are durable at the server; never goes back.
  std::function<uint64_t()> acknowledged;
  // The logs that are not read, and why, one text for each; empty = all are. Called when it
  // changes.
  std::function<void(std::vector<std::string>)> blind;
};

class IdsFeed {
 public:
  // `clock` and `metrics` are not owned and outlive this. Reads the offsets file and makes its
  // directory if that is missing; a file that makes no sense is told in the log and as a loss.
  IdsFeed(IdsFeedOptions options, IdsSink sink, const Clock* clock, Metrics* metrics);
  ~IdsFeed();
  IdsFeed(const IdsFeed&) = delete;
  IdsFeed& operator=(const IdsFeed&) = delete;

  // Once each. Stop waits a moment for acknowledgements and saves; the sink must still work.
  void Start();
  void Stop();

  // What the thread does at each wake-up; tests call it instead of Start. True if there is more to
  // do at once.
  bool Turn();
  // As Stop does after the thread has ended.
  void SaveAtEnd();

 private:
  struct Log {
    Log(IdsLog log, std::optional<LogPosition> from, LogTailLimits limits, Metrics* metrics);

    const IdsLog what;
    LogTail tail;
    Counter alerts;
    Counter not_understood;
    Counter too_long;
    Counter gaps;
    Counter truncated;
    Gauge open;
    LogTailCounters counted;
    // 0 = it is being followed.
    int64_t not_open_since_ns = 0;
    bool was_open = false;
    // In a row, up to now.
    uint64_t nonsense_lines = 0;
    bool told_not_open = false;
    bool told_not_understood = false;
    bool told_fields = false;
  };
  struct Queued {
    int64_t boottime_ns;
    IdsAlert alert;
    const Log* log;
    // Of its line.
    LogPosition position;
  };

  LogOffsets LoadOffsets();
  void OnLine(Log& log, absl::string_view line, int64_t now_ns);
  void LookAt(Log& log, int64_t now_ns);
  // Why its alerts are not seen; empty = they are.
  static std::string BlindTo(const Log& log, int64_t now_ns);
  void TellBlind(int64_t now_ns);
  void TakeAcknowledged();
  void HandOver(int64_t now_ns);
  void SaveIfDue(int64_t now_ns);
  void Save(int64_t now_ns, uint64_t unacknowledged);
  std::map<std::string, LogPosition> Positions() const;
  void Lose(LossCause cause, uint64_t count, int64_t now_ns);
  void TellLosses();
  void Run();
  // Until something happens, but not longer than `timeout_ms`. False when stopping.
  bool Wait(int timeout_ms);

  const IdsFeedOptions options_;
  const IdsSink sink_;
  const Clock* clock_;
  Counter dropped_;
  Gauge unsaved_;
  std::vector<std::unique_ptr<Log>> logs_;
  std::deque<Queued> queue_;
  size_t queued_bytes_ = 0;
  std::vector<Loss> losses_;
  std::vector<std::string> blind_told_;
  uint64_t handed_ = 0;
  uint64_t in_flight_ = 0;
  // What the offsets file says, if it could be written.
  LogOffsets saved_;
  int64_t last_save_ns_ = 0;
  bool told_unsaved_ = false;
  int64_t last_turn_ns_ = 0;
  UniqueFd stop_;  // eventfd
  std::thread thread_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_IDS_IDS_FEED_H_
