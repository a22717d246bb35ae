#include "sensor_agent/spool/spool_thread.h"

#include <utility>

#include "services/base/overloaded.h"
#include "services/runtime/log.h"

namespace rips::sensor {

SpoolResult DoJob(Spool& spool, const SpoolJob& job) {
  return std::visit(Overloaded{[&](const SpoolRelease& release) -> SpoolResult {
                                 spool.Release(release.record);
                                 return SpoolReleased{.disk_bytes = spool.bytes()};
                               },
                               [&](const SpoolRead& read) -> SpoolResult {
                                 return SpoolReadBack{.stream = read.record.stream,
                                                      .first_sequence = read.record.first_sequence,
                                                      .bytes = spool.Read(read.record)};
                               },
                               [&](const SpoolWrite& write) -> SpoolResult {
                                 absl::StatusOr<SpoolRecord> record = spool.Append(
                                     write.stream, {.first_sequence = write.first_sequence,
                                                    .count = write.count,
                                                    .oldest_ns = write.oldest_ns,
                                                    .payload = *write.bytes});
                                 return SpoolWritten{.stream = write.stream,
                                                     .first_sequence = write.first_sequence,
                                                     .record = std::move(record),
                                                     .disk_bytes = spool.bytes()};
                               }},
                    job);
}

SpoolThread::SpoolThread(std::unique_ptr<Spool> spool, std::function<void(SpoolResult)> on_result)
    : spool_(std::move(spool)), on_result_(std::move(on_result)) {
  thread_ = std::thread([this] { Run(); });
}

SpoolThread::~SpoolThread() { Stop(/*clean=*/false); }

void SpoolThread::Push(SpoolJob job) {
  MutexLock lock(&mu_);
  jobs_.push_back(std::move(job));
  work_.NotifyOne();
}

void SpoolThread::Stop(bool clean) {
  if (!thread_.joinable()) return;
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    work_.NotifyOne();
  }
  thread_.join();
  if (!clean) return;
  if (absl::Status marked = spool_->MarkClean(); !marked.ok()) {
    LogError("spool not closed cleanly", {{"error", marked.message()}});
  }
}

void SpoolThread::Run() {
  while (true) {
    std::deque<SpoolJob> jobs;
    {
      MutexLock lock(&mu_);
      while (jobs_.empty() && !stopping_) work_.Wait(lock);
      if (jobs_.empty()) return;
      jobs.swap(jobs_);
    }
    for (const SpoolJob& each : jobs) on_result_(DoJob(*spool_, each));
  }
}

}  // namespace rips::sensor
