#include "services/rpc/bidi_client.h"

#include <chrono>
#include <random>

#include "absl/strings/str_cat.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/support/channel_arguments.h"
#include "services/base/check.h"
#include "services/rpc/handshake_hint.h"
#include "services/rpc/status_conversion.h"

namespace rips::rpc {
namespace {

void AddHint(const std::string& server, const TlsFiles& files, grpc::Status& status) {
  const std::string hint = HandshakeHint(status.error_message(), server, files);
  if (hint.empty()) return;
  status = grpc::Status(status.error_code(), absl::StrCat(hint, " (", status.error_message(), ")"));
}

// How soon Stop() is noticed while connecting.
constexpr std::chrono::milliseconds kStopSlice(100);
// How long a failed channel may take to say why.
constexpr std::chrono::milliseconds kReasonTimeout(200);
// Of a server to a client, a recording that ripsctl fetches for example: as the server's own.
constexpr int kLookaheadBytes = 256 << 10;

Random SystemRandom() {
  auto generator = std::make_shared<std::mt19937_64>(std::random_device()());
  return [generator] { return std::uniform_real_distribution<double>(0, 1)(*generator); };
}

}  // namespace

std::shared_ptr<grpc::Channel> MakeChannel(
    const std::string& server, const std::shared_ptr<grpc::ChannelCredentials>& credentials,
    const BidiClientOptions& options) {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(kMessageBytesMax);
  arguments.SetMaxSendMessageSize(kMessageBytesMax);
  arguments.SetInt(GRPC_ARG_MAX_METADATA_SIZE, kMetadataBytesMax);
  arguments.SetInt(GRPC_ARG_ENABLE_PER_MESSAGE_DECOMPRESSION, 0);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS,
                   static_cast<int>(absl::ToInt64Milliseconds(options.keepalive_time)));
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS,
                   static_cast<int>(absl::ToInt64Milliseconds(options.keepalive_timeout)));
  // By default pings stop after two on a quiet stream, and a vanished server is never noticed.
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 1000);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS,
                   static_cast<int>(absl::ToInt64Milliseconds(options.connect_timeout)));
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 5000);
  // A server sends little. Pings after its messages, to find a wider window, were a sixth of all
  // that it had to answer.
  arguments.SetInt(GRPC_ARG_HTTP2_BDP_PROBE, 0);
  arguments.SetInt(GRPC_ARG_HTTP2_STREAM_LOOKAHEAD_BYTES, kLookaheadBytes);
  // A channel shares nothing with earlier ones, neither connection nor back-off.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  // Nothing but the configuration decides where to connect.
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  arguments.SetInt(GRPC_ARG_SERVICE_CONFIG_DISABLE_RESOLUTION, 1);
  return grpc::CreateCustomChannel(server, credentials, arguments);
}

BidiClientBase::BidiClientBase(BidiClientOptions options)
    : options_(std::move(options)),
      gate_(
          &clock_,
          [this](const Peer& peer) {
            MutexLock lock(&mu_);
            return own_ == nullptr ? std::nullopt : own_->Revoked(peer);
          },
          nullptr),
      watch_(&clock_, absl::Milliseconds(500), &gate_) {
  watch_.set_before_look([this] {
    std::shared_ptr<const Credentials> own;
    {
      MutexLock lock(&mu_);
      own = own_;
    }
    if (own != nullptr) own->Refresh();
  });
  RIPS_CHECK(!options_.servers.empty(), "a client needs a server");
}

BidiClientBase::~BidiClientBase() {
  RIPS_CHECK(!thread_.joinable(), "the derived class stops the thread");
}

void BidiClientBase::Start() {
  RIPS_CHECK(!thread_.joinable(), "started twice");
  thread_ = std::thread([this] { Run(); });
}

void BidiClientBase::Stop() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    if (context_ != nullptr) context_->TryCancel();
    stop_cond_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

bool BidiClientBase::stopping() {
  MutexLock lock(&mu_);
  return stopping_;
}

bool BidiClientBase::Pause(absl::Duration delay) {
  const int64_t deadline_ns = BoottimeAfter(delay);
  MutexLock lock(&mu_);
  while (!stopping_ && stop_cond_.WaitUntil(lock, deadline_ns)) {
  }
  return !stopping_;
}

