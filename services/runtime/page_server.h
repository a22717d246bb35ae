// A small HTTP server for a daemon's own pages, which clients cannot occupy: nothing it does waits
// for one of them.
//
// | a client                                    | what happens                                |
// |---------------------------------------------|---------------------------------------------|
// | has not sent its request within `patience`  | closed; counted as `slow`                   |
// | has not read its answer within `patience`   | closed; counted as `slow`                   |
// | sends a request beyond `request_bytes_max`  | 431, closed; counted as `long`              |
// | is one too many (`connections_max`)         | taken; the oldest one that has not sent its |
// |                                             | request, else the oldest, is closed, and    |
// |                                             | counted as `crowded`                        |
// | makes answers together exceed               | the oldest answer is dropped with its       |
// | `answers_bytes_max`                         | connection; counted as `crowded`            |
// | sends what is not HTTP/1                    | 400, closed                                 |
//
// One answer a connection. A page that takes time is made on a thread of its own, once for all who
// ask while it waits to begin; the others never wait for it.
#ifndef RIPS_SERVICES_RUNTIME_PAGE_SERVER_H_
#define RIPS_SERVICES_RUNTIME_PAGE_SERVER_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips {

struct PageLimits {
  size_t connections_max = 64;
  absl::Duration patience = absl::Seconds(5);
  size_t request_bytes_max = 8 << 10;
  size_t answers_bytes_max = size_t{32} << 20;
};

struct PageAnswer {
  int code = 200;
  std::string type = "text/plain";
  std::string body;
};

// `HOST:PORT` with a numeric host, one of IPv6 in brackets.
struct PageAddress {
  std::string host;  // `127.0.0.1`, `[::1]`
  uint16_t port = 0;
  // Only processes of this machine reach it.
  bool loopback = false;
};
// InvalidArgument with an example.
absl::StatusOr<PageAddress> ParsePageAddress(absl::string_view text);

class PageServer {
 public:
  enum class Dropped { kSlow, kLong, kCrowded };

  // Called with the path of a GET, without its query. `quick` runs on the thread that serves all
  // connections and must not wait; it returns false for a page of `slow`, which runs on a thread of
  // its own and answers `/readyz`.
  struct Pages {
    std::function<bool(absl::string_view path, PageAnswer& answer)> quick;
    std::function<PageAnswer()> slow;
    // Counts a connection that was closed without its answer. On the serving thread; may be empty.
    std::function<void(Dropped)> dropped;
  };

  // Unavailable if the address cannot be bound.
  static absl::StatusOr<std::unique_ptr<PageServer>> Start(const PageAddress& address, Pages pages,
                                                           PageLimits limits = {});
  // Closes all connections.
  ~PageServer();

  uint16_t port() const { return port_; }

 private:
  struct Connection;

  PageServer(UniqueFd listener, uint16_t port, Pages pages, PageLimits limits);
  void Serve() ABSL_LOCKS_EXCLUDED(mu_);
  void Wait();
  void Accept();
  void MakeRoom();
  // False: it is over.
  bool Step(Connection& connection);
  bool Read(Connection& connection);
  bool Write(Connection& connection);
  void Dispatch(Connection& connection) ABSL_LOCKS_EXCLUDED(mu_);
  void Answer(Connection& connection, const PageAnswer& answer);
  void DropOldAnswers();
  void GiveSlowAnswers() ABSL_LOCKS_EXCLUDED(mu_);
  void MakeSlowAnswers() ABSL_LOCKS_EXCLUDED(mu_);
  void Count(Dropped why) const;

  const UniqueFd listener_;
  const WakeFd wake_;
  const uint16_t port_;
  const Pages pages_;
  const PageLimits limits_;
  // The serving thread's. Oldest first.
  std::list<Connection> connections_;
  int64_t accept_again_ns_ = 0;

  Mutex mu_;
  CondVar asked_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  // Rounds of the slow page: who asks now is answered by the round `wanted_`.
  uint64_t wanted_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t begun_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t made_ ABSL_GUARDED_BY(mu_) = 0;
  PageAnswer slow_answer_ ABSL_GUARDED_BY(mu_);
  std::thread slow_thread_;
  std::thread thread_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_PAGE_SERVER_H_
