#include "services/runtime/page_server.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "services/base/clock.h"
#include "services/runtime/real_clock.h"

namespace rips {
namespace {

constexpr int kBacklog = 128;
// After a client has been answered, for it to read the end before the connection is closed.
constexpr absl::Duration kLinger = absl::Seconds(1);
// Without descriptors, until a connection is taken again.
constexpr absl::Duration kAcceptPause = absl::Milliseconds(100);
constexpr size_t kReadBytes = 4'096;

absl::string_view Reason(int code) {
  switch (code) {
    case 200:
      return "OK";
    case 400:
      return "Bad Request";
    case 404:
      return "Not Found";
    case 405:
      return "Method Not Allowed";
    case 431:
      return "Request Header Fields Too Large";
    default:
      return "Service Unavailable";
  }
}

bool IsLoopback(const in6_addr& address) {
  return IN6_IS_ADDR_LOOPBACK(&address) ||
         (IN6_IS_ADDR_V4MAPPED(&address) && address.s6_addr[12] == 127);
}

// The socket address of a parsed host, whose brackets were checked.
bool Resolve(const PageAddress& address, sockaddr_storage& storage, socklen_t& size) {
  storage = {};
  if (address.host.front() == '[') {
    auto* v6 = reinterpret_cast<sockaddr_in6*>(&storage);
    v6->sin6_family = AF_INET6;
    v6->sin6_port = htons(address.port);
    size = sizeof(*v6);
    const std::string bare = address.host.substr(1, address.host.size() - 2);
    return inet_pton(AF_INET6, bare.c_str(), &v6->sin6_addr) == 1;
  }
  auto* v4 = reinterpret_cast<sockaddr_in*>(&storage);
  v4->sin_family = AF_INET;
  v4->sin_port = htons(address.port);
  size = sizeof(*v4);
  return inet_pton(AF_INET, address.host.c_str(), &v4->sin_addr) == 1;
}

// Of the first line.
struct Request {
  int refused = 0;  // with this code; 0 = it is a GET
  std::string path;
};

Request ParseRequest(absl::string_view head) {
  const absl::string_view line = head.substr(0, head.find("\r\n"));
  const std::vector<absl::string_view> words = absl::StrSplit(line, ' ');
  if (words.size() != 3 || words[1].empty() || words[1][0] != '/' ||
      (words[2] != "HTTP/1.1" && words[2] != "HTTP/1.0")) {
    return {.refused = 400, .path = ""};
  }
  if (words[0] != "GET") return {.refused = 405, .path = ""};
  return {.path = std::string(words[1].substr(0, words[1].find('?')))};
}

}  // namespace

absl::StatusOr<PageAddress> ParsePageAddress(absl::string_view text) {
  const absl::Status bad = absl::InvalidArgumentError(
      absl::StrCat("metrics address `", text,
                   "` is not HOST:PORT with a host in numbers, such as `127.0.0.1:9464`"));
  const size_t colon = text.rfind(':');
  PageAddress address;
  int port = 0;
  if (colon == absl::string_view::npos || colon == 0 ||
      text.substr(colon + 1).find_first_not_of("0123456789") != absl::string_view::npos ||
      !absl::SimpleAtoi(text.substr(colon + 1), &port) || port > 65535) {
    return bad;
  }
  address.host = std::string(text.substr(0, colon));
  address.port = static_cast<uint16_t>(port);
  if (address.host.front() == '[' && (address.host.back() != ']' || address.host.size() < 3)) {
    return bad;
  }
  sockaddr_storage storage;
  socklen_t size = 0;
  if (!Resolve(address, storage, size)) return bad;
  if (storage.ss_family == AF_INET) {
    const auto* v4 = reinterpret_cast<const sockaddr_in*>(&storage);
    address.loopback = (ntohl(v4->sin_addr.s_addr) >> 24) == 127;
  } else {
    address.loopback = IsLoopback(reinterpret_cast<const sockaddr_in6*>(&storage)->sin6_addr);
  }
  return address;
}

struct PageServer::Connection {
  enum class State { kReading, kAsked, kWriting, kLingering };

  UniqueFd fd;
  State state = State::kReading;
  int64_t deadline_ns = 0;
  std::string request;
  // The round of the slow page that answers it.
  uint64_t round = 0;
  std::string answer;
  size_t written = 0;
  bool over = false;
  short ready = 0;

