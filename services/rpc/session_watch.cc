#include "services/rpc/session_watch.h"

#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::rpc {

SessionWatch::SessionWatch(const Clock* clock, absl::Duration interval)
    : clock_(clock), interval_(interval), thread_([this] { Run(); }) {}

SessionWatch::~SessionWatch() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    stop_cond_.NotifyAll();
  }
  thread_.join();
}

std::shared_ptr<SessionWatch::Session> SessionWatch::Add(
    absl::Time not_after, std::function<void(const grpc::Status&)> close) {
  auto session = std::make_shared<Session>();
  session->opened_boottime_ns = clock_->Now().boottime_ns;
  session->not_after = not_after;
  session->close = std::move(close);
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

void SessionWatch::CloseAll(const grpc::Status& status) {
  for (const auto& session : Live()) session->close(status);
}

void SessionWatch::Look() {
  const Instant now = clock_->Now();
  for (const auto& session : Live()) {
    const int64_t open_ns = now.boottime_ns - session->opened_boottime_ns;
    if (!session->greeted && open_ns > absl::ToInt64Nanoseconds(kHelloTimeout)) {
      session->close(
          grpc::Status(grpc::StatusCode::DEADLINE_EXCEEDED,
                       absl::StrCat("no hello within ", absl::FormatDuration(kHelloTimeout))));
    } else if (absl::FromUnixNanos(now.unix_ns) > session->not_after) {
      session->close(
          grpc::Status(grpc::StatusCode::UNAUTHENTICATED, "the certificate has expired"));
    }
  }
}

void SessionWatch::Run() {
  while (true) {
    {
      MutexLock lock(&mu_);
      while (!stopping_ && stop_cond_.WaitFor(lock, interval_)) {
      }
      if (stopping_) return;
    }
    Look();
  }
}

}  // namespace rips::rpc
