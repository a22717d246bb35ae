#include "services/rpc/connection.h"

#include <linux/tcp.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include "services/base/status_macros.h"

namespace rips::rpc {
namespace {

// Of tcp_info (net/tcp_states.h of the kernel).
constexpr uint8_t kEstablished = 1;
constexpr uint8_t kCloseWait = 8;
// No ClientHello is shorter.
constexpr uint64_t kClientHelloBytes = 64;

}  // namespace

void Connection::OnMessage(size_t bytes) {
  MutexLock lock(&mu_);
  budget_.OnMessage(bytes);
}

void Connection::Exceed(Excess why) {
  MutexLock lock(&mu_);
  budget_.Exceed(why);
}

void Connection::Identify(const std::string& certificate, const std::string& account, bool agent) {
  MutexLock lock(&mu_);
  budget_.OnIdentified(agent);
  if (!certificate_.empty()) return;
  certificate_ = certificate;
  account_ = account;
}

absl::StatusOr<Peer> Connection::ReadPeer(const grpc::AuthContext& auth) {
  MutexLock lock(&mu_);
  if (!peer_.has_value()) {
    RIPS_ASSIGN_OR_RETURN(peer_, PeerOf(auth));
  }
  return *peer_;
}

void Connection::OnThrottled() {
  if (told_.exchange(true)) End();
}

std::string Connection::certificate() const {
  MutexLock lock(&mu_);
  return certificate_;
}

std::string Connection::account() const {
  MutexLock lock(&mu_);
  return account_;
}

std::string Connection::shown() const {
  MutexLock lock(&mu_);
  return certificate_.empty() && peer_.has_value() ? Describe(*peer_) : certificate_;
}

std::optional<PeerIdentity> Connection::identity() const {
  MutexLock lock(&mu_);
  return peer_.has_value() ? std::optional(peer_->identity) : std::nullopt;
}

Excess Connection::OnCall(int64_t now_ns) {
  MutexLock lock(&mu_);
  return budget_.OnCall(now_ns);
}

Connection::State Connection::Check(int64_t now_ns, bool active, int64_t rest_ns, Excess& excess) {
  MutexLock lock(&mu_);
  // Also if the peer has left at once: its certificate is banned all the same.
  if (!ended_ && budget_.exceeded() != Excess::kNone) {
    excess = budget_.exceeded();
    return State::kOpen;
  }
  const bool rests = look_.watched && !active && !ended_ && !look_.unsent;
  if (rests && now_ns - look_.at_ns < rest_ns) return State::kOpen;
  look_.at_ns = now_ns;
  tcp_info info = {};
  socklen_t size = sizeof(info);
  if (getsockopt(socket_.get(), IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return State::kOver;
  spoke_ = info.tcpi_bytes_received >= kClientHelloBytes;
  look_.unsent = info.tcpi_notsent_bytes > 0 || info.tcpi_unacked > 0;
  if (info.tcpi_state != kEstablished && info.tcpi_state != kCloseWait) return State::kOver;
  if (ended_) return State::kEnded;
  excess = budget_.Check(info.tcpi_bytes_received, now_ns);
  return State::kOpen;
}

bool Connection::EndedByPeer() const {
  MutexLock lock(&mu_);
  return !ended_;
}

bool Connection::End() {
  MutexLock lock(&mu_);
  if (std::exchange(ended_, true)) return false;
  shutdown(socket_.get(), SHUT_RDWR);
  return true;
}

}  // namespace rips::rpc
