#include "services/rpc/session_watch.h"

#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/rpc/status_conversion.h"

namespace rips::rpc {

SessionWatch::SessionWatch(const Clock* clock, absl::Duration interval, CallGate* gate)
    : clock_(clock),
      only_times_(clock, nullptr, nullptr),
      gate_(gate == nullptr ? &only_times_ : gate) {
  if (interval == absl::InfiniteDuration()) return;
  ticker_.emplace(interval, [this, interval] {
    CheckSessions();
    return interval;
  });
}

void SessionWatch::set_silence(absl::Duration silence) {
  MutexLock lock(&mu_);
  silence_ = silence;
}

void SessionWatch::set_before_look(std::function<void()> before) {
  MutexLock lock(&mu_);
  before_look_ = std::move(before);
}

std::shared_ptr<SessionWatch::Session> SessionWatch::Add(
    Peer peer, std::function<void(const grpc::Status&)> close,
    std::function<void(const grpc::Status&)> close_when_sent, std::function<void(int64_t)> reap,
    std::function<void()> resume) {
  auto session = std::make_shared<Session>();
  const Instant now = clock_->Now();
  session->opened_boottime_ns = now.boottime_ns;
  session->left = peer.not_after - absl::FromUnixNanos(now.unix_ns);
  session->peer = std::move(peer);
  session->close_when_sent = close_when_sent != nullptr ? std::move(close_when_sent) : close;
  session->close = std::move(close);
  session->reap = std::move(reap);
  if (resume != nullptr) {
    session->resume = std::move(resume);
    session->pace = paces_.Of(ToString(session->peer.identity), now.boottime_ns);
  }
  MutexLock lock(&mu_);
  sessions_.push_back(session);
  return session;
}

std::vector<std::shared_ptr<SessionWatch::Session>> SessionWatch::Live() {
  std::vector<std::shared_ptr<Session>> live;
  MutexLock lock(&mu_);
  size_t kept = 0;
  for (std::weak_ptr<Session>& weak : sessions_) {
    std::shared_ptr<Session> session = weak.lock();
    if (session == nullptr) continue;
    live.push_back(std::move(session));
    sessions_[kept++] = weak;
  }
  sessions_.resize(kept);
  return live;
}

std::map<Role, size_t> SessionWatch::Open() {
  std::map<Role, size_t> open;
  for (const auto& session : Live()) {
    if (session->greeted && !session->closed) ++open[session->peer.identity.role];
  }
  return open;
}

void SessionWatch::CloseAll(const grpc::Status& status) {
  for (const auto& session : Live()) session->close_when_sent(status);
}

void SessionWatch::Heard(Session& session, size_t bytes) {
  session.heard_boottime_ns = clock_->Now().boottime_ns;
  if (session.connection != nullptr) session.connection->OnMessage(bytes);
}

ReadingPace::Next SessionWatch::OnRead(Session& session, int64_t took_ns) {
  if (session.pace == nullptr) return ReadingPace::Next::kRead;
  return session.pace->OnRead(took_ns, clock_->Now().boottime_ns);
}

bool SessionWatch::MayRead(Session& session) {
  return session.pace == nullptr || session.pace->MayRead(clock_->Now().boottime_ns);
}

void SessionWatch::CheckSessions() {
  std::function<void()> before;
  absl::Duration silence;
  {
    MutexLock lock(&mu_);
    before = before_look_;
    silence = silence_;
  }
  if (before) before();
  const int64_t now_ns = clock_->Now().boottime_ns;
  paces_.Prune(now_ns);
  for (const auto& session : Live()) {
    if (session->reap != nullptr) session->reap(now_ns);
    if (session->closed) continue;
    if (session->resume != nullptr && session->pace->MayRead(now_ns)) session->resume();
    const absl::Duration open = absl::Nanoseconds(now_ns - session->opened_boottime_ns);
    std::optional<Refusal> refusal = gate_->Against(session->peer);
    if (!refusal && open > session->left) {
      refusal = Refusal{"expired", absl::UnauthenticatedError("the certificate has expired")};
    }
    if (refusal) {
      session->closed = true;
      const std::string address =
          session->connection == nullptr ? "" : session->connection->source().peer;
      session->close(ToGrpc(gate_->Refuse(*refusal, &session->peer, address)));
    } else if (!session->greeted && open > kHelloTimeout) {
      session->closed = true;
      session->close(
          grpc::Status(grpc::StatusCode::DEADLINE_EXCEEDED,
                       absl::StrCat("no hello within ", absl::FormatDuration(kHelloTimeout))));
    } else if (const int64_t heard_ns = session->heard_boottime_ns;
               heard_ns != 0 && absl::Nanoseconds(now_ns - heard_ns) > silence) {
      session->closed = true;
      session->close(
          grpc::Status(grpc::StatusCode::DEADLINE_EXCEEDED,
                       absl::StrCat("no heartbeat within ", absl::FormatDuration(silence))));
    }
  }
}

}  // namespace rips::rpc
