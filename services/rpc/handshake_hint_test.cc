#include "services/rpc/handshake_hint.h"

#include <string>

#include "gmock/gmock.h"

namespace rips::rpc {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::string Hint(absl::string_view failure) {
  return HandshakeHint(failure, "server:7443",
                       {.ca = "/pki/ca.pem", .cert = "/pki/cert.pem", .key = "/pki/key.pem"});
}

TEST(HandshakeHintTest, SaysWhoseCertificateAndWhichFile) {
  EXPECT_THAT(Hint("Tls handshake failed: SSL_ERROR_SSL: error:0A000086:SSL "
                   "routines::certificate verify failed"),
              AllOf(HasSubstr("the certificate of `server:7443` is not issued under `/pki/ca.pem`"),
                    HasSubstr("openssl s_client -connect server:7443 ")));
  for (const char* failure :
       {"UNAVAILABLE: ipv4:10.0.0.1:7443: Socket closed", "recvmsg:Connection reset by peer",
        "error:0A000418:SSL routines::tlsv1 alert unknown ca", "sendmsg: Broken pipe"}) {
    EXPECT_THAT(Hint(failure), HasSubstr("the issuer of `/pki/cert.pem`")) << failure;
  }
  EXPECT_THAT(Hint("ipv4:10.0.0.1:7443: Handshake read failed"), HasSubstr("does it speak TLS"));
  EXPECT_THAT(Hint("SSL routines::wrong version number"), HasSubstr("does not speak TLS"));
}

TEST(HandshakeHintTest, AddsNothingToWhatSaysEnough) {
  for (const char* failure : {"", "Failed to connect to remote host: Connection refused",
                              "DNS resolution failed for server:7443", "draining"}) {
    EXPECT_EQ(Hint(failure), "") << failure;
  }
}

}  // namespace
}  // namespace rips::rpc
