#include "services/rpc/connection_guard.h"

#include <fcntl.h>
#include <linux/tcp.h>
#include <malloc.h>
#include <netdb.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <tuple>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/rpc/peer_address.h"
#include "services/runtime/log.h"

namespace rips::rpc {
namespace {

constexpr int kBacklog = 1'024;
// What a listener without descriptors waits before it looks again.
constexpr absl::Duration kOutOfDescriptors = absl::Milliseconds(50);
// After the last connection that was ended for its cost.
constexpr int64_t kTrimNs = kNanosPerSecond;
// Of agents whose calls are counted, before those who have not called for long are forgotten.
constexpr size_t kAgentCallsMax = 4'096;
constexpr size_t kBannedMax = 4'096;
// Calls that cannot be decoded have an account of their own beside those of an agent.
constexpr char kUndecodable[] = " undecodable";
// Ended to make room though gRPC had them, which closes its descriptors a moment later.
constexpr int kRoomPerLook = 128;
// At most, of many.
constexpr size_t kRoomAtOnce = 16;
// After so many looks also a connection at rest is looked at: SocketActivity
// misses a peer that floods and does not read.
constexpr int64_t kRestLooks = 4;
// Peers that stay connected stay known.
constexpr int64_t kStayKnownNs = 60 * kNanosPerSecond;
constexpr char kEndedHelp[] = "Connections ended by the guard, by why.";

absl::Status Failed(absl::string_view what) {
  return absl::UnavailableError(absl::StrCat(what, ": ", std::strerror(errno)));
}

UniqueFd OpenReserve() { return UniqueFd(open("/dev/null", O_RDONLY | O_CLOEXEC)); }

// Refuses at once and leaves nothing of it behind.
void Reset(UniqueFd socket) {
  const linger now{.l_onoff = 1, .l_linger = 0};
  setsockopt(socket.get(), SOL_SOCKET, SO_LINGER, &now, sizeof(now));
}

struct FreeAddresses {
  void operator()(addrinfo* list) const { freeaddrinfo(list); }
};

absl::StatusOr<UniqueFd> ListenOn(const addrinfo& at, int port) {
  UniqueFd fd(socket(at.ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (fd.get() < 0) return Failed("socket");
  const int on = 1;
  const int off = 0;
  setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
  sockaddr_storage address = {};
  std::memcpy(&address, at.ai_addr, at.ai_addrlen);
  if (at.ai_family == AF_INET6) {
    // `[::]` is IPv4, too; an address of its own is not.
    setsockopt(fd.get(), IPPROTO_IPV6, IPV6_V6ONLY, &off, sizeof(off));
    reinterpret_cast<sockaddr_in6*>(&address)->sin6_port = htons(static_cast<uint16_t>(port));
  } else {
    reinterpret_cast<sockaddr_in*>(&address)->sin_port = htons(static_cast<uint16_t>(port));
  }
  if (bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), at.ai_addrlen) != 0) {
    return Failed("bind");
  }
  if (listen(fd.get(), kBacklog) != 0) return Failed("listen");
  return fd;
}

int PortOf(const UniqueFd& fd) {
  sockaddr_storage address = {};
  socklen_t size = sizeof(address);
  if (getsockname(fd.get(), reinterpret_cast<sockaddr*>(&address), &size) != 0) return 0;
  return address.ss_family == AF_INET6
             ? ntohs(reinterpret_cast<const sockaddr_in6*>(&address)->sin6_port)
             : ntohs(reinterpret_cast<const sockaddr_in*>(&address)->sin_port);
}

void CountRefused(Metrics* metrics, absl::string_view reason) {
  if (metrics == nullptr) return;
  metrics
      ->AddCounter("rips_connections_refused_total", "Connections not taken, by why.",
                   {{"reason", std::string(reason)}})
      .Increment();
}

void CountEnded(Metrics* metrics, absl::string_view reason) {
  if (metrics == nullptr) return;
  metrics->AddCounter("rips_connections_ended_total", kEndedHelp, {{"reason", std::string(reason)}})
      .Increment();
}

void HandOver(grpc::experimental::ExternalConnectionAcceptor& grpc, UniqueFd socket) {
  const int on = 1;
  setsockopt(socket.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
  grpc::experimental::ExternalConnectionAcceptor::NewConnectionParameters given;
  given.fd = socket.Release();
  grpc.HandleNewConnection(&given);
}

// Its peer has closed or reset it, or we have shut it down.
bool HasLeft(const UniqueFd& socket) {
  pollfd polled = {.fd = socket.get(), .events = POLLRDHUP, .revents = 0};
  return poll(&polled, 1, 0) != 0;
}

}  // namespace

// --------------------------------------------------------------------------------------- guard

ConnectionGuard::ConnectionGuard(Options options, const Clock* clock, Metrics* metrics)
    : options_(std::move(options)),
      clock_(clock),
      metrics_(metrics),
      reserve_(OpenReserve()),
      admission_(options_.admission),
      waiting_(options_.handshakes) {
  if (metrics_ == nullptr) return;
  open_ = metrics_->AddGauge("rips_connections", "Connections that are open.");
  for (const char* why : {"banned", "rate", "address", "network", "total", "descriptors"}) {
    metrics_->AddCounter("rips_connections_refused_total", "Connections not taken, by why.",
                         {{"reason", why}});
  }
  for (const char* why : {"silent", "calls", "bytes", "refused", "room"}) {
    metrics_->AddCounter("rips_connections_ended_total", kEndedHelp, {{"reason", why}});
  }
}

ConnectionGuard::~ConnectionGuard() { Stop(); }

absl::StatusOr<std::unique_ptr<ConnectionGuard>> ConnectionGuard::Listen(const std::string& listen,
                                                                         Options options,
                                                                         const Clock* clock,
                                                                         Metrics* metrics) {
  std::unique_ptr<ConnectionGuard> guard(new ConnectionGuard(std::move(options), clock, metrics));
  if (const absl::Status bound = guard->Bind(listen); !bound.ok()) {
    return absl::UnavailableError(absl::StrCat("cannot listen on `", listen, "` (", bound.message(),
                                               "); is the port in use?"));
  }
  return guard;
}

absl::Status ConnectionGuard::Bind(const std::string& listen) {
  const size_t colon = listen.rfind(':');
  if (colon == std::string::npos) return absl::UnavailableError("write it as HOST:PORT");
  std::string host = listen.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  const std::string service = listen.substr(colon + 1);
  addrinfo hints = {};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  const int error =
      getaddrinfo(host.empty() ? nullptr : host.c_str(), service.c_str(), &hints, &found);
  if (error != 0) return absl::UnavailableError(gai_strerror(error));
  const std::unique_ptr<addrinfo, FreeAddresses> list(found);
  if (!absl::SimpleAtoi(service, &port_)) return absl::UnavailableError("the port is no number");
  for (const addrinfo* at = list.get(); at != nullptr; at = at->ai_next) {
    if (at->ai_family != AF_INET && at->ai_family != AF_INET6) continue;
    RIPS_ASSIGN_OR_RETURN(UniqueFd listener, ListenOn(*at, port_));
    port_ = PortOf(listener);
    listeners_.push_back(std::move(listener));
  }
  if (listeners_.empty()) return absl::UnavailableError("no address");
  return absl::OkStatus();
}

void ConnectionGuard::Start(std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> grpc) {
  grpc_ = std::move(grpc);
  accept_ = std::thread([this] { Accept(); });
  watch_ = std::thread([this] { RunWatch(); });
}

void ConnectionGuard::Stop() {
  if (stopped_.exchange(true)) return;
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    stop_cond_.NotifyAll();
  }
  wake_.Wake();
  if (accept_.joinable()) accept_.join();
  if (watch_.joinable()) watch_.join();
  MutexLock lock(&mu_);
  listeners_.clear();
  connections_.clear();
  waiting_.EraseIf([](const Waiting&) { return true; });
}

void ConnectionGuard::Wasted(const Source& source, int64_t now_ns) {
  if (!options_.on_wasted) return;
  bool known = false;
  {
    MutexLock lock(&mu_);
    known = admission_.Known(source, now_ns);
  }
  options_.on_wasted(source.address, known);
}

absl::Status ConnectionGuard::Probe(absl::Duration patience) {
  // Where a connection to ourselves goes: to the listener's address, or to the host's own if it
  // listens on all. It comes from the same address.
  sockaddr_storage to = {};
  socklen_t size = sizeof(to);
  {
    MutexLock lock(&mu_);
    if (listeners_.empty() ||
        getsockname(listeners_[0].get(), reinterpret_cast<sockaddr*>(&to), &size) != 0) {
      return absl::UnavailableError("the listener is closed");
    }
  }
  sockaddr_storage from = {};
  from.ss_family = to.ss_family;
  if (to.ss_family == AF_INET6) {
    auto* v6 = reinterpret_cast<sockaddr_in6*>(&to);
    if (IN6_IS_ADDR_UNSPECIFIED(&v6->sin6_addr)) v6->sin6_addr = in6addr_loopback;
    reinterpret_cast<sockaddr_in6*>(&from)->sin6_addr = v6->sin6_addr;
  } else {
    auto* v4 = reinterpret_cast<sockaddr_in*>(&to);
    if (v4->sin_addr.s_addr == htonl(INADDR_ANY)) v4->sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    reinterpret_cast<sockaddr_in*>(&from)->sin_addr = v4->sin_addr;
  }
  const UniqueFd fd(socket(to.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (fd.get() < 0 || bind(fd.get(), reinterpret_cast<const sockaddr*>(&from), size) != 0 ||
      getsockname(fd.get(), reinterpret_cast<sockaddr*>(&from), &size) != 0) {
    return Failed("no socket to probe with");
  }
  const std::string name = SourceOf(from).peer;
  {
    MutexLock lock(&mu_);
    probes_.insert(name);
  }
  bool taken =
      connect(fd.get(), reinterpret_cast<const sockaddr*>(&to), size) == 0 || errno == EINPROGRESS;
  if (taken) {
    pollfd polled = {.fd = fd.get(), .events = POLLIN | POLLRDHUP, .revents = 0};
    taken = poll(&polled, 1, static_cast<int>(absl::ToInt64Milliseconds(patience))) == 1;
    char byte = 0;
    taken = taken && recv(fd.get(), &byte, 1, 0) == 0;
  }
  MutexLock lock(&mu_);
  probes_.erase(name);
  if (taken) return absl::OkStatus();
  return absl::UnavailableError("the listener accepts no connections");
}

// ------------------------------------------------------------------------------------ accepting

void ConnectionGuard::Accept() {
  std::vector<pollfd> polled = {{.fd = wake_.get(), .events = POLLIN, .revents = 0}};
  for (const UniqueFd& listener : listeners_) {
    polled.push_back({.fd = listener.get(), .events = POLLIN, .revents = 0});
  }
  while (true) {
    if (poll(polled.data(), polled.size(), -1) < 0 && errno != EINTR) {
      LogError("listener failed", {{"reason", std::strerror(errno)}});
      return;
    }
    if (polled[0].revents != 0) return;
    for (size_t i = 1; i < polled.size(); ++i) {
      if (polled[i].revents == 0 || AcceptAll(polled[i].fd)) continue;
      MutexLock lock(&mu_);
      if (!stopping_) stop_cond_.WaitFor(lock, kOutOfDescriptors);
    }
  }
}

bool ConnectionGuard::AcceptAll(int listener) {
  while (true) {
    // getpeername fails on a socket that its peer has reset; accept4 still gives the address.
    sockaddr_storage address = {};
    socklen_t size = sizeof(address);
    UniqueFd socket(accept4(listener, reinterpret_cast<sockaddr*>(&address), &size,
                            SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (socket.get() >= 0) {
      Admit(std::move(socket), SourceOf(address));
      continue;
    }
    if (errno == EAGAIN) return true;
    if (errno != EMFILE && errno != ENFILE && errno != ENOBUFS && errno != ENOMEM) {
      continue;  // that connection is gone already
    }
    // What waits is refused, so that it does not wait for ever.
    reserve_.Reset();
    UniqueFd refused(accept4(listener, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
    const bool any = refused.get() >= 0;
    if (any) Reset(std::move(refused));
    reserve_ = OpenReserve();
    CountRefused(metrics_, "descriptors");
    if (!any || reserve_.get() < 0) return false;
  }
}

void ConnectionGuard::Admit(UniqueFd socket, Source source) {
  UniqueFd duplicate(fcntl(socket.get(), F_DUPFD_CLOEXEC, 0));
  const int64_t now_ns = clock_->Now().boottime_ns;
  sockaddr_storage address = {};
  socklen_t size = sizeof(address);
  // Its peer has reset it already: it must not take the place of another one.
  if (getpeername(socket.get(), reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    return Wasted(source, now_ns);
  }
  Admission::Verdict verdict = Admission::Verdict::kTake;
  std::vector<std::shared_ptr<Connection>> ended;
  {
    MutexLock lock(&mu_);
    if (probes_.contains(source.peer)) return;  // closes it
    verdict = admission_.Ask(source, now_ns);
    ended = MakeRoomLocked(source, verdict, now_ns);
    if (!ended.empty()) verdict = admission_.Ask(source, now_ns);
  }
  for (const auto& each : ended) Wasted(each->source(), now_ns);
  if (verdict != Admission::Verdict::kTake) {
    CountRefused(metrics_, ToString(verdict));
    if (const auto left_out = refusal_logs_.Admit("")) {
      LogWarning("connection refused",
                 {{"peer", source.peer}, {"limit", ToString(verdict)}, {"left_out", *left_out}});
    }
    Wasted(source, now_ns);
    return Reset(std::move(socket));
  }
  {
    MutexLock lock(&mu_);
    if (duplicate.get() < 0) {
      admission_.Left(source);
      CountRefused(metrics_, "descriptors");
      return Reset(std::move(socket));
    }
    // A port that was used a moment ago: the connection before is over.
    if (const auto old = connections_.find(source.peer); old != connections_.end()) {
      ForgetLocked(*old->second);
      connections_.erase(old);
    }
    const bool watched = activity_.Add(duplicate.get());
    auto connection = std::make_shared<Connection>(source, std::move(duplicate), watched,
                                                   options_.budget, now_ns);
    connections_[source.peer] = connection;
    open_.Set(static_cast<double>(connections_.size()));
    if (!admission_.Known(source, now_ns)) {
      waiting_.Add(source, {.connection = std::move(connection), .socket = std::move(socket)});
    }
  }
  if (socket.get() >= 0) return HandOver(*grpc_, std::move(socket));
  HandOverWaiting();
}

void ConnectionGuard::HandOverWaiting() {
  while (true) {
    std::optional<Waiting> next;
    {
      MutexLock lock(&mu_);
      next = waiting_.Next(clock_->Now().boottime_ns);
    }
    if (!next.has_value()) return;
    if (!HasLeft(next->socket)) {
      HandOver(*grpc_, std::move(next->socket));
      continue;
    }
    // Never gRPC's, so that it is closed by us: also a peer that has only closed its side.
    if (next->connection->End()) Wasted(next->connection->source(), clock_->Now().boottime_ns);
    MutexLock lock(&mu_);
    waiting_.GiveBack();
  }
}

std::vector<std::shared_ptr<Connection>> ConnectionGuard::MakeRoomLocked(const Source& source,
                                                                         Admission::Verdict limit,
                                                                         int64_t now_ns) {
  const bool in_address = limit == Admission::Verdict::kAddress;
  const bool in_network = limit == Admission::Verdict::kNetwork;
  if (!in_address && !in_network && limit != Admission::Verdict::kTotal) return {};
  if (made_room_ >= kRoomPerLook) return {};
  using Worth = std::tuple<bool, int, bool, int64_t>;
  std::vector<std::pair<Worth, std::shared_ptr<Connection>>> worth;
  for (const auto& [peer, connection] : connections_) {
    if (in_address && connection->source().address != source.address) continue;
    if (in_network && connection->source().network != source.network) continue;
    if (!connection->certificate().empty()) continue;
    worth.emplace_back(Worth(admission_.Known(connection->source(), now_ns),
                             -admission_.InNetwork(connection->source()), connection->spoke_.load(),
                             connection->taken_ns_),
                       connection);
  }
  // A flood of thousands a second must not cost a look at all of them each.
  const size_t some = std::min(kRoomAtOnce, 1 + worth.size() / 64);
  const auto end = worth.begin() + static_cast<ptrdiff_t>(std::min(some, worth.size()));
  std::partial_sort(worth.begin(), end, worth.end(),
                    [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<std::shared_ptr<Connection>> ended;
  for (auto each = worth.begin(); each != end; ++each) {
    each->second->End();
    ForgetLocked(*each->second);
    connections_.erase(each->second->source().peer);
    CountEnded(metrics_, "room");
    ended.push_back(std::move(each->second));
  }
  // Those that still wait are closed here and now.
  const size_t waited = waiting_.size();
  waiting_.EraseIf([&](const Waiting& waiting) {
    return std::find(ended.begin(), ended.end(), waiting.connection) != ended.end();
  });
  made_room_ += static_cast<int>(ended.size() - (waited - waiting_.size()));
  return ended;
}

// ------------------------------------------------------------------------------------- watching

std::shared_ptr<Connection> ConnectionGuard::Find(absl::string_view peer) {
  const std::string name = DecodePeer(peer);
  MutexLock lock(&mu_);
  const auto it = connections_.find(name);
  return it == connections_.end() ? nullptr : it->second;
}

void ConnectionGuard::OnCall(const grpc::ServerContextBase& context) {
  const std::shared_ptr<Connection> connection = Find(context.peer());
  if (connection == nullptr) return;
  const Excess excess = connection->OnCall(clock_->Now().boottime_ns);
  if (excess == Excess::kNone) return;
  // Perhaps no handler has asked yet whose they are.
  if (const auto auth = context.auth_context(); auth != nullptr) {
    connection->ReadPeer(*auth).IgnoreError();
  }
  EndFor(*connection, excess);
}

std::string ConnectionGuard::AccountLocked(const Source& source, const std::string& certificate,
                                           int64_t now_ns) const {
  if (!admission_.AtHome(source.address, certificate, now_ns)) return certificate;
  return absl::StrCat(certificate, " at ", source.address);
}

bool ConnectionGuard::MayCallLocked(const std::string& account, int64_t now_ns) {
  if (agent_calls_.size() >= kAgentCallsMax) {
    const double full_s = options_.agent_calls_burst / options_.agent_calls_per_second;
    absl::erase_if(agent_calls_, [&](const auto& each) {
      return static_cast<double>(now_ns - each.second.counted_ns) > full_s * kNanosPerSecond;
    });
  }
  const auto [it, fresh] =
      agent_calls_.try_emplace(account, AgentCalls{options_.agent_calls_burst, now_ns});
  AgentCalls& calls = it->second;
  const double seconds = static_cast<double>(now_ns - calls.counted_ns) / kNanosPerSecond;
  calls.counted_ns = now_ns;
  calls.tokens = std::min(options_.agent_calls_burst,
                          calls.tokens + seconds * options_.agent_calls_per_second);
  if (calls.tokens < 1) return false;
  calls.tokens -= 1;
  return true;
}

void ConnectionGuard::OnUndecodable(Connection& from, const std::string& certificate) {
  const int64_t now_ns = clock_->Now().boottime_ns;
  bool may = false;
  {
    MutexLock lock(&mu_);
    may =
        BannedLocked(certificate, from.source().address, now_ns) == 0 &&
        MayCallLocked(absl::StrCat(AccountLocked(from.source(), certificate, now_ns), kUndecodable),
                      now_ns);
  }
  if (!may) EndFor(from, Excess::kRefused);
}

absl::Status ConnectionGuard::OnIdentified(absl::string_view peer, const std::string& certificate,
                                           bool agent) {
  const std::string name = DecodePeer(peer);
  const int64_t now_ns = clock_->Now().boottime_ns;
  std::shared_ptr<Connection> connection;
  {
    MutexLock lock(&mu_);
    const auto it = connections_.find(name);
    if (it == connections_.end()) return absl::OkStatus();
    connection = it->second;
    admission_.Identified(connection->source(), certificate, now_ns);
    const std::string account = AccountLocked(connection->source(), certificate, now_ns);
    if (connection->certificate().empty()) {
      int& count = accounts_[account];
      if (count >= (agent ? options_.per_agent : options_.per_operator)) {
        return absl::ResourceExhaustedError(
            absl::StrCat("this certificate has ", count, " connections already; close some: each ",
                         agent ? "stream" : "`watch`", " holds one"));
      }
      ++count;
      connection->Identify(certificate, account, agent);
      waiting_.GiveBack();
    }
    if (!agent || MayCallLocked(account, now_ns)) return absl::OkStatus();
  }
  // At once: hundreds may follow before the next look.
  EndFor(*connection, Excess::kCalls);
  return absl::ResourceExhaustedError("this certificate begins too many streams");
}

void ConnectionGuard::ForgetLocked(const Connection& connection) {
  activity_.Remove(connection.socket_.get());
  admission_.Left(connection.source());
  const auto it = accounts_.find(connection.account());
  if (it != accounts_.end() && --it->second == 0) accounts_.erase(it);
}

int64_t ConnectionGuard::BannedLocked(const std::string& certificate, const std::string& address,
                                      int64_t now_ns) const {
  const auto it = banned_.find(certificate);
  if (it == banned_.end() || it->second.until_ns <= now_ns) return 0;
  const auto& homes = it->second.homes;
  const bool there = std::find(homes.begin(), homes.end(), address) != homes.end();
  if (!there && admission_.AtHome(address, certificate, now_ns)) return 0;
  return it->second.until_ns - now_ns;
}

absl::Duration ConnectionGuard::Banned(const std::string& certificate, const std::string& address) {
  const int64_t now_ns = clock_->Now().boottime_ns;
  MutexLock lock(&mu_);
  return absl::Nanoseconds(BannedLocked(certificate, address, now_ns));
}

int64_t ConnectionGuard::BanLocked(const Connection& connection, int64_t now_ns) {
  const int64_t banned_ns = admission_.Ban(connection.source(), now_ns);
  const std::string certificate = connection.shown();
  if (!certificate.empty() && (banned_.size() < kBannedMax || banned_.contains(certificate))) {
    Ban& ban = banned_[certificate];
    ban.until_ns = std::max(ban.until_ns, now_ns + banned_ns);
    const std::string& address = connection.source().address;
    if (admission_.AtHome(address, certificate, now_ns)) ban.homes.push_back(address);
  }
  return banned_ns;
}

void ConnectionGuard::EndFor(Connection& connection, Excess excess) {
  if (!connection.End()) return;
  const int64_t now_ns = clock_->Now().boottime_ns;
  Report report{.peer = connection.source().peer,
                .certificate = connection.shown(),
                .identity = connection.identity(),
                .excess = excess};
  CountEnded(metrics_, ToString(excess));
  {
    MutexLock lock(&mu_);
    // Who only keeps silent may be a scanner, or a peer on a bad line. Where ours connect from too,
    // a peer that has not named itself costs them nothing.
    const bool spared = report.certificate.empty() && admission_.Known(connection.source(), now_ns);
    if (excess != Excess::kSilent && !spared) report.banned_ns = BanLocked(connection, now_ns);
    trim_at_ns_ = now_ns + kTrimNs;
  }
  LogWarning("connection closed: it exceeded its budget",
             {{"peer", report.peer},
              {"certificate", report.certificate.empty() ? "unknown" : report.certificate},
              {"excess", ToString(excess)},
              {"banned_s", report.banned_ns / kNanosPerSecond}});
  if (options_.on_ended) options_.on_ended(report);
  if (excess == Excess::kSilent) Wasted(connection.source(), now_ns);
}

void ConnectionGuard::LogUnknownPeer(const Connection& connection) {
  if (!connection.spoke_) return;
  const auto left_out = unknown_peer_logs_.Admit(connection.source().network);
  if (!left_out.has_value()) return;
  LogWarning("connection ended before its peer was known",
             {{"peer", connection.source().peer},
              {"perhaps",
               "its certificate is not issued under our `tls.ca`, or not valid now; or it does not "
               "take ours"},
              {"left_out", *left_out}});
}

void ConnectionGuard::CheckConnections() {
  std::vector<std::shared_ptr<Connection>> live;
  bool trim = false;
  const int64_t now_ns = clock_->Now().boottime_ns;
  {
    MutexLock lock(&mu_);
    live.reserve(connections_.size());
    for (const auto& [peer, connection] : connections_) live.push_back(connection);
    made_room_ = 0;
    if (now_ns - stayed_ns_ >= kStayKnownNs) {
      stayed_ns_ = now_ns;
      for (const auto& connection : live) {
        const std::string certificate = connection->certificate();
        if (!certificate.empty()) admission_.Identified(connection->source(), certificate, now_ns);
      }
    }
    trim = trim_at_ns_ != 0 && now_ns >= trim_at_ns_;
    if (trim) trim_at_ns_ = 0;
    for (auto it = banned_.begin(); it != banned_.end();) {
      it = it->second.until_ns <= now_ns ? banned_.erase(it) : std::next(it);
    }
  }
  const absl::flat_hash_set<int> active = activity_.Look();
  const int64_t rest_ns = kRestLooks * absl::ToInt64Nanoseconds(options_.interval);
  for (const std::shared_ptr<Connection>& connection : live) {
    Excess excess = Excess::kNone;
    const bool stirred = active.contains(connection->socket_.get());
    const Connection::State state = connection->Check(now_ns, stirred, rest_ns, excess);
    if (state == Connection::State::kOver) {
      {
        MutexLock lock(&mu_);
        const auto it = connections_.find(connection->source().peer);
        if (it == connections_.end() || it->second != connection) continue;
        ForgetLocked(*connection);
        connections_.erase(it);
        open_.Set(static_cast<double>(connections_.size()));
      }
      if (!connection->EndedByPeer() || !connection->shown().empty()) continue;
      LogUnknownPeer(*connection);
      Wasted(connection->source(), now_ns);
    } else if (excess != Excess::kNone) {
      EndFor(*connection, excess);
    }
  }
  {
    MutexLock lock(&mu_);
    waiting_.EraseIf([this](const Waiting& waiting) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
      const auto it = connections_.find(waiting.connection->source().peer);
      return it == connections_.end() || it->second != waiting.connection;
    });
  }
  // The C library keeps what an attack made it take.
  if (trim) malloc_trim(0);
}

void ConnectionGuard::RunWatch() {
  while (true) {
    {
      MutexLock lock(&mu_);
      if (!stopping_) stop_cond_.WaitFor(lock, options_.interval);
      if (stopping_) return;
    }
    CheckConnections();
    HandOverWaiting();
  }
}

}  // namespace rips::rpc
