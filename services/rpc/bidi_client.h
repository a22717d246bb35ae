// An agent's stream to the policy server: connects, says hello, sends from a bounded queue, hands
// over what comes in, and does so again after every end until stopped.
//
// The server's certificate is judged in the handshake, and while the stream lives: one that expires
// or is revoked ends the stream with UNAUTHENTICATED.
//
// Threads: one session thread connects, calls the callbacks and reads; one writer thread per
// session writes; one watches the server's certificate. The synchronous API is used because the
// callback API may sleep up to 100 ms after
// an idle second. Each attempt has a channel of its own, so no back-off but ours is at work.
#ifndef RIPS_SERVICES_RPC_BIDI_CLIENT_H_
#define RIPS_SERVICES_RPC_BIDI_CLIENT_H_

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "grpcpp/channel.h"
#include "grpcpp/client_context.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/support/sync_stream.h"
#include "services/rpc/backoff.h"
#include "services/rpc/credentials.h"
#include "services/rpc/outgoing_queue.h"
#include "services/rpc/session_watch.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::rpc {

struct BidiClientOptions {
  // `HOST:PORT`, at least one. Tried in turn; the back-off delay comes after each full round.
  std::vector<std::string> servers;
  // While they cannot be used, each attempt ends with UNAUTHENTICATED and the reason.
  CredentialsSource credentials;
  // Called on the session thread with the server's certificate when its first message has come.
  std::function<void(const Peer&)> on_peer;
  BackoffPolicy backoff = SensorBackoff();
  Random random;                 // empty = a generator seeded by the system
  size_t queue_capacity = 1024;  // messages waiting to be written
  absl::Duration connect_timeout = absl::Seconds(5);
  // HTTP/2 pings find a peer that vanished within the sum of both.
  absl::Duration keepalive_time = absl::Seconds(5);
  absl::Duration keepalive_timeout = absl::Seconds(5);
};

// One gRPC message, either way: a recorded payload of 4 MiB and what is said of it.
inline constexpr int kMessageBytesMax = (4 << 20) + (256 << 10);
inline constexpr int kMetadataBytesMax = 8 << 10;

// A channel with this project's keepalive and limits, connecting to one server. For unary clients
// (ripsctl) as well; they set a deadline on every call.
std::shared_ptr<grpc::Channel> MakeChannel(
    const std::string& server, const std::shared_ptr<grpc::ChannelCredentials>& credentials,
    const BidiClientOptions& options = {});

// What does not depend on the message types.
class BidiClientBase {
 public:
  // Runs sessions until stopped, with pauses, on a thread of its own. Once.
  void Start();
  // Cancels the stream, joins the threads; no callback runs afterwards. Idempotent; not from a
  // callback.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 protected:
  struct SessionEnd {
    grpc::Status status;
    bool received = false;  // at least one message came in
  };

  explicit BidiClientBase(BidiClientOptions options);
  virtual ~BidiClientBase();

  // Runs one stream to its end.
  virtual SessionEnd RunSession(const std::shared_ptr<grpc::Channel>& channel,
                                grpc::ClientContext* context) = 0;
  // Starts a stream on a channel that could not connect, for the status that says why.
  virtual grpc::Status FailingCall(const std::shared_ptr<grpc::Channel>& channel,
                                   grpc::ClientContext* context) = 0;
  // The stream's first message is here: watches the certificate it came under from now on.
  void WatchServer(grpc::ClientContext* context) ABSL_LOCKS_EXCLUDED(mu_);
  virtual void OnDisconnected(const grpc::Status& status, CloseClass close_class) = 0;

  const BidiClientOptions options_;

 private:
  void Run();
  SessionEnd Attempt(const std::string& server);
  // READY or TRANSIENT_FAILURE as soon as that is known; another state after `connect_timeout` or
  // Stop().
  grpc_connectivity_state WaitUntilSettled(grpc::Channel& channel);
  bool stopping() ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the attempt of this number, if it still runs.
  void EndAttempt(uint64_t number, const grpc::Status& status) ABSL_LOCKS_EXCLUDED(mu_);
  // False if stopped meanwhile.
  bool Pause(absl::Duration delay) ABSL_LOCKS_EXCLUDED(mu_);

  Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  grpc::ClientContext* context_ ABSL_GUARDED_BY(mu_) = nullptr;  // of the running attempt
  uint64_t attempt_ ABSL_GUARDED_BY(mu_) = 0;
  std::shared_ptr<const Credentials> own_ ABSL_GUARDED_BY(mu_);  // of the running attempt
  grpc::Status ended_because_ ABSL_GUARDED_BY(mu_);              // by us; OK = it was not
  const RealClock clock_;
  CallGate gate_;
  SessionWatch watch_;
  std::shared_ptr<SessionWatch::Session> session_;  // the session thread's
  std::thread thread_;
};