  short events() const {
    if (state == State::kAsked) return 0;  // POLLHUP and POLLERR come anyway
    return state == State::kWriting ? POLLOUT : POLLIN;
  }
};

absl::StatusOr<std::unique_ptr<PageServer>> PageServer::Start(const PageAddress& address,
                                                              Pages pages, PageLimits limits) {
  sockaddr_storage storage;
  socklen_t size = 0;
  if (!Resolve(address, storage, size)) return absl::InvalidArgumentError("no numeric host");
  UniqueFd listener(
      socket(storage.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, IPPROTO_TCP));
  const int on = 1;
  setsockopt(listener.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
  if (storage.ss_family == AF_INET6) {
    setsockopt(listener.get(), IPPROTO_IPV6, IPV6_V6ONLY, &on, sizeof(on));
  }
  const auto* raw = reinterpret_cast<const sockaddr*>(&storage);
  if (listener.get() < 0 || bind(listener.get(), raw, size) != 0 ||
      listen(listener.get(), kBacklog) != 0) {
    return absl::UnavailableError(std::strerror(errno));
  }
  size = sizeof(storage);
  getsockname(listener.get(), reinterpret_cast<sockaddr*>(&storage), &size);
  const uint16_t port =
      ntohs(storage.ss_family == AF_INET6 ? reinterpret_cast<sockaddr_in6*>(&storage)->sin6_port
                                          : reinterpret_cast<sockaddr_in*>(&storage)->sin_port);
  return std::unique_ptr<PageServer>(
      new PageServer(std::move(listener), port, std::move(pages), limits));
}

PageServer::PageServer(UniqueFd listener, uint16_t port, Pages pages, PageLimits limits)
    : listener_(std::move(listener)), port_(port), pages_(std::move(pages)), limits_(limits) {
  slow_thread_ = std::thread([this] { MakeSlowAnswers(); });
  thread_ = std::thread([this] { Serve(); });
}

PageServer::~PageServer() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    asked_.NotifyAll();
  }
  wake_.Wake();
  thread_.join();
  slow_thread_.join();
}

void PageServer::Count(Dropped why) const {
  if (pages_.dropped) pages_.dropped(why);
}

void PageServer::MakeSlowAnswers() {
  while (true) {
    {
      MutexLock lock(&mu_);
      while (!stopping_ && begun_ == wanted_) asked_.Wait(lock);
      if (stopping_) return;
      ++begun_;
    }
    PageAnswer answer = pages_.slow();
    {
      MutexLock lock(&mu_);
      slow_answer_ = std::move(answer);
      made_ = begun_;
    }
    wake_.Wake();
  }
}

void PageServer::Serve() {
  while (true) {
    {
      MutexLock lock(&mu_);
      if (stopping_) return;
    }
    Wait();
    for (Connection& each : connections_) each.over = !Step(each);
    GiveSlowAnswers();
    DropOldAnswers();
    connections_.remove_if([](const Connection& each) { return each.over; });
    Accept();
  }
}

void PageServer::Wait() {
  const int64_t now_ns = BoottimeNow();
  int64_t until_ns = now_ns + kNanosPerSecond;
  // The listener first: it does not wait for connections to end, since one makes room.
  std::vector<pollfd> fds = {{wake_.get(), POLLIN, 0}, {listener_.get(), POLLIN, 0}};
  if (now_ns < accept_again_ns_) {
    fds[1].fd = -1;
    until_ns = std::min(until_ns, accept_again_ns_);
  }
  for (const Connection& each : connections_) {
    fds.push_back({each.fd.get(), each.events(), 0});
    until_ns = std::min(until_ns, each.deadline_ns);
  }
  const int64_t wait_ms = std::max<int64_t>(0, until_ns - now_ns) / kNanosPerMilli + 1;
  poll(fds.data(), fds.size(), static_cast<int>(wait_ms));
  wake_.Drain();
  size_t i = 2;
  for (Connection& each : connections_) each.ready = fds[i++].revents;
}

