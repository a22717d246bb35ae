// The writing half of a server's stream: a bounded queue in front of a gRPC reactor that may hold
// one write at a time, safe to use from any thread and after the reactor is gone.
#ifndef RIPS_SERVICES_RPC_STREAM_OUTBOUND_H_
#define RIPS_SERVICES_RPC_STREAM_OUTBOUND_H_

#include <cstddef>
#include <deque>
#include <optional>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "grpcpp/support/status.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

// `Reactor` has StartWrite(const Out*) and Finish(grpc::Status). Any thread; never blocks.
template <typename Reactor, typename Out>
class StreamOutbound {
 public:
  // Messages waiting to be written, the one being written included; a peer that does not read is
  // cut off.
  static constexpr size_t kOutgoingMax = 4'096;
  // Their serialized size, one message excepted.
  static constexpr size_t kOutgoingBytesMax = size_t{64} << 20;

  explicit StreamOutbound(Reactor* reactor) : reactor_(reactor) {}

  // False if the call is ending. A full queue ends it with RESOURCE_EXHAUSTED.
  bool Send(Out message) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (reactor_ == nullptr || finishing_ || last_words_.has_value()) return false;
    const size_t bytes = BytesOf(message);
    if (outgoing_.size() >= kOutgoingMax ||
        (!outgoing_.empty() && outgoing_bytes_ + bytes > kOutgoingBytesMax)) {
      FinishLocked(grpc::Status(grpc::StatusCode::RESOURCE_EXHAUSTED,
                                "the peer does not read what it is sent"));
      return false;
    }
    outgoing_bytes_ += bytes;
    outgoing_.push_back(std::move(message));
    if (!writing_) WriteNextLocked();
    return true;
  }

  bool open() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return reactor_ != nullptr && !finishing_ && !last_words_.has_value();
  }

  // Messages waiting, the one being written included.
  size_t waiting() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return outgoing_.size();
  }

  // Ends the call and drops what waits. Only the first one counts. A peer that does not read learns
  // it, and OnDone comes, only after it has read what the network holds, or when it is gone.
  void Close(grpc::Status status) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    FinishLocked(std::move(status));
  }

  // Takes no more messages, writes those that wait, and ends the call with `status` then. A peer
  // that does not read delays the end without limit: somebody must Close() such a call in the end,
  // as a server's shutdown does after its grace. The first status counts, of whichever kind.
  void CloseWhenSent(grpc::Status status) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (reactor_ == nullptr || finishing_ || last_words_.has_value()) return;
    last_words_ = std::move(status);
    if (outgoing_.empty()) FinishLocked({});
  }

  // From the reactor's OnWriteDone.
  void OnWritten(bool ok) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    writing_ = false;
    outgoing_bytes_ -= BytesOf(outgoing_.front());
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
  }

 private:
  static size_t BytesOf(const Out& message) {
    if constexpr (requires { message.ByteSizeLong(); }) {
      return message.ByteSizeLong();
    } else {
      return 0;
    }
  }
  void WriteNextLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    writing_ = true;
    reactor_->StartWrite(&outgoing_.front());
  }
  void FinishLocked(grpc::Status status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (reactor_ == nullptr || finishing_) return;
    finishing_ = true;
    outgoing_.erase(outgoing_.begin() + (writing_ ? 1 : 0), outgoing_.end());
    outgoing_bytes_ = writing_ ? BytesOf(outgoing_.front()) : 0;
    reactor_->Finish(last_words_.has_value() ? *std::move(last_words_) : std::move(status));
  }

  mutable Mutex mu_;
  Reactor* reactor_ ABSL_GUARDED_BY(mu_);  // Not owned; null once it is done.
  // The front one is being written while writing_, and stays where it is: only others are added
  // and erased, at the back.
  std::deque<Out> outgoing_ ABSL_GUARDED_BY(mu_);
  size_t outgoing_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  bool writing_ ABSL_GUARDED_BY(mu_) = false;
  bool finishing_ ABSL_GUARDED_BY(mu_) = false;
  // What the call ends with once nothing waits.
  std::optional<grpc::Status> last_words_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_STREAM_OUTBOUND_H_
