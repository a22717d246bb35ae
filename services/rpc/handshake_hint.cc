#include "services/rpc/handshake_hint.h"

#include <algorithm>
#include <initializer_list>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace rips::rpc {
namespace {

bool Says(absl::string_view text, std::initializer_list<absl::string_view> any) {
  return std::any_of(any.begin(), any.end(),
                     [text](absl::string_view each) { return absl::StrContains(text, each); });
}

}  // namespace

std::string HandshakeHint(absl::string_view failure, absl::string_view server,
                          const TlsFiles& files) {
  if (Says(failure, {"certificate verify failed"})) {
    return absl::StrCat("the certificate of `", server, "` is not issued under `", files.ca,
                        "`, or is not valid now; `openssl s_client -connect ", server,
                        " </dev/null | openssl x509 -noout -issuer -dates` shows it");
  }
  if (Says(failure, {"Handshake read failed"})) {
    return absl::StrCat("`", server, "` ended the connection before a handshake; does it speak ",
                        "TLS, and is the port right?");
  }
  if (Says(failure, {"alert", "Socket closed", "onnection reset", "Broken pipe"})) {
    return absl::StrCat("`", server, "` ended the connection: it does not trust the issuer of `",
                        files.cert, "`, or it is busy or under attack and takes no more ",
                        "connections from this host's address now, which hosts behind the same ",
                        "NAT share: try again; its log says which");
  }
  if (Says(failure, {"wrong version number", "WRONG_VERSION_NUMBER"})) {
    return absl::StrCat("what listens at `", server, "` does not speak TLS; is the port right?");
  }
  return "";
}

}  // namespace rips::rpc
