// Saves flights with alerts, on a thread of its own: what fires never waits for the disk.
//
//   alert of a robot        saved with the next piece, and again at most every kPauseNs, or at once
//                           if it is graver than what was saved; alerts in between share one
//                           recording
//   a robot saves much      past kBurstBytes it saves kBytesPerMilli at most, so that it does not
//                           replace all that was saved of it within minutes
//   the disk is slow        a robot has at most one recording that waits, and all together hold at
//                           most kPendingBytesMax; alerts meanwhile share the next one
//   it cannot be saved      counted, and reported once until one is saved again
#ifndef RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_ARCHIVE_H_
#define RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_ARCHIVE_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "policy_server/server/flight/flight_files.h"
#include "policy_server/server/flight/flight_ring.h"
#include "policy_server/server/robot/ports.h"
#include "services/runtime/bounded_queue.h"

namespace rips::flight {

struct ArchiveReports {
  // Called on the archive's thread; may be empty.
  std::function<void()> saved;
  // A recording could not be saved.
  std::function<void()> failed;
  // The first that could not, since one was saved.
  std::function<void(const absl::Status& why)> problem;
};

class FlightArchive {
 public:
  static constexpr int64_t kPauseNs = 5 * kNanosPerSecond;
  static constexpr size_t kBurstBytes = size_t{32} << 20;
  static constexpr int64_t kBytesPerMilli = 64;
  // Alerts that one recording names; of more it is said that they were too many.
  static constexpr size_t kAlertsMax = 500;
  // Memory of the flights that wait, one excepted.
  static constexpr size_t kPendingBytesMax = size_t{64} << 20;

  // `files` outlives this.
  FlightArchive(FlightFiles* files, ArchiveReports reports);
  // What waits is saved first.
  ~FlightArchive();

  // Of one robot, to be called on its thread; the archive outlives it.
  std::unique_ptr<pipeline::FlightRecorder> NewRecorder(const std::string& robot);

 private:
  class RobotRecorder;
  struct Job {
    std::string robot;
    Flight flight;
    size_t bytes = 0;
    std::vector<recording::RecordedAlert> alerts;
    // Its robot has a recording that waits, until this is done.
    std::shared_ptr<std::atomic<bool>> waits;
  };

  // There is memory for one more.
  bool has_room() const { return pending_bytes_ < kPendingBytesMax; }
  void Submit(Job job);
  void Run();
  absl::Status Save(const Job& job);

  FlightFiles* const files_;
  const ArchiveReports reports_;
  // Of the archive's thread.
  bool failing_ = false;
  std::atomic<size_t> pending_bytes_ = 0;
  BoundedQueue<Job> jobs_{{.capacity = 100'000}};
  std::thread thread_;
};

}  // namespace rips::flight

#endif  // RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_ARCHIVE_H_
