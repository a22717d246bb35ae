// A cgroup for each run, so that all of its processes can be killed, wherever they went.
//
// Only cgroup v2 can (cgroup.kill, Linux 5.14). No controller is switched on; limits are set where
// the parent has switched the controller on.
#ifndef RIPS_SERVICES_RUNTIME_RUN_CGROUPS_H_
#define RIPS_SERVICES_RUNTIME_RUN_CGROUPS_H_

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/runtime/unique_fd.h"

namespace rips {

// How long killed processes may take to be gone; one in an uninterruptible call takes longer.
inline constexpr absl::Duration kGoneWait = absl::Seconds(1);

// The directory of a process's cgroup in the cgroup2 mount, from the texts of its
// /proc/self/mountinfo and /proc/self/cgroup. NotFound if there is none.
absl::StatusOr<std::string> FindCgroup(absl::string_view mountinfo, absl::string_view cgroup);

// One run's. One thread at a time.
class RunCgroup {
 public:
  explicit RunCgroup(std::string path) : path_(std::move(path)) {}
  // Removes it if it is empty; else the next RunCgroups at the same place does.
  ~RunCgroup();
  RunCgroup(const RunCgroup&) = delete;
  RunCgroup& operator=(const RunCgroup&) = delete;

  // A process that writes `0` there enters.
  absl::StatusOr<UniqueFd> OpenProcs() const;
  // Processes in it and below. 0 also if that is not known.
  int Count() const;
  bool Populated() const;
  // At most so many tasks and so much memory. False if one of the controllers is not switched on.
  bool Limit(uint64_t tasks, uint64_t memory_bytes) const;
  // SIGKILL to every process in it and below.
  void Kill() const;

 private:
  const std::string path_;
};

// Any thread.
class RunCgroups {
 public:
  // Below `parent`, or below our own cgroup if that is empty, in a directory of this `name`: who
  // gave the same name is our predecessor. What it has left there is killed and removed, and its
  // processes are counted in `*left_behind`. FailedPrecondition or NotFound, saying why, if cgroups
  // cannot be used.
  static absl::StatusOr<std::unique_ptr<RunCgroups>> Open(const std::string& parent,
                                                          absl::string_view name, int* left_behind);
  ~RunCgroups();

  absl::StatusOr<std::unique_ptr<RunCgroup>> Make();
  const std::string& path() const { return path_; }

 private:
  explicit RunCgroups(std::string path) : path_(std::move(path)) {}

  const std::string path_;
  std::atomic<uint64_t> next_ = 1;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_RUN_CGROUPS_H_
