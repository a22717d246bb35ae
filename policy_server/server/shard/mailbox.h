// One stream's way onto its robot's thread, with a bound on what it may have waiting there: a peer
// that floods is cut off before it can fill a queue that other robots share.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_MAILBOX_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_MAILBOX_H_

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/shard/pipeline.h"

namespace rips::pipeline {

struct MailboxLimits {
  size_t tasks = 1'024;
  // Serialized size of the messages behind the tasks.
  size_t bytes = 16 << 20;
};

// Any thread.
class Mailbox {
 public:
  // `pipeline` is not owned and outlives this.
  Mailbox(Pipeline* pipeline, std::string robot, MailboxLimits limits = {})
      : pipeline_(pipeline), robot_(std::move(robot)), limits_(limits) {}

  // As Pipeline::Post; ResourceExhausted also when this peer has too much waiting, which is
  // reported. PermissionDenied for a robot that is not in the inventory.
  absl::Status Post(Lane lane, size_t bytes, std::function<void(Robot&)> task) {
    return Post(QueueOf(lane), bytes, std::move(task));
  }
  absl::Status Post(Queue queue, size_t bytes, std::function<void(Robot&)> task) {
    if (waiting_->tasks.fetch_add(1) >= limits_.tasks ||
        waiting_->bytes.fetch_add(bytes) + bytes > limits_.bytes) {
      pipeline_->ReportRefused(robot_);
      return absl::ResourceExhaustedError(absl::StrCat("more than ", limits_.tasks, " messages or ",
                                                       limits_.bytes,
                                                       " bytes of this stream wait to be judged"));
    }
    const absl::Status posted = pipeline_->Post(
        robot_, queue, [waiting = waiting_, bytes, task = std::move(task)](Robot& r) {
          task(r);
          --waiting->tasks;
          waiting->bytes -= bytes;
        });
    return absl::IsNotFound(posted) ? absl::PermissionDeniedError(posted.message()) : posted;
  }

  const std::string& robot() const { return robot_; }

 private:
  struct Waiting {
    std::atomic<size_t> tasks = 0;
    std::atomic<size_t> bytes = 0;
  };
  Pipeline* pipeline_;
  std::string robot_;
  MailboxLimits limits_;
  // After a refusal the stream is closed: what it counted does not matter any more.
  std::shared_ptr<Waiting> waiting_ = std::make_shared<Waiting>();
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_MAILBOX_H_
