// A server on loopback that does what a test says, over TLS or TCP. Test code only.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_FAKE_PEER_FOR_TEST_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_FAKE_PEER_FOR_TEST_H_

#include <netinet/in.h>
#include <openssl/ssl.h>
#include <sys/socket.h>

#include <csignal>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include "absl/strings/string_view.h"
#include "gtest/gtest.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/unique_fd.h"

namespace rips::outputs {

// One connection that the fake has taken. Blocks; ends with the connection.
class Taken {
 public:
  Taken(UniqueFd fd, SSL* tls) : fd_(std::move(fd)), tls_(tls) {}
  ~Taken() { SSL_free(tls_); }

  // Up to 64 KiB; empty = the client has gone.
  std::string Read() {
    std::string bytes(size_t{64} << 10, '\0');
    const auto size = static_cast<int>(bytes.size());
    const ssize_t got = tls_ != nullptr ? SSL_read(tls_, bytes.data(), size)
                                        : recv(fd_.get(), bytes.data(), bytes.size(), 0);
    bytes.resize(got > 0 ? static_cast<size_t>(got) : 0);
    return bytes;
  }
  // Until `enough` says so, or the client has gone.
  std::string ReadUntil(const std::function<bool(const std::string&)>& enough) {
    std::string all;
    while (!enough(all)) {
      const std::string more = Read();
      if (more.empty()) break;
      all += more;
    }
    return all;
  }
  // A request with its whole body.
  std::string ReadRequest() {
    return ReadUntil([](const std::string& all) {
      const size_t head = all.find("\r\n\r\n");
      const size_t length = all.find("Content-Length: ");
      return head != std::string::npos && length != std::string::npos &&
             all.size() >= head + 4 + std::stoul(all.substr(length + 16));
    });
  }
  // False: the client has gone.
  bool Write(absl::string_view bytes) {
    if (tls_ != nullptr) {
      return SSL_write(tls_, bytes.data(), static_cast<int>(bytes.size())) > 0;
    }
    return send(fd_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL) > 0;
  }
  // Waits until the client goes.
  void Hang() {
    while (!Read().empty()) {
    }
  }
  // Closes with a reset, as a process that is killed with unread data.
  void Reset() {
    const linger at_once = {.l_onoff = 1, .l_linger = 0};
    setsockopt(fd_.get(), SOL_SOCKET, SO_LINGER, &at_once, sizeof(at_once));
    fd_.Reset();
  }

 private:
  UniqueFd fd_;
  SSL* tls_;
};

// Takes connections one after another, and gives each to `serve` on its thread.
class FakePeer {
 public:
  using Serve = std::function<void(Taken&)>;

  // With `files`, over TLS; with `wants_client`, only to clients that their CA has signed.
  explicit FakePeer(Serve serve, const TlsFiles* files = nullptr, bool wants_client = false)
      : serve_(std::move(serve)) {
    signal(SIGPIPE, SIG_IGN);
    if (files != nullptr) UseTls(*files, wants_client);
    listening_ = UniqueFd(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    sockaddr_in address = {.sin_family = AF_INET,
                           .sin_port = 0,
                           .sin_addr = {.s_addr = htonl(INADDR_LOOPBACK)},
                           .sin_zero = {}};
    socklen_t length = sizeof(address);
    auto* bytes = reinterpret_cast<sockaddr*>(&address);
    EXPECT_EQ(bind(listening_.get(), bytes, length), 0);
    EXPECT_EQ(listen(listening_.get(), 8), 0);
    EXPECT_EQ(getsockname(listening_.get(), bytes, &length), 0);
    port_ = ntohs(address.sin_port);
    thread_ = std::thread([this] { Run(); });
  }
  // Waits for `serve`.
  ~FakePeer() {
    shutdown(listening_.get(), SHUT_RDWR);
    thread_.join();
    SSL_CTX_free(context_);
  }

  int port() const { return port_; }

 private:
  void UseTls(const TlsFiles& files, bool wants_client) {
    context_ = SSL_CTX_new(TLS_server_method());
    EXPECT_EQ(SSL_CTX_use_certificate_chain_file(context_, files.cert.c_str()), 1);
    EXPECT_EQ(SSL_CTX_use_PrivateKey_file(context_, files.key.c_str(), SSL_FILETYPE_PEM), 1);
    if (!wants_client) return;
    EXPECT_EQ(SSL_CTX_load_verify_file(context_, files.ca.c_str()), 1);
    SSL_CTX_set_verify(context_, SSL_VERIFY_PEER | SSL_VERIFY_FAIL_IF_NO_PEER_CERT, nullptr);
  }
  void Run() {
    while (true) {
      UniqueFd fd(accept4(listening_.get(), nullptr, nullptr, SOCK_CLOEXEC));
      if (fd.get() < 0) return;
      SSL* tls = nullptr;
      if (context_ != nullptr) {
        tls = SSL_new(context_);
        SSL_set_fd(tls, fd.get());
        if (SSL_accept(tls) != 1) {
          SSL_free(tls);
          continue;
        }
      }
      Taken taken(std::move(fd), tls);
      serve_(taken);
    }
  }

  const Serve serve_;
  SSL_CTX* context_ = nullptr;
  UniqueFd listening_;
  int port_ = 0;
  std::thread thread_;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_FAKE_PEER_FOR_TEST_H_
