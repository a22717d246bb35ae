// Ends streams that the library would keep for ever: those whose peer never says hello, falls
// silent or does not read, and those whose certificate has expired, was revoked or banned.
//
// A certificate ends at its notAfter by the wall clock, or when the time that was left of it at the
// stream's opening has passed by CLOCK_BOOTTIME, whichever is first: a wall clock that is set back
// does not prolong a stream. One that was ahead and is corrected ends a stream too early; the
// peer connects again at once.
#ifndef RIPS_SERVICES_RPC_SESSION_WATCH_H_
#define RIPS_SERVICES_RPC_SESSION_WATCH_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "grpcpp/server_context.h"
#include "grpcpp/support/status.h"
#include "services/base/clock.h"
#include "services/rpc/call_gate.h"
#include "services/rpc/identity.h"
#include "services/rpc/reading_pace.h"
#include "services/rpc/unread_streams.h"
#include "services/runtime/mutex.h"
#include "services/runtime/ticker.h"

namespace rips::rpc {

// Any thread.
class SessionWatch {
 public:
  // From a stream's opening to its hello, by CLOCK_BOOTTIME.
  static constexpr absl::Duration kHelloTimeout = absl::Seconds(5);
  // Between two messages of an agent, which sends a heartbeat at least each second.
  static constexpr absl::Duration kSilence = absl::Seconds(15);

  struct Session {
    std::atomic<bool> greeted = false;
    // When its last message came, by CLOCK_BOOTTIME; 0 = it is none that sends any.
    std::atomic<int64_t> heard_boottime_ns = 0;
    // May be null.
    std::shared_ptr<Connection> connection;
    int64_t opened_boottime_ns = 0;
    // Of the certificate when the stream was opened.
    absl::Duration left;
    Peer peer;
    // Was ended by Look: not a second time.
    std::atomic<bool> closed = false;
    // Ends the stream; may be called after it has ended.
    std::function<void(const grpc::Status&)> close;
    // As above, but after what waits to be written; null = `close`.
    std::function<void(const grpc::Status&)> close_when_sent;
    // Called at each look with CLOCK_BOOTTIME, as StreamOutbound::Reap. May be null.
    std::function<void(int64_t)> reap;
    // Called at each look while `pace` allows it: the stream reads again, if it pauses. Both are
    // null of who is no agent: it is read however dear that is.
    std::function<void()> resume;
    std::shared_ptr<ReadingPace> pace;
  };

  // Looks every `interval`, on a thread of its own; InfiniteDuration = only when asked. `clock` and
  // `gate` are not owned and outlive this; without a gate only times count.
  explicit SessionWatch(const Clock* clock, absl::Duration interval = absl::Milliseconds(500),
                        CallGate* gate = nullptr);

  // Instead of kSilence. Before the first Add.
  void set_silence(absl::Duration silence) ABSL_LOCKS_EXCLUDED(mu_);
  // Called before each look, on its thread: what must be fresh for it. Before the first Add.
  void set_before_look(std::function<void()> before) ABSL_LOCKS_EXCLUDED(mu_);

  // Who is at the other end of a call; see CallGate::Admit.
  absl::StatusOr<Peer> Admit(const grpc::CallbackServerContext& context, Role role) {
    return gate_->Admit(context, role);
  }
  CallGate& gate() { return *gate_; }
  // Watched until the caller drops what is returned.
  std::shared_ptr<Session> Add(Peer peer, std::function<void(const grpc::Status&)> close,
                               std::function<void(const grpc::Status&)> close_when_sent = nullptr,
                               std::function<void(int64_t)> reap = nullptr,
                               std::function<void()> resume = nullptr);
  // As Add, for a StreamOutbound: it gets the limits of its kind, and is cancelled when its peer
  // reads not even its end. Before its first Send.
  template <typename Outbound>
  std::shared_ptr<Session> Guard(StreamKind kind, const Peer& peer,
                                 grpc::CallbackServerContext* context,
                                 const std::shared_ptr<Outbound>& outbound);
  // What peers leave unread. Before the first Guard; not owned, may be null: then each stream has
  // the limits of OutboundLimits.
  void set_unread(UnreadStreams* unread) { unread_ = unread; }
  // A message of the session's stream came, of so many bytes.
  void Heard(Session& session, size_t bytes);
  // A message of an agent's session, which its robot has admitted, took so long to be read. Unless
  // kRead is answered, the stream is to read no more until `resume`.
  ReadingPace::Next OnRead(Session& session, int64_t took_ns);
  bool MayRead(Session& session);
  // Ends what is due now: DEADLINE_EXCEEDED without a hello or a heartbeat, or as CallGate refuses
  // the peer.
  void CheckSessions();
  // Streams that are open and have said hello, by role of their peer.
  std::map<Role, size_t> Open() ABSL_LOCKS_EXCLUDED(mu_);
  // Ends every stream with `status`, after what waits to be written if its owner can do that: the
  // lease that a stopping server grants must not be lost with the stream.
  void CloseAll(const grpc::Status& status);

 private:
  std::vector<std::shared_ptr<Session>> Live() ABSL_LOCKS_EXCLUDED(mu_);

  const Clock* clock_;
  CallGate only_times_;
  CallGate* const gate_;
  UnreadStreams* unread_ = nullptr;
  Mutex mu_;
  std::function<void()> before_look_ ABSL_GUARDED_BY(mu_);
  absl::Duration silence_ ABSL_GUARDED_BY(mu_) = kSilence;
  std::vector<std::weak_ptr<Session>> sessions_ ABSL_GUARDED_BY(mu_);
  ReadingPaces paces_;
  std::optional<Ticker> ticker_;  // last: uses the others
};

template <typename Outbound>
std::shared_ptr<SessionWatch::Session> SessionWatch::Guard(
    StreamKind kind, const Peer& peer, grpc::CallbackServerContext* context,
    const std::shared_ptr<Outbound>& outbound) {
  if (unread_ != nullptr) {
    Outbound::Limit(outbound, unread_->LimitsFor(kind, peer, context->peer()));
  }
  outbound->set_cancel([context] { context->TryCancel(); });
  const bool agent = kind == StreamKind::kSensor || kind == StreamKind::kActuator;
  return Add(
      peer, [outbound](const grpc::Status& status) { outbound->Close(status); },
      agent ? [outbound](const grpc::Status& status) { outbound->CloseWhenSent(status); }
            : std::function<void(const grpc::Status&)>(),
      [outbound](int64_t now_ns) { outbound->Reap(now_ns); },
      agent ? [outbound] { outbound->Resume(); } : std::function<void()>());
}

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_SESSION_WATCH_H_