void BidiClientBase::Run() {
  ReconnectPacer pacer(options_.backoff, options_.random ? options_.random : SystemRandom());
  size_t server = 0;
  size_t tried = 0;  // servers since the last pause
  while (!stopping()) {
    const SessionEnd end = Attempt(options_.servers[server]);
    if (stopping()) return;
    if (end.received) pacer.MessageReceived();
    const CloseClass close_class =
        ClassifyClose(static_cast<absl::StatusCode>(end.status.error_code()));
    OnDisconnected(end.status, close_class);
    server = (server + 1) % options_.servers.size();
    ++tried;
    if (close_class == CloseClass::kRetry && tried < options_.servers.size()) continue;
    tried = 0;
    if (!Pause(pacer.Next(close_class))) return;
  }
}

BidiClientBase::SessionEnd BidiClientBase::Attempt(const std::string& server) {
  const absl::StatusOr<CredentialsSource::Usable> usable = options_.credentials.Get();
  if (!usable.ok()) {
    return {.status = grpc::Status(grpc::StatusCode::UNAUTHENTICATED,
                                   std::string(usable.status().message()))};
  }
  if (usable->own != nullptr) usable->own->Refresh();
  const std::shared_ptr<grpc::Channel> channel = MakeChannel(server, usable->channel, options_);
  const grpc_connectivity_state state = WaitUntilSettled(*channel);
  grpc::ClientContext context;
  {
    MutexLock lock(&mu_);
    if (stopping_) return {};
    context_ = &context;
    own_ = usable->own;
    ended_because_ = grpc::Status::OK;
    ++attempt_;
  }
  SessionEnd end;
  if (state == GRPC_CHANNEL_READY) {
    end = RunSession(channel, &context);
  } else if (state == GRPC_CHANNEL_TRANSIENT_FAILURE) {
    context.set_deadline(std::chrono::system_clock::now() + kReasonTimeout);
    end.status = FailingCall(channel, &context);
    if (usable->own != nullptr) AddHint(server, usable->own->files(), end.status);
  } else {
    end.status = grpc::Status(
        grpc::StatusCode::DEADLINE_EXCEEDED,
        absl::StrCat("no connection to `", server, "` within ",
                     absl::FormatDuration(options_.connect_timeout), "; is it reachable?"));
  }
  session_.reset();
  MutexLock lock(&mu_);
  context_ = nullptr;
  if (!ended_because_.ok()) end.status = ended_because_;
  return end;
}

void BidiClientBase::WatchServer(grpc::ClientContext* context) {
  const std::shared_ptr<const grpc::AuthContext> auth = context->auth_context();
  absl::StatusOr<Peer> peer = absl::UnauthenticatedError("no certificate");
  if (auth != nullptr) peer = PeerOf(*auth);
  if (!peer.ok()) return;  // without TLS, in tests; the handshake rejects other peers
  if (options_.on_peer) options_.on_peer(*peer);
  uint64_t number = 0;
  {
    MutexLock lock(&mu_);
    number = attempt_;
  }
  session_ = watch_.Add(*std::move(peer), [this, number](const grpc::Status& status) {
    EndAttempt(number,
               grpc::Status(status.error_code(), "the policy server: " + status.error_message()));
  });
  session_->greeted = true;
}

void BidiClientBase::EndAttempt(uint64_t number, const grpc::Status& status) {
  MutexLock lock(&mu_);
  if (context_ == nullptr || attempt_ != number) return;
  ended_because_ = status;
  context_->TryCancel();
}

grpc_connectivity_state BidiClientBase::WaitUntilSettled(grpc::Channel& channel) {
  const int64_t deadline_ns = BoottimeAfter(options_.connect_timeout);
  while (true) {
    const grpc_connectivity_state state = channel.GetState(/*try_to_connect=*/true);
    if (state == GRPC_CHANNEL_READY || state == GRPC_CHANNEL_TRANSIENT_FAILURE ||
        BoottimeNow() >= deadline_ns || stopping()) {
      return state;
    }
    channel.WaitForStateChange(state, std::chrono::system_clock::now() + kStopSlice);
  }
}

}  // namespace rips::rpc
