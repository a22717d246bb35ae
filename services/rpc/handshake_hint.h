// What a failed TLS handshake means for those who copied the files: gRPC says neither whose
// certificate was refused, nor under which authority. Pure.
#ifndef RIPS_SERVICES_RPC_HANDSHAKE_HINT_H_
#define RIPS_SERVICES_RPC_HANDSHAKE_HINT_H_

#include <string>

#include "absl/strings/string_view.h"
#include "services/runtime/config_sections.h"

namespace rips::rpc {

// `failure` as gRPC has it, of a connection to `server` with `files`. Empty if that says enough.
//
//   certificate verify failed         the server's is not issued under files.ca, or not valid now
//   alert, closed in the handshake    the server does not take files.cert
//   read failed, wrong version number no TLS there
std::string HandshakeHint(absl::string_view failure, absl::string_view server,
                          const TlsFiles& files);

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_HANDSHAKE_HINT_H_
