// The writing half of a server's stream: a bounded queue in front of a gRPC reactor that may hold
// one write at a time, safe to use from any thread and after the reactor is gone.
//
// | what a peer that does not read makes wait            | what happens                          |
// |------------------------------------------------------|---------------------------------------|
// | `limits.messages`, or `limits.bytes` of memory (one  | the call ends, RESOURCE_EXHAUSTED;    |
// | message excepted)                                    | what waited is dropped                |
// | its part of `limits.budget`, when that is used up    | the same                              |
// | the end of the call, for kEndPatience                | the call is cancelled (Reap)          |
#ifndef RIPS_SERVICES_RPC_STREAM_OUTBOUND_H_
#define RIPS_SERVICES_RPC_STREAM_OUTBOUND_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "grpcpp/support/status.h"
#include "services/rpc/outbound_limits.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

// `Reactor` has StartWrite(const Out*) and Finish(grpc::Status), and Read() if it ever pauses. Any
// thread; never blocks.
template <typename Reactor, typename Out>
class StreamOutbound {
 public:
  // From the end of a call to its cancellation, if the peer does not even read that.
  static constexpr absl::Duration kEndPatience = absl::Seconds(5);

  explicit StreamOutbound(Reactor* reactor) : reactor_(reactor) {}

  // Before the first Send.
  static void Limit(const std::shared_ptr<StreamOutbound>& self, OutboundLimits limits) {
    self->limits_ = std::move(limits);
    if (self->limits_.budget == nullptr) return;
    self->share_ = self->limits_.budget->Join(self->limits_.owner,
                                              [weak = std::weak_ptr<StreamOutbound>(self)] {
                                                if (const auto stream = weak.lock())
                                                  stream->Exceed(stream->BudgetText());
                                              });
  }
  // How Reap ends the call. Before the first Send; called at most until Detach.
  void set_cancel(std::function<void()> cancel) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    cancel_ = std::move(cancel);
  }

  // False if the call is ending. A limit that is exceeded ends it.
  bool Send(Out message) ABSL_LOCKS_EXCLUDED(mu_) {
    if (!open()) return false;
    const size_t bytes = BytesOf(message);
    if (limits_.budget != nullptr && !limits_.budget->Reserve(share_, bytes)) {
      Exceed(BudgetText());
      return false;
    }
    std::string problem;
    {
      MutexLock lock(&mu_);
      const bool open = reactor_ != nullptr && !finishing_ && !last_words_.has_value();
      if (open) problem = ProblemLocked(bytes);
      if (open && problem.empty()) {
        outgoing_bytes_ += bytes;
        outgoing_.push_back({std::move(message), bytes});
        if (!writing_) WriteNextLocked();
        return true;
      }
    }
    if (limits_.budget != nullptr) limits_.budget->Release(share_, bytes);
    if (!problem.empty()) Exceed(problem);
    return false;
  }

  bool open() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return reactor_ != nullptr && !finishing_ && !last_words_.has_value();
  }
  // Its end is on its way to the peer, or gone: nothing can be said any more.
  bool ended() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return reactor_ == nullptr || finishing_;
  }

  // Messages waiting, the one being written included.
  size_t waiting() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return outgoing_.size();
  }

  // Their size in memory.
  size_t waiting_bytes() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return outgoing_bytes_;
  }

  // Ends the call and drops what waits. Only the first one counts. A peer that does not read learns
  // it, and OnDone comes, only after it has read what the network holds, or when it is gone, or
  // when Reap loses patience.
  void Close(grpc::Status status) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    FinishLocked(std::move(status));
  }

  // Takes no more messages, writes those that wait, and ends the call with `status` then. A peer
  // that does not read delays the end without limit: its owner must Close() such a call in the end,
  // as a server's shutdown does after its grace. The first status counts, of whichever kind.
  void CloseWhenSent(grpc::Status status) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (reactor_ == nullptr || finishing_ || last_words_.has_value()) return;
    last_words_ = std::move(status);
    if (outgoing_.empty()) FinishLocked({});
  }

  // To be called from time to time, CLOCK_BOOTTIME: cancels a call that has ended and whose peer
  // does not read that. What the library holds of it would stay as long as the connection.
  void Reap(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (reactor_ == nullptr || !finishing_ || cancel_ == nullptr) return;
    if (ended_ns_ == 0) {
      ended_ns_ = now_ns;
    } else if (now_ns - ended_ns_ >= absl::ToInt64Nanoseconds(kEndPatience)) {
      std::exchange(cancel_, nullptr)();
    }
  }

  // The reactor reads no more until Resume, which may come from any thread.
  void Pause() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    paused_ = true;
  }
  // No effect unless it pauses.
  void Resume() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if constexpr (requires { reactor_->Read(); }) {
      if (reactor_ != nullptr && !finishing_ && std::exchange(paused_, false)) reactor_->Read();
    }
  }

  // From the reactor's OnWriteDone.
  void OnWritten(bool ok) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    writing_ = false;
    ReleaseLocked(outgoing_.front().bytes);
    outgoing_.pop_front();  // only now may the message die
    if (!ok) return FinishLocked(grpc::Status(grpc::StatusCode::UNAVAILABLE, "write failed"));
    if (finishing_) return;
    if (!outgoing_.empty()) return WriteNextLocked();
    if (last_words_.has_value()) FinishLocked({});
  }

  // From the reactor's OnDone, before it is deleted.
  void Detach() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    reactor_ = nullptr;
    cancel_ = nullptr;
    if (limits_.budget != nullptr) limits_.budget->Leave(share_);
  }

 private:
  struct Waiting {
    Out message;
    size_t bytes = 0;
  };

  static size_t BytesOf(const Out& message) {
    if constexpr (requires { message.SpaceUsedLong(); }) {
      return message.SpaceUsedLong();
    } else if constexpr (requires { message.ByteSizeLong(); }) {
      return message.ByteSizeLong();
    } else {
      return 0;
    }
  }
  std::string BudgetText() const {
    return absl::StrCat("streams of this kind that are not read hold ",
                        limits_.budget->bytes_max() >> 20, " MiB, and this peer most of it");
  }
  // Empty if a message of so many bytes may wait.
  std::string ProblemLocked(size_t bytes) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (outgoing_.size() >= limits_.messages) {
      return absl::StrCat(limits_.messages, " messages wait");
    }
    if (!outgoing_.empty() && outgoing_bytes_ + bytes > limits_.bytes) {
      return absl::StrCat("more than ", limits_.bytes >> 10, " KiB wait");
    }
    return "";
  }
  void Exceed(const std::string& why) ABSL_LOCKS_EXCLUDED(mu_) {
    {
      MutexLock lock(&mu_);
      if (reactor_ == nullptr || finishing_) return;
      FinishLocked(grpc::Status(grpc::StatusCode::RESOURCE_EXHAUSTED,
                                absl::StrCat("the peer does not read what it is sent: ", why)));
    }
    if (limits_.exceeded != nullptr) limits_.exceeded(why);
  }
  void ReleaseLocked(size_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    outgoing_bytes_ -= bytes;
    if (limits_.budget != nullptr) limits_.budget->Release(share_, bytes);
  }
  void WriteNextLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    writing_ = true;
    reactor_->StartWrite(&outgoing_.front().message);
  }
  void FinishLocked(grpc::Status status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (reactor_ == nullptr || finishing_) return;
    finishing_ = true;
    while (outgoing_.size() > (writing_ ? 1 : 0)) {
      ReleaseLocked(outgoing_.back().bytes);
      outgoing_.pop_back();
    }
    reactor_->Finish(last_words_.has_value() ? *std::move(last_words_) : std::move(status));
  }

  OutboundLimits limits_;  // constant after Limit
  uint64_t share_ = 0;     // as well
  mutable Mutex mu_;
  std::function<void()> cancel_ ABSL_GUARDED_BY(mu_);
  Reactor* reactor_ ABSL_GUARDED_BY(mu_);  // Not owned; null once it is done.
  // The front one is being written while writing_, and stays where it is: only others are added
  // and erased, at the back.
  std::deque<Waiting> outgoing_ ABSL_GUARDED_BY(mu_);
  size_t outgoing_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  bool writing_ ABSL_GUARDED_BY(mu_) = false;
  bool finishing_ ABSL_GUARDED_BY(mu_) = false;
  bool paused_ ABSL_GUARDED_BY(mu_) = false;
  // When Reap saw first that the call had ended; 0 = it has not.
  int64_t ended_ns_ ABSL_GUARDED_BY(mu_) = 0;
  // What the call ends with once nothing waits.
  std::optional<grpc::Status> last_words_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_STREAM_OUTBOUND_H_
