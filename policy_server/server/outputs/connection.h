// One outgoing connection, over TLS or plain TCP. Every wait has an end: its time, or the caller's
// `stop`. A name is resolved on a thread of its own, because the resolver of the system cannot be
// interrupted; the thread outlives the wait by as long as the resolver takes.
//
// With TLS: version 1.2 or later, the certificate of the peer must be good for the host's name (or
// address) and lead to the CA. The files are read for each connection. The process ignores SIGPIPE
// (BlockSignals).
//
// Errors: Unavailable (the network, the peer, its certificate), DeadlineExceeded, Cancelled (`stop`
// was woken), and those of ReadFile for our own files. No message holds more than a file's path.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_CONNECTION_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_CONNECTION_H_

#include <openssl/ssl.h>

#include <cstddef>
#include <memory>
#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/server/config/output_config.h"
#include "policy_server/server/outputs/deadline.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips::outputs {

// One thread at a time.
class Connection {
 public:
  // `stop` is not owned and outlives the connection; once woken, it stays so. Unavailable also if
  // it takes too long: nothing has been sent, so that less of it would not help.
  static absl::StatusOr<std::unique_ptr<Connection>> Open(const server::OutputEndpoint& endpoint,
                                                          absl::Duration within,
                                                          const WakeFd* stop);
  ~Connection();
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  // All of `bytes`, to the kernel.
  absl::Status Write(absl::string_view bytes, absl::Duration within);
  // What has come, at least one byte and at most `max`; empty = the peer has closed.
  absl::StatusOr<std::string> Read(size_t max, const Deadline& deadline);
  // OK if the connection is still up after `time`; what comes meanwhile is thrown away.
  absl::Status StaysUp(absl::Duration time);

 private:
  struct FreeTls {
    void operator()(SSL* tls) const { SSL_free(tls); }
  };
  Connection(UniqueFd fd, const WakeFd* stop) : stop_(stop), fd_(std::move(fd)) {}

  static absl::StatusOr<std::unique_ptr<Connection>> OpenWithin(
      const server::OutputEndpoint& endpoint, const Deadline& deadline, const WakeFd* stop);
  absl::Status StartTls(const server::OutputEndpoint& endpoint, const Deadline& deadline);
  // Waits until the socket is ready for `events` of poll().
  absl::Status Await(short events, const Deadline& deadline, absl::string_view doing);
  // Calls a function of OpenSSL until it is done, and returns its result; 0 = the peer has closed.
  absl::StatusOr<int> Perform(absl::string_view doing, const Deadline& deadline,
                              absl::FunctionRef<int()> step);

  const WakeFd* stop_;
  UniqueFd fd_;
  // Null: plain TCP.
  std::unique_ptr<SSL, FreeTls> tls_;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_CONNECTION_H_
