// The recordings that are kept on disk: `DIR/ROBOT/START-ALERT.rips`, named by the time of their
// start in nanoseconds since the Unix epoch and by their first alert.
//
// Together they have at most `bytes_max`: the oldest of the robot that has most goes first, so that
// no robot pushes out another's. What else lies in the directory is left alone.
#ifndef RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_FILES_H_
#define RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_FILES_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/recording/recorded.h"
#include "services/runtime/mutex.h"

namespace rips::flight {

struct FlightFilesOptions {
  std::string directory;
  // Of all files; a recording that is larger is refused.
  uint64_t bytes_max = uint64_t{256} << 20;
  // Recordings leave so much of the file system to the store. Bytes.
  uint64_t free_bytes_min = uint64_t{64} << 20;
};

// Any thread; blocks on the disk, except Expect.
class FlightFiles {
 public:
  // Alerts of which it is remembered why they have no recording.
  static constexpr size_t kMissingMax = 10'000;

  // Makes the directory, and finds what was saved before. Files that are no whole recording are
  // counted and named in the log, and kept. Errors: the directory cannot be made or read.
  static absl::StatusOr<std::unique_ptr<FlightFiles>> Open(FlightFilesOptions options);

  // Unavailable: nothing can be saved now, as on a file system that is read-only.
  absl::Status CheckWritable() const;

  // One at a time. Durable when it returns OK. ResourceExhausted: larger than all may be, or the
  // disk is too full. InvalidArgument: no alert, or a robot that is no name. Otherwise Unavailable.
  absl::Status Save(const recording::RecordedOrigin& origin, absl::string_view bytes)
      ABSL_LOCKS_EXCLUDED(mu_);

  // A recording will be saved with that alert; or it could not be. Never wait for the disk.
  void Expect(const std::string& alert) ABSL_LOCKS_EXCLUDED(missing_mu_);
  void Lose(const std::string& alert, absl::string_view why) ABSL_LOCKS_EXCLUDED(missing_mu_);

  // The file that was saved with the alert whose id begins so. NotFound, with the reason if it is
  // one of the kMissingMax newest; FailedPrecondition: it will be there in a few seconds;
  // InvalidArgument: several alerts begin so, or it is no id.
  absl::StatusOr<std::string> Find(absl::string_view alert_prefix) const ABSL_LOCKS_EXCLUDED(mu_);

  // Of all files.
  uint64_t bytes() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct File {
    std::string path;
    uint64_t bytes = 0;
    std::vector<recording::RecordedAlert> alerts;
  };
  // Of one robot, by name, which is by time.
  using Files = std::map<std::string, File>;

  explicit FlightFiles(FlightFilesOptions options) : options_(std::move(options)) {}
  absl::Status Scan() ABSL_LOCKS_EXCLUDED(mu_);
  void Add(const std::string& robot, const std::string& name, File file)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Miss(const std::string& alert, absl::Status why) ABSL_LOCKS_EXCLUDED(missing_mu_);
  // Why there is no recording of an alert whose id begins so.
  absl::Status WhyMissing(absl::string_view alert_prefix) const ABSL_LOCKS_EXCLUDED(missing_mu_);
  // Removes old ones until `bytes` more fit.
  void MakeRoom(uint64_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The same, until they fit on the disk. ResourceExhausted, and none is removed, if they would
  // not.
  absl::Status FreeDisk(uint64_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The oldest of the robot that has most; there is one.
  void RemoveOne() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const FlightFilesOptions options_;
  // Held while files are removed, not while one is written.
  mutable Mutex mu_;
  std::map<std::string, Files> robots_ ABSL_GUARDED_BY(mu_);
  // Path by alert.
  std::map<std::string, std::string, std::less<>> alerts_ ABSL_GUARDED_BY(mu_);
  uint64_t bytes_ ABSL_GUARDED_BY(mu_) = 0;
  // Held for no longer than a look into memory; after mu_ where both are held.
  mutable Mutex missing_mu_;
  // Why there is none, by alert, and those alerts, oldest first.
  std::map<std::string, absl::Status, std::less<>> missing_ ABSL_GUARDED_BY(missing_mu_);
  std::deque<std::string> missing_order_ ABSL_GUARDED_BY(missing_mu_);
};

}  // namespace rips::flight

#endif  // RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_FILES_H_
