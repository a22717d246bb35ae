#include "policy_server/server/outputs/connection.h"

#include <openssl/err.h>
#include <openssl/x509_vfy.h>
#include <openssl/x509v3.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/outputs/resolver.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"

namespace rips::outputs {
namespace {

constexpr size_t kPemBytesMax = 1 << 20;
constexpr char kClosed[] = "the receiver closed the connection";

struct FreeContext {
  void operator()(SSL_CTX* context) const { SSL_CTX_free(context); }
};
using Context = std::unique_ptr<SSL_CTX, FreeContext>;

// Of the newest error of OpenSSL; it names no content.
std::string Reason() {
  const char* text = ERR_reason_error_string(ERR_peek_last_error());
  ERR_clear_error();
  return text != nullptr ? text : "unknown error";
}

// An encrypted key is refused instead of asking for its password on the terminal.
int RefusePassword(char*, int, int, void*) { return 0; }

absl::Status BadFile(const std::string& path, absl::string_view what) {
  return absl::FailedPreconditionError(
      absl::StrCat("`", path, "` is no usable ", what, " in PEM: ", Reason()));
}

absl::StatusOr<Context> MakeContext(const server::OutputEndpoint& endpoint) {
  ERR_clear_error();
  Context context(SSL_CTX_new(TLS_client_method()));
  SSL_CTX* tls = context.get();
  if (tls == nullptr || SSL_CTX_set_min_proto_version(tls, TLS1_2_VERSION) != 1) {
    return absl::UnavailableError(absl::StrCat("cannot use TLS: ", Reason()));
  }
  SSL_CTX_set_verify(tls, SSL_VERIFY_PEER, nullptr);
  SSL_CTX_set_mode(tls, SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
  SSL_CTX_set_default_passwd_cb(tls, RefusePassword);
  // An answer has its own end; what a cut connection leaves of one is not taken for whole.
  SSL_CTX_set_options(tls, SSL_OP_IGNORE_UNEXPECTED_EOF);
  if (endpoint.ca.empty()) {
    if (SSL_CTX_set_default_verify_paths(tls) != 1) {
      return absl::UnavailableError("the system has no certificates to trust; set `ca`");
    }
  } else {
    RIPS_RETURN_IF_ERROR(ReadFile(endpoint.ca, kPemBytesMax).status());
    if (SSL_CTX_load_verify_file(tls, endpoint.ca.c_str()) != 1) {
      return BadFile(endpoint.ca, "CA certificate");
    }
  }
  if (endpoint.cert.empty()) return context;
  RIPS_RETURN_IF_ERROR(ReadFile(endpoint.cert, kPemBytesMax).status());
  RIPS_RETURN_IF_ERROR(ReadFile(endpoint.key, kPemBytesMax).status());
  if (SSL_CTX_use_certificate_chain_file(tls, endpoint.cert.c_str()) != 1) {
    return BadFile(endpoint.cert, "certificate");
  }
  if (SSL_CTX_use_PrivateKey_file(tls, endpoint.key.c_str(), SSL_FILETYPE_PEM) != 1 ||
      SSL_CTX_check_private_key(tls) != 1) {
    return BadFile(endpoint.key, absl::StrCat("private key of ", endpoint.cert));
  }
  return context;
}

// Whom the certificate of the peer must name.
bool ExpectPeer(SSL* tls, const std::string& host) {
  X509_VERIFY_PARAM* wanted = SSL_get0_param(tls);
  X509_VERIFY_PARAM_set_hostflags(wanted, X509_CHECK_FLAG_NO_PARTIAL_WILDCARDS);
  if (X509_VERIFY_PARAM_set1_ip_asc(wanted, host.c_str()) == 1) return true;
  ERR_clear_error();  // a name
  return SSL_set_tlsext_host_name(tls, host.c_str()) == 1 && SSL_set1_host(tls, host.c_str()) == 1;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Connection>> Connection::Open(const server::OutputEndpoint& endpoint,
                                                             absl::Duration within,
                                                             const WakeFd* stop) {
  absl::StatusOr<std::unique_ptr<Connection>> opened = OpenWithin(endpoint, Deadline(within), stop);
  if (!absl::IsDeadlineExceeded(opened.status())) return opened;
  return absl::UnavailableError(opened.status().message());
}

absl::StatusOr<std::unique_ptr<Connection>> Connection::OpenWithin(
    const server::OutputEndpoint& endpoint, const Deadline& deadline, const WakeFd* stop) {
  RIPS_ASSIGN_OR_RETURN(UniqueFd fd, ConnectTo(endpoint.host, endpoint.port, deadline, *stop));
  std::unique_ptr<Connection> connection(new Connection(std::move(fd), stop));
  if (endpoint.tls) RIPS_RETURN_IF_ERROR(connection->StartTls(endpoint, deadline));
  return connection;
}

Connection::~Connection() {
  // Tells the peer the end, if that does not block. Ignored: it may have gone.
  if (tls_ != nullptr && SSL_is_init_finished(tls_.get()) == 1) SSL_shutdown(tls_.get());
  ERR_clear_error();
}

absl::Status Connection::StartTls(const server::OutputEndpoint& endpoint,
                                  const Deadline& deadline) {
  RIPS_ASSIGN_OR_RETURN(const Context context, MakeContext(endpoint));
  tls_.reset(SSL_new(context.get()));
  if (tls_ == nullptr || SSL_set_fd(tls_.get(), fd_.get()) != 1 ||
      !ExpectPeer(tls_.get(), endpoint.host)) {
    return absl::UnavailableError(absl::StrCat("cannot use TLS: ", Reason()));
  }
  const absl::StatusOr<int> done =
      Perform("TLS handshake", deadline, [this] { return SSL_connect(tls_.get()); });
  const int64_t verified = SSL_get_verify_result(tls_.get());
  if (!done.ok() && verified != X509_V_OK) {
    return absl::UnavailableError(absl::StrCat("the certificate of the receiver is not accepted: ",
                                               X509_verify_cert_error_string(verified)));
  }
  if (done.ok() && *done == 0) return absl::UnavailableError(kClosed);
  return done.status();
}

absl::Status Connection::Await(short events, const Deadline& deadline, absl::string_view doing) {
  return AwaitFd(fd_.get(), events, deadline, *stop_, doing);
}

absl::StatusOr<int> Connection::Perform(absl::string_view doing, const Deadline& deadline,
                                        absl::FunctionRef<int()> step) {
  while (true) {
    ERR_clear_error();
    errno = 0;
    const int result = step();
    if (result > 0) return result;
    switch (SSL_get_error(tls_.get(), result)) {
      case SSL_ERROR_WANT_READ:
        RIPS_RETURN_IF_ERROR(Await(POLLIN, deadline, doing));
        break;
      case SSL_ERROR_WANT_WRITE:
        RIPS_RETURN_IF_ERROR(Await(POLLOUT, deadline, doing));
        break;
      case SSL_ERROR_ZERO_RETURN:
        return 0;
      case SSL_ERROR_SYSCALL:
        return absl::UnavailableError(
            absl::StrCat(doing, ": ", errno != 0 ? std::strerror(errno) : kClosed));
      default:
        return absl::UnavailableError(absl::StrCat(doing, ": ", Reason()));
    }
  }
}

absl::Status Connection::Write(absl::string_view bytes, absl::Duration within) {
  constexpr size_t kPiece = std::numeric_limits<int>::max() / 2;
  const Deadline deadline(within);
  while (!bytes.empty()) {
    const size_t piece = std::min(bytes.size(), kPiece);
    if (tls_ != nullptr) {
      RIPS_ASSIGN_OR_RETURN(const int wrote, Perform("sending", deadline, [&] {
                              return SSL_write(tls_.get(), bytes.data(), static_cast<int>(piece));
                            }));
      if (wrote == 0) return absl::UnavailableError(kClosed);
      bytes.remove_prefix(static_cast<size_t>(wrote));
      continue;
    }
    const ssize_t wrote = send(fd_.get(), bytes.data(), piece, MSG_NOSIGNAL);
    if (wrote >= 0) {
      bytes.remove_prefix(static_cast<size_t>(wrote));
    } else if (errno == EAGAIN) {
      RIPS_RETURN_IF_ERROR(Await(POLLOUT, deadline, "sending"));
    } else if (errno != EINTR) {
      return absl::UnavailableError(absl::StrCat("sending: ", std::strerror(errno)));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::string> Connection::Read(size_t max, const Deadline& deadline) {
  std::string bytes(std::min(max, size_t{16} << 10), '\0');
  const auto size = static_cast<int>(bytes.size());
  if (tls_ != nullptr) {
    RIPS_ASSIGN_OR_RETURN(const int got, Perform("waiting for the receiver", deadline, [&] {
                            return SSL_read(tls_.get(), bytes.data(), size);
                          }));
    bytes.resize(static_cast<size_t>(got));
    return bytes;
  }
  while (true) {
    const ssize_t got = recv(fd_.get(), bytes.data(), bytes.size(), 0);
    if (got >= 0) {
      bytes.resize(static_cast<size_t>(got));
      return bytes;
    }
    if (errno == EAGAIN) {
      RIPS_RETURN_IF_ERROR(Await(POLLIN, deadline, "waiting for the receiver"));
    } else if (errno != EINTR) {
      return absl::UnavailableError(
          absl::StrCat("waiting for the receiver: ", std::strerror(errno)));
    }
  }
}

absl::Status Connection::StaysUp(absl::Duration time) {
  const Deadline deadline(time);
  do {
    const absl::StatusOr<std::string> got = Read(size_t{16} << 10, deadline);
    if (absl::IsDeadlineExceeded(got.status())) return absl::OkStatus();
    RIPS_RETURN_IF_ERROR(got.status());
    if (got->empty()) return absl::UnavailableError(kClosed);
  } while (deadline.left() > absl::ZeroDuration());
  return absl::OkStatus();
}

}  // namespace rips::outputs
