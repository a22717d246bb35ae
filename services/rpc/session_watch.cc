#include "services/rpc/session_watch.h"

#include <utility>

#include "absl/time/clock.h"

namespace rips::rpc {

SessionWatch::SessionWatch(absl::Duration hello_timeout, absl::Duration interval)
    : hello_timeout_(hello_timeout), interval_(interval), thread_([this] { Run(); }) {}

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
  session->opened = absl::Now();
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

void SessionWatch::Run() {
  while (true) {
    {
      MutexLock lock(&mu_);
      if (!stopping_) stop_cond_.WaitFor(lock, interval_);
      if (stopping_) return;
    }
    const absl::Time now = absl::Now();
    for (const auto& session : Live()) {
      if (!session->greeted && now - session->opened > hello_timeout_) {
        session->close(grpc::Status(grpc::StatusCode::DEADLINE_EXCEEDED, "no hello in time"));
      } else if (now > session->not_after) {
        session->close(
            grpc::Status(grpc::StatusCode::UNAUTHENTICATED, "the certificate has expired"));
      }
    }
  }
}

}  // namespace rips::rpc