void PageServer::Accept() {
  while (BoottimeNow() >= accept_again_ns_) {
    UniqueFd fd(accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (fd.get() < 0) {
      // Also when descriptors run out: what waits stays readable, and must not be asked at once.
      if (errno != EAGAIN && errno != EINTR && errno != ECONNABORTED) {
        accept_again_ns_ = BoottimeAfter(kAcceptPause);
      }
      return;
    }
    if (connections_.size() >= limits_.connections_max) MakeRoom();
    connections_.emplace_back();
    connections_.back().fd = std::move(fd);
    connections_.back().deadline_ns = BoottimeAfter(limits_.patience);
  }
}

void PageServer::MakeRoom() {
  using State = Connection::State;
  auto victim = connections_.begin();
  for (const State state : {State::kLingering, State::kReading}) {
    const auto found = std::find_if(connections_.begin(), connections_.end(),
                                    [&](const auto& each) { return each.state == state; });
    if (found == connections_.end()) continue;
    victim = found;
    break;
  }
  if (victim->state != State::kLingering) Count(Dropped::kCrowded);
  connections_.erase(victim);
}

bool PageServer::Step(Connection& connection) {
  using State = Connection::State;
  if (connection.state == State::kWriting) {
    if (connection.ready != 0 && !Write(connection)) return false;
  } else if (connection.state == State::kAsked) {
    // The client has disconnected.
    if ((connection.ready & (POLLHUP | POLLERR)) != 0) return false;
  } else if (connection.ready != 0 && !Read(connection)) {
    return false;
  }
  if (connection.state == State::kAsked || BoottimeNow() < connection.deadline_ns) return true;
  if (connection.state != State::kLingering) Count(Dropped::kSlow);
  return false;
}

// One piece at a time, so that an endless sender does not keep the thread.
bool PageServer::Read(Connection& connection) {
  char piece[kReadBytes];
  const ssize_t got = recv(connection.fd.get(), piece, sizeof(piece), 0);
  if (got < 0) return errno == EAGAIN || errno == EINTR;
  if (got == 0) return false;
  if (connection.state == Connection::State::kLingering) return true;
  connection.request.append(piece, static_cast<size_t>(got));
  if (connection.request.find("\r\n\r\n") != std::string::npos) {
    Dispatch(connection);
  } else if (connection.request.size() > limits_.request_bytes_max) {
    Count(Dropped::kLong);
    Answer(connection, {.code = 431, .body = "the request is too long\n"});
  }
  return true;
}

void PageServer::Dispatch(Connection& connection) {
  const Request request = ParseRequest(connection.request);
  connection.request = std::string();
  if (request.refused != 0) {
    return Answer(connection, {.code = request.refused,
                               .body = request.refused == 405 ? "only GET\n" : "not HTTP/1\n"});
  }
  PageAnswer answer;
  if (pages_.quick(request.path, answer)) return Answer(connection, answer);
  connection.state = Connection::State::kAsked;
  connection.deadline_ns = INT64_MAX;
  MutexLock lock(&mu_);
  wanted_ = connection.round = begun_ + 1;
  asked_.NotifyAll();
}

void PageServer::GiveSlowAnswers() {
  uint64_t made = 0;
  PageAnswer answer;
  {
    MutexLock lock(&mu_);
    made = made_;
    answer = slow_answer_;
  }
  for (Connection& each : connections_) {
    if (each.state == Connection::State::kAsked && each.round <= made) Answer(each, answer);
  }
}

void PageServer::Answer(Connection& connection, const PageAnswer& answer) {
  connection.answer = absl::StrCat(
      "HTTP/1.1 ", answer.code, " ", Reason(answer.code), "\r\nContent-Type: ", answer.type,
      "\r\nContent-Length: ", answer.body.size(), "\r\nConnection: close\r\n\r\n", answer.body);
  connection.state = Connection::State::kWriting;
  connection.deadline_ns = BoottimeAfter(limits_.patience);
}

bool PageServer::Write(Connection& connection) {
  const absl::string_view left = absl::string_view(connection.answer).substr(connection.written);
  const ssize_t sent = send(connection.fd.get(), left.data(), left.size(), MSG_NOSIGNAL);
  if (sent < 0) return errno == EAGAIN || errno == EINTR;
  connection.written += static_cast<size_t>(sent);
  if (connection.written < connection.answer.size()) return true;
  // Closed now, with bytes of its own unread, the client might never see the answer.
  connection.answer = std::string();
  connection.state = Connection::State::kLingering;
  connection.deadline_ns = BoottimeAfter(kLinger);
  shutdown(connection.fd.get(), SHUT_WR);
  return true;
}

void PageServer::DropOldAnswers() {
  size_t bytes = 0;
  for (auto each = connections_.rbegin(); each != connections_.rend(); ++each) {
    if (each->over) continue;
    bytes += each->answer.size();
    if (each->answer.empty() || bytes <= limits_.answers_bytes_max ||
        bytes == each->answer.size()) {
      continue;
    }
    bytes -= each->answer.size();
    each->over = true;
    Count(Dropped::kCrowded);
  }
}

}  // namespace rips