template <typename Out, typename In>
class BidiClient final : public BidiClientBase {
 public:
  using Stream = grpc::ClientReaderWriterInterface<Out, In>;
  // All on the session thread, never two at once.
  struct Callbacks {
    // [](const auto& channel, auto* context) { return S::NewStub(channel)->Observe(context); }
    std::function<std::unique_ptr<Stream>(const std::shared_ptr<grpc::Channel>&,
                                          grpc::ClientContext*)>
        start_stream;
    // Connected: gives the first message. Send() works from its return on, and what it takes is
    // written after this message. The server may still refuse the stream.
    std::function<Out()> on_connected;
    std::function<void(In)> on_message;
    // After every failed or ended attempt, also one that never connected; not after Stop().
    std::function<void(const grpc::Status&, CloseClass)> on_disconnected;
    // All that SendBulk took is written. On the writer thread, without locks held; return soon. May
    // be empty.
    std::function<void()> on_bulk_written = nullptr;
  };

  BidiClient(BidiClientOptions options, Callbacks callbacks)
      : BidiClientBase(std::move(options)), callbacks_(std::move(callbacks)) {}
  ~BidiClient() override { Stop(); }

  // Queues `message` for the running session. False, and nothing is kept, when not connected or the
  // queue is full. A message taken may still be lost with its session, unsent: what must arrive is
  // kept by the caller until acknowledged. Any thread; never blocks.
  bool Send(Out message) ABSL_LOCKS_EXCLUDED(queue_mu_) {
    const std::shared_ptr<Queue> queue = CurrentQueue();
    return queue != nullptr && queue->Push(std::move(message));
  }
  // Send would take a message now; stays so until Send is called or the session ends.
  bool HasRoom() const ABSL_LOCKS_EXCLUDED(queue_mu_) {
    const std::shared_ptr<Queue> queue = CurrentQueue();
    return queue != nullptr && queue->HasRoom();
  }
  // The same as Send for a message that everything else goes before, also what Send takes later.
  bool SendBulk(Out message) ABSL_LOCKS_EXCLUDED(queue_mu_) {
    const std::shared_ptr<Queue> queue = CurrentQueue();
    return queue != nullptr && queue->PushBulk(std::move(message));
  }
  // Messages that SendBulk took in this session and that are not written yet.
  size_t bulk_unwritten() const ABSL_LOCKS_EXCLUDED(queue_mu_) {
    const std::shared_ptr<Queue> queue = CurrentQueue();
    return queue == nullptr ? 0 : queue->bulk_unwritten();
  }
  // Takes those of them back of which nothing is written.
  std::vector<Out> RecallBulk() ABSL_LOCKS_EXCLUDED(queue_mu_) {
    const std::shared_ptr<Queue> queue = CurrentQueue();
    return queue == nullptr ? std::vector<Out>() : queue->RecallBulk();
  }

  bool connected() const ABSL_LOCKS_EXCLUDED(queue_mu_) {
    MutexLock lock(&queue_mu_);
    return queue_ != nullptr;
  }

 private:
  using Queue = OutgoingQueue<Out>;

  std::shared_ptr<Queue> CurrentQueue() const ABSL_LOCKS_EXCLUDED(queue_mu_) {
    MutexLock lock(&queue_mu_);
    return queue_;
  }

  SessionEnd RunSession(const std::shared_ptr<grpc::Channel>& channel,
                        grpc::ClientContext* context) override {
    SessionEnd end;
    const std::unique_ptr<Stream> stream = callbacks_.start_stream(channel, context);
    Out first = callbacks_.on_connected();
    const auto queue = std::make_shared<Queue>(options_.queue_capacity);
    SetQueue(queue);
    std::thread writer([&] { WriteAll(*stream, *queue, std::move(first)); });
    for (In message; stream->Read(&message); message = In()) {
      if (!end.received) WatchServer(context);
      end.received = true;
      callbacks_.on_message(std::move(message));
    }
    SetQueue(nullptr);
    queue->Close();
    writer.join();
    end.status = stream->Finish();
    return end;
  }

  grpc::Status FailingCall(const std::shared_ptr<grpc::Channel>& channel,
                           grpc::ClientContext* context) override {
    return callbacks_.start_stream(channel, context)->Finish();
  }

  // Ends when the queue is closed or the stream broken (then Read fails, too).
  void WriteAll(Stream& stream, Queue& queue, Out first) const {
    if (!stream.Write(first)) return;
    while (std::optional<Out> message = queue.Pop()) {
      if (!stream.Write(*message)) return;
      if (queue.Written() && callbacks_.on_bulk_written) callbacks_.on_bulk_written();
    }
  }

  void OnDisconnected(const grpc::Status& status, CloseClass close_class) override {
    callbacks_.on_disconnected(status, close_class);
  }

  void SetQueue(std::shared_ptr<Queue> queue) ABSL_LOCKS_EXCLUDED(queue_mu_) {
    MutexLock lock(&queue_mu_);
    queue_ = std::move(queue);
  }

  const Callbacks callbacks_;
  mutable Mutex queue_mu_;
  std::shared_ptr<Queue> queue_ ABSL_GUARDED_BY(queue_mu_);  // nullptr while not connected
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_BIDI_CLIENT_H_
